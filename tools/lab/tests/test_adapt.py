"""Adapting to a few recorded scenes: written where it pays, and only there."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from conftest import needed
from rigidformer_lab import adapt
from rigidformer_lab.scenes import EXTRA, TEST, TRAIN, VALIDATION, Scenes, read_scenes, write_scenes
from rigidformer_lab.windows import collect

rigidformer = needed("rigidformer")
MODEL = Path(__file__).resolve().parents[3] / "weights" / "models" / "nano-f32.rfm"
RATE, GRAVITY, HALF = 148.0, 9.81, 0.05
BOUNCES = 0.2  # what scene files say: unit and plane together


def height(time, drop, speed, bounces):
    """Of a body's underside that begins so high and so fast upwards, at any times."""
    out = np.empty_like(time)
    for k, t in enumerate(time):
        z, v = drop, speed
        while True:
            lands = (v + np.sqrt(v * v + 2 * GRAVITY * z)) / GRAVITY
            if t < lands:
                out[k] = z + v * t - 0.5 * GRAVITY * t * t
                break
            t, z, v = t - lands, 0.0, bounces * (GRAVITY * lands - v)
            if v < 1e-3:
                out[k] = 0.0
                break
    return out


def drops(path, bounces, count=16, frames=60, velocities=True):
    """A scene file of cubes that drop flat and bounce so, whatever the file says of them."""
    rng = np.random.default_rng(3)
    points = HALF * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    time, poses, velocity = np.arange(frames) / RATE, np.zeros((count, frames, 7)), np.zeros((count, 6))
    for scene in range(count):
        drop, speed, along = rng.uniform(0.05, 0.25), rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5, 2)
        poses[scene, :, :2] = along * time[:, None]
        poses[scene, :, 2] = HALF + height(time, drop, speed, bounces)
        poses[scene, :, 3] = 1
        velocity[scene, :3] = (*along, speed)
    share = np.sqrt(BOUNCES)
    write_scenes(path, Scenes(
        dataset="drops", shape_names=["cube"], shape_points=points, shape_offsets=np.array([0, 8]), scene_seed=np.arange(count),
        scene_split=np.array(([TRAIN] * 6 + [VALIDATION, EXTRA] * 3 + [TEST] * count)[:count], np.uint8), scene_units=np.arange(count + 1),
        unit_shape=np.zeros(count, np.int32), unit_scale=np.ones(count, np.float32),
        unit_physics=np.tile(np.array([0.4, 0.0, share], np.float32), (count, 1)), unit_poses=poses.astype(np.float32), provenance="p",
        licence="l", frame_rate_hz=RATE, gravity_m_s2=(0.0, 0.0, -GRAVITY), ground_friction=None, ground_restitution=None,
        planes=np.tile(np.array([0, 0, 1, 0, 0.0, share], np.float32), (count, 1)), scene_planes=np.arange(count + 1),
        unit_velocity=velocity.astype(np.float32) if velocities else None,
    ))  # fmt: skip
    return path


def run(recording, out, *more):
    few = ["--folds", "2", "--stops", "20", "60", "--shares", "1", "--starts", "zeros", "--steps", "5", "--frames", "3", "--lr", "1e-3",
           "--slots", "64", "--loss-beta", "0.2", "--threads", "1"]  # fmt: skip
    return adapt.main([str(recording), "--from", str(MODEL), "--out", str(out), *few, *map(str, more)])


@pytest.fixture
def program():
    if shutil.which("rigidformer") is None and not os.environ.get("RIGIDFORMER_COMPLETE"):
        pytest.skip("the program rigidformer is not on the PATH")


def test_what_can_be_learnt_is_written(tmp_path, capsys, program):
    recording, out, told = drops(tmp_path / "drops.safetensors", 0.7), tmp_path / "adapted.rfm", tmp_path / "report.json"
    assert run(recording, out, "--json", told) == 0
    said = capsys.readouterr().out
    assert "on folds: written" in said and str(out) in said
    report = json.loads(told.read_text())
    assert report["scenes"] == 12 and report["kept_percent"] > 20 and report["verdict"] in said
    assert not any(row["worse"] for row in report["folds"])
    assert {"candidates", "model_folds", "last_stop_kept_percent", "kept_on_unseen_folds_percent"} <= set(report)
    wide, narrow = rigidformer.Model(tmp_path / "adapted-f32.rfm"), rigidformer.Model(out)
    assert narrow.name == wide.name == "nano" and narrow.nbytes < wide.nbytes
    assert "drops" in narrow.provenance["adapt"] and "from nano-f32.rfm" in narrow.provenance["adapt"]
    assert not list(tmp_path.glob(".*"))
    # On the test scenes, which nothing was chosen by, it keeps what it kept on folds or most of it.
    figures = json.loads(adapt.call("evaluate", recording, "--model", out, "--steps", "5", "--json"))["gains"]
    position = next(gain for gain in figures if gain["figure"] == "position_m")
    assert position["with_network"] < 0.9 * position["without_network"]


def test_what_is_known_already_is_not(tmp_path, capsys, program):
    out = tmp_path / "adapted.rfm"
    assert run(drops(tmp_path / "drops.safetensors", BOUNCES), out, "--stops", "5", "10") == 0
    assert capsys.readouterr().out == "no gain: not written\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drops.safetensors"]


def test_an_interrupted_run_leaves_nothing(tmp_path, capsys, monkeypatch, program):
    recording = drops(tmp_path / "drops.safetensors", 0.7)

    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(adapt, "learn", interrupt)
    assert run(recording, tmp_path / "adapted.rfm") == 130
    assert "nothing is written" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["drops.safetensors"]


@pytest.mark.parametrize("more, says", [
    (("--from", "none"), "is no file and no shipped model"),
    (("--from", MODEL.with_name("nano.rfm")), "give its f32 file"),
    (("--from", MODEL.with_name("shell-f16.rfm")), "give edge or nano"),
    (("--contact", "none.toml"), "rigidformer calibrate"),
    (("--folds", "9"), "12 scenes of the splits train, validation and extra; 9 folds take 18"),
    (("--out", "no/folder.rfm"), "there is no folder"),
    (("--out", MODEL), "would overwrite"),
])  # fmt: skip
def test_bad_input_is_told(tmp_path, capsys, program, more, says):
    recording = drops(tmp_path / "drops.safetensors", 0.7)
    assert run(recording, tmp_path / "adapted.rfm", *more) == 1
    assert says in capsys.readouterr().err


def test_a_missing_program_is_told(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert run(drops(tmp_path / "drops.safetensors", 0.7), tmp_path / "adapted.rfm") == 1
    assert "`rigidformer` is not on the PATH; build it" in capsys.readouterr().err


def test_one_bad_fold_rules_a_candidate_out():
    good, bad = adapt.Candidate("zeros", 10, 0.5), adapt.Candidate("zeros", 20, 1.0)
    figures = lambda metres, degrees: {("position", 2): adapt.Figure(metres, 0.1, 1000), ("orientation", 2): adapt.Figure(degrees, 10.0, 0.8)}  # noqa: E731
    table = {good: [figures(0.09, 9.9), figures(0.095, 10.1)], bad: [figures(0.01, 1.0), figures(0.1, 10.1)]}
    assert adapt.chosen(table, 1) == good and adapt.chosen(table, 1, [0]) == bad and adapt.chosen({bad: table[bad]}, 1) is None
    assert adapt.chosen(table, 50) is None
    assert adapt.unseen(table, 1, 2) == [pytest.approx(100 * 10.08 / 108), pytest.approx(100 * -0.08 / 108)]
    assert adapt.kept(table[good], "position") == pytest.approx(7.5)


def test_no_fold_has_a_test_scene():
    fold = adapt.folds_of(np.array([TRAIN, TEST, VALIDATION, EXTRA, TRAIN, TEST, TRAIN]), 2, 0)
    assert (fold[[1, 5]] == -1).all() and sorted(fold[[0, 2, 3, 4, 6]].tolist()) == [0, 0, 0, 1, 1]


def test_windows_take_contacts_numbers_and_start_as_bodies_leave(tmp_path):
    recording, contact = drops(tmp_path / "drops.safetensors", 0.7), tmp_path / "contact.toml"
    contact.write_text('format = "rigidformer-contact"\nversion = 1\nrestitution = 0.7\n')
    config, of = adapt.PRESETS["nano"], {}
    for name, more in {"as it says": {}, "as it is": {"contact": contact}}.items():
        arrays = collect([recording], (TRAIN,), config, 600, [3], points=8, threads=1, whole=True, impulse_m_s=0.1, **more)
        of[name] = np.abs(arrays["wanted"][arrays["share"] > 0.5]).mean()
        assert set(arrays["scene"].tolist()) <= set(range(6)) and len(arrays["scene"]) == len(arrays["code"])
    # With the restitution that the record has, hardly anything is left to learn.
    assert of["as it is"] < 0.2 * of["as it says"]
    noisy, quiet = (collect([recording], (TRAIN,), config, 200, [3], points=8, threads=1, noise_m_s=noise)["features"] for noise in (0.1, 0.0))
    assert noisy.shape != quiet.shape or (noisy != quiet).any()


def test_frames_of_windows_are_those_of_the_steps(tmp_path):
    file = read_scenes(drops(tmp_path / "drops.safetensors", 0.7))
    assert adapt.frames_of([2, 5], file, adapt.PRESETS["nano"]) == [1, 2, 3, 4]
    file.unit_velocity = None
    assert adapt.frames_of([10], file, adapt.PRESETS["nano"]) == [9, 10, 11]
