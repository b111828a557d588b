"""Makes a scene file of recorded tosses of two linked boxes: a real elbow, thrown onto a table and seen by motion capture.

    python -m rigidformer_lab.elbow FOLDER --out elbow.safetensors

FOLDER holds `elbow_tosses.npz`: arrays `index` (tosses, the published numbers), `frames` (tosses, rows of each) and `state`
(rows, 15): quaternion w, x, y, z and position in metres of link 1, hinge angle in rad, angular velocity in the frame of
link 1 in rad/s, velocity of link 1 in m/s, hinge rate in rad/s. The tosses are those of the DAIR Lab, University of
Pennsylvania (repository DAIRLab/dair_pll, assets; BSD-3-Clause), recorded at 148 Hz.

The file has one scene a toss, with the published number as its seed. A scene has two units of one body, the boxes of links
1 and 2, each about its own centre: .1 x .05 x .05 m, .37 kg. The hinge turns about y, which both boxes share. Its pivot is
at (-.035, .06, 0) m of the first box and at (-.035, 0, 0) m of the second. The boxes do not collide with each other.

All tosses are of the split test. `--train N` makes N of them train, drawn as `rigidformer_lab.tosses` draws.
`--first-seed K` takes the tosses whose numbers are K or more, `--seeds N` the first N of those; a toss has the same split
with them or without.

The inertia is the published one; friction of boxes and table together is .3. No restitution is published, so that is the
cube's. Lengths are as published. Velocities are recorded as `rigidformer_lab.tosses` says: `unit_velocity` has half a frame
of gravity more. That of the second box follows from the hinge's angle and rate.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from .bullet import steady_signs
from .movi import _offsets, _rotation
from .scenes import Scenes
from .tosses import (FRAME_RATE_HZ, GRAVITY_M_S2, MASS_KG, RESTITUTION, TossError, box_points, licence_of, read_tosses,
                     split_of_tosses, write_tosses)

DATASET = "elbow-tosses"
FILE = "elbow_tosses.npz"
ROW = 15
EDGES_M = (0.1, 0.05, 0.05)
INERTIA_KG_M2 = 6.167e-4  # about every axis, as published; a uniform box has 1.5e-4 and 3.9e-4
FRICTION = 0.3  # of boxes and table together
PIVOT_1_M = np.array([-0.035, 0.06, 0.0])  # in the frame of the first box
PIVOT_2_M = np.array([-0.035, 0.0, 0.0])  # of the second
AXIS = np.array([0.0, 1.0, 0.0])
SOURCE = ("Recorded by the DAIR Lab, University of Pennsylvania: the elbow tosses of ContactNets, from the assets of "
          "github.com/DAIRLab/dair_pll. Converted by rigidformer_lab.elbow; lengths as published.")


def poses_of(rows: np.ndarray) -> np.ndarray:
    """(2, frames, 7) poses of the boxes."""
    poses = np.empty((2, len(rows), 7))
    poses[0, :, :3], poses[0, :, 3:] = rows[:, 4:7], rows[:, :4]
    w, x, y, z = rows[:, :4].T
    cos, sin = np.cos(rows[:, 7] / 2), np.sin(rows[:, 7] / 2)
    poses[1, :, 3:] = np.column_stack([w * cos - y * sin, x * cos - z * sin, w * sin + y * cos, x * sin + z * cos])
    steady_signs(poses)
    for frame in range(len(rows)):
        first, second = _rotation(*poses[0, frame, 3:]), _rotation(*poses[1, frame, 3:])
        poses[1, frame, :3] = poses[0, frame, :3] + first @ PIVOT_1_M - second @ PIVOT_2_M
    return poses


def velocities_of(row: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """(2, 6) velocities of the boxes at the instant of a row, in the world; poses: (2, 7) of it."""
    first, second = (_rotation(*pose[3:]) for pose in poses)
    velocity = row[11:14] + np.array(GRAVITY_M_S2) / (2 * FRAME_RATE_HZ)
    spin = first @ row[8:11]
    spin_2 = spin + first @ AXIS * row[14]
    pivot = velocity + np.cross(spin, first @ PIVOT_1_M)
    return np.array([[*velocity, *spin], [*(pivot - np.cross(spin_2, second @ PIVOT_2_M)), *spin_2]])


def make(folder: Path, train: int = 0, first_seed: int = 0, seeds: int | None = None) -> Scenes:
    """The scenes of the tosses with numbers from `first_seed` on, `seeds` of them or all. `train` of all in the folder
    are to learn from."""
    index, tosses = read_tosses(folder, FILE, ROW)
    split = split_of_tosses(len(index), train)
    taken = np.flatnonzero(index >= first_seed)
    if len(taken) < max(1, seeds or 0):
        raise TossError(f"--first-seed {first_seed}: {len(taken)} tosses have such a number or a higher one, up to "
                        f"{index[-1]}; give a lower one" + (f", or fewer --seeds than {seeds}" if seeds else ""))
    taken = taken[:seeds]
    tosses, count = [tosses[k] for k in taken], len(taken)
    frames = [len(rows) for rows in tosses]
    poses, velocity = np.empty((count, 2, max(frames), 7)), np.empty((count, 2, 6))
    for toss, rows in enumerate(tosses):
        poses[toss, :, : len(rows)] = poses_of(rows)
        poses[toss, :, len(rows) :] = poses[toss, :, len(rows) - 1 : len(rows)]
        velocity[toss] = velocities_of(rows[0], poses[toss, :, 0])
    alone = np.sqrt([FRICTION, RESTITUTION])  # the same for boxes and table
    points = box_points(np.array(EDGES_M) / 2)
    return Scenes(
        dataset=DATASET,
        shape_names=["box"],
        shape_points=points,
        shape_offsets=_offsets([len(points)]),
        scene_seed=index[taken],
        scene_split=split[taken],
        scene_units=_offsets([2] * count),
        unit_shape=np.zeros(2 * count, np.int32),
        unit_scale=np.ones(2 * count, np.float32),
        unit_physics=np.tile(np.array([MASS_KG, *alone], np.float32), (2 * count, 1)),
        unit_poses=poses.reshape(2 * count, -1, 7).astype(np.float32),
        provenance=SOURCE,
        licence=licence_of(folder),
        frame_rate_hz=FRAME_RATE_HZ,
        gravity_m_s2=GRAVITY_M_S2,
        ground_friction=None,
        ground_restitution=None,
        planes=np.tile(np.array([0, 0, 1, 0, *alone], np.float32), (count, 1)),
        scene_planes=np.arange(count + 1, dtype=np.int64),
        scene_frames=np.array(frames, np.int64),
        unit_body=np.zeros(2 * count, np.int32),
        unit_velocity=velocity.reshape(-1, 6).astype(np.float32),
        unit_inertia=np.full((2 * count, 3), INERTIA_KG_M2, np.float32),
    )


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m rigidformer_lab.elbow", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help=f"folder that holds {FILE}")
    parser.add_argument("--out", type=Path, required=True, help="scene file to make")
    parser.add_argument("--train", type=int, default=0, help="so many of all tosses are of the split train (default: none)")
    parser.add_argument("--seeds", type=int, help="number of tosses (default: all)")
    parser.add_argument("--first-seed", type=int, default=0, help="least published number of a toss (default %(default)s)")
    options = parser.parse_args(arguments)
    if options.seeds is not None and options.seeds < 1:
        parser.error("--seeds must be at least 1")
    return write_tosses(options.out, lambda: make(options.folder, options.train, options.first_seed, options.seeds))


if __name__ == "__main__":
    sys.exit(main())
