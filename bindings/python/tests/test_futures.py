"""Futures and planners."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

import rigidformer as rf
from conftest import MODELS, at, cube

REST = [at(z=1.5)]


def start(role: str = "free") -> rf.Start:
    return rf.Start(1 / 24, [rf.Unit(cube(), role=role)], REST, REST)


def test_a_future_is_what_a_world_predicts(edge, scene):
    world = rf.World(edge)
    world.gravity_m_s2 = scene.gravity_m_s2
    if scene.planes is not None:
        world.planes = scene.planes
    world.observe_poses(10 / scene.frame_rate_hz, scene.units, scene.poses[0], scene.poses[10])
    futures = rf.BatchSimulator(edge).run(rf.Start.of_scene(scene), 3, 6)
    expected = world.rollout(6)
    assert futures.ends == [None] * 3 and (futures.steps == 6).all()
    for poses in futures.poses:
        assert (poses == expected).all()


def test_velocities_pushes_and_physics(nano):
    velocities = np.zeros((3, 1, 6), np.float32)
    velocities[:, 0, 0] = [0, 1, 2]
    simulator = rf.BatchSimulator(nano)
    moved = simulator.run(start(), 3, 4, velocities=velocities).poses[:, -1, 0, 0]
    assert np.allclose(moved, [0, 1 / 6, 2 / 6], atol=1e-4)
    pushed = simulator.run(start(), 3, 4, pushes=velocities).poses[:, -1, 0, 0]
    assert np.allclose(moved, pushed, atol=1e-5)
    physics = np.ones((3, 1, 3), np.float32)
    physics[1, 0, 0] = -1
    ends = simulator.run(start(), 3, 4, physics=physics).ends
    assert ends[0] is None and ends[2] is None and "mass" in ends[1]


def test_targets_of_driven_units(nano):
    targets = np.tile(at(z=1.5), (2, 3, 1))
    targets[1, :, 0] = [0.1, 0.2, 0.3]
    futures = rf.BatchSimulator(nano).run(start("driven"), 2, 3, targets={0: targets})
    assert (futures.poses[:, :, 0] == targets).all()
    wrong = rf.BatchSimulator(nano).run(start(), 2, 3, targets={0: targets})
    assert all("not driven" in end for end in wrong.ends)


def test_commands_differ(nano):
    robot = rf.Model(MODELS / "g1.rfm")
    begin = rf.Start(1 / 3, [rf.Unit(cube())], REST, REST, command=[0, 0, 0])
    commands = np.zeros((2, 3, 3), np.float32)
    commands[1, :, 0] = 0.8
    futures = rf.BatchSimulator(robot).run(begin, 2, 3, commands=commands)
    assert (futures.poses[0] != futures.poses[1]).any()
    with pytest.raises(rf.InputError, match="commands"):
        rf.BatchSimulator(robot).run(begin, 2, 3, commands=commands[:, :, :2])
    with pytest.raises(rf.InputError):
        rf.BatchSimulator(robot).run(start(), 2, 3)  # without a command to begin with


def test_starts_and_sizes_that_cannot_be(nano, scene):
    simulator = rf.BatchSimulator(nano)
    with pytest.raises(rf.InputError, match="velocities"):
        simulator.run(start(), 2, 3, velocities=np.zeros((2, 2, 6)))
    with pytest.raises(rf.InputError, match="ask for fewer"):
        simulator.run(start(), 2**40, 2**30)
    for futures in (0, 2):
        with pytest.raises(ValueError, match="^steps is 0; give at least 1$"):
            simulator.run(start(), futures, 0)
    none = np.zeros((0, 7))
    with pytest.raises(ValueError, match="^start.units is 0; give at least 1$"):
        simulator.run(rf.Start(1 / 24, [], none, none), 2, 3)
    with pytest.raises(rf.InputError, match="quaternion"):
        simulator.run(rf.Start(1 / 24, [rf.Unit(cube())], np.zeros((1, 7)), REST), 1, 1)
    with pytest.raises(rf.InputError, match="current"):
        rf.Start(1 / 24, [rf.Unit(cube())], REST, REST + REST)
    for step, frame in [(0, None), (10, 5), (10, 10**6)]:
        with pytest.raises(rf.InputError, match="frame"):
            rf.Start.of_scene(scene, step, frame=frame)
    assert len(simulator.run(start(), 0, 3)) == 0


def distance(parameters, poses):
    assert parameters.shape == (3,) and poses.shape[1:] == (1, 7)
    return float(np.linalg.norm(poses[:, 0, :3] - [0.3, 0, 1.4], axis=1).min())


def planner(**settings) -> rf.Planner:
    return rf.Planner([rf.Parameter(0, 2, -4, 4)] * 3, futures=32, iterations=3, steps=4, **settings)


def test_the_same_seed_gives_the_same_plan(edge):
    def plan(seed, threads):
        simulator = rf.BatchSimulator(edge, threads=threads)
        return planner(seed=seed).plan(simulator, start(), rf.Launch(0), distance)

    first, second, other = plan(1, 1), plan(1, 2), plan(2, 2)
    assert first.cost < 0.15 and first.cut is None and (first.iterations, first.futures) == (3, 96)
    assert (first.best == second.best).all() and (first.poses == second.poses).all()
    assert (first.best != other.best).any()


def test_a_planner_moves_on(nano):
    chosen = planner(method=rf.Mppi(0.1))
    simulator = rf.BatchSimulator(nano)
    plan = chosen.plan(simulator, start(), rf.Launch(0), distance)
    chosen.shift(0, 3)
    assert (chosen.mean == plan.mean).all()
    chosen.set_mean([1, 2, 3])
    assert (chosen.mean == [1, 2, 3]).all()
    chosen.propose([[0.5, 0.5, 0.5]])
    with pytest.raises(rf.InputError):
        chosen.set_mean([9, 9, 9])
    with pytest.raises(rf.InputError):
        chosen.shift(1, 2)
    late = chosen.plan(simulator, start(), rf.Launch(0), distance, deadline_s=60.0)
    assert late.cut is None


def test_plans_that_cannot_be(nano):
    simulator = rf.BatchSimulator(nano)
    with pytest.raises(ZeroDivisionError):
        planner().plan(simulator, start(), rf.Launch(0), lambda parameters, poses: 1 / 0)
    with pytest.raises(TypeError):
        planner().plan(simulator, start(), rf.Launch(0), lambda parameters, poses: "cheap")
    with pytest.raises(rf.InputError, match="none of 96"):
        planner().plan(simulator, start(), rf.Launch(0), lambda parameters, poses: float("nan"))
    with pytest.raises(rf.InputError, match="unit 7"):
        planner().plan(simulator, start(), rf.Launch(7), distance)
    with pytest.raises(rf.InputError, match="deadline"):
        planner().plan(simulator, start(), rf.Launch(0), distance, deadline_s=0.0)
    with pytest.raises(rf.InputError, match="deadline_s"):
        planner().plan(simulator, start(), rf.Launch(0), distance, deadline_s=-1.0)
    with pytest.raises(rf.InputError, match="is planning"):
        mine = planner()
        mine.plan(simulator, start(), rf.Launch(0), lambda parameters, poses: mine.mean[0])
    with pytest.raises(rf.InputError):
        rf.Planner([])
    with pytest.raises(rf.InputError, match="at most 16384 steps"):
        rf.Planner([rf.Parameter(0, 1)], steps=10**12)
    with pytest.raises(rf.InputError):
        rf.Planner([rf.Parameter(0, -1)])
    with pytest.raises(rf.InputError, match="temperature"):
        planner(method=rf.Mppi(0.0))
    with pytest.raises(rf.InputError, match="costs"):
        planner().plan_by(lambda samples: samples)
    with pytest.raises(ZeroDivisionError):
        planner().plan_by(lambda samples: 1 / 0)


def test_a_cost_may_predict_and_is_never_called_twice_at_once(nano):
    simulator, busy, threads = rf.BatchSimulator(nano, threads=2), [], set()

    def cost(parameters, poses):
        assert not busy
        busy.append(parameters)
        threads.add(threading.get_ident())
        simulator.run(start(), 2, 2)
        time.sleep(0.001)  # another thread may run meanwhile
        busy.clear()
        return float(np.linalg.norm(poses[-1, 0, :3] - [0.3, 0, 1.4]))

    planner = rf.Planner([rf.Parameter(0, 2)] * 3, futures=32, iterations=2, steps=4)
    plan = planner.plan(simulator, start(), rf.Launch(0), cost)
    assert plan.futures == 64 and len(threads) == 1
