"""First impacts of units under free motion, between the convex hulls of their points (docs/MODEL.md, section 3).

The twin of `impacts` and `geometry::separation` in the Rust core.
"""

from __future__ import annotations

import numba
import numpy as np
import torch

from .geometry import _octahedron
from .ground import coming_motion, groups, level_ground

TOUCH_M = 1e-3
ADVANCES = 8
ITERATIONS = 24
TOLERANCE = 1e-3
OVERLAP_M = 1e-5
SAME_M = 1e-6
CANDIDATES = 4
#: Of an impact with a plane p: GROUND - p.
GROUND = -2
_LATTICE = _octahedron(8)[0]


def extreme_points(local):
    """Rows of `local` that are farthest in one of 258 directions."""
    dots = local.astype(np.float32) @ _LATTICE.T
    return np.unique(dots.argmax(0))


#: A hull that holds a sphere of this part of its radius counts as a ball.
BALL = 0.975


def is_ball(local) -> bool:
    """Whether points about their centre are those of a ball: in each of the 258 directions one is nearly as far as any."""
    points = local.astype(np.float32)
    reach = (points @ _LATTICE.T).max(0) / np.linalg.norm(_LATTICE, axis=1)
    return bool(reach.min() >= BALL * np.linalg.norm(points, axis=1).max())


@numba.njit(cache=True, inline="always")
def _cayley(b, f, r, out):
    x, y, z = b[0] * f, b[1] * f, b[2] * f
    k = 2.0 / (1.0 + x * x + y * y + z * z)
    for col in range(3):
        a0, a1, a2 = r[0, col], r[1, col], r[2, col]
        c0 = y * a2 - z * a1
        c1 = z * a0 - x * a2
        c2 = x * a1 - y * a0
        d0 = y * c2 - z * c1
        d1 = z * c0 - x * c2
        d2 = x * c1 - y * c0
        out[0, col] = a0 + k * (c0 + d0)
        out[1, col] = a1 + k * (c1 + d1)
        out[2, col] = a2 + k * (c2 + d2)


@numba.njit(cache=True, inline="always")
def _support(bank, start, count, scale, r, c, d, sign, out):
    lx = sign * (r[0, 0] * d[0] + r[1, 0] * d[1] + r[2, 0] * d[2])
    ly = sign * (r[0, 1] * d[0] + r[1, 1] * d[1] + r[2, 1] * d[2])
    lz = sign * (r[0, 2] * d[0] + r[1, 2] * d[1] + r[2, 2] * d[2])
    best = -1e30
    index = start
    for k in range(start, start + count):
        v = bank[k, 0] * lx + bank[k, 1] * ly + bank[k, 2] * lz
        if v > best:
            best = v
            index = k
    px, py, pz = bank[index, 0] * scale, bank[index, 1] * scale, bank[index, 2] * scale
    for a in range(3):
        out[a] = r[a, 0] * px + r[a, 1] * py + r[a, 2] * pz + c[a]
    return index


@numba.njit(cache=True)
def _triangle(a, b, c, w):
    """Barycentric weights of the origin's closest point on a triangle."""
    ab, ac = b - a, c - a
    d1, d2 = -np.dot(ab, a), -np.dot(ac, a)
    if d1 <= 0 and d2 <= 0:
        w[0], w[1], w[2] = 1, 0, 0
        return
    d3, d4 = -np.dot(ab, b), -np.dot(ac, b)
    if d3 >= 0 and d4 <= d3:
        w[0], w[1], w[2] = 0, 1, 0
        return
    vc = d1 * d4 - d3 * d2
    if vc <= 0 and d1 >= 0 and d3 <= 0:
        t = d1 / (d1 - d3) if d1 - d3 > 0 else 0.0
        w[0], w[1], w[2] = 1 - t, t, 0
        return
    d5, d6 = -np.dot(ab, c), -np.dot(ac, c)
    if d6 >= 0 and d5 <= d6:
        w[0], w[1], w[2] = 0, 0, 1
        return
    vb = d5 * d2 - d1 * d6
    if vb <= 0 and d2 >= 0 and d6 <= 0:
        t = d2 / (d2 - d6) if d2 - d6 > 0 else 0.0
        w[0], w[1], w[2] = 1 - t, 0, t
        return
    va = d3 * d6 - d5 * d4
    if va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        s = (d4 - d3) + (d5 - d6)
        t = (d4 - d3) / s if s > 0 else 0.0
        w[0], w[1], w[2] = 0, 1 - t, t
        return
    s = va + vb + vc
    if s == 0:
        w[0], w[1], w[2] = 1, 0, 0
        return
    w[0], w[1], w[2] = va / s, vb / s, vc / s


@numba.njit(cache=True)
def _closest(y, n, w, best):
    """Weights `best` (4) of the simplex y (n, 3) closest to the origin; True: it is inside."""
    best[:] = 0
    if n == 1:
        best[0] = 1
        return False
    if n == 2:
        ab = y[1] - y[0]
        d = np.dot(ab, ab)
        t = -np.dot(ab, y[0]) / d if d > 0 else 0.0
        t = min(max(t, 0.0), 1.0)
        best[0], best[1] = 1 - t, t
        return False
    if n == 3:
        _triangle(y[0], y[1], y[2], w)
        best[0], best[1], best[2] = w[0], w[1], w[2]
        return False
    low = 1e30
    inside = True
    for skip in range(4):
        i0, i1, i2 = (skip + 1) % 4, (skip + 2) % 4, (skip + 3) % 4
        a, b, c = y[i0], y[i1], y[i2]
        nrm = np.cross(b - a, c - a)
        side = np.dot(nrm, y[skip] - a)
        mine = -np.dot(nrm, a)
        if side * mine > 0:
            continue
        inside = False
        _triangle(a, b, c, w)
        p = w[0] * a + w[1] * b + w[2] * c
        d = np.dot(p, p)
        if d < low:
            low = d
            best[:] = 0
            best[i0], best[i1], best[i2] = w[0], w[1], w[2]
    return inside


@numba.njit(cache=True)
def _gjk(bank, si, ni, ki, ri, ci, sj, nj, kj, rj, cj, v, p, q, tolerance):
    """Distance between two hulls; v: the direction to begin with, then from j's closest point to i's; p, q: the closest points. 0: overlap."""
    y = np.zeros((4, 3))
    a = np.zeros((4, 3))
    b = np.zeros((4, 3))
    w = np.zeros(3)
    bary = np.zeros(4)
    ti = np.zeros(3)
    tj = np.zeros(3)
    n = 0
    for it in range(ITERATIONS):
        _support(bank, si, ni, ki, ri, ci, v, -1.0, ti)
        _support(bank, sj, nj, kj, rj, cj, v, 1.0, tj)
        s = ti - tj
        vv = np.dot(v, v)
        if n > 0:
            if vv - np.dot(v, s) <= tolerance * vv:
                break
            same = False
            for k in range(n):
                if np.abs(y[k] - s).max() < SAME_M:
                    same = True
            if same:
                break
        y[n], a[n], b[n] = s, ti, tj
        n += 1
        if _closest(y, n, w, bary):
            return 0.0
        m = 0
        for k in range(n):
            if bary[k] > 0:
                y[m], a[m], b[m], bary[m] = y[k], a[k], b[k], bary[k]
                m += 1
        n = m
        v[:] = 0
        p[:] = 0
        q[:] = 0
        for k in range(n):
            v += bary[k] * y[k]
            p += bary[k] * a[k]
            q += bary[k] * b[k]
        if np.dot(v, v) < OVERLAP_M * OVERLAP_M:
            return 0.0
        if n == 4:
            return 0.0
    return np.sqrt(np.dot(v, v))


@numba.njit(cache=True)
def _insert(rows, used, score, after):
    """Slot for an impact, the most urgent ones stay; -1: none."""
    if used < rows:
        return used
    worst = 0
    for k in range(1, rows):
        if score[k] > score[worst]:
            worst = k
    return worst if after < score[worst] else -1


@numba.njit(parallel=True, cache=True)
def _impacts(
    rot, cen, turns, travels, free, group, mask, radius, start, count, scale, bank, planes, planes_valid, fall, rows,
    other, xi, xj, normal, frac, gap,
):  # fmt: skip
    batch, units = mask.shape
    for b in numba.prange(batch):
        spin = np.zeros((units, 3))
        for i in range(units):
            qm = turns[b, i]
            d = 1.0 + qm[0, 0] + qm[1, 1] + qm[2, 2]
            d = max(d, 0.1)
            spin[i, 0] = (qm[2, 1] - qm[1, 2]) / d
            spin[i, 1] = (qm[0, 2] - qm[2, 0]) / d
            spin[i, 2] = (qm[1, 0] - qm[0, 1]) / d
        ri = np.zeros((3, 3))
        rj = np.zeros((3, 3))
        v = np.zeros(3)
        p = np.zeros(3)
        q = np.zeros(3)
        zero = np.zeros(3)
        nrm = np.zeros(3)
        down = np.zeros(3)
        near = np.zeros(CANDIDATES, np.int64)
        room = np.zeros(CANDIDATES)
        score = np.zeros(rows)
        for i in range(units):
            if not (mask[b, i] and free[b, i]):
                continue
            used = 0
            ti = travels[b, i]
            bi = spin[i]
            own_turn = 2 * np.sqrt(np.dot(bi, bi)) * radius[b, i]
            # Planes: the point farthest along -normal when it touches.
            for plane in range(planes.shape[1]):
                if not planes_valid[b, plane]:
                    continue
                up = planes[b, plane, :3]
                for k in range(3):
                    down[k] = -up[k]
                height = np.dot(up, cen[b, i]) - planes[b, plane, 3]
                along, drop = np.dot(up, ti), np.dot(up, fall[b])
                sink = along + drop
                if not height - radius[b, i] + min(sink, 0.0) * 1.05 < 0.03:
                    continue
                f = 0.0
                room_left = 0.0
                for k in range(ADVANCES):
                    _cayley(bi, f, rot[b, i], ri)
                    _support(bank, start[b, i], count[b, i], scale[b, i], ri, zero, down, 1.0, p)
                    room_left = ((height + f * along) + f * drop) + np.dot(up, p)
                    close = own_turn - sink
                    if room_left < TOUCH_M or close <= 1e-9 or f >= 1 or k + 1 == ADVANCES:
                        break
                    f = min(f + room_left / close, 1.0)
                a = -(sink + 2 * np.dot(up, np.cross(bi, p)))
                after = room_left - a * (1 - f)
                slot = _insert(rows, used, score, after)
                if slot < 0:
                    continue
                used = max(used, slot + 1)
                score[slot] = after
                other[b, i, slot] = GROUND - plane
                frac[b, i, slot] = f
                gap[b, i, slot] = room_left
                for k in range(3):
                    normal[b, i, slot, k] = down[k]
                    xi[b, i, slot, k] = ri[0, k] * p[0] + ri[1, k] * p[1] + ri[2, k] * p[2]
                    xj[b, i, slot, k] = 0.0
            # The nearest bounding spheres, the room left after the step counted.
            found = 0
            for j in range(units):
                if group[b, j] == group[b, i] or not mask[b, j]:
                    continue
                dc = cen[b, i] - cen[b, j]
                rel = ti - travels[b, j]
                left = np.sqrt(np.dot(dc, dc)) - radius[b, i] - radius[b, j] - (np.sqrt(np.dot(rel, rel)) * 1.05 + 0.03)
                if left >= 0:
                    continue
                slot = found
                if found == CANDIDATES:
                    slot = 0
                    for k in range(1, CANDIDATES):
                        if room[k] > room[slot]:
                            slot = k
                    if left >= room[slot]:
                        continue
                else:
                    found += 1
                near[slot] = j
                room[slot] = left
            for c in range(found):
                j = near[c]
                tj = travels[b, j]
                rel = ti - tj
                dc = cen[b, i] - cen[b, j]
                bj = spin[j]
                turn = own_turn + 2 * np.sqrt(np.dot(bj, bj)) * radius[b, j]
                f = 0.0
                end = 1.0
                have = False
                distance = 0.0
                li, lj = np.zeros(3), np.zeros(3)
                overlapped = False
                stale = True
                for attempt in range(2):
                    if attempt == 1:
                        f, end, overlapped = -1.0, 0.0, True
                    for k in range(ADVANCES):
                        _cayley(bi, f, rot[b, i], ri)
                        _cayley(bj, f, rot[b, j], rj)
                        ci = cen[b, i] + f * ti
                        cj = cen[b, j] + f * tj
                        if not have:
                            v[:] = ci - cj
                        d = _gjk(bank, start[b, i], count[b, i], scale[b, i], ri, ci, start[b, j], count[b, j], scale[b, j], rj, cj, v, p, q, TOLERANCE)
                        stale = d <= 0
                        if d <= 0:
                            break
                        distance = d
                        have = True
                        li, lj = p - ci, q - cj
                        for a in range(3):
                            nrm[a] = -v[a] / d  # from i to j
                        if d < TOUCH_M:
                            break
                        close = np.dot(rel, nrm) + turn
                        if close <= 1e-9 or f >= end or k + 1 == ADVANCES:
                            break
                        f = min(f + (d - 0.5 * TOUCH_M) / close, end)
                    if have:
                        break
                if not have:
                    d = np.sqrt(np.dot(dc, dc))
                    for a in range(3):
                        nrm[a] = -dc[a] / max(d, 1e-6)
                if overlapped or stale:
                    if overlapped:
                        f = 0.0
                    _cayley(bi, f, rot[b, i], ri)
                    _cayley(bj, f, rot[b, j], rj)
                    ci = cen[b, i] + f * ti
                    cj = cen[b, j] + f * tj
                    _support(bank, start[b, i], count[b, i], scale[b, i], ri, ci, nrm, 1.0, p)
                    _support(bank, start[b, j], count[b, j], scale[b, j], rj, cj, nrm, -1.0, q)
                    distance = np.dot(q - p, nrm)
                    if not have:
                        li, lj = p - ci, q - cj
                a = np.dot(rel + 2 * np.cross(bi, li) - 2 * np.cross(bj, lj), nrm)
                after = distance - a * (1 - f)
                slot = _insert(rows, used, score, after)
                if slot < 0:
                    continue
                used = max(used, slot + 1)
                score[slot] = after
                other[b, i, slot] = j
                frac[b, i, slot] = f
                gap[b, i, slot] = distance
                for k in range(3):
                    normal[b, i, slot, k] = nrm[k]
                    xi[b, i, slot, k] = ri[0, k] * li[0] + ri[1, k] * li[1] + ri[2, k] * li[2]
                    xj[b, i, slot, k] = rj[0, k] * lj[0] + rj[1, k] * lj[1] + rj[2, k] * lj[2]


@numba.njit(parallel=True, cache=True)
def _depths(rot, height, up, mask, radius, start, count, scale, bank, out):
    for b in numba.prange(len(mask)):
        p = np.zeros(3)
        zero = np.zeros(3)
        for i in range(mask.shape[1]):
            if mask[b, i] and height[b, i] < radius[b, i]:
                _support(bank, start[b, i], count[b, i], scale[b, i], rot[b, i], zero, up[b], -1.0, p)
                out[b, i] = max(-(height[b, i] + np.dot(up[b], p)), 0.0)


def depths(rotation, height, normal, mask, radius, start, count, scale, bank):
    """How deep the lowest point of each unit's hull is below a plane (B, M), metres, 0 above it. height (B, M): of the
    units' centres above the plane; normal (B, 3)."""
    n = lambda t: np.ascontiguousarray(t.detach().cpu().numpy())  # noqa: E731
    wide = lambda t: n(t).astype(np.float64)  # noqa: E731
    out = np.zeros(mask.shape)
    _depths(wide(rotation), wide(height), wide(normal), n(mask), wide(radius), n(start), n(count), wide(scale), wide(bank),
            out)  # fmt: skip
    return torch.from_numpy(out).to(device=height.device, dtype=height.dtype)


def find_impacts(state, mask, radius, start, count, scale, bank, fall, rows, motion=None, planes=None, group=None):
    """For each free unit its `rows` most urgent impacts: other unit (B, M, K) (-1: none, GROUND - p: plane p), the
    witness points in both units' frames (B, M, K, 3), the normal towards the other, the fraction of the step at which
    they are taken, the gap then. fall (B, 3): what gravity adds to a step's travel, metres; motion: of the coming step,
    None: as the last one for all; planes None: z = 0; group (B, M) as in `nearest_points`."""
    motion = motion or coming_motion(state, None, fall)
    planes = planes or level_ground(0.0, 0.0, len(mask), state.centre)
    group = groups(None, mask) if group is None else group
    n = lambda t: np.ascontiguousarray(t.detach().cpu().numpy())  # noqa: E731
    wide = lambda t: n(t).astype(np.float64)  # noqa: E731
    b, m = mask.shape
    other = np.full((b, m, rows), -1, np.int64)
    xi, xj, normal = (np.zeros((b, m, rows, 3)) for _ in range(3))
    frac, gap = (np.zeros((b, m, rows)) for _ in range(2))
    turns = wide(motion.to_rotation) @ np.swapaxes(wide(motion.from_rotation), -1, -2)
    travels = wide(motion.to_centre) - wide(motion.from_centre)
    travels = np.where(n(motion.free)[..., None], travels, travels - wide(fall)[:, None])
    rows_of_planes = np.concatenate((wide(planes.normal), wide(planes.offset)[..., None]), -1)
    _impacts(
        wide(state.rotation), wide(state.centre), turns, travels, n(motion.free), n(group), n(mask), wide(radius),
        n(start), n(count), wide(scale), wide(bank), rows_of_planes, n(planes.valid), wide(fall), rows, other, xi, xj,
        normal, frac, gap,
    )  # fmt: skip
    put = lambda a: torch.from_numpy(a).to(device=state.centre.device, dtype=state.centre.dtype)  # noqa: E731
    return torch.from_numpy(other).to(state.centre.device), put(xi), put(xj), put(normal), put(frac), put(gap)
