"""Makes scenes: the MOVi benchmark sets as HopNet uses them, and a set of primitive shapes of the lab's own.

    python -m rigidformer_lab.movi movi-b --assets KUBASIC_FOLDER --out movi-b.safetensors

The MOVi sets reproduce the published scenes draw by draw, so the order of every random draw below matters. The work is
kept in `FILE.parts/` until the file is complete: an interrupted run continues where it stopped.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import hashlib
import json
import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import far
from .pieces import file_pieces, read_pieces
from .scenes import MOVI_SEEDS, ContactLaw, Scenes, SceneFileError, concatenate, read_scenes, split_of_seed, write_scenes

FRAME_RATE_HZ = 240
GRAVITY_M_S2 = (0.0, 0.0, -10.0)
GROUND_FRICTION = 0.3
GROUND_RESTITUTION = 0.5
#: How contacts that bounce differ from rigid ones in PyBullet with the settings below (docs/CONTACT.md).
CONTACT_LAW = ContactLaw(0.03, pyramid=True)
SEEDS_PER_SHARD = 50
PLACEMENT_TRIALS = 100
SPAWN_REGION_M = np.array([(-5, -5, 1), (5, 5, 5)], np.float32)
MATERIALS = {"metal": (0.4, 0.3, 2.7), "rubber": (0.8, 0.7, 1.1)}  # friction, restitution, density

# dataset -> (shapes, dropped leading draws, physics sub-steps a frame); the shapes in the order they are drawn from
MOVI = {
    "movi-a": (("cube", "cylinder", "sphere"), 15, 10),
    "movi-b": (("cube", "cylinder", "sphere", "cone", "torus", "gear", "torus_knot", "sponge", "spot", "teapot",
                "suzanne"), 12, 10),
    "movi-sphere": (("sphere",), 15, 5),
}
DATASETS = (*MOVI, "primitives")
PRIMITIVE_SUB_STEPS = 10
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


class AssetError(ValueError):
    """The folder of shapes cannot be used."""


@dataclass(frozen=True)
class Shape:
    """A shape at scale 1."""

    name: str
    points: np.ndarray  # (points, 3), body frame, metres
    bounds: np.ndarray  # (2, 3), lower and upper corner
    mass: float  # at density 1
    urdf: str | None = None  # MOVi
    pieces: tuple[np.ndarray, ...] = ()  # convex ones, (points, 3) each; none: the hull of the points
    size: tuple[float, ...] = ()  # primitives: box half extents, cylinder radius and height, sphere radius


# ---------------------------------------------------------------------------------------------------------------------
# Shapes


def load_movi_shapes(dataset: str, assets: Path) -> list[Shape]:
    """The data set's KuBasic shapes, from a folder with one folder per shape."""
    return [_load_kubasic(Path(assets), name) for name in MOVI[dataset][0]]


@functools.lru_cache(maxsize=None)
def _load_kubasic(assets: Path, name: str) -> Shape:
    folder = assets / name
    try:
        kwargs = json.loads((folder / "data.json").read_text())["kwargs"]
        points = [
            [float(word) for word in line.split()[1:4]]
            for line in (folder / "collision_geometry.obj").read_text().splitlines()
            if line.startswith("v ")
        ]
        urdf = folder / "object.urdf"
        urdf.read_bytes()
        pieces = tuple(read_pieces(folder / "collision_geometry.obj"))
        bounds = np.array(kwargs["bounds"], np.float64)
        mass = float(kwargs["mass"])
    except (OSError, KeyError, ValueError) as error:  # a MeshError too
        raise AssetError(f"{folder}: cannot read the KuBasic shape {name!r} ({error}); --assets takes the folder that "
                         "holds one folder per shape, each with data.json, collision_geometry.obj and object.urdf"
                         ) from error
    return Shape(name, np.array(points, np.float32), bounds, mass, urdf=str(urdf), pieces=pieces)


def primitive_shapes(sphere_points: int = 64) -> list[Shape]:
    """Boxes, cylinders and a sphere, with the body origin at the centre of mass. Nothing is read from disk."""
    shapes = []
    for name, half in (("box", (0.48, 0.48, 0.48)), ("box_slab", (0.62, 0.46, 0.22)), ("box_bar", (0.72, 0.27, 0.3))):
        grid = np.array(np.meshgrid(*[np.linspace(-1, 1, 4)] * 3, indexing="ij")).reshape(3, -1).T
        points = grid[np.abs(grid).max(axis=1) == 1] * half  # the 56 outer points of a 4 x 4 x 4 grid
        shapes.append(Shape(name, points.astype(np.float32), np.array([half, half]) * [[-1], [1]],
                            8 * half[0] * half[1] * half[2], size=half))
    for name, radius, height in (("cylinder", 0.48, 0.96), ("cylinder_disc", 0.62, 0.34)):
        rim = _ring(radius, 16)
        cap = np.concatenate([_ring(0.5 * radius, 7), [[0.0, 0.0]]])
        points = np.concatenate([
            np.column_stack([xy, np.full(len(xy), z)])
            for xy, z in ((rim, -height / 2), (cap, -height / 2), (rim, 0.0), (rim, height / 2), (cap, height / 2))
        ])
        corner = np.array([radius, radius, height / 2])
        shapes.append(Shape(name, points.astype(np.float32), np.array([-corner, corner]),
                            np.pi * radius**2 * height, size=(radius, height)))
    radius, count = 0.5, sphere_points
    index = np.arange(count)
    z = 1 - (2 * index + 1) / count
    across = np.sqrt(1 - z * z)
    points = radius * np.column_stack([across * np.cos(GOLDEN_ANGLE * index), across * np.sin(GOLDEN_ANGLE * index), z])
    shapes.append(Shape("sphere", points.astype(np.float32), np.full((2, 3), radius) * [[-1], [1]],
                        4 / 3 * np.pi * radius**3, size=(radius,)))
    return shapes


def _ring(radius: float, count: int) -> np.ndarray:
    angle = 2 * np.pi * np.arange(count) / count
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


# ---------------------------------------------------------------------------------------------------------------------
# One scene


@dataclass
class Scene:
    shape: list[int]
    scale: list[float]
    physics: list[tuple[float, float, float]]  # mass kg, friction, restitution
    poses: np.ndarray  # (units, frames, 7) float64


@dataclass(frozen=True)
class Variation:
    """Other masses and frictions than the sets have; shapes and starting motions stay."""

    mass_factor: tuple[float, float] | None = None  # each body's mass times a log-uniform factor
    friction: tuple[float, float] | None = None  # each body's friction, uniform

    def draw(self, seed: int, count: int) -> tuple[np.ndarray, np.ndarray | None]:
        """Factors of the masses and, if they vary, frictions (count,). Draws of their own: the scene's stay."""
        rng = np.random.default_rng((seed, 1))
        factors, frictions = rng.random(count), rng.random(count)
        low, high = self.mass_factor or (1.0, 1.0)
        factors = low * (high / low) ** factors
        if self.friction is None:
            return factors, None
        low, high = self.friction
        return factors, low + (high - low) * frictions


def simulate(dataset: str, shapes: list[Shape], seed: int, frames: int, floor_urdf: str | None = None,
             variation: Variation = Variation()) -> Scene:
    """One scene, drawn from `seed` alone. `floor_urdf`: the `dome` of KuBasic, for the MOVi sets."""
    import pybullet

    client = pybullet.connect(pybullet.DIRECT)
    if client < 0:
        raise RuntimeError("PyBullet refused a direct connection; too many may be open in this process")
    try:
        return _simulate(pybullet, client, dataset, shapes, seed, frames, floor_urdf, variation)
    except pybullet.error as error:
        raise RuntimeError(f"seed {seed}: PyBullet: {error}; check the shapes that --assets names") from error
    finally:
        pybullet.disconnect(client)


def _simulate(pb, client: int, dataset: str, shapes: list[Shape], seed: int, frames: int, floor_urdf,
              variation: Variation) -> Scene:
    on = {"physicsClientId": client}
    movi = dataset in MOVI
    sub_steps = MOVI[dataset][2] if movi else PRIMITIVE_SUB_STEPS
    rng = np.random.RandomState(seed)
    if movi:
        rng.rand(MOVI[dataset][1])  # lights and camera of the published scenes
    count = rng.randint(3, 11)

    pb.setPhysicsEngineParameter(restitutionVelocityThreshold=0.0, warmStartingFactor=0.0, useSplitImpulse=True,
                                 contactSlop=0.0, enableConeFriction=False, deterministicOverlappingPairs=True, **on)
    pb.setGravity(*GRAVITY_M_S2, **on)
    pb.setTimeStep(1.0 / (FRAME_RATE_HZ * sub_steps), **on)

    if movi:
        floor = pb.loadURDF(floor_urdf, useFixedBase=True, globalScaling=2.0, useMaximalCoordinates=True, **on)
    else:
        floor = pb.createMultiBody(0, pb.createCollisionShape(pb.GEOM_PLANE, **on), useMaximalCoordinates=True, **on)
    pb.changeDynamics(floor, -1, contactProcessingThreshold=0, **on)
    pb.changeDynamics(floor, -1, lateralFriction=GROUND_FRICTION, restitution=GROUND_RESTITUTION, mass=0, **on)

    bodies = [floor]
    scene = Scene([], [], [], np.empty((count, frames, 7)))
    factors, frictions = variation.draw(seed, count)
    for number in range(count):
        index = 0 if dataset == "movi-sphere" else int(rng.choice(len(shapes)))
        shape = shapes[index]
        if dataset in ("movi-a", "movi-sphere"):
            scale = {"small": 0.7, "large": 1.4}[str(rng.choice(["small", "large"]))]
            rng.choice(8)  # colour
        else:
            scale = rng.uniform(0.7, 1.4)
            if movi:
                rng.uniform()  # hue
        friction, restitution, density = MATERIALS[str(rng.choice(["metal", "rubber"]))]
        mass = shape.mass * density * scale**3 * factors[number]
        if frictions is not None:
            friction = frictions[number]

        if movi:
            body = pb.loadURDF(shape.urdf, globalScaling=scale, useMaximalCoordinates=True, **on)
        else:
            body = pb.createMultiBody(mass, _primitive_collision(pb, shape, scale, on), useMaximalCoordinates=True,
                                      **on)
        pb.changeDynamics(body, -1, contactProcessingThreshold=0, **on)
        pb.changeDynamics(body, -1, lateralFriction=friction, restitution=restitution, mass=mass, **on)

        position, quaternion = _place(pb, rng, body, bodies, shape.bounds * scale, seed, on)
        velocity = rng.uniform((-4, -4, 0), (4, 4, 0)) - [position[0], position[1], 0]
        pb.resetBaseVelocity(body, velocity, (0, 0, 0), **on)

        bodies.append(body)
        scene.shape.append(index)
        scene.scale.append(scale)
        scene.physics.append((mass, friction, restitution))

    for frame in range(frames):
        for unit, body in enumerate(bodies[1:]):
            position, (x, y, z, w) = pb.getBasePositionAndOrientation(body, **on)
            scene.poses[unit, frame] = (*position, w, x, y, z)
        if frame + 1 < frames:
            for _ in range(sub_steps):
                pb.stepSimulation(**on)

    quaternions = scene.poses[:, :, 3:]
    quaternions /= np.linalg.norm(quaternions, axis=-1, keepdims=True)
    flips = np.einsum("ufk,ufk->uf", quaternions[:, 1:], quaternions[:, :-1]) < 0
    quaternions[:, 1:] *= np.where(np.cumsum(flips, axis=1) % 2, -1.0, 1.0)[:, :, None]
    return scene


def _place(pb, rng, body: int, others: list[int], bounds: np.ndarray, seed: int, on: dict):
    """Draws poses until the body overlaps nothing; returns position and quaternion (w, x, y, z)."""
    corners = np.array([(bounds[i, 0], bounds[j, 1], bounds[k, 2])
                        for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    for _ in range(PLACEMENT_TRIALS):
        r1, r2, r3 = rng.random_sample(3)
        w, x = np.sqrt(1.0 - r1) * np.sin(2 * np.pi * r2), np.sqrt(1.0 - r1) * np.cos(2 * np.pi * r2)
        y, z = np.sqrt(r1) * np.sin(2 * np.pi * r3), np.sqrt(r1) * np.cos(2 * np.pi * r3)
        rotated = corners @ _rotation(w, x, y, z).T
        low, high = SPAWN_REGION_M - np.array([rotated.min(axis=0), rotated.max(axis=0)])
        position = rng.uniform(low, high)
        pb.resetBasePositionAndOrientation(body, position, (x, y, z, w), **on)
        if not any(pb.getClosestPoints(body, other, distance=0, **on) for other in others):
            return position, (w, x, y, z)
    raise RuntimeError(f"seed {seed}: no free place for an object in {PLACEMENT_TRIALS} trials; leave the seed out")


def _rotation(w: float, x: float, y: float, z: float) -> np.ndarray:
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])


def _primitive_collision(pb, shape: Shape, scale: float, on: dict) -> int:
    size = [scale * length for length in shape.size]
    if len(size) == 3:
        return pb.createCollisionShape(pb.GEOM_BOX, halfExtents=size, **on)
    if len(size) == 2:
        return pb.createCollisionShape(pb.GEOM_CYLINDER, radius=size[0], height=size[1], **on)
    return pb.createCollisionShape(pb.GEOM_SPHERE, radius=size[0], **on)


# ---------------------------------------------------------------------------------------------------------------------
# A file of scenes


def shards_of(first_seed: int, seeds: int) -> list[range]:
    """The parts that a run of so many seeds is made in."""
    end = first_seed + seeds
    return [range(seed, min(seed + SEEDS_PER_SHARD, end)) for seed in range(first_seed, end, SEEDS_PER_SHARD)]


@dataclass(frozen=True)
class Recipe:
    """What a run makes; every shard of a run is made from the same recipe."""

    dataset: str
    first_seed: int
    seeds: int
    frames: int
    assets: Path | None
    variation: Variation = Variation()

    @property
    def name(self) -> str:
        """What the file calls the set: nobody is to take varied scenes for the published ones."""
        return self.dataset if self.variation == Variation() else f"{self.dataset}-varied"

    def load_shapes(self) -> list[Shape]:
        if self.dataset == "primitives":
            return primitive_shapes()
        return load_movi_shapes(self.dataset, self.assets)

    @property
    def floor_urdf(self) -> str | None:
        return None if self.dataset == "primitives" else str(self.assets / "dome" / "object.urdf")

    def shards(self) -> list[range]:
        return shards_of(self.first_seed, self.seeds)

    def make(self, seeds: range) -> Scenes:
        return make_scenes(self, seeds)

    def description(self) -> dict:
        """What has to agree before a run may continue from existing shards."""
        digest = hashlib.sha256()
        for shape in self.load_shapes():
            digest.update(f"{shape.name} {shape.mass} {shape.bounds.tolist()} {shape.size}".encode())
            digest.update(shape.points.tobytes())
            for piece in shape.pieces:
                digest.update(piece.tobytes())
            if shape.urdf:
                digest.update(Path(shape.urdf).read_bytes())
        if self.floor_urdf:
            for path in (Path(self.floor_urdf), Path(self.floor_urdf).with_name("collision_geometry.obj")):
                try:
                    digest.update(path.read_bytes())
                except OSError as error:
                    raise AssetError(f"{path}: cannot read the floor ({error.strerror}); --assets takes the folder "
                                     "that holds `dome` and one folder per shape") from error
        description = {"dataset": self.dataset, "first_seed": self.first_seed, "seeds": self.seeds,
                       "frames": self.frames, "shapes_sha256": digest.hexdigest()}
        if self.variation != Variation():
            description["variation"] = dataclasses.asdict(self.variation)
        return description


def make_scenes(recipe: Recipe, seeds: range) -> Scenes:
    """Simulates `seeds` one after the other."""
    shapes = recipe.load_shapes()
    made = [simulate(recipe.dataset, shapes, seed, recipe.frames, recipe.floor_urdf, recipe.variation)
            for seed in seeds]
    if recipe.dataset == "primitives":
        provenance = "Generated by rigidformer_lab.movi with PyBullet 3.2.7; shapes of the lab's own, no assets used."
        licence = "the licence of the rigidformer project"
    else:
        provenance = (f"Generated by rigidformer_lab.movi with PyBullet 3.2.7 after the {recipe.dataset} recipe of "
                      "Kubric and HopNet, with the KuBasic shapes of Kubric's public assets; shape_points are the "
                      "vertices of their collision meshes, unchanged.")
        licence = "CC BY-SA 4.0 (KuBasic shapes and what is derived from them)"
    if recipe.variation.mass_factor:
        provenance += " Masses times log-uniform factors of {:g} to {:g}.".format(*recipe.variation.mass_factor)
    if recipe.variation.friction:
        provenance += " Frictions drawn from {:g} to {:g}.".format(*recipe.variation.friction)
    return Scenes(
        dataset=recipe.name,
        shape_names=[shape.name for shape in shapes],
        shape_points=np.concatenate([shape.points for shape in shapes]),
        shape_offsets=_offsets([len(shape.points) for shape in shapes]),
        **file_pieces([shape.pieces for shape in shapes]),
        scene_seed=np.array(seeds, np.int64),
        scene_split=np.array([split_of_seed(recipe.dataset, seed) for seed in seeds], np.uint8),
        scene_units=_offsets([len(scene.shape) for scene in made]),
        unit_shape=np.concatenate([scene.shape for scene in made]).astype(np.int32),
        unit_scale=np.concatenate([scene.scale for scene in made]).astype(np.float32),
        unit_physics=np.concatenate([scene.physics for scene in made]).astype(np.float32),
        unit_poses=np.concatenate([scene.poses for scene in made]).astype(np.float32),
        provenance=provenance,
        licence=licence,
        frame_rate_hz=FRAME_RATE_HZ,
        gravity_m_s2=GRAVITY_M_S2,
        contact_law=CONTACT_LAW,
        ground_friction=GROUND_FRICTION,
        ground_restitution=GROUND_RESTITUTION,
    )


def _offsets(counts: list[int]) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def generate(recipe, out: Path, workers: int, dask: str | None = None) -> Scenes:
    """Makes the file `out`, continuing from the shards of an interrupted run. recipe: a `Recipe`, or what has its `name`,
    `dataset`, `seeds`, `frames`, `shards`, `description` and `make`; with a `join` that makes one data set of the shards. dask: the address of a scheduler
    whose workers make the shards, instead of so many processes here."""
    parts = out.with_name(out.name + ".parts")
    description = recipe.description()
    open_parts(parts, description)
    missing = [seeds for seeds in recipe.shards() if not _shard_path(parts, seeds).exists()]
    done = recipe.seeds - sum(len(seeds) for seeds in missing)
    progress = _Progress(recipe.dataset, recipe.seeds, done)
    if missing and dask:
        jobs = [(recipe, seeds) for seeds in missing]
        for index, shard in far.results(dask, _shard_bytes, jobs, description):
            write_bytes(_shard_path(parts, missing[index]), shard)
            progress.add(len(missing[index]))
    elif missing:
        context = multiprocessing.get_context("spawn")
        with context.Pool(min(workers, len(missing)), initializer=_start_worker) as pool:
            for count in pool.imap_unordered(_make_shard, [(recipe, seeds, parts) for seeds in missing]):
                progress.add(count)
    progress.close()

    shards = []
    for seeds in recipe.shards():
        path = _shard_path(parts, seeds)
        shard = read_scenes(path)
        if shard.dataset != recipe.name or shard.frames != recipe.frames or list(shard.scene_seed) != list(seeds):
            raise SceneFileError(path, "scene_seed", "the shard holds other scenes than its name says",
                                 f"remove {parts} and start again")
        shards.append(shard)
    scenes = getattr(recipe, "join", concatenate)(shards)
    write_scenes(out, scenes)
    shutil.rmtree(parts)
    return scenes


def _shard_path(parts: Path, seeds: range) -> Path:
    return parts / f"seeds-{seeds[0]:07d}-{seeds[-1]:07d}.safetensors"


def open_parts(parts: Path, description: dict) -> None:
    parts.mkdir(parents=True, exist_ok=True)
    note = parts / "recipe.json"
    text = json.dumps(description, indent=1) + "\n"
    if note.exists():
        if note.read_text() != text:
            raise SceneFileError(note, "recipe", "an interrupted run with other arguments or shapes lies here",
                                 f"finish it with those, or remove {parts}")
    else:
        write_text(note, text)
    for leftover in parts.glob(".seeds-*.tmp"):  # half-written shards of a run that was killed
        leftover.unlink()


def _start_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    null, stderr = os.open(os.devnull, os.O_WRONLY), os.dup(2)
    os.dup2(null, 1)  # PyBullet's remarks on URDFs
    os.dup2(null, 2)  # its banner, printed on import
    try:
        import pybullet  # noqa: F401
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(null)

    def leave_with_parent():
        multiprocessing.parent_process().join()
        os._exit(1)

    threading.Thread(target=leave_with_parent, daemon=True).start()


def _make_shard(job: tuple[Recipe, range, Path]) -> int:
    recipe, seeds, parts = job
    write_scenes(_shard_path(parts, seeds), recipe.make(seeds))
    return len(seeds)


def write_text(path: Path, text: str) -> None:
    """Writes a file under a temporary name, then renames it."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, data: bytes) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    temporary.write_bytes(data)
    os.replace(temporary, path)


def _shard_bytes(description: dict, job: tuple[Recipe, range]) -> bytes:
    """A shard as a file has it, made on another machine."""
    recipe, seeds = job
    if recipe.description() != description:
        raise RuntimeError("a worker of --dask reads other assets than this machine; give it the same ones, at the same path")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shard"
        write_scenes(path, recipe.make(seeds))
        return path.read_bytes()


class _Progress:
    """A bar on a terminal, otherwise a line at most every 30 seconds."""

    LINE_EVERY_S = 30.0

    def __init__(self, name: str, total: int, done: int):
        self.name, self.total, self.done, self.bar = name, total, done, None
        self.start = self.last = time.monotonic()
        if sys.stderr.isatty():
            from tqdm import tqdm

            self.bar = tqdm(total=total, initial=done, desc=name, unit="scene")
        elif done:
            print(f"{name}: continuing after {done} of {total} scenes", file=sys.stderr, flush=True)

    def add(self, count: int) -> None:
        self.done += count
        if self.bar is not None:
            self.bar.update(count)
        elif time.monotonic() - self.last >= self.LINE_EVERY_S:
            self.last = time.monotonic()
            print(f"{self.name}: {self.done} of {self.total} scenes, {self.last - self.start:.0f} s", file=sys.stderr,
                  flush=True)

    def close(self) -> None:
        if self.bar is not None:
            self.bar.close()


def _terminate(signum, frame):
    raise KeyboardInterrupt


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m rigidformer_lab.movi", description=__doc__.splitlines()[0])
    parser.add_argument("dataset", choices=DATASETS)
    parser.add_argument("--assets", type=Path, help="folder of the KuBasic shapes and `dome`, from Kubric's public "
                        "assets (MOVi sets only)")
    parser.add_argument("--out", type=Path, required=True, help="scene file to make")
    parser.add_argument("--seeds", type=int, default=MOVI_SEEDS, help="number of scenes (default %(default)s)")
    parser.add_argument("--first-seed", type=int, default=1, help=f"default %(default)s; MOVi seeds beyond "
                        f"{MOVI_SEEDS} are extra")
    parser.add_argument("--frames", type=int, default=480, help="frames a scene at 240 Hz (default %(default)s)")
    parser.add_argument("--mass-factor", type=float, nargs=2, metavar=("LOW", "HIGH"),
                        help="multiply each body's mass by a log-uniform factor")
    parser.add_argument("--friction", type=float, nargs=2, metavar=("LOW", "HIGH"),
                        help="draw each body's friction anew, uniformly")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (default: one a core)")
    far.add_argument(parser)
    options = parser.parse_args(arguments)
    for name in ("seeds", "frames", "workers"):
        if getattr(options, name) < 1:
            parser.error(f"--{name} must be at least 1")
    if options.mass_factor and not 1e-6 <= options.mass_factor[0] <= options.mass_factor[1] <= 1e6:
        parser.error("--mass-factor takes two numbers from 1e-6 to 1e6, the lower one first")
    if options.friction and not 0 <= options.friction[0] <= options.friction[1] <= 1000:
        parser.error("--friction takes two numbers from 0 to 1000, the lower one first")
    last_seed = options.first_seed + options.seeds - 1
    if options.first_seed < 0 or last_seed >= 2**32:
        parser.error("seeds must lie between 0 and 2^32 - 1")
    if options.dataset == "primitives":
        if options.assets is not None:
            parser.error("primitives take no --assets")
    elif options.assets is None:
        parser.error(f"{options.dataset} needs --assets, the folder of the KuBasic shapes (Kubric's public assets)")

    recipe = Recipe(options.dataset, options.first_seed, options.seeds, options.frames,
                    options.assets and options.assets.resolve(),
                    Variation(options.mass_factor and tuple(options.mass_factor),
                              options.friction and tuple(options.friction)))
    signal.signal(signal.SIGTERM, _terminate)
    start = time.monotonic()
    try:
        scenes = generate(recipe, options.out, options.workers, options.dask)
    except (AssetError, SceneFileError, RuntimeError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"interrupted; the same command continues from {options.out}.parts", file=sys.stderr)
        return 130
    print(f"{options.out}: {scenes.scenes} scenes, {scenes.units} units, {scenes.frames} frames, "
          f"{options.out.stat().st_size} bytes, {time.monotonic() - start:.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
