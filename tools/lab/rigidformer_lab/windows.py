"""Single steps of recorded scenes as the network sees them, worked out by the runtime: what `train_steps` learns from.

    python -m rigidformer_lab.windows movi-a.safetensors movi-b.safetensors --out windows --count 60000

A window observes two frames of a record and steps to a third. Its rows are the units that the network sees there: inputs of their
points and impacts, where the step ends without the network, and where the record has them. Windows without a unit that the network
corrects are left out. OUT is a folder of arrays that training maps into memory; a folder that is there already with the same arguments is
kept. Needs the runtime's Python package `rigidformer`.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import os
import pathlib
import shutil
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from .config import FEATURE_COUNT, IMPACT_FEATURES, IMPACTS, PRESETS, ModelConfig
from .data import IMPULSE_M_S, LAST_FRAME, Dataset
from .geometry import quaternion_to_matrix
from .model import ANCHORS, FEATURE_CLAMP
from .roles import FREE

#: The runtime gives inputs times this, so that it cuts none off: its limit is 10.
SCALE = 0.01
#: Where a point's inputs have its way since the scene began.
OFFSET = slice(6, 9)
#: Vectors among the inputs of a point, and among those of an impact: where each begins.
POINT_VECTORS = (0, 3, 6, 12, 15, 18, 27, 30)
IMPACT_VECTORS = (0, 3, 6, 9, 12, 25, 28, 31, 34, 37, 40)
ROW = ("features", "impacts", "impact_count", "points", "points_in_use", "anchors", "place", "pushes", "share", "wanted", "known")
WINDOW = ("start", "code", "active")
FORMAT = 1  # of a folder: another one is made again


def look(config: ModelConfig, folder):
    """A packed model that sees what one of `config` does, and is quick: its network has next to no weights."""
    import torch

    from .export import write_model
    from .model import RigidFormer

    small = PRESETS["tiny-impulses"]
    config = dataclasses.replace(config, **{
        field: getattr(small, field)
        for field in ("width", "heads", "head_dim", "blocks", "point_width", "registers", "feed_forward_width", "avp_width", "film_width",
                      "rope_frequencies", "scales", "point_hidden", "fuse_hidden")
    }, name="look", scope="near", most_units=0)  # fmt: skip
    with torch.random.fork_rng([]):
        torch.manual_seed(0)
        model = RigidFormer(config).initialise()
    model.encoder.feature_scale.fill_(SCALE)
    model.encoder.impact_scale.fill_(SCALE)
    import rigidformer

    exported, packed = pathlib.Path(folder) / "look.safetensors", pathlib.Path(folder) / "look.rfm"
    write_model(exported, config, model.state_dict(), {}, {})
    rigidformer.pack(exported, packed)
    return rigidformer.Model(packed)


def drawn(dataset, scene, rng, steps, count, contact_share, latest):
    """So many windows of a scene, (first frame, frames a step), most of them with a contact."""
    chosen = []
    last, hits = int(dataset.worlds.frames[scene]) - 1, dataset.hits[scene]
    for step in rng.choice(steps, count):
        top = min(latest, last - 2 * step)
        if top < 0:
            continue
        first = np.arange(top + 1)
        hit = hits[first + 2 * step] - hits[first + step] > 0
        wanted = first[hit] if rng.random() < contact_share else first
        if len(wanted):
            chosen.append((int(rng.choice(wanted)), int(step)))
    return sorted(set(chosen))


def turned(vectors):
    return Rotation.from_rotvec(vectors).as_matrix()


def rows_of(dataset, scene, config, windows, seen, points, rng):
    """Arrays of `ROW` and `WINDOW` of one scene, from what the runtime gives; windows without a row that counts are left out."""
    u, world, low = dataset.units, dataset.worlds, dataset.first_unit[scene]
    window, unit = seen["window"].astype(np.int64), seen["unit"].astype(np.int64) + low
    first, step = (np.array(windows, np.int64)[window].T if len(windows) else np.zeros((2, 0), np.int64))
    rate, gravity = float(world.rate[scene]), world.gravity[scene].astype(np.float64)
    size = float(dataset.typical[scene][0])
    length = size / config.length_m if config.length_m else 1.0
    own, here = np.linalg.norm(config.gravity_m_s2), np.linalg.norm(gravity)
    pull = own / here if config.length_m and own > 0 and here > 0 else 1.0
    second = np.sqrt(length * pull) if config.length_m else 1.0
    speed = length / second  # m/s that stand for one
    dt = (step / rate)[:, None, None]
    now, then = first + step, first + 2 * step
    pose = lambda frame: (quaternion_to_matrix(u.rotation[unit, frame].astype(np.float64)), u.centre[unit, frame].astype(np.float64))  # noqa: E731
    (r0, c0), (r1, c1), (r2, c2) = pose(first), pose(now), pose(then)
    picked = points[unit - low]  # (rows, points)
    start = dataset.start[u.shape[unit]]
    local = dataset.bank[start[:, None] + picked].astype(np.float64) * u.scale[unit][:, None, None]
    anchors = dataset.bank[start[:, None] + np.arange(ANCHORS)].astype(np.float64) * u.scale[unit][:, None, None]
    at = lambda rotation, centre, local=anchors: local @ rotation.swapaxes(-1, -2) + centre[:, None]  # noqa: E731
    end = seen["uncorrected"]
    centre, rotation, way, turn, share = end[:, :3], end[:, 3:12].reshape(-1, 3, 3), end[:, 12:15], end[:, 15:18], end[:, 18]
    prior, before = at(rotation, centre), at(turned(-turn) @ rotation, centre - way)
    free = at(r1 @ r0.swapaxes(-1, -2) @ r1, 2 * c1 - c0 + gravity * (step / rate)[:, None] ** 2)
    here_now = at(r1, c1)
    pushes = np.concatenate(((prior - free) / dt, ((prior - free) - (before - here_now)) / dt), -1) / speed
    # Engines answer a touch in the step after it, and the runtime within the step: where the record bounces just at the end, what it does
    # next is what is wanted, and of places nothing.
    frame = lambda k: u.centre[unit, (then + k).clip(max=u.centre.shape[1] - 1)].astype(np.float64)  # noqa: E731
    bend = lambda k: np.linalg.norm(frame(k + 1) - 2 * frame(k) + frame(k - 1) - gravity / rate**2, axis=-1) * rate > IMPULSE_M_S  # noqa: E731
    late = bend(0)
    unsettled = late & (bend(1) | (then + 2 > world.frames[scene] - 1))
    pace_way, pace_turn = dataset._paces(unit[:, None], (then + late)[:, None], step, np.full(len(unit), rate), np.repeat(gravity[None], len(unit), 0))
    pace_way = pace_way[:, 0, 0] - late[:, None] * gravity * (step / rate**2)[:, None]
    fall = 0.5 * gravity * (step / rate)[:, None] ** 2
    truth = at(r2, c2)
    truth_before = at(pace_turn[:, 0, 0].swapaxes(-1, -2) @ r2, c2 - pace_way + fall)
    wanted = np.concatenate(((truth - prior) / dt, ((truth - truth_before) - (prior - before)) / dt), -1) / speed
    known = np.stack((~late, ~unsettled), -1)
    features = seen["features"] / np.float32(SCALE)
    origin = (rng.random(len(unit)) * (first + 1)).astype(np.int64)
    # One origin a window, so that its units began together.
    origin = origin[np.searchsorted(window, window)]
    begin = pose(origin)
    features[..., OFFSET] = (at(r1, c1, local) - at(*begin, local)) / length
    impacts = np.zeros((len(unit), IMPACTS, IMPACT_FEATURES), np.float32)
    given = seen["impacts"][:, :IMPACTS] / np.float32(SCALE)
    impacts[:, : given.shape[1]] = given
    counts = np.diff(np.searchsorted(window, np.arange(len(windows) + 1)))
    code = np.array([s for _, s in windows], np.float64) * config.frame_rate_hz / (rate * second)
    active = (share > 0) & (u.role[unit] == FREE) & known.any(-1) & (np.abs(wanted).max((1, 2)) < 10 * (1 + share / speed))
    keep = np.zeros(len(windows), bool)
    np.logical_or.at(keep, window, active)
    keep &= code <= (config.longest_step or np.inf) * (1 + 1e-6)
    rows = keep[window]
    out = {
        "features": features.clip(-6e4, 6e4).astype(np.float16), "impacts": impacts.clip(-6e4, 6e4).astype(np.float16),
        "impact_count": seen["impact_count"].astype(np.uint8), "points": (local / length).astype(np.float16),
        "points_in_use": np.minimum(dataset.count[u.shape[unit]], points.shape[1]).astype(np.uint8),
        "anchors": (anchors / length).astype(np.float32), "place": (here_now / length).astype(np.float32),
        "pushes": pushes.clip(-FEATURE_CLAMP, FEATURE_CLAMP).astype(np.float32),
        "share": np.where(active, share / speed, 0.0).astype(np.float32), "wanted": wanted.astype(np.float32), "known": known,
    }  # fmt: skip
    out = {name: values[rows] for name, values in out.items()}
    return out, counts[keep], code[keep]


def chosen_points(dataset, scene, count, rng):
    """Numbers of points (U, P) of the units of a scene: the anchors, and others at random, in order; the last again where there are less."""
    out = []
    for shape in dataset.units.shape[dataset.first_unit[scene] : dataset.first_unit[scene + 1]]:
        have = int(dataset.count[shape])
        more = np.sort(rng.permutation(max(have - ANCHORS, 0))[: count - ANCHORS]) + ANCHORS
        own = np.concatenate((np.arange(ANCHORS), more))
        out.append(np.concatenate((own, np.full(count - len(own), own[-1]))))
    return np.stack(out)


def collect(paths, splits, config, count, steps, points=32, contact_share=0.9, seed=0, threads=None, latest=LAST_FRAME, limit=None):
    """Arrays of about so many windows of scene files, a dictionary. Draws depend on the scenes and the seed, not on threads."""
    import rigidformer

    parts = []
    datasets = [Dataset([path], splits, last_frame=latest, limit=limit) for path in paths]
    total = sum(map(len, datasets))
    bar = tqdm(total=total, disable=not sys.stderr.isatty(), unit="scene")
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        model = look(config, folder)
        for part, (path, dataset) in enumerate(zip(paths, datasets)):
            file = rigidformer.Dataset(path)
            names = {0: "train", 1: "validation", 2: "test", 3: "extra"}
            numbers = sorted(n for split in splits for n in file.scenes_of(names[split]))[:limit]
            if len(numbers) != len(dataset):
                raise SystemExit(f"{path}: {len(dataset)} scenes are read, and {len(numbers)} are there; take scenes whole")
            each = np.random.default_rng([seed, part]).multinomial(round(count * len(dataset) / total), np.full(len(dataset), 1 / len(dataset)))

            def one(scene, path=path, dataset=dataset, file=file, numbers=numbers, each=each, part=part):
                rng = np.random.default_rng([seed, part, scene])
                windows = drawn(dataset, scene, rng, steps, int(each[scene]), contact_share, latest)
                if not windows:
                    return None
                told = chosen_points(dataset, scene, points, rng)
                try:
                    seen = rigidformer.network_inputs(model, file.scene(numbers[scene]), windows, points=told.tolist())
                except rigidformer.StepError:
                    return None  # a record whose frames no step can start from
                return rows_of(dataset, scene, config, windows, seen, told, rng)

            for found in pool.map(one, range(len(dataset))):
                bar.update()
                if found is not None and len(found[1]):
                    parts.append(found)
    bar.close()
    if not parts:
        raise SystemExit(f"{', '.join(map(str, paths))}: no window has a unit that the network corrects; give scenes with contacts")
    out = {name: np.concatenate([rows[name] for rows, _, _ in parts]) for name in ROW}
    counts = np.concatenate([counts for _, counts, _ in parts])
    out["start"] = np.concatenate(([0], np.cumsum(counts)))
    out["code"] = np.concatenate([code for _, _, code in parts]).astype(np.float32)
    out["active"] = np.add.reduceat((out["share"] > 0).astype(np.int64), out["start"][:-1])
    return out


def described(paths, config, arguments):
    """What a folder of windows is of."""
    digests = {pathlib.Path(path).name: hashlib.sha256(pathlib.Path(path).read_bytes()).hexdigest()[:16] for path in paths}
    law = None if config.law is None else dataclasses.asdict(config.law)
    return {"format": FORMAT, "scenes": digests, "features": config.features, "length_m": config.length_m, "law": law, **arguments}


def write(folder, arrays, description):
    """A folder of arrays; whole, or not there."""
    folder = pathlib.Path(folder)
    temporary = folder.with_name(folder.name + ".parts")
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir(parents=True)
    for name, values in arrays.items():
        np.save(temporary / f"{name}.npy", values)
    (temporary / "windows.json").write_text(json.dumps(description) + "\n")
    if folder.exists():
        shutil.rmtree(folder)
    os.replace(temporary, folder)


def read(folder):
    """Arrays of a folder, mapped into memory, and what it is of."""
    folder = pathlib.Path(folder)
    if not (folder / "windows.json").exists():
        raise SystemExit(f"{folder}: is no folder of windows; make it with `python -m rigidformer_lab.windows`")
    arrays = {name: np.load(folder / f"{name}.npy", mmap_mode="r") for name in (*ROW, *WINDOW)}
    if arrays["features"].shape[-1] != FEATURE_COUNT["impact"]:
        raise SystemExit(f"{folder}: its points have {arrays['features'].shape[-1]} inputs; make it again")
    return arrays, json.loads((folder / "windows.json").read_text())


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", nargs="+", type=pathlib.Path, help="scene files of rigid units")
    parser.add_argument("--out", required=True, type=pathlib.Path, help="folder that the windows go to")
    parser.add_argument("--count", type=int, default=60_000, help="windows to draw (default %(default)s)")
    parser.add_argument("--steps", type=int, nargs="+", default=[1, 2, 3, 5, 7, 10, 10], help="frames a step; repeat one to weigh it")
    parser.add_argument("--points", type=int, default=32, help="points a unit (default %(default)s)")
    parser.add_argument("--contacts", type=float, default=0.9, help="share of the windows in which a unit is pushed (default %(default)s)")
    parser.add_argument("--preset", default="edge", help="model whose inputs they are (default %(default)s)")
    parser.add_argument("--config", type=json.loads, default={}, metavar="JSON", help="fields of the preset to change")
    parser.add_argument("--splits", type=int, nargs="+", default=[0, 3], choices=(0, 1, 3), help="0 train, 1 validation, 3 extra (default 0 3)")
    parser.add_argument("--last-frame", type=int, default=LAST_FRAME, help="last frame of a scene that is learnt from (default %(default)s)")
    parser.add_argument("--limit", type=int, help="scenes a file, at most")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int)
    args = parser.parse_args()
    if min(args.count, args.points - ANCHORS, *args.steps) < 1:
        parser.error(f"--count and --steps take 1 or more, --points more than {ANCHORS}")
    config = ModelConfig.from_json(json.dumps({**dataclasses.asdict(PRESETS[args.preset]), **args.config}))
    if config.motion != "impulses":
        parser.error(f"{args.preset} does not move units by impulses; give edge or nano")
    try:
        import rigidformer  # noqa: F401
    except ImportError:
        parser.error("the runtime's Python package is missing; install it from bindings/python (`pip install ./bindings/python`)")
    arguments = {name: getattr(args, name) for name in ("count", "steps", "points", "contacts", "splits", "last_frame", "limit", "seed")}
    description = described(args.data, config, arguments)
    if (args.out / "windows.json").exists() and json.loads((args.out / "windows.json").read_text()) == description:
        print(f"{args.out} is there already, of the same scenes and arguments", file=sys.stderr)
        return
    arrays = collect(args.data, args.splits, config, args.count, args.steps, args.points, args.contacts, args.seed, args.threads,
                     args.last_frame, args.limit)  # fmt: skip
    write(args.out, arrays, description)
    print(f"{len(arrays['code'])} windows of {len(arrays['share'])} units", file=sys.stderr)


if __name__ == "__main__":
    main()
