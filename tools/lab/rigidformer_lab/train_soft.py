"""Trains a model of soft bodies on scene files; resumes from its last checkpoint.

    python -m rigidformer_lab.train_soft --preset shell --data shell.safetensors --run runs/shell --minutes 60

A window starts from a recorded frame and goes on from what the model itself made of the frames before. Each step is learnt by
itself: no gradient passes from one to the next, through springs and contact.
"""

from __future__ import annotations

import argparse
import json
import math
import pathlib
import sys
import time

import numpy as np
import torch
import torch.nn.functional as F
from tqdm import tqdm

from .config import PRESETS
from .export import changed, described, runs_of
from .packed import read_weights
from .soft_data import batch_of, records, state_at, velocity_at
from .soft_model import SoftFormer
from .train import BETA_M_S, F16_LAYERS, Average, positive, round_layers, save

NOISE_M = 0.0  # on the points of a window's first frames, both alike, and as a rate on the one before
EARLY = 0.5  # share of the windows that begin where rollouts do: at the first frames of a scene
LAST_START = 105  # frame that a window begins at, at the latest


def physical(batch, points, truth, weights):
    """What the laws that soft bodies obey say of predicted points (B, M P, 3): a mean each of stretch, of bending, of volume and of
    how deep points are in others, times its weight."""
    total = points.new_zeros(())
    for b, r in enumerate(batch.records):
        x, true = points[b][batch.slots[b]], truth[b][batch.slots[b]]
        first, second = torch.from_numpy(r.web.first), torch.from_numpy(r.web.second)
        if weights["stretch"]:  # springs that are longer or shorter than recorded
            length = torch.from_numpy(r.web.length)
            wrong = ((x[first] - x[second]).norm(dim=-1) - (true[first] - true[second]).norm(dim=-1)) / length
            total = total + weights["stretch"] * wrong.square().mean()
        if weights["bend"]:  # how far a mass is from the middle of its neighbours
            size = len(x)
            middle = x.new_zeros(size, 3)
            e = x - true
            middle = middle.index_add(0, first, e[second] - e[first]).index_add(0, second, e[first] - e[second])
            many = x.new_zeros(size).index_add(0, first, torch.ones_like(first, dtype=x.dtype))
            many = many.index_add(0, second, torch.ones_like(second, dtype=x.dtype)).clamp(min=1)
            total = total + weights["bend"] * (middle / many[:, None] / float(r.web.spacing.mean())).square().sum(-1).mean()
        if weights["volume"] and len(r.tetrahedra):
            t = torch.from_numpy(r.tetrahedra).long()

            def volume(p):
                a, b_, c, d = (p[t[:, k]] for k in range(4))
                return (torch.linalg.cross(b_ - a, c - a) * (d - a)).sum(-1)

            own = volume(true)
            total = total + weights["volume"] * ((volume(x) - own) / own.abs().mean()).square().mean()
        if weights["depth"]:
            deep = x.new_zeros(len(x))
            for plane in r.planes:
                n = torch.from_numpy(plane[:3])
                deep = deep + (plane[3] - x @ n).clamp(min=0)
            for k in range(len(r.centre)):
                if r.obstacles.ball[k] > 0:
                    deep = deep + (float(r.obstacles.ball[k]) - (x - torch.from_numpy(r.centre[k, 0])).norm(dim=-1)).clamp(min=0)
            total = total + weights["depth"] * (deep / float(r.web.spacing.mean())).mean()
    return total / len(batch.records)


def targets(model, batch, state):
    """Recorded points and velocities (B, M P, 3) at the frames of a state."""
    points = model.padded(batch, [r.points[f] for r, f in zip(batch.records, state.frame)])
    velocity = model.padded(batch, [velocity_at(r, f) for r, f in zip(batch.records, state.frame)])
    return points.flatten(1, 2), velocity.flatten(1, 2)


def step_loss(model, batch, state, weights, beta=BETA_M_S):
    """The next state, and the loss of the step to it."""
    after, points, velocity = model.step(batch, state)
    true, rate = targets(model, batch, after)
    row = torch.arange(batch.rest.shape[2])
    own = ((row < batch.points_in_use[..., None]) & batch.soft[..., None]).flatten(1)[..., None]
    loss = 0.0
    for error in ((points - true) / batch.dt[:, None, None], velocity - rate):
        each = F.smooth_l1_loss(error, torch.zeros_like(error), beta=beta, reduction="none") * own
        loss = loss + (each.sum((1, 2)) / own.sum((1, 2)) / 3).mean()
    if any(weights.values()):
        loss = loss + physical(batch, points, true, weights)
    return after, loss


def rollout_errors(model, scenes, step, frames=(25, 50, 100)):
    """Mean distance of the points from where they were recorded, metres, at frames after the last one seen."""
    errors = {f: [] for f in frames}
    with torch.no_grad():
        for low in range(0, len(scenes), 8):
            own = scenes[low : low + 8]
            batch = batch_of(own, step)
            state = state_at(own, [step] * len(own), step)
            for k in range(max(frames) // step):
                state, _, _ = model.step(batch, state)
                at = (k + 1) * step
                if at in errors:
                    errors[at] += [
                        float(np.linalg.norm(x - r.points[step + at], axis=1).mean())
                        for x, r in zip(state.points, own) if step + at < r.frames
                    ]  # fmt: skip
    return {f: round(float(np.mean(e)), 5) for f, e in errors.items() if e}


@torch.no_grad()
def fit_normalisation(model, scenes, step, rng):
    features, inside = [], []
    for _ in range(24):
        own = [scenes[i] for i in rng.integers(len(scenes), size=8)]
        frames = [int(rng.integers(step, min(LAST_START, r.frames - step - 1))) for r in own]
        batch, state = batch_of(own, step, rng), state_at(own, frames, step)
        raw, points, _, _ = model.soft_features(batch, state, model.motion_of(batch, state))
        used = torch.arange(points.shape[2]) < batch.points_in_use[..., None]
        features.append(raw[used])
        inside.append(points[:, :, :4][batch.mask])
    features, inside = torch.cat(features), torch.cat(inside).flatten(0, 1)
    model.encoder.feature_mean.copy_(features.mean(0))
    model.encoder.feature_scale.copy_(1 / features.std(0).clamp(min=1e-3))
    model.anchors.position_mean.copy_(inside.mean(0))
    model.anchors.position_scale.copy_(1 / inside.std(0).clamp(min=1e-3))


def windows(scenes, steps, horizon, size, rng):
    """(scenes, frames, step): a batch of windows of one step code."""
    step = int(rng.choice(steps))
    own = [scenes[i] for i in rng.integers(len(scenes), size=size)]
    latest = [max(step, min(LAST_START, r.frames - 1 - step * horizon)) for r in own]
    frames = [step if rng.random() < EARLY else int(rng.integers(step, last + 1)) for last in latest]
    return own, frames, step


def shaken(state, batch, metres, rng):
    """Noise on what is seen, alike for all rows of one mass."""
    for b, r in enumerate(batch.records):
        for where, share in ((state.points, 1.0), (state.before, 1.0)):
            noise = (rng.standard_normal(where[b].shape) * metres * share * rng.random()).astype(np.float32)[r.web.owner]
            where[b] = where[b] + noise
            if where is state.points:
                state.before[b] = state.before[b] + noise
    return state


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", nargs="+", required=True, type=pathlib.Path)
    parser.add_argument("--run", required=True, type=pathlib.Path, help="folder of checkpoints and log")
    parser.add_argument("--preset", default="shell", choices=[name for name, c in PRESETS.items() if c.motion == "soft"])
    parser.add_argument("--minutes", type=float, default=60, help="training time of the whole run, resumed parts added")
    parser.add_argument("--steps", type=positive, nargs="+", default=[5], help="frames a step; repeat one to weigh it")
    parser.add_argument("--horizon", type=positive, default=6, help="steps a window")
    parser.add_argument("--slots", type=positive, default=8, help="windows a batch")
    parser.add_argument("--lr", type=float, default=1e-3)
    parser.add_argument("--decay", type=float, default=0.999, help="of the averaged weights")
    parser.add_argument("--noise", type=float, default=NOISE_M, help="metres")
    parser.add_argument("--limit", type=positive, help="scenes to learn from, at most")
    parser.add_argument("--checkpoint-minutes", type=float, default=4)
    parser.add_argument("--validate-minutes", type=float, default=15)
    parser.add_argument("--start-from", type=pathlib.Path, help="weights of another run's checkpoint, or of a packed f32 or f16 model")
    parser.add_argument("--int8", action="store_true", help="round weights and inputs of layers as int8 models do")
    laws = parser.add_argument_group("laws, as weights beside the loss (0: not taught)")
    laws.add_argument("--stretch", type=float, default=1.0, help="lengths between neighbours are those recorded")
    laws.add_argument("--bend", type=float, default=0.0, help="a point lies to its neighbours as recorded")
    laws.add_argument("--volume", type=float, default=0.0, help="tetrahedra keep the volumes recorded")
    laws.add_argument("--depth", type=float, default=1.0, help="no point is in a plane or a rigid ball")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(args.seed)
    args.run.mkdir(parents=True, exist_ok=True)
    config = PRESETS[args.preset]
    scenes = records(config, args.data, [0, 3], args.limit)
    checked = records(config, args.data, [1], 24)
    rng = np.random.default_rng(args.seed)
    model = SoftFormer(config).initialise()
    weights = {name: getattr(args, name) for name in ("stretch", "bend", "volume", "depth")}
    fit_normalisation(model, scenes, args.steps[0], rng)
    average = Average(model, args.decay)
    optimizer = torch.optim.AdamW(model.parameters(), lr=args.lr, weight_decay=0.01)
    spent, updates, seen = 0.0, 0, 0
    data, runs, resumed = described(args.data), [], []
    checkpoint = args.run / "checkpoint.pt"
    if checkpoint.exists():
        saved = torch.load(checkpoint, map_location="cpu", weights_only=False)
        if saved["config"] != config.to_json():
            parser.error(f"{checkpoint} is of another configuration: {saved['config']}; give another --run")
        model.load_state_dict(saved["model"])
        optimizer.load_state_dict(saved["optimizer"])
        average.weights, average.count = saved["average"], saved["average_count"]
        spent, updates, seen, runs, resumed = (saved[k] for k in ("spent", "updates", "seen", "runs", "resumed"))
        if what := changed(saved["arguments"], vars(args)):
            resumed = [*resumed, f"resumed at minute {spent / 60:.1f} with {what}"]
        rng = np.random.default_rng(args.seed + updates)
        print(f"resumed {checkpoint} after {spent / 60:.1f} min, {updates} updates", file=sys.stderr)
    elif args.start_from:
        runs = runs_of(args.start_from)
        if args.start_from.suffix == ".rfm":
            model.load_state_dict(read_weights(args.start_from))
        else:
            model.load_state_dict(torch.load(args.start_from, map_location="cpu", weights_only=False)["average"])
        average = Average(model, args.decay)
    if args.int8:
        round_layers(model, F16_LAYERS)
    print(f"{config.name}: {sum(p.numel() for p in model.parameters())} parameters, {len(scenes)} scenes", file=sys.stderr)

    def write():
        save(checkpoint, model=model.state_dict(), optimizer=optimizer.state_dict(), average=average.weights,
             average_count=average.count, spent=spent, updates=updates, seen=seen, config=config.to_json(),
             arguments=json.loads(json.dumps(vars(args) | {"points": "all"}, default=str)), data=data, runs=runs, resumed=resumed)  # fmt: skip

    log = (args.run / "log.jsonl").open("a")

    def say(line):
        print(json.dumps(line), file=log, flush=True)
        print(line, file=sys.stderr, flush=True)

    def validate():
        with torch.random.fork_rng():
            copy = SoftFormer(config)
        copy.load_state_dict(average.weights)
        if args.int8:
            round_layers(copy, F16_LAYERS)
        if checked:
            say({"min": round(spent / 60, 2), "validation": rollout_errors(copy, checked, args.steps[0])})

    budget, mean, last = args.minutes * 60, None, time.time()
    since_checkpoint = since_validation = 0.0
    bar = tqdm(total=round(args.minutes, 2), disable=not sys.stderr.isatty(), unit="min")
    if not updates:
        validate()
    while spent < budget:
        began = time.time()
        rate = args.lr * min(1.0, (updates + 1) / 200) * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * min(spent / budget, 1))))
        for group in optimizer.param_groups:
            group["lr"] = rate
        own, frames, step = windows(scenes, args.steps, args.horizon, args.slots, rng)
        batch = batch_of(own, step, rng)
        state = shaken(state_at(own, frames, step), batch, args.noise, rng)
        optimizer.zero_grad(set_to_none=True)
        total = 0.0
        for _ in range(args.horizon):
            state, loss = step_loss(model, batch, state, weights)
            (loss / args.horizon).backward()
            total += float(loss.detach()) / args.horizon
        norm = torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        if torch.isfinite(norm):
            optimizer.step()
            average.update(model)
        updates, seen = updates + 1, seen + len(own)
        took = time.time() - began
        spent, since_checkpoint, since_validation = spent + took, since_checkpoint + took, since_validation + took
        mean = total if mean is None else mean + 0.02 * (total - mean)
        bar.update(took / 60)
        if time.time() - last > 30:
            last = time.time()
            say({"min": round(spent / 60, 2), "updates": updates, "windows": seen, "loss": round(mean, 5), "lr": round(rate, 6)})
        if since_checkpoint > args.checkpoint_minutes * 60:
            since_checkpoint = 0.0
            write()
        if since_validation > args.validate_minutes * 60:
            since_validation = 0.0
            write()
            validate()
    write()
    validate()


if __name__ == "__main__":
    main()
