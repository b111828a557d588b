"""The scene file: recorded rigid-body scenes, one safetensors file per data set.

Metadata (all strings)
    format="rigidformer-scenes", version="1" or "2", dataset, frame_rate_hz, gravity_m_s2 ("x y z"), shape_names (a JSON
    list), provenance, licence; in version 1 ground_friction and ground_restitution of the plane z = 0. contact_law, how contacts that
    bounce differ from rigid ones: a number from 0 to 1, and ",pyramid" behind it or not; absent: not at all.

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

In version 2 besides (N planes, W soft points); all but the planes may be absent
    planes         F32 (N, 6)     normal towards the free side, offset in metres (free: normal . x >= offset), friction,
                                  restitution
    scene_planes   I64 (S+1)      scene s has planes scene_planes[s]..scene_planes[s+1], at most 8, may be none
    unit_role      U8  (U)        0 free, 1 driven, 2 fixed; absent: all free
    unit_body      I32 (U)        parts of one body of a scene share a number from 0 to 65534; -1: a body of its own
    commands       F32 (S, F, C)  a command a frame; of a step from frame a to b the mean over a..b-1 counts
    command_last   U8  (C)        1: a set point, such as the target of a joint: of a step from frame a to b that of b-1 counts;
                                  absent: none is
    unit_soft      U8  (U)        1: deformable
    soft_points    F32 (W, F, 3)  world positions of soft units' points, metres, unit after unit
    scene_frames   I64 (S)        recorded frames of a scene, 1..F; the others repeat its last one; absent: all
    shape_pieces   I64 (K+1)      shape k has the convex pieces shape_pieces[k]..shape_pieces[k+1], at most 32, may be none:
                                  what it touches with, where that is not the hull of its points
    piece_offsets  I64 (N+1)      piece n has the rows piece_offsets[n]..piece_offsets[n+1], 4 to 255
    piece_points   F32 (R, 3)     their points, as shape_points
    unit_velocity  F32 (U, 6)     at frame 0, in the world: of the body origin m/s, angular rad/s
    unit_inertia   F32 (U, 3)     principal moments kg m^2 of the unit as scaled, about axes through its centre along
                                  those of its shape's points; a row of zeros: that of the uniform box around the points
    unit_young     F32 (U)        Young's modulus of a soft unit, Pa, above 0; 0 for rigid units; absent: not known
    faces          I32 (T, 3)     triangles of the surfaces of soft units: rows of soft_points of the file
    scene_faces    I64 (S+1)      scene s has the faces scene_faces[s]..scene_faces[s+1], may be none
    edges          I32 (E, 2)     lines between soft points whose lengths are measured; scene_edges, I64 (S+1), as scene_faces
    tetrahedra     I32 (V, 4)     what soft units are filled with, for volumes; scene_tetrahedra, I64 (S+1), as scene_faces
    bonds          I32 (B, 2)     pairs of units, rows of the file, that hold together until the bond breaks; scene_bonds,
                                  I64 (S+1), as scene_faces
    height_fields  F32 (G, 9)     ground of varying height: rows, columns, spacing along x and y, corner x, y, z, friction,
                                  restitution; scene_height_fields, I64 (S+1), as scene_planes, at most one a scene
    heights        F32 (H)        (rows, columns) heights of each over its corner, metres, one field after another
    bond_frame     I32 (B)        first frame in which a bond is broken, 0..F; F: it holds

Scenes that need nothing of version 2 are written as version 1.

Frames are right-handed, z up, SI units. The same scenes give the same bytes: the header is written here, in a fixed
order, because the safetensors package orders metadata differently on every run.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open

from .roles import BODIES, FIXED, MAX_PLANES, OWN_BODY

FORMAT = "rigidformer-scenes"
VERSIONS = ("1", "2")
NORMAL_TOLERANCE = 1e-3
MAX_PIECES = 32  # of a shape
FAR_PIECES = 100  # farther ones are most likely in millimetres
LEAST_PIECE, MOST_PIECE = 4, 255  # points
INERTIA_TOLERANCE = 1e-3  # of the sum of the other two moments, which a thin plate reaches

TRAIN, VALIDATION, TEST, EXTRA = 0, 1, 2, 3
SPLIT_NAMES = ("train", "validation", "test", "extra")

MOVI_SEEDS = 1200  # the published benchmark; seeds beyond are extra
_FIRST_TEST_SEEDS = (1019, 4, 1028, 1033, 1034, 1039, 1042, 542, 545, 547)  # in the published order

# name -> (dtype, dimensions); widest element first, so that every tensor starts aligned to its element
_TENSORS = {
    "scene_seed": ("<i8", 1),
    "scene_units": ("<i8", 1),
    "shape_offsets": ("<i8", 1),
    "scene_planes": ("<i8", 1),
    "scene_frames": ("<i8", 1),
    "shape_pieces": ("<i8", 1),
    "piece_offsets": ("<i8", 1),
    "scene_faces": ("<i8", 1),
    "scene_edges": ("<i8", 1),
    "scene_tetrahedra": ("<i8", 1),
    "scene_bonds": ("<i8", 1),
    "piece_points": ("<f4", 2),
    "shape_points": ("<f4", 2),
    "unit_physics": ("<f4", 2),
    "unit_poses": ("<f4", 3),
    "unit_scale": ("<f4", 1),
    "unit_velocity": ("<f4", 2),
    "unit_inertia": ("<f4", 2),
    "planes": ("<f4", 2),
    "commands": ("<f4", 3),
    "soft_points": ("<f4", 3),
    "unit_young": ("<f4", 1),
    "unit_shape": ("<i4", 1),
    "unit_body": ("<i4", 1),
    "faces": ("<i4", 2),
    "edges": ("<i4", 2),
    "tetrahedra": ("<i4", 2),
    "bonds": ("<i4", 2),
    "bond_frame": ("<i4", 1),
    "scene_split": ("|u1", 1),
    "command_last": ("|u1", 1),
    "unit_role": ("|u1", 1),
    "unit_soft": ("|u1", 1),
}
_PLANES = ("scene_planes", "planes")  # what version 2 must have
_OPTIONAL = ("unit_role", "unit_body", "commands", "unit_soft", "soft_points", "scene_frames",
             "unit_velocity", "unit_inertia")  # what it may have
_PIECES = ("shape_pieces", "piece_offsets", "piece_points")  # all of them or none
_OF_FILE = ("command_last",)  # what it may have once for all scenes
_MESHES = {"faces": 3, "edges": 2, "tetrahedra": 4}  # soft points a row, in files that have them
_LISTS = (*_MESHES, "bonds")  # a scene has as many rows as its tensor scene_... says, maybe none
_LISTED = (*_LISTS, *(f"scene_{name}" for name in _LISTS), "bond_frame", "unit_young")
_MAYBE = (*_OPTIONAL, *_PIECES, *_OF_FILE, *_LISTED)
_ST_DTYPE = {"<i8": "I64", "<f4": "F32", "<i4": "I32", "|u1": "U8"}
_GROUND = ("ground_friction", "ground_restitution")  # of version 1
_METADATA = (
    "dataset",
    "frame_rate_hz",
    "gravity_m_s2",
    *_GROUND,
    "shape_names",
    "provenance",
    "licence",
)


@dataclass(frozen=True)
class ContactLaw:
    """How contacts that bounce differ from rigid ones in what recorded scenes (docs/CONTACT.md); as it is: not at all."""

    restitution_offset: float = 0.0  # is added to the restitution of each pair that bounces, from 0 to 1
    pyramid: bool = False  # friction of contacts that bounce has a pyramid along their sliding, and not a cone

    def __str__(self) -> str:
        """As files have it."""
        return _number(self.restitution_offset) + ",pyramid" * self.pyramid

    @staticmethod
    def of(text: str) -> "ContactLaw":
        """The law that a file has as such a text; ValueError where it is none."""
        offset, comma, shape = text.partition(",")
        if comma and shape != "pyramid":
            raise ValueError(f"{shape!r} is no shape of friction")
        if offset != offset.strip() or "_" in offset:
            raise ValueError(f"{offset!r} is no number")
        if not 0 <= float(offset) <= 1:
            raise ValueError(f"{offset} is not from 0 to 1")
        return ContactLaw(float(offset), bool(comma))


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
    contact_law: ContactLaw = ContactLaw()
    ground_friction: float | None = 0.3  # of the plane z = 0, where `planes` is None
    ground_restitution: float | None = 0.5
    planes: np.ndarray | None = None  # (N, 6); None: z = 0 for every scene
    scene_planes: np.ndarray | None = None  # (S+1)
    unit_role: np.ndarray | None = None  # (U); None: all free
    unit_body: np.ndarray | None = None  # (U); None: all bodies of their own
    commands: np.ndarray | None = None  # (S, F, C)
    command_last: np.ndarray | None = None  # (C); None: no number is a set point
    unit_soft: np.ndarray | None = None  # (U); None: all rigid
    soft_points: np.ndarray | None = None  # (W, F, 3)
    scene_frames: np.ndarray | None = None  # (S); None: all F of every scene
    unit_velocity: np.ndarray | None = None  # (U, 6); None: not known
    unit_inertia: np.ndarray | None = None  # (U, 3); None: all those of their boxes
    shape_pieces: np.ndarray | None = None  # (K+1); None: all shapes are the hulls of their points
    piece_offsets: np.ndarray | None = None  # (N+1)
    piece_points: np.ndarray | None = None  # (R, 3)
    unit_young: np.ndarray | None = None  # (U); None: not known
    faces: np.ndarray | None = None  # (T, 3)
    scene_faces: np.ndarray | None = None  # (S+1)
    edges: np.ndarray | None = None  # (E, 2)
    scene_edges: np.ndarray | None = None  # (S+1)
    tetrahedra: np.ndarray | None = None  # (V, 4)
    scene_tetrahedra: np.ndarray | None = None  # (S+1)
    bonds: np.ndarray | None = None  # (B, 2)
    scene_bonds: np.ndarray | None = None  # (S+1)
    bond_frame: np.ndarray | None = None  # (B)

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

    def pieces_of_shape(self, shape: int) -> list[np.ndarray]:
        """Convex pieces of a shape at scale 1, (points, 3) each; none: it is the hull of its points."""
        if self.shape_pieces is None:
            return []
        pieces = range(self.shape_pieces[shape], self.shape_pieces[shape + 1])
        return [self.piece_points[self.piece_offsets[k] : self.piece_offsets[k + 1]] for k in pieces]

    def units_of_scene(self, scene: int) -> range:
        return range(int(self.scene_units[scene]), int(self.scene_units[scene + 1]))

    def scenes_of_split(self, split: int) -> np.ndarray:
        return np.flatnonzero(self.scene_split == split)

    @property
    def roles(self) -> np.ndarray:
        """(U) FREE, DRIVEN or FIXED."""
        return np.zeros(self.units, np.uint8) if self.unit_role is None else self.unit_role

    @property
    def bodies(self) -> np.ndarray:
        """(U) numbers of bodies, -1: of its own."""
        return np.full(self.units, OWN_BODY, np.int32) if self.unit_body is None else self.unit_body

    @property
    def inertias(self) -> np.ndarray:
        """(U, 3) moments of inertia, kg m^2; zeros: those of the box around the points."""
        return np.zeros((self.units, 3), np.float32) if self.unit_inertia is None else self.unit_inertia

    @property
    def soft_offsets(self) -> np.ndarray:
        """(U+1): unit u owns soft_points soft_offsets[u]..soft_offsets[u+1], none if it is rigid."""
        counts = np.diff(self.shape_offsets)[self.unit_shape]
        counts = counts * (np.zeros(self.units, bool) if self.unit_soft is None else self.unit_soft > 0)
        return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)

    def frames_of_scene(self, scene: int) -> int:
        """Recorded frames of a scene; the arrays go on with its last one."""
        return self.frames if self.scene_frames is None else int(self.scene_frames[scene])

    def planes_of_scene(self, scene: int) -> np.ndarray:
        """(planes, 6): normal, offset, friction, restitution."""
        if self.planes is None:
            return np.array([[0, 0, 1, 0, self.ground_friction, self.ground_restitution]], np.float32)
        return self.planes[self.scene_planes[scene] : self.scene_planes[scene + 1]]

    def faces_of_scene(self, scene: int) -> np.ndarray:
        """(triangles, 3): rows of `soft_points`; none where the file has no such list."""
        return self._listed("faces", scene)

    def edges_of_scene(self, scene: int) -> np.ndarray:
        """(edges, 2): rows of `soft_points`."""
        return self._listed("edges", scene)

    def tetrahedra_of_scene(self, scene: int) -> np.ndarray:
        """(tetrahedra, 4): rows of `soft_points`."""
        return self._listed("tetrahedra", scene)

    def bonds_of_scene(self, scene: int) -> np.ndarray:
        """(bonds, 3): two units of the file and the first frame in which they do not hold together."""
        pairs = self._listed("bonds", scene)
        frames = np.zeros(0, np.int32) if self.bonds is None else self.bond_frame[slice(*self.scene_bonds[scene : scene + 2])]
        return np.column_stack([pairs, frames])

    def _listed(self, name: str, scene: int) -> np.ndarray:
        rows = getattr(self, name)
        if rows is None:
            return np.zeros((0, _MESHES.get(name, 2)), np.int32)
        return rows[slice(*getattr(self, f"scene_{name}")[scene : scene + 2])]

    @property
    def version(self) -> str:
        """Of the file that these scenes make: 1 where version 1 can hold them."""
        more = self.commands is not None or np.any(self.roles) or np.any(self.bodies != OWN_BODY)
        more = more or (self.unit_soft is not None and np.any(self.unit_soft)) or self.soft_points is not None
        more = more or self.unit_velocity is not None or (self.unit_inertia is not None and np.any(self.unit_inertia))
        more = more or self.shape_pieces is not None or any(getattr(self, name) is not None for name in _LISTED)
        more = more or (self.scene_frames is not None and np.any(self.scene_frames != self.frames))
        return "2" if more or self._ground() is None else "1"

    def _ground(self) -> tuple[float, float] | None:
        """Friction and restitution, if z = 0 is what every scene stands on, and the same."""
        if self.planes is None:
            return self.ground_friction, self.ground_restitution
        if len(self.planes) != self.scenes or np.any(np.diff(self.scene_planes) != 1):
            return None
        if np.any(self.planes != self.planes[0]) or self.planes[0, :4].tolist() != [0, 0, 1, 0]:
            return None
        return tuple(self.planes[0, 4:].tolist())

    def _or_default(self, name: str) -> np.ndarray:
        """A tensor, its default where it is absent."""
        value = getattr(self, name)
        if value is not None:
            return value
        if name in ("commands", "unit_velocity"):
            raise ValueError(f"{name}: some parts have them and some do not; give them to all")
        defaults = {"unit_role": self.roles, "unit_body": self.bodies, "unit_soft": np.zeros(self.units, np.uint8),
                    "scene_frames": np.full(self.scenes, self.frames, np.int64),
                    "unit_inertia": self.inertias}
        return defaults.get(name, np.zeros((0, self.frames, 3), np.float32))

    def _with_planes(self) -> "Scenes":
        """The same scenes, the ground among the planes."""
        if self.planes is not None:
            return self
        planes = np.repeat(self.planes_of_scene(0), self.scenes, axis=0)
        return dataclasses.replace(self, planes=planes, scene_planes=np.arange(self.scenes + 1, dtype=np.int64))


def write_scenes(path, scenes: Scenes) -> None:
    """Checks `scenes` and writes them to `path`: first under a temporary name beside it, then renamed."""
    path = Path(path)
    remedy = "nothing was written: correct the scenes"
    for name, (dtype, dimensions) in _TENSORS.items():
        array = getattr(scenes, name)
        if array is None and name in (*_PLANES, *_MAYBE):
            continue
        array = np.asarray(array)
        if array.dtype != np.dtype(dtype):
            raise SceneFileError(path, name, f"is {array.dtype}, not {np.dtype(dtype)}", "convert it before writing")
        if array.ndim != dimensions:
            raise SceneFileError(path, name, f"has {array.ndim} dimensions, not {dimensions}", remedy)
    _check(path, scenes, remedy)
    version = scenes.version
    if version == "2":
        scenes = scenes._with_planes()
    friction, restitution = scenes._ground() or (None, None)
    arrays = {
        name: np.ascontiguousarray(getattr(scenes, name))
        for name in _TENSORS
        if name not in (*_PLANES, *_MAYBE) or (version == "2" and getattr(scenes, name) is not None)
    }
    metadata = {
        "format": FORMAT,
        "version": version,
        "dataset": scenes.dataset,
        "frame_rate_hz": _number(scenes.frame_rate_hz),
        "gravity_m_s2": " ".join(_number(g) for g in scenes.gravity_m_s2),
    }
    if version == "1":
        metadata |= {"ground_friction": _number(friction), "ground_restitution": _number(restitution)}
    if scenes.contact_law != ContactLaw():
        metadata["contact_law"] = str(scenes.contact_law)
    metadata |= {
        "shape_names": json.dumps(list(scenes.shape_names)),
        "provenance": scenes.provenance,
        "licence": scenes.licence,
    }
    header: dict = {"__metadata__": metadata}
    start = 0
    for name, array in arrays.items():
        end = start + array.nbytes
        dtype = _ST_DTYPE[_TENSORS[name][0]]
        header[name] = {"dtype": dtype, "shape": list(array.shape), "data_offsets": [start, end]}
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
            version = metadata.get("version")
            if version not in VERSIONS:
                raise SceneFileError(path, "metadata version", f"is {version!r}; this reader knows "
                                     f"{' and '.join(map(repr, VERSIONS))}", remake)
            for name in _METADATA:
                if name not in metadata and not (version == "2" and name in _GROUND):
                    raise SceneFileError(path, f"metadata {name}", "is missing", remake)
            present = set(file.keys())
            if "height_fields" in present:
                raise SceneFileError(path, "tensor height_fields", "holds ground of varying height, which networks and the lab's solver "
                                     "do not know", "roll it out with the program or Python, by impulses")
            arrays = {}
            for name, (dtype, dimensions) in _TENSORS.items():
                if name not in present:
                    if name in _MAYBE or (version == "1" and name in _PLANES):
                        continue
                    raise SceneFileError(path, f"tensor {name}", "is missing", remake)
                if version == "1" and name in (*_PLANES, *_MAYBE):
                    raise SceneFileError(path, f"tensor {name}", "is of version 2, the file says that it is of "
                                         "version 1", remake)
                array = file.get_tensor(name)
                if array.dtype != np.dtype(dtype) or array.ndim != dimensions:
                    raise SceneFileError(path, f"tensor {name}", f"is {array.dtype} with {array.ndim} dimensions, not "
                                         f"{np.dtype(dtype)} with {dimensions}", remake)
                arrays[name] = array
    except (SafetensorError, OSError) as error:
        raise SceneFileError(path, "file", f"is not a readable safetensors file ({error})", remake) from error

    numbers = {name: [None] for name in _GROUND}
    for name in ("frame_rate_hz", *(_GROUND if version == "1" else ()), "gravity_m_s2"):
        try:
            numbers[name] = [float(word) for word in metadata[name].split()]
        except ValueError:
            numbers[name] = []
        if len(numbers[name]) != (3 if name == "gravity_m_s2" else 1):
            raise SceneFileError(path, f"metadata {name}", f"is {metadata[name]!r}, which does not parse", remake)
    try:
        law = ContactLaw.of(metadata.get("contact_law", "0"))
    except ValueError:
        raise SceneFileError(path, "metadata contact_law", f"is {metadata['contact_law']!r}, not a number from 0 to 1 with ',pyramid' "
                             "behind it or without", remake) from None
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
        contact_law=law,
        ground_friction=numbers["ground_friction"][0],
        ground_restitution=numbers["ground_restitution"][0],
        **arrays,
    )
    _check(path, scenes, remake)
    return scenes


def commands_of_steps(commands: np.ndarray, step: int, last: np.ndarray | None) -> np.ndarray:
    """(steps, C) of (frames, C): of each step of so many frames the mean, or the last one where `last` (C) says so."""
    commands = commands.reshape(len(commands) // step, step, -1)
    mean = commands.mean(1)
    return mean if last is None else np.where(last > 0, commands[:, -1], mean)


def concatenate(parts: list[Scenes]) -> Scenes:
    """One data set from parts of it, in the given order. All parts share their number of frames, their frame rate,
    gravity and contact law, whether they have commands and velocities, and which commands are set points. Parts that do not have the same
    shapes keep theirs, and must have no pieces."""
    first = parts[0]
    if any(part.planes is not None for part in parts):
        parts = [part._with_planes() for part in parts]
    names = ("scene_seed", "scene_split", "unit_shape", "unit_scale", "unit_physics", "unit_poses", "planes", *_OPTIONAL)
    join = {}
    for name in names:
        if any(getattr(part, name) is not None for part in parts):
            join[name] = np.concatenate([part._or_default(name) for part in parts])
    join |= _join_lists(parts) | _join_shapes(parts)
    if any(not np.array_equal(part.command_last, first.command_last) for part in parts if part is not first):
        raise ValueError("command_last: parts have other set points; give all the same")
    if any(part.contact_law != first.contact_law for part in parts):
        raise ValueError("contact_law: parts have other laws; give all the same")
    for name in ("scene_units", "scene_planes"):
        values = [getattr(part, name) for part in parts]
        if values[0] is not None:
            join[name] = _joined_offsets(values)
    return dataclasses.replace(first, **join)


def _join_shapes(parts: list[Scenes]) -> dict:
    """The shapes of all parts, one part after another, and what of them units have; nothing where all have the same."""
    first = parts[0]
    if all(part.shape_names == first.shape_names and np.array_equal(part.shape_points, first.shape_points) for part in parts):
        return {}
    if any(part.shape_pieces is not None for part in parts):
        raise ValueError("shape_pieces: parts with other shapes have pieces; give parts of the same shapes")
    shapes = np.cumsum([0] + [len(part.shape_names) for part in parts])
    return {
        "shape_names": [name for part in parts for name in part.shape_names],
        "shape_points": np.concatenate([part.shape_points for part in parts]),
        "shape_offsets": _joined_offsets([part.shape_offsets for part in parts]),
        "unit_shape": np.concatenate([part.unit_shape + shape for part, shape in zip(parts, shapes)]).astype(np.int32),
    }


def _join_lists(parts: list[Scenes]) -> dict:
    """Young's moduli, meshes and bonds of all parts that have them, whose rows now count units and soft points of all."""
    join = {}
    if any(part.unit_young is not None for part in parts):
        if any(part.unit_young is None and part.soft_offsets[-1] for part in parts):
            raise ValueError("unit_young: some parts with soft units have it and some do not; give it to all")
        rigid = [np.zeros(part.units, np.float32) for part in parts]
        join["unit_young"] = np.concatenate([r if p.unit_young is None else p.unit_young for p, r in zip(parts, rigid)])
    units = np.cumsum([0] + [part.units for part in parts])
    points = np.cumsum([0] + [int(part.soft_offsets[-1]) for part in parts])
    for name in _LISTS:
        if all(getattr(part, name) is None for part in parts):
            continue
        starts = units if name == "bonds" else points
        empty = np.zeros((0, _MESHES.get(name, 2)), np.int32)
        rows = [empty if getattr(part, name) is None else getattr(part, name) + start for part, start in zip(parts, starts)]
        none = [np.zeros(part.scenes + 1, np.int64) for part in parts]
        offsets = [getattr(part, f"scene_{name}") for part in parts]
        join[name] = np.concatenate(rows).astype(np.int32)
        join[f"scene_{name}"] = _joined_offsets([n if o is None else o for n, o in zip(none, offsets)])
    if "bonds" in join:
        join["bond_frame"] = np.concatenate([part.bond_frame for part in parts if part.bonds is not None])
    return join


def _joined_offsets(offsets: list[np.ndarray]) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(np.concatenate([np.diff(values) for values in offsets]))]).astype(np.int64)


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
    numbers = [("frame_rate_hz", scenes.frame_rate_hz)]
    if scenes.planes is None and scenes.scene_planes is None:
        numbers += [(name, getattr(scenes, name)) for name in _GROUND]
    for name, value in numbers:
        if value is None or not math.isfinite(value) or value < 0 or (name == "frame_rate_hz" and value == 0):
            fail(name, f"is {value}")
    if len(scenes.gravity_m_s2) != 3 or not all(map(math.isfinite, scenes.gravity_m_s2)):
        fail("gravity_m_s2", f"is {scenes.gravity_m_s2}, not three finite numbers")
    if not 0 <= scenes.contact_law.restitution_offset <= 1:
        fail("contact_law", f"has a restitution_offset of {scenes.contact_law.restitution_offset}, not one from 0 to 1")
    _check_version_2(scenes, fail, shape)


def _check_version_2(scenes: Scenes, fail, shape) -> None:
    def first(bad, name: str, problem: str):
        """Fails, if any row is bad, with the first one."""
        if np.any(bad):
            row = int(np.flatnonzero(bad)[0])
            fail(name, f"row {row}: {problem.format(np.asarray(getattr(scenes, name))[row])}")

    units, count, frames = scenes.units, scenes.scenes, scenes.frames
    if (scenes.planes is None) != (scenes.scene_planes is None):
        fail("planes" if scenes.planes is None else "scene_planes", "is missing: planes and scene_planes go together")
    if scenes.planes is not None:
        shape("planes", (None, 6))
        shape("scene_planes", (count + 1,))
        rising = np.diff(scenes.scene_planes)
        if scenes.scene_planes[0] != 0 or scenes.scene_planes[-1] != len(scenes.planes) or np.any(rising < 0):
            fail("scene_planes", f"does not go from 0 to {len(scenes.planes)} without falling")
        many = np.flatnonzero(rising > MAX_PLANES)
        if len(many):
            fail("scene_planes", f"row {many[0]}: gives the scene {rising[many[0]]} planes, more than {MAX_PLANES}")
        first(~np.isfinite(scenes.planes).all(1), "planes", "holds values that are not finite")
        length = np.linalg.norm(scenes.planes[:, :3].astype(np.float64), axis=1)
        first(np.abs(length - 1) > NORMAL_TOLERANCE, "planes", "the normal of {} is not of length 1")
        first((scenes.planes[:, 4:] < 0).any(1), "planes", "holds a negative friction or restitution")
    if scenes.unit_role is not None:
        shape("unit_role", (units,))
        first(scenes.unit_role > FIXED, "unit_role", "is {}, neither 0 (free) nor 1 (driven) nor 2 (fixed)")
        fixed = np.flatnonzero(scenes.unit_role == FIXED)
        moved = (scenes.unit_poses[fixed] != scenes.unit_poses[fixed, :1]).any((1, 2))
        if moved.any():
            fail("unit_poses", f"row {fixed[moved][0]}: moves, but unit_role says that it is fixed (2)")
    if scenes.unit_body is not None:
        shape("unit_body", (units,))
        bad = (scenes.unit_body < OWN_BODY) | (scenes.unit_body >= BODIES)
        first(bad, "unit_body", f"is {{}}, neither -1 nor a number from 0 to {BODIES - 1}")
    if scenes.commands is not None:
        shape("commands", (count, frames, None))
        if scenes.commands.shape[2] == 0:
            fail("commands", "holds commands of no numbers; leave the tensor out")
        first(~np.isfinite(scenes.commands).all((1, 2)), "commands", "holds values that are not finite")
    if scenes.command_last is not None:
        if scenes.commands is None:
            fail("command_last", "is there without commands; leave it out")
        shape("command_last", scenes.commands.shape[2:])
        first(scenes.command_last > 1, "command_last", "is {}, neither 0 (a mean counts) nor 1 (the last one counts)")
    if scenes.unit_soft is not None:
        shape("unit_soft", (units,))
        first(scenes.unit_soft > 1, "unit_soft", "is {}, neither 0 (rigid) nor 1 (deformable)")
    points = int(scenes.soft_offsets[-1])
    if scenes.soft_points is not None:
        shape("soft_points", (points, frames, 3))
        first(~np.isfinite(scenes.soft_points).all((1, 2)), "soft_points", "holds values that are not finite")
    elif points:
        fail("soft_points", f"is missing: unit_soft names deformable units of {points} points in all")
    _check_pieces(scenes, fail, shape, first)
    _check_lists(scenes, fail, shape, first)
    if scenes.scene_frames is not None:
        shape("scene_frames", (count,))
        bad = (scenes.scene_frames < 1) | (scenes.scene_frames > frames)
        first(bad, "scene_frames", f"is {{}}, not a number from 1 to {frames}")
        each = np.repeat(scenes.scene_frames, np.diff(scenes.scene_units))
        for unit in np.flatnonzero(each < frames):
            rest = scenes.unit_poses[unit, each[unit] - 1 :]
            if (rest != rest[:1]).any():
                fail("unit_poses", f"row {unit}: moves after the {each[unit]} frames that scene_frames gives its scene")
    if scenes.unit_velocity is not None:
        shape("unit_velocity", (units, 6))
        first(~np.isfinite(scenes.unit_velocity).all(1), "unit_velocity", "holds values that are not finite")
    if scenes.unit_inertia is not None:
        shape("unit_inertia", (units, 3))
        first(~np.isfinite(scenes.unit_inertia).all(1), "unit_inertia", "holds values that are not finite")
        moments = scenes.unit_inertia.astype(np.float64)
        bad = (moments != 0).any(1) & (moments <= 0).any(1)
        first(bad, "unit_inertia", "the moments {} are neither all 0 (those of the box) nor all above 0")
        greatest = moments.max(1, initial=0.0)
        bad = greatest > (1 + INERTIA_TOLERANCE) * (moments.sum(1) - greatest)
        first(bad, "unit_inertia", "of the moments {} one is greater than the sum of the other two, which no body has")


def _check_pieces(scenes: Scenes, fail, shape, first) -> None:
    given = [name for name in _PIECES if getattr(scenes, name) is not None]
    if not given:
        return
    for name in _PIECES:
        if name not in given:
            fail(name, f"is missing: {', '.join(_PIECES)} go together")
    shape("shape_pieces", (len(scenes.shape_names) + 1,))
    shape("piece_points", (None, 3))
    for name, total, least, most, of in (
        ("shape_pieces", len(scenes.piece_offsets) - 1, 0, MAX_PIECES, "shape {} {} pieces"),
        ("piece_offsets", len(scenes.piece_points), LEAST_PIECE, MOST_PIECE, "piece {} {} points"),
    ):
        value = getattr(scenes, name)
        rising = np.diff(value)
        if len(value) == 0 or value[0] != 0 or value[-1] != total or np.any(rising < 0):
            fail(name, f"does not go from 0 to {total} without falling")
        for row in np.flatnonzero((rising < least) | (rising > most))[:1]:
            limit = f"more than {most}" if rising[row] > most else f"fewer than {least}"
            fail(name, f"row {row}: gives {of.format(row, rising[row])}, {limit}")
    first(~np.isfinite(scenes.piece_points).all(1), "piece_points", "holds values that are not finite")
    for row in range(len(scenes.shape_names)):
        points, pieces = scenes.points_of_shape(row), scenes.pieces_of_shape(row)
        middle, reach = (points.min(0) + points.max(0)) / 2, np.linalg.norm(np.ptp(points, axis=0)) / 2
        if pieces and 0 < FAR_PIECES * reach < np.linalg.norm(np.concatenate(pieces) - middle, axis=1).max():
            fail("shape_pieces", f"row {row}: gives pieces more than {FAR_PIECES} times as far out as the shape's points; "
                                 "give both in metres")


def _check_lists(scenes: Scenes, fail, shape, first) -> None:
    if scenes.unit_young is not None:
        shape("unit_young", (scenes.units,))
        first(~np.isfinite(scenes.unit_young) | (scenes.unit_young < 0), "unit_young", "is {}, not a number of at least 0")
        soft = np.zeros(scenes.units, bool) if scenes.unit_soft is None else scenes.unit_soft > 0
        first(soft & (scenes.unit_young == 0), "unit_young", "is {}, but unit_soft says that the unit is soft; give it more than 0")
        first(~soft & (scenes.unit_young > 0), "unit_young", "is {}, but the unit is rigid; give it 0")
    for name in _LISTS:
        rows, ends = getattr(scenes, name), getattr(scenes, f"scene_{name}")
        if rows is None and ends is None:
            continue
        if rows is None or ends is None:
            fail(name if rows is None else f"scene_{name}", f"is missing: {name} and scene_{name} go together")
        shape(name, (None, _MESHES.get(name, 2)))
        shape(f"scene_{name}", (scenes.scenes + 1,))
        count = np.diff(ends)
        if ends[0] != 0 or ends[-1] != len(rows) or np.any(count < 0):
            fail(f"scene_{name}", f"does not go from 0 to {len(rows)} without falling")
        kind = "units" if name == "bonds" else "soft points"
        starts = scenes.scene_units if name == "bonds" else scenes.soft_offsets[scenes.scene_units]
        low, high = np.repeat(starts[:-1], count)[:, None], np.repeat(starts[1:], count)[:, None]
        first(((rows < low) | (rows >= high)).any(1), name, f"{{}} are not all rows of {kind} of its scene")
        ordered = np.sort(rows, axis=1)
        first((ordered[:, 1:] == ordered[:, :-1]).any(1), name, f"{{}} names one of the {kind} twice")
    if (scenes.bonds is None) != (scenes.bond_frame is None):
        fail("bonds" if scenes.bonds is None else "bond_frame", "is missing: bonds and bond_frame go together")
    if scenes.bonds is not None:
        shape("bond_frame", (len(scenes.bonds),))
        bad = (scenes.bond_frame < 0) | (scenes.bond_frame > scenes.frames)
        first(bad, "bond_frame", f"is {{}}, not a number from 0 to {scenes.frames}")


def _number(value: float) -> str:
    return f"{value:.9g}"
