"""Makes scenes in which a soft cube falls on the ground, tips over and comes to rest.

    python -m rigidformer_lab.soft_cube --seeds 1000 --out soft.safetensors

MuJoCo simulates the cube: a lattice of n x n x n vertices whose cells are filled with tetrahedra, of 100 kg/m3, with Poisson's
ratio .45 and damping 50 ms. Its vertices keep 5 mm away from the ground; it does not touch itself. The ground is the plane
z = 0. 60 frames a second, 480 engine steps a second, gravity 9.81 m/s2.

A scene has 8 units: free, soft patches of one body, the cube. The cells of the lattice are cut into 2 x 2 x 2 blocks as equal
as can be; a patch has the vertices of its cells. So neighbours share the vertices on their border, and each has its own copy.
Points at rest are those of the undeformed cube about its middle, for all patches in the same frame, so copies of a vertex are
in the same place there too. The pose of a patch is that of the rigid motion that carries its points at rest nearest to where
they are. A patch has the mass of its vertices, which all weigh the same; patches share that of a shared vertex equally.

Tetrahedra and their edges are all in the file, each once, as rows of the copies; its faces are those of the cube's surface.

The seed draws, uniformly: n, 4 to 6; the side, .3 to .5 m; the logarithm of Young's modulus, 8e3 to 3e4 Pa; friction, .3 to .8
(the ground has 1, so this is the friction of the pair); any turn about the vertical, then a tilt of up to 60 degrees; the
height of the lowest vertex, .05 to .3 m; the velocity, up to .7 m/s along x and y and .5 m/s along z, either way.

A run in which the engine warns, a tetrahedron turns inside out, or a vertex goes farther than 5 m or deeper than 5 cm into the
ground, is drawn anew from the same seed. A tenth of the seeds is for tests, a tenth for validation, as in `movi primitives`;
`--split test` puts all of a file into the split for tests. An interrupted run continues where it stopped.
"""

from __future__ import annotations

import sys

import numpy as np

from . import trials
from .patches import Flex, cut, turned, volumes
from .scenes import Scenes
from .trials import GROUND_FRICTION, RESTITUTION, STEP_S, Unstable, one_scene

FRAMES = 120
VERTICES = (4, 6)  # a side
SIDE_M, KG_M3, FRICTION = (0.3, 0.5), 100.0, (0.3, 0.8)
YOUNG_PA = (8e3, 3e4)
TILT_RAD = np.radians(60)
ABOVE_M = (0.05, 0.3)
VELOCITY_M_S = np.array([0.7, 0.7, 0.5])
DEEPEST_M = 0.05
BLOCKS = (2, 2, 2)

#: The implicit integrators take no elasticity of flexes.
XML = """<mujoco>
<option timestep="{step}" integrator="discrete" solver="CG" iterations="100" gravity="0 0 -9.81"/>
<worldbody>
<geom type="plane" size="9 9 .1" zaxis="{normal}" friction="{friction}" solref=".005 1"/>
<flexcomp name="cube" type="grid" dim="3" count="{n} {n} {n}" spacing="{spacing} {spacing} {spacing}" mass="{mass}" radius=".005">
<contact solref=".005 1" selfcollide="none" condim="3" friction="{friction}"/>
<elasticity young="{young}" poisson=".45" damping=".05"/>
</flexcomp>
</worldbody>
</mujoco>"""


class Recipe(trials.Recipe):
    dataset, program = "soft", "soft_cube"
    what = "a soft cube falls on the ground."
    draws = 91

    def ground(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """The normal of the plane, which goes through the origin, and where on it the cube starts (m)."""
        return np.array([0.0, 0.0, 1.0]), np.zeros(3)

    def run(self, seed: int, rng: np.random.Generator) -> Scenes:
        n, side = int(rng.integers(VERTICES[0], VERTICES[1], endpoint=True)), rng.uniform(*SIDE_M)
        young, friction, mass = np.exp(rng.uniform(*np.log(YOUNG_PA))), rng.uniform(*FRICTION), side**3 * KG_M3
        turn, above, velocity = turned(rng, TILT_RAD), rng.uniform(*ABOVE_M), rng.uniform(-VELOCITY_M_S, VELOCITY_M_S)
        normal, start = self.ground(rng)

        cube = Flex(XML.format(step=STEP_S, friction=friction, n=n, spacing=side / (n - 1), mass=mass, young=young,
                               normal=" ".join(f"{number:.17g}" for number in normal)))  # fmt: skip
        patches = cut(cube.rest, cube.elements, BLOCKS)
        places = cube.rest @ turn.T + start
        places += (above - (places @ normal).min()) * normal
        first = np.concatenate(patches.members)[patches.tetrahedra]  # vertices of the lattice

        def sound(vertices):
            depth = -(vertices @ normal).min()
            if depth > DEEPEST_M:
                raise Unstable(f"a vertex went {depth:.3f} m deep")
            if volumes(vertices, first).min() <= 0:
                raise Unstable("a tetrahedron turned inside out")

        vertices = cube.simulate(places, np.broadcast_to(velocity, places.shape), self.frames, sound)
        count = len(patches.members)
        return one_scene(
            seed, self.dataset, {f"{self.dataset}-{seed}-{k}": points for k, points in enumerate(patches.shapes)},
            patches.poses(vertices), [(share, friction, RESTITUTION) for share in patches.masses(mass)], self.what,
            program=self.program,
            planes=np.array([[*normal, 0, GROUND_FRICTION, RESTITUTION]], np.float32),
            scene_planes=np.array([0, 1], np.int64),
            unit_body=np.zeros(count, np.int32),
            unit_soft=np.ones(count, np.uint8),
            unit_young=np.full(count, young, np.float32),
            soft_points=patches.points(vertices),
            **patches.lists(),
        )  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    return trials.command(arguments, __doc__, Recipe, FRAMES)


if __name__ == "__main__":
    sys.exit(main())
