"""Makes scenes of soft bodies of kinds that no model of this project was trained on, all for tests.

    python -m rigidformer_lab.research.unseen ball-on-shell --seeds 20 --first-seed 70001 --out unseen-ball-on-shell.safetensors

MuJoCo simulates them with the settings of `rigidformer_lab.shell` and `.soft`. Sheets and cubes, their materials, patches, points
and meshes are drawn as there, and files have the same fields; what is said here is what differs.

ball-on-shell: a free, rigid ball falls after the sheet, hits it where it lies over the sphere and rolls off. Sheet and ball push
each other. The sheet's units come first, then the sphere, then the ball. The seed draws besides, uniformly: the ball's radius,
.08 to .15 m; the logarithm of its mass, .1 to .5 kg (the sheet has .1 to .73 kg); its friction, .2 to .8, with the sheet the
product of theirs; where its middle is over the sphere's, up to .12 m away; the height of its lowest point over the highest vertex
of the sheet, .1 to .5 m. It starts at rest. Its contacts with the ground and the sphere have a time constant of 5 ms, half that
of all others, or it would go deep into the ground.

shell-on-two: a sheet falls on two fixed bodies that stand side by side on the ground, the middle between their middles at the
origin: a sphere, and another sphere or, as often, a box. The seed draws the radii of spheres, .15 to .25 m; half the edges of the
box, .1 to .18 m along each of its sides and .12 to .22 m upwards; its turn about the vertical, any; the gap between a sphere and
what the other body reaches to in any turn, .02 to .15 m; the direction from one to the other, any.

soft-on-ramp: the soft cube falls on a tilted plane through the origin. The seed draws its slope, 10 to 30 degrees, and in which
direction it goes down, any. The cube starts 2 m up the slope, so that it is not out of reach at the end; the height of its lowest
vertex is that over the plane.

A ball that goes deeper than 12 mm into the ground or the sphere is drawn anew, as vertices are. An interrupted run continues where
it stopped.
"""

from __future__ import annotations

import sys

import numpy as np

from .. import bullet, shell, soft_cube
from ..shell import SOLID_KG_M3, Solid, ball
from ..trials import parser_of
from ..wrecking import SPLITS

FALLING_RADIUS_M, FALLING_KG, FALLING_AWAY_M, FALLING_ABOVE_M = (0.08, 0.15), (0.1, 0.5), 0.12, (0.1, 0.5)
PAIR_RADIUS_M, GAP_M = (0.15, 0.25), (0.02, 0.15)
BOX_LOW_M, BOX_HIGH_M = (0.1, 0.1, 0.12), (0.18, 0.18, 0.22)  # half its edges
SLOPE_RAD, UPHILL_M = np.radians((10, 30)), 2.0


def around(rng: np.random.Generator) -> np.ndarray:
    """(2): any horizontal direction."""
    angle = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(angle), np.sin(angle)])


class BallOnShell(shell.Recipe):
    dataset, program, uses = "ball-on-shell", "research.unseen ball-on-shell", (shell.__name__,)
    what = "a sheet of cloth falls on a sphere, and a ball on the sheet."
    draws = 93

    def solids(self, rng: np.random.Generator) -> list[Solid]:
        [sphere] = super().solids(rng)
        radius, kg = rng.uniform(*FALLING_RADIUS_M), np.exp(rng.uniform(*np.log(FALLING_KG)))
        friction = rng.uniform(*shell.FRICTION)
        place = np.array([*(FALLING_AWAY_M * rng.random() ** 0.5 * around(rng)), radius + rng.uniform(*FALLING_ABOVE_M)])
        return [sphere, Solid("ball", (radius,), place, kg, friction=friction, free=True)]


class ShellOnTwo(shell.Recipe):
    dataset, program, uses = "shell-on-two", "research.unseen shell-on-two", (shell.__name__,)
    what = "a sheet of cloth falls on two bodies."
    draws = 94

    def solids(self, rng: np.random.Generator) -> list[Solid]:
        first, second, half = rng.uniform(*PAIR_RADIUS_M), rng.uniform(*PAIR_RADIUS_M), rng.uniform(BOX_LOW_M, BOX_HIGH_M)
        heading, is_box = rng.uniform(0, np.pi), rng.random() < 0.5
        reach = np.hypot(*half[:2]) if is_box else second
        there = (first + reach + rng.uniform(*GAP_M)) / 2 * around(rng)
        sphere = ball("sphere", first, -there)
        if not is_box:
            return [sphere, ball("sphere-2", second, there)]
        return [sphere, Solid("box", tuple(half), np.array([*there, half[2]]), 8 * half.prod() * SOLID_KG_M3, heading)]


class SoftOnRamp(soft_cube.Recipe):
    dataset, program, uses = "soft-on-ramp", "research.unseen soft-on-ramp", (soft_cube.__name__,)
    what = "a soft cube falls on a slope."
    draws = 95

    def ground(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        slope, down = rng.uniform(*SLOPE_RAD), around(rng)
        normal = np.array([*(np.sin(slope) * down), np.cos(slope)])
        return normal, -UPHILL_M * np.array([*(np.cos(slope) * down), -np.sin(slope)])


KINDS = {BallOnShell.dataset: (BallOnShell, shell.FRAMES), ShellOnTwo.dataset: (ShellOnTwo, shell.FRAMES),
         SoftOnRamp.dataset: (SoftOnRamp, soft_cube.FRAMES)}  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    parser = parser_of("research.unseen", __doc__, None, f"{shell.FRAMES}, of cubes {soft_cube.FRAMES}")
    parser.add_argument("kind", choices=KINDS, help="what happens in the scenes")
    options = parser.parse_args(arguments)
    recipe, frames = KINDS[options.kind]
    options.frames = frames if options.frames is None else options.frames
    bullet.check_seeds(parser, options)
    made = recipe(options.first_seed, options.seeds, options.frames, SPLITS["test"])
    return bullet.run(made, options.out, options.workers, options.dask)


if __name__ == "__main__":
    sys.exit(main())
