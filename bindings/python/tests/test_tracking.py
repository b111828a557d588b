"""From depth images and clouds to units."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import rigidformer as rf

# Half a metre above a floor, looking down: x stays, y and z turn about it.
DOWN = [0, 0, 0.5, 0, 1, 0, 0]


def camera() -> rf.Camera:
    return rf.Camera(160, 120, 140, 140, 80, 60, DOWN)


def depth(left: int) -> np.ndarray:
    image = np.full((120, 160), 500, np.uint16)
    image[40:90, left : left + 50] = 300
    return image


def test_a_box_is_followed_and_predicted(nano):
    tracker = rf.Tracker(nano)
    for frame in range(12):
        estimate = tracker.observe(frame / 30, [rf.DepthView(camera(), depth(40 + frame))])
    (unit,) = estimate.units
    assert unit.sight == "seen" and unit.points.shape[1] == 3
    assert unit.covariance.shape == unit.velocity_covariance.shape == (6, 6)
    # A pixel of 0.3 m / 140 in each of 30 frames a second: .064 m/s to the right.
    assert 0.02 < unit.velocity[0] < 0.1
    assert len(tracker.planes) == 1 and tracker.shape(unit.id).shape[1] == 3
    assert tracker.shape(99) is None
    forecast = tracker.predict(0.25)
    assert forecast.poses[unit.id].shape == (6, 7) and forecast.left_out == {}
    assert rf.Tracker().predict(0.25).poses == {}
    for horizon_s in (0, -1, float("nan"), float("inf")):
        with pytest.raises(rf.InputError, match="horizon_s"):
            tracker.predict(horizon_s)


def test_a_scene_is_seen_and_its_units_are_completed():
    scene = rf.Dataset.embedded().scene(0)
    tracker = rf.Tracker(segmentation="given", gravity_m_s2=scene.gravity_m_s2, confirm=1)
    for capture in range(3):
        views = scene.views(capture / 30, cameras=2, deviation_m=0.001, capture=capture)
        estimate = tracker.observe(capture / 30, views)
    assert len(views) == 2 and 0 < len(estimate.units) <= len(scene.units)
    for unit in estimate.units:
        points = tracker.shape(unit.id)
        # Of 1000 kg/m3, and no larger than the box around its points.
        assert 0 < tracker.mass_kg(unit.id) < 1000 * np.prod(np.ptp(points, axis=0)) * 3**1.5
    assert tracker.mass_kg(99) is None
    again, others = scene.views(0.1, capture=3), scene.views(0.1, capture=4)
    same = [pickle.dumps(view) == pickle.dumps(other) for view, other in zip(again * 2, scene.views(0.1, capture=3) + others)]
    assert same == [True, False]
    for wrong in ({"cameras": 0}, {"cameras": 4}, {"deviation_m": float("nan")}, {"edge_loss": 2.0}):
        with pytest.raises(rf.InputError, match=next(iter(wrong)) if "edge_loss" not in wrong else "noise"):
            scene.views(0.0, **wrong)
    with pytest.raises(rf.InputError, match="nothing was recorded"):
        scene.views(99.0)


def test_the_network_is_left_out(nano):
    ends = []
    for network in (True, False):
        tracker = rf.Tracker(nano, network=network)
        for frame in range(12):
            tracker.observe(frame / 30, [rf.DepthView(camera(), depth(40 + frame))])
        (path,) = tracker.predict(0.25).poses.values()
        ends.append(path[-1])
    assert np.isfinite(ends).all() and (ends[0] != ends[1]).any()


def test_layouts_and_labels():
    views = []
    for image in (depth(40), np.asfortranarray(depth(40)), np.repeat(depth(40), 2, axis=1)[:, ::2]):
        labels = (image == 300).astype(np.uint16)
        tracker = rf.Tracker(segmentation="given")
        for frame in range(3):
            view = rf.DepthView(camera(), image, labels=labels)
            estimate = tracker.observe(frame / 30, [view])
        views.append(estimate.units[0].pose)
    assert (views[0] == views[1]).all() and (views[0] == views[2]).all()


def test_a_cloud():
    rng = np.random.default_rng(1)
    ball = rng.normal(size=(3000, 3))
    ball = 0.2 * ball / np.linalg.norm(ball, axis=1, keepdims=True) + [0, 0, 1]
    tracker = rf.Tracker(planes=[rf.Plane([0, 0, 1])])
    for frame in range(3):
        estimate = tracker.observe(frame / 30, [rf.Cloud(ball, sensor=[0, -3, 2])])
    assert len(estimate.units) == 1


def test_captures_that_cannot_be():
    tracker = rf.Tracker()
    view = rf.DepthView(camera(), depth(40))
    tracker.observe(0.0, [view])
    for time_s, views, error in [
        (0.0, [view], rf.InputError),
        (float("nan"), [view], rf.InputError),
        (1.0, [], rf.InputError),
        (1.0, [rf.Cloud([[np.nan, 0, 0]])], rf.InputError),
        (1.0, [depth(40)], TypeError),
    ]:
        with pytest.raises(error):
            tracker.observe(time_s, views)
    tracker.observe(0.1, [view])
    for image, error in [
        (depth(40).astype(np.float32), TypeError),
        (depth(40).astype(np.int32), TypeError),
        (depth(40).tolist(), TypeError),
        (depth(40)[:100], rf.InputError),
        (depth(40).ravel(), rf.InputError),
    ]:
        with pytest.raises(error, match="depth"):
            rf.DepthView(camera(), image)
    with pytest.raises(rf.InputError, match="scale"):
        rf.DepthView(camera(), depth(40), 0.0)
    with pytest.raises(rf.InputError, match="labels"):
        rf.Cloud(np.zeros((3, 3)), labels=np.zeros(2, np.uint16))
    with pytest.raises(rf.InputError):
        rf.Camera(0, 120, 140, 140, 80, 60)
    with pytest.raises(rf.InputError):
        rf.Tracker(model_points=1)
    with pytest.raises(rf.InputError, match="segmentation"):
        rf.Tracker(segmentation="guessed")


def test_depths_at_any_address_are_the_same_numbers():
    record = np.zeros((120, 160), dtype=[("depth", "<u2"), ("flag", "u1")])
    record["depth"] = depth(40)
    record["flag"] = 255
    buffer = b"\x07" + depth(40).tobytes()
    shifted = np.frombuffer(buffer, np.uint16, 120 * 160, offset=1).reshape(120, 160)
    expected = None
    for image in [depth(40), record["depth"], shifted]:
        tracker = rf.Tracker(confirm=1)
        unit = tracker.observe(0.0, [rf.DepthView(camera(), image)]).units[0]
        pose = np.asarray(unit.pose).tobytes()
        expected = expected or pose
        assert pose == expected


def test_the_default_completion_is_the_libraries():
    with pytest.raises(rf.InputError, match="fitted, mirrored or seen"):
        rf.Tracker(completion="round")
    rf.Tracker(completion="fitted")
