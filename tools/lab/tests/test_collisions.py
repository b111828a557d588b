"""Closed forms of `collisions` against conservation laws, and engines against them."""

import numpy as np
import pytest

from rigidformer_lab import collisions
from rigidformer_lab.scenes import read_scenes

CASES = {impact.name: impact for impact in collisions.impacts()}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("friction,restitution", collisions.SETTINGS)
def test_closed_forms_keep_momentum_and_bounce(name, friction, restitution):
    impact = CASES[name]
    after = impact.after(friction, restitution)
    before = [(body.velocity, body.spin) for body in impact.bodies]

    def sums(motion):
        way = sum(body.mass * v for body, (v, _) in zip(impact.bodies, motion))
        whirl = sum(body.mass * np.cross(body.centre, v) + body.moment * w for body, (v, w) in zip(impact.bodies, motion))
        energy = sum(body.mass * v @ v + body.moment * w @ w for body, (v, w) in zip(impact.bodies, motion))
        return way, whirl, energy

    def leaving(motion):
        speed = [v + np.cross(w, impact.point - body.centre) for body, (v, w) in zip(impact.bodies, motion)]
        return (speed[1] - speed[0]) @ impact.normal

    (way, whirl, energy), (way_after, whirl_after, energy_after) = sums(before), sums(after)
    assert np.allclose(way, way_after) and np.allclose(whirl, whirl_after)
    assert np.isclose(leaving(after), -restitution * leaving(before))
    assert np.isclose(energy, energy_after) if (friction, restitution) == (0, 1) else energy_after <= energy + 1e-12
    assert after[0][0] @ impact.normal <= after[1][0] @ impact.normal + 1e-12


def test_scene_files_are_the_closed_form(tmp_path):
    impact = CASES["hollow balls, offset"]
    collisions.write_scenes(tmp_path / "a.safetensors", collisions.scenes(impact))
    scenes = read_scenes(tmp_path / "a.safetensors")
    assert (scenes.scenes, scenes.units, scenes.frames) == (48, 96, 101)
    assert np.allclose(scenes.unit_inertia, [[2 / 3 * 0.01], [2 / 3 * 0.025]] * 48)
    for frame in (0, 10):  # step code 10 observes both: the bodies are apart
        first, second = scenes.unit_poses[::2, frame, :3], scenes.unit_poses[1::2, frame, :3]
        assert (np.linalg.norm(first - second, axis=1) > 0.205).all()
    touch = collisions.touch_frames()[0]
    assert np.allclose(collisions.path(impact, 0.0, 0.5, touch), scenes.unit_poses[:2], atol=1e-6)


@pytest.mark.parametrize("name", ["balls, head on", "balls, offset", "hollow balls, offset"])
def test_bullet_without_its_push_hits_balls_as_the_closed_form_says(name):
    impact, run = CASES[name], (0.1, 0.5, 14.3)
    closed = collisions.path(impact, *run)[:, collisions.LAST_FRAME]
    for engine, most in (("Bullet, erp 0", 0.5), ("MuJoCo", 6.0)):
        found = collisions.in_per_cent(impact, *collisions.errors(collisions.ENGINES[engine](impact, *run), closed))
        assert max(found) < most, (engine, found)


def test_programs_that_are_not_there_are_told(tmp_path, capsys):
    assert collisions.main(["--out", str(tmp_path), "--program", str(tmp_path / "none")]) == 1
    assert "none" in capsys.readouterr().err
