"""How far two runs of a simulated robot come apart that differ by a nudge: what no prediction from poses can do better than.

    python -m rigidformer_lab.research.sensitivity humanoid --seeds 60
    python -m rigidformer_lab.research.sensitivity g1 FOLDER --seeds 60

Each seed is run twice under the same commands. In the second run each joint turns by a random angle at the last observed frame, by
default .001 rad, and keeps its rate. Printed is what `rigidformer evaluate` prints of a prediction: position error in metres and
orientation error in degrees, RMS over parts, mean over runs, and the median over them. Runs in which the robot falls are left out.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from .. import g1, humanoid
from ..geometry import quaternion_to_matrix
from ..robots import WARM_UP_FRAMES, FolderError, Nudge, Robot

ROBOTS = {"g1": g1, "humanoid": humanoid}
OBSERVED = 10  # the last frame that a model sees
FRAMES = (20, 50, 100)


def errors(robot: Robot, seed: int, angle_rad: float) -> np.ndarray | None:
    """(len(FRAMES), 2) metres and degrees between a run and the same one, nudged; None if the robot fell."""
    frames = WARM_UP_FRAMES + max(FRAMES) + 1
    runs = []
    for nudge in (None, Nudge(WARM_UP_FRAMES + OBSERVED, angle_rad, seed)):
        run = robot.run(np.random.default_rng((seed, robot.draws, 0)), frames, nudge)
        if run is None:
            return None
        runs.append(run[0][:, WARM_UP_FRAMES:])
    rows = []
    for frame in FRAMES:
        one, other = (run[:, frame] for run in runs)
        apart = np.square(one[:, :3] - other[:, :3]).sum(-1).mean()
        turns = [quaternion_to_matrix(poses[:, 3:]) for poses in (one, other)]
        cos = (np.einsum("kij,kij->k", *turns) - 1) / 2
        rows.append((np.sqrt(apart), np.degrees(np.sqrt(np.square(np.arccos(np.clip(cos, -1, 1))).mean()))))
    return np.array(rows)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m rigidformer_lab.research.sensitivity", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robot", choices=ROBOTS)
    parser.add_argument("folder", type=Path, nargs="?", help="folder that the robot is made from; humanoid needs none")
    parser.add_argument("--seeds", type=int, default=60, help="number of runs (default %(default)s)")
    parser.add_argument("--first-seed", type=int, default=100001, help="default %(default)s")
    parser.add_argument("--angle", type=float, default=0.001, help="rad (default %(default)s)")
    options = parser.parse_args(arguments)
    if options.seeds < 1 or not 0 <= options.angle < 1:
        parser.error("--seeds takes 1 or more, --angle 0 to 1 rad")
    if options.folder is None and options.robot == "g1":
        parser.error("g1: give the folder that it is made from; `python -m rigidformer_lab.g1 --help` says what is in it")
    try:
        robot = ROBOTS[options.robot].load(options.folder and options.folder.resolve())
    except FolderError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    found = [row for seed in seeds if (row := errors(robot, seed, options.angle)) is not None]
    if not found:
        print("error: the robot fell in every run; give another --first-seed, or a smaller --angle", file=sys.stderr)
        return 1
    print(f"{options.robot}, {len(found)} runs, joints turned by {options.angle:g} rad at frame {OBSERVED}: mean (median)")
    for frame, mean, median in zip(FRAMES, np.mean(found, 0), np.median(found, 0)):
        print(f"frame {frame:3}: {mean[0]:.3f} ({median[0]:.3f}) m, {mean[1]:.2f} ({median[1]:.2f}) deg")
    return 0


if __name__ == "__main__":
    sys.exit(main())
