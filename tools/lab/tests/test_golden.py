"""The golden vectors that the Rust tests read are what this model computes. No assets needed."""

import dataclasses
import pathlib

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.numpy import load_file

from rigidformer_lab import golden
from rigidformer_lab.config import ModelConfig
from rigidformer_lab.model import RigidFormer
from rigidformer_lab.scenes import TEST, Scenes

DATA = pathlib.Path(__file__).parents[3] / "tests" / "data"


def committed(name):
    """A model of `tests/data`."""
    path = DATA / f"{name}.model.safetensors"
    with safe_open(path, framework="numpy") as file:
        config = ModelConfig.from_json(file.metadata()["config"])
    model = RigidFormer(config)
    model.load_state_dict({k: torch.from_numpy(v) for k, v in load_file(path).items()})
    return model.double()


def compare(out, expected):
    assert out.keys() == expected.keys()
    for name, value in expected.items():
        assert value.dtype == out[name].dtype, name
        np.testing.assert_allclose(out[name], value, rtol=0, atol=1e-6 * max(1, np.abs(value).max()), err_msg=name)


@pytest.mark.parametrize("name", ["tiny", "tiny-paper-inputs", "tiny-impact"])
def test_recorded_scenes(name):
    expected = load_file(DATA / f"{name}.golden.safetensors")
    units = len(expected["physics"])
    file = Scenes(
        dataset="golden", shape_names=[str(u) for u in range(units)], shape_points=expected["points"],
        shape_offsets=np.cumsum([0, *expected["point_counts"]]), scene_seed=np.zeros(1, np.int64),
        scene_split=np.full(1, TEST, np.uint8), scene_units=np.array([0, units]),
        unit_shape=np.arange(units, dtype=np.int32), unit_scale=np.ones(units, np.float32),
        unit_physics=expected["physics"], provenance="", licence="",
        unit_poses=np.stack((expected["previous"], expected["current"]), 1),
    )  # fmt: skip
    scene, state, inputs, centres = golden.golden_scene(file, 0, 0, 1)
    command = expected.get("command")
    scene = dataclasses.replace(
        scene, step=torch.tensor([golden.RECORDED[name][0]]),
        command=None if command is None else torch.from_numpy(command)[None].double(),
    )  # fmt: skip
    compare(golden.record(committed(name), scene, state, inputs, centres, command, True), expected)


def test_the_scene_in_its_own_length():
    expected = load_file(DATA / "tiny-similar.golden.safetensors")
    size = golden.SIMILAR_LENGTH, golden.SIMILAR_GRAVITY, golden.SIMILAR_MASS
    scene, state, inputs, centres, targets = golden.roles_scene(*size)
    model = committed("tiny-similar")
    assert model.config.length_m == 0.25
    compare(golden.record(model, scene, state, inputs, centres, None, True, targets), expected)


def test_the_scene_of_all_roles_by_impulses():
    expected = load_file(DATA / "tiny-impulses.golden.safetensors")
    scene, state, inputs, centres, targets = golden.roles_scene(steps=golden.IMPULSES_STEPS, start=golden.IMPULSES_START)
    model = committed("tiny-impulses")
    assert model.config.motion == "impulses"
    compare(golden.record(model, scene, state, inputs, centres, None, True, targets), expected)


def test_units_that_hold_together():
    expected = load_file(DATA / "tiny-bonds.golden.safetensors")
    scene, state, inputs, centres, targets = golden.roles_scene(steps=golden.IMPULSES_STEPS, start=golden.BONDS_START)
    scene, inputs = golden.bonded(scene, inputs)
    compare(golden.record(committed("tiny-impulses"), scene, state, inputs, centres, None, False, targets), expected)
    assert expected["rollout_active"][:, [4, 5, 8]].any(0).all(), "the correction of a cluster counts"
    # Centres of units move with the first one's frame.
    rotation, place = expected["rollout"][..., 1:], expected["rollout"][..., 0]
    first = rotation[:, 4].transpose(0, 2, 1)
    for unit in (5, 8):
        arm = np.einsum("sij,sj->si", first, place[:, unit] - place[:, 4])
        np.testing.assert_allclose(arm, np.tile(arm[:1], (len(arm), 1)), atol=1e-5)
        turn = first @ rotation[:, unit]
        np.testing.assert_allclose(turn, np.tile(turn[:1], (len(turn), 1, 1)), atol=1e-5)


def test_bonds_that_a_model_breaks():
    expected = load_file(DATA / "tiny-breaking.golden.safetensors")
    scene, state, inputs, centres, targets = golden.roles_scene(steps=golden.IMPULSES_STEPS, start=golden.BONDS_START)
    scene, inputs = golden.bonded(scene, inputs)
    scene = golden.meeting(scene, state)
    model = committed("tiny-breaking")
    assert model.config.bonds == 8
    compare(golden.record(model, scene, state, inputs, centres, None, True, targets), expected)
    first, last = expected["rollout_holds"][[0, -1]]
    assert first.all() and last.any() and not last.all(), "one breaks, the other holds"


def test_the_scene_of_all_roles_seen_from_a_heading():
    expected = load_file(DATA / "tiny-carried.golden.safetensors")
    scene, state, inputs, centres, targets = golden.roles_scene()
    model = committed("tiny-carried")
    assert model.config.motion == "robot" and model.config.directions == (1,)
    scene = dataclasses.replace(scene, command=torch.from_numpy(expected["command"])[None].double())
    compare(golden.record(model, scene, state, inputs, centres, expected["command"], True, targets), expected)


def test_the_scene_of_all_roles():
    expected = load_file(DATA / "tiny-roles.golden.safetensors")
    scene, state, inputs, centres, targets = golden.roles_scene()
    compare(golden.record(committed("tiny-roles"), scene, state, inputs, centres, None, True, targets), expected)
    assert np.count_nonzero(expected["role"] == 0) == 7 and expected["targets"].shape == (12, 10, 7)
    assert np.isclose(expected["dt"][0] * 240, 6.5)
    # Driven units are at their targets, the fixed one stays, neither is ever predicted.
    rollout, moved = expected["rollout"], expected["role"] == 1
    assert np.allclose(rollout[:, moved][..., 0], expected["targets"][:, moved, :3], atol=1e-6)
    assert np.all(rollout[:, expected["role"] == 2] == rollout[:1, expected["role"] == 2])
    assert not expected["rollout_active"][:, expected["role"] > 0].any()
    free = expected["rollout_active"][:, expected["role"] == 0]
    assert free[:, :-1].all() and not free[:, -1].any()  # the last one falls from high up
