"""Makes scenes of a wrecking ball, after the WreckingBall scenes of the RigidFormer paper.

    python -m rigidformer_lab.wrecking --cubes 64 --seeds 100 --out wrecking-64.safetensors

From the paper: 27, 64, 125 or 216 cubes of 1 m, 1.05 m apart along all three axes, in a grid on the ground; 8 points a
cube, 43 the ball; 1000 kg/m3, friction 0.3, restitution 0.5; the ball at 30 m/s along +x at a height of U[2.5, 4.0] m; 600
frames.

Not in the paper, so chosen here: 240 frames a second; a ball of 1 m radius (4,189 kg) whose points are a spiral on its
surface; the ball starts 2 m before the first cubes (surface to face) and flies at the middle of the grid's width; friction
and restitution of the ground as those of the bodies; gravity 10 m/s2; ten engine steps a frame. So errors on these scenes
are not to be compared with the paper's: by frame 50 hardly a cube has moved by .6 m here. The lowest layer stands on
the ground, and the layers above fall 5 cm first. The seed draws the height alone. A tenth of the seeds is for tests, a tenth
for validation, as in `movi primitives`; `--split test` puts all of a file into the split for tests. An interrupted run
continues where it stopped.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import bullet, far
from .movi import FRAME_RATE_HZ, GOLDEN_ANGLE, GRAVITY_M_S2, _offsets
from .scenes import EXTRA, TEST, TRAIN, VALIDATION, Scenes, split_of_seed

SUB_STEPS = 10
EDGE_M, PITCH_M = 1.0, 1.05
DENSITY, FRICTION, RESTITUTION = 1000.0, 0.3, 0.5
BALL_RADIUS_M, BALL_POINTS = 1.0, 43
BALL_M_S, BALL_HEIGHT_M = 30.0, (2.5, 4.0)
BALL_AWAY_M = 2.0  # from its surface to the first cubes
BALL_KG = 4 / 3 * np.pi * BALL_RADIUS_M**3 * DENSITY
PUBLISHED_CUBES = (27, 64, 125, 216)
UNITS_PER_SHARD = 256
SPLITS = {"train": TRAIN, "validation": VALIDATION, "test": TEST, "extra": EXTRA}


def side_of(cubes: int) -> int:
    """Cubes along an edge of the grid; 0 for a number that is no cube."""
    side = round(cubes ** (1 / 3))
    return side if side**3 == cubes else 0


def shapes() -> tuple[np.ndarray, np.ndarray]:
    """Points of the cube, (8, 3), and of the ball, (43, 3)."""
    cube = np.array(np.meshgrid(*[(-0.5 * EDGE_M, 0.5 * EDGE_M)] * 3, indexing="ij")).reshape(3, -1).T
    index = np.arange(BALL_POINTS)
    z = 1 - (2 * index + 1) / BALL_POINTS
    across = np.sqrt(1 - z * z)
    ball = np.column_stack([across * np.cos(GOLDEN_ANGLE * index), across * np.sin(GOLDEN_ANGLE * index), z])
    return cube.astype(np.float32), (BALL_RADIUS_M * ball).astype(np.float32)


def grid(side: int) -> np.ndarray:
    """(cubes, 3) centres: about x = y = 0, the lowest layer on the ground."""
    steps = np.arange(side) * PITCH_M
    flat = steps - steps[-1] / 2
    return np.array(np.meshgrid(flat, flat, steps + EDGE_M / 2, indexing="ij")).reshape(3, -1).T


def simulate(cubes: int, seed: int, frames: int) -> np.ndarray:
    """Poses of the cubes and, last, the ball: (units, frames, 7)."""
    side = side_of(cubes)
    height = np.random.default_rng((seed, 77)).uniform(*BALL_HEIGHT_M)
    with bullet.engine(GRAVITY_M_S2, 1.0 / (FRAME_RATE_HZ * SUB_STEPS)) as (pb, on):
        bullet.add_plane(pb, on, (0, 0, 1, 0, FRICTION, RESTITUTION))
        box = pb.createCollisionShape(pb.GEOM_BOX, halfExtents=[EDGE_M / 2] * 3, **on)
        bodies = [bullet.add_body(pb, on, box, DENSITY * EDGE_M**3, FRICTION, RESTITUTION, place) for place in grid(side)]
        sphere = pb.createCollisionShape(pb.GEOM_SPHERE, radius=BALL_RADIUS_M, **on)
        face = (side - 1) * PITCH_M / 2 + EDGE_M / 2
        place = (-face - BALL_AWAY_M - BALL_RADIUS_M, 0.0, height)
        bodies.append(bullet.add_body(pb, on, sphere, BALL_KG, FRICTION, RESTITUTION, place))
        pb.resetBaseVelocity(bodies[-1], (BALL_M_S, 0, 0), (0, 0, 0), **on)
        poses = np.empty((len(bodies), frames, 7))
        for frame in range(frames):
            for unit, body in enumerate(bodies):
                poses[unit, frame] = bullet.pose_of(pb, on, body)
            for _ in range(SUB_STEPS if frame + 1 < frames else 0):
                pb.stepSimulation(**on)
    bullet.steady_signs(poses)
    return poses


@dataclass(frozen=True)
class Recipe:
    """What a run makes; see `movi.Recipe`."""

    cubes: int
    first_seed: int
    seeds: int
    frames: int
    split: int | None = None  # None: by seed

    @property
    def name(self) -> str:
        return f"wrecking-ball-{self.cubes}"

    @property
    def dataset(self) -> str:
        return self.name

    def shards(self) -> list[range]:
        end, size = self.first_seed + self.seeds, max(1, UNITS_PER_SHARD // (self.cubes + 1))
        return [range(seed, min(seed + size, end)) for seed in range(self.first_seed, end, size)]

    def description(self) -> dict:
        """What has to agree before a run may continue from existing shards."""
        code = hashlib.sha256(Path(__file__).read_bytes() + Path(bullet.__file__).read_bytes())
        return {"dataset": self.name, "first_seed": self.first_seed, "seeds": self.seeds, "frames": self.frames,
                "split": self.split, "code_sha256": code.hexdigest()}

    def split_of(self, seed: int) -> int:
        return split_of_seed("primitives", seed) if self.split is None else self.split

    def make(self, seeds: range) -> Scenes:
        """Simulates `seeds` one after the other."""
        points = shapes()
        units, count = self.cubes + 1, len(seeds)
        physics = [(DENSITY * EDGE_M**3, FRICTION, RESTITUTION)] * self.cubes + [(BALL_KG, FRICTION, RESTITUTION)]
        return Scenes(
            dataset=self.name,
            shape_names=["cube", "ball"],
            shape_points=np.concatenate(points),
            shape_offsets=_offsets([len(p) for p in points]),
            scene_seed=np.array(seeds, np.int64),
            scene_split=np.array([self.split_of(seed) for seed in seeds], np.uint8),
            scene_units=_offsets([units] * count),
            unit_shape=np.tile(np.array([0] * self.cubes + [1], np.int32), count),
            unit_scale=np.ones(units * count, np.float32),
            unit_physics=np.tile(np.array(physics, np.float32), (count, 1)),
            unit_poses=np.concatenate([simulate(self.cubes, seed, self.frames) for seed in seeds]).astype(np.float32),
            provenance="Generated by rigidformer_lab.wrecking with PyBullet 3.2.7 after the WreckingBall scenes of the "
                       f"RigidFormer paper. Chosen by the lab: {FRAME_RATE_HZ} Hz, ball radius {BALL_RADIUS_M:g} m, ball "
                       f"{BALL_AWAY_M:g} m before the first cubes, split.",
            licence="the licence of the rigidformer project",
            frame_rate_hz=FRAME_RATE_HZ,
            gravity_m_s2=GRAVITY_M_S2,
            ground_friction=FRICTION,
            ground_restitution=RESTITUTION,
        )


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m rigidformer_lab.wrecking", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="scene file to make")
    parser.add_argument("--cubes", type=int, default=64, help="a cube number; the paper has "
                        f"{', '.join(map(str, PUBLISHED_CUBES))} (default %(default)s)")
    parser.add_argument("--seeds", type=int, default=100, help="number of scenes (default %(default)s)")
    parser.add_argument("--first-seed", type=int, default=1, help="default %(default)s")
    parser.add_argument("--frames", type=int, default=600, help="frames a scene at 240 Hz (default %(default)s)")
    parser.add_argument("--split", choices=SPLITS, help="split of all scenes of the file (default: by seed)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (default: one a core)")
    far.add_argument(parser)
    options = parser.parse_args(arguments)
    bullet.check_seeds(parser, options)
    if not 1 <= options.cubes <= 1000 or not side_of(options.cubes):
        parser.error(f"--cubes {options.cubes}: the cubes fill a grid of k x k x k; give 1, 8, 27, 64, 125, 216, ... at most "
                     "1000")
    recipe = Recipe(options.cubes, options.first_seed, options.seeds, options.frames, SPLITS.get(options.split))
    return bullet.run(recipe, options.out, options.workers, options.dask)


if __name__ == "__main__":
    sys.exit(main())
