"""Training in several processes that torchrun starts, by gloo on the processor."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
import torch

from rigidformer_lab import contacts
from rigidformer_lab.ranks import Ranks, checksum
from rigidformer_lab.scenes import write_scenes
from rigidformer_lab.train import Average

#: The trainer, which notes down the checksums that the ranks compare, and the states of what draws a rank's windows and noise.
SCRIPT = """
import os
import torch
from rigidformer_lab import ranks, train

def drawn(dataset, *what):
    with open(os.path.join(os.environ["NOTES"], "draws-" + os.environ.get("RANK", "0")), "a") as file:
        print("windows", dataset.rng.bit_generator.state["state"]["state"], file=file)
        print("noise", torch.initial_seed(), file=file)
    return windows(dataset, *what)

windows, train.Dataset.windows = train.Dataset.windows, drawn

def noted(*what):
    value = ranks.checksum(*what)
    with open(os.path.join(os.environ["NOTES"], "rank-" + os.environ["RANK"]), "a") as file:
        print(value, file=file)
    return value

train.checksum = noted
ranks.started_by_torchrun(train.main)()
"""

#: Gradients of three weights: of both ranks, of rank 1 alone, of none.
AVERAGED = """
import json
import os
import torch
from rigidformer_lab.ranks import Ranks

ranks = Ranks("cpu")
model = torch.nn.ParameterList([torch.nn.Parameter(torch.zeros(2)) for _ in range(3)])
model[0].grad = torch.full((2,), ranks.rank + 1.0)
if ranks.rank == 1:
    model[1].grad = torch.tensor([3.0, 5.0])
ranks.average_gradients(model)
with open(os.path.join(os.environ["NOTES"], "gradients-" + os.environ["RANK"]), "w") as file:
    json.dump([None if p.grad is None else p.grad.tolist() for p in model.parameters()], file)
ranks.end()
"""


@pytest.fixture
def start(tmp_path):
    """Starts the trainer, in so many processes by torchrun, or (None) as a plain program."""
    write_scenes(tmp_path / "x", contacts.Recipe(6, 5, 101, 0.1, ("slide",)).make(range(6, 11)))
    (tmp_path / "train.py").write_text(SCRIPT)
    started = []

    def started_with(processes, run, *arguments):
        launch = [sys.executable]
        if processes:
            launch += ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(processes)]
        notes = tmp_path / f"notes-{run}"
        notes.mkdir(exist_ok=True)
        command = [*launch, str(tmp_path / "train.py"), "--data", str(tmp_path / "x"), "--run-folder", str(tmp_path / run),
                   "--preset", "tiny", "--config", '{"command_size": 0}', "--steps", "1", "--horizon", "2", "--slots", "16",
                   "--points", "24", "--threads", "1", "--no-bf16", "--seed", "5", "--checkpoint-minutes", "0", *arguments]  # fmt: skip
        started.append(subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env={**os.environ, "NOTES": str(notes), "OMP_NUM_THREADS": "1"}))
        return started[-1]

    yield started_with
    for process in started:
        if process.poll() is None:
            process.kill()
            process.communicate()


def checkpoint(folder):
    return torch.load(folder / "checkpoint.pt", weights_only=False)


def test_two_processes_train_one_model_stop_and_go_on(start, tmp_path):
    run, notes = tmp_path / "two", tmp_path / "notes-two"
    process = start(2, "two", "--updates", "1000000")
    until = time.monotonic() + 120
    while not (notes / "rank-1").exists() and process.poll() is None and time.monotonic() < until:
        time.sleep(0.1)
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=120)
    stopped = checkpoint(run)
    assert 1 <= stopped["updates"] < 1000000 and f"stopped after {stopped['updates']} updates" in said
    assert (run / "log.jsonl").read_text() == ""

    last = stopped["updates"] + 2
    process = start(2, "two", "--updates", str(last))
    _, said = process.communicate(timeout=120)
    assert process.returncode == 0, said
    assert said.count("resumed") == 1 and said.count("2 processes") == 1
    saved = checkpoint(run)
    assert saved["updates"] == saved["average_count"] == last and saved["arguments"]["processes"] == 2
    assert saved["seen"] > stopped["seen"] and not saved["resumed"]
    # One rank wrote: one validation.
    lines = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
    assert [line["validation"] for line in lines] == ["x"]
    # The ranks had the same weights, averages and optimizer after every update, and others after each.
    first, second = ((notes / f"rank-{rank}").read_text().split() for rank in range(2))
    assert first == second and len(set(first)) == last
    # Each drew windows and noise of its own, in both parts of the run.
    own, others = (set((notes / f"draws-{rank}").read_text().splitlines()) for rank in range(2))
    assert own and others and not own & others

    process = start(None, "two", "--updates", str(last + 1))
    _, said = process.communicate(timeout=120)
    assert process.returncode == 0, said
    saved = checkpoint(run)
    assert saved["updates"] == saved["average_count"] == last + 1 and saved["arguments"]["processes"] == 1
    assert [line.endswith("with processes 1 instead of 2") for line in saved["resumed"]] == [True]


def test_gradients_are_averaged_and_weights_without_any_keep_none(start, tmp_path):
    (tmp_path / "train.py").write_text(AVERAGED)
    process = start(2, "averages")
    _, said = process.communicate(timeout=120)
    assert process.returncode == 0, said
    for rank in range(2):
        noted = json.loads((tmp_path / "notes-averages" / f"gradients-{rank}").read_text())
        assert noted == [[1.5, 1.5], [1.5, 2.5], None]


def test_one_process_of_torchrun_does_what_the_plain_program_does(start, tmp_path):
    both = [start(1, "one", "--updates", "3"), start(None, "plain", "--updates", "3")]
    for process in both:
        _, said = process.communicate(timeout=120)
        assert process.returncode == 0, said
    one, plain = checkpoint(tmp_path / "one"), checkpoint(tmp_path / "plain")
    assert one["seen"] == plain["seen"]
    for what in ("model", "average"):
        assert all(torch.equal(one[what][name], plain[what][name]) for name in plain[what])


def test_a_rank_that_fails_ends_all_and_says_why(start, tmp_path):
    (tmp_path / "train.py").write_text(SCRIPT.replace("ranks.started", """
def fail(*what):
    if os.environ["RANK"] == "1":
        raise RuntimeError("no more memory")
    return real(*what)

real, train.window_loss = train.window_loss, fail
ranks.started"""))
    process = start(2, "fails", "--updates", "2")
    _, said = process.communicate(timeout=120)
    assert process.returncode != 0 and "rank 1 failed, which ends all: RuntimeError: no more memory" in said


def test_a_lone_process_is_the_first_rank(monkeypatch):
    monkeypatch.delenv("TORCHELASTIC_RUN_ID", raising=False)
    ranks = Ranks("cpu")
    assert ranks.first and ranks.seed(7) == 7 and ranks.shared("x") == "x" and ranks.totals(2.0, 3, 4.0) == (2.0, 3, 4.0, False)
    ranks.rank = 1
    assert len({7, 8, ranks.seed(7), ranks.seed(8)}) == 4


def test_ranks_that_differ_end(monkeypatch):
    monkeypatch.delenv("TORCHELASTIC_RUN_ID", raising=False)
    ranks = Ranks("cpu")
    ranks.size = 2
    gathered = ["a", "b"]
    monkeypatch.setattr("torch.distributed.all_gather_object", lambda values, value: values.__setitem__(slice(None), gathered))
    with pytest.raises(SystemExit, match="rank 1 has other weights than rank 0: b instead of a; go on"):
        ranks.check_alike("weights", "a", "go on")
    gathered[1] = "a"
    ranks.check_alike("weights", "a", "go on")


def test_checksums_tell_weights_apart():
    model = torch.nn.Linear(2, 2)
    optimizer, average = torch.optim.AdamW(model.parameters()), Average(model, 0.9)
    before = checksum(model, optimizer, average)
    assert checksum(model, optimizer, average) == before
    with torch.no_grad():
        model.weight[0, 0] += 1
    assert checksum(model, optimizer, average) != before
