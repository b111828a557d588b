"""Processes that train one model together, as torchrun starts them; without torchrun there is one, and nothing here does anything.

Each process, a rank, draws its own windows. Gradients are averaged over the ranks, each rank alike: a rank's loss is a mean over
what its units do that may have touched something, and one process gives its batches the same weight too, however much is in them. So all
ranks take the same step, and their weights stay the same to the bit. Rank 0 tells the time and writes the files.
"""

from __future__ import annotations

import datetime
import hashlib
import os
import signal
import sys

import numpy as np
import torch
import torch.distributed as dist

#: Rank 0 validates while the others wait. torchrun ends them sooner where a rank has failed.
PATIENCE = datetime.timedelta(hours=6)


class Ranks:
    """This process among those that train together."""

    def __init__(self, device: str):
        self.together = "TORCHELASTIC_RUN_ID" in os.environ  # what torchrun sets, and little else does
        self.rank, self.size, self.here = 0, 1, 1
        self.device, self.stopping = device, False
        if not self.together:
            return
        self.rank, self.size, self.here = (int(os.environ[name]) for name in ("RANK", "WORLD_SIZE", "LOCAL_WORLD_SIZE"))
        if device == "cuda":
            place, cards = int(os.environ["LOCAL_RANK"]), torch.cuda.device_count()
            if place >= cards:
                raise SystemExit(f"rank {self.rank}: {self.here} processes were started here, and there are {cards} GPUs; give "
                                 f"torchrun --nproc-per-node {cards}")
            torch.cuda.set_device(place)
        dist.init_process_group("nccl" if device == "cuda" else "gloo", timeout=PATIENCE)
        for number in (signal.SIGTERM, signal.SIGINT):  # torchrun passes on what it gets
            signal.signal(number, self._stop)

    def _stop(self, number, frame):
        self.stopping = True

    @property
    def first(self) -> bool:
        """Whether this rank writes the files."""
        return self.rank == 0

    def seed(self, seed: int) -> int:
        """A seed of this rank's own; that of rank 0 is `seed`."""
        return seed if self.first else int(np.random.SeedSequence((seed, self.rank)).generate_state(1)[0])

    def shared(self, value):
        """What rank 0 has."""
        if self.size == 1:
            return value
        box = [value if self.first else None]
        dist.broadcast_object_list(box, 0)
        return box[0]

    @torch.no_grad()
    def share_weights(self, model):
        """Gives all ranks the weights and constants of rank 0."""
        if self.size > 1:
            for value in model.state_dict().values():
                dist.broadcast(value, 0)

    @torch.no_grad()
    def average_gradients(self, model):
        """Gives all ranks the mean of their gradients. Who has none for a weight counts as zero; a weight that has none on any
        rank keeps none, so that the optimizer leaves it alone."""
        if not self.together:
            return
        weights = [p for p in model.parameters() if p.requires_grad]
        has = torch.tensor([p.grad is not None for p in weights], dtype=torch.float32, device=self.device)
        flat = torch.cat([has, *(torch.zeros_like(p).flatten() if p.grad is None else p.grad.flatten() for p in weights)])
        dist.all_reduce(flat)
        had, flat = flat[: len(weights)].tolist(), flat[len(weights) :] / self.size
        for p, some, mean in zip(weights, had, flat.split([p.numel() for p in weights])):
            p.grad = mean.view_as(p) if some else None

    def totals(self, took: float, windows: int, loss: float) -> tuple[float, int, float, bool]:
        """Of an update: seconds by rank 0's clock, windows of all ranks, their mean loss, and whether a rank was told to stop. All
        ranks get the same, so they end at the same update."""
        if not self.together:
            return took, windows, loss, False
        numbers = torch.tensor([took if self.first else 0.0, windows, loss, self.stopping], dtype=torch.float64, device=self.device)
        dist.all_reduce(numbers)
        took, windows, loss, stopping = numbers.tolist()
        return took, int(windows), loss / self.size, stopping > 0

    def check_alike(self, name: str, value: str, remedy: str):
        """Ends a run whose ranks do not have the same."""
        if self.size == 1:
            return
        values = [None] * self.size
        dist.all_gather_object(values, value)
        for rank, other in enumerate(values):
            if other != values[0]:
                raise SystemExit(f"rank {rank} has other {name} than rank 0: {other} instead of {values[0]}; {remedy}")

    def end(self):
        if self.together:
            dist.destroy_process_group()


def checksum(model, optimizer, average) -> str:
    """Of all that an update changes."""
    digest = hashlib.sha256()

    def add(value):
        if isinstance(value, torch.Tensor):
            digest.update(value.detach().cpu().contiguous().numpy().tobytes())
        elif isinstance(value, dict):
            for key in value:
                add(value[key])
        elif isinstance(value, (list, tuple)):
            for v in value:
                add(v)
        else:
            digest.update(repr(value).encode())

    add([model.state_dict(), optimizer.state_dict(), average.weights, average.count])
    return digest.hexdigest()


def started_by_torchrun(main):
    """`main`, whose failure torchrun shows with the rank and the reason."""
    if "TORCHELASTIC_RUN_ID" not in os.environ:
        return main

    def told():
        try:
            return main()
        except Exception as error:
            print(f"rank {os.environ['RANK']} failed, which ends all: {type(error).__name__}: {error}", file=sys.stderr, flush=True)
            raise

    from torch.distributed.elastic.multiprocessing.errors import record

    return record(told)
