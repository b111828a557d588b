"""Frames and centres of the starts that predictions are compared from."""

import numpy as np
from scipy.spatial.transform import Rotation

from rigidformer_lab.research import ahead


def test_poses_are_followed_and_turned_back():
    rng = np.random.default_rng(1)
    poses = np.concatenate((rng.normal(size=(5, 3)), Rotation.random(5, rng=rng).as_quat(scalar_first=True)), 1)
    first, second = poses[:4], poses[4]
    both = ahead.moved(first, np.tile(second, (4, 1)))
    points = rng.normal(size=(4, 3))
    carried = Rotation.from_quat(second[[4, 5, 6, 3]]).apply(points) + second[:3]
    expected = Rotation.from_quat(first[:, [4, 5, 6, 3]]).apply(carried) + first[:, :3]
    assert np.allclose(Rotation.from_quat(both[:, [4, 5, 6, 3]]).apply(points) + both[:, :3], expected)
    assert np.allclose(np.abs(ahead.moved(first, ahead.inverse(first))), [0, 0, 0, 1, 0, 0, 0], atol=1e-12)


def test_a_spin_moves_other_centres():
    # About z, a point beside the centre along x moves along y.
    velocity = np.array([1.0, 0, 0, 0, 0, 2.0])
    assert ahead.at_other_centre(velocity, np.array([0.5, 0, 0])).tolist() == [1, 1, 0, 0, 0, 2]
