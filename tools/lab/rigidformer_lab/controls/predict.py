"""What a packed model makes of a scene, by the package `rigidformer`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .errors import Failure, Usage
from .motion import Motion, Record

#: Frame to which a toss is looked at for the pivots of its bodies.
JOIN_FRAME = 10


def package():
    """The package `rigidformer`."""
    try:
        import rigidformer
    except ImportError as error:
        raise Failure(
            f"a prediction needs the package rigidformer ({error}); run `python -m pip install ./bindings/python` in the repository's "
            "root, or give --recorded"
        ) from error
    return rigidformer


def predicted(path: Path, index: int, record: Record, model: Path | None, step: int, join: bool) -> tuple[Motion, str]:
    """The predicted motion, and what it is."""
    rigidformer = package()
    try:
        loaded = rigidformer.Model("edge" if model is None else model)
        scene = rigidformer.Dataset(path).scene(index)
        what = f"predicted by {loaded.name}, step {step}"
        if record.velocity is not None:
            return open_loop(rigidformer, loaded, scene, record, step, join), what
        needed, last = 2 * step, record.frames - 1
        if needed > last:
            raise Usage(
                f"--step {step}: the first prediction is frame {needed}, and {record.name} has {record.frames} frames; give a smaller "
                "step, or --recorded"
            )
        found = rigidformer.rollout(loaded, scene, step, last - last % step, join=join)
    except rigidformer.RigidFormerError as error:
        raise Failure(str(error)) from error
    soft = np.zeros((len(found), 0, 3), np.float32) if found.points is None else found.points
    return Motion(found.poses, soft, record.rate_hz / step), what


def open_loop(rigidformer, model, scene, record: Record, step: int, join: bool) -> Motion:
    """From the poses and velocities of frame 0 alone, in steps of so many of the model's frames, to the end of the record."""
    if record.commanded or (record.role == 1).any():
        raise Failure(
            f"{record.name}: has driven units or commands, which have no value between frames; leave unit_velocity out of the file, to "
            "start from two frames"
        )
    dt_s = step / model.frame_rate_hz
    steps = int(np.ceil((record.frames - 1) / record.rate_hz * (1 - 1e-7) / dt_s))
    current = record.poses[0].astype(np.float64)
    moves = (record.role == 0)[:, None]
    # A pose before it says the velocity: a body that comes from there covers v dt + g dt^2 / 2 in a step.
    way = moves * (record.velocity[:, :3] * dt_s - record.gravity * (0.5 * dt_s * dt_s))
    previous = np.hstack((current[:, :3] - way, turned(current[:, 3:], -dt_s * moves * record.velocity[:, 3:])))
    world = rigidformer.World(model, units=max(64, len(current)), points=max(8192, 2 * sum(map(len, record.points))))
    world.gravity_m_s2, world.contact_law = record.gravity.astype(np.float32), scene.contact_law
    if scene.planes is not None:
        world.planes = scene.planes
    world.observe_poses(dt_s, scene.units, previous.astype(np.float32), current.astype(np.float32))
    for pivot in scene.pivots(min(JOIN_FRAME, record.frames - 1)) if join else ():
        world.join(world.ids[pivot.unit], world.ids[pivot.parent], pivot.pivot, pivot.parent_pivot)
    poses = np.concatenate((record.poses[:1], world.rollout(steps)))
    return Motion(poses, np.zeros((len(poses), 0, 3), np.float32), 1 / dt_s)


def turned(quaternion: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Quaternions (M, 4), w first, turned further by radians (M, 3) about axes of the world."""
    angle = np.linalg.norm(turn, axis=1, keepdims=True)
    axis = turn / np.where(angle > 0, angle, 1)
    w, v = np.cos(angle / 2), np.sin(angle / 2) * axis
    a, b = quaternion[:, :1], quaternion[:, 1:]
    return np.hstack((w * a - (v * b).sum(1, keepdims=True), w * b + a * v + np.cross(v, b)))
