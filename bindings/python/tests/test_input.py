"""What cannot be used is refused with a clear exception, and nothing changes."""

from __future__ import annotations

import errno

import numpy as np
import pytest

import rigidformer as rf
from conftest import MODELS, at, cube, falling

NAN = float("nan")


def test_all_exceptions_have_one_base():
    for error, also in [(rf.InputError, ValueError), (rf.FileError, OSError), (rf.StepError, RuntimeError)]:
        assert issubclass(error, rf.RigidFormerError) and issubclass(error, also)


def test_a_file_that_is_not_there(tmp_path):
    path = tmp_path / "none.rfm"
    for load in (rf.Model, rf.Dataset):
        with pytest.raises(rf.FileError, match="cannot be read") as raised:
            load(path)
        assert raised.value.errno == errno.ENOENT
        assert str(path) in str(raised.value)
        with pytest.raises(rf.FileError):
            load(tmp_path)
    with pytest.raises(rf.FileError, match="cannot be written"):
        rf.pack(MODELS / "nano-f32.rfm", tmp_path / "no" / "folder.rfm")


@pytest.mark.parametrize("length", [0, 1, 15, 100, 5000, -1])
def test_a_truncated_model(tmp_path, length):
    whole = (MODELS / "nano.rfm").read_bytes()
    path = tmp_path / "short.rfm"
    path.write_bytes(whole[:length])
    with pytest.raises(rf.InputError, match="short.rfm"):
        rf.Model(path)
    with pytest.raises(rf.InputError, match="mine"):
        rf.Model.from_bytes(whole[:length], "mine")


def test_a_damaged_model():
    whole = bytearray((MODELS / "nano.rfm").read_bytes())
    for place in range(0, len(whole), len(whole) // 50):
        damaged = bytearray(whole)
        damaged[place] ^= 0x40
        try:
            rf.Model.from_bytes(bytes(damaged))
        except rf.InputError:
            pass


def test_a_truncated_scene_file(tmp_path, scene):
    path = tmp_path / "scene.safetensors"
    scene.save(path, dataset="d", provenance="p", licence="l")
    whole = path.read_bytes()
    for length in (0, 7, 100, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(rf.InputError):
            rf.Dataset(path)


@pytest.mark.parametrize(
    "points, error",
    [
        (np.zeros((8, 2), np.float32), rf.InputError),
        (np.zeros(24, np.float32), rf.InputError),
        (np.zeros((2, 4, 3), np.float32), rf.InputError),
        ([[1, 2, 3], [4, 5]], rf.InputError),
        (np.zeros((8, 3), complex), TypeError),
        (np.zeros((8, 3), bool), TypeError),
        (np.array([["a"] * 3] * 4), TypeError),
        (None, TypeError),
        (object(), TypeError),
        ("points", TypeError),
    ],
)
def test_points_of_other_shapes_and_types(points, error):
    with pytest.raises(error, match="points"):
        rf.Unit(points)


@pytest.mark.parametrize("value", [NAN, float("inf"), 1e7, 1e300])
def test_points_that_are_none(nano, value):
    world, _ = falling(nano)
    before = world.poses()
    points = cube().astype(np.float64)
    points[3, 1] = value
    with pytest.raises(rf.InputError, match="point 3"):
        world.add(rf.Unit(points), at(2))
    with pytest.raises(rf.InputError, match="point 3"):
        world.observe(1 / 24, [rf.Unit(cube())], [points])
    assert (world.poses() == before).all() and len(world) == 1


@pytest.mark.parametrize(
    "pose",
    [
        [NAN, 0, 0, 1, 0, 0, 0],
        [0, 0, 1e7, 1, 0, 0, 0],
        [0, 0, 0, 0, 0, 0, 0],
        [0, 0, 0, 2, 0, 0, 0],
        [0, 0, 0, 1, 0, 0],
        [[0, 0, 0, 1, 0, 0, 0]],
    ],
)
def test_poses_that_are_none(nano, pose):
    world, cube_id = falling(nano)
    before = world.poses()
    for call in (
        lambda: world.add(rf.Unit(cube()), pose),
        lambda: world.add(rf.Unit(cube()), at(), pose),
        lambda: world.set_poses(cube_id, pose, at()),
        lambda: world.observe_poses(1 / 24, [rf.Unit(cube())], [pose], [pose]),
    ):
        with pytest.raises(rf.InputError):
            call()
    assert (world.poses() == before).all() and len(world) == 1


def test_a_refused_call_leaves_the_world_to_go_on_as_it_would_have(nano):
    (one, cube_id), (other, _) = falling(nano), falling(nano)
    one.step(3)
    for call in (
        lambda: one.drive(cube_id, at()),
        lambda: one.drive(12345, at()),
        lambda: one.remove(12345),
        lambda: one.pose(12345),
        lambda: one.points(12345),
        lambda: one.health(12345),
        lambda: one.set_physics(cube_id, NAN, 0.5, 0.5),
        lambda: one.set_compliance(cube_id, -1.0),
        lambda: one.set_compliance(cube_id, 1e4, NAN),
        lambda: one.set_compliance(12345, 1e4),
        lambda: one.set_plane_compliance(1, 1e4),
        lambda: one.set_plane_compliance(-1, 1e4),
        lambda: one.set_plane_compliance(0, 1e13),
        lambda: one.set_velocity(cube_id, [NAN, 0, 0], [0, 0, 0]),
        lambda: one.set_role(cube_id, "conveyor"),
        lambda: one.command([1.0]),
        lambda: setattr(one, "dt_s", -1.0),
        lambda: setattr(one, "gravity_m_s2", [0, 0, NAN]),
        lambda: setattr(one, "planes", [rf.Plane([0, 0, 2])]),
        lambda: setattr(one, "planes", [rf.Plane([0, 0, 1])] * 9),
        lambda: one.observe(1 / 24, [], []),
        lambda: one.observe(1 / 24, [rf.Unit(cube())], []),
        lambda: one.observe(1 / 24, [rf.Unit(cube())], [cube()[:7]]),
        lambda: one.observe(0, [rf.Unit(cube())], [cube()]),
        lambda: one.add(rf.Unit(cube(0.1)[:3]), at()),
        lambda: one.add(rf.Unit(cube(0.0)), at()),
        lambda: one.add(rf.Unit(cube(), mass_kg=0), at()),
        lambda: one.add(rf.Unit(cube(), inertia_kg_m2=[1, 1, 9]), at()),
        lambda: one.add(rf.Unit(cube(), stiffness_n_m=1e-4), at()),
        lambda: one.add(rf.Unit(cube(), pieces=[cube()[:3]]), at()),
        lambda: one.add(rf.Unit(np.tile(cube(), (9, 1))), at()),
    ):
        with pytest.raises(rf.InputError):
            call()
    other.step(3)
    assert (one.rollout(5) == other.rollout(5)).all()


def test_a_step_without_units_or_command(nano):
    with pytest.raises(rf.StepError, match="nothing to step"):
        rf.World(nano).step()
    robot = rf.Model(MODELS / "g1.rfm")
    world = rf.World(robot, units=2, points=64)
    world.dt_s = 1 / 3
    world.add(rf.Unit(cube()), at(z=1))
    with pytest.raises(rf.StepError, match="command of 3"):
        world.step()
    with pytest.raises(rf.InputError, match="wants 3"):
        world.command([0.0])
    world.command([0.3, 0.0, 0.0])
    assert world.step().active_units == 1


def test_limits_without_memory(nano):
    with pytest.raises(rf.InputError, match="memory"):
        rf.World(nano, units=10**12, points=10**15)
    with pytest.raises(rf.InputError, match="threads"):
        rf.World(nano, threads=0)
    with pytest.raises(rf.InputError):
        rf.World(nano, kernel="abacus")


def test_out_that_does_not_fit(nano):
    world, _ = falling(nano)
    for out, error in [
        (np.zeros((1, 7)), TypeError),
        (np.zeros((2, 7), np.float32), rf.InputError),
        (np.zeros((1, 14), np.float32)[:, ::2], rf.InputError),
        ([[0] * 7], TypeError),
    ]:
        with pytest.raises(error, match="out"):
            world.poses(out)
    locked = np.zeros((1, 7), np.float32)
    locked.flags.writeable = False
    with pytest.raises(rf.InputError, match="out"):
        world.poses(locked)
    out = np.zeros((1, 7), np.float32)
    assert world.poses(out) is out and (out == world.poses()).all()


def test_arrays_of_every_layout_are_the_same_numbers(nano):
    def first(points) -> np.ndarray:
        world = rf.World(nano)
        world.observe(1 / 24, [rf.Unit(points)], [points])
        return world.points(world.ids[0])

    points = cube() + np.float32(0.5)
    expected = first(points)
    wide = np.zeros((8, 6), np.float32)
    wide[:, ::2] = points
    unaligned = np.frombuffer(b"x" + points.tobytes(), np.uint8)[1:].view(np.float32).reshape(8, 3)
    for same in (
        points.astype(np.float64),
        np.asfortranarray(points),
        wide[:, ::2],
        points[::-1][::-1],
        points.astype(">f4"),
        unaligned,
        points.tolist(),
    ):
        assert (first(same) == expected).all()


def test_rollouts_that_cannot_be(nano, scene):
    with pytest.raises(rf.InputError, match="step is 0"):
        rf.rollout(nano, scene, step=0)
    with pytest.raises(rf.InputError, match="frames"):
        rf.rollout(nano, scene, step=1000)
    with pytest.raises(OverflowError):
        rf.rollout(nano, scene, step=-1)
    with pytest.raises(rf.InputError):
        rf.Dataset.embedded().scene(1)
    with pytest.raises(rf.InputError):
        rf.Dataset.embedded().scene(0, 0)
    with pytest.raises(rf.InputError, match="there is no split"):
        rf.Dataset.embedded().scenes_of("tests")
    with pytest.raises(rf.InputError, match="no scene is in the split train"):
        rf.evaluate(nano, rf.Dataset.embedded(), split="train")
    for nothing in ({"limit": 0}, {"steps": []}):
        with pytest.raises(rf.InputError, match="there are no"):
            rf.evaluate(nano, rf.Dataset.embedded(), **nothing)
    for step in (0, 26):
        with pytest.raises(rf.InputError, match=f"step code {step}.*give 1 to 25"):
            rf.evaluate(nano, rf.Dataset.embedded(), steps=[step])
        with pytest.raises(rf.InputError, match="step codes from 1 to 25"):
            rf.check(nano, nano, rf.Dataset.embedded(), steps=[step])
    with pytest.raises(rf.InputError, match="give at most 8388608 poses"):
        rf.free_fall(scene, 1, last_frame=2**32 - 1)
    with pytest.raises(rf.InputError):
        rf.Scene([], np.zeros((1, 0, 7)), 240)
    with pytest.raises(rf.InputError):
        rf.Scene([rf.Unit(cube())], [[[NAN] * 7]], 240)


def test_models_that_are_quantised_already(nano):
    with pytest.raises(rf.InputError, match="already"):
        nano.quantised("i8")
    with pytest.raises(rf.InputError, match="there is no dtype"):
        nano.quantised("i4")


def test_more_futures_than_memory_are_refused():
    with pytest.raises(rf.InputError, match="1000000000000 futures of 3 parameters; give at most"):
        rf.Planner([rf.Parameter(0, 1)] * 3, futures=10**12)
