"""The scene file: recorded rigid-body scenes, one safetensors file per data set.

Metadata (all strings)
    format="rigidformer-scenes", version="1", dataset, frame_rate_hz, gravity_m_s2 ("x y z"), ground_friction,
    ground_restitution, shape_names (a JSON list), provenance, licence.

Tensors (P points, K shapes, S scenes, U units, F frames)
    shape_points   F32 (P, 3)     points of all shapes, body frame at scale 1, metres, file order
    shape_offsets  I64 (K+1)      shape k owns rows shape_offsets[k]..shape_offsets[k+1]
    scene_seed     I64 (S)
    scene_split    U8  (S)        0 train, 1 validation, 2 test, 3 extra
    scene_units    I64 (S+1)      scene s owns units scene_units[s]..scene_units[s+1]
    unit_shape     I32 (U)
    unit_scale     F32 (U)
    unit_physics   F32 (U, 3)     mass kg, friction, restitution
    unit_poses     F32 (U, F, 7)  position x, y, z of the body origin in metres, unit quaternion w, x, y, z whose
                                  sign is continuous over time

Frames are right-handed, z up, SI units. The same scenes give the same bytes: the header is written here, in a fixed
order, because the safetensors package orders metadata differently on every run.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open

FORMAT = "rigidformer-scenes"
VERSION = "1"

TRAIN, VALIDATION, TEST, EXTRA = 0, 1, 2, 3
SPLIT_NAMES = ("train", "validation", "test", "extra")

MOVI_SEEDS = 1200  # the published benchmark; seeds beyond are extra
_FIRST_TEST_SEEDS = (1019, 4, 1028, 1033, 1034, 1039, 1042, 542, 545, 547)  # in the published order

# name -> (dtype, dimensions); widest element first, so that every tensor starts aligned to its element
_TENSORS = {
    "scene_seed": ("<i8", 1),
    "scene_units": ("<i8", 1),
    "shape_offsets": ("<i8", 1),
    "shape_points": ("<f4", 2),
    "unit_physics": ("<f4", 2),
    "unit_poses": ("<f4", 3),
    "unit_scale": ("<f4", 1),
    "unit_shape": ("<i4", 1),
    "scene_split": ("|u1", 1),
}
_ST_DTYPE = {"<i8": "I64", "<f4": "F32", "<i4": "I32", "|u1": "U8"}
_METADATA = (
    "dataset",
    "frame_rate_hz",
    "gravity_m_s2",
    "ground_friction",
    "ground_restitution",
    "shape_names",
    "provenance",
    "licence",
)


class SceneFileError(ValueError):
    """A scene file that cannot be used. The message names the file, the field and the remedy."""

    def __init__(self, path, field_name: str, problem: str, remedy: str):
        super().__init__(f"{path}: {field_name}: {problem}; {remedy}")
        self.path, self.field = str(path), field_name
        self._arguments = (str(path), field_name, problem, remedy)

    def __reduce__(self):  # workers send it to their parent
        return type(self), self._arguments


@dataclass
class Scenes:
    """Scenes of one data set; see the module's text for each array."""

    dataset: str
    shape_names: list[str]
    shape_points: np.ndarray  # (P, 3)
    shape_offsets: np.ndarray  # (K+1)
    scene_seed: np.ndarray  # (S)
    scene_split: np.ndarray  # (S)
    scene_units: np.ndarray  # (S+1)
    unit_shape: np.ndarray  # (U)
    unit_scale: np.ndarray  # (U)
    unit_physics: np.ndarray  # (U, 3)
    unit_poses: np.ndarray  # (U, F, 7)
    provenance: str
    licence: str
    frame_rate_hz: float = 240.0
    gravity_m_s2: tuple[float, float, float] = field(default=(0.0, 0.0, -10.0))
    ground_friction: float = 0.3
    ground_restitution: float = 0.5

    @property
    def scenes(self) -> int:
        return len(self.scene_seed)

    @property
    def units(self) -> int:
        return len(self.unit_shape)

    @property
    def frames(self) -> int:
        return self.unit_poses.shape[1]

    def points_of_shape(self, shape: int) -> np.ndarray:
        """Points of a shape at scale 1, (points, 3)."""
        return self.shape_points[self.shape_offsets[shape] : self.shape_offsets[shape + 1]]

    def units_of_scene(self, scene: int) -> range:
        return range(int(self.scene_units[scene]), int(self.scene_units[scene + 1]))

    def scenes_of_split(self, split: int) -> np.ndarray:
        return np.flatnonzero(self.scene_split == split)


def write_scenes(path, scenes: Scenes) -> None:
    """Checks `scenes` and writes them to `path`: first under a temporary name beside it, then renamed."""
    path = Path(path)
    arrays = {}
    for name, (dtype, _) in _TENSORS.items():
        array = np.asarray(getattr(scenes, name))
        if array.dtype != np.dtype(dtype):
            raise SceneFileError(path, name, f"is {array.dtype}, not {np.dtype(dtype)}", "convert it before writing")
        arrays[name] = np.ascontiguousarray(array)
    _check(path, scenes, "nothing was written: correct the scenes")
    metadata = {
        "format": FORMAT,
        "version": VERSION,
        "dataset": scenes.dataset,
        "frame_rate_hz": _number(scenes.frame_rate_hz),
        "gravity_m_s2": " ".join(_number(g) for g in scenes.gravity_m_s2),
        "ground_friction": _number(scenes.ground_friction),
        "ground_restitution": _number(scenes.ground_restitution),
        "shape_names": json.dumps(list(scenes.shape_names)),
        "provenance": scenes.provenance,
        "licence": scenes.licence,
    }
    header: dict = {"__metadata__": metadata}
    start = 0
    for name, (dtype, _) in _TENSORS.items():
        end = start + arrays[name].nbytes
        header[name] = {"dtype": _ST_DTYPE[dtype], "shape": list(arrays[name].shape), "data_offsets": [start, end]}
        start = end
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)

    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "wb") as file:
            file.write(len(text).to_bytes(8, "little"))
            file.write(text)
            for array in arrays.values():
                file.write(memoryview(array.reshape(-1)).cast("B") if array.size else b"")
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def read_scenes(path) -> Scenes:
    """Reads and checks a scene file."""
    path = Path(path)
    remake = "make the file again with rigidformer_lab.movi"
    if not path.is_file():
        raise SceneFileError(path, "file", "does not exist", "give the path of a scene file, or make one with "
                             "rigidformer_lab.movi")
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            if metadata.get("format") != FORMAT:
                raise SceneFileError(path, "metadata format", f"is {metadata.get('format')!r}, not {FORMAT!r}",
                                     "give a scene file")
            if metadata.get("version") != VERSION:
                raise SceneFileError(path, "metadata version", f"is {metadata.get('version')!r}; this reader knows "
                                     f"{VERSION!r}", remake)
            for name in _METADATA:
                if name not in metadata:
                    raise SceneFileError(path, f"metadata {name}", "is missing", remake)
            present = set(file.keys())
            arrays = {}
            for name, (dtype, dimensions) in _TENSORS.items():
                if name not in present:
                    raise SceneFileError(path, f"tensor {name}", "is missing", remake)
                array = file.get_tensor(name)
                if array.dtype != np.dtype(dtype) or array.ndim != dimensions:
                    raise SceneFileError(path, f"tensor {name}", f"is {array.dtype} with {array.ndim} dimensions, not "
                                         f"{np.dtype(dtype)} with {dimensions}", remake)
                arrays[name] = array
    except (SafetensorError, OSError) as error:
        raise SceneFileError(path, "file", f"is not a readable safetensors file ({error})", remake) from error

    numbers = {}
    for name in ("frame_rate_hz", "ground_friction", "ground_restitution", "gravity_m_s2"):
        try:
            numbers[name] = [float(word) for word in metadata[name].split()]
        except ValueError:
            numbers[name] = []
        if len(numbers[name]) != (3 if name == "gravity_m_s2" else 1):
            raise SceneFileError(path, f"metadata {name}", f"is {metadata[name]!r}, which does not parse", remake)
    try:
        shape_names = json.loads(metadata["shape_names"])
    except json.JSONDecodeError:
        shape_names = None
    if not isinstance(shape_names, list) or not all(isinstance(name, str) for name in shape_names):
        raise SceneFileError(path, "metadata shape_names", "is not a JSON list of strings", remake)

    scenes = Scenes(
        dataset=metadata["dataset"],
        shape_names=shape_names,
        provenance=metadata["provenance"],
        licence=metadata["licence"],
        frame_rate_hz=numbers["frame_rate_hz"][0],
        gravity_m_s2=tuple(numbers["gravity_m_s2"]),
        ground_friction=numbers["ground_friction"][0],
        ground_restitution=numbers["ground_restitution"][0],
        **arrays,
    )
    _check(path, scenes, remake)
    return scenes


def concatenate(parts: list[Scenes]) -> Scenes:
    """One data set from parts of it, in the given order. All parts share their shapes and their number of frames."""
    first = parts[0]
    counts = np.concatenate([np.diff(part.scene_units) for part in parts])
    join = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("scene_seed", "scene_split", "unit_shape", "unit_scale", "unit_physics", "unit_poses")
    }
    return Scenes(
        dataset=first.dataset,
        shape_names=first.shape_names,
        shape_points=first.shape_points,
        shape_offsets=first.shape_offsets,
        scene_units=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        provenance=first.provenance,
        licence=first.licence,
        frame_rate_hz=first.frame_rate_hz,
        gravity_m_s2=first.gravity_m_s2,
        ground_friction=first.ground_friction,
        ground_restitution=first.ground_restitution,
        **join,
    )


def split_of_seed(dataset: str, seed: int) -> int:
    """TRAIN, VALIDATION, TEST or EXTRA. MOVi: the published split of seeds 1 to 1200; others are extra."""
    if dataset == "primitives":
        return {0: TEST, 9: VALIDATION}.get(seed % 10, TRAIN)
    if 1 <= seed <= MOVI_SEEDS:
        return int(_movi_split()[seed - 1])
    return EXTRA


@lru_cache(maxsize=1)
def _movi_split() -> np.ndarray:
    rng = np.random.default_rng(0)
    train = rng.choice(range(MOVI_SEEDS), 960, replace=False).tolist()
    # The published split draws the validation scenes from a Python set, so CPython's set order is part of it.
    rest = list(set(range(MOVI_SEEDS)) - set(train))
    validation = rng.choice(rest, 120, replace=False).tolist()
    test = list(set(rest) - set(validation))
    if tuple(index + 1 for index in test[:10]) != _FIRST_TEST_SEEDS:
        raise RuntimeError("this Python orders sets in another way than the published split needs; use CPython 3.11")
    split = np.full(MOVI_SEEDS, TRAIN, np.uint8)
    split[validation] = VALIDATION
    split[test] = TEST
    return split


def _check(path, scenes: Scenes, remedy: str) -> None:
    def fail(name: str, problem: str):
        raise SceneFileError(path, name, problem, remedy)

    def shape(name: str, expected: tuple):
        found = np.shape(getattr(scenes, name))
        if len(found) != len(expected) or any(e is not None and e != f for e, f in zip(expected, found)):
            fail(name, f"has shape {found}, not {tuple('any' if e is None else e for e in expected)}")

    def offsets(name: str, total: int):
        value = getattr(scenes, name)
        if value[0] != 0 or value[-1] != total or np.any(np.diff(value) <= 0):
            fail(name, f"does not rise from 0 to {total}")

    def finite(name: str):
        if not np.isfinite(getattr(scenes, name)).all():
            fail(name, "holds values that are not finite")

    units, count = len(scenes.unit_shape), len(scenes.scene_seed)
    if count == 0:
        fail("scene_seed", "is empty")
    shape("shape_points", (None, 3))
    shape("shape_offsets", (len(scenes.shape_names) + 1,))
    shape("scene_split", (count,))
    shape("scene_units", (count + 1,))
    shape("unit_scale", (units,))
    shape("unit_physics", (units, 3))
    shape("unit_poses", (units, None, 7))
    offsets("shape_offsets", len(scenes.shape_points))
    offsets("scene_units", units)
    if scenes.scene_split.max() > EXTRA:
        fail("scene_split", f"holds {scenes.scene_split.max()}, above {EXTRA}")
    if scenes.unit_shape.min() < 0 or scenes.unit_shape.max() >= len(scenes.shape_names):
        fail("unit_shape", f"names a shape outside 0..{len(scenes.shape_names) - 1}")
    for name in ("shape_points", "unit_scale", "unit_physics", "unit_poses"):
        finite(name)
    if scenes.unit_scale.min() <= 0:
        fail("unit_scale", "holds a scale that is not above 0")
    if scenes.unit_physics[:, 0].min() <= 0 or scenes.unit_physics.min() < 0:
        fail("unit_physics", "holds a mass that is not above 0, or a negative friction or restitution")
    if scenes.unit_poses.shape[1] == 0:
        fail("unit_poses", "holds no frames")
    quaternions = scenes.unit_poses[:, :, 3:]
    if np.abs(np.einsum("ufk,ufk->uf", quaternions, quaternions) - 1).max() > 1e-5:
        fail("unit_poses", "holds quaternions of a length other than 1")
    if np.einsum("ufk,ufk->uf", quaternions[:, 1:], quaternions[:, :-1]).min(initial=0.0) < 0:
        fail("unit_poses", "holds quaternions whose sign flips between frames")
    for name, value in (("frame_rate_hz", scenes.frame_rate_hz), ("ground_friction", scenes.ground_friction),
                        ("ground_restitution", scenes.ground_restitution)):
        if not math.isfinite(value) or value < 0 or (name == "frame_rate_hz" and value == 0):
            fail(name, f"is {value}")


def _number(value: float) -> str:
    return f"{value:.9g}"
