"""Rolls scenes out by sequential impulses alone (`solver`), without a network: what a motion with contact is worth as the
motion that a network corrects.

    python -m rigidformer_lab.research.impulses_alone movi-a.safetensors --split 1
    python -m rigidformer_lab.research.impulses_alone cube-tosses.safetensors --split 2

Errors are those of HopNet's protocol at frames 50 and 100, from the frames 0 and s. Files with velocities, such as those
of `tosses`, go on from their first frame, and the errors are means over frames, then over scenes. `rest` is how far
units move in 480 frames that lay still in the last 48 of the record: median, 90 %, 99 % and the most.

    python -m rigidformer_lab.research.impulses_alone fragments-test.safetensors --split 2 --steps 1 5 --bonds recorded

Of files with bonds, such as those of `fragments`, `--bonds` says when they break: `recorded` in the step after that in which the record
has them broken first, `early` in that step, `kept` never, `loose` at once. Errors are then means over cells, at the frames 25, 50 and 100.
"""

from __future__ import annotations

import argparse
import json
import math
import pathlib

import numpy as np
from scipy.spatial.transform import Rotation

from ..bonds import bodies, leads
from ..data import BALL_BOX, box_of
from ..geometry import prepare_points
from ..impacts import extreme_points, is_ball
from ..pieces import ball_around, centre_of, rows_of
from ..roles import DRIVEN, FREE
from ..scenes import SceneFileError, read_scenes
from ..solver import Motion, World, advance, keep_apart, meetings, parts, room

CODE_HZ = 240.0  # a step code is so many parts of a second
FRAMES = (50, 100)
CRUMBLING = (25, 50, 100)
BONDS = ("recorded", "early", "kept", "loose")
STILL_FRAMES, STILL_M, STILL_DEG = 48, 1e-3, 0.5
REST_FRAMES = 480


class Record:
    """A recorded scene as the solver wants it."""

    def __init__(self, file, scene: int, shapes, bank):
        units = file.units_of_scene(scene)
        low, high = units.start, units.stop
        self.frames = file.frames_of_scene(scene)
        poses = file.unit_poses[low:high, : self.frames].astype(np.float64)
        quaternions = poses[..., 3:]
        self.rotation = Rotation.from_quat(quaternions.reshape(-1, 4), scalar_first=True).as_matrix()
        self.rotation = self.rotation.reshape(*quaternions.shape[:2], 3, 3)
        shape, scale = file.unit_shape[low:high], file.unit_scale[low:high].astype(np.float64)
        local = [shapes[k] for k in shape]
        self.offset = np.stack([s["centre"] for s in local]) * scale[:, None]
        self.centre = poses[..., :3] + np.einsum("utij,uj->uti", self.rotation, self.offset)
        mass, friction, restitution = file.unit_physics[low:high].astype(np.float64).T
        self.free = file.roles[low:high] == FREE
        self.driven = file.roles[low:high] == DRIVEN
        body = file.bodies[low:high].astype(np.int64)
        sides = np.stack([s["extent"] for s in local]) * scale[:, None]
        radius, ball = np.array([s["radius"] for s in local]) * scale, np.array([s["ball"] for s in local])
        square = box_of(file.inertias[low:high], mass, np.where(ball[:, None], BALL_BOX * radius[:, None], sides)).astype(np.float64) ** 2
        pieces = np.array([len(s["piece"]) for s in local])
        self.rate = float(file.frame_rate_hz)
        self.world = World(
            self.free, np.where(body < 0, -1 - np.arange(len(body)), body), np.where(self.free, 1 / mass, 0.0),
            np.maximum(mass[:, None] * (square.sum(1, keepdims=True) - square) / 12, 1e-12), friction, restitution,
            radius, np.array([s["start"] for s in local]), np.array([s["count"] for s in local]), scale, bank,
            np.cumsum(pieces) - pieces, pieces, np.concatenate([s["piece"] for s in local]),
            np.concatenate([s["around"] for s in local]), np.where(ball, radius, 0.0),
            np.ascontiguousarray(file.planes_of_scene(scene), np.float64), np.array(file.gravity_m_s2, np.float64),
            np.arange(len(body)), np.array([file.contact_law.restitution_offset, file.contact_law.pyramid], np.float64),
        )  # fmt: skip
        bonds = file.bonds_of_scene(scene).astype(np.int64)
        self.bonds, self.breaks = bonds[:, :2] - low, bonds[:, 2]
        self.given = None if file.unit_velocity is None else file.unit_velocity[low:high].astype(np.float64)

    def between(self, a: int, b: int):
        """Mean velocity and spin of all units from one frame to another."""
        dt = (b - a) / self.rate
        turn = self.rotation[:, b] @ np.swapaxes(self.rotation[:, a], -1, -2)
        return (self.centre[:, b] - self.centre[:, a]) / dt, Rotation.from_matrix(turn).as_rotvec() / dt

    def start(self, frame: int, step: int, falling: bool) -> Motion:
        """Motion at a frame, from the one `step` before it. falling: free units have been in the air."""
        velocity, spin = self.between(frame - step, frame)
        if falling:
            velocity[self.free] += self.world.gravity * (0.5 * step / self.rate)
        return Motion(self.rotation[:, frame].copy(), self.centre[:, frame].copy(), velocity, spin)

    def thrown(self) -> Motion:
        """Motion at frame 0, as the file gives it."""
        arm = np.einsum("uij,uj->ui", self.rotation[:, 0], self.offset)
        spin = self.given[:, 3:].copy()
        velocity = self.given[:, :3] + np.cross(spin, arm)
        return Motion(self.rotation[:, 0].copy(), self.centre[:, 0].copy(), velocity, spin)

    def holding(self, at: float, ahead: float, bonds: str | None):
        """The pairs that hold together in a step of so many frames."""
        if bonds is None or bonds == "loose":
            return self.bonds[:0]
        until = at + ahead if bonds == "early" else at
        return self.bonds[(self.breaks > until + 1e-6) | (bonds == "kept")]

    def roll(self, motion: Motion, frame: int, last: int, dt: float, bonds: str | None = None):
        """(time in frames, rotations, centres) from a frame on, until `last` is passed; `motion` is moved. Driven units
        go where the record has them, while there is one. bonds: as in BONDS; None: there are none, and units of one body do
        not touch."""
        contacts, at, ahead = room(len(self.free)), float(frame), dt * self.rate
        world, whole = self.world, leads(len(self.free), self.bonds)
        yield at, motion.rotation.copy(), motion.centre.copy()
        while at < last - 1e-6:
            until = round(at + ahead)
            if self.driven.any() and until < self.frames and abs(at + ahead - until) < 1e-6:
                velocity, spin = self.between(round(at), until)
                motion.velocity[self.driven], motion.spin[self.driven] = velocity[self.driven], spin[self.driven]
            elif self.driven.any():
                motion.velocity[self.driven] = motion.spin[self.driven] = 0.0
            if bonds is not None:
                lead = leads(len(self.free), self.holding(at, ahead, bonds))
                world = world._replace(group=bodies(world.group, whole, lead), lead=lead)
                whole = lead
            count = advance(world, motion, dt, parts(dt), *contacts)[1]
            keep_apart(world, motion, *meetings(contacts[0], count))
            at += ahead
            yield at, motion.rotation.copy(), motion.centre.copy()

    def errors(self, rotation, centre, frame: int):
        """Position (m) and orientation (degrees) errors of the free units' origins at a recorded frame."""
        origin = centre - np.einsum("uij,uj->ui", rotation, self.offset)
        true = self.centre[:, frame] - np.einsum("uij,uj->ui", self.rotation[:, frame], self.offset)
        away = np.linalg.norm(origin - true, axis=1)
        turn = np.linalg.norm(
            Rotation.from_matrix(rotation @ np.swapaxes(self.rotation[:, frame], -1, -2)).as_rotvec(), axis=1
        )
        return away[self.free], np.degrees(turn)[self.free]


def records(path, split: int, limit: int | None = None):
    """The scenes of a split, one after another."""
    file = read_scenes(path)
    if len(file.soft_offsets) and file.soft_offsets[-1]:
        raise SystemExit(f"{path}: holds soft units (unit_soft), which the solver does not move; leave the file out")
    shapes, hulls, total = [], [], 0
    for k in range(len(file.shape_offsets) - 1):
        pieces = file.pieces_of_shape(k)
        local, centre = prepare_points(file.points_of_shape(k), centre_of(pieces) if pieces else None)
        ball = not pieces and is_ball(local)
        rows = rows_of(pieces, centre) or [np.zeros((1, 3), np.float32) if ball else local[extreme_points(local)]]
        hull = np.concatenate(rows).astype(np.float64)
        radius = float(np.linalg.norm(np.concatenate((local, hull)), axis=1).max())
        count = np.array([len(r) for r in rows])
        around = np.stack([ball_around(r) for r in rows]) if pieces else np.array([[0, 0, 0, radius]])
        shapes.append(dict(centre=centre.astype(np.float64), extent=np.ptp(local, axis=0).astype(np.float64), radius=radius,
                           ball=ball, start=total, count=len(hull), around=around,
                           piece=np.stack((total + np.cumsum(count) - count, count), 1)))  # fmt: skip
        hulls.append(hull)
        total += len(hull)
    bank = np.concatenate(hulls)
    chosen = file.scenes_of_split(split)[:limit]
    if not len(chosen):
        raise SystemExit(f"{path}: has no scene of split {split}; give another --split")
    return [Record(file, int(scene), shapes, bank) for scene in chosen]


def _root_mean_square(values):
    return float(np.sqrt(np.mean(np.square(values))))


def predicted(scenes, step: int):
    """Errors at FRAMES from the frames 0 and step: {frame: (m, degrees)}."""
    found = {frame: [] for frame in FRAMES}
    for scene in scenes:
        if scene.frames <= max(FRAMES):
            raise SystemExit(f"a scene has {scene.frames} frames, and frame {max(FRAMES)} is asked for; give longer ones")
        motion = scene.start(step, step, falling=True)
        for at, rotation, centre in scene.roll(motion, step, max(FRAMES), step / scene.rate):
            if round(at) in found:
                away, turn = scene.errors(rotation, centre, round(at))
                found[round(at)].append((_root_mean_square(away), _root_mean_square(turn)))
    return {frame: tuple(np.mean(rows, axis=0)) for frame, rows in found.items()}


def crumbled(scenes, step: int, bonds: str):
    """Mean errors of cells at CRUMBLING from the frames 0 and step, over scenes: {frame: (m, degrees)}."""
    found = {frame: [] for frame in CRUMBLING}
    for scene in scenes:
        motion = scene.start(step, step, falling=True)
        for at, rotation, centre in scene.roll(motion, step, max(CRUMBLING), step / scene.rate, bonds):
            if round(at) in found:
                away, turn = scene.errors(rotation, centre, round(at))
                found[round(at)].append((away.mean(), turn.mean()))
    return {frame: tuple(np.mean(rows, axis=0)) for frame, rows in found.items() if rows}


def open_loop(scenes, code: float):
    """Mean errors over frames, then over scenes, from the velocities in the file: (m, degrees). Frames between two steps
    are compared with the nearer one's line."""
    rows = []
    for scene in scenes:
        away, turn, before = [], [], None
        for now in scene.roll(scene.thrown(), 0, scene.frames - 1, code / CODE_HZ):
            if before is not None:
                for frame in range(math.floor(before[0]) + 1, min(math.floor(now[0]), scene.frames - 1) + 1):
                    share = (frame - before[0]) / (now[0] - before[0])
                    turned = Rotation.from_matrix(now[1] @ np.swapaxes(before[1], -1, -2)).as_rotvec() * share
                    rotation = Rotation.from_rotvec(turned).as_matrix() @ before[1]
                    a, t = scene.errors(rotation, before[2] + (now[2] - before[2]) * share, frame)
                    away.append(a.mean())
                    turn.append(t.mean())
            before = now
        rows.append((np.mean(away), np.mean(turn)))
    return tuple(np.mean(rows, axis=0))


def resting(scenes, step: int):
    """Metres that units move in REST_FRAMES which lay still at the end of the record: all of them."""
    drifts = []
    for scene in scenes:
        last = scene.frames - 1
        if last < STILL_FRAMES + step:
            continue
        way, turn = scene.between(last - STILL_FRAMES, last)
        seconds = STILL_FRAMES / scene.rate
        still = scene.free & (np.linalg.norm(way, axis=1) * seconds < STILL_M)
        still &= np.degrees(np.linalg.norm(turn, axis=1)) * seconds < STILL_DEG
        if still.any():
            motion = scene.start(last, step, falling=False)
            *_, (_, _, centre) = scene.roll(motion, last, last + REST_FRAMES, step / scene.rate)
            drifts += list(np.linalg.norm(centre - scene.centre[:, last], axis=1)[still])
    return drifts


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=pathlib.Path, nargs="+")
    parser.add_argument("--split", type=int, default=1, help="0 train, 1 validation, 2 test, 3 extra (default 1)")
    parser.add_argument("--steps", type=int, nargs="+", default=[1, 5, 10], help="step codes")
    parser.add_argument("--bonds", choices=BONDS, help="of files with bonds: when they break")
    parser.add_argument("--limit", type=int, help="only the first scenes of a split")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if min(args.steps) < 1:
        parser.error("--steps takes numbers from 1 on")
    out = []
    for path in args.data:
        try:
            scenes = records(path, args.split, args.limit)
        except (SceneFileError, OSError) as error:
            raise SystemExit(str(error)) from None
        for step in args.steps:
            row = {"file": path.name, "step": step, "scenes": len(scenes)}
            if args.bonds:
                for frame, (away, turn) in crumbled(scenes, step, args.bonds).items():
                    row[f"position_m@{frame}"], row[f"rotation_deg@{frame}"] = away, turn
            elif scenes[0].given is not None:
                row["position_m"], row["rotation_deg"] = open_loop(scenes, step)
            else:
                for frame, (away, turn) in predicted(scenes, step).items():
                    row[f"position_m@{frame}"], row[f"rotation_deg@{frame}"] = away, turn
                if drifts := resting(scenes, step):
                    row["at_rest"] = len(drifts)
                    row["rest_m"] = [float(v) for v in np.quantile(drifts, (0.5, 0.9, 0.99, 1.0))]
            out.append(row)
            if not args.json:
                print("  ".join(f"{k} {_short(v)}" for k, v in row.items()), flush=True)
    if args.json:
        print(json.dumps(out, indent=1))


def _short(value):
    if isinstance(value, list):
        return "/".join(_short(v) for v in value)
    return f"{value:.4f}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()
