"""Makes scenes of the 17-part humanoid with sword and shield from recorded clips, for local experiments.

    python -m rigidformer_lab.ase FOLDER --out ase.safetensors

FOLDER holds `ase17_parts.npz` (arrays `part` (17), `verts`, `vstart`, `mass`) and `ase17_locomotion.npz` (`clip` (C), `start`
(C + 1), `pos` (frames, 17, 3), `quat_wxyz` (frames, 17, 4), `cmd` (frames, 5)), 30 frames a second. The clips are motion capture
that Reallusion provides for NON-COMMERCIAL use: neither they, nor scenes made of them, nor weights trained on those may be passed on.

The command is a direction (x, y) and a speed, m/s, of the way, and the direction (x, y) that the body faces, all in the heading of the
pelvis, read off the clips afterwards: no policy obeyed it. A scene has up to 111 frames. Of clips of 222 frames and more the last 111 are
for tests; of those before, and of the other clips, a scene begins every 5 frames for training. Nobody can walk on in a clip that has ended,
so error beyond frame 110 is not to be had.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from .bullet import steady_signs
from .movi import _offsets
from .robots import FRAME_RATE_HZ, POINTS, FolderError, farthest, read_arrays
from .scenes import TEST, TRAIN, Scenes, write_scenes

PARTS, COMMAND = 17, 5
FRAMES, STRIDE = 111, 5
LEAST_FRAMES = 21  # two steps of ten frames
GROUND = (0.8, 0.0)  # friction, restitution: a guess, nothing in the clips says
HOW = "give the folder of the clips; --help says what is in it"
LICENCE = "Motion: Reallusion, NON-COMMERCIAL. Do not pass on, nor weights trained on it."


def cut(starts) -> list[tuple[int, int, int]]:
    """First frame, end and split of each scene. starts: (clips + 1)."""
    scenes = []
    for first, end in zip(starts, starts[1:]):
        if end - first >= 2 * FRAMES:
            scenes.append((end - FRAMES, end, TEST))
            end -= FRAMES
        if end - first >= LEAST_FRAMES:
            last = max(first, end - FRAMES)
            begins = sorted({*range(first, last + 1, STRIDE), last})
            scenes += [(begin, min(begin + FRAMES, end), TRAIN) for begin in begins]
    return scenes


def make(folder: Path) -> Scenes:
    """All scenes of the folder's clips."""
    shapes = {"part": (PARTS,), "verts": (None, 3), "vstart": (PARTS + 1,), "mass": (PARTS,)}
    parts = read_arrays(Path(folder) / "ase17_parts.npz", shapes, HOW)
    shapes = {"clip": (None,), "start": (None,), "pos": (None, PARTS, 3), "quat_wxyz": (None, PARTS, 4), "cmd": (None, COMMAND)}
    clips = read_arrays(Path(folder) / "ase17_locomotion.npz", shapes, HOW)
    starts, total = clips["start"].astype(np.int64), len(clips["pos"])
    if starts[0] != 0 or starts[-1] != total or (np.diff(starts) <= 0).any() or not len(clips["quat_wxyz"]) == len(clips["cmd"]) == total:
        raise FolderError(f"{folder}/ase17_locomotion.npz: start does not rise from 0 to {total}, the frames of pos, or quat_wxyz or "
                          f"cmd have another number of frames; {HOW}")
    points = [farthest(own, POINTS) for own in np.split(parts["verts"].astype(np.float32), parts["vstart"][1:-1])]
    poses = np.concatenate((clips["pos"], clips["quat_wxyz"]), -1).astype(np.float64).transpose(1, 0, 2)
    scenes = cut(starts.tolist())
    commands, made = np.zeros((len(scenes), FRAMES, COMMAND), np.float32), []
    for number, (first, end, _) in enumerate(scenes):
        held = np.minimum(np.arange(first, first + FRAMES), end - 1)
        own = poses[:, held].copy()
        steady_signs(own)
        made.append(own)
        commands[number] = clips["cmd"][held]
    count = len(scenes)
    physics = [(mass, GROUND[0], 0.0) for mass in parts["mass"]]
    return Scenes(
        dataset="ase",
        shape_names=[str(name) for name in parts["part"]],
        shape_points=np.concatenate(points),
        shape_offsets=_offsets([len(own) for own in points]),
        scene_seed=np.array([first for first, _, _ in scenes], np.int64),
        scene_split=np.array([split for _, _, split in scenes], np.uint8),
        scene_units=_offsets([PARTS] * count),
        unit_shape=np.tile(np.arange(PARTS, dtype=np.int32), count),
        unit_scale=np.ones(PARTS * count, np.float32),
        unit_physics=np.tile(np.array(physics, np.float32), (count, 1)),
        unit_poses=np.concatenate(made).astype(np.float32),
        provenance="Cut by rigidformer_lab.ase from motion capture clips.",
        licence=LICENCE,
        frame_rate_hz=FRAME_RATE_HZ,
        gravity_m_s2=(0.0, 0.0, -9.81),
        ground_friction=None,
        ground_restitution=None,
        planes=np.tile(np.array([0, 0, 1, 0, *GROUND], np.float32), (count, 1)),
        scene_planes=np.arange(count + 1, dtype=np.int64),
        unit_body=np.zeros(PARTS * count, np.int32),
        commands=commands,
        scene_frames=np.array([end - first for first, end, _ in scenes], np.int64),
    )


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m rigidformer_lab.ase", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder that holds ase17_parts.npz and ase17_locomotion.npz")
    parser.add_argument("--out", type=Path, required=True, help="scene file to make")
    options = parser.parse_args(arguments)
    try:
        scenes = make(options.folder)
    except FolderError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    write_scenes(options.out, scenes)
    tests = int((scenes.scene_split == TEST).sum())
    print(f"{options.out.name}: {scenes.scenes - tests} scenes to train on, {tests} for tests; for local use alone")
    return 0


if __name__ == "__main__":
    sys.exit(main())
