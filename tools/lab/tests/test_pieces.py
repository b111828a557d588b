"""Convex pieces: of meshes, in scene files, and in contact."""

import dataclasses

import numpy as np
import pytest

from rigidformer_lab import data, pieces
from rigidformer_lab.geometry import prepare_points
from rigidformer_lab.movi import Recipe, make_scenes
from rigidformer_lab.scenes import SceneFileError, read_scenes, write_scenes
from rigidformer_lab.solver import PIECES, Motion, advance, in_one_piece, keep_apart, meetings, parts, room
from rigidformer_lab.solver_cases import pieces_of, world


@pytest.fixture(scope="module")
def plain():
    return make_scenes(Recipe("primitives", 1, 2, 12, None), range(1, 3))


def arc(start, end, inner=0.8):
    """A part of a ring from one angle to another."""
    return np.array([
        [radius * np.cos(angle), radius * np.sin(angle), z]
        for z in (0, 0.2) for radius in (inner, 1.0) for angle in (start, end)
    ])  # fmt: skip


def ring(count):
    at = np.linspace(0, 2 * np.pi, count + 1)
    return [arc(a, b) for a, b in zip(at, at[1:])]


def volume(found):
    return sum(pieces._volume(piece) for piece in found)


def test_neighbours_of_a_ring_merge_and_its_hole_stays():
    whole, half = ring(24), pieces.merged(ring(24), 12)
    assert len(half) == 12 and volume(half) < 1.1 * volume(whole)
    assert volume(half) < 0.6 * volume([np.concatenate(half)])
    assert len(pieces.merged(ring(40))) == PIECES


def test_the_centre_of_pieces_is_that_of_the_body_whatever_its_points():
    table = [piece.astype(np.float32) for piece in pieces_of(0.4, -0.2, 0.3)]
    volumes = np.array([pieces._volume(piece) for piece in table])
    true = (volumes[:, None] * [piece.mean(0) for piece in table]).sum(0) / volumes.sum()
    np.testing.assert_allclose(pieces.centre_of(table), true, atol=1e-6)
    far = [piece + np.float32(1000) for piece in table]
    np.testing.assert_allclose(pieces.centre_of(far), true + 1000, atol=1e-3)
    assert pieces.centre_of([table[0][:4]]) is None, "flat"
    _, centre = prepare_points(np.concatenate(table), pieces.centre_of(table))
    np.testing.assert_allclose(centre, true, atol=1e-6)


def test_obj_files_have_groups(tmp_path):
    lines, first = [], 1
    for number, piece in enumerate(ring(3)):
        lines += [f"o part{number}", *("v " + " ".join(map(str, point)) for point in piece)]
        lines += [f"f {first} {first + 1} {first + 2}", f"f {first + 4}/1 {first + 5} {first + 7} {first + 6}"]
        first += len(piece)
    path = tmp_path / "ring.obj"
    path.write_text("\n".join(lines))
    assert [len(piece) for piece in pieces.read_pieces(path)] == [7, 7, 7], "corners that faces name"
    path.write_text("\n".join(lines[:11]))
    assert pieces.read_pieces(path) == [], "one group is one hull"
    path.write_text("v 0 0 x\n")
    with pytest.raises(pieces.MeshError, match="ring.obj"):
        pieces.read_pieces(path)


def with_pieces(scenes, given):
    return dataclasses.replace(scenes, **pieces.file_pieces(given))


def test_files_keep_pieces_and_refuse_bad_ones(tmp_path, plain):
    shapes = len(plain.shape_names)
    given = [[arc(0, 1).astype(np.float32), arc(1, 2).astype(np.float32)]] + [[] for _ in range(shapes - 1)]
    scenes = with_pieces(plain, given)
    path = tmp_path / "x.safetensors"
    write_scenes(path, scenes)
    found = read_scenes(path)
    assert found.version == "2" and len(found.pieces_of_shape(0)) == 2 and not found.pieces_of_shape(shapes - 1)
    for own, back in zip(given[0], found.pieces_of_shape(0)):
        np.testing.assert_array_equal(own, back)
    for name, problem in (
        ("piece_points", {"piece_points": np.full_like(scenes.piece_points, np.nan)}),
        ("piece_offsets", {"piece_offsets": scenes.piece_offsets + np.array([0, 1, 0])[: len(scenes.piece_offsets)] * 6}),
        ("shape_pieces", {"shape_pieces": np.arange(shapes + 1, dtype=np.int64)}),
        ("piece_points", {"piece_points": None}),
    ):
        with pytest.raises(SceneFileError) as error:
            write_scenes(path, dataclasses.replace(scenes, **problem))
        assert error.value.field == name
    many = with_pieces(plain, [[arc(0, 1).astype(np.float32)] * 33] + [[] for _ in range(shapes - 1)])
    with pytest.raises(SceneFileError, match="more than 32"):
        write_scenes(path, many)
    far = dataclasses.replace(scenes, piece_points=scenes.piece_points * 1000)
    with pytest.raises(SceneFileError, match="both in metres"):
        write_scenes(path, far)


def test_datasets_have_the_pieces_of_shapes(tmp_path, plain):
    given = [[arc(0, 1).astype(np.float32), arc(3, 4).astype(np.float32)]] + [[] for _ in plain.shape_names[1:]]
    path = tmp_path / "x.safetensors"
    write_scenes(path, with_pieces(plain, given))
    split = int(plain.scene_split[0])
    dataset = data.Dataset([path], [split], last_frame=plain.frames - 1)
    assert dataset.piece_count[0] == 2 and (dataset.piece_count[1:] == 1).all()
    rows = dataset.piece_bank[dataset.piece_start[0]]
    centre = pieces.centre_of(given[0])
    np.testing.assert_allclose(dataset.hull_bank[rows[0] : rows[0] + rows[1]], given[0][0] - centre, atol=1e-6)
    np.testing.assert_allclose(dataset.centres[0], centre, atol=1e-6)


@pytest.mark.parametrize("hollow", [True, False])
def test_what_is_under_a_table_does_not_touch_it(hollow):
    w = world([[0.3, -0.2, 0.2], [0.05, 0.05, 0.05]], np.ones(2), np.full(2, 0.7), np.full(2, 0.5))
    if not hollow:
        first, number, piece, ball = in_one_piece(w.start, w.count, w.radius)
        w = w._replace(first=first, pieces=number, piece=piece, ball=ball)
    motion = Motion(np.tile(np.eye(3), (2, 1, 1)), np.array([[0, 0, 0.2], [0, 0, 0.12]]), np.zeros((2, 3)), np.zeros((2, 3)))
    contacts = room(2)
    for _ in range(480):
        count = advance(w, motion, 1 / 240, parts(1 / 240), *contacts)[1]
        keep_apart(w, motion, *meetings(contacts[0], count))
    stands = np.linalg.norm(motion.centre[0] - [0, 0, 0.2]) < 5e-3 and abs(motion.centre[1, 2] - 0.05) < 2e-3
    assert stands == hollow, motion.centre
