"""Shapes as the tracker makes them: the same for a seed, near the true ones, and all else as recorded."""

import dataclasses

import numpy as np
import pytest

from conftest import needed

needed("rigidformer", reason="the runtime's Python package")

from rigidformer_lab import clouds  # noqa: E402
from rigidformer_lab.data import Dataset  # noqa: E402
from rigidformer_lab.movi import Recipe, make_scenes  # noqa: E402
from rigidformer_lab.scenes import TEST, TRAIN, VALIDATION, SceneFileError, read_scenes, write_scenes  # noqa: E402

SEEDS = range(8, 11)  # one for training, one for validation, one for tests


@pytest.fixture(scope="module")
def scenes():
    return make_scenes(Recipe("primitives", SEEDS[0], len(SEEDS), 60, None), SEEDS)


@pytest.fixture(scope="module")
def file(scenes, tmp_path_factory):
    path = tmp_path_factory.mktemp("clouds") / "scenes.safetensors"
    write_scenes(path, scenes)
    return path


def made(file, name, *more):
    out = file.with_name(name)
    assert clouds.main([str(file), "--out", str(out), "--captures", "3", "--workers", "1", *more]) == 0
    return out


@pytest.fixture(scope="module")
def seen(file):
    return made(file, "seen")


def true_points(scenes, unit):
    kind = scenes.unit_shape[unit]
    return scenes.points_of_shape(kind) * scenes.unit_scale[unit]


def test_the_same_seed_gives_the_same_bytes(file, seen):
    assert seen.read_bytes() == made(file, "again").read_bytes()
    assert seen.read_bytes() != made(file, "other", "--seed", "1").read_bytes()
    assert not list(file.parent.glob("*.parts"))


def test_poses_seeds_and_splits_stay(file, seen, scenes):
    found = read_scenes(seen)
    assert found.scene_split.tolist() == [TRAIN, VALIDATION], "tests are left out"
    units = scenes.scene_units[2]
    assert np.array_equal(found.unit_poses, scenes.unit_poses[:units])
    assert found.scene_seed.tolist() == scenes.scene_seed[:2].tolist()
    assert found.licence == scenes.licence and found.provenance.startswith(scenes.provenance)
    assert "2 cameras, noise 0.001 m" in found.provenance and found.frame_rate_hz == scenes.frame_rate_hz
    every = read_scenes(made(file, "every", "--splits", "train", "validation", "test"))
    assert every.scene_split.tolist() == [TRAIN, VALIDATION, TEST]
    # A scene's draws do not depend on which other scenes are looked at.
    alone = read_scenes(made(file, "alone", "--splits", "validation"))
    last = found.units_of_scene(1)
    for unit, same in zip(last, alone.units_of_scene(0)):
        assert np.array_equal(true_points(found, unit), true_points(alone, same))


def test_shapes_differ_by_noise_and_completion_alone(seen, scenes):
    found, completed = read_scenes(seen), 0
    for unit in range(found.units):
        points, true = true_points(found, unit), true_points(scenes, unit)
        kind = found.unit_shape[unit]
        if kind < len(scenes.shape_names):
            assert np.array_equal(points, true)
            continue
        completed += 1
        assert found.shape_names[kind].endswith(clouds.SEEN) and 4 <= len(points) <= 96
        extent = np.linalg.norm(np.ptp(true, axis=0))
        off = clouds.off_surface(points.astype(np.float64), clouds.surface_of(true, []))
        assert 0 < np.median(off) < 0.06 * extent and off.max() < 0.35 * extent
        assert 0.5 < clouds.volume_m3(points) / clouds.volume_m3(true) < 1.5
        # Single precision, and points in farthest-point order.
        assert found.unit_physics[unit, 0] == pytest.approx(1000 * clouds.volume_m3(points), rel=1e-3)
    assert completed >= found.units - 1
    assert np.all(found.unit_physics[:, 1:] == np.float32([0.5, 0.4]))
    assert (found.ground_friction, found.ground_restitution) == (0.5, 0.4)


def test_looks_and_physics_are_chosen(file, scenes):
    twice = read_scenes(made(file, "twice", "--variants", "2", "--physics", "record", "--splits", "train", "--noise", "0.003"))
    own = scenes.units_of_scene(0)
    assert twice.scene_seed.tolist() == [SEEDS[0]] * 2
    assert np.array_equal(twice.unit_physics, np.tile(scenes.unit_physics[own], (2, 1)))
    assert np.array_equal(twice.unit_poses, np.tile(scenes.unit_poses[own], (2, 1, 1)))
    first, second = (true_points(twice, unit) for unit in (0, len(own)))
    assert first.shape != second.shape or not np.allclose(first, second)


def test_an_interrupted_run_continues(file, seen, monkeypatch, capsys):
    # A shard a scene, so that one can be there and one not.
    monkeypatch.setattr(clouds, "shards_of", lambda first, count: [range(k, k + 1) for k in range(first, first + count)])
    join = clouds.Recipe.join

    def interrupt(recipe, shards):
        raise KeyboardInterrupt

    command = [str(file), "--out", str(file.with_name("resumed")), "--captures", "3", "--workers", "1"]
    monkeypatch.setattr(clouds.Recipe, "join", interrupt)
    assert clouds.main(command) == 130
    assert "continues" in capsys.readouterr().err
    monkeypatch.setattr(clouds.Recipe, "join", join)
    sorted(file.with_name("resumed.parts").glob("seeds-*"))[1].unlink()
    assert clouds.main([*command, "--noise", "0.002"]) == 1
    assert "other arguments" in capsys.readouterr().err
    assert clouds.main(command) == 0
    assert file.with_name("resumed").read_bytes() == seen.read_bytes()


def test_a_model_trains_on_them(seen):
    dataset = Dataset([seen], [TRAIN], last_frame=50)
    windows = dataset.windows(2, [5], 1, latest_start=20)
    [(chosen, rows), *_] = dataset.batches(windows, 1, 64)
    assert len(chosen) and all(len(own) for own in rows)


def test_what_nobody_sees_stays(scenes, tmp_path):
    # A unit far below the ground is hidden by it.
    poses = scenes.unit_poses.copy()
    poses[0, :, 2] = -5.0
    role = np.zeros(scenes.units, np.uint8)
    path, out = tmp_path / "hidden", tmp_path / "out"
    write_scenes(path, dataclasses.replace(scenes, unit_poses=poses, unit_role=role))
    assert clouds.main([str(path), "--out", str(out), "--captures", "2", "--workers", "1", "--splits", "train"]) == 0
    found = read_scenes(out)
    assert np.array_equal(true_points(found, 0), true_points(scenes, 0))
    assert found.unit_physics[0, 0] == pytest.approx(1000 * clouds.volume_m3(true_points(scenes, 0)), rel=1e-5)
    assert "1 of" in found.provenance


def test_wrong_use_says_what_to_do(file, scenes, tmp_path, capsys):
    out = ["--out", str(tmp_path / "x")]
    for wrong, said in (("--cameras 0", "1 to 3"), ("--noise 2", "metres from 0 to 1"), ("--captures 0", "at least 1"),
                        ("--variants 0", "at least 1"), ("--limit 0", "at least 1"), ("--seed -1", "between 0"),
                        ("--splits some", "invalid choice")):  # fmt: skip
        with pytest.raises(SystemExit):
            clouds.main([str(file), *out, *wrong.split()])
        assert said in capsys.readouterr().err
    assert clouds.main(["nothing.safetensors", *out]) == 1
    assert "nothing.safetensors" in capsys.readouterr().err
    assert clouds.main([str(file), *out, "--splits", "extra"]) == 1
    assert "--splits" in capsys.readouterr().err
    assert clouds.main([str(file), *out, "--model", str(tmp_path / "none.rfm")]) == 1
    assert "none.rfm" in capsys.readouterr().err
    soft = dataclasses.replace(scenes, unit_soft=np.ones(scenes.units, np.uint8))
    with pytest.raises(SceneFileError, match="deformable"):
        clouds.check(file, soft, ("train",), None)
    bonds = dataclasses.replace(scenes, bonds=np.zeros((1, 2), np.int32))
    with pytest.raises(SceneFileError, match="whole"):
        clouds.check(file, bonds, ("train",), None)
