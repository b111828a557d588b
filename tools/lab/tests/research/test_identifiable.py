"""Scenes whose frictions, restitutions and masses are drawn, and what is said of them."""

import json

import numpy as np
import pytest

from rigidformer_lab.geometry import quaternion_to_matrix
from rigidformer_lab.research.identifiable import GROUND, GUESS, KINDS, MEET, compare, holds, main, make
from rigidformer_lab.scenes import read_scenes

FRAMES = 30


@pytest.mark.parametrize("kind", (*KINDS, MEET))
def test_scenes_hide_what_was_drawn(kind):
    scenes, truths = make(range(1, 3), FRAMES, 5e-4, (kind,))
    assert scenes.units == (4 if kind == MEET else 2) and scenes.frames == FRAMES
    np.testing.assert_allclose(scenes.unit_physics[:, 1:], [GUESS] * scenes.units)
    np.testing.assert_allclose(scenes.planes[:, 4:], [GROUND] * 2, atol=1e-6)
    for truth in truths:
        assert truth["kind"] == kind
        assert all(0.05 <= f <= 0.8 for f in truth["friction"]) and all(0 <= e <= 0.8 for e in truth["restitution"])


def test_noise_is_as_asked():
    clean, noisy = (make(range(1, 2), FRAMES, noise, ("toss",))[0] for noise in (0.0, 1e-3))
    away = noisy.unit_poses - clean.unit_poses
    assert 0.8e-3 < away[0, :, :3].std() < 1.2e-3
    one, other = (quaternion_to_matrix(scenes.unit_poses[0, :, 3:].astype(np.float64)) for scenes in (clean, noisy))
    cosines = (np.einsum("fij,fij->f", one, other) - 1) / 2
    points = clean.points_of_shape(clean.unit_shape[0]) * clean.unit_scale[0]
    radius = np.linalg.norm(points, axis=1).max()
    angle = np.sqrt(np.mean(np.arccos(np.clip(cosines, -1, 1)) ** 2 / 3))
    assert 0.7 < angle * radius / 1e-3 < 1.3


def test_intervals_are_compared_with_what_was_drawn(tmp_path, capsys):
    out = tmp_path / "x.safetensors"
    assert main(["--out", str(out), "--seeds", "1", "--frames", str(FRAMES), "--kinds", "slide"]) == 0
    truth = json.loads((tmp_path / "x.safetensors.truth.json").read_text())[0]
    assert read_scenes(out).scenes == 1
    friction = truth["friction"][0]
    unit = {"unit": 0, "friction": {"seen": "between", "low": friction - 0.1, "middle": friction, "high": friction + 0.1},
            "restitution": {"seen": "no"}}
    found = {"results": [{"scenes": [0], "units": [unit], "met": []}]}
    assert [row[5] for row in compare(found, [truth])] == [True, None]
    (tmp_path / "found.json").write_text(json.dumps(found))
    assert main(["--out", str(out), "--check", str(tmp_path / "found.json")]) == 0
    assert "1 (1.00)" in capsys.readouterr().out
    assert main(["--out", str(tmp_path / "none"), "--check", str(tmp_path / "found.json")]) == 1
    assert holds({"seen": "at least", "low": 0.3}, 0.2) is False and holds({"seen": "at most", "high": 0.3}, 0.2)
