"""Planners that know what they plan: pushing and walking."""

from __future__ import annotations

import json
import subprocess

import numpy as np
import pytest

import rigidformer as rf
from conftest import MODELS, at, cube

RADIUS_M = 0.01
SEEN = np.array([at(z=0.025), at(x=0.1, y=0.02, z=0.02)])


def pushing(**settings) -> rf.PushPlanner:
    body, stick = rf.Unit(cube(0.025), 0.1), rf.Unit(cube(RADIUS_M), 0.1)
    planes = [rf.Plane([0, 0, 1], friction=1.0, restitution=0.0)]
    return rf.PushPlanner(body, stick, RADIUS_M, planes=planes, **settings)


def test_a_cube_is_pushed_to_its_place(edge):
    simulator = rf.BatchSimulator(edge)
    goal = rf.PushGoal([-0.08, 0.03])
    planner = pushing()
    previous = current = SEEN
    for _ in range(12):
        plan = planner.plan(simulator, previous, current, goal)
        if plan.cost > plan.stay - 1e-3:
            break
        path = plan.path_m[:24]
        targets = np.tile(current[1], (1, len(path), 1))
        targets[0, :, :2] = path
        units = [rf.Unit(cube(0.025), 0.1), rf.Unit(cube(RADIUS_M), 0.1, role="driven")]
        planes = [rf.Plane([0, 0, 1], friction=1.0, restitution=0.0)]
        start = rf.Start(planner.dt_s, units, previous, current, planes=planes)
        poses = simulator.run(start, 1, len(path), targets={1: targets}).poses[0]
        previous, current = np.concatenate([[current], poses])[-2:]
        planner.passed(plan, len(path))
    away, turned = goal.errors(current[0])
    assert away < 0.01 and turned < 0.2


def test_the_same_seed_gives_the_same_push(nano):
    def plan(seed, threads):
        simulator = rf.BatchSimulator(nano, threads=threads)
        return pushing(seed=seed).plan(simulator, SEEN, SEEN, rf.PushGoal([-0.06, 0]))

    first, second, other = plan(1, 1), plan(1, 2), plan(2, 2)
    assert (first.path_m == second.path_m).all() and (first.poses == second.poses).all()
    assert (first.search.best == second.search.best).all() and (first.search.best != other.search.best).any()
    assert first.search.best.tolist() == [first.heading_rad, first.offset_m, first.length_m]
    assert first.search.futures == 16 and first.search.cut is None and first.search.cost == first.cost
    # A prediction for each step of the push, and three more while the cube settles.
    assert first.poses.shape == (len(first.path_m) - first.approach + 3, 7)


def test_the_callers_cost(nano):
    simulator = rf.BatchSimulator(nano)
    goal = rf.PushGoal([-0.06, 0])
    seen = []

    def cost(push, seconds, poses):
        seen.append((push, seconds, poses))
        return np.hypot(*(poses[-1, :2] - [-0.06, 0]))

    plan = pushing().plan(simulator, SEEN, SEEN, goal, cost=cost)
    assert plan.stay == np.float32(0.06) and plan.cost < plan.stay
    assert all((poses[0] == SEEN[0]).all() for _, _, poses in seen)
    push, seconds, poses = seen[-1]
    assert (push == 0).all() and seconds == 0 and len(poses) == 1
    with pytest.raises(ZeroDivisionError):
        pushing().plan(simulator, SEEN, SEEN, goal, cost=lambda push, seconds, poses: 1 / 0)
    with pytest.raises(rf.InputError, match="is planning"):
        mine = pushing()
        mine.plan(simulator, SEEN, SEEN, goal, cost=lambda push, seconds, poses: mine.forget())


def test_pushes_that_cannot_be(nano):
    simulator = rf.BatchSimulator(nano)
    goal = rf.PushGoal([-0.06, 0])
    for settings, match in [
        ({"futures": 0}, "futures is 0"),
        ({"futures": 10**9}, "at most 65536"),
        ({"futures": 20_000, "settle_s": 166.0}, "steps of the longest push"),
        ({"settle_s": 1e30}, "of settling"),
        ({"dt_s": -1.0}, "^dt_s is -1"),
        ({"heading_rad": float("nan")}, "^heading_rad is NaN"),
        ({"offset": -1.0}, "^offset is -1"),
    ]:
        with pytest.raises(rf.InputError, match=match):
            pushing(**settings)
    stick, corners = rf.Unit(cube(RADIUS_M), body=3), cube(0.025)
    for body, match in [
        (rf.Unit(corners, role="fixed"), "is fixed"),
        (rf.Unit(corners, rest=corners, young_pa=1e4), "is soft"),
        (rf.Unit(corners, body=3), "of body 3"),
    ]:
        with pytest.raises(rf.InputError, match=match):
            rf.PushPlanner(body, stick, RADIUS_M)
    for numbers, match in [
        (([float("nan"), 0],), "place_m is NaN"),
        (([0, 2e6],), "place_m is 2000000"),
        (([0, 0], float("inf")), "yaw_rad is inf"),
    ]:
        with pytest.raises(rf.InputError, match=match):
            rf.PushGoal(*numbers)
    with pytest.raises(rf.InputError, match="haste_m_s is -1"):
        rf.PushGoal([0, 0], haste_m_s=-1)
    with pytest.raises(rf.InputError, match="previous"):
        pushing().plan(simulator, SEEN[:1], SEEN, goal)
    with pytest.raises(rf.InputError, match="deadline"):
        pushing().plan(simulator, SEEN, SEEN, goal, deadline_s=0.0)
    with pytest.raises(rf.InputError, match="place_m"):
        rf.PushGoal([1, 2, 3])
    for away, match in [(9e5, "no push gets to the body"), (np.nan, "pusher's previous pose is NaN"), (2e6, "up to 1e6")]:
        far = SEEN + np.array([[0] * 7, [away] + [0] * 6], np.float32)
        with pytest.raises(rf.InputError, match=match):
            pushing().plan(simulator, far, far, goal)
    line = rf.PushPlanner(rf.Unit([[x, 0, 0] for x in range(4)]), rf.Unit(cube(RADIUS_M)), RADIUS_M)
    with pytest.raises(rf.InputError, match="outline"):
        line.plan(simulator, SEEN, SEEN, goal)


@pytest.fixture(scope="module")
def robot() -> rf.Model:
    return rf.Model(MODELS / "g1.rfm")


@pytest.fixture(scope="module")
def walk() -> rf.Scene:
    """A robot of one part, seen in two frames."""
    poses = [[at(z=0.7)], [at(x=0.05, z=0.7)]]
    return rf.Scene([rf.Unit(cube(), 30.0)], poses, 3, planes=[rf.Plane([0, 0, 1])], commands=np.zeros((2, 3)))


def test_walks_are_those_of_the_example(robot, walk, walk_example, tmp_path):
    file = tmp_path / "walk.safetensors"
    walk.save(file, dataset="walk", provenance="by hand", licence="CC0-1.0")
    arguments = [file, "--model", MODELS / "g1.rfm", "--step", "1", "--to", "1,0.5", "--seed", "3"]
    arguments += ["--first", "0.5,0,0.1", "--json"]
    done = subprocess.run([walk_example, *map(str, arguments)], capture_output=True, text=True, check=True)
    told = json.loads(done.stdout)
    start = rf.Start.of_scene(walk, step=1)
    for threads in (1, 2):
        planner = rf.WalkPlanner(seed=3)
        planner.begin_with([[0.5, 0, 0.1]])
        plan = planner.plan(rf.BatchSimulator(robot, threads=threads), start, [1, 0.5])
        assert np.float32(told["cost_m"]) == plan.cost
        assert (np.float32(told["commands"]) == plan.search.best).all()
        assert plan.search.futures == 32 and plan.search.poses.shape == (9, 1, 7)
        assert (plan.path == plan.search.poses[:, 0]).all() and (plan.command == plan.search.best[:3]).all()


def test_a_walk_begins_with_what_is_left(robot, walk):
    simulator, start = rf.BatchSimulator(robot), rf.Start.of_scene(walk, step=1)
    planner = rf.WalkPlanner(commands=2, hold=2)
    planner.begin_with([[0.5, 0, 0]])
    first = planner.plan(simulator, start, [1, 0])
    planner.passed(1)
    second = planner.plan(simulator, start, [1, 0], 0.5)
    assert first.path.shape == second.path.shape == (4, 7)
    assert (first.command <= [0.9, 0.5, 1]).all() and (first.command >= [-0.7, -0.5, -1]).all()


def test_a_walk_that_is_forgotten_is_not_tried(robot, walk):
    simulator, start = rf.BatchSimulator(robot), rf.Start.of_scene(walk, step=1)
    commands = []
    for first in ([0.0, 0, 0], [0.9, 0.5, 1]):
        planner = rf.WalkPlanner(commands=2, hold=2)
        planner.begin_with([first])
        planner.forget()
        commands.append(planner.plan(simulator, start, [1, 0]).search.mean)
    assert (commands[0] == commands[1]).all()


def test_walks_that_cannot_be(nano, robot, walk):
    simulator, start = rf.BatchSimulator(robot), rf.Start.of_scene(walk, step=1)
    planner = rf.WalkPlanner()
    with pytest.raises(rf.InputError, match="walking robot"):
        planner.plan(rf.BatchSimulator(nano), start, [1, 0])
    with pytest.raises(rf.InputError, match="place"):
        planner.plan(simulator, start, [float("nan"), 0])
    with pytest.raises(rf.InputError, match="deadline"):
        planner.plan(simulator, start, [1, 0], deadline_s=0.0)
    with pytest.raises(rf.InputError, match="hold is 0"):
        rf.WalkPlanner(hold=0)
    with pytest.raises(rf.InputError, match="three a command"):
        rf.WalkPlanner(commands=10**9)
    for hold in (10**6, 2**63):
        with pytest.raises(rf.InputError, match="at most 16384 steps"):
            rf.WalkPlanner(hold=hold)
    with pytest.raises(rf.InputError):
        rf.WalkPlanner(low=[1, 1, 1], high=[0, 0, 0])
    with pytest.raises(rf.InputError, match="low is NaN"):
        rf.WalkPlanner(low=[np.nan] * 3, high=[np.nan] * 3)
    with pytest.raises(rf.InputError, match="quaternion"):
        none = rf.Start(1 / 3, [rf.Unit(cube())], np.zeros((1, 7)), np.zeros((1, 7)), command=np.zeros(3))
        planner.plan(simulator, none, [1, 0])
    with pytest.raises(rf.InputError, match="4 rows"):
        planner.begin_with(np.zeros((4, 3)))
    with pytest.raises(rf.InputError):
        planner.begin_with([[9, 9, 9]])
    with pytest.raises(rf.InputError, match="commands"):
        planner.begin_with([0.5, 0, 0])
