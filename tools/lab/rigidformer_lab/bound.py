"""What perfect corrections would win: rollouts of the core in which units take the velocities of the record at some moments.

    python -m rigidformer_lab.bound movi-a.safetensors --model edge-i8.rfm --steps 1 10

A correction is perfect where a unit ends the step with the record's velocity and spin: in the first impact of each unit, in all
impacts, in impacts of a kind, or in free flight. Elsewhere the motion is the model's. What an error falls by is what there is to learn
there. The row `start` corrects the second observed frame alone: velocities are seen as differences of poses, which an impact between
the two frames makes wrong.

Needs the runtime's Python package `rigidformer`.
"""

from __future__ import annotations

import argparse
import json
import pathlib
import sys

import numpy as np
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from .data import IMPULSE_M_S
from .movi import write_text

#: A spin changes by this much in an impact at least, rad/s.
SPIN_RAD_S = 0.05
#: Units that have an impact in one frame, and whose balls are this near, have hit each other, in sums of radii.
NEAR = 1.1
#: Rows: the name, and which moments are corrected.
CORRECTIONS = ("nothing", "start", "first impact", "all impacts", "ground", "units", "flight", "start and all impacts", "everything")


class Record:
    """A recorded scene: units' centres, turns, velocities and impacts."""

    def __init__(self, scene, offsets, radii):
        poses = np.asarray(scene.poses, np.float64)
        self.rate = scene.frame_rate_hz
        self.turn = Rotation.from_quat(poses[..., [4, 5, 6, 3]].reshape(-1, 4))
        self.shape = poses.shape[:2]
        matrices = self.turn.as_matrix().reshape(*self.shape, 3, 3)
        self.poses = poses
        self.centre = poses[..., :3] + np.einsum("tuij,uj->tui", matrices, offsets)
        fall = np.asarray(scene.gravity_m_s2, np.float64) / self.rate
        way = np.diff(self.centre, axis=0) * self.rate
        turns = Rotation.from_matrix((matrices[1:] @ matrices[:-1].swapaxes(-1, -2)).reshape(-1, 3, 3))
        spin = turns.as_rotvec().reshape(way.shape) * self.rate
        bend = np.linalg.norm(np.diff(way, axis=0) - fall, axis=-1) > IMPULSE_M_S
        bend |= np.linalg.norm(np.diff(spin, axis=0), axis=-1) > SPIN_RAD_S
        # An impact within an interval bends the way at both of its ends; one bend alone is of an impact at the begin of an interval.
        self.hit = np.zeros(way.shape[:2], bool)
        none = np.zeros_like(bend[:1])
        before, after = np.concatenate((none, bend[:-1])), np.concatenate((bend[1:], none))
        self.hit[1:] = bend & (after | ~before)
        # One bend alone at the second frame is of an impact in the first interval, which has no bend before it.
        self.hit[0], self.hit[1] = self.hit[1] & ~after[0], self.hit[1] & after[0]
        # Of a frame: by the interval behind it where that has no impact, otherwise by the one before.
        velocity = np.concatenate((way - 0.5 * fall, way[-1:] + 0.5 * fall))
        spins = np.concatenate((spin, spin[-1:]))
        back = np.zeros(velocity.shape[:2], bool)
        back[1:-1] = self.hit[1:] & ~self.hit[:-1]
        velocity[1:][back[1:]] = (way + 0.5 * fall)[back[1:]]
        spins[1:][back[1:]] = spin[back[1:]]
        self.velocity = np.concatenate((velocity, spins), -1)
        near = np.linalg.norm(self.centre[:-1, :, None] - self.centre[:-1, None], axis=-1) < NEAR * (radii[:, None] + radii)
        near &= ~np.eye(self.shape[1], dtype=bool)
        self.of_units = self.hit & (near & self.hit[:, None]).any(-1)

    def impacts(self, first, last, kind=None):
        """Which units have an impact in the intervals from a frame to another (U)."""
        hit = self.hit if kind is None else self.of_units if kind == "units" else self.hit & ~self.of_units
        return hit[first:last].any(0)


def corrected(record, correction, seen, first, last):
    """Which units end the step between two frames with the record's motion (U). seen (U): those that had an impact before."""
    hits = record.impacts(first, last)
    match correction:
        case "first impact":
            return hits & ~seen
        case "all impacts" | "start and all impacts":
            return hits
        case "ground" | "units":
            return record.impacts(first, last, correction)
        case "flight":  # before the first impact: what is behind one has its error
            return ~hits & ~seen
        case "everything":
            return np.ones_like(hits)
    return np.zeros_like(hits)


def rolled_out(rigidformer, model, scene, step, correction, frame, network):
    """Position and orientation error at a frame: RMS over units, metres and degrees."""
    world = rigidformer.World(model, units=len(scene.units), points=sum(max(len(points), 8) for points in scene.points(0)) + 4096)
    world.network = network
    poses = np.asarray(scene.poses)
    if scene.planes is not None:
        world.planes = scene.planes
    world.gravity_m_s2, world.contact_law = scene.gravity_m_s2, scene.contact_law
    world.observe_poses(step / scene.frame_rate_hz, scene.units, poses[0], poses[step])
    turn = Rotation.from_quat(poses[step][:, [4, 5, 6, 3]])
    offsets = turn.inv().apply(world.centres() - poses[step][:, :3])
    radii = np.array([np.linalg.norm(points - centre, axis=1).max() for points, centre in zip(scene.points(step), world.centres())])
    record = Record(scene, offsets, radii)
    if "start" in correction or correction == "everything":
        world.set_velocities(record.velocity[step].astype(np.float32))
    seen = record.impacts(0, step)
    for last in range(2 * step, frame + 1, step):
        world.step()
        right = corrected(record, correction, seen, last - step, last)
        seen |= record.impacts(last - step, last)
        if right.any():
            velocities = np.array(world.velocities())
            velocities[right] = record.velocity[last][right]
            world.set_velocities(velocities.astype(np.float32))
    found = np.asarray(world.poses())
    away = np.linalg.norm(found[:, :3] - poses[frame][:, :3], axis=1)
    between = Rotation.from_quat(found[:, [4, 5, 6, 3]]).inv() * Rotation.from_quat(poses[frame][:, [4, 5, 6, 3]])
    return [float(np.sqrt((v**2).mean())) for v in (away, np.degrees(between.magnitude()))]


def bound(path, model, steps, split="validation", limit=None, frame=100, network=True):
    """Rows of a scene file: {"step", "correction", "position_m", "orientation_deg"}, means over scenes."""
    import rigidformer

    dataset = rigidformer.Dataset(path)
    scenes = dataset.scenes_of(split)[:limit]
    if not scenes:
        raise SystemExit(f"{path}: no scene is in the split {split}; choose another with --split")
    loaded = rigidformer.Model(model)
    rows = []
    bar = tqdm(total=len(scenes) * len(steps) * len(CORRECTIONS), disable=not sys.stderr.isatty(), unit="rollout")
    for step in steps:
        errors = np.zeros((len(CORRECTIONS), len(scenes), 2))
        for place, index in enumerate(scenes):
            scene = dataset.scene(index, frame + 2)
            if scene.frames < frame + 2:
                raise SystemExit(f"{path}: scene {index} has {scene.frames} frames; give --frame {scene.frames - 2} or less")
            for row, correction in enumerate(CORRECTIONS):
                errors[row, place] = rolled_out(rigidformer, loaded, scene, step, correction, frame - frame % step, network)
                bar.update()
        for correction, (position, orientation) in zip(CORRECTIONS, errors.mean(1)):
            rows.append({"step": step, "correction": correction, "position_m": position, "orientation_deg": orientation})
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=pathlib.Path, help="scene file of free rigid units")
    parser.add_argument("--model", type=pathlib.Path, required=True, help="packed model whose motion is corrected")
    parser.add_argument("--no-network", action="store_true", help="its motion without the network")
    parser.add_argument("--steps", type=int, nargs="+", default=[1, 10], help="frames a step (default 1 10)")
    parser.add_argument("--split", default="validation", choices=("train", "validation", "extra"), help="never the test scenes")
    parser.add_argument("--limit", type=int, help="scenes at most")
    parser.add_argument("--frame", type=int, default=100, help="where errors are read (default 100)")
    parser.add_argument("--json", type=pathlib.Path, metavar="FILE", help="file that the rows go to as well")
    args = parser.parse_args()
    if min(args.steps) < 1 or args.frame < 3 * max(args.steps):
        parser.error("--steps takes 1 or more, and --frame three steps or more")
    try:
        import rigidformer  # noqa: F401
    except ImportError:
        parser.error("the runtime's Python package is missing; install it from bindings/python (`pip install ./bindings/python`)")
    rows = bound(args.data, args.model, args.steps, args.split, args.limit, args.frame, not args.no_network)
    print(f"{args.data.stem}, {args.split}, frame {args.frame}: position m / orientation degrees, and what a perfect correction wins")
    for row in rows:
        plain = next(r for r in rows if r["step"] == row["step"] and r["correction"] == "nothing")
        won = [100 * (1 - row[k] / plain[k]) if plain[k] else 0.0 for k in ("position_m", "orientation_deg")]
        print(f"s = {row['step']:<3} {row['correction']:<22} {row['position_m']:.4f} / {row['orientation_deg']:.2f}   {won[0]:5.0f} % / {won[1]:4.0f} %")
    if args.json:
        write_text(args.json, json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
