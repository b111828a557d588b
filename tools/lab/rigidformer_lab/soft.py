"""The elastic motion of soft bodies, which a model of them corrects (docs/MODEL.md, section 6).

The points of a body are masses that springs join, each to its nearest ones at rest. A step is taken in sub-steps, each of which
moves the masses freely, corrects every spring once, one after the other (XPBD: Macklin, Müller, Chentanez 2016), and keeps the
masses out of planes and of units of other bodies, with friction. Points of two units of a body that are in the same place at rest
are one mass.
"""

from __future__ import annotations

import dataclasses
import math

import numba
import numpy as np

from .config import Elastic
from .geometry import _DIRECTIONS

f32 = np.float32

#: Points closer together at rest than this share of the body's spacing are one.
SAME = f32(1e-3)
#: Springs shorter than this many spacings keep their length both ways where strain is limited: longer ones lie across folds.
SHORT = f32(1.2)
#: Directions in which the hull of a rigid unit is felt for, of unit length.
_FELT = (_DIRECTIONS / np.sqrt(np.square(_DIRECTIONS).sum(1, dtype=f32))[:, None]).astype(f32)


@dataclasses.dataclass
class Web:
    """What holds the soft bodies of a scene together."""

    owner: np.ndarray  # (R) of each row of points the first one that is the same mass
    body: np.ndarray  # (R) number of the row's body, from 0
    lightness: np.ndarray  # (R) 1 / kg
    friction: np.ndarray  # (R)
    first: np.ndarray  # (S) springs: two rows, owners
    second: np.ndarray  # (S)
    length: np.ndarray  # (S) metres
    compliance: np.ndarray  # (S) m/N
    spacing: np.ndarray  # (bodies) mean distance of a mass from its nearest one


def web(elastic: Elastic, rest: np.ndarray, body: np.ndarray, unit_mass: np.ndarray, friction: np.ndarray,
        young: np.ndarray) -> Web:
    """rest: (R, 3) all points of soft units; of each row: body, mass of its unit over the unit's rows, friction, Young's modulus."""
    rest = rest.astype(f32)
    rows = len(rest)
    owner, lightness = np.arange(rows), np.zeros(rows, f32)
    springs, spacings = [], []
    for number in range(body.max() + 1):
        own = np.flatnonzero(body == number)
        p = rest[own]
        apart = np.square(p[:, None] - p[None])
        apart = (apart[..., 0] + apart[..., 1]) + apart[..., 2]
        size = apart.max()
        same = apart <= SAME * SAME * (size / f32(len(own)))
        owner[own] = own[same.argmax(1)]
        masses = np.flatnonzero(owner[own] == own)
        lightness[own] = f32(len(masses)) / unit_mass[own].astype(f32).sum(dtype=f32)
        near = apart[np.ix_(masses, masses)]
        np.fill_diagonal(near, np.inf)
        order = np.argsort(near, axis=1, kind="stable")[:, : elastic.neighbours]
        nearest = np.sqrt(near[np.arange(len(masses)), order[:, 0]])
        spacing = np.add.accumulate(nearest, dtype=f32)[-1] / f32(len(masses))
        spacings.append(spacing)
        linked = np.zeros(near.shape, bool)
        linked[np.arange(len(masses))[:, None], order] = True
        a, b = np.nonzero(np.triu(linked | linked.T, 1))
        length = np.sqrt(near[a, b])
        share = spacing / length
        stiffness = young[own][masses[a]].astype(f32) * f32(elastic.stiffness)
        stiffness = stiffness * (f32(elastic.thickness_m) if elastic.thickness_m else spacing)
        for _ in range(elastic.falloff):
            stiffness = stiffness * share
        springs.append((own[masses[a]], own[masses[b]], length, f32(1) / stiffness))
    first, second, length, compliance = (np.concatenate(v) for v in zip(*springs))
    return Web(owner, body, lightness, friction.astype(f32), first, second, length.astype(f32), compliance.astype(f32),
               np.array(spacings, f32))  # fmt: skip


def support(points: np.ndarray) -> np.ndarray:
    """How far local points (n, 3) reach along each felt direction, metres."""
    return (points.astype(f32) @ _FELT.T).max(0)


@dataclasses.dataclass
class Obstacles:
    """Rigid units that soft ones touch. Those that nothing moves have lightness 0."""

    ball: np.ndarray  # (K) radius, 0: by its support
    reach: np.ndarray  # (K) radius around the centre
    support: np.ndarray  # (K, 258)
    friction: np.ndarray  # (K)
    lightness: np.ndarray  # (K) 1 / kg


@numba.njit(cache=True)
def _rub(x, before, i, n0, n1, n2, depth, friction, share):
    """Moves mass i out by its share of the depth, and drags it along the surface."""
    x[i, 0] += n0 * depth * share
    x[i, 1] += n1 * depth * share
    x[i, 2] += n2 * depth * share
    t0, t1, t2 = x[i, 0] - before[0], x[i, 1] - before[1], x[i, 2] - before[2]
    along = t0 * n0 + t1 * n1 + t2 * n2
    t0 -= along * n0
    t1 -= along * n1
    t2 -= along * n2
    size = np.sqrt(t0 * t0 + t1 * t1 + t2 * t2)
    if size > np.float32(1e-9):
        drag = min(friction * depth, size) / size * share
        x[i, 0] -= drag * t0
        x[i, 1] -= drag * t1
        x[i, 2] -= drag * t2


@numba.njit(cache=True)
def _advance(x, v, y, u, turn, way, owner, lightness, friction, first, second, length, compliance, planes, ball, reach,
             felt, supports, their_friction, their_lightness, gravity, steps, h, damping, skin):  # fmt: skip
    """x, v: (R, 3) masses, at their owners; y, u: (K, 3) centres of obstacles and velocities of those that nothing tells where to
    go; turn: (K, 3, 3); way: (K, 3) of those told, a sub-step."""
    rows, obstacles = len(x), len(y)
    before = x.copy()
    y_before = y.copy()
    lag = damping / h
    for _ in range(steps):
        for i in range(rows):
            if owner[i] == i:
                for k in range(3):
                    v[i, k] += gravity[k] * h
                    before[i, k] = x[i, k]
                    x[i, k] += v[i, k] * h
        for j in range(obstacles):
            for k in range(3):
                y_before[j, k] = y[j, k]
                if their_lightness[j] > 0:
                    u[j, k] += gravity[k] * h
                    y[j, k] += u[j, k] * h
                else:
                    y[j, k] += way[j, k]
        for s in range(len(first)):
            i, j = first[s], second[s]
            d0, d1, d2 = x[i, 0] - x[j, 0], x[i, 1] - x[j, 1], x[i, 2] - x[j, 2]
            size = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
            if size < np.float32(1e-9):
                continue
            n0, n1, n2 = d0 / size, d1 / size, d2 / size
            rate = (
                ((x[i, 0] - before[i, 0]) - (x[j, 0] - before[j, 0])) * n0
                + ((x[i, 1] - before[i, 1]) - (x[j, 1] - before[j, 1])) * n1
                + ((x[i, 2] - before[i, 2]) - (x[j, 2] - before[j, 2])) * n2
            )
            soft = (1 + lag) * (lightness[i] + lightness[j]) + compliance[s] / (h * h)
            pull = -((size - length[s]) + lag * rate) / soft
            a, b = pull * lightness[i], pull * lightness[j]
            x[i, 0] += n0 * a
            x[i, 1] += n1 * a
            x[i, 2] += n2 * a
            x[j, 0] -= n0 * b
            x[j, 1] -= n1 * b
            x[j, 2] -= n2 * b
        for i in range(rows):
            if owner[i] != i:
                continue
            for p in range(len(planes)):
                n0, n1, n2 = planes[p, 0], planes[p, 1], planes[p, 2]
                depth = (planes[p, 3] + skin) - (n0 * x[i, 0] + n1 * x[i, 1] + n2 * x[i, 2])
                if depth > 0:
                    _rub(x, before[i], i, n0, n1, n2, depth, friction[i] * planes[p, 4], np.float32(1))
            for j in range(obstacles):
                d0, d1, d2 = x[i, 0] - y[j, 0], x[i, 1] - y[j, 1], x[i, 2] - y[j, 2]
                size = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
                depth = (reach[j] + skin) - size
                if depth <= 0 or size < np.float32(1e-9):
                    continue
                n0, n1, n2 = d0 / size, d1 / size, d2 / size
                if ball[j] == 0:
                    r = turn[j]
                    q0 = r[0, 0] * d0 + r[1, 0] * d1 + r[2, 0] * d2
                    q1 = r[0, 1] * d0 + r[1, 1] * d1 + r[2, 1] * d2
                    q2 = r[0, 2] * d0 + r[1, 2] * d1 + r[2, 2] * d2
                    best = -1
                    for k in range(len(felt)):
                        gap = (supports[j, k] + skin) - (felt[k, 0] * q0 + felt[k, 1] * q1 + felt[k, 2] * q2)
                        if best < 0 or gap < depth:
                            depth, best = gap, k
                        if depth <= 0:
                            break
                    if depth <= 0:
                        continue
                    f = felt[best]
                    n0 = r[0, 0] * f[0] + r[0, 1] * f[1] + r[0, 2] * f[2]
                    n1 = r[1, 0] * f[0] + r[1, 1] * f[1] + r[1, 2] * f[2]
                    n2 = r[2, 0] * f[0] + r[2, 1] * f[1] + r[2, 2] * f[2]
                share = lightness[i] / (lightness[i] + their_lightness[j])
                # Where the mass would be had it stayed on the surface that moves.
                there = before[i] + (y[j] - y_before[j])
                x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
                _rub(x, there, i, n0, n1, n2, depth, friction[i] * their_friction[j], share)
                if their_lightness[j] > 0:
                    back = their_lightness[j] / lightness[i]
                    y[j, 0] -= (x[i, 0] - x0) * back
                    y[j, 1] -= (x[i, 1] - x1) * back
                    y[j, 2] -= (x[i, 2] - x2) * back
        for j in range(obstacles):
            if their_lightness[j] > 0:
                for p in range(len(planes)):
                    n0, n1, n2 = planes[p, 0], planes[p, 1], planes[p, 2]
                    depth = (planes[p, 3] + reach[j]) - (n0 * y[j, 0] + n1 * y[j, 1] + n2 * y[j, 2])
                    if depth > 0:
                        _rub(y, y_before[j], j, n0, n1, n2, depth, their_friction[j] * planes[p, 4], np.float32(1))
                for k in range(3):
                    u[j, k] = (y[j, k] - y_before[j, k]) / h
        for i in range(rows):
            if owner[i] == i:
                for k in range(3):
                    v[i, k] = (x[i, k] - before[i, k]) / h
    for i in range(rows):
        if owner[i] != i:
            for k in range(3):
                x[i, k], v[i, k] = x[owner[i], k], v[owner[i], k]


@numba.njit(cache=True)
def _limit(x, owner, lightness, first, second, length, least, most, sweeps):
    for _ in range(sweeps):
        for s in range(len(first)):
            i, j = first[s], second[s]
            d0, d1, d2 = x[i, 0] - x[j, 0], x[i, 1] - x[j, 1], x[i, 2] - x[j, 2]
            size = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
            if size < np.float32(1e-9):
                continue
            wanted = min(max(size, length[s] * least[s]), length[s] * most)
            pull = (wanted - size) / (lightness[i] + lightness[j])
            n0, n1, n2 = d0 / size, d1 / size, d2 / size
            a, b = pull * lightness[i], pull * lightness[j]
            x[i, 0] += n0 * a
            x[i, 1] += n1 * a
            x[i, 2] += n2 * a
            x[j, 0] -= n0 * b
            x[j, 1] -= n1 * b
            x[j, 2] -= n2 * b
    for i in range(len(x)):
        if owner[i] != i:
            for k in range(3):
                x[i, k] = x[owner[i], k]


def limit(elastic: Elastic, web: Web, x: np.ndarray) -> np.ndarray:
    """Points (R, 3) with no spring longer than the strain limit allows, after so many sweeps at least; short ones not shorter."""
    x = x.astype(f32).copy()
    if elastic.strain_sweeps:
        short = web.length < SHORT * web.spacing[web.body[web.first]]
        least = np.where(short, f32(1) - f32(elastic.strain_limit), f32(0)).astype(f32)
        most = f32(1) + f32(elastic.strain_limit)
        _limit(x, web.owner, web.lightness, web.first, web.second, web.length, least, most, elastic.strain_sweeps)
    return x


def advance(elastic: Elastic, web: Web, obstacles: Obstacles, planes: np.ndarray, gravity: np.ndarray, dt: float, x: np.ndarray,
            before: np.ndarray, start, target):
    """Points (R, 3) after a step of dt seconds and their velocities then, from where they are and where they were a step before
    that. start: (centre (K, 3), centre before (K, 3), rotation (K, 3, 3)) of the obstacles; target: (K, 3) where those go that
    nothing moves. Returns x, v and the centres and velocities of the obstacles."""
    g = gravity.astype(f32)
    steps = max(1, math.ceil(f32(f32(dt) * f32(elastic.rate_hz)) - f32(1e-3)))
    h, half = f32(f32(dt) / f32(steps)), f32(0.5) * f32(dt)
    x, y = x.astype(f32).copy(), start[0].astype(f32).copy()
    v = (x - before.astype(f32)) / f32(dt) + g * half
    u = (y - start[1].astype(f32)) / f32(dt) + g * half
    way = (target.astype(f32) - y) / f32(steps)
    _advance(x, v, y, u, start[2].astype(f32), way, web.owner, web.lightness, web.friction, web.first, web.second, web.length,
             web.compliance, planes.astype(f32), obstacles.ball, obstacles.reach, _FELT, obstacles.support, obstacles.friction,
             obstacles.lightness, g, steps, h, f32(elastic.damping_s), f32(elastic.skin_m))  # fmt: skip
    return x, v, y, u


if __name__ == "__main__":
    raise SystemExit("rigidformer_lab.soft is no command; `python -m rigidformer_lab.soft_cube` makes scenes of a soft cube")
