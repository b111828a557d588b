"""Trains a model of rigid bodies on single steps whose inputs the runtime has worked out: ten times as many windows a second as `train`.

    python -m rigidformer_lab.windows movi-a.safetensors --out windows/train
    python -m rigidformer_lab.windows movi-a.safetensors --splits 1 --count 6000 --out windows/validation
    python -m rigidformer_lab.train_steps windows/train --validation windows/validation --run runs/edge --minutes 20

Resumes from its last checkpoint. It starts with a head of zeros, which is the motion without the network, or from --start-from. What is
learnt is what the way and the velocity of a unit's anchors lack at the end of a step. `train` goes on from its checkpoint with closed
loops, and `export` packs either one's. The log has errors on validation windows, and the share of them that the network takes away.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import pathlib
import signal
import sys
import time

import numpy as np
import torch
import torch.nn.functional as F
from tqdm import tqdm

from .config import PRESETS, ModelConfig
from .export import changed, runs_of
from .model import RigidFormer, Scene
from .packed import read_weights
from .train import Average, positive, read_average, read_checkpoint, save
from .windows import IMPACT_VECTORS, POINT_VECTORS, ROW, WINDOW, read

BETA_M_S = 0.02  # of the loss: quadratic below, linear above; velocities are in the scenes' own measure
FARTHEST = 3.0  # how far a window is moved at random, in the scenes' own length: nothing depends on where a scene is
MOST_ROWS = 24  # of a window


def has_bf16(device):
    """Whether products of bf16 are quicker there than those of f32; other processors emulate them, at twice the time."""
    return device == "cuda" or any(getattr(torch.cpu, f"_is_{kind}_supported", lambda: False)() for kind in ("amx_tile", "avx512_bf16"))


class Batches:
    """Windows of some folders in memory, drawn by how much there is to learn from them."""

    def __init__(self, folders, limit=None, read=read):
        """`read`: arrays of one of the folders, and what it is of."""
        read_all = [read(folder) for folder in folders]
        self.described = [description for _, description in read_all]
        if len({json.dumps([d["features"], d["length_m"]]) for d in self.described}) > 1:
            raise SystemExit("the folders of windows are of models of different measures; make them with one preset")
        self.rows = {name: torch.from_numpy(np.concatenate([a[name] for a, _ in read_all])) for name in ROW}
        starts, base = [], 0
        for arrays, _ in read_all:
            starts.append(arrays["start"][:-1] + base)
            base += int(arrays["start"][-1])
        self.start = np.concatenate((*starts, [base]))
        self.code = np.concatenate([a["code"] for a, _ in read_all])
        self.count = np.diff(self.start)
        self.windows = np.flatnonzero(self.count <= MOST_ROWS)[:limit]

    def __len__(self):
        return len(self.windows)

    def draw(self, rng, slots):
        """Lists of windows of similar size, about `slots` units each; together all windows once."""
        order = rng.permutation(self.windows)
        order = order[np.argsort(self.count[order], kind="stable")]
        batches, batch = [], []
        for window in order:
            if batch and (len(batch) + 1) * self.count[window] > slots:
                batches.append(batch)
                batch = []
            batch.append(window)
        batches.append(batch)
        rng.shuffle(batches)
        return batches

    def tensors(self, batch, device, rng=None):
        """(scene, raw features, anchors in the world, (impacts, valid, pushes), share, wanted) of a batch; rng: turned about the vertical
        and moved at random."""
        batch = np.asarray(batch)
        counts = self.count[batch]
        width = int(counts.max())
        column = np.arange(width)
        mask = column < counts[:, None]
        index = torch.from_numpy(np.where(mask, self.start[batch][:, None] + column, self.start[batch][:, None]))
        one = {name: values[index] for name, values in self.rows.items()}
        mask = torch.from_numpy(mask).to(device)
        one = {name: (values.float() if values.dtype == torch.float16 else values).to(device) for name, values in one.items()}
        raw, impacts, place = one["features"], one["impacts"], one["place"]
        pushes, wanted = one["pushes"], one["wanted"]
        if rng is not None:
            angle = torch.from_numpy(rng.random(len(batch)).astype(np.float32) * 2 * np.pi).to(device)
            turn = torch.zeros(len(batch), 3, 3, device=device)
            turn[:, 0, 0] = turn[:, 1, 1] = angle.cos()
            turn[:, 1, 0], turn[:, 0, 1] = angle.sin(), -angle.sin()
            turn[:, 2, 2] = 1
            shift = torch.zeros(len(batch), 1, 1, 3, device=device)
            shift[..., :2] = torch.from_numpy(rng.uniform(-FARTHEST, FARTHEST, (len(batch), 1, 1, 2)).astype(np.float32)).to(device)
            flat = turn.transpose(-1, -2)[:, None, None]
            middle = place.mean((1, 2), keepdim=True) * place.new_tensor((1.0, 1.0, 0.0))
            place = (place - middle) @ turn.transpose(-1, -2)[:, None] + shift
            for values, vectors in ((raw, POINT_VECTORS), (impacts, IMPACT_VECTORS)):
                for at in vectors:
                    values[..., at : at + 3] = values[..., at : at + 3] @ flat[:, 0]
            pushes, wanted = ((v.unflatten(-1, (2, 3)) @ flat).flatten(-2) for v in (pushes, wanted))
        scene = Scene(
            points=one["points"], points_in_use=one["points_in_use"].long(), mask=mask, physics=None, radius=None, reference=None, start=None,
            count=None, scale=None, bank=None, step=torch.from_numpy(self.code[batch]).to(device),
            full=bool((one["points_in_use"] == one["points"].shape[2]).all()),
        )  # fmt: skip
        valid = torch.arange(impacts.shape[2], device=device) < one["impact_count"][..., None]
        return scene, raw, place, (impacts, valid, pushes), one["share"] * mask, (wanted, one["known"] & mask[..., None])


def predicted(model, scene, raw, place, impacts):
    """(B, M, A, 6): the network's output, of scenes in the model's own measure."""
    with torch.autocast(raw.device.type, torch.bfloat16, enabled=model.bf16):
        return model.learned(scene, raw, place, None, impacts, scene.mask) * model.config.output_scale


def loss_of(model, batch, beta):
    """Loss over the units that the network corrects."""
    scene, raw, place, impacts, share, (wanted, known) = batch
    out = predicted(model, scene, raw, place, impacts)
    error = (out * share[..., None, None] - wanted).unflatten(-1, (2, 3)).transpose(2, 3)
    error = error[known & (share > 0)[..., None]]
    return F.smooth_l1_loss(error, torch.zeros_like(error), beta=beta)


@torch.no_grad()
def validate(model, batches, device, slots):
    """Mean error of anchors' ways and velocities on all windows, without and with the network, m/s; mean of the errors' sizes."""
    sums = np.zeros((3, 2))
    for batch in batches.draw(np.random.default_rng(0), slots):
        scene, raw, place, impacts, share, (wanted, known) = batches.tensors(batch, device)
        out = predicted(model, scene, raw, place, impacts) * share[..., None, None]
        chosen = known & (share > 0)[..., None]
        for row, values in enumerate((wanted, wanted - out)):
            size = values.unflatten(-1, (2, 3)).norm(dim=-1).mean(2).double() * chosen
            sums[row] += size.sum((0, 1)).cpu().numpy()
        sums[2] += chosen.sum((0, 1)).cpu().numpy()
    without, with_ = sums[0] / sums[2], sums[1] / sums[2]
    names = ("way_m_s", "velocity_m_s")
    out = {name: round(float(value), 5) for name, value in zip(names, with_)}
    return out | {"gain": [round(float(1 - a / b), 4) if b else 0.0 for a, b in zip(with_, without)]}


def fit_normalisation(model, batches, rng, count=400):
    """Constants of the inputs, from windows at random."""
    features, touches, positions = [], [], []
    for batch in batches.draw(rng, 192)[:count]:
        scene, raw, place, (impacts, valid, _), *_ = batches.tensors(batch, "cpu", rng)
        features.append(raw[scene.mask].flatten(0, 1)[::4])
        touches.append(impacts[valid & scene.mask[..., None]])
        positions.append(place[scene.mask].flatten(0, 1))
    for values, mean, scale in (
        (features, model.encoder.feature_mean, model.encoder.feature_scale), (touches, model.encoder.impact_mean, model.encoder.impact_scale),
        (positions, model.anchors.position_mean, model.anchors.position_scale),
    ):  # fmt: skip
        values = torch.cat(values)
        mean.copy_(values.mean(0))
        scale.copy_(1 / values.std(0).clamp(min=1e-3))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("windows", nargs="+", type=pathlib.Path, help="folders of `rigidformer_lab.windows`")
    parser.add_argument("--validation", nargs="*", type=pathlib.Path, default=[], help="folders of windows that nothing is learnt from")
    parser.add_argument("--run", required=True, type=pathlib.Path, help="folder of checkpoints and log")
    parser.add_argument("--preset", default="edge", choices=PRESETS)
    parser.add_argument("--config", type=json.loads, default={}, metavar="JSON", help="fields of the preset to change")
    parser.add_argument("--minutes", type=float, default=20, help="training time of the whole run, resumed parts added")
    parser.add_argument("--updates", type=positive, help="end after so many updates, whatever time they take")
    parser.add_argument("--slots", type=positive, default=384, help="units a batch, about")
    parser.add_argument("--lr", type=float, default=1e-3)
    parser.add_argument("--decay", type=float, default=0.998, help="of the averaged weights")
    parser.add_argument("--loss-beta", type=float, default=BETA_M_S, help="m/s up to which the loss is quadratic")
    parser.add_argument("--checkpoint-minutes", type=float, default=3)
    parser.add_argument("--validate-minutes", type=float, default=3)
    parser.add_argument("--start-from", type=pathlib.Path, help="weights of another run's checkpoint, or of a packed f32 model")
    parser.add_argument("--zero-head", action="store_true", help="with --start-from: a head of zeros all the same")
    parser.add_argument("--weight-decay", type=float, default=0.01)
    parser.add_argument("--bf16", action=argparse.BooleanOptionalAction, help="products in bf16 (default: where the processor has them)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=positive, help="of the processor (default: one a core)")
    args = parser.parse_args()
    device = "cuda" if torch.cuda.is_available() else "cpu"
    if args.bf16 is None:
        args.bf16 = has_bf16(device)
    if args.threads:
        torch.set_num_threads(args.threads)
    torch.manual_seed(args.seed)
    rng = np.random.default_rng(args.seed)
    try:
        config = ModelConfig.from_json(json.dumps({**dataclasses.asdict(PRESETS[args.preset]), **args.config}))
    except (TypeError, ValueError) as error:
        parser.error(f"--config: {error}")
    if config.motion != "impulses" or config.bonds:
        parser.error(f"{config.name} does not move units by impulses alone and the network; give edge or nano")
    batches = Batches(args.windows)
    held_out = Batches(args.validation) if args.validation else None
    if any(d["length_m"] != config.length_m for d in batches.described):
        parser.error(f"{config.name} measures scenes in lengths of {config.length_m} m, and the windows are of another model; make them with "
                     f"--preset {args.preset}")
    if config.most_units and (laws := sorted({law for d in batches.described for law in d["laws"]})):
        parser.error(f"{config.name} leaves scenes with a contact law alone, and the windows have {', '.join(laws)}; learn over it by "
                     "--config '{\"most_units\": 0}', or make windows with --rigid")
    if not len(batches):
        parser.error(f"no window has {MOST_ROWS} units or less; give windows of smaller scenes")
    model = RigidFormer(config).initialise().to(device)
    model.bf16 = args.bf16
    args.run.mkdir(parents=True, exist_ok=True)
    checkpoint = args.run / "checkpoint.pt"
    saved = read_checkpoint(checkpoint, device)
    names = ("train", "validation", "test", "extra")
    scenes = [name for d in batches.described for name in d["scenes"]]
    splits = sorted({names[split] for d in batches.described for split in d["splits"]})
    data = f"windows of {', '.join(pathlib.Path(name).stem for name in scenes)}; splits {' and '.join(splits)}"
    runs, resumed = [], []
    spent, updates, seen = 0.0, 0, 0
    if saved is None:
        with torch.no_grad():
            fit_normalisation(model, batches, np.random.default_rng(1))
        if args.start_from:
            runs = runs_of(args.start_from)
            weights = read_weights(args.start_from) if args.start_from.suffix == ".rfm" else read_average(args.start_from, device)
            if args.zero_head:
                weights = {name: torch.zeros_like(v) if name.startswith("anchors.head.1.") else v for name, v in weights.items()}
            model.load_state_dict(weights)
    optimizer = torch.optim.AdamW(model.parameters(), lr=args.lr, weight_decay=args.weight_decay, fused=True)
    average = Average(model, args.decay)
    if saved is not None:
        if ModelConfig.from_json(saved["config"]) != config:
            parser.error(f"{checkpoint} is of another configuration: {saved['config']}; give that one, or another --run")
        model.load_state_dict(saved["model"])
        optimizer.load_state_dict(saved["optimizer"])
        average.weights, average.count = {k: v.to(device) for k, v in saved["average"].items()}, saved["average_count"]
        spent, updates, seen = saved["spent"], saved["updates"], saved["seen"]
        runs, resumed = saved.get("runs", []), saved.get("resumed", [])
        if what := changed(saved["arguments"], vars(args)):
            resumed = [*resumed, f"resumed at minute {spent / 60:.1f} with {what}"]
        rng = np.random.default_rng(args.seed + updates)
        print(f"resumed {checkpoint} after {spent / 60:.1f} min, {updates} updates", file=sys.stderr)
    print(f"{config.name}: {sum(p.numel() for p in model.parameters())} parameters, {len(batches)} windows, {device}", file=sys.stderr)
    arguments = vars(args) | {"data": scenes, "points": batches.rows["features"].shape[1], "steps": sorted({s for d in batches.described for s in d["steps"]})}

    def write():
        save(checkpoint, model=model.state_dict(), optimizer=optimizer.state_dict(), average=average.weights, average_count=average.count,
             spent=spent, updates=updates, seen=seen, config=config.to_json(), arguments=json.loads(json.dumps(arguments, default=str)),
             data=data, runs=runs, resumed=resumed)  # fmt: skip

    log = (args.run / "log.jsonl").open("a")

    def tell(line):
        print(json.dumps(line), file=log, flush=True)
        if not sys.stderr.isatty():
            print(json.dumps(line), file=sys.stderr, flush=True)

    def check():
        own = RigidFormer(config).to(device)
        own.load_state_dict(average.weights)
        own.bf16 = args.bf16
        for name, windows in (("training", None), ("validation", held_out)):
            if windows is not None:
                tell({"min": round(spent / 60, 2), "windows": seen, name: validate(own, windows, device, args.slots)})

    stopped = []
    signal.signal(signal.SIGTERM, lambda *_: stopped.append(True))
    signal.signal(signal.SIGINT, lambda *_: stopped.append(True))
    bar = tqdm(total=round(args.minutes, 2), disable=not sys.stderr.isatty(), unit="min")
    budget, mean = args.minutes * 60, None
    since_checkpoint = since_validation = since_line = 0.0
    progress = lambda: min(updates / args.updates if args.updates else spent / budget, 1.0)  # noqa: E731
    while progress() < 1 and not stopped:
        for batch in batches.draw(rng, args.slots):
            began = time.monotonic()
            lr = args.lr * min(1.0, (updates + 1) / 200) * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress())))
            for group in optimizer.param_groups:
                group["lr"] = lr
            loss = loss_of(model, batches.tensors(batch, device, rng), args.loss_beta)
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            norm = torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
            if torch.isfinite(norm):
                optimizer.step()
                average.update(model)
            took = time.monotonic() - began
            updates, seen = updates + 1, seen + len(batch)
            spent, since_checkpoint, since_validation, since_line = (v + took for v in (spent, since_checkpoint, since_validation, since_line))
            mean = float(loss.detach()) if mean is None else mean + 0.02 * (float(loss.detach()) - mean)
            bar.update(took / 60)
            if since_line > 30:
                since_line = 0.0
                tell({"min": round(spent / 60, 2), "updates": updates, "windows": seen, "loss": round(mean, 5), "lr": round(lr, 6)})
            if since_checkpoint > args.checkpoint_minutes * 60:
                since_checkpoint = 0.0
                write()
            if since_validation > args.validate_minutes * 60:
                since_validation = 0.0
                check()
            if progress() >= 1 or stopped:
                break
    write()
    if stopped:
        print(f"stopped after {updates} updates; the same command goes on from {checkpoint}", file=sys.stderr)
        sys.exit(128 + signal.SIGTERM)
    check()


if __name__ == "__main__":
    main()
