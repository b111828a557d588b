"""Makes a scene file of recorded cube tosses: a real cube, thrown onto a table and seen by motion capture.

    python -m rigidformer_lab.tosses FOLDER --out cube-tosses.safetensors

FOLDER holds `cube_tosses.npz`: arrays `index` (tosses, the published numbers), `frames` (tosses, rows of each) and `state`
(rows, 13): quaternion w, x, y, z, position in metres, angular velocity in the body frame in rad/s, velocity in m/s. The
tosses are those of the DAIR Lab, University of Pennsylvania (repository DAIRLab/dair_pll, assets; BSD-3-Clause), recorded
at 148 Hz.

The file has one scene a toss, with the published number as its seed. All tosses are of the split test. `--train N` makes the
first N train, in the order of `numpy.random.default_rng(2110).permutation` over the tosses sorted by number. `--validation M`
takes the last M of these N for choices instead, so that none is made on the test tosses.

The cube's inertia is the published one. Lengths are as published: 2.2 % short, which the published errors of engines are too. A recorded velocity is the way since
the frame before, so it is that of half a frame earlier; `unit_velocity` has half a frame of gravity more.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from .movi import _offsets, _rotation
from .npz import arrays_of
from .scenes import TEST, TRAIN, VALIDATION, Scenes, SceneFileError, write_scenes

DATASET = "cube-tosses"
FILE = "cube_tosses.npz"
FRAME_RATE_HZ = 148.0
GRAVITY_M_S2 = (0.0, 0.0, -9.81)
EDGE_M, MASS_KG = 0.1048, 0.37
INERTIA_KG_M2 = 8.1e-4  # about every axis, as published; a uniform cube would have 6.8e-4
FRICTION, RESTITUTION = 0.18, 0.125  # of cube and table together: the product of their coefficients
ORDER_SEED = 2110
SOURCE = ("Recorded by the DAIR Lab, University of Pennsylvania: the cube tosses of ContactNets, from the assets of "
          "github.com/DAIRLab/dair_pll. Converted by rigidformer_lab.tosses; lengths as published.")
LICENCE = "BSD-3-Clause, Copyright (c) 2022, Dynamic Autonomy and Intelligent Robotics Lab. All rights reserved."


class TossError(ValueError):
    """The recorded tosses cannot be used."""


def box_points(half_m) -> np.ndarray:
    """(64, 3) points on a box of these half edges, its 8 corners among them, about its centre: the 56 outer points of a
    4 x 4 x 4 grid, and the middles of the four edges and of the four faces about z."""
    grid = np.array(np.meshgrid(*[np.linspace(-1, 1, 4)] * 3, indexing="ij")).reshape(3, -1).T
    grid = grid[np.abs(grid).max(axis=1) == 1]
    more = [(x, y, 0) for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y]
    return (np.concatenate([grid, more]) * half_m).astype(np.float32)


def cube_points() -> np.ndarray:
    return box_points(EDGE_M / 2)


def read_tosses(folder: Path, name: str = FILE, width: int = 13) -> tuple[np.ndarray, list[np.ndarray]]:
    """Published numbers, ascending, and the rows of each toss, (frames, width) float64, which begin with a quaternion."""
    path = Path(folder) / name

    def fail(problem: str):
        raise TossError(f"{path}: {problem}; give the folder that holds {name} as recorded, of the "
                        "tosses in github.com/DAIRLab/dair_pll (--help says what is in it)")

    index, frames, state = arrays_of(path, ("index", "frames", "state"), fail).values()
    if index.ndim != 1 or frames.shape != index.shape or not len(index):
        fail(f"index has shape {index.shape} and frames {frames.shape}, not one number a toss")
    for what, array in (("index", index), ("frames", frames)):
        if array.dtype.kind not in "iu":
            fail(f"{what} is {array.dtype}, not whole numbers")
    if len(set(index.tolist())) != len(index):
        fail("index names a toss twice")
    if frames.min() < 2:
        fail(f"frames gives toss {index[frames.argmin()]} {frames.min()} rows, fewer than 2")
    if state.ndim != 2 or state.shape != (int(frames.sum(dtype=np.int64)), width) or state.dtype.kind != "f":
        fail(f"state is {state.dtype} of shape {state.shape}, not floats of {frames.sum()} rows, as frames says, of {width}")
    state = state.astype(np.float64)
    bad = ~np.isfinite(state).all(1)
    bad |= np.abs(np.linalg.norm(state[:, :4], axis=1) - 1) > 1e-3
    if bad.any():
        fail(f"state row {np.flatnonzero(bad)[0]} is not finite, or its quaternion is not of length 1")
    rows = np.split(state, np.cumsum(frames)[:-1])
    order = np.argsort(index)
    return index[order].astype(np.int64), [rows[k] for k in order]


def split_of_tosses(count: int, train: int, validation: int = 0) -> np.ndarray:
    """(count) TRAIN for `train` of the tosses, of which the last `validation` are VALIDATION, and TEST for the others."""
    if not 0 <= train <= count:
        raise TossError(f"--train {train}: there are {count} tosses; give a number from 0 to {count}")
    if not 0 <= validation <= train:
        raise TossError(f"--validation {validation}: it is a part of the {train} of --train; give a number from 0 to {train}")
    split = np.full(count, TEST, np.uint8)
    order = np.random.default_rng(ORDER_SEED).permutation(count)
    split[order[:train]] = TRAIN
    split[order[train - validation : train]] = VALIDATION
    return split


def licence_of(folder: Path) -> str:
    text = Path(folder) / "LICENSE.txt"
    return f"{LICENCE}\n\n{text.read_text()}" if text.is_file() else LICENCE


def make(folder: Path, train: int = 0, validation: int = 0) -> Scenes:
    """The scenes of all tosses, `train` of them to learn from, of which `validation` are to choose by."""
    index, tosses = read_tosses(folder)
    count = len(index)
    split = split_of_tosses(count, train, validation)
    longest = max(len(rows) for rows in tosses)
    poses = np.empty((count, longest, 7))
    velocity = np.empty((count, 6))
    for toss, rows in enumerate(tosses):
        quaternion = rows[:, :4] / np.linalg.norm(rows[:, :4], axis=1, keepdims=True)
        flips = np.einsum("fk,fk->f", quaternion[1:], quaternion[:-1]) < 0
        quaternion[1:] *= np.where(np.cumsum(flips) % 2, -1.0, 1.0)[:, None]
        poses[toss, : len(rows)] = np.concatenate([rows[:, 4:7], quaternion], axis=1)
        poses[toss, len(rows) :] = poses[toss, len(rows) - 1]
        velocity[toss, :3] = rows[0, 10:] + np.array(GRAVITY_M_S2) / (2 * FRAME_RATE_HZ)
        velocity[toss, 3:] = _rotation(*quaternion[0]) @ rows[0, 7:10]
    alone = np.sqrt([FRICTION, RESTITUTION])  # the same for cube and table
    points = cube_points()
    return Scenes(
        dataset=DATASET,
        shape_names=["cube"],
        shape_points=points,
        shape_offsets=_offsets([len(points)]),
        scene_seed=index,
        scene_split=split,
        scene_units=np.arange(count + 1, dtype=np.int64),
        unit_shape=np.zeros(count, np.int32),
        unit_scale=np.ones(count, np.float32),
        unit_physics=np.tile(np.array([MASS_KG, *alone], np.float32), (count, 1)),
        unit_poses=poses.astype(np.float32),
        provenance=SOURCE,
        licence=licence_of(folder),
        frame_rate_hz=FRAME_RATE_HZ,
        gravity_m_s2=GRAVITY_M_S2,
        ground_friction=None,
        ground_restitution=None,
        planes=np.tile(np.array([0, 0, 1, 0, *alone], np.float32), (count, 1)),
        scene_planes=np.arange(count + 1, dtype=np.int64),
        scene_frames=np.array([len(rows) for rows in tosses], np.int64),
        unit_velocity=velocity.astype(np.float32),
        unit_inertia=np.full((count, 3), INERTIA_KG_M2, np.float32),
    )


def write_tosses(out: Path, make) -> int:
    """Writes the scenes that `make` gives, and says how many; the exit code."""
    try:
        scenes = make()
        write_scenes(out, scenes)
    except (TossError, SceneFileError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    frames = scenes.scene_frames
    print(f"{out}: {scenes.scenes} tosses of {frames.min()} to {frames.max()} frames, "
          f"{(scenes.scene_split == TRAIN).sum()} to learn from, {out.stat().st_size} bytes")
    return 0


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m rigidformer_lab.tosses", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help=f"folder that holds {FILE}")
    parser.add_argument("--out", type=Path, required=True, help="scene file to make")
    parser.add_argument("--train", type=int, default=0, help="so many tosses are of the split train (default: none)")
    parser.add_argument("--validation", type=int, default=0, help="so many of those are of the split validation (default: none)")
    options = parser.parse_args(arguments)
    return write_tosses(options.out, lambda: make(options.folder, options.train, options.validation))


if __name__ == "__main__":
    sys.exit(main())
