"""Points on surfaces: evenly, on the outside, and what else must stay."""

import numpy as np
import pytest

from rigidformer_lab import resample
from rigidformer_lab.movi import CONTACT_LAW, Recipe, make_scenes
from rigidformer_lab.scenes import read_scenes, write_scenes

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
FACES = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4),
         (1, 5, 7), (1, 7, 3)]  # fmt: skip


def cube(at=(0.0, 0.0, 0.0)):
    return (CORNERS + at)[np.array(FACES)]


def test_points_are_spread_evenly_over_the_surface():
    points = resample.sample_surface([cube()], 6000, np.random.default_rng(0))
    assert points.shape == (6000, 3)
    on_a_face = np.isclose(points, 0, atol=1e-6) | np.isclose(points, 1, atol=1e-6)
    assert on_a_face.any(1).all()
    share = [np.isclose(points[:, axis], side, atol=1e-6).mean() for axis in range(3) for side in (0, 1)]
    assert np.allclose(share, 1 / 6, atol=0.02)


def test_faces_inside_another_piece_have_no_points():
    pieces = [cube(), cube((0.5, 0.0, 0.0))]
    points = resample.sample_surface(pieces, 4000, np.random.default_rng(0))
    assert not any(resample.inside(points, piece).any() for piece in pieces)
    assert points[:, 0].min() < 1e-6 and points[:, 0].max() > 1.5 - 1e-6


def test_the_rest_of_the_scenes_stays(tmp_path):
    scenes = make_scenes(Recipe("primitives", 8, 2, 6, None), range(8, 10))
    path, out = tmp_path / "a.safetensors", tmp_path / "b.safetensors"
    write_scenes(path, scenes)
    assert resample.main([str(path), "--keep", "0.75", "--seed", "3", "--out", str(out)]) == 0
    kept = read_scenes(out)
    assert np.array_equal(kept.unit_poses, scenes.unit_poses)
    assert np.array_equal(kept.scene_seed, scenes.scene_seed)
    assert kept.contact_law == scenes.contact_law == CONTACT_LAW
    for k in range(len(scenes.shape_names)):
        before, after = scenes.points_of_shape(k), kept.points_of_shape(k)
        assert len(after) == round(0.75 * len(before))
        assert {tuple(p) for p in after} <= {tuple(p) for p in before}


def test_wrong_use_says_what_to_do(tmp_path, capsys):
    with pytest.raises(SystemExit):
        resample.main(["x.safetensors", "--points", "768", "--out", str(tmp_path / "y")])
    assert "--assets" in capsys.readouterr().err
    assert resample.main(["nothing.safetensors", "--keep", "0.5", "--out", str(tmp_path / "y")]) == 1
    assert "nothing.safetensors" in capsys.readouterr().err
    with pytest.raises(resample.MeshError, match="--assets"):
        resample.read_triangles(tmp_path / "none.obj")
