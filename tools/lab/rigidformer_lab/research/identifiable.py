"""Makes slides, bounces, tosses and meetings in PyBullet with drawn frictions, restitutions and masses, seen with noise.

    python -m rigidformer_lab.research.identifiable --seeds 100 --first-seed 1001 --out identifiable.safetensors
    rigidformer identify identifiable.safetensors --json > found.json
    python -m rigidformer_lab.research.identifiable --check found.json --out identifiable.safetensors

The seed draws a kind of scene and all that is in it:

slide   a flat body slides and spins on the ground
bounce  a ball or a box falls and bounces
toss    a box is thrown and tumbles
meet    a body slides into another one (only with --kinds: what is asked of it is the ratio of masses)

Friction with the ground is drawn from 0.05 to 0.8, restitution with it from 0 to 0.8: products of both coefficients, which is what
PyBullet and RigidFormer take. The ground has 0.7 and 0.9 of its own. Friction is a cone here, not the pyramid of `contacts`. Masses are drawn; of two that meet the ratio is 1/4 to 4.

The scene file has guesses in place of what was drawn: friction 0.5, restitution 0.5, and the mass of a density of 1,000 kg/m3. What was
drawn is in FILE.truth.json, which `--check` compares with what `rigidformer identify --json` said. Radii are 5 to 20 cm, as in
`contacts`, and poses are noisy: each coordinate by --noise-mm, each rotation by that over the radius.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from .. import bullet
from ..bullet import check_seeds
from ..contacts import BALL_POINTS, FLAT, REFERENCE_M, Stage, _log_uniform, rate_of
from ..movi import FRAME_RATE_HZ, GRAVITY_M_S2, PRIMITIVE_SUB_STEPS, _offsets, primitive_shapes
from ..roles import FREE
from ..scenes import TEST, SceneFileError, Scenes, write_scenes

DATASET = "identifiable"
KINDS = ("slide", "bounce", "toss")
MEET = "meet"
SIZE_M = 0.1
EVERY = 5  # of the frames that contacts would have: 117.6 a second
GROUND = (0.7, 0.9)  # friction and restitution of its own
FRICTION, RESTITUTION = (0.05, 0.8), (0.0, 0.8)  # products
GUESS = (0.5, 0.5)
GUESSED_DENSITY, DENSITY = 1000.0, (300.0, 3000.0)
PROBABILITY = 0.9


class Drawn(Stage):
    """A scene that is being set up on the ground; each of its bodies has products with the ground and a density of its own."""

    def __init__(self, pb, on: dict, rng, shapes):
        super().__init__(pb, on, rng, shapes)
        self.planes.append((0.0, 0.0, 1.0, 0.0, *GROUND))
        bullet.add_plane(pb, on, self.planes[-1])

    def body(self, names=None, radius=(0.5, 2.0), role: int = FREE):
        body = super().body(names, radius, role)
        part = body.parts[0]
        part.mass = self.shapes[part.shape].mass * part.scale**3 * _log_uniform(self.rng, *DENSITY)
        body.friction = self.rng.uniform(*FRICTION) / GROUND[0]
        body.restitution = self.rng.uniform(*RESTITUTION) / GROUND[1]
        return body


def _slide(stage: Drawn) -> None:
    body = stage.body(FLAT, (0.5, 1.5))
    stage.somewhere(body, stage.resting(body, 0.1))
    stage.move(body, stage.flat_velocity(2.0, 5.0), (0, 0, stage.rng.uniform(-3, 3)))


def _bounce(stage: Drawn) -> None:
    body = stage.body(("sphere",) if stage.rng.random() < 0.6 else ("box",), (0.5, 1.2))
    rise = stage.rng.uniform(1.0, 2.5)
    stage.somewhere(body, lambda: ((0, 0, rise), stage.any_turn()))
    stage.move(body, stage.flat_velocity(0.0, 3.0), stage.rng.normal(size=3) * 0.5)


def _toss(stage: Drawn) -> None:
    body = stage.body(("box",), (0.6, 1.2))
    rise = stage.rng.uniform(0.8, 1.6)
    stage.somewhere(body, lambda: ((0, 0, rise), stage.any_turn()))
    stage.move(body, stage.flat_velocity(1.0, 5.0) + (0, 0, stage.rng.uniform(-1.5, 1.0)), stage.rng.normal(size=3) * 2.0)


def _meet(stage: Drawn) -> None:
    one, other = (stage.body(("box", "cylinder"), (0.7, 1.1)) for _ in range(2))
    half = [stage.half(body) for body in (one, other)]
    gap = float(np.linalg.norm(half[0][:2]) + np.linalg.norm(half[1][:2])) + stage.rng.uniform(0.1, 0.5)
    heading = stage.about_z()
    stage.put(one, heading @ (-gap, 0.0, half[0][2] + 0.002), heading)
    stage.put(other, heading @ (0.0, stage.rng.uniform(-0.2, 0.2) * half[1][1], half[1][2] + 0.002), heading)
    stage.move(one, heading[:, 0] * stage.rng.uniform(4.0, 7.0))


MAKERS = {"slide": _slide, "bounce": _bounce, "toss": _toss, MEET: _meet}


def simulate(shapes, seed: int, frames: int, kinds) -> tuple[str, Drawn, np.ndarray]:
    """Kind, contents and poses, (units, frames, 7), of a scene at the reference size."""
    rng = np.random.default_rng((seed, 181))
    kind = kinds[int(rng.integers(len(kinds)))]
    with bullet.engine(GRAVITY_M_S2, 1.0 / (FRAME_RATE_HZ * PRIMITIVE_SUB_STEPS)) as (pb, on):
        # Of `movi` the pyramid: along its edges it has up to 1.41 times the coefficient that was drawn.
        pb.setPhysicsEngineParameter(enableConeFriction=True, **on)
        stage = Drawn(pb, on, rng, shapes)
        MAKERS[kind](stage)
        poses = np.empty((len(stage.bodies), frames, 7))
        for frame in range(frames):
            for unit, body in enumerate(stage.bodies):
                poses[unit, frame] = bullet.pose_of(pb, on, body.number)
            for _ in range(EVERY * PRIMITIVE_SUB_STEPS if frame + 1 < frames else 0):
                pb.stepSimulation(**on)
    bullet.steady_signs(poses)
    return kind, stage, poses


def _noisy(rng, poses: np.ndarray, noise_m: float, radius_m: float) -> np.ndarray:
    """Poses (frames, 7) as a sensor might see them."""
    place = poses[:, :3] + rng.normal(size=(len(poses), 3)) * noise_m
    turn = rng.normal(size=(len(poses), 3)) * (noise_m / radius_m)
    angle = np.linalg.norm(turn, axis=1, keepdims=True)
    w, xyz = np.cos(angle / 2), turn * np.sinc(angle / (2 * np.pi)) / 2
    q, v = poses[:, 3:4], poses[:, 4:]
    turned = np.concatenate([w * q - (xyz * v).sum(1, keepdims=True), w * v + q * xyz + np.cross(xyz, v)], axis=1)
    return np.concatenate([place, turned / np.linalg.norm(turned, axis=1, keepdims=True)], axis=1)


def make(seeds: range, frames: int, noise_m: float, kinds) -> tuple[Scenes, list[dict]]:
    """The scenes of these seeds as they were seen, and what is true of each."""
    shapes = primitive_shapes(BALL_POINTS)
    times = SIZE_M / REFERENCE_M
    units, planes, counts, truths = [], [], [], []
    for seed in seeds:
        kind, stage, poses = simulate(shapes, seed, frames, kinds)
        poses[:, :, :3] *= times
        rng = np.random.default_rng((seed, 182))
        planes += stage.planes
        counts.append(len(stage.bodies))
        for body, own in zip(stage.bodies, poses):
            part = body.parts[0]
            scale = part.scale * times
            guess = shapes[part.shape].mass * scale**3 * GUESSED_DENSITY
            inertia = np.array(body.inertia) * times**5 * guess / (part.mass * times**3)
            radius = float(np.linalg.norm(shapes[part.shape].points, axis=1).max()) * scale
            units.append((part.shape, scale, guess, inertia, _noisy(rng, own, noise_m, radius)))
        truths.append({
            "seed": seed, "kind": kind,
            "friction": [body.friction * GROUND[0] for body in stage.bodies],
            "restitution": [body.restitution * GROUND[1] for body in stage.bodies],
            "mass_kg": [body.mass * times**3 for body in stage.bodies],
        })  # fmt: skip
    return Scenes(
        dataset=DATASET,
        shape_names=[shape.name for shape in shapes],
        shape_points=np.concatenate([shape.points for shape in shapes]),
        shape_offsets=_offsets([len(shape.points) for shape in shapes]),
        scene_seed=np.array(seeds, np.int64),
        scene_split=np.full(len(seeds), TEST, np.uint8),
        scene_units=_offsets(counts),
        unit_shape=np.array([unit[0] for unit in units], np.int32),
        unit_scale=np.array([unit[1] for unit in units], np.float32),
        unit_physics=np.array([(unit[2], *GUESS) for unit in units], np.float32),
        unit_poses=np.stack([unit[4] for unit in units]).astype(np.float32),
        provenance=f"Generated by rigidformer_lab.research.identifiable with PyBullet 3.2.7, kinds {', '.join(kinds)}, noise "
                   f"{noise_m * 1e3:g} mm; shapes of the lab's own, no assets used.",
        licence="the licence of the rigidformer project",
        frame_rate_hz=rate_of(SIZE_M) / EVERY,
        gravity_m_s2=GRAVITY_M_S2,
        ground_friction=None,
        ground_restitution=None,
        planes=np.array(planes, np.float32),
        scene_planes=_offsets([1] * len(seeds)),
        unit_inertia=np.array([unit[3] for unit in units], np.float32),
    ), truths


def holds(interval: dict, value: float) -> bool | None:
    """Whether an interval of `rigidformer identify --json` holds a value; None: it was not seen."""
    match interval["seen"]:
        case "between":
            return interval["low"] <= value <= interval["high"]
        case "at least":
            return value >= interval["low"]
        case "at most":
            return value <= interval["high"]
    return None


def compare(found: dict, truths: list[dict]) -> list[tuple]:
    """Rows of (seed, kind, what, interval, truth, whether it holds)."""
    rows = []
    for result in found["results"]:
        truth = truths[result["scenes"][0]]
        for unit in result["units"]:
            for what in ("friction", "restitution"):
                value = truth[what][unit["unit"]]
                rows.append((truth["seed"], truth["kind"], what, unit[what], value, holds(unit[what], value)))
        for pair in result["met"]:
            one, other = pair["units"]
            value = truth["mass_kg"][one] / truth["mass_kg"][other]
            rows.append((truth["seed"], truth["kind"], "mass ratio", pair["mass_ratio"], value, holds(pair["mass_ratio"], value)))
    return rows


def report(rows: list[tuple], each: bool) -> None:
    """Prints how many intervals hold the truth."""
    if each:
        for seed, kind, what, interval, value, held in rows:
            text = " ".join(f"{key} {interval[key]:.3f}" for key in ("low", "middle", "high") if key in interval)
            mark = {True: "", False: "MISSED", None: ""}[held]
            print(f"{seed} {kind:7} {what:11} truth {value:.3f}  {interval['seen']:8} {text} {mark}")
    print(f"{'':8}{'':12} scenes  seen (one bound)  hold the truth   median width   median error   bias")
    for what in ("friction", "restitution", "mass ratio"):
        for kind in (*KINDS, MEET, "all"):
            own = [row for row in rows if row[2] == what and kind in (row[1], "all")]
            if not own:
                continue
            seen = [row for row in own if row[5] is not None]
            both = [row for row in seen if row[3]["seen"] == "between"]
            held = sum(row[5] for row in seen)
            width = np.median([row[3]["high"] - row[3]["low"] for row in both]) if both else float("nan")
            errors = np.array([row[3]["middle"] - row[4] for row in both]) if both else np.array([np.nan])
            share = f"{held / len(seen):.2f}" if seen else "-"
            print(f"{kind:8}{what:12} {len(own):6}  {len(seen):4} ({len(seen) - len(both)})  {held:10} ({share})  {width:12.4f}  "
                  f"{np.median(np.abs(errors)):12.4f}  {np.median(errors):+8.4f}")


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m rigidformer_lab.research.identifiable", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="scene file to make; what is true goes to FILE.truth.json")
    parser.add_argument("--seeds", type=int, default=100, help="number of scenes (default %(default)s)")
    parser.add_argument("--first-seed", type=int, default=1, help="default %(default)s")
    parser.add_argument("--frames", type=int, default=110, help="frames a scene, 117.6 a second (default %(default)s)")
    parser.add_argument("--noise-mm", type=float, default=0.5, help="default %(default)s")
    parser.add_argument("--kinds", nargs="+", choices=(*KINDS, MEET), default=list(KINDS), help="default: all but meet")
    parser.add_argument("--check", type=Path, metavar="FOUND.json", help="what `rigidformer identify FILE --json` said of the "
                        "scenes of --out, which are not made again")
    parser.add_argument("--each", action="store_true", help="with --check: print every interval")
    options = parser.parse_args(arguments)
    options.workers = 1
    check_seeds(parser, options)
    if not 0 <= options.noise_mm <= 100:
        parser.error(f"--noise-mm {options.noise_mm}: give millimetres from 0 to 100")
    truth_file = options.out.with_name(options.out.name + ".truth.json")
    try:
        if options.check:
            report(compare(json.loads(options.check.read_text()), json.loads(truth_file.read_text())), options.each)
            return 0
        kinds = tuple(kind for kind in (*KINDS, MEET) if kind in options.kinds)
        seeds = range(options.first_seed, options.first_seed + options.seeds)
        scenes, truths = make(seeds, options.frames, options.noise_mm * 1e-3, kinds)
        write_scenes(options.out, scenes)
        truth_file.write_text(json.dumps(truths, indent=1) + "\n")
    except (SceneFileError, OSError, ValueError, KeyError, IndexError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(f"{options.out}: {scenes.scenes} scenes, {scenes.units} units, {scenes.frames} frames, {options.out.stat().st_size} bytes")
    return 0


if __name__ == "__main__":
    sys.exit(main())
