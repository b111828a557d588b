"""Clips of the 17-part humanoid, made up here: the recorded ones may not be in the project."""

import numpy as np
import pytest

from rigidformer_lab import ase
from rigidformer_lab.scenes import TEST, TRAIN, read_scenes

LENGTHS = (250, 111, 60, 20)


@pytest.fixture
def folder(tmp_path):
    rng = np.random.default_rng(0)
    corners = np.array(np.meshgrid(*[(-0.05, 0.05)] * 3)).reshape(3, -1).T
    np.savez(tmp_path / "ase17_parts.npz", part=[f"part {k}" for k in range(17)], verts=np.tile(corners, (17, 1)),
             vstart=np.arange(18) * 8, mass=np.ones(17))
    total = sum(LENGTHS)
    turns = rng.normal(size=(total, 17, 4))
    clips = {"clip": [f"clip {k}" for k in range(len(LENGTHS))], "start": np.cumsum((0, *LENGTHS)),
             "pos": rng.normal(size=(total, 17, 3)), "cmd": rng.normal(size=(total, 5)),
             "quat_wxyz": turns / np.linalg.norm(turns, axis=-1, keepdims=True)}
    np.savez(tmp_path / "ase17_locomotion.npz", **clips)
    return tmp_path, clips


def test_the_ends_of_long_clips_are_for_tests(folder, tmp_path):
    where, clips = folder
    assert ase.main([str(where), "--out", str(tmp_path / "x")]) == 0
    scenes = read_scenes(tmp_path / "x")
    firsts, splits, frames = scenes.scene_seed.tolist(), scenes.scene_split.tolist(), scenes.scene_frames.tolist()
    assert [first for first, split in zip(firsts, splits) if split == TEST] == [139]
    assert frames == [111 if first < 361 else 60 for first in firsts] and splits.count(TRAIN) == 9
    for first, split, length in zip(firsts, splits, frames):
        assert split == TEST or first >= 250 or first + length <= 139
    pose = scenes.unit_poses.reshape(-1, 17, 111, 7)[0, 3, 5]
    np.testing.assert_allclose(pose[:3], clips["pos"][144, 3], rtol=1e-6)
    np.testing.assert_allclose(scenes.commands[0, 5], clips["cmd"][144], rtol=1e-6)
    assert "NON-COMMERCIAL" in scenes.licence and scenes.bodies.tolist() == [0] * 17 * len(firsts)


@pytest.mark.parametrize("changes, message", [({"start": np.array([0, 5])}, "start does not rise"), ({"cmd": None}, "no array of the name")])
def test_clips_that_cannot_be_used(folder, tmp_path, capsys, changes, message):
    where, clips = folder
    np.savez(where / "ase17_locomotion.npz", **{k: v for k, v in (clips | changes).items() if v is not None})
    assert ase.main([str(where), "--out", str(tmp_path / "x")]) == 1
    assert message in capsys.readouterr().err and not (tmp_path / "x").exists()
