"""Grasps: drawn by a seed, recorded by MuJoCo, predicted by the runtime."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from conftest import needed

needed("mujoco")

from rigidformer_lab import grasp  # noqa: E402

MODEL = Path(__file__).resolve().parents[3] / "weights" / "models" / "edge-i8.rfm"
#: A box of 100 g in the middle, by a drive that could hold five of them.
SURE = grasp.Grasp("box", (0.02, 0.02, 0.03), 0.1, 0.5, 0.0, (0.0, 0.01), 0.035, 5.0)
WEAK = dataclasses.replace(SURE, force_n=0.3)
ASIDE = dataclasses.replace(SURE, aside=(0.08, 0.0))


def test_a_seed_draws_one_grasp():
    assert grasp.draw(7) == grasp.draw(7) != grasp.draw(8)
    kinds = {grasp.draw(seed).kind for seed in range(20)}
    assert kinds == {"box", "cylinder"}
    seeds = grasp.seeds_that_fit(1, 30)
    assert len(seeds) == 30 and all(grasp.fits(grasp.draw(seed)) for seed in seeds)
    assert not grasp.fits(dataclasses.replace(SURE, aside=(0.0, 0.03)))


@pytest.mark.parametrize(("tried", "known"), [(SURE, grasp.HELD), (WEAK, grasp.SLIPPED), (ASIDE, grasp.MISSED)])
def test_the_engine_and_the_runtime_agree_on_clear_cases(tried, known):
    rigidformer = needed("rigidformer")
    recorded, predicted = grasp.record(tried), grasp.predict(rigidformer.Model(MODEL), tried)
    assert recorded["outcome"] == predicted["outcome"] == known
    assert recorded["poses"].shape == predicted["poses"].shape == (round(grasp.END_S / grasp.STEP_S) + 1, 7)
    metres, degrees = grasp.apart(recorded["poses"][-1], predicted["poses"][-1])
    assert metres < 0.005 and degrees < 3


def test_what_is_held_hangs_where_the_jaws_are():
    poses = grasp.record(SURE)["poses"]
    lifted = round((grasp.REST_S + grasp.CLOSE_S + grasp.LIFT_S) / grasp.STEP_S)
    assert abs(poses[lifted][2] - poses[0][2] - grasp.LIFT_M) < 1e-3
    # The sliding jaw pushed it against the fixed one.
    assert abs(poses[lifted][1] + grasp.OPEN_M - SURE.half[1]) < 1e-3


def test_the_command_tells_how_many_are_right(tmp_path, capsys):
    needed("rigidformer")
    out = tmp_path / "grasps.json"
    assert grasp.main(["--model", str(MODEL), "--seeds", "2", "--json", str(out)]) == 0
    assert "of 2 outcomes are right" in capsys.readouterr().out
    document = json.loads(out.read_text())
    assert document["grasps"] == len(document["rows"]) == 2
    assert sum(sum(row.values()) for row in document["table"].values()) == 2
    assert grasp.main(["--model", str(MODEL), "--seeds", "1", "--choose", "2", "--no-network", "--json", str(out)]) == 0
    assert json.loads(out.read_text())["objects"] == 1
    with pytest.raises(SystemExit):
        grasp.main(["--model", str(MODEL), "--seeds", "0"])


def test_turns_and_places_are_told_apart():
    still = np.array((0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
    turned = np.array((0.0, 0.003, 0.004, np.cos(0.1), 0.0, 0.0, -np.sin(0.1)))
    metres, degrees = grasp.apart(still, turned)
    assert metres == pytest.approx(0.005) and degrees == pytest.approx(np.degrees(0.2))
