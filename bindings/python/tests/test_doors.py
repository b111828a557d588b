"""Python as its users write it: arrays that count, exceptions by their names, processes that fork, threads with small stacks."""

from __future__ import annotations

import copy
import errno
import multiprocessing
import os
import pickle
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import rigidformer as rf
from conftest import ROOT, at, cube, falling

posix = pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")


def run(code: str, *arguments: str, cwd=None, limit: float = 60) -> str:
    """What a program prints."""
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, timeout=limit, cwd=cwd
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.mark.parametrize("value", [1e-46, 1e-320, -3e-42])
def test_numbers_too_small_for_float32_are_no_error_of_numpys(value):
    points = cube().astype(np.float64)
    points[0, 0] = value
    with np.errstate(all="raise"):
        unit = rf.Unit(points)
        assert np.geterr()["under"] == "raise"
    assert (unit.points == points.astype(np.float32)).all()
    with np.errstate(all="raise"), pytest.raises(TypeError):
        rf.Unit(points.astype(complex))


def test_objects_own_arrays_are_read_only(nano, scene):
    world, cube_id = falling(nano)
    unit, plane = rf.Unit(cube()), rf.Plane([0, 0, 1])
    trajectory = rf.free_fall(scene, 10)
    camera = rf.Camera(4, 4, 2, 2, 2, 2)
    soft = rf.Unit(cube(), rest=cube(), young_pa=1e4)
    goal = rf.PushGoal([0, 1])
    for array in (
        world.gravity_m_s2,
        unit.points,
        soft.rest,
        plane.normal,
        scene.poses,
        scene.gravity_m_s2,
        trajectory.poses,
        trajectory.frames,
        camera.pose,
        goal.place_m,
        rf.Planner([rf.Parameter(0, 1)]).mean,
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    for planes in (world.planes, scene.planes):
        assert isinstance(planes, tuple) and not hasattr(planes, "append")
    assert isinstance(scene.units, tuple)
    world.planes = (*world.planes, rf.Plane([1, 0, 0], -1))
    world.gravity_m_s2 = world.gravity_m_s2 * [1, 1, 0]
    assert len(world.planes) == 2 and world.gravity_m_s2[2] == 0
    # What calls return is the caller's.
    for array in (world.poses(), world.pose(cube_id), world.points(cube_id), world.rollout(1)):
        array[...] = 0
    assert world.pose(cube_id)[3] != 0


def test_masked_numbers_are_refused(nano):
    world, cube_id = falling(nano)
    points = np.ma.masked_greater(cube(), 0.1)
    single = np.ma.masked_array(at(z=1), mask=[1, 0, 0, 0, 0, 0, 0])

    class Table:
        def __array__(self, dtype=None, copy=None):
            return points

    for call in (
        lambda: rf.Unit(points),
        lambda: rf.Unit(points.astype(np.float64)),
        lambda: rf.Unit(np.ma.masked_array(cube())),
        lambda: rf.Unit(list(points)),
        lambda: rf.Unit(Table()),
        lambda: world.add(rf.Unit(cube()), single),
        lambda: world.observe(1 / 24, [rf.Unit(cube())], [points]),
        lambda: world.poses(np.ma.zeros((1, 7), np.float32)),
        lambda: rf.DepthView(rf.Camera(2, 2, 1, 1, 1, 1), np.ma.zeros((2, 2), np.uint16)),
    ):
        with pytest.raises(rf.InputError, match="masked"):
            call()
    # Other classes of arrays are arrays.
    assert (rf.Unit(cube().view(np.recarray)).points == cube()).all()


class Tensor:
    """A tensor of a library that does not know numpy."""

    def __init__(self, array):
        self.array = array

    def __dlpack__(self, **arguments):
        return self.array.__dlpack__(**arguments)

    def __dlpack_device__(self):
        return self.array.__dlpack_device__()


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int32])
def test_tensors_come_in_and_go_out(nano, dtype):
    points = (cube(1.0)).astype(dtype)
    assert (rf.Unit(Tensor(points)).points == points).all()
    world, _ = falling(nano)
    for array in (world.poses(), world.rollout(2)):
        assert (np.from_dlpack(Tensor(array)) == array).all()


def test_torch_and_jax(nano):
    world, cube_id = falling(nano)
    torch = pytest.importorskip("torch")
    assert (rf.Unit(torch.from_numpy(cube())).points == cube()).all()
    assert (torch.from_dlpack(world.poses()).numpy() == world.poses()).all()


@pytest.mark.parametrize(
    "call, name",
    [
        (lambda w: w.step(-1), "steps"),
        (lambda w: w.rollout(-(10**30)), "steps"),
        (lambda w: w.pose(-1), "id"),
        (lambda w: w.bond([(1, -2)]), "pairs"),
        (lambda w: w.join(-1, 2, [0] * 3, [0] * 3), "unit"),
        (lambda w: rf.Dataset.embedded().scene(-1), "index"),
        (lambda w: rf.VelocityNoise(-1), "seed"),
        (lambda w: rf.VelocityNoise(2**64), "seed"),
        (lambda w: rf.Unit(cube(), body=70_000), "body"),
        (lambda w: rf.World(rf.Model("nano"), units=-1), "units"),
        (lambda w: rf.World(rf.Model("nano"), threads=-1), "threads"),
        (lambda w: rf.Planner([rf.Parameter(0, 1)], futures=-1), "futures"),
        (lambda w: rf.Launch(-1), "unit"),
        (lambda w: rf.Camera(-1, 2, 1, 1, 1, 1), "width"),
        (lambda w: rf.evaluate(rf.Model("nano"), rf.Dataset.embedded(), steps=[2**40]), "steps"),
    ],
)
def test_whole_numbers_out_of_range(nano, call, name):
    world, _ = falling(nano)
    for also in (rf.RigidFormerError, rf.InputError, ValueError, OverflowError):
        with pytest.raises(also, match=f"^{name} is -?[^ ]+"):
            call(world)


def test_files_are_refused_by_pythons_names(tmp_path):
    path = tmp_path / "none.rfm"
    for load in (rf.Model, rf.Dataset):
        with pytest.raises(FileNotFoundError) as raised:
            load(path)
        error = raised.value
        assert isinstance(error, rf.FileError) and error.errno == errno.ENOENT
        assert error.filename == str(path) and error.strerror == os.strerror(errno.ENOENT)
        for same in (pickle.loads(pickle.dumps(error)), copy.copy(error)):
            assert type(same) is type(error) and str(same) == str(error)
            assert (same.errno, same.filename) == (error.errno, error.filename)
    with pytest.raises(IsADirectoryError):
        rf.Dataset(tmp_path)
    with pytest.raises(FileNotFoundError):
        rf.pack(Path(ROOT / "weights/models/nano-f32.rfm"), tmp_path / "no" / "folder.rfm")
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises((NotADirectoryError, FileNotFoundError)):
        rf.Model(tmp_path / "file" / "x.rfm")


def test_errors_are_in_pythons_words(nano):
    texts = []

    def note(call) -> None:
        with pytest.raises(rf.RigidFormerError) as raised:
            call()
        texts.append(str(raised.value))

    world = rf.World(nano, units=1, points=8)
    note(lambda: world.add(rf.Unit(cube()), at()))
    world.dt_s = 1 / 24
    cube_id = world.add(rf.Unit(cube()), at(z=1))
    note(lambda: world.add(rf.Unit(cube()), at(z=3)))
    note(lambda: world.drive(cube_id, at()))
    note(lambda: rf.Scene([rf.Unit(cube())], [[at()]], 24).save("x", dataset="d", provenance="p", licence="l"))
    assert "set dt_s" in texts[0] and "units=" in texts[1] and 'set_role(id, "driven")' in texts[2]
    assert "planes=" in texts[3]
    assert not any(re.search(r"::|set_dt\b|--[a-z]|Limits|with_", text) for text in texts)


def test_no_text_of_the_core_has_a_rust_name_that_python_does_not_translate():
    # The texts, and the dictionary of them, as they are in the sources.
    errors = ROOT / "bindings" / "python" / "src" / "errors.rs"
    if not errors.exists():
        pytest.skip("the sources are not beside the tests")
    words = re.findall(r'^    \("([^"]+)", ', errors.read_text(), re.M)
    assert len(words) >= 10
    source = (ROOT / "core/src/error.rs").read_text()
    for text in re.findall(r'#\[error\(\s*"([^"]+)"', source):
        # Slabs are memory of firmware's.
        if "slab" in text:
            continue
        for word in words:
            text = text.replace(word, "")
        assert not re.search(r"[A-Z]\w+::\w|set_\w+|with_\w+|replicate", text), text


@pytest.mark.parametrize("name", ["\x1b[2J\x1b]0;x\x07", "a\nb\rc", "\u202eabc"])
def test_texts_of_files_cannot_write_on_terminals(tmp_path, name, nano):
    with pytest.raises(rf.InputError) as raised:
        rf.Model.from_bytes(b"none", name)
    text = str(raised.value)
    assert not re.search("[\x00-\x1f\x7f-\x9f\u202a-\u202e]", text) and "\\u{" in text
    with pytest.raises(rf.InputError) as raised:
        nano.quantised(name)
    assert not re.search("[\x00-\x1f\x7f-\x9f]", str(raised.value))


def test_objects_without_entries_are_true(nano, scene):
    for empty in (
        rf.World(nano),
        rf.BatchSimulator(nano).run(rf.Start.of_scene(scene), 0, 1),
    ):
        assert len(empty) == 0 and bool(empty) and (empty or None) is empty
    assert rf.Dataset.embedded() and rf.free_fall(scene)


@pytest.mark.parametrize("unit", [1, 7, 2**40])
def test_targets_of_units_that_are_not_there(nano, unit):
    start = rf.Start(1 / 24, [rf.Unit(cube(), role="driven")], [at(z=1)], [at(z=1)])
    targets = np.tile(at(z=1), (2, 3, 1))
    with pytest.raises(rf.InputError, match=f"no unit {unit} of 1"):
        rf.BatchSimulator(nano).run(start, 2, 3, targets={unit: targets})


@pytest.mark.parametrize("folder", ["python", "rigidformer"])
def test_imports_in_folders_of_any_name(tmp_path, folder):
    place = tmp_path / folder
    place.mkdir()
    for cwd in (place, tmp_path, ROOT / "bindings" / "python", ROOT / "bindings"):
        assert run("import rigidformer; print(rigidformer.kernels()[0])", cwd=cwd) == "portable\n"


@pytest.mark.parametrize("shape", [(7,), (3, 7), (2, 3, 7), (4,), (5, 4)])
def test_orders_of_quaternions(shape):
    numbers = np.arange(np.prod(shape), dtype=np.float64).reshape(shape)
    last = rf.to_xyzw(numbers)
    assert (last[..., -1] == numbers[..., -4]).all() and (last[..., -4:-1] == numbers[..., -3:]).all()
    assert (last[..., :-4] == numbers[..., :-4]).all() and last.dtype == np.float32
    assert (rf.from_xyzw(last) == numbers).all()
    with pytest.raises(rf.InputError, match="shape"):
        rf.from_xyzw(numbers[..., :3])


def stepped(world: rf.World, calls: list) -> None:
    """In a forked process."""
    for call in calls:
        call(world)


def steps_of_all_kinds(model, scene) -> list:
    start = rf.Start.of_scene(scene)
    return [
        lambda world: world.step(),
        lambda world: world.step(5),
        lambda world: world.rollout(3),
        lambda world: rf.rollout(model, scene, last_frame=30),
        lambda world: rf.BatchSimulator(model, threads=2).run(start, 40, 2),
        lambda world: rf.evaluate(model, rf.Dataset.embedded(), limit=1, steps=[10]),
    ]


def observed(model, scene) -> rf.World:
    world = rf.World(model, threads=2)
    world.observe_poses(10 / scene.frame_rate_hz, scene.units, scene.poses[0], scene.poses[10])
    return world


def in_fork(call) -> int:
    """The exit status of a fork that makes the call; never a hang."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            call()
            status = 0
        finally:
            os._exit(status)
    end = time.monotonic() + 60
    while time.monotonic() < end:
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.01)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    pytest.fail("the fork hangs")


@posix
def test_forks_work_before_and_after_threads_are_made(nano, scene):
    calls = steps_of_all_kinds(nano, scene)
    world = observed(nano, scene)
    expected = observed(nano, scene).rollout(3)
    assert in_fork(lambda: stepped(world, calls)) == 0
    for call in calls:
        call(world)
    assert in_fork(lambda: stepped(world, calls)) == 0
    # A fork of a fork, and the parent after all of them.
    assert in_fork(lambda: None if in_fork(lambda: stepped(world, calls)) == 0 else 1 / 0) == 0
    assert (observed(nano, scene).rollout(3) == expected).all()


def child(scene_name: str) -> None:
    model, scene = rf.Model("nano"), rf.Dataset.embedded().scene(0)
    stepped(observed(model, scene), steps_of_all_kinds(model, scene))


@posix
def test_multiprocessing_by_fork(nano, scene):
    observed(nano, scene).step(5)
    process = multiprocessing.get_context("fork").Process(target=child, args=("",))
    process.start()
    process.join(60)
    hangs = process.is_alive()
    process.kill()
    process.join()
    assert not hangs and process.exitcode == 0


@posix
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_forks_while_other_threads_compute(nano, scene):
    stop = threading.Event()
    busy = observed(nano, scene)

    def compute() -> None:
        while not stop.is_set():
            busy.step(20)
            rf.BatchSimulator(nano, threads=2).run(rf.Start.of_scene(scene), 8, 2)

    threads = [threading.Thread(target=compute) for _ in range(2)]
    for thread in threads:
        thread.start()
    try:
        for _ in range(5):
            time.sleep(0.02)
            assert in_fork(lambda: stepped(observed(nano, scene), steps_of_all_kinds(nano, scene))) == 0

            def on_the_busy_one() -> None:
                # Another thread's, which is not here, may be in the middle of a step: then an error, and never a wait.
                try:
                    busy.step()
                except rf.InputError as error:
                    assert "forked" in str(error)

            assert in_fork(on_the_busy_one) == 0
    finally:
        stop.set()
        for thread in threads:
            thread.join()


@pytest.mark.parametrize("kib", [64, 128, 256])
def test_threads_with_small_stacks(kib):
    code = """
import sys, threading, numpy as np, rigidformer as rf
np.zeros(3).sum()  # numpy's first calls are numpy's business
scene, model = rf.Dataset.embedded().scene(0), rf.Model("nano")
edge = rf.Model("edge")
rf.World(model)
def go():
    for m in (model, edge):
        for threads in (1, 2):
            w = rf.World(m, threads=threads)
            w.observe_poses(10 / scene.frame_rate_hz, scene.units, scene.poses[0], scene.poses[10])
            w.step(12); w.step(); w.rollout(2)
            w.observe(1 / 24, scene.units, [unit.points for unit in scene.units])
            w.add(scene.units[0], [0, 0, 9, 1, 0, 0, 0])
            w.step()
        rf.BatchSimulator(m).run(rf.Start.of_scene(scene), 8, 2)
        rf.rollout(m, scene, last_frame=20)
    print("ok")
threading.stack_size(int(sys.argv[1]) * 1024)
t = threading.Thread(target=go); t.start(); t.join()
"""
    assert run(code, str(kib)) == "ok\n"


@pytest.mark.parametrize("count", [1500, 40_000])
def test_meshes_of_many_points_are_added(nano, count):
    chance = np.random.default_rng(2)
    ball = chance.normal(size=(count, 3))
    ball = (0.1 * ball / np.linalg.norm(ball, axis=1, keepdims=True)).astype(np.float32)
    for points in (ball, np.concatenate([ball, ball[:7], np.copysign(0, ball[:5])])):
        world = rf.World(nano, units=1, points=len(points))
        world.dt_s = 1 / 24
        begin = time.process_time()
        unit = world.add(rf.Unit(points), at(z=1))
        print(f"{len(points)} points: {time.process_time() - begin:.2f} s of the processor")
        # Whatever their order, they are those that were given, and the anchors are far apart.
        found = world.points(unit) - [0, 0, 1]
        assert np.abs(np.sort(found, axis=0) - np.sort(points, axis=0)).max() < 1e-6
        apart = np.linalg.norm(found[:4, None] - found[None, :4], axis=2)[np.triu_indices(4, 1)]
        assert apart.min() > 0.1


LIMITED = """
import resource, sys, numpy as np, rigidformer as rf
scene, model = rf.Dataset.embedded().scene(0), rf.Model("nano")
def size():
    for line in open("/proc/self/status"):
        if line.startswith("VmSize"): return int(line.split()[1]) * 1024
resource.setrlimit(resource.RLIMIT_AS, (size() + (1 << 30),) * 2)
import threading
threads = None if sys.argv[1] == "all" else int(sys.argv[1])
world = rf.World(model, threads=threads)
world.observe_poses(10 / scene.frame_rate_hz, scene.units, scene.poses[0], scene.poses[10])
world.step(); world.step(5)
np.save(sys.argv[2], world.poses())
rf.BatchSimulator(model, threads=threads).run(rf.Start.of_scene(scene), 40, 2)
rf.rollout(model, scene, last_frame=20, threads=threads)
planner = rf.Planner([rf.Parameter(0, 1)] * 3, futures=32, iterations=1, steps=2)
planner.plan(rf.BatchSimulator(model), rf.Start.of_scene(scene), rf.Launch(0), lambda parameters, poses: float(poses[-1, 0, 0]))
try: rf.evaluate(model, rf.Dataset.embedded(), limit=1)
except rf.RigidFormerError as error: print(error)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
@pytest.mark.parametrize("threads", ["all", "1", "4"])
def test_processes_that_get_no_threads(tmp_path, threads, nano, scene):
    path = tmp_path / "poses.npy"
    # A thread's stack is larger than what memory the process may have.
    environment = {**os.environ, "RUST_MIN_STACK": str(1 << 40)}
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, threads, path], capture_output=True, text=True, timeout=60, env=environment
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert "no threads" in done.stdout and "ulimit" in done.stdout
    world = observed(nano, scene)
    world.step(6)
    assert (np.load(path) == world.poses()).all()


@pytest.mark.parametrize("futures", [64, 2000, 50_000])
def test_a_deadline_of_many_pushes_leaves_a_plan(nano, futures):
    planner = rf.PushPlanner(
        rf.Unit(cube(0.025)), rf.Unit(cube(0.01)), 0.01, futures=futures, iterations=10_000
    )
    seen = np.array([[0, 0, 0.025, 1, 0, 0, 0], [0.1, 0, 0.02, 1, 0, 0, 0]])
    goal = rf.PushGoal([-0.06, 0])
    begin = time.monotonic()
    plan = planner.plan(rf.BatchSimulator(nano), seen, seen, goal, deadline_s=1.0)
    print(f"{futures} futures: {time.monotonic() - begin:.2f} s for a deadline of 1 s")
    assert plan.cost <= plan.stay and plan.search.cut == "the deadline passed"


LONG = """
import signal, sys, numpy as np, rigidformer as rf
signal.signal(signal.SIGINT, signal.default_int_handler)
start, model = rf.Start.of_scene(rf.Dataset.embedded().scene(0)), rf.Model("edge")
print("ready", flush=True)
try:
    rf.BatchSimulator(model).run(start, int(sys.argv[1]), 20)
    print("ended")
except KeyboardInterrupt:
    print("interrupted")
"""


@posix
@pytest.mark.parametrize("futures", [2_000, 50_000])
def test_ctrl_c_ends_a_batch_of_many_futures(futures):
    child = subprocess.Popen([sys.executable, "-c", LONG, str(futures)], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None and child.stdout.readline() == "ready\n"
    time.sleep(0.3)
    child.send_signal(signal.SIGINT)
    sent = time.monotonic()
    said, _ = child.communicate(timeout=60)
    print(f"{futures} futures: ended {time.monotonic() - sent:.2f} s after the signal")
    assert said == "interrupted\n"


def test_a_robot_is_read_and_makes_a_scene(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    inertial = "<inertial><mass value='1'/><inertia ixx='1' iyy='1' izz='1'/></inertial>"
    shape = "<collision><geometry><box size='.1 .1 .1'/></geometry></collision>"
    links = "".join(f"<link name='{name}'>{inertial}{shape}</link>" for name in "ab")
    joint = "<joint name='j' type='continuous'><parent link='a'/><child link='b'/><origin xyz='0 0 1'/></joint>"
    file.write_text(f"<robot name='arm'>{links}{joint}</robot>")
    robot = rf.load_robot(file)
    assert robot.links == ["a", "b"] and robot.rest == [0.0] and robot.mass_kg == 2.0
    assert robot.poses([0.0])[1, 2] == 1.0
    assert [joint["kind"] for joint in robot.describe()["joints"]] == ["continuous"]
    scene = robot.scene(points=16, fixed_base=True)
    assert [len(unit.points) for unit in scene.units] == [16, 16]
    with pytest.raises(rf.InputError, match="positions"):
        robot.poses([])
    file.write_text("<sdf/>")
    with pytest.raises(rf.InputError, match="SDF"):
        rf.load_robot(file)
    with pytest.raises(rf.FileError):
        rf.load_robot(tmp_path / "none.urdf")
