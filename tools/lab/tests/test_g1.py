"""Scenes of a walking G1: policy and commands, a toy with the robot's joints and, with RIGIDFORMER_G1 set, the robot."""

import os
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from rigidformer_lab import g1
from rigidformer_lab.g1 import DEFAULT, HEAD, TORSO, Policy, Recipe, draw_command, load, observe
from rigidformer_lab.geometry import quaternion_to_matrix
from rigidformer_lab.robots import FRAME_RATE_HZ, FolderError
from rigidformer_lab.scenes import TEST, read_scenes

LEG = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw")
JOINTS = [f"{side}_{name}" for side in ("left", "right") for name in LEG] + ["waist_yaw", "waist_roll", "waist_pitch"] + [
    f"{side}_{name}" for side in ("left", "right") for name in ARM]  # fmt: skip
BODIES = ["pelvis", *(TORSO if name == "waist_pitch" else f"{name}_link" for name in JOINTS)]


def weights(observed, hidden, middle, actions, seed=0):
    rng = np.random.default_rng(seed)
    shapes = {"w_ih": (4 * hidden, observed), "w_hh": (4 * hidden, hidden), "b_ih": (4 * hidden,), "b_hh": (4 * hidden,),
              "w0": (middle, hidden), "b0": (middle,), "w1": (actions, middle), "b1": (actions,)}
    return {name: rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}


def toy_model(joints=JOINTS):
    """A block that stands, with the joints of the robot on it, each with a small ball."""
    inner = "".join(
        f"<body name='{body}' pos='0 0 {0.02 * number}'><joint name='{joint}_joint' axis='0 1 0'/>"
        "<geom size='.05' contype='0' conaffinity='0' mass='0.5'/></body>"
        for number, (joint, body) in enumerate(zip(joints, BODIES[1:]))
    )
    motors = "".join(f"<motor joint='{joint}_joint'/>" for joint in joints)
    return (f"<mujoco><worldbody><geom type='plane' size='0 0 1'/><body name='pelvis' pos='0 0 0.75'><freejoint/>"
            f"<geom type='box' size='.4 .4 .75' mass='50'/>{inner}</body></worldbody><actuator>{motors}</actuator></mujoco>")


def toy_folder(folder, model=None, parts=None, policy=None):
    """What a G1's folder holds, of a toy."""
    (folder / "mjcf").mkdir()
    (folder / g1.MODEL).write_text(model or toy_model())
    np.savez(folder / g1.POLICY, **(policy or weights(47, 64, 32, 12) | {"w1": np.zeros((12, 32), np.float32)}))
    names = [*BODIES[:16], HEAD, *BODIES[16:]]
    points = np.random.default_rng(1).normal(scale=0.05, size=(5 * len(names), 3)).astype(np.float32)
    starts = np.arange(0, len(points) + 1, 5, dtype=np.int32)
    np.savez(folder / g1.PARTS, **({"part": np.array(names), "verts": points, "vstart": starts} | (parts or {})))
    return folder


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "toy").mkdir()
    return toy_folder(tmp_path / "toy")


def test_the_policy_is_the_lstm_and_layers_of_torch():
    w = weights(5, 4, 3, 2)
    lstm = torch.nn.LSTM(5, 4)
    tensors = {name: torch.from_numpy(array) for name, array in w.items()}
    lstm.load_state_dict({"weight_ih_l0": tensors["w_ih"], "weight_hh_l0": tensors["w_hh"], "bias_ih_l0": tensors["b_ih"],
                          "bias_hh_l0": tensors["b_hh"]})
    seen = 3 * np.random.default_rng(1).normal(size=(20, 5)).astype(np.float32)
    with torch.no_grad():
        hidden, _ = lstm(torch.from_numpy(seen))
        middle = torch.nn.functional.elu(hidden @ tensors["w0"].T + tensors["b0"])
        expected = (middle @ tensors["w1"].T + tensors["b1"]).numpy()
    policy = Policy(w)
    found = np.array([policy.act(row) for row in seen])
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, atol=2e-6)
    assert np.isfinite(Policy(w).act(np.full(5, 1e30, np.float32))).all()


def test_what_the_policy_sees():
    position, velocity = np.zeros(36), np.arange(35.0)
    position[3:7] = np.cos(0.3), np.sin(0.3), 0, 0  # rolled by .6
    position[7:19] = DEFAULT + 0.1
    seen = observe(position, velocity, np.array([0.5, -0.2, 1.0]), np.full(12, 7.0), 0.2)
    assert seen.shape == (47,)
    np.testing.assert_allclose(seen[:3], [0.75, 1.0, 1.25])
    np.testing.assert_allclose(seen[3:6], [0, -np.sin(0.6), -np.cos(0.6)], atol=1e-12)
    np.testing.assert_allclose(seen[6:9], [1.0, -0.4, 0.25])
    np.testing.assert_allclose(seen[9:21], 0.1)
    np.testing.assert_allclose(seen[21:33], 0.05 * np.arange(6, 18))
    np.testing.assert_allclose(seen[33:], [7.0] * 12 + [1.0, 0.0], atol=1e-12)


def test_commands_are_in_their_range():
    rng = np.random.default_rng(0)
    drawn = np.array([draw_command(rng) for _ in range(3000)])
    np.testing.assert_allclose(drawn.min(0), [-0.7, -0.5, -1.0], atol=0.01)
    np.testing.assert_allclose(drawn.max(0), [0.9, 0.5, 1.0], atol=0.01)


def test_scenes_of_a_toy(folder):
    scenes = Recipe(folder, 3, 2, 6).make(range(3, 5))
    assert scenes.units == 62 and scenes.dataset == "g1" and scenes.commands.shape == (2, 6, 3)
    names = scenes.shape_names
    torso, head = names.index(TORSO), names.index(HEAD)
    np.testing.assert_array_equal(scenes.unit_poses[torso], scenes.unit_poses[head])
    mass = scenes.unit_physics[:31, 0]
    np.testing.assert_allclose([mass[0], mass[torso] + mass[head], mass.sum()], [50, 0.5, 64.5], rtol=1e-6)
    assert mass.min() > 0.05
    # It stands where it stood, each scene turned in its own way.
    np.testing.assert_allclose(scenes.unit_poses[[0, 31], :, 2], 0.75, atol=0.02)
    ahead = quaternion_to_matrix(scenes.unit_poses[[0, 31], 0, 3:].astype(np.float64))[:, :2, 0]
    assert np.abs(ahead[0] - ahead[1]).max() > 0.1
    again = Recipe(folder, 4, 1, 6).make(range(4, 5))
    np.testing.assert_array_equal(again.unit_poses, scenes.unit_poses[31:])
    np.testing.assert_array_equal(again.commands[0], scenes.commands[1])


def test_an_interrupted_run_continues_with_the_same_bytes(folder, resumes, monkeypatch):
    monkeypatch.setattr("rigidformer_lab.robots.SEEDS_PER_SHARD", 1)
    resumes(Recipe(folder, 1, 2, 3), Recipe(folder, 1, 2, 4))


def test_the_command(folder, tmp_path, capsys):
    out = tmp_path / "x"
    few = ["--seeds", "2", "--first-seed", "7", "--frames", "2", "--workers", "1", "--split", "test"]
    assert g1.main([str(folder), "--out", str(out), *few]) == 0
    assert "2 scenes, 62 units" in capsys.readouterr().out
    assert read_scenes(out).scene_split.tolist() == [TEST] * 2


@pytest.mark.parametrize("file", [g1.MODEL, g1.POLICY, g1.PARTS])
def test_a_missing_file_is_named(folder, tmp_path, capsys, file):
    (folder / file).unlink()
    assert g1.main([str(folder), "--out", str(tmp_path / "x"), "--workers", "1"]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"error: {folder / file}: ") and "give the folder" in error and error.count("\n") == 1
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize("wrong, message", [
    ({"model": "<mujoco>"}, "MuJoCo cannot read it"),
    ({"model": "<mujoco/>"}, "is no G1"),
    ({"model": toy_model(JOINTS[:-1])}, "is no G1"),
    ({"model": toy_model(JOINTS[::-1])}, "is no G1"),
    ({"policy": weights(47, 64, 32, 10)}, r"w1 has shape \(10, 32\), not \(12, 32\)"),
    ({"policy": {"w_ih": np.zeros((256, 46))}}, "no array of the name"),
    ({"parts": {"vstart": np.arange(32)}}, "vstart does not cut"),
    ({"parts": {"vstart": np.arange(0, 156, 5)[:-1]}}, "vstart does not cut"),
    ({"parts": {"part": np.array([*BODIES, "hat_link"])}}, "name each body"),
])
def test_files_of_something_else_are_named(tmp_path, wrong, message):
    with pytest.raises(FolderError, match=message):
        load(toy_folder(tmp_path, **wrong))


@pytest.fixture(scope="module")
def robot():
    folder = os.environ.get("RIGIDFORMER_G1")
    if not folder:
        pytest.skip("set RIGIDFORMER_G1 to the folder of mjcf, g1_policy.npz and g1_parts31.npz to run this test")
    return Path(folder)


def test_the_robot_walks_as_commanded(robot):
    scenes = Recipe(robot, 1, 3, 330).make(range(1, 4))
    poses = scenes.unit_poses.reshape(3, 31, 330, 7).astype(np.float64)
    turned = quaternion_to_matrix(poses[:, 0, :, 3:])
    heading = np.unwrap(np.arctan2(turned[..., 1, 0], turned[..., 0, 0]), axis=1)
    over = np.diff(poses[:, 0, :, :2], axis=1) * FRAME_RATE_HZ
    cos, sin = np.cos(heading[:, :-1]), np.sin(heading[:, :-1])
    moved = [cos * over[..., 0] + sin * over[..., 1], cos * over[..., 1] - sin * over[..., 0],
             np.diff(heading, axis=1) * FRAME_RATE_HZ]
    errors = []
    for scene, commands in enumerate(scenes.commands):
        cuts = [0, *(np.flatnonzero((np.diff(commands, axis=0) != 0).any(1)) + 1), 329]
        for start, end in zip(cuts, cuts[1:]):
            if end - start > 2 * FRAME_RATE_HZ:
                errors.append([way[scene, (start + end) // 2 : end].mean() for way in moved] - commands[start])
    assert len(errors) >= 6 and np.abs(errors).mean() < 0.1
    # The feet are on the ground, and nothing else is.
    lowest = np.empty((31, 3, 330))
    for part in range(31):
        down = quaternion_to_matrix(poses[:, part, :, 3:])[..., 2, :]
        lowest[part] = (down @ scenes.points_of_shape(part).T.astype(np.float64)).min(-1) + poses[:, part, :, 2]
    feet = [scenes.shape_names.index(f"{side}_ankle_roll_link") for side in ("left", "right")]
    assert np.abs(lowest[feet].min(0)).max() < 0.02
    assert np.delete(lowest, feet, axis=0).min() > 0.01


def test_points_are_in_the_frames_of_the_poses(robot):
    """The parts lie on the meshes that MuJoCo has for their bodies."""
    made = load(robot)
    model = made.model
    for name, body, points in zip(made.parts, made.body, made.points):
        vertices = []
        for geom in range(model.ngeom):
            mesh = model.geom_dataid[geom]
            if model.geom_bodyid[geom] == body and mesh >= 0:
                rows = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]].astype(np.float64)
                vertices.append(rows @ quaternion_to_matrix(model.geom_quat[geom]).T + model.geom_pos[geom])
        apart, _ = cKDTree(np.concatenate(vertices)).query(points)
        assert apart.mean() < 0.01 and apart.max() < 0.03, name
