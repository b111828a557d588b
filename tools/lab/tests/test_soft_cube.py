"""The soft cube that falls on the ground."""

import numpy as np
import pytest

from rigidformer_lab import movi, soft_cube, trials
from rigidformer_lab.patches import cut, volumes
from rigidformer_lab.scenes import read_scenes, write_scenes
from rigidformer_lab.soft_cube import Recipe

SEEDS = range(1, 4)


@pytest.fixture(scope="module")
def scenes():
    return Recipe(1, 3, 120).make(SEEDS)


def rest(scenes, scene):
    """Points at rest of the units, in the order of the file's soft points, and the row of the first."""
    units = scenes.units_of_scene(scene)
    return np.concatenate([scenes.points_of_shape(scenes.unit_shape[u]) for u in units]), int(scenes.soft_offsets[units[0]])


def points(scenes, scene):
    own, first = rest(scenes, scene)
    return scenes.soft_points[first : first + len(own)].astype(np.float64)


def test_eight_patches_of_a_cube(scenes, tmp_path):
    write_scenes(tmp_path / "x", scenes)
    again = read_scenes(tmp_path / "x")
    assert again.version == "2" and again.dataset == "soft" and again.frame_rate_hz == 60 and again.frames == 120
    assert not again.roles.any() and not again.bodies.any() and again.unit_soft.tolist() == [1] * 24
    assert again.planes_of_scene(2).tolist() == [[0, 0, 1, 0, 1, 0]] and again.shape_names[8] == "soft-2-0"
    for name in ("soft_points", "unit_young", "faces", "scene_faces", "edges", "scene_edges", "tetrahedra", "scene_tetrahedra"):
        np.testing.assert_array_equal(getattr(again, name), getattr(scenes, name))
    for scene in range(3):
        side = np.ptp(rest(again, scene)[0], axis=0)
        np.testing.assert_allclose(side, side[0], rtol=1e-6)
        assert 0.3 <= side[0] <= 0.5 and 8e3 <= again.unit_young[8 * scene] <= 3e4
        np.testing.assert_allclose(again.unit_physics[8 * scene : 8 * scene + 8, 0].sum(), 100 * side[0] ** 3, rtol=1e-5)


def test_patches_share_the_vertices_on_their_border(scenes):
    for scene in range(3):
        own, _ = rest(scenes, scene)
        places, copy, times = np.unique(own, axis=0, return_inverse=True, return_counts=True)
        n = round(len(places) ** (1 / 3))
        assert 4 <= n <= 6 and n**3 == len(places)
        m = n - 1  # beside the shared plane of an axis
        assert np.bincount(times).tolist() == [0, m**3, 3 * m**2, 0, 3 * m, 0, 0, 0, 1]
        vertices = np.zeros((len(places), *scenes.soft_points.shape[1:]))
        vertices[copy] = points(scenes, scene)
        np.testing.assert_array_equal(vertices[copy], points(scenes, scene))


def test_mesh_fills_the_cube(scenes):
    for scene in range(3):
        own, first = rest(scenes, scene)
        own = own.astype(np.float64)
        n, side = round(len(np.unique(own, axis=0)) ** (1 / 3)), np.ptp(own[:, 0])
        tetrahedra, faces = scenes.tetrahedra_of_scene(scene) - first, scenes.faces_of_scene(scene) - first
        assert len(faces) == 12 * (n - 1) ** 2
        assert volumes(own, tetrahedra).min() > 0
        assert volumes(own, tetrahedra).sum() == pytest.approx(side**3, rel=1e-5)
        a, b, c = (own[faces[:, k]] for k in range(3))
        outwards = np.cross(b - a, c - a)
        assert np.linalg.norm(outwards, axis=1).sum() / 2 == pytest.approx(6 * side**2, rel=1e-5)
        assert (outwards * (a + b + c)).sum(1).min() > 0
        edges = np.sort(np.array([scenes.edges_of_scene(scene) - first]).reshape(-1, 2), axis=1)
        length = np.linalg.norm(own[edges[:, 0]] - own[edges[:, 1]], axis=1)
        assert length.min() > 0.99 * side / (n - 1) and length.max() < 1.01 * 3**0.5 * side / (n - 1)
        vertex = np.unique(own, axis=0, return_inverse=True)[1]
        wanted = {tuple(sorted((vertex[t[i]], vertex[t[j]]))) for t in tetrahedra for i in range(4) for j in range(i)}
        assert wanted == {tuple(sorted(edge)) for edge in vertex[edges]} and len(wanted) == len(edges)
        moved = points(scenes, scene)[:, 0]
        np.testing.assert_allclose(np.linalg.norm(moved[edges[:, 0]] - moved[edges[:, 1]], axis=1), length, rtol=1e-5)


def test_cube_falls_keeps_its_volume_and_comes_to_rest_on_the_ground(scenes):
    for scene in range(3):
        own, first = rest(scenes, scene)
        moved, tetrahedra = points(scenes, scene), scenes.tetrahedra_of_scene(scene) - first
        volume = volumes(moved.transpose(1, 0, 2), tetrahedra)
        assert volume.min() > 0
        assert volume.sum(1).min() > 0.8 * volume[0].sum() and volume[-1].sum() > 0.97 * volume[0].sum()
        low = moved[..., 2].min(0)
        assert 0.049 < low[0] < 0.301 and low.min() > -0.012 and -0.001 < low[-1] < 0.008
        assert np.linalg.norm(moved[:, -1] - moved[:, -2], axis=1).max() * 60 < 0.1
        middle, frames = moved.mean(0), np.arange(4) / 60
        assert np.abs(np.diff(middle[:4, :2], n=2, axis=0)).max() < 1e-5
        np.testing.assert_allclose(np.diff(middle[:4, 2], n=2), -9.81 / 60**2, rtol=0.02)
        assert np.abs(np.gradient(middle[:4, 0], frames)).max() <= 0.71


def test_a_lattice_is_cut_as_equally_as_can_be():
    rest = np.array(np.meshgrid(range(6), range(4), [0], indexing="ij")).reshape(3, -1).T.astype(float)
    corner = np.array([4 * i + j for i in range(5) for j in range(3)])
    triangles = np.concatenate([corner[:, None] + [0, 4, 5], corner[:, None] + [0, 5, 1]])
    patches = cut(rest, triangles, (2, 2))
    assert [len(own) for own in patches.members] == [4 * 3, 4 * 2, 3 * 3, 3 * 2] and len(patches.faces) == 30
    assert patches.masses(24.0).sum() == pytest.approx(24)
    placed = np.concatenate(patches.shapes)
    np.testing.assert_array_equal(np.sort(placed[patches.faces].sum(1), axis=0), np.sort(rest[triangles].sum(1), axis=0))


def test_scenes_are_drawn_from_their_seed_alone(scenes):
    again = Recipe(3, 1, 120).make(range(3, 4))
    np.testing.assert_array_equal(again.unit_poses, scenes.unit_poses[16:])
    np.testing.assert_array_equal(again.soft_points, scenes.soft_points[scenes.soft_offsets[16] :])
    np.testing.assert_array_equal(again.tetrahedra, scenes.tetrahedra_of_scene(2) - scenes.soft_offsets[16])


def test_a_cube_that_turns_inside_out_is_drawn_anew(monkeypatch):
    """The first run of a seed fails, so its scene is that of the second."""
    real, calls = soft_cube.volumes, []

    def inside_out_once(*given):
        calls.append(given)
        return -real(*given) if len(calls) == 1 else real(*given)

    monkeypatch.setattr(soft_cube, "volumes", inside_out_once)
    again = Recipe(5, 1, 2).make(range(5, 6))
    monkeypatch.setattr(soft_cube, "volumes", real)
    first = Recipe(5, 1, 2).make(range(5, 6))
    assert again.unit_young[0] != first.unit_young[0]
    monkeypatch.setattr(soft_cube, "volumes", lambda *given: -real(*given))
    monkeypatch.setattr(trials, "TRIALS", 2)
    with pytest.raises(RuntimeError, match="seed 5: 2 runs of 2 failed, the last because a tetrahedron turned inside out"):
        Recipe(5, 1, 2).make(range(5, 6))


def test_an_interrupted_run_continues_with_the_same_bytes(resumes, monkeypatch):
    monkeypatch.setattr(movi, "SEEDS_PER_SHARD", 1)
    resumes(Recipe(1, 2, 3), Recipe(1, 2, 4))


def test_the_command(makes_splits):
    makes_splits(soft_cube.main, says="3 scenes, 24 units, 2 frames")
