"""How well MuJoCo itself says what becomes of a cube of fragments where it is not told how strong the bonds are: what no prediction from
two frames can be expected to do better than.

    python -m rigidformer_lab.research.strengths fragments-test.safetensors

Each scene of `fragments` is simulated again from its seed, with the mean strength for all bonds, per square metre. Printed are which
bonds are broken at a frame, F1 of those that are and of those that hold, and how far the cells are from where the record has them.
Scenes of which the record needed another draw are left out.
"""

from __future__ import annotations

import argparse
import json
import pathlib
import sys

import numpy as np

from .. import fragments
from ..scenes import SceneFileError, read_scenes
from ..wrecking import SPLITS


class Even(fragments.Recipe):
    """The same scenes with bonds of equal strength."""

    strengths = (1.0, 1.0)


def compared(file, splits, frame: int, limit: int | None = None):
    """(4) bonds broken in both, here alone, in the record alone, in neither; mean metres; scenes."""
    counts, away = np.zeros(4, int), []
    for scene in [s for split in splits for s in file.scenes_of_split(split)][:limit]:
        seed, frames = int(file.scene_seed[scene]), int(file.frames_of_scene(scene))
        again = Even(seed, 1, frames).scene(seed)
        record, own = file.bonds_of_scene(scene), again.bonds_of_scene(0)
        units = file.units_of_scene(scene)
        start = file.unit_poses[units.start : units.stop, 0]
        if len(record) != len(own) or not np.array_equal(start, again.unit_poses[:, 0]):
            continue
        broken, found = record[:, 2] <= frame, own[:, 2] <= frame
        counts += [(found & broken).sum(), (found & ~broken).sum(), (~found & broken).sum(), (~found & ~broken).sum()]
        way = file.unit_poses[units.start : units.stop, frame, :3] - again.unit_poses[:, frame, :3]
        away.append(np.linalg.norm(way, axis=1).mean())
    return counts, float(np.mean(away)) if away else float("nan"), len(away)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m rigidformer_lab.research.strengths", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=pathlib.Path, help="a file that `rigidformer_lab.fragments` made")
    parser.add_argument("--split", choices=SPLITS, default="test", help="default %(default)s")
    parser.add_argument("--frame", type=int, default=105, help="default %(default)s")
    parser.add_argument("--limit", type=int, help="only the first scenes of the split")
    options = parser.parse_args(arguments)
    try:
        file = read_scenes(options.data)
    except (SceneFileError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if file.dataset != fragments.Recipe.dataset:
        print(f"error: {options.data}: is of {file.dataset}, not of fragments; give a file that `fragments` made", file=sys.stderr)
        return 1
    (both, here, record, neither), away, scenes = compared(file, [SPLITS[options.split]], options.frame, options.limit)
    if not scenes:
        print(f"error: {options.data}: has no scene of split {options.split} that can be made again; give another --split", file=sys.stderr)
        return 1
    wrong = here + record
    print(json.dumps({
        "scenes": scenes, "frame": options.frame, "f1": round(2 * both / max(2 * both + wrong, 1), 4),
        "f1_of_holding": round(2 * neither / max(2 * neither + wrong, 1), 4), "position_m": round(away, 4),
    }))  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
