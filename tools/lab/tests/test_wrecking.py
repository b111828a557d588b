"""The wrecking ball and its wall of cubes. No assets needed."""

import numpy as np
import pytest

from rigidformer_lab import wrecking
from rigidformer_lab.scenes import TEST, TRAIN, VALIDATION, read_scenes
from rigidformer_lab.wrecking import Recipe


@pytest.fixture(scope="module")
def scenes():
    return Recipe(27, 1, 2, 60).make(range(1, 3))


def test_the_grid_stands_and_the_ball_comes(scenes):
    assert scenes.dataset == "wrecking-ball-27" and scenes.version == "1" and scenes.units == 56
    assert np.diff(scenes.shape_offsets).tolist() == [8, 43]
    assert scenes.unit_shape[:28].tolist() == [0] * 27 + [1]
    first = scenes.unit_poses[:, 0, :3].astype(np.float64)
    for scene in range(2):
        units = scenes.units_of_scene(scene)
        cubes, ball = first[units[:-1]], first[units[-1]]
        apart = np.linalg.norm(cubes[:, None] - cubes[None], axis=-1) + 9 * np.eye(27)
        np.testing.assert_allclose(apart.min(0), 1.05, atol=1e-6)
        assert cubes[:, 2].min() == 0.5 and 2.5 <= ball[2] <= 4.0
        np.testing.assert_allclose(ball[0], -(1.05 + 0.5) - 2 - 1, atol=1e-6)
        path = scenes.unit_poses[units[-1], :, 0]
        np.testing.assert_allclose(np.diff(path[:10]) * 240, 30, atol=1e-2)
        moved = np.linalg.norm(scenes.unit_poses[units[:-1], -1, :3] - cubes, axis=1)
        assert moved.max() > 0.3 and scenes.unit_poses[units, -1, 2].min() > 0.3
    assert len(set(first[[27, 55], 2])) == 2
    np.testing.assert_allclose(scenes.unit_physics[[0, 27]], [(1000, 0.3, 0.5), (4188.79, 0.3, 0.5)], rtol=1e-5)


def test_scenes_are_drawn_from_their_seed_alone(scenes):
    again = Recipe(27, 2, 1, 60).make(range(2, 3))
    np.testing.assert_array_equal(again.unit_poses, scenes.unit_poses[28:])


def test_a_file_has_its_seeds_splits_or_one(tmp_path):
    assert Recipe(1, 8, 3, 1).make(range(8, 11)).scene_split.tolist() == [TRAIN, VALIDATION, TEST]
    out = tmp_path / "x"
    few = ["--cubes", "1", "--seeds", "3", "--first-seed", "8", "--frames", "1", "--workers", "1"]
    assert wrecking.main(["--out", str(out), "--split", "test", *few]) == 0
    assert read_scenes(out).scene_split.tolist() == [TEST] * 3


def test_an_interrupted_run_continues_with_the_same_bytes(resumes, monkeypatch):
    monkeypatch.setattr(wrecking, "UNITS_PER_SHARD", 1)
    recipe = Recipe(8, 1, 2, 3)
    resumes(recipe, Recipe(27, 1, 2, 3))


@pytest.mark.parametrize("wrong, message", [
    (("--cubes", "28"), "k x k x k"), (("--cubes", "0"), "k x k x k"), (("--cubes", "-8"), "k x k x k"),
    (("--cubes", "1331"), "at most 1000"), (("--seeds", "0"), "at least 1"), (("--first-seed", "-1"), "between 0"),
])
def test_bad_arguments(tmp_path, capsys, wrong, message):
    with pytest.raises(SystemExit):
        wrecking.main(["--out", str(tmp_path / "x"), *wrong])
    assert message in capsys.readouterr().err


def test_the_command(tmp_path, capsys):
    out = tmp_path / "x"
    assert wrecking.main(["--out", str(out), "--cubes", "8", "--seeds", "1", "--frames", "2", "--workers", "1"]) == 0
    assert "9 units" in capsys.readouterr().out and read_scenes(out).dataset == "wrecking-ball-8"
