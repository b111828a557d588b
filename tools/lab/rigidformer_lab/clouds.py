"""Shapes as `rigidformer track` makes them of the same bodies: half seen, noisy, completed.

    python -m rigidformer_lab.clouds movi-a.safetensors --out movi-a-clouds.safetensors --cameras 2 --noise 0.001

Depth cameras see each scene from where `rigidformer track --render` has them, and the tracker follows its units for some captures up to
one of its frames. The seed draws how many captures those are, 1 to `--captures`, and which frame is the last one. What the tracker then
has of a unit is the unit's shape: what was seen, with the errors of depths, of normals and of the tracker's poses, and its guess at what
was not (`docs/TRACKING.md`). Other units and planes hide what they do in an image.

Points are in the recorded body frames, so that poses, seeds and splits stay those of the file. Physics are the tracker's: units have
1000 kg/m3 over the hull of their points, units and planes a friction of .5 and a restitution of .4, and inertia is that of the box
around the points. `--physics record` keeps recorded masses, frictions and restitutions. A unit that no capture shows keeps its recorded
shape, and the command says how many do.

`--variants` looks at each scene several times, and the file has so many scenes of each. Test scenes are left out unless `--splits` names
them. Needs the runtime's Python package `rigidformer`. An interrupted run continues.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from .movi import _terminate, generate, shards_of
from .scenes import SPLIT_NAMES, ContactLaw, SceneFileError, Scenes, read_scenes

RATE_HZ = 30.0  # captures a second, as `rigidformer track --render` has them
MOST_CAMERAS = 3
DENSITY_KG_M3, FRICTION, RESTITUTION = 1000.0, 0.5, 0.4  # of the tracker's options
PHYSICS = ("track", "record")
OWN = 0.25  # radii that a track's points lie off the surface of its unit, at most, in the median
LEAST = 4  # points that a unit needs
FLAT = 1e-3  # a shape that is thinner than this part of its extent encloses nothing
SEEN = ", seen"  # what the names of completed shapes end with
DRAWS = 97  # of this command, so that no other one draws the same numbers from a seed


class CloudsError(ValueError):
    """Scenes that cannot be seen. The message has the remedy."""


def surface_of(points: np.ndarray, pieces: list[np.ndarray]) -> list[np.ndarray]:
    """Half-spaces (faces, 4) of each convex part of a shape: outward normal and offset."""
    try:
        return [ConvexHull(part.astype(np.float64)).equations for part in pieces or [points]]
    except QhullError as error:
        raise CloudsError("a shape encloses no volume, so that no camera sees it; leave its scenes out") from error


def off_surface(points: np.ndarray, surface: list[np.ndarray]) -> np.ndarray:
    """Distances (N) of points from a surface, about: by the faces' planes."""
    return np.abs(np.stack([(points @ part[:, :3].T + part[:, 3]).max(1) for part in surface]).min(0))


def volume_m3(points: np.ndarray) -> float:
    """Of the hull."""
    return float(ConvexHull(points.astype(np.float64)).volume)


def encloses(points: np.ndarray) -> bool:
    """Whether points have a hull with a volume."""
    if len(points) < LEAST:
        return False
    spread = np.linalg.svd(points - points.mean(0), compute_uv=False)
    return bool(spread[2] > FLAT * spread[0])


def owners(shapes: list[np.ndarray], surfaces: list[list[np.ndarray]], radii: np.ndarray, poses: np.ndarray) -> list[int | None]:
    """Of each track, whose points (N, 3) are in the world, the unit whose surface they are on; units have one track each."""
    turns = Rotation.from_quat(poses[:, [4, 5, 6, 3]])
    off = np.full((len(shapes), len(surfaces)), np.inf)
    for track, points in enumerate(shapes):
        for unit, surface in enumerate(surfaces):
            local = turns[unit].inv().apply(points - poses[unit, :3])
            off[track, unit] = np.median(off_surface(local, surface)) / radii[unit]
    found: list[int | None] = [None] * len(shapes)
    while off.size and off.min() < OWN:
        track, unit = np.unravel_index(off.argmin(), off.shape)
        found[track] = int(unit)
        off[track], off[:, unit] = np.inf, np.inf
    return found


@dataclass(frozen=True)
class Look:
    """How scenes are seen."""

    cameras: int
    noise_m: float
    captures: int
    seed: int
    model: Path | None = None

    def shapes(self, rigidformer, scene, surfaces, radii, numbers: tuple[int, ...]) -> list[tuple[np.ndarray, float] | None]:
        """Of each unit of a scene its points in the body frame and its mass, as the tracker has them at some frame; None: it has
        none. `numbers` tell the look's draws from those of others."""
        rng = np.random.default_rng((DRAWS, self.seed, *numbers))
        frame = int(rng.integers(scene.frames))
        now_s = frame / scene.frame_rate_hz
        # Nothing was recorded before the first frame.
        most = min(self.captures, int(now_s * RATE_HZ + 1e-6) + 1)
        captures, errors = int(rng.integers(1, most + 1)), int(rng.integers(2**32))
        model = None if self.model is None else rigidformer.Model(self.model)
        tracker = rigidformer.Tracker(model, segmentation="given", gravity_m_s2=scene.gravity_m_s2, confirm=1,
                                      plane_physics=(FRICTION, RESTITUTION), unit_physics=(FRICTION, RESTITUTION),
                                      density_kg_m3=DENSITY_KG_M3)  # fmt: skip
        for capture in range(captures):
            time_s = max(0.0, now_s - (captures - 1 - capture) / RATE_HZ)
            views = scene.views(time_s, cameras=self.cameras, deviation_m=self.noise_m, capture=capture, seed=errors)
            estimate = tracker.observe(time_s, views)
        tracks = [track for track in estimate.units if tracker.shape(track.id) is not None]
        carried = []
        for track in tracks:
            points = np.asarray(tracker.shape(track.id), np.float64)
            pose = np.asarray(track.pose, np.float64)
            carried.append(Rotation.from_quat(pose[[4, 5, 6, 3]]).apply(points) + pose[:3])
        poses = np.asarray(scene.poses[frame], np.float64)
        found: list[tuple[np.ndarray, float] | None] = [None] * len(poses)
        for track, points, unit in zip(tracks, carried, owners(carried, surfaces, radii, poses)):
            if unit is None or not encloses(points):
                continue
            turn = Rotation.from_quat(poses[unit][[4, 5, 6, 3]])
            found[unit] = turn.inv().apply(points - poses[unit][:3]).astype(np.float32), float(tracker.mass_kg(track.id))
        return found


@dataclass(frozen=True)
class Recipe:
    """What is made of a file: the scenes of some splits, each seen so many times. Seeds are numbers of looks."""

    path: Path
    look: Look
    splits: tuple[str, ...]
    limit: int | None
    variants: int
    physics: str
    dataset: str
    seeds: int
    frames: int = 1  # of a shard, which has shapes alone

    @property
    def name(self) -> str:
        return self.dataset

    def shards(self) -> list[range]:
        return shards_of(0, self.seeds)

    def description(self) -> dict:
        numbers = dataclasses.asdict(self.look) | {"model": str(self.look.model), "variants": self.variants, "physics": self.physics}
        return {"scenes": str(self.path), "splits": self.splits, "limit": self.limit, **numbers}

    def make(self, looks: range) -> Scenes:
        """Shapes and masses of these looks, in frame 0."""
        import rigidformer

        file, dataset = read_scenes(self.path), rigidformer.Dataset(self.path)
        rows = rows_of(file, self.splits, self.limit)
        surfaces = [surface_of(file.points_of_shape(k), file.pieces_of_shape(k)) for k in range(len(file.shape_names))]
        far = [np.linalg.norm(file.points_of_shape(k), axis=1).max() for k in range(len(file.shape_names))]
        names, points, masses, units = [], [], [], []
        for number in looks:
            row, variant = int(rows[number // self.variants]), number % self.variants
            own = file.units_of_scene(row)
            kinds, scales = file.unit_shape[own], file.unit_scale[own].astype(np.float64)
            scaled = [[np.column_stack((part[:, :3], part[:, 3] * scale)) for part in surfaces[kind]] for kind, scale in zip(kinds, scales)]
            radii = np.array([far[kind] for kind in kinds]) * scales
            found = self.look.shapes(rigidformer, dataset.scene(row), scaled, radii, (int(file.scene_seed[row]), row, variant))
            for kind, scale, shape in zip(kinds, scales, found):
                name, true = file.shape_names[kind], file.points_of_shape(kind)
                names.append(name if shape is None else name + SEEN)
                points.append(true if shape is None else shape[0])
                masses.append(DENSITY_KG_M3 * volume_m3(true * scale) if shape is None else shape[1])
            units.extend(own)
        rows_seen = [int(rows[number // self.variants]) for number in looks]
        physics = np.column_stack((masses, np.full(len(masses), FRICTION), np.full(len(masses), RESTITUTION))).astype(np.float32)
        return Scenes(
            dataset=self.dataset, shape_names=names, shape_points=np.concatenate(points),
            shape_offsets=ends([len(p) for p in points]), scene_seed=np.array(looks, np.int64),
            scene_split=file.scene_split[rows_seen], scene_units=ends([len(file.units_of_scene(row)) for row in rows_seen]),
            unit_shape=np.arange(len(names), dtype=np.int32), unit_scale=np.ones(len(names), np.float32), unit_physics=physics,
            unit_poses=file.unit_poses[units, :1], provenance=file.provenance, licence=file.licence, frame_rate_hz=file.frame_rate_hz,
            gravity_m_s2=file.gravity_m_s2,
        )  # fmt: skip

    def join(self, shards: list[Scenes]) -> Scenes:
        """The scenes of the file with these shapes."""
        file = read_scenes(self.path)
        scenes = picked(file, np.repeat(rows_of(file, self.splits, self.limit), self.variants))
        names = [name for shard in shards for name in shard.shape_names]
        points = [shard.points_of_shape(k) for shard in shards for k in range(len(shard.shape_names))]
        seen = np.array([name.endswith(SEEN) for name in names])
        of = np.flatnonzero(seen)
        shape, scale = scenes.unit_shape.copy(), scenes.unit_scale.copy()
        # Recorded shapes come first: units that nobody saw keep theirs.
        shape[seen], scale[seen] = len(file.shape_names) + np.arange(len(of), dtype=np.int32), 1.0
        more: dict = {}
        if file.shape_pieces is not None:
            more["shape_pieces"] = np.concatenate([file.shape_pieces, np.full(len(of), file.shape_pieces[-1])])
        if self.physics == "track":
            # The tracker knows no law of contact.
            more |= {"unit_physics": np.concatenate([shard.unit_physics for shard in shards]), "unit_inertia": None, "contact_law": ContactLaw()}
            if scenes.planes is None:
                more |= {"ground_friction": FRICTION, "ground_restitution": RESTITUTION}
            else:
                more["planes"] = np.column_stack((scenes.planes[:, :4], np.tile(np.float32([FRICTION, RESTITUTION]), (len(scenes.planes), 1))))
        elif scenes.unit_inertia is not None:
            # Axes of recorded moments are those of recorded points; a row of zeros is the box of the points that there are.
            more["unit_inertia"] = np.where(seen[:, None], np.float32(0), scenes.unit_inertia)
        look = self.look
        with_model = "" if look.model is None else f" with {look.model.name}"
        return dataclasses.replace(
            scenes, shape_names=file.shape_names + [names[k] for k in of], unit_shape=shape, unit_scale=scale,
            shape_points=np.concatenate([file.shape_points, *(points[k] for k in of)]),
            shape_offsets=ends([*np.diff(file.shape_offsets), *(len(points[k]) for k in of)]), **more,
            provenance=f"{file.provenance}; shapes as the tracker of rigidformer{with_model} completes them, by rigidformer_lab.clouds: "
            f"{look.cameras} cameras, noise {look.noise_m:g} m, at most {look.captures} captures, {self.variants} variants, "
            f"physics {self.physics}, seed {look.seed}; {np.count_nonzero(~seen)} of {len(seen)} units were not seen",
        )  # fmt: skip


def ends(counts) -> np.ndarray:
    """Offsets of lists of so many rows."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def rows_of(file: Scenes, splits: tuple[str, ...], limit: int | None) -> np.ndarray:
    """Scenes of these splits, of each split the first `limit`."""
    each = [file.scenes_of_split(SPLIT_NAMES.index(name))[:limit] for name in splits]
    return np.sort(np.concatenate(each)).astype(np.int64)


def picked(file: Scenes, rows: np.ndarray) -> Scenes:
    """These scenes of a file of rigid bodies, which may come several times."""
    units = np.concatenate([np.arange(*file.scene_units[row : row + 2]) for row in rows])
    change: dict = {"scene_units": ends(np.diff(file.scene_units)[rows])}
    for name in ("scene_seed", "scene_split", "commands", "scene_frames"):
        change[name] = None if getattr(file, name) is None else getattr(file, name)[rows]
    for name in ("unit_shape", "unit_scale", "unit_physics", "unit_poses", "unit_role", "unit_body", "unit_velocity", "unit_inertia"):
        change[name] = None if getattr(file, name) is None else getattr(file, name)[units]
    if file.planes is not None:
        planes = [np.arange(*file.scene_planes[row : row + 2]) for row in rows]
        change |= {"planes": file.planes[np.concatenate(planes)], "scene_planes": ends([len(own) for own in planes])}
    return dataclasses.replace(file, unit_soft=None, soft_points=None, **change)


def check(path: Path, file: Scenes, splits: tuple[str, ...], limit: int | None) -> int:
    """How many scenes of the file are looked at; fails where the tracker cannot follow them."""
    if file.soft_offsets[-1]:
        raise SceneFileError(path, "unit_soft", "names deformable units, which the tracker does not follow", "give scenes of rigid bodies")
    if file.bonds is not None:
        raise SceneFileError(path, "bonds", "are there, which the tracker does not know", "give scenes of bodies that are whole")
    if file.frames < 2:
        raise SceneFileError(path, "unit_poses", "has one frame, in which nothing moves", "give recorded motion")
    count = len(rows_of(file, splits, limit))
    if count == 0:
        raise SceneFileError(path, "scene_split", f"has no scene of {', '.join(splits)}", "name other splits with --splits")
    return count


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m rigidformer_lab.clouds", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)  # fmt: skip
    parser.add_argument("scenes", type=Path, help="scene file to read")
    parser.add_argument("--out", type=Path, required=True, help="scene file to make")
    parser.add_argument("--cameras", type=int, default=2, help=f"1 to {MOST_CAMERAS} (default %(default)s)")
    parser.add_argument("--noise", type=float, default=0.001, metavar="METRES",
                        help="standard deviation of depths where the units are at first, 0 to 1; grows with the square of the depth (default %(default)s)")
    parser.add_argument("--captures", type=int, default=8, help="captures that show a unit, at most (default %(default)s)")
    parser.add_argument("--variants", type=int, default=1, help="looks at each scene (default %(default)s)")
    parser.add_argument("--physics", choices=PHYSICS, default=PHYSICS[0], help="masses, frictions and restitutions as the tracker assumes them, or recorded ones (default %(default)s)")
    parser.add_argument("--model", type=Path, help="packed model that predicts for the tracker (default: units fly or lie)")
    parser.add_argument("--splits", nargs="+", choices=SPLIT_NAMES, default=["train", "validation", "extra"],
                        help="scenes that are looked at (default: all but tests)")
    parser.add_argument("--limit", type=int, help="scenes of a split, at most")
    parser.add_argument("--seed", type=int, default=0, help="default %(default)s")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (default: one a core)")
    options = parser.parse_args(arguments)
    if not 1 <= options.cameras <= MOST_CAMERAS:
        parser.error(f"--cameras takes 1 to {MOST_CAMERAS}")
    if not 0 <= options.noise <= 1:
        parser.error("--noise takes metres from 0 to 1, such as 0.001")
    for name in ("captures", "variants", "workers", *(["limit"] if options.limit is not None else [])):
        if getattr(options, name) < 1:
            parser.error(f"--{name} must be at least 1")
    if not 0 <= options.seed < 2**32:
        parser.error("--seed must lie between 0 and 2^32 - 1")
    try:
        import rigidformer  # noqa: F401
    except ImportError:
        parser.error("the runtime's Python package is missing; install it from bindings/python (`pip install ./bindings/python`)")

    signal.signal(signal.SIGTERM, _terminate)
    start = time.monotonic()
    try:
        path, splits = options.scenes.resolve(), tuple(dict.fromkeys(options.splits))
        file = read_scenes(path)
        count = check(path, file, splits, options.limit)
        look = Look(options.cameras, options.noise, options.captures, options.seed, options.model and options.model.resolve())
        if look.model is not None:
            rigidformer.Model(look.model)  # a model that cannot be read is no worker's fault
        recipe = Recipe(path, look, splits, options.limit, options.variants, options.physics, file.dataset, count * options.variants)
        scenes = generate(recipe, options.out, options.workers)
    except (CloudsError, SceneFileError, RuntimeError, OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"interrupted; the same command continues from {options.out}.parts", file=sys.stderr)
        return 130
    kept = int((scenes.unit_shape < len(file.shape_names)).sum())
    print(f"{options.out}: {scenes.scenes} scenes, {scenes.units} units, {kept} of them not seen and as recorded, "
          f"{time.monotonic() - start:.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
