"""Contact's numbers from a file, and what training sees of scenes that have them."""

from __future__ import annotations

import errno

import numpy as np
import pytest

import rigidformer as rf
from conftest import at, cube

HEAD = 'format = "rigidformer-contact"\nversion = 1\n'


@pytest.fixture
def drop() -> rf.Scene:
    """A cube that falls onto a plane, as a record has it that knows no contact."""
    poses = [[at(z=0.5 - 4.905 * (frame / 240) ** 2)] for frame in range(90)]
    unit = rf.Unit(cube(), mass_kg=1.0, friction=0.5, restitution=0.5)
    plane = rf.Plane((0, 0, 1), 0.0, 1.0, 0.6)
    return rf.Scene([unit], np.array(poses), 240, gravity_m_s2=[0, 0, -9.81], planes=[plane])


def contact(tmp_path, text):
    path = tmp_path / "contact.toml"
    path.write_text(HEAD + text)
    return path


def test_a_scene_takes_contacts_numbers(tmp_path, drop):
    text = "friction = 0.3\nstiffness_n_m = 2000\ndissipation_s_m = 1\ngravity_factor = 0.5\ntable_height_m = 0.01\n"
    changed = drop.with_contact(contact(tmp_path, text))
    assert np.allclose(changed.gravity_m_s2, [0, 0, -4.905]) and np.allclose(drop.gravity_m_s2, [0, 0, -9.81])
    assert changed.planes[0].offset_m == pytest.approx(0.01) and changed.units[0].friction == pytest.approx(0.3)
    assert changed.units[0].stiffness_n_m == 2000 and drop.units[0].stiffness_n_m != 2000
    assert (changed.poses == drop.poses).all() and changed.name == drop.name
    rigid, soft = (rf.rollout(rf.Model("nano"), scene, 5, 85).poses for scene in (drop, changed))
    assert not np.allclose(rigid[-1], soft[-1], atol=1e-3)


def test_what_is_no_such_file_is_refused(tmp_path, drop):
    with pytest.raises(rf.FileError, match="none.toml") as raised:
        drop.with_contact(tmp_path / "none.toml")
    assert raised.value.errno == errno.ENOENT and raised.value.filename == str(tmp_path / "none.toml")
    with pytest.raises(rf.InputError, match="line 3: bounce is no number of contact.*rigidformer calibrate"):
        drop.with_contact(contact(tmp_path, "bounce = 1\n"))
    floating = rf.Scene([rf.Unit(cube())], drop.poses, 240, planes=[])
    with pytest.raises(rf.InputError, match="has no plane, which table_height_m is of"):
        floating.with_contact(contact(tmp_path, "table_height_m = 0.01\n"))


@pytest.mark.parametrize("text", ["", "stiffness_n_m = 3000\ndissipation_s_m = 1\n"])
def test_without_the_network_a_step_ends_as_training_is_told(tmp_path, drop, text):
    scene, model, step = drop.with_contact(contact(tmp_path, text)), rf.Model("nano"), 10
    windows = [(first, step) for first in range(30, 65, 5)]
    seen = rf.network_inputs(model, scene, windows)
    touched = 0
    for window, told in zip(seen["window"], seen["uncorrected"]):
        first = windows[window][0]
        world = rf.World(model, units=1, points=8)
        world.gravity_m_s2, world.planes, world.network = scene.gravity_m_s2, scene.planes, False
        world.observe_poses(step / 240, list(scene.units), scene.poses[first], scene.poses[first + step])
        world.step()
        assert np.allclose(world.centres()[0], told[:3], atol=2e-4)
        # A way is that of half a step before, as that between two poses is.
        later = scene.gravity_m_s2 * step / 480
        assert np.allclose(world.velocities()[0][:3], told[12:15] * 240 / step + later, atol=2e-3)
        touched += told[18] > 0
    assert touched > 2


def test_windows_start_as_they_are_told(drop):
    model, windows = rf.Model("nano"), [(20, 10), (45, 10)]
    told = np.stack([drop.poses[[first, first + step]] for first, step in windows])
    recorded, same = rf.network_inputs(model, drop, windows), rf.network_inputs(model, drop, windows, starts=told)
    assert all((recorded[name] == same[name]).all() for name in recorded)
    told[0, 0, 0, 2] += 0.01
    other = rf.network_inputs(model, drop, windows, starts=told)
    assert recorded["uncorrected"][0, 2] - other["uncorrected"][0, 2] == pytest.approx(0.01, abs=1e-4)
    with pytest.raises(rf.InputError, match="starts"):
        rf.network_inputs(model, drop, windows, starts=told[:1])
