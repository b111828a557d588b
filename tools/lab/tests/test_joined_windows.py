"""Windows whose parts hang together: the joints of a batch."""

import numpy as np
import torch

from rigidformer_lab.data import Dataset, state_at
from rigidformer_lab.joints import hold_together
from rigidformer_lab.movi import _offsets
from rigidformer_lab.scenes import Scenes, write_scenes


def test_the_pivots_of_a_batch_are_where_its_parts_meet(tmp_path):
    """Two bars on a ball joint and a box by itself, drawn in any order."""
    rng, frames = np.random.default_rng(0), 40
    bar = np.array(np.meshgrid((-0.2, 0.1, 0.2), (-0.05, 0.05), (-0.05, 0.05))).reshape(3, -1).T.astype(np.float32)
    turns = np.cumsum(rng.normal(size=(2, frames, 4)) * 0.02, 1) + np.array([1.0, 0, 0, 0])
    turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
    from rigidformer_lab.geometry import quaternion_to_matrix as matrix

    meeting = np.cumsum(rng.normal(size=(frames, 3)) * 0.01, 0)
    ends = np.array([0.2, 0.0, 0.0]), np.array([-0.2, 0.0, 0.0])
    poses = np.zeros((3, frames, 7))
    for k, end in enumerate(ends):
        poses[k, :, :3], poses[k, :, 3:] = meeting - matrix(turns[k]) @ end, turns[k]
    poses[2] = [3, 0, 0, 1, 0, 0, 0]
    units, count = 3, 2
    write_scenes(tmp_path / "x", Scenes(
        dataset="bars", shape_names=["bar"], shape_points=bar, shape_offsets=_offsets([len(bar)]), scene_seed=np.arange(count),
        scene_split=np.zeros(count, np.uint8), scene_units=_offsets([units] * count), unit_shape=np.zeros(units * count, np.int32),
        unit_scale=np.ones(units * count, np.float32), unit_physics=np.tile(np.float32([1, 0.5, 0]), (units * count, 1)),
        unit_poses=np.tile(poses, (count, 1, 1)).astype(np.float32), provenance="-", licence="-", frame_rate_hz=30.0,
        gravity_m_s2=(0, 0, -9.81), ground_friction=None, ground_restitution=None,
        planes=np.tile(np.float32([0, 0, 1, -9, 0.5, 0]), (count, 1)), scene_planes=np.arange(count + 1),
        unit_body=np.tile(np.array([0, 0, -1], np.int32), count),
    ))  # fmt: skip
    data = Dataset([tmp_path / "x"], [0], last_frame=frames - 1, join=True)
    rows = [np.arange(3), np.array([3, 4])]
    scene, rotation, centre, _ = data.tensors([(0, 3, 2), (1, 3, 2)], rows, 2, 8, True)
    assert ((scene.joints.parent >= 0).sum(1) == 1).all()
    state = state_at(rotation, centre, 1)
    mass, every = scene.physics[..., 0], scene.mask
    held = hold_together(scene.joints, state.rotation, state.centre, mass, every, every)
    torch.testing.assert_close(held, state.centre, atol=2e-6, rtol=0)
    moved = hold_together(scene.joints, state.rotation, state.centre + 0.01 * torch.randn_like(state.centre), mass, every, every)
    assert (moved - state.centre).abs().max() > 1e-3
