"""Roles, bodies, planes, gravity and time as data of the scene. No assets needed."""

import dataclasses

import pytest
import torch

from rigidformer_lab import golden
from rigidformer_lab.config import PRESETS
from rigidformer_lab.geometry import _nearest_torch, nearest_points
from rigidformer_lab.ground import ABYSS_M, NOTHING, PLANE, groups, planes_of
from rigidformer_lab.model import RigidFormer, transform
from rigidformer_lab.roles import DRIVEN, FIXED, FREE

MODEL = RigidFormer(PRESETS["tiny-roles"]).initialise().double()


@pytest.fixture(scope="module")
def roles():
    """Scene and state of the golden vectors, with targets for driven units."""
    scene, state, _, _, (rotation, centre) = golden.roles_scene()
    return scene, dataclasses.replace(state, target_rotation=rotation[:1], target_centre=centre[:1])


def search(scene, state, planes, body):
    query = transform(state.rotation, state.centre, scene.points)
    group = groups(body, scene.mask)
    bank = (scene.start, scene.count, scene.bank, scene.scale)
    found = nearest_points(
        query, scene.points_in_use, state.rotation, state.centre, scene.radius, *bank, planes, group
    )
    plain = _nearest_torch(query, state.rotation, state.centre, *bank, group, *planes.nearest(query))
    inside = torch.arange(query.shape[2]) < scene.points_in_use[..., None]
    assert torch.equal(found[0][inside], plain[0][inside])
    return found[0], inside


def test_units_of_a_body_are_not_near_each_other(roles):
    scene, state = roles
    unit, inside = search(scene, state, scene.planes, scene.body)
    for m in range(unit.shape[1]):
        near = unit[0, m][inside[0, m]]
        near = near[near >= 0]
        body = scene.body[0, m]
        assert (near != m).all() and (body < 0 or (scene.body[0, near] != body).all())
    together = torch.zeros_like(scene.body)
    none = planes_of(torch.zeros(1, 0, 6, dtype=torch.float64))
    assert (search(scene, state, none, together)[0] == NOTHING).all()


def test_without_anything_near_the_abyss_is_below(roles):
    scene, state = roles
    scene = dataclasses.replace(
        scene, planes=planes_of(torch.zeros(1, 0, 6, dtype=torch.float64)), body=torch.zeros_like(scene.body)
    )
    raw = MODEL.features(scene, state)
    assert (raw[..., :3] == torch.tensor([0, 0, -ABYSS_M])).all()
    assert (raw[..., 22:24] == 0).all()  # frictions and restitutions
    assert torch.equal(raw[..., 21], (scene.role == FREE)[..., None].expand(raw.shape[:3]).double())
    assert not MODEL.active(scene, state).any()


def test_the_nearest_plane_is_one_of_lowest_number(roles):
    points = torch.tensor([[[0.0, 0.0, 0.5], [0.0, 0.0, 1.9], [0.0, 0.0, 1.0]]])
    planes = planes_of(torch.tensor([[[0.0, 0, 1, 0, 0, 0], [0, 0, -1, -2, 0, 0], [0, 0, 1, 0, 0, 0]]]))
    distance, which = planes.nearest(points)
    assert which.tolist() == [[PLANE, PLANE - 1, PLANE]] and torch.allclose(distance, torch.tensor([[0.5, 0.1, 1.0]]))


def test_driven_and_fixed_units_are_seen_as_they_will_move(roles):
    scene, state = roles
    raw = MODEL.features(scene, state)
    dt = MODEL.dt(scene)[0]
    inside = torch.arange(raw.shape[2]) < scene.points_in_use[0, :, None]
    local = scene.points
    way = transform(state.target_rotation, state.target_centre, local) - transform(state.rotation, state.centre, local)
    for unit in torch.nonzero(scene.role[0] == DRIVEN)[:, 0]:
        assert torch.allclose(raw[0, unit, :, 3:6], way[0, unit] / dt, atol=1e-9)
    fixed = scene.role[0] == FIXED
    assert not raw[0, fixed][..., 3:6].any() and not raw[0, scene.role[0] != FREE][..., 21].any()
    assert inside.any()


def test_only_free_units_have_impacts_and_the_others_are_infinitely_heavy(roles):
    scene, state = roles
    rows, valid, pushes = MODEL.impacts(scene, state)
    free = scene.role[0] == FREE
    assert valid[0, free].any() and not valid[0, ~free].any() and not pushes[0, ~free].any()
    # The falling ball meets the fixed box and the driven disc alone: neither takes a share of the impulse.
    assert valid[0, 6].sum() == 2 and not rows[0, 6, :2, 21].any()


def test_a_plane_of_any_direction_is_the_ground_turned(roles):
    scene, state = roles
    angle = torch.tensor(0.7, dtype=torch.float64)
    c, s = angle.cos(), angle.sin()
    turn = torch.tensor([[c, 0, s], [0, 1, 0], [-s, 0, c]], dtype=torch.float64)
    shift = torch.tensor([0.3, -1.0, 2.0], dtype=torch.float64)

    def pose(rotation, centre):
        return turn @ rotation, centre @ turn.T + shift

    normal = scene.planes.normal @ turn.T
    moved = dataclasses.replace(
        scene, reference=pose(*scene.reference), gravity=scene.gravity @ turn.T,
        planes=dataclasses.replace(scene.planes, normal=normal, offset=scene.planes.offset + normal @ shift),
    )  # fmt: skip
    previous, current = pose(state.previous_rotation, state.previous_centre), pose(state.rotation, state.centre)
    other = type(state)(*previous, *current, *pose(state.target_rotation, state.target_centre))
    rows, valid, _ = MODEL.impacts(scene, state)
    moved_rows, moved_valid, _ = MODEL.impacts(moved, other)
    assert torch.equal(valid, moved_valid)
    # Scalars stay, vectors turn.
    assert torch.allclose(rows[valid][:, 15:25], moved_rows[valid][:, 15:25], atol=1e-7)
    assert torch.allclose(rows[valid][:, :3] @ turn.T, moved_rows[valid][:, :3], atol=1e-7)
    assert torch.equal(MODEL.active(scene, state), MODEL.active(moved, other))
    out = torch.zeros(*scene.mask.shape, 4, 3, dtype=torch.float64)
    after, again = MODEL.advance(scene, state, out)[0], MODEL.advance(moved, other, out)[0]
    assert torch.allclose(after.centre @ turn.T + shift, again.centre, atol=1e-9)


def test_a_driven_unit_without_a_target_stays(roles):
    scene, state = roles
    after = MODEL.step(scene, state)[0]
    driven = scene.role == DRIVEN
    assert torch.equal(after.centre[driven], state.target_centre[driven]) and after.target_centre is None
    again = MODEL.step(scene, after)[0]
    assert torch.equal(again.centre[driven], after.centre[driven])
    assert torch.equal(again.rotation[driven], after.rotation[driven])
    fixed = scene.role == FIXED
    assert torch.equal(again.centre[fixed], state.centre[fixed])


@pytest.mark.parametrize("plane", range(3))
def test_no_step_of_a_free_unit_ends_deeper_in_a_plane(roles, plane):
    scene, state = roles
    alone = dataclasses.replace(scene, planes=type(scene.planes)(
        **{f.name: getattr(scene.planes, f.name)[:, plane, None] for f in dataclasses.fields(scene.planes)}
    ))  # fmt: skip
    out = (alone.planes.normal[:, :, None] * -60.0).expand(*scene.mask.shape, 4, 3)
    before = MODEL.depths(alone, state.rotation, state.centre)
    after, raw, active = MODEL.advance(alone, state, out)
    depth = MODEL.depths(alone, after.rotation, after.centre)
    free = scene.role == FREE
    assert (depth[free] <= before[free] + 1e-6).all()  # normals are of unit length to f32
    # Sent 1.6 m towards the plane, those that may touch something were stopped by it.
    sunk = raw.mean(2) @ alone.planes.normal[0, 0] - alone.planes.offset[0]
    assert (active & (sunk < -0.5)).any()


def test_a_step_of_another_frame_rate_has_a_code_of_its_own(roles):
    scene, _ = roles
    slow = dataclasses.replace(scene, step=torch.tensor([5]), frame_rate=torch.tensor([100.0]))
    assert MODEL.dt(slow).item() == pytest.approx(0.05) and MODEL.code(slow).item() == pytest.approx(12.0)
    assert MODEL.code(scene).item() == pytest.approx(6.5)
