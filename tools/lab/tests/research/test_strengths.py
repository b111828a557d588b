"""Cubes that break again, with bonds of equal strength."""

import json

import numpy as np

from rigidformer_lab import fragments
from rigidformer_lab.research import strengths


def test_the_same_cubes_break_elsewhere(tmp_path, capsys):
    path = tmp_path / "fragments.safetensors"
    assert fragments.main(["--seeds", "2", "--frames", "60", "--split", "test", "--workers", "1", "--out", str(path)]) == 0
    capsys.readouterr()
    assert strengths.main([str(path), "--frame", "59"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["scenes"] == 2 and 0.5 < found["f1"] <= 1 and 0 < found["position_m"] < 2
    assert strengths.main([str(path), "--split", "train"]) == 1
    assert "--split" in capsys.readouterr().err
    assert strengths.main([str(tmp_path / "none.safetensors")]) == 1


def test_equal_strengths_take_as_many_draws():
    one, other = fragments.Recipe(3, 1, 2).scene(3), strengths.Even(3, 1, 2).scene(3)
    np.testing.assert_array_equal(one.unit_poses[:, 0], other.unit_poses[:, 0])
    np.testing.assert_array_equal(one.bonds, other.bonds)
