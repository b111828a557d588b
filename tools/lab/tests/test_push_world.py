"""The world of the example `push`."""

import io
import json

import numpy as np
import pytest

from rigidformer_lab import bullet, push_world
from rigidformer_lab.push_world import FRAME_S, GOAL_M, GOAL_TURN_RAD, HEIGHT_M, RADIUS_M, World


@pytest.fixture
def engine():
    with bullet.world() as (pb, on):
        yield pb, on


def ask(*requests):
    out = io.StringIO()
    push_world.serve([request if isinstance(request, str) else json.dumps(request) for request in requests], out)
    return [json.loads(line) for line in out.getvalue().splitlines()]


def yaw(pose):
    w, x, y, z = pose[3:]
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def towards(world, metres, speed=0.2):
    """A path from the ball over the origin."""
    way = -world.place / np.linalg.norm(world.place)
    return world.place + way * np.linspace(0, metres, round(metres / speed / FRAME_S) + 1)[1:, None]


def test_a_seed_gives_one_trial():
    first, other, again = ask({"do": "reset", "seed": 3}, {"do": "reset", "seed": 4}, {"do": "reset", "seed": 3})
    assert first == again and first["goal"] != other["goal"]
    assert len(first["cube"]["points"]) == 8 and len(first["pusher"]["points"]) == 128
    np.testing.assert_allclose(np.linalg.norm(first["pusher"]["points"], axis=1), RADIUS_M)


def test_goals_lie_as_far_and_are_turned_as_told(engine):
    for seed in range(1, 21):
        world = World(*engine, seed)
        cube = world.poses()["cube"]
        assert GOAL_M[0] <= np.hypot(*world.goal[:2]) <= GOAL_M[1]
        turned = (world.goal[2] - yaw(cube) + np.pi) % (2 * np.pi) - np.pi
        assert abs(turned) <= GOAL_TURN_RAD + 1e-3 and abs(world.goal[2]) <= np.pi
        # Both are at rest.
        np.testing.assert_allclose(world.previous["cube"], cube, atol=1e-5)
        np.testing.assert_allclose(cube[:3], (0, 0, 0.025), atol=1e-4)


def test_the_ball_moves_as_told_and_pushes(engine):
    world = World(*engine, 5)
    path, begin = towards(world, 0.15), np.array(world.poses()["cube"])
    for place in path:
        world.act([place])
        np.testing.assert_allclose(world.poses()["pusher"][:3], (*place, HEIGHT_M), atol=1e-6)
        assert np.linalg.norm(np.array(world.poses()["cube"][:2]) - place) > RADIUS_M + 0.024
    moved = np.array(world.poses()["cube"]) - begin
    assert np.linalg.norm(moved[:2]) > 0.04 and abs(moved[2]) < 1e-3


def test_a_rollout_foretells_and_leaves_no_trace():
    told = ask({"do": "reset", "seed": 6})[0]
    place = np.array(told["current"]["pusher"][:2])
    path = (place * np.linspace(1, -0.2, 45)[1:, None]).tolist()
    tried = [{"from": place.tolist(), "path": path}, {"from": [0.2, 0.2], "path": [[0.2, 0.19]]}]
    # In the midst of a push.
    _, moved, found, again, end = ask({"do": "reset", "seed": 6}, {"do": "act", "path": path[:20]},
                                      {"do": "rollout", "paths": [{"from": path[19], "path": path[20:]}, tried[1]]},
                                      {"do": "rollout", "paths": [{"from": path[19], "path": path[20:]}]},
                                      {"do": "act", "path": path[20:]})
    assert found["poses"][0] == again["poses"][0] and len(found["poses"][1]) == 1
    without = ask({"do": "reset", "seed": 6}, {"do": "act", "path": path[:20]}, {"do": "act", "path": path[20:]})
    assert without[1] == moved and without[2] == end
    np.testing.assert_allclose(found["poses"][0][-1], end["current"]["cube"], atol=1e-3)
    assert np.linalg.norm(np.subtract(end["current"]["cube"][:2], told["current"]["cube"][:2])) > 0.01


@pytest.mark.parametrize("request_, text", [
    ("{", "not JSON"),
    ("[1]", "JSON object"),
    ({"do": "fly"}, "reset, act, rollout or close"),
    ({"do": "reset", "seed": -1}, "seed"),
    ({"do": "reset", "seed": True}, "seed"),
    ({"do": "act", "path": []}, "a path is"),
    ({"do": "act", "path": [[1, 2, 3]]}, "a path is"),
    ({"do": "act", "path": [["a", "b"]]}, "a path is"),
    ('{"do": "act", "path": [[NaN, 0]]}', "a path is"),
    ({"do": "act", "path": [[100, 0]]}, "beyond 10 m"),
    ({"do": "act", "path": [[5, 5]]}, "at most 2 m/s"),
    ({"do": "rollout", "paths": 3}, "list of paths"),
    ({"do": "rollout", "paths": [[[0, 0]]]}, "`paths` are objects"),
    ({"do": "rollout", "paths": [{"from": [0, 0], "path": [[1, 0]]}]}, "at most 2 m/s"),
])
def test_what_cannot_be_done_is_said_and_changes_nothing(request_, text):
    act = {"do": "act", "path": [list(ask({"do": "reset", "seed": 1})[0]["current"]["pusher"][:2])]}
    _, error, then = ask({"do": "reset", "seed": 1}, request_, act)
    assert list(error) == ["error"] and text in error["error"]
    assert then == ask({"do": "reset", "seed": 1}, act)[1]


def test_before_the_first_trial_and_after_the_end():
    assert "before the first" in ask({"do": "act", "path": [[0, 0]]})[0]["error"]
    assert ask({"do": "close"}, {"do": "reset", "seed": 1}) == []
