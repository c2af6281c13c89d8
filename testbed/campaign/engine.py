"""Distributes runs over Dask workers, on this machine or on a cluster.

Campaign-specific choices on top of Dask: a worker has one thread, because a flight holds the
interpreter lock. Runs travel in batches of about one second, because a scheduler handles about a
thousand tasks per second. Only a few batches per worker are under way, so ten thousand runs take no
more memory than ten. A batch whose workers die is split to find the run that kills them. A worker
that takes longer than the limit for a batch is killed.
"""

import faulthandler
import logging
import math
import os
import socket
import time
from asyncio import CancelledError as FutureCancelled
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any, Generic, TypeVar

from testbed.core.error import TestbedError
from testbed.core.extra import needs_extra
from testbed.run.code_digest import code_digest
from testbed.run.interrupt import held_back

Task = TypeVar("Task")
Result = TypeVar("Result")

BATCH_S = 1.0  # computing time of one batch [s]
LARGEST_BATCH = 100
AHEAD = 2  # batches under way per worker
ASK_S = 2.0  # interval of counting workers [s]
WORKER_GB = 0.3  # [GB] measured 0.22 to 0.27 (docs/performance.md)
LOOP = "tornado.application"
TRIES = 2  # workers that may die on a batch before it is given up

WORKER_ENVIRONMENT = {  # one thread each, because runs are parallel
    "NUMBA_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
}


class EngineError(TestbedError):
    """No workers can fly the runs."""


def most_workers() -> int:
    """Number of workers that fit into this machine's memory."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return max(os.cpu_count() or 1, int(memory / (1e9 * WORKER_GB)))


def check_jobs(jobs: int, scheduler: str | None) -> None:
    """Refuse more workers than fit into this machine's memory; a cluster decides for itself.

    Raises:
        EngineError: they are too many.
    """
    if scheduler is None and jobs > (most := most_workers()):
        raise EngineError(
            where=f"--jobs {jobs}",
            expected=f"at most {most}: a worker takes {WORKER_GB:g} GB of memory; "
            f"more than this machine's {os.cpu_count()} cores fly no faster",
            found=str(jobs),
        )


@contextmanager
def workers(jobs: int, scheduler: str | None, tasks: int | None = None) -> Iterator[Any]:
    """A Dask client with workers on this machine, or of the cluster at `scheduler`.

    Args:
        jobs: processes on this machine.
        scheduler: address of a cluster; None: this machine.
        tasks: more workers than these are not started; None: their number is not known.

    Raises:
        EngineError: too many `jobs`, or the cluster does not answer or has other code.
    """
    check_jobs(jobs, scheduler)
    with needs_extra("campaign"):
        import dask
        import distributed  # noqa: F401  (its import sets up its loggers, which `_quiet` silences)
    settings = {
        "distributed.scheduler.allowed-failures": TRIES - 1,
        "distributed.nanny.pre-spawn-environ": WORKER_ENVIRONMENT,
        "distributed.worker.multiprocessing-method": "spawn",
        "distributed.worker.profile.enabled": False,  # else a worker grows by 5 MB a minute
        "distributed.worker.preload": ["testbed.campaign.preload"],
        "distributed.comm.timeouts.connect": "10s",
        # by default every process of Dask wakes 50 times a second, which takes 3 % of a core
        "distributed.admin.tick.interval": "1s",
        "distributed.admin.system-monitor.interval": "10s",
    }
    with dask.config.set(settings), _quiet():
        if scheduler is None:
            with _own_workers(jobs if tasks is None else min(jobs, tasks)) as client:
                yield client
        else:
            with _connected(scheduler) as client:
                _same_code(client, scheduler)
                yield client


@contextmanager
def _own_workers(jobs: int) -> Iterator[Any]:
    """A client with workers on this machine."""
    from distributed import Client, LocalCluster

    with ExitStack() as stack:
        try:
            resource_tracker.ensure_running()  # its start lets signals through again
            with held_back():  # Dask cannot close workers that have not started yet
                cluster = LocalCluster(
                    n_workers=jobs, threads_per_worker=1, processes=True, host="127.0.0.1",
                    dashboard_address="127.0.0.1:0", scheduler_kwargs={"dashboard": False},
                    memory_limit=0,
                )  # fmt: skip
                stack.enter_context(cluster)
            client = stack.enter_context(Client(cluster))
        except (OSError, RuntimeError) as error:
            raise EngineError(
                where=f"--jobs {jobs}", found=str(error),
                expected=f"to start {jobs} processes with about ten open files each",
            ) from None  # fmt: skip
        yield client


def _connected(scheduler: str) -> Any:
    """A client of the cluster at `scheduler`."""
    from distributed import Client

    try:
        return Client(scheduler, timeout="10s")
    except (OSError, TimeoutError, ValueError, TypeError, RuntimeError) as error:
        raise EngineError(
            where=f"--scheduler {scheduler}",
            expected="a Dask scheduler, for instance tcp://10.0.0.1:8786",
            found=str(error) or "no answer within 10 s",
        ) from None


def _same_code(client: Any, scheduler: str) -> None:
    digests = client.run(code_digest, on_error="return")
    if not digests:
        raise EngineError(where=scheduler, expected="workers", found="a scheduler without workers")
    for address, digest in digests.items():
        if digest != code_digest():
            raise EngineError(
                where=scheduler, found=f"{digest} on {address}",
                expected=f"workers with the code of this machine, {code_digest()}",
            )  # fmt: skip


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence Dask's logs; the campaign itself reports lost workers.

    Its event loop, tornado's, would log callbacks that an interrupt broke off.
    """
    before = {name: logging.getLogger(name).level for name in ("distributed", LOOP)}
    for name in before:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)


def count_workers(client: Any) -> int:
    """Number of workers of a client; Dask waits for workers if it is zero."""
    return len(client.nthreads())


class OtherCodeError(TestbedError):
    """A worker that joined late has other code."""


def _fly_here(
    fly: Callable[[list[Task]], list[Result]], digest: str, limit_s: float, batch: list[Task]
) -> list[Result]:
    """In the worker: fly a batch if the code is the campaign's.

    A flight that hangs, in Python or in machine code, can only be ended with its process.
    """
    if code_digest() != digest:
        raise OtherCodeError(f"{code_digest()} on {socket.gethostname()}, process {os.getpid()}")
    with Path(os.devnull).open("w") as nowhere:
        faulthandler.dump_traceback_later(limit_s, exit=True, file=nowhere)
        try:
            return fly(batch)
        finally:
            faulthandler.cancel_dump_traceback_later()


def _results_of(future: Any) -> list[Any]:
    """The results of a batch that ended.

    Raises:
        KilledWorker: its workers died.
        EngineError: the cluster is gone, or a worker cannot fly.
    """
    from distributed.scheduler import KilledWorker

    try:
        results: list[Any] = future.result()
    except (OSError, CancelledError, FutureCancelled) as error:
        raise EngineError(
            where="the cluster is gone", expected="workers until the end",
            found=str(error) or type(error).__name__, hint="the same command resumes",
        ) from None  # fmt: skip
    except KilledWorker:
        raise
    except Exception as error:  # errors of a run are in its result, so the worker failed
        raise EngineError(
            where="a worker cannot fly", found=f"{type(error).__name__}: {error}",
            expected=f"workers with the code of this machine, {code_digest()}",
            hint="without that worker, the same command resumes",
        ) from None  # fmt: skip
    return results


class WorkerPool(Generic[Task, Result]):
    """Flies tasks on all workers of a client.

    Args:
        client: from `workers`.
        fly: maps a list of tasks to the list of their results; runs in the worker.
        lost: the result of a task whose workers died.
        took: computing time of a result's task [s].
        limit_s: time limit of a batch; then the worker is killed [s].
    """

    def __init__(
        self,
        client: Any,
        fly: Callable[[list[Task]], list[Result]],
        lost: Callable[[Task], Result],
        took: Callable[[Result], float],
        limit_s: float,
    ) -> None:
        self._client, self._fly, self._lost, self._took = client, fly, lost, took
        self._limit_s = limit_s
        self._count, self._asked = 1, -math.inf
        self._pace = 0.0  # mean computing time of a task [s]

    def results(self, tasks: Sequence[Task]) -> Iterator[Result]:
        """Yield results in order of completion.

        Raises:
            EngineError: the cluster is gone, or a worker cannot fly.
        """
        suspects: list[Task] = []  # one of them kills its worker; the others were queued beside it
        yield from self._fly_all(tasks, suspects.extend)
        for task in suspects:  # one at a time, with all workers idle
            culprit: list[Task] = []
            yield from self._fly_all([task], culprit.extend)
            yield from map(self._lost, culprit)

    def _fly_all(
        self, tasks: Sequence[Task], killed: Callable[[list[Task]], object]
    ) -> Iterator[Result]:
        """Yield results in order of completion; `killed` gets batches whose workers died."""
        from distributed import as_completed
        from distributed.scheduler import KilledWorker

        waiting = deque(tasks)
        under_way: dict[Any, list[Task]] = {}
        done = as_completed()

        def fill() -> None:
            most = AHEAD * self._workers()
            while waiting and len(under_way) < most:
                share = -(-len(waiting) // most)  # spreads the last tasks over all workers
                size = max(1, min(self._batch(), share))
                batch = [waiting.popleft() for _ in range(min(size, len(waiting)))]
                arguments = self._fly, code_digest(), self._limit_s, batch
                future = self._client.submit(_fly_here, *arguments, pure=False)
                under_way[future] = batch
                done.add(future)

        fill()
        while under_way:
            future = next(done)
            batch = under_way.pop(future)
            try:
                results = _results_of(future)
            except KilledWorker:
                killed(batch)
                results = []
            for result in results:
                self._pace += 0.3 * (self._took(result) - self._pace)
                yield result
            fill()

    def _workers(self) -> int:
        """Number of workers, asked every ASK_S because it is a round trip."""
        if time.monotonic() - self._asked > ASK_S:
            self._count = max(1, count_workers(self._client))
            self._asked = time.monotonic()
        return self._count

    def _batch(self) -> int:
        if self._pace <= 0.0:
            return 1
        return max(1, min(LARGEST_BATCH, round(BATCH_S / self._pace)))
