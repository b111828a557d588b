"""Steps of the pushing environment a second, beside MuJoCo's own threads on the same task, in turns: all sticks push their cubes
towards the middle. Needs mujoco and gymnasium.

    python push.py --copies 4096 --turns 7
"""

from __future__ import annotations

import argparse
import os
import pathlib
import statistics
import sys
import time

import mujoco
import numpy as np
from mujoco import rollout

sys.path.insert(0, str(pathlib.Path(__file__).parents[1] / "examples"))
import push_env

# The cube and the stick of the example; the stick goes as fast as it is told.
SCENE = """
<mujoco>
  <option timestep="{step}" integrator="implicitfast"/>
  <worldbody>
    <geom type="plane" size="5 5 .1" friction=".5"/>
    <body pos="0 0 .025">
      <freejoint/>
      <geom type="box" size=".025 .025 .025" mass=".1" friction=".5"/>
    </body>
    <body pos="0 0 .021">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="y" type="slide" axis="0 1 0"/>
      <geom type="box" size=".01 .01 .01" mass="1" friction=".5"/>
    </body>
  </worldbody>
  <actuator><velocity joint="x" kv="50"/><velocity joint="y" kv="50"/></actuator>
</mujoco>
"""


def actions_of(sticks: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """At the greatest speed towards the middle, about."""
    way = -sticks / np.maximum(np.linalg.norm(sticks, axis=1, keepdims=True), 1e-3)
    return np.clip(0.3 * way + random.normal(scale=0.02, size=way.shape), -0.3, 0.3).astype(np.float32)


class Ours(push_env.PushVectorEnv):
    """The example as it is."""

    def sticks(self) -> np.ndarray:
        return self.poses[:, 1, :2]


class MuJoCo:
    """As many cubes, each with its stick: a step of the environment is so many of MuJoCo's."""

    def __init__(self, copies: int, threads: int, step_s: float):
        self.model = mujoco.MjModel.from_xml_string(SCENE.format(step=step_s))
        self.substeps = round(push_env.DT_S / step_s)
        self.data = [mujoco.MjData(self.model) for _ in range(threads)]
        self.pool = rollout.Rollout(nthread=threads)
        size = mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        self.state = np.zeros((copies, size))
        self.copies, self.random = copies, np.random.default_rng(1)
        self.steps = np.zeros(copies, int)
        self.begin(np.ones(copies, bool))

    def begin(self, which: np.ndarray) -> None:
        """As the example begins: a cube around the middle, its stick beyond it."""
        angle = self.random.uniform(-np.pi, np.pi, which.sum())
        way = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        rows = np.zeros((len(angle), self.state.shape[1]))
        rows[:, 1:3] = way * self.random.uniform(0.1, 0.2, (len(angle), 1))
        rows[:, 3:5] = 0.025, 1
        rows[:, 8:10] = way * 0.3
        self.state[which], self.steps[which] = rows, 0

    def sticks(self) -> np.ndarray:
        return self.state[:, 8:10]

    def step(self, actions: np.ndarray) -> None:
        control = np.repeat(actions[:, None].astype(float), self.substeps, axis=1)
        states, _ = self.pool.rollout(self.model, self.data, self.state, control)
        self.state = states[:, -1]
        self.steps += 1
        cube = self.state[:, 1:3]
        self.begin((np.linalg.norm(cube, axis=1) < push_env.NEAR_M) | (self.steps >= push_env.MOST_STEPS))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--copies", type=int, default=4096)
    parser.add_argument("--turns", type=int, default=7)
    parser.add_argument("--steps", type=int, default=10, help="of the environment, a turn")
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="of MuJoCo")
    arguments = parser.parse_args()
    count = arguments.copies
    ours = Ours(count)
    ours.reset(seed=1)
    sides = {"RigidFormer, nano": ours}
    for step_s in (0.002, 0.005):
        sides[f"MuJoCo {mujoco.__version__}, {1000 * step_s:g} ms"] = MuJoCo(count, arguments.threads, step_s)
    seconds: dict[str, list[float]] = {name: [] for name in sides}
    random = np.random.default_rng(2)
    for turn in range(arguments.turns + 1):
        for name, side in sides.items():
            taken = 0.0
            for _ in range(arguments.steps):
                actions = actions_of(side.sticks(), random)
                begin = time.perf_counter()
                side.step(actions)
                taken += time.perf_counter() - begin
            # The first turn wakes threads up.
            if turn:
                seconds[name].append(taken)
    for name, each in seconds.items():
        print(f"{name:24} {count * arguments.steps / statistics.median(each):>12,.0f} steps of single copies a second")


if __name__ == "__main__":
    main()
