"""Scene files of recorded tosses of two linked boxes, from a recording made here."""

import os
from pathlib import Path

import numpy as np
import pytest

from rigidformer_lab import elbow
from rigidformer_lab.geometry import quaternion_to_matrix
from rigidformer_lab.scenes import TEST, TRAIN, read_scenes
from rigidformer_lab.tosses import TossError

LENGTHS = (5, 9, 7)
INDEX = (12, 3, 40)
SPIN = np.array([0.5, -2.0, 1.0])  # of link 1 in its frame, rad/s
RATE = 3.0  # of the hinge, rad/s
VELOCITY = np.array([1.0, 0.5, 0.2])
PIVOTS = np.array([[-0.035, 0.06, 0], [-0.035, 0, 0]])


def turn(vector):
    """Quaternion of a rotation vector."""
    angle = np.linalg.norm(vector)
    return np.array([np.cos(angle / 2), *(np.sin(angle / 2) * vector / angle)]) if angle else np.array([1.0, 0, 0, 0])


def times(a, b):
    w, x, y, z = a
    return np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]]) @ b


def place(toss, time):
    return np.array([0.1 * toss, 0, 1]) + VELOCITY * time + 0.5 * np.array([0, 0, -9.81]) * time**2


def orientation(toss, time):
    return times(turn(np.array([0.3 * toss, 0.2, -0.1])), turn(SPIN * time))


def angle(toss, time):
    return (toss + 3.1 + RATE * time + np.pi) % (2 * np.pi) - np.pi  # the first toss wraps around on its way


def record(toss, frames):
    """Rows of boxes that go their way, velocities as the ways since the frame before."""
    rows = []
    for frame in range(frames):
        at, before = frame / 148, (frame - 1) / 148
        velocity = (place(toss, at) - place(toss, before)) * 148
        rows.append([*orientation(toss, at), *place(toss, at), angle(toss, at), *SPIN, *velocity, RATE])
    return np.array(rows)


def pose_2(toss, time):
    """Rotation and place of the second box: the hinge turns it about the pivot, along y."""
    first = quaternion_to_matrix(orientation(toss, time))
    second = first @ quaternion_to_matrix(turn(np.array([0, angle(toss, time), 0])))
    return second, place(toss, time) + first @ PIVOTS[0] + second @ [0.035, 0, 0]


def write(folder, **changes):
    rows = [record(toss, length) for toss, length in enumerate(LENGTHS)]
    rows[1][4:, :4] *= -1  # the same orientation
    arrays = {"index": np.array(INDEX, np.int32), "frames": np.array(LENGTHS, np.int32),
              "state": np.concatenate(rows).astype(np.float32)}
    arrays |= changes
    np.savez(folder / elbow.FILE, **{name: array for name, array in arrays.items() if array is not None})
    return folder


def pivots(scenes):
    """(scenes, 2, frames, 3) where each box has the pivot."""
    poses = scenes.unit_poses.reshape(scenes.scenes, 2, -1, 7).astype(np.float64)
    return poses[..., :3] + np.einsum("suftj,uj->suft", quaternion_to_matrix(poses[..., 3:]), PIVOTS)


def test_two_boxes_a_toss_as_recorded(tmp_path, capsys):
    out = tmp_path / "elbow.safetensors"
    assert elbow.main([str(write(tmp_path)), "--out", str(out)]) == 0
    assert "3 tosses of 5 to 9 frames, 0 to learn" in capsys.readouterr().out
    scenes = read_scenes(out)
    assert scenes.version == "2" and scenes.dataset == "elbow-tosses" and scenes.frame_rate_hz == 148
    assert scenes.scene_seed.tolist() == [3, 12, 40] and scenes.scene_frames.tolist() == [9, 5, 7]
    assert scenes.scene_units.tolist() == [0, 2, 4, 6] and (scenes.bodies == 0).all() and not scenes.roles.any()
    assert (scenes.scene_split == TEST).all() and "BSD-3-Clause" in scenes.licence and "DAIR Lab" in scenes.provenance
    for scene, toss in enumerate((1, 0, 2)):
        first, second = scenes.unit_poses[scenes.units_of_scene(scene)].astype(np.float64)
        for frame in range(LENGTHS[toss]):
            time = frame / 148
            np.testing.assert_allclose(first[frame, :3], place(toss, time), atol=1e-6)
            turned = quaternion_to_matrix(first[frame, 3:])
            np.testing.assert_allclose(turned, quaternion_to_matrix(orientation(toss, time)), atol=1e-5)
            rotation, centre = pose_2(toss, time)
            np.testing.assert_allclose(second[frame, :3], centre, atol=1e-6)
            np.testing.assert_allclose(quaternion_to_matrix(second[frame, 3:]), rotation, atol=1e-5)
        assert (second[LENGTHS[toss] :] == second[LENGTHS[toss] - 1]).all()
    assert np.abs(np.diff(pivots(scenes), axis=1)).max() < 1e-6
    mass, friction, restitution = scenes.unit_physics[5].astype(np.float64)
    plane = scenes.planes_of_scene(2)[0].astype(np.float64)
    np.testing.assert_allclose([mass, friction * plane[4], restitution * plane[5]], [0.37, 0.3, 0.125], rtol=1e-6)
    np.testing.assert_allclose(scenes.unit_inertia, 6.167e-4, rtol=1e-6)


def test_velocities_are_those_of_the_instant(tmp_path):
    scenes = elbow.make(write(tmp_path))
    step = 1e-5
    for scene, toss in enumerate((1, 0, 2)):
        one, two = scenes.unit_velocity[scenes.units_of_scene(scene)].astype(np.float64)
        np.testing.assert_allclose(one[:3], VELOCITY, atol=2e-4)
        first = quaternion_to_matrix(orientation(toss, 0.0))
        np.testing.assert_allclose(one[3:], first @ SPIN, atol=1e-5)
        (before, centre_before), (after, centre_after) = pose_2(toss, -step), pose_2(toss, step)
        np.testing.assert_allclose(two[:3], (centre_after - centre_before) / (2 * step), atol=3e-4)
        spin = (after - before) / (2 * step) @ pose_2(toss, 0.0)[0].T
        np.testing.assert_allclose(two[3:], [spin[2, 1], spin[0, 2], spin[1, 0]], atol=1e-4)


def test_the_points_are_the_box(tmp_path):
    points = elbow.make(write(tmp_path)).shape_points
    assert len(points) == len(np.unique(points, axis=0)) == 64
    np.testing.assert_allclose(np.abs(points).max(0), [0.05, 0.025, 0.025])
    np.testing.assert_allclose(points.mean(0), 0, atol=1e-8)


def test_some_tosses_are_taken_or_to_learn_from(tmp_path, capsys):
    folder = write(tmp_path)
    every = elbow.make(folder, 2)
    assert (every.scene_split == TRAIN).sum() == 2
    late = elbow.make(folder, 2, first_seed=4)
    assert late.scene_seed.tolist() == [12, 40] and late.frames == 7
    assert late.scene_split.tolist() == every.scene_split[1:].tolist()
    one = elbow.make(folder, 2, first_seed=4, seeds=1)
    assert one.scene_seed.tolist() == [12] and len(one.unit_velocity) == 2
    np.testing.assert_array_equal(one.unit_poses, every.unit_poses[2:4, :5])
    for wrong in ({"train": 4}, {"first_seed": 41}, {"first_seed": 4, "seeds": 3}):
        with pytest.raises(TossError, match="give a"):
            elbow.make(folder, **wrong)
    assert elbow.main([str(folder), "--out", str(tmp_path / "x"), "--first-seed", "41"]) == 1
    assert "up to 40" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        elbow.main([str(folder), "--out", str(tmp_path / "x"), "--seeds", "0"])


@pytest.mark.parametrize("changes, message", [
    ({"state": None}, "no array of the name"),
    ({"index": np.array([1, 1, 2])}, "twice"),
    ({"state": np.full((21, 15), np.nan)}, "row 0 is not finite"),
    ({"state": np.ones((21, 13))}, "of 15"),
])
def test_bad_recordings_are_named(tmp_path, capsys, changes, message):
    out = tmp_path / "x.safetensors"
    assert elbow.main([str(write(tmp_path, **changes)), "--out", str(out)]) == 1
    error = capsys.readouterr().err
    assert message in error and elbow.FILE in error and "give the folder" in error and not out.exists()


def test_a_folder_without_the_file(tmp_path, capsys):
    assert elbow.main([str(tmp_path), "--out", str(tmp_path / "x")]) == 1
    error = capsys.readouterr().err
    assert "No such file" in error and elbow.FILE in error


def test_the_recording_itself():
    folder = os.environ.get("RIGIDFORMER_TOSSES")
    if not folder or not (Path(folder) / elbow.FILE).is_file():
        pytest.skip("set RIGIDFORMER_TOSSES to the folder of elbow_tosses.npz to run this test")
    scenes = elbow.make(Path(folder))
    assert np.abs(np.diff(pivots(scenes), axis=1)).max() < 1e-6
    poses = scenes.unit_poses.astype(np.float64)
    time = 10 / scenes.frame_rate_hz
    free = poses[:, 0, :3] + scenes.unit_velocity[:, :3] * time + 0.5 * np.array(scenes.gravity_m_s2) * time**2
    assert np.median(np.linalg.norm(poses[:, 10, :3] - free, axis=1)) < 0.005
    still = np.abs(poses[:, -10:] - poses[:, -1:]).max((1, 2)).reshape(-1, 2).max(1) < 1e-3
    height = np.einsum("uj,pj->up", quaternion_to_matrix(poses[:, -1, 3:])[:, 2], scenes.shape_points) + poses[:, -1, 2:3]
    lowest = height.min(1).reshape(-1, 2).min(1)[still]
    assert len(lowest) > 50 and np.abs(lowest).max() < 1e-3
