"""A cube on springs, against what mechanics says."""

import numpy as np
import pytest

from rigidformer_lab import tosses
from rigidformer_lab.research import springs
from rigidformer_lab.scenes import read_scenes

FRAMES = 120


@pytest.fixture
def file(tmp_path):
    """Two recordings of a cube that lies still: the second one slides at 0.3 m/s in its first frame."""
    state = np.zeros((2 * FRAMES, 13), np.float32)
    state[:, 0], state[:, 6] = 1, tosses.EDGE_M / 2
    state[FRAMES:, 10] = 0.3
    np.savez(tmp_path / tosses.FILE, index=np.array([1, 2], np.int32), frames=np.array([FRAMES, FRAMES], np.int32), state=state)
    out = tmp_path / "tosses.safetensors"
    assert tosses.main([str(tmp_path), "--out", str(out)]) == 0
    return out


def test_a_cube_sinks_as_deep_as_its_springs_say_and_slides_as_far_as_friction_lets_it(file):
    scenes = read_scenes(file)
    still, sliding = springs.rollout(scenes, np.array([0, 1]), 2500.0, 4.0, 2e-4)[:, -1]
    sunk = tosses.EDGE_M / 2 - tosses.MASS_KG * 9.81 / (4 * 2500.0)
    np.testing.assert_allclose(still, [0, 0, sunk, 1, 0, 0, 0], atol=2e-5)
    # The file's velocities have half a frame's fall, which the table takes with friction.
    speed = 0.3 - tosses.FRICTION * 9.81 * 0.5 / tosses.FRAME_RATE_HZ
    assert sliding[0] == pytest.approx(speed**2 / (2 * tosses.FRICTION * 9.81), rel=0.01)
    metres, degrees = springs.errors(scenes, np.array([0]), springs.rollout(scenes, np.array([0]), 2500.0, 4.0, 2e-4))
    assert metres[0] == pytest.approx(tosses.EDGE_M / 2 - sunk, rel=0.1) and degrees[0] < 0.01


def test_files_without_such_scenes_are_refused(file, capsys):
    assert springs.main([str(file), "--split", "2"]) == 0
    assert "of 2 tosses" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        springs.main([str(file), "--split", "0"])
    assert "--train 300" in capsys.readouterr().err
