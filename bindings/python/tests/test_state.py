"""The state of worlds, kept and gone on from in this process and in others; velocities; values that are pickled and copied."""

from __future__ import annotations

import copy
import multiprocessing
import os
import pickle
import random
import subprocess
import sys

import numpy as np
import pytest

import rigidformer as rf
from conftest import MODELS, at, cube

RATE_HZ = 60


def rigid(model: str) -> rf.World:
    """Cubes in the middle of a bounce."""
    world = rf.World(rf.Model(model), units=4, points=64)
    world.dt_s = 1 / 24
    for place in range(3):
        world.add(rf.Unit(cube(0.1)), at(0.05 * place, 0, 0.3 + 0.3 * place))
    world.step(5)
    return world


def soft() -> rf.World:
    """A sheet of four patches, draped over a fixed cube."""
    side = np.linspace(-0.4, 0.4, 9)
    sheet = np.stack(np.meshgrid(side, side, [0.4], indexing="ij"), axis=-1)[:, :, 0]
    patches = [sheet[i : i + 5, j : j + 5].reshape(-1, 3) for i in (0, 4) for j in (0, 4)]
    units = [rf.Unit(patch, 0.05, rest=patch, young_pa=1e5, body=1) for patch in patches]
    units.append(rf.Unit(cube(), role="fixed"))
    world = rf.World(rf.Model(MODELS / "shell.rfm"))
    world.observe(1 / RATE_HZ, units, [*patches, cube()])
    world.step(5)
    return world


def joints() -> rf.World:
    """A chain of three links that swings from a driven hand."""
    world = rf.World(rf.Model("edge"), units=4, points=64)
    world.dt_s = 1 / 24
    hand, *links = [
        world.add(rf.Unit(cube(0.1), role=role, body=1), at(0.2 * place, 0, 1))
        for place, role in enumerate(("driven", "free", "free", "free"))
    ]
    for unit, parent in zip(links, (hand, *links)):
        world.join(unit, parent, [-0.1, 0, 0], [0.1, 0, 0])
    world.drive(hand, at(0.02, 0, 1.05))
    world.step(4)
    world.drive(hand, at(0.05, 0, 1.1))
    return world


def bonds() -> rf.World:
    """Eight cubes that hold together, thrown on the ground; one bond is broken by hand, others by the model."""
    world = rf.World(rf.Model(MODELS / "fragments.rfm"), units=8, points=64)
    world.dt_s = 5 / RATE_HZ
    places = 0.2 * np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    ids = [world.add(rf.Unit(cube(0.1), body=3), at(x, y, z + 1)) for x, y, z in places]
    pairs = [(a, b) for a in range(8) for b in range(a) if np.abs(places[a] - places[b]).sum() < 0.3]
    world.bond([(ids[a], ids[b]) for a, b in pairs])
    for unit in ids:
        world.set_velocity(unit, [0, 0, -3], [0, 0, 0])
    world.break_bond((ids[1], ids[0]))
    world.step(4)
    return world


WORLDS = {
    "edge": lambda: rigid("edge"),
    "nano": lambda: rigid("nano"),
    "soft": soft,
    "joints": joints,
    "bonds": bonds,
}


def after(world: rf.World, steps: int) -> bytes:
    """All that a world is after so many steps."""
    world.step(steps)
    return world.snapshot()


@pytest.mark.parametrize("kind", WORLDS)
def test_a_snapshot_goes_on_with_the_same_bits(kind):
    world = WORLDS[kind]()
    other, snapshot = pickle.loads(pickle.dumps(world)), world.snapshot()
    poses, end = world.rollout(100), world.snapshot()
    world.restore(snapshot)
    assert world.snapshot() == snapshot
    for same in (world, other):
        assert (same.rollout(100) == poses).all() and same.snapshot() == end


def test_a_snapshot_goes_on_within_other_limits_and_on_other_kernels():
    world = rigid("edge")
    snapshot, end = world.snapshot(), after(world, 100)
    for kernel in rf.kernels():
        other = rf.World(rf.Model("edge"), threads=1, kernel=kernel)
        other.restore(snapshot)
        assert other.snapshot() == snapshot and after(other, 100) == end
    with pytest.raises(rf.InputError, match="units="):
        rf.World(rf.Model("edge"), units=2, points=64).restore(snapshot)


def test_copies_go_on_by_themselves():
    world = rigid("edge")
    world.quarantine = True
    world.network = False
    world.contact_law = 0.25, "pyramid"
    others = [world.copy(), copy.copy(world), copy.deepcopy({"of": world})["of"], pickle.loads(pickle.dumps(world))]
    then = world.snapshot()
    first = world.rollout(30)
    for other in others:
        assert other.ids == world.ids and other.snapshot() == then and other.quarantine and not other.network
        assert other.contact_law == (0.25, "pyramid")
        assert (other.rollout(30) == first).all()
        other.remove(other.ids[0])
    assert len(world) == 3


def test_ground_of_varying_height_is_of_the_scene(tmp_path):
    x, y = np.meshgrid(np.linspace(-2, 2, 41), np.linspace(-2, 2, 41))
    hills = rf.HeightField(0.1 * np.sin(3 * x) * np.cos(2 * y), 0.1, [-2, -2, 0], friction=0.7, restitution=0.1)
    kept = pickle.loads(pickle.dumps(hills))
    assert (kept.heights_m == hills.heights_m).all() and not kept.heights_m.flags.writeable
    assert kept.spacing_m == hills.spacing_m and (kept.corner_m == hills.corner_m).all()
    assert hills.height_m(0, 0) == pytest.approx(0, abs=1e-6) and hills.height_m(3, 0) is None
    model, corners = rf.Model("edge"), 0.1 * np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], np.float32)
    world = rf.World(model, units=4, points=64)
    world.dt_s, world.planes, world.height_field = 1 / 60, [], hills
    for number in range(4):
        world.add(rf.Unit(corners, friction=0.7), [0.3 * number, 0.1, 0.3, 1, 0, 0, 0])
    others = [world.copy(), pickle.loads(pickle.dumps(world))]
    start = pickle.loads(pickle.dumps(world.start()))
    snapshot, first = world.snapshot(), world.rollout(60)
    assert all((other.rollout(60) == first).all() for other in others)
    assert (rf.BatchSimulator(model).run(start, 1, 60).poses[0] == first).all()
    assert first[-1, :, 2].min() > -0.05
    # A file has it, and what predicts it stands on it.
    more = dict(planes=[], gravity_m_s2=[0, 0, -9.81], height_field=hills)
    scene = rf.Scene([rf.Unit(corners, friction=0.7)] * 4, first, 60, **more)
    scene.save(tmp_path / "hills.safetensors", dataset="d", provenance="p", licence="l")
    read = rf.Dataset(tmp_path / "hills.safetensors").scene(0)
    assert (read.height_field.heights_m == hills.heights_m).all()
    assert pickle.loads(pickle.dumps(read)).height_field.friction == hills.friction
    rolled = rf.rollout(model, read, step=1, last_frame=59).poses
    assert rolled[-1, :, 2].min() > -0.05
    world.height_field = None
    with pytest.raises(rf.InputError, match="height field"):
        world.restore(snapshot)
    for wrong in (np.zeros((1, 5)), np.zeros(5), np.full((2, 2), np.nan)):
        with pytest.raises(rf.InputError):
            rf.HeightField(wrong, 0.1)
    for wrong in (0, -1, np.nan, [0.1, 0.1, 0.1], 1e6):
        with pytest.raises(rf.InputError):
            rf.HeightField(np.zeros((2, 2)), wrong)
    with pytest.raises(rf.InputError, match="planes alone"):
        rf.World(rf.Model(MODELS / "g1.rfm")).height_field = hills


def test_a_contact_law_is_of_the_scene(tmp_path):
    scene = rf.Dataset.embedded().scene(0)
    assert scene.contact_law is None
    path = tmp_path / "lawful.safetensors"
    more = dict(gravity_m_s2=scene.gravity_m_s2, planes=scene.planes)
    lawful = rf.Scene(scene.units, scene.poses, scene.frame_rate_hz, contact_law=(0.25, "pyramid"), **more)
    lawful.save(path, dataset="d", provenance="p", licence="l")
    read = rf.Dataset(path).scene(0)
    assert read.contact_law == lawful.contact_law == pickle.loads(pickle.dumps(lawful)).contact_law == (0.25, "pyramid")
    model = rf.Model("edge")
    last = dict(step=10, last_frame=100)
    plain, other = (rf.rollout(model, each, **last).poses for each in (scene, read))
    assert (plain != other).any()

    world = rf.World(model)
    world.gravity_m_s2, world.planes = scene.gravity_m_s2, scene.planes
    assert world.contact_law is None
    world.contact_law = read.contact_law
    world.observe_poses(10 / scene.frame_rate_hz, scene.units, scene.poses[0], scene.poses[10])
    assert (world.rollout(9) == other[2:]).all()
    for wrong in ((-0.1, "cone"), (1.5, "cone"), (float("nan"), "cone"), (0.1, "ball")):
        with pytest.raises(rf.InputError):
            world.contact_law = wrong
        with pytest.raises(rf.InputError):
            rf.Scene(scene.units, scene.poses, scene.frame_rate_hz, contact_law=wrong, **more)
    assert world.contact_law == (0.25, "pyramid")
    world.contact_law = None
    assert world.contact_law is None
    batch = rf.BatchSimulator(model)
    assert (batch.run(rf.Start.of_scene(read), 1, 9).poses[0] == other[2:]).all()


def test_worlds_of_one_model_are_pickled_with_one():
    model = rf.Model("edge").quantised("i8")
    worlds = [rf.World(model, units=2, points=16) for _ in range(4)]
    assert len(pickle.dumps(worlds)) < 1.5 * model.nbytes


OTHER = """
import pickle, sys
world = pickle.load(sys.stdin.buffer)
world.step(100)
sys.stdout.buffer.write(world.snapshot())
"""


@pytest.mark.parametrize("kind", WORLDS)
def test_another_process_goes_on_with_the_same_bits(kind):
    world = WORLDS[kind]()
    done = subprocess.run([sys.executable, "-c", OTHER], input=pickle.dumps(world), capture_output=True, timeout=120)
    assert done.returncode == 0, done.stderr.decode()[-2000:]
    assert done.stdout == after(world, 100)


@pytest.mark.parametrize("method", sorted(set(multiprocessing.get_all_start_methods()) & {"fork", "spawn"}))
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_pools_of_processes_take_worlds_and_give_them_back(method):
    world = rigid("nano")
    with multiprocessing.get_context(method).Pool(2) as pool:
        ends = pool.starmap(after, [(world, steps) for steps in (1, 3, 5)])
        back = pool.map(copy.copy, [world])[0]
    assert ends == [after(world.copy(), steps) for steps in (1, 3, 5)]
    assert back.snapshot() == world.snapshot()


def test_what_is_no_snapshot_is_refused():
    world = rigid("edge")
    snapshot = world.snapshot()
    chance = random.Random(1)
    damaged = []
    for _ in range(300):
        bad = bytearray(snapshot)
        for _ in range(chance.choice((1, 1, 4, 32))):
            bad[chance.randrange(len(bad))] ^= 1 << chance.randrange(8)
        damaged.append(bytes(bad))
    cut = [snapshot[: chance.randrange(len(snapshot))] for _ in range(100)]
    others = [b"", b"no snapshot", snapshot + b"\0", snapshot * 2, bytes(len(snapshot)), b"\xff" * len(snapshot)]
    noise = [chance.randbytes(len(snapshot)) for _ in range(20)]
    for bad in (*damaged, *cut, *others, *noise):
        if bad != snapshot:
            with pytest.raises(rf.InputError):
                world.restore(bad)
    for another in (rigid("nano"), soft(), bonds()):
        with pytest.raises(rf.InputError, match="another model"):
            another.restore(snapshot)
    with pytest.raises(rf.InputError, match="points="):
        rf.World(rf.Model("edge"), units=4, points=16).restore(snapshot)
    for none in ("text", None, 3, [1, 2]):
        with pytest.raises(TypeError):
            world.restore(none)
    assert world.snapshot() == snapshot


def test_pickles_of_worlds_are_checked():
    world = rigid("nano")
    callee, (model, units, points, threads, snapshot, field) = world.__reduce__()
    assert field is None and callee(model, units, points, threads, snapshot).snapshot() == snapshot
    with pytest.raises(rf.InputError):
        callee(model, units, points, threads, snapshot[:-1])
    with pytest.raises(rf.InputError):
        callee(rf.Model("edge"), units, points, threads, snapshot)
    with pytest.raises(rf.InputError, match="threads"):
        callee(model, units, points, 10**6, snapshot)


def test_ids_stay_and_are_given_once():
    world = rigid("nano")
    snapshot, ids = world.snapshot(), world.ids
    later = world.add(rf.Unit(cube(0.1)), at(z=3))
    world.restore(snapshot)
    assert world.ids == ids
    assert world.add(rf.Unit(cube(0.1)), at(z=3)) not in (*ids, later)


def test_velocities_are_those_of_now():
    world = rf.World(rf.Model("edge"), units=3, points=24)
    world.dt_s = 0.02
    world.gravity_m_s2 = [0, 0, -9.81]
    rest = world.add(rf.Unit(cube(0.1)), at(z=0.1))
    thrown = world.add(rf.Unit(cube(0.1)), at(x=3, z=5))
    hand = world.add(rf.Unit(cube(0.1), role="driven"), at(x=-3, z=5))
    given = np.array([[0] * 6, [1, 2, 3, 0.5, 0, 1], [0] * 6], np.float32)
    world.set_velocities(given)
    assert np.allclose(world.velocities(), given, atol=1e-3)
    for step in range(1, 6):
        world.drive(hand, at(-3 + 0.01 * step, 0, 5))
        world.step()
    assert np.allclose(world.velocity(thrown), [1, 2, 3 - 0.981, 0.5, 0, 1], atol=2e-3)
    assert np.allclose(world.velocity(hand), [0.5, 0, 0, 0, 0, 0], atol=1e-3)
    # What lies still has none, though it counts as having risen against gravity.
    assert np.allclose(world.velocity(rest), 0, atol=1e-3)
    out = np.empty((3, 6), np.float32)
    assert world.velocities(out) is out and (out == world.velocities()).all()
    assert (out[1] == world.velocity(thrown)).all() and world.velocity(thrown).dtype == np.float32
    world.set_velocity(thrown, [0, 0, 1], [0, 0, 0])
    assert np.allclose(world.velocity(thrown), [0, 0, 1, 0, 0, 0], atol=1e-3)


def test_velocities_that_cannot_be():
    world = rigid("edge")
    first, snapshot = world.ids[0], world.snapshot()
    good = world.velocities()
    bad = good.copy()
    for value in (np.nan, np.inf, 1e30):
        bad[2, 1] = value
        with pytest.raises(rf.InputError):
            world.set_velocities(bad)
    bad = good.copy()
    bad[2, 5] = 400
    for call, text in (
        (lambda: world.set_velocities(bad), "half a turn"),
        (lambda: world.set_velocity(first, [0, 0, 0], [0, 0, 400]), "half a turn"),
        (lambda: world.set_velocities(good[:1]), "velocities"),
        (lambda: world.set_velocities(good[:, :3]), "shape"),
        (lambda: world.set_velocity(99, [0, 0, 0], [0, 0, 0]), "99"),
        (lambda: world.set_velocities(np.ma.masked_array(good)), "masked"),
        (lambda: world.velocity(99), "99"),
        (lambda: world.velocity(-1), "^id is -1"),
        (lambda: world.velocities(np.empty((2, 6), np.float32)), "shape"),
        (lambda: world.velocities(np.empty((6, 3), np.float32).T), "contiguous"),
    ):
        with pytest.raises(rf.InputError, match=text):
            call()
    for call in (
        lambda: world.set_velocities("none"),
        lambda: world.set_velocities(good.astype(complex)),
        lambda: world.velocities(np.empty((3, 6))),
    ):
        with pytest.raises((TypeError, rf.InputError)):
            call()
    assert world.snapshot() == snapshot
    sheet = soft()
    with pytest.raises(rf.InputError, match="soft"):
        sheet.set_velocity(sheet.ids[0], [0, 0, 1], [0, 0, 0])
    assert np.isfinite(sheet.velocities()).all()


def values() -> dict:
    """An object of each class whose objects do not change, and what tells it from others."""
    scene = rf.Dataset.embedded().scene(0)
    soft_unit = rf.Unit(cube(), 2.0, rest=0.9 * cube(), young_pa=1e4, body=5)
    hollow = rf.Unit(
        cube(), 0.3, 0.1, 0.7, role="fixed", body=3, inertia_kg_m2=[1, 2, 3], pieces=[cube(0.1), cube(0.1) + 0.3],
        stiffness_n_m=1e4, dissipation_s_m=4.0,
    )
    posed = at(1, 2, 3)
    camera = rf.Camera(4, 3, 2.5, 2.25, 1.75, 1.5, posed)
    depth = np.arange(12, dtype=np.uint16).reshape(3, 4)
    pivot = rf.Pivot(1, 0, [0.1, 0.2, 0.3], [0.4, 0.5, 0.6], 0.25)
    joined = rf.Start(
        0.1, [rf.Unit(cube(0.1), body=1)] * 2, [at(), at(0.2)], [at(), at(0.2)], pivots=[pivot],
        planes=[rf.Plane([0, 0, 1])], gravity_m_s2=[0, 0, -1], contact_law=(0.25, "pyramid"),
    )
    world = joints()
    futures = rf.BatchSimulator(rf.Model("nano")).run(rf.Start.of_scene(scene), 3, 2)
    patch = cube()
    frames = np.tile(at(z=1), (3, 1, 1))
    cloth = rf.Scene([soft_unit], frames, 60, soft_points=np.tile(patch, (3, 1, 1)), planes=[])
    walk = rf.Scene([hollow], frames, 60, commands=np.ones((3, 2)), name="walk", seed=-4, split="train", contact_law=(0.25, "cone"))
    simulator = rf.BatchSimulator(rf.Model("nano"))
    thrown = rf.Start(1 / 24, [rf.Unit(cube())], [at(z=1)], [at(z=1)])
    few = dict(method=rf.Cem(0.5), futures=8, iterations=1)
    plan = rf.Planner([rf.Parameter(0, 1)] * 3, steps=2, **few).plan(
        simulator, thrown, rf.Launch(0), lambda parameters, poses: float(poses[-1, 0, 0])
    )
    pushed = rf.PushPlanner(rf.Unit(cube(0.025), 0.1), rf.Unit(cube(0.01)), 0.01, **few).plan(
        simulator, [at(z=0.025), at(0.1, 0, 0.02)], [at(z=0.025), at(0.1, 0, 0.02)], rf.PushGoal([-0.06, 0])
    )
    robot = rf.Start(1 / 3, [rf.Unit(cube())], [at(z=1)], [at(z=1)])
    walked = rf.WalkPlanner(**few).plan(rf.BatchSimulator(rf.Model(MODELS / "g1.rfm")), robot, [1, 0])
    estimate, forecast = seen()
    bonded = rf.Scene([rf.Unit(cube(), body=1)] * 2, np.tile(at(), (3, 2, 1)), 24, bonds=[(0, 1, 2)])
    return {
        "soft unit": (soft_unit, ["points", "mass_kg", "rest", "young_pa", "body"]),
        "hollow unit": (
            hollow,
            ["points", "mass_kg", "friction", "restitution", "role", "body", "stiffness_n_m", "dissipation_s_m"],
        ),
        "plane": (rf.Plane([0, 0.6, 0.8], 0.1, 0.2, 0.3), ["normal", "offset_m", "friction", "restitution"]),
        "noise": (rf.VelocityNoise(2**63, 0.1, 0.2), ["seed", "linear_m_s", "angular_rad_s"]),
        "parameter": (rf.Parameter(0.1, 0.2, low=-1), ["mean", "deviation", "low", "high"]),
        "mppi": (rf.Mppi(0.1, 0.9), ["temperature", "narrowing"]),
        "cem": (rf.Cem(0.3, 0.1), ["elite", "smoothing"]),
        "launch": (rf.Launch(3), ["unit"]),
        "commands": (rf.Commands(3, 2), ["size", "hold"]),
        "goal": (rf.PushGoal([0.1, 0.2], 0.3, lever_m=0.4, haste_m_s=0.5), ["place_m", "yaw_rad", "lever_m", "haste_m_s"]),
        "camera": (camera, ["size", "pose"]),
        "view": (rf.DepthView(camera, depth, 0.002, depth), []),
        "cloud": (rf.Cloud(cube(), [1, 2, 3], np.arange(8, dtype=np.uint16)), []),
        "start": (joined, ["dt_s"]),
        "start of a scene": (rf.Start.of_scene(scene), ["dt_s"]),
        "scene": (scene, SCENE),
        "soft scene": (cloth, SCENE),
        "scene with commands": (walk, SCENE),
        "scene with bonds": (bonded, SCENE),
        "dataset": (rf.Dataset.embedded(), ["name", "frame_rate_hz", "command_size"]),
        "trajectory": (rf.rollout(rf.Model("nano"), scene, last_frame=40), ["poses", "frames", "step", "points", "holding"]),
        "falling": (rf.free_fall(scene), ["poses", "frames", "step"]),
        "futures": (futures, ["poses", "steps", "ends"]),
        "report": (world.step(), ["active_units", "degenerate_units", "quarantined_units"]),
        "observation": (rf.Observation(0.5, 2), ["residual_m", "degenerate_units"]),
        "bond": (bonds().bonds[0], ["units", "holds"]),
        "joint": (world.joints[1], ["unit", "parent", "pivot", "parent_pivot"]),
        "pivot": (pivot, ["unit", "parent", "pivot", "parent_pivot", "residual_m"]),
        "model": (rf.Model("nano"), ["name", "path", "nbytes", "provenance"]),
        "another model": (rf.Model("edge").quantised("i8"), ["name", "path", "nbytes", "provenance"]),
        "simulator": (rf.BatchSimulator(rf.Model("nano"), threads=1, memory=10**9), []),
        "start of a world": (world.start(), ["dt_s"]),
        "plan": (plan, PLAN),
        "plan without poses": (rf.Planner([rf.Parameter(0, 1)]).plan_by(lambda samples: samples[:, 0] ** 2), PLAN),
        "push": (pushed, ["heading_rad", "offset_m", "length_m", "cost", "stay", "path_m", "approach", "poses"]),
        "walk": (walked, ["command", "cost", "path"]),
        "estimate": (estimate, ["time_s"]),
        "track": (estimate.units[0], TRACK),
        "forecast": (forecast, ["step_s", "left_out"]),
    }


def seen():
    """What a tracker tells of a box that slides on a floor, and predicts."""
    camera = rf.Camera(160, 120, 140, 140, 80, 60, [0, 0, 0.5, 0, 0, 1, 0])
    tracker = rf.Tracker(rf.Model("nano"))
    for frame in range(4):
        depth = np.full((120, 160), 500, np.uint16)
        depth[40:90, 40 + frame : 90 + frame] = 300
        estimate = tracker.observe(frame / 30, [rf.DepthView(camera, depth)])
    return estimate, tracker.predict(0.2)


PLAN = ["best", "cost", "poses", "mean", "deviations", "iterations", "futures", "unusable", "cut"]
TRACK = ["id", "pose", "covariance", "velocity", "velocity_covariance", "points", "sight", "rest"]
SCENE = ["name", "seed", "split", "frame_rate_hz", "gravity_m_s2", "shapes", "frames", "poses", "soft_points", "bonds", "commands"]


def test_values_are_pickled_and_copied():
    for name, (value, attributes) in values().items():
        for same in (pickle.loads(pickle.dumps(value)), copy.copy(value), copy.deepcopy([value])[0]):
            assert type(same) is type(value) and repr(same) == repr(value) or "object at" in repr(value), name
            for attribute in attributes:
                one, other = getattr(value, attribute), getattr(same, attribute)
                assert np.array_equal(one, other) if isinstance(one, np.ndarray) else one == other, (name, attribute)
            # What it is made of again is the same.
            assert pickle.dumps(same) == pickle.dumps(pickle.loads(pickle.dumps(same))), name


def test_pickled_values_do_what_they_did():
    made = {name: value for name, (value, _) in values().items()}
    again = {name: pickle.loads(pickle.dumps(value)) for name, value in made.items()}
    bits = [
        set_of["simulator"].run(set_of["start"], 3, 4, noise=set_of["noise"]).poses.tobytes()
        + rf.rollout(set_of["model"], set_of["scene"], last_frame=40).poses.tobytes()
        for set_of in (made, again)
    ]
    assert bits[0] == bits[1]
    assert again["trajectory"].errors(again["scene"], 40) == made["trajectory"].errors(made["scene"], 40)
    runs = [rf.BatchSimulator(rf.Model("edge")).run(each["start of a world"], 2, 3).poses for each in (made, again)]
    assert (runs[0] == runs[1]).all()
    assert [track.id for track in again["estimate"].units] == [track.id for track in made["estimate"].units]
    for one, other in ((made, again), (again, made)):
        assert all((one["forecast"].poses[id] == other["forecast"].poses[id]).all() for id in one["forecast"].poses)
    assert (again["walk"].search.poses == made["walk"].search.poses).all() and again["push"].search.poses is None
    assert again["scene with bonds"].planes is None and again["soft scene"].planes == ()
    worlds = [rf.World(rf.Model("edge")) for _ in range(2)]
    for world, values_of in zip(worlds, (made, again)):
        world.dt_s, world.planes = 1 / 24, [values_of["plane"]]
        world.add(values_of["hollow unit"], at(z=1))
    assert worlds[0].snapshot() == worlds[1].snapshot()
    robot = rf.Start(1 / 3, [rf.Unit(cube())], [at(z=1)], [at(z=1)], command=[1, 0, 0])
    pushed = [rf.BatchSimulator(rf.Model(MODELS / "g1.rfm")).run(start, 1, 2).poses for start in (robot, copy.copy(robot))]
    assert (pushed[0] == pushed[1]).all()


def test_what_has_a_run_of_its_own_is_not_pickled():
    for value in (rf.Tracker(), rf.Planner([rf.Parameter(0, 1)]), rf.WalkPlanner()):
        with pytest.raises(TypeError, match="pickle"):
            pickle.dumps(value)


def test_records_that_cannot_be():
    row = np.zeros((2, 1, 7), np.float32)
    for call in (
        lambda: rf.Trajectory(row, [0, 0]),
        lambda: rf.Trajectory(row, [5, 3]),
        lambda: rf.Trajectory(np.zeros((3, 1, 7)), [0, 1, 3]),
        lambda: rf.Trajectory(np.zeros((0, 1, 7)), []),
        lambda: rf.Trajectory(np.zeros((2, 0, 7)), [0, 1]),
        lambda: rf.Trajectory(row, [0]),
        lambda: rf.Trajectory(row, [0, 1], points=np.zeros((1, 2, 3))),
        lambda: rf.Trajectory(row, [0, 1], holding=[[True]]),
        lambda: rf.Trajectory(row, [0, 1], holding=[[True]] * 3),
        lambda: rf.Trajectory(row, [0, 1], holding=[[True], [True, False]]),
        lambda: rf.Trajectory(row, [0, 1], holding=[]),
        lambda: rf.Plan(row[0, 0], 0, None, row[0, 0, :3], row[0, 0], 1, 1, 0, None),
        lambda: rf.Plan(row[0, 0], 0, None, row[0, 0], row[0, 0], 1, 1, 0, "no reason"),
        lambda: rf.Track(1, at(), np.eye(6), np.zeros(6), np.eye(5), cube()),
        lambda: rf.Track(1, at(), np.eye(6), np.zeros(6), np.eye(6), cube(), "lost"),
        lambda: rf.Track(1, at(), np.eye(6), np.zeros(6), np.eye(6), cube(), "seen", "asleep"),
        lambda: rf.Forecast(0.1, {1: np.zeros((2, 6))}, {}),
        lambda: rf.Start(0.1, [rf.Unit(cube())], [at()], [at()], state=(b"", 1, 8)),
        lambda: rf.BatchSimulator(rf.Model("nano")).run(
            rf.Start(0.1, [], np.zeros((0, 7)), np.zeros((0, 7)), state=(b"no state", 1, 8)), 1, 1
        ),
        lambda: rf.BatchSimulator(rf.Model("nano")).run(
            rf.Start(0.1, [], np.zeros((0, 7)), np.zeros((0, 7)), state=(b"no state", 10**9, 10**12)), 1, 1
        ),
        lambda: rf.Futures(np.zeros((1, 1, 1, 7), np.float32), np.zeros(1, np.uint32), []),
        lambda: rf.Futures(np.zeros((1, 1, 7), np.float32), np.zeros(1, np.uint32), [None]),
        lambda: rf.Futures(np.zeros((1, 1, 1, 7), np.float32), np.zeros(2, np.uint32), [None]),
        lambda: rf.Pivot(-1, 0, [0] * 3, [0] * 3),
        lambda: rf.Dataset.from_bytes(b"none"),
        lambda: rf.StepReport(-1),
    ):
        with pytest.raises(rf.InputError):
            call()
    without = rf.Trajectory(row, [0, 4], points=np.zeros((2, 0, 3)), holding=[[], []])
    for same in (without, pickle.loads(pickle.dumps(without)), copy.deepcopy(without)):
        assert len(same) == 2 and same.points is None and same.holding == [[], []]


def resident() -> int:
    """Bytes of this process in memory."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(sys.platform != "linux", reason="the files of Linux")
def test_memory_stays_as_it_is():
    # 100,000 turns by hand: RIGIDFORMER_TURNS=100000.
    turns = int(os.environ.get("RIGIDFORMER_TURNS", 2000))
    world = rigid("nano")
    simulator, start = rf.BatchSimulator(rf.Model("nano")), rf.Start(1 / 24, [rf.Unit(cube())], [at(z=1)], [at(z=1)])
    snapshot = world.snapshot()

    def turn(number: int) -> None:
        world.step()
        kept = world.snapshot()
        world.restore(snapshot if number % 3 else kept)
        world.velocities()
        if number % 10 == 0:
            pickle.loads(pickle.dumps(world.copy()))
            simulator.run(start, 2, 1)

    for number in range(turns // 2):
        turn(number)
    before = resident()
    for number in range(turns):
        turn(number)
    grown = resident() - before
    print(f"{turns} turns: {grown / 1024:.0f} KiB more of {before / 2**20:.0f} MiB")
    # A leak of 4 KiB a turn, the least that a snapshot could leave behind, would be 8 MiB and more.
    assert grown < 4 << 20
