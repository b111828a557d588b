"""What units look like: their points, or surfaces over them."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from .motion import Record, alone, matrices

#: How far in front of itself a sheet is drawn, as a share of its triangles' sides. Triangles cut corners, so what lies right under a
#: sheet shows through between its points otherwise.
SHEET_LIFT = 0.12
#: Faces that meet at less than the angle of this cosine look round: those of hulls, and those of soft bodies. Folds of cloth are round,
#: the edges of a cube are not.
SMOOTH, SMOOTH_SOFT = 0.80, 0.5


def hull_faces(points: np.ndarray) -> np.ndarray:
    """The triangles (T, 3) of the convex hull, rows of the points, counter-clockwise from outside; none where there is no volume."""
    try:
        hull = ConvexHull(points.astype(np.float64))
    except (QhullError, ValueError):
        return np.zeros((0, 3), np.int64)
    a, b, c = (points[hull.simplices[:, k]].astype(np.float64) for k in range(3))
    inwards = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(1) < 0
    return np.where(inwards[:, None], hull.simplices[:, ::-1], hull.simplices).astype(np.int64)


def surface(points: np.ndarray, pieces: list[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
    """The corners (N, 3) of a rigid unit's surface, and for each convex piece its triangles, rows of the corners."""
    if not pieces:
        faces = hull_faces(points)
        return points, [faces] if len(faces) else []
    first, corners, triangles = 0, [], []
    for piece in pieces:
        faces = hull_faces(piece)
        if len(faces):
            corners.append(piece)
            triangles.append(first + faces)
            first += len(piece)
    return (np.concatenate(corners), triangles) if corners else (points, [])


def smooth_normals(corners: np.ndarray, names: np.ndarray, cosine: float) -> np.ndarray:
    """Unit normals (T, 3, 3) at the corners (T, 3, 3) of triangles. names: (T, 3) corners of one name are one place, where triangles that
    meet at less than the angle of this cosine share a normal. Larger triangles count more."""
    a, b, c = (corners[:, k] for k in range(3))
    weighted = np.cross(b - a, c - a)
    own = weighted / np.linalg.norm(weighted, axis=1, keepdims=True).clip(1e-30)
    flat, triangle = names.ravel(), np.repeat(np.arange(len(names)), 3)
    order = np.argsort(flat, kind="stable")
    starts = np.searchsorted(flat[order], flat)
    counts = np.searchsorted(flat[order], flat, "right") - starts
    corner = np.repeat(np.arange(len(flat)), counts)
    offset = np.arange(len(corner)) - np.repeat(np.cumsum(counts) - counts, counts)
    near = triangle[order[starts[corner] + offset]]
    alike = (own[near] * own[triangle[corner]]).sum(1) > cosine
    total = np.zeros((len(flat), 3))
    np.add.at(total, corner[alike], weighted[near[alike]])
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 1e-12, total / length.clip(1e-30), own[triangle]).reshape(-1, 3, 3)


def twins(record: Record) -> np.ndarray:
    """(W) of each soft point the first one of its body that is in the same place at rest: the two are one."""
    rest = [record.points[unit] for unit in np.flatnonzero(record.soft)]
    if not rest:
        return np.zeros(0, np.int64)
    body = np.repeat(alone(record.body)[record.soft], [len(points) for points in rest])
    places = np.column_stack((body, np.round(np.concatenate(rest).astype(np.float64) * 1e5))).astype(np.int64)
    _, first, inverse = np.unique(places, axis=0, return_index=True, return_inverse=True)
    return first[inverse.ravel()]


@dataclasses.dataclass
class Shape:
    """Vertices, and what is drawn of them. Vertices of rigid units come first, then all soft points."""

    rigid: np.ndarray  # (R, 3) in the unit's frame
    owner: np.ndarray  # (R) unit
    squares: np.ndarray  # vertices
    triangles: np.ndarray  # (T, 3) of closed surfaces
    sheets: np.ndarray  # (S, 3) of soft units
    flat: list[int]  # units without a surface, where surfaces are drawn

    def placed(self, poses: np.ndarray, soft: np.ndarray) -> np.ndarray:
        """All vertices (N, 3) in the world."""
        rigid = np.einsum("nij,nj->ni", matrices(poses)[self.owner], self.rigid) + poses[self.owner, :3]
        return np.concatenate((rigid, soft))

    def lift_m(self, placed: np.ndarray) -> float:
        """How far in front of themselves sheets are drawn, metres."""
        if not len(self.sheets):
            return 0.0
        return SHEET_LIFT * float(np.linalg.norm(placed[self.sheets[:, 1]] - placed[self.sheets[:, 0]], axis=1).mean())


def shape_of(record: Record, surfaces: bool) -> Shape:
    """The points of all units; or their surfaces, and the points of those without."""
    nothing = np.zeros((0, 3), np.int64)
    vertices, owner, triangles, squares, flat, count = [], [], [nothing], [], [], 0
    for unit in np.flatnonzero(~record.soft):
        corners, faces = surface(record.points[unit], record.pieces[unit]) if surfaces else (record.points[unit], [])
        if faces:
            triangles += [count + face for face in faces]
        else:
            squares.append(np.arange(count, count + len(corners)))
            flat += [int(unit)] * surfaces
        vertices.append(corners)
        owner.append(np.full(len(corners), unit))
        count += len(corners)
    sheets, start = (record.faces if surfaces else nothing), 0
    for unit in np.flatnonzero(record.soft):
        end = start + len(record.points[unit])
        if not ((sheets >= start) & (sheets < end)).any():
            squares.append(np.arange(count + start, count + end))
            flat += [int(unit)] * surfaces
        start = end
    join = lambda parts, like: np.concatenate(parts) if parts else like  # noqa: E731
    return Shape(
        rigid=join(vertices, np.zeros((0, 3))).astype(np.float64), owner=join(owner, np.zeros(0, np.int64)),
        squares=join(squares, np.zeros(0, np.int64)), triangles=np.concatenate(triangles), sheets=count + sheets, flat=flat,
    )  # fmt: skip
