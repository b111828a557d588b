"""Where the error of `rigidformer track`'s predictions comes from: the same predictions with parts of what the tracker has made true.

    python -m rigidformer_lab.research.ahead movi-a.safetensors --model edge-i8.rfm --cameras 2 --noise 0.001

The tracker follows scenes that are rendered, with the network and without it, and predicts from every third capture. Beside its own
prediction (`tracker`) stand those of the same model from other starts. `shape`: the tracker's shapes and masses where it has them, with
true velocities. `motion`: true shapes and poses, the tracker's velocities. `both`: the tracker's shapes and velocities. `neither`: true
shapes, poses and velocities. In all of these frictions and restitutions are the tracker's guesses, and so are densities; `physics` is
`neither` with recorded ones. Planes are true, but for `tracker`.

Errors of positions are those of body frames, RMS over all units and captures, and the median; a start has none. `speed` and `spin` are
errors of the tracker's velocities at the start.

Needs the runtime's Python package `rigidformer`.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from ..bound import Record
from ..clouds import DENSITY_KG_M3, FRICTION, RATE_HZ, RESTITUTION, owners, surface_of, volume_m3
from ..movi import write_text

EVERY = 3  # captures from one prediction to the next
STEP_S, STEPS, AHEAD_S = 0.04, 10, (0.2, 0.4)
ROWS = ("tracker", "both", "motion", "shape", "neither", "physics")


def moved(pose, by):
    """Poses (..., 7) followed by others in their frames."""
    turn = Rotation.from_quat(np.asarray(pose)[..., [4, 5, 6, 3]])
    after = turn * Rotation.from_quat(np.asarray(by)[..., [4, 5, 6, 3]])
    return np.concatenate((turn.apply(np.asarray(by)[..., :3]) + np.asarray(pose)[..., :3], after.as_quat(scalar_first=True)), -1)


def inverse(pose):
    turn = Rotation.from_quat(np.asarray(pose)[..., [4, 5, 6, 3]]).inv()
    return np.concatenate((-turn.apply(np.asarray(pose)[..., :3]), turn.as_quat(scalar_first=True)), -1)


def at_other_centre(velocity, way):
    """The same motion about a centre that is `way` off."""
    return np.concatenate((velocity[:3] + np.cross(velocity[3:], way), velocity[3:]))


class Scored:
    """A scene whose predictions are scored."""

    def __init__(self, rf, model, scene, network):
        self.rf, self.model, self.scene, self.network = rf, model, scene, network
        self.points = [np.asarray(unit.points, np.float64) for unit in scene.units]
        self.surfaces = [surface_of(points, []) for points in self.points]
        self.radii = np.array([np.linalg.norm(points, axis=1).max() for points in self.points])
        self.poses = np.asarray(scene.poses, np.float64)
        guessed = [rf.Unit(p, DENSITY_KG_M3 * volume_m3(p), FRICTION, RESTITUTION, role=self.role(u)) for p, u in zip(self.points, scene.units)]
        self.guessed = guessed
        world = self.world(guessed, self.poses[0], None, False)
        self.offsets = Rotation.from_quat(self.poses[0][:, [4, 5, 6, 3]]).inv().apply(np.asarray(world.centres()) - self.poses[0][:, :3])
        self.record = Record(scene, self.offsets, self.radii)

    def role(self, unit):
        return "free" if unit.role == "driven" else unit.role

    def world(self, units, poses, velocities, recorded):
        world = self.rf.World(self.model, units=len(units), points=sum(max(len(unit.points), 8) for unit in units) + 4096)
        world.network = self.network
        if self.scene.planes is not None:
            guess = [self.rf.Plane(p.normal, p.offset_m, FRICTION, RESTITUTION) for p in self.scene.planes]
            world.planes = list(self.scene.planes) if recorded else guess
        world.gravity_m_s2 = self.scene.gravity_m_s2
        if recorded:
            world.contact_law = self.scene.contact_law
        poses = np.asarray(poses, np.float32)
        world.observe_poses(STEP_S, units, poses, poses)
        if velocities is not None:
            free = np.array([unit.role == "free" for unit in units])
            world.set_velocities(np.where(free[:, None], velocities, 0).astype(np.float32))
        return world

    def rolled(self, units, poses, velocities, recorded=False):
        """Poses (steps, units, 7)."""
        world, path = self.world(units, poses, velocities, recorded), []
        for _ in range(STEPS):
            world.step()
            path.append(np.asarray(world.poses(), np.float64))
        return np.array(path)

    def errors(self, tracker, estimate, frame):
        """{(row, seconds ahead): errors of the units that are tracked, metres}."""
        rf, now = self.rf, self.poses[frame]
        forecast = tracker.predict(STEP_S * STEPS)
        tracks = [t for t in estimate.units if t.id in forecast.poses]
        shapes = [np.asarray(tracker.shape(t.id), np.float64) for t in tracks]
        starts = [np.asarray(t.pose, np.float64) for t in tracks]
        carried = [Rotation.from_quat(p[[4, 5, 6, 3]]).apply(s) + p[:3] for s, p in zip(shapes, starts)]
        of = {unit: k for k, unit in enumerate(owners(carried, self.surfaces, self.radii, now)) if unit is not None}
        if not of:
            return {}
        # The tracker's frame in the body's, so that the start has no error.
        frames = {unit: moved(inverse(now[unit]), starts[k]) for unit, k in of.items()}
        own = list(self.guessed)
        for unit, k in of.items():
            own[unit] = rf.Unit(shapes[k], tracker.mass_kg(tracks[k].id), FRICTION, RESTITUTION, role=own[unit].role)
        placed = now.copy()
        for unit, k in of.items():
            placed[unit] = starts[k]
        there = np.asarray(self.world(own, placed, None, False).centres())
        here = self.record.centre[frame]
        true = self.record.velocity[frame]
        true_there = np.array([at_other_centre(v, t - h) for v, t, h in zip(true, there, here)])
        seen_there, seen = true_there.copy(), true.copy()
        for unit, k in of.items():
            seen_there[unit] = np.asarray(tracks[k].velocity, np.float64)
            seen[unit] = at_other_centre(seen_there[unit], here[unit] - there[unit])
        paths = {
            "both": self.rolled(own, placed, seen_there),
            "shape": self.rolled(own, placed, true_there),
            "motion": self.rolled(self.guessed, now, seen),
            "neither": self.rolled(self.guessed, now, true),
            "physics": self.rolled(list(self.scene.units), now, true, True),
        }
        found = {}
        for ahead in AHEAD_S:
            later, step = frame + round(ahead * self.scene.frame_rate_hz), round(ahead / STEP_S) - 1
            if later >= len(self.poses):
                continue
            for row in ROWS:
                for unit, k in of.items():
                    pose = np.asarray(forecast.poses[tracks[k].id], np.float64)[step] if row == "tracker" else paths[row][step, unit]
                    if row in ("tracker", "both", "shape"):
                        pose = moved(pose, inverse(frames[unit]))
                    found.setdefault((row, ahead), []).append(float(np.linalg.norm(pose[:3] - self.poses[later, unit, :3])))
            speed = [float(np.linalg.norm(seen[unit, :3] - true[unit, :3])) for unit in of]
            spin = [float(np.linalg.norm(seen[unit, 3:] - true[unit, 3:])) for unit in of]
            found.setdefault(("speed", ahead), []).extend(speed)
            found.setdefault(("spin", ahead), []).extend(spin)
        return found


def ahead(path, model, cameras, noise, splits, limit):
    """{"network": ..., "row": ..., "ahead_s": ..., "rms": ..., "median": ..., "count": ...} of a scene file."""
    import rigidformer as rf

    dataset, loaded = rf.Dataset(path), rf.Model(model)
    chosen = [index for split in splits for index in dataset.scenes_of(split)[:limit]]
    if not chosen:
        raise SystemExit(f"{path}: no scene is in the splits {', '.join(splits)}; choose others with --splits")
    rows = []
    bar = tqdm(total=2 * len(chosen), disable=not sys.stderr.isatty(), unit="scene")
    for network in (True, False):
        found: dict = {}
        for index in chosen:
            scene = dataset.scene(index)
            scored = Scored(rf, loaded, scene, network)
            tracker = rf.Tracker(loaded, network=network, gravity_m_s2=scene.gravity_m_s2)
            for capture in range(int((scene.frames - 1) / scene.frame_rate_hz * RATE_HZ) + 1):
                frame = round(capture / RATE_HZ * scene.frame_rate_hz)
                time_s = frame / scene.frame_rate_hz
                estimate = tracker.observe(time_s, scene.views(time_s, cameras=cameras, deviation_m=noise, capture=capture))
                if capture % EVERY == 0:
                    for key, errors in scored.errors(tracker, estimate, frame).items():
                        found.setdefault(key, []).extend(errors)
            bar.update()
        for (row, ahead_s), errors in found.items():
            rows.append({"network": network, "row": row, "ahead_s": ahead_s, "rms": float(np.sqrt(np.mean(np.square(errors)))),
                         "median": float(np.median(errors)), "count": len(errors)})  # fmt: skip
    return rows


def main(arguments=None):
    parser = argparse.ArgumentParser(prog="python -m rigidformer_lab.research.ahead", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)  # fmt: skip
    parser.add_argument("data", type=Path, help="scene file of free rigid units that are the hulls of their points")
    parser.add_argument("--model", type=Path, required=True, help="packed model")
    parser.add_argument("--cameras", type=int, default=2, help="default %(default)s")
    parser.add_argument("--noise", type=float, default=0.001, help="metres (default %(default)s)")
    parser.add_argument("--splits", nargs="+", default=["validation", "extra"], choices=("train", "validation", "extra"), help="never the test scenes")
    parser.add_argument("--limit", type=int, help="scenes of a split, at most")
    parser.add_argument("--json", type=Path, metavar="FILE", help="file that the rows go to as well")
    options = parser.parse_args(arguments)
    rows = ahead(options.data, options.model, options.cameras, options.noise, options.splits, options.limit)
    for row in sorted(rows, key=lambda row: (row["ahead_s"], not row["network"])):
        print(f"{row['ahead_s']:.1f} s  {'network' if row['network'] else 'alone':<8} {row['row']:<11} rms {row['rms']:.4f}  median {row['median']:.4f}  ({row['count']})")
    if options.json:
        write_text(options.json, json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
