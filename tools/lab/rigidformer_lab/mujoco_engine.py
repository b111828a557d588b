"""Records scenes of `contacts` with MuJoCo: another law of contact than PyBullet's. Contact is soft, and friction has an elliptic cone."""

from __future__ import annotations

import math

import numpy as np

from .movi import FRAME_RATE_HZ, GRAVITY_M_S2, PRIMITIVE_SUB_STEPS
from .roles import FREE

#: Time constant of a contact, seconds: MuJoCo takes no less than two time steps, and has .02 by default.
TIME_CONSTANT_S = 0.005
#: Least restitution of a pair: the damping ratio of 0 is infinite. What MuJoCo's own softness changes is not counted.
LEAST_RESTITUTION = 0.02
MARGIN_M = 1e-3


def restitution_of(ratio: float) -> float:
    """What a spring and a damper of a damping ratio leave of the speed; they push alone, so contact ends where they would pull."""
    if ratio < 1:
        root = math.sqrt(1 - ratio**2)
        return math.exp(-ratio / root * (math.pi - math.atan2(2 * ratio * root, 1 - 2 * ratio**2)))
    if ratio == 1:
        return math.exp(-2)
    root = math.sqrt(ratio**2 - 1)
    return math.exp(-ratio / root * math.log((ratio + root) / (ratio - root)))


def damping_ratio(restitution: float) -> float:
    """That which leaves so much of the speed."""
    low, high = 1e-4, 10.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if restitution_of(middle) > max(restitution, LEAST_RESTITUTION) else (low, middle)
    return high


def _geom(name, shape, scale):
    size = [scale * length for length in shape.size]
    kind = {3: "box", 2: "cylinder", 1: "sphere"}[len(size)]
    if kind == "cylinder":
        size[1] /= 2  # MuJoCo's is half of the height
    return f'<geom name="{name}" type="{kind}" size="{" ".join(f"{length:.9g}" for length in size)}"/>'


def scene_xml(shapes, bodies, planes) -> str:
    """The scene as MJCF: bodies where they are put, and a pair of geoms for each two that may touch."""
    plain, pairs = [], []
    text = lambda numbers: " ".join(f"{v:.9g}" for v in numbers)  # noqa: E731
    for k, plane in enumerate(planes):
        normal = np.asarray(plane[:3])
        plain.append(f'<geom name="p{k}" type="plane" size="50 50 1" pos="{text(normal * plane[3])}" zaxis="{text(normal)}"/>')
    for k, body in enumerate(bodies):
        part = body.parts[0]
        inner = _geom(f"g{k}", shapes[part.shape], part.scale)
        if body.role == FREE:
            inner = f'<freejoint/><inertial pos="0 0 0" mass="{part.mass:.9g}" diaginertia="{text(body.inertia)}"/>' + inner
        plain.append(f'<body name="b{k}" pos="{text(body.place)}" quat="{text(body.turn)}">{inner}</body>')

    def pair(a, b, friction, restitution):
        solref = f"{TIME_CONSTANT_S} {damping_ratio(restitution):.6g}"
        pairs.append(f'<pair geom1="{a}" geom2="{b}" condim="3" friction="{friction:.9g} {friction:.9g} 0 0 0" solref="{solref}" '
                     f'margin="{MARGIN_M}"/>')

    for k, body in enumerate(bodies):
        for n, plane in enumerate(planes):
            if body.role == FREE:
                pair(f"p{n}", f"g{k}", body.friction * plane[4], body.restitution * plane[5])
        for j, other in enumerate(bodies[:k]):
            if FREE in (body.role, other.role):
                pair(f"g{j}", f"g{k}", body.friction * other.friction, body.restitution * other.restitution)
    step = 1.0 / (FRAME_RATE_HZ * PRIMITIVE_SUB_STEPS)
    return (
        f'<mujoco><option timestep="{step:.9g}" gravity="{text(GRAVITY_M_S2)}" cone="elliptic" impratio="10"/>'
        '<default><geom contype="0" conaffinity="0"/></default>'
        f"<worldbody>{''.join(plain)}</worldbody><contact>{''.join(pairs)}</contact></mujoco>"
    )


def record(shapes, stage, frames: int) -> np.ndarray:
    """Poses (units, frames, 7) of a stage that has not begun to move, without driven bodies."""
    import mujoco

    bodies = stage.bodies
    model = mujoco.MjModel.from_xml_string(scene_xml(shapes, bodies, stage.planes))
    data = mujoco.MjData(model)
    for k, body in enumerate(bodies):
        if body.role == FREE:
            velocity, spin = stage.pb.getBaseVelocity(body.number, **stage.on)
            first = model.jnt_dofadr[model.body_jntadr[model.body(f"b{k}").id]]
            data.qvel[first : first + 3] = velocity
            rotation = np.zeros(9)
            mujoco.mju_quat2Mat(rotation, np.asarray(body.turn, float))
            data.qvel[first + 3 : first + 6] = rotation.reshape(3, 3).T @ np.asarray(spin)  # MuJoCo's is in the body's frame
    mujoco.mj_forward(model, data)
    poses = np.empty((len(bodies), frames, 7))
    for frame in range(frames):
        for k, body in enumerate(bodies):
            here = data.body(f"b{k}")
            poses[k, frame] = (*here.xpos, *here.xquat)
        for _ in range(PRIMITIVE_SUB_STEPS if frame + 1 < frames else 0):
            mujoco.mj_step(model, data)
    return poses
