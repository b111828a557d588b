"""Futures that begin where each is, and the environments of the example."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

import rigidformer as rf
from conftest import ROOT, at, cube, needed


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
    kept = env.current[4:].copy()
    _, rewards, _, truncated, _ = env.step(still)
    assert (rewards[:4] == 0).all() and not truncated.any()
    assert (env.steps[:4] == 0).all() and (env.steps[4:] == 2).all()
    assert np.abs(env.current[4:] - kept).max() < 0.05
