"""Scene files of recorded tosses, from a recording made here."""

import os
from pathlib import Path

import numpy as np
import pytest

from rigidformer_lab import tosses
from rigidformer_lab.data import Dataset
from rigidformer_lab.geometry import quaternion_to_matrix
from rigidformer_lab.scenes import TEST, TRAIN, read_scenes

LENGTHS = (5, 9, 7)
INDEX = (12, 3, 40)
SPIN = np.array([0.5, -2.0, 1.0])  # in the body frame, rad/s
VELOCITY = np.array([1.0, 0.5, 0.2])


def quaternion_of(turn):
    angle = np.linalg.norm(turn)
    return np.array([np.cos(angle / 2), *(np.sin(angle / 2) * turn / angle)]) if angle else np.array([1.0, 0, 0, 0])


def times(a, b):
    w, x, y, z = a
    return np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]]) @ b


def flight(toss, frames):
    """Rows of a body that falls and turns about one axis of its own, velocities as the ways since the frame before."""
    start = quaternion_of(np.array([0.3 * toss, 0.2, -0.1]))
    rows = []
    for frame in range(frames):
        at = [0.1 * toss, 0, 1] + VELOCITY * frame / 148 + 0.5 * np.array([0, 0, -9.81]) * (frame / 148) ** 2
        before = [0.1 * toss, 0, 1] + VELOCITY * (frame - 1) / 148 + 0.5 * np.array([0, 0, -9.81]) * ((frame - 1) / 148) ** 2
        rows.append([*times(start, quaternion_of(SPIN * frame / 148)), *at, *SPIN, *((at - before) * 148)])
    return np.array(rows)


def write(folder, **changes):
    rows = [flight(toss, length) for toss, length in enumerate(LENGTHS)]
    rows[1][4:, :4] *= -1  # the same orientation
    arrays = {"index": np.array(INDEX, np.int32), "frames": np.array(LENGTHS, np.int32),
              "state": np.concatenate(rows).astype(np.float32)}
    arrays |= changes
    np.savez(folder / tosses.FILE, **{name: array for name, array in arrays.items() if array is not None})
    return folder


def test_a_scene_a_toss_as_recorded(tmp_path, capsys):
    out = tmp_path / "tosses.safetensors"
    assert tosses.main([str(write(tmp_path)), "--out", str(out)]) == 0
    assert "3 tosses of 5 to 9 frames" in capsys.readouterr().out
    scenes = read_scenes(out)
    assert scenes.version == "2" and scenes.dataset == "cube-tosses" and scenes.frame_rate_hz == 148
    assert scenes.scene_seed.tolist() == [3, 12, 40] and scenes.scene_frames.tolist() == [9, 5, 7]
    assert [scenes.frames_of_scene(s) for s in range(3)] == [9, 5, 7] and scenes.frames == 9
    assert (scenes.scene_split == TEST).all() and "BSD-3-Clause" in scenes.licence and "DAIR Lab" in scenes.provenance
    for scene, toss in enumerate((1, 0, 2)):
        rows = flight(toss, LENGTHS[toss])
        poses = scenes.unit_poses[scene].astype(np.float64)
        np.testing.assert_allclose(poses[: len(rows), :3], rows[:, 4:7], atol=1e-6)
        turned = quaternion_to_matrix(poses[: len(rows), 3:])
        np.testing.assert_allclose(turned, quaternion_to_matrix(rows[:, :4]), atol=1e-5)
        assert (poses[len(rows) :] == poses[len(rows) - 1]).all()
        # At the instant of frame 0, in the world.
        np.testing.assert_allclose(scenes.unit_velocity[scene, :3], VELOCITY, atol=2e-4)
        np.testing.assert_allclose(scenes.unit_velocity[scene, 3:], quaternion_to_matrix(rows[0, :4]) @ SPIN, atol=1e-5)
    mass, friction, restitution = scenes.unit_physics[0].astype(np.float64)
    plane = scenes.planes_of_scene(2)[0].astype(np.float64)
    assert plane[:4].tolist() == [0, 0, 1, 0] and len(scenes.planes_of_scene(2)) == 1
    np.testing.assert_allclose([mass, friction * plane[4], restitution * plane[5]], [0.37, 0.18, 0.125], rtol=1e-6)


def test_the_points_are_the_cube():
    points = tosses.cube_points()
    assert len(points) == len(np.unique(points, axis=0)) == 64
    assert (np.abs(points) == np.float32(0.0524)).all(1).sum() == 8
    assert np.abs(points).max() == np.float32(0.0524) and (np.abs(points).max(1) == np.float32(0.0524)).all()
    np.testing.assert_allclose(points.mean(0), 0, atol=1e-8)


def test_some_tosses_are_to_learn_from(tmp_path):
    folder = write(tmp_path)
    first = tosses.make(folder, 1).scene_split == TRAIN
    more = tosses.make(folder, 2).scene_split == TRAIN
    assert first.sum() == 1 and more.sum() == 2 and (more | ~first).all()
    for wrong in (-1, 4):
        with pytest.raises(tosses.TossError, match="from 0 to 3"):
            tosses.make(folder, wrong)


def test_the_rest_of_a_short_scene_is_no_record(tmp_path):
    out = tmp_path / "tosses.safetensors"
    assert tosses.main([str(write(tmp_path)), "--out", str(out)]) == 0
    data = Dataset([out], [TEST], last_frame=6)
    assert data.worlds.frames.tolist() == [7, 5, 7] and data.frames == 7


@pytest.mark.parametrize("changes, message", [
    ({"state": None}, "no array of the name"),
    ({"index": np.array([1, 1, 2])}, "twice"),
    ({"index": np.array([1.0, 3.0, 2.0])}, "not whole numbers"),
    ({"frames": np.array([5, 9])}, "one number a toss"),
    ({"frames": np.array([5, 9, 8])}, "floats of 22 rows"),
    ({"frames": np.array([1, 9, 11])}, "fewer than 2"),
    ({"frames": np.array([-1, 9, 13])}, "fewer than 2"),
    ({"state": np.full((21, 13), np.nan)}, "row 0 is not finite"),
    ({"state": np.ones((21, 13))}, "not of length 1"),
    ({"state": np.ones((21, 12))}, "of 13"),
])
def test_bad_recordings_are_named(tmp_path, capsys, changes, message):
    out = tmp_path / "x.safetensors"
    assert tosses.main([str(write(tmp_path, **changes)), "--out", str(out)]) == 1
    error = capsys.readouterr().err
    assert message in error and tosses.FILE in error and "give the folder" in error and not out.exists()


def test_files_that_are_no_recording(tmp_path, capsys):
    assert tosses.main([str(tmp_path), "--out", str(tmp_path / "x")]) == 1
    assert "No such file" in capsys.readouterr().err
    (tmp_path / tosses.FILE).write_bytes(b"PK\x03\x04 and no more")
    assert tosses.main([str(tmp_path), "--out", str(tmp_path / "x")]) == 1
    assert "cannot be read" in capsys.readouterr().err


def test_the_recording_itself():
    folder = os.environ.get("RIGIDFORMER_TOSSES")
    if not folder:
        pytest.skip("set RIGIDFORMER_TOSSES to the folder of cube_tosses.npz to run this test")
    scenes = tosses.make(Path(folder))
    time = np.arange(11)[:, None] / scenes.frame_rate_hz
    velocity = scenes.unit_velocity[:, None, :3].astype(np.float64)
    free = scenes.unit_poses[:, :1, :3] + velocity * time + 0.5 * np.array(scenes.gravity_m_s2) * time**2
    assert np.median(np.linalg.norm(scenes.unit_poses[:, 10, :3] - free[:, 10], axis=1)) < 0.0015
