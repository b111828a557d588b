"""Environments for reinforcement learning: a stick pushes a cube to the middle. Needs gymnasium.

All copies step together (``BatchSimulator.copies``), and each goes on bit for bit as it would alone. One that has ended is put
somewhere else alone.

    python push_env.py 4096    # prints steps of single copies a second
"""

from __future__ import annotations

import sys
import time

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

import rigidformer as rf

DT_S = 1 / 24
MOST_STEPS = 100
NEAR_M = 0.02
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
REST = np.array([[0, 0, 0.025, 1, 0, 0, 0], [0.1, 0, 0.02, 1, 0, 0, 0]], np.float32)
OBSERVATION = gymnasium.spaces.Box(-10, 10, (6,), np.float32)  # cube x, y, sine and cosine of its yaw; stick x, y
ACTION = gymnasium.spaces.Box(-0.3, 0.3, (2,), np.float32)  # the stick's velocity, m/s


class PushVectorEnv(VectorEnv):
    """``num_envs`` cubes, each with its stick."""

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(self, num_envs: int, model: str = "nano"):
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = OBSERVATION, ACTION
        self.observation_space = batch_space(OBSERVATION, num_envs)
        self.action_space = batch_space(ACTION, num_envs)
        units = [rf.Unit(0.025 * CORNERS, 0.1), rf.Unit(0.01 * CORNERS, 0.1, role="driven")]
        start = rf.Start(DT_S, units, REST, REST, planes=[rf.Plane([0, 0, 1])])
        self.copies = rf.BatchSimulator(rf.Model(model)).copies(start, num_envs)
        self.poses = self.copies.poses()
        self.steps = np.zeros(num_envs, int)
        self.done = np.zeros(num_envs, bool)

    def _begin(self, which: np.ndarray) -> None:
        """Puts cubes somewhere around the middle, at rest, and sticks beyond them."""
        count = int(which.sum())
        angle = self.np_random.uniform(-np.pi, np.pi, count)
        way = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        poses = np.tile(REST, (count, 1, 1))
        for unit, distance in ((0, self.np_random.uniform(0.1, 0.2, count)), (1, 0.3)):
            poses[:, unit, :2] = way * np.reshape(distance, (-1, 1))
        self.copies.set_poses(which, poses, poses)
        self.poses[which] = poses
        self.steps[which], self.done[which] = 0, False

    def reset(self, *, seed=None, options=None):
        if seed is not None or self._np_random is None:
            self._np_random, self._np_random_seed = gymnasium.utils.seeding.np_random(seed)
        self._begin(np.ones(self.num_envs, bool))
        return self._observation(), {}

    def step(self, actions):
        begun = self.done.copy()
        targets = self.poses[:, 1].copy()
        targets[:, :2] += DT_S * np.clip(actions, ACTION.low, ACTION.high)
        went = self.copies.step(targets={1: targets})
        self.copies.poses(self.poses)
        self.steps += 1
        distance = np.linalg.norm(self.poses[:, 0, :2], axis=1)
        terminated = (distance < NEAR_M) & ~begun
        # A copy whose prediction fails begins anew, as one that takes too long does.
        truncated = ((self.steps >= MOST_STEPS) | ~went) & ~terminated & ~begun
        rewards = np.where(begun, 0.0, -distance)
        # Copies that ended a step ago begin now: their action is of no effect.
        self._begin(begun)
        self.done = terminated | truncated
        return self._observation(), rewards, terminated, truncated, {}

    def _observation(self) -> np.ndarray:
        cube, stick = self.poses[:, 0], self.poses[:, 1]
        w, x, y, z = cube[:, 3:].T
        sine, cosine = 2 * (w * z + x * y), 1 - 2 * (y * y + z * z)
        seen = np.column_stack([cube[:, :2], sine, cosine, stick[:, :2]])
        return np.clip(seen, OBSERVATION.low, OBSERVATION.high).astype(np.float32)


class PushEnv(gymnasium.Env):
    """One of them."""

    observation_space, action_space = OBSERVATION, ACTION

    def __init__(self, model: str = "nano"):
        self.copies = PushVectorEnv(1, model)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        observation, info = self.copies.reset(seed=seed)
        return observation[0], info

    def step(self, action):
        observation, reward, terminated, truncated, info = self.copies.step(np.reshape(action, (1, 2)))
        return observation[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), info


def main() -> None:
    copies, steps = int(sys.argv[1]) if len(sys.argv) > 1 else 4096, 10
    env = PushVectorEnv(copies)
    env.reset(seed=1)
    env.step(env.action_space.sample())
    begin = time.perf_counter()
    for _ in range(steps):
        env.step(env.action_space.sample())
    seconds = time.perf_counter() - begin
    print(f"{copies} copies: {copies * steps / seconds:,.0f} steps of single copies a second")


if __name__ == "__main__":
    main()
