"""The same bits as from the program."""

from __future__ import annotations

import csv
import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

import rigidformer as rf
from conftest import MODELS, ROOT


def run(program: str, *arguments: object) -> str:
    command = [program, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout


def poses_of(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """(samples,) frames and (samples, units, 7) poses of a poses.csv, whose decimals stand for one float32 each."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    units = 1 + max(int(row["unit"]) for row in rows)
    numbers = [[np.float32(row[name]) for name in ("x", "y", "z", "qw", "qx", "qy", "qz")] for row in rows]
    frames = np.array([int(row["frame"]) for row in rows[::units]])
    return frames, np.array(numbers, np.float32).reshape(-1, units, 7)


def bits(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array).view(np.uint32)


@pytest.mark.parametrize("step", [5, 10])
def test_a_rollout_is_that_of_the_program(program, tmp_path, edge, scene, step):
    run(program, "rollout", "--step", step, "--frames", 120, "--out", tmp_path)
    frames, expected = poses_of(tmp_path / "poses.csv")
    found = rf.rollout(edge, scene, step=step, last_frame=120)
    assert (found.frames == frames).all()
    assert (bits(found.poses) == bits(expected)).all()


def test_a_model_file_predicts_what_the_program_predicts(program, tmp_path, scene):
    path = MODELS / "edge-i8.rfm"
    run(program, "rollout", "--model", path, "--frames", 60, "--out", tmp_path)
    _, expected = poses_of(tmp_path / "poses.csv")
    step = int(np.diff(poses_of(tmp_path / "poses.csv")[0])[0])
    found = rf.rollout(rf.Model(path), scene, step=step, last_frame=60)
    assert (bits(found.poses) == bits(expected)).all()


@pytest.mark.parametrize("kernel", rf.kernels())
@pytest.mark.parametrize("threads", [1, 2])
def test_a_world_steps_as_a_rollout_does(edge, scene, kernel, threads):
    expected = rf.rollout(edge, scene, step=10, last_frame=120).poses
    world = rf.World(edge, threads=threads, kernel=kernel)
    world.gravity_m_s2 = scene.gravity_m_s2
    if scene.planes is not None:
        world.planes = scene.planes
    poses = scene.poses
    world.observe_poses(10 / scene.frame_rate_hz, scene.units, poses[0], poses[10])
    assert (bits(world.rollout(11)) == bits(expected[2:])).all()


def test_the_embedded_scene_is_that_of_the_program():
    ours, theirs = ROOT / "bindings" / "python" / "scenes", ROOT / "tools" / "cli" / "scenes"
    assert (ours / "default.safetensors").read_bytes() == (theirs / "default.safetensors").read_bytes()


def test_figures_are_those_of_the_program(program, tmp_path, scene):
    path = tmp_path / "one.safetensors"
    scene.save(path, dataset="primitives", provenance="the test", licence="as the scene")
    said = json.loads(run(program, "evaluate", path, "--steps", "5,10", "--json"))
    dataset = rf.Dataset(path)
    # The program measures the same motion without the network besides.
    gains, alone = said.pop("gains"), said.pop("without_network")
    assert said.pop("changed_by") == [] and said.pop("contact_law") == "0" and alone["name"] == "impulses alone"
    assert [gain["step"] for gain in gains] == [5, 5, 10, 10]
    assert rf.evaluate(rf.Model("edge"), dataset, steps=[5, 10]) == said


def test_a_check_is_that_of_the_program(program, tmp_path, scene):
    path = tmp_path / "one.safetensors"
    scene.save(path, dataset="primitives", provenance="the test", licence="as the scene")
    float_model, quantised = MODELS / "edge.rfm", MODELS / "edge-i8.rfm"
    command = [program, "check", "--float", float_model, "--quantised", quantised, path, "--json"]
    # It may find the models too different on one scene: the exit code then says so.
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=600)
    found = rf.check(rf.Model(float_model), rf.Model(quantised), rf.Dataset(path))
    assert found == json.loads(done.stdout)
    assert found["pass"] == (done.returncode == 0)


def test_a_packed_file_is_that_of_the_program(program, tmp_path):
    ours, theirs = tmp_path / "ours.rfm", tmp_path / "theirs.rfm"
    said = json.loads(
        run(program, "pack", MODELS / "nano-f32.rfm", "--dtype", "i8", "--out", theirs, "--json")
    )
    assert rf.pack(MODELS / "nano-f32.rfm", ours, dtype="i8") == said
    assert ours.read_bytes() == theirs.read_bytes()
    assert rf.Model(ours).parameters == said["parameters"]


def test_a_scene_survives_its_file(tmp_path, scene):
    path = tmp_path / "one.safetensors"
    scene.save(path, dataset="primitives", provenance="the test", licence="as the scene")
    back = rf.Dataset(path).scene(0)
    assert (bits(back.poses) == bits(scene.poses)).all()
    assert back.frame_rate_hz == scene.frame_rate_hz
    made = rf.Scene(scene.units, scene.poses, scene.frame_rate_hz, gravity_m_s2=scene.gravity_m_s2, planes=scene.planes)
    assert (bits(made.poses) == bits(scene.poses)).all()
