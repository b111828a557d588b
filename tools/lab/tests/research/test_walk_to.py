"""The controller without a model, and what of a plan is left."""

import json
import stat

import numpy as np
import pytest

from rigidformer_lab.research import walk_to
from rigidformer_lab.movi import _offsets
from rigidformer_lab.scenes import Scenes, read_scenes

CORNERS = np.array(np.meshgrid(*[(-0.1, 0.1)] * 3)).reshape(3, -1).T.astype(np.float32)


def pose(x, y, yaw):
    return np.array([x, y, 0.8, np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)])


def test_straight_walks_in_the_heading():
    np.testing.assert_allclose(walk_to.straight(pose(0, 0, np.pi / 2), np.array([0.3, 0.4])), [0.4, -0.3, 0], atol=1e-12)
    np.testing.assert_allclose(walk_to.straight(pose(5, 0, 0), np.array([-5, 9])), [-0.7, 0.5, 0])
    assert walk_to.yaw_of(pose(0, 0, 0.3)) == pytest.approx(0.3)


def test_the_program_sees_two_looks_and_begins_with_what_is_left(tmp_path):
    """A program that notes its arguments and answers with a plan."""
    answer = {"command": [0.1, 0.2, 0.3], "commands": [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9]}
    program = tmp_path / "program"
    program.write_text(f"#!/bin/sh\ncp \"$2\" {tmp_path}/seen\necho \"$@\" >> {tmp_path}/said\necho '{json.dumps(answer)}'\n")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    template = Scenes(
        dataset="g1", shape_names=["torso"], shape_points=CORNERS, shape_offsets=_offsets([8]), scene_seed=np.zeros(1, np.int64),
        scene_split=np.zeros(1, np.uint8), scene_units=_offsets([1]), unit_shape=np.zeros(1, np.int32), unit_scale=np.ones(1, np.float32),
        unit_physics=np.float32([[1, 0.5, 0]]), unit_poses=pose(0, 0, 0)[None, None].astype(np.float32), provenance="-", licence="-",
        frame_rate_hz=30.0, gravity_m_s2=(0, 0, -9.81), ground_friction=None, ground_restitution=None,
        planes=np.float32([[0, 0, 1, 0, 0.5, 0]]), scene_planes=np.arange(2), unit_body=np.zeros(1, np.int32),
    )  # fmt: skip
    planner = walk_to.Planner(program, tmp_path / "model", template, True)
    poses = np.stack([pose(0.01 * k, 0, 0) for k in range(11)])[None]
    for _ in range(4):
        np.testing.assert_allclose(planner.command(poses, np.array([1.0, 2.0])), [0.1, 0.2, 0.3])
    seen = read_scenes(tmp_path / "seen")
    assert seen.frames == 11 and seen.unit_poses[0, -1, 0] == np.float32(0.1)
    firsts = [line.split("--first=")[1].split()[0] for line in (tmp_path / "said").read_text().splitlines()]
    assert "--join" in (tmp_path / "said").read_text() and firsts[0].count("0.000000") == 9
    assert firsts[1] == firsts[2] and firsts[1].startswith("0.1") and firsts[3].startswith("0.4") and firsts[3].endswith("0.900000")


def test_what_goes_wrong_is_said(tmp_path, capsys):
    assert walk_to.main([str(tmp_path)]) == 1
    assert "g1" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        walk_to.main([str(tmp_path), "--trials", "0"])
