"""Grasps by a parallel gripper: MuJoCo records them, and the runtime predicts their outcome.

    python -m rigidformer_lab.grasp --model ../../weights/models/edge-i8.rfm --seeds 200 --first-seed 100001 --json grasps.json
    python -m rigidformer_lab.grasp --model ../../weights/models/edge-i8.rfm --seeds 100 --choose 64

A palm that is moved along a given way carries two fingers on sliders. They close on a box or a cylinder that stands on the ground, lift it
by 15 cm, and shake it sideways. Their drives hold a position with limited force. The outcome is `held` (it hangs between the fingers at
the end), `slipped` (they touched it, and it does not), or `missed` (they never touched it).

MuJoCo's contact is soft and has an elliptic cone of friction; its steps are 1 ms. The runtime has the same shapes, masses, inertias,
frictions, joints and drives, and moves by impulses. With `--choose N` the runtime tries so many grasps of each object and takes the one that holds
longest against the strongest shaking; the table says in how many scenes MuJoCo holds it too.

Needs the runtime's Python package `rigidformer`, and MuJoCo.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

HELD, SLIPPED, MISSED = "held", "slipped", "missed"
FRICTIONS = (0.25, 0.5, 0.9)
FINGER = (0.010, 0.006, 0.025)  # half of its lengths, metres: along the palm, across it (the way it closes), upwards
FINGER_KG, PALM = 0.1, (0.02, 0.06, 0.01)
OPEN_M = 0.045  # from the middle to a finger's inner face
PALM_UP_M = 0.06  # from the middle of the fingers
STEP_S, MUJOCO_S = 1 / 60, 1e-3
REST_S, CLOSE_S, LIFT_S, HANG_S, SHAKE_S = 0.1, 0.4, 0.6, 0.2, 0.7
LIFT_M, SHAKE_M, SHAKE_HZ = 0.15, 0.02, 3.0
END_S = REST_S + CLOSE_S + LIFT_S + HANG_S + SHAKE_S
GRAVITY = 9.81
TOUCH_KG_M3 = (300.0, 1500.0)


@dataclass(frozen=True)
class Grasp:
    """An object and where the gripper closes on it. Lengths in metres."""

    kind: str  # box, cylinder
    half: tuple[float, float, float]  # half of the lengths of a box; radius, radius and half of the height of a cylinder
    mass_kg: float
    friction: float
    turn_rad: float  # of the object about the vertical, in the gripper's frame
    aside: tuple[float, float]  # of the object's centre from the middle of the fingers, along and across
    height: float  # of the fingers' middle over the ground
    force_n: float  # of each finger, at most

    @property
    def inertia(self) -> tuple[float, float, float]:
        x, y, z = self.half
        if self.kind == "box":
            return tuple(self.mass_kg / 3 * s for s in (y * y + z * z, x * x + z * z, x * x + y * y))
        side = self.mass_kg * (x * x / 4 + z * z / 3)
        return side, side, self.mass_kg * x * x / 2


def draw(seed: int) -> Grasp:
    """A grasp by a seed: from sure ones to such that slip or miss."""
    rng = np.random.default_rng([917, seed])
    kind = ("box", "cylinder")[rng.integers(2)]
    half = rng.uniform((0.012, 0.012, 0.02), (0.035, 0.035, 0.05))
    if kind == "cylinder":
        half[1] = half[0] = min(half[0], 0.032)
    volume = 8 * half.prod() if kind == "box" else 2 * math.pi * half[0] ** 2 * half[2]
    mass = float(volume * rng.uniform(*TOUCH_KG_M3))
    friction = float(rng.choice(FRICTIONS))
    # About what it takes to hold it, from a third to ten times that.
    force = float(mass * GRAVITY / (2 * friction) * np.exp(rng.uniform(math.log(0.35), math.log(10))))
    turn = float(rng.uniform(-0.25, 0.25) + rng.choice((0.0, math.pi / 2)))
    reach = FINGER[0] + half[:2].max()
    along = float(rng.uniform(-1, 1) * (1.6 * reach if rng.random() < 0.2 else 0.4 * reach))
    wide = abs(half[0] * math.sin(turn)) + abs(half[1] * math.cos(turn))
    wide = half[0] if kind == "cylinder" else wide
    across = float(rng.uniform(-1, 1) * max(OPEN_M - wide - 0.004, 0.0))
    height = float(rng.uniform(FINGER[2] + 0.004, min(2 * half[2], 0.08) + FINGER[2] * 0.3))
    return Grasp(kind, tuple(map(float, half)), mass, friction, turn, (along, across), max(height, FINGER[2] + 0.004), force)


def fits(grasp: Grasp) -> bool:
    """Whether the object is between the open fingers, so that nothing overlaps at the start."""
    x, y, _ = grasp.half
    wide = x if grasp.kind == "cylinder" else abs(x * math.sin(grasp.turn_rad)) + abs(y * math.cos(grasp.turn_rad))
    return wide + abs(grasp.aside[1]) < OPEN_M - 0.002


def palm_at(t: float) -> tuple[float, float]:
    """Where the palm is at a time, along and upwards from its first place, metres."""
    lifted = np.clip((t - REST_S - CLOSE_S) / LIFT_S, 0.0, 1.0)
    shaken = max(t - REST_S - CLOSE_S - LIFT_S - HANG_S, 0.0)
    swell = min(shaken * SHAKE_HZ, 1.0)
    return SHAKE_M * swell * math.sin(2 * math.pi * SHAKE_HZ * shaken), LIFT_M * float(lifted * lifted * (3 - 2 * lifted))


def closes(t: float) -> bool:
    return t >= REST_S


def outcome(touched: bool, place: np.ndarray, palm: np.ndarray) -> str:
    """`place`: of the object's centre, `palm`: of the palm, at the end."""
    if not touched:
        return MISSED
    return HELD if np.linalg.norm(place - palm) < PALM_UP_M + 0.06 and place[2] > LIFT_M / 2 else SLIPPED


def start(grasp: Grasp):
    """(place, quaternion) of the object."""
    return np.array((*grasp.aside, grasp.half[2])), np.array((math.cos(grasp.turn_rad / 2), 0, 0, math.sin(grasp.turn_rad / 2)))


def fingers_at(grasp: Grasp) -> list[np.ndarray]:
    return [np.array((0.0, side * (OPEN_M + FINGER[1]), grasp.height)) for side in (-1, 1)]


# MuJoCo -----------------------------------------------------------------------------------------------------------------------------


def scene_xml(grasp: Grasp) -> str:
    text = lambda numbers: " ".join(f"{v:.9g}" for v in numbers)  # noqa: E731
    place, turn = start(grasp)
    size = grasp.half if grasp.kind == "box" else (grasp.half[0], grasp.half[2])
    palm = (0.0, 0.0, grasp.height + PALM_UP_M)
    fingers, drives, pairs = "", "", ""
    pair = f'condim="4" friction="{grasp.friction} {grasp.friction} 0.002 0 0" solref="0.004 1" solimp=".95 .99 .0005"'
    for k, side in enumerate((-1, 1)):
        at = fingers_at(grasp)[k] - palm
        fingers += (
            f'<body name="f{k}" pos="{text(at)}"><joint name="j{k}" type="slide" axis="0 {-side} 0" damping="0"/>'
            f'<geom name="g{k}" type="box" size="{text(FINGER)}" mass="{FINGER_KG}"/></body>'
        )
        drives += f'<motor joint="j{k}"/>'
        pairs += f'<pair geom1="g{k}" geom2="o" {pair}/>'
    pairs += f'<pair geom1="ground" geom2="o" {pair}/>'
    return (
        f'<mujoco><option timestep="{MUJOCO_S}" gravity="0 0 -{GRAVITY}" cone="elliptic" impratio="20" noslip_iterations="5" integrator="implicitfast"/>'
        '<default><geom contype="0" conaffinity="0"/></default><worldbody>'
        '<geom name="ground" type="plane" size="5 5 1"/>'
        f'<body name="palm" pos="{text(palm)}"><joint name="along" type="slide" axis="1 0 0"/><joint name="up" type="slide" axis="0 0 1"/>'
        f'<geom type="box" size="{text(PALM)}" mass="1000"/>{fingers}</body>'
        f'<body name="o" pos="{text(place)}" quat="{text(turn)}"><freejoint/><inertial pos="0 0 0" mass="{grasp.mass_kg:.9g}" '
        f'diaginertia="{text(grasp.inertia)}"/><geom name="o" type="{grasp.kind}" size="{text(size)}"/></body>'
        f"</worldbody><actuator>{drives}</actuator><contact>{pairs}</contact></mujoco>"
    )


def record(grasp: Grasp) -> dict:
    """What MuJoCo makes of it: the outcome, and the object's poses each STEP_S, (steps + 1, 7)."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(scene_xml(grasp))
    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in ("along", "up", "j0", "j1")]
    at = [(int(j.qposadr[0]), int(j.dofadr[0])) for j in joints]
    geoms = {model.geom(f"g{k}").id for k in range(2)}
    thing = model.geom("o").id
    mujoco.mj_forward(model, data)
    poses, touched = [np.concatenate((data.body("o").xpos, data.body("o").xquat))], False
    next_s = STEP_S
    for n in range(round(END_S / MUJOCO_S)):
        t = n * MUJOCO_S
        # The palm goes its way whatever pulls at it.
        here, there = palm_at(t), palm_at(t + MUJOCO_S)
        for axis in range(2):
            q, v = at[axis]
            data.qpos[q], data.qvel[v] = here[axis], (there[axis] - here[axis]) / MUJOCO_S
        data.ctrl[:] = grasp.force_n if closes(t) else 0.0
        mujoco.mj_step(model, data)
        touched = touched or any({int(c.geom1), int(c.geom2)} & geoms and thing in (c.geom1, c.geom2) and c.dist < 0 for c in data.contact)
        if data.time >= next_s - MUJOCO_S / 2:
            poses.append(np.concatenate((data.body("o").xpos, data.body("o").xquat)))
            next_s += STEP_S
    return {"outcome": outcome(touched, poses[-1][:3], data.body("palm").xpos), "poses": np.array(poses)}
