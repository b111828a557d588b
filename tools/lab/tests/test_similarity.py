"""Models that measure scenes in their own length: the same motion at any size (docs/MODEL.md, section 1)."""

import dataclasses
import pathlib
import struct
import zlib

import pytest
import torch

from rigidformer_lab import golden
from rigidformer_lab.config import PRESETS, ModelConfig
from rigidformer_lab.model import RigidFormer, typical
from rigidformer_lab.packed import opened, read_provenance, read_weights

NANO = pathlib.Path(__file__).parents[3] / "weights" / "models" / "nano.rfm"


def scene_of(length=1.0, pull=1.0, weight=1.0):
    scene, state, _, _, (rotation, centre) = golden.roles_scene(length, pull, weight)
    return scene, dataclasses.replace(state, target_rotation=rotation[0][None], target_centre=centre[0][None])


def model():
    torch.manual_seed(3)
    model = RigidFormer(PRESETS["tiny-similar"]).initialise().double()
    torch.nn.init.normal_(model.anchors.head.get_submodule("1").weight, std=0.1)
    return model


@pytest.mark.parametrize("size", [(4.0, 1.0, 1.0), (1 / 16, 1.0, 8.0), (0.11, 0.7, 0.02), (1.0, 0.25, 1.0)])
def test_sizes_gravities_and_masses_change_nothing(size):
    network = model()
    with torch.no_grad():
        (scene, state), (other, moved) = scene_of(), scene_of(*size)
        assert torch.allclose(network.features(scene, state), network.features(other, moved), atol=1e-5)
        after, advanced, active = network.step(scene, state)
        found, found_advanced, found_active = network.step(other, moved)
    assert torch.equal(active, found_active) and active.any()
    assert torch.allclose(after.rotation, found.rotation, atol=1e-5)
    assert torch.allclose(after.centre, found.centre / size[0], atol=1e-5)
    assert torch.allclose(advanced, found_advanced / size[0], atol=1e-5)
    assert torch.allclose(found.previous_centre, moved.centre, atol=1e-12)


def test_the_measure_is_that_of_the_free_units():
    scene, _ = scene_of()
    size, mass = typical(scene)[0].tolist()
    free = scene.role[0] == 0
    assert mass == pytest.approx(float(scene.physics[0, free, 0].mean()))
    assert 0.1 < size < float(scene.radius[0].max())
    inner = model().measured(scene)
    assert inner.length.tolist() == [pytest.approx(size / 0.25)] and model().measured(inner) is inner
    held = dataclasses.replace(scene, role=torch.full_like(scene.role, 2))
    assert typical(held)[0, 1] == pytest.approx(float(scene.physics[0, :, 0].mean()))
    whole = dataclasses.replace(scene, typical=torch.tensor([[0.5, 2.0]]))
    assert model().measured(whole).length.tolist() == [2.0]


def test_files_keep_the_fields_and_bad_values_are_refused():
    config = dataclasses.replace(PRESETS["tiny-similar"], longest_step=12.0)
    assert ModelConfig.from_json(config.to_json()) == config
    assert "length_m" not in PRESETS["edge-paper-inputs"].to_json()
    for bad in ({"length_m": -0.1}, {"length_m": float("nan")}, {"longest_step": 1e9}):
        with pytest.raises(ValueError):
            dataclasses.replace(config, **bad)


def test_steps_beyond_the_longest_are_for_the_core():
    scene, state = scene_of()
    network = RigidFormer(dataclasses.replace(PRESETS["tiny-similar"], longest_step=3.0)).double()
    with pytest.raises(ValueError, match="longest_step 3"):
        network.step(scene, state)


@pytest.mark.parametrize("version", [1, 2, 3])
def test_weights_of_older_versions_are_read(tmp_path, version):
    """Headers of version 3 end alike; 2 has no length_m and longest_step (8 bytes), and 1 no widths of hidden layers (3)."""
    old = NANO.read_bytes()
    behind = 64 + opened(NANO)[0].at
    end = behind - 7  # nano is of version 10: scope, five bytes that are kept free, most units
    assert old[8] == 10 and old[end:behind] == bytes(6) + b"\x18"
    (length,) = struct.unpack_from("<I", old, 12)
    start, payload_length = struct.unpack_from("<QQ", old, 16)
    assert old[end - 11 : end - 8] == bytes(3), "nano's hidden layers are of the usual widths"
    header = old[64 : end - {1: 11, 2: 8, 3: 0}[version]] + old[behind : 64 + length]
    at = -(-(64 + len(header)) // 64) * 64
    prefix = struct.pack("<8sIIQQI", old[:8], version, len(header), at, payload_length, zlib.crc32(header))
    prefix += old[36:60]
    prefix += struct.pack("<I", zlib.crc32(prefix))
    path = tmp_path / "older.rfm"
    path.write_bytes((prefix + header).ljust(at, b"\0") + old[start:])
    assert read_provenance(path) == read_provenance(NANO) != {}
    found, expected = read_weights(path), read_weights(NANO)
    assert found.keys() == expected.keys() and all(torch.equal(found[k], expected[k]) for k in found)
