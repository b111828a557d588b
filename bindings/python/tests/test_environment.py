"""Results have the same bits whatever the thread has set of its floating-point arithmetic."""

from __future__ import annotations

import ctypes
import hashlib
import itertools
import platform
import struct
import subprocess
import sys

import numpy as np
import pytest

import rigidformer as rf
from conftest import MODELS, at, cube

#: What Python and NumPy round to float32, they round as the thread is set. These need no rounding.
DT_S, POSE = float(np.float32(1 / 24)), at(z=0.7)
MASS_KG, REACH, TURN_RAD = (float(np.float32(value)) for value in (1.3, 0.1, 0.7))


def results(model: rf.Model, scene: rf.Scene, threads: int) -> list[np.ndarray]:
    """What calls of each kind give, all of which are made as the thread is set."""
    unit = rf.Unit(CUBE, mass_kg=MASS_KG)
    world = rf.World(model, units=4, points=64, threads=threads)
    world.dt_s = DT_S
    one = world.add(unit, POSE)
    world.set_velocity(one, SPEED, SPIN)
    found = [world.rollout(3), world.velocities(), world.centres(), world.velocity(one)]
    world.step(2)
    found += [world.pose(one), world.previous_pose(one), world.points(one)]
    simulator = rf.BatchSimulator(model, threads=threads)
    noise = rf.VelocityNoise(3, REACH, TURN_RAD)
    found.append(simulator.run(world.start(), 3, 4, noise=noise).poses)
    copies = simulator.copies(rf.Start(DT_S, [unit], [POSE], [POSE]), 2)
    copies.step()
    found += [copies.poses(), copies.velocities()]
    predicted = rf.rollout(model, scene, last_frame=20, threads=threads)
    found += [predicted.poses, rf.free_fall(scene, last_frame=30).poses, *scene.points(7)]
    found += [np.array(predicted.errors(scene, frame)) for frame in (17, 20)]
    planner = rf.Planner([rf.Parameter(0.0, 1.0)] * 6, futures=32, iterations=2, steps=2)
    plan = planner.plan(simulator, world.start(), rf.Launch(0), lambda _, poses: float(poses[-1, 0, 2]))
    found += [plan.best, plan.poses, plan.mean, plan.deviations]
    goal = rf.PushGoal(PLACE, TURN_RAD)
    found.append(np.array(goal.errors(scene.poses[9, 0])))
    tracker = rf.Tracker(segmentation="given", extents_m=(1 / 128, 5.0))
    for time_s, points in enumerate((SEEN, MOVED)):
        seen = tracker.observe(time_s / 16, [rf.Cloud(points, labels=LABELS)])
    assert seen.units
    found += [array for track in seen.units for array in (track.pose, track.velocity, track.covariance)]
    return found


# Made to nearest: NumPy rounds as the thread is set.
CUBE, PLACE = cube(0.1), np.array([0.1, 0.3], np.float32)
SPEED, SPIN = np.array([0.1, 0.3, 1e-39], np.float32), np.array([0.7, 0.0, 0.1], np.float32)
GRID = np.stack(np.meshgrid(*[np.linspace(-0.1, 0.1, 12)] * 2), -1).reshape(-1, 2)
SIDES = [np.insert(GRID, axis, side, axis=1) for axis in range(3) for side in (-0.1, 0.1)]
SEEN = (np.concatenate(SIDES) + [0.3, 0.1, 0.6]).astype(np.float32)
MOVED, LABELS = SEEN + np.float32([0.01, 0.003, 0]), np.ones(len(SEEN), np.uint16)


def digest(arrays: list[np.ndarray]) -> str:
    bits = hashlib.sha256()
    for array in arrays:
        bits.update(np.ascontiguousarray(array).tobytes())
    return bits.hexdigest()


def libm() -> ctypes.CDLL:
    try:
        return ctypes.CDLL("libm.so.6")
    except OSError as error:
        pytest.skip(str(error))


#: The constants of <fenv.h> for down, up and to zero.
ROUNDINGS = {"x86_64": (0x400, 0x800, 0xC00), "aarch64": (0x800000, 0x400000, 0xC00000)}


@pytest.mark.parametrize("threads", [1, 2])
def test_every_rounding_gives_the_same_bits(edge, scene, threads):
    library, expected = libm(), digest(results(edge, scene, threads))
    for rounding in ROUNDINGS.get(platform.machine(), ()):
        assert library.fesetround(rounding) == 0
        try:
            found = results(edge, scene, threads)
            assert library.fegetround() == rounding
        finally:
            library.fesetround(0)
        assert digest(found) == expected, hex(rounding)


#: To nearest, down, up and to zero; flush of results; operands that count as zeros. The bits of MXCSR.
MODES = [
    sum(bits)
    for bits in itertools.product((0, 0x2000, 0x4000, 0x6000), (0, 0x8000), (0, 0x40))
]
#: All exceptions masked, and all but invalid operations, divisions by zero and overflows: Python itself has inexact results.
MASKS = 0x1F80, 0x1F80 & ~0x680


class Settings:
    """MXCSR of this thread, which lies behind 28 bytes of what glibc keeps."""

    def __init__(self) -> None:
        self.libm = libm()
        self.words = ctypes.create_string_buffer(32)
        assert self.libm.fegetenv(self.words) == 0

    def set(self, mxcsr: int) -> None:
        changed = ctypes.create_string_buffer(self.words.raw[:28] + struct.pack("<I", mxcsr), 32)
        assert self.libm.fesetenv(changed) == 0

    def restore(self) -> None:
        assert self.libm.fesetenv(self.words) == 0


@pytest.mark.skipif(
    sys.platform != "linux" or platform.machine() != "x86_64", reason="sets MXCSR through glibc"
)
def test_every_environment_gives_the_same_bits(tmp_path, edge, scene):
    packed, settings = tmp_path / "packed.rfm", Settings()
    hashes = {digest(results(edge, scene, 1))}
    files = set()
    for masks, mode in itertools.product(MASKS, MODES):
        settings.set(masks | mode)
        try:
            found = results(edge, scene, 2)
            rf.pack(MODELS / "nano-f32.rfm", packed, dtype="i8")
        finally:
            settings.restore()
        hashes.add(digest(found))
        files.add(packed.read_bytes())
    assert (len(hashes), len(files)) == (1, 1)


#: Prints figures, which a process's first call computes as it is set.
FIGURES = """
import ctypes, json, sys
import rigidformer as rf
model, data, libm = rf.Model("edge"), rf.Dataset.embedded(), ctypes.CDLL("libm.so.6")
libm.fesetround(int(sys.argv[1]))
figures = rf.evaluate(model, data, steps=[10])
libm.fesetround(0)  # Python writes digits as it is set
print(json.dumps(figures))
"""


def test_threads_that_share_work_round_to_nearest():
    """They are made in the first call that needs them, by a thread that may round otherwise."""
    libm()
    found = set()
    for rounding in (0, *ROUNDINGS.get(platform.machine(), ())):
        command = [sys.executable, "-c", FIGURES, str(rounding)]
        found.add(subprocess.run(command, check=True, capture_output=True, timeout=600).stdout)
    assert len(found) == 1
