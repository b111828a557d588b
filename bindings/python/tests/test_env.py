"""Futures that begin where each is, copies that go on, and the environments of the example."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

import rigidformer as rf
from conftest import MODELS, ROOT, at, cube, needed
from test_state import WORLDS


def test_futures_begin_where_each_is(nano):
    start = rf.Start(1 / 24, [rf.Unit(cube())], [at(z=1)], [at(z=1)])
    simulator = rf.BatchSimulator(nano)
    current = np.stack([[at(x, 0, 1 + x)] for x in (0, 0.5, 2)])
    previous = current.copy()
    previous[:, :, 0] -= 0.05
    all_at_once = simulator.run(start, 3, 4, previous=previous, current=current)
    for index in range(3):
        alone = rf.Start(1 / 24, [rf.Unit(cube())], previous[index], current[index])
        assert (simulator.run(alone, 1, 4).poses[0] == all_at_once.poses[index]).all()
    # A step after the other is the same, so a loop may reset any of them between.
    before, now = previous, current
    for step in range(4):
        before, now = now, simulator.run(start, 3, 1, previous=before, current=now).poses[:, 0]
        assert np.abs(now - all_at_once.poses[:, step]).max() < 1e-3
    with pytest.raises(rf.InputError, match="both or none"):
        simulator.run(start, 3, 1, previous=previous)
    with pytest.raises(rf.InputError, match="current has shape"):
        simulator.run(start, 3, 1, previous=previous, current=current[:2])


def heap(count: int, model: str = "nano", **engine) -> rf.Copies:
    """Copies of two cubes, one above the other, and a driven one."""
    units = [rf.Unit(cube(0.1)), rf.Unit(cube(0.1)), rf.Unit(cube(0.1), role="driven")]
    poses = [at(z=0.3), at(0.05, 0, 0.6), at(2, 0, 1)]
    start = rf.Start(1 / 24, units, poses, poses, planes=[rf.Plane([0, 0, 1])], gravity_m_s2=[0, 0, -9])
    return rf.BatchSimulator(rf.Model(model), **engine).copies(start, count)


def targets(copies: rf.Copies, step: int) -> dict:
    goal = np.tile(at(2, 0, 1), (len(copies), 1))
    goal[:, 0] += 0.01 * (step + 1)
    return {2: goal}


@pytest.mark.parametrize("engine", [{}, {"threads": 1}, {"threads": 2, "kernel": "portable"}])
def test_copies_go_on_as_the_scene_alone(engine):
    copies, alone = heap(70, **engine), heap(1, threads=1)
    pushed = np.zeros((1, 3, 6), np.float32)
    pushed[0, 0, 0] = 0.5
    copies.set_velocities([69], pushed)
    alone.set_velocities([0], pushed)
    others = heap(1, threads=1)
    for step in range(6):
        for each in (copies, alone, others):
            assert each.step(targets=targets(each, step)).all() and each.problems == {}
    assert copies.snapshot(69) == alone.snapshot(0) != others.snapshot(0)
    assert all(copies.snapshot(copy) == others.snapshot(0) for copy in (0, 33, 68))
    assert (copies.poses()[69] == alone.poses()[0]).all()
    assert (copies.velocities()[5] == others.velocities()[0]).all()
    out = np.empty((70, 3, 7), np.float32)
    assert copies.poses(out) is out and (out == copies.poses()).all()


def test_copies_begin_anew_alone():
    copies = heap(50)
    begun = copies.snapshot(0)
    for step in range(5):
        copies.step(targets=targets(copies, step))
    then, poses = copies.snapshot(7), copies.poses()
    mask = np.zeros(50, bool)
    mask[[3, 40]] = True
    for which in (mask, [3, 40], np.array([40, 3]), []):
        copies.reset(which)
        if len(which):
            assert copies.snapshot(3) == begun == copies.snapshot(40)
        assert (np.delete(copies.poses(), [3, 40], axis=0) == np.delete(poses, [3, 40], axis=0)).all()
    copies.restore(12, then)
    assert copies.snapshot(12) == then
    placed = np.stack([[at(k, 0, 2), at(k, 1, 2), at(k, 2, 2)] for k in range(2)])
    copies.set_poses(mask, placed, placed)
    assert np.abs(copies.poses()[mask] - placed).max() < 1e-6
    assert np.abs(copies.velocities()[mask][:, 2]).max() == 0
    copies.reset()
    assert all(copies.snapshot(copy) == begun for copy in range(50))


def test_units_of_single_copies_come_and_go():
    copies, without = heap(40, "edge"), rf.BatchSimulator(rf.Model("edge"))
    units, poses = [rf.Unit(cube(0.1)), rf.Unit(cube(0.1), role="driven")], [at(0.05, 0, 0.6), at(2, 0, 1)]
    start = rf.Start(1 / 24, units, poses, poses, planes=[rf.Plane([0, 0, 1])], gravity_m_s2=[0, 0, -9])
    without = without.copies(start, 1)
    out = np.full((2, 1, 7), np.nan)
    copies.set_poses([7, 39], out, out, units=[0])
    goal = targets(copies, 0)[2]
    goal[5] = np.nan  # no target
    for step in range(8):
        assert copies.step(targets={2: goal}).all() and without.step(targets={1: goal[:1]}).all()
        for copy in (7, 39):
            assert (copies.poses()[copy, 1:] == without.poses()[0]).all()
            assert (copies.velocities()[copy, 1:] == without.velocities()[0]).all()
    gone = np.isnan(copies.poses())
    assert gone[[7, 39], 0].all() and gone.sum() == 14
    assert np.isnan(copies.velocities()).sum() == 12
    copies.set_velocities([7], copies.velocities()[[7]])
    then = copies.snapshot(7)
    back = np.array([[at(0, 0, 3)]])
    copies.set_poses([7], back, back, units=[0])
    copies.set_velocities([7], [[[1, 0, 0, 0, 0, 0]]], units=[0])
    copies.step()
    assert np.allclose(copies.poses()[7, 0, :3], [1 / 24, 0, 3 - 9 / 24**2 / 2], atol=1e-3)
    copies.restore(7, then)
    copies.reset([39])
    assert np.isnan(copies.poses()[7, 0]).all() and not np.isnan(copies.poses()[39]).any()
    assert copies.snapshot(39) == heap(1, "edge").snapshot(0)
    with pytest.raises(rf.InputError, match="no unit 3 of 3"):
        copies.set_poses([7], back, back, units=[3])
    with pytest.raises(rf.InputError, match="^units is"):
        copies.set_velocities([7], np.zeros((1, 1, 6)), units=[-1])
    hand = rf.World(rf.Model("nano"), units=2, points=16)
    hand.dt_s = 1 / 24
    pair = [hand.add(rf.Unit(cube(0.1), body=1), at(x, 0, 1)) for x in (0, 0.2)]
    hand.join(pair[1], pair[0], [-0.1, 0, 0], [0.1, 0, 0])
    joined = rf.BatchSimulator(rf.Model("nano")).copies(hand.start(), 2)
    with pytest.raises(rf.InputError, match="hangs together"):
        joined.set_poses([0], out[:1], out[:1], units=[0])


def test_copies_and_futures_are_counted_before_memory_is_taken(nano):
    start = rf.Start(1 / 24, [rf.Unit(cube())], [at(z=1)], [at(z=1)])
    small = rf.BatchSimulator(nano, memory=1 << 22)
    assert len(small.copies(start, 20)) == 20
    for call in (lambda: small.copies(start, 65_536), lambda: small.run(start, 10_000, 10)):
        with pytest.raises(MemoryError, match=r"\d{7} bytes.* 4194304; ask for fewer, or .*memory=") as error:
            call()
        assert isinstance(error.value, rf.MemoryLimitError) and isinstance(error.value, rf.InputError)
    units = [rf.Unit(cube(), body=k) for k in range(8)]
    many = rf.Start(1 / 24, units, [at(k, 0, 1) for k in range(8)], [at(k, 0, 1) for k in range(8)])
    with pytest.raises(rf.MemoryLimitError, match=str(4 << 30)):
        rf.BatchSimulator(nano).copies(many, 65_536)
    with pytest.raises(rf.MemoryLimitError):
        rf.BatchSimulator(nano).run(start, 10**12, 10**6)
    with pytest.raises(rf.MemoryLimitError):
        rf.World(nano, units=10**9, points=10**12)


@pytest.mark.parametrize("kind", ["edge", "nano", "joints", "bonds"])
def test_futures_copies_and_planners_start_from_worlds(kind):
    world = WORLDS[kind]()
    model = rf.Model(MODELS / "fragments.rfm" if kind == "bonds" else {"joints": "edge"}.get(kind, kind))
    world.planes = [rf.Plane([0, 0, 1], 0.05), rf.Plane([-1, 0, 0], -3)]
    world.gravity_m_s2 = [0, 0.5, -9]
    start, before = world.start(), world.snapshot()
    assert repr(start).startswith(f"Start({len(world)} units") and start.dt_s == world.dt_s
    simulator = rf.BatchSimulator(model)
    futures, copies = simulator.run(start, 9, 12), simulator.copies(start, 5)
    planner = rf.Planner([rf.Parameter(0, 0)] * 3, method=rf.Mppi(1), futures=3, iterations=1, steps=12)
    # A command of none: the action changes nothing.
    plan = planner.plan(simulator, start, rf.Commands(0), lambda parameters, poses: 0.0)
    assert world.snapshot() == before
    alone = world.rollout(12)
    assert (futures.poses == alone).all() and futures.ends == [None] * 9
    for step in range(12):
        copies.step()
        assert (copies.poses() == alone[step]).all()
    assert (plan.poses == alone).all()
    pushed = simulator.run(start, 2, 3, noise=rf.VelocityNoise(1, 0.1))
    assert (pushed.poses[0] != pushed.poses[1]).any()
    with pytest.raises(rf.InputError, match="another model"):
        rf.BatchSimulator(rf.Model(MODELS / "soft.rfm")).run(start, 1, 1)


def test_copies_that_cannot_be(nano):
    copies = heap(4)
    before = [copies.snapshot(copy) for copy in range(4)]
    poses = np.tile(copies.poses()[:1], (2, 1, 1))
    bad = poses.copy()
    bad[1, 2, 0] = np.nan
    start = rf.Start(1 / 24, [rf.Unit(cube())], [at(z=1)], [at(z=1)])
    for call, text in (
        (lambda: copies.set_poses([0, 1], bad, bad), "unit 2"),
        (lambda: copies.set_poses([0, 0], bad, bad), "unit 2"),
        (lambda: copies.set_poses([0, 4], poses, poses), "copy 4 of 4"),
        (lambda: copies.set_poses([0], poses, poses), "shape"),
        (lambda: copies.set_velocities([0, 1], np.full((2, 3, 6), np.inf)), "unit"),
        (lambda: copies.reset([-1]), "^which is "),
        (lambda: copies.reset(4), "which"),
        (lambda: copies.reset([0.5]), "which"),
        (lambda: copies.reset(np.zeros(3, bool)), "which has shape"),
        (lambda: copies.reset(np.zeros((2, 2), bool)), "which has shape"),
        (lambda: copies.restore(0, before[0][:-4]), "snapshot"),
        (lambda: copies.restore(4, before[0]), "copy 4 of 4"),
        (lambda: copies.restore(0, heap(2).snapshot(0) + b"0000"), "snapshot"),
        (lambda: copies.snapshot(-1), "^copy is -1"),
        (lambda: copies.step(targets={3: np.zeros((4, 7))}), "no unit 3 of 3"),
        (lambda: copies.step(targets={2: np.zeros((3, 7))}), "targets has shape"),
        (lambda: copies.step(commands=np.zeros((4, 1))), "commands has shape"),
        (lambda: rf.BatchSimulator(nano).copies(start, 0), "0 copies"),
        (lambda: rf.BatchSimulator(nano).copies(start, 10**9), "copies"),
        (lambda: rf.BatchSimulator(nano).copies(start, -1), "^count is -1"),
    ):
        with pytest.raises(rf.InputError, match=text):
            call()
    assert [copies.snapshot(copy) for copy in range(4)] == before
    # One copy's target cannot be: it stays where it was, and the others go on.
    goal = targets(copies, 0)[2]
    goal[1, 0] = np.nan
    assert copies.step(targets={2: goal}).tolist() == [True, False, True, True]
    assert list(copies.problems) == [1] and copies.snapshot(1) == before[1]
    assert copies.snapshot(0) == copies.snapshot(3) != before[0]
    free = np.tile(at(), (4, 1))
    assert not copies.step(targets={0: free}).any() and "driven" in copies.problems[3]


def environments():
    needed("gymnasium")
    path = ROOT / "bindings" / "python" / "examples" / "push_env.py"
    spec = importlib.util.spec_from_file_location("push_env", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.filterwarnings("ignore")
def test_gymnasium_checks_the_environment():
    module = environments()
    from gymnasium.utils.env_checker import check_env

    check_env(module.PushEnv(), skip_render_check=True)


@pytest.mark.filterwarnings("ignore")
def test_copies_are_reset_alone():
    module = environments()
    env = module.PushVectorEnv(16)
    first, _ = env.reset(seed=3)
    assert (env.reset(seed=3)[0] == first).all()
    env.steps[:4] = module.MOST_STEPS - 1
    still = np.zeros((16, 2), np.float32)
    _, _, _, truncated, _ = env.step(still)
    assert truncated.tolist() == [True] * 4 + [False] * 12
    kept = env.poses[4:].copy()
    _, rewards, _, truncated, _ = env.step(still)
    assert (rewards[:4] == 0).all() and not truncated.any()
    assert (env.steps[:4] == 0).all() and (env.steps[4:] == 2).all()
    assert np.abs(env.poses[4:] - kept).max() < 0.05
