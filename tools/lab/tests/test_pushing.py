"""Scenes with a pusher, a slope and a wall. No assets needed."""

import dataclasses

import numpy as np
import pytest

from rigidformer_lab import movi, pushing
from rigidformer_lab.geometry import quaternion_to_matrix
from rigidformer_lab.pushing import Recipe
from rigidformer_lab.roles import DRIVEN, FIXED, FREE
from rigidformer_lab.scenes import read_scenes, write_scenes

FRAMES = 120


@pytest.fixture(scope="module")
def scenes():
    return Recipe(1, 4, FRAMES).make(range(1, 5))


def world_points(scenes, unit):
    points = scenes.points_of_shape(scenes.unit_shape[unit]) * scenes.unit_scale[unit]
    pose = scenes.unit_poses[unit].astype(np.float64)
    return np.einsum("tij,nj->tni", quaternion_to_matrix(pose[:, 3:]), points) + pose[:, None, :3]


def test_every_scene_has_all_roles_and_two_planes(scenes, tmp_path):
    for s in range(scenes.scenes):
        roles = scenes.roles[scenes.units_of_scene(s)]
        assert (roles == DRIVEN).sum() == 1 and (roles == FIXED).sum() == 1 and (roles == FREE).sum() >= 3
        slope, wall = scenes.planes_of_scene(s)[:, :3]
        assert slope[2] > np.cos(np.radians(12.1)) and abs(slope @ wall) < 1e-6
    write_scenes(tmp_path / "x", scenes)
    again = read_scenes(tmp_path / "x")
    assert again.version == "2" and np.array_equal(again.planes, scenes.planes)


def test_free_bodies_stay_on_the_free_side(scenes):
    for s in range(scenes.scenes):
        planes = scenes.planes_of_scene(s)
        for unit in scenes.units_of_scene(s):
            height = world_points(scenes, unit) @ planes[:, :3].T - planes[:, 3]
            assert height.min() > -0.005


def test_parts_of_a_body_move_as_one(scenes):
    pairs = 0
    for s in range(scenes.scenes):
        units = np.array(scenes.units_of_scene(s))
        for body in set(scenes.bodies[units].tolist()) - {-1}:
            one, two = units[scenes.bodies[units] == body]
            pairs += 1
            between = scenes.unit_poses[two, :, :3] - scenes.unit_poses[one, :, :3]
            local = np.einsum("tij,ti->tj", quaternion_to_matrix(scenes.unit_poses[one, :, 3:]), between)
            np.testing.assert_allclose(local, np.broadcast_to(local[0], local.shape), atol=1e-5)
            np.testing.assert_array_equal(scenes.unit_poses[one, :, 3:], scenes.unit_poses[two, :, 3:])
    assert pairs


def test_the_pusher_goes_smoothly_and_pushes(scenes):
    for unit in np.flatnonzero(scenes.roles == DRIVEN):
        place = scenes.unit_poses[unit, :, :3].astype(np.float64)
        speed = np.diff(place, axis=0) * 240
        assert np.linalg.norm(speed[-1]) > 0.1 and np.abs(np.diff(speed, axis=0)).max() < 0.1
    still = scenes.roles == FIXED
    assert (scenes.unit_poses[still] == scenes.unit_poses[still, :1]).all()


def test_scenes_are_drawn_from_their_seed_alone(scenes):
    again = Recipe(3, 1, FRAMES).make(range(3, 4))
    np.testing.assert_array_equal(again.unit_poses, scenes.unit_poses[scenes.units_of_scene(2)])
    np.testing.assert_array_equal(again.planes, scenes.planes_of_scene(2))


def test_an_interrupted_run_continues_with_the_same_bytes(resumes, monkeypatch):
    monkeypatch.setattr(movi, "SEEDS_PER_SHARD", 1)
    recipe = Recipe(1, 2, 3)
    resumes(recipe, dataclasses.replace(recipe, frames=4))


def test_the_command(tmp_path, capsys):
    with pytest.raises(SystemExit):
        pushing.main(["--out", str(tmp_path / "x"), "--seeds", "0"])
    assert "at least 1" in capsys.readouterr().err
    assert pushing.main(["--out", str(tmp_path / "x"), "--seeds", "1", "--frames", "2", "--workers", "1"]) == 0
    assert "1 scenes" in capsys.readouterr().out
    assert read_scenes(tmp_path / "x").dataset == pushing.DATASET
