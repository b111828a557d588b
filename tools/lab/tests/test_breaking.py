"""Bonds: where units meet, what a network is told of them, and what breaks in windows of training."""

import numpy as np
import pytest
import torch

from rigidformer_lab import breaking, fragments
from rigidformer_lab.config import PRESETS, ModelConfig
from rigidformer_lab.data import Dataset, commanded, state_at
from rigidformer_lab.model import RigidFormer
from rigidformer_lab.train import bond_batch

STEP = 5


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    path = tmp_path_factory.mktemp("bonds") / "fragments.safetensors"
    assert fragments.main(["--seeds", "3", "--frames", "60", "--split", "train", "--workers", "1", "--out", str(path)]) == 0
    dataset = Dataset([path], [0], late=False)
    dataset.refresh_subsets(24)
    return dataset


def model():
    torch.manual_seed(0)
    return RigidFormer(PRESETS["fragments"]).initialise()


def test_a_joint_of_two_cubes_is_their_face():
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    turn, centre = np.stack([np.eye(3)] * 2), np.array([[0.0, 0, 0], [1, 0, 0]])
    spread, touches, middle = breaking.joint([corners, corners], turn, centre, [0.87, 0.87])
    assert touches == 4 and np.allclose(middle, [0.5, 0, 0])
    larger = breaking.joint([corners * 2, corners * 2], turn, centre * 2, [1.74, 1.74])
    assert np.isclose(larger[0], 4 * spread) and spread > 0
    spread, touches, middle = breaking.joint([corners, corners], turn, centre * 3, [0.87, 0.87])
    assert (spread, touches) == (0, 0) and np.allclose(middle, [1.5, 0, 0])


def test_windows_hold_what_breaks_in_the_step(dataset):
    for scene, frame, step in dataset.breaking_windows(12, [STEP], breaking_share=1.0):
        until = dataset.bonds[scene][1]
        assert (until > frame + step).any()
        broken = (until > frame + step) & (until <= frame + 2 * step)
        assert broken.any()


def test_clusters_follow_the_record(dataset):
    windows = [(0, 0, STEP)]
    rows = [dataset.chosen_units(windows[0], 8, True)]
    scene, rotation, centre, _ = dataset.tensors(windows, rows, 8, None, False)
    pairs, until = dataset.bonds[0][:2]
    for k in range(8):
        held = commanded(scene, k)
        expected = breaking.clusters_at(pairs, until, len(rows[0]), scene.body[0].numpy(), STEP * (k + 1))
        np.testing.assert_array_equal(held.lead[0].numpy(), expected[0])
        # Units of one body are those of one cluster.
        same = held.body[0][:, None] == held.body[0]
        np.testing.assert_array_equal(same.numpy(), expected[0][:, None] == expected[0])


def test_nothing_breaks_in_flight_and_what_breaks_stays_broken(dataset):
    own = model()
    with torch.no_grad():
        own.bonds.net.get_submodule("1").bias.add_(100.0)  # it breaks all that it is asked about
    windows = [(0, 0, STEP)]
    rows = [dataset.chosen_units(windows[0], 9, True)]
    scene, rotation, centre, _ = dataset.tensors(windows, rows, 9, None, False)
    state, holds = state_at(rotation, centre, 1), scene.bonds.mask.clone()
    first = int(dataset.bonds[0][1].min())
    seen = []
    with torch.no_grad():
        for k in range(9):
            state, after, _ = breaking.step(own, scene, state, holds)
            assert not (after & ~holds).any()
            holds = after
            seen.append((STEP * (k + 2), bool(holds.all())))
    assert all(whole for frame, whole in seen if frame < first - STEP), "in flight"
    assert not seen[-1][1], "it lands"


def test_the_loss_is_of_bonds_that_hold_and_has_gradients(dataset):
    own = model()
    batch = bond_batch(dataset, [STEP], 4, 24, "cpu", noise=0.0)
    breaking.fit_normalisation(own, [batch])
    assert torch.isfinite(own.bonds.feature_scale).all()
    loss = breaking.loss(own, *batch)
    loss.backward()
    assert 0 < float(loss.detach()) < 5
    assert own.bonds.net.get_submodule("0").weight.grad.abs().sum() > 0


def test_configurations_that_bonds_do_not_go_with():
    with pytest.raises(ValueError, match="bonds go with"):
        ModelConfig(name="x", bonds=4)
    with pytest.raises(ValueError, match="bonds go with"):
        ModelConfig(name="x", bonds=4, features="impact", motion="impulses", length_m=0.5)
