"""Writes single steps of `solver` for the test of its twin in the core.

    python -m rigidformer_lab.solver_cases ../../core/src/contact/solver/cases.txt
    python -m rigidformer_lab.solver_cases --clusters ../../core/src/contact/solver/clusters.txt

A line a unit: scene; half sides x, y, z of a box, or radius, 0, 0 of a polyhedron of POLYHEDRON points on a sphere, or
radius, 0, 1 of a ball, which has BALL such points, or of a table of three boxes, whose y is negative (`pieces_of`); mass; friction and
restitution; rotation vector, centre, velocity and spin at the start; for each of STEPS centre, rotation vector and share
at the end. With --clusters scenes have clusters, and a line ends in the first unit of the one that a unit is in, or its own number:
a pair that falls on an edge, eight cubes that spin freely, a cluster at rest, two clusters that collide, and scenes that fell. The ground z = 0 has friction and restitution 1. SI units, velocities at the start without half of a step's
fall.
"""

from __future__ import annotations

import argparse
import itertools
import pathlib

import numpy as np
from scipy.spatial.transform import Rotation

from .data import BALL_BOX
from .impacts import is_ball
from .pieces import ball_around
from .solver import Motion, World, advance, in_one_piece, parts, room

SCENES = 8
TABLES = 10_000  # seeds from there on have tables of three pieces
TABLE_SCENES = 8
STEPS = (1, 5, 10)  # parts of 1/240 s
#: Of the scenes with one: offset of restitution, and a pyramid.
LAW, LAW_SCENES = np.array([0.05, 1.0]), 8
POLYHEDRON, BALL = 64, 160
GOLDEN = 2.399963  # radians from a point of a ball to the next
GRAVITY = np.array([0.0, 0.0, -9.81])


def box(x, y, z):
    return np.array([[a, b, c] for c in (-z, z) for b in (-y, y) for a in (-x, x)])


def pieces_of(x, y, z):
    """Of a table: a plate on two walls. Anything else has none."""
    if y >= 0:
        return []
    wall = [box(0.15 * x, -y, 0.8 * z) + [side * 0.85 * x, 0, -0.2 * z] for side in (-1, 1)]
    return [box(x, -y, 0.2 * z) + [0, 0, 0.8 * z], *wall]


def points(x, y, z):
    """Of a box, of a table, or about evenly over a sphere."""
    if y > 0:
        return box(x, y, z)
    if y < 0:
        return np.concatenate(pieces_of(x, y, z))
    count = BALL if z > 0 else POLYHEDRON
    k = np.arange(count)
    up = 1 - (2 * k + 1) / count
    across = np.sqrt(1 - up**2)
    return x * np.stack([across * np.cos(GOLDEN * k), across * np.sin(GOLDEN * k), up], 1)


def world(shapes, mass, friction, restitution, lead=None):
    """Free units over the ground."""
    hulls = [points(*shape) for shape in shapes]
    radius = np.array([np.linalg.norm(hull, axis=1).max() for hull in hulls])
    ball = np.array([is_ball(hull) for hull in hulls])
    sides = np.where(ball[:, None], BALL_BOX * radius[:, None], np.array([np.ptp(hull, axis=0) for hull in hulls]))
    square = sides**2
    hulls = [np.zeros((1, 3)) if one else hull for hull, one in zip(hulls, ball)]
    count = np.array([len(hull) for hull in hulls])
    start = np.cumsum(count) - count
    first, pieces, piece, around = in_one_piece(start, count, radius)
    given = [pieces_of(*shape) for shape in shapes]
    if any(given):
        pieces = np.array([max(len(p), 1) for p in given])
        first = np.cumsum(pieces) - pieces
        piece = np.concatenate([
            [[low + 8 * k, 8] for k in range(len(p))] if p else [[low, many]] for p, low, many in zip(given, start, count)
        ])
        around = np.concatenate([[ball_around(q) for q in p] if p else [[0, 0, 0, r]] for p, r in zip(given, radius)])
    return World(
        np.ones(len(hulls), bool), np.arange(len(hulls)) if lead is None else lead, 1 / mass,
        mass[:, None] * (square.sum(1, keepdims=True) - square) / 12, friction, restitution,
        radius, start, count, np.ones(len(hulls)), np.concatenate(hulls), first, pieces, piece, around, np.where(ball, radius, 0.0),
        np.array([[0, 0, 1, 0, 1, 1.0]]), GRAVITY, np.arange(len(hulls)) if lead is None else lead,
    )  # fmt: skip


def step(w, turn, centre, velocity, spin, code):
    """(M, 7): centre, rotation vector and share after a step."""
    motion = Motion(Rotation.from_rotvec(turn).as_matrix(), centre.copy(), velocity.copy(), spin.copy())
    dt = code / 240
    share = advance(w, motion, dt, parts(dt), *room(len(turn)))[3]
    return np.concatenate([motion.centre, Rotation.from_matrix(motion.rotation).as_rotvec(), share[:, None]], 1)


def fallen(seed, lead=None, law=None):
    """A scene some time after units were let fall: the world, and rows of what a line has of the start. lead: of each of 6. law: of a world
    in which they are thrown."""
    rng = np.random.default_rng(seed)
    units = 3 + seed % 4 if lead is None else len(lead)
    box = rng.uniform(0.04, 0.12, (units, 3))
    shapes = np.where(rng.random((units, 1)) < 0.7, box, box * [1, 0, 0] + [0, 0, seed % 2])
    mass, friction, restitution = rng.uniform([0.3, 0.4, 0.0], [3, 0.9, 0.6], (units, 3)).T
    if seed >= TABLES:
        shapes[rng.random(units) < 0.5, 1] *= -1
    given = [np.round(v, 4) for v in (shapes, mass, friction, restitution)]
    w = world(*given, lead)
    centre = np.stack([rng.uniform(-0.05, 0.05, units), rng.uniform(-0.05, 0.05, units), 0.15 + 0.18 * np.arange(units)], 1)
    motion = Motion(
        Rotation.random(units, random_state=seed).as_matrix(), centre, rng.normal(size=(units, 3)) * 0.1,
        rng.normal(size=(units, 3)),
    )  # fmt: skip
    if law is not None:
        w = w._replace(law=law)
        motion.velocity[:] *= 10
    contacts = room(units)
    for _ in range(int(rng.integers(60, 300) if law is None else rng.integers(20, 90))):
        advance(w, motion, 1 / 240, 1, *contacts)
    turn = Rotation.from_matrix(motion.rotation).as_rotvec()
    state = [np.round(v, 6) for v in (turn, motion.centre, motion.velocity, motion.spin)]
    shapes, mass, friction, restitution = given
    return w, [shapes, np.stack([mass, friction, restitution], 1), *state]


def cells(half, turn, place, velocity, spin):
    """Rows of the eight cells of a box that moves."""
    x, y, z = np.array(half) / 2
    arms = Rotation.from_rotvec(turn).apply(box(x, y, z))
    each = lambda row: np.tile(np.asarray(row, float), (8, 1))  # noqa: E731
    return [each([x, y, z]), each([0.25, 0.7, 0.5]), each(turn), arms + place, velocity + np.cross(spin, arms), each(spin)]


def clusters():
    """Scenes with clusters: worlds, rows of what a line has of the start, and leads."""
    pair = [np.array([[0.1, 0.05, 0.08], [0.06, 0.07, 0.05]]), np.array([[1, 0.7, 0.5], [0.4, 0.6, 0.4]]), np.zeros((2, 3)),
            np.array([[0, 0, 0], [0.17, 0, 0.03]]), np.zeros((2, 3)), np.zeros((2, 3))]  # fmt: skip
    turn = Rotation.from_rotvec([0.3, 0.6, 0.1])
    pair[2], pair[3] = np.tile(turn.as_rotvec(), (2, 1)), turn.apply(pair[3]) + [0, 0, 0.172]
    pair[5][:] = [0.5, -1.0, 0.3]
    pair[4] = np.cross(pair[5], pair[3] - pair[3].mean(0)) + [0.4, 0.1, -1.2]
    spinning = cells((0.2, 0.2, 0.2), (0.5, 0.2, -0.4), (0.1, 0.3, 2), (1, -0.5, 2), (3, -2, 4))
    resting = cells((0.2, 0.1, 0.1), (0, 0, 0.3), (0.1, -0.2, 0.1), (0, 0, 0), (0, 0, 0))
    one = cells((0.2, 0.15, 0.1), (0.2, 0.1, 0.7), (0, 0, 1), (1.5, 0, 0.1), (0.5, 1, -1))
    other = cells((0.15, 0.15, 0.15), (-0.3, 0.2, 0.2), (0.445, 0.05, 1.05), (-2, 0.2, 0), (0, -1, 2))
    both = [np.concatenate(rows) for rows in zip(one, other)]
    eight = np.zeros(8, np.int64)
    scenes = [(pair, np.array([0, 0])), (spinning, eight), (resting, eight), (both, np.concatenate((eight, eight + 8)))]
    for rows, lead in scenes:
        rows = [np.round(row, 6) for row in rows]
        yield world(rows[0], *rows[1].T, lead), rows, lead


def ends_of(seed):
    """As `ends_from`, of a scene that fell."""
    return ends_from(seed, *fallen(seed))


def ends_from(seed, w, given):
    """The start and the ends of a scene; None where rounding to f32 alone changes an end by a fifth of what the test
    allows: there the two solvers may well choose another contact."""
    start = given[2:]
    ends = [step(w, *start, code) for code in STEPS]
    rng = np.random.default_rng(seed)
    for _ in range(12):
        shaken = [v + rng.normal(size=v.shape) * 1e-7 * np.maximum(1.0, np.abs(v)) for v in start]
        for end, code in zip(ends, STEPS):
            away = np.abs(step(w, *shaken, code) - end)
            if away[:, :3].max() > 2e-5 or away[:, 3:6].max() > 2e-4 or away[:, 6].max() * code / 240 > 2e-5:
                return None
    return given, [np.round(end, 7) for end in ends]


def cluster_lines():
    """The file with clusters, line by line."""
    kept = [(ends_from(1, w, given), lead) for w, given, lead in clusters()]
    if any(ends is None for ends, _ in kept):
        raise SystemExit("rounding decides between contacts in a scene of `clusters`; change its start")
    for lead in ([0, 0, 2, 2, 4, 5], [0, 1, 0, 1, 0, 1], [0, 1, 2, 1, 2, 2]):
        lead = np.array(lead)
        found = (ends_from(seed, *fallen(seed, lead)) for seed in itertools.count(0))
        kept += [(ends, lead) for ends in itertools.islice((ends for ends in found if ends), 2)]
    for scene, ((given, ends), lead) in enumerate(kept):
        for row, first in zip(np.concatenate(given + ends, 1), lead):
            yield f"{scene} " + " ".join(f"{v + 0.0:.7f}".rstrip("0").rstrip(".") for v in row) + f" {first}"


def law_lines():
    """The file with a contact law, line by line: of scenes that it changes."""
    kept = []
    for seed in itertools.count(0):
        w, given = fallen(seed, law=LAW)
        plain = step(w._replace(law=np.zeros(2)), *given[2:], STEPS[0])
        ends = ends_from(seed, w, given)
        if ends and np.abs(plain - ends[1][0]).max() > 1e-3:
            kept.append(ends)
        if len(kept) == LAW_SCENES:
            break
    for scene, (given, ends) in enumerate(kept):
        for row in np.concatenate(given + ends, 1):
            yield f"{scene} " + " ".join(f"{v + 0.0:.7f}".rstrip("0").rstrip(".") for v in row)


def lines():
    """The file, line by line."""
    kept = []
    for start, count in ((0, SCENES), (TABLES, TABLE_SCENES)):
        found = (ends_of(seed) for seed in itertools.count(start))
        kept += itertools.islice((ends for ends in found if ends), count)
    for scene, (given, ends) in enumerate(kept):
        for row in np.concatenate(given + ends, 1):
            yield f"{scene} " + " ".join(f"{v + 0.0:.7f}".rstrip("0").rstrip(".") for v in row)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=pathlib.Path)
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--clusters", action="store_true", help="scenes with clusters")
    kind.add_argument("--law", action="store_true", help="scenes with a contact law")
    args = parser.parse_args()
    found = cluster_lines() if args.clusters else law_lines() if args.law else lines()
    args.out.write_text("".join(f"{line}\n" for line in found))


if __name__ == "__main__":
    main()
