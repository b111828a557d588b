"""The cube of fragments that breaks on the ground."""

import numpy as np
import pytest

from rigidformer_lab import fragments, movi, trials
from rigidformer_lab.fragments import Recipe, draw_cells
from rigidformer_lab.geometry import quaternion_to_matrix
from rigidformer_lab.scenes import read_scenes, write_scenes

SEEDS = range(1, 4)


@pytest.fixture(scope="module")
def scenes():
    return Recipe(1, 3, 180).make(SEEDS)


def pieces(bonds, units, frame):
    """Units, by piece, that bonds hold together at a frame."""
    piece = {unit: {unit} for unit in units}
    for i, j, broken in bonds:
        if frame < broken and piece[i] is not piece[j]:
            both = piece[i] | piece[j]
            piece |= dict.fromkeys(both, both)
    return {id(members): members for members in piece.values()}.values()


def corners(scenes, unit):
    """(frames, corners, 3)"""
    poses, own = scenes.unit_poses[unit].astype(np.float64), scenes.points_of_shape(scenes.unit_shape[unit])
    return np.einsum("fij,pj->fpi", quaternion_to_matrix(poses[:, 3:]), own) + poses[:, None, :3]


def test_rigid_cells_of_one_body_with_bonds(scenes, tmp_path):
    write_scenes(tmp_path / "x", scenes)
    again = read_scenes(tmp_path / "x")
    assert again.version == "2" and again.dataset == "fragments" and again.frame_rate_hz == 60 and again.frames == 180
    assert not again.roles.any() and not again.bodies.any() and again.unit_soft is None and again.soft_points is None
    assert again.planes_of_scene(2).tolist() == [[0, 0, 1, 0, 1, 0]] and again.shape_names[0] == "fragment-1-0"
    for name in ("bonds", "scene_bonds", "bond_frame", "unit_poses"):
        np.testing.assert_array_equal(getattr(again, name), getattr(scenes, name))
    for scene in range(3):
        units, bonds = again.units_of_scene(scene), again.bonds_of_scene(scene)
        assert 8 <= len(units) <= 16 and (bonds[:, 0] < bonds[:, 1]).all()
        assert len(np.unique(bonds[:, :2], axis=0)) == len(bonds) and (bonds[:, 2] > 0).all()
        assert again.unit_physics[units, 0].sum() == pytest.approx(970.299, rel=1e-5)
        assert len(pieces(bonds, units, 0)) == 1


def test_cells_fill_the_cube():
    for seed in range(5):
        cells = draw_cells(np.random.default_rng(seed))
        assert cells.volumes.min() >= 0.01 * 0.97 and cells.volumes.sum() == pytest.approx(0.99**3)
        assert (cells.volumes @ cells.centres) / cells.volumes.sum() == pytest.approx(np.zeros(3), abs=1e-9)
        corners = np.concatenate([centre + own for centre, own in zip(cells.centres, cells.corners)])
        assert 0.49 < np.abs(corners).max() < 0.5 and min(map(len, cells.corners)) >= 4
        assert cells.areas.min() > 0.01
        for (i, j), middle in zip(cells.bonds, cells.middles):
            reach = [np.linalg.norm(cells.corners[k], axis=1).max() / 0.99 for k in (i, j)]
            assert all(np.linalg.norm(middle - cells.centres[k]) <= r for k, r in zip((i, j), reach))


def test_whole_cube_moves_as_one_body(scenes):
    """Until the first bond breaks cells fall and turn together, and nearly so after that, where bonds hold."""
    for scene in range(3):
        units, bonds = scenes.units_of_scene(scene), scenes.bonds_of_scene(scene)
        poses, first = scenes.unit_poses[units].astype(np.float64), bonds[:, 2].min()
        turn = quaternion_to_matrix(poses[..., 3:])
        apart = np.einsum("ufji,ufj->ufi", turn, poses[:, :, :3] - poses[:1, :, :3])
        together = apart[:, : first - 1] - apart[:, :1]
        assert np.abs(together).max() < 1e-3
        mass = scenes.unit_physics[units, 0].astype(np.float64)
        middle = np.einsum("u,ufi->fi", mass, poses[..., :3]) / mass.sum()
        np.testing.assert_allclose(np.diff(middle[: first - 1], n=2, axis=0), np.tile([0, 0, -9.81 / 3600], (first - 3, 1)), atol=1e-5)
        for i, j, broken in bonds - [units[0], units[0], 0]:
            if broken == scenes.frames:
                kept = np.einsum("fji,fj->fi", turn[i], poses[j, :, :3] - poses[i, :, :3])
                assert np.linalg.norm(kept - kept[0], axis=1).max() < 0.06


def test_bonds_break_once_and_pieces_separate(scenes):
    for scene in range(3):
        units, bonds = scenes.units_of_scene(scene), scenes.bonds_of_scene(scene)
        counts = [len(pieces(bonds, units, frame)) for frame in range(scenes.frames)]
        assert counts[0] == 1 and counts[-1] >= 2 and (np.diff(counts) >= 0).all()
        moved = scenes.unit_poses[:, :, :3].astype(np.float64)
        apart = {(i, j): np.linalg.norm(moved[i] - moved[j], axis=1) for i, j, _ in bonds}
        parted = [apart[i, j][-1] - apart[i, j][0] for i, j, broken in bonds
                  if not any({i, j} <= piece for piece in pieces(bonds, units, scenes.frames - 1))]
        assert len(parted) and max(parted) > 0.02 and min(parted) > -0.1
        lowest = min(corners(scenes, unit)[..., 2].min() for unit in units)
        assert -0.05 < lowest < 0.01


def test_strong_bonds_hold(monkeypatch):
    monkeypatch.setattr(fragments, "STRENGTH_PA", 1e9)
    scenes = Recipe(1, 1, 60).make(range(1, 2))
    assert (scenes.bond_frame == 60).all()


def test_scenes_are_drawn_from_their_seed_alone(scenes):
    again, units = Recipe(3, 1, 180).make(range(3, 4)), scenes.units_of_scene(2)
    np.testing.assert_array_equal(again.unit_poses, scenes.unit_poses[units])
    np.testing.assert_array_equal(again.bonds_of_scene(0), scenes.bonds_of_scene(2) - [units[0], units[0], 0])


def test_a_seed_that_always_fails_is_named(monkeypatch):
    monkeypatch.setattr(trials, "FARTHEST_M", 0.1)
    monkeypatch.setattr(trials, "TRIALS", 2)
    with pytest.raises(RuntimeError, match="seed 7: 2 runs of 2 failed, the last because a point was farther than 0.1 m"):
        Recipe(7, 1, 2).make(range(7, 8))


def test_an_interrupted_run_continues_with_the_same_bytes(resumes, monkeypatch):
    monkeypatch.setattr(movi, "SEEDS_PER_SHARD", 1)
    resumes(Recipe(1, 2, 3), Recipe(1, 2, 4))


def test_the_command(makes_splits):
    makes_splits(fragments.main)
