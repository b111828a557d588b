"""What a trained model does to bodies that lie still.

    python -m rigidformer_lab.research.rest runs/edge/checkpoint.pt movi-a.safetensors --split 2

Of each scene those units count that lay still in the last 48 frames of the record. The model takes over at the last two
observed frames, and `rest_m` is how far each of them has moved 480 frames later: median, 90 %, 99 % and the most. `energy`
is the most that any of them gains at the end of a step, potential and kinetic together: J/kg.
"""

from __future__ import annotations

import argparse
import json
import pathlib

import numpy as np
import torch

from ..evaluate import load
from ..golden import golden_scene
from .impulses_alone import REST_FRAMES, STILL_DEG, STILL_FRAMES, STILL_M, Record, records
from ..scenes import read_scenes


def still(record: Record):
    """Units (M) bool that lie still at the end of a record."""
    last = record.frames - 1
    way, turn = record.between(last - STILL_FRAMES, last)
    seconds = STILL_FRAMES / record.rate
    quiet = record.free & (np.linalg.norm(way, axis=1) * seconds < STILL_M)
    return quiet & (np.degrees(np.linalg.norm(turn, axis=1)) * seconds < STILL_DEG)


@torch.no_grad()
def resting(model, path, split, step, limit=None):
    """Metres that still units move, and the energy that they gain, of all scenes."""
    file = read_scenes(path)
    drifts, gains = [], []
    for index, record in zip(file.scenes_of_split(split)[:limit], records(path, split, limit)):
        last, quiet = record.frames - 1, torch.from_numpy(still(record))
        if not quiet.any():
            continue
        scene, state, _, _ = golden_scene(file, int(index), last - step, step)
        dt, gravity = step / float(file.frame_rate_hz), model.gravity.double()
        began, most = state.centre.clone(), torch.full_like(state.centre[..., 0], -1e9)
        for _ in range(round(REST_FRAMES / step)):
            state, _, _ = model.step(scene, state)
            velocity = (state.centre - state.previous_centre) / dt + gravity * (dt / 2)
            energy = velocity.square().sum(-1) / 2 - ((state.centre - began) * gravity).sum(-1)
            most = torch.maximum(most, energy)
        drifts += (state.centre - began).norm(dim=-1)[0][quiet].tolist()
        gains += most[0][quiet].tolist()
    return drifts, gains


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=pathlib.Path)
    parser.add_argument("data", type=pathlib.Path, nargs="+")
    parser.add_argument("--split", type=int, default=1, help="0 train, 1 validation, 2 test (default 1)")
    parser.add_argument("--steps", type=int, nargs="+", default=[10], help="frames a step (default 10)")
    parser.add_argument("--limit", type=int, help="only the first scenes of a split")
    args = parser.parse_args()
    model = load(args.checkpoint)[0].double()
    for path in args.data:
        for step in args.steps:
            drifts, gains = resting(model, path, args.split, step, args.limit)
            row = {"file": path.name, "step": step, "units": len(drifts)}
            if drifts:
                row["rest_m"] = [round(float(v), 5) for v in np.quantile(drifts, (0.5, 0.9, 0.99, 1.0))]
                row["energy"] = round(max(gains), 6)
            print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
