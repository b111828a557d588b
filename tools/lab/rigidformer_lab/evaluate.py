"""Rolls a trained model out over a split: the lab's own check. The figures that count
are those of `rigidformer evaluate`, which uses every point.

    python -m rigidformer_lab.evaluate runs/edge/checkpoint.pt movi-a.safetensors --split 1
"""

from __future__ import annotations

import argparse
import json
import pathlib

import torch

from .config import ModelConfig
from .data import Dataset, commanded, state_at, with_targets
from .model import RigidFormer
from .roles import FREE


def angle_deg(a, b):
    """Angle between rotations (..., 3, 3), degrees."""
    s = torch.linalg.matrix_norm(a - b) / (2 * 2**0.5)
    return torch.rad2deg(2 * torch.atan2(s, (1 - s.square()).clamp(min=0).sqrt()))


@torch.no_grad()
def evaluate(model, path, split=1, steps=(5, 10), frames=(50, 100), limit=None, device="cpu", points=64, anchors_seed=None):
    """HopNet-protocol errors over free units: {"s10@100": [position m, orientation deg], ...}."""
    dataset = Dataset([path], [split], last_frame=max(frames), limit=limit, anchors_seed=anchors_seed)
    if dataset.worlds.frames.min() <= max(frames):
        raise SystemExit(f"{path}: has {dataset.worlds.frames.min()} frames, and frame {max(frames)} is asked for; make "
                         "longer scenes")
    if points:
        dataset.refresh_subsets(points)
    out = {}
    for s in steps:
        horizon = max(frames) // s - 1
        windows = [(i, 0, s) for i in range(len(dataset))]
        sums = {f: [0.0, 0.0] for f in frames}
        for w, rows in dataset.batches(windows, horizon, 256, full_share=1.0):
            scene, rotation, centre, index = dataset.tensors(w, rows, horizon, points, False, device)
            offset = torch.from_numpy(dataset.units.centre_offset[index]).to(device)
            state = state_at(rotation, centre, 1)
            for k in range(1, horizon + 1):
                state, _, _ = model.step(commanded(scene, k), with_targets(state, rotation, centre, k))
                frame = (k + 1) * s
                if frame in sums:
                    mine = state.centre - (state.rotation @ offset[..., None])[..., 0]
                    true_rotation = rotation[:, :, k + 1]
                    true = centre[:, :, k + 1] - (true_rotation @ offset[..., None])[..., 0]
                    free = scene.mask if scene.role is None else scene.mask & (scene.role == FREE)
                    count = free.sum(-1).clamp(min=1)
                    position = ((mine - true).square().sum(-1) * free).sum(-1) / count
                    turn = (angle_deg(state.rotation, true_rotation).square() * free).sum(-1) / count
                    sums[frame][0] += float(position.sqrt().sum())
                    sums[frame][1] += float(turn.sqrt().sum())
        for f in frames:
            out[f"s{s}@{f}"] = [round(v / len(dataset), 4) for v in sums[f]]
    return out


def load(path, device="cpu"):
    saved = torch.load(path, map_location=device, weights_only=False)
    model = RigidFormer(ModelConfig.from_json(saved["config"])).to(device)
    model.load_state_dict(saved["average"])
    return model.eval(), saved


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=pathlib.Path)
    parser.add_argument("data", type=pathlib.Path)
    parser.add_argument("--split", type=int, default=1, help="0 train, 1 validation, 2 test, 3 extra")
    parser.add_argument("--steps", type=int, nargs="+", default=[5, 10])
    parser.add_argument("--points", type=int, default=0, help="random points a unit, 0 for all")
    parser.add_argument("--limit", type=int)
    parser.add_argument("--anchors-seed", type=int, help="random anchors instead of the farthest points")
    args = parser.parse_args()
    device = "cuda" if torch.cuda.is_available() else "cpu"
    model, _ = load(args.checkpoint, device)
    print(json.dumps(evaluate(model, args.data, args.split, args.steps, limit=args.limit,
                              device=device, points=args.points or None, anchors_seed=args.anchors_seed)))  # fmt: skip


if __name__ == "__main__":
    main()
