"""Flies runs in worker processes of this machine, each run alone in its process.

A worker that dies or hangs loses the run that it was flying, and a new worker takes the next one.
Ctrl-C reaches only the caller, which ends the workers; they would print tracebacks.
"""

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from queue import Empty, SimpleQueue

import msgspec
from msgspec.structs import replace

from testbed.campaign.row import FlownRun
from testbed.campaign.worker import Order
from testbed.core.error import TestbedError


class LostRunError(TestbedError):
    """The process that flew a run has ended or hangs."""


FLY = (sys.executable, "-m", "testbed.campaign.worker")


class Worker:
    """A worker process, started for its first run."""

    def __init__(self, command: Sequence[str] = FLY) -> None:
        self._command = command
        self._process: subprocess.Popen[bytes] | None = None
        self._over = False  # it flies no more
        self._base = ""  # experiment of the newest run

    def fly(self, order: Order, limit_s: float) -> FlownRun:
        """Fly one run.

        Raises:
            LostRunError: the process ended, or took longer than `limit_s`.
        """
        if self._process is None:
            self._process = subprocess.Popen(
                self._command, bufsize=0, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                start_new_session=True,
            )  # fmt: skip
            self._base = ""
            if self._over:  # since the caller's order
                self.stop()
                raise LostRunError("not flown: the runs were interrupted")
        assert self._process.stdin is not None
        if order.base == self._base:
            order = replace(order, base="")
        else:
            self._base = order.base
        try:
            self._process.stdin.write(msgspec.json.encode(order) + b"\n")
            return msgspec.json.decode(self._line(self._process, limit_s), type=FlownRun)
        except BrokenPipeError:
            raise self._lost(self._process) from None

    def _line(self, process: "subprocess.Popen[bytes]", limit_s: float) -> bytes:
        assert process.stdout is not None
        line, until = b"", time.monotonic() + limit_s
        while not line.endswith(b"\n"):
            left = until - time.monotonic()
            if not select.select([process.stdout], [], [], max(0.0, left))[0]:
                raise LostRunError(f"no result after {limit_s:g} s")
            if not (more := os.read(process.stdout.fileno(), 1 << 16)):
                raise self._lost(process)
            line += more
        return line

    def _lost(self, process: "subprocess.Popen[bytes]") -> LostRunError:
        code = process.wait()
        how = f"with code {code}" if code >= 0 else f"by {signal.Signals(-code).name}"
        return LostRunError(f"its process ended {how} during the flight")

    def end(self) -> None:
        """End the process for good."""
        self._over = True
        self.stop()

    def stop(self) -> None:
        """End the process, whatever it does."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.communicate()


def fly_in_processes(orders: Sequence[Order], jobs: int, limit_s: float) -> list[FlownRun]:
    """Fly runs in `jobs` processes; each takes the next run when it is done.

    Returns:
        The runs in their order; a lost one has the outcome "lost".
    """
    waiting: SimpleQueue[Order] = SimpleQueue()
    for order in orders:
        waiting.put(order)
    runs: dict[int, FlownRun] = {}
    workers = [Worker() for _ in range(min(jobs, len(orders)))]

    def feed(worker: Worker) -> None:
        while True:
            try:
                order = waiting.get_nowait()
            except Empty:
                return
            try:
                runs[order.k] = worker.fly(order, limit_s)
            except LostRunError as error:
                runs[order.k] = FlownRun(order.k, "lost", str(error), limit_s=limit_s)
                worker.stop()

    if not orders:
        return []
    try:
        with ThreadPoolExecutor(len(workers)) as threads:
            try:
                for done in [threads.submit(feed, worker) for worker in workers]:
                    done.result()
            except BaseException:  # Ctrl-C: no more runs
                with suppress(Empty):
                    while True:
                        waiting.get_nowait()
                for worker in workers:
                    worker.end()
                raise
    finally:
        for worker in workers:
            worker.stop()
    return [runs[order.k] for order in orders]
