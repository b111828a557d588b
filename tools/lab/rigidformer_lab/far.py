"""Work that Dask's workers do on other machines: calls of a function, each with what it takes, whose results come back here.

Workers and the scheduler need this package of the same commit, and no disk that is shared: what they make travels. Nothing imports Dask
without --dask.
"""

from __future__ import annotations

import functools
import hashlib
import sys
import threading
from pathlib import Path

#: Tasks that are at the workers at a time, of each thread of theirs, so that none waits and results do not pile up.
AHEAD = 2
PATIENCE_S = 20  # for an answer of the scheduler
INSTALL = "install tools/lab of this commit on its machine, and start it again"
_ONE = threading.Lock()


class FarError(RuntimeError):
    """Dask is missing, cannot be reached, or has workers that cannot be used. The message says what to do."""


def add_argument(parser, more: str = "--workers does not count then") -> None:
    parser.add_argument("--dask", metavar="ADDRESS", help="share the work out to the workers of Dask's scheduler there, such as "
                        f"tcp://10.0.0.1:8786; workers and the scheduler need this package of the same commit; {more}")


@functools.cache
def code() -> str:
    """SHA-256 of this package's code."""
    digest = hashlib.sha256()
    package = sys.modules[__package__].__path__[0]  # where the other modules come from, which need not be beside this one
    for path in sorted(Path(package).glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def results(address: str, function, jobs: list, common=None):
    """(index of the job, function(common, job)) of every job, as they come. common: what all take; it travels to a worker once. A
    worker that goes away has its jobs done by others."""
    try:
        from distributed import CancelledError, Client, KilledWorker, as_completed
    except ImportError as error:
        raise FarError("--dask needs Dask, which is not installed: python -m pip install -e 'tools/lab[dask]'") from error
    try:
        client = Client(address, timeout=PATIENCE_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise FarError(f"--dask {address}: no scheduler answers ({error}); start one there by `dask scheduler`") from error
    with client:
        _check_workers(address, client)
        # In a list, since Dask takes a bare dict apart: its keys would name data of the whole scheduler, which all who use it share.
        held = client.scatter([common], broadcast=True, hash=False)[0]
        left, indices = iter(enumerate(jobs)), {}
        done = as_completed(loop=client.loop)

        def fill():
            """Keeps the workers that there are now busy, those that came later too. One job is always out while some are left, so that
            a moment without workers does not end the loop."""
            most = max(1, AHEAD * _threads(address, client))
            while len(indices) < most and (one := next(left, None)):
                index, job = one
                future = client.submit(_do, code(), function, held, job, pure=False)
                indices[future] = index
                done.add(future)

        try:
            fill()
            for future in done:
                yield indices.pop(future), future.result()
                fill()
        except (CancelledError, KilledWorker) as error:
            raise _gone(address, error) from error
        finally:  # what is not needed any more is not made
            client.cancel(list(indices))


def _threads(address: str, client) -> int:
    """Of all workers that there are now."""
    try:
        return sum(client.nthreads().values())
    except OSError as error:
        raise _gone(address, error) from error


def _gone(address: str, error: Exception) -> FarError:
    return FarError(f"--dask {address}: the scheduler went away, or workers that had a job ended again and again ({error}); see what "
                    "they say, and give the same command to go on")


def _check_workers(address: str, client) -> None:
    """Refuses none at all, and those with other code: what they make may be something else. The scheduler unpickles what it is given,
    so it needs the code too."""
    try:
        theirs = client.run_on_scheduler(code)
    except Exception as error:  # whatever a scheduler without this module says
        raise FarError(f"--dask {address}: the scheduler cannot use rigidformer_lab ({error}); {INSTALL}") from error
    if theirs != code():
        raise FarError(f"--dask {address}: the scheduler has other code; {INSTALL}")
    try:
        found = client.run(code)
    except Exception as error:  # whatever a worker without this module says
        raise FarError(f"--dask {address}: workers cannot use rigidformer_lab ({error}); {INSTALL}") from error
    if not found:
        raise FarError(f"--dask {address}: the scheduler has no workers; start some by `dask worker {address} --nthreads 1`")
    for worker, theirs in found.items():
        if theirs != code():
            raise FarError(f"--dask {address}: the worker {worker} has other code; {INSTALL}")


def _do(expected: str, function, common, job):
    """On a worker: a job, one at a time in a process, since the engines are not made for threads."""
    if code() != expected:  # one that came after `_check_workers`
        raise FarError(f"a worker has other code; {INSTALL}")
    with _ONE:
        try:
            return function(common, job)
        except SystemExit as error:  # would end the worker
            raise FarError(str(error)) from error
