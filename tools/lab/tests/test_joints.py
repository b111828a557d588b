"""Pivots from poses, and units that are held together."""

import dataclasses

import numpy as np
import pytest
import torch

from rigidformer_lab import golden
from rigidformer_lab.config import PRESETS
from rigidformer_lab.geometry import quaternion_to_matrix
from rigidformer_lab.joints import Joints, Pivot, find_pivots, hold_together, joints_of, turn_together
from rigidformer_lab.model import RigidFormer
from rigidformer_lab.roles import FREE


def turns(rng, *shape):
    q = rng.normal(size=(*shape, 4))
    return quaternion_to_matrix(q / np.linalg.norm(q, axis=-1, keepdims=True))


def chain(rng, frames, axis=None):
    """Three bars, each of which turns about the end of the one before."""
    bar = np.stack(np.meshgrid([-0.2, 0.2], [-0.03, 0.03], [-0.03, 0.03]), -1).reshape(-1, 3)
    rotation, place = np.zeros((3, frames, 3, 3)), np.zeros((3, frames, 3))
    for part in range(3):
        if axis is None:
            rotation[part] = turns(rng, frames)
        else:
            angle = rng.uniform(-1, 1, frames)
            q = np.column_stack((np.cos(angle / 2), np.sin(angle / 2)[:, None] * np.asarray(axis)))
            rotation[part] = quaternion_to_matrix(q)
        end = place[part - 1] + rotation[part - 1] @ [0.2, 0, 0] if part else rng.normal(size=(frames, 3))
        place[part] = end - rotation[part] @ [-0.2, 0, 0]
    return rotation, place, [bar] * 3


@pytest.mark.parametrize("axis", [None, (0, 1, 0)])
def test_pivots_of_a_chain_are_its_ends(axis):
    rotation, place, points = chain(np.random.default_rng(0), 12, axis)
    found = find_pivots(rotation, place, points, [4, 4, 4])
    assert [(pivot.unit, pivot.parent) for pivot in found] == [(1, 0), (2, 1)]
    for pivot in found:
        assert np.abs(pivot.pivot - [-0.2, 0, 0]).max() < 1e-3 if axis is None else pivot.residual_m < 1e-6
        assert np.abs(pivot.parent_pivot - [0.2, 0, 0]).max() < (1e-3 if axis is None else 0.05)
    assert find_pivots(rotation, place, points, [4, -1, -1]) == []
    with pytest.raises(ValueError, match="2 or more"):
        find_pivots(rotation[:, :1], place[:, :1], points, [4, 4, 4])


def test_parts_that_slide_are_not_joined():
    rotation, place, points = chain(np.random.default_rng(1), 12)
    place[2] += np.linspace(0, 0.3, 12)[:, None]
    assert [(pivot.unit, pivot.parent) for pivot in find_pivots(rotation, place, points, [0, 0, 0])] == [(1, 0)]


def scene_of(seed, units=7, parent=(-1, 0, 1, 1, 5, -1, -1)):
    rng = np.random.default_rng(seed)
    put = lambda a: torch.from_numpy(a)[None]  # noqa: E731
    rotation, centre, mass = put(turns(rng, units)), put(rng.normal(size=(units, 3))), put(rng.uniform(1, 3, units))
    joints = Joints(torch.tensor([parent]), put(rng.normal(size=(units, 3))), put(rng.normal(size=(units, 3))))
    return joints, rotation, centre, mass


def gaps(joints, rotation, centre):
    own = centre + (rotation @ joints.pivot[..., None])[..., 0]
    above = joints.parent.clamp(min=0)[0]
    parents = centre[:, above] + (rotation[:, above] @ joints.parent_pivot[..., None])[..., 0]
    return (own - parents).norm(dim=-1)[0]


def test_free_trees_keep_their_centre_of_mass():
    joints, rotation, centre, mass = scene_of(0)
    every = torch.ones(1, 7, dtype=torch.bool)
    held = hold_together(joints, rotation, centre, mass, every, every)
    assert gaps(joints, rotation, held)[joints.parent[0] >= 0].max() < 1e-12
    for tree in ([0, 1, 2, 3], [4, 5], [6]):
        before, after = ((mass[..., None] * c)[0, tree].sum(0) for c in (centre, held))
        assert (before - after).abs().max() < 1e-12
    assert torch.equal(held[0, 6], centre[0, 6])


def test_what_is_held_stays_and_carries_the_others():
    joints, rotation, centre, mass = scene_of(1)
    every = torch.ones(1, 7, dtype=torch.bool)
    for held in ([2], [0], [1, 3], [4]):
        free = every.clone()
        free[0, held] = False
        moved = hold_together(joints, rotation, centre, mass, free, every)
        assert torch.equal(moved[0, held], centre[0, held])
        unmet = [unit for unit in range(7) if joints.parent[0, unit] < 0 or (unit in held and int(joints.parent[0, unit]) in held)]
        met = [unit for unit in range(7) if unit not in unmet]
        assert gaps(joints, rotation, moved)[met].max() < 1e-12, held


def test_pushes_bring_pivots_together_and_turn_no_whole():
    joints, rotation, centre, mass = scene_of(2)
    # Small gaps: what is of the second order in them does not count.
    above, every = joints.parent.clamp(min=0)[0], torch.ones(1, 7, dtype=torch.bool)
    own = (rotation @ joints.pivot[..., None])[..., 0]
    at = centre[:, above] + (rotation[:, above] @ joints.parent_pivot[..., None])[..., 0]
    for unit in (1, 2, 3, 4):  # parents first, but for 4 and 5
        centre[0, unit] = (at - own)[0, unit] + 1e-4
        at = centre[:, above] + (rotation[:, above] @ joints.parent_pivot[..., None])[..., 0]
    inertia = torch.full((1, 7, 3), 0.3, dtype=torch.float64)
    turned, moved = turn_together(joints, rotation, centre, mass, inertia, every, every)
    hangs = joints.parent[0] >= 0
    assert gaps(joints, turned, moved)[hangs].max() < 0.3 * gaps(joints, rotation, centre)[hangs].max()
    assert (turned @ turned.transpose(-1, -2) - torch.eye(3)).abs().max() < 1e-12
    for tree in ([0, 1, 2, 3], [4, 5]):
        way = mass[..., None] * (moved - centre)
        assert way[0, tree].sum(0).abs().max() < 1e-12
        skew = turned @ rotation.transpose(-1, -2)
        spin = torch.stack((skew[..., 2, 1] - skew[..., 1, 2], skew[..., 0, 2] - skew[..., 2, 0], skew[..., 1, 0] - skew[..., 0, 1]), -1) / 2
        whole = torch.linalg.cross(centre, way) + mass[..., None] * 0.3 * spin
        assert whole[0, tree].sum(0).abs().max() < 1e-6 < spin[0, tree].abs().max()


def test_steps_hold_joined_units_together():
    scene, state, _, centres, (rotation, centre) = golden.roles_scene()
    model = RigidFormer(PRESETS["tiny-impulses"]).initialise().double()
    state = dataclasses.replace(state, target_rotation=rotation[:1], target_centre=centre[:1])
    free = [unit for unit, role in enumerate(scene.role[0].tolist()) if role == FREE][:2]
    at = (state.centre[0, free[0]] + state.centre[0, free[1]]) / 2
    local = [(state.rotation[0, unit].T @ (at - state.centre[0, unit])).numpy() + centres[unit] for unit in free]
    joints = joints_of([Pivot(free[0], free[1], *local, 0.0)], centres)
    with torch.no_grad():
        alone, _, _ = model.step(scene, state)
        joined, _, _ = model.step(dataclasses.replace(scene, joints=joints), state)
    assert gaps(joints, joined.rotation, joined.centre)[free[0]] < 1e-12
    assert gaps(joints, alone.rotation, alone.centre)[free[0]] > 1e-4
    others = [unit for unit in range(len(centres)) if unit not in free]
    assert torch.equal(alone.centre[0, others], joined.centre[0, others])
    assert torch.equal(alone.rotation[0, others], joined.rotation[0, others])
