"""Where the units of a scene are at any time, recorded or predicted."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..roles import OWN_BODY
from ..scenes import Scenes

#: A time so near to a sample is that sample's, in samples.
ROUNDING = 1e-4


@dataclasses.dataclass
class Record:
    """One scene of a file. M units, F frames, W points of soft units."""

    name: str
    rate_hz: float
    points: list[np.ndarray]  # (M) of (points, 3) in the unit's frame, metres
    pieces: list[list[np.ndarray]]  # (M) convex pieces, none: the hull of the points
    role: np.ndarray  # (M)
    body: np.ndarray  # (M), -1: a body of its own
    soft: np.ndarray  # (M) bool
    poses: np.ndarray  # (F, M, 7)
    soft_points: np.ndarray  # (F, W, 3) in the world
    faces: np.ndarray  # (T, 3) rows of the soft points
    planes: np.ndarray  # (L, 6)
    velocity: np.ndarray | None  # (M, 6) at frame 0
    gravity: np.ndarray  # (3)
    commanded: bool

    @property
    def frames(self) -> int:
        return len(self.poses)


def record(scenes: Scenes, index: int) -> Record:
    """The scene with this number."""
    units, frames = scenes.units_of_scene(index), scenes.frames_of_scene(index)
    own = slice(units.start, units.stop)
    first, last = scenes.soft_offsets[units.start], scenes.soft_offsets[units.stop]
    soft_points = np.zeros((frames, 0, 3), np.float32)
    if scenes.soft_points is not None:
        soft_points = scenes.soft_points[first:last, :frames].swapaxes(0, 1)
    scale = scenes.unit_scale
    return Record(
        name=f"{scenes.dataset} seed {scenes.scene_seed[index]}",
        rate_hz=scenes.frame_rate_hz,
        points=[scenes.points_of_shape(scenes.unit_shape[unit]) * scale[unit] for unit in units],
        pieces=[[piece * scale[unit] for piece in scenes.pieces_of_shape(scenes.unit_shape[unit])] for unit in units],
        role=scenes.roles[own],
        body=scenes.bodies[own],
        soft=np.zeros(len(units), bool) if scenes.unit_soft is None else scenes.unit_soft[own] > 0,
        poses=scenes.unit_poses[own, :frames].swapaxes(0, 1),
        soft_points=soft_points,
        faces=scenes.faces_of_scene(index).astype(np.int64) - first,
        planes=scenes.planes_of_scene(index).astype(np.float64),
        velocity=None if scenes.unit_velocity is None else scenes.unit_velocity[own],
        gravity=np.asarray(scenes.gravity_m_s2, np.float64),
        commanded=scenes.commands is not None,
    )  # fmt: skip


@dataclasses.dataclass
class Motion:
    """Samples of a motion, evenly spaced from time 0 on."""

    poses: np.ndarray  # (samples, M, 7)
    soft_points: np.ndarray  # (samples, W, 3)
    rate_hz: float  # of samples

    @property
    def duration_s(self) -> float:
        return (len(self.poses) - 1) / self.rate_hz

    def at(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Poses (M, 7) and soft points (W, 3) at a time within the motion; between samples on the way from one to the next."""
        at = min(max(time_s * self.rate_hz, 0.0), len(self.poses) - 1.0)
        at = round(at) if abs(at - round(at)) < ROUNDING else at
        before, share = int(at), at - int(at)
        if share == 0.0:
            return self.poses[before].astype(np.float64), self.soft_points[before].astype(np.float64)
        poses = between(self.poses[before].astype(np.float64), self.poses[before + 1].astype(np.float64), share)
        a, b = self.soft_points[before].astype(np.float64), self.soft_points[before + 1].astype(np.float64)
        return poses, a + (b - a) * share


def between(a: np.ndarray, b: np.ndarray, share: float) -> np.ndarray:
    """Poses (M, 7) at a share of the way from some to others: places on straight lines, turns at constant rates, the shorter way."""
    place = a[:, :3] + (b[:, :3] - a[:, :3]) * share
    p, q = a[:, 3:], b[:, 3:]
    cosine = (p * q).sum(-1, keepdims=True)
    q, cosine = np.where(cosine < 0, -q, q), np.abs(cosine).clip(max=1.0)
    angle = np.arccos(cosine)
    sine = np.sin(angle)
    small = sine < 1e-6
    sine = np.where(small, 1.0, sine)
    near, far = np.sin((1 - share) * angle) / sine, np.sin(share * angle) / sine
    return np.hstack((place, np.where(small, p, near * p + far * q)))


def matrices(poses: np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) of poses (..., 7)."""
    w, x, y, z = np.moveaxis(poses[..., 3:] / np.linalg.norm(poses[..., 3:], axis=-1, keepdims=True), -1, 0)
    rows = (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z), 1 - 2 * (x * x + z * z),
            2 * (y * z - w * x), 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))  # fmt: skip
    return np.stack(rows, -1).reshape(*poses.shape[:-1], 3, 3)


def alone(body: np.ndarray) -> np.ndarray:
    """Numbers of bodies (M), where a unit that is a body of its own has a number that no other unit has."""
    return np.where(body == OWN_BODY, -1 - np.arange(len(body)), body)
