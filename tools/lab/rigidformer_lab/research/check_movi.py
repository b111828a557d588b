"""Checks regenerated MOVi files: the number of instances, and the free-fall baseline on the test split.

    python -m rigidformer_lab.research.check_movi movi-sphere.safetensors movi-a.safetensors movi-b.safetensors

Errors follow HopNet's protocol. Per scene and frame: position error = sqrt(mean over objects of |p - p*|^2);
orientation error = 2 asin(|vector part of q^-1 q*|), RMS over objects; then the mean over the test scenes. HopNet's own
script takes the mean over objects for orientation: printed too, for reading beside its tables.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from ..scenes import MOVI_SEEDS, TEST, Scenes, SceneFileError, read_scenes

READ_FRAMES = (50, 75, 100)
START_FRAMES = (2, 3)
# units over seeds 1 to 1200, and free-fall errors (position m, orientation degrees) at READ_FRAMES
EXPECTED = {
    "movi-a": (7810, ((0.082, 5.30), (0.188, 11.31), (0.330, 17.69))),
    "movi-b": (7764, ((0.069, 4.27), (0.150, 9.09), (0.270, 16.33))),
    "movi-sphere": (7810, ((0.085, 3.89), (0.194, 7.91), (0.343, 13.31))),
}


def multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Quaternion product, (w, x, y, z) in the last axis."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack([
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ], axis=-1)


def conjugate(q: np.ndarray) -> np.ndarray:
    return q * [1.0, -1.0, -1.0, -1.0]


def free_fall(poses: np.ndarray, first: int, last_frame: int, gravity: np.ndarray, dt: float) -> np.ndarray:
    """Poses (units, frames, 7) for frames first.. to last_frame; constant spin, Verlet fall, from two frames.

    Entry i of the result is frame `first + i`; the first two are copies.
    """
    result = [poses[:, first], poses[:, first + 1]]
    spin = multiply(poses[:, first + 1, 3:], conjugate(poses[:, first, 3:]))
    while len(result) <= last_frame - first:
        position = 2 * result[-1][:, :3] - result[-2][:, :3] + gravity * dt * dt
        rotation = multiply(spin, result[-1][:, 3:])
        rotation /= np.linalg.norm(rotation, axis=-1, keepdims=True)
        result.append(np.concatenate([position, rotation], axis=1))
    return np.stack(result, axis=1)


def scene_errors(predicted: np.ndarray, truth: np.ndarray) -> tuple[float, float, float]:
    """Of one scene and frame, poses (units, 7): position RMSE m, orientation RMS and mean over objects, degrees."""
    position = np.sqrt(np.mean(np.sum((predicted[:, :3] - truth[:, :3]) ** 2, axis=1)))
    vector = multiply(conjugate(predicted[:, 3:]), truth[:, 3:])[:, 1:]
    angle = np.degrees(2 * np.arcsin(np.minimum(np.linalg.norm(vector, axis=1), 1.0)))
    return position, np.sqrt(np.mean(angle**2)), np.mean(angle)


def baseline(scenes: Scenes, start: int = START_FRAMES[0]) -> np.ndarray:
    """Free-fall errors, (READ_FRAMES, [position m, orientation RMS degrees, orientation mean degrees])."""
    gravity, dt = np.array(scenes.gravity_m_s2), 1.0 / scenes.frame_rate_hz
    errors = []
    for scene in scenes.scenes_of_split(TEST):
        units = scenes.units_of_scene(scene)
        truth = scenes.unit_poses[units.start : units.stop, : READ_FRAMES[-1] + 1].astype(np.float64)
        predicted = free_fall(truth, start, READ_FRAMES[-1], gravity, dt)
        errors.append([scene_errors(predicted[:, frame - start], truth[:, frame]) for frame in READ_FRAMES])
    return np.mean(errors, axis=0)


def check(path: Path) -> bool:
    scenes = read_scenes(path)
    if scenes.dataset not in EXPECTED:
        raise SceneFileError(path, "metadata dataset", f"is {scenes.dataset!r}; nothing is published for it",
                             f"give a file of {', '.join(EXPECTED)}")
    if scenes.frames <= READ_FRAMES[-1] or not np.array_equal(scenes.scene_seed, np.arange(1, MOVI_SEEDS + 1)):
        raise SceneFileError(path, "scene_seed", f"holds {scenes.scenes} scenes of {scenes.frames} frames, not seeds 1 "
                             f"to {MOVI_SEEDS} with more than {READ_FRAMES[-1]} frames", "make the whole set")
    instances, expected = EXPECTED[scenes.dataset]
    good = scenes.units == instances
    tests = scenes.scenes_of_split(TEST)
    print(f"{scenes.dataset}: {scenes.units} instances over seeds 1-{MOVI_SEEDS} (expected {instances}) "
          f"{'ok' if good else 'DIFFERS'}; {len(tests)} test scenes, {scenes.frames} frames")
    print(f"  free fall from frames {START_FRAMES[0]} and {START_FRAMES[1]}, constant spin; position RMSE m, orientation "
          "RMS deg [mean over objects deg]")
    for frame, (position, rms, mean), (want_position, want_rms) in zip(READ_FRAMES, baseline(scenes), expected):
        same = f"{position:.3f}/{rms:.2f}" == f"{want_position:.3f}/{want_rms:.2f}"
        good &= same
        print(f"  frame {frame:3d}: {position:.3f}/{rms:.2f} [{mean:.2f}]  expected {want_position:.3f}/{want_rms:.2f}  "
              f"{'ok' if same else 'DIFFERS'}")
    return good


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m rigidformer_lab.research.check_movi", description=__doc__.splitlines()[0])
    parser.add_argument("files", type=Path, nargs="+", help="MOVi scene files, seeds 1 to 1200")
    options = parser.parse_args(arguments)
    try:
        return 0 if all([check(path) for path in options.files]) else 1
    except SceneFileError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
