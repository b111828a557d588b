"""Scenes of lasting contact. No assets needed."""

import dataclasses

import numpy as np
import pytest

from rigidformer_lab import bullet, contacts, movi, mujoco_engine
from rigidformer_lab.contacts import KINDS, Recipe
from rigidformer_lab.geometry import quaternion_to_matrix
from rigidformer_lab.roles import DRIVEN, FIXED, FREE
from rigidformer_lab.scenes import EXTRA, ContactLaw, read_scenes, write_scenes

FRAMES = 90


def scenes_of(kind, seeds=range(1, 4), size=0.1):
    return Recipe(seeds[0], len(seeds), FRAMES, size, (kind,)).make(seeds)


@pytest.mark.parametrize("kind", KINDS)
def test_bodies_stay_on_the_free_side_and_start_apart(kind, tmp_path):
    scenes = scenes_of(kind)
    write_scenes(tmp_path / "x", scenes)
    assert read_scenes(tmp_path / "x").version == "2"
    assert (scenes.roles == FREE).any() and ((scenes.roles == DRIVEN).any() == (kind == "pusher"))
    assert (scenes.roles == FIXED).any() == (kind in ("table", "steps"))
    for scene in range(scenes.scenes):
        planes = scenes.planes_of_scene(scene)
        assert len(planes) == (2 if kind in ("ramp", "wall") else 1)
        assert 0 <= planes[:, 4].min() and planes[:, 4].max() <= 1 and planes[:, 5].max() <= 0.8
        for unit in scenes.units_of_scene(scene):
            points = scenes.points_of_shape(scenes.unit_shape[unit]) * scenes.unit_scale[unit]
            if scenes.roles[unit] != FREE:
                continue
            radius = np.linalg.norm(points, axis=1).max()
            assert 0.049 < radius < 0.201
            pose = scenes.unit_poses[unit].astype(np.float64)
            world = np.einsum("tij,nj->tni", quaternion_to_matrix(pose[:, 3:]), points) + pose[:, None, :3]
            assert (world @ planes[:, :3].T - planes[:, 3]).min() > -0.004
            speed = np.linalg.norm(np.diff(pose[:, :3], axis=0), axis=1) * scenes.frame_rate_hz
            assert speed.max() < 6  # nothing starts inside another body and is thrown out
    physics = scenes.unit_physics[scenes.roles == FREE]
    assert (physics[:, 1:] >= 0).all() and physics[:, 1].max() <= 1 and physics[:, 2].max() <= 0.8


def test_bodies_slide_and_come_to_rest():
    scenes = Recipe(1, 3, 480, 0.1, ("slide",)).make(range(1, 4))
    step = np.linalg.norm(np.diff(scenes.unit_poses[:, :, :3], axis=1), axis=2) * scenes.frame_rate_hz
    assert step[:, 5].max() > 0.5 and step[:, -1].min() < 0.01


def test_the_pusher_pushes():
    scenes = Recipe(1, 2, 300, 0.6, ("pusher",)).make(range(1, 3))
    moved = np.linalg.norm(scenes.unit_poses[:, -1, :2] - scenes.unit_poses[:, 0, :2], axis=1)
    assert moved[scenes.roles == FREE].max() > 0.2


def test_another_size_is_the_same_motion():
    large, small = scenes_of("heap", range(5, 6), 0.4), scenes_of("heap", range(5, 6), 0.1)
    assert (large.frame_rate_hz, small.frame_rate_hz) == (pytest.approx(240 * 1.5**0.5), 2 * large.frame_rate_hz)
    np.testing.assert_allclose(large.unit_poses[:, :, :3], 4 * small.unit_poses[:, :, :3], rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(large.unit_poses[:, :, 3:], small.unit_poses[:, :, 3:])
    np.testing.assert_allclose(large.unit_scale, 4 * small.unit_scale, rtol=1e-6)
    np.testing.assert_allclose(large.unit_physics[:, 0], 64 * small.unit_physics[:, 0], rtol=1e-6)
    np.testing.assert_array_equal(large.planes, small.planes)


def test_scenes_are_drawn_from_their_seed_alone():
    both, one = scenes_of("steps", range(7, 9)), scenes_of("steps", range(8, 9))
    np.testing.assert_array_equal(both.unit_poses[both.units_of_scene(1)], one.unit_poses)
    shapes = movi.primitive_shapes()
    assert len({contacts.simulate(shapes, seed, 1)[0] for seed in range(60)}) == len(KINDS)


def test_an_interrupted_run_continues_with_the_same_bytes(resumes, monkeypatch):
    monkeypatch.setattr(movi, "SEEDS_PER_SHARD", 1)
    recipe = Recipe(1, 2, 3)
    resumes(recipe, dataclasses.replace(recipe, size=0.2))


@pytest.mark.parametrize("wrong, message", [
    (("--size", "3"), "from 0.02 to 1.0"), (("--size", "nan"), "from 0.02 to 1.0"), (("--kinds", "pile"), "invalid choice"),
    (("--frames", "0"), "at least 1"),
])
def test_bad_arguments(tmp_path, capsys, wrong, message):
    with pytest.raises(SystemExit):
        contacts.main(["--out", str(tmp_path / "x"), *wrong])
    assert message in capsys.readouterr().err


def test_the_command(tmp_path, capsys):
    out = tmp_path / "x"
    arguments = ["--out", str(out), "--seeds", "1", "--frames", "2", "--workers", "1", "--kinds", "roll", "slide"]
    assert contacts.main(arguments) == 0
    assert "1 scenes" in capsys.readouterr().out and read_scenes(out).dataset == contacts.DATASET


def test_mujoco_records_the_same_scenes_by_another_law(tmp_path):
    ours, theirs = (Recipe(3, 3, 60, 0.6, ("toss",), engine).make(range(3, 6)) for engine in ("bullet", "mujoco"))
    assert ours.dataset == "contacts" and theirs.dataset == "contacts-mujoco" and "MuJoCo" in theirs.provenance
    assert (theirs.scene_split == EXTRA).all()
    assert ours.contact_law == bullet.CONTACT_LAW and theirs.contact_law == ContactLaw()
    write_scenes(tmp_path / "x", theirs)
    assert (theirs.unit_physics == ours.unit_physics).all() and (theirs.unit_inertia == ours.unit_inertia).all()
    apart = np.linalg.norm(ours.unit_poses[:, :, :3] - theirs.unit_poses[:, :, :3], axis=2)
    assert apart[:, 0].max() < 1e-6 and 1e-4 < apart[:, -1].max() < 0.3
    again = Recipe(3, 3, 60, 0.6, ("toss",), "mujoco").make(range(3, 6))
    assert (again.unit_poses == theirs.unit_poses).all()


def test_damping_gives_the_restitution():
    for restitution in (0.05, 0.1, 0.5, 0.9):
        ratio = mujoco_engine.damping_ratio(restitution)
        place, speed, step = 0.0, -1.0, 1e-4
        while place <= 0:  # a spring of frequency 1 that does not pull
            push = max(-place - 2 * ratio * speed, 0.0)
            if push == 0 and speed > 0:
                break
            speed += push * step
            place += speed * step
        assert speed == pytest.approx(restitution, abs=2e-3)
