"""Leads a G1 in MuJoCo to places by commands that the model plans: the example `walk` again and again.

    cargo build --release -p rigidformer-planning --example walk
    python -m rigidformer_lab.research.walk_to FOLDER --program target/release/examples/walk --model g1.rfm --trials 20

FOLDER is that of `rigidformer_lab.g1`. The robot stands for a second. Then, three times a second, the program sees its poses now and a
third of a second ago, and says what to command until it looks again. The world waits while it plans. A trial draws from its
seed which way the robot looks at first, and a place 1 to 3 m away, any way. It ends after `--seconds`; counted is how far from the
place the torso is then, and when it came within .25 m first. `--planner straight` needs no model: it walks straight at the place, at the
speed that brings it there in a second, and does not turn. It knows neither how slowly the robot takes a command up nor that it
walks slower than it is told.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from .. import g1, robots
from ..robots import FRAME_RATE_HZ, WARM_UP_FRAMES
from ..scenes import Scenes, write_scenes

STEP = 10  # frames between two looks
NEAR_M, FAR_M, THERE_M = 1.0, 3.0, 0.25
COMMANDS = 3  # of a plan, each for
HOLD = 3  # looks
LOW, HIGH = np.array([-0.7, -0.5, -1.0]), np.array([0.9, 0.5, 1.0])


def yaw_of(pose: np.ndarray) -> float:
    return 2 * np.arctan2(pose[6], pose[3])


def straight(torso: np.ndarray, place: np.ndarray) -> np.ndarray:
    """The command of a controller without a model."""
    yaw, way = yaw_of(torso), place - torso[:2]
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    return np.clip([way @ ahead, way @ [-ahead[1], ahead[0]], 0.0], LOW, HIGH)


@dataclasses.dataclass
class Planner:
    """The example `walk` of rigidformer-planning, on a scene of two frames."""

    program: Path
    model: Path
    template: Scenes  # a walk of this robot, of one frame
    join: bool
    left: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((COMMANDS, 3)))
    looks: int = 0

    def command(self, poses: np.ndarray, place: np.ndarray) -> np.ndarray:
        """poses: (parts, STEP + 1, 7)."""
        frames = poses.shape[1]
        scene = dataclasses.replace(self.template, unit_poses=poses.astype(np.float32),
                                    commands=np.zeros((1, frames, 3), np.float32))
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "seen.safetensors"
            write_scenes(path, scene)
            numbers = lambda values: ",".join(f"{value:.6f}" for value in np.ravel(values))  # noqa: E731
            arguments = [self.program, path, "--model", self.model, f"--to={numbers(place)}", "--step", STEP,
                         f"--first={numbers(self.left)}", "--json"] + ["--join"] * self.join  # fmt: skip
            done = subprocess.run(list(map(str, arguments)), capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"{self.program} ended with {done.returncode}: {done.stderr.strip()}")
        plan = json.loads(done.stdout)
        self.looks += 1
        over = self.looks % HOLD == 0
        best = np.array(plan["commands"]).reshape(COMMANDS, 3)
        self.left = np.concatenate((best[1:], best[-1:])) if over else best
        return np.array(plan["command"])


def trial(robot, recipe, options, seed: int) -> dict:
    """What came of a walk."""
    rng = np.random.default_rng((seed, 82))
    yaw, way, far = rng.uniform(-np.pi, np.pi), rng.uniform(-np.pi, np.pi), rng.uniform(NEAR_M, FAR_M)
    place = far * np.array([np.cos(way), np.sin(way)])
    leader, said = int(np.argmax(robot.mass)), np.zeros(3)
    still = dataclasses.replace(robot, command=(0.0, 0.0, 0.0))
    template = dataclasses.replace(recipe, frames=1).make(range(seed, seed + 1), still)
    planner = Planner(options.program, options.model, template, options.join)

    def tell(frame, poses):
        nonlocal said
        if frame >= WARM_UP_FRAMES and (frame - WARM_UP_FRAMES) % STEP == 0:
            if options.planner == "straight":
                said = straight(poses[leader, -1], place)
            else:
                said = planner.command(poses[:, -STEP - 1 :], place)
        return said

    frames = WARM_UP_FRAMES + round(options.seconds * FRAME_RATE_HZ) + 1
    poses = robot.walk(yaw, frames, tell)
    if poses is None:
        return {"seed": seed, "start_m": far, "end_m": None, "there_s": None}
    away = np.linalg.norm(poses[leader, WARM_UP_FRAMES:, :2] - place, axis=-1)
    there = np.flatnonzero(away < THERE_M)
    return {"seed": seed, "start_m": far, "end_m": float(away[-1]), "there_s": float(there[0] / FRAME_RATE_HZ) if len(there) else None}


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m rigidformer_lab.research.walk_to", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="what Unitree publishes, as in rigidformer_lab.g1")
    parser.add_argument("--program", type=Path, default=Path("target/release/examples/walk"),
                        help="the example walk of rigidformer-planning (default %(default)s)")
    parser.add_argument("--model", type=Path, default=Path("weights/models/g1.rfm"), help="packed model (default %(default)s)")
    parser.add_argument("--planner", choices=("model", "straight"), default="model")
    parser.add_argument("--join", action=argparse.BooleanOptionalAction, default=True, help="hold the parts together")
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--seed", type=int, default=300001, help="of the first trial (default %(default)s)")
    parser.add_argument("--seconds", type=float, default=8.0, help="of the world, after a second of standing (default %(default)s)")
    parser.add_argument("--json", action="store_true", help="print JSON, with every trial")
    options = parser.parse_args(arguments)
    if options.trials < 1 or not 0 < options.seconds <= 60:
        parser.error("--trials takes 1 or more, --seconds up to 60")
    recipe = g1.Recipe(options.folder.resolve(), options.seed, 1, 1)
    try:
        robot = recipe.robot()
    except robots.FolderError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    found = []
    for seed in range(options.seed, options.seed + options.trials):
        found.append(trial(robot, recipe, options, seed))
        print(f"{len(found)} of {options.trials}", end="\r", file=sys.stderr, flush=True)
    walked = [row for row in found if row["end_m"] is not None]
    ends, times = [row["end_m"] for row in walked], [row["there_s"] for row in walked if row["there_s"] is not None]
    summary = {"planner": options.planner, "trials": len(found), "fallen": len(found) - len(walked), "there": len(times),
               "median_there_s": float(np.median(times)) if times else None,
               "median_end_m": float(np.median(ends)) if ends else None, "most_end_m": max(ends, default=None)}  # fmt: skip
    if options.json:
        print(json.dumps({**summary, "per_trial": found}, indent=2))
    else:
        print("\n".join(f"{key}: {value:.3g}" if isinstance(value, float) else f"{key}: {value}" for key, value in summary.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
