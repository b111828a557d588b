"""Python's side of step.rs: processor time of a step of a pile of cubes, for each line that is read.

    python step.py MODEL CUBES SIDE STEPS
"""

import sys
import time

import numpy as np
import rigidformer as rf

model, cubes, side, steps = sys.argv[1], *map(int, sys.argv[2:])
edge = np.float32(0.4) * np.arange(side, dtype=np.float32) / np.float32(side - 1) - np.float32(0.2)
points = np.stack(np.meshgrid(edge, edge, edge, indexing="ij"), axis=-1).reshape(-1, 3)
world = rf.World(rf.Model(model), units=cubes, points=cubes * len(points), threads=1)
world.dt_s = 1 / 24
unit = rf.Unit(points, mass_kg=1.0, friction=0.5, restitution=0.4)


def poses(i):
    """Where a cube is a step ago and now: x, y, z, then a quaternion with w first."""
    f = np.float32
    column, row = f(i % 3), f(i // 3)
    before = [f(0.45) * column, 0.05, f(0.25) + f(0.45) * row, 1, 0, 0, 0]
    now = [f(0.43) * column, 0.0, f(0.21) + f(0.42) * row, 1, 0, 0, 0]
    return before, now


ids = [world.add(unit, poses(i)[1]) for i in range(cubes)]
for _ in sys.stdin:
    # The first run fills the caches, as in step.rs.
    for _ in range(2):
        for i, cube in enumerate(ids):
            world.set_poses(cube, *poses(i))
        start = time.process_time()
        for _ in range(steps):
            world.step()
        taken = time.process_time() - start
    print(1e6 * taken / steps, flush=True)
