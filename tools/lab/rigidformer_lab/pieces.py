"""Convex pieces of hollow shapes: rings, handles, tables. A shape of several pieces touches with each of them.

The solver knows up to `PIECES` a unit. Meshes made of more pieces are merged, the pair first that gains the least volume.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from .geometry import felt_hull
from .impacts import extreme_points
from .solver import PIECES

ROWS = 255  # points of a piece, at most


class MeshError(ValueError):
    """A mesh cannot be used."""


def read_triangles(path: Path) -> list[np.ndarray]:
    """Triangles of each piece of an OBJ file, (triangles, 3, 3)."""
    vertices, pieces = [], [[]]
    try:
        for line in path.read_text().splitlines():
            kind, *words = line.split() or [""]
            if kind == "v":
                vertices.append([float(word) for word in words[:3]])
            elif kind in ("o", "g") and pieces[-1]:
                pieces.append([])
            elif kind == "f":
                corners = [int(word.split("/")[0]) - 1 for word in words]
                pieces[-1] += [(corners[0], b, c) for b, c in zip(corners[1:], corners[2:])]
        points = np.array(vertices)
        return [points[np.array(piece)] for piece in pieces if piece]
    except (OSError, ValueError, IndexError) as error:
        raise MeshError(f"{path}: cannot read the mesh ({error}); --assets takes the folder with one folder per "
                        "KuBasic shape, each with collision_geometry.obj") from error


def read_pieces(path: Path, most: int = PIECES) -> list[np.ndarray]:
    """Convex pieces of an OBJ file of several, merged to so many, (points, 3) each; none of a file of one. Flat ones have no
    volume, and are left out."""
    pieces = [np.unique(piece.reshape(-1, 3), axis=0) for piece in read_triangles(path)]
    pieces = [piece for piece in pieces if _volume(piece) > 0]
    return merged(pieces, most) if len(pieces) > 1 else []


def file_pieces(pieces: list[list[np.ndarray]]) -> dict[str, np.ndarray]:
    """The convex pieces of each shape, as scene files have them; nothing if no shape has any."""
    each = [piece for own in pieces for piece in own]
    if not each:
        return {}
    rising = lambda counts: np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)  # noqa: E731
    return {"shape_pieces": rising([len(own) for own in pieces]), "piece_offsets": rising([len(piece) for piece in each]),
            "piece_points": np.concatenate(each)}


def hull_points(points: np.ndarray) -> np.ndarray:
    """Those of points that are corners of their hull, in their order."""
    try:
        return points[np.sort(ConvexHull(points).vertices)]
    except QhullError:  # flat
        return points


def _volume(points: np.ndarray) -> float:
    try:
        return ConvexHull(points).volume
    except QhullError:
        return 0.0


def merged(pieces: list[np.ndarray], most: int = PIECES) -> list[np.ndarray]:
    """At most so many pieces (points, 3): pairs become their common hull, the pair first that gains the least volume."""
    pieces = [hull_points(np.asarray(piece, np.float64)) for piece in pieces]
    volumes = [_volume(piece) for piece in pieces]
    gains = {}
    while len(pieces) > most:
        best = None
        for a in range(len(pieces)):
            for b in range(a + 1, len(pieces)):
                key = id(pieces[a]), id(pieces[b])
                if key not in gains:
                    gains[key] = _volume(np.concatenate((pieces[a], pieces[b]))) - volumes[a] - volumes[b], pieces[a], pieces[b]
                if best is None or gains[key][0] < best[0]:
                    best = gains[key][0], a, b
        _, a, b = best
        pieces[a] = hull_points(np.concatenate((pieces[a], pieces.pop(b))))
        volumes.pop(b)
        volumes[a] = _volume(pieces[a])
    pieces = [piece.astype(np.float32) for piece in pieces]
    return [piece if len(piece) <= ROWS else piece[extreme_points(piece - piece[0])][:ROWS] for piece in pieces]


def centre_of(pieces: list[np.ndarray]) -> np.ndarray | None:
    """Centroid of pieces by their volumes, f32; None if all are flat. What two pieces share counts twice."""
    found = [felt_hull(piece) for piece in pieces]
    total, moment = np.float32(0), np.zeros(3, np.float32)
    for middle, _, volume, offset in found:
        total = total + volume
        moment = moment + (middle * volume + offset)
    extent = np.concatenate(pieces)
    size = np.float32(np.ptp(extent, axis=0).max())
    return moment / total if total > np.float32(1e-4) * size**3 else None


def rows_of(pieces: list[np.ndarray], centre: np.ndarray) -> list[np.ndarray]:
    """What the solver keeps of each piece: its extreme points, relative to the centre, f32."""
    local = [piece.astype(np.float32) - centre for piece in pieces]
    return [piece[extreme_points(piece - piece[0])][:ROWS] for piece in local]


def ball_around(rows: np.ndarray) -> np.ndarray:
    """Middle and radius of a ball around a piece (4,), f32: the middle is that of its box."""
    middle = (rows.min(0) + rows.max(0)) * np.float32(0.5)
    return np.append(middle, np.sqrt(np.square(rows - middle).sum(1).max())).astype(np.float32)
