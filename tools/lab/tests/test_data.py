"""Windows from files of different frame rates, planes and roles, mixed in one batch. No assets needed."""

import dataclasses

import numpy as np
import pytest
import torch

from rigidformer_lab import evaluate, movi, pushing
from rigidformer_lab.config import PRESETS
from rigidformer_lab.data import Dataset, commanded, state_at
from rigidformer_lab.model import RigidFormer, transform
from rigidformer_lab.roles import DRIVEN, FREE
from rigidformer_lab.scenes import ContactLaw, read_scenes, write_scenes
from rigidformer_lab.train import TURN_M, displaced, window_loss

HORIZON = 2


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Recorded falls, pushes, and the pushes as if they were of another frame rate, gravity and with commands."""
    folder = tmp_path_factory.mktemp("data")
    plain = movi.make_scenes(movi.Recipe("primitives", 1, 3, 120, None), range(1, 4))
    pushes = pushing.Recipe(1, 3, 100).make(range(1, 4))
    commands = np.random.default_rng(1).random((3, 100, 2)).astype(np.float32)
    slow = dataclasses.replace(pushes, frame_rate_hz=120.0, gravity_m_s2=(0.0, 1.0, -2.5))
    steered = dataclasses.replace(slow, commands=commands)
    held = dataclasses.replace(steered, command_last=np.array([0, 1], np.uint8))
    for name, scenes in (("plain", plain), ("pushes", pushes), ("slow", slow), ("steered", steered), ("held", held)):
        write_scenes(folder / name, scenes)
    return folder


def load(files, *names):
    dataset = Dataset([files / name for name in names], [0], last_frame=110)
    dataset.refresh_subsets(16)
    return dataset


def test_scenes_have_the_law_of_their_file(files, tmp_path):
    """A data set of two files, with a contact law and without, has the motion by impulses of each."""
    falls = dataclasses.replace(read_scenes(files / "plain"), contact_law=ContactLaw(0.2, pyramid=True))
    write_scenes(tmp_path / "lawful", falls)
    write_scenes(tmp_path / "rigid", dataclasses.replace(falls, contact_law=ContactLaw()))
    model = RigidFormer(PRESETS["tiny-impulses"]).initialise()

    def priors(names, windows):
        dataset = Dataset([tmp_path / name for name in names], [0], last_frame=110)
        dataset.refresh_subsets(16)
        dataset.rng = np.random.default_rng(3)
        scene, rotation, centre, _ = batch(dataset, windows)
        return scene.law, model.prior(scene, state_at(rotation, centre, 1)).centre

    # In so many frames something bounces.
    of_first, of_second = [(0, k, 10) for k in range(60, 90, 10)], [(3, k, 10) for k in range(60, 90, 10)]
    law, mixed = priors(["lawful", "rigid"], of_first + of_second)
    assert law.shape == (6, 2) and torch.equal(law, torch.tensor([[0.2, 1.0]] * 3 + [[0.0, 0.0]] * 3))
    lawful, rigid = priors(["lawful"], of_first), priors(["rigid"], of_first)
    assert rigid[0] is None and not torch.allclose(lawful[1], rigid[1])
    torch.testing.assert_close(mixed[:3], lawful[1], rtol=0, atol=1e-5)
    torch.testing.assert_close(mixed[3:], rigid[1], rtol=0, atol=1e-5)


def batch(dataset, windows, augment=False):
    rows = [dataset.chosen_units(w, HORIZON, True) for w in windows]
    return dataset.tensors(windows, rows, HORIZON, 16, augment)


def test_scenes_of_all_kinds_share_a_batch(files):
    dataset = load(files, "plain", "pushes", "slow")
    assert dataset.worlds.frames.tolist() == [111] * 3 + [100] * 6
    model = RigidFormer(PRESETS["tiny-impact"]).initialise()
    windows = [(0, 60, 5), (3, 10, 5), (6, 10, 5)]
    scene, rotation, centre, _ = batch(dataset, windows)
    assert scene.planes.valid.tolist() == [[True, False], [True, True], [True, True]]
    assert model.code(scene).tolist() == [5, 5, 10] and torch.allclose(model.dt(scene) * 240, model.code(scene))
    assert torch.allclose(scene.gravity[2], torch.tensor([0, 1.0, -2.5]))
    state = state_at(rotation, centre, 1)
    together = model.features(scene, state), model.impacts(scene, state)[1], model.active(scene, state)
    for i, window in enumerate(windows):
        torch.manual_seed(0)
        one, rotation, centre, _ = batch(dataset, [window])
        units = one.mask.shape[1]
        one = dataclasses.replace(one, points=scene.points[i : i + 1, :units])
        alone = state_at(rotation, centre, 1)
        assert torch.equal(model.impacts(one, alone)[1][0], together[1][i, :units])
        assert torch.equal(model.active(one, alone)[0], together[2][i, :units])
        assert torch.allclose(model.features(one, alone)[0], together[0][i, :units], atol=1e-4)


def test_the_loss_counts_free_units_alone(files):
    dataset = load(files, "pushes")
    model = RigidFormer(PRESETS["tiny-impact"]).initialise()
    scene, rotation, centre, _ = batch(dataset, [(0, 10, 5), (1, 20, 5)])
    state = state_at(rotation, centre, 1)
    out = torch.zeros(*scene.mask.shape, 4, 3, requires_grad=True)
    after, _, active = model.advance(scene, state, out)
    after.centre.sum().backward()
    free = scene.mask & (scene.role == FREE)
    assert not out.grad[~free].any() and not active[~free].any() and out.grad[free].any()
    driven = scene.mask & (scene.role == DRIVEN)
    assert torch.equal(after.centre[driven], centre[:, :, 2][driven])
    loss = window_loss(model, scene, rotation, centre, HORIZON)
    loss.backward()
    assert torch.isfinite(loss) and loss > 0


def test_displaced_units_keep_their_motion():
    torch.manual_seed(0)
    turn = torch.linalg.qr(torch.randn(3, 40, 2, 3, 3, dtype=torch.float64))[0]
    turn = turn * torch.det(turn)[..., None, None]
    place = torch.randn(3, 40, 2, 3, dtype=torch.float64)
    again, there = (v.double() for v in displaced(turn, place, 0.02))
    way = lambda c: c[:, :, 1] - c[:, :, 0]  # noqa: E731
    assert torch.allclose(way(there), way(place), atol=1e-12) and not torch.allclose(there, place, atol=1e-3)
    by = again @ turn.transpose(-1, -2)  # one turn, in the world, of both frames
    assert torch.allclose(by[:, :, 0], by[:, :, 1], atol=1e-6) and torch.allclose(by @ by.transpose(-1, -2), torch.eye(3).double(), atol=1e-6)
    moved, turned = (there - place).norm(dim=-1).mean(), (by - torch.eye(3)).norm(dim=(-1, -2)).mean() / 2**0.5 * TURN_M
    assert 0.005 < moved < 0.03 and 0.7 < turned / moved < 1.4
    assert all(torch.allclose(a, b) for a, b in zip(displaced(turn, place, 0.0), (turn, place)))


def test_the_loss_of_places_lets_a_model_make_up_for_what_is_off(files):
    """Where a step was wrong, the velocity that brings a unit back to its place is none of the record's."""
    dataset = load(files, "steered")
    model = RigidFormer(dataclasses.replace(PRESETS["tiny"], gate=False, command_size=2)).initialise()
    scene, rotation, centre, _ = batch(dataset, [(0, 10, 5), (1, 20, 5)])
    target, calls = {}, []

    def network(scene, state, trace=None, prior=None):
        """Goes wrong in the first step, and in the second to where the record is."""
        calls.append(1)
        k, local = len(calls), scene.points[:, :, :4]
        free = transform(*model.free(scene, state), local)
        wanted = transform(rotation[:, :, k + 1], centre[:, :, k + 1], local) + (target["off"] if k == 1 else 0.0)
        return (wanted - free) / model.dt(scene)[:, None, None, None]

    model.network = network
    found = {}
    for name, places in (("motion", False), ("places", True)):
        for off in (0.0, 0.05):
            calls.clear()
            target["off"] = torch.tensor([off, 0.0, 0.0])
            found[name, off] = float(window_loss(model, scene, rotation, centre, 2, 0.0, places=places))
    assert found["motion", 0.0] < 1e-6 and found["places", 0.0] < 1e-6
    # Of places the first step alone is wrong; of motion the way back is as wrong as the way off.
    calls.clear()
    target["off"] = torch.tensor([0.05, 0.0, 0.0])
    once = float(window_loss(model, scene, rotation, centre, 1, 0.0, places=True))
    assert found["places", 0.05] == pytest.approx(once / 2, rel=0.02)
    assert found["motion", 0.05] > 2.5 * found["places", 0.05]


def test_turning_the_world_turns_planes_and_gravity(files):
    dataset = load(files, "slow")
    model = RigidFormer(PRESETS["tiny-impact"]).initialise()
    windows = [(0, 10, 5), (1, 20, 5)]
    _, rotation, centre, index = batch(dataset, windows)
    turned, rotation, centre, other = batch(dataset, windows, augment=True)
    assert not torch.allclose(turned.gravity[0, :2], torch.tensor([0, 1.0]))
    still, _, still_centre, _ = batch(dataset, windows)
    order = [[list(theirs).index(unit) for unit in mine] for mine, theirs in zip(index, other)]
    heights = turned.planes.heights(centre[:, :, 1])[torch.arange(2)[:, None], torch.tensor(order)]
    expected = still.planes.heights(still_centre[:, :, 1])
    assert torch.allclose(heights[still.mask], expected[still.mask], atol=1e-4)
    fall = lambda s: (model.gravity_of(s)[:, None] * s.planes.normal).sum(-1)  # noqa: E731
    assert torch.allclose(fall(turned), fall(still), atol=1e-5)


def test_windows_keep_what_free_units_may_touch(files):
    dataset = load(files, "pushes")
    for window in dataset.windows(20, [5], HORIZON):
        rows = dataset.chosen_units(window, HORIZON, False)
        assert len(rows) and (dataset.units.role[rows] == FREE).any()


def test_a_step_s_command_is_the_mean_over_its_frames_or_the_last_of_set_points(files):
    dataset = load(files, "steered")
    assert dataset.command_size == 2
    scene, _, _, _ = batch(dataset, [(0, 10, 5)])
    expected = dataset.worlds.commands[0, 15:20].mean(0)
    assert commanded(scene, 1).command[0].tolist() == pytest.approx(expected.tolist(), abs=1e-6)
    held, _, _, _ = batch(load(files, "held"), [(0, 10, 5)])
    expected[1] = dataset.worlds.commands[0, 19, 1]
    assert commanded(held, 1).command[0].tolist() == pytest.approx(expected.tolist(), abs=1e-6)
    with pytest.raises(SystemExit, match="their command_last differ"):
        load(files, "steered", "held")
    with pytest.raises(SystemExit, match="commands of other sizes"):
        load(files, "steered", "slow")


def test_windows_that_no_scene_has_are_named(files):
    dataset = load(files, "pushes")
    with pytest.raises(SystemExit, match="the longest has 100"):
        dataset.windows(4, [50], HORIZON)
    mixed = load(files, "plain", "pushes")
    assert {int(s) for s, _, _ in mixed.windows(30, [35], HORIZON, None)} <= {0, 1, 2}


def test_evaluation_is_over_free_units(files):
    model = RigidFormer(PRESETS["tiny-impact"]).initialise()
    errors = evaluate.evaluate(model, files / "pushes", 0, (10,), (50,), points=16)
    assert np.isfinite(errors["s10@50"]).all() and errors["s10@50"][0] > 0
    with pytest.raises(SystemExit, match="has 100 frames, and frame 100"):
        evaluate.evaluate(model, files / "pushes", 0, (10,), (50, 100), points=16)
