"""Adapts a model to a few recorded scenes, where that pays: held-out scenes decide, and where nothing is gained no file is written.

    rigidformer calibrate tosses.safetensors --without-network --out contact.toml
    python -m rigidformer_lab.adapt tosses.safetensors --from nano-f32.rfm --contact contact.toml --out adapted.rfm

Scenes of the splits train, validation and extra are dealt into folds; those of the split test are not looked at. For each fold a model
learns from single steps of the other folds (`rigidformer_lab.windows`), from MODEL's weights and from these with a head of zeros. At
several numbers of updates, and with several shares of the network's correction, `rigidformer evaluate` rolls out the scenes of the fold,
beside the same motion without the network and beside MODEL.

What counts is what `rigidformer calibrate` counts: the position error in per cent of the units' size, and .8 a degree. A candidate is out
if in any fold, at any of --steps, that is above the motion without the network, or if it keeps off less than --least per cent of the
error, mean over folds. The best of the others learns from all folds, and is written twice: OUT as int8, and the same in f32 beside it, OUT's name with `-f32`. Without one the
last line is `no gain: not written`, and the exit code 0.

Needs the runtime's Python package `rigidformer`, and the program `rigidformer` on the PATH.
"""

from __future__ import annotations

import argparse
import copy
import dataclasses
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time

import numpy as np
import torch
from tqdm import tqdm

from .config import PRESETS, ModelConfig
from .export import runs_of, scale_head, write_model
from .model import RigidFormer
from .movi import write_text
from .packed import read_provenance, read_weights
from .recipe import MODELS
from .roles import FREE
from .scenes import EXTRA, TEST, TRAIN, VALIDATION, ContactLaw, SceneFileError, read_scenes, write_scenes
from .train import Average, draws_kept, positive
from .train_steps import Batches, loss_of
from .windows import collect, described, digest

LEARNT = (TRAIN, VALIDATION, EXTRA)
#: Of the head's last layer. A share of 0 is the motion without the network, which stands beside all.
SHARES = (0.25, 0.5, 1.0)
STOPS = (25, 50, 100, 200, 400, 800)
STARTS = ("model", "zeros")
HEAD = "anchors.head.1."
KINDS = ("position", "orientation")
DEGREE = 0.8  # what a degree costs, beside a per cent of the units' size
LEAST_COST = 0.1  # shares are of errors of so much or more
BETA_M_S = 0.2
WARM = 20  # updates that the learning rate rises in
MOST_WINDOWS = 60_000


class AdaptError(Exception):
    """Cannot adapt. The message says what to do."""


@dataclasses.dataclass(frozen=True)
class Candidate:
    start: str  # one of STARTS
    updates: int  # 0: MODEL itself, unless the start is a head of zeros
    share: float

    def __str__(self):
        head = "a head of zeros" if self.start == "zeros" else "the model's head"
        return f"from {head}, {self.updates} updates, {self.share:g} of the correction"


def program():
    found = shutil.which("rigidformer")
    if found is None:
        raise AdaptError("the program `rigidformer` is not on the PATH; build it with `cargo build --release -p rigidformer-cli`, and add "
                         "target/release to the PATH")
    return found


def call(*arguments):
    done = subprocess.run([program(), *map(str, arguments)], capture_output=True, text=True)
    if done.returncode:
        said = done.stderr.strip() or f"exit code {done.returncode}"
        raise AdaptError(f"rigidformer {arguments[0]}: {said}")
    return done.stdout


def config_of(path):
    """The configuration of a packed model."""
    told = json.loads(call("inspect", path, "--json"))
    name = told.get("name", "")
    if name not in PRESETS:
        raise AdaptError(f"{path}: is a model {name or 'without a name'}, and the lab has no preset of that name; give edge or nano, or one "
                         "that was made from them")
    given, preset = told["config"], PRESETS[name]
    for field in ("width", "heads", "head_dim", "blocks", "point_width", "registers", "feed_forward_width", "avp_width", "film_width"):
        if given[field] != getattr(preset, field):
            raise AdaptError(f"{path}: has a {field} of {given[field]}, and the preset {name} {getattr(preset, field)}; give a model of that "
                             "preset")
    changes = {"scope": given.get("scope", "all"), "most_units": given.get("most_units", 0)}
    config = dataclasses.replace(preset, **changes)
    if config.motion != "impulses" or config.bonds:
        raise AdaptError(f"{path}: {name} does not move units by impulses alone and the network; give edge or nano")
    return ModelConfig.from_json(config.to_json())


def located(model):
    """The f32 file of a model, given by path or by the name of a shipped one."""
    path = pathlib.Path(model)
    if path.suffix != ".rfm" and path.name == str(model):
        folder = pathlib.Path(__file__).resolve().parents[3] / "weights" / "models"
        path = next((file for file in (folder / f"{model}-f32.rfm", folder / f"{model}.rfm") if file.is_file()), path)
    if not path.is_file():
        raise AdaptError(f"--from {model}: is no file and no shipped model; give a packed f32 model, such as edge.rfm, or edge or nano")
    layers = json.loads(call("inspect", path, "--json")).get("tensors") or []
    if any(layer.get("dtype") == "i8" for layer in layers):
        raise AdaptError(f"--from {path}: is quantised, and training would go on from rounded weights; give its f32 file")
    return path


def folds_of(split, count, seed):
    """(scenes) The fold of each, -1 of the split test."""
    learnt = np.flatnonzero(np.isin(split, LEARNT))
    if len(learnt) < 2 * count:
        raise AdaptError(f"has {len(learnt)} scenes of the splits train, validation and extra; {count} folds take {2 * count} or more, so record "
                         "more, or give less --folds")
    fold = np.full(len(split), -1)
    fold[np.random.default_rng([seed, 1]).permutation(learnt)] = np.arange(len(learnt)) % count
    return fold


def frames_of(steps, file, config):
    """Frames of the record that a window steps: those of the step codes, one more and one less."""
    rate = file.frame_rate_hz / config.frame_rate_hz if file.unit_velocity is not None else 1.0
    near = {round(step * rate) + more for step in steps for more in (-1, 0, 1)}
    return sorted(frames for frames in near if frames >= 1)


@dataclasses.dataclass(frozen=True)
class Figure:
    """An error with the network and without it, and what a metre or a degree costs."""

    with_: float
    without: float
    weight: float


def size_m(file, scenes):
    """Mean side of the boxes around the free units of scenes, metres."""
    sides = []
    for scene in scenes:
        for unit in file.units_of_scene(scene):
            if file.roles[unit] == FREE:
                sides.append(np.ptp(file.points_of_shape(file.unit_shape[unit]), axis=0).mean() * file.unit_scale[unit])
    if not sides:
        raise AdaptError("no unit is free; give scenes of units that move by themselves")
    return float(np.mean(sides))


class Judge:
    """What `rigidformer evaluate` says of models on the scenes of each fold."""

    def __init__(self, file, fold, folder, config, steps, contact):
        self.folder, self.config, self.steps = pathlib.Path(folder), config, steps
        self.contact = () if contact is None else ("--contact", contact)
        # Per cent of the units' size, so that metres and degrees count as in `rigidformer calibrate`.
        self.per_m, self.files = 100 / size_m(file, np.flatnonzero(fold >= 0)), []
        for number in range(fold.max() + 1):
            split = np.where(fold == number, VALIDATION, TEST).astype(np.uint8)
            path = self.folder / f"fold-{number}.safetensors"
            write_scenes(path, dataclasses.replace(file, scene_split=split))
            self.files.append(path)

    def packed(self, weights, share=1.0, name="candidate", options=()):
        """A packed file of weights."""
        exported, packed = self.folder / f"{name}.safetensors", self.folder / f"{name}.rfm"
        weights = dict(weights)
        scale_head(weights, share)
        write_model(exported, self.config, weights, {}, {})
        call("pack", exported, "--out", packed)
        return packed if not options else self.narrowed(packed, packed.with_suffix(".i8.rfm"), options)

    @staticmethod
    def narrowed(wide, out, options):
        call("pack", wide, "--dtype", "i8", *options, "--out", out)
        return out

    def figures(self, number, model):
        """{figure at a step: (with the network, without)} of a packed model on a fold."""
        told = call("evaluate", self.files[number], "--split", "validation", "--model", model, "--steps", ",".join(map(str, self.steps)), "--json",
                    *self.contact)  # fmt: skip
        found = {}
        for gain in json.loads(told)["gains"]:
            kind = KINDS[gain["figure"].endswith("_deg")]
            weight = DEGREE if kind == "orientation" else self.per_m
            found[kind, gain["step"]] = Figure(gain["with_network"], gain["without_network"], weight)
        if not found:
            raise AdaptError("rigidformer evaluate gives no gains for such scenes; give scenes of rigid units")
        return found


def without_and_kept(figures, kind=None):
    """What the errors without the network cost, and what of it a model keeps off; of one kind, or of both."""
    own = [figure for (is_of, _), figure in figures.items() if kind in (None, is_of)]
    return sum(f.weight * f.without for f in own), sum(f.weight * (f.without - f.with_) for f in own)


def kept(rows, kind=None):
    """Per cent of the error without the network that a model keeps off, mean over folds."""
    pairs = np.array([without_and_kept(row, kind) for row in rows])
    return float(100 * np.mean(pairs[:, 1] / np.maximum(pairs[:, 0], LEAST_COST)))


def is_worse(figures):
    """Whether the error at any step is above that without the network."""
    steps = {step for _, step in figures}
    return any(sum(f.weight * (f.with_ - f.without) for (_, of), f in figures.items() if of == step) > 0 for step in steps)


def chosen(table, least, folds=None):
    """The best candidate of {candidate: [figures of each fold]}, or None; by some of the folds."""
    best = None
    for candidate, rows in table.items():
        rows = [rows[number] for number in folds or range(len(rows))]
        mean = kept(rows)
        if not any(map(is_worse, rows)) and mean >= least and (best is None or mean > best[1]):
            best = candidate, mean
    return None if best is None else best[0]


def unseen(table, least, count):
    """Per cent that are kept on folds that the choice does not see: each fold by the candidate that the others choose."""
    gains = []
    for number in range(count):
        picked = chosen(table, least, [other for other in range(count) if other != number])
        gains.append(0.0 if picked is None else kept([table[picked][number]]))
    return gains


def learn(config, weights, batches, args, stops, device, budget_s=None):
    """Averaged weights at each number of updates of `stops`, as (updates, weights); fewer where the time is over before."""
    with draws_kept(device):
        torch.manual_seed(args.seed)
        model = RigidFormer(config).to(device)
    model.load_state_dict(weights)
    model.bf16 = False
    optimizer = torch.optim.AdamW(model.parameters(), lr=args.lr, weight_decay=0.01, fused=True)
    average, rng, done = Average(model, 0.998), np.random.default_rng([args.seed, 2]), 0
    spent = 0.0  # the caller's measurements between updates do not count
    while True:
        for batch in batches.draw(rng, args.slots):
            began = time.monotonic()
            for group in optimizer.param_groups:
                group["lr"] = args.lr * min(1.0, (done + 1) / WARM)
            loss = loss_of(model, batches.tensors(batch, device, rng), args.loss_beta)
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            norm = torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
            if torch.isfinite(norm):
                optimizer.step()
                average.update(model)
            done += 1
            spent += time.monotonic() - began
            if done in stops:
                yield done, {name: values.detach().cpu().clone() for name, values in average.weights.items()}
            if done >= max(stops):
                return
            # The first stop is always reached, so that there is something to choose from.
            if budget_s is not None and done >= min(stops) and spent > budget_s:
                return


def zeroed(weights):
    return {name: torch.zeros_like(values) if name.startswith(HEAD) else values for name, values in weights.items()}


def restricted(batches, keep):
    """The windows of some scenes, a truth for each window."""
    few = copy.copy(batches)
    few.windows = batches.windows[keep[batches.windows]]
    if not len(few.windows):
        raise AdaptError("a fold's other scenes have no window in which the network corrects a unit; give scenes with contacts")
    return few


def compare(judge, start, config, batches, fold_of_window, args, device, bar):
    """{candidate: [figures of each fold]}, those of MODEL, and the seconds that were learnt."""
    table, of_model, stops = {}, [], list(args.stops)
    budget = None if args.minutes is None else 60 * args.minutes / (len(judge.files) * len(args.starts))

    def add(number, kind, updates, weights):
        for share in args.shares:
            figures = judge.figures(number, judge.packed(weights, share))
            table.setdefault(Candidate(kind, updates, share), [None] * len(judge.files))[number] = figures
            bar.update()

    for number in range(len(judge.files)):
        few = restricted(batches, fold_of_window != number)
        of_model.append(judge.figures(number, judge.packed(start)))
        for kind in args.starts:
            if kind == "model":
                add(number, kind, 0, start)
            begin = zeroed(start) if kind == "zeros" else start
            reached = []
            # Of all folds as many stops count as the first run reaches.
            for updates, weights in learn(config, begin, few, args, stops, device, budget if number == 0 else None):
                reached.append(updates)
                add(number, kind, updates, weights)
            if number == 0:
                stops = reached if kind == args.starts[0] else [stop for stop in stops if stop in reached]
    whole = {candidate: rows for candidate, rows in table.items() if None not in rows}
    return whole, of_model


def verdict(gain):
    return "no gain: not written" if gain is None else f"keeps {gain:.1f} % on folds: written"


def told_of(rows):
    return [{"figures": [{"figure": kind, "step": step, "with_network": f.with_, "without_network": f.without} for (kind, step), f in row.items()],
             "kept_percent": round(kept([row]), 3), "worse": is_worse(row)} for row in rows]  # fmt: skip


def say(rows, name):
    for number, row in enumerate(rows, 1):
        told = ", ".join(f"{kind} {f.with_:.4g} ({f.without:.4g} without) at step {step}" for (kind, step), f in row.items())
        print(f"fold {number}, {name}: {told}", file=sys.stderr)


def put_whole(made):
    """Moves files to their places, {place: file}."""
    for place, file in made.items():
        part = place.with_name(f".{place.name}.part")
        try:
            shutil.copyfile(file, part)
            os.replace(part, place)
        finally:
            part.unlink(missing_ok=True)


def provenance_of(path, file, recording, args, choice, report):
    """What a model says of itself: what MODEL says, and this run."""
    runs = runs_of(path)
    contact = "the scenes' own contact" if args.contact is None else f"contact {args.contact.name} ({digest(args.contact)})"
    folds = ", ".join(f"{row['kept_percent']:.1f}" for row in report["folds"])
    line = (f"adapt: {file.dataset} ({digest(recording)}), {report['scenes']} scenes, splits train, validation and extra; {contact}; {choice}; "
            f"learning rate {args.lr:g}, frames a step {' '.join(map(str, report['frames_a_step']))}, seed {args.seed}; from {path.name}; keeps "
            f"{report['kept_percent']:.1f} % of the error without the network, on folds {folds} %")  # fmt: skip
    kept = {key: value for key, value in read_provenance(path).items() if not key.startswith("run ")}
    return kept | {"data": f"run {len(runs) + 1}: {file.dataset}; splits train, validation and extra", "adapt": line} | {
        f"run {number}": text for number, text in enumerate([*runs, line], 1)
    }


def adapt(args):
    """The report of a run, whose files are written where something is gained."""
    recording, out = args.recording, args.out
    wide = out.with_name(f"{out.stem}-f32{out.suffix}")
    program()
    try:
        import rigidformer  # noqa: F401
    except ImportError:
        raise AdaptError("the runtime's Python package is missing; install it from bindings/python (`pip install ./bindings/python`)") from None
    if args.contact is not None and not args.contact.is_file():
        raise AdaptError(f"--contact {args.contact}: is no file; make one with `rigidformer calibrate`")
    if args.json is not None and (not args.json.parent.is_dir() or args.json.resolve() == recording.resolve()):
        raise AdaptError(f"--json {args.json}: cannot be written there; give another file, in a folder that exists")
    if not out.parent.is_dir():
        raise AdaptError(f"--out {out}: there is no folder {out.parent}; make it first")
    file = read_scenes(recording)
    path = located(args.model)
    if len({recording.resolve(), path.resolve(), out.resolve(), wide.resolve()}) < 4:
        raise AdaptError(f"--out {out}: would overwrite what is read; give another name")
    config = config_of(path)
    units = np.diff(file.scene_units).max()
    if config.most_units and (units > config.most_units or file.contact_law != ContactLaw()):
        # What MODEL leaves alone is what is to be learnt.
        config = dataclasses.replace(config, most_units=0)
    try:
        fold = folds_of(np.asarray(file.scene_split), args.folds, args.seed)
    except AdaptError as error:
        raise AdaptError(f"{recording}: {error}") from None
    device = "cuda" if torch.cuda.is_available() else "cpu"
    learnt = np.flatnonzero(fold >= 0)
    steps = args.steps or ([5] if file.unit_velocity is not None else [10])
    frames = args.frames or frames_of(steps, file, config)
    count = args.windows or min(MOST_WINDOWS, 100 * len(learnt))
    arrays = collect([recording], LEARNT, config, count, frames, args.points, 0.9, args.seed, args.threads, contact=args.contact,
                     whole=True, noise_m_s=args.noise, impulse_m_s=args.impulse)  # fmt: skip
    told = described([recording], config, {"steps": frames})
    batches = Batches([recording], read=lambda _: (arrays, told))
    fold_of_window = fold[learnt[arrays["scene"]]]
    start = read_weights(path)
    total = args.folds * len(args.shares) * (len(args.starts) * len(args.stops) + ("model" in args.starts))
    with tempfile.TemporaryDirectory(prefix="adapt-") as folder:
        judge = Judge(file, fold, folder, config, steps, args.contact)
        began = time.monotonic()
        with tqdm(total=total, disable=not sys.stderr.isatty(), unit="candidate") as bar:
            table, of_model = compare(judge, start, config, batches, fold_of_window, args, device, bar)
        choice = chosen(table, args.least)
        best = choice or max(table, key=lambda candidate: kept(table[candidate]))
        rows = table[best]
        last = Candidate(best.start, max(c.updates for c in table if c.start == best.start), best.share)
        report = {
            "recording": str(recording), "dataset": file.dataset, "scenes": len(learnt), "windows": len(batches), "steps": steps,
            "frames_a_step": frames, "model": str(path), "contact": None if args.contact is None else str(args.contact),
            "minutes": round((time.monotonic() - began) / 60, 2), "best": dataclasses.asdict(best), "kept_percent": round(kept(rows), 3),
            "kept_on_unseen_folds_percent": [round(gain, 3) for gain in unseen(table, args.least, args.folds)],
            "folds": told_of(rows), "model_folds": told_of(of_model), "model_kept_percent": round(kept(of_model), 3),
            "last_stop": dataclasses.asdict(last), "last_stop_kept_percent": round(kept(table[last]), 3),
            "candidates": [dataclasses.asdict(c) | {"kept_percent": round(kept(r), 3), "position_kept_percent": round(kept(r, "position"), 3),
                                                    "orientation_kept_percent": round(kept(r, "orientation"), 3),
                                                    "worse_on_folds": sum(map(is_worse, r))} for c, r in table.items()],
            "written": None,
        }  # fmt: skip
        say(of_model, path.name)
        say(rows, str(best))
        print(f"kept off the error without the network: by {path.name} as it is {kept(of_model):.1f} %, by the best candidate {kept(rows):.1f} % "
              f"({best}), without an early stop, after {last.updates} updates, {kept(table[last]):.1f} %; on folds that the choice does not see "
              f"{np.mean(unseen(table, args.least, args.folds)):.1f} %", file=sys.stderr)  # fmt: skip
        if choice is not None:
            narrow, _ = MODELS.get(config.name, ((), None))
            options = [option for layer in narrow for option in ("--narrow", layer)]
            weights = zeroed(start) if choice.start == "zeros" else dict(start)
            if choice.updates:
                ((_, weights),) = learn(config, weights, batches, args, (choice.updates,), device)
            weights = dict(weights)
            scale_head(weights, choice.share)
            exported = pathlib.Path(folder) / "adapted.safetensors"
            write_model(exported, config, weights, provenance_of(path, file, recording, args, choice, report), {})
            made = [pathlib.Path(folder) / "adapted-f32.rfm", pathlib.Path(folder) / "adapted.rfm"]
            call("pack", exported, "--out", made[0])
            judge.narrowed(made[0], made[1], options)
            put_whole({wide: made[0], out: made[1]})
            report["written"] = [str(out), str(wide)]
    report["verdict"] = verdict(None if choice is None else report["kept_percent"])
    return report


def numbers(kind, low, high=float("inf")):
    def read(text):
        if not low <= (value := kind(text)) <= high:
            raise argparse.ArgumentTypeError(f"takes numbers from {low:g}" + (f" to {high:g}" if high < float("inf") else ""))
        return value

    return read


def main(arguments=None):
    parser = argparse.ArgumentParser(prog="python -m rigidformer_lab.adapt", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=pathlib.Path, help="scene file of rigid units")
    parser.add_argument("--from", dest="model", required=True, metavar="MODEL", help="packed f32 model that moves units by impulses, or edge or nano")
    parser.add_argument("--contact", type=pathlib.Path, metavar="FILE", help="contact's numbers, as `rigidformer calibrate` wrote them")
    parser.add_argument("--out", required=True, type=pathlib.Path, metavar="FILE.rfm", help="packed model to write, if something is gained")
    parser.add_argument("--folds", type=numbers(int, 2, 100), default=4, help="default %(default)s")
    parser.add_argument("--steps", type=positive, nargs="+", metavar="S", help="step codes that are measured (default: of scenes with unit_velocity 5, which an impact fits in, else 10)")
    parser.add_argument("--frames", type=positive, nargs="+", metavar="N", help="frames of the record that windows step (default: those of --steps, one more, one less)")
    parser.add_argument("--minutes", type=numbers(float, 0), help="training time of all folds together, at most (default: no limit)")
    parser.add_argument("--stops", type=positive, nargs="+", default=list(STOPS), metavar="N", help="updates after which folds are measured")
    parser.add_argument("--shares", type=numbers(float, 0.01, 2), nargs="+", default=list(SHARES), metavar="X", help="of the correction")
    parser.add_argument("--starts", nargs="+", default=list(STARTS), choices=STARTS, help="weights to start from: MODEL's, or these with a head of zeros")
    parser.add_argument("--least", type=numbers(float, 0, 100), default=1.0, metavar="PERCENT", help="of the error that has to be kept off (default %(default)s)")
    parser.add_argument("--windows", type=positive, metavar="N", help="to learn from (default: 100 a scene)")
    parser.add_argument("--points", type=numbers(int, 5), default=32, help="a unit (default %(default)s)")
    parser.add_argument("--slots", type=positive, default=128, help="units a batch, about (default %(default)s)")
    parser.add_argument("--lr", type=numbers(float, 0), default=7e-4, help="default %(default)s")
    parser.add_argument("--loss-beta", type=numbers(float, 1e-6), default=BETA_M_S, help="scaled m/s up to which the loss is quadratic (default %(default)s: recorded impacts scatter)")
    parser.add_argument("--noise", type=numbers(float, 0), default=0.0, metavar="M_S", help="on velocities that windows start with (default 0: a record has its own)")
    parser.add_argument("--impulse", type=numbers(float, 1e-6), default=0.1, metavar="M_S", help="what a velocity changes in a frame of impact (default %(default)s)")
    parser.add_argument("--seed", type=numbers(int, 0), default=0)
    parser.add_argument("--threads", type=positive, help="of the processor (default: one a core)")
    parser.add_argument("--json", type=pathlib.Path, metavar="FILE", help="also write all figures there")
    args = parser.parse_args(arguments)
    args.stops, args.shares, args.starts = sorted(set(args.stops)), sorted(set(args.shares)), list(dict.fromkeys(args.starts))
    if args.threads:
        torch.set_num_threads(args.threads)
    try:
        report = adapt(args)
    except (AdaptError, SceneFileError, OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted: nothing is written", file=sys.stderr)
        return 130
    if args.json:
        write_text(args.json, json.dumps(report, indent=1) + "\n")
    print(report["verdict"] + (f", {report['written'][0]} and {report['written'][1]}" if report["written"] else ""))
    return 0


if __name__ == "__main__":
    sys.exit(main())
