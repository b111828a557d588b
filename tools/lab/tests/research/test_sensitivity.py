"""Two runs that differ by a nudge."""

import dataclasses

import numpy as np
import pytest

from rigidformer_lab import humanoid
from rigidformer_lab.research import sensitivity
from rigidformer_lab.robots import WARM_UP_FRAMES, Nudge


def test_a_nudge_comes_at_its_frame_and_from_its_seed_alone():
    nudge = Nudge(40, 0.5, 3)
    assert not nudge.angles(39, 5).any() and not nudge.angles(41, 5).any()
    np.testing.assert_array_equal(nudge.angles(40, 5), Nudge(40, 0.5, 3).angles(40, 5))
    assert (nudge.angles(40, 5) != Nudge(40, 0.5, 4).angles(40, 5)).all()


def test_runs_are_one_without_a_nudge_and_part_with_it():
    robot = humanoid.load(None)
    assert not sensitivity.errors(robot, 2, 0.0)[:, 0].any()
    found = sensitivity.errors(robot, 2, 0.001)
    assert (found > 0).all() and found[-1, 0] > found[0, 0]


def test_frames_before_the_nudge_stay():
    robot, frame = humanoid.load(None), WARM_UP_FRAMES + 10
    one, other = (robot.run(np.random.default_rng(2), frame + 3, nudge)[0] for nudge in (None, Nudge(frame, 0.01)))
    np.testing.assert_array_equal(one[:, : frame + 1], other[:, : frame + 1])
    assert (one[:, frame + 1] != other[:, frame + 1]).any()


def test_the_command(capsys):
    assert sensitivity.main(["humanoid", "--seeds", "1", "--first-seed", "2"]) == 0
    out = capsys.readouterr().out
    assert "1 runs" in out and "frame 100" in out
    with pytest.raises(SystemExit):
        sensitivity.main(["g1"])
    assert "folder" in capsys.readouterr().err
    assert sensitivity.main(["g1", "."]) == 1


def test_robots_that_fall_are_left_out():
    robot = humanoid.load(None)
    falls = dataclasses.make_dataclass("Falls", [("draws", int)], namespace={"run": lambda *_: None})
    assert sensitivity.errors(falls(robot.draws), 1, 0.001) is None
