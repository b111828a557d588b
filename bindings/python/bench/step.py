"""What a step costs from Python more than from Rust, on the embedded scene.

    cargo build --release -p rigidformer-runtime --example step
    python bindings/python/bench/step.py target/release/examples/step

The program is the Rust side: a loop around `World::step`. Both sides take the same steps from the same observation, in rounds that
take turns, so that what else the machine does meets both. The fastest turn is the one that nothing else disturbed.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import time

import numpy as np

import rigidformer as rf

STEPS = 11
ROUNDS = 10


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", help="the example `step` of rigidformer-runtime")
    parser.add_argument("--model", default="edge", choices=["edge", "nano"])
    parser.add_argument("--turns", type=int, default=100, help="of each round")
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    scene = rf.Dataset.embedded().scene(0)
    world = rf.World(rf.Model(options.model), threads=options.threads)
    world.gravity_m_s2 = scene.gravity_m_s2
    units, poses = scene.units, scene.poses
    out = np.zeros((len(units), 7), np.float32)
    command = [options.program, options.model, str(options.turns), str(options.threads)]
    rust: list[float] = []
    python: list[float] = []
    read: list[float] = []
    inside: list[float] = []
    for _ in range(ROUNDS):
        said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        rust += [float(line) for line in said.split()]
        for _ in range(options.turns):
            for times in (python, read, inside):
                world.observe_poses(10 / scene.frame_rate_hz, units, poses[0], poses[10])
                begin = time.perf_counter()
                if times is inside:
                    world.step(STEPS)
                else:
                    for _ in range(STEPS):
                        world.step()
                        if times is read:
                            world.poses(out)
                times.append(1e6 * (time.perf_counter() - begin) / STEPS)
    print(f"{options.model}, {len(units)} units, {options.threads} threads, {len(rust)} turns of {STEPS} steps")
    print("us a step: fastest turn (against the Rust program), median turn (against it)")
    for name, times in [
        ("Rust program", rust),
        ("world.step(11)", inside),
        ("world.step()", python),
        ("world.step(), poses(out)", read),
    ]:
        cells = [(figure(times), figure(rust)) for figure in (min, statistics.median)]
        print(f"{name:25}", *(f"{ours:8.2f} ({ours - base:+.2f})" for ours, base in cells))


if __name__ == "__main__":
    main()
