"""What makers of scenes with MuJoCo share: steps of the engine, runs drawn anew where one fails, and the command."""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import bullet, far
from .movi import shards_of
from .scenes import Scenes, concatenate, split_of_seed
from .wrecking import SPLITS

FRAME_RATE_HZ, SUB_STEPS = 60.0, 8
STEP_S = 1.0 / (FRAME_RATE_HZ * SUB_STEPS)
GRAVITY_M_S2 = (0.0, 0.0, -9.81)
#: Of the ground and of what is fixed. The pair of two bodies has the product of their frictions, so a body that moves has the
#: pair's. MuJoCo takes the greater of two: what stays has the friction of the body that moves there.
GROUND_FRICTION, RESTITUTION = 1.0, 0.0
FARTHEST_M = 5.0  # from the origin; what is farther has been thrown by the engine
TRIALS = 50


class Unstable(Exception):
    """A run that is not to be kept. The message says why."""


def model_of(text: str):
    """MuJoCo's model and its data, of an XML text."""
    import mujoco

    mujoco.set_mju_user_warning(lambda _: None)  # a file in the current folder otherwise; `check` finds them in the data
    model = mujoco.MjModel.from_xml_string(text)
    return model, mujoco.MjData(model)


def check(data) -> None:
    """Refuses a run of which the engine says that it failed."""
    if np.any(data.warning.number):  # the engine starts anew after bad numbers, so nothing else may tell
        raise Unstable("the engine warned")


def check_places(points: np.ndarray) -> None:
    """Refuses points (..., 3) that no sound run has."""
    if not np.isfinite(points).all():
        raise Unstable("a point was not finite")
    if np.linalg.norm(points, axis=-1).max() > FARTHEST_M:
        raise Unstable(f"a point was farther than {FARTHEST_M:g} m")


@dataclass(frozen=True)
class Recipe:
    """What a run makes; see `movi.Recipe`. `dataset`, `draws` and `run` are those of a kind of scene."""

    first_seed: int
    seeds: int
    frames: int
    split: int | None = None  # None: by seed

    dataset = ""
    program = ""  # what makes such scenes, after `python -m rigidformer_lab.`; "": the dataset's name
    uses: tuple[str, ...] = ()  # modules whose code its scenes hang on, beside its own and those that all have
    draws = 0  # goes into the seed, so that kinds of scenes do not share draws

    def run(self, seed: int, rng: np.random.Generator) -> Scenes:
        """One scene, drawn with `rng`, or `Unstable`. Its split is set later."""
        raise NotImplementedError

    @property
    def name(self) -> str:
        return self.dataset

    def shards(self) -> list[range]:
        return shards_of(self.first_seed, self.seeds)

    def description(self) -> dict:
        """What has to agree before a run may continue from existing shards."""
        from . import patches

        modules = (type(self).__module__, *self.uses, __name__, patches.__name__, bullet.__name__)
        code = hashlib.sha256(b"".join(Path(sys.modules[module].__file__).read_bytes() for module in modules))
        return {"dataset": self.dataset, "first_seed": self.first_seed, "seeds": self.seeds, "frames": self.frames,
                "split": self.split, "code_sha256": code.hexdigest()}

    def split_of(self, seed: int) -> int:
        return split_of_seed("primitives", seed) if self.split is None else self.split

    def scene(self, seed: int) -> Scenes:
        """The first run of a seed that does not fail."""
        rng, reason = np.random.default_rng((seed, self.draws)), None
        for _ in range(TRIALS):
            try:
                scene = self.run(seed, rng)
            except Unstable as error:
                reason = error
                print(f"seed {seed}: drawn anew: {error}", file=sys.stderr, flush=True)
                continue
            scene.scene_split = np.array([self.split_of(seed)], np.uint8)
            return scene
        raise RuntimeError(f"seed {seed}: {TRIALS} runs of {TRIALS} failed, the last because {reason}; leave the seed out")

    def make(self, seeds: range) -> Scenes:
        """Simulates `seeds` one after the other."""
        return concatenate([self.scene(seed) for seed in seeds])


def one_scene(seed: int, dataset: str, shapes: dict[str, np.ndarray], poses: np.ndarray, physics: np.ndarray, what: str,
              program: str = "", **more) -> Scenes:
    """A scene over the ground. shapes: the name and the points of each unit; poses: (units, frames, 7); program: of a `Recipe`."""
    bullet.steady_signs(poses)
    counts = [len(points) for points in shapes.values()]
    return Scenes(
        dataset=dataset,
        shape_names=list(shapes),
        shape_points=np.concatenate(list(shapes.values())).astype(np.float32),
        shape_offsets=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        scene_seed=np.array([seed], np.int64),
        scene_split=np.zeros(1, np.uint8),
        scene_units=np.array([0, len(shapes)], np.int64),
        unit_shape=np.arange(len(shapes), dtype=np.int32),
        unit_scale=np.ones(len(shapes), np.float32),
        unit_physics=np.asarray(physics, np.float32),
        unit_poses=poses.astype(np.float32),
        provenance=f"Generated by rigidformer_lab.{program or dataset} with MuJoCo 4.0.0: {what}",
        licence="the licence of the rigidformer project",
        frame_rate_hz=FRAME_RATE_HZ,
        gravity_m_s2=GRAVITY_M_S2,
        ground_friction=GROUND_FRICTION,
        ground_restitution=RESTITUTION,
        **more,
    )


def parser_of(program: str, text: str, frames: int | None, said: str = "%(default)s") -> argparse.ArgumentParser:
    """What all commands are told. frames: of a scene, where none are given; said: how the help says that."""
    parser = argparse.ArgumentParser(prog=f"python -m rigidformer_lab.{program}", description=text,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="scene file to make")
    parser.add_argument("--seeds", type=int, default=100, help="number of scenes (default %(default)s)")
    parser.add_argument("--first-seed", type=int, default=1, help="default %(default)s")
    parser.add_argument("--frames", type=int, default=frames, help=f"frames a scene at 60 Hz (default {said})")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (default: one a core)")
    far.add_argument(parser)
    return parser


def command(arguments: list[str] | None, text: str, recipe: type[Recipe], frames: int) -> int:
    """Reads the arguments, makes the file and says so; the exit code. frames: of a scene, where none are given."""
    parser = parser_of(recipe.program or recipe.dataset, text, frames)
    parser.add_argument("--split", choices=SPLITS, help="split of all scenes of the file (default: by seed)")
    options = parser.parse_args(arguments)
    bullet.check_seeds(parser, options)
    made = recipe(options.first_seed, options.seeds, options.frames, SPLITS.get(options.split))
    return bullet.run(made, options.out, options.workers, options.dask)
