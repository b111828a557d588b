"""Makes scenes of contact that lasts: bodies that lie, slide, roll, lean, are stacked, pushed or heaped.

    python -m rigidformer_lab.contacts --seeds 500 --out contacts.safetensors
    python -m rigidformer_lab.contacts --seeds 500 --size 0.05 --out contacts-small.safetensors

The seed draws a kind of scene and all that is in it:

table   bodies come down on a fixed box and may slide off it
ramp    bodies on a slope of 5 to 35 degrees that ends at level ground
wall    bodies slide along the ground into a wall
steps   bodies come down a stair of three fixed boxes
stack   bodies on top of each other, not quite in line; some stacks are hit
slide   flat bodies slide and spin on the ground
roll    spheres and cylinders roll, some with slip
pusher  a driven box goes there and back among bodies on the ground
heap    bodies fall into a heap; a ball is thrown into some heaps
toss    one or two bodies, most of them cubes and some of them hollow, are thrown onto smooth, dull ground

Frictions are drawn from 0 to 1 and restitutions from 0 to 0.8, of each body and of the planes; in a contact the product of
two counts. Densities are drawn from 100 to 8,000 kg/m3 a scene, times 0.5 to 2 a body.

Radii are drawn from half the size to twice the size, so within a factor of 4 in a file. Frames a second go with the size, so
that a frame is always the same part of sqrt(size / g): 240 at 0.6 m, 588 at 0.1 m. Under gravity, dry friction and
restitution a scene of another size is the same motion, slower or faster; so all are simulated at 0.6 m, where the engine is
accurate, and then scaled. The same seed in another size is the same scene, scaled.

Shapes are those of `movi primitives`, the sphere with more points; no assets are needed. A tenth of the seeds is for tests, a tenth for validation. An
interrupted run continues where it stopped.
"""

from __future__ import annotations

import argparse
import hashlib
import math
import os
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import bullet, far, mujoco_engine, pushing
from .movi import FRAME_RATE_HZ, GRAVITY_M_S2, PRIMITIVE_SUB_STEPS, Shape, _offsets, _rotation, primitive_shapes
from .pushing import Body, Part, Swing, _about_z, _create, _quaternion
from .roles import DRIVEN, FIXED, FREE
from .scenes import EXTRA, ContactLaw, Scenes, split_of_seed

DATASET = "contacts"
KINDS = ("table", "ramp", "wall", "steps", "stack", "slide", "roll", "pusher", "heap", "toss")
ENGINES = {"bullet": "PyBullet 3.2.7", "mujoco": "MuJoCo 4.0.0"}
BALL_POINTS = 160  # with so many the solver takes a sphere for a ball
REFERENCE_M = 0.6  # the size at which scenes are simulated
SIZES_M = (0.02, 1.0)  # that --size may be: radii of 1 cm to 2 m
RADIUS = (0.5, 2.0)  # of the size
FRICTION, RESTITUTION = (0.0, 1.0), (0.0, 0.8)
DENSITY, DENSITY_FACTOR = (100.0, 8000.0), (0.5, 2.0)
CLEARANCE_M = 0.004
PLACEMENT_TRIALS = 300
UPRIGHT = np.eye(3)
LYING = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])  # about x by a quarter turn


def rate_of(size: float) -> float:
    """Frames a second of scenes of a size."""
    return FRAME_RATE_HZ * math.sqrt(REFERENCE_M / size)


def _log_uniform(rng, low: float, high: float) -> float:
    return low * (high / low) ** rng.random()


class Stage:
    """A scene that is being set up, at the reference size."""

    def __init__(self, pb, on: dict, rng, shapes: list[Shape]):
        self.pb, self.on, self.rng, self.shapes = pb, on, rng, shapes
        self.bodies: list[Body] = []
        self.planes: list[tuple[float, ...]] = []
        self.path: Swing | None = None
        self.density = _log_uniform(rng, *DENSITY)

    def material(self) -> tuple[float, float]:
        """Friction and restitution."""
        return self.rng.uniform(*FRICTION), self.rng.uniform(*RESTITUTION)

    def plane(self, normal, offset: float) -> None:
        normal = np.asarray(normal, float) / np.linalg.norm(normal)
        self.planes.append((*normal, offset, *self.material()))
        bullet.add_plane(self.pb, self.on, self.planes[-1])

    def index(self, name: str) -> int:
        return next(k for k, shape in enumerate(self.shapes) if shape.name == name)

    def body(self, names=None, radius=RADIUS, role: int = FREE) -> Body:
        """A body of one of some shapes, all by default, of a radius drawn in sizes; not yet anywhere."""
        shape = self.index(str(self.rng.choice(names))) if names else int(self.rng.integers(len(self.shapes)))
        known = self.shapes[shape]
        scale = REFERENCE_M * _log_uniform(self.rng, *radius) / float(np.linalg.norm(known.points, axis=1).max())
        mass = known.mass * scale**3 * self.density * _log_uniform(self.rng, *DENSITY_FACTOR)
        return Body([Part(shape, scale, mass, np.zeros(3))], role, *self.material())

    def half(self, body: Body) -> np.ndarray:
        """(3) half the extent of a body along its axes."""
        part = body.parts[0]
        return part.scale * self.shapes[part.shape].bounds[1]

    def put(self, body: Body, place, turn: np.ndarray) -> None:
        """Adds a body at a place, turned by a matrix."""
        body.place, body.turn = np.asarray(place, float), _quaternion(turn)
        _create(self.pb, self.on, self.shapes, body)
        self.bodies.append(body)

    def somewhere(self, body: Body, draw) -> bool:
        """Adds a body at the first drawn place and turn where it touches nothing; False, and no body, where none is free."""
        pb, on = self.pb, self.on
        others = [pb.getBodyUniqueId(k, **on) for k in range(pb.getNumBodies(**on))]
        body.place, body.turn = np.array([0.0, 0.0, 90.0]), np.array([1.0, 0, 0, 0])
        _create(pb, on, self.shapes, body)
        for _ in range(PLACEMENT_TRIALS):
            place, turn = draw()
            body.place, body.turn = np.asarray(place, float), _quaternion(turn)
            w, x, y, z = body.turn
            pb.resetBasePositionAndOrientation(body.number, body.place, (x, y, z, w), **on)
            if not any(pb.getClosestPoints(body.number, other, distance=CLEARANCE_M, **on) for other in others):
                self.bodies.append(body)
                return True
        pb.removeBody(body.number, **on)
        return False

    def move(self, body: Body, velocity, spin=(0, 0, 0)) -> None:
        self.pb.resetBaseVelocity(body.number, list(velocity), list(spin), **self.on)

    def any_turn(self) -> np.ndarray:
        turn = self.rng.normal(size=4)
        return _rotation(*(turn / np.linalg.norm(turn)))

    def about_z(self) -> np.ndarray:
        return _about_z(self.rng.uniform(0, 2 * np.pi))

    def resting(self, body: Body, spread: float, turned=UPRIGHT, above: float = 0.0):
        """Draws places of a body that lies on the ground, or on a level above it."""
        height = above + float(np.abs(turned[2]) @ self.half(body)) + 1.5 * CLEARANCE_M
        return lambda: ((*self.rng.uniform(-spread, spread, 2), height), self.about_z() @ turned)

    def flat_velocity(self, low: float, high: float) -> np.ndarray:
        angle = self.rng.uniform(0, 2 * np.pi)
        return self.rng.uniform(low, high) * np.array([np.cos(angle), np.sin(angle), 0.0])


FLAT = ("box", "box_slab", "box_bar", "cylinder", "cylinder_disc")
ROUND = ("sphere", "cylinder", "cylinder_disc")


def _some(stage: Stage, low: int, high: int) -> range:
    return range(int(stage.rng.integers(low, high + 1)))


def _ground(stage: Stage) -> None:
    stage.plane((0, 0, 1), 0.0)


def _table(stage: Stage) -> None:
    _ground(stage)
    table = stage.body(("box_slab",), (3.0, 5.0), FIXED)
    half = stage.half(table)
    stage.put(table, (0, 0, half[2]), stage.about_z())
    reach = 0.6 * half[:2].min()
    for _ in _some(stage, 2, 5):
        body = stage.body(radius=(0.5, 1.2))
        if stage.rng.random() < 0.5 and stage.shapes[body.parts[0].shape].name in FLAT:
            placed = stage.somewhere(body, stage.resting(body, reach, above=2 * half[2]))
            speed = (0.0, 3.0)
        else:
            rise = 2 * half[2] + stage.rng.uniform(0.8, 2.0)
            placed = stage.somewhere(body, lambda: ((*stage.rng.uniform(-reach, reach, 2), rise), stage.any_turn()))
            speed = (0.0, 1.5)
        if placed:
            stage.move(body, stage.flat_velocity(*speed))


def _ramp(stage: Stage) -> None:
    slope = np.radians(stage.rng.uniform(5, 35))
    heading = stage.about_z()
    _ground(stage)
    stage.plane(heading @ (np.sin(slope), 0, np.cos(slope)), 0.0)  # falls towards +x of the heading, to z = 0
    tilt = heading @ np.array([[np.cos(slope), 0, np.sin(slope)], [0, 1, 0], [-np.sin(slope), 0, np.cos(slope)]])
    for _ in _some(stage, 2, 4):
        body = stage.body(radius=(0.5, 1.3))
        flat = stage.shapes[body.parts[0].shape].name in FLAT and stage.rng.random() < 0.7
        half = stage.half(body)[2] if flat else REFERENCE_M * RADIUS[1]

        def draw():
            along, across = stage.rng.uniform(-6.0, -1.5), stage.rng.uniform(-2, 2)
            turn = stage.about_z() if flat else stage.any_turn()
            return tilt @ (along, across, half + 2 * CLEARANCE_M), tilt @ turn
        if stage.somewhere(body, draw):
            stage.move(body, tilt @ stage.flat_velocity(0.0, 2.0))


def _wall(stage: Stage) -> None:
    _ground(stage)
    heading = stage.about_z()
    stage.plane(-heading[:, 0], -2.5)
    for _ in _some(stage, 2, 4):
        body = stage.body(FLAT + ("sphere",), (0.5, 1.3))
        turned = LYING if stage.shapes[body.parts[0].shape].name == "cylinder" and stage.rng.random() < 0.5 else UPRIGHT
        if stage.somewhere(body, stage.resting(body, 2.0, turned)):
            side = heading[:, 1] * stage.rng.uniform(-1.5, 1.5)
            stage.move(body, heading[:, 0] * stage.rng.uniform(1.0, 6.0) + side, (0, 0, stage.rng.uniform(-2, 2)))


def _steps(stage: Stage) -> None:
    _ground(stage)
    rise, heading = stage.rng.uniform(0.15, 0.35), stage.about_z()
    top = None
    for step in range(3):
        block = stage.body(("box",), (2.0, 2.0), FIXED)
        half = stage.half(block)[0]
        stage.put(block, heading @ ((step - 1) * 2 * half, 0, (3 - step) * rise - half), heading)
        top = top or (-2 * half, half)
    for _ in _some(stage, 1, 3):
        body = stage.body(radius=(0.5, 1.0))

        def draw():
            place = (top[0] + stage.rng.uniform(-0.6, 0.8) * top[1], stage.rng.uniform(-0.6, 0.6) * top[1],
                     3 * rise + stage.rng.uniform(0.4, 1.2))
            return heading @ place, stage.any_turn()
        if stage.somewhere(body, draw):
            velocity = heading @ (stage.rng.uniform(1.0, 3.0), stage.rng.uniform(-0.3, 0.3), 0)
            stage.move(body, velocity, stage.rng.uniform(-3, 3, 3))


def _stack(stage: Stage) -> None:
    _ground(stage)
    height, place, radius = CLEARANCE_M, np.zeros(2), _log_uniform(stage.rng, 0.6, 1.6)
    for _ in _some(stage, 2, 5):
        body = stage.body(FLAT, (radius / 1.2, min(radius * 1.2, RADIUS[1])))
        half = stage.half(body)
        stage.put(body, (*place, height + half[2]), stage.about_z())
        height += 2 * half[2] + CLEARANCE_M
        place = place + stage.rng.uniform(-0.35, 0.35, 2) * half[:2].min()
    if stage.rng.random() < 0.3:
        ball, angle = stage.body(("sphere",), (0.5, 1.0)), stage.rng.uniform(0, 2 * np.pi)
        away = np.array([np.cos(angle), np.sin(angle)])
        centre = (*(4.0 * away), max(stage.half(ball)[2] + 0.05, stage.rng.uniform(0.2, 1.0) * height))
        stage.put(ball, centre, UPRIGHT)
        stage.move(ball, (*(-stage.rng.uniform(3.0, 8.0) * away), 1.0))


def _slide(stage: Stage) -> None:
    _ground(stage)
    for _ in _some(stage, 2, 4):
        body = stage.body(FLAT)
        if stage.somewhere(body, stage.resting(body, 2.5)):
            stage.move(body, stage.flat_velocity(0.0, 6.0), (0, 0, stage.rng.uniform(-5, 5)))


def _roll(stage: Stage) -> None:
    _ground(stage)
    for _ in _some(stage, 2, 4):
        body = stage.body(ROUND, (0.5, 1.6))
        sphere = stage.shapes[body.parts[0].shape].name == "sphere"
        if stage.somewhere(body, stage.resting(body, 2.5, UPRIGHT if sphere else LYING)):
            velocity = stage.flat_velocity(0.5, 5.0)
            if not sphere:  # across its axis
                axis = _rotation(*body.turn)[:, 2]
                velocity = np.cross(axis, (0, 0, 1)) * np.linalg.norm(velocity)
            radius = stage.half(body)[0]
            roll = np.cross((0, 0, 1), velocity) / radius
            stage.move(body, velocity, roll * stage.rng.choice([1.0, stage.rng.uniform(0, 1.5)]))


def _pusher(stage: Stage) -> None:
    _ground(stage)
    stage.path = Swing(stage.rng, np.eye(3))
    pusher = Body([Part(stage.index("box"), stage.path.scale, pushing.PUSHER_MASS_KG, np.zeros(3))], DRIVEN,
                  *stage.material())
    pusher.place, pusher.turn = stage.path.at(0.0)
    _create(stage.pb, stage.on, stage.shapes, pusher)
    stage.bodies.append(pusher)
    for _ in _some(stage, 2, 4):
        body = stage.body(FLAT + ("sphere",), (0.5, 0.9))
        resting = stage.resting(body, 1.0)

        def in_the_way():
            (_, _, height), turn = resting()
            along, across = stage.rng.uniform(-0.4, 0.8), stage.rng.uniform(-0.35, 0.35)
            return stage.path.way * along + stage.path.across * across + (0, 0, height), turn
        stage.somewhere(body, in_the_way)


def _heap(stage: Stage) -> None:
    _ground(stage)
    for _ in _some(stage, 5, 10):
        body = stage.body(radius=(0.5, 1.0))
        stage.somewhere(body, lambda: ((*stage.rng.uniform(-0.8, 0.8, 2), stage.rng.uniform(0.5, 4.0)), stage.any_turn()))
    if stage.rng.random() < 0.3:
        ball = stage.body(("sphere",), (0.8, 1.5))
        radius = stage.half(ball)[2]
        stage.put(ball, (-5.0, stage.rng.uniform(-0.5, 0.5), stage.rng.uniform(radius + 0.05, 2.0)), UPRIGHT)
        stage.move(ball, (stage.rng.uniform(5.0, 12.0), 0, 0))


def _toss(stage: Stage) -> None:
    """Of a contact: friction .05 to .5, restitution 0 to .4."""
    friction, restitution = stage.rng.uniform(0.05, 0.5), stage.rng.uniform(0.0, 0.4)
    stage.planes.append((0, 0, 1, 0, math.sqrt(friction), math.sqrt(restitution)))
    bullet.add_plane(stage.pb, stage.on, stage.planes[-1])
    for _ in _some(stage, 1, 2):
        body = stage.body(("box",) if stage.rng.random() < 0.7 else None)
        body.friction, body.restitution = math.sqrt(friction), math.sqrt(restitution)
        body.hollow = stage.rng.uniform(0.8, 1.5) if stage.rng.random() < 0.7 else 1.0
        reach = REFERENCE_M * RADIUS[1]

        def draw():
            rise = reach * stage.rng.uniform(0.6, 1.5)
            return (*stage.rng.uniform(-1.5, 1.5, 2), rise), stage.any_turn()
        if stage.somewhere(body, draw):
            velocity = stage.flat_velocity(0.0, 5.0) + (0, 0, stage.rng.uniform(-1.5, 1.0))
            stage.move(body, velocity, stage.rng.normal(size=3) * 2.0)


MAKERS = {"table": _table, "ramp": _ramp, "wall": _wall, "steps": _steps, "stack": _stack, "slide": _slide, "roll": _roll,
          "pusher": _pusher, "heap": _heap, "toss": _toss}


def simulate(shapes: list[Shape], seed: int, frames: int, kinds=KINDS, engine="bullet") -> tuple[str, Stage, np.ndarray]:
    """Kind, contents and poses, (units, frames, 7), of a scene at the reference size, drawn from `seed` alone; engine: `ENGINES`."""
    rng = np.random.default_rng((seed, 78))
    kind = kinds[int(rng.integers(len(kinds)))]
    step = 1.0 / (FRAME_RATE_HZ * PRIMITIVE_SUB_STEPS)
    with bullet.engine(GRAVITY_M_S2, step) as (pb, on):
        stage = Stage(pb, on, rng, shapes)
        MAKERS[kind](stage)
        if not any(body.role == FREE for body in stage.bodies):
            raise RuntimeError(f"seed {seed}: no free place for any body; leave the seed out")
        if engine == "mujoco":
            poses = mujoco_engine.record(shapes, stage, frames)
            return kind, stage, _kept(stage, poses)
        poses = np.empty((len(stage.bodies), frames, 7))
        driven = [body for body in stage.bodies if body.role == DRIVEN]
        for frame in range(frames):
            for unit, body in enumerate(stage.bodies):
                poses[unit, frame] = bullet.pose_of(pb, on, body.number)
                if body.role == DRIVEN:  # exactly on its path
                    place, turn = stage.path.at(frame / FRAME_RATE_HZ)
                    poses[unit, frame] = (*place, *turn)
            for sub in range(PRIMITIVE_SUB_STEPS if frame + 1 < frames else 0):
                now = frame / FRAME_RATE_HZ + sub * step
                for body in driven:
                    place, (w, x, y, z) = stage.path.at(now)
                    after, _ = stage.path.at(now + step)
                    # The velocity is what contacts see of a body without mass.
                    pb.resetBasePositionAndOrientation(body.number, place, (x, y, z, w), **on)
                    pb.resetBaseVelocity(body.number, (after - place) / step, stage.path.spin(now), **on)
                pb.stepSimulation(**on)
    return kind, stage, _kept(stage, poses)


def _kept(stage: Stage, poses: np.ndarray) -> np.ndarray:
    """Poses with steady signs; what is fixed stays, to the bit."""
    bullet.steady_signs(poses)
    for unit, body in enumerate(stage.bodies):
        if body.role == FIXED:
            poses[unit] = poses[unit, 0]
    return poses


@dataclass(frozen=True)
class Recipe:
    """What a run makes; see `movi.Recipe`."""

    first_seed: int
    seeds: int
    frames: int
    size: float = 0.1
    kinds: tuple[str, ...] = KINDS
    engine: str = "bullet"

    @property
    def dataset(self) -> str:
        return DATASET if self.engine == "bullet" else f"{DATASET}-{self.engine}"

    name = dataset

    def shards(self) -> list[range]:
        return pushing.shards_of(self.first_seed, self.seeds)

    def description(self) -> dict:
        """What has to agree before a run may continue from existing shards."""
        digest = hashlib.sha256()
        for module in (__file__, bullet.__file__, pushing.__file__, mujoco_engine.__file__):
            digest.update(Path(module).read_bytes())
        for shape in primitive_shapes(BALL_POINTS):
            digest.update(f"{shape.name} {shape.mass} {shape.size}".encode() + shape.points.tobytes())
        return {"dataset": self.dataset, "first_seed": self.first_seed, "seeds": self.seeds, "frames": self.frames,
                "size": self.size, "kinds": list(self.kinds), "code_and_shapes_sha256": digest.hexdigest()}

    def make(self, seeds: range) -> Scenes:
        """Simulates `seeds` one after the other."""
        shapes = primitive_shapes(BALL_POINTS)
        made = [simulate(shapes, seed, self.frames, self.kinds, self.engine)[1:] for seed in seeds]
        times = self.size / REFERENCE_M
        every = [(body, body.parts[0]) for stage, _ in made for body in stage.bodies]
        poses = np.concatenate([poses for _, poses in made])
        poses[:, :, :3] *= times
        planes = np.array([plane for stage, _ in made for plane in stage.planes])
        planes[:, 3] *= times
        inertia = np.array([body.inertia for body, _ in every]) * times**5
        return Scenes(
            dataset=self.dataset,
            shape_names=[shape.name for shape in shapes],
            shape_points=np.concatenate([shape.points for shape in shapes]),
            shape_offsets=_offsets([len(shape.points) for shape in shapes]),
            scene_seed=np.array(seeds, np.int64),
            # Of another engine all are extra: no set has splits of them.
            scene_split=np.array([split_of_seed("primitives", seed) if self.engine == "bullet" else EXTRA for seed in seeds], np.uint8),
            scene_units=_offsets([len(stage.bodies) for stage, _ in made]),
            unit_shape=np.array([part.shape for _, part in every], np.int32),
            unit_scale=np.array([part.scale * times for _, part in every], np.float32),
            unit_physics=np.array([(part.mass * times**3, body.friction, body.restitution) for body, part in every],
                                  np.float32),
            unit_poses=poses.astype(np.float32),
            provenance=f"Generated by rigidformer_lab.contacts with {ENGINES[self.engine]}, kinds {', '.join(self.kinds)}, size "
                       f"{self.size:g} m; shapes of the lab's own, no assets used.",
            licence="the licence of the rigidformer project",
            frame_rate_hz=rate_of(self.size),
            gravity_m_s2=GRAVITY_M_S2,
            contact_law=bullet.CONTACT_LAW if self.engine == "bullet" else ContactLaw(),
            ground_friction=None,
            ground_restitution=None,
            planes=planes.astype(np.float32),
            scene_planes=_offsets([len(stage.planes) for stage, _ in made]),
            unit_role=np.array([body.role for body, _ in every], np.uint8),
            unit_inertia=inertia.astype(np.float32),
        )


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m rigidformer_lab.contacts", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="scene file to make")
    parser.add_argument("--seeds", type=int, default=100, help="number of scenes (default %(default)s)")
    parser.add_argument("--first-seed", type=int, default=1, help="default %(default)s")
    parser.add_argument("--frames", type=int, default=480, help="frames a scene (default %(default)s)")
    parser.add_argument("--size", type=float, default=0.1, metavar="M", help="typical radius of a body, metres, from "
                        f"{SIZES_M[0]} to {SIZES_M[1]} (default %(default)s)")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS), help="kinds to draw from (default: all)")
    parser.add_argument("--engine", choices=ENGINES, default="bullet", help="what records (default bullet): mujoco has soft contact "
                        "and an elliptic cone of friction")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (default: one a core)")
    far.add_argument(parser)
    options = parser.parse_args(arguments)
    bullet.check_seeds(parser, options)
    if not SIZES_M[0] <= options.size <= SIZES_M[1]:
        parser.error(f"--size {options.size}: give metres from {SIZES_M[0]} to {SIZES_M[1]}")
    kinds = tuple(kind for kind in KINDS if kind in options.kinds)
    if options.engine == "mujoco":  # what it drives has no velocity to contacts
        if options.kinds == ["pusher"]:
            parser.error("--engine mujoco: has no pusher; give other --kinds")
        kinds = tuple(kind for kind in kinds if kind != "pusher")
    recipe = Recipe(options.first_seed, options.seeds, options.frames, options.size, kinds, options.engine)
    return bullet.run(recipe, options.out, options.workers, options.dask)


if __name__ == "__main__":
    sys.exit(main())
