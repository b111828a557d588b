"""What makers of scenes of commanded robots share: commands that change, runs drawn anew after a fall, the scene file."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import re
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import bullet, far, movi
from .geometry import prepare_points
from .movi import _offsets
from .npz import arrays_of
from .scenes import Scenes, split_of_seed
from .wrecking import SPLITS

FRAME_RATE_HZ = 30
WARM_UP_FRAMES = FRAME_RATE_HZ  # a second of standing up, before frame 0
HOLD_S = (1.5, 4.0)  # how long a command lasts
HOLD_FRAMES = 3  # a command lasts a multiple of these: controllers at 50 Hz and at 60 Hz see it change at a frame
POINTS = 32  # of a part: what a microcontroller has room for
ATTEMPTS = 50
SEEDS_PER_SHARD = 10
_REDRAWN = "Runs that fell and were drawn anew: {}."


class FolderError(RuntimeError):
    """A file that a robot is made of cannot be used. The message names it and says how to get it."""


@dataclass(frozen=True)
class Nudge:
    """At a frame, right after it was recorded, each joint turns by a random angle of this standard deviation, rad."""

    frame: int
    angle_rad: float
    seed: int = 0

    def angles(self, frame: int, joints: int) -> np.ndarray:
        """(joints) by how much they turn at a frame."""
        if frame != self.frame:
            return np.zeros(joints)
        return self.angle_rad * np.random.default_rng(self.seed).standard_normal(joints)


@dataclass(frozen=True)
class Robot:
    """What moves, and how a run of it is made."""

    dataset: str
    parts: list[str]
    points: list[np.ndarray]  # of each part, (points, 3) float32, in the frame whose poses are recorded
    mass: np.ndarray  # (parts) kg
    friction: float
    ground: tuple[float, float]  # friction, restitution
    gravity_m_s2: tuple[float, float, float]
    draws: int  # goes into the seed, so that robots do not share draws
    provenance: str
    licence: str
    digest: str  # of the files that it was made from

    def run(self, rng: np.random.Generator, frames: int, nudge: Nudge | None = None) -> tuple[np.ndarray, np.ndarray] | None:
        """Poses (parts, frames, 7) from rest on and commands (frames, C); None if the robot falls."""
        raise NotImplementedError


def read_arrays(path: Path, shapes: dict[str, tuple], how: str) -> dict[str, np.ndarray]:
    """The arrays of an .npz file, checked. shapes: name -> shape, None for any size. how: to get the file."""

    def fail(problem: str):
        raise FolderError(f"{path}: {problem}; {how}")

    arrays = arrays_of(path, shapes, fail)
    for name, shape in shapes.items():
        found = arrays[name].shape
        if len(found) != len(shape) or any(b not in (None, a) for a, b in zip(found, shape)):
            fail(f"{name} has shape {found}, not ({', '.join('any' if size is None else str(size) for size in shape)})")
        if arrays[name].dtype.kind == "f" and not np.isfinite(arrays[name]).all():
            fail(f"{name} holds values that are not finite")
    return arrays


def hold_commands(rng: np.random.Generator, frames: int, draw, first: np.ndarray | None = None) -> np.ndarray:
    """(frames, C): `first`, then what `draw` gives, each held for a time of `HOLD_S`. The command of a frame is in force
    until the next."""
    commands: list[np.ndarray] = []
    while len(commands) < frames:
        held = HOLD_FRAMES * round(rng.uniform(*HOLD_S) * FRAME_RATE_HZ / HOLD_FRAMES)
        commands += [draw() if commands or first is None else first] * held
    return np.array(commands[:frames])


def stay_up(robot: Robot, seed: int, frames: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Poses and commands of a run without a fall, after the warm-up, and how many runs fell before it. Drawn from `seed`."""
    for fallen in range(ATTEMPTS):
        run = robot.run(np.random.default_rng((seed, robot.draws, fallen)), WARM_UP_FRAMES + frames)
        if run is not None:
            poses, commands = run[0][:, WARM_UP_FRAMES:], run[1][WARM_UP_FRAMES:]
            bullet.steady_signs(poses)
            return poses, commands, fallen
    raise RuntimeError(f"seed {seed}: the robot fell in {ATTEMPTS} runs of {ATTEMPTS}; make shorter scenes with --frames")


def farthest(points: np.ndarray, count: int) -> np.ndarray:
    """The first of a part's points (points, 3), float32, in farthest-point order: at most `count`, all if that is 0."""
    local, centre = prepare_points(points.astype(np.float32))
    return (local[: count or len(local)] + centre).astype(np.float32)


@dataclass(frozen=True)
class Recipe:
    """What a run makes; see `movi.Recipe`. `dataset` and `robot` are those of a robot."""

    folder: Path | None
    first_seed: int
    seeds: int
    frames: int
    split: int | None = None  # None: by seed
    points: int = POINTS  # of a part, at most; 0: all

    def robot(self) -> Robot:
        raise NotImplementedError

    @property
    def name(self) -> str:
        return self.dataset

    def shards(self) -> list[range]:
        end = self.first_seed + self.seeds
        return [range(seed, min(seed + SEEDS_PER_SHARD, end)) for seed in range(self.first_seed, end, SEEDS_PER_SHARD)]

    def description(self) -> dict:
        """What has to agree before a run may continue from existing shards."""
        code = hashlib.sha256()
        for module in (__name__, type(self).__module__, bullet.__name__):
            code.update(Path(sys.modules[module].__file__).read_bytes())
        return {"dataset": self.dataset, "first_seed": self.first_seed, "seeds": self.seeds, "frames": self.frames,
                "split": self.split, "points": self.points, "robot_sha256": self.robot().digest, "code_sha256": code.hexdigest()}

    def split_of(self, seed: int) -> int:
        return split_of_seed("primitives", seed) if self.split is None else self.split

    def make(self, seeds: range, robot: Robot | None = None) -> Scenes:
        """Simulates `seeds` one after the other; robot: another than the recipe's."""
        robot = robot or self.robot()
        made = [stay_up(robot, seed, self.frames) for seed in seeds]
        units, count = len(robot.parts), len(seeds)
        points = [farthest(part, self.points) for part in robot.points]
        physics = [(mass, robot.friction, 0.0) for mass in robot.mass]
        fallen = sum(fallen for _, _, fallen in made)
        return Scenes(
            dataset=self.dataset,
            shape_names=list(robot.parts),
            shape_points=np.concatenate(points),
            shape_offsets=_offsets([len(part) for part in points]),
            scene_seed=np.array(seeds, np.int64),
            scene_split=np.array([self.split_of(seed) for seed in seeds], np.uint8),
            scene_units=_offsets([units] * count),
            unit_shape=np.tile(np.arange(units, dtype=np.int32), count),
            unit_scale=np.ones(units * count, np.float32),
            unit_physics=np.tile(np.array(physics, np.float32), (count, 1)),
            unit_poses=np.concatenate([poses for poses, _, _ in made]).astype(np.float32),
            provenance=f"{robot.provenance} {_REDRAWN.format(fallen)}",
            licence=robot.licence,
            frame_rate_hz=FRAME_RATE_HZ,
            gravity_m_s2=robot.gravity_m_s2,
            ground_friction=None,
            ground_restitution=None,
            planes=np.tile(np.array([0, 0, 1, 0, *robot.ground], np.float32), (count, 1)),
            scene_planes=np.arange(count + 1, dtype=np.int64),
            unit_body=np.zeros(units * count, np.int32),
            commands=np.stack([commands for _, commands, _ in made]).astype(np.float32),
        )

    def join(self, shards: list[Scenes]) -> Scenes:
        """One data set, which says how many runs fell."""
        counts = [re.search(_REDRAWN.format(r"(\d+)"), shard.provenance) for shard in shards]
        fallen = sum(int(count[1]) for count in counts)
        provenance = shards[0].provenance.replace(counts[0][0], _REDRAWN.format(fallen))
        return dataclasses.replace(movi.concatenate(shards), provenance=provenance)


def command(arguments: list[str] | None, module: str, text: str, recipe, folder: dict) -> int:
    """Reads the arguments of `python -m module`, makes the file and says so; the exit code. recipe: the class of it. folder:
    of the argument that names it."""
    parser = ArgumentParser(prog=f"python -m rigidformer_lab.{module}", description=text,
                            formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, **folder)
    parser.add_argument("--out", type=Path, required=True, help="scene file to make")
    parser.add_argument("--seeds", type=int, default=100, help="number of scenes (default %(default)s)")
    parser.add_argument("--first-seed", type=int, default=1, help="default %(default)s")
    parser.add_argument("--frames", type=int, default=11 * FRAME_RATE_HZ, help=f"frames a scene at {FRAME_RATE_HZ} Hz "
                        "(default %(default)s)")
    parser.add_argument("--points", type=int, default=POINTS, metavar="N", help="points of a part, those farthest from each "
                        "other, at least 4; 0: all (default %(default)s)")
    parser.add_argument("--split", choices=SPLITS, help="split of all scenes of the file (default: by seed)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (default: one a core)")
    far.add_argument(parser)
    options = parser.parse_args(arguments)
    bullet.check_seeds(parser, options)
    if options.points < 4 and options.points != 0:
        parser.error(f"--points {options.points}: a part has at least 4 points; 0 takes all")
    where = options.folder and options.folder.resolve()
    made = recipe(where, options.first_seed, options.seeds, options.frames, SPLITS.get(options.split),
                  options.points)
    return bullet.run(made, options.out, options.workers, options.dask)
