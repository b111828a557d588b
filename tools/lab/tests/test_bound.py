"""What a record says of impacts and velocities: `bound` without the runtime's package."""

import types

import numpy as np
import pytest

from rigidformer_lab.bound import Record, corrected

RATE = 240.0
GRAVITY = np.array([0.0, 0.0, -10.0])


def recorded(frames=12, bounce=5.4):
    """A unit that falls, and bounces at a time in frames, and one far away that flies on."""
    time = np.arange(frames) / RATE
    at = bounce / RATE
    poses = np.zeros((frames, 2, 7))
    poses[..., 3] = 1.0
    before, after = np.array([1.0, 0.0, -2.0]), np.array([0.9, 0.0, 1.5])
    place = before * at + 0.5 * GRAVITY * at**2
    for frame, t in enumerate(time):
        late = t - at
        poses[frame, 0, :3] = before * t + 0.5 * GRAVITY * t**2 if late <= 0 else place + after * late + 0.5 * GRAVITY * late**2
        poses[frame, 1, :3] = (9.0, 0.0, 9.0) + np.array([0.0, 1.0, 0.0]) * t + 0.5 * GRAVITY * t**2
    scene = types.SimpleNamespace(poses=poses, frame_rate_hz=RATE, gravity_m_s2=GRAVITY)
    return Record(scene, np.zeros((2, 3)), np.full(2, 0.1)), before, after, at


def test_impacts_are_in_their_interval_and_velocities_beside_them_right():
    record, before, after, at = recorded()
    assert np.flatnonzero(record.hit[:, 0]).tolist() == [5] and not record.hit[:, 1].any()
    assert not record.of_units.any()
    assert record.velocity[5, 0, :3] == pytest.approx(before + GRAVITY * 5 / RATE, abs=1e-3)
    assert record.velocity[6, 0, :3] == pytest.approx(after + GRAVITY * (6 / RATE - at), abs=1e-3)
    assert record.velocity[6, 1, :3] == pytest.approx((0.0, 1.0, -10 * 6 / RATE), abs=1e-3)


def test_an_impact_between_the_observed_frames_is_in_the_first_interval():
    record, _, after, at = recorded(bounce=0.4)
    assert np.flatnonzero(record.hit[:, 0]).tolist() == [0]
    assert record.velocity[1, 0, :3] == pytest.approx(after + GRAVITY * (1 / RATE - at), abs=1e-3)


def test_what_is_corrected():
    record, *_ = recorded()
    fresh, seen = np.zeros(2, bool), np.array([True, False])
    step = (5, 6)
    assert corrected(record, "first impact", fresh, *step).tolist() == [True, False]
    assert corrected(record, "first impact", seen, *step).tolist() == [False, False]
    assert corrected(record, "all impacts", seen, *step).tolist() == [True, False]
    assert corrected(record, "ground", seen, *step).tolist() == [True, False]
    assert corrected(record, "units", seen, *step).tolist() == [False, False]
    assert corrected(record, "flight", seen, 7, 8).tolist() == [False, True]
    assert corrected(record, "nothing", fresh, *step).tolist() == [False, False]
    assert corrected(record, "everything", fresh, *step).all()
