"""Makes scenes in which a cube of fragments is thrown on the ground and breaks.

    python -m rigidformer_lab.fragments --seeds 1000 --out fragments.safetensors

The cube has an edge of 1 m and 1000 kg/m3. It consists of the Voronoi cells of random points, each shrunk by 1 % about its
centre of mass. A bond holds two cells together that share a face of more than .01 m2. MuJoCo simulates the cells as convex
bodies and the bonds as welds at the middle of the shared face. A bond breaks for good after an engine step in which the force
of its weld exceeds its strength, 3e5 N/m2 times the area times a factor of its own. The cells touch each other, also those
that are bonded. 60 frames a second, 480 engine steps a second, gravity 9.81 m/s2. The ground is the plane z = 0.

A scene has a free unit a cell, and all have the same body, though they separate: `bonds` says which pairs hold together, and
`bond_frame` from which frame on they do not. The frame of a cell has its centre of mass at the origin and the axes of the
cube. The points of its shape are its corners.

The seed draws, uniformly: the number of cells, 8 to 16; their points, which then move to the middle of their cells, as Lloyd's
algorithm has it, once (drawn anew until each cell has at least 10 liters); factors of the strengths, .6 to 1.4; friction, .4 to
.8 (the ground has 1, so this is that of a cell on the ground; two cells have its square); the cube's turn, any; the height of
its lowest corner, .3 to 1.5 m; its velocity, up to 2 m/s along x and y either way and up to 4 m/s downwards; its spin, up to
3 rad/s about each axis.

A run in which the engine warns, or a cell goes farther than 5 m or its centre below the ground, is drawn anew from the same
seed. A tenth of the seeds is for tests, a tenth for validation, as in `movi primitives`; `--split test` puts all of a file into
the split for tests. An interrupted run continues where it stopped.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, Voronoi
from scipy.spatial.transform import Rotation

from . import trials
from .scenes import Scenes
from .trials import RESTITUTION, STEP_S, SUB_STEPS, Unstable, check, check_places, model_of, one_scene

FRAMES = 180
CELLS = (8, 16)
LEAST_M3, SHRUNK = 0.01, 0.99
BOND_M2, STRENGTH_PA, STRENGTHS = 0.01, 3e5, (0.6, 1.4)
KG_M3, FRICTION = 1000.0, (0.4, 0.8)
ABOVE_M, DOWN_M_S = (0.3, 1.5), (0.0, 4.0)
ASIDE_M_S, SPIN_RAD_S = 2.0, 3.0
CORNER_M = 1e-6  # corners of a cell that are closer are one

#: Contacts as stiff as the welds: with softer ones cubes break into two or three pieces.
XML = """<mujoco>
<option timestep="{step}" integrator="implicitfast" gravity="0 0 -9.81"/>
<size memory="64M"/>
<asset>{meshes}</asset>
<worldbody>
<geom type="plane" size="9 9 .1" friction="{ground}" solref=".006 1"/>
{bodies}
</worldbody>
<equality>{welds}</equality>
</mujoco>"""


@dataclass(frozen=True)
class Cells:
    """The cells of a cube about the origin."""

    centres: np.ndarray  # (cells, 3) of mass
    corners: list[np.ndarray]  # of each cell, (corners, 3) about its centre, shrunk
    volumes: np.ndarray  # (cells) shrunk, m3
    bonds: np.ndarray  # (bonds, 2)
    areas: np.ndarray  # (bonds) m2
    middles: np.ndarray  # (bonds, 3) of the shared faces


def _middle(corners: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre of mass and volume of a convex body."""
    hull = ConvexHull(corners)
    apex = corners.mean(0)
    a, b, c = (corners[hull.simplices[:, k]] - apex for k in range(3))
    volume = np.abs((np.cross(a, b) * c).sum(1)) / 6
    return apex + (volume[:, None] * (a + b + c) / 4).sum(0) / volume.sum(), volume.sum()


def _voronoi(points: np.ndarray) -> tuple[list[np.ndarray], Voronoi]:
    """Corners of the cells of points within the cube."""
    mirrored = [points]
    for axis in range(3):
        for side in (-1.0, 1.0):  # a point and its mirror image have the cube's face between them
            image = points.copy()
            image[:, axis] = side - image[:, axis]
            mirrored.append(image)
    diagram = Voronoi(np.concatenate(mirrored))
    return [diagram.vertices[diagram.regions[diagram.point_region[k]]] for k in range(len(points))], diagram


def draw_cells(rng: np.random.Generator) -> Cells:
    count = int(rng.integers(CELLS[0], CELLS[1], endpoint=True))
    while True:
        corners, _ = _voronoi(rng.uniform(-0.5, 0.5, (count, 3)))
        corners, diagram = _voronoi(np.array([_middle(cell)[0] for cell in corners]))
        if min(_middle(cell)[1] for cell in corners) >= LEAST_M3:
            break
    centres = np.array([_middle(cell)[0] for cell in corners])
    faces = []
    for pair, ridge in zip(diagram.ridge_points, diagram.ridge_vertices):
        if max(pair) < count:  # the other ones are on the cube's surface, or outside
            faces.append((*sorted(map(int, pair)), *_face(diagram.vertices[ridge])))
    held = sorted((face for face in faces if face[2] > BOND_M2), key=lambda face: face[:2])
    shrunk = [SHRUNK * (_apart(cell) - centre) for cell, centre in zip(corners, centres)]
    volumes = np.array([_middle(cell)[1] for cell in shrunk])
    bonds, areas, middles = ([face[:2] for face in held], [face[2] for face in held], [face[3] for face in held])
    return Cells(centres, shrunk, volumes, np.array(bonds), np.array(areas), np.array(middles))


def _face(corners: np.ndarray) -> tuple[float, np.ndarray]:
    """Area and middle of a convex face whose corners are in order."""
    a, b, c = corners[0], corners[1:-1], corners[2:]
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return areas.sum(), (areas[:, None] * (a + b + c) / 3).sum(0) / areas.sum()


def _apart(corners: np.ndarray) -> np.ndarray:
    """Without those that are as good as another one."""
    kept: list[np.ndarray] = []
    for corner in corners:
        if all(np.linalg.norm(corner - other) > CORNER_M for other in kept):
            kept.append(corner)
    return np.array(kept)


def _text(numbers) -> str:
    return " ".join(f"{number:.17g}" for number in np.ravel(numbers))


def describe(cells: Cells, friction: float) -> str:
    """The cube for MuJoCo, about the origin, unturned."""
    meshes = "".join(f'<mesh name="m{k}" vertex="{_text(corners)}"/>' for k, corners in enumerate(cells.corners))
    bodies = "".join(
        f'<body name="b{k}" pos="{_text(centre)}"><freejoint/><geom type="mesh" mesh="m{k}" mass="{_text(KG_M3 * volume)}" '
        f'friction="{friction**2}" solref=".006 1"/></body>' for k, (centre, volume) in enumerate(zip(cells.centres, cells.volumes))
    )  # fmt: skip
    welds = "".join(
        f'<weld body1="b{i}" body2="b{j}" anchor="{_text(middle - cells.centres[j])}" solref=".006 1"/>'
        for (i, j), middle in zip(cells.bonds, cells.middles)
    )  # fmt: skip
    return XML.format(step=STEP_S, meshes=meshes, ground=friction, bodies=bodies, welds=welds)


def forces(data, bonds: int) -> np.ndarray:
    """(bonds) N of the welds of the last step; 0 of broken ones."""
    import mujoco

    found = np.zeros(bonds)
    rows = np.flatnonzero(data.efc_type[: data.nefc] == mujoco.mjtConstraint.mjCNSTR_EQUALITY).reshape(-1, 6)
    # Of a weld come three rows of its force, then three of its torque.
    found[data.efc_id[rows[:, 0]]] = np.linalg.norm(data.efc_force[rows[:, :3]], axis=1)
    return found


class Recipe(trials.Recipe):
    dataset = "fragments"
    draws = 92
    strengths = STRENGTHS

    def run(self, seed: int, rng: np.random.Generator) -> Scenes:
        import mujoco

        cells = draw_cells(rng)
        count, strength = len(cells.centres), STRENGTH_PA * cells.areas * rng.uniform(*self.strengths, len(cells.areas))
        friction, turn, above = rng.uniform(*FRICTION), Rotation.random(rng=rng), rng.uniform(*ABOVE_M)
        velocity = np.array([*rng.uniform(-ASIDE_M_S, ASIDE_M_S, 2), -rng.uniform(*DOWN_M_S)])
        spin = rng.uniform(-SPIN_RAD_S, SPIN_RAD_S, 3)

        model, data = model_of(describe(cells, friction))
        corners = [turn.apply(centre + own) for centre, own in zip(cells.centres, cells.corners)]
        places = turn.apply(cells.centres)
        places[:, 2] += above - min(own[:, 2].min() for own in corners)
        middle = places.mean(0)
        data.qpos[:] = np.column_stack([places, np.tile(turn.as_quat()[[3, 0, 1, 2]], (count, 1))]).ravel()
        moving = velocity + np.cross(spin, places - middle)
        data.qvel[:] = np.column_stack([moving, np.tile(turn.inv().apply(spin), (count, 1))]).ravel()  # spin in the body's frame

        poses = np.empty((count, self.frames, 7))
        broken = np.full(len(cells.bonds), self.frames, np.int32)
        for frame in range(self.frames):
            for _ in range(SUB_STEPS if frame else 0):
                mujoco.mj_step(model, data)
                loose = (forces(data, len(broken)) > strength) & (broken == self.frames)
                broken[loose], data.eq_active[loose] = frame, 0
            check(data)
            poses[:, frame] = data.qpos.reshape(count, 7)
            check_places(poses[:, frame, :3])
            if poses[:, frame, 2].min() < 0:
                raise Unstable("a cell's centre went below the ground")
        return one_scene(
            seed, self.dataset, {f"fragment-{seed}-{k}": own for k, own in enumerate(cells.corners)}, poses,
            [(KG_M3 * volume, friction, RESTITUTION) for volume in cells.volumes],
            "a cube of fragments is thrown on the ground and breaks.",
            unit_body=np.zeros(count, np.int32),
            bonds=cells.bonds.astype(np.int32),
            scene_bonds=np.array([0, len(cells.bonds)], np.int64),
            bond_frame=broken,
        )  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    return trials.command(arguments, __doc__, Recipe, FRAMES)


if __name__ == "__main__":
    sys.exit(main())
