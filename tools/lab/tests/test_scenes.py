"""Scenes: the file format, the split, the primitives and, with RIGIDFORMER_ASSETS set, the MOVi recipe."""

import dataclasses
import hashlib
import json
import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from rigidformer_lab import movi
from rigidformer_lab.movi import Recipe, make_scenes, primitive_shapes, simulate
from rigidformer_lab.research import check_movi
from rigidformer_lab.scenes import (EXTRA, TEST, TRAIN, VALIDATION, ContactLaw, SceneFileError, concatenate, read_scenes,
                                    split_of_seed, write_scenes)

ARRAYS = ("shape_points", "shape_offsets", "scene_seed", "scene_split", "scene_units", "unit_shape", "unit_scale",
          "unit_physics", "unit_poses")
FIRST_TEST_SEEDS = (1019, 4, 1028, 1033, 1034, 1039, 1042, 542, 545, 547)


@pytest.fixture(scope="module")
def primitives():
    return make_scenes(Recipe("primitives", 8, 3, 6, None), range(8, 11))


@pytest.fixture
def assets():
    folder = os.environ.get("RIGIDFORMER_ASSETS")
    if not folder:
        pytest.skip("set RIGIDFORMER_ASSETS to the folder of the KuBasic shapes to run this test")
    return Path(folder)


def test_varied_scenes_start_alike(primitives):
    varied = make_scenes(Recipe("primitives", 8, 3, 6, None, movi.Variation((0.2, 5.0), (0.0, 1.0))), range(8, 11))
    factor = varied.unit_physics[:, 0] / primitives.unit_physics[:, 0]
    assert factor.min() >= 0.2 and factor.max() <= 5.0 and factor.std() > 0.5
    assert 0 <= varied.unit_physics[:, 1].min() and varied.unit_physics[:, 1].max() <= 1
    np.testing.assert_array_equal(varied.unit_poses[:, :2], primitives.unit_poses[:, :2])
    np.testing.assert_array_equal(varied.unit_physics[:, 2], primitives.unit_physics[:, 2])
    assert varied.dataset == "primitives-varied"
    assert "Masses times" in varied.provenance and "Frictions drawn" in varied.provenance
    only = make_scenes(Recipe("primitives", 8, 3, 6, None, movi.Variation((0.2, 5.0))), range(8, 11))
    np.testing.assert_array_equal(only.unit_physics[:, 0], varied.unit_physics[:, 0])
    np.testing.assert_array_equal(only.unit_physics[:, 1], primitives.unit_physics[:, 1])


@pytest.mark.parametrize("wrong", [("--mass-factor", "0", "2"), ("--mass-factor", "3", "2"), ("--friction", "-1", "1")])
def test_variation_is_checked(wrong, tmp_path, capsys):
    with pytest.raises(SystemExit):
        movi.main(["primitives", "--out", str(tmp_path / "x"), *wrong])
    assert "the lower one first" in capsys.readouterr().err


# The format


def test_round_trip(tmp_path, primitives):
    path = tmp_path / "scenes.safetensors"
    write_scenes(path, primitives)
    again = read_scenes(path)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(again, name), getattr(primitives, name))
        assert getattr(again, name).dtype == getattr(primitives, name).dtype
    for field in dataclasses.fields(again):
        if field.name not in ARRAYS:
            assert getattr(again, field.name) == getattr(primitives, field.name), field.name
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_bytes_are_reproducible_and_tensors_aligned(tmp_path, primitives):
    for name in ("a", "b"):
        write_scenes(tmp_path / name, primitives)
    data = (tmp_path / "a").read_bytes()
    assert data == (tmp_path / "b").read_bytes()
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    assert length % 8 == 0
    assert all(isinstance(value, str) for value in header.pop("__metadata__").values())
    width = {"I64": 8, "F32": 4, "I32": 4, "U8": 1}
    for name, entry in header.items():
        assert entry["data_offsets"][0] % width[entry["dtype"]] == 0, name


def test_concatenate_restores_the_whole(primitives):
    parts = [make_scenes(Recipe("primitives", 8, 3, 6, None), range(seed, seed + 1)) for seed in (8, 9, 10)]
    whole = concatenate(parts)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(whole, name), getattr(primitives, name))


def _spoil(field, change):
    def spoil(scenes):
        value = np.array(getattr(scenes, field))
        return dataclasses.replace(scenes, **{field: change(value)})
    return spoil


def _set(index, value):
    def change(array):
        array[index] = value
        return array
    return change


@pytest.mark.parametrize("field, spoil", [
    ("unit_shape", _spoil("unit_shape", _set(0, 99))),
    ("unit_shape", _spoil("unit_shape", lambda a: a.astype(np.int64))),
    ("unit_scale", _spoil("unit_scale", _set(0, 0))),
    ("unit_scale", _spoil("unit_scale", lambda a: a[1:])),
    ("unit_physics", _spoil("unit_physics", _set((0, 0), 0))),
    ("unit_physics", _spoil("unit_physics", _set((0, 1), -1))),
    ("unit_poses", _spoil("unit_poses", _set((0, 0, 0), np.nan))),
    ("unit_poses", _spoil("unit_poses", _set((0, 0, slice(3, 7)), 1))),
    ("unit_poses", _spoil("unit_poses", lambda a: a * np.where(np.arange(7) > 2, (-1.0) ** np.arange(6)[:, None], 1
                                                             ).astype(np.float32))),
    ("unit_poses", _spoil("unit_poses", lambda a: a[:, :0])),
    ("scene_units", _spoil("scene_units", _set(-1, 1))),
    ("scene_split", _spoil("scene_split", _set(0, 4))),
    ("shape_offsets", _spoil("shape_offsets", _set(0, 1))),
    ("ground_friction", lambda scenes: dataclasses.replace(scenes, ground_friction=float("nan"))),
])
def test_unusable_scenes_are_not_written(tmp_path, primitives, field, spoil):
    with pytest.raises(SceneFileError, match=field):
        write_scenes(tmp_path / "bad.safetensors", spoil(primitives))
    assert list(tmp_path.iterdir()) == []


def _edit_header(path, edit):
    data = path.read_bytes()
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    edit(header)
    text = json.dumps(header).encode()
    path.write_bytes(len(text).to_bytes(8, "little") + text + data[8 + length :])


@pytest.mark.parametrize("message, edit", [
    ("metadata format", lambda h: h["__metadata__"].update(format="other")),
    ("metadata version", lambda h: h["__metadata__"].update(version="3")),
    ("metadata licence", lambda h: h["__metadata__"].pop("licence")),
    ("metadata gravity_m_s2", lambda h: h["__metadata__"].update(gravity_m_s2="0 -10")),
    ("metadata frame_rate_hz", lambda h: h["__metadata__"].update(frame_rate_hz="fast")),
    *((f"metadata contact_law: is '{law}', not a number from 0 to 1", lambda h, law=law: h["__metadata__"].update(contact_law=law))
      for law in ("", "0.1,", "0.1,cone", "nan", "inf", "-0.1", "1.5", " 0.1", "0.1,pyramid,")),
    ("metadata shape_names", lambda h: h["__metadata__"].update(shape_names="box")),
    ("tensor unit_scale", lambda h: h.update(unit_size=h.pop("unit_scale"))),
    ("tensor unit_shape", lambda h: h["unit_shape"].update(dtype="F32")),
])
def test_bad_files_name_the_field(tmp_path, primitives, message, edit):
    path = tmp_path / "bad.safetensors"
    write_scenes(path, primitives)
    _edit_header(path, edit)
    with pytest.raises(SceneFileError, match=message) as caught:
        read_scenes(path)
    assert str(path) in str(caught.value)
    assert any(remedy in str(caught.value) for remedy in ("make the file again", "give a scene file"))


def test_files_have_the_law_of_what_recorded_them(tmp_path, primitives):
    path = tmp_path / "scenes.safetensors"
    assert primitives.contact_law == movi.CONTACT_LAW == ContactLaw(0.03, pyramid=True) and str(movi.CONTACT_LAW) == "0.03,pyramid"
    write_scenes(path, primitives)
    assert b'"contact_law":"0.03,pyramid"' in path.read_bytes() and read_scenes(path).contact_law == movi.CONTACT_LAW
    for law, text in ((ContactLaw(0.25), b'"0.25"'), (ContactLaw(0, pyramid=True), b'"0,pyramid"'), (ContactLaw(1.0), b'"1"')):
        write_scenes(path, dataclasses.replace(primitives, contact_law=law))
        assert b'"contact_law":' + text in path.read_bytes() and read_scenes(path).contact_law == law
    write_scenes(path, dataclasses.replace(primitives, contact_law=ContactLaw()))
    assert b"contact_law" not in path.read_bytes() and read_scenes(path).contact_law == ContactLaw()


def test_missing_truncated_and_foreign_files(tmp_path, primitives):
    path = tmp_path / "scenes.safetensors"
    with pytest.raises(SceneFileError, match="does not exist"):
        read_scenes(path)
    write_scenes(path, primitives)
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(SceneFileError, match="not a readable safetensors file"):
        read_scenes(path)
    path.write_text("hello")
    with pytest.raises(SceneFileError, match="not a readable safetensors file"):
        read_scenes(path)


def test_a_failed_write_leaves_the_old_file(tmp_path, primitives, monkeypatch):
    path = tmp_path / "scenes.safetensors"
    path.write_text("old")

    def refuse(*_):
        raise OSError("no space")
    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(OSError, match="no space"):
        write_scenes(path, primitives)
    assert path.read_text() == "old" and len(list(tmp_path.iterdir())) == 1


def test_errors_travel_between_processes():
    error = SceneFileError("a.safetensors", "unit_scale", "is empty", "make it again")
    again = pickle.loads(pickle.dumps(error))
    assert str(again) == str(error) and again.field == "unit_scale"


# Version 2


@pytest.fixture
def everything(primitives):
    """Scenes with every tensor of version 2."""
    units, frames = primitives.units, primitives.frames
    poses = primitives.unit_poses.copy()
    poses[1] = poses[1, :1]
    role, body, soft = np.zeros(units, np.uint8), np.full(units, -1, np.int32), np.zeros(units, np.uint8)
    role[:2], body[2:4], soft[3] = (1, 2), 65534, 1
    planes = np.zeros((9, 6), np.float32)
    planes[:, :3], planes[:, 3], planes[:, 4:] = (0.6, 0, 0.8), np.arange(9), (0.5, 0.25)
    soft_points = np.zeros((len(primitives.points_of_shape(primitives.unit_shape[3])), frames, 3), np.float32)
    return dataclasses.replace(
        primitives, unit_poses=poses, unit_role=role, unit_body=body, planes=planes,
        scene_planes=np.array([0, 8, 8, 9]), commands=np.ones((3, frames, 2), np.float32), unit_soft=soft,
        command_last=np.array([0, 1], np.uint8),
        soft_points=soft_points, scene_frames=np.array([frames, frames, frames]), frame_rate_hz=62.5,
        unit_velocity=np.arange(6 * units, dtype=np.float32).reshape(units, 6), gravity_m_s2=(1.0, 0.0, -9.0), ground_friction=None,
        ground_restitution=None,
        unit_inertia=np.arange(units, dtype=np.float32)[:, None] * np.array([1, 2, 3], np.float32),
        unit_young=np.where(soft, np.float32(1e4), np.float32(0)), faces=np.array([[0, 1, 2], [2, 1, 3]], np.int32),
        scene_faces=np.array([0, 2, 2, 2]), edges=np.array([[3, 0]], np.int32), scene_edges=np.array([0, 1, 1, 1]),
        tetrahedra=np.array([[0, 1, 2, 3]], np.int32), scene_tetrahedra=np.array([0, 1, 1, 1]),
        bonds=np.array([[0, 2], [1, 0], primitives.scene_units[2] + [0, 1]], np.int32), scene_bonds=np.array([0, 2, 2, 3]),
        bond_frame=np.array([0, 4, frames], np.int32),
    )  # fmt: skip


def test_version_2_keeps_everything(tmp_path, everything):
    path = tmp_path / "scenes.safetensors"
    write_scenes(path, everything)
    data = path.read_bytes()
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    assert header["__metadata__"]["version"] == "2" and not any("ground" in name for name in header["__metadata__"])
    again = read_scenes(path)
    for field in dataclasses.fields(again):
        mine, theirs = getattr(again, field.name), getattr(everything, field.name)
        assert np.array_equal(mine, theirs), field.name
        assert not isinstance(mine, np.ndarray) or mine.dtype == theirs.dtype
    assert [len(again.planes_of_scene(s)) for s in range(3)] == [8, 0, 1]
    low, high = again.soft_offsets[3:5]
    assert (low, high) == (0, len(again.soft_points)) and again.soft_offsets[-1] == high
    assert again.faces_of_scene(0).tolist() == [[0, 1, 2], [2, 1, 3]] and again.edges_of_scene(0).tolist() == [[3, 0]]
    assert again.tetrahedra_of_scene(0).tolist() == [[0, 1, 2, 3]] and again.tetrahedra_of_scene(2).shape == (0, 4)
    first = again.scene_units[2]
    assert again.bonds_of_scene(0).tolist() == [[0, 2, 0], [1, 0, 4]] and again.bonds_of_scene(1).shape == (0, 3)
    assert again.bonds_of_scene(2).tolist() == [[first, first + 1, again.frames]]


def test_what_needs_nothing_of_version_2_is_version_1(tmp_path, primitives):
    write_scenes(tmp_path / "old", primitives)
    more = dataclasses.replace(
        primitives, scene_frames=np.full(3, primitives.frames), unit_role=np.zeros(primitives.units, np.uint8), unit_body=np.full(primitives.units, -1, np.int32),
        unit_soft=np.zeros(primitives.units, np.uint8), scene_planes=np.arange(4),
        planes=np.repeat(np.array([[0, 0, 1, 0, 0.5, 0.25]], np.float32), 3, axis=0),
    )  # fmt: skip
    same_ground = dataclasses.replace(primitives, ground_friction=0.5, ground_restitution=0.25)
    write_scenes(tmp_path / "more", more)
    write_scenes(tmp_path / "same", same_ground)
    assert (tmp_path / "more").read_bytes() == (tmp_path / "same").read_bytes()
    assert b'"version":"1"' in (tmp_path / "old").read_bytes() and read_scenes(tmp_path / "old").planes is None
    moving = dataclasses.replace(primitives, unit_velocity=np.zeros((primitives.units, 6), np.float32))
    write_scenes(tmp_path / "moving", moving)
    assert read_scenes(tmp_path / "moving").version == "2"
    boxes = dataclasses.replace(primitives, unit_inertia=np.zeros((primitives.units, 3), np.float32))
    write_scenes(tmp_path / "boxes", boxes)
    assert (tmp_path / "boxes").read_bytes() == (tmp_path / "old").read_bytes()
    inertia = boxes.unit_inertia.copy()
    inertia[1] = 1e-3
    write_scenes(tmp_path / "turning", dataclasses.replace(boxes, unit_inertia=inertia))
    again = read_scenes(tmp_path / "turning")
    assert again.version == "2" and again.unit_inertia.tolist() == inertia.tolist()
    assert read_scenes(tmp_path / "old").bonds_of_scene(1).shape == (0, 3)
    bonded = dataclasses.replace(primitives, bonds=np.array([[0, 1]], np.int32), scene_bonds=np.array([0, 1, 1, 1]),
                                 bond_frame=np.array([2], np.int32))
    write_scenes(tmp_path / "bonded", bonded)
    assert read_scenes(tmp_path / "bonded").version == "2"
    write_scenes(tmp_path / "young", dataclasses.replace(primitives, unit_young=np.zeros(primitives.units, np.float32)))
    assert read_scenes(tmp_path / "young").version == "2"
    driven = dataclasses.replace(primitives, unit_role=np.ones(primitives.units, np.uint8))
    write_scenes(tmp_path / "driven", driven)
    again = read_scenes(tmp_path / "driven")  # the ground has become a plane
    assert again.planes.tolist() == [np.array([0, 0, 1, 0, 0.3, 0.5], np.float32).tolist()] * 3
    assert again.scene_planes.tolist() == [0, 1, 2, 3] and (again.roles == 1).all() and (again.bodies == -1).all()


def test_parts_with_planes_join(primitives, everything):
    frames = primitives.frames
    some = dataclasses.replace(everything, commands=None, command_last=None, unit_velocity=None, scene_frames=np.array([frames, 1, frames]))
    whole = concatenate([some, primitives])
    assert whole.scene_frames.tolist() == [frames, 1, *[frames] * 4]
    assert whole.scene_planes.tolist() == [0, 8, 8, 9, 10, 11, 12] and whole.planes.shape == (12, 6)
    assert len(whole.unit_role) == whole.units and whole.soft_points.shape == everything.soft_points.shape
    assert whole.unit_body[everything.units :].tolist() == [-1] * primitives.units
    assert whole.unit_inertia[: everything.units].tolist() == everything.unit_inertia.tolist()
    assert not whole.unit_inertia[everything.units :].any()
    with pytest.raises(ValueError, match="commands"):
        concatenate([everything, primitives])
    with pytest.raises(ValueError, match="unit_velocity"):
        concatenate([dataclasses.replace(everything, commands=None), primitives])
    with pytest.raises(ValueError, match="other set points"):
        concatenate([everything, dataclasses.replace(everything, command_last=None)])
    assert concatenate([everything, everything]).command_last.tolist() == [0, 1]
    with pytest.raises(ValueError, match="contact_law"):
        concatenate([everything, dataclasses.replace(everything, contact_law=ContactLaw())])


def test_meshes_bonds_and_shapes_join(tmp_path, primitives, everything):
    some = dataclasses.replace(everything, commands=None, command_last=None, unit_velocity=None)
    whole = concatenate([primitives, some, some])
    units, points = primitives.units, len(everything.soft_points)
    assert whole.unit_young.tolist() == [0] * units + everything.unit_young.tolist() * 2
    assert whole.faces_of_scene(6).tolist() == [[points, points + 1, points + 2], [points + 2, points + 1, points + 3]]
    assert whole.scene_faces.tolist() == [0] * 4 + [2] * 3 + [4] * 3 and whole.edges.tolist() == [[3, 0], [points + 3, points]]
    assert whole.tetrahedra_of_scene(3).tolist() == [[0, 1, 2, 3]] and not len(whole.bonds_of_scene(0))
    assert whole.bonds_of_scene(6).tolist() == [[2 * units, 2 * units + 2, 0], [2 * units + 1, 2 * units, 4]]
    assert whole.bond_frame.tolist() == [0, 4, 6] * 2 and whole.shape_names == primitives.shape_names
    for name in ("faces", "edges", "tetrahedra", "bonds", "bond_frame", "unit_shape"):
        assert getattr(whole, name).dtype == np.int32
    write_scenes(tmp_path / "whole", whole)
    with pytest.raises(ValueError, match="unit_young"):
        concatenate([some, dataclasses.replace(some, unit_young=None)])

    other = dataclasses.replace(primitives, shape_names=[f"other-{name}" for name in primitives.shape_names],
                                shape_points=2 * primitives.shape_points)
    both = concatenate([primitives, other])
    shapes = len(primitives.shape_names)
    assert both.shape_names == primitives.shape_names + other.shape_names and both.unit_shape.dtype == np.int32
    assert both.unit_shape.tolist() == [*primitives.unit_shape, *(primitives.unit_shape + shapes)]
    for k in range(shapes):
        np.testing.assert_array_equal(both.points_of_shape(shapes + k), 2 * both.points_of_shape(k))
    write_scenes(tmp_path / "both", both)
    pieces = {"shape_pieces": np.array([0, 1] + [1] * (shapes - 1)), "piece_offsets": np.array([0, 4]),
              "piece_points": np.eye(4, 3, dtype=np.float32)}
    with pytest.raises(ValueError, match="shape_pieces"):
        concatenate([dataclasses.replace(primitives, **pieces), other])


@pytest.mark.parametrize("field, row, spoil", [
    ("unit_role", "row 2", _spoil("unit_role", _set(2, 3))),
    ("unit_role", "", _spoil("unit_role", lambda a: a[1:])),
    ("unit_role", "", _spoil("unit_role", lambda a: a.astype(np.int32))),
    ("unit_poses", "row 1: moves", _spoil("unit_poses", _set((1, 2, 0), 7))),
    ("unit_body", "row 4", _spoil("unit_body", _set(4, -2))),
    ("unit_body", "row 4", _spoil("unit_body", _set(4, 65535))),
    ("planes", "row 3", _spoil("planes", _set((3, 0), np.nan))),
    ("planes", "row 3: the normal", _spoil("planes", _set((3, 0), 0.7))),
    ("planes", "row 3", _spoil("planes", _set((3, 5), -0.1))),
    ("planes", "", _spoil("planes", lambda a: a[:, :5])),
    ("planes", "", _spoil("planes", lambda a: a[0])),
    ("planes", "is missing", lambda scenes: dataclasses.replace(scenes, planes=None)),
    ("scene_planes", "is missing", lambda scenes: dataclasses.replace(scenes, scene_planes=None)),
    ("scene_planes", "without falling", _spoil("scene_planes", _set(2, 7))),
    ("scene_planes", "without falling", _spoil("scene_planes", _set(0, 1))),
    ("scene_planes", "row 0: gives", _spoil("scene_planes", _set(slice(1, 3), 9))),
    ("commands", "row 1", _spoil("commands", _set((1, 0, 0), np.inf))),
    ("commands", "of no numbers", _spoil("commands", lambda a: a[:, :, :0])),
    ("commands", "", _spoil("commands", lambda a: a[:, 1:])),
    ("command_last", "row 1: is 2", _spoil("command_last", _set(1, 2))),
    ("command_last", "", _spoil("command_last", lambda a: a[1:])),
    ("command_last", "without commands", lambda scenes: dataclasses.replace(scenes, commands=None)),
    ("unit_soft", "row 0", _spoil("unit_soft", _set(0, 2))),
    ("soft_points", "", _spoil("unit_soft", _set(0, 1))),
    ("soft_points", "row 5", _spoil("soft_points", _set((5, 0, 0), np.nan))),
    ("soft_points", "is missing", lambda scenes: dataclasses.replace(scenes, soft_points=None)),
    ("scene_frames", "row 1: is 0", _spoil("scene_frames", _set(1, 0))),
    ("scene_frames", "row 1: is 7", _spoil("scene_frames", _set(1, 7))),
    ("scene_frames", "", _spoil("scene_frames", lambda a: a[1:])),
    ("unit_poses", "moves after the 2 frames", _spoil("scene_frames", _set(0, 2))),
    ("unit_velocity", "row 3", _spoil("unit_velocity", _set((3, 5), np.inf))),
    ("unit_velocity", "", _spoil("unit_velocity", lambda a: a[:, :3])),
    ("unit_inertia", "row 2: holds", _spoil("unit_inertia", _set((2, 1), np.nan))),
    ("unit_inertia", "row 3: the moments", _spoil("unit_inertia", _set((3, 0), 0))),
    ("unit_inertia", "row 0: the moments", _spoil("unit_inertia", _set((0, 2), -1))),
    ("unit_inertia", "row 1: of the moments", _spoil("unit_inertia", _set((1, 2), 3.01))),
    ("unit_inertia", "", _spoil("unit_inertia", lambda a: a[1:])),
    ("unit_young", "row 3: is 0.0, but unit_soft", _spoil("unit_young", _set(3, 0))),
    ("unit_young", "row 2: is 5.0, but the unit is rigid", _spoil("unit_young", _set(2, 5))),
    ("unit_young", "row 3: is nan", _spoil("unit_young", _set(3, np.nan))),
    ("unit_young", "", _spoil("unit_young", lambda a: a[1:])),
    ("faces", "row 1: .* not all rows of soft points of its scene", _spoil("faces", _set((1, 2), -1))),
    ("faces", "row 0: .* names one of the soft points twice", _spoil("faces", _set((0, 2), 1))),
    ("faces", "", _spoil("faces", lambda a: a[:, :2])),
    ("faces", "is missing", lambda scenes: dataclasses.replace(scenes, faces=None)),
    ("scene_faces", "is missing", lambda scenes: dataclasses.replace(scenes, scene_faces=None)),
    ("scene_faces", "without falling", _spoil("scene_faces", _set(-1, 1))),
    ("scene_faces", "", _spoil("scene_faces", lambda a: a[1:])),
    ("faces", "row 1: .* of its scene", _spoil("scene_faces", _set(1, 1))),
    ("edges", "row 0: .* of its scene", _spoil("edges", _set((0, 0), 10000))),
    ("edges", "", _spoil("edges", lambda a: a.astype(np.int64))),
    ("scene_edges", "without falling", _spoil("scene_edges", _set(2, 0))),
    ("tetrahedra", "row 0: .* twice", _spoil("tetrahedra", _set((0, 3), 0))),
    ("tetrahedra", "", _spoil("tetrahedra", lambda a: a[:, :3])),
    ("scene_tetrahedra", "", _spoil("scene_tetrahedra", _set(0, 1))),
    ("bonds", "row 1: .* not all rows of units of its scene", _spoil("bonds", _set((1, 1), 99))),
    ("bonds", "row 2: .* of its scene", _spoil("bonds", _set((2, 0), 0))),
    ("bonds", "row 0: .* names one of the units twice", _spoil("bonds", _set((0, 1), 0))),
    ("bonds", "is missing", lambda scenes: dataclasses.replace(scenes, bonds=None, scene_bonds=None)),
    ("scene_bonds", "is missing", lambda scenes: dataclasses.replace(scenes, scene_bonds=None)),
    ("bond_frame", "is missing", lambda scenes: dataclasses.replace(scenes, bond_frame=None)),
    ("bond_frame", "row 2: is 7", _spoil("bond_frame", _set(2, 7))),
    ("bond_frame", "row 0: is -1", _spoil("bond_frame", _set(0, -1))),
    ("bond_frame", "", _spoil("bond_frame", lambda a: a[1:])),
    ("frame_rate_hz", "", lambda scenes: dataclasses.replace(scenes, frame_rate_hz=0.0)),
    ("gravity_m_s2", "", lambda scenes: dataclasses.replace(scenes, gravity_m_s2=(0.0, 0.0, float("inf")))),
    *(("contact_law", "restitution_offset", lambda scenes, offset=offset: dataclasses.replace(scenes, contact_law=ContactLaw(offset)))
      for offset in (-0.1, 1.5, float("nan"))),
])
def test_unusable_scenes_of_version_2_are_not_written(tmp_path, everything, field, row, spoil):
    with pytest.raises(SceneFileError, match=f"{field}: .*{row}") as caught:
        write_scenes(tmp_path / "bad.safetensors", spoil(everything))
    assert caught.value.field == field and list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("message, edit", [
    ("tensor planes: is missing", lambda h: h.update(other=h.pop("planes"))),
    ("tensor scene_planes: is missing", lambda h: h.update(other=h.pop("scene_planes"))),
    ("tensor unit_body: is float32", lambda h: h["unit_body"].update(dtype="F32")),
    ("of version 2, the file says that it is of version 1",
     lambda h: h["__metadata__"].update(version="1", ground_friction="0", ground_restitution="0")),
])
def test_bad_files_of_version_2_name_the_field(tmp_path, everything, message, edit):
    path = tmp_path / "bad.safetensors"
    write_scenes(path, everything)
    _edit_header(path, edit)
    with pytest.raises(SceneFileError, match=message):
        read_scenes(path)


# The split


def test_movi_split():
    split = np.array([split_of_seed("movi-b", seed) for seed in range(1, 1201)])
    assert [int((split == s).sum()) for s in (TRAIN, VALIDATION, TEST, EXTRA)] == [960, 120, 120, 0]
    assert all(split_of_seed("movi-a", seed) == TEST for seed in FIRST_TEST_SEEDS)
    # of the split whose free-fall errors equal the reference: see check_movi
    assert hashlib.sha256(split.astype(np.uint8).tobytes()).hexdigest()[:16] == "448bf9941581e893"
    assert split_of_seed("movi-sphere", 1201) == split_of_seed("movi-sphere", 0) == EXTRA


def test_primitives_split():
    assert [split_of_seed("primitives", seed) for seed in (1, 8, 9, 10, 11, 1209, 1210)] == [
        TRAIN, TRAIN, VALIDATION, TEST, TRAIN, VALIDATION, TEST]


# Primitives


def test_primitive_points_lie_on_the_surface():
    for shape in primitive_shapes():
        assert len(shape.points) == (56 if shape.name.startswith("box") else 64)
        assert len(np.unique(shape.points, axis=0)) == len(shape.points)
        np.testing.assert_allclose(shape.points.mean(axis=0), 0, atol=1e-3)  # the origin is the centre of mass
        points = shape.points.astype(np.float64)
        if len(shape.size) == 3:
            np.testing.assert_allclose(np.abs(points / shape.size).max(axis=1), 1, atol=1e-6)
        elif len(shape.size) == 2:
            radius, height = shape.size
            reach = np.maximum(np.hypot(points[:, 0], points[:, 1]) / radius, np.abs(points[:, 2]) / (height / 2))
            np.testing.assert_allclose(reach, 1, atol=1e-6)
        else:
            np.testing.assert_allclose(np.linalg.norm(points, axis=1), shape.size[0], atol=1e-6)


def test_primitives_are_deterministic():
    first, again, other = (simulate("primitives", primitive_shapes(), seed, 4) for seed in (5, 5, 6))
    assert first.shape == again.shape and first.physics == again.physics
    np.testing.assert_array_equal(first.poses, again.poses)
    assert first.physics != other.physics


def test_primitives_start_apart_in_the_region_and_fall_freely():
    scene = simulate("primitives", primitive_shapes(), 3, 4)
    assert 3 <= len(scene.shape) <= 10
    positions = scene.poses[:, :, :3]
    assert np.all(np.abs(positions[:, 0, :2]) <= 5) and np.all(positions[:, 0, 2] > 1)
    acceleration = (positions[:, 2:] - 2 * positions[:, 1:-1] + positions[:, :-2]) * 240**2
    np.testing.assert_allclose(acceleration - [0, 0, -10], 0, atol=1e-6)


def test_primitives_come_to_lie_on_the_floor():
    scene = simulate("primitives", primitive_shapes(), 3, 720)
    assert scene.poses[:, :, 2].min() > 0.1
    assert scene.poses[:, -1, 2].max() < 3


# The command


def _movi(*arguments):
    return subprocess.run([sys.executable, "-m", "rigidformer_lab.movi", *map(str, arguments)], capture_output=True,
                          text=True)


def test_an_interrupted_run_continues_with_the_same_bytes(tmp_path, monkeypatch):
    monkeypatch.setattr(movi, "SEEDS_PER_SHARD", 2)
    recipe = Recipe("primitives", 1, 5, 3, None)
    movi.generate(recipe, tmp_path / "whole", 1)
    real, calls = movi.concatenate, []

    def interrupt(parts):
        calls.append(len(parts))
        raise KeyboardInterrupt
    monkeypatch.setattr(movi, "concatenate", interrupt)
    with pytest.raises(KeyboardInterrupt):
        movi.generate(recipe, tmp_path / "resumed", 1)
    assert calls == [3] and not (tmp_path / "resumed").exists()
    shards = sorted((tmp_path / "resumed.parts").glob("seeds-*"))
    shards[1].unlink()
    kept = shards[0].stat().st_mtime_ns

    with pytest.raises(SceneFileError, match="other arguments"):
        movi.generate(dataclasses.replace(recipe, frames=4), tmp_path / "resumed", 1)
    assert shards[0].stat().st_mtime_ns == kept

    monkeypatch.setattr(movi, "concatenate", real)
    movi.generate(recipe, tmp_path / "resumed", 1)
    assert (tmp_path / "resumed").read_bytes() == (tmp_path / "whole").read_bytes()
    assert not (tmp_path / "resumed.parts").exists()


def test_bad_arguments(tmp_path):
    assert "needs --assets" in _movi("movi-a", "--out", tmp_path / "x").stderr
    assert "at least 1" in _movi("primitives", "--out", tmp_path / "x", "--seeds", 0).stderr
    result = _movi("movi-a", "--assets", tmp_path, "--out", tmp_path / "x")
    assert result.returncode == 1 and "error:" in result.stderr and "--assets takes" in result.stderr
    assert "Traceback" not in result.stderr


def test_broken_urdfs_are_reported(tmp_path, assets):
    copy = tmp_path / "assets"
    shutil.copytree(assets, copy)
    (copy / "sphere" / "object.urdf").write_text("<robot")
    result = _movi("movi-sphere", "--assets", copy, "--out", tmp_path / "x", "--seeds", 1, "--frames", 1)
    assert result.returncode == 1 and "PyBullet" in result.stderr and "Traceback" not in result.stderr


# The measures


def test_free_fall_follows_the_parabola_and_spin():
    angle, dt, gravity = 0.02, 1 / 240, np.array([0.0, 0.0, -10.0])
    frames = np.arange(11)
    poses = np.zeros((1, 11, 7))
    poses[0, :, :3] = np.array([1.0, -2.0, 3.0]) * frames[:, None] * dt + gravity * (frames[:, None] * dt) ** 2 / 2
    poses[0, :, 3], poses[0, :, 5] = np.cos(frames * angle / 2), np.sin(frames * angle / 2)
    predicted = check_movi.free_fall(poses, 2, 10, gravity, dt)
    np.testing.assert_allclose(predicted, poses[:, 2:], atol=1e-12)
    turned = poses[:, 10].copy()
    turned[:, 0] += 0.5
    position, rms, mean = check_movi.scene_errors(turned, poses[:, 9])
    assert rms == pytest.approx(np.degrees(angle)) and mean == pytest.approx(rms)
    assert check_movi.scene_errors(turned, poses[:, 10])[0] == pytest.approx(0.5)


# MOVi, with the assets


@pytest.mark.parametrize("dataset, points", [("movi-a", 51 + 64 + 64), ("movi-b", 4988), ("movi-sphere", 64)])
def test_movi_scenes(assets, dataset, points):
    recipe = Recipe(dataset, 1, 2, 4, assets)
    scenes = make_scenes(recipe, range(1, 3))
    assert scenes.frames == 4 and len(scenes.shape_points) == points
    positions = scenes.unit_poses[:, :, :3].astype(np.float64)
    acceleration = (positions[:, 2:] - 2 * positions[:, 1:-1] + positions[:, :-2]) * 240**2
    np.testing.assert_allclose(acceleration - [0, 0, -10], 0, atol=0.2)  # F32 at 5 m, differenced twice
    again = make_scenes(recipe, range(1, 3))
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(scenes, name), getattr(again, name))
