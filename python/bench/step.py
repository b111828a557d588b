"""What a step costs from Python more than from Rust, on the embedded scene: `python bench/step.py`.

`World.step(n)` loops in Rust, a `for` loop around `World.step()` in Python. Both take the same steps from the same observation in
turn, so that what else the machine does meets both. The figures are medians over the turns.
"""

from __future__ import annotations

import argparse
import statistics
import time

import numpy as np

import rigidformer as rf

STEPS = 11


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", default="edge")
    parser.add_argument("--turns", type=int, default=300)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    scene = rf.Dataset.embedded().scene(0)
    model = rf.Model(options.model)
    world = rf.World(model, threads=options.threads)
    world.gravity_m_s2 = scene.gravity_m_s2
    units, poses = scene.units, scene.poses
    out = np.zeros((len(units), 7), np.float32)
    turns: dict[str, list[float]] = {"Rust": [], "Python": [], "Python, poses read": []}
    for _ in range(options.turns):
        for name, times in turns.items():
            world.observe_poses(10 / scene.frame_rate_hz, units, poses[0], poses[10])
            begin = time.perf_counter()
            if name == "Rust":
                world.step(STEPS)
            elif name == "Python":
                for _ in range(STEPS):
                    world.step()
            else:
                for _ in range(STEPS):
                    world.step()
                    world.poses(out)
            times.append(1e6 * (time.perf_counter() - begin) / STEPS)
    print(f"{model!r}, {len(units)} units, {options.threads} threads, {options.turns} turns of {STEPS} steps")
    for name, times in turns.items():
        more = statistics.median(a - b for a, b in zip(times, turns["Rust"]))
        print(f"{name:20} {statistics.median(times):8.2f} us a step, {more:+6.2f} us against Rust")


if __name__ == "__main__":
    main()
