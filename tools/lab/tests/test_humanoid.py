"""Scenes of a running humanoid. PyBullet's wheel has all that they need."""

import numpy as np
import pytest

from rigidformer_lab import bullet, humanoid
from rigidformer_lab.geometry import quaternion_to_matrix
from rigidformer_lab.humanoid import FEET, LAYERS, PARTS, Body, Recipe, act, capsule_points, load, observe, wheel_weights
from rigidformer_lab.robots import FRAME_RATE_HZ, FolderError
from rigidformer_lab.scenes import TEST, read_scenes


@pytest.fixture(scope="module")
def scenes():
    return Recipe(None, 1, 3, 330).make(range(1, 4))


@pytest.fixture
def body():
    with bullet.world() as (pb, on):
        yield Body(pb, on, load(None).model)


def test_the_policy_is_three_layers():
    weights = {f"{name}_{kind}": np.zeros((rows, columns) if kind == "w" else columns)
               for name, rows, columns in LAYERS for kind in "wb"}
    weights["dense1_w"][3, 7], weights["dense1_w"][3, 8] = 2, -2
    weights["dense2_w"][7, 1], weights["dense2_w"][8, 1] = 3, 100
    weights["final_w"][1, 4], weights["final_b"][4] = -1, 0.5
    expected = np.zeros(17)
    expected[4] = -1 * 3 * 2 * 0.25 + 0.5
    np.testing.assert_allclose(act(weights, 0.25 * np.eye(44)[3]), expected)


def test_what_the_policy_sees():
    quarter = np.pi / 2
    seen = observe((9.0, 9.0, 1.0), (0.1, 0.2, quarter), (1.0, 2.0, 3.0), np.arange(17) / 17, np.full(17, 2.0), (1.0, 0.0),
                   np.array([1.0, 0.0]))
    assert seen.shape == (44,)
    # It looks along y and is to go along x, to its right.
    np.testing.assert_allclose(seen[:8], [0.2, -1, 0, 0.6, -0.3, 0.9, 0.1, 0.2], atol=1e-7)
    np.testing.assert_allclose(seen[8:42:2], np.arange(17) / 17, atol=1e-7)
    np.testing.assert_allclose(seen[9:42:2], 0.2)
    assert seen[42:].tolist() == [1, 0]
    assert observe((0, 0, 99.0), (0, 0, 0), (0, 0, 0), np.zeros(17), np.zeros(17), (0, 0), np.ones(2))[0] == 5


def test_points_are_spread_over_a_capsule():
    points = capsule_points((0, 0, 1), (0, 3, 1), 0.5, 4000)
    along = np.clip(points[:, 1], 0, 3)
    np.testing.assert_allclose(np.linalg.norm(points - np.column_stack([0 * along, along, 0 * along + 1]), axis=1), 0.5)
    share = np.histogram(points[:, 1], bins=8, range=(-0.5, 3.5))[0] / len(points)
    np.testing.assert_allclose(share, 1 / 8, atol=0.001)
    np.testing.assert_allclose(points.mean(0), (0, 1.5, 1), atol=0.01)
    sphere = capsule_points((1, 2, 3), (1, 2, 3), 0.2, 100)
    np.testing.assert_allclose(np.linalg.norm(sphere - [1, 2, 3], axis=1), 0.2)


def test_points_lie_on_what_pybullet_lets_touch(body):
    """A speck at a point of a part is nowhere off its link, and hardly in it unless pieces of the part overlap there."""
    body.bend(np.linspace(-0.4, 0.3, 17))
    robot, radius = load(None), 0.005
    ball = body.pb.createCollisionShape(body.pb.GEOM_SPHERE, radius=radius, **body.on)
    speck = body.pb.createMultiBody(0, ball, **body.on)
    poses, deepest = body.poses(), {}
    for part, link in enumerate((-1, *body.links)):
        where = robot.points[part] @ quaternion_to_matrix(poses[part, 3:]).T + poses[part, :3]
        gaps = []
        for point in where:
            body.pb.resetBasePositionAndOrientation(speck, point, (0, 0, 0, 1), **body.on)
            found = body.pb.getClosestPoints(body.number, speck, 1.0, linkIndexA=link, **body.on)
            gaps.append(min(contact[8] for contact in found) + radius)
        assert max(gaps) < 0.002, PARTS[part]
        deepest[PARTS[part]] = min(gaps)
    assert min(deepest[name] for name in PARTS if name not in ("torso", "right_lower_arm", "left_lower_arm")) > -0.002
    masses = [body.pb.getDynamicsInfo(body.number, link, **body.on)[0] for link in (-1, *body.links)]
    np.testing.assert_allclose(robot.mass, masses, rtol=1e-5)


def test_it_runs_along_its_command(scenes):
    assert scenes.dataset == "humanoid" and scenes.units == 39 and tuple(scenes.shape_names) == PARTS
    np.testing.assert_allclose(np.linalg.norm(scenes.commands, axis=2), 1, atol=1e-6)
    poses = scenes.unit_poses.reshape(3, 13, 330, 7).astype(np.float64)
    over = np.diff(poses[:, 0, :, :2], axis=1) * FRAME_RATE_HZ
    assert (over * scenes.commands[:, :-1]).sum(-1).mean() > 1.2
    assert poses[:, 0, :, 2].min() > 0.7
    lowest = []
    for part, name in enumerate(PARTS):
        down = quaternion_to_matrix(poses[:, part, :, 3:])[..., 2, :]
        lowest.append((down @ scenes.points_of_shape(part).T.astype(np.float64)).min(-1) + poses[:, part, :, 2])
    feet = [PARTS.index(name) for name in FEET]
    touching = np.min([lowest[foot] for foot in feet], axis=0)
    assert touching.min() > -0.02 and np.median(np.abs(touching)) < 0.005


def test_scenes_are_drawn_from_their_seed_alone(scenes):
    again = Recipe(None, 2, 1, 330).make(range(2, 3))
    np.testing.assert_array_equal(again.unit_poses, scenes.unit_poses[13:26])
    np.testing.assert_array_equal(again.commands[0], scenes.commands[1])


def test_an_interrupted_run_continues_with_the_same_bytes(resumes, monkeypatch):
    monkeypatch.setattr("rigidformer_lab.robots.SEEDS_PER_SHARD", 1)
    resumes(Recipe(None, 1, 2, 3), Recipe(None, 1, 2, 4))


def test_the_command(tmp_path, capsys):
    out = tmp_path / "x"
    few = ["--seeds", "1", "--frames", "2", "--workers", "1", "--split", "test"]
    assert humanoid.main(["--out", str(out), *few]) == 0
    assert "13 units" in capsys.readouterr().out and read_scenes(out).scene_split.tolist() == [TEST]
    np.savez(tmp_path / humanoid.POLICY, **wheel_weights())
    assert humanoid.main([str(tmp_path), "--out", str(tmp_path / "y"), *few]) == 0
    assert (tmp_path / "y").read_bytes() == out.read_bytes()


def test_weights_that_are_missing_or_wrong(tmp_path, capsys, monkeypatch):
    assert humanoid.main([str(tmp_path), "--out", str(tmp_path / "x"), "--workers", "1"]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"error: {tmp_path / humanoid.POLICY}: cannot be read") and "or no folder" in error
    np.savez(tmp_path / humanoid.POLICY, **(wheel_weights() | {"final_w": np.zeros((17, 128))}))
    with pytest.raises(FolderError, match=r"final_w has shape \(17, 128\), not \(128, 17\)"):
        load(tmp_path)
    assert not (tmp_path / "x").exists()
    monkeypatch.setattr(humanoid, "EXAMPLE", "examples/none.py")
    with pytest.raises(FolderError, match="none.py: cannot read .*install pybullet"):
        wheel_weights()
    monkeypatch.setattr(humanoid, "EXAMPLE", "__init__.py")
    with pytest.raises(FolderError, match="lacks the weights of the layer dense1|cannot read"):
        wheel_weights()


@pytest.mark.parametrize("wrong, message", [
    (("--seeds", "0"), "at least 1"), (("--first-seed", "-1"), "between 0"), (("--frames", "0"), "at least 1"),
])
def test_bad_arguments(tmp_path, capsys, wrong, message):
    with pytest.raises(SystemExit):
        humanoid.main(["--out", str(tmp_path / "x"), *wrong])
    assert message in capsys.readouterr().err
