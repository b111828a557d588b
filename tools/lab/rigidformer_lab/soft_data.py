"""Recorded scenes of soft bodies as a model of them takes them: points of units in farthest-point order, padded and stacked."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch

from .config import ModelConfig
from .geometry import canonical_order, centre_of_mass, farthest_point_order, quaternion_to_matrix
from .impacts import is_ball
from .roles import FREE
from .scenes import read_scenes
from .soft import Obstacles, Web, support, web


@dataclasses.dataclass
class Record:
    """One scene. M units, of which the soft ones have R rows of points in all, one unit after the other; K are rigid."""

    name: str
    soft: np.ndarray  # (M) bool
    count: np.ndarray  # (M) points
    physics: np.ndarray  # (M, 3)
    role: np.ndarray  # (M)
    body: np.ndarray  # (M)
    ln_young: np.ndarray  # (M) 0: rigid
    rest: np.ndarray  # (R, 3) in the frame of the body at rest
    unit: np.ndarray  # (R) unit of a row
    given: np.ndarray  # (R) its number among the scene's soft points as they are in the file
    points: np.ndarray  # (F, R, 3)
    local: list[np.ndarray]  # of rigid units, points about their centres
    centre: np.ndarray  # (K, F, 3)
    rotation: np.ndarray  # (K, F, 3, 3)
    planes: np.ndarray  # (N, 6)
    gravity: np.ndarray  # (3)
    frame_rate: float
    frames: int
    web: Web
    obstacles: Obstacles
    edges: np.ndarray  # (E, 2) rows
    tetrahedra: np.ndarray  # (V, 4) rows

    @property
    def size(self) -> float:
        """Of the soft bodies: the diagonal of the box around their points at rest, metres."""
        return float(np.linalg.norm(np.ptp(self.rest, axis=0)))


def order_of(points: np.ndarray) -> np.ndarray:
    """Rows of points in the order in which models take them."""
    canon = canonical_order(points)
    p = points[canon].astype(np.float32)
    return canon[farthest_point_order(p, centre_of_mass(p))]


def records(config: ModelConfig, paths, splits, limit=None) -> list[Record]:
    """All scenes of some splits."""
    out = []
    for path in paths:
        file = read_scenes(path)
        if file.unit_young is None or file.unit_soft is None:
            raise SystemExit(f"{path}: has no soft units with a Young's modulus (unit_soft, unit_young); give scenes of "
                             "rigidformer_lab.shell or .soft_cube")
        rows_of, soft_file = file.soft_offsets, file.unit_soft > 0
        for s in np.flatnonzero(np.isin(file.scene_split, splits)):
            units = np.array(file.units_of_scene(s))
            soft = soft_file[units]
            rest, unit, taken, local, centre, rotation, count, ball = [], [], [], [], [], [], [], []
            for m, u in enumerate(units):
                points = file.points_of_shape(file.unit_shape[u]) * file.unit_scale[u]
                order = order_of(points)
                count.append(len(order))
                if soft[m]:
                    rest.append(points[order])
                    unit.append(np.full(len(order), m))
                    taken.append(rows_of[u] + order)
                else:
                    canon = points[canonical_order(points)].astype(np.float32)
                    middle = centre_of_mass(canon)
                    own = points[order].astype(np.float32) - middle
                    pose = file.unit_poses[u].astype(np.float64)
                    turn = quaternion_to_matrix(pose[:, 3:])
                    local.append(own)
                    rotation.append(turn)
                    centre.append(pose[:, :3] + turn @ middle)
                    ball.append(is_ball(own))
            rest, unit, taken = np.concatenate(rest).astype(np.float32), np.concatenate(unit), np.concatenate(taken)
            number, place = units[soft], np.full(int(rows_of[-1]), -1)
            place[taken] = np.arange(len(taken))
            physics = file.unit_physics[units].astype(np.float32)
            bodies = np.where(file.bodies[units] < 0, 1 << 20 | np.arange(len(units)), file.bodies[units])
            _, body = np.unique(bodies[unit], return_inverse=True)
            share = physics[unit, 0] / np.array(count)[unit]
            young = file.unit_young[units]
            rigid = np.flatnonzero(~soft)
            reach = np.array([np.linalg.norm(p, axis=1).max() for p in local], np.float32)
            free = file.roles[number[0] if len(number) else units[0]] == FREE
            assert free, "soft units are free"
            obstacles = Obstacles(
                np.where(ball, reach, 0).astype(np.float32).reshape(-1), reach.reshape(-1),
                np.stack([support(p) for p in local]) if local else np.zeros((0, 258), np.float32), physics[rigid, 1],
                np.where(file.roles[units][rigid] == FREE, 1 / physics[rigid, 0], 0).astype(np.float32),
            )  # fmt: skip
            frames = file.frames_of_scene(s)
            out.append(Record(
                f"{file.dataset}-{file.scene_seed[s]}", soft, np.array(count), physics, file.roles[units], body_numbers(bodies),
                np.where(soft, np.log(np.maximum(young, 1e-9)), 0).astype(np.float32), rest, unit,
                taken - taken.min(), file.soft_points[taken].transpose(1, 0, 2)[:frames], local,
                np.stack(centre).astype(np.float32)[:, :frames] if local else np.zeros((0, frames, 3), np.float32),
                np.stack(rotation).astype(np.float32)[:, :frames] if local else np.zeros((0, frames, 3, 3), np.float32),
                file.planes_of_scene(s).astype(np.float32), np.array(file.gravity_m_s2, np.float32), file.frame_rate_hz, frames,
                web(config.elastic, rest, body, share, physics[unit, 1], young[unit]), obstacles,
                place[file.edges_of_scene(s)], place[file.tetrahedra_of_scene(s)],
            ))  # fmt: skip
            if limit and len(out) >= limit:
                return out
    if not out:
        raise SystemExit(f"no scene of splits {list(splits)} in {[str(p) for p in paths]}")
    return out


def body_numbers(bodies: np.ndarray) -> np.ndarray:
    return np.unique(bodies, return_inverse=True)[1]


@dataclasses.dataclass
class Batch:
    """What does not change in a rollout of B scenes, padded to M units of P points."""

    records: list[Record]
    rest: torch.Tensor  # (B, M, P, 3)
    points_in_use: torch.Tensor  # (B, M)
    mask: torch.Tensor  # (B, M)
    soft: torch.Tensor  # (B, M)
    physics: torch.Tensor  # (B, M, 3)
    free: torch.Tensor  # (B, M)
    ln_young: torch.Tensor  # (B, M)
    body: torch.Tensor  # (B, M)
    weights: torch.Tensor | None  # squared distances (B, M P, M A) of points at rest to anchors of their bodies, infinite for others
    radius: torch.Tensor  # (B) mean radius of the soft units at rest
    owner: torch.Tensor  # (B, M P) row of the mass that a row is a copy of
    copies: torch.Tensor  # (B, M P) rows of that mass
    local: list[list[np.ndarray]]  # of rigid units, points as encoded
    slots: list[np.ndarray]  # padded row (m P + k) of each row of a record
    step: torch.Tensor  # (B)
    dt: torch.Tensor  # (B)


def batch_of(records: list[Record], steps, rng: np.random.Generator | None = None, most: int = 64) -> Batch:
    """Pads scenes. rng: rigid units have as many of their points at random, else their first ones."""
    units = max(len(r.soft) for r in records)
    counts = [np.where(r.soft, r.count, np.minimum(r.count, most)) for r in records]
    points = max(int(c.max()) for c in counts)
    shape = (len(records), units)
    rest = np.zeros((*shape, points, 3), np.float32)
    used, mask, soft, free = (np.zeros(shape, t) for t in (np.int64, bool, bool, bool))
    physics, ln_young, body = np.ones((*shape, 3), np.float32), np.zeros(shape, np.float32), np.full(shape, -1)
    apart = np.full((len(records), units * points, units * 4), np.inf, np.float32)
    owner = np.tile(np.arange(units * points), (len(records), 1))
    copies = np.ones(owner.shape, np.float32)
    radius, local, slots = np.zeros(len(records), np.float32), [], []
    for b, r in enumerate(records):
        n = len(r.soft)
        used[b, :n], mask[b, :n], soft[b, :n], physics[b, :n] = counts[b], True, r.soft, r.physics
        free[b, :n], ln_young[b, :n], body[b, :n] = r.role == FREE, r.ln_young, r.body
        start = np.searchsorted(r.unit, np.arange(n))
        slot = r.unit * points + np.arange(len(r.unit)) - start[r.unit]
        slots.append(slot)
        rest[b].reshape(-1, 3)[slot] = r.rest
        radii = []
        for m in np.flatnonzero(r.soft):
            own = r.rest[r.unit == m]
            radii.append(np.linalg.norm(own - own.mean(0), axis=1).max())
            mates = np.isin(r.unit, np.flatnonzero(r.body == r.body[m]))
            apart[b, slot[mates], 4 * m : 4 * m + 4] = np.square(r.rest[mates][:, None] - own[None, :4]).sum(-1)
        radius[b] = np.mean(radii)
        owner[b, slot] = slot[r.web.owner]
        copies[b, slot] = np.bincount(r.web.owner, minlength=len(slot))[r.web.owner]
        picked = []
        for p, m in zip(r.local, np.flatnonzero(~r.soft)):
            kept = slice(counts[b][m])
            if rng is not None and len(p) > most:
                kept = np.concatenate((np.arange(4), 4 + np.sort(rng.permutation(len(p) - 4)[: most - 4])))
            picked.append(p[kept])
        local.append(picked)
    t = torch.from_numpy
    rate = torch.tensor([r.frame_rate for r in records])
    step = torch.as_tensor(steps).expand(len(records)).float()
    return Batch(records, t(rest), t(used), t(mask), t(soft), t(physics), t(free), t(ln_young), t(body), t(apart), t(radius), t(owner),
                 t(copies), local, slots, step, step / rate)  # fmt: skip


@dataclasses.dataclass
class State:
    """Of each scene: points of soft units (R, 3) and where they were a step before, centres of rigid ones (K, 3) likewise, and the
    frame that rotations are of."""

    points: list[np.ndarray]
    before: list[np.ndarray]
    centre: list[np.ndarray]
    centre_before: list[np.ndarray]
    frame: list[int]


def state_at(records: list[Record], frames, step: int) -> State:
    """From the records, at some frame each."""
    rows = list(zip(records, frames))
    return State(
        [r.points[f] for r, f in rows], [r.points[f - step] for r, f in rows], [r.centre[:, f] for r, f in rows],
        [r.centre[:, f - step] for r, f in rows], list(frames),
    )  # fmt: skip


def velocity_at(record: Record, frame: int) -> np.ndarray:
    """(R, 3) m/s, by the frames around one."""
    low, high = max(frame - 1, 0), min(frame + 1, record.frames - 1)
    return (record.points[high] - record.points[low]) * (record.frame_rate / (high - low))
