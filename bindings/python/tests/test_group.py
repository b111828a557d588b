"""Groups: several worlds in one space."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import rigidformer as rf
from conftest import MODELS, at, cube

DT_S = 1 / 3


def robot(x, command=(0.3, 0, 0)):
    """Three links that walk under a command."""
    world = rf.World(rf.Model(MODELS / "g1.rfm"), units=16, points=256, threads=1)
    units = [rf.Unit(cube(half), mass_kg=mass, body=3) for half, mass in ((0.2, 30), (0.1, 5), (0.05, 1))]
    now = np.stack([at(x=x, z=z) for z in (0.9, 0.5, 0.05)])
    before = now - np.float32([0.1, 0, 0, 0, 0, 0, 0])
    world.observe_poses(DT_S, units, before, now)
    world.command(command)
    return world


def table(x):
    world = rf.World(rf.Model("edge"), units=16, points=256, threads=1)
    world.dt_s = DT_S
    world.add(rf.Unit(cube(0.1)), at(x=x, z=0.1))
    return world


def crowd(threads=None):
    group = rf.Group(threads=threads)
    for name, world in (("one", robot(0)), ("other", robot(0.6)), ("table", table(0.3))):
        group.add(name, world)
    group.set_neighbour_distance("one", 0.5)
    return group


def state(group):
    return [group.poses(name).tobytes() for name in group.names]


def test_members_come_and_go_by_name():
    group = rf.Group()
    assert (len(group), group.names, group.dt_s, bool(group), group.step()) == (0, [], None, True, {})
    group.add("one", robot(0))
    group.add("table", table(9))
    assert group.names == ["one", "table"] and group.dt_s == np.float32(DT_S)
    assert (group.neighbour_distance("one"), group.neighbour_distance("table")) == (None, np.float32(0.1))
    assert repr(group) == "Group(one, table)"
    with pytest.raises(rf.InputError, match="called \"one\" already"):
        group.add("one", robot(0))
    with pytest.raises(rf.InputError, match="there are: one, table"):
        group.world("chair")
    gone = group.remove("table")
    assert isinstance(gone, rf.World) and len(gone) == 1 and group.names == ["one"]


def test_far_members_go_as_alone_and_threads_change_no_bit():
    alone, group = robot(0), rf.Group()
    group.add("one", alone)
    group.add("other", robot(30))
    group.set_neighbour_distance("one", 1.0)
    reports = group.step(3)
    alone.step(3)
    assert group.poses("one").tobytes() == alone.poses().tobytes()
    assert reports["one"][1] == 0 and isinstance(reports["one"][0], rf.StepReport)
    groups = [crowd(threads) for threads in (1, 2, None)]
    reports = [group.step(4) for group in groups]
    assert reports[0]["one"][1] > 0
    assert state(groups[0]) == state(groups[1]) == state(groups[2])


def test_a_failed_step_changes_nobody():
    group = crowd()
    group.step()
    was = state(group)
    for spoiler, error, match in (
        (rf.World(rf.Model(MODELS / "g1.rfm"), units=4, points=64), rf.StepError, "spoiler: the model wants a command"),
        (rf.World(rf.Model("edge"), units=1, points=8), rf.InputError, "spoiler: its units and those of others"),
    ):
        spoiler.dt_s = DT_S
        spoiler.add(rf.Unit(cube(0.1)), at(x=0.1, z=0.3))
        group.add("spoiler", spoiler)
        with pytest.raises(error, match=match):
            group.step()
        assert state(group)[:3] == was
        group.remove("spoiler")
    with pytest.raises(rf.InputError, match="not finite"):
        group.command("one", [0, np.nan, 0])
    slow = table(5)
    slow.dt_s = 0.1
    with pytest.raises(rf.InputError, match="those of the group"):
        group.add("slow", slow)
    with pytest.raises(rf.InputError, match="those of the group"):
        group.set_world("table", slow)
    for bad in (-1, np.nan, np.inf):
        with pytest.raises(rf.InputError, match="distance"):
            group.set_neighbour_distance("one", bad)
        with pytest.raises(rf.InputError, match="distance"):
            group.gaps(bad)
    assert state(group) == was


def test_copies_look_ahead_and_worlds_are_put_back():
    group = crowd()
    group.step()
    others = [group.copy(), copy.copy(group), copy.deepcopy(group), pickle.loads(pickle.dumps(group))]
    changed = group.copy()
    one = changed.world("one")
    one.command([-0.5, 0, 0])
    changed.set_world("one", one)
    for each in (group, changed, *others):
        each.step(3)
    assert all(state(other) == state(group) for other in others)
    assert state(changed) != state(group)
    assert others[3].neighbour_distance("one") == 0.5 and others[3].neighbour_distance("other") is None


def test_gaps_say_who_touches_whom():
    group = rf.Group()
    for name, x in (("left", 0), ("right", 1)):
        world = rf.World(rf.Model("edge"))
        world.dt_s = 0.1
        world.add(rf.Unit(cube(0.1), role="driven"), at(x=x, z=0.5))
        group.add(name, world)
    assert group.gaps() == []
    (gap,) = group.gaps(1.0)
    assert gap.members == ("left", "right") and gap.gap_m == pytest.approx(0.8, abs=1e-5)
    assert gap == pickle.loads(pickle.dumps(gap)) and repr(gap).startswith('Gap(("left", "right"), (')
    group.drive("left", group.ids("left")[0], at(x=2, z=0.5))
    group.step()
    assert group.gaps() == []
    (gap,) = group.gaps(in_step=True)
    assert gap.gap_m == pytest.approx(-0.2, abs=0.02) and 0.4 < gap.share < 0.6
