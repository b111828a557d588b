"""The arm that pushes a cube. PyBullet brings the arm; its parts are boxes here, but in the last test."""

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest

from rigidformer_lab import bullet, franka, movi
from rigidformer_lab.franka import PARTS, Push, Recipe
from rigidformer_lab.geometry import quaternion_to_matrix
from rigidformer_lab.roles import DRIVEN, FIXED, FREE
from rigidformer_lab.scenes import read_scenes, write_scenes

CORNERS = np.array(np.meshgrid(*[(-0.025, 0.025)] * 3, indexing="ij")).reshape(3, -1).T.astype(np.float32)
HAND, LEFT, CUBE = PARTS.index("panda_hand"), PARTS.index("panda_leftfinger"), PARTS.index("cube")


def write(folder, **changes):
    arrays = {"part": np.array(PARTS), "verts": np.tile(CORNERS, (12, 1)), "vstart": np.arange(13, dtype=np.int32) * 8}
    arrays |= changes
    np.savez(folder / franka.FILE, **{name: array for name, array in arrays.items() if array is not None})
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write(tmp_path_factory.mktemp("franka"))


@pytest.fixture(scope="module")
def scenes(folder):
    return Recipe(folder, 1, 2).make(range(1, 3))


def units(scenes, scene):
    return scenes.unit_poses[scenes.units_of_scene(scene)].astype(np.float64)


def test_an_arm_of_driven_parts_and_a_free_cube(scenes, tmp_path):
    write_scenes(tmp_path / "x", scenes)
    again = read_scenes(tmp_path / "x")
    assert again.version == "2" and again.dataset == "franka" and again.frame_rate_hz == 60 and again.frames == 330
    assert again.roles.tolist() == ([DRIVEN] * 11 + [FREE]) * 2 and again.bodies.tolist() == ([0] * 11 + [-1]) * 2
    assert again.commands.shape == (2, 330, 7) and again.command_last.tolist() == [1] * 7 and again.shape_names == list(PARTS) and "Apache-2.0" in again.licence
    assert again.planes_of_scene(1).tolist() == [[0, 0, 1, 0, 1, 0]]
    np.testing.assert_allclose(again.unit_physics[[0, CUBE]], [(2.9, 0.5, 0), (0.1, 0.5, 0)], rtol=1e-6)


def test_the_cube_lies_until_it_is_pushed(scenes):
    for scene in range(2):
        push, cube = Push.of_seed(1 + scene), units(scenes, scene)[CUBE]
        np.testing.assert_allclose(cube[:80, :3], np.broadcast_to(push.cube, (80, 3)), atol=1e-4)
        assert np.abs(cube[:, 2] - 0.025).max() < 3e-4
        assert quaternion_to_matrix(cube[:, 3:])[:, 2, 2].min() > np.cos(np.radians(1))
        assert (cube[-1, :3] - cube[0, :3]) @ push.way > 0.1
        np.testing.assert_allclose(cube[-1], cube[-10], atol=1e-4)


def test_the_fingers_go_their_way_and_stay_out_of_the_cube(scenes):
    for scene in range(2):
        push, poses = Push.of_seed(1 + scene), units(scenes, scene)
        tip = poses[HAND, :, :3] + quaternion_to_matrix(poses[HAND, :, 3:])[:, :, 2] * 0.105
        way = np.array([push.at(0.5 + frame / 60) for frame in range(330)])
        assert np.abs(tip - way).max() < 0.02
        np.testing.assert_allclose(tip[-1], way[-1], atol=1e-4)
        np.testing.assert_allclose(quaternion_to_matrix(poses[HAND, :, 3:])[:, 2, 2], -1, atol=1e-4)
        # The fingers reach 8.7 mm along the hand's x and 14 mm along its y there.
        apart = np.linalg.norm(poses[LEFT, :, :2] - poses[CUBE, :, :2], axis=1)
        assert 0.025 + 0.0087 < apart.min() < 0.06


def test_parts_hold_together(scenes):
    poses = units(scenes, 0)
    parents = (0, 1, 2, 3, 4, 5, 6, 7, 8, 8)
    for child, parent in enumerate(parents, 1):
        between = poses[child, :, :3] - poses[parent, :, :3]
        local = np.einsum("tji,tj->ti", quaternion_to_matrix(poses[parent, :, 3:]), between)
        assert np.ptp(local, axis=0).max() < 2e-5
    assert (poses[0] == poses[0, 0]).all() and poses[0, 0].tolist() == [0, 0, 0, 1, 0, 0, 0]


def test_commands_lead_the_joints(scenes):
    """The first joint turns about the vertical: its angle is to be seen in the pose of the first link."""
    pose = units(scenes, 0)[1]
    angle = 2 * np.arctan2(pose[:, 6], pose[:, 3])
    assert np.abs(angle - scenes.commands[0, :, 0]).max() < 0.03
    np.testing.assert_allclose(angle[-1], scenes.commands[0, -1, 0], atol=1e-3)


def test_the_arm_alone(scenes, folder):
    alone = Recipe(folder, 2, 1, alone=True).make(range(2, 3))
    np.testing.assert_array_equal(alone.unit_poses, scenes.unit_poses[12:23])
    np.testing.assert_array_equal(alone.commands, scenes.commands[1:])
    assert alone.roles.tolist() == [FIXED] + [FREE] * 10 and alone.bodies.tolist() == [0] * 11
    assert alone.unit_physics[:, 0].argmax() == 1 and alone.shape_names == list(PARTS[:11])


def test_pushes_vary_within_reach():
    pushes = [Push.of_seed(seed) for seed in range(200)]
    assert all(push.in_reach() for push in pushes)
    cubes, ways = np.array([p.cube for p in pushes]), np.array([p.way for p in pushes])
    assert cubes[:, 0].min() >= 0.4 and cubes[:, 0].max() <= 0.6 and np.abs(cubes[:, 1]).max() <= 0.25
    assert cubes[:, 1].min() < -0.2 and cubes[:, 1].max() > 0.2 and np.ptp(ways[:, 0]) > 1 and np.ptp(ways[:, 1]) > 1.9
    for push in pushes:
        behind = (push.cube - push.start) @ push.way
        aside = np.linalg.norm((push.cube - push.start)[:2] - behind * push.way[:2])
        assert abs(behind - 0.1) < 1e-9 and aside <= 0.015 and 0.02 <= push.start[2] <= 0.04 and 3 <= push.seconds <= 3.4
        across = np.array([np.cos(push.hand_turn), np.sin(push.hand_turn)]) @ push.way[:2]
        assert abs(across) >= np.cos(np.radians(20)) - 1e-9
        assert push.at(1.0)[2] == 0.25 and np.linalg.norm(push.at(6.0) - push.at(2.0)) >= 0.45 - 1e-9


def test_a_seed_without_a_push_is_named(monkeypatch):
    monkeypatch.setattr(franka, "REACH_M", (0.3, 0.4))
    with pytest.raises(RuntimeError, match="seed 7"):
        Push.of_seed(7)


def test_scenes_are_drawn_from_their_seed_alone(scenes, folder):
    again = Recipe(folder, 2, 1).make(range(2, 3))
    np.testing.assert_array_equal(again.unit_poses, scenes.unit_poses[12:])
    np.testing.assert_array_equal(again.commands, scenes.commands[1:])


def test_an_interrupted_run_continues_with_the_same_bytes(resumes, folder, monkeypatch):
    monkeypatch.setattr(movi, "SEEDS_PER_SHARD", 1)
    recipe = Recipe(folder, 1, 2, 3)
    resumes(recipe, dataclasses.replace(recipe, frames=4))


def test_the_command(makes_splits, folder):
    makes_splits(franka.main, folder, says="3 scenes, 36 units, 2 frames")


@pytest.mark.parametrize("changes, message", [
    ({"verts": None}, "no array of the name"),
    ({"part": np.array(PARTS[::-1])}, "part is not panda_link0"),
    ({"verts": np.full((96, 3), np.nan)}, "not finite floats"),
    ({"verts": np.zeros((96, 2))}, "not finite floats"),
    ({"vstart": np.arange(12) * 8}, "not 13 whole numbers"),
    ({"vstart": np.arange(13) * 7}, "from 0 to 96"),
    ({"vstart": np.array([0, 3, *range(16, 97, 8)])}, "at least 4 a part"),
    ({"verts": np.ones((96, 3))}, "edge of 0.05 m"),
])
def test_bad_parts_are_named(tmp_path, capsys, changes, message):
    out = tmp_path / "x"
    assert franka.main([str(write(tmp_path, **changes)), "--out", str(out)]) == 1
    error = capsys.readouterr().err
    assert message in error and franka.FILE in error and "give the folder" in error and not out.exists()


def test_files_that_are_no_parts(tmp_path, capsys):
    assert franka.main([str(tmp_path), "--out", str(tmp_path / "x")]) == 1
    assert "No such file" in capsys.readouterr().err
    (tmp_path / franka.FILE).write_bytes(b"PK\x03\x04 and no more")
    assert franka.main([str(tmp_path), "--out", str(tmp_path / "x")]) == 1
    assert "cannot be read" in capsys.readouterr().err
    assert not (tmp_path / "x.parts").exists()


def test_the_arm_stands_as_recorded():
    """Joint angles read off a recorded push, put into the arm, give the poses of that push."""
    folder = os.environ.get("RIGIDFORMER_FRANKA")
    if not folder:
        pytest.skip("set RIGIDFORMER_FRANKA to the folder of franka_parts12.npz and franka_example.npz to run this test")
    assert [len(points) for points in franka.read_parts(Path(folder))][-1] == 8
    with np.load(Path(folder) / "franka_example.npz") as example:
        assert tuple(example["part"]) == PARTS
        place, turn = example["pos"].astype(np.float64), quaternion_to_matrix(example["quat_xyzw"][..., [3, 0, 1, 2]])
    with bullet.paced_world(franka.GRAVITY_M_S2, 1 / 240) as (pb, on):
        arm = franka.Arm(pb, on, 0.0)
        for joint in range(7):
            pb.resetJointState(arm.number, joint, 0.0, **on)
        zero = quaternion_to_matrix(np.array(arm.poses())[:, 3:])
        for frame in (0, 120, 300):
            for joint in range(7):
                turned = (zero[joint].T @ zero[joint + 1]).T @ turn[frame, joint].T @ turn[frame, joint + 1]
                pb.resetJointState(arm.number, joint, float(np.arctan2(turned[1, 0], turned[0, 0])), **on)
            poses = np.array(arm.poses())
            np.testing.assert_allclose(poses[:, :3], place[frame, :11], atol=2e-5)
            np.testing.assert_allclose(quaternion_to_matrix(poses[:, 3:]), turn[frame, :11], atol=1e-5)
