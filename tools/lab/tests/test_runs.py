"""What a model says of the runs behind it."""

import pathlib

import numpy as np
import pytest
import torch
from safetensors.numpy import save_file

from rigidformer_lab import export, packed


def scene_file(path):
    save_file({"scene_seed": np.array([1, 7, 12, 30], np.int64), "scene_split": np.array([0, 2, 3, 1], np.uint8)}, path)
    return path


def checkpoint(path, **more):
    arguments = {"data": ["/far/movi-a.safetensors"], "lr": 1.5e-3, "steps": [1, 5], "horizon": 6, "points": 32,
                 "slots": 192, "seed": 4, "late": True, "masked": 0.25, "start_from": None}  # fmt: skip
    torch.save({"arguments": arguments, "spent": 90.0, "updates": 12, "seen": 345, **more}, path)
    return path


def test_data_are_described_by_the_seeds_that_are_learnt_from(tmp_path):
    assert export.described([scene_file(tmp_path / "a.safetensors")]) == "a (seeds 1-12, 2 scenes); splits train and extra"


def test_runs_of_a_checkpoint_are_those_before_it_and_its_own(tmp_path):
    more = {"data": "a (seeds 1-12, 2 scenes)", "resumed": ["resumed at minute 1.0 with lr 2"]}
    path = checkpoint(tmp_path / "x.pt", runs=["the first"], **more)
    first, own = export.runs_of(path)
    assert first == "the first"
    assert own == (
        "a (seeds 1-12, 2 scenes); 1.5 min, 12 updates, 345 windows; learning rate 0.0015 to 1.5e-05; step codes 1 5; "
        "horizon 6, 32 points a unit, about 192 units a batch; late frames yes, masked 0.25; seed 4; "
        "resumed at minute 1.0 with lr 2"
    )
    older = export.runs_of(checkpoint(tmp_path / "y.pt"))
    assert len(older) == 1 and older[0].startswith("movi-a; splits train and extra; 1.5 min")


def test_only_what_matters_counts_as_changed():
    before = {"data": ["/x/a.safetensors"], "lr": 1e-3, "run": "one", "minutes": 5, "start_from": "/x/edge.rfm"}
    assert export.changed(before, dict(before, run="two", minutes=9)) == ""
    after = dict(before, data=["/x/a.safetensors", "/x/b.safetensors"], lr=2e-3)
    assert export.changed(before, after) == "data a b instead of a, lr 0.002 instead of 0.001"


def string(text):
    return bytes([len(text)]) + text.encode()


@pytest.mark.parametrize(
    ("provenance", "runs"),
    [
        ({"run 1": "a", "run 2": "b", "data": "c"}, ["a", "b"]),
        ({"data": "movi-a", "trained": "5 min", "steps": "1 5"}, ["movi-a; 5 min; step codes 1 5"]),
        ({}, ["not known"]),
    ],
)
def test_runs_of_a_packed_model(tmp_path, monkeypatch, provenance, runs):
    entries = b"".join(string(key) + string(value) for key, value in provenance.items())
    cursor = packed.Cursor(bytes([len(provenance)]) + entries)
    monkeypatch.setattr(packed, "opened", lambda path: (cursor, b""))
    assert export.runs_of(tmp_path / "x.rfm") == runs


@pytest.mark.parametrize(("model", "runs"), [("edge", 5), ("nano-f32", 3), ("g1", 3)])
def test_the_committed_models_say_all_their_runs(model, runs):
    path = pathlib.Path(__file__).parents[3] / "weights" / "models" / f"{model}.rfm"
    assert len(export.runs_of(path)) == runs
    assert "encoder.point.0.weight" in packed.read_weights(path)
