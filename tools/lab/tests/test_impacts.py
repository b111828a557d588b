"""First impacts under free motion, and what a single one does. No assets needed."""

import dataclasses

import numpy as np
import pytest
import torch

from rigidformer_lab import geometry
from rigidformer_lab.config import PRESETS
from rigidformer_lab.impacts import GROUND, extreme_points, find_impacts
from rigidformer_lab.model import RigidFormer, Scene, State

CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)], np.float32)


def scene_of(centres, travels, shapes, restitution=0.5, friction=0.0):
    """Units that do not turn, at step 10."""
    m = len(shapes)
    locals_ = [geometry.prepare_points(shape)[0] for shape in shapes]
    count = torch.tensor([[len(p) for p in locals_]])
    start = torch.cumsum(count, 1) - count
    hulls = [p[extreme_points(p)] for p in locals_]
    hull_count = torch.tensor([[len(p) for p in hulls]])
    put = lambda a: torch.as_tensor(np.asarray(a), dtype=torch.float64)[None]  # noqa: E731
    eye = torch.eye(3, dtype=torch.float64).expand(1, m, 3, 3)
    now = put(centres)
    scene = Scene(
        points=put([p[:4] for p in locals_]), points_in_use=torch.full((1, m), 4), mask=torch.ones(1, m, dtype=torch.bool),
        physics=put([[2.0, friction, restitution]] * m), radius=put([np.linalg.norm(p, axis=1).max() for p in locals_]),
        reference=(eye, now), start=start, count=count, scale=put(np.ones(m)), bank=put(np.concatenate(locals_))[0],
        step=torch.tensor([10]), hull_start=torch.cumsum(hull_count, 1) - hull_count, hull_count=hull_count,
        hull_bank=put(np.concatenate(hulls))[0], extent=put([np.ptp(p, axis=0) for p in locals_]),
    )  # fmt: skip
    return scene, State(eye, now - put(travels), eye, now)


def impacts_of(scene, state):
    fall = torch.tensor([[0.0, 0.0, -10.0 * (10 / 240) ** 2]])
    return find_impacts(
        state, scene.mask, scene.radius, scene.hull_start, scene.hull_count, scene.scale, scene.hull_bank, fall, 4
    )


def test_no_step_ends_deeper_below_the_ground():
    model = RigidFormer(PRESETS["tiny-impact"]).double()
    out = torch.zeros(1, 3, 4, 3, dtype=torch.float64)
    # One comes down fast, one was seen 2 cm below, one is far above.
    scene, state = scene_of([[0, 0, 0.6], [3, 0, 0.48], [6, 0, 3]], [[0, 0, -0.4], [0, 0, -0.01], [0, 0, -0.4]], [CUBE] * 3)
    fall = 10 * (10 / 240) ** 2
    after, _, _ = model.advance(scene, state, out)
    assert after.centre[0, :, 2].tolist() == pytest.approx([0.5, 0.48, 3 - 0.4 - fall], abs=1e-9)
    assert torch.equal(after.previous_centre, state.centre)
    assert model.depths(scene, after.rotation, after.centre)[0].tolist() == pytest.approx([0, 0.02, 0], abs=1e-9)


def test_a_corner_meets_the_middle_of_a_face():
    # The cube that comes stands on its corner: no vertex of the other is near.
    axis = np.array([1, 1, 1]) / 3**0.5
    z = np.array([0, 0, 1.0])
    v, c = np.cross(axis, z), axis @ z
    k = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    turned = CUBE @ (np.eye(3) + k + k @ k / (1 + c)).T
    scene, state = scene_of(
        [[0, 0, 5], [0, 0, 5 + 0.5 + 0.75**0.5 + 0.1]], [[0, 0, 0], [0, 0, -0.2]], [CUBE, turned]
    )
    other, xi, xj, normal, fraction, gap = impacts_of(scene, state)
    assert other[0].tolist() == [[1, -1, -1, -1], [0, -1, -1, -1]]
    assert torch.allclose(normal[0, 0, 0], torch.tensor([0, 0, 1.0], dtype=torch.float64), atol=1e-3)
    assert fraction[0, 0, 0] == pytest.approx(0.5, abs=0.01) and -1e-6 < gap[0, 0, 0] < 1e-3
    assert xi[0, 0, 0].tolist() == pytest.approx([0, 0, 0.5], abs=1e-2)


def test_what_overlaps_now_is_seen_along_the_normal_of_before():
    scene, state = scene_of([[0, 0, 5], [0.2, 0, 5.9]], [[0, 0, 0], [0, 0, -0.3]], [CUBE, CUBE])
    other, _, _, normal, fraction, gap = impacts_of(scene, state)
    assert other[0, 0, 0] == 1 and fraction[0, 0, 0] == 0
    assert gap[0, 0, 0] == pytest.approx(-0.1, abs=1e-3) and normal[0, 0, 0, 2] > 0.999


def test_the_ground_is_met_when_the_lowest_point_reaches_it():
    scene, state = scene_of([[0, 0, 0.6]], [[0.1, 0, -0.1826388889]], [CUBE])
    other, xi, _, normal, fraction, gap = impacts_of(scene, state)
    assert other[0, 0, 0] == GROUND and normal[0, 0, 0].tolist() == [0, 0, -1]
    assert fraction[0, 0, 0] == pytest.approx(0.5, abs=0.01) and gap[0, 0, 0] < 1e-3
    assert xi[0, 0, 0, 2] == -0.5


def test_equal_masses_exchange_what_the_bounce_leaves():
    directions = geometry._octahedron(8)[0]
    ball = directions / np.linalg.norm(directions, axis=1, keepdims=True) / 2
    scene, state = scene_of([[0, 0, 5], [0, 0, 6.05]], [[0, 0, 0.1], [0, 0, 0]], [ball, ball], restitution=0.5)
    model = RigidFormer(PRESETS["tiny-impact"]).double()
    rows, valid, pushes = model.impacts(scene, state)
    assert valid[0].sum() == 2
    speed = 0.1 / (10 / 240)
    # e = 0.5 x 0.5: of the approach v each takes (1 + e) v / 2, less what half a millimetre of gap takes off.
    assert pushes[0, 0, :, 5].mean() == pytest.approx(-0.625 * speed, rel=0.03)
    assert pushes[0, 1, :, 5].mean() == pytest.approx(0.625 * speed, rel=0.03)
    assert rows.shape == (1, 2, 4, 43)


def test_units_that_cannot_meet_have_no_impacts():
    scene, state = scene_of([[0, 0, 5], [0, 0, 9]], [[0, 0, 0.1], [0, 0, 0]], [CUBE, CUBE])
    model = RigidFormer(PRESETS["tiny-impact"]).double()
    rows, valid, pushes = model.impacts(scene, state)
    assert not valid.any() and not pushes.any()
    pools = model.encoder.impact_pools(rows, valid)
    assert not any(p.any() for p in pools)


def test_the_hull_s_centroid_does_not_follow_dense_points():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 1.5]], np.float32)
    edge = np.array([[i / 40, 0, 0] for i in range(1, 40)], np.float32)
    points = np.concatenate((corners, edge))
    assert geometry.hull_centre(points) == pytest.approx([0.25, 0.5, 0.375], abs=1e-5)
    assert geometry.hull_centre(np.concatenate((CUBE, [[0, 0, 0]]))) is None
    assert geometry.hull_centre(CUBE[:4]) is None


def test_the_configuration_keeps_its_inputs_through_json():
    config = PRESETS["nano"]
    assert config.has_impacts and type(config).from_json(config.to_json()) == config
    assert not dataclasses.replace(config, features="contact", motion="free").has_impacts
    with pytest.raises(ValueError, match="needs the hulls"):
        dataclasses.replace(config, features="contact")
