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

import numpy as np

from . import trials
from .flex import Flex, cut, turned
from .roles import FIXED, FREE, OWN_BODY
from .scenes import Scenes
from .trials import GROUND_FRICTION, RESTITUTION, STEP_S, Unstable, one_scene

FRAMES = 150
VERTICES = (11, 15)  # a side
SIDE_M, KG_M2, FRICTION = (0.7, 1.1), (0.2, 0.6), (0.2, 0.8)
YOUNG_PA = (2e5, 2e6)
BALL_RADIUS_M, BALL_KG_M3 = (0.15, 0.3), 1000.0
OFFSET = 0.3  # of the side
TILT_RAD = np.radians(20)
ABOVE_M = (0.03, 0.3)
DEEPEST_M = 0.012
BLOCKS = (2, 4)

#: The implicit integrators take no elasticity of flexes. 8 mm and a time constant of 10 ms keep a fast sheet out of the sphere.
XML = """<mujoco>
<option timestep="{step}" integrator="discrete" solver="CG" iterations="100" gravity="0 0 -9.81"/>
<worldbody>
<geom type="plane" size="9 9 .1" friction="{friction}" solref=".01 1"/>
<geom type="sphere" size="{radius}" pos="0 0 {radius}" friction="{friction}" solref=".01 1"/>
<flexcomp name="sheet" type="grid" dim="2" count="{n} {n} 1" spacing="{spacing} {spacing} {spacing}" mass="{mass}" radius=".008">
<contact solref=".01 1" selfcollide="none" condim="3" friction="{friction}"/>
<elasticity young="{young}" poisson=".2" thickness="2e-3" damping="1e-2" elastic2d="both"/>
</flexcomp>
</worldbody>
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


class Recipe(trials.Recipe):
    dataset = "shell"
    draws = 90

    def run(self, seed: int, rng: np.random.Generator) -> Scenes:
        n, side = int(rng.integers(VERTICES[0], VERTICES[1], endpoint=True)), rng.uniform(*SIDE_M)
        mass, friction = side**2 * rng.uniform(*KG_M2), rng.uniform(*FRICTION)
        young, radius = np.exp(rng.uniform(*np.log(YOUNG_PA))), rng.uniform(*BALL_RADIUS_M)
        away, along = OFFSET * side * rng.random() ** 0.5, rng.uniform(0, 2 * np.pi)
        turn, above = turned(rng, TILT_RAD), rng.uniform(*ABOVE_M)

        sheet = Flex(XML.format(step=STEP_S, friction=friction, radius=radius, n=n, spacing=side / (n - 1), mass=mass, young=young))
        places = sheet.rest @ turn.T + [away * np.cos(along), away * np.sin(along), 0.0]
        places[:, 2] += 2 * radius + above - places[:, 2].min()

        def sound(vertices):
            depth = max(-vertices[:, 2].min(), radius - np.linalg.norm(vertices - [0, 0, radius], axis=1).min())
            if depth > DEEPEST_M:
                raise Unstable(f"a vertex went {depth:.3f} m deep")

        vertices = sheet.simulate(places, np.zeros_like(places), self.frames, sound)
        patches = cut(sheet.rest, sheet.elements, BLOCKS)
        ball = np.tile([0, 0, radius, 1, 0, 0, 0], (1, self.frames, 1))
        count = len(patches.members)
        shapes = {f"shell-{seed}-{k}": points for k, points in enumerate(patches.shapes)}
        physics = [(share, friction, RESTITUTION) for share in patches.masses(mass)]
        return one_scene(
            seed, self.dataset, shapes | {f"shell-{seed}-sphere": radius * icosphere()},
            np.concatenate([patches.poses(vertices), ball]),
            [*physics, (4 / 3 * np.pi * radius**3 * BALL_KG_M3, GROUND_FRICTION, RESTITUTION)],
            "a sheet of cloth falls on a sphere.",
            unit_role=np.array([FREE] * count + [FIXED], np.uint8),
            unit_body=np.array([0] * count + [OWN_BODY], np.int32),
            unit_soft=np.array([1] * count + [0], np.uint8),
            unit_young=np.array([young] * count + [0], np.float32),
            soft_points=patches.points(vertices),
            **patches.lists(),
        )  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    return trials.command(arguments, __doc__, Recipe, FRAMES)


if __name__ == "__main__":
    sys.exit(main())
