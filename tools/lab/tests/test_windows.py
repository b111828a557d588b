"""What the runtime says that the network sees, beside the lab's own; and training on it. Needs the runtime's package."""

import dataclasses
import json
import pathlib
import sys

import numpy as np
import pytest
import torch
from conftest import needed

from safetensors import safe_open

from rigidformer_lab import export, train_steps, windows
from rigidformer_lab.config import PRESETS
from rigidformer_lab.data import Dataset, state_at
from rigidformer_lab.model import RigidFormer, transform
from rigidformer_lab.scenes import TRAIN, read_scenes, write_scenes

needed("rigidformer")

SHIPPED = pathlib.Path(__file__).parents[3] / "bindings/python/scenes/default.safetensors"
CONFIG = PRESETS["edge"]


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """A scene to learn from."""
    path = tmp_path_factory.mktemp("scenes") / "falling.safetensors"
    file = read_scenes(SHIPPED)
    write_scenes(path, dataclasses.replace(file, scene_split=np.full(len(file.scene_split), TRAIN, file.scene_split.dtype)))
    return path


@pytest.fixture(scope="module")
def collected(scenes, tmp_path_factory):
    folder = tmp_path_factory.mktemp("windows") / "w"
    arrays = windows.collect([scenes], [0], CONFIG, 150, [1, 5, 10], points=24, latest=110)
    windows.write(folder, arrays, windows.described([scenes], CONFIG, {"steps": [1, 5, 10], "splits": [0]}))
    return folder, arrays


def test_the_runtime_sees_what_the_lab_does(scenes, tmp_path):
    import rigidformer

    dataset = Dataset([scenes], [0], last_frame=110)
    look, scene = windows.look(CONFIG, tmp_path), rigidformer.Dataset(scenes).scene(0)
    drawn = windows.drawn(dataset, 0, np.random.default_rng(1), [1, 5, 10], 24, 1.0, 110)
    assert len(drawn) > 8
    count = int(dataset.count[dataset.units.shape].min())
    told = np.tile(np.arange(count), (len(dataset.units.shape), 1))
    seen = rigidformer.network_inputs(look, scene, drawn, points=told.tolist())
    arrays, counts, codes = windows.rows_of(dataset, 0, CONFIG, drawn, seen, told, np.random.default_rng(0))
    model, row, kept, others = RigidFormer(CONFIG), 0, 0, 0
    for number, (first, step) in enumerate(drawn):
        here = seen["window"] == number
        if not (seen["uncorrected"][here, 18] > 0).any():
            continue
        unit = seen["unit"][here]
        own = {name: values[row : row + counts[kept]] for name, values in arrays.items()}
        scene_, rotation, centre, _ = dataset.tensors([(0, first, step)], [np.arange(len(dataset.units.shape))], 1, None, False)
        state = state_at(rotation, centre, 1)
        prior = model.prior(scene_, state)
        measured = model.measured(scene_)
        assert codes[kept] == pytest.approx(float(model.code(measured)), rel=1e-5)
        row, kept = row + counts[kept], kept + 1
        # Numbers of half precision; the way since the begin is since a frame that is drawn.
        raw = model.features(scene_, state)[0].numpy()[unit][:, :count]
        off = np.abs(raw - own["features"]) / (1 + np.abs(raw))
        off[..., windows.OFFSET] = 0
        assert off.max() < 2e-3
        impacts, valid, pushes = (values[0].numpy()[unit] for values in model.impacts(scene_, state, prior))
        assert (valid.sum(-1) == own["impact_count"]).all()
        assert (np.abs(impacts - own["impacts"]) / (1 + np.abs(impacts)) * valid[..., None]).max() < 5e-3
        if np.abs(pushes - own["pushes"]).max() > 2e-3:  # rounding decided what touches first
            others += 1
            continue
        counts_here = own["share"] > 0  # the others are not corrected, or the record says nothing of them
        assert np.abs(prior.share[0].numpy()[unit] - own["share"])[counts_here].max() < 1e-4
        dt, local = model.dt(measured)[:, None, None, None], measured.points[:, :, :4]
        places = centre / measured.length[:, None, None, None]
        way = (transform(rotation[:, :, 2], places[:, :, 2], local) - transform(prior.rotation, prior.centre, local)) / dt
        assert np.abs(way[0].numpy()[unit] - own["wanted"][..., :3]).max() < 2e-3
    assert kept == len(counts) > 4 and others <= kept / 10


def test_draws_do_not_depend_on_threads(scenes, collected):
    again = windows.collect([scenes], [0], CONFIG, 150, [1, 5, 10], points=24, latest=110, threads=1)
    for name, values in collected[1].items():
        assert np.array_equal(values, again[name]), name
    other = windows.collect([scenes], [0], CONFIG, 150, [1, 5, 10], points=24, latest=110, seed=1)
    assert not np.array_equal(collected[1]["place"], other["place"])


def test_turned_and_moved_windows_are_the_same_to_the_geometry(collected):
    batches = train_steps.Batches([collected[0]])
    chosen = batches.draw(np.random.default_rng(0), 24)[0]
    plain, other = batches.tensors(chosen, "cpu"), batches.tensors(chosen, "cpu", np.random.default_rng(2))
    assert not torch.equal(plain[1], other[1])
    for begin in windows.POINT_VECTORS:
        a, b = (t[1][..., begin : begin + 3].norm(dim=-1) for t in (plain, other))
        assert torch.allclose(a, b, rtol=1e-3, atol=1e-3)
    rest = [k for k in range(34) if not any(at <= k < at + 3 for at in windows.POINT_VECTORS)]
    assert torch.equal(plain[1][..., rest], other[1][..., rest])
    assert torch.allclose(plain[5][0].norm(dim=-1), other[5][0].norm(dim=-1), atol=1e-4)
    # The turn of the wanted ways is that of the inputs: their product with the push stays.
    a, b = ((t[5][0][..., :3] * t[3][2][..., :3]).sum(-1) for t in (plain, other))
    assert torch.allclose(a, b, atol=1e-3)


def test_a_model_learns_from_a_head_of_zeros_and_goes_on(collected, tmp_path, monkeypatch, capsys):
    run = tmp_path / "run"
    small = {"width": 32, "heads": 2, "head_dim": 16, "blocks": 2, "point_width": 32, "feed_forward_width": 64, "avp_width": 16,
             "film_width": 8, "scales": [0, 2], "registers": 2}  # fmt: skip
    command = ["train_steps", str(collected[0]), "--validation", str(collected[0]), "--run", str(run), "--config", json.dumps(small),
               "--lr", "3e-3", "--no-bf16", "--slots", "64", "--threads", "1"]  # fmt: skip
    monkeypatch.setattr(sys, "argv", [*command, "--updates", "40"])
    train_steps.main()
    saved = torch.load(run / "checkpoint.pt", weights_only=False)
    monkeypatch.setattr(sys, "argv", [*command, "--updates", "200"])
    train_steps.main()
    after = torch.load(run / "checkpoint.pt", weights_only=False)
    assert after["updates"] > saved["updates"]
    lines = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
    found = [line["validation"] for line in lines if "validation" in line]
    assert found[-1]["way_m_s"] < found[0]["way_m_s"]
    assert "resumed" in capsys.readouterr().err
    monkeypatch.setattr(sys, "argv", ["export", str(run / "checkpoint.pt"), "--out", str(tmp_path / "model.safetensors")])
    export.main()
    with safe_open(tmp_path / "model.safetensors", "numpy") as file:
        provenance = json.loads(file.metadata()["provenance"])
    assert "windows of falling; splits train" in provenance["run 1"] and "single steps, 24 points a unit" in provenance["run 1"]


def test_a_folder_that_is_none_is_refused(tmp_path):
    with pytest.raises(SystemExit, match="is no folder of windows"):
        windows.read(tmp_path)
