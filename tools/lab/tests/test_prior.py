"""The model that corrects motion by impulses, against that motion itself."""

import dataclasses
import json

import numpy as np
import pytest
import torch

from rigidformer_lab import geometry
from rigidformer_lab.config import PRESETS, ModelConfig
from rigidformer_lab.impacts import extreme_points
from rigidformer_lab.model import RigidFormer, Scene, State

GRAVITY = 10.0


def boxes(centres, velocities, step=10, half=0.2, friction=0.5):
    """Equal boxes about z = 0: Scene, and State with these velocities now (m/s)."""
    corners = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), -1).reshape(-1, 3) * half
    local = geometry.prepare_points(corners.astype(np.float32))[0]
    hull = local[extreme_points(local)]
    units, dt = len(centres), step / 240
    put = lambda a: torch.from_numpy(np.asarray(a)).double()[None]  # noqa: E731
    whole = lambda value: torch.full((1, units), value)  # noqa: E731
    centre = put(np.array(centres, float))
    # So that gravity until now leaves these velocities.
    before = centre - put(np.array(velocities, float)) * dt
    before[..., 2] -= GRAVITY * dt * dt / 2
    eye = torch.eye(3).double().expand(1, units, 3, 3)
    scene = Scene(
        points=put(local).expand(units, -1, -1)[None], points_in_use=whole(8), mask=torch.ones(1, units, dtype=torch.bool),
        physics=put([[1.0, friction, 0.3]] * units), radius=whole(float(np.linalg.norm(local, axis=1).max())).double(),
        reference=(eye, before), start=whole(0), count=whole(8), scale=whole(1.0).double(), bank=put(local)[0],
        step=torch.tensor([step]), hull_start=whole(0), hull_count=whole(len(hull)), hull_bank=put(hull)[0],
        extent=put(np.ptp(local, axis=0)).expand(1, units, 3),
    )  # fmt: skip
    return scene, State(eye.clone(), before, eye.clone(), centre)


def model(**fields):
    torch.manual_seed(0)
    return RigidFormer(dataclasses.replace(PRESETS["tiny-impulses"], **fields)).initialise().double()


def roll(net, scene, state, steps):
    with torch.no_grad():
        for _ in range(steps):
            state, _, _ = net.step(scene, state)
    return state


def test_impulses_need_hulls():
    with pytest.raises(ValueError, match="hulls"):
        dataclasses.replace(PRESETS["tiny"], motion="impulses")
    assert ModelConfig.from_json(PRESETS["tiny-impulses"].to_json()).outputs == 6


def test_models_have_no_contact_law():
    older = json.loads(PRESETS["tiny-impulses"].to_json()) | {"law": None}
    assert ModelConfig.from_json(json.dumps(older)) == PRESETS["tiny-impulses"]
    with pytest.raises(ValueError, match="those of scenes"):
        ModelConfig.from_json(json.dumps(older | {"law": {"restitution_offset": 0.03}}))


def test_the_law_is_of_each_scene():
    """Of boxes that fall on the ground one bounces higher: that whose scene has a law."""
    scene, state = boxes([[0, 0, 0.201]], [[0, 0, -2]])
    net = model()
    rigid = net.prior(scene, state).centre[0, 0, 2]
    law = lambda *numbers: dataclasses.replace(scene, law=torch.tensor([numbers], dtype=torch.float64))  # noqa: E731
    assert net.prior(law(0.0, 0.0), state).centre[0, 0, 2] == rigid
    assert net.prior(law(0.25, 0.0), state).centre[0, 0, 2] > rigid + 1e-3


@pytest.mark.parametrize("step", [1, 5, 10])
def test_what_touches_nothing_flies_exactly(step):
    scene, state = boxes([[0, 0, 5.0]], [[1, 0, 2]], step)
    net = model()
    with torch.no_grad():
        after, _, active = net.step(scene, state)
        rotation, centre = net.free(scene, state)
    assert not active.any()
    torch.testing.assert_close(after.centre, centre, atol=1e-12, rtol=0)
    torch.testing.assert_close(after.rotation, rotation, atol=1e-9, rtol=0)
    assert torch.equal(after.previous_centre, state.centre)


@pytest.mark.parametrize("step", [1, 10])
def test_what_lies_still_stays_to_the_bit(step):
    """Observed at rest: two equal frames, which free flight would not have."""
    scene, state = boxes([[0, 0, 0.2], [0, 0, 0.6008]], [[0, 0, 0], [0, 0, 0]], step)
    state.previous_centre = state.centre.clone()
    net = model()
    # The head would push everything about if it were heard.
    torch.nn.init.constant_(net.anchors.head.get_parameter("1.bias"), 0.3)
    still = roll(net, scene, state, 12)
    later = roll(net, scene, still, 40)
    assert torch.equal(later.centre, still.centre) and torch.equal(later.rotation, still.rotation)
    assert (still.centre - state.centre).abs().max() < 1e-3


def test_the_state_has_the_velocity_at_the_end_of_the_step():
    """A box that slides at the end of a step does so at the start of the next one: friction takes mu g dt a step."""
    scene, state = boxes([[0, 0, 0.2]], [[2, 0, 0]])
    net, dt = model(), 10 / 240
    state = roll(net, scene, state, 3)
    speed = ((state.centre - state.previous_centre)[0, 0, 0] / dt).item()
    mu = 0.5 * 0.3  # of the box times of the ground
    assert abs(speed - (2 - mu * GRAVITY * 3 * dt)) < 0.05


def test_gradients_pass_through_flight_and_contact():
    scene, state = boxes([[0, 0, 0.21], [3, 0, 0.8]], [[0.5, 0, -1], [0, 0, 1]], 5)
    net = model(gate=False)
    torch.nn.init.normal_(net.anchors.head.get_parameter("1.weight"), std=0.01)
    for _ in range(3):
        prior = net.prior(scene, state)
        state, _, _ = net.advance(scene, state, net.network(scene, state, prior=prior), prior=prior)
    (state.centre.square().sum() + state.previous_centre.sum()).backward()
    found = net.anchors.head.get_parameter("1.weight").grad
    assert torch.isfinite(found).all() and (found.abs().sum(-1) > 0).all()
