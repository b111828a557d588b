"""Trains a model of the inputs "paper" with everything on the accelerator; resumes from its last checkpoint.

    python -m rigidformer_lab.train_fast --data movi-a.safetensors movi-b.safetensors movi-b-more.safetensors.parts \\
        --run runs/paper --minutes 9

`--data` takes scene files, and folders of parts that `movi` is still making: they are read as they come. All scenes stand on z = 0 and
have free units only. On GPUs an update is a CUDA graph: windows are drawn, told, learnt from and averaged without the processor.
The checkpoint is that of `train`, for `evaluate` and `export`, and so is `weights.pt`, a quarter of it; `curve.jsonl` has windows, minutes and validation errors.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import pathlib
import queue
import sys
import threading
import time

import numpy as np
import torch

from .config import PRESETS, ModelConfig
from .data import LATEST_START
from .evaluate import batches, errors_of, means, opened
from .export import changed
from .fast import Bucket, FastRigidFormer, Flat, Sampler, Shapes, prepare
from .model import transform
from .data import state_at
from .scenes import SceneFileError, read_scenes
from .train import contacts, draws_kept, positive, read_checkpoint, save, share, window_loss

#: Units that a scene has at most, of those that are trained on.
MOST_UNITS = 64
#: Updates between two looks at the clock.
LOOK_EVERY = 16
WARM_UPDATES = 400


def phase(text):
    """`3:.25`: three predictions until a quarter of the time is over; `9:1:4096`, the last ones with 4096 units a batch."""
    horizon, _, rest = text.partition(":")
    until, _, slots = rest.partition(":")
    return positive(horizon), share(until or "1"), positive(slots) if slots else None


class Feed:
    """Scenes of files and growing folders, prepared in a thread."""

    def __init__(self, paths, frames):
        self.paths, self.frames, self.shapes = paths, frames, Shapes()
        self.seen, self.described, self.ready, self.problem = set(), {}, queue.Queue(), None
        self.stop = threading.Event()

    def files(self):
        for path in self.paths:
            for file in sorted(path.glob("seeds-*")) if path.is_dir() else [path]:
                if file not in self.seen:
                    yield file

    def read(self, file):
        self.seen.add(file)
        scenes = read_scenes(file)
        parts = prepare(scenes, self.shapes, self.frames)
        seeds = scenes.scene_seed[np.isin(scenes.scene_split, (0, 3))]
        return scenes.dataset, seeds, parts

    def describe(self, dataset, seeds, added):
        if added:
            low, high, count = self.described.get(dataset, (np.inf, -np.inf, 0))
            self.described[dataset] = int(min(low, seeds.min())), int(max(high, seeds.max())), count + added

    def text(self):
        parts = [f"{name} (seeds {low}-{high}, {count} scenes)" for name, (low, high, count) in sorted(self.described.items())]
        return ", ".join(parts) + "; splits train and extra"

    def watch(self):
        """Goes on to read what folders get, until `stop`."""

        def work():
            try:
                while not self.stop.wait(1.0):
                    for file in self.files():
                        try:
                            self.ready.put(self.read(file))
                        except SceneFileError:
                            if file.exists():
                                raise
                            continue  # the maker has joined its parts
                        if self.stop.is_set():
                            return
            except (SceneFileError, ValueError, OSError) as error:
                self.problem = f"{file}: {error}"

        if any(path.is_dir() for path in self.paths):
            threading.Thread(target=work, daemon=True).start()


class Trainer:
    def __init__(self, model, flat, sampler, buckets, args, device):
        self.model, self.flat, self.sampler, self.buckets, self.args, self.device = model, flat, sampler, buckets, args, device
        self.loss = torch.zeros((), device=device)
        self.graphs, self.pool = {}, None
        self.rng = np.random.default_rng(args.seed)

    def count(self, units, slots):
        return max(1, slots // units)

    def update(self, units, horizon, slots):
        """One update of windows of one number of units."""
        a = self.args
        bucket = self.buckets[units]
        chosen = self.sampler.draw(bucket, self.count(units, slots), a.steps, a.contacts)
        scene, rotation, centre = self.sampler.window(bucket, *chosen, horizon, a.points)
        loss = window_loss(self.model, scene, rotation, centre, horizon, a.noise, a.loss_beta, fine=a.fine)
        if self.model.tf32:
            torch.backends.cuda.matmul.allow_tf32 = True
        loss.backward()
        torch.backends.cuda.matmul.allow_tf32 = False
        self.flat.step()
        self.loss.lerp_(loss.detach(), 0.02)

    def run(self, units, horizon, slots):
        """The same, on GPUs by replaying it. Returns how many windows that was, and how many updates."""
        windows = self.count(units, slots)
        if self.device != "cuda" or not self.args.graphs:
            self.update(units, horizon, slots)
            return windows, 1
        key = units, horizon, slots
        if key in self.graphs:
            self.graphs[key].replay()
            return windows, 1
        side = torch.cuda.Stream()
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side):
            self.update(units, horizon, slots)
        torch.cuda.current_stream().wait_stream(side)
        if self.pool is None:
            self.pool = torch.cuda.graph_pool_handle()
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph, pool=self.pool):
            self.update(units, horizon, slots)
        self.graphs[key] = graph  # capturing runs nothing
        return windows, 1

    def forget(self):
        """Graphs of a phase that is over."""
        if self.graphs:
            torch.cuda.synchronize()
            torch.cuda.empty_cache()
        self.graphs = {}

    def refresh(self, horizon):
        """Where windows may begin, and which points units have."""
        for bucket in self.buckets.values():
            if bucket.used:
                bucket.refresh(self.args.steps, horizon, self.args.latest_start)
        self.sampler.refresh(self.args.points)
        used = {m: b.used * m for m, b in self.buckets.items() if b.used}
        self.units, weights = list(used), np.array(list(used.values()), np.float64)
        self.odds = weights / weights.sum()

    def next_units(self):
        return int(self.rng.choice(self.units, p=self.odds))


@torch.no_grad()
def fit_normalisation(model, trainer, points, steps, contact_share=0.8):
    """As that of `train`: constants of features and positions."""
    features, positions = [], []
    for units, bucket in trainer.buckets.items():
        if not bucket.used:
            continue
        many = max(8, 4096 // units)
        scene, rotation, centre = trainer.sampler.window(bucket, *trainer.sampler.draw(bucket, many, steps, contact_share), 1, points)
        state = state_at(rotation, centre, 1)
        features.append(model.features(scene, state).flatten(0, 2))
        positions.append(transform(state.rotation, state.centre, scene.points[:, :, :4]).flatten(0, 2))
    features, positions = torch.cat(features), torch.cat(positions)
    model.encoder.feature_mean.copy_(features.mean(0))
    model.encoder.feature_scale.copy_(1 / features.std(0).clamp(min=1e-3))
    model.anchors.position_mean.copy_(positions.mean(0))
    model.anchors.position_scale.copy_(1 / positions.std(0).clamp(min=1e-3))


class Validation:
    """Errors of the averaged weights over validation scenes, which stay on the device."""

    def __init__(self, config, paths, limit, points, frames, device):
        with draws_kept(device):
            self.model = FastRigidFormer(config).to(device).eval()
        self.sets, self.paths, self.limit, self.points, self.frames, self.device = {}, paths, limit, points, frames, device

    def tensors(self, path, steps):
        key = path, tuple(steps)
        if key not in self.sets:
            dataset = opened(path, 1, self.frames, self.limit, self.points, None)
            made = [
                (s, horizon, dataset.tensors(w, rows, horizon, self.points, False, self.device))
                for s, horizon, w, rows in batches(dataset, steps, self.frames)
            ]
            self.sets[key] = dataset, made
        return self.sets[key]

    @torch.no_grad()
    def errors(self, weights, steps):
        self.model.load_state_dict(weights)
        out = {}
        for path in self.paths:
            dataset, made = self.tensors(path, steps)
            parts = [(s, errors_of(self.model, dataset, s, horizon, tensors, self.frames, self.device)) for s, horizon, tensors in made]
            out[path.stem] = means(parts, len(dataset), steps, self.frames)
        return out


def arguments(text=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", nargs="+", required=True, type=pathlib.Path, help="scene files, and folders of parts that still come")
    parser.add_argument("--run", required=True, type=pathlib.Path, help="folder of checkpoint and curve")
    parser.add_argument("--preset", default="edge-paper-inputs", choices=[n for n, c in PRESETS.items() if c.features == "paper" and c.motion == "verlet"])
    parser.add_argument("--config", type=json.loads, default={}, metavar="JSON", help="fields of the preset to change")
    parser.add_argument("--minutes", type=float, default=60, help="time of the whole run, checks and resumed parts added")
    parser.add_argument("--updates", type=positive, help="end after so many updates, whatever time they take")
    parser.add_argument("--steps", type=int, nargs="+", default=[1, 5, 10], help="frames a step; repeat one to weigh it")
    parser.add_argument("--horizon", type=phase, nargs="+", default=[(1, 0.25, None), (3, 0.5, None), (9, 1.0, None)],
                        metavar="N[:UNTIL[:SLOTS]]", help="closed-loop predictions a window, as `train` takes them, and with how many "
                        "units a batch (default 1:.25 3:.5 9)")  # fmt: skip
    parser.add_argument("--frames", type=positive, default=111, help="of a scene that are learnt from (default %(default)s)")
    parser.add_argument("--latest-start", type=int, default=LATEST_START, help="latest frame that a window begins at")
    parser.add_argument("--points", type=positive, default=32, help="random points a unit")
    parser.add_argument("--slots", type=positive, default=8192, help="units a batch, about")
    parser.add_argument("--capacity", type=positive, default=0, help="scenes of one number of units that there is room for, where folders grow")
    parser.add_argument("--lr", type=float, default=1.5e-3)
    parser.add_argument("--decay", type=float, default=0.999, help="of the averaged weights")
    parser.add_argument("--noise", type=float, default=0.003, help="on a window's first velocity, m/s")
    parser.add_argument("--loss-beta", type=float, default=0.25, help="m/s up to which the loss is quadratic")
    parser.add_argument("--fine", type=float, default=0.05, help="weight of a second loss, of millimetres a second")
    parser.add_argument("--contacts", type=contacts, default=0.8, help="share of each step code's windows with a contact")
    parser.add_argument("--checkpoint-minutes", type=float, default=1)
    parser.add_argument("--refresh-minutes", type=float, default=0.25, help="between new points, and looks for new scenes")
    parser.add_argument("--validate", nargs="*", default=[], type=pathlib.Path, help="scene files whose validation scenes the curve is of")
    parser.add_argument("--validate-minutes", type=float, default=1)
    parser.add_argument("--validate-scenes", type=positive, default=60, help="of each file")
    parser.add_argument("--validate-points", type=int, default=0, help="of a unit, 0 for all")
    parser.add_argument("--validate-steps", type=int, nargs="+", default=[5, 10])
    parser.add_argument("--start-from", type=pathlib.Path, help="weights of another run's checkpoint")
    parser.add_argument("--tf32", action=argparse.BooleanOptionalAction, default=True, help="of matrix products of the learned part, on GPUs")
    parser.add_argument("--bf16", action=argparse.BooleanOptionalAction, default=False, help="those in bf16")
    parser.add_argument("--compile", action=argparse.BooleanOptionalAction, default=False, help="the learned part by torch.compile")
    parser.add_argument("--graphs", action=argparse.BooleanOptionalAction, default=True, help="CUDA graphs, on GPUs")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=positive, help="of the processor")
    args = parser.parse_args(text)
    if [u for _, u, _ in args.horizon] != sorted(u for _, u, _ in args.horizon) or args.horizon[-1][1] < 1:
        parser.error("--horizon: give shares that rise, and a last one without a share")
    missing = [str(path) for path in args.data if not path.exists()]
    if missing:
        parser.error(f"--data {', '.join(missing)}: no such file; make scenes with `movi`")
    args.phases, args.horizon = args.horizon, [(number, until) for number, until, _ in args.horizon]
    args.late, args.masked = False, 0
    return args, parser


def build(args, parser, device):
    """Everything that a run has, from its arguments."""
    torch.manual_seed(args.seed)
    config = ModelConfig.from_json(json.dumps({**dataclasses.asdict(PRESETS[args.preset]), **args.config}))
    feed = Feed(args.data, args.frames)
    read = [feed.read(file) for file in feed.files()]
    if not read:
        parser.error("--data: no scenes are there yet; wait for the first part")
    sizes = {}
    for dataset, seeds, parts in read:
        feed.describe(dataset, seeds, len(seeds))
        for m, part in parts.items():
            sizes[m] = sizes.get(m, 0) + len(part.shape)
    room = {m: max(args.capacity, n) for m, n in sizes.items()}
    if args.capacity:
        room = {m: max(args.capacity, sizes.get(m, 0)) for m in {*range(3, 11), *sizes}}
    buckets = {m: Bucket(m, n, args.frames, device) for m, n in sorted(room.items())}
    for _, _, parts in read:
        for m, part in parts.items():
            buckets[m].add(part)
    model = FastRigidFormer(config).initialise().to(device)
    model.tf32, model.bf16 = args.tf32 and device == "cuda", args.bf16
    if args.compile:
        model.compiled = torch.compile(super(FastRigidFormer, model).learned, dynamic=False)
    flat = Flat(model, args.decay)
    ground = config.ground_friction, config.ground_restitution
    sampler = Sampler(feed.shapes, config, ground, device, args.seed)
    trainer = Trainer(model, flat, sampler, buckets, args, device)
    trainer.refresh(1)
    fit_normalisation(model, trainer, args.points, sorted(set(args.steps)))
    return config, feed, model, flat, trainer


def main(text=None):
    args, parser = arguments(text)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    if args.threads:
        torch.set_num_threads(args.threads)
    args.run.mkdir(parents=True, exist_ok=True)
    config, feed, model, flat, trainer = build(args, parser, device)
    known = len(feed.shapes.start)
    spent, updates, seen, resumed, runs = 0.0, 0, 0, [], []
    path = args.run / "checkpoint.pt"
    saved = read_checkpoint(path, device)
    if saved:
        if ModelConfig.from_json(saved["config"]) != config:
            parser.error(f"{path} is of another configuration: {saved['config']}; give that one, or another --run")
        model.load_state_dict(saved["model"])
        flat.load(flat.average, saved["average"])
        flat.load(flat.mean, saved["optimizer"]["mean"])
        flat.load(flat.square, saved["optimizer"]["square"])
        flat.count.fill_(saved["average_count"])
        spent, updates, seen = saved["spent"], saved["updates"], saved["seen"]
        resumed, runs = saved["resumed"], saved["runs"]
        if what := changed(saved["arguments"], vars(args)):
            resumed = [*resumed, f"resumed at minute {spent / 60:.1f} with {what}"]
        torch.manual_seed(args.seed + updates)
        print(f"resumed {path} after {spent / 60:.1f} min, {updates} updates", file=sys.stderr)
    elif args.start_from:
        start = torch.load(args.start_from, map_location=device, weights_only=False)
        model.load_state_dict(start["average"])
        flat.average.copy_(flat.weights)
    scenes = sum(b.used for b in trainer.buckets.values())
    print(f"{config.name}: {sum(flat.sizes)} parameters, {scenes} scenes, {device}", file=sys.stderr)
    validation = Validation(config, args.validate, args.validate_scenes, args.validate_points or None, (50, 100), device) if args.validate else None
    curve = (args.run / "curve.jsonl").open("a")

    def say(**what):
        line = {"min": round(spent / 60, 3), "updates": updates, "windows": seen, **what}
        print(json.dumps(line), file=curve, flush=True)
        print(json.dumps(line), file=sys.stderr, flush=True)

    def write():
        what = dict(
            average=flat.state(flat.average), spent=spent, updates=updates, seen=seen, config=config.to_json(), data=feed.text(),
            runs=runs, resumed=resumed, arguments=json.loads(json.dumps(vars(args), default=str)),
        )  # fmt: skip
        save(args.run / "weights.pt", **what)
        moments = (("mean", flat.mean), ("square", flat.square))
        optimizer = {name: {k: v for k, v in flat.state(value).items() if k in flat.names} for name, value in moments}
        save(path, model=flat.state(flat.weights), average_count=float(flat.count), optimizer=optimizer, **what)

    def check(steps=None):
        if validation:
            say(validation=validation.errors(flat.state(flat.average), steps or args.validate_steps))

    def progress():
        return min(updates / args.updates if args.updates else spent / (args.minutes * 60), 1.0)

    feed.watch()
    at, last = None, time.time()
    since = dict.fromkeys(("checkpoint", "refresh", "validate"), 0.0)
    while progress() < 1:
        horizon, slots = next((n, s or args.slots) for n, until, s in args.phases if progress() < until or until == 1)
        if (horizon, slots) != at or since["refresh"] > args.refresh_minutes * 60:
            since["refresh"] = 0.0
            while not feed.ready.empty():
                dataset, seeds, parts = feed.ready.get()
                if any(part.shape.max() >= known for part in parts.values()):
                    print(f"{dataset}: scenes left out, of shapes that none had at the start", file=sys.stderr, flush=True)
                    continue
                added = sum(trainer.buckets[m].add(part) for m, part in parts.items() if m in trainer.buckets)
                feed.describe(dataset, seeds, added)
            if feed.problem:
                print(f"no more scenes are read: {feed.problem}", file=sys.stderr, flush=True)
                feed.problem = None
            if (horizon, slots) != at:
                trainer.forget()
                at = horizon, slots
            trainer.refresh(horizon)
        warm = min(1.0, (updates + 1) / WARM_UPDATES)
        flat.rate.fill_(args.lr * warm * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress()))))
        began, before = time.time(), seen
        for _ in range(LOOK_EVERY if device == "cuda" else 1):
            windows, many = trainer.run(trainer.next_units(), horizon, slots)
            updates, seen = updates + many, seen + windows
        if device == "cuda":
            torch.cuda.synchronize()
        pace = (seen - before) / (time.time() - began)
        due = since["validate"] > args.validate_minutes * 60
        if due or since["checkpoint"] > args.checkpoint_minutes * 60:
            since["checkpoint"] = 0.0
            say(loss=round(float(trainer.loss), 5), horizon=horizon, scenes=sum(b.used for b in trainer.buckets.values()),
                windows_a_second=round(pace))  # fmt: skip
            write()
        if due:
            since["validate"] = 0.0
            check()
        # All counts, checks too: who has so many minutes of a machine ends within them.
        now = time.time()
        took, last = now - last, now
        spent += took
        for name in since:
            since[name] += took
    feed.stop.set()
    write()
    check()


if __name__ == "__main__":
    main()
