"""Makes scenes in which a robot arm, a Franka Panda, pushes a cube over the ground.

    python -m rigidformer_lab.franka FOLDER --seeds 1000 --out franka.safetensors

FOLDER holds `franka_parts12.npz`: arrays `part` (12 names: `panda_link0` to `panda_link7`, `panda_hand`, `panda_leftfinger`,
`panda_rightfinger`, `cube`), `verts` (vertices of all parts, each in the frame of its link, in metres) and `vstart` (part k
has the rows vstart[k] to vstart[k + 1]). The arm itself comes with the package pybullet (`pybullet_data/franka_panda`). The
vertices are those of the hulls of its collision meshes, `link0.obj` to `finger.obj`, with x and y of the right finger
negated; those of link 6 are thinned to 259, which is within 4 mm. The cube has 8, its corners.

A scene has 12 units in the order of the file: 11 driven parts of one body, the arm, and the cube, which is free. The arm
and the cube stand on the plane z = 0. The command of a frame is the target of the 7 joints, in rad, from that frame to the
next; a set point: of a longer step the last one counts (`command_last`). Scenes have 60 frames a second. 240 engine steps a second, PyBullet's own settings, gravity 9.81 m/s2.

The cube has an edge of 5 cm, .1 kg and friction .5; the ground has friction 1, so the pair has .5, as the cube and a finger
have. PyBullet's URDF gives the fingers friction against spinning, with a lever of .1 m, twice the cube: with it a cube is
pushed by its edge for seconds without turning, and rises by up to 12 degrees where it slips past. It is off here.

`--alone` leaves the cube out of the file, not out of the simulation, and makes links 1 to 10 free units and the base, link 0, a
fixed one: scenes for a model that is told the targets of the joints and predicts the arm. Link 1 weighs 100 kg there: a model's heading
is that of the heaviest free unit, and link 1 turns about the vertical as the arm does.

The fingers are closed and point straight down; the point between their tips is led. It waits 25 cm high until 1.2 s, goes
straight down to 10 cm behind the cube by 2.0 s, pushes at .15 m/s, and then stays. The record begins at .5 s; 330 frames
end at 6 s, after the push.

The seed draws, uniformly: the cube's place, x .4 to .6 m and y -.25 to .25 m, and its turn, any; the direction of the push,
any; how far the fingers' broad side (28 mm at the tips) is turned from across the push, -20 to 20 degrees; how high the
point is led, .02 to .04 m (the tips are 7 mm lower); how far to the side of the cube's centre it passes, -15 to 15 mm; how
long the push lasts, 3.0 to 3.4 s. They are drawn anew until the way lies .3 to .72 m from the arm's axis and at most 75
degrees to either side of its front, where the arm reaches well. Most cubes are pushed to the end; some turn and slip past.

A tenth of the seeds is for tests, a tenth for validation, as in `movi primitives`; `--split test` puts all of a file into
the split for tests. An interrupted run continues where it stopped.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import bullet, far
from .movi import _offsets, shards_of
from .npz import arrays_of
from .roles import DRIVEN, FIXED, FREE, OWN_BODY
from .scenes import Scenes, split_of_seed
from .wrecking import SPLITS

DATASET = "franka"
FILE = "franka_parts12.npz"
PARTS = (*(f"panda_link{k}" for k in range(8)), "panda_hand", "panda_leftfinger", "panda_rightfinger", "cube")
LEAST_POINTS = 4  # a unit of a model

FRAME_RATE_HZ, SUB_STEPS = 60.0, 4
GRAVITY_M_S2 = (0.0, 0.0, -9.81)
FRAMES = 330
LEFT_OUT_S = 0.5

EDGE_M, CUBE_KG, FRICTION = 0.05, 0.1, 0.5
GROUND_FRICTION, RESTITUTION = 1.0, 0.0
BASE_KG = 2.9  # of the URDF; PyBullet says 0 of what it holds fast
TURRET, TURRET_KG = 1, 100.0  # with `--alone`: more than any other link

JOINTS = 7
FINGERS = (9, 10)
TIP = "panda_grasptarget"  # between the finger tips
HOME_RAD = (0.0, -0.2, 0.0, -2.3, 0.0, 2.1, np.pi / 4)
GAIN = 0.1
FORCES = (87.0,) * 4 + (12.0,) * 3  # N m at most
FINGER_FORCE_N = 20.0

WAIT_M, WAIT_S, DOWN_S = 0.25, 1.2, 2.0
BEHIND_M, PUSH_M_S = 0.10, 0.15
CUBE_X_M, CUBE_Y_M = (0.4, 0.6), (-0.25, 0.25)
HAND_TURN_RAD = np.radians(20)  # to either side
HEIGHT_M = (0.02, 0.04)
ASIDE_M = 0.015  # to either side
PUSH_S = (3.0, 3.4)
REACH_M, SIDE_RAD = (0.3, 0.72), np.radians(75)
TRIALS = 1000


class PartsError(ValueError):
    """The parts of the arm cannot be used."""


def read_parts(folder: Path) -> list[np.ndarray]:
    """Points of each of PARTS, (points, 3) float32."""
    path = Path(folder) / FILE

    def fail(problem: str):
        raise PartsError(f"{path}: {problem}; give the folder that holds {FILE}, or make it from the hulls of the meshes in "
                         "pybullet_data/franka_panda/meshes/collision as --help says")

    names, points, starts = arrays_of(path, ("part", "verts", "vstart"), fail).values()
    if names.ndim != 1 or tuple(map(str, names)) != PARTS:
        fail(f"part is not {', '.join(PARTS)}")
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind != "f" or not np.isfinite(points).all():
        fail(f"verts is {points.dtype} of shape {points.shape}, not finite floats of shape (points, 3)")
    if starts.shape != (len(PARTS) + 1,) or starts.dtype.kind not in "iu":
        fail(f"vstart is {starts.dtype} of shape {starts.shape}, not {len(PARTS) + 1} whole numbers")
    counts = np.diff(starts.astype(np.int64))
    if starts[0] != 0 or starts[-1] != len(points) or counts.min() < LEAST_POINTS:
        fail(f"vstart does not rise from 0 to {len(points)} by at least {LEAST_POINTS} a part")
    if not np.allclose(np.abs(points[starts[-2] :]).max(axis=0), EDGE_M / 2, atol=1e-6):
        fail(f"the cube does not have an edge of {EDGE_M:g} m about its origin")
    return np.split(points.astype(np.float32), starts[1:-1])


@dataclass(frozen=True)
class Push:
    """What a seed draws: where the cube lies and the way of the point between the finger tips."""

    cube: np.ndarray  # (3) its centre
    cube_turn: float  # rad about the vertical
    hand_turn: float
    start: np.ndarray  # (3) 10 cm behind the cube
    way: np.ndarray  # (3) direction of the push
    seconds: float

    @classmethod
    def of_seed(cls, seed: int) -> Push:
        rng = np.random.default_rng((seed, 80))
        for _ in range(TRIALS):
            cube = np.array([rng.uniform(*CUBE_X_M), rng.uniform(*CUBE_Y_M), EDGE_M / 2])
            cube_turn, heading = rng.uniform(0, 2 * np.pi, 2)
            hand_turn = heading + rng.uniform(-HAND_TURN_RAD, HAND_TURN_RAD)
            height, aside, seconds = rng.uniform(*HEIGHT_M), rng.uniform(-ASIDE_M, ASIDE_M), rng.uniform(*PUSH_S)
            way = np.array([np.cos(heading), np.sin(heading), 0.0])
            start = cube - BEHIND_M * way + aside * np.array([-way[1], way[0], 0.0])
            start[2] = height
            push = cls(cube, cube_turn, _wrist(cube, hand_turn), start, way, seconds)
            if push.in_reach():
                return push
        raise RuntimeError(f"seed {seed}: no push within reach in {TRIALS} trials; leave the seed out")

    def in_reach(self) -> bool:
        points = self.start[:2] + np.linspace(0, self.seconds * PUSH_M_S, 32)[:, None] * self.way[:2]
        away, side = np.linalg.norm(points, axis=1), np.arctan2(points[:, 1], points[:, 0])
        return REACH_M[0] <= away.min() and away.max() <= REACH_M[1] and np.abs(side).max() <= SIDE_RAD

    def at(self, time: float) -> np.ndarray:
        """(3) where the point is to be."""
        down = np.clip((time - WAIT_S) / (DOWN_S - WAIT_S), 0, 1)
        place = self.start + np.clip(time - DOWN_S, 0, self.seconds) * PUSH_M_S * self.way
        place[2] += (1 - down) * (WAIT_M - self.start[2])
        return place


def _wrist(cube, turn: float) -> float:
    """The turn of the hand or the opposite one, which is as good: the one that keeps the last joint near its middle."""
    least = np.arctan2(cube[1], cube[0]) - np.pi / 4
    return least + (turn - least) % np.pi


class Arm:
    """The Panda in PyBullet, led by the point between its finger tips."""

    def __init__(self, pb, on: dict, turn: float):
        self.pb, self.on = pb, on
        self.number = pb.loadURDF(bullet.data_file("franka_panda/panda.urdf"), useFixedBase=True, **on)
        infos = (pb.getJointInfo(self.number, joint, **on) for joint in range(pb.getNumJoints(self.number, **on)))
        link = {info[12].decode(): joint for joint, info in enumerate(infos)}
        self.links = [link[name] for name in PARTS[1:-1]]
        self.tip = link[TIP]
        self.down = pb.getQuaternionFromEuler((np.pi, 0, turn))
        for joint in FINGERS:
            pb.changeDynamics(self.number, joint, spinningFriction=0.0, frictionAnchor=0, **on)
        for joint, angle in enumerate(HOME_RAD):
            pb.resetJointState(self.number, joint, angle, **on)

    def targets(self, place) -> tuple[float, ...]:
        """Angles of the joints that bring the point to a place with the fingers down."""
        return self.pb.calculateInverseKinematics(self.number, self.tip, place, self.down, maxNumIterations=100,
                                                  residualThreshold=1e-6, **self.on)[:JOINTS]

    def jump(self, place) -> None:
        """Puts the point to a place, at once."""
        for _ in range(20):  # each goes on from where the arm is
            for joint, angle in enumerate(self.targets(place)):
                self.pb.resetJointState(self.number, joint, angle, **self.on)

    def drive(self, targets) -> None:
        for joint, angle in enumerate(targets):
            self.pb.setJointMotorControl2(self.number, joint, self.pb.POSITION_CONTROL, targetPosition=angle,
                                          positionGain=GAIN, force=FORCES[joint], **self.on)
        for joint in FINGERS:
            self.pb.setJointMotorControl2(self.number, joint, self.pb.POSITION_CONTROL, targetPosition=0.0,
                                          positionGain=GAIN, force=FINGER_FORCE_N, **self.on)

    def poses(self) -> list[tuple[float, ...]]:
        """Position and quaternion w, x, y, z of the frame of each part. The base stands at the origin."""
        poses = [(0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)]
        for state in self.pb.getLinkStates(self.number, self.links, computeForwardKinematics=True, **self.on):
            place, (x, y, z, w) = state[4:6]  # of the link's frame; the first two are of its centre of mass
            poses.append((*place, w, x, y, z))
        return poses

    def physics(self) -> list[tuple[float, float, float]]:
        """Mass, friction and restitution of each part."""
        found = []
        for link in (-1, *self.links):
            info = self.pb.getDynamicsInfo(self.number, link, **self.on)
            found.append((info[0] if link >= 0 else BASE_KG, info[1], info[5]))
        return found


@dataclass
class Scene:
    poses: np.ndarray  # (12, frames, 7) float64
    commands: np.ndarray  # (frames, 7) float64
    physics: np.ndarray  # (12, 3)


def simulate(seed: int, frames: int) -> Scene:
    """One scene, drawn from `seed` alone."""
    push = Push.of_seed(seed)
    left_out = round(LEFT_OUT_S * FRAME_RATE_HZ)
    poses, commands = np.empty((len(PARTS), frames, 7)), np.empty((frames, JOINTS))
    # The settings of `movi` make so small a cube tremble, a half-space makes it tilt: the plane of the URDF is a large box.
    with bullet.paced_world(GRAVITY_M_S2, 1.0 / (FRAME_RATE_HZ * SUB_STEPS)) as (pb, on):
        ground = pb.loadURDF(bullet.data_file("plane.urdf"), useFixedBase=True, **on)
        pb.changeDynamics(ground, -1, lateralFriction=GROUND_FRICTION, restitution=RESTITUTION, **on)
        box = pb.createCollisionShape(pb.GEOM_BOX, halfExtents=[EDGE_M / 2] * 3, **on)
        turn = pb.getQuaternionFromEuler((0, 0, push.cube_turn))
        cube = pb.createMultiBody(CUBE_KG, box, basePosition=push.cube, baseOrientation=turn, **on)
        pb.changeDynamics(cube, -1, lateralFriction=FRICTION, restitution=RESTITUTION, **on)
        arm = Arm(pb, on, push.hand_turn)
        arm.jump(push.at(0.0))
        for index in range(-left_out, frames):
            targets = arm.targets(push.at((index + left_out) / FRAME_RATE_HZ))
            if index >= 0:
                poses[:, index] = [*arm.poses(), bullet.pose_of(pb, on, cube)]
                commands[index] = targets
            arm.drive(targets)
            for _ in range(SUB_STEPS if index + 1 < frames else 0):
                pb.stepSimulation(**on)
        physics = np.array([*arm.physics(), (CUBE_KG, FRICTION, RESTITUTION)])
    bullet.steady_signs(poses)
    return Scene(poses, commands, physics)


@dataclass(frozen=True)
class Recipe:
    """What a run makes; see `movi.Recipe`."""

    folder: Path
    first_seed: int
    seeds: int
    frames: int = FRAMES
    split: int | None = None  # None: by seed
    alone: bool = False  # links 1 to 10 as free units, without the cube

    name = dataset = DATASET

    def shards(self) -> list[range]:
        return shards_of(self.first_seed, self.seeds)

    def description(self) -> dict:
        """What has to agree before a run may continue from existing shards."""
        digest = hashlib.sha256(Path(__file__).read_bytes() + Path(bullet.__file__).read_bytes())
        for points in read_parts(self.folder):
            digest.update(points.tobytes())
        return {"dataset": DATASET, "first_seed": self.first_seed, "seeds": self.seeds, "frames": self.frames,
                "split": self.split, "alone": self.alone, "code_and_parts_sha256": digest.hexdigest()}

    def split_of(self, seed: int) -> int:
        return split_of_seed("primitives", seed) if self.split is None else self.split

    def make(self, seeds: range) -> Scenes:
        """Simulates `seeds` one after the other."""
        made = [simulate(seed, self.frames) for seed in seeds]
        units, count = len(PARTS) - self.alone, len(made)
        points = read_parts(self.folder)[:units]
        roles, bodies = [DRIVEN] * (len(PARTS) - 1) + [FREE], [0] * (len(PARTS) - 1) + [OWN_BODY]
        if self.alone:
            roles = [FIXED] + [FREE] * (units - 1)
            for scene in made:
                scene.physics[TURRET, 0] = TURRET_KG
        return Scenes(
            dataset=DATASET,
            shape_names=list(PARTS[:units]),
            shape_points=np.concatenate(points),
            shape_offsets=_offsets([len(p) for p in points]),
            scene_seed=np.array(seeds, np.int64),
            scene_split=np.array([self.split_of(seed) for seed in seeds], np.uint8),
            scene_units=_offsets([units] * count),
            unit_shape=np.tile(np.arange(units, dtype=np.int32), count),
            unit_scale=np.ones(units * count, np.float32),
            unit_physics=np.concatenate([scene.physics[:units] for scene in made]).astype(np.float32),
            unit_poses=np.concatenate([scene.poses[:units] for scene in made]).astype(np.float32),
            provenance="Generated by rigidformer_lab.franka with PyBullet 3.2.7 and the Franka Panda of its pybullet_data: "
                       "the arm pushes a cube.",
            licence="Arm and shapes: Apache-2.0, Franka Emika GmbH (pybullet_data/franka_panda). Motion: the licence of the "
                    "rigidformer project.",
            frame_rate_hz=FRAME_RATE_HZ,
            gravity_m_s2=GRAVITY_M_S2,
            ground_friction=GROUND_FRICTION,
            ground_restitution=RESTITUTION,
            unit_role=np.tile(np.array(roles, np.uint8)[:units], count),
            unit_body=np.tile(np.array(bodies, np.int32)[:units], count),
            commands=np.stack([scene.commands for scene in made]).astype(np.float32),
            command_last=np.ones(JOINTS, np.uint8),
        )


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m rigidformer_lab.franka", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help=f"folder that holds {FILE}")
    parser.add_argument("--out", type=Path, required=True, help="scene file to make")
    parser.add_argument("--seeds", type=int, default=100, help="number of scenes (default %(default)s)")
    parser.add_argument("--first-seed", type=int, default=1, help="default %(default)s")
    parser.add_argument("--frames", type=int, default=FRAMES, help="frames a scene at 60 Hz (default %(default)s)")
    parser.add_argument("--split", choices=SPLITS, help="split of all scenes of the file (default: by seed)")
    parser.add_argument("--alone", action="store_true", help="links 1 to 10 as free units, without the cube")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (default: one a core)")
    far.add_argument(parser)
    options = parser.parse_args(arguments)
    bullet.check_seeds(parser, options)
    try:
        read_parts(options.folder)
    except PartsError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    recipe = Recipe(options.folder.resolve(), options.first_seed, options.seeds, options.frames, SPLITS.get(options.split), options.alone)
    return bullet.run(recipe, options.out, options.workers, options.dask)


if __name__ == "__main__":
    sys.exit(main())
