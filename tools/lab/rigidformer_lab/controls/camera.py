"""Where the videos are seen from."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

#: Share of the picture's half size that the motion may take.
FILL = 0.90
#: A camera that is fitted is no nearer than this, metres.
NEAREST_M = 0.3
#: Rounds of moving the camera. Each is nearly exact.
ROUNDS = 12


@dataclasses.dataclass
class Camera:
    """A pinhole camera."""

    size: tuple[int, int]
    focal: float  # pixels
    eye: np.ndarray  # (3) metres
    axes: np.ndarray  # rows: right, down, forward

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Points (N, 3) of the world along the camera's axes."""
        return (points - self.eye) @ self.axes.T

    def places(self, seen: np.ndarray, near_m: float) -> np.ndarray:
        """Pixels (..., 2) from the left and upper edges of what `seen` gives. What is nearer than near_m counts as being there."""
        middle = np.array(self.size) / 2
        return self.focal * seen[..., :2] / np.maximum(seen[..., 2:3], near_m) + middle


def focal_of(size: tuple[int, int], view_rad: float) -> float:
    """Focal length, pixels, of an angle of view along the longer side."""
    return max(size) / 2 / math.tan(view_rad / 2)


def along(forward: np.ndarray) -> np.ndarray | None:
    """The axes of a camera that looks this way; None where there is no direction."""
    length = np.linalg.norm(forward)
    if not length > 1e-6:
        return None
    forward = forward / length
    right = np.cross(forward, [0.0, 0.0, 1.0])
    # Straight up or down, x is on the right.
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-4 else np.array([1.0, 0.0, 0.0])
    return np.array([right, np.cross(forward, right), forward])


def middle(points: np.ndarray) -> np.ndarray:
    """The middle of the box around points."""
    return (points.min(0).astype(np.float64) + points.max(0)) / 2


def fit(points: np.ndarray, azimuth: float, elevation: float, size: tuple[int, int], view_rad: float) -> Camera:
    """Looks from an azimuth and an elevation, radians, at all points (N, 3), as near as shows them."""
    level = math.cos(elevation)
    axes = along(-np.array([math.cos(azimuth) * level, math.sin(azimuth) * level, math.sin(elevation)]))
    focal = focal_of(size, view_rad)
    half = FILL * np.array(size) / 2 / focal
    target = middle(points)
    for _ in range(ROUNDS):
        offset = (points - target) @ axes.T
        away = max(NEAREST_M, float((np.abs(offset[:, :2]) / half - offset[:, 2:]).max()))
        slope = offset[:, :2] / (offset[:, 2:] + away)
        target = target + (slope.min(0) + slope.max(0)) / 2 * away * 0.9 @ axes[:2]
    return Camera(size, focal, target - axes[2] * away, axes)


def between(eye: np.ndarray, target: np.ndarray, size: tuple[int, int], view_rad: float) -> Camera | None:
    """Looks from one place to another; None where they are one."""
    axes = along(np.asarray(target, float) - eye)
    return None if axes is None else Camera(size, focal_of(size, view_rad), np.asarray(eye, float), axes)
