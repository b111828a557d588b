"""Packed files and their errors are those of the program, byte for byte."""

from __future__ import annotations

import json
import os
import subprocess
import types
from pathlib import Path

import pytest

import rigidformer as rf
from conftest import MODELS, at, cube
from test_bits import run

EDGE, NANO = MODELS / "edge.rfm", MODELS / "nano-f32.rfm"


def falling(path: Path, split: str, frames: int = 40) -> Path:
    """A scene file with a cube that falls."""
    poses = [[at(z=2 - 4.9 * (frame / 60) ** 2)] for frame in range(frames)]
    scene = rf.Scene([rf.Unit(cube())], poses, 60, planes=[rf.Plane([0, 0, 1])], split=split)
    scene.save(path, dataset="test", provenance="the test", licence="none")
    return path


def both(program: str, folder: Path, source: Path, arguments: list, **settings) -> None:
    """Packs by both, and compares files and what is said of them."""
    ours, theirs = folder / "ours.rfm", folder / "theirs.rfm"
    said = json.loads(run(program, "pack", source, *arguments, "--out", theirs, "--json"))
    assert rf.pack(source, ours, **settings) == said
    assert ours.read_bytes() == theirs.read_bytes()


def test_types_of_weights(program, tmp_path):
    both(program, tmp_path, NANO, ["--dtype", "i8"], dtype="i8")
    both(program, tmp_path, NANO, ["--dtype", "i8", "--panels"], dtype="i8", panels=True)
    wide = "encoder.fuse.1"
    both(program, tmp_path, NANO, ["--dtype", "i8", "--wide", wide], dtype="i8", wide=[wide])


@pytest.mark.parametrize("name", ["all", "near"])
def test_scopes(program, tmp_path, name):
    both(program, tmp_path, EDGE, ["--scope", name], scope=name)


def test_provenance(program, tmp_path):
    known = next(iter(rf.Model(EDGE).provenance))
    # Not in the order of the alphabet: files keep that of the texts.
    entries = {"run 2": "seeds 1-1200, 92 min", known: "another", "run 1": 'a "text"'}
    path = tmp_path / "runs.toml"
    path.write_text("".join(f"{json.dumps(key)} = {json.dumps(text)}\n" for key, text in entries.items()))
    both(program, tmp_path, EDGE, ["--provenance", path], provenance=entries)
    both(program, tmp_path, EDGE, ["--provenance", path], provenance=types.MappingProxyType(entries))
    assert rf.Model(tmp_path / "ours.rfm").provenance[known] == "another"


def test_ranges(program, tmp_path):
    scenes = [falling(tmp_path / f"{split}.safetensors", split) for split in ("train", "extra")]
    both(program, tmp_path, EDGE, ["--ranges", *scenes], ranges=scenes)
    measured = tmp_path / "measured.rfm"
    os.replace(tmp_path / "ours.rfm", measured)
    both(program, tmp_path, NANO, ["--ranges", measured], ranges=[measured])


def test_files_that_cannot_be_packed(program, tmp_path):
    """The program says the same."""
    test, short = falling(tmp_path / "test.safetensors", "test"), falling(tmp_path / "short.safetensors", "train", 3)
    no_model, none = falling(tmp_path / "scene.safetensors", "train"), tmp_path / "none.rfm"
    empty = tmp_path / "empty.toml"
    empty.write_text('"" = "a"\n')
    out = tmp_path / "out.rfm"
    for source, arguments, settings in [
        (no_model, ["--scope", "all"], {"scope": "all"}),
        (no_model, ["--provenance", empty], {"provenance": {"": "a"}}),
        (no_model, ["--ranges", test], {"ranges": [test]}),
        (none, ["--scope", "all"], {"scope": "all"}),
        (MODELS / "shell.rfm", ["--scope", "near"], {"scope": "near"}),
        (EDGE, ["--provenance", empty], {"provenance": {"": "a"}}),
        (EDGE, ["--ranges", test], {"ranges": [test]}),
        (EDGE, ["--ranges", short], {"ranges": [short]}),
        (EDGE, ["--ranges", none], {"ranges": [none]}),
        (EDGE, ["--ranges", EDGE, test], {"ranges": [EDGE, test]}),
        (NANO, ["--dtype", "i8", "--wide", "x"], {"dtype": "i8", "wide": ["x"]}),
        (MODELS / "nano.rfm", ["--dtype", "i8"], {"dtype": "i8"}),
    ]:
        command = [program, "pack", source, *arguments, "--out", out]
        done = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=600)
        with pytest.raises(rf.RigidFormerError) as raised:
            rf.pack(source, out, **settings)
        # Python names its arguments, the program its options.
        said, told = (text.replace("--", "") for text in (str(raised.value), done.stderr))
        assert done.returncode != 0 and said in told, done.stderr
        assert isinstance(raised.value, rf.FileError) == (none in (source, *settings.get("ranges", [])))
        assert not out.exists()


def test_settings_that_cannot_be(tmp_path):
    out = tmp_path / "out.rfm"
    for settings, error, text in [
        ({"scope": "some"}, rf.InputError, "give all or near"),
        ({"scope": "all", "panels": True}, rf.InputError, "scope cannot be used with panels"),
        ({"scope": "all", "dtype": "i8"}, rf.InputError, "scope cannot be used with dtype"),
        ({"scope": "all", "provenance": {"a": "b"}}, rf.InputError, "provenance cannot be used with scope"),
        ({"ranges": [EDGE], "wide": ["x"]}, rf.InputError, "ranges cannot be used with wide"),
        ({"ranges": []}, rf.InputError, "no free units"),
        ({"ranges": str(EDGE)}, TypeError, "ranges"),
        ({"provenance": {}}, rf.InputError, "has no entries"),
        ({"provenance": {"a": 1}}, TypeError, "a: is of type int, not a text"),
        ({"provenance": {1: "a"}}, TypeError, "a key: is of type int"),
        ({"provenance": "a"}, TypeError, "provenance"),
    ]:
        with pytest.raises(error, match=text):
            rf.pack(EDGE, out, **settings)
        assert not out.exists()


def test_a_failed_call_leaves_the_file(tmp_path):
    out = tmp_path / "out.rfm"
    out.write_bytes(b"mine")
    with pytest.raises(rf.InputError):
        rf.pack(MODELS / "shell.rfm", out, scope="near")
    assert out.read_bytes() == b"mine"
