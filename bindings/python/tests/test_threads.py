"""Long calls free the interpreter, and Ctrl-C ends them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import rigidformer as rf
from conftest import MODELS, at, cube, falling


def test_two_threads_step_two_worlds(nano):
    worlds = [falling(nano)[0] for _ in range(2)]
    expected = falling(nano)[0].rollout(200)
    found: list = [None, None]

    def run(number: int) -> None:
        found[number] = worlds[number].rollout(200)

    threads = [threading.Thread(target=run, args=(number,)) for number in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (found[0] == expected).all() and (found[1] == expected).all()


def test_other_threads_run_during_rollouts(edge):
    world, _ = falling(edge)
    stop = threading.Event()

    def run() -> None:
        while not stop.is_set():
            world.rollout(20)

    before = sys.getswitchinterval()
    # A thread that does not let go of the interpreter by itself now keeps it for good, and this test never ends.
    sys.setswitchinterval(1000)
    try:
        thread = threading.Thread(target=run)
        thread.start()
        for _ in range(20):
            time.sleep(0.001)
        stop.set()
        thread.join()
    finally:
        sys.setswitchinterval(before)


def test_threads_share_a_world(nano):
    world, cube_id = falling(nano)
    expected, _ = falling(nano)
    expected.step(400)

    def look() -> None:
        for _ in range(200):
            world.step()
            assert np.isfinite(world.pose(cube_id)).all()
            assert world.ids == [cube_id]

    threads = [threading.Thread(target=look) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (world.poses() == expected.poses()).all()


def test_a_cost_is_called_while_others_run(nano):
    start = rf.Start(1 / 24, [rf.Unit(cube())], [at(z=1.5)], [at(z=1.5)])
    planner = rf.Planner([rf.Parameter(0, 1)] * 3, futures=64, iterations=2, steps=3)
    threads = set()

    def cost(parameters, poses):
        threads.add(threading.get_ident())
        return float(poses[-1, 0, 0])

    planner.plan(rf.BatchSimulator(nano), start, rf.Launch(0), cost)
    assert threading.get_ident() not in threads


LONG = """
import os, signal, sys
import numpy as np, rigidformer as rf
# Jobs that a shell puts in the background are born with it ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
model, scene = rf.Model("edge"), rf.Dataset.embedded().scene(0)
world = rf.World(model)
world.observe_poses(10 / scene.frame_rate_hz, scene.units, scene.poses[0], scene.poses[10])
start = rf.Start.of_scene(scene)
forever = 10**7
model_file, scene_file, robot_file = sys.argv[2:]
planner = rf.Planner([rf.Parameter(0, 1)] * 3, futures=100_000, iterations=100, steps=100)
corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
pushes = rf.PushPlanner(rf.Unit(0.025 * corners), rf.Unit(0.01 * corners), 0.01, futures=50_000, iterations=10_000)
seen = np.array([[0, 0, 0.025, 1, 0, 0, 0], [0.1, 0, 0.02, 1, 0, 0, 0]])
goal = rf.PushGoal([-0.06, 0])
robot = rf.Start(1 / 3, [rf.Unit(corners)], [[0, 0, 1, 1, 0, 0, 0]], [[0, 0, 1, 1, 0, 0, 0]])
# Where units lie in it takes minutes to find.
cloud = np.random.default_rng(1).normal(size=(1_000_000 if sys.argv[1] in ("add", "observe") else 8, 3)).astype(np.float32)
large = rf.World(model, points=2 * len(cloud))
large.dt_s = 1 / 24
simulator = rf.BatchSimulator(rf.Model("nano"), memory=1 << 36)
walks = rf.WalkPlanner(futures=100_000, iterations=10_000)
calls = {
    "push": lambda: pushes.plan(rf.BatchSimulator(model), seen, seen, goal),
    "walk": lambda: walks.plan(rf.BatchSimulator(rf.Model(robot_file)), robot, [2, 1]),
    "rollout": lambda: rf.rollout(model, scene, last_frame=forever),
    "world": lambda: world.rollout(forever),
    "step": lambda: world.step(forever),
    "futures": lambda: rf.BatchSimulator(model).run(start, 64, 20_000),
    "plan": lambda: planner.plan(rf.BatchSimulator(model), start, rf.Launch(0), lambda parameters, poses: 0.0),
    "plan_by": lambda: planner.plan_by(lambda samples: [np.linalg.norm(s) for s in samples]),
    "evaluate": lambda: [rf.evaluate(model, rf.Dataset.embedded(), steps=[1] * 10_000)],
    "pack": lambda: rf.pack(model_file, os.devnull, ranges=[scene_file] * 10_000),
    "add": lambda: large.add(rf.Unit(cloud), [0, 0, 1, 1, 0, 0, 0]),
    "observe": lambda: large.observe(1 / 24, [rf.Unit(cloud)], [cloud]),
    "copies": lambda: [simulator.copies(start, 65_536) for _ in range(1000)],
    "copies' step": lambda: [copies.step() for copies in [simulator.copies(start, 4096)] for _ in range(1000)],
    "check": lambda: rf.check(model, model.quantised("i8"), rf.Dataset.embedded(), steps=[1] * 10_000),
}
print("ready", flush=True)
try:
    calls[sys.argv[1]]()
    print("ended")
except KeyboardInterrupt:
    print("interrupted")
    assert len(large) == 0
"""


@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX's here")
@pytest.mark.parametrize(
    "call",
    ["rollout", "world", "step", "futures", "plan", "plan_by", "push", "walk", "evaluate", "pack", "check",
     "add", "observe", "copies", "copies' step"],
)
def test_ctrl_c_ends_a_long_call(call, tmp_path, scene):
    path = tmp_path / "train.safetensors"
    learnt = rf.Scene(scene.units, scene.poses, 240, planes=scene.planes, split="train")
    learnt.save(path, dataset="primitives", provenance="the test", licence="as the scene")
    child = subprocess.Popen(
        [sys.executable, "-c", LONG, call, MODELS / "edge.rfm", path, MODELS / "g1.rfm"],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert child.stdout is not None and child.stdout.readline() == "ready\n"
    time.sleep(0.5)
    child.send_signal(signal.SIGINT)
    sent = time.monotonic()
    # A test asserts no time; without an end it would wait for hours.
    said, _ = child.communicate(timeout=60)
    print(f"{call}: ended {time.monotonic() - sent:.2f} s after the signal")
    assert said == "interrupted\n"
