"""Makes scenes in which a sheet of cloth falls on a sphere and hangs from it or slides off.

    python -m rigidformer_lab.shell --seeds 1000 --out shell.safetensors

MuJoCo simulates the sheet: a square grid of n x n vertices that resists stretch and bending, 2 mm thick, with Poisson's ratio
.2 and damping 10 ms. Its vertices keep 8 mm away from what they touch; it does not touch itself. The sphere is fixed and stands
on the plane z = 0, at the origin. 60 frames a second, 480 engine steps a second, gravity 9.81 m/s2.

A scene has 9 units in the order of the file: 8 free, soft patches of one body, the sheet, and the sphere, which is fixed. The
cells of the grid are cut into 2 x 4 blocks as equal as can be; a patch has the vertices of its cells. So neighbours share the
vertices on their border, and each has its own copy. Points at rest are those of the flat sheet about its middle, for all
patches in the same frame, so copies of a vertex are in the same place there too. The pose of a patch is that of the rigid
motion that carries its points at rest nearest to where they are. A patch has the mass of its vertices, which all weigh the
same; patches share that of a shared vertex equally.

Faces and edges of the file are those of the sheet, each once, as rows of the copies.

The seed draws, uniformly: n, 11 to 15; the side of the sheet, .7 to 1.1 m; its mass, .2 to .6 kg/m2; the logarithm of its
Young's modulus, 2e5 to 2e6 Pa; its friction, .2 to .8 (the sphere and the ground have 1, so this is the friction of the pair);
the sphere's radius, .15 to .3 m; where the middle of the sheet is over the sphere, up to .3 of its side away; its turn about
the vertical, any; its tilt, up to 20 degrees; the height of its lowest vertex over the sphere, .03 to .3 m. It starts at rest.

A run in which the engine warns, or a vertex goes farther than 5 m or deeper than 12 mm into the sphere or the ground, is drawn
anew from the same seed. A tenth of the seeds is for tests, a tenth for validation, as in `movi primitives`; `--split test` puts
all of a file into the split for tests. An interrupted run continues where it stopped.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from . import trials
from .patches import Flex, cut, turned
from .roles import FIXED, FREE, OWN_BODY
from .scenes import Scenes
from .trials import GROUND_FRICTION, RESTITUTION, STEP_S, Unstable, check_places, one_scene

FRAMES = 150
VERTICES = (11, 15)  # a side
SIDE_M, KG_M2, FRICTION = (0.7, 1.1), (0.2, 0.6), (0.2, 0.8)
YOUNG_PA = (2e5, 2e6)
BALL_RADIUS_M, SOLID_KG_M3 = (0.15, 0.3), 1000.0
OFFSET = 0.3  # of the side
TILT_RAD = np.radians(20)
ABOVE_M = (0.03, 0.3)
DEEPEST_M = 0.012
BLOCKS = (2, 4)

#: The implicit integrators take no elasticity of flexes. 8 mm and a time constant of 10 ms keep a fast sheet out of the sphere.
XML = """<mujoco>
<option timestep="{step}" integrator="discrete" solver="CG" iterations="100" gravity="0 0 -9.81"/>
<worldbody>
<geom name="ground" type="plane" size="9 9 .1" friction="{friction}" solref=".01 1"/>
{fixed}
<flexcomp name="sheet" type="grid" dim="2" count="{n} {n} 1" spacing="{spacing} {spacing} {spacing}" mass="{mass}" radius=".008">
<contact solref=".01 1" selfcollide="none" condim="3" friction="{friction}"/>
<elasticity young="{young}" poisson=".2" thickness="2e-3" damping="1e-2" elastic2d="both"/>
</flexcomp>
{free}
</worldbody>
<contact>{pairs}</contact>
</mujoco>"""


def icosphere() -> np.ndarray:
    """(162, 3): an icosahedron whose faces were cut in four twice, on the unit sphere."""
    golden = (1 + 5**0.5) / 2
    corners = [(0, y, z) for y in (-1, 1) for z in (-golden, golden)]
    points = np.array([np.roll(corner, k) for k in range(3) for corner in corners])
    for length in (2.0, 1.0):  # of an edge, about; an edge's middle becomes a point
        first, second = np.triu_indices(len(points), 1)
        near = np.linalg.norm(points[first] - points[second], axis=1) < 1.2 * length
        points = np.concatenate([points, (points[first] + points[second])[near] / 2])
        points *= np.hypot(1, golden) / np.linalg.norm(points, axis=1, keepdims=True)
    return points / np.hypot(1, golden)


@dataclass(frozen=True)
class Solid:
    """A rigid body that a sheet touches: a ball or a box."""

    name: str
    size_m: tuple[float, ...]  # the radius of a ball, or half the three edges of a box
    place: np.ndarray  # (3) of its middle, metres; of a free one the height is that over the highest vertex of the sheet
    kg: float
    heading_rad: float = 0.0  # its turn about the vertical
    friction: float = GROUND_FRICTION
    free: bool = False

    def text(self, sheet_friction: float) -> str:
        """For MuJoCo, with the friction of its contact with the sheet, the product of theirs. A free body has priority."""
        half, kind = self.heading_rad / 2, "sphere" if len(self.size_m) == 1 else "box"
        joint, more = (f'<freejoint name="{self.name}"/>', f'mass="{self.kg}" priority="1" ') if self.free else ("", "")
        return (
            f'<body name="{self.name}" pos="{_text(self.place)}" quat="{_text((np.cos(half), 0, 0, np.sin(half)))}">{joint}'
            f'<geom name="{self.name}" type="{kind}" size="{_text(self.size_m)}" {more}'
            f'friction="{self.friction * sheet_friction}" solref=".01 1"/></body>'
        )  # fmt: skip

    def points(self) -> np.ndarray:
        """(n, 3) of its surface, about its middle: 162 of a ball, 98 of a box."""
        if len(self.size_m) == 1:
            return self.size_m[0] * icosphere()
        grid = np.array(np.meshgrid(*[np.linspace(-1, 1, 5)] * 3, indexing="ij")).reshape(3, -1).T
        return grid[np.abs(grid).max(1) == 1] * self.size_m

    def depth(self, points: np.ndarray, pose: np.ndarray) -> float:
        """How deep the deepest of points (n, 3) is in it where its pose is (7), metres; below 0 where all are outside."""
        away = points - pose[:3]
        if len(self.size_m) == 1:
            return self.size_m[0] - np.linalg.norm(away, axis=1).min()
        return (self.size_m - np.abs(away @ turn_of(pose))).min(1).max()


def ball(name: str, radius: float, place=(0.0, 0.0), **more) -> Solid:
    """A fixed ball that stands on the ground."""
    return Solid(name, (radius,), np.array([*place, radius]), 4 / 3 * np.pi * radius**3 * SOLID_KG_M3, **more)


def turn_of(pose: np.ndarray) -> np.ndarray:
    """(3, 3)"""
    return Rotation.from_quat(pose[3:], scalar_first=True).as_matrix()


def _text(numbers) -> str:
    return " ".join(f"{number:.17g}" for number in numbers)


def _pair(one: str, other: str, friction: float) -> str:
    """A contact of rigid bodies with a friction other than the greater one of theirs. Its time constant is half the sheet's, or a
    ball that falls would go deep into the ground. The last three frictions are of spin and rolling, and do not count."""
    return f'<pair geom1="{one}" geom2="{other}" condim="3" friction="{friction} {friction} 1 1 1" solref=".005 1"/>'


class Recipe(trials.Recipe):
    dataset = "shell"
    what = "a sheet of cloth falls on a sphere."
    draws = 90

    def solids(self, rng: np.random.Generator) -> list[Solid]:
        """What is there beside the sheet: fixed, and then what falls."""
        return [ball("sphere", rng.uniform(*BALL_RADIUS_M))]

    def run(self, seed: int, rng: np.random.Generator) -> Scenes:
        n, side = int(rng.integers(VERTICES[0], VERTICES[1], endpoint=True)), rng.uniform(*SIDE_M)
        mass, friction = side**2 * rng.uniform(*KG_M2), rng.uniform(*FRICTION)
        young, solids = np.exp(rng.uniform(*np.log(YOUNG_PA))), self.solids(rng)
        away, along = OFFSET * side * rng.random() ** 0.5, rng.uniform(0, 2 * np.pi)
        turn, above = turned(rng, TILT_RAD), rng.uniform(*ABOVE_M)

        fixed, free = ([solid for solid in solids if solid.free is which] for which in (False, True))
        sheet = Flex(XML.format(
            step=STEP_S, friction=friction, n=n, spacing=side / (n - 1), mass=mass, young=young,
            fixed="".join(solid.text(friction) for solid in fixed), free="".join(solid.text(friction) for solid in free),
            pairs="".join(_pair(one.name, other, one.friction) for one in free for other in ["ground", *(o.name for o in fixed)]),
        ))  # fmt: skip
        places = sheet.rest @ turn.T + [away * np.cos(along), away * np.sin(along), 0.0]
        places[:, 2] += max(solid.place[2] + solid.size_m[-1] for solid in fixed) + above - places[:, 2].min()
        for solid in free:
            sheet.data.joint(solid.name).qpos[2] += places[:, 2].max()
        poses = []

        def sound(vertices):
            poses.append([np.concatenate([sheet.data.body(o.name).xpos, sheet.data.body(o.name).xquat]) for o in solids])
            still, moving = list(zip(fixed, poses[-1])), list(zip(free, poses[-1][len(fixed) :]))
            points = np.concatenate([vertices, *(solid.points() @ turn_of(pose).T + pose[:3] for solid, pose in moving)])
            check_places(points)
            depth = max(-points[:, 2].min(), *(solid.depth(points, pose) for solid, pose in still))
            depth = max(depth, *(solid.depth(vertices, pose) for solid, pose in moving), -np.inf)
            if depth > DEEPEST_M:
                raise Unstable(f"a vertex went {depth:.3f} m deep")

        vertices = sheet.simulate(places, np.zeros_like(places), self.frames, sound)
        patches = cut(sheet.rest, sheet.elements, BLOCKS)
        count, others = len(patches.members), len(solids)
        shapes = {f"{self.dataset}-{seed}-{k}": points for k, points in enumerate(patches.shapes)}
        shapes |= {f"{self.dataset}-{seed}-{solid.name}": solid.points() for solid in solids}
        physics = [(share, friction, RESTITUTION) for share in patches.masses(mass)]
        return one_scene(
            seed, self.dataset, shapes, np.concatenate([patches.poses(vertices), np.transpose(poses, (1, 0, 2))]),
            [*physics, *((solid.kg, solid.friction, RESTITUTION) for solid in solids)], self.what,
            program=self.program,
            unit_role=np.array([FREE] * count + [FREE if solid.free else FIXED for solid in solids], np.uint8),
            unit_body=np.array([0] * count + [OWN_BODY] * others, np.int32),
            unit_soft=np.array([1] * count + [0] * others, np.uint8),
            unit_young=np.array([young] * count + [0] * others, np.float32),
            soft_points=patches.points(vertices),
            **patches.lists(),
        )  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    return trials.command(arguments, __doc__, Recipe, FRAMES)


if __name__ == "__main__":
    sys.exit(main())
