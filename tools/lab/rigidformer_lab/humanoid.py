"""Makes scenes of a humanoid of 13 parts that runs along a commanded direction, simulated with PyBullet.

    python -m rigidformer_lab.humanoid --seeds 200 --out humanoid.safetensors

Body and controller are those of HumanoidFlagrunHarder: `humanoid_symmetric.xml` of pybullet_data, and the policy whose
weights stand in pybullet_envs/examples/enjoy_TF_HumanoidFlagrunHarderBulletEnv_v1_2017jul.py; both come with PyBullet's
wheel (zlib licence). `python -m rigidformer_lab.humanoid FOLDER ...` takes the weights from
`FOLDER/flagrun_humanoid_policy.npz` instead: arrays `dense1_w`, `dense1_b`, `dense2_w`, `dense2_b`, `final_w` and
`final_b`, as in that file without their `weights_`.

A scene has 13 units, the parts of one body. The poses are those of the links' frames, and points lie on the spheres and
capsules of the MJCF, in those frames. (PyBullet's getVisualShapeData gives its capsules without their place and turn.)
The command is the direction (x, y) in the world, of length 1, drawn anew after 1.5 to 4 s (multiples of .1 s), from all
directions alike, the first one straight on. The direction in the humanoid's heading, which its policy sees, is no
command: it would give away how the body turns. The command of a frame is in force until the next frame.

The policy acts 60 times a second (its training had steps of .0165 s), with 4 steps of the engine each. The start is
upright at rest, turned about z at random, joints up to .1 rad off; frame 0 is 1 s later. Where a humanoid falls (its
torso's centre below .78 m, as in its training), the run is drawn anew from the same seed; the file's provenance counts
such runs: 11 for seeds 1 to 200.

A tenth of the seeds is for tests, a tenth for validation, as in `movi primitives`; `--split test` puts all of a file into
the split for tests. An interrupted run continues where it stopped.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.util
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import bullet, robots
from .movi import GOLDEN_ANGLE, _rotation
from .robots import FRAME_RATE_HZ, FolderError, Robot, hold_commands, read_arrays

DATASET = "humanoid"
POLICY = "flagrun_humanoid_policy.npz"
HOW = (f"give the folder that holds {POLICY}, or no folder for the weights in PyBullet's wheel; --help says what is in the "
       "file")
EXAMPLE = "examples/enjoy_TF_HumanoidFlagrunHarderBulletEnv_v1_2017jul.py"
MODEL = "mjcf/humanoid_symmetric.xml"
REINSTALL = "install pybullet 3.2.7 anew"
PARTS = ("torso", "lwaist", "pelvis", "right_thigh", "right_shin", "right_foot", "left_thigh", "left_shin", "left_foot",
         "right_upper_arm", "right_lower_arm", "left_upper_arm", "left_lower_arm")
FEET = ("right_foot", "left_foot")

CONTROL_HZ, SUB_STEPS, ITERATIONS, CONTACT_ERP = 60, 4, 5, 0.9
GRAVITY_M_S2 = (0.0, 0.0, -9.8)
FRICTION, GROUND = 0.8, (0.8, 0.5)  # of the parts in the MJCF; friction and restitution of the training's floor
POWER = {"abdomen_z": 100, "abdomen_y": 100, "abdomen_x": 100}  # N m at an action of 1, before the next number
for _side in ("right", "left"):
    POWER |= {f"{_side}_hip_x": 100, f"{_side}_hip_z": 100, f"{_side}_hip_y": 300, f"{_side}_knee": 200}
for _side in ("right", "left"):
    POWER |= {f"{_side}_shoulder1": 75, f"{_side}_shoulder2": 75, f"{_side}_elbow": 75}
POWER_FACTOR = 0.41
START_HEIGHT_M, START_RAD = 1.4, 0.1
USUAL_HEIGHT_M, LEAST_HEIGHT_M = 0.8, 0.78
SPHERE_POINTS, CAPSULE_POINTS = 64, 128
DENSITY_KG_M3 = 1000.0  # of what the MJCF gives no mass

LAYERS = (("dense1", 44, 256), ("dense2", 256, 128), ("final", 128, 17))


def act(weights: dict[str, np.ndarray], observed: np.ndarray) -> np.ndarray:
    """The policy: two layers with ReLU and one without."""
    hidden = observed
    for name, _, _ in LAYERS[:-1]:
        hidden = np.maximum(hidden @ weights[f"{name}_w"] + weights[f"{name}_b"], 0)
    name = LAYERS[-1][0]
    return hidden @ weights[f"{name}_w"] + weights[f"{name}_b"]


def observe(place, turn, velocity, angles: np.ndarray, rates: np.ndarray, touches, direction: np.ndarray) -> np.ndarray:
    """(44): what the policy sees. turn: roll, pitch and yaw of the torso. angles: -1 to 1 between the joints' limits."""
    roll, pitch, yaw = turn
    ahead, aside = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    flat = np.array(velocity[:2])
    body = [place[2] - USUAL_HEIGHT_M, aside @ direction, ahead @ direction, 0.3 * (ahead @ flat), 0.3 * (aside @ flat),
            0.3 * velocity[2], roll, pitch]
    joints = np.column_stack([angles, 0.1 * rates]).ravel()
    return np.clip(np.concatenate([body, joints, touches]), -5, 5).astype(np.float32)


def draw_direction(rng: np.random.Generator) -> np.ndarray:
    angle = rng.uniform(-np.pi, np.pi)
    return np.array([np.cos(angle), np.sin(angle)])


@dataclass(frozen=True)
class Humanoid(Robot):
    model: str = ""  # file of the MJCF
    weights: dict | None = None  # of the policy

    def run(self, rng, frames, nudge=None):
        with bullet.world() as (pb, on):
            return self._run(Body(pb, on, self.model), rng, frames, nudge)

    def _run(self, body: Body, rng, frames: int, nudge):
        body.bend(rng.uniform(-START_RAD, START_RAD, len(body.joints)))
        yaw = rng.uniform(-np.pi, np.pi)
        body.place((0, 0, START_HEIGHT_M), yaw)
        ahead = np.array([np.cos(yaw), np.sin(yaw)])
        commands = hold_commands(rng, frames, lambda: draw_direction(rng), first=ahead)
        poses = np.empty((len(PARTS), frames, 7))
        for frame in range(frames):
            poses[:, frame] = body.poses()
            if not body.height() >= LEAST_HEIGHT_M:
                return None
            if nudge is not None and frame == nudge.frame:
                body.turn(nudge.angles(frame, len(body.joints)))
            for _ in range(CONTROL_HZ // FRAME_RATE_HZ):
                body.step(act(self.weights, body.observe(commands[frame])))
        return poses, commands


class Body:
    """The humanoid in PyBullet, on a ground of its own."""

    def __init__(self, pb, on: dict, model: str):
        self.pb, self.on = pb, on
        pb.setPhysicsEngineParameter(fixedTimeStep=1 / CONTROL_HZ, numSubSteps=SUB_STEPS, numSolverIterations=ITERATIONS,
                                     deterministicOverlappingPairs=True, **on)
        pb.setDefaultContactERP(CONTACT_ERP, **on)
        pb.setGravity(*GRAVITY_M_S2, **on)
        self.ground = pb.createMultiBody(0, pb.createCollisionShape(pb.GEOM_PLANE, **on), **on)
        pb.changeDynamics(self.ground, -1, lateralFriction=GROUND[0], restitution=GROUND[1], **on)
        flags = pb.URDF_USE_SELF_COLLISION | pb.URDF_USE_SELF_COLLISION_EXCLUDE_ALL_PARENTS
        (self.number,) = pb.loadMJCF(model, flags=flags, **on)
        infos = [pb.getJointInfo(self.number, joint, **on) for joint in range(pb.getNumJoints(self.number, **on))]
        joints, links = {info[1].decode(): info for info in infos}, {info[12].decode(): info[0] for info in infos}
        self.joints = [joints[name][0] for name in POWER]
        low, high = np.array([joints[name][8:10] for name in POWER]).T
        self.middle, self.half = (low + high) / 2, (high - low) / 2
        self.power = POWER_FACTOR * np.array(list(POWER.values()))
        self.links = [links[name] for name in PARTS[1:]]
        self.feet = [links[name] for name in FEET]
        for info in infos:  # without its motors, which hold every joint
            pb.setJointMotorControl2(self.number, info[0], pb.POSITION_CONTROL, force=0, **on)
        self.centre = np.array(pb.getDynamicsInfo(self.number, -1, **on)[3])  # of the torso's mass, in its frame
        self.touches = np.zeros(len(FEET))

    def bend(self, angles: np.ndarray) -> None:
        for joint, angle in zip(self.joints, angles):
            self.pb.resetJointState(self.number, joint, angle, 0.0, **self.on)

    def turn(self, angles: np.ndarray) -> None:
        """Turns joints by angles, rad; their rates stay."""
        for joint, angle in zip(self.joints, angles):
            place, rate = self.pb.getJointState(self.number, joint, **self.on)[:2]
            self.pb.resetJointState(self.number, joint, place + angle, rate, **self.on)

    def place(self, centre, yaw: float) -> None:
        turn = self.pb.getQuaternionFromEuler((0, 0, yaw))
        self.pb.resetBasePositionAndOrientation(self.number, centre, turn, **self.on)

    def height(self) -> float:
        return self.pb.getBasePositionAndOrientation(self.number, **self.on)[0][2]

    def poses(self) -> np.ndarray:
        """(parts, 7) of the frames of the torso and the links."""
        place, (x, y, z, w) = self.pb.getBasePositionAndOrientation(self.number, **self.on)
        rows = [(*(np.array(place) - _rotation(w, x, y, z) @ self.centre), w, x, y, z)]
        for state in self.pb.getLinkStates(self.number, self.links, computeForwardKinematics=True, **self.on):
            x, y, z, w = state[5]
            rows.append((*state[4], w, x, y, z))
        return np.array(rows)

    def observe(self, direction: np.ndarray) -> np.ndarray:
        place, quaternion = self.pb.getBasePositionAndOrientation(self.number, **self.on)
        velocity, _ = self.pb.getBaseVelocity(self.number, **self.on)
        states = self.pb.getJointStates(self.number, self.joints, **self.on)
        angles, rates = np.array([state[:2] for state in states]).T
        turn = self.pb.getEulerFromQuaternion(quaternion)
        return observe(place, turn, velocity, (angles - self.middle) / self.half, rates, self.touches, direction)

    def step(self, action: np.ndarray) -> None:
        torques = (self.power * np.clip(action, -1, 1)).tolist()
        self.pb.setJointMotorControlArray(self.number, self.joints, self.pb.TORQUE_CONTROL, forces=torques, **self.on)
        self.pb.stepSimulation(**self.on)
        contacts = [self.pb.getContactPoints(self.number, self.ground, foot, -1, **self.on) for foot in self.feet]
        self.touches = np.array([float(len(points) > 0) for points in contacts])


def capsule_points(start, end, radius: float, count: int) -> np.ndarray:
    """(count, 3) points in a spiral over a capsule, evenly; with `end` at `start`, a sphere. As on a sphere, slices across
    it of one height have one area."""
    start, way = np.array(start, np.float64), np.array(end, np.float64) - start
    length = np.linalg.norm(way)
    axis = way / length if length else np.array([0.0, 0.0, 1.0])
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    side /= np.linalg.norm(side)
    index = np.arange(count)
    along = (0.5 - (index + 0.5) / count) * (length + 2 * radius)
    beyond = np.maximum(np.abs(along) - length / 2, 0)
    across = np.sqrt(radius * radius - beyond * beyond)[:, None]
    angle = (GOLDEN_ANGLE * index)[:, None]
    around = np.cos(angle) * side + np.sin(angle) * np.cross(axis, side)
    return start + way / 2 + along[:, None] * axis + across * around


def read_parts(model: Path) -> tuple[list[np.ndarray], np.ndarray]:
    """Points on the spheres and capsules of each part of the MJCF, in the frame of its link, and masses."""
    bodies = {body.get("name"): body for body in ElementTree.parse(model).iter("body")}
    points, masses = [], np.zeros(len(PARTS))
    for part, name in enumerate(PARTS):
        pieces = []
        for geom in bodies[name].findall("geom"):
            radius = float(geom.get("size").split()[0])
            ends = np.array((geom.get("fromto") or 2 * f"{geom.get('pos')} ").split(), np.float64).reshape(2, 3)
            count = CAPSULE_POINTS if geom.get("type") == "capsule" else SPHERE_POINTS
            pieces.append(capsule_points(*ends, radius, count))
            length = np.linalg.norm(ends[1] - ends[0])
            masses[part] += DENSITY_KG_M3 * np.pi * radius**2 * (length + 4 / 3 * radius)
        points.append(np.concatenate(pieces).astype(np.float32))
    return points, masses


def wheel_weights() -> dict[str, np.ndarray]:
    """The policy's weights in PyBullet's wheel: numbers in a program, which is read and not run."""
    spec = importlib.util.find_spec("pybullet_envs")
    path = Path(spec.origin).parent / EXAMPLE if spec and spec.origin else Path("pybullet_envs") / EXAMPLE
    try:
        program = ast.parse(path.read_bytes())
        weights = {
            line.targets[0].id.removeprefix("weights_"): np.array(ast.literal_eval(line.value.args[0]), np.float32)
            for line in program.body
            if isinstance(line, ast.Assign) and line.targets[0].id.startswith("weights_")
        }
    except (OSError, ValueError, SyntaxError, AttributeError) as error:
        raise FolderError(f"{path}: cannot read the policy's weights ({error}); {REINSTALL}, or give the folder of {POLICY}"
                          ) from error
    for name, rows, columns in LAYERS:
        if np.shape(weights.get(f"{name}_w")) != (rows, columns) or np.shape(weights.get(f"{name}_b")) != (columns,):
            raise FolderError(f"{path}: lacks the weights of the layer {name}; {REINSTALL}, or give the folder of {POLICY}")
    return weights


def read_weights(folder: Path | None) -> dict[str, np.ndarray]:
    if folder is None:
        return wheel_weights()
    shapes = {f"{name}_w": (rows, columns) for name, rows, columns in LAYERS}
    shapes |= {f"{name}_b": (columns,) for name, _, columns in LAYERS}
    return read_arrays(folder / POLICY, shapes, HOW)


@functools.lru_cache(maxsize=1)
def load(folder: Path | None) -> Humanoid:
    """The humanoid and its policy, from a folder or from PyBullet's wheel."""
    import pybullet_data

    model = Path(pybullet_data.getDataPath()) / MODEL
    weights = read_weights(folder)
    try:
        digest = hashlib.sha256(model.read_bytes())
        points, mass = read_parts(model)
    except (OSError, KeyError, ValueError, ElementTree.ParseError) as error:
        raise FolderError(f"{model}: cannot be read ({error}); {REINSTALL}") from error
    for name in sorted(weights):
        digest.update(weights[name].tobytes())
    return Humanoid(
        dataset=DATASET,
        parts=list(PARTS),
        points=points,
        mass=mass,
        friction=FRICTION,
        ground=GROUND,
        gravity_m_s2=GRAVITY_M_S2,
        draws=13,
        provenance="Generated by rigidformer_lab.humanoid with PyBullet 3.2.7: its humanoid_symmetric.xml, running by its "
                   "policy of HumanoidFlagrunHarder. Commands: direction x, y in the world.",
        licence="zlib, Bullet Physics SDK (PyBullet): body and policy come with its wheel",
        digest=digest.hexdigest(),
        model=str(model),
        weights=weights,
    )


class Recipe(robots.Recipe):
    dataset = DATASET

    def robot(self) -> Humanoid:
        return load(self.folder)


def main(arguments: list[str] | None = None) -> int:
    folder = {"nargs": "?", "help": f"folder that holds {POLICY} (default: the weights in PyBullet's wheel)"}
    return robots.command(arguments, "humanoid", __doc__, Recipe, folder)


if __name__ == "__main__":
    sys.exit(main())
