"""Trains a model on scene files; resumes from its last checkpoint.

    python -m rigidformer_lab.train --data movi-a.safetensors movi-b.safetensors \\
        --run runs/edge --minutes 60

On many GPUs, or in many processes, one model together:

    torchrun --nproc-per-node N -m rigidformer_lab.train --data ... --run-folder runs/edge --minutes 60

Each process has a GPU where there are some, and draws windows of its own, so an update has N times as many. --slots, --bond-slots and
--threads are of one process. Gradients are averaged, each process alike, as successive batches of one process weigh alike. The first
process tells the time, validates, and writes checkpoint and log. Whoever stops torchrun (SIGTERM, SIGINT) gets a checkpoint of the
last update; the same command goes on from it, with as many processes or others.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import pathlib
import signal
import sys
import time

import numpy as np
import torch
import torch.nn.functional as F
from tqdm import tqdm

from . import breaking
from .config import PRESETS, ModelConfig
from .data import LAST_FRAME, LATEST_START, Dataset, commanded, state_at, with_targets
from .evaluate import evaluate
from .export import changed, described, runs_of
from .model import ANCHORS, RigidFormer, State, transform
from .packed import read_weights
from .prior import use_threads
from .ranks import Ranks, checksum, started_by_torchrun
from .roles import FREE

BETA_M_S = 0.25  # SmoothL1: quadratic below, linear above
#: Layers that `rigidformer pack --dtype i8` keeps at f16.
F16_LAYERS = ("encoder.point.0", "encoder.impact.0", "anchors.query.0", "anchors.head.1", "bonds.net.0")
NOISE_M_S = 0.01  # on the first velocity of a window, as a rate so that s = 1 is not drowned
TURN_M = 0.15  # turning a displaced unit moves what is so far from its centre by as much as the unit is moved


def displaced(rotation, centre, metres):
    """Observed poses (B, M, 2, 3, 3) and (B, M, 2, 3), each unit moved and turned at random, both frames alike: by as many metres and,
    at `TURN_M` from the centre, by as many again. Each window draws a share of that."""
    share = torch.rand(centre.shape[0], 1, 1, device=centre.device) * metres
    shift, turn = (torch.randn_like(centre[:, :, 0]) * share for _ in range(2))
    x, y, z = (turn / TURN_M).unbind(-1)
    o = torch.zeros_like(x)
    spin = torch.stack((o, -z, y, z, o, -x, -y, x, o), -1).unflatten(-1, (3, 3))
    return torch.linalg.matrix_exp(spin)[:, :, None] @ rotation, centre + shift[:, :, None]


def window_loss(model, scene, rotation, centre, horizon, noise=NOISE_M_S, beta=BETA_M_S, teacher=None, places=False, displace=0.0):
    """Closed-loop loss of a window: velocity and mean drift of the anchors, before and
    after the projection, over free units that may have touched something. Models whose state has the velocity at the end
    of a step: that too. `teacher`: a model whose output at the same state is wanted too, as much as one of these. `places`: where the
    anchors are instead, in m/s of one step, so that it pays to make up for what is off. `displace`: metres by which the
    observed units are put elsewhere than recorded."""
    scene = model.measured(scene)
    if scene.length is not None:  # errors too are in the scene's measure
        centre = centre / scene.length[:, None, None, None]
        scene.pace = scene.pace[0] / scene.length[:, None, None, None], scene.pace[1]
    state = state_at(rotation, centre, 1)
    dt = model.dt(scene)[:, None, None, None]
    local = scene.points[:, :, :ANCHORS]
    if displace:
        free = (scene.mask if scene.role is None else scene.mask & (scene.role == FREE))[..., None, None]
        turned, moved = displaced(rotation[:, :, :2], centre[:, :, :2], displace)
        state = state_at(torch.where(free[..., None], turned, rotation[:, :, :2]), torch.where(free, moved, centre[:, :, :2]), 1)
    if noise:
        shake = torch.randn_like(state.centre) * noise * dt[..., 0]
        state.previous_centre = state.previous_centre + shake
    touched = torch.zeros_like(scene.mask)
    before_true = transform(rotation[:, :, 1], centre[:, :, 1], local)
    before = before_true
    total = weight = 0.0
    for k in range(1, horizon + 1):
        state, scene = with_targets(state, rotation, centre, k), commanded(scene, k)
        taught = None
        if teacher is not None:
            with torch.no_grad():
                taught = teacher.network(scene, state)
        prior = model.prior(scene, state)
        out = model.network(scene, state, prior=prior)
        state, raw, active = model.advance(scene, state, out, prior=prior)
        truth = transform(rotation[:, :, k + 1], centre[:, :, k + 1], local)
        rigid = transform(state.rotation, state.centre, local)
        touched = touched | active
        w = touched[..., None, None].float()
        speed = (truth - before_true) / dt
        loss = 0.0
        for guess in (raw, rigid):
            if places:
                errors = ((guess - truth) / dt,)
            else:
                errors = (guess - truth) / (dt * k), (guess - before) / dt - speed  # drift and rate
            for e in errors:
                loss = loss + F.smooth_l1_loss(e, torch.zeros_like(e), beta=beta, reduction="none")
        if prior is not None:
            way, turn = (v[:, :, k + 1] for v in scene.pace)
            fall = 0.5 * model.gravity_of(scene)[:, None] * dt[..., 0].square()
            true_before = transform(
                turn.transpose(-1, -2) @ rotation[:, :, k + 1], centre[:, :, k + 1] - way + fall, local
            )
            e = (rigid - transform(state.previous_rotation, state.previous_centre, local) - truth + true_before) / dt
            loss = loss + F.smooth_l1_loss(e, torch.zeros_like(e), beta=beta, reduction="none")
        if taught is not None:
            loss = loss + F.smooth_l1_loss(out, taught, beta=beta, reduction="none")
        total = total + (loss * w).sum()
        weight = weight + w.sum() * ANCHORS * 3
        before, before_true = rigid, truth
    return total / weight.clamp(min=1.0)


def bond_batch(dataset, steps, count, points, device, noise=NOISE_M_S):
    """(scene, state, frames) for `breaking.loss`: so many windows, seen with noise as others are."""
    windows = dataset.breaking_windows(count, steps)
    rows = [dataset.chosen_units(w, 1, True) for w in windows]
    scene, rotation, centre, _ = dataset.tensors(windows, rows, 1, points, True, device)
    state = state_at(rotation, centre, 1)
    dt = scene.step / scene.frame_rate
    state.previous_centre = state.previous_centre + torch.randn_like(state.centre) * noise * dt[:, None, None]
    _, frame, step = torch.tensor(windows, device=device).unbind(1)
    return commanded(scene, 0), state, torch.stack((frame + step, frame + 2 * step), 1)


@torch.no_grad()
def fit_normalisation(model, dataset, points, device, steps=(1, 5, 10), contact_share=0.8, latest_start=LATEST_START):
    """Feature and position constants from windows, most with contacts, of some step codes."""
    windows = dataset.windows(768, list(steps), 1, contact_share, latest_start)
    features, positions, touches = [], [], []
    for w, rows in dataset.batches(windows, 1, 256, full_share=1.0):
        scene, rotation, centre, _ = dataset.tensors(w, rows, 1, points, True, device)
        scene, state = model.entered(scene, state_at(rotation, centre, 1))
        raw = model.features(scene, state)
        row = torch.arange(raw.shape[2], device=device)
        inside = (row < scene.points_in_use[..., None]) & scene.mask[..., None]
        features.append(raw[inside])
        anchors = transform(state.rotation, state.centre, scene.points[:, :, :ANCHORS])
        positions.append(anchors[scene.mask].flatten(0, 1))
        if model.config.has_impacts:
            rows, valid, _ = model.impacts(scene, state)
            touches.append(rows[valid])
    features, positions = torch.cat(features), torch.cat(positions)
    model.encoder.feature_mean.copy_(features.mean(0))
    model.encoder.feature_scale.copy_(1 / features.std(0).clamp(min=1e-3))
    if touches:
        touches = torch.cat(touches)
        model.encoder.impact_mean.copy_(touches.mean(0))
        model.encoder.impact_scale.copy_(1 / touches.std(0).clamp(min=1e-3))
    model.anchors.position_mean.copy_(positions.mean(0))
    model.anchors.position_scale.copy_(1 / positions.std(0).clamp(min=1e-3))


def rounded(x):
    """Each row of f32 on 255 levels of its own scale; the gradient is that of x."""
    scale = x.detach().abs().amax(-1, keepdim=True).clamp(min=1e-12) / 127
    return x + ((x / scale).round() * scale - x).detach()


def round_layers(model, f16_layers):
    """Weights and inputs of matrix products as int8 models have them; gradients pass."""

    def product(x, layer):
        with torch.autocast(x.device.type, enabled=False):  # bf16 has no 255 levels
            return F.linear(rounded(x.float()), rounded(layer.weight), layer.bias)

    for name, layer in model.named_modules():
        if isinstance(layer, torch.nn.Linear) and name not in f16_layers:
            layer.forward = lambda x, layer=layer: product(x, layer)


def draws_kept(device):
    """What is drawn within changes nothing of what is drawn afterwards. Of GPUs it keeps this rank's alone: the others are other ranks',
    and to ask for their state takes memory there."""
    return torch.random.fork_rng([torch.cuda.current_device()] if device == "cuda" else [])


def read_teacher(path, preset, device):
    """A frozen model of a preset, from a packed f32 file."""
    with draws_kept(device):  # so that runs with and without one draw the same noise
        model = RigidFormer(PRESETS[preset]).to(device).eval()
    model.load_state_dict(read_weights(path))
    return model.requires_grad_(False)


def read_average(path, device):
    """Averaged weights of a checkpoint."""
    return torch.load(path, map_location=device, weights_only=False)["average"]


class Average:
    """Exponential moving average of the weights: what is evaluated and exported."""

    def __init__(self, model, decay):
        self.decay, self.count = decay, 0
        self.weights = {k: v.detach().clone() for k, v in model.state_dict().items()}

    @torch.no_grad()
    def update(self, model):
        self.count += 1
        decay = min(self.decay, (1 + self.count) / (10 + self.count))
        for k, v in model.state_dict().items():
            if v.is_floating_point():
                self.weights[k].lerp_(v, 1 - decay)


def read_checkpoint(path, device):
    """What a run has saved; None: nothing yet."""
    return torch.load(path, map_location=device, weights_only=False) if path.exists() else None


def save(path, **what):
    temporary = path.with_suffix(".tmp")
    torch.save(what, temporary)
    os.replace(temporary, path)


def positive(text):
    if (value := int(text)) < 1:
        raise argparse.ArgumentTypeError("takes 1 or more")
    return value


def horizons(text):
    """`6`, or `1:.1`, which is 1 until a tenth of the time is over."""
    number, _, until = text.partition(":")
    return positive(number), share(until or "1")


def share(text):
    if not 0 <= (value := float(text)) <= 1:
        raise argparse.ArgumentTypeError("takes a share from 0 to 1")
    return value


def contacts(text):
    return None if text == "natural" else share(text)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", nargs="+", required=True, type=pathlib.Path)
    parser.add_argument("--run", "--run-folder", required=True, type=pathlib.Path,
                        help="folder of checkpoints and log; torchrun takes --run for one of its own, so give it --run-folder")
    parser.add_argument("--preset", default="edge", choices=PRESETS)
    parser.add_argument("--minutes", type=float, default=60, help="training time of the whole run, resumed parts added")
    parser.add_argument("--steps", type=int, nargs="+", default=[1, 5, 10],
                        help="frames a step, step codes of scenes at the model's frame rate; repeat one to weigh it")
    parser.add_argument("--horizon", type=horizons, nargs="+", default=[(6, 1.0)], metavar="N[:UNTIL]",
                        help="closed-loop predictions a window (default 6); `1:.1 3:.25 9`: 1 until a tenth of the time is "
                        "over, then 3 until a quarter of it is, then 9")  # fmt: skip
    parser.add_argument("--last-frame", type=positive, default=LAST_FRAME,
                        help="last frame of a scene that is learnt from, and latest that a window begins at (default "
                        "%(default)s, where windows begin at 110 at the latest)")  # fmt: skip
    parser.add_argument("--points", type=int, default=32, help="random points a unit")
    parser.add_argument("--slots", type=int, default=192, help="units a batch, about; under torchrun in each process")
    parser.add_argument("--lr", type=float, default=1e-3)
    parser.add_argument("--decay", type=float, default=0.999, help="of the averaged weights")
    parser.add_argument("--checkpoint-minutes", type=float, default=4)
    parser.add_argument("--validate-minutes", type=float, default=20)
    parser.add_argument("--start-from", type=pathlib.Path, help="weights of another run's checkpoint, or of a packed f32 model")
    parser.add_argument("--own-scales", action="store_true",
                        help="with --start-from: normalise inputs by what these scenes have, not as the older model did")
    parser.add_argument("--late", action=argparse.BooleanOptionalAction, default=True,
                        help="take long scenes' later frames too, where bodies land and rest")  # fmt: skip
    parser.add_argument("--masked", type=float, default=0.25, help="share of the scenes whose units lack points")
    parser.add_argument("--rigid", action="store_true", help="take contact as rigid, whatever law the scenes have")
    parser.add_argument("--join", action="store_true",
                        help="hold the parts of a body together at pivots in the loop, as `rigidformer evaluate --join` does")
    parser.add_argument("--bond-slots", type=positive, default=8, help="of models with bonds: single steps an update that say what breaks")
    parser.add_argument("--bond-weight", type=float, default=0.05, help="of models with bonds: of that loss beside the others")
    compare = parser.add_argument_group("for comparisons")
    compare.add_argument("--updates", type=positive, help="end after so many updates, whatever time they take")
    compare.add_argument("--config", type=json.loads, default={}, metavar="JSON",
                         help='fields of the preset to change: \'{"gate": false}\'')  # fmt: skip
    compare.add_argument("--noise", type=float, default=NOISE_M_S, help="on a window's first velocity, m/s")
    compare.add_argument("--loss-beta", type=float, default=BETA_M_S, help="m/s up to which the loss is quadratic")
    compare.add_argument("--loss", choices=("motion", "places"), default="motion",
                         help="how wrong drift and velocities are, or places: then it pays to make up for what is off")
    compare.add_argument("--displace", type=float, default=0.0, metavar="M", help="put units of a window elsewhere at its begin, metres")
    compare.add_argument("--contacts", type=contacts, default=0.8,
                         help="share of each step code's windows with a contact; `natural`: as they are drawn")
    compare.add_argument("--whole", type=share, default=0.25,
                         help="share of the windows that are whole scenes; the others are units near enough to touch")
    compare.add_argument("--teacher", type=pathlib.Path, help="packed f32 edge model to learn from, beside the records")
    compare.add_argument("--int8", action="store_true", help="round weights and inputs of layers as int8 models do")
    compare.add_argument("--f16-layers", nargs="*", default=F16_LAYERS, help="layers that --int8 leaves alone")
    parser.add_argument("--bf16", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=positive, help="of the processor (default: one a core)")
    args = parser.parse_args()
    device = "cuda" if torch.cuda.is_available() else "cpu"
    ranks = Ranks(device)
    args.processes = ranks.size
    if ranks.here > 1 and not args.threads:  # processes that want all cores wait for each other
        args.threads = max(1, (os.cpu_count() or 1) // ranks.here)
    if args.threads:
        torch.set_num_threads(args.threads)
        use_threads(args.threads)
    torch.manual_seed(args.seed)
    if ranks.first:
        args.run.mkdir(parents=True, exist_ok=True)
    latest_start = LATEST_START if args.last_frame == LAST_FRAME else args.last_frame
    if [until for _, until in args.horizon] != sorted(until for _, until in args.horizon) or args.horizon[-1][1] < 1:
        parser.error("--horizon: give shares that rise, and a last one without a share")
    dataset = Dataset(args.data, [0, 3], last_frame=args.last_frame, late=args.late, masked=args.masked, join=args.join)
    dataset.rng = np.random.default_rng(args.seed)
    try:
        config = ModelConfig.from_json(json.dumps({**dataclasses.asdict(PRESETS[args.preset]), **args.config}))
    except (TypeError, ValueError) as error:
        parser.error(f"--config: {error}")
    if args.rigid:
        dataset.worlds.law[:] = 0
    if config.most_units and dataset.worlds.law.any():
        parser.error(f"{config.name} leaves scenes with a contact law alone, and --data has some; learn over rigid contact by --rigid, or over "
                     "the law by --config '{\"most_units\": 0}'")
    if config.command_size != dataset.command_size:
        parser.error(f"{config.name} takes commands of {config.command_size} numbers, --data has commands of "
                     f"{dataset.command_size}; set command_size by --config, or give other scenes")
    model = RigidFormer(config).initialise().to(device)
    model.bf16 = args.bf16
    shared = {name: value for name, value in vars(args).items() if name not in ("run", "threads")}
    data = described(args.data)
    ranks.check_alike("scenes or arguments", f"{data}, {json.dumps(shared, default=str)}", "give all the same")
    teacher = args.teacher and read_teacher(args.teacher, "edge", device)
    if not ranks.first:
        pass  # takes over the constants of the first, below
    elif config.motion == "robot":
        fit_normalisation(model, dataset, args.points, device, args.steps, None, latest_start)
    else:
        fit_normalisation(model, dataset, args.points, device)
    if config.bonds:
        if dataset.bonds is None:
            parser.error(f"{config.name} learns which bonds break, and --data has none; give scenes with bonds, such as `fragments`")
        if ranks.first:
            breaking.fit_normalisation(model, [bond_batch(dataset, args.steps, 16, args.points, device) for _ in range(24)])
    ranks.share_weights(model)
    if not ranks.first:
        dataset.rng = np.random.default_rng(ranks.seed(args.seed))
        torch.manual_seed(ranks.seed(args.seed))
    optimizer = torch.optim.AdamW(model.parameters(), lr=args.lr, weight_decay=0.01)
    average = Average(model, args.decay)
    spent, updates, seen = 0.0, 0, 0
    runs, resumed = [], []  # beside `data`, what the model will say of its making
    checkpoint = args.run / "checkpoint.pt"
    # Other ranks may be on machines that lack it.
    saved = ranks.shared(read_checkpoint(checkpoint, device if ranks.size == 1 else "cpu") if ranks.first else None)
    if saved:
        if ModelConfig.from_json(saved["config"]) != config:
            parser.error(f"{checkpoint} is of another configuration: {saved['config']}; give that one, or another --run")
        model.load_state_dict(saved["model"])
        optimizer.load_state_dict(saved["optimizer"])
        average.weights, average.count = {k: v.to(device) for k, v in saved["average"].items()}, saved["average_count"]
        spent, updates, seen = saved["spent"], saved["updates"], saved["seen"]
        runs, resumed = saved.get("runs", []), saved.get("resumed", [])
        if what := changed(saved["arguments"], vars(args)):
            resumed = [*resumed, f"resumed at minute {spent / 60:.1f} with {what}"]
        dataset.rng = np.random.default_rng(ranks.seed(args.seed + updates))
        torch.manual_seed(ranks.seed(args.seed + updates))
        if ranks.first:
            print(f"resumed {checkpoint} after {spent / 60:.1f} min, {updates} updates", file=sys.stderr)
    elif args.start_from:
        runs = runs_of(args.start_from)
        if args.start_from.suffix == ".rfm" or args.own_scales:
            weights = read_weights(args.start_from) if args.start_from.suffix == ".rfm" else read_average(args.start_from, device)
            own = model.state_dict()
            for name, value in own.items():  # what the older model lacks starts afresh and is not heard of yet
                old = weights.get(name)
                is_scale = args.own_scales and name.endswith(("_mean", "_scale"))
                if is_scale or old is None or old.shape[:1] != value.shape[:1] or old.shape[1:] > value.shape[1:]:
                    weights[name] = value  # other outputs, or fewer inputs: as at the start too
                elif old.shape != value.shape:
                    weights[name] = torch.zeros_like(value)
                    weights[name][:, : old.shape[1]] = old
            weights = {name: weights[name] for name in own}
            model.load_state_dict(weights)
        else:
            model.load_state_dict(read_average(args.start_from, device))
        ranks.share_weights(model)
        average = Average(model, args.decay)
    if args.int8:
        round_layers(model, args.f16_layers)
    parameters = sum(p.numel() for p in model.parameters())
    if ranks.first:
        many = f", {ranks.size} processes" if ranks.size > 1 else ""
        print(f"{config.name}: {parameters} parameters, {len(dataset)} scenes, {device}{many}", file=sys.stderr)

    def write(path=checkpoint):
        if not ranks.first:
            return
        save(
            path, model=model.state_dict(), optimizer=optimizer.state_dict(),
            average=average.weights, average_count=average.count, spent=spent,
            updates=updates, seen=seen, config=config.to_json(),
            arguments=json.loads(json.dumps(vars(args), default=str)),
            data=data, runs=runs, resumed=resumed,
        )  # fmt: skip

    def check():
        ranks.check_alike("weights", ranks.size > 1 and checksum(model, optimizer, average),
                          f"the same command goes on from {checkpoint}, which is that of rank 0")

    budget = args.minutes * 60
    log = (args.run / "log.jsonl").open("a") if ranks.first else None
    bar = tqdm(total=round(args.minutes, 2), disable=not (ranks.first and sys.stderr.isatty()), unit="min")
    mean, stopped = None, False
    since_checkpoint = since_validation = 0.0
    last_line = time.time()

    def progress():
        return min(updates / args.updates if args.updates else spent / budget, 1.0)

    while progress() < 1 and not stopped:
        dataset.refresh_subsets(args.points)
        horizon = next(number for number, until in args.horizon if progress() < until)
        windows = dataset.windows(512 if len(args.horizon) == 1 else 128, args.steps, horizon, args.contacts, latest_start)
        for w, rows in dataset.batches(windows, horizon, args.slots, args.whole):
            began = time.time()
            warm = min(1.0, (updates + 1) / 200)
            lr = args.lr * warm * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress())))
            for group in optimizer.param_groups:
                group["lr"] = lr
            scene, rotation, centre, _ = dataset.tensors(w, rows, horizon, args.points, True, device)
            loss = window_loss(model, scene, rotation, centre, horizon, args.noise, args.loss_beta, teacher,
                               args.loss == "places", args.displace)
            if config.bonds:
                loss = loss + args.bond_weight * breaking.loss(model, *bond_batch(dataset, args.steps, args.bond_slots, args.points, device))
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            ranks.average_gradients(model)
            norm = torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
            if torch.isfinite(norm):
                optimizer.step()
                average.update(model)
            took, count, value, stopped = ranks.totals(time.time() - began, len(w), float(loss.detach()))
            updates, seen = updates + 1, seen + count
            spent, since_checkpoint, since_validation = (
                spent + took, since_checkpoint + took, since_validation + took,
            )  # fmt: skip
            mean = value if mean is None else mean + 0.02 * (value - mean)
            bar.update(took / 60)
            if ranks.first and time.time() - last_line > 30:
                last_line = time.time()
                line = {"min": round(spent / 60, 2), "updates": updates, "windows": seen,
                        "loss": round(mean, 5), "lr": round(lr, 6)}  # fmt: skip
                print(json.dumps(line), file=log, flush=True)
                if not sys.stderr.isatty():
                    print(line, file=sys.stderr, flush=True)
            if since_checkpoint > args.checkpoint_minutes * 60:
                since_checkpoint = 0.0
                write()
                check()
            if progress() >= 1 or stopped:
                break
        # Ranks come here at different updates, since their batches differ: nothing here may wait for the others.
        if ranks.first and not stopped and since_validation > args.validate_minutes * 60:
            since_validation = 0.0
            write()
            validate(config, average, args, log, device, spent)
    write()
    check()
    if ranks.first and not stopped:
        validate(config, average, args, log, device, spent)
    ranks.end()
    if stopped:
        if ranks.first:
            print(f"stopped after {updates} updates; the same command goes on from {checkpoint}", file=sys.stderr)
        sys.exit(128 + signal.SIGTERM)


def validate(config: ModelConfig, average, args, log, device, spent):
    with draws_kept(device):
        model = RigidFormer(config).to(device)
    model.load_state_dict(average.weights)
    if args.int8:
        round_layers(model, args.f16_layers)
    for path in args.data:
        try:
            rows = evaluate(model, path, split=1, limit=40, device=device, points=64, rigid=args.rigid)
        except SystemExit:
            continue  # a part of extra seeds has no validation scenes
        line = {"min": round(spent / 60, 2), "validation": path.stem, **rows}
        print(json.dumps(line), file=log, flush=True)
        print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    started_by_torchrun(main)()
