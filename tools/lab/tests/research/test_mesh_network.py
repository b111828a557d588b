"""The network on meshes that models of soft bodies are measured against."""

import json

import pytest
import torch

from rigidformer_lab.research import mesh_network, unseen
from rigidformer_lab.scenes import write_scenes
from rigidformer_lab.shell import Recipe


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """Three scenes: to learn from, to validate and to test with."""
    path = tmp_path_factory.mktemp("scenes") / "shell.safetensors"
    write_scenes(path, Recipe(8, 3, 60).make(range(8, 11)))
    return path


def test_a_run_learns_resumes_and_is_measured(scenes, tmp_path, capsys):
    run = ["--run", str(tmp_path / "run"), "--horizon", "2", "--slots", "2"]
    learn = [*run, "--data", str(scenes), "--minutes"]
    assert mesh_network.main([*learn, "1e-9"]) == 0
    first = torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=False)
    assert first["updates"] == 1 and first["spent"] > 0
    said = capsys.readouterr().err
    assert "1 scenes" in said and "'validation': {25:" in said
    assert mesh_network.main([*learn, "1e-9"]) == 0  # its time is spent
    assert torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=False)["updates"] == 1
    assert mesh_network.main([*learn, str(first["spent"] / 60 + 1e-9)]) == 0
    second = torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=False)
    assert second["updates"] == 2 and second["spent"] > first["spent"]
    changed = [name for name, value in second["model"].items() if not torch.equal(value, first["model"][name])]
    assert "out.4.weight" in changed
    capsys.readouterr()
    assert mesh_network.main([*run, "--test", str(scenes)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["scenes"] == 1 and set(found["vertex_m"]) == {"25", "50"} and found["vertex_m"]["25"] > 0


@pytest.mark.parametrize(
    "wrong, says",
    [
        ([], "--data --test"),
        (["--data", "SCENES", "--test", "SCENES"], "not allowed with"),
        (["--data", "none.safetensors"], "none.safetensors: no such file"),
        (["--test", "SCENES"], "train with --data first"),
        (["--data", "SCENES", "--minutes", "0"], "--minutes must be above 0"),
        (["--data", "SCENES", "--lr", "nan"], "--lr must be above 0"),
        (["--data", "SCENES", "--noise", "-1"], "--noise must be at least 0"),
        (["--data", "SCENES", "--slots", "0"], "--slots"),
        (["--data", "SCENES", "--step", "60"], "has no frame 60"),
    ],
)
def test_wrong_arguments_are_named(wrong, says, scenes, tmp_path, capsys):
    with pytest.raises(SystemExit) as error:
        mesh_network.main(["--run", str(tmp_path), *(str(scenes) if word == "SCENES" else word for word in wrong)])
    assert error.value.code == 2 and says in capsys.readouterr().err


def test_scenes_that_it_cannot_be_told_of_are_refused(tmp_path):
    write_scenes(tmp_path / "x", unseen.ShellOnTwo(8, 2, 8).make(range(8, 10)))
    with pytest.raises(SystemExit, match="shell-on-two-8: has other planes than the ground, or other rigid units"):
        mesh_network.main(["--run", str(tmp_path), "--data", str(tmp_path / "x")])
