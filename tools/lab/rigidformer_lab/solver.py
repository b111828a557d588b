"""Rigid motion with contact by sequential impulses: what an engine that knows hulls, masses, frictions and restitutions
would do in a step. docs/CONTACT.md says how, why and how well.

Everything is f64 and in one fixed order; `core/src/contact/solver` is the same in f32. Lengths are compared with the radii of
units, speeds with those that gravity gives, so lengths times 4 and times times 2 is the same motion: but for what f32
cannot tell from rest.

The world of one scene: M units, L planes. A unit is the convex hull of its extreme points, or several such pieces.
"""

from __future__ import annotations

import math
from collections import namedtuple

import numba
import numpy as np

from .impacts import _gjk, _support

PARTS_HZ = 144.0  # a part of a step is at most so many parts of a second
MOST_PARTS = 16
MOST_CUT_PARTS = 32  # where fast approaches cut parts
TICKS = 16  # of a part: it may be cut to so many of them
WAY = 1 / 32  # of a part, at most, of what closes in fast and touches, in radii of the smaller unit
SWEEPS = 18  # over all contacts in a step, of all parts together, but for those that are cut
LEAST_SWEEPS = 4  # of a part
SETTLING = 1  # sweeps after those, from what does not move upwards, each lower unit held
BOUNCING = 8  # sweeps in which contacts bounce
PUSHES = 1  # sweeps that push overlaps apart, of a part
KEEPS = 4  # sweeps that keep units apart at the end of a step
SLACK = 0.0002  # of an overlap that they leave, in radii of the smaller one
SHARE = 0.5  # of an overlap that a whole part pushes away
FACE = 0.03  # points this close to the lowest one belong to its face, in radii
SKIN = 0.002  # units keep this distance, in radii: hulls that do not overlap have an exact normal
BOUNCE = 0.1  # slower approaches do not bounce, in sqrt(gravity x radius); motion this fast counts as a whole one
SLOW = 0.25  # motion slower than this part of that is no network's: it would keep from rest what is about to come to it
LASTING = 1.5  # what contact that lasts changes at most, in gravity x dt: a network's small errors would add up there
#: Nor do approaches that gravity alone gives what lies still, with something to spare: two frames cannot tell that from
#: what has been falling for half a step.
STILL = 1.05
HELD = 0.1  # what moved slower between the two observed frames lay still, in gravity x dt
REST = 0.02  # what touches something held and is slower at both ends of a step rests, in gravity x dt
ROUNDING = 4 * 1.2e-7  # of a coordinate: what falls into that in a step rests too, up to twice the speed
SAME_CONTACT = 0.1  # a contact this close to one of the part before goes on from its impulse, in radii
SAME_WAY = 0.7  # and its normal must be within 45 degrees: at an inner corner two pieces push in two ways at one place
CONTACTS, HEAP_CONTACTS = 12, 24  # room a unit, and in scenes of more than FEW
FEW = 32
STEEP = 10  # metres that a point of a patch counts as nearer for each that it is higher
ASIDE = 1e-6  # points this far aside, in the greatest distance, are aside
CORNERS = 8  # of a face, at most: its outermost points to so many sides
SIDES = np.stack([np.cos((np.arange(CORNERS) + 0.5) * np.pi / 4), np.sin((np.arange(CORNERS) + 0.5) * np.pi / 4)], 1)
THIN = 1e-3  # faces whose area is smaller are edges, in half squares of their length
TOLERANCE = 1e-7  # of squared distances: a coarser one tilts normals by degrees
SLIDES = 1e-3  # slower sliding has no direction, in approaches
SAME = 1e-12  # faces smaller than the root of this have no slope, in radii
LEVELS = 8  # from what does not move, that are told apart
FAR = 1000  # level of what touches nothing that is held
PLANE = -1  # in place of a unit's number
PIECES = 32  # of a unit, at most

#: What does not change in a step. free (M) bool; group (M): units of one body share a number; light (M) 1/kg, 0: nothing
#: moves it; inertia (M, 3) kg m^2 along the unit's axes; friction, restitution, radius (M); start, count, scale (M) and
#: bank (K, 3): hulls as in `impacts`, the pieces of a unit one after the other; first and pieces (M): the rows of
#: piece (P, 2), start and count in the bank, that are a unit's, and of ball (P, 4), middle and radius of a ball around them, at
#: scale 1; round (M): what all points of a unit's
#: surface are beyond its hull, a ball's radius about one point; planes (L, 6) normal, offset, friction, restitution; gravity (3) m/s^2;
#: lead (M): the first unit of the cluster that a unit is in, which moves as one body, or the unit itself where it is alone; law (2): what
#: is added to restitutions, and above 0 that contacts which bounce have a pyramid of friction along their sliding, not a cone.
World = namedtuple(
    "World", "free group light inertia friction restitution radius start count scale bank first pieces piece ball round planes gravity lead law",
    defaults=(np.zeros(2),),
)

#: What does. rotation (M, 3, 3), centre (M, 3), velocity (M, 3) m/s and spin (M, 3) rad/s in the world frame.
Motion = namedtuple("Motion", "rotation centre velocity spin")

#: Contacts of a part of a step, from unit i (or PLANE) to unit j. piece: number of the first one's piece times PIECES and of
#: the second one's; middle: whether it is that of a patch; arms (N, 3) from
#: the centres of the units, or of their clusters; gap and skin, the gap that they keep, m; impulse along the normal and two tangents (N, 3) N s; axes
#: (N, 3, 3): normal from i to j and tangents; weight (N, 3): impulse for a change of velocity along them, kg; held: the
#: unit that is nearer to what does not move, 0: i, 1: j, -1: neither; stiff: weight along the normal with that unit held,
#: in weights; approach m/s before all impulses, negative where they close in; bounces: approaches below this bounce, m/s;
#: twist (N, 3), of the middle of a patch what brakes a spin about the normal: mean arm of the corners m, impulse at that arm N s, weight kg.
Contacts = namedtuple(
    "Contacts", "i j piece middle arm_i arm_j gap skin friction restitution bounces impulse axes weight held stiff approach order twist"
)


def parts(dt: float) -> int:
    """Parts that a step is taken in, at least."""
    return min(max(1, math.ceil(dt * PARTS_HZ - 0.01)), MOST_PARTS)


def in_one_piece(start, count, radius):
    """first, pieces, piece and ball of a world's units, each in one piece; radius: of each at scale 1."""
    units = len(start)
    ball = np.zeros((units, 4))
    ball[:, 3] = radius
    return np.arange(units), np.ones(units, np.int64), np.stack((start, count), 1).astype(np.int64), ball


def _room(units):
    n = (HEAP_CONTACTS if units > FEW else CONTACTS) * units
    whole = lambda: np.zeros(n, np.int64)  # noqa: E731
    one, three = (lambda: np.zeros(n)), (lambda: np.zeros((n, 3)))
    return Contacts(
        whole(), whole(), whole(), np.zeros(n, np.bool_), three(), three(), one(), one(), one(), one(), one(), three(), np.zeros((n, 3, 3)), three(),
        whole(), one(), one(), whole(), three(),
    )  # fmt: skip


@numba.njit(cache=True, nogil=True)
def _cross(a, b):
    out = np.empty(3)
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return out


@numba.njit(cache=True, nogil=True)
def _length(a):
    return np.sqrt(np.dot(a, a))


@numba.njit(cache=True, nogil=True)
def _turn(turn, rotation):
    """Turns a rotation by a vector of radians, in place."""
    angle = _length(turn)
    if angle < 1e-12:
        sine, rest = 1.0, 0.5
    else:
        sine, rest = np.sin(angle) / angle, (1 - np.cos(angle)) / (angle * angle)
    for column in range(3):
        v = rotation[:, column].copy()
        once = _cross(turn, v)
        rotation[:, column] = v + sine * once + rest * _cross(turn, once)


@numba.njit(cache=True, nogil=True)
def _tangents(n):
    seed = np.zeros(3)
    seed[0 if abs(n[0]) < 0.577 else (1 if abs(n[1]) < 0.577 else 2)] = 1.0
    u = _cross(n, seed)
    u /= _length(u)
    return u, _cross(n, u)


@numba.njit(cache=True, nogil=True)
def _distance(w, i, a, ri, ci, j, b, rj, cj, v, p, q):
    """As `impacts._gjk`, to rounding: of two pieces, balls as their middles, from direction v on; 0: they overlap."""
    a, b = w.piece[w.first[i] + a], w.piece[w.first[j] + b]
    return _gjk(w.bank, a[0], a[1], w.scale[i], ri, ci, b[0], b[1], w.scale[j], rj, cj, v, p, q, TOLERANCE)


@numba.njit(cache=True, nogil=True)
def _between(w, s, i, a, j, b, n, p, q):
    """Gap of two pieces along n, negative where they overlap, and their outermost points along it."""
    a, b = w.piece[w.first[i] + a], w.piece[w.first[j] + b]
    _support(w.bank, a[0], a[1], w.scale[i], s.rotation[i], s.centre[i], n, 1.0, p)
    _support(w.bank, b[0], b[1], w.scale[j], s.rotation[j], s.centre[j], n, -1.0, q)
    p += n * w.round[i]
    q -= n * w.round[j]
    return np.dot(q - p, n)


@numba.njit(cache=True, nogil=True)
def _middle(w, s, unit, piece):
    """Middle of the ball around a piece, in the world."""
    return s.rotation[unit] @ (w.ball[w.first[unit] + piece, :3] * w.scale[unit]) + s.centre[unit]


@numba.njit(cache=True, nogil=True)
def _separate(w, s, i, a, j, b, known, n, p, q):
    """Gap of two pieces, the normal n from i to j, and the points p and q there. known: the normal of the part before,
    zeros: none. Pieces that overlap are moved apart along a first guess; the normal there serves if it tells of less."""
    apart = _middle(w, s, j, b) - _middle(w, s, i, a)
    v = -known if np.dot(known, known) > 0 else -apart
    gap = _distance(w, i, a, s.rotation[i], s.centre[i], j, b, s.rotation[j], s.centre[j], v, p, q)
    if gap > 0:
        n[:] = -v / gap
        p += n * w.round[i]
        q -= n * w.round[j]
        return gap - w.round[i] - w.round[j]
    if np.dot(known, known) > 0:
        n[:] = known
    elif np.dot(apart, apart) > 0:
        n[:] = apart / _length(apart)
    else:
        n[0], n[1], n[2] = 0.0, 0.0, 1.0
    small = min(w.radius[i], w.radius[j])
    for _ in range(2):
        gap = _between(w, s, i, a, j, b, n, p, q)
        v[:] = -n
        moved = s.centre[j] + n * (0.02 * small - gap)
        away = _distance(w, i, a, s.rotation[i], s.centre[i], j, b, s.rotation[j], moved, v, p, q)
        if away <= 0:
            break
        better = -v / away
        if _between(w, s, i, a, j, b, better, p, q) > gap:
            n[:] = better
    return _between(w, s, i, a, j, b, n, p, q)


@numba.njit(cache=True, nogil=True)
def _face(w, s, unit, piece, n, sign, u, v, corners, heights):
    """The face of a piece along sign * n: its corners across n, in the plane of u and v, in convex order, and their
    heights along n. How many."""
    start, count = w.piece[w.first[unit] + piece]
    flat = np.empty((count, 3))
    top = -np.inf
    rows = np.empty((3, 4))
    for row, along in enumerate((u, v, n)):
        rows[row, :3] = (along @ s.rotation[unit]) * w.scale[unit]
        rows[row, 3] = np.dot(along, s.centre[unit])
    for k in range(count):
        for row in range(3):
            x = w.bank[start + k]
            flat[k, row] = rows[row, 0] * x[0] + rows[row, 1] * x[1] + rows[row, 2] * x[2] + rows[row, 3]
        top = max(top, sign * flat[k, 2])
    kept = 0
    for k in range(count):
        if sign * flat[k, 2] >= top - FACE * w.radius[unit]:
            flat[kept] = flat[k]
            kept += 1
    # The outermost points to eight sides are in convex order; what has corners only at one side is one point.
    found = last = first = -1
    count = 0
    for side in range(CORNERS):
        x, y = SIDES[side, 0], SIDES[side, 1]
        most = -np.inf
        for k in range(kept):
            reach = x * flat[k, 0] + y * flat[k, 1]
            if reach > most:
                most, found = reach, k
        if found == last or (found == first and side > 0):
            continue
        if side == 0:
            first = found
        last = found
        corners[count, 0], corners[count, 1], heights[count] = flat[found, 0], flat[found, 1], flat[found, 2]
        count += 1
    return _edge(corners, heights, count)


@numba.njit(cache=True, nogil=True)
def _edge(corners, heights, count):
    """How many corners there are: of those that lie on a line, the two that are farthest from each other."""
    area, length, one, other = 0.0, 0.0, 0, 0
    for a in range(count):
        b = (a + 1) % count
        area += corners[a, 0] * corners[b, 1] - corners[a, 1] * corners[b, 0]
        for b in range(a):
            x, y = corners[a, 0] - corners[b, 0], corners[a, 1] - corners[b, 1]
            if x * x + y * y > length:
                length, one, other = x * x + y * y, b, a
    if count < 3 or area > THIN * length:
        return count
    corners[0], heights[0] = corners[one], heights[one]
    corners[1], heights[1] = corners[other], heights[other]
    return 2 if length > 0 else 1


@numba.njit(cache=True, nogil=True)
def _slope(corners, heights, n, radius):
    """height = a + b x + c y over a face's corners, by least squares: (a, b, c)."""
    x, y, z = corners[:n, 0].mean(), corners[:n, 1].mean(), heights[:n].mean()
    xx = xy = yy = xz = yz = 0.0
    for k in range(n):
        dx, dy, dz = corners[k, 0] - x, corners[k, 1] - y, heights[k] - z
        xx, xy, yy, xz, yz = xx + dx * dx, xy + dx * dy, yy + dy * dy, xz + dx * dz, yz + dy * dz
    size, det = xx + yy, xx * yy - xy * xy
    if size < SAME * radius * radius:
        b = c = 0.0
    elif det > 1e-4 * size * size:
        b, c = (xz * yy - yz * xy) / det, (yz * xx - xz * xy) / det
    else:  # an edge: along it alone
        ex, ey = (xx, xy) if xx >= yy else (xy, yy)
        length = np.sqrt(ex * ex + ey * ey)
        ex, ey = ex / length, ey / length
        rise = (xz * ex + yz * ey) / size
        b, c = rise * ex, rise * ey
    return z - b * x - c * y, b, c


@numba.njit(cache=True, nogil=True)
def _clip(corners, n, other, m, out):
    """The part of a polygon or an edge that is within another, convex polygon. How many corners."""
    here, there = np.empty((3 * CORNERS, 2)), np.empty((3 * CORNERS, 2))
    here[:n] = corners[:n]
    count = n
    for edge in range(m):
        ax, ay = other[edge, 0], other[edge, 1]
        ex, ey = other[(edge + 1) % m, 0] - ax, other[(edge + 1) % m, 1] - ay
        kept = 0
        for k in range(count):
            p, q = here[k], here[(k + 1) % count]
            mine = ex * (p[1] - ay) - ey * (p[0] - ax)
            next_ = ex * (q[1] - ay) - ey * (q[0] - ax)
            if mine >= 0 and kept < len(there):
                there[kept] = p
                kept += 1
            back = count == 2 and k == 1  # an edge has no way back
            if mine * next_ < 0 and not back and kept < len(there):
                there[kept] = p + (mine / (mine - next_)) * (q - p)
                kept += 1
        count = kept
        here[:count] = there[:count]
        if count == 0:
            break
    out[:count] = here[:count]
    return count


@numba.njit(cache=True, nogil=True)
def _patch(points, gaps, count, n, chosen):
    """Of points that may touch, at most four, and their middle first where they are more than two: the deepest one, the
    farthest from it across n, and the farthest from both to either side. A point that is higher counts as less far: else
    the bevel of a face would be chosen for the face. The middle carries a weight without turning the unit, so that few
    sweeps suffice. Rows of `points`; the middle becomes row `count`."""
    found = 0
    if count <= 4:
        for k in range(count):
            chosen[k] = k
        found = count
    else:
        deepest = 0
        for k in range(1, count):
            if gaps[k] < gaps[deepest]:
                deepest = k
        far, most = deepest, -np.inf
        for k in range(count):
            d = points[k] - points[deepest]
            reach = _length(d - n * np.dot(d, n)) - STEEP * (gaps[k] - gaps[deepest])
            if reach > most:
                most, far = reach, k
        across = _cross(n, points[far] - points[deepest])
        size = _length(across)
        left, right, high, low = -1, -1, -np.inf, -np.inf
        for k in range(count):
            side = np.dot(across, points[k] - points[deepest])
            rank = abs(side) - STEEP * (gaps[k] - gaps[deepest]) * size
            if side > ASIDE * size * size and rank > high:
                high, left = rank, k
            if side < -ASIDE * size * size and rank > low:
                low, right = rank, k
        chosen[0], chosen[1] = deepest, far
        found = 2
        for k in (left, right):
            if k >= 0:
                chosen[found] = k
                found += 1
    if found > 2:
        points[count] = 0.0
        gaps[count] = 0.0
        for k in range(found - 1, -1, -1):
            points[count] += points[chosen[k]] / found
            gaps[count] += gaps[chosen[k]] / found
            chosen[k + 1] = chosen[k]
        chosen[0] = count
        found += 1
    return found


@numba.njit(cache=True, nogil=True)
def _add(c, count, points, gaps, chosen, found, n):
    """Makes contacts of a patch's points, from `count` on. How many there are then; those without room are left out."""
    u, v = _tangents(n)
    for k in range(found):
        if count == len(c.i):
            break
        c.arm_i[count], c.arm_j[count], c.gap[count] = points[chosen[k]], points[chosen[k]], gaps[chosen[k]]
        c.axes[count, 0], c.axes[count, 1], c.axes[count, 2] = n, u, v
        c.impulse[count] = 0.0
        c.middle[count] = k == 0 and found > 3
        c.twist[count] = 0.0
        if c.middle[count]:
            for corner in range(1, found):
                arm = points[chosen[corner]] - points[chosen[0]]
                c.twist[count, 0] += _length(arm - n * np.dot(arm, n)) / (found - 1)
        count += 1
    return count


@numba.njit(cache=True, nogil=True)
def _bounces(w, radius, dt, h):
    """Approaches below this bounce, m/s, in parts of h seconds of a step of dt."""
    drop = _length(w.gravity)
    return -max(BOUNCE * np.sqrt(drop * radius), STILL * drop * (0.5 * dt + h))


@numba.njit(cache=True, nogil=True)
def _restitution(w, product):
    """What a pair bounces with."""
    return min(product + w.law[0], max(product, 1.0)) if w.law[0] > 0 else product


@numba.njit(cache=True, nogil=True)
def _is_pyramid(w, c, k):
    """Whether the friction of a contact has a pyramid."""
    return w.law[1] > 0 and c.approach[k] < c.bounces[k] and c.restitution[k] > 0


@numba.njit(cache=True, nogil=True)
def _slide(w, s, c, count):
    """Turns the tangents of pyramids along the sliding; the middles of patches keep theirs."""
    for k in range(count):
        seen, n = _relative(w, s, c, k), c.axes[k, 0]
        c.approach[k] = np.dot(seen, n)
        if not _is_pyramid(w, c, k) or c.middle[k]:
            continue
        sliding = seen - n * c.approach[k]
        speed = _length(sliding)
        if speed > SLIDES * -c.approach[k]:
            c.axes[k, 1] = sliding / speed
            c.axes[k, 2] = _cross(n, c.axes[k, 1])


@numba.njit(cache=True, nogil=True)
def _with_planes(w, s, dt, h, c, count):
    room = w.count.max()
    points, gaps, chosen = np.zeros((room + 1, 3)), np.zeros(room + 1), np.zeros(5, np.int64)
    for j in range(len(w.free)):
        if not w.free[j]:
            continue
        whirl = _length(s.spin[j]) * w.radius[j] * h
        for plane in range(len(w.planes)):
            n = w.planes[plane, :3].copy()
            height = np.dot(n, s.centre[j]) - w.planes[plane, 3]
            reach = max(-np.dot(n, s.velocity[j]), 0.0) * h + whirl + FACE * w.radius[j]
            if height - w.radius[j] > reach:
                continue
            near = 0
            local = (n @ s.rotation[j]) * w.scale[j]
            for k in range(w.start[j], w.start[j] + w.count[j]):
                gap = local[0] * w.bank[k, 0] + local[1] * w.bank[k, 1] + local[2] * w.bank[k, 2] + height - w.round[j]
                if gap < reach:
                    points[near], gaps[near] = s.rotation[j] @ (w.bank[k] * w.scale[j]) - n * w.round[j], gap
                    near += 1
            if near == 0:
                continue
            found = _patch(points, gaps, near, n, chosen)
            upto = _add(c, count, points, gaps, chosen, found, n)
            for k in range(count, upto):
                c.i[k], c.j[k], c.piece[k], c.arm_i[k] = PLANE, j, 0, 0.0
                c.skin[k] = 0.0
                c.friction[k] = w.friction[j] * w.planes[plane, 4]
                c.restitution[k] = _restitution(w, w.restitution[j] * w.planes[plane, 5])
                c.bounces[k] = _bounces(w, w.radius[j], dt, h)
            count = upto
    return count


@numba.njit(cache=True, nogil=True)
def _is_before(c, k, i, j, piece):
    """Whether a contact comes before those of a pair's pieces."""
    if c.i[k] != i:
        return c.i[k] < i
    if c.j[k] != j:
        return c.j[k] < j
    return c.piece[k] < piece


@numba.njit(cache=True, nogil=True)
def _with_units(w, s, dt, h, c, count, old, old_count):
    units = len(w.free)
    points, gaps, chosen = np.zeros((257, 3)), np.zeros(257), np.zeros(5, np.int64)
    mine, theirs = np.zeros((CORNERS, 2)), np.zeros((CORNERS, 2))
    my_heights, their_heights = np.zeros(CORNERS), np.zeros(CORNERS)
    shared = np.zeros((3 * CORNERS, 2))
    n, p, q, known = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    place = 0  # both lists have their pairs in one order: no contact is looked at twice
    for i in range(units):
        for j in range(i + 1, units):
            if not (w.free[i] or w.free[j]) or w.group[i] == w.group[j]:
                continue
            apart = s.centre[j] - s.centre[i]
            closing = s.velocity[i] - s.velocity[j]
            whirl = (_length(s.spin[i]) * w.radius[i] + _length(s.spin[j]) * w.radius[j]) * h
            small = min(w.radius[i], w.radius[j])
            margin = whirl + FACE * small
            if _length(apart) - w.radius[i] - w.radius[j] > _length(closing) * h + margin:
                continue
            for a in range(w.pieces[i]):
                for b in range(w.pieces[j]):
                    between = _length(_middle(w, s, j, b) - _middle(w, s, i, a))
                    reach = w.ball[w.first[i] + a, 3] * w.scale[i] + w.ball[w.first[j] + b, 3] * w.scale[j]
                    if between - reach > _length(closing) * h + margin:
                        continue
                    piece = a * PIECES + b
                    while place < old_count and _is_before(old, place, i, j, piece):
                        place += 1
                    known[:] = 0.0
                    if place < old_count and old.i[place] == i and old.j[place] == j and old.piece[place] == piece:
                        known[:] = old.axes[place, 0]
                    gap = _separate(w, s, i, a, j, b, known, n, p, q)
                    if gap > max(np.dot(closing, n), 0.0) * h + margin:
                        continue
                    u, v = _tangents(n)
                    mine_count = _face(w, s, i, a, n, 1.0, u, v, mine, my_heights)
                    their_count = _face(w, s, j, b, n, -1.0, u, v, theirs, their_heights)
                    both = 0
                    if mine_count >= 3 and their_count == 2:
                        both = _clip(theirs, their_count, mine, mine_count, shared)
                    elif mine_count >= 2 and their_count >= 3:
                        both = _clip(mine, mine_count, theirs, their_count, shared)
                    if both == 0:
                        points[0], gaps[0], both = 0.5 * (p + q), gap, 1
                    else:
                        a0, a1, a2 = _slope(mine, my_heights, mine_count, w.radius[i])
                        b0, b1, b2 = _slope(theirs, their_heights, their_count, w.radius[j])
                        for k in range(both):
                            x, y = shared[k, 0], shared[k, 1]
                            low, high = a0 + a1 * x + a2 * y, b0 + b1 * x + b2 * y
                            points[k] = u * x + v * y + n * (0.5 * (low + high))
                            # Slopes are fits: no point of hulls that are apart is closer than they are.
                            gaps[k] = max(high - low, gap) if gap > 0 else high - low
                        if gaps[:both].min() > gap + SKIN * small:  # they meet beside what the faces share
                            points[both], gaps[both], both = 0.5 * (p + q), gap, both + 1
                    found = _patch(points, gaps, both, n, chosen)
                    upto = _add(c, count, points, gaps, chosen, found, n)
                    for k in range(count, upto):
                        c.i[k], c.j[k], c.piece[k] = i, j, piece
                        c.arm_i[k] -= s.centre[i]
                        c.arm_j[k] -= s.centre[j]
                        c.skin[k] = SKIN * small
                        c.friction[k] = w.friction[i] * w.friction[j]
                        c.restitution[k] = _restitution(w, w.restitution[i] * w.restitution[j])
                        c.bounces[k] = _bounces(w, small, dt, h)
                    count = upto
    return count


@numba.njit(cache=True, nogil=True)
def _moved(w, i):
    """What moves with a unit, or the plane."""
    return PLANE if i == PLANE else w.lead[i]


@numba.njit(cache=True, nogil=True)
def _levels(w, c, count, level):
    """Contacts that a unit is from one that does not move, and the order of contacts from there on."""
    level[:] = FAR
    for j in range(len(level)):
        if w.light[j] <= 0:
            level[j] = 0
    for _ in range(LEVELS):
        for k in range(count):
            i, j = c.i[k], c.j[k]
            small = w.radius[j] if i == PLANE else min(w.radius[i], w.radius[j])
            if c.gap[k] > 2 * SKIN * small:
                continue
            i, j = _moved(w, i), w.lead[j]
            below = 0 if i == PLANE else level[i]
            level[j] = min(level[j], below + 1)
            if i != PLANE:
                level[i] = min(level[i], level[j] + 1)
    placed = 0
    for step in range(LEVELS + 2):
        for k in range(count):
            below = 0 if c.i[k] == PLANE else level[w.lead[c.i[k]]]
            above = level[w.lead[c.j[k]]]
            lower = min(below, above)
            if lower == step or (step == LEVELS + 1 and lower > LEVELS):
                c.order[placed] = k
                c.held[k] = -1 if below == above else (0 if below < above else 1)
                placed += 1


@numba.njit(cache=True, nogil=True)
def _yield(light, inverse, arm, along):
    """Velocity along a direction that a unit impulse there gives the point."""
    lever = _cross(arm, along)
    return light + np.dot(lever, inverse @ lever)


@numba.njit(cache=True, nogil=True)
def _relative(w, s, c, k):
    """Velocity of j's point as i's sees it."""
    i, j = _moved(w, c.i[k]), w.lead[c.j[k]]
    out = np.empty(3)
    a, b = c.arm_j[k], s.spin[j]
    out[0] = s.velocity[j, 0] + b[1] * a[2] - b[2] * a[1]
    out[1] = s.velocity[j, 1] + b[2] * a[0] - b[0] * a[2]
    out[2] = s.velocity[j, 2] + b[0] * a[1] - b[1] * a[0]
    if i != PLANE:
        a, b = c.arm_i[k], s.spin[i]
        out[0] -= s.velocity[i, 0] + b[1] * a[2] - b[2] * a[1]
        out[1] -= s.velocity[i, 1] + b[2] * a[0] - b[0] * a[2]
        out[2] -= s.velocity[i, 2] + b[0] * a[1] - b[1] * a[0]
    return out


@numba.njit(cache=True, nogil=True)
def _push(s, unit, light, inverse, a, sign, x, y, z):
    """Gives a unit an impulse at an arm."""
    s.velocity[unit, 0] += sign * x * light
    s.velocity[unit, 1] += sign * y * light
    s.velocity[unit, 2] += sign * z * light
    u, v, w = sign * (a[1] * z - a[2] * y), sign * (a[2] * x - a[0] * z), sign * (a[0] * y - a[1] * x)
    for row in range(3):
        s.spin[unit, row] += inverse[unit, row, 0] * u + inverse[unit, row, 1] * v + inverse[unit, row, 2] * w


@numba.njit(cache=True, nogil=True)
def _kick(w, s, light, inverse, c, k, x, y, z, hold_i, hold_j):
    i, j = _moved(w, c.i[k]), w.lead[c.j[k]]
    if light[j] > 0 and not hold_j:
        _push(s, j, light[j], inverse, c.arm_j[k], 1.0, x, y, z)
    if i != PLANE and light[i] > 0 and not hold_i:
        _push(s, i, light[i], inverse, c.arm_i[k], -1.0, x, y, z)


@numba.njit(cache=True, nogil=True)
def _spin(w, s, light, inverse, c, k, impulse, hold_i, hold_j):
    """Adds what an impulse at the arm of a twist changes of spins."""
    i, j = _moved(w, c.i[k]), w.lead[c.j[k]]
    turn = c.axes[k, 0] * (impulse * c.twist[k, 0])
    if light[j] > 0 and not hold_j:
        s.spin[j] += inverse[j] @ turn
    if i != PLANE and light[i] > 0 and not hold_i:
        s.spin[i] -= inverse[i] @ turn


@numba.njit(cache=True, nogil=True)
def _prepare(w, s, light, inverse, c, count, old, old_count, part_share):
    """Weights and approaches; contacts that were there in the part before begin with their impulses."""
    for k in range(count):
        i, j = _moved(w, c.i[k]), w.lead[c.j[k]]
        c.stiff[k] = 1.0
        for axis in range(3):
            own = _yield(light[j], inverse[j], c.arm_j[k], c.axes[k, axis]) if light[j] > 0 else 0.0
            other = 0.0
            if i != PLANE and light[i] > 0:
                other = _yield(light[i], inverse[i], c.arm_i[k], c.axes[k, axis])
            c.weight[k, axis] = 1.0 / (own + other) if own + other > 0 else 0.0
            if axis == 0 and i != PLANE:
                moves = own if c.held[k] == 0 else other
                if c.held[k] >= 0 and moves > 0:
                    c.stiff[k] = (own + other) / moves
        if c.middle[k]:
            arm, n = c.twist[k, 0], c.axes[k, 0]
            soft = np.dot(n, inverse[j] @ n) if light[j] > 0 else 0.0
            if i != PLANE and light[i] > 0:
                soft += np.dot(n, inverse[i] @ n)
            # A small patch turns freely, and keeps its friction for sliding.
            c.twist[k, 2] = min(1.0 / (arm * arm * soft), c.weight[k, 1]) if arm * arm * soft > 0 else 0.0
        c.approach[k] = np.dot(_relative(w, s, c, k), c.axes[k, 0])
    first = 0  # both lists have their pairs in one order
    for k in range(count):
        nearest, which = SAME_CONTACT * w.radius[c.j[k]], -1
        while first < old_count and (old.i[first] < c.i[k] or (old.i[first] == c.i[k] and old.j[first] < c.j[k])):
            first += 1
        o = first
        while o < old_count and old.i[o] == c.i[k] and old.j[o] == c.j[k]:
            if old.held[o] == 0 and old.impulse[o, 0] > 0 and np.dot(old.axes[o, 0], c.axes[k, 0]) > SAME_WAY:
                d = _length(old.arm_j[o] - c.arm_j[k])
                if d < nearest:
                    nearest, which = d, o
            o += 1
        if which >= 0:
            old.held[which] = 1  # taken
            c.impulse[k, 0] = part_share * old.impulse[which, 0]  # what rests has impulses as long as parts; what has hit has none
            rub = part_share * (old.axes[which, 1] * old.impulse[which, 1] + old.axes[which, 2] * old.impulse[which, 2])
            c.impulse[k, 1], c.impulse[k, 2] = np.dot(rub, c.axes[k, 1]), np.dot(rub, c.axes[k, 2])
            whole = c.impulse[k] @ c.axes[k]
            _kick(w, s, light, inverse, c, k, whole[0], whole[1], whole[2], False, False)
            if c.middle[k]:
                c.twist[k, 1] = part_share * old.twist[which, 1]
                _spin(w, s, light, inverse, c, k, c.twist[k, 1], False, False)


@numba.njit(cache=True, nogil=True)
def _ticks(w, s, c, count, h, ticks):
    """Ticks of a part of h seconds until the first of the fast approaches touches, or is WAY further."""
    share = 1.0
    for k in range(count):
        closing = -np.dot(_relative(w, s, c, k), c.axes[k, 0])
        if closing <= -c.bounces[k]:
            continue
        small = w.radius[c.j[k]] if c.i[k] == PLANE else min(w.radius[c.i[k]], w.radius[c.j[k]])
        gap, near = max(c.gap[k] - c.skin[k], 0.0), WAY * small
        way = gap - 0.5 * near if gap > near else gap + 0.5 * near
        share = min(share, way / (closing * h))
    return max(int(share * ticks), 1)


@numba.njit(cache=True, nogil=True)
def _carry(w, s, before, light, inverse, c, count, dt, h):
    """Lets each unit carry what is above it, downwards, as if what is below moved as before the part: what rests on patches does so after
    one sweep. before (M, 3): those velocities."""
    rests = np.zeros(len(light))
    for counts in (True, False):
        for place in range(count - 1, -1, -1):
            k = c.order[place]
            if not c.middle[k] or c.held[k] < 0:
                continue
            i, j = _moved(w, c.i[k]), w.lead[c.j[k]]
            upper, lower = (j, i) if c.held[k] == 0 else (i, j)
            n = c.axes[k, 0] if c.held[k] == 0 else -c.axes[k, 0]
            still = before[lower] if lower != PLANE else np.zeros(3)
            small = w.radius[c.j[k]] if c.i[k] == PLANE else min(w.radius[c.i[k]], w.radius[c.j[k]])
            if np.dot(still - before[upper], n) > -_bounces(w, small, dt, h):  # what hits it is not carried
                continue
            if counts:
                rests[upper] += 1
                continue
            share = 1 / rests[upper]
            rests[upper] -= 1
            leaving = np.dot(s.velocity[upper] - still, n)
            along = max((-max(c.gap[k] - c.skin[k], 0.0) / h - leaving) * share / light[upper], 0.0)
            push = c.axes[k, 0] * along
            _kick(w, s, light, inverse, c, k, push[0], push[1], push[2], False, False)
            c.impulse[k, 0] = along


@numba.njit(cache=True, nogil=True)
def _sweep(w, s, light, inverse, c, count, h, turn, settles, bounces):
    """One impulse at each contact: what takes the approach that the gap does not allow, and friction within its cone."""
    for place in range(2 * count):
        # The middles of patches first: they carry the load without turning anything.
        middles, rank = place < count, place % count
        k = c.order[rank] if settles or turn % 2 == 1 else c.order[count - 1 - rank]
        if c.middle[k] != middles:
            continue
        hold_i, hold_j = settles and c.held[k] == 0, settles and c.held[k] == 1
        if bounces and c.impulse[k, 0] <= 0:
            continue
        n = c.axes[k, 0]
        goal = -max(c.gap[k] - c.skin[k], 0.0) / h
        if bounces:
            goal = -c.restitution[k] * c.approach[k] if c.approach[k] < c.bounces[k] else 0.0
        weight = c.weight[k, 0] * (c.stiff[k] if settles else 1.0)
        seen = _relative(w, s, c, k)
        along = max(c.impulse[k, 0] + (goal - (seen[0] * n[0] + seen[1] * n[1] + seen[2] * n[2])) * weight, 0.0)
        more = along - c.impulse[k, 0]
        _kick(w, s, light, inverse, c, k, n[0] * more, n[1] * more, n[2] * more, hold_i, hold_j)
        c.impulse[k, 0] = along
        if along <= 0 and c.impulse[k, 1] == 0 and c.impulse[k, 2] == 0 and c.twist[k, 1] == 0:
            continue
        seen, u, v, twist = _relative(w, s, c, k), c.axes[k, 1], c.axes[k, 2], 0.0
        if c.middle[k]:
            i, j = _moved(w, c.i[k]), w.lead[c.j[k]]
            whirl = np.dot(s.spin[j] - s.spin[i], n) if i != PLANE else np.dot(s.spin[j], n)
            twist = c.twist[k, 1] - whirl * c.twist[k, 0] * c.twist[k, 2]
            brake = n * ((twist - c.twist[k, 1]) * c.twist[k, 0])  # as if it acted alone
            if light[j] > 0 and not hold_j:
                seen = seen + _cross(inverse[j] @ brake, c.arm_j[k])
            if i != PLANE and light[i] > 0 and not hold_i:
                seen = seen + _cross(inverse[i] @ brake, c.arm_i[k])
        a = c.impulse[k, 1] - (seen[0] * u[0] + seen[1] * u[1] + seen[2] * u[2]) * c.weight[k, 1]
        b = c.impulse[k, 2] - (seen[0] * v[0] + seen[1] * v[1] + seen[2] * v[2]) * c.weight[k, 2]
        most, size = c.friction[k] * along, np.sqrt(a * a + b * b + twist * twist)
        if _is_pyramid(w, c, k):
            a, b, twist = max(min(a, most), -most), max(min(b, most), -most), max(min(twist, most), -most)
        elif size > most:
            a, b, twist = a * (most / size), b * (most / size), twist * (most / size)
        if c.middle[k]:
            _spin(w, s, light, inverse, c, k, twist - c.twist[k, 1], hold_i, hold_j)
            c.twist[k, 1] = twist
        f, g = a - c.impulse[k, 1], b - c.impulse[k, 2]
        _kick(w, s, light, inverse, c, k, u[0] * f + v[0] * g, u[1] * f + v[1] * g, u[2] * f + v[2] * g, hold_i, hold_j)
        c.impulse[k, 1], c.impulse[k, 2] = a, b


@numba.njit(cache=True, nogil=True)
def _push_apart(w, s, light, inverse, c, count, share, touched):
    """Moves what overlaps, from what does not move on, and marks it as touched; velocities stay."""
    ways, turns = np.zeros_like(s.centre), np.zeros_like(s.centre)
    for _ in range(PUSHES):
        for place in range(count):
            k = c.order[place]
            i, j = _moved(w, c.i[k]), w.lead[c.j[k]]
            n = c.axes[k, 0]
            way = ways[j] + _cross(turns[j], c.arm_j[k])
            if i != PLANE:
                way = way - ways[i] - _cross(turns[i], c.arm_i[k])
            depth = -c.gap[k] - np.dot(way, n)
            if depth <= 0:
                continue
            moves_j = light[j] > 0 and c.held[k] != 1
            moves_i = i != PLANE and light[i] > 0 and c.held[k] != 0
            soft = _yield(light[j], inverse[j], c.arm_j[k], n) if moves_j else 0.0
            if moves_i:
                soft += _yield(light[i], inverse[i], c.arm_i[k], n)
            if soft <= 0:
                continue
            push = n * (depth * share / soft)
            if moves_j:
                ways[j] += push * light[j]
                turns[j] += inverse[j] @ _cross(c.arm_j[k], push)
                touched[j] = True
            if moves_i:
                ways[i] -= push * light[i]
                turns[i] -= inverse[i] @ _cross(c.arm_i[k], push)
                touched[i] = True
    if count == 0:
        return
    arms, bound = _arms(w, s)  # clusters have moved since
    for unit in range(len(ways)):
        lead = w.lead[unit]
        if w.light[unit] > 0:
            s.centre[unit] += ways[lead]
            if bound[unit]:
                s.centre[unit] += _swing(turns[lead], arms[unit])
            _turn(turns[lead], s.rotation[unit])


@numba.njit(cache=True, nogil=True)
def _swing(turn, arm):
    """How far a turn takes the point at an arm."""
    angle = _length(turn)
    if angle < 1e-12:
        sine, rest = 1.0, 0.5
    else:
        sine, rest = np.sin(angle) / angle, (1 - np.cos(angle)) / (angle * angle)
    once = _cross(turn, arm)
    return sine * once + rest * _cross(turn, once)


@numba.njit(cache=True, nogil=True)
def _arms(w, s):
    """Of each unit from its cluster's centre of mass to its own, (M, 3), zeros of those alone; and which are in a cluster."""
    units = len(w.lead)
    mass, centre, bound = np.zeros(units), np.zeros((units, 3)), np.zeros(units, np.bool_)
    for unit in range(units):
        lead = w.lead[unit]
        if lead != unit:
            bound[unit] = bound[lead] = True
    arms = np.zeros((units, 3))
    if not bound.any():
        return arms, bound
    for unit in range(units):
        if bound[unit]:
            lead = w.lead[unit]
            mass[lead] += 1 / w.light[unit]
            centre[lead] += (s.centre[unit] - s.centre[lead]) / w.light[unit]
    for unit in range(units):
        if bound[unit]:
            lead = w.lead[unit]
            arms[unit] = s.centre[unit] - s.centre[lead] - centre[lead] / mass[lead]
    return arms, bound


@numba.njit(cache=True, nogil=True)
def _radii(w, arms, bound):
    """Radius of what a unit moves with, for the first one of each cluster and those alone."""
    radius = w.radius.copy()
    for unit in range(len(radius)):
        if bound[unit]:
            radius[unit] = 0.0
    for unit in range(len(radius)):
        if bound[unit]:
            lead = w.lead[unit]
            radius[lead] = max(radius[lead], _length(arms[unit]) + w.radius[unit])
    return radius


@numba.njit(cache=True, nogil=True)
def _inertia(w, s, arms, lead):
    """Of a cluster, in the world's axes."""
    out = np.zeros((3, 3))
    for unit in range(lead, len(w.lead)):
        if w.lead[unit] == lead:
            r, arm = s.rotation[unit], arms[unit]
            out += (r * w.inertia[unit]) @ r.T.copy()
            for row in range(3):
                for column in range(3):
                    far = np.dot(arm, arm) if row == column else 0.0
                    out[row, column] += (far - arm[row] * arm[column]) / w.light[unit]
    return out


@numba.njit(cache=True, nogil=True)
def _gather(w, s, bound):
    """Puts the motion of each cluster into the row of its first unit, and gives 1 / mass of what units move with there."""
    light = w.light.copy()
    for lead in range(len(light)):
        if not bound[lead] or w.lead[lead] != lead:
            continue
        mass, velocity, spin = 0.0, np.zeros(3), np.zeros(3)
        for unit in range(lead, len(light)):
            if w.lead[unit] == lead:
                mass += 1 / w.light[unit]
                velocity += s.velocity[unit] / w.light[unit]
                spin += s.spin[unit] / w.light[unit]
        light[lead] = 1 / mass
        s.velocity[lead], s.spin[lead] = velocity / mass, spin / mass
    return light


@numba.njit(cache=True, nogil=True)
def _speed(radius, s, unit):
    """No point of a unit is faster, m/s."""
    return _length(s.velocity[unit]) + _length(s.spin[unit]) * radius


@numba.njit(cache=True, nogil=True)
def advance(w, s, dt, parts, c, old):
    """Advances a scene by dt seconds in equal parts, which fast approaches cut, in place. c and old: room for contacts, from `room`. Units that are
    not free go on as their velocity and spin say, whatever they meet.

    Clusters come with the mean motion of their units, by mass, and end with each unit's own.

    Returns the most contacts of a part, and those of the last one; touched (M) bool: what an impulse or a push has moved; share (M) m/s: what contact
    changed of a unit's motion, less where that is slow in the end; 0 where nothing touches it; -1 where it rests."""
    units = len(w.free)
    inverse, level = np.zeros((units, 3, 3)), np.zeros(units, np.int64)
    rotation, centre = s.rotation.copy(), s.centre.copy()
    speed, rest = np.zeros(units), np.zeros(units)
    arms, bound = _arms(w, s)
    radius = _radii(w, arms, bound)
    light = _gather(w, s, bound)
    # Of what moves: units alone, and the first one of each cluster.
    velocity, spin = s.velocity + w.gravity * dt, s.spin.copy()  # in free flight, at the end
    touched, touched_now = np.zeros(units, np.bool_), np.zeros(units, np.bool_)
    drop = _length(w.gravity)
    for unit in range(units):
        speed[unit] = _speed(radius[unit], s, unit)
        lead = w.lead[unit]
        slow = REST * drop * dt
        rest[lead] = max(rest[lead], slow + min(slow, ROUNDING * np.abs(s.centre[unit]).max() / dt))
    count = most = 0
    left, part, last = TICKS * parts, 0, TICKS
    there = Motion(s.rotation, s.centre, s.velocity.copy(), s.spin.copy())  # motion at the units' own centres
    before = s.velocity.copy()
    while left > 0:
        ticks = min(left, TICKS)
        h = ticks * (dt / (TICKS * parts))
        kept = count
        for k in range(count):
            old.i[k], old.j[k], old.piece[k], old.arm_j[k] = c.i[k], c.j[k], c.piece[k], c.arm_j[k]
            old.impulse[k], old.axes[k], old.held[k] = c.impulse[k], c.axes[k], 0
            old.twist[k] = c.twist[k]
        arms, bound = _arms(w, s)
        for unit in range(units):
            if w.lead[unit] != unit:
                continue
            inverse[unit] = 0.0
            if bound[unit]:
                inverse[unit] = np.linalg.inv(_inertia(w, s, arms, unit))
            elif light[unit] > 0:
                r = s.rotation[unit]
                inverse[unit] = (r / w.inertia[unit]) @ r.T.copy()
            if w.free[unit]:
                s.velocity[unit] += w.gravity * h
        for unit in range(units):
            lead = w.lead[unit]
            there.velocity[unit], there.spin[unit] = s.velocity[lead], s.spin[lead]
            if bound[unit]:
                there.velocity[unit] += _cross(s.spin[lead], arms[unit])
        count = _with_planes(w, there, dt, h, c, 0)
        count = _with_units(w, there, dt, h, c, count, old, kept)
        for k in range(count):
            if bound[c.j[k]]:
                c.arm_j[k] += arms[c.j[k]]
            if c.i[k] != PLANE and bound[c.i[k]]:
                c.arm_i[k] += arms[c.i[k]]
        if w.law[1] > 0:
            _slide(w, s, c, count)
        most = max(most, count)
        fewer = -(-left // (MOST_CUT_PARTS - part))
        fewer = max(_ticks(w, s, c, count, h, ticks), fewer)
        if fewer < ticks:
            for k in range(count):  # what bounces is known with gravity of all of the part
                slow = np.dot(_relative(w, s, c, k), c.axes[k, 0]) >= c.bounces[k]
                c.bounces[k] = -np.inf if slow else 0.0
            whole, ticks, h = h, fewer, fewer * (dt / (TICKS * parts))
            for unit in range(units):
                if w.free[unit] and w.lead[unit] == unit:
                    s.velocity[unit] -= w.gravity * (whole - h)
        _levels(w, c, count, level)
        if part == 0:
            # What lay still between the two frames and is held has not begun to fall in the middle of it either.
            for unit in range(units):
                if w.lead[unit] != unit:
                    continue
                way = _length(velocity[unit] - w.gravity * (1.5 * dt)) + _length(spin[unit]) * radius[unit]
                if w.free[unit] and level[unit] < FAR and way < HELD * drop * dt:
                    s.velocity[unit] -= w.gravity * (0.5 * dt)
                    before[unit] -= w.gravity * (0.5 * dt)
                if level[unit] == FAR:
                    speed[unit] = np.inf  # at the top of a bounce it is slow, and does not rest
        _prepare(w, s, light, inverse, c, count, old, kept, min(ticks / last, 1.0))
        last = ticks
        if part == 0:
            _carry(w, s, before, light, inverse, c, count, dt, h)
        for turn in range(max(LEAST_SWEEPS, SWEEPS // parts)):
            _sweep(w, s, light, inverse, c, count, h, turn, False, False)
        for _ in range(SETTLING * ticks // TICKS):
            _sweep(w, s, light, inverse, c, count, h, 1, True, False)
        touched_now[:] = False
        bounces = False
        for k in range(count):
            if c.impulse[k, 0] > 0:
                touched_now[w.lead[c.j[k]]] = True
                if c.i[k] != PLANE:
                    touched_now[w.lead[c.i[k]]] = True
                bounces |= c.approach[k] < c.bounces[k] and c.restitution[k] > 0
        touched |= touched_now
        for unit in range(units):
            lead = w.lead[unit]
            s.centre[unit] += s.velocity[lead] * h
            if w.free[unit] and not touched_now[lead]:
                s.centre[unit] -= w.gravity * (0.5 * h * h)  # a parabola, exactly
            if bound[unit]:
                s.centre[unit] += _swing(s.spin[lead] * h, arms[unit])
            _turn(s.spin[lead] * h, s.rotation[unit])
        if bounces:
            for turn in range(BOUNCING):
                _sweep(w, s, light, inverse, c, count, h, turn, False, True)
        _push_apart(w, s, light, inverse, c, count, SHARE * ticks / TICKS, touched)
        left, part = left - ticks, part + 1
    share = np.zeros(units)
    arms, bound = _arms(w, s)
    radius = _radii(w, arms, bound)
    changed, changed_spin = s.velocity - velocity, s.spin - spin
    went = np.zeros(units)  # what is pushed out of something else is slow too, and goes
    for unit in range(units):
        turn = s.rotation[unit] @ rotation[unit].T.copy()
        turn = (turn - turn.T.copy()) / 2  # its sine
        arm = np.sqrt((turn * turn).sum() / 2) * radius[unit]
        went[unit] = np.sqrt(arm * arm + ((s.centre[unit] - centre[unit]) ** 2).sum())
    for unit in range(units):
        lead = w.lead[unit]
        if not w.free[unit]:
            touched[unit] = False
            continue
        if not touched[lead]:
            continue
        touched[unit] = True
        slow = level[lead] < FAR and speed[lead] < rest[lead] and _speed(radius[lead], s, lead) < rest[lead]
        if slow and went[lead] <= SKIN * radius[lead]:
            s.rotation[unit], s.centre[unit] = rotation[unit], centre[unit]
            share[unit] = -1.0
            continue
        own, change = s.velocity[lead], changed[lead]
        if bound[unit]:
            own, change = own + _cross(s.spin[lead], arms[unit]), change + _cross(changed_spin[lead], arms[unit])
        after = _length(own) + _length(s.spin[lead]) * w.radius[unit]
        brisk = BOUNCE * np.sqrt(drop * w.radius[unit])
        share[unit] = _length(change) + _length(changed_spin[lead]) * w.radius[unit]
        if after < brisk:
            share[unit] *= max(after - SLOW * brisk, 0.0) / ((1 - SLOW) * brisk)
        lasting = LASTING * drop * dt
        if share[unit] < 2 * lasting:
            share[unit] *= max(share[unit] - lasting, 0.0) / lasting
    for unit in range(units - 1, -1, -1):  # the first one of a cluster last: the others read its row
        lead = w.lead[unit]
        if share[unit] < 0:
            s.velocity[unit], s.spin[unit] = 0.0, 0.0
        elif bound[unit]:
            s.velocity[unit] = s.velocity[lead] + _cross(s.spin[lead], arms[unit])
            s.spin[unit] = s.spin[lead]
    return most, count, touched, share


def meetings(c, count):
    """Pairs of pieces that contacts of the last part of a step are between, in the order of its contacts, for `keep_apart`:
    (K, 4) i, j, the pieces and which unit is held, and (K, 3) normals from i to j."""
    order = [k for k in c.order[:count] if c.i[k] != PLANE]
    pair = [(c.i[k], c.j[k], c.piece[k]) for k in order]
    first = [k for at, k in enumerate(order) if at == 0 or pair[at] != pair[at - 1]]
    return np.stack((c.i[first], c.j[first], c.piece[first], c.held[first]), 1), c.axes[first, 0]


@numba.njit(cache=True, nogil=True)
def _lowest(w, s, unit, plane):
    """Height of a unit's lowest point over a plane where it is below that, else 0."""
    n = w.planes[plane, :3]
    height = np.dot(n, s.centre[unit]) - w.planes[plane, 3]
    if height > w.radius[unit]:
        return 0.0
    local = (n @ s.rotation[unit]) * w.scale[unit]
    low = 0.0
    for k in range(w.start[unit], w.start[unit] + w.count[unit]):
        low = min(low, local[0] * w.bank[k, 0] + local[1] * w.bank[k, 1] + local[2] * w.bank[k, 2] + height - w.round[unit])
    return low


@numba.njit(cache=True, nogil=True)
def _shift(w, s, unit, way):
    """Moves what a unit moves with, and then out of planes: as far as the deepest of a cluster has to go."""
    lead = w.lead[unit]
    for other in range(lead, len(w.lead)):
        if w.lead[other] == lead:
            s.centre[other] += way
    for plane in range(len(w.planes)):
        low = 0.0
        for other in range(lead, len(w.lead)):
            if w.lead[other] == lead:
                low = min(low, _lowest(w, s, other, plane))
        for other in range(lead, len(w.lead)):
            if w.lead[other] == lead:
                s.centre[other] -= w.planes[plane, :3] * low


@numba.njit(cache=True, nogil=True)
def keep_apart(w, s, pairs, normals):
    """Moves units of `pairs` apart where they overlap, without turning them, from what does not move on: centres of s, in
    place. What a network corrects after impulses, or turns to the first order miss, may overlap."""
    units = len(w.free)
    n, p, q = np.zeros(3), np.zeros(3), np.zeros(3)
    light = w.light.copy()
    for lead in range(units):
        if light[lead] > 0 and w.lead[lead] == lead:
            mass, many = 0.0, 0
            for unit in range(lead, units):
                if w.lead[unit] == lead:
                    mass, many = mass + 1 / w.light[unit], many + 1
            if many > 1:
                light[lead] = 1 / mass
    moved, moves = np.ones(units, np.bool_), np.zeros(units, np.bool_)
    for _ in range(KEEPS):
        moves[:] = False
        for k in range(len(pairs)):
            i, j, piece, held = pairs[k]
            a, b = piece // PIECES, piece % PIECES
            first, second = w.lead[i], w.lead[j]
            if not (moved[first] or moved[second] or moves[first] or moves[second]):
                continue
            light_i = 0.0 if held == 0 else light[w.lead[i]]
            light_j = 0.0 if held == 1 else light[w.lead[j]]
            slack = SLACK * min(w.radius[i], w.radius[j])
            if light_i + light_j <= 0 or _between(w, s, i, a, j, b, normals[k], p, q) >= -slack:
                continue
            depth = -slack - _separate(w, s, i, a, j, b, normals[k], n, p, q)
            if depth <= 0:
                continue
            way = n * (depth / (light_i + light_j))
            if light_i > 0:
                moves[w.lead[i]] = True
                _shift(w, s, i, -way * light_i)
            if light_j > 0:
                moves[w.lead[j]] = True
                _shift(w, s, j, way * light_j)
        if not moves.any():
            break
        moved[:] = moves


def room(units):
    """Memory for `advance`: two lists of contacts."""
    return _room(units), _room(units)
