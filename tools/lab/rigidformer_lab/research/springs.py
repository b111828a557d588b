"""Rolls cube tosses out with a spring and a damper at each corner, as a compliant engine would: how much of an error is due
to contact that the impulses take as rigid.

    python -m rigidformer_lab.research.springs tosses-300.safetensors --split 0 --stiffness 2500 --dissipation 4

A corner at depth d pushes with k d (1 - c d') newtons (Hunt and Crossley), and rubs with the scene's friction. The scene's
restitution is not used: k and c decide how much a corner bounces. Scenes have one free unit over one plane, and velocities.
Errors are those of `impulses_alone` on such files: means over frames, then over scenes.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ..scenes import Scenes, read_scenes

SLIPS_M_S = 0.01  # slower corners stick


def rollout(scenes: Scenes, which: np.ndarray, stiffness: float, dissipation: float, step_s: float):
    """Poses at the record's frames, (scenes, frames, 7): position, quaternion w x y z."""
    first = np.array([scenes.units_of_scene(s).start for s in which])
    corners = np.stack([_corners(scenes, unit) for unit in first])
    mass = scenes.unit_physics[first, 0].astype(float)
    inertia = scenes.inertias[first].astype(float)[:, :1]
    planes = np.stack([scenes.planes_of_scene(s)[0] for s in which]).astype(float)
    friction = (planes[:, 4] * scenes.unit_physics[first, 1])[:, None]
    centre, turn = scenes.unit_poses[first, 0, :3].astype(float), Rotation.from_quat(scenes.unit_poses[first, 0, 3:], scalar_first=True)
    velocity, spin = scenes.unit_velocity[first, :3].astype(float), scenes.unit_velocity[first, 3:].astype(float)
    gravity = np.array(scenes.gravity_m_s2)
    frames, out, frame, step = scenes.frames, [], 0, 0
    while frame < frames:
        if step * step_s >= frame / scenes.frame_rate_hz - 1e-9:
            out.append(np.concatenate([centre, turn.as_quat(scalar_first=True)], 1))
            frame += 1
            continue
        arms = np.einsum("nij,nkj->nki", turn.as_matrix(), corners)
        depth = np.maximum(-(centre[:, None, 2] + arms[..., 2]), 0)
        moves = velocity[:, None] + np.cross(spin[:, None], arms)
        push = np.maximum(stiffness * depth * (1 - dissipation * moves[..., 2]), 0)
        slide = moves[..., :2]
        speed = np.linalg.norm(slide, axis=-1) + 1e-9
        rub = -(friction * push * np.minimum(speed / SLIPS_M_S, 1) / speed)[..., None] * slide
        force = np.concatenate([rub, push[..., None]], -1)
        velocity = velocity + step_s * (force.sum(1) / mass[:, None] + gravity)
        spin = spin + step_s * np.cross(arms, force).sum(1) / inertia
        centre, turn = centre + step_s * velocity, Rotation.from_rotvec(step_s * spin) * turn
        step += 1
    return np.stack(out, 1)


def _corners(scenes: Scenes, unit: int) -> np.ndarray:
    points = scenes.points_of_shape(scenes.unit_shape[unit]) * scenes.unit_scale[unit]
    low, high = points.min(0), points.max(0)
    return np.array([[high[axis] if corner >> axis & 1 else low[axis] for axis in range(3)] for corner in range(8)], float)


def errors(scenes: Scenes, which: np.ndarray, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Metres and degrees of each scene, means over all frames after frame 0."""
    metres, degrees = [], []
    for path, scene in zip(poses, which):
        frames = slice(1, scenes.frames_of_scene(scene))
        record = scenes.unit_poses[scenes.units_of_scene(scene).start, frames].astype(float)
        metres.append(np.linalg.norm(path[frames, :3] - record[:, :3], axis=1).mean())
        agree = np.abs((path[frames, 3:] * record[:, 3:]).sum(1)).clip(0, 1)
        degrees.append(np.degrees(2 * np.arccos(agree)).mean())
    return np.array(metres), np.array(degrees)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, help="scene file of `tosses`")
    parser.add_argument("--split", type=int, default=0, help="0 train, 1 validation, 2 test [default: 0]")
    parser.add_argument("--stiffness", type=float, nargs="+", default=[2500.0], metavar="N/M", help="of a corner, N/m")
    parser.add_argument("--dissipation", type=float, nargs="+", default=[4.0], metavar="S/M", help="of a corner, s/m")
    parser.add_argument("--step", type=float, default=2e-4, metavar="S", help="of the integration, seconds [default: 0.0002]")
    given = parser.parse_args(arguments)
    scenes = read_scenes(given.file)
    which = scenes.scenes_of_split(given.split)
    if scenes.unit_velocity is None or not len(which) or scenes.units != scenes.scenes:
        parser.error(f"{given.file}: needs scenes of one unit, with velocities, in split {given.split}; "
                     "`python -m rigidformer_lab.tosses FOLDER --train 300 --out FILE` makes such a file")
    for stiffness in given.stiffness:
        for dissipation in given.dissipation:
            poses = rollout(scenes, which, stiffness, dissipation, given.step)
            metres, degrees = errors(scenes, which, poses)
            print(f"{stiffness:g} N/m, {dissipation:g} s/m: {metres.mean():.4f} m, {degrees.mean():.1f} degrees; "
                  f"{(degrees > 45).mean():.3f} of {len(which)} tosses above 45 degrees", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
