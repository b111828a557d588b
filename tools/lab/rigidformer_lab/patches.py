"""Soft bodies of MuJoCo as units of a scene: a lattice of vertices, cut into patches.

A patch is a unit. It has the vertices of a block of the lattice's cells, so neighbours share the vertices on their border, and
each has its own copy. All patches of a body have their points at rest in one frame, that of the undeformed body.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from .trials import SUB_STEPS, check, check_places, model_of

#: Outside of a tetrahedron whose volume is above 0.
SIDES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))


@dataclass(frozen=True)
class Patches:
    """The patches of a body, and its mesh in rows of their points, patch after patch."""

    rest: np.ndarray  # (vertices, 3) undeformed
    members: list[np.ndarray]  # of each patch, its vertices
    faces: np.ndarray  # (T, 3)
    edges: np.ndarray  # (E, 2) each once
    tetrahedra: np.ndarray  # (V, 4) none in a sheet

    @property
    def shapes(self) -> list[np.ndarray]:
        return [self.rest[own] for own in self.members]

    def masses(self, total: float) -> np.ndarray:
        """(patches) kg of a body whose vertices are all as heavy; what patches share, they share equally."""
        owners = np.bincount(np.concatenate(self.members), minlength=len(self.rest))
        return np.array([(total / len(self.rest) / owners[own]).sum() for own in self.members])

    def points(self, vertices: np.ndarray) -> np.ndarray:
        """(points, frames, 3) of all patches, from vertices (frames, vertices, 3)."""
        return vertices[:, np.concatenate(self.members)].transpose(1, 0, 2).astype(np.float32)

    def poses(self, vertices: np.ndarray) -> np.ndarray:
        """(patches, frames, 7): where each patch would be if it were rigid."""
        return np.stack([fit(self.rest[own], vertices[:, own]) for own in self.members])

    def lists(self) -> dict:
        """What a file of one scene says of the mesh."""
        found = {}
        for name in ("faces", "edges", "tetrahedra"):
            rows = getattr(self, name)
            if len(rows):
                found |= {name: rows.astype(np.int32), f"scene_{name}": np.array([0, len(rows)], np.int64)}
        return found


def fit(rest: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(frames, 7): the poses that carry rest (n, 3) nearest to points (frames, n, 3), without reflection."""
    middle, there = rest.mean(0), points.mean(1)
    u, _, vh = np.linalg.svd(np.einsum("fai,aj->fij", points - there[:, None], rest - middle))
    u[..., 2] *= np.sign(np.linalg.det(u @ vh))[:, None]
    rotation = u @ vh
    return np.column_stack([there - rotation @ middle, Rotation.from_matrix(rotation).as_quat()[:, [3, 0, 1, 2]]])


def cut(rest: np.ndarray, elements: np.ndarray, blocks: tuple[int, ...]) -> Patches:
    """Cuts a lattice into as many blocks along each axis. rest: (vertices, 3) of the lattice; elements: its triangles (T, 3) or
    tetrahedra (T, 4), each within a cell."""
    low = rest.min(0)
    spacing = [np.diff(np.unique(np.round(rest[:, axis] - low[axis], 9))).min(initial=1.0) for axis in range(len(blocks))]
    place = np.round((rest - low)[:, : len(blocks)] / spacing, 9)  # in cells
    cells = np.floor(place[elements].mean(1)).astype(int)
    patch = np.zeros(len(elements), int)
    for axis, number in enumerate(blocks):
        parts = np.array_split(np.arange(cells[:, axis].max() + 1), number)
        block_of = np.repeat(np.arange(number), [len(part) for part in parts])
        patch = patch * number + block_of[cells[:, axis]]
    members = [np.unique(elements[patch == k]) for k in range(np.prod(blocks))]
    if elements.shape[1] == 4:
        elements = elements.copy()
        turned = volumes(rest, elements) < 0
        elements[turned, :2] = elements[turned, 1::-1]
    starts = np.cumsum([0] + [len(own) for own in members])
    row = np.full((len(members), len(rest)), -1)
    for k, own in enumerate(members):
        row[k, own] = starts[k] + np.arange(len(own))

    def rows(corners, count) -> np.ndarray:
        """Rows of those of the vertices (n, k) of elements that occur at most so often, each once."""
        corners = np.concatenate([elements[:, c] for c in corners])
        owner = np.tile(patch, len(corners) // len(patch))
        _, first, times = np.unique(np.sort(corners, axis=1), axis=0, return_index=True, return_counts=True)
        first = np.sort(first[times <= count])
        return row[owner[first][:, None], corners[first]]

    edges = rows(list(map(list, combinations(range(elements.shape[1]), 2))), np.inf)
    if elements.shape[1] == 4:
        return Patches(rest, members, rows(list(map(list, SIDES)), 1), edges, row[patch[:, None], elements])
    return Patches(rest, members, row[patch[:, None], elements], edges, np.zeros((0, 4), int))


def volumes(points: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """(..., V) of points (..., n, 3)."""
    a, b, c, d = (points[..., tetrahedra[:, k], :] for k in range(4))
    return (np.cross(b - a, c - a) * (d - a)).sum(-1) / 6


class Flex:
    """A model with one soft body, made at the origin, that starts elsewhere. Bodies that move besides come after it in the text."""

    def __init__(self, text: str):
        self.model, self.data = model_of(text)
        self._update()
        self.rest = self.data.flexvert_xpos.copy()
        corners = self.model.flex_dim[0] + 1
        self.elements = self.model.flex_elem.reshape(-1, corners).astype(int)

    def _update(self) -> None:
        """The vertices that a step leaves are those before it."""
        import mujoco

        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_flex(self.model, self.data)

    def simulate(self, places: np.ndarray, velocities: np.ndarray, frames: int, sound) -> np.ndarray:
        """(frames, vertices, 3) from places and velocities of the vertices on. sound: is called once a frame, and raises
        `Unstable` where vertices (vertices, 3) cannot be."""
        import mujoco

        self.data.qpos[: places.size] = (places - self.rest).ravel()  # each vertex slides along x, y and z
        self.data.qvel[: places.size] = velocities.ravel()
        vertices = np.empty((frames, *self.rest.shape))
        for frame in range(frames):
            if frame:
                mujoco.mj_step(self.model, self.data, SUB_STEPS)
                check(self.data)
            self._update()
            vertices[frame] = self.data.flexvert_xpos
            check_places(vertices[frame])
            sound(vertices[frame])
        return vertices


def turned(rng: np.random.Generator, most_rad: float) -> np.ndarray:
    """(3, 3): any turn about the vertical, then a tilt of at most so much about a horizontal axis."""
    turn, along, tilt = rng.uniform(0, 2 * np.pi), rng.uniform(0, 2 * np.pi), rng.uniform(0, most_rad)
    axis = np.array([np.cos(along), np.sin(along), 0.0])
    return (Rotation.from_rotvec(tilt * axis) * Rotation.from_rotvec([0, 0, turn])).as_matrix()

