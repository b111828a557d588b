"""Work shared out to Dask's workers: two processes here."""

import json
import operator
import sys
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pytest
import torch

from conftest import needed
from rigidformer_lab import contacts, evaluate, far, movi
from rigidformer_lab.config import PRESETS, ModelConfig
from rigidformer_lab.model import RigidFormer
from rigidformer_lab.scenes import write_scenes


@pytest.fixture(scope="module")
def address():
    """Of a scheduler with two workers."""
    distributed = needed("distributed", reason="Dask is not installed: pip install -e '.[dask]'")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        with distributed.Client(cluster, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)
        yield cluster.scheduler_address


@pytest.mark.parametrize(
    ("main", "arguments"),
    [(contacts.main, ("--kinds", "slide")), (movi.main, ("primitives",))],
)
def test_scenes_are_the_same_bytes(main, arguments, address, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(movi, "SEEDS_PER_SHARD", 2)
    few = [*arguments, "--seeds", "5", "--frames", "3", "--workers", "1"]
    assert main([*few, "--out", str(tmp_path / "here")]) == 0
    assert main([*few, "--out", str(tmp_path / "far"), "--dask", address]) == 0
    assert "5 scenes" in capsys.readouterr().out
    assert (tmp_path / "here").read_bytes() == (tmp_path / "far").read_bytes()
    assert not (tmp_path / "far.parts").exists()


def test_interrupted_scenes_continue(address, tmp_path, monkeypatch):
    monkeypatch.setattr(movi, "SEEDS_PER_SHARD", 1)
    recipe = contacts.Recipe(1, 4, 3, kinds=("roll",))
    movi.generate(recipe, tmp_path / "whole", 1)
    real, asked = far.results, []

    def interrupted(where, function, jobs, common):
        asked.append(len(jobs))
        for count, made in enumerate(real(where, function, jobs, common)):
            if count == 2 and len(asked) == 1:
                raise KeyboardInterrupt
            yield made

    monkeypatch.setattr(far, "results", interrupted)
    with pytest.raises(KeyboardInterrupt):
        movi.generate(recipe, tmp_path / "resumed", 1, address)
    movi.generate(recipe, tmp_path / "resumed", 1, address)
    assert asked == [4, 2]
    assert (tmp_path / "resumed").read_bytes() == (tmp_path / "whole").read_bytes()


@pytest.fixture
def trained(tmp_path):
    """A checkpoint that was never trained, and scenes of more than one batch."""
    torch.manual_seed(0)
    config = ModelConfig.from_json(json.dumps({**json.loads(PRESETS["tiny"].to_json()), "command_size": 0}))
    model = RigidFormer(config).initialise()
    torch.save({"config": config.to_json(), "average": model.state_dict()}, tmp_path / "checkpoint.pt")
    scenes = contacts.Recipe(1, 40, 101, 0.1, ("slide",)).make(range(1, 41))
    scenes.scene_split[:] = 1
    write_scenes(tmp_path / "x", scenes)
    return [str(tmp_path / "checkpoint.pt"), str(tmp_path / "x"), "--steps", "10", "25", "--points", "24"]


def test_figures_are_the_same(trained, address, tmp_path, monkeypatch, capsys):
    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["evaluate", *trained, *arguments])
        evaluate.main()
        return capsys.readouterr().out

    torch.set_num_threads(1)
    here = run("--out", str(tmp_path / "here"))
    asked, real = [], far.results

    def interrupted(where, function, jobs, common):
        asked.append(len(jobs))
        for count, made in enumerate(real(where, function, jobs, common)):
            if count == 1 and len(asked) == 1:
                raise KeyboardInterrupt
            yield made

    monkeypatch.setattr(far, "results", interrupted)
    with pytest.raises(SystemExit):
        run("--out", str(tmp_path / "far"), "--dask", address)
    capsys.readouterr()
    assert run("--out", str(tmp_path / "far"), "--dask", address) == here
    assert asked[0] >= 2 and asked[1] == asked[0] - 1
    assert (tmp_path / "far").read_bytes() == (tmp_path / "here").read_bytes()
    assert not (tmp_path / "far.parts").exists()


def test_figures_are_printed_and_their_folder_is_made(trained, tmp_path, monkeypatch, capsys):
    out = tmp_path / "new" / "folder" / "errors.json"
    monkeypatch.setattr(sys, "argv", ["evaluate", *trained, "--out", str(out)])
    evaluate.main()
    figures = capsys.readouterr().out
    assert out.read_text() == figures and [path.name for path in out.parent.iterdir()] == ["errors.json"]

    def full(*_):
        raise OSError("no space is left")

    monkeypatch.setattr(evaluate, "write_text", full)
    with pytest.raises(OSError, match="no space"):
        evaluate.main()
    assert capsys.readouterr().out == figures
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(evaluate, "evaluate", None)  # not reached
    monkeypatch.setattr(sys, "argv", ["evaluate", *trained, "--out", str(tmp_path / "file" / "errors.json")])
    with pytest.raises(SystemExit):
        evaluate.main()
    assert "its folder cannot be made" in capsys.readouterr().err


def test_two_users_of_a_scheduler_get_what_is_theirs(address):
    def frames(number):
        return [made for _, made in far.results(address, operator.getitem, ["frames"] * 40, {"frames": number})]

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(frames, range(4))) == [[number] * 40 for number in range(4)]


def test_every_job_is_done_though_workers_come_and_go(address, monkeypatch):
    threads, most = iter([2, 0, 0, 5, 5]), []

    def counted(*_):
        most.append(next(threads, 1))
        return most[-1]

    monkeypatch.setattr(far, "_threads", counted)
    made = sorted(far.results(address, operator.getitem, list(range(12)), list(range(100, 112))))
    assert made == [(index, 100 + index) for index in range(12)]
    assert len(most) == 13  # asked before the first job and after each


def client_with(scheduler, **workers):
    """A stand-in for a client: what `far.code` gives on the scheduler and on workers; an exception is raised."""

    def said(answer):
        if isinstance(answer, Exception):
            raise answer
        return answer

    return SimpleNamespace(run_on_scheduler=lambda _: said(scheduler), run=lambda _: {name: said(theirs) for name, theirs in workers.items()})


def test_workers_and_schedulers_without_this_code_are_refused():
    ours, missing = far.code(), ModuleNotFoundError("No module named 'rigidformer_lab'")
    far._check_workers("tcp://a", client_with(ours, one=ours, two=ours))
    for client, said in [
        (client_with(missing, one=ours), "the scheduler cannot use rigidformer_lab .No module.*install tools/lab"),
        (client_with("other", one=ours), "the scheduler has other code; install tools/lab"),
        (client_with(ours), "the scheduler has no workers; start some"),
        (client_with(ours, one=ours, two="other"), "the worker two has other code; install tools/lab"),
        (client_with(ours, one=missing), "workers cannot use rigidformer_lab .No module"),
    ]:
        with pytest.raises(far.FarError, match=f"--dask tcp://a: {said}"):
            far._check_workers("tcp://a", client)


def test_a_worker_with_other_code_that_comes_later_does_nothing(address, monkeypatch):
    monkeypatch.setattr(far, "code", lambda: "other")
    monkeypatch.setattr(far, "_check_workers", lambda *_: None)
    with pytest.raises(far.FarError, match="a worker has other code"):
        list(far.results(address, str, [1]))


def test_without_dask_the_message_says_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert contacts.main(["--out", str(tmp_path / "x"), "--seeds", "1", "--frames", "2", "--dask", "tcp://127.0.0.1:1"]) == 1
    assert "tools/lab[dask]" in capsys.readouterr().err


def test_a_scheduler_that_does_not_answer(tmp_path, capsys, monkeypatch):
    needed("distributed", reason="Dask is not installed: pip install -e '.[dask]'")
    monkeypatch.setattr(far, "PATIENCE_S", 1)
    assert contacts.main(["--out", str(tmp_path / "x"), "--seeds", "1", "--frames", "2", "--dask", "tcp://127.0.0.1:1"]) == 1
    assert "no scheduler answers" in capsys.readouterr().err
