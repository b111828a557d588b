"""What scenes of robots share: commands that are held, runs drawn anew, and files of a folder."""

import dataclasses

import numpy as np
import pytest

from rigidformer_lab import robots
from rigidformer_lab.robots import FolderError, Recipe, Robot, hold_commands, read_arrays, stay_up
from rigidformer_lab.scenes import TEST, TRAIN, VALIDATION


class Coin(Robot):
    """Falls unless its first draw is below a half; what it does then is its next draw."""

    def run(self, rng, frames):
        if rng.random() >= 0.5:
            return None
        commands = hold_commands(rng, frames, lambda: rng.random(2))
        poses = np.zeros((1, frames, 7))
        poses[..., 2], poses[..., 3] = np.arange(frames), -1.0
        return poses, commands


COIN = Coin("coin", ["disc"], [np.eye(4, 3, dtype=np.float32)], np.array([2.0]), 0.5, (0.7, 0.1), (0.0, 0.0, -9.0), 1,
            "Tossed.", "any", "digest")


class Coins(Recipe):
    dataset = "coin"

    def robot(self):
        return COIN


def test_commands_last_their_time():
    rng = np.random.default_rng(3)
    commands = hold_commands(rng, 100000, lambda: rng.uniform(-1, 1, 3), first=np.zeros(3))
    assert commands.shape == (100000, 3) and not commands[0].any()
    changes = np.flatnonzero((np.diff(commands, axis=0) != 0).any(1)) + 1
    held = np.diff(changes)
    assert changes[0] >= 45 and held.min() == 45 and held.max() == 120 and not (changes % 3).any()
    assert abs(held.mean() - 82.5) < 2


def test_runs_that_fall_are_drawn_anew_from_their_seed():
    made = [stay_up(COIN, seed, 20) for seed in range(20)]
    fallen = [number for _, _, number in made]
    assert 5 < sum(fallen) < 40 and min(fallen) == 0
    for seed, (poses, commands, number) in enumerate(made):
        draws = [np.random.default_rng((seed, 1, attempt)).random() < 0.5 for attempt in range(number + 1)]
        assert draws == [False] * number + [True]
        assert poses.shape == (1, 20, 7) and poses[0, 0, 2] == robots.WARM_UP_FRAMES and commands.shape == (20, 2)
        np.testing.assert_array_equal(commands, stay_up(COIN, seed, 20)[1])


def test_a_robot_that_always_falls_ends_the_run(monkeypatch):
    monkeypatch.setattr(Coin, "run", lambda self, rng, frames: None)
    with pytest.raises(RuntimeError, match="seed 5: the robot fell in 50 runs of 50"):
        stay_up(COIN, 5, 3)


def test_the_file_counts_the_runs_that_fell():
    recipe = Coins(None, 8, 13, 4)
    assert [list(seeds)[0] for seeds in recipe.shards()] == [8, 18]
    shards = [recipe.make(seeds) for seeds in recipe.shards()]
    scenes = recipe.join(shards)
    fallen = sum(stay_up(COIN, seed, 4)[2] for seed in range(8, 21))
    assert scenes.provenance == f"Tossed. Runs that fell and were drawn anew: {fallen}."
    assert scenes.scene_seed.tolist() == list(range(8, 21)) and scenes.version == "2"
    assert scenes.scene_split[:3].tolist() == [TRAIN, VALIDATION, TEST]
    assert set(dataclasses.replace(recipe, split=TEST).make(range(8, 11)).scene_split) == {TEST}
    assert scenes.frame_rate_hz == 30 and scenes.gravity_m_s2 == (0, 0, -9) and scenes.commands.shape == (13, 4, 2)
    np.testing.assert_allclose(scenes.unit_physics, [(2.0, 0.5, 0.0)] * 13)
    np.testing.assert_allclose(scenes.planes_of_scene(12), [(0, 0, 1, 0, 0.7, 0.1)])
    assert (scenes.unit_body == 0).all() and scenes.unit_role is None


@pytest.mark.parametrize("arrays, message", [
    (None, "cannot be read"),
    ({"a": np.zeros((2, 3))}, "no array of the name b"),
    ({"a": np.zeros((2, 4)), "b": np.zeros(1)}, r"a has shape \(2, 4\), not \(any, 3\)"),
    ({"a": np.zeros(3), "b": np.zeros(1)}, r"a has shape \(3,\), not"),
    ({"a": np.full((2, 3), np.inf), "b": np.zeros(1)}, "a holds values that are not finite"),
])
def test_bad_arrays_are_named(tmp_path, arrays, message):
    path = tmp_path / "x.npz"
    if arrays is not None:
        np.savez(path, **arrays)
    with pytest.raises(FolderError, match=message) as error:
        read_arrays(path, {"a": (None, 3), "b": (1,)}, "ask the maker")
    assert str(path) in str(error.value) and "ask the maker" in str(error.value)
