"""Rolls a trained model out over a split: the lab's own check. The figures that count
are those of `rigidformer evaluate`, which uses every point.

    python -m rigidformer_lab.evaluate runs/edge/checkpoint.pt movi-a.safetensors --split 1
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import pathlib
import shutil
import sys
import tempfile

import torch

from . import far
from .config import ModelConfig
from .data import Dataset, commanded, state_at, with_targets
from .model import RigidFormer
from .movi import open_parts, write_text
from .roles import FREE
from .scenes import SceneFileError


def angle_deg(a, b):
    """Angle between rotations (..., 3, 3), degrees."""
    s = torch.linalg.matrix_norm(a - b) / (2 * 2**0.5)
    return torch.rad2deg(2 * torch.atan2(s, (1 - s.square()).clamp(min=0).sqrt()))


def opened(path, split, frames, limit, points, anchors_seed, rigid=False):
    """The data set of an evaluation; its draws are the same every time."""
    dataset = Dataset([path], [split], last_frame=max(frames), limit=limit, anchors_seed=anchors_seed)
    if dataset.worlds.frames.min() <= max(frames):
        raise SystemExit(f"{path}: has {dataset.worlds.frames.min()} frames, and frame {max(frames)} is asked for; make "
                         "longer scenes")
    if points:
        dataset.refresh_subsets(points)
    if rigid:
        dataset.worlds.law[:] = 0
    return dataset


def batches(dataset, steps, frames):
    """(frames a step, predictions, windows, rows of units) of every batch, in order."""
    for s in steps:
        horizon = max(frames) // s - 1
        windows = [(i, 0, s) for i in range(len(dataset))]
        for w, rows in dataset.batches(windows, horizon, 256, full_share=1.0):
            yield s, horizon, w, rows


@torch.no_grad()
def errors_of(model, dataset, s, horizon, tensors, frames, device):
    """Sums over the scenes of a batch of position and orientation errors, {frame: [m, deg]}."""
    scene, rotation, centre, index = tensors
    sums = {}
    offset = torch.from_numpy(dataset.units.centre_offset[index]).to(device)
    state = state_at(rotation, centre, 1)
    for k in range(1, horizon + 1):
        state, _, _ = model.step(commanded(scene, k), with_targets(state, rotation, centre, k))
        frame = (k + 1) * s
        if frame in frames:
            mine = state.centre - (state.rotation @ offset[..., None])[..., 0]
            true_rotation = rotation[:, :, k + 1]
            true = centre[:, :, k + 1] - (true_rotation @ offset[..., None])[..., 0]
            free = scene.mask if scene.role is None else scene.mask & (scene.role == FREE)
            count = free.sum(-1).clamp(min=1)
            position = ((mine - true).square().sum(-1) * free).sum(-1) / count
            turn = (angle_deg(state.rotation, true_rotation).square() * free).sum(-1) / count
            sums[frame] = [float(position.sqrt().sum()), float(turn.sqrt().sum())]
    return sums


def means(parts, scenes, steps, frames):
    """What `evaluate` gives, of (frames a step, sums) of all batches in order."""
    out = {f"s{s}@{f}": [0.0, 0.0] for s in steps for f in frames}
    for s, sums in parts:
        for f, values in sums.items():
            mean = out[f"s{s}@{f}"]
            mean[0] += values[0]
            mean[1] += values[1]
    return {key: [round(v / scenes, 4) for v in mean] for key, mean in out.items()}


def evaluate(model, path, split=1, steps=(5, 10), frames=(50, 100), limit=None, device="cpu", points=64, anchors_seed=None, rigid=False):
    """HopNet-protocol errors over free units: {"s10@100": [position m, orientation deg], ...}. rigid: whatever law of contact the scenes have."""
    dataset = opened(path, split, frames, limit, points, anchors_seed, rigid)
    parts = []
    for s, horizon, w, rows in batches(dataset, steps, frames):
        tensors = dataset.tensors(w, rows, horizon, points, False, device)
        parts.append((s, errors_of(model, dataset, s, horizon, tensors, frames, device)))
    return means(parts, len(dataset), steps, frames)


#: The model that a worker of `evaluate_far` has built last, by what it was asked for.
_held = {}


def batch_far(common, number):
    """On another machine: a batch's sums. It draws what the batches before draw, so that it is the same as in one process."""
    key, checkpoint, data, steps, frames, options = common
    device = "cuda" if torch.cuda.is_available() else "cpu"
    if key not in _held:
        _held.clear()
        _held[key] = load(io.BytesIO(checkpoint), device)[0]
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "scenes.safetensors"
        path.write_bytes(data)
        dataset = opened(path, options["split"], frames, options["limit"], options["points"], options["anchors_seed"])
    for place, (s, horizon, w, rows) in enumerate(batches(dataset, steps, frames)):
        if place == number or options["points"]:  # without random points tensors draw nothing
            tensors = dataset.tensors(w, rows, horizon, options["points"], False, device)
        if place == number:
            return s, errors_of(_held[key], dataset, s, horizon, tensors, frames, device)


def evaluate_far(address, checkpoint, path, out=None, split=1, steps=(5, 10), frames=(50, 100), limit=None, points=64, anchors_seed=None):
    """`evaluate` of a checkpoint file by the workers of Dask. out: the file that the figures will go to, beside which finished batches are
    kept; `main` removes them."""
    options = {"split": split, "limit": limit, "points": points, "anchors_seed": anchors_seed}
    dataset = opened(path, split, frames, limit, points, anchors_seed)
    count = sum(1 for _ in batches(dataset, steps, frames))
    # The model alone: what an optimizer knows need not travel.
    saved = torch.load(checkpoint, map_location="cpu", weights_only=False)
    buffer = io.BytesIO()
    torch.save({"config": saved["config"], "average": saved["average"]}, buffer)
    weights, data = buffer.getvalue(), pathlib.Path(path).read_bytes()
    digests = [hashlib.sha256(text).hexdigest() for text in (weights, data)]
    description = {"weights": digests[0], "scenes": digests[1], "code": far.code(), "steps": list(steps), "frames": list(frames), **options}
    parts = out and parts_of(out)
    kept = {}
    if parts:
        open_parts(parts, description)
        kept = {k: json.loads(part_path(parts, k).read_text()) for k in range(count) if part_path(parts, k).exists()}
        if kept:
            print(f"continuing after {len(kept)} of {count} batches", file=sys.stderr, flush=True)
    missing = [k for k in range(count) if k not in kept]
    common = (json.dumps(description), weights, data, tuple(steps), tuple(frames), options)
    for index, (s, sums) in far.results(address, batch_far, missing, common) if missing else ():
        kept[missing[index]] = s, list(sums.items())
        if parts:
            write_text(part_path(parts, missing[index]), json.dumps(kept[missing[index]]))
    figures = means([(s, dict(sums)) for s, sums in (kept[k] for k in range(count))], len(dataset), steps, frames)
    return figures


def parts_of(out):
    """Where finished batches are until all are there."""
    return out.with_name(out.name + ".parts")


def part_path(parts, number):
    return parts / f"batch-{number:05d}.json"


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
    parser.add_argument("--out", type=pathlib.Path, help="file that the figures go to as well")
    far.add_argument(parser, "on processors like this one's the figures are the same; with --out an interrupted run continues")
    args = parser.parse_args()
    if args.out:
        try:  # before any work, which would be lost with a folder that cannot be made
            args.out.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            parser.error(f"--out {args.out}: its folder cannot be made ({error}); give another file")
    options = {"split": args.split, "steps": args.steps, "limit": args.limit, "points": args.points or None, "anchors_seed": args.anchors_seed}
    if args.dask:
        try:
            figures = evaluate_far(args.dask, args.checkpoint, args.data, args.out, **options)
        except (far.FarError, SceneFileError) as error:
            raise SystemExit(f"error: {error}") from error
        except KeyboardInterrupt:
            print(f"interrupted; the same command continues from {parts_of(args.out)}" if args.out else "interrupted", file=sys.stderr)
            raise SystemExit(130) from None
    else:
        device = "cuda" if torch.cuda.is_available() else "cpu"
        model, _ = load(args.checkpoint, device)
        figures = evaluate(model, args.data, device=device, **options)
    print(json.dumps(figures), flush=True)  # first, so that a file that cannot be written does not lose them
    if args.out:
        write_text(args.out, json.dumps(figures) + "\n")
        if args.dask:
            shutil.rmtree(parts_of(args.out))


if __name__ == "__main__":
    main()
