"""Sequential impulses against what mechanics says."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rigidformer_lab import solver_cases
from rigidformer_lab.data import BALL_BOX
from rigidformer_lab.impacts import is_ball
from rigidformer_lab.movi import primitive_shapes
from rigidformer_lab.solver import Motion, World, _separate, advance, in_one_piece, keep_apart, meetings, parts, room

GRAVITY = 9.81
DT = 10 / 240


def box(x, y, z):
    return np.array([[a, b, c] for a in (-x, x) for b in (-y, y) for c in (-z, z)])


def world(shapes, friction=0.5, restitution=0.3, planes=((0, 0, 1, 0),), free=None, mass=None, gravity=GRAVITY, group=None, lead=None):
    """Bodies whose pairs have the given coefficients."""
    units = len(shapes)
    free = np.ones(units, bool) if free is None else np.array(free)
    mass = np.ones(units) if mass is None else np.array(mass, float)
    radius = np.array([np.linalg.norm(s, axis=1).max() for s in shapes])
    ball = np.array([is_ball(s) for s in shapes])
    sides = np.where(ball[:, None], BALL_BOX * radius[:, None], [np.ptp(s, axis=0) for s in shapes])
    square = sides**2
    shapes = [np.zeros((1, 3)) if one else s for s, one in zip(shapes, ball)]
    count = np.array([len(s) for s in shapes])
    mu, e = np.sqrt(friction), np.sqrt(restitution)
    return World(
        free, np.arange(units) if group is None else np.array(group), np.where(free, 1 / mass, 0.0),
        mass[:, None] * (square.sum(1, keepdims=True) - square) / 12, np.full(units, mu), np.full(units, e),
        radius, np.cumsum(count) - count, count, np.ones(units),
        np.concatenate(shapes).astype(float), *in_one_piece(np.cumsum(count) - count, count, radius), np.where(ball, radius, 0.0), np.array([[*p, mu, e] for p in planes], float).reshape(-1, 6),
        np.array([0, 0, -gravity]), np.arange(units) if lead is None else np.array(lead),
    )  # fmt: skip


def at(centres, velocities=None, rotation=None):
    centres = np.array(centres, float)
    units = len(centres)
    rotation = np.tile(np.eye(3) if rotation is None else rotation, (units, 1, 1))
    velocities = np.zeros((units, 3)) if velocities is None else np.array(velocities, float)
    return Motion(rotation, centres, velocities, np.zeros((units, 3)))


def run(w, motion, seconds, dt=DT, count=None):
    contacts = room(len(w.free))
    for _ in range(round(seconds / dt)):
        advance(w, motion, dt, parts(dt) if count is None else count, *contacts)
    return motion


def test_a_step_of_code_ten_has_six_parts():
    assert [parts(code / 240) for code in (1, 2.5, 5, 10, 20)] == [1, 2, 3, 6, 12]


def test_flight_is_a_parabola():
    w = world([box(0.1, 0.1, 0.1)])
    motion = run(w, at([[0, 0, 10]], [[1, 2, 3]]), 1.0)
    np.testing.assert_allclose(motion.centre[0], [1, 2, 13 - GRAVITY / 2], atol=1e-12)
    np.testing.assert_allclose(motion.velocity[0], [1, 2, 3 - GRAVITY], atol=1e-12)


@pytest.mark.parametrize("dt", [1 / 240, 5 / 240, 10 / 240])
@pytest.mark.parametrize("direction", [0.0, 0.4, 2.2])
def test_a_box_slides_to_a_stop(dt, direction):
    w = world([box(0.1, 0.1, 0.05)], friction=0.3)
    speed, ahead = 1.5, np.array([np.cos(direction), np.sin(direction), 0])
    motion = run(w, at([[0, 0, 0.05]], [speed * ahead]), 1.5, dt)
    expected = speed**2 / (2 * 0.3 * GRAVITY)
    assert abs(motion.centre[0] @ ahead - expected) < 0.05 * expected
    assert np.abs(motion.velocity).max() == 0, "comes to rest for good"


@pytest.mark.parametrize("dt", [1 / 240, 10 / 240])
def test_a_ramp_holds_below_the_angle_of_friction_and_not_above(dt):
    for degrees in (24, 29):
        a = np.radians(degrees)
        n = np.array([-np.sin(a), 0, np.cos(a)])
        turned = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
        w = world([box(0.1, 0.1, 0.1)], friction=0.5, planes=((*n, 0),))
        motion = run(w, at([n * 0.1], rotation=turned), 2.0, dt)
        way = np.linalg.norm(motion.centre[0] - n * 0.1)
        if degrees == 24:
            assert way == 0, "still, to the bit"
        else:
            expected = 0.5 * GRAVITY * (np.sin(a) - 0.5 * np.cos(a)) * 4
            assert abs(way - expected) < 0.05 * expected


@pytest.mark.parametrize("aside", [0.0, 0.01])
@pytest.mark.parametrize("dt", [1 / 240, 10 / 240])
def test_five_boxes_stand_for_ten_seconds(dt, aside):
    w = world([box(0.1, 0.1, 0.1)] * 5)
    centres = [[aside * (k % 2), 0, 0.1 + 0.2 * k] for k in range(5)]
    motion = run(w, at(centres), 10.0, dt)
    np.testing.assert_array_equal(motion.centre, centres)
    np.testing.assert_array_equal(motion.rotation, np.tile(np.eye(3), (5, 1, 1)))


def test_bodies_in_the_air_keep_their_momentum_and_do_not_gain_energy():
    rng = np.random.default_rng(3)
    for _ in range(20):
        shapes = [rng.normal(size=(12, 3)) * 0.15 for _ in range(2)]
        shapes = [s - s.mean(0) for s in shapes]
        mass = rng.uniform(0.2, 5, 2)
        w = world(shapes, planes=(), mass=mass, gravity=0.0, restitution=0.8)
        motion = at([[-1, 0, 0], [1, 0, 0]], [[2, 0, 0], [-2, 0.1, 0]])
        energy = lambda m: 0.5 * (mass * (m.velocity**2).sum(1)).sum() + 0.5 * sum(  # noqa: E731
            s @ r @ np.diag(i) @ r.T @ s for s, r, i in zip(m.spin, m.rotation, w.inertia)
        )
        before, momentum = energy(motion), mass @ motion.velocity
        run(w, motion, 1.5)
        np.testing.assert_allclose(mass @ motion.velocity, momentum, atol=1e-9)
        assert energy(motion) <= before * 1.001


def test_a_box_that_lands_flat_bounces_as_high_as_it_should():
    w = world([box(0.1, 0.1, 0.1)], restitution=0.64)
    motion = at([[0, 0, 1.1]])
    contacts, heights = room(1), []
    for _ in range(230):
        advance(w, motion, 1 / 240, 1, *contacts)
        heights.append(motion.centre[0, 2])
    assert abs(max(heights[150:]) - 0.1 - 0.64**2 * 1.0) < 0.02
    assert np.abs(motion.rotation[0] - np.eye(3)).max() < 1e-9


def test_a_driven_unit_pushes_and_a_fixed_one_stays():
    w = world([box(0.1, 0.1, 0.1)] * 3, free=[False, True, False])
    motion = at([[0, 0, 0.1], [0.25, 0, 0.1], [2, 0, 0.1]], [[0.5, 0, 0], [0, 0, 0], [0, 0, 0]])
    run(w, motion, 2.0)
    np.testing.assert_allclose(motion.centre[0], [1.0, 0, 0.1], atol=1e-12)
    np.testing.assert_array_equal(motion.centre[2], [2, 0, 0.1])
    assert 1.199 < motion.centre[1, 0] < 1.25 and abs(motion.centre[1, 2] - 0.1) < 2e-3


def test_parts_of_one_body_do_not_collide():
    w = world([box(0.1, 0.1, 0.1)] * 2, planes=(), gravity=0.0, group=[4, 4])
    motion = run(w, at([[0, 0, 0], [0.15, 0, 0]], [[0.1, 0, 0], [-0.1, 0, 0]]), 0.5)
    np.testing.assert_allclose(motion.centre[:, 0], [0.05, 0.1], atol=1e-12)


def test_four_times_as_large_takes_twice_as_long():
    shapes = [box(0.1, 0.07, 0.05), box(0.06, 0.06, 0.12), box(0.1, 0.1, 0.1)]
    centres, velocities = np.array([[0, 0, 0.4], [0.3, 0.02, 0.3], [0, 0.4, 0.2]]), np.array([[1, 0, 0], [-1, 0, 0], [0, -1, 0.0]])
    small = run(world(shapes), at(centres, velocities), 1.0, 5 / 240, 2)
    large = run(world([4 * s for s in shapes]), at(4 * centres, 2 * velocities), 2.0, 10 / 240, 2)
    np.testing.assert_allclose(large.centre, 4 * small.centre, rtol=0, atol=1e-4)


def test_the_same_scene_has_the_same_bits():
    shapes = [box(0.1, 0.07, 0.05), box(0.06, 0.06, 0.12)]
    runs = [run(world(shapes), at([[0, 0, 0.3], [0.02, 0.02, 0.5]]), 1.0).centre for _ in range(2)]
    np.testing.assert_array_equal(*runs)


def test_shares_are_what_contact_changed():
    w = world([box(0.1, 0.1, 0.1)] * 5, free=[True, True, True, False, True])
    motion = at([[0, 0, 0.1], [1, 0, 3], [2, 0, 0.1], [3, 0, 0.1], [4, 0, 0.1]], [[0, 0, 0]] * 2 + [[1, 0, 0], [0, 0, 0], [0, 0, -3]])
    _, _, touched, share = advance(w, motion, DT, parts(DT), *room(5))
    assert touched.tolist() == [True, False, True, False, True]
    assert share[:4].tolist() == [-1, 0, 0, 0]  # rests, flies, slides by weight and friction alone, stays
    np.testing.assert_allclose(share[4], motion.velocity[4, 2] + 3 + GRAVITY * DT)  # hits the ground


def test_what_lies_still_in_two_frames_does_not_bounce():
    w = world([box(0.1, 0.1, 0.1)], restitution=0.9)
    motion = at([[0, 0, 0.1]], [[0, 0, -GRAVITY * DT / 2]])
    advance(w, motion, DT, parts(DT), *room(1))
    assert abs(motion.velocity[0, 2]) < 1e-6


def kept_apart(w, motion, dt=DT):
    """Ways of the centres after a step that a network has put at the places of `motion`."""
    contacts, places = room(len(w.free)), motion.centre.copy()
    _, count, _, _ = advance(w, motion, dt, parts(dt), *contacts)
    return places, meetings(contacts[0], count)


def test_what_a_network_moves_into_each_other_is_moved_apart_the_lighter_unit_farther():
    w = world([box(0.1, 0.1, 0.1)] * 3, planes=(), gravity=0.0, mass=np.array([3.0, 1.0, 1.0]))
    places, met = kept_apart(w, at([[0, 0, 1], [0.201, 0.05, 1], [2, 0, 1]]))
    places[1, 0] -= 0.021
    motion = at(places)
    keep_apart(w, motion, *met)
    np.testing.assert_allclose(motion.centre - places, [[-0.005, 0, 0], [0.015, 0, 0], [0, 0, 0]], atol=1e-4)


def test_a_pressed_pile_stands_on_the_ground_again():
    w = world([box(0.1, 0.1, 0.1)] * 3)
    places, met = kept_apart(w, at([[0, 0, 0.1 + 0.2 * k] for k in range(3)]))
    places[1:, 2] -= [0.03, 0.04]
    motion = at(places)
    keep_apart(w, motion, *met)
    np.testing.assert_allclose(motion.centre[:, 2], [0.1, 0.3, 0.5], atol=2e-4)
    again = motion.centre.copy()
    keep_apart(w, motion, *met)
    np.testing.assert_array_equal(motion.centre, again)


def test_faces_of_many_corners_stop_where_they_meet():
    """A cylinder's end has more corners than a face is walked around; slightly tilted, it meets a box with any of them."""
    angle = np.arange(24) * (np.pi / 12)
    rim = np.stack([np.cos(angle), np.sin(angle)], 1) * 0.1
    cylinder = np.concatenate([np.column_stack([rim, np.full(24, z)]) for z in (-0.05, 0.05)])
    w = world([box(0.2, 0.2, 0.05), cylinder], planes=(), gravity=0.0, restitution=0.0, free=[False, True])
    p, q, n = (np.zeros(3) for _ in range(3))
    for turn in np.radians(range(0, 360, 30)):
        motion = at([[0, 0, 0], [0, 0, 0.104]], [[0, 0, 0], [0, 0, -0.5]])
        motion.rotation[1] = Rotation.from_rotvec([0.02 * np.cos(turn), 0.02 * np.sin(turn), 0]).as_matrix()
        for _ in range(8):
            run(w, motion, 1 / 240, 1 / 240)
            assert _separate(w, motion, 0, 0, 1, 0, np.zeros(3), n, p, q) > -1e-4, turn


def test_the_cores_test_has_steps_of_this_solver():
    path = Path(__file__).parents[3] / "core/src/contact/solver/cases.txt"
    ours, theirs = (np.array([line.split() for line in lines], float) for lines in (solver_cases.lines(), path.open()))
    np.testing.assert_allclose(ours, theirs, atol=1e-5)


def ball(radius, count=160):
    return radius / 0.5 * primitive_shapes(count)[-1].points.astype(float)


def test_a_ball_of_many_points_rolls_on():
    """On level ground without end, and down a slope at 5/7 g sin a, where 64 points are a polyhedron that stops."""
    w = world([ball(0.1)])
    motion = at([[0, 0, 0.1]], [[1.0, 0, 0]])
    motion.spin[0] = [0, 10.0, 0]
    run(w, motion, 3.0)
    assert motion.centre[0, 0] == pytest.approx(3.0, rel=1e-3) and motion.centre[0, 2] == pytest.approx(0.1, abs=1e-6)
    slope = np.radians(12)
    w = world([ball(0.1)], planes=[(np.sin(slope), 0, np.cos(slope), 0.1)])
    motion = run(w, at([[0.2 * np.sin(slope), 0, 0.2 * np.cos(slope)]]), 2.0)
    down = motion.centre[0] @ [np.cos(slope), 0, -np.sin(slope)]
    assert down == pytest.approx(0.5 * 5 / 7 * GRAVITY * np.sin(slope) * 4, rel=0.05)
    w = world([ball(0.1, 64)])
    motion = at([[0, 0, 0.1]], [[0.3, 0, 0]])
    motion.spin[0] = [0, 3.0, 0]
    run(w, motion, 5.0)
    assert np.abs(motion.velocity).max() < 1e-3


def test_a_sliding_ball_comes_to_roll_at_five_sevenths():
    w = world([ball(0.1)], friction=0.3)
    motion = run(w, at([[0, 0, 0.1]], [[1.0, 0, 0]]), 1.0)
    assert motion.velocity[0, 0] == pytest.approx(5 / 7, rel=0.02)
    assert motion.spin[0, 1] * 0.1 == pytest.approx(motion.velocity[0, 0], rel=1e-3)


def test_a_ball_hits_a_ball_and_a_box_along_the_line_of_centres():
    w = world([ball(0.1), ball(0.1)], friction=0.0, restitution=1.0, planes=(), gravity=0.0)
    motion = run(w, at([[0, 0, 0], [0.5, 0, 0]], [[1.0, 0, 0], [0, 0, 0]]), 1.0, dt=1 / 240)
    np.testing.assert_allclose(motion.velocity, [[0, 0, 0], [1, 0, 0]], atol=1e-6)
    w = world([ball(0.1), box(0.2, 0.2, 0.2)], friction=0.0, planes=(), free=[True, False])
    motion = run(w, at([[0.02, 0.03, 0.4], [0, 0, 0]]), 2.0)
    np.testing.assert_allclose(motion.centre[0], [0.02, 0.03, 0.3], atol=1e-3)


@pytest.mark.parametrize("restitution, offset, expected", [(0.3, 0.05, 0.35), (0.98, 0.05, 1.0), (1.2, 0.05, 1.2)])
def test_a_contact_law_adds_to_the_restitution(restitution, offset, expected):
    w = world([ball(0.1)], restitution=restitution, gravity=1e-3)._replace(law=np.array([offset, 0.0]))
    motion = at([[0, 0, 0.11]], [[0, 0, -1.0]])
    run(w, motion, 0.1)
    assert motion.velocity[0, 2] == pytest.approx(expected, abs=2e-3)
