"""Single steps of recorded scenes as the network sees them, worked out by the runtime: what `train_steps` learns from.

    python -m rigidformer_lab.windows movi-a.safetensors movi-b.safetensors --out windows --count 60000

A window observes two frames of a record and steps to a third. Its rows are the units that the network sees there: inputs of their
points and impacts, where the step ends without the network, and where the record has them. Windows without a unit that the network
corrects are left out. Real impacts last, and frames may lie amidst one; impacts of rigid contact do not. With
`--impacts whole` windows therefore begin with the velocity at their second frame, by the frame before it, and none begins amidst an
impact. A unit that is amidst one at the end ends as it leaves, flown back to there. OUT is a folder of arrays that training maps into memory; a folder that is there already with the same arguments is
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
from .scenes import ContactLaw, SceneFileError, read_scenes, write_scenes

#: The runtime gives inputs times this, so that it cuts none off: its limit is 10.
SCALE = 0.01
#: Where a point's inputs have its way since the scene began.
OFFSET = slice(6, 9)
#: Vectors among the inputs of a point, and among those of an impact: where each begins.
POINT_VECTORS = (0, 3, 6, 12, 15, 18, 27, 30)
IMPACT_VECTORS = (0, 3, 6, 9, 12, 25, 28, 31, 34, 37, 40)
ROW = ("features", "impacts", "impact_count", "points", "points_in_use", "anchors", "place", "pushes", "share", "wanted", "known")
WINDOW = ("start", "code", "active")
FORMAT = 2  # of a folder: another one is made again
LASTS = 4  # frames that an impact goes on after a window's end, at most


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


def poses_at(units, rows, frames):
    """Rotations (N, 3, 3) and centres (N, 3) of such rows of units at such frames."""
    return quaternion_to_matrix(units.rotation[rows, frames].astype(np.float64)), units.centre[rows, frames].astype(np.float64)


def begins(pushed, rows, frames):
    """Whether a unit is in no impact at such frames: its way since the frame before tells its velocity."""
    return ~pushed[rows, frames - 1]


def leaves(pushed, rows, frames):
    """The frames, or the next ones at which units are in no impact any more; -1 where none is near, or where one is just to come."""
    out, last = np.full(len(frames), -1), pushed.shape[1] - 1
    for more in range(LASTS, -1, -1):
        later = np.minimum(frames + more, last)
        out = np.where(begins(pushed, rows, later), later, out)
    comes = pushed[rows, np.minimum(frames, last)] & (out == frames)
    return np.where(comes, -1, out)


def starts_of(dataset, scene, gravity, windows, whole, noise_m_s, rng):
    """What windows observe, (windows, 2, units, 7) poses as a scene file has them, or None: their frames as recorded. `whole`: of the
    velocity at the second one. `noise_m_s` is on the velocities of free units."""
    if not whole and not noise_m_s:
        return None
    u, rate = dataset.units, float(dataset.worlds.rate[scene])
    rows = np.arange(*dataset.first_unit[scene : scene + 2])
    first, step = np.array(windows, np.int64).T
    now, each, dt = first + step, np.broadcast_to(rows, (len(windows), len(rows))), (step / rate)[:, None, None]
    (r0, c0), (r1, c1) = (poses_at(u, each, frames[:, None]) for frames in (first, now))
    free = u.role[rows] == FREE
    if whole:
        of = lambda values: np.repeat(values[None], len(windows), 0)  # noqa: E731
        way, turn = dataset._paces(each, now[:, None], step, of(np.float64(rate)), of(gravity))
        # Free motion covers that, and half of a fall more, in the next step.
        c0 = np.where(free[:, None], c1 - way[:, :, 0] + 0.5 * gravity * dt**2, c0)
        r0 = np.where(free[:, None, None], turn[:, :, 0].swapaxes(-1, -2) @ r1, r0)
    c0 = c0 + rng.normal(size=c0.shape) * noise_m_s * dt * free[:, None]
    poses = np.empty((len(windows), 2, len(rows), 7), np.float32)
    for number, (rotation, centre) in enumerate(((r0, c0), (r1, c1))):
        poses[:, number, :, :3] = centre - (rotation @ u.centre_offset[rows][..., None].astype(np.float64))[..., 0]
        quaternion = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_quat().reshape(*rotation.shape[:2], 4)
        poses[:, number, :, 3:] = quaternion[..., [3, 0, 1, 2]]
    return poses


def ends_of(dataset, scene, unit, then, step, gravity, pushed):
    """Rotations and centres of units where windows end, the way and the turn (a rotation) of a step at their velocity there, and whether
    places and velocities are known, (rows, 2). `pushed`: units amidst an impact end as they leave it."""
    u, rate, frames = dataset.units, float(dataset.worlds.rate[scene]), dataset.worlds.frames[scene]
    of = (np.full(len(unit), rate), np.repeat(gravity[None], len(unit), 0))
    paces = lambda frames: (values[:, 0, 0] for values in dataset._paces(unit[:, None], frames[:, None], step, *of))  # noqa: E731
    if pushed is None:
        # Engines answer a touch in the step after it, and the runtime within the step: where the record bounces just at the end, what it
        # does next is what is wanted, and of places nothing.
        frame = lambda k: u.centre[unit, (then + k).clip(max=u.centre.shape[1] - 1)].astype(np.float64)  # noqa: E731
        bend = lambda k: np.linalg.norm(frame(k + 1) - 2 * frame(k) + frame(k - 1) - gravity / rate**2, axis=-1) * rate > IMPULSE_M_S  # noqa: E731
        late = bend(0)
        unsettled = late & (bend(1) | (then + 2 > frames - 1))
        rotation, centre = poses_at(u, unit, then)
        way, turn = paces(then + late)
        return rotation, centre, way - late[:, None] * gravity * (step / rate**2)[:, None], turn, np.stack((~late, ~unsettled), -1)
    end = leaves(pushed, unit, then)
    known, end = end >= 0, np.where(end >= 0, end, then)
    rotation, centre = poses_at(u, unit, end)
    way, turn = paces(end)
    late, dt = ((end - then) / step)[:, None], (step / rate)[:, None]
    centre = centre - way * late + 0.5 * gravity * (late * dt) ** 2
    back = Rotation.from_rotvec(-late * Rotation.from_matrix(turn).as_rotvec()).as_matrix()
    return back @ rotation, centre, way - gravity * late * dt**2, turn, np.stack((known, known), -1)


def rows_of(dataset, scene, config, windows, seen, points, rng, gravity=None, starts=None, pushed=None):
    """Arrays of `ROW` and `WINDOW` of one scene, from what the runtime gives; windows without a row that counts are left out."""
    u, world, low = dataset.units, dataset.worlds, dataset.first_unit[scene]
    window, unit = seen["window"].astype(np.int64), seen["unit"].astype(np.int64) + low
    first, step = (np.array(windows, np.int64)[window].T if len(windows) else np.zeros((2, 0), np.int64))
    rate = float(world.rate[scene])
    gravity = world.gravity[scene].astype(np.float64) if gravity is None else gravity
    size = float(dataset.typical[scene][0])
    length = size / config.length_m if config.length_m else 1.0
    own, here = np.linalg.norm(config.gravity_m_s2), np.linalg.norm(gravity)
    pull = own / here if config.length_m and own > 0 and here > 0 else 1.0
    second = np.sqrt(length * pull) if config.length_m else 1.0
    speed = length / second  # m/s that stand for one
    dt = (step / rate)[:, None, None]
    now, then = first + step, first + 2 * step
    (r0, c0), (r1, c1) = (poses_at(u, unit, frame) for frame in (first, now))
    r2, c2, pace_way, pace_turn, known = ends_of(dataset, scene, unit, then, step, gravity, pushed)
    if pushed is not None:
        known &= begins(pushed, unit, now)[:, None]
    if starts is not None:
        told = starts[window, 0, unit - low].astype(np.float64)
        r0 = quaternion_to_matrix(told[:, 3:])
        c0 = told[:, :3] + (r0 @ u.centre_offset[unit][..., None].astype(np.float64))[..., 0]
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
    fall = 0.5 * gravity * (step / rate)[:, None] ** 2
    truth = at(r2, c2)
    truth_before = at(pace_turn.swapaxes(-1, -2) @ r2, c2 - pace_way + fall)
    wanted = np.concatenate(((truth - prior) / dt, ((truth - truth_before) - (prior - before)) / dt), -1) / speed
    features = seen["features"] / np.float32(SCALE)
    origin = (rng.random(len(unit)) * (first + 1)).astype(np.int64)
    # One origin a window, so that its units began together.
    origin = origin[np.searchsorted(window, window)]
    begin = poses_at(u, unit, origin)
    features[..., OFFSET] = (at(r1, c1, local) - at(*begin, local)) / length
    impacts = np.zeros((len(unit), IMPACTS, IMPACT_FEATURES), np.float32)
    given = seen["impacts"][:, :IMPACTS] / np.float32(SCALE)
    impacts[:, : given.shape[1]] = given
    counts = np.diff(np.searchsorted(window, np.arange(len(windows) + 1)))
    code = np.array([s for _, s in windows], np.float64) * config.frame_rate_hz / (rate * second)
    active = known.any(-1) & (share > 0) & (u.role[unit] == FREE) & (np.abs(wanted).max((1, 2)) < 10 * (1 + share / speed))
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


def refuse(folder, paths):
    """Refuses to write windows where something else is."""
    folder = pathlib.Path(folder).resolve()
    if not folder.name:
        raise SystemExit(f"--out {folder}: has no name; give a folder that is not there")
    own = {"windows.json", *(f"{name}.npy" for name in (*ROW, *WINDOW, "scene"))}
    for place in (folder, folder.with_name(folder.name + ".parts")):
        if place.exists() and (not place.is_dir() or {entry.name for entry in place.iterdir()} - own):
            raise SystemExit(f"--out {folder}: {place} holds something else; give a folder that is not there")
    for path in paths:
        if not pathlib.Path(path).is_file():
            raise SystemExit(f"{path}: is no file; give scene files")


def collect(paths, splits, config, count, steps, points=32, contact_share=0.9, seed=0, threads=None, latest=LAST_FRAME, limit=None,
            contact=None, whole=False, noise_m_s=0.0, impulse_m_s=IMPULSE_M_S, rigid=False):  # fmt: skip
    """Arrays of about so many windows of scene files, a dictionary: those of `ROW` and `WINDOW`, and `scene`, the number of each window's
    scene among all. Draws depend on the scenes and the seed, not on threads. `contact`: a file of contact's numbers, which scenes take.
    `whole`: impacts are. `rigid`: contact is, whatever law the scenes have. `impulse_m_s`: what a velocity changes in a frame of impact; what lies still is pushed too, against gravity."""
    import rigidformer

    parts, base = [], 0
    datasets = [Dataset([path], splits, last_frame=latest, limit=limit) for path in paths]
    impacts = [dataset.pushed(impulse_m_s) if whole else None for dataset in datasets]
    if impulse_m_s != IMPULSE_M_S:
        for dataset in datasets:
            dataset.hits = dataset._hits(impulse_m_s)
    total = sum(map(len, datasets))
    bar = tqdm(total=total, disable=not sys.stderr.isatty(), unit="scene")
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        model = look(config, folder)
        for part, (path, dataset) in enumerate(zip(paths, datasets)):
            if rigid and read_scenes(path).contact_law != ContactLaw():
                plain = pathlib.Path(folder) / f"{part}.safetensors"
                write_scenes(plain, dataclasses.replace(read_scenes(path), contact_law=ContactLaw()))
                path = plain
            file = rigidformer.Dataset(path)
            names = {0: "train", 1: "validation", 2: "test", 3: "extra"}
            numbers = sorted(n for split in splits for n in file.scenes_of(names[split]))[:limit]
            if len(numbers) != len(dataset):
                raise SystemExit(f"{path}: {len(dataset)} scenes are read, and {len(numbers)} are there; take scenes whole")
            if not numbers:
                continue
            each = np.random.default_rng([seed, part]).multinomial(round(count * len(dataset) / total), np.full(len(dataset), 1 / len(dataset)))

            def one(scene, path=path, dataset=dataset, file=file, numbers=numbers, each=each, part=part):
                rng = np.random.default_rng([seed, part, scene])
                windows = drawn(dataset, scene, rng, steps, int(each[scene]), contact_share, latest)
                if not windows:
                    return None
                told = chosen_points(dataset, scene, points, rng)
                recorded = file.scene(numbers[scene])
                if contact is not None:
                    recorded = recorded.with_contact(contact)
                gravity = recorded.gravity_m_s2.astype(np.float64)
                start = starts_of(dataset, scene, gravity, windows, whole, noise_m_s, rng)
                try:
                    seen = rigidformer.network_inputs(model, recorded, windows, points=told.tolist(), starts=start)
                except rigidformer.StepError:
                    return None  # a record whose frames no step can start from
                return rows_of(dataset, scene, config, windows, seen, told, rng, gravity, start, impacts[part])

            for scene, found in enumerate(pool.map(one, range(len(dataset)))):
                bar.update()
                if found is not None and len(found[1]):
                    parts.append((*found, base + scene))
            base += len(dataset)
    bar.close()
    if not parts:
        raise SystemExit(f"{', '.join(map(str, paths))}: no window has a unit that the network corrects; give scenes with contacts")
    out = {name: np.concatenate([rows[name] for rows, _, _, _ in parts]) for name in ROW}
    counts = np.concatenate([counts for _, counts, _, _ in parts])
    out["start"] = np.concatenate(([0], np.cumsum(counts)))
    out["code"] = np.concatenate([code for _, _, code, _ in parts]).astype(np.float32)
    out["scene"] = np.concatenate([np.full(len(code), scene, np.int32) for _, _, code, scene in parts])
    out["active"] = np.add.reduceat((out["share"] > 0).astype(np.int64), out["start"][:-1])
    return out


def digest(path):
    """Of a file's bytes, 16 figures."""
    return hashlib.sha256(pathlib.Path(path).read_bytes()).hexdigest()[:16]


def described(paths, config, arguments):
    """What a folder of windows is of."""
    digests = {pathlib.Path(path).name: digest(path) for path in paths}
    laws = [] if arguments.get("rigid") else sorted({str(read_scenes(path).contact_law) for path in paths} - {str(ContactLaw())})
    return {"format": FORMAT, "scenes": digests, "laws": laws, "features": config.features, "length_m": config.length_m, **arguments}


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
    parser.add_argument("--rigid", action="store_true", help="take contact as rigid, whatever law the scenes have")
    parser.add_argument("--preset", default="edge", choices=PRESETS, help="model whose inputs they are (default %(default)s)")
    parser.add_argument("--config", type=json.loads, default={}, metavar="JSON", help="fields of the preset to change")
    parser.add_argument("--splits", type=int, nargs="+", default=[0, 3], choices=(0, 1, 3), help="0 train, 1 validation, 3 extra (default 0 3)")
    parser.add_argument("--last-frame", type=int, default=LAST_FRAME, help="last frame of a scene that is learnt from (default %(default)s)")
    parser.add_argument("--limit", type=int, help="scenes a file, at most")
    parser.add_argument("--contact", type=pathlib.Path, metavar="FILE", help="contact's numbers, as `rigidformer calibrate` wrote them, in place of the scenes'")
    parser.add_argument("--impacts", default="cut", choices=("cut", "whole"), help="at both ends of windows (default %(default)s)")
    parser.add_argument("--impulse", type=float, default=IMPULSE_M_S, metavar="M_S", help="what a unit's velocity changes in a frame of contact (default %(default)s)")
    parser.add_argument("--noise", type=float, default=0.0, metavar="M_S", help="on those of free units, m/s (default 0)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int)
    args = parser.parse_args()
    if not (0 <= args.noise < np.inf and 0 < args.impulse < np.inf):
        parser.error("--noise takes a number from 0, m/s, and --impulse one above 0")
    if min(args.count, args.points - ANCHORS, *args.steps) < 1:
        parser.error(f"--count and --steps take 1 or more, --points more than {ANCHORS}")
    config = ModelConfig.from_json(json.dumps({**dataclasses.asdict(PRESETS[args.preset]), **args.config}))
    if config.motion != "impulses":
        parser.error(f"{args.preset} does not move units by impulses; give edge or nano")
    try:
        import rigidformer  # noqa: F401
    except ImportError:
        parser.error("the runtime's Python package is missing; install it from bindings/python (`pip install ./bindings/python`)")
    names = ("count", "steps", "points", "contacts", "splits", "last_frame", "limit", "seed", "impacts", "noise", "impulse", "rigid")
    arguments = {name: getattr(args, name) for name in names}
    if args.contact:
        if not args.contact.is_file():
            parser.error(f"--contact {args.contact}: is no file; make one with `rigidformer calibrate`")
        arguments["contact"] = digest(args.contact)
    refuse(args.out, args.data)
    try:
        made(args, config, arguments)
    except (SceneFileError, ValueError) as error:
        raise SystemExit(f"error: {error}") from error
    except KeyboardInterrupt:
        print("interrupted: nothing is written", file=sys.stderr)
        raise SystemExit(130) from None


def made(args, config, arguments):
    """Collects and writes what `main` was asked for."""
    description = described(args.data, config, arguments)
    if (args.out / "windows.json").exists() and json.loads((args.out / "windows.json").read_text()) == description:
        print(f"{args.out} is there already, of the same scenes and arguments", file=sys.stderr)
        return
    arrays = collect(args.data, args.splits, config, args.count, args.steps, args.points, args.contacts, args.seed, args.threads,
                     args.last_frame, args.limit, args.contact, args.impacts == "whole", args.noise, args.impulse, args.rigid)  # fmt: skip
    write(args.out, arrays, description)
    print(f"{len(arrays['code'])} windows of {len(arrays['share'])} units", file=sys.stderr)


if __name__ == "__main__":
    main()
