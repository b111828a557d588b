"""Every public call with arguments of every kind: what it does not take it refuses by a documented exception, and nothing changes.

`ANY_INPUT=1000 pytest tests/test_any_input.py` tries so many of each call instead of a few.
"""

from __future__ import annotations

import decimal
import fractions
import inspect
import os
import signal

import numpy as np
import pytest

import rigidformer as rf
from conftest import MODELS, at, cube, falling

TRIALS = int(os.environ.get("ANY_INPUT", "20"))
# Seconds of a call. Some ask for more steps than anybody waits for; a signal ends them.
PATIENCE_S = 0.5

NUMBERS = [0.0, -0.0, 1e-45, 1e-38, 1e-6, 1.0, -1.0, 1.5, 1e6, 1e38, -1e38, 1e300, float("nan"), float("inf"), float("-inf")]
SCALARS = NUMBERS + [
    None, True, False, ..., object(), int, len, set(), {}, (), [], range(7), iter([1.0]), b"x", bytearray(4), memoryview(b"1234"),
    "", "free", "i8", "test", "portable", "\0", "\ud800", "x" * 10_000, 1j,
    -1, 0, 1, 2, 3, 255, 65_535, 65_536, 1 << 31, 1 << 40, (1 << 63) - 1, 1 << 63, 1 << 64, -(1 << 63) - 1, 10**400,
    np.float16(2), np.float64("nan"), np.longdouble(1), np.int8(-1), np.uint64(2**64 - 1), np.bool_(True), np.str_("x"),
    np.datetime64("2000-01-01"), fractions.Fraction(1, 3), decimal.Decimal("1e999"),
]  # fmt: skip
DTYPES = ["f2", "f4", "f8", "g", ">f4", ">f8", "i1", "u1", "i4", "u2", ">u2", "i8", "u8", "?", "c8", "O", "S3", "U3", "M8[s]", "V4"]
SHAPES = [(), (0,), (1,), (2,), (3,), (6,), (7,), (8,), (0, 3), (0, 7), (1, 3), (1, 7), (2, 7), (3, 3), (8, 3), (9, 3), (4, 4)] + [
    (6, 8), (3, 8), (1, 2, 7), (4, 2, 7), (0, 2, 7), (2, 0, 7), (4, 2, 6), (1, 1, 8, 3), (300, 3), (1,) * 32,
]  # fmt: skip


# Of arguments that Python itself cannot convert.
OF_PYTHON = (TypeError, UnicodeEncodeError, MemoryError)


class Raising:
    """An array that cannot be made."""

    def __array__(self, dtype=None, copy=None):
        raise ValueError("no array")


class Subclass(np.ndarray):
    """An array of another class."""


def laid_out(random, array):
    """The same numbers, or about the same, elsewhere in memory."""
    array = np.asarray(array)
    kind = random.integers(11)
    if kind == 0:
        return np.asfortranarray(array)
    if kind == 1 and array.ndim:
        return np.repeat(array, 2, axis=-1)[..., ::2]
    if kind == 2 and array.ndim:
        return array[::-1]
    if kind == 3 and not array.dtype.hasobject:
        # At an odd address.
        room = np.zeros(array.nbytes + 1, np.uint8)[1:]
        odd = room.view(array.dtype) if array.size else np.zeros(0, array.dtype)
        odd[...] = array.ravel()
        return odd.reshape(array.shape)
    if kind == 4:
        array = array.copy()
        array.setflags(write=False)
        return array
    if kind == 5:
        return np.ma.masked_array(array)
    if kind == 6:
        return array.view(Subclass)
    if kind == 7:
        return array.tolist()
    if kind == 8 and array.size and array.ndim:
        return np.broadcast_to(array[:1], (100_000, *array.shape[1:]))
    if kind == 9 and array.ndim:
        return array.T
    return array.astype(random.choice(["f2", "f8", "i4", ">f4"])) if array.dtype.kind in "fiu" else array


def array(random):
    """Numbers, texts and times of any type, shape and place."""
    dtype, shape = np.dtype(random.choice(DTYPES)), SHAPES[random.integers(len(SHAPES))]
    with np.errstate(all="ignore"):
        values = random.choice(NUMBERS, shape)
        if dtype.kind in "iuMSUV":
            values = random.integers(0, 99, shape).astype("i8")
        if dtype.kind == "V":
            return np.zeros(shape, dtype)
        return laid_out(random, np.asarray(values).astype(dtype))


def wrong(random, sound):
    """Something in the place of a sound argument."""
    kind = random.integers(7)
    if kind == 0:
        return array(random)
    if kind in (1, 2) and isinstance(sound, np.ndarray):
        if kind == 1 or not sound.size:
            return laid_out(random, sound)
        changed = sound.copy()
        with np.errstate(all="ignore"):
            place = random.integers(changed.size)
            changed.reshape(-1)[place] = np.float64(random.choice(NUMBERS)).astype(changed.dtype)
        return changed
    if kind == 3:
        return [sound, wrong(random, sound)]
    if kind == 4 and isinstance(sound, (list, tuple, dict)) and len(sound):
        if isinstance(sound, dict):
            return {key: wrong(random, value) for key, value in sound.items()}
        changed = list(sound)
        changed[random.integers(len(changed))] = wrong(random, changed[0])
        return changed
    if kind == 5:
        return Raising()
    return SCALARS[random.integers(len(SCALARS))]


ROBOT = """<mujoco><worldbody><body><geom type="box" size=".1 .1 .1"/>
<body pos="0 0 .3"><joint axis="0 1 0"/><geom type="box" size=".05 .05 .2"/></body></body></worldbody></mujoco>"""
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


def sound_calls(nano, scene, folder, random):
    """All public calls: a name, what is called, and arguments that it takes."""
    world, first = falling(nano)
    second = world.add(rf.Unit(cube(), role="driven"), at(x=1.0, z=1.0))
    field = rf.HeightField(np.zeros((4, 4)), 1.0, [-1, -1, -1])
    unit, plane, pose = rf.Unit(cube()), rf.Plane([0, 0, 1]), at(z=1.0)
    hinged, hinge = falling(nano)
    post = hinged.add(rf.Unit(cube(), role="fixed"), at(x=1.0, z=1.0))
    hinged.join(hinge, post, np.zeros(3), np.zeros(3), kind="revolute", axis=(0, 0, 1))
    (folder / "robot.xml").write_text(ROBOT)
    (folder / "meshes").mkdir(exist_ok=True)
    (folder / "meshes" / "tetrahedron.obj").write_text(TETRAHEDRON)
    robot = rf.load_robot(folder / "robot.xml")
    group = rf.Group(threads=1)
    group.add("one", world)
    group.add("other", hinged)
    start = rf.Start.of_scene(scene)
    (folder / "contact.toml").write_text('format = "rigidformer-contact"\nversion = 1\ngravity_factor = 0.5\n')
    units = len(scene.units)
    batch = rf.BatchSimulator(nano, threads=1)
    copies = batch.copies(start, 2)
    camera = rf.Camera(8, 6, 8, 8, 4, 3)
    depth = np.full((6, 8), 500, np.uint16)
    cloud = rf.Cloud(cube())
    tracker = rf.Tracker()
    planner = rf.Planner([rf.Parameter(0, 1)] * 3, method=rf.Mppi(1.0), futures=2, iterations=1, steps=1)
    pusher = rf.PushPlanner(unit, rf.Unit(cube(0.05)), 0.05, method=rf.Mppi(1.0), futures=2, iterations=1)
    walker = rf.WalkPlanner(futures=2, iterations=1)
    trajectory = rf.free_fall(scene)
    costs = [1.0, *SCALARS]

    def cost(*_):
        return costs[random.integers(len(costs))]

    def setting(target, name):
        return lambda value: setattr(target, name, value)

    plan = rf.Plan(*[np.ones(2, np.float32), 1.0, None] + [np.ones(2, np.float32)] * 2 + [1, 2, 0, None])
    track = rf.Track(1, pose, np.eye(6), np.ones(6), np.eye(6), cube())
    poses = np.stack([pose, at(x=1.0, z=1.0)])
    seen = np.stack([at(z=0.2), at(x=1.0, z=0.05)])
    f32 = np.float32
    data = (MODELS / "nano.rfm").read_bytes()
    calls = {
        "Model": (rf.Model, {"source": "nano"}),
        "Model.from_bytes": (rf.Model.from_bytes, {"data": data, "name": "mine"}),
        "Model.quantised": (nano.quantised, {"dtype": "i8", "wide": [], "narrow": []}),
        "Unit": (rf.Unit, {
            "points": cube(), "mass_kg": 1.0, "friction": 0.5, "restitution": 0.4, "role": "free", "body": 1,
            "inertia_kg_m2": np.ones(3, f32), "stiffness_n_m": 1e4, "dissipation_s_m": 4.0, "pieces": [cube()], "rest": cube(), "young_pa": 1e4,
        }),
        "Unit.with_points": (unit.with_points, {"points": cube()}),
        "Plane": (rf.Plane, {"normal": np.array([0, 0, 1], f32), "offset_m": 0.0, "friction": 0.5, "restitution": 0.4}),
        "Gap": (rf.Gap, {"members": ("one", "other"), "units": (1, 2), "gap_m": 0.1, "share": 1.0}),
        "Group": (rf.Group, {"threads": 1}),
        "Group.add": (group.add, {"name": "third", "world": world}),
        "Group.remove": (group.remove, {"name": "third"}),
        "Group.world": (group.world, {"name": "one"}),
        "Group.set_world": (group.set_world, {"name": "one", "world": world}),
        "Group.command": (group.command, {"name": "one", "command": np.zeros(0, f32)}),
        "Group.drive": (group.drive, {"name": "one", "id": second, "pose": at(x=1.0, z=1.01)}),
        "Group.set_neighbour_distance": (group.set_neighbour_distance, {"name": "one", "within_m": 0.1}),
        "Group.neighbour_distance": (group.neighbour_distance, {"name": "one"}),
        "Group.step": (group.step, {"steps": 1}),
        "Group.poses": (group.poses, {"name": "one"}),
        "Group.ids": (group.ids, {"name": "one"}),
        "Group.gaps": (group.gaps, {"within_m": 0.1, "in_step": True}),
        "Group.copy": (group.copy, {}),
        "World": (rf.World, {"model": nano, "units": 4, "points": 64, "threads": 1, "kernel": "portable"}),
        "World.observe": (world.observe, {"dt_s": 0.04, "units": [unit], "current": [cube()]}),
        "World.observe_poses": (
            world.observe_poses, {"dt_s": 0.04, "units": [unit, unit], "previous": poses, "current": poses}
        ),
        "World.add": (world.add, {"unit": unit, "pose": pose, "previous": pose}),
        "World.remove": (world.remove, {"id": first}),
        "World.drive": (world.drive, {"id": second, "pose": at(x=1.0, z=1.01)}),
        "World.command": (world.command, {"command": np.zeros(0, f32)}),
        "World.set_poses": (world.set_poses, {"id": first, "previous": pose, "current": pose}),
        "World.set_velocity": (
            world.set_velocity, {"id": first, "linear_m_s": np.ones(3, f32), "angular_rad_s": np.ones(3, f32)}
        ),
        "World.set_velocities": (world.set_velocities, {"velocities": np.ones((2, 6), f32)}),
        "World.velocity": (world.velocity, {"id": first}),
        "World.centres": (world.centres, {}),
        "World.velocities": (world.velocities, {"out": np.zeros((2, 6), f32)}),
        "World.snapshot": (world.snapshot, {}),
        "World.restore": (world.restore, {"snapshot": world.snapshot()}),
        "World.copy": (world.copy, {}),
        "World.start": (world.start, {}),
        "World.set_physics": (world.set_physics, {"id": first, "mass_kg": 2.0, "friction": 0.5, "restitution": 0.4}),
        "World.set_compliance": (world.set_compliance, {"id": first, "stiffness_n_m": 1e4, "dissipation_s_m": 4.0}),
        "World.set_plane_compliance": (
            world.set_plane_compliance, {"plane": 0, "stiffness_n_m": 1e4, "dissipation_s_m": 4.0}
        ),
        "World.bond": (world.bond, {"pairs": [(first, second)]}),
        "World.break_bond": (world.break_bond, {"pair": (first, second)}),
        "World.join": (
            world.join, {"unit": first, "parent": second, "pivot": np.zeros(3, f32), "parent_pivot": np.zeros(3, f32)}
        ),
        "World.set_joint_target": (hinged.set_joint_target, {"id": hinge, "target": 0.1}),
        "World.joint_position": (hinged.joint_position, {"id": hinge}),
        "World.unjoin": (world.unjoin, {"id": first}),
        "World.set_role": (world.set_role, {"id": first, "role": "fixed"}),
        "World.role": (world.role, {"id": first}),
        "World.step": (world.step, {"steps": 1}),
        "World.rollout": (world.rollout, {"steps": 1}),
        "World.pose": (world.pose, {"id": first}),
        "World.poses": (world.poses, {"out": np.zeros((2, 7), f32)}),
        "World.previous_pose": (world.previous_pose, {"id": first}),
        "World.points": (world.points, {"id": first}),
        "World.soft_points": (world.soft_points, {"id": first}),
        "World.is_soft": (world.is_soft, {"id": first}),
        "World.health": (world.health, {"id": first}),
        "World.dt_s": (setting(world, "dt_s"), {"value": 0.04}),
        "World.gravity_m_s2": (setting(world, "gravity_m_s2"), {"value": np.ones(3, f32)}),
        "World.planes": (setting(world, "planes"), {"value": [plane]}),
        "World.quarantine": (setting(world, "quarantine"), {"value": True}),
        "World.network": (setting(world, "network"), {"value": False}),
        "World.height_field": (setting(world, "height_field"), {"value": field}),
        "HeightField": (rf.HeightField, {
            "heights_m": np.zeros((3, 4), f32), "spacing_m": 0.5, "corner_m": np.zeros(3, f32), "friction": 0.5, "restitution": 0.4,
        }),
        "HeightField.height_m": (field.height_m, {"x_m": 0.1, "y_m": 0.2}),
        "World.contact_law": (setting(world, "contact_law"), {"value": (0.03, "pyramid")}),
        "Dataset": (rf.Dataset, {"path": folder / "saved.safetensors"}),
        "Dataset.from_bytes": (
            rf.Dataset.from_bytes, {"data": (folder / "saved.safetensors").read_bytes(), "name": "mine"}
        ),
        "Dataset.embedded": (rf.Dataset.embedded, {}),
        "Dataset.scene": (rf.Dataset.embedded().scene, {"index": 0, "frames": 12}),
        "Dataset.scenes_of": (rf.Dataset.embedded().scenes_of, {"split": "test"}),
        "load_robot": (rf.load_robot, {
            "path": folder / "robot.xml", "package_paths": [], "skip_meshes": False, "merge_fixed": False, "balance": False,
        }),
        "load_meshes": (rf.load_meshes, {"folder": folder / "meshes", "density_kg_m3": 1000.0, "scale": 1.0}),
        "Robot.describe": (robot.describe, {}),
        "Robot.poses": (robot.poses, {"positions": [0.1]}),
        "Robot.scene": (robot.scene, {
            "points": 8, "positions": [0.1], "at": (0.0, 0.0, 1.0), "fixed_base": True, "principal_frames": False, "frame_rate_hz": 60.0,
        }),
        "Scene": (rf.Scene, {
            "units": [unit, unit], "poses": np.stack([poses] * 4), "frame_rate_hz": 60.0, "gravity_m_s2": np.ones(3, f32),
            "contact_law": (0.03, "cone"), "height_field": field, "planes": [plane], "commands": None, "soft_points": None, "bonds": [(0, 1, None)], "name": "s", "seed": 1,
            "split": "test",
        }),
        "Scene.points": (scene.points, {"frame": 1}),
        "Scene.pivots": (scene.pivots, {"last": 10}),
        "Scene.with_contact": (scene.with_contact, {"path": folder / "contact.toml"}),
        "Scene.views": (scene.views, {
            "time_s": 0.0, "cameras": 1, "deviation_m": 0.001, "edge_loss": 0.3, "capture": 0, "seed": 1,
        }),
        "Scene.save": (
            scene.save, {"path": folder / "saved.safetensors", "dataset": "d", "provenance": "p", "licence": "l"}
        ),
        "Trajectory": (rf.Trajectory, {
            "poses": np.stack([poses] * 2), "frames": [1, 2], "points": None, "holding": [[True], [False]],
        }),
        "Trajectory.errors": (trajectory.errors, {"scene": scene, "frame": 20}),
        "Start": (rf.Start, {
            "dt_s": 0.04, "units": [unit, unit], "previous": poses, "current": poses, "command": None, "planes": [plane],
            "gravity_m_s2": np.ones(3, f32), "contact_law": (0.03, "cone"), "height_field": field, "state": None,
        }),
        "Start.of_scene": (rf.Start.of_scene, {"scene": scene, "step": 10, "frame": 10, "join": False}),
        "VelocityNoise": (rf.VelocityNoise, {"seed": 1, "linear_m_s": 0.1, "angular_rad_s": 0.1}),
        "BatchSimulator": (rf.BatchSimulator, {"model": nano, "threads": 1, "kernel": "portable", "memory": 1 << 30}),
        "BatchSimulator.copies": (batch.copies, {"start": start, "count": 2}),
        "Copies.step": (copies.step, {"targets": {0: np.zeros((2, 7), f32)}, "commands": np.zeros((2, 0), f32)}),
        "Copies.reset": (copies.reset, {"which": [0, 1]}),
        "Copies.set_poses": (
            copies.set_poses, {
                "which": [1], "previous": copies.poses()[1:, :1], "current": copies.poses()[1:, :1], "units": [0],
            }
        ),
        "Copies.set_velocities": (
            copies.set_velocities, {"which": [0], "velocities": np.zeros((1, units, 6), f32), "units": None}
        ),
        "Copies.poses": (copies.poses, {"out": np.zeros((2, units, 7), f32)}),
        "Copies.velocities": (copies.velocities, {"out": np.zeros((2, units, 6), f32)}),
        "Copies.snapshot": (copies.snapshot, {"copy": 1}),
        "Copies.restore": (copies.restore, {"copy": 0, "snapshot": copies.snapshot(1)}),
        "Futures": (rf.Futures, {
            "poses": np.zeros((1, 2, 2, 7), f32), "steps": np.ones(1, np.uint32), "ends": [None],
        }),
        "Bond": (rf.Bond, {"units": (0, 1), "holds": True}),
        "Joint": (rf.Joint, {"unit": 1, "parent": 0, "pivot": np.zeros(3, f32), "parent_pivot": np.zeros(3, f32)}),
        "Pivot": (rf.Pivot, {
            "unit": 1, "parent": 0, "pivot": np.zeros(3, f32), "parent_pivot": np.zeros(3, f32), "residual_m": 0.0,
        }),
        "StepReport": (rf.StepReport, {"active_units": 1, "degenerate_units": 0, "quarantined_units": 0}),
        "Observation": (rf.Observation, {"residual_m": 0.0, "degenerate_units": 0}),
        "BatchSimulator.run": (batch.run, {
            "start": start, "futures": 2, "steps": 1, "previous": None, "current": None,
            "velocities": np.zeros((2, units, 6), f32), "pushes": np.zeros((2, 1, units, 6), f32),
            "noise": rf.VelocityNoise(1), "physics": np.full((2, units, 3), 0.5, f32), "commands": None,
            "targets": {0: np.zeros((2, 1, 7), f32)},
        }),
        "Parameter": (rf.Parameter, {"mean": 0.0, "deviation": 1.0, "low": -1.0, "high": 1.0}),
        "Mppi": (rf.Mppi, {"temperature": 1.0, "narrowing": 0.7}),
        "Cem": (rf.Cem, {"elite": 0.1, "smoothing": 0.2}),
        "Launch": (rf.Launch, {"unit": 0}),
        "Commands": (rf.Commands, {"size": 3, "hold": 1}),
        "Planner": (rf.Planner, {
            "parameters": [rf.Parameter(0, 1)], "method": rf.Mppi(1.0), "futures": 2, "iterations": 1, "steps": 1, "seed": 1,
        }),
        "Planner.plan": (planner.plan, {
            "simulator": batch, "start": start, "action": rf.Launch(0), "cost": cost, "deadline_s": None,
        }),
        "Planner.plan_by": (planner.plan_by, {"evaluate": lambda samples: wrong(random, samples[:, 0]), "deadline_s": 1.0}),
        "Planner.shift": (planner.shift, {"passed": 1, "a_step": 1}),
        "Planner.set_mean": (planner.set_mean, {"mean": np.zeros(3, f32)}),
        "Planner.propose": (planner.propose, {"samples": np.zeros((1, 3), f32)}),
        "Plan": (rf.Plan, {
            "best": np.ones(2, f32), "cost": 1.0, "poses": np.ones((3, 2, 7), f32), "mean": np.ones(2, f32),
            "deviations": np.ones(2, f32), "iterations": 1, "futures": 2, "unusable": 0, "cut": "the deadline passed",
        }),
        "PushPlan": (rf.PushPlan, {
            "heading_rad": 0.1, "offset_m": 0.0, "length_m": 0.1, "cost": 1.0, "stay": 2.0, "path_m": np.ones((3, 2), f32),
            "approach": 1, "poses": poses, "search": plan,
        }),
        "WalkPlan": (rf.WalkPlan, {"command": np.ones(3, f32), "cost": 1.0, "path": poses, "search": plan}),
        "Estimate": (rf.Estimate, {"time_s": 1.0, "units": [track]}),
        "Track": (rf.Track, {
            "id": 1, "pose": pose, "covariance": np.eye(6, dtype=f32), "velocity": np.ones(6, f32),
            "velocity_covariance": np.eye(6, dtype=f32), "points": cube(), "sight": "hidden", "rest": "held",
        }),
        "Forecast": (rf.Forecast, {"step_s": 0.04, "poses": {1: poses}, "left_out": {2: "why"}}),
        "PushGoal": (rf.PushGoal, {"place_m": np.zeros(2, f32), "yaw_rad": 0.0, "lever_m": 0.1, "haste_m_s": 0.005}),
        "PushGoal.errors": (rf.PushGoal([0, 0]).errors, {"pose": pose}),
        "PushPlanner": (rf.PushPlanner, {
            "body": unit, "pusher": unit, "radius_m": 0.2, "dt_s": 0.04, "push_m_s": 0.2, "travel_m_s": 0.4, "room_m": 0.008,
            "longest_m": 0.12, "settle_s": 0.05, "planes": [plane], "gravity_m_s2": np.ones(3, f32), "method": rf.Cem(),
            "futures": 2, "iterations": 1, "seed": 1, "heading_rad": 0.25, "offset": 0.25, "length_m": 0.03,
        }),
        "PushPlanner.plan": (pusher.plan, {
            "simulator": batch, "previous": seen, "current": seen, "goal": rf.PushGoal([0.1, 0]), "cost": cost,
            "deadline_s": 1.0,
        }),
        "PushPlanner.passed": (pusher.passed, {"plan": None, "steps": 1}),
        "PushPlanner.forget": (pusher.forget, {}),
        "WalkPlanner": (rf.WalkPlanner, {
            "method": rf.Mppi(1.0), "futures": 2, "iterations": 1, "commands": 3, "hold": 3, "seed": 1, "low": -np.ones(3, f32),
            "high": np.ones(3, f32),
        }),
        "WalkPlanner.plan": (walker.plan, {
            "simulator": batch, "start": start, "place_m": np.zeros(2, f32), "heading_rad": 0.0, "deadline_s": 1.0,
        }),
        "WalkPlanner.begin_with": (walker.begin_with, {"commands": np.zeros((3, 3), f32)}),
        "WalkPlanner.passed": (walker.passed, {"steps": 1}),
        "WalkPlanner.forget": (walker.forget, {}),
        "Camera": (rf.Camera, {
            "width": 8, "height": 6, "fx": 8.0, "fy": 8.0, "cx": 4.0, "cy": 3.0, "pose": at(),
        }),
        "Camera.moved": (camera.moved, {"pose": pose}),
        "DepthView": (rf.DepthView, {"camera": camera, "depth": depth, "scale_m": 0.001, "labels": depth}),
        "Cloud": (rf.Cloud, {"points": cube(), "sensor": np.zeros(3, f32), "labels": np.zeros(8, np.uint16)}),
        "Tracker": (rf.Tracker, {
            "model": nano, "segmentation": "found", "planes": [plane], "plane_physics": (0.5, 0.4), "unit_physics": (0.5, 0.4),
            "density_kg_m3": 1e3, "gravity_m_s2": np.ones(3, f32), "completion": "fitted", "model_points": 96, "confirm": 2,
            "missed": 5, "hidden_s": 3.0, "clusters": 8, "units": 8, "extents_m": (0.01, 5.0), "first_velocity": (2.0, 4.0),
            "seed": 1, "network": True,
        }),
        "Tracker.observe": (tracker.observe, {"time_s": 0.0, "views": [rf.DepthView(camera, depth), cloud]}),
        "Tracker.predict": (tracker.predict, {"horizon_s": 0.1}),
        "Tracker.shape": (tracker.shape, {"id": 0}),
        "Tracker.mass_kg": (tracker.mass_kg, {"id": 0}),
        "check": (rf.check, {
            "float_model": nano, "quantised": nano, "dataset": rf.Dataset.embedded(), "steps": [1], "split": "test", "limit": 1,
            "tolerances": None,
        }),
        "evaluate": (rf.evaluate, {
            "model": nano, "dataset": rf.Dataset.embedded(), "steps": [1], "split": "test", "limit": 1, "join": False,
        }),
        "free_fall": (rf.free_fall, {"scene": scene, "step": 10, "last_frame": 20}),
        "kernels": (rf.kernels, {}),
        "network_inputs": (rf.network_inputs, {
            "model": nano, "scene": scene, "windows": [(0, 1)], "points": None, "starts": None,
        }),
        "pack": (rf.pack, {
            "source": MODELS / "nano-f32.rfm", "out": folder / "packed.rfm", "dtype": "i8", "wide": [], "narrow": [],
            "panels": False, "provenance": {"note": "n"}, "scope": None, "ranges": None,
        }),
        "rollout": (rf.rollout, {
            "model": nano, "scene": scene, "step": 10, "last_frame": 12, "join": False, "threads": 1, "kernel": "portable",
        }),
        "from_xyzw": (rf.from_xyzw, {"poses": poses}),
        "to_xyzw": (rf.to_xyzw, {"poses": poses}),
    }  # fmt: skip
    return world, calls


class Ended(Exception):
    """A call that was ended because it takes long."""


def of_float(argument, error):
    """Whether it is what ``float`` says of the argument."""
    try:
        float(argument)
    except (ValueError, OverflowError) as said:
        return repr(said) == repr(error)
    except TypeError:
        pass
    return False


def end(*_):
    raise Ended


def state(world):
    return world.poses().tobytes(), world.ids, world.dt_s, world.gravity_m_s2.tobytes(), len(world.planes), len(world.joints)


@pytest.fixture
def saved(tmp_path, monkeypatch, scene):
    """An empty folder to be in, so that names of any kind make files there."""
    scene.save(tmp_path / "saved.safetensors", dataset="d", provenance="p", licence="l")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_every_public_call_is_tried(nano, scene, saved):
    _, calls = sound_calls(nano, scene, saved, np.random.default_rng(0))
    public = set()
    for name in rf.__all__:
        found = getattr(rf, name)
        if not inspect.isclass(found):
            public.update([name] if callable(found) else [])
        elif not issubclass(found, BaseException):
            members = inspect.classify_class_attrs(found)
            methods = [m.name for m in members if m.kind not in ("data", "property") and not m.name.startswith("_")]
            public.update(f"{name}.{method}" for method in methods if callable(getattr(found, method)))
            # Without a signature there is no constructor.
            if found.__text_signature__:
                public.add(name)
    assert public - set(calls) == set()
    # Sound arguments are taken, or refused for what they mean together.
    for name, (call, arguments) in calls.items():
        try:
            call(**arguments)
        except rf.InputError:
            pass
        except TypeError:
            assert name in ("PushPlanner.passed", "Planner.plan", "PushPlanner.plan", "Planner.plan_by"), name


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="there are no timers here")
def test_what_is_refused_is_refused_by_documented_exceptions(nano, scene, saved):
    random = np.random.default_rng(7)
    before = signal.signal(signal.SIGALRM, end)
    faults = {}
    try:
        world, calls = sound_calls(nano, scene, saved, random)
        for name in calls:
            for _ in range(TRIALS):
                call, arguments = calls[name]
                given = dict(arguments)
                for key in random.permutation(list(given))[: random.integers(1, 4)]:
                    given[key] = wrong(random, given[key])
                # So many copies are taken where there is memory for them, and a test must not ask for all of it.
                if name == "BatchSimulator.copies" and isinstance(given["count"], (int, np.integer)) and given["count"] > 255:
                    given["count"] = 1 << 40
                was = state(world)
                try:
                    try:
                        signal.setitimer(signal.ITIMER_REAL, PATIENCE_S)
                        call(**given)
                    finally:
                        signal.setitimer(signal.ITIMER_REAL, 0)
                except Ended:
                    world, calls = sound_calls(nano, scene, saved, random)
                    continue
                except (rf.RigidFormerError, *OF_PYTHON) as error:
                    if isinstance(error, rf.FaultError):
                        faults.setdefault(f"{name}: a fault: {error!r:.300}", given)
                    elif state(world) != was and name not in ("World.step", "World.rollout"):
                        faults.setdefault(f"{name}: has changed the world and raised {error!r:.200}", given)
                except BaseException as error:  # noqa: BLE001
                    if any(of_float(argument, error) for argument in given.values()):
                        continue
                    faults.setdefault(f"{name}: {error!r:.300}", given)
                world, calls = sound_calls(nano, scene, saved, random) if name.startswith("World") else (world, calls)
    finally:
        signal.signal(signal.SIGALRM, before)
    shown = [f"{fault}\n    {given!r:.600}" for fault, given in faults.items()]
    assert not faults, "\n".join(shown[:40])
