"""Makes scenes of a Unitree G1 that walks under commands, simulated with MuJoCo.

    python -m rigidformer_lab.g1 FOLDER --seeds 400 --out g1.safetensors

FOLDER holds what Unitree publishes (BSD-3-Clause), in this form:

- `mjcf/g1_29dof_rev_1_0.xml` and the STL files in `mjcf/meshes`, as in robots/g1_description of
  github.com/unitreerobotics/unitree_ros;
- `g1_policy.npz`: the walking policy deploy/pre_train/g1/motion.pt of github.com/unitreerobotics/unitree_rl_gym, its LSTM
  as `w_ih`, `w_hh`, `b_ih`, `b_hh` and its two linear layers as `w0`, `b0`, `w1`, `b1`;
- `g1_parts31.npz`: vertices of the 30 bodies' meshes and of `head_link`, as few as wanted: `part` (names), `vstart`
  (where the vertices of each part start, and the end of the last) and `verts` (vertices, 3), metres, in the frame of the
  part's body.

A scene has 31 units, the parts of one body. The poses are those of MuJoCo's bodies, and the head has the torso's. The
mass of the torso is that of torso and head, shared out by the volumes of their hulls. The command is (vx, vy, yaw rate)
in m/s and rad/s, in the robot's heading; it is uniform in +-(.8, .5, 1), vx plus .1, and drawn anew after 1.5 to 4 s
(multiples of .1 s). The command of a frame is in force until the next frame.

The policy moves the legs at 50 Hz; the engine has 600 steps a second. Springs hold waist and arms, and the shoulders
swing by about half a radian in step with the gait. The start is upright at rest, turned about z at random; frame 0 is 1 s
later. Where a robot falls (pelvis below .5 m, or tilted by more than 60 degrees), the run is drawn anew from the same
seed; the file's provenance counts such runs. Of seeds 1 to 400 none fell.

A tenth of the seeds is for tests, a tenth for validation, as in `movi primitives`; `--split test` puts all of a file into
the split for tests. An interrupted run continues where it stopped.
"""

from __future__ import annotations

import functools
import hashlib
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

from . import robots
from .robots import FRAME_RATE_HZ, FolderError, Robot, hold_commands, read_arrays

DATASET = "g1"
MODEL, POLICY, PARTS = "mjcf/g1_29dof_rev_1_0.xml", "g1_policy.npz", "g1_parts31.npz"
HOW = f"give the folder that holds {MODEL}, {POLICY} and {PARTS}; --help says where they come from and what is in them"
LICENCE = ("BSD-3-Clause, Copyright (c) 2016-2023 HangZhou YuShu TECHNOLOGY CO.,LTD. (\"Unitree Robotics\"). All rights "
           "reserved.")
HEAD, TORSO = "head_link", "torso_link"  # MuJoCo's body of the torso has both meshes

STEPS_HZ, CONTROL_HZ = 600, 50
LEGS = slice(6, 18)  # of the velocities; of the positions one later
LEG_JOINTS = 12
# Left leg first; hip pitch, roll, yaw, knee, ankle pitch, roll.
DEFAULT = np.array([-0.1, 0.0, 0.0, 0.3, -0.2, 0.0] * 2)  # rad
STIFFNESS = np.array([100.0, 100.0, 100.0, 150.0, 40.0, 40.0] * 2)
DAMPING = np.array([2.0, 2.0, 2.0, 4.0, 2.0, 2.0] * 2)
WAIST = ("waist_",)
ARMS = ("left_shoulder_", "left_elbow_", "left_wrist_", "right_shoulder_", "right_elbow_", "right_wrist_")
GAIT_S = 0.8
SWING_RAD = 0.5
COMMAND, COMMAND_MIDDLE = np.array([0.8, 0.5, 1.0]), np.array([0.1, 0.0, 0.0])
LEAST_HEIGHT_M, LEAST_UPRIGHT = 0.5, 0.5  # a robot below is one that fell; the latter: cosine of the tilt
FRICTION = 1.0  # of feet and ground in the MJCF; MuJoCo takes the greater one

OBSERVED, HIDDEN, MIDDLE = 47, 64, 32


class Policy:
    """The walking policy: an LSTM and two linear layers. It remembers, so every run has one of its own."""

    def __init__(self, weights: dict[str, np.ndarray]):
        self.weights = weights
        self.hidden = self.cell = np.zeros(weights["w_hh"].shape[1], np.float32)

    def act(self, observed: np.ndarray) -> np.ndarray:
        w = self.weights
        gates = w["w_ih"] @ observed.astype(np.float32) + w["b_ih"] + w["w_hh"] @ self.hidden + w["b_hh"]
        take, forget, new, show = np.split(gates, 4)
        self.cell = _sigmoid(forget) * self.cell + _sigmoid(take) * np.tanh(new)
        self.hidden = _sigmoid(show) * np.tanh(self.cell)
        middle = w["w0"] @ self.hidden + w["b0"]
        middle = np.where(middle > 0, middle, np.expm1(np.minimum(middle, 0)))
        return w["w1"] @ middle + w["b1"]


def _sigmoid(x: np.ndarray) -> np.ndarray:
    return 0.5 + 0.5 * np.tanh(0.5 * x)


def observe(position: np.ndarray, velocity: np.ndarray, command: np.ndarray, action: np.ndarray, time: float) -> np.ndarray:
    """(47): what the policy sees, of MuJoCo's positions and velocities and of the policy's last action."""
    w, x, y, z = position[3:7]
    phase = 2 * np.pi * time / GAIT_S
    return np.concatenate([
        0.25 * velocity[3:6],
        [2 * (w * y - z * x), -2 * (z * y + w * x), 1 - 2 * (w * w + z * z)],  # the way down in the pelvis' frame
        command * [2.0, 2.0, 0.25],
        position[7 : 7 + LEG_JOINTS] - DEFAULT,
        0.05 * velocity[LEGS],
        action,
        [np.sin(phase), np.cos(phase)],
    ])  # fmt: skip


def draw_command(rng: np.random.Generator) -> np.ndarray:
    return COMMAND_MIDDLE + rng.uniform(-COMMAND, COMMAND)


@dataclass(frozen=True)
class G1(Robot):
    model: object = None  # MuJoCo's
    weights: dict | None = None  # of the policy
    body: np.ndarray | None = None  # (parts) MuJoCo's number of the body whose pose a part has
    command: tuple[float, float, float] | None = None  # that holds all the time; None: drawn anew again and again

    def run(self, rng, frames, nudge=None):
        yaw = rng.uniform(-np.pi, np.pi)
        if self.command is None:
            commands = hold_commands(rng, frames, lambda: draw_command(rng))
        else:
            commands = np.tile(np.array(self.command, np.float64), (frames, 1))
        poses = self.walk(yaw, frames, lambda frame, _: commands[frame], nudge)
        return None if poses is None else (poses, commands)

    def walk(self, yaw: float, frames: int, tell, nudge=None) -> np.ndarray | None:
        """Poses (parts, frames, 7) of a walk that looks along `yaw` at first; None if the robot falls. tell: the command from a
        frame on, from its number and the poses (parts, frame + 1, 7) up to it."""
        import mujoco

        model, data = self.model, mujoco.MjData(self.model)
        data.qpos[3:7] = np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)
        policy, action, target = Policy(self.weights), np.zeros(LEG_JOINTS), DEFAULT
        shoulders = [model.joint(f"{side}_shoulder_pitch_joint").qposadr[0] for side in ("left", "right")]
        every, between = STEPS_HZ // FRAME_RATE_HZ, STEPS_HZ // CONTROL_HZ
        poses = np.empty((len(self.body), frames, 7))
        for step in range((frames - 1) * every + 1):
            frame, rest = divmod(step, every)
            if not rest:
                mujoco.mj_kinematics(model, data)  # the poses that mj_step leaves are those before its last step
                poses[:, frame, :3], poses[:, frame, 3:] = data.xpos[self.body], data.xquat[self.body]
                if _has_fallen(data.qpos):
                    return None
                if nudge is not None:
                    data.qpos[7:] += nudge.angles(frame, len(data.qpos) - 7)
                command = np.asarray(tell(frame, poses[:, : frame + 1]), np.float64)
            # At the start the legs go to their default first, as on the robot.
            if step and step % between == 0:
                seen = observe(data.qpos, data.qvel, command, action, step / STEPS_HZ)
                action = policy.act(seen)
                target = DEFAULT + 0.25 * action
            swing = SWING_RAD * np.sin(2 * np.pi * step / STEPS_HZ / GAIT_S)
            model.qpos_spring[shoulders] = swing, -swing
            legs = data.qpos[7 : 7 + LEG_JOINTS]
            data.ctrl[:LEG_JOINTS] = STIFFNESS * (target - legs) - DAMPING * data.qvel[LEGS]
            mujoco.mj_step(model, data)
        return poses


def _has_fallen(position: np.ndarray) -> bool:
    x, y = position[4:6]
    return position[2] < LEAST_HEIGHT_M or 1 - 2 * (x * x + y * y) < LEAST_UPRIGHT


def read_model(path: Path):
    """MuJoCo's model of the robot, with the joints that the policy needs."""
    import mujoco

    if not path.is_file():
        raise FolderError(f"{path}: there is no such file; {HOW}")
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise FolderError(f"{path}: MuJoCo cannot read it ({' '.join(str(error).split())}); {HOW}") from error
    names = [model.joint(k).name for k in range(model.njnt)]
    legs = [name for name in names[1 : 1 + LEG_JOINTS] if "hip" in name or "knee" in name or "ankle" in name]
    if model.nq != 36 or model.nu != 29 or len(legs) != LEG_JOINTS:
        raise FolderError(f"{path}: is no G1 with 29 joints, the legs' first; {HOW}")
    model.opt.timestep = 1 / STEPS_HZ
    model.dof_armature[6:], model.dof_damping[6:], model.dof_frictionloss[6:] = 0.01, 0.001, 0.1
    for start, stiffness, damping in ((WAIST, 3000.0, 60.0), (ARMS, 300.0, 10.0)):
        for joint in (k for k, name in enumerate(names) if name.startswith(start)):
            model.jnt_stiffness[joint] = stiffness
            model.dof_damping[model.jnt_dofadr[joint]] = damping
    return model


def read_parts(path: Path) -> tuple[list[str], list[np.ndarray]]:
    """Names of the parts, and the points of each."""
    arrays = read_arrays(path, {"part": (None,), "vstart": (None,), "verts": (None, 3)}, HOW)
    names, starts, points = [str(name) for name in arrays["part"]], arrays["vstart"], arrays["verts"]
    ends = [0, *starts[1:-1], len(points)]
    if (len(starts) != len(names) + 1 or starts.dtype.kind not in "iu" or list(starts) != ends
            or (np.diff(starts.astype(np.int64)) < 4).any() or points.dtype.kind != "f"):
        raise FolderError(f"{path}: vstart does not cut the {len(points)} rows of verts into {len(names)} parts of 4 points "
                          f"or more; {HOW}")
    return names, [part.astype(np.float32) for part in np.split(points, starts[1:-1])]


@functools.lru_cache(maxsize=1)
def load(folder: Path) -> G1:
    """The robot, its parts and its policy."""
    names, points = read_parts(folder / PARTS)
    weights = read_arrays(folder / POLICY, {
        "w_ih": (4 * HIDDEN, OBSERVED), "w_hh": (4 * HIDDEN, HIDDEN), "b_ih": (4 * HIDDEN,), "b_hh": (4 * HIDDEN,),
        "w0": (MIDDLE, HIDDEN), "b0": (MIDDLE,), "w1": (LEG_JOINTS, MIDDLE), "b1": (LEG_JOINTS,),
    }, HOW)
    model = read_model(folder / MODEL)
    bodies = {model.body(k).name: k for k in range(1, model.nbody)}
    if len(names) != len(bodies) + 1 or set(names) != {*bodies, HEAD}:
        raise FolderError(f"{folder / PARTS}: part does not name each body of {MODEL} and {HEAD} once; {HOW}")
    body = np.array([bodies[TORSO if name == HEAD else name] for name in names])
    mass = model.body_mass[body]
    shared = [names.index(TORSO), names.index(HEAD)]
    volume = np.array([ConvexHull(points[k]).volume for k in shared])
    mass[shared] *= volume / volume.sum()
    digest = hashlib.sha256()
    for file in (folder / MODEL, folder / POLICY, folder / PARTS, *sorted((folder / MODEL).parent.glob("meshes/*"))):
        digest.update(file.read_bytes())
    licence = folder / "g1_LICENSE.txt"
    return G1(
        dataset=DATASET,
        parts=names,
        points=points,
        mass=mass,
        friction=FRICTION,
        ground=(FRICTION, 0.0),
        gravity_m_s2=tuple(float(g) for g in model.opt.gravity),
        draws=31,
        provenance="Generated by rigidformer_lab.g1 with MuJoCo 4.0.0: the Unitree G1 of unitree_ros (g1_29dof_rev_1_0), "
                   "walking by the policy of unitree_rl_gym. Commands: vx, vy (m/s) and yaw rate (rad/s) in the robot's "
                   "heading. shape_points are vertices of its meshes.",
        licence=f"{LICENCE}\n\n{licence.read_text()}" if licence.is_file() else LICENCE,
        digest=digest.hexdigest(),
        model=model,
        weights=weights,
        body=body,
    )


class Recipe(robots.Recipe):
    dataset = DATASET

    def robot(self) -> G1:
        return load(self.folder)


def main(arguments: list[str] | None = None) -> int:
    folder = {"help": f"folder that holds {MODEL}, {POLICY} and {PARTS}"}
    return robots.command(arguments, "g1", __doc__, Recipe, folder)


if __name__ == "__main__":
    sys.exit(main())
