"""How a G1 follows commands in a model, beside MuJoCo's: pace over ten seconds under one command each.

    python -m rigidformer_lab.research.follow FOLDER --program target/release/rigidformer --model g1.rfm

FOLDER is that of `rigidformer_lab.g1`. For each command a walk is simulated that keeps it from a second before frame 0 on. The
program observes frames 0 and 10 and predicts the rest under the same command (`rigidformer rollout --command`). The pace is
the mean over frames 100 to 300, in the heading of the heaviest part. No walk that a model learns from keeps a command for
longer than 4 s.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from .. import g1, robots
from ..scenes import write_scenes

COMMANDS = ((0.3, 0.0, 0.0), (0.6, 0.0, 0.0), (0.85, 0.0, 0.0), (-0.4, 0.0, 0.0), (0.0, 0.35, 0.0), (0.0, -0.35, 0.0),
            (0.0, 0.0, 0.7), (0.0, 0.0, -0.7), (0.5, 0.0, 0.5), (0.7, 0.2, -0.4), (-0.3, -0.2, 0.6), (0.6, -0.3, 0.8))
FRAMES, FIRST, STEP = 300, 100, 10


def pace(poses: np.ndarray, seconds: float) -> np.ndarray:
    """Mean forward and left speed, m/s, and turn, rad/s, of poses (samples, 7), samples so far apart."""
    yaw = 2 * np.arctan2(poses[:, 6], poses[:, 3])
    turn = (np.diff(yaw) + np.pi) % (2 * np.pi) - np.pi
    way, along = np.diff(poses[:, :2], axis=0), yaw[:-1] + turn / 2
    forward = way[:, 0] * np.cos(along) + way[:, 1] * np.sin(along)
    left = way[:, 1] * np.cos(along) - way[:, 0] * np.sin(along)
    return np.array([forward.mean(), left.mean(), turn.mean()]) / seconds


def predicted(program, model, scene: Path, command, join: bool) -> np.ndarray:
    """Poses (samples, units, 7) that the program writes."""
    with tempfile.TemporaryDirectory() as folder:
        text = ",".join(f"{number:g}" for number in command)
        arguments = [program, "rollout", scene, "--model", model, f"--command={text}", "--frames", str(FRAMES),
                     "--step", str(STEP), "--out", folder] + ["--join"] * join  # fmt: skip
        done = subprocess.run(list(map(str, arguments)), capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"{program} ended with {done.returncode}: {done.stderr.strip()}")
        with (Path(folder) / "poses.csv").open() as file:
            rows = [[float(row[key]) for key in ("x", "y", "z", "qw", "qx", "qy", "qz")] for row in csv.DictReader(file)]
    return np.array(rows).reshape(FRAMES // STEP + 1, -1, 7)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="what Unitree publishes, as in rigidformer_lab.g1")
    parser.add_argument("--program", type=Path, required=True, help="rigidformer")
    parser.add_argument("--model", type=Path, required=True, help="packed model")
    parser.add_argument("--join", action="store_true", help="hold the parts together")
    parser.add_argument("--seed", type=int, default=200001, help="of the first walk (default %(default)s)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    recipe = g1.Recipe(options.folder.resolve(), options.seed, 1, FRAMES + 1)
    try:
        robot = recipe.robot()
    except robots.FolderError as error:
        raise SystemExit(str(error)) from error
    leader, rows = int(np.argmax(robot.mass)), []
    for number, command in enumerate(COMMANDS):
        walker = dataclasses.replace(robot, command=command)
        scenes = dataclasses.replace(recipe, first_seed=options.seed + number).make(
            range(options.seed + number, options.seed + number + 1), walker
        )
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "walk.safetensors"
            write_scenes(path, scenes)
            found = predicted(options.program, options.model, path, command, options.join)
        engine = scenes.unit_poses[leader, FIRST : FRAMES + 1 : STEP].astype(np.float64)
        seconds = STEP / robots.FRAME_RATE_HZ
        rows.append({"command": command, "model": pace(found[FIRST // STEP :, leader], seconds).round(3).tolist(),
                     "engine": pace(engine, seconds).round(3).tolist()})  # fmt: skip
        print(f"{number + 1} of {len(COMMANDS)}", end="\r", file=sys.stderr, flush=True)
    if options.json:
        print(json.dumps(rows, indent=2))
        return
    print("| command | model | MuJoCo |\n|---|---|---|")
    for row in rows:
        print("| " + " | ".join(", ".join(f"{v:.2f}" for v in row[key]) for key in ("command", "model", "engine")) + " |")


if __name__ == "__main__":
    main()
