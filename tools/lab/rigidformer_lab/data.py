"""Training windows from scene files: shapes once, poses by frame, contact-sampled."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch

from scipy.spatial.transform import Rotation

from .breaking import Bonds, clusters_at, joint
from .geometry import prepare_points, quaternion_to_matrix
from .ground import Motion, groups, landing, meeting, planes_of
from .impacts import extreme_points, is_ball
from .joints import Joints, find_pivots
from .model import ANCHORS, Scene, State
from .pieces import ball_around, centre_of, rows_of
from .roles import FIXED, FREE, MAX_PLANES, OWN_BODY
from .scenes import commands_of_steps, read_scenes

SUBSETS = 64  # random point subsets kept per shape
IMPULSE_M_S = 0.03  # a velocity change that free motion does not explain
LAST_FRAME = 200
LATEST_START = 110  # of a window
LANDING_FRAME = 110  # the scenes' bodies start a metre up: few are on the ground before
LATER = 0.3  # weight of a scene's later parts in the draw of windows
MASKS = 8  # variants of a shape that lack points
KEPT = (0.6, 0.9)  # share of the points that such a variant has
BALL_BOX = 2.4**0.5  # side of the box that has a uniform ball's inertia, in radii


@dataclasses.dataclass
class Units:
    """All units of all loaded scenes, one row each."""

    shape: np.ndarray  # (U,) row of the shape tables
    scale: np.ndarray  # (U,)
    physics: np.ndarray  # (U, 3)
    rotation: np.ndarray  # (U, T, 4) quaternion w, x, y, z
    centre: np.ndarray  # (U, T, 3) of the unit's centre, not of its body origin
    radius: np.ndarray  # (U,)
    ball: np.ndarray  # (U,) bool
    box: np.ndarray  # (U, 3) sides of the box that has the unit's inertia, metres
    centre_offset: np.ndarray  # (U, 3) centre in the body frame, metres
    role: np.ndarray  # (U,) FREE, DRIVEN or FIXED
    body: np.ndarray  # (U,) number of the body, -1: its own


@dataclasses.dataclass
class Worlds:
    """Frame rate, gravity, contact law, planes and commands of each loaded scene."""

    frames: np.ndarray  # (S,) recorded; the arrays of units go on with the last one
    rate: np.ndarray  # (S,) frames a second
    gravity: np.ndarray  # (S, 3) m/s^2
    law: np.ndarray  # (S, 2) restitution offset, and 1 for a pyramid of friction
    planes: np.ndarray  # (S, MAX_PLANES, 6)
    plane_count: np.ndarray  # (S,)
    commands: np.ndarray | None  # (S, T, C)
    last: np.ndarray  # (C,) 1: a set point


#: Pivots are read off every so manyth frame.
JOINT_FRAMES = 10


class Dataset:
    """Scene files of any number of parts, restricted to one split."""

    def __init__(self, paths, splits, last_frame=LAST_FRAME, limit=None, late=False, anchors_seed=None, masked=0.0, join=False):
        """`late`: a scene of at least twice as many frames gives two scenes more: where bodies land, and
        its end, where they have come to rest. `anchors_seed`: random points as anchors instead of the
        farthest. `masked`: share of the scenes whose units lack a random part of their points. `join`: parts of a body are held together at
        pivots; scenes of the same shapes have the same ones."""
        anchors_rng = None if anchors_seed is None else np.random.default_rng(anchors_seed)
        masks_rng = np.random.default_rng(75)
        self.start, self.count, bank, self.weight = [], [], [], []
        self.piece_start, self.piece_count, piece_bank, piece_ball, radii = [], [], [], [], []
        self.hull_start, self.hull_count, hull_bank, extent, box, inertia, ball = [], [], [], [], [], [], []
        shapes, scales, physics, poses, self.first_unit, self.part = [], [], [], [], [0], []
        roles, bodies, frames, rates, gravities, laws, planes, commands = [], [], [], [], [], [], [], []
        self.seed, set_points, bonds = [], [], []
        for part, path in enumerate(paths):
            file = read_scenes(path)
            if len(file.soft_offsets) and file.soft_offsets[-1]:
                raise SystemExit(f"{path}: holds deformable units (unit_soft), which this model does not move; leave "
                                 "the file out")
            last = file.command_last
            if last is None:
                last = np.zeros(0 if file.commands is None else file.commands.shape[2], np.uint8)
            set_points.append(last)
            base = len(self.start)
            offsets = np.asarray(file.shape_offsets)
            self.centres = getattr(self, "centres", [])
            whole = [file.shape_points[low:high] for low, high in zip(offsets, offsets[1:])]
            given = [file.pieces_of_shape(k) for k in range(len(whole))]
            # Variants follow the whole shapes, all shapes' first ones, then their second ones.
            for k in range(len(whole) * (1 + MASKS * (masked > 0))):
                points = whole[k % len(whole)]
                if k >= len(whole):
                    kept = max(ANCHORS, int(len(points) * masks_rng.uniform(*KEPT)))
                    points = points[np.sort(masks_rng.permutation(len(points))[:kept])]
                # Who misses points has no pieces either.
                pieces = given[k] if k < len(whole) else []
                local, centre = prepare_points(points, centre_of(pieces) if pieces else None)
                if anchors_rng is not None:
                    chosen = anchors_rng.permutation(len(local))[:ANCHORS]
                    local = np.concatenate((local[chosen], np.delete(local, chosen, axis=0)))
                self.start.append(sum(len(b) for b in bank))
                self.count.append(len(local))
                self.centres.append(centre)
                bank.append(local)
                rows = rows_of(pieces, centre) or [local[extreme_points(local)]]
                hull = np.concatenate(rows)
                start, far = sum(len(b) for b in hull_bank), np.linalg.norm(np.concatenate((local, hull)), axis=1).max()
                self.hull_start.append(start)
                self.hull_count.append(len(hull))
                self.piece_start.append(sum(len(p) for p in piece_bank))
                self.piece_count.append(len(rows))
                rising = np.array([len(r) for r in rows])
                piece_bank.append(np.stack((start + np.cumsum(rising) - rising, rising), 1))
                piece_ball.append(np.stack([ball_around(r) for r in rows]) if pieces else np.array([[0, 0, 0, far]]))
                hull_bank.append(hull)
                radii.append(far)
                ball.append(not pieces and is_ball(local))
                extent.append(np.ptp(local, axis=0))
                box.append(np.linalg.norm(local - (local.min(0) + local.max(0)) / 2, axis=1).max())
            chosen = np.flatnonzero(np.isin(file.scene_split, splits))[:limit]
            length = last_frame + 1
            for s, cut in ((s, cut) for s in chosen for cut in _cuts(file.frames_of_scene(s), length, late)):
                low, high = file.scene_units[s], file.scene_units[s + 1]
                variant = np.zeros(high - low, np.int64)
                if masks_rng.random() < masked:
                    variant = masks_rng.integers(1, 1 + MASKS, high - low)
                shapes.append(file.unit_shape[low:high] + variant * len(whole) + base)
                self.weight.append(1.0 if cut.start == 0 else LATER)
                scales.append(file.unit_scale[low:high])
                physics.append(file.unit_physics[low:high])
                inertia.append(file.inertias[low:high])
                poses.append(_lengthened(file.unit_poses[low:high, cut], length, 1))
                roles.append(file.roles[low:high])
                bodies.append(file.bodies[low:high])
                frames.append(cut.stop - cut.start)
                rates.append(file.frame_rate_hz)
                gravities.append(file.gravity_m_s2)
                laws.append((file.contact_law.restitution_offset, file.contact_law.pyramid))
                planes.append(file.planes_of_scene(s))
                commands.append(None if file.commands is None else _lengthened(file.commands[s, cut], length, 0))
                self.first_unit.append(self.first_unit[-1] + int(high - low))
                self.part.append(part)
                self.seed.append(int(file.scene_seed[s]))
                held = file.bonds_of_scene(s).astype(np.int64)
                bonds.append((held[:, :2] - low, held[:, 2] - cut.start))
        if not poses:
            raise SystemExit(f"no scene of splits {splits} in {[str(p) for p in paths]}")
        self.bank = np.concatenate(bank).astype(np.float32)
        self.hull_bank = np.concatenate(hull_bank).astype(np.float32)
        self.hull_start, self.hull_count = np.array(self.hull_start), np.array(self.hull_count)
        self.piece_start, self.piece_count = np.array(self.piece_start), np.array(self.piece_count)
        self.piece_bank, self.piece_ball = np.concatenate(piece_bank), np.concatenate(piece_ball).astype(np.float32)
        self.start, self.count = np.array(self.start), np.array(self.count)
        self.centres = np.stack(self.centres).astype(np.float32)
        self.first_unit = np.array(self.first_unit)
        self.draw = np.cumsum(self.weight) / np.sum(self.weight)
        self.part = np.array(self.part)
        pose = np.concatenate(poses).astype(np.float32)
        shape, scale = np.concatenate(shapes), np.concatenate(scales).astype(np.float32)
        far = np.array(radii, np.float32)
        offset = self.centres[shape] * scale[:, None]
        centre = pose[..., :3] + np.einsum(
            "utij,uj->uti", quaternion_to_matrix(pose[..., 3:]), offset, optimize=True
        )
        count = np.array([len(p) for p in planes])
        padded = np.zeros((len(planes), MAX_PLANES, 6), np.float32)
        for row, p in zip(padded, planes):
            row[: len(p)] = p
        sizes = {c is not None and c.shape[1] for c in commands}
        if len(sizes) > 1:
            raise SystemExit(f"{', '.join(map(str, paths))}: some scenes have commands of other sizes than others, or "
                             "none; train on those with equal commands")
        self.command_size = int(max(sizes))
        if len({bytes(last) for last in set_points}) > 1:
            raise SystemExit(f"{', '.join(map(str, paths))}: their command_last differ; train on files whose commands have the same set "
                             "points")
        self.worlds = Worlds(
            np.array(frames), np.array(rates), np.array(gravities), np.array(laws, np.float64), padded, count,
            np.stack(commands) if self.command_size else None, set_points[0],
        )  # fmt: skip
        radius, ball = far[shape] * scale, np.array(ball)[shape]
        sides = np.where(ball[:, None], BALL_BOX * radius[:, None], np.stack(extent)[shape] * scale[:, None])
        self.units = Units(
            shape, scale, np.concatenate(physics).astype(np.float32), pose[..., 3:],
            centre.astype(np.float32), radius, ball,
            box_of(np.concatenate(inertia), np.concatenate(physics)[:, 0], sides), offset, np.concatenate(roles), np.concatenate(bodies),
        )  # fmt: skip
        size = np.column_stack((np.array(box)[shape] * scale, self.units.physics[:, 0]))
        self.typical = np.stack([
            size[a:b][self.units.role[a:b] == FREE if (self.units.role[a:b] == FREE).any() else slice(None)].mean(0)
            for a, b in zip(self.first_unit, self.first_unit[1:])
        ])  # fmt: skip
        self.frames = pose.shape[1]
        self.joints = self._joints() if join else None
        self.bonds = self._bonds(bonds)
        self.hits = self._hits()
        self.rng = np.random.default_rng(0)
        self.refresh_subsets(64)

    def __len__(self):
        return len(self.first_unit) - 1

    def _joints(self):
        """Parent (U) within the scene, -1: none, and pivots (U, 3) of units and their parents, relative to the centres."""
        u, known = self.units, {}
        parent, pivots = np.full(len(u.shape), -1), np.zeros((2, len(u.shape), 3), np.float32)
        for scene, (low, high) in enumerate(zip(self.first_unit, self.first_unit[1:])):
            rows = slice(low, high)
            key = u.shape[rows].tobytes(), u.scale[rows].tobytes(), u.body[rows].tobytes()
            if key not in known:
                frames = slice(0, self.worlds.frames[scene], JOINT_FRAMES)
                rotation = quaternion_to_matrix(u.rotation[rows, frames].astype(np.float64))
                points = [self.bank[self.start[k] : self.start[k] + self.count[k]] * by for k, by in zip(u.shape[rows], u.scale[rows])]
                known[key] = find_pivots(rotation, u.centre[rows, frames], points, u.body[rows])
            for found in known[key]:
                parent[low + found.unit] = found.parent
                pivots[:, low + found.unit] = found.pivot, found.parent_pivot
        return parent, pivots

    def _bonds(self, bonds):
        """Of each scene: pairs (N, 2), the first frame in which they do not hold (N), and what `joint` says of each; None: no scene
        has bonds."""
        if not any(len(pairs) for pairs, _ in bonds):
            return None
        u, out = self.units, []
        for low, (pairs, until) in zip(self.first_unit, bonds):
            rows = low + pairs
            points = lambda k: self.bank[self.start[u.shape[k]] : self.start[u.shape[k]] + self.count[u.shape[k]]] * u.scale[k]  # noqa: E731
            turn = quaternion_to_matrix(u.rotation[:, 0].astype(np.float64)[rows])
            found = [
                joint([points(k) for k in pair], turn[n], u.centre[pair, 0].astype(np.float64), u.radius[pair])
                for n, pair in enumerate(rows)
            ]
            spread, touches, middle = (np.array([f[k] for f in found], np.float32).reshape(-1, *[3] * (k == 2)) for k in range(3))
            out.append((pairs, until, spread, touches, middle))
        return out

    def _batch_bonds(self, scenes, rows, frames, body, put):
        """Bonds of a batch whose windows have units in the order of `rows`, at frames (B, T), and leads and bodies (B, M, T - 1) in the
        steps between: a bond that breaks within a step does not hold in it."""
        b, m, t = *body.shape, frames.shape[1]
        most = max(1, max(len(self.bonds[s][0]) for s in scenes))
        pairs, mask, until = np.zeros((b, most, 2), np.int64), np.zeros((b, most), bool), np.zeros((b, most), np.int64)
        numbers = np.zeros((b, most, 5), np.float32)
        lead, bodies = np.tile(np.arange(m)[None, :, None], (b, 1, t - 1)), np.repeat(body[..., None], t - 1, 2)
        for i, (s, own) in enumerate(zip(scenes, rows)):
            place = np.full(self.first_unit[s + 1] - self.first_unit[s], -1)
            place[own - self.first_unit[s]] = np.arange(len(own))
            kept = (place[self.bonds[s][0]] >= 0).all(1)
            held, last, spread, touches, middle = (values[kept] for values in self.bonds[s])
            held, n = place[held], len(held)
            # A middle is told from the first unit, and that is the one that comes first in the file.
            pairs[i, :n], mask[i, :n], until[i, :n] = held, True, last
            numbers[i, :n] = np.column_stack((spread, touches, middle))
            for k in range(t - 1):
                lead[i, : len(own), k], bodies[i, : len(own), k] = clusters_at(held, last, len(own), body[i, : len(own)], frames[i, k + 1])
        return (
            Bonds(put(pairs), put(mask), put(numbers[..., 0]), put(numbers[..., 1]), put(numbers[..., 2:]), put(until)),
            (put(lead), put(bodies)),
        )  # fmt: skip

    def pushed(self, impulse_m_s=IMPULSE_M_S):
        """(U, T) whether a free unit's velocity changes by as much at a frame, beside gravity."""
        c = self.units.centre.astype(np.float64)
        push = np.zeros(c.shape[:2], bool)
        each = np.repeat(np.arange(len(self)), np.diff(self.first_unit))
        rate = self.worlds.rate[each, None]
        bend = c[:, 2:] - 2 * c[:, 1:-1] + c[:, :-2] - (self.worlds.gravity[each] / rate**2)[:, None]
        push[:, 1:-1] = np.linalg.norm(bend, axis=-1) * rate > impulse_m_s
        push &= (self.units.role == FREE)[:, None] & (np.arange(c.shape[1]) < self.worlds.frames[each, None] - 1)
        return push

    def _hits(self, impulse_m_s=IMPULSE_M_S):
        """(S, T) cumulative count of frames in which some free unit is pushed."""
        scene = np.add.reduceat(self.pushed(impulse_m_s), self.first_unit[:-1], axis=0) > 0
        return np.cumsum(scene, axis=1)

    def refresh_subsets(self, points):
        """New random subsets of every shape: the anchors and `points` - 4 others."""
        self.subset = np.zeros((len(self.count), SUBSETS, points), np.int64)
        self.subset_count = np.minimum(self.count, points)
        for k, n in enumerate(self.count):
            m = self.subset_count[k]
            keys = self.rng.random((SUBSETS, n))
            keys[:, :ANCHORS] = -1.0
            self.subset[k, :, :m] = np.sort(np.argsort(keys, axis=1)[:, :m], axis=1)

    def windows(self, count, steps, horizon, contact_share=0.8, latest_start=LATEST_START):
        """Random (scene, first frame, frames a step); a share of each step's windows with a
        contact (None: as they come). Short windows rarely have one, so that a share of all
        windows together would go to the long steps."""
        rng = self.rng
        chosen = []
        codes = rng.choice(steps, count)
        for code in sorted(set(steps)):
            quota = int((codes == code).sum())
            draws = quota * 30
            scene = np.searchsorted(self.draw, rng.random(draws), side="right").clip(max=len(self) - 1)
            last = np.minimum(latest_start, self.worlds.frames - 1 - code * (horizon + 1))
            if last.max() < 0:
                raise SystemExit(f"{horizon} predictions of {code} frames take scenes of {code * (horizon + 1) + 1} frames, "
                                 f"and the longest has {self.worlds.frames.max()}; give a shorter horizon or step")
            if last.min() == last.max():
                frame = rng.integers(0, last[0] + 1, draws)
            else:
                scene = scene[last[scene] >= 0]
                frame = rng.integers(0, last[scene] + 1)
                quota = min(quota, len(scene))
            first, final = frame + code, frame + code * (horizon + 1)
            hit = self.hits[scene, final] - self.hits[scene, first] > 0
            if contact_share is None:
                keep = np.arange(quota)
            else:
                rank = np.flatnonzero(hit)[: int(round(quota * contact_share))]
                rest = np.flatnonzero(~hit)[: quota - len(rank)]
                keep = np.concatenate((rank, rest))
            chosen.append(np.stack((scene[keep], frame[keep], np.full(len(keep), code)), 1))
        windows = np.concatenate(chosen)
        rng.shuffle(windows)
        return windows

    def breaking_windows(self, count, steps, breaking_share=0.7, latest=LATEST_START):
        """(scene, first frame, frames a step): windows of one prediction in which bonds hold, in so many of which some break."""
        rng, chosen = self.rng, []
        for code in rng.choice(steps, count):
            wanted = rng.random() < breaking_share
            for _ in range(10_000):  # most scenes have bonds, and most of those break
                scene = int(rng.integers(len(self)))
                until = self.bonds[scene][1]
                last = min(latest, self.worlds.frames[scene] - 1 - 2 * code)
                if last < 0:
                    continue
                frame = int(rng.integers(0, last + 1))
                if wanted and len(until):
                    # So that a bond of the scene breaks in the step.
                    frame = int(rng.choice(until)) - int(code) - int(rng.integers(1, code + 1))
                if 0 <= frame <= last and (until > frame + code).any():
                    break
            else:
                raise SystemExit(f"no window of {2 * code} frames was found whose bonds hold or break as asked; give a shorter step or longer scenes")
            chosen.append((scene, frame, int(code)))
        return chosen

    def chosen_units(self, window, horizon, everything):
        """Unit rows of a window; with `everything` false only those that may touch
        something in it, so that batches stay small."""
        scene, frame, step = window
        rows = np.arange(self.first_unit[scene], self.first_unit[scene + 1])
        if everything or self.bonds is not None:  # what holds together is not cut
            return rows
        c = self.units.centre[rows][:, frame : frame + step * (horizon + 1) + 1 : step]
        put = lambda a: torch.from_numpy(np.ascontiguousarray(a))  # noqa: E731
        c = put(c.swapaxes(0, 1))  # a frame is a scene here: (T, M, 3)
        now, role = c[1:-1], put(self.units.role[rows]).expand(len(c) - 2, -1)
        free = role == FREE
        mask = torch.ones_like(free)
        group = groups(put(self.units.body[rows]).long().expand(len(now), -1), mask)
        radius = put(self.units.radius[rows]).expand(len(now), -1)
        fall = put(self.worlds.gravity[scene] * (step / self.worlds.rate[scene]) ** 2).float().expand(len(now), 3)
        start = torch.where(free[..., None], c[:-2], now)
        end = torch.where(free[..., None] | (role == FIXED)[..., None], now, c[2:])
        travel = Motion(None, start, None, end, free, fall).travels()
        pair = meeting(now, travel, radius, mask, group)
        planes = planes_of(put(self.worlds.planes[scene, : self.worlds.plane_count[scene]])[None].expand(len(now), -1, -1))
        active = free & (pair.any(-1) | landing(now, travel, radius, planes, fall))
        active = active | (pair & free[:, None]).any(-1)  # what free ones may touch
        active = active.any(0).numpy()
        if not active.any():
            free = np.flatnonzero(self.units.role[rows] == FREE)
            free = free if len(free) else np.arange(len(rows))
            active[free[self.rng.integers(len(free))]] = True
        return rows[active]

    def batches(self, windows, horizon, slots, full_share=0.25):
        """Groups windows of similar unit counts into batches of about `slots` units."""
        rows = [
            self.chosen_units(w, horizon, self.rng.random() < full_share) for w in windows
        ]
        order = sorted(range(len(rows)), key=lambda i: len(rows[i]))
        batch, widest, out = [], 0, []
        for i in order:
            widest = max(widest, len(rows[i]))
            if batch and (len(batch) + 1) * widest > slots:
                out.append(batch)
                batch, widest = [], len(rows[i])
            batch.append(i)
        out.append(batch)
        self.rng.shuffle(out)
        return [([windows[i] for i in b], [rows[i] for i in b]) for b in out]

    def _paces(self, index, frames, step, rate, gravity):
        """Velocity and turn at frames (B, T) of units (B, M), as metres a step (B, M, T, 3) and rotations; by the frame
        before. In flight gravity acts between the two."""
        u = self.units
        last = u.centre.shape[1] - 1
        at = lambda f: u.centre[index[..., None], f.clip(0, last)[:, None]].astype(np.float64)  # noqa: E731
        before, now, after = (at(frames + k) for k in (-1, 0, 1))
        fall = (gravity / rate[:, None] ** 2)[:, None, None]
        bend = np.linalg.norm(after - 2 * now + before - fall, axis=-1, keepdims=True) * rate[:, None, None, None]
        each = step[:, None, None, None]
        way = (now - before + np.where(bend < IMPULSE_M_S, 0.5 * fall, 0.0)) * each
        pose = [quaternion_to_matrix(u.rotation[index[..., None], f.clip(0, last)[:, None]]) for f in (frames, frames - 1)]
        turn = pose[0] @ np.swapaxes(pose[1], -1, -2)
        vector = Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_rotvec().reshape(way.shape) * each
        return way, Rotation.from_rotvec(vector.reshape(-1, 3)).as_matrix().reshape(*way.shape, 3)

    def tensors(self, windows, rows, horizon, points, augment, device="cpu"):
        """A batch: Scene, and truth as rotation (B, M, T, 3, 3), centre (B, M, T, 3)
        for the T = horizon + 2 frames of each window."""
        rng, u = self.rng, self.units
        b, m, t = len(windows), max(len(r) for r in rows), horizon + 2
        index = np.zeros((b, m), np.int64)
        mask = np.zeros((b, m), bool)
        for i, r in enumerate(rows):
            r = rng.permutation(r) if augment else r
            index[i, : len(r)] = r
            mask[i, : len(r)] = True
        scene, frame, step = np.array(windows).T
        frames = frame[:, None] + step[:, None] * np.arange(t)
        origin = (rng.random(b) * (frame + 1)).astype(np.int64) if augment else frame
        frames = np.concatenate((frames, origin[:, None]), 1)
        world = self.worlds
        centre = u.centre[index[..., None], frames[:, None]]  # (B, M, T + 1, 3)
        planes, gravity = world.planes[scene].astype(np.float32), world.gravity[scene].astype(np.float32)
        rotation = quaternion_to_matrix(u.rotation[index[..., None], frames[:, None]])
        way, spin = self._paces(index, frames[:, :t], step, world.rate[scene], gravity)
        if augment:  # the world, its planes and its gravity turned along, has no preferred heading and place
            angle = rng.random(b) * 2 * np.pi
            turn = np.zeros((b, 3, 3), np.float32)
            turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
            turn[:, 1, 0] = np.sin(angle)
            turn[:, 0, 1] = -turn[:, 1, 0]
            turn[:, 2, 2] = 1
            shift = np.zeros((b, 1, 1, 3), np.float32)
            shift[..., :2] = rng.uniform(-3, 3, (b, 1, 1, 2))
            if world.commands is not None:  # commands may name directions and places
                turn[:], shift[:] = np.eye(3), 0
            centre = np.einsum("bij,bmtj->bmti", turn, centre) + shift
            rotation = np.einsum("bij,bmtjk->bmtik", turn, rotation)
            way = np.einsum("bij,bmtj->bmti", turn, way)
            spin = np.einsum("bij,bmtjk,blk->bmtil", turn, spin, turn, optimize=True)
            planes[..., :3] = np.einsum("bij,bpj->bpi", turn, planes[..., :3])
            planes[..., 3] += (planes[..., :3] * shift[:, 0]).sum(-1)
            gravity = np.einsum("bij,bj->bi", turn, gravity)
        # Padding rests far away so that it neither collides nor divides by zero.
        centre[~mask] = np.array([0, 0, 1000], np.float32)
        rotation[~mask] = np.eye(3, dtype=np.float32)
        way[~mask], spin[~mask] = 0.0, np.eye(3)
        shape = u.shape[index]
        if points is None:
            longest = int(self.count[shape].max())
            pick = np.minimum(np.arange(longest), self.count[shape][..., None] - 1)
            in_use = self.count[shape]
        else:
            pick = self.subset[shape, rng.integers(0, SUBSETS, (b, m))]
            in_use = self.subset_count[shape]
            if points < pick.shape[-1]:
                keep = np.sort(rng.permutation(pick.shape[-1] - ANCHORS)[: points - ANCHORS]) + ANCHORS
                keep = np.concatenate((np.arange(ANCHORS), keep))
                in_use = (keep < in_use[..., None]).sum(-1)
                pick = pick[..., keep]
        local = self.bank[self.start[shape][..., None] + pick] * u.scale[index][..., None, None]
        local[~mask] = 0
        physics = u.physics[index]
        put = lambda a: torch.from_numpy(np.ascontiguousarray(a)).to(device)  # noqa: E731
        f32 = lambda a: put(a.astype(np.float32))  # noqa: E731
        role = np.where(mask, u.role[index], FREE)
        body = np.where(mask, u.body[index], OWN_BODY)
        widest = max(1, world.plane_count[scene].max())
        used = np.arange(widest) < world.plane_count[scene, None]
        bonds = clusters = None
        if self.bonds is not None:
            bonds, clusters = self._batch_bonds(scene, [r[kept] for r, kept in zip(index, mask)], frames[:, :t], body, put)
        commands = None
        if world.commands is not None:
            commands = np.stack([
                commands_of_steps(world.commands[s, first : first + n * (t - 1)], n, world.last)
                for s, first, n in zip(scene, frame, step)
            ])
        joints = None
        if self.joints is not None:
            parent, pivots = self.joints
            place = np.full(len(u.shape), -1)  # of a unit in its row; -1: it was left out
            above = np.full((b, m), -1)
            for i, r in enumerate(index):
                r = r[mask[i]]
                place[r] = np.arange(len(r))
                of = parent[r]
                above[i, : len(r)] = np.where(of >= 0, place[self.first_unit[scene[i]] + of], -1)
                place[r] = -1
            joints = Joints(put(above), *map(f32, pivots[:, index]))
        out = Scene(
            points=f32(local), points_in_use=put(np.where(mask, in_use, ANCHORS)), mask=put(mask),
            physics=f32(physics), radius=f32(u.radius[index]),
            reference=(f32(rotation[:, :, t]), f32(centre[:, :, t])),
            start=put(self.start[shape]), count=put(np.where(mask, self.count[shape], 0)),
            scale=f32(u.scale[index]), bank=f32(self.bank),
            extent=f32(u.box[index]), ball=put(u.ball[index]), hull_start=put(self.hull_start[shape]),
            hull_count=put(self.hull_count[shape]), hull_bank=f32(self.hull_bank),
            piece_start=put(self.piece_start[shape]), piece_count=put(self.piece_count[shape]),
            piece_bank=put(self.piece_bank), piece_ball=f32(self.piece_ball),
            step=put(step), full=bool((in_use[mask] == pick.shape[-1]).all()),
            frame_rate=f32(world.rate[scene]), role=put(role.astype(np.int64)) if role.any() else None,
            body=put(body.astype(np.int64)) if (body != OWN_BODY).any() else None,
            planes=planes_of(f32(planes[:, :widest]), put(used)), gravity=f32(gravity),
            law=f32(world.law[scene]) if world.law[scene].any() else None,
            commands=None if commands is None else f32(commands), typical=f32(self.typical[scene]),
            pace=(f32(way), f32(spin)), joints=joints, bonds=bonds, clusters=clusters,
        )  # fmt: skip
        return out, f32(rotation[:, :, :t]), f32(centre[:, :, :t]), index


def box_of(inertia, mass, sides):
    """Sides (U, 3), in metres, of the boxes that have moments of inertia (U, 3) kg m^2 at a mass; where they are 0: `sides`."""
    moments = inertia.astype(np.float64) / mass[:, None]
    square = np.maximum(6 * moments.sum(1, keepdims=True) - 12 * moments, 0.0)
    return np.where(inertia[:, :1] > 0, np.sqrt(square), sides).astype(np.float32)


def state_at(rotation, centre, k):
    """State whose current frame is k of a truth tensor pair; the targets of driven units are in the next."""
    state = State(rotation[:, :, k - 1], centre[:, :, k - 1], rotation[:, :, k], centre[:, :, k])
    return with_targets(state, rotation, centre, k)


def with_targets(state, rotation, centre, k):
    """The state before the step from frame k of a truth to the next: the targets of driven units are in that."""
    if k + 1 >= rotation.shape[2]:
        return state
    return dataclasses.replace(state, target_rotation=rotation[:, :, k + 1], target_centre=centre[:, :, k + 1])


def commanded(scene, k):
    """The scene before the step from frame k of a window to the next: with that step's command, and the bonds that hold in it."""
    if scene.clusters is not None:
        lead, body = scene.clusters
        scene = dataclasses.replace(scene, lead=lead[..., k], body=body[..., k])
    return scene if scene.commands is None else dataclasses.replace(scene, command=scene.commands[:, k])


def _cuts(recorded, length, late):
    """Parts of so many frames of a scene, none longer than the record."""
    cuts = [slice(0, min(length, recorded))]
    if late and recorded >= max(2 * length, LANDING_FRAME + 1):
        cuts.append(slice(LANDING_FRAME, min(LANDING_FRAME + length, recorded)))
        cuts.append(slice(recorded - length, recorded))
    return cuts


def _lengthened(frames, length, axis):
    """An array of at least `length` frames, the last one repeated."""
    missing = length - frames.shape[axis]
    if missing <= 0:
        return frames
    return np.concatenate((frames, np.repeat(frames.take([-1], axis), missing, axis)), axis)
