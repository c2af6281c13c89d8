"""Shares the compiling of the first flight on a machine among its cores.

The compiler works on one core. While this process compiles the larger half of the chain, others
compile the estimator, the plant and the law; they meet in the cache on disk (core/code_cache.py),
where each finds what the others have finished and waits for what another one has begun. A process
compiles a function once for all its callers, so there are no more processes than cores.

    python -m testbed.rig.compile_ahead PART...    the experiment is read from standard input
"""

import fcntl
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import numpy as np
from msgspec.structs import replace
from numba.core import config

from controllers.own_law import OwnLawParams
from sim_twin.radio import SIZE
from testbed.config import Experiment
from testbed.core.code_address import CodeAddress
from testbed.core.code_cache import has_code
from testbed.core.rows import States
from testbed.core.types import Accel, Pose, State, Twist
from testbed.flight import chain
from testbed.flight.barrier import WIDTH
from testbed.rig.chain import make_agent, make_guidance
from testbed.rig.twin import make_twin

TICKS = 4  # of a law, until its ticks are single calls, see fleet/host.py
DONE = "chain.act"  # this function has code: a flight has been compiled
LOCK = "compiling.lock"  # in the cache: one flight at a time starts other processes

GIVE_WAY = 10  # niceness of the other processes


class Compilers:
    """Processes that compile beside this one."""

    def __init__(self, experiment: Experiment, cores: int) -> None:
        """Start them; with one core, none."""
        self._experiment = experiment
        parts = [part for part in PARTS if part != "law" or _is_ours(experiment)]
        shares = [parts[k :: cores - 1] for k in range(min(cores - 1, len(parts)))]
        self._processes = [_start(share, experiment) for share in shares]

    def join_in(self) -> None:
        """Compile the part of this process, if there are others."""
        if self._processes:
            act(self._experiment)

    def end(self) -> None:
        """End the other processes."""
        for one in self._processes:
            one.kill()
            one.wait()


@contextmanager
def compiling_ahead(experiment: Experiment) -> Iterator[Compilers]:
    """Let other processes compile, too, if the cache is empty and this flight is the first.

    Yields:
        these, which end with the context.
    """
    with _first_flight() as first:
        compilers = Compilers(experiment, (os.cpu_count() or 1) if first else 1)
        try:
            yield compilers
        finally:
            compilers.end()


@contextmanager
def _first_flight() -> Iterator[bool]:
    """Whether no code is there yet and no other flight has this cache's lock; else take it."""
    cache = vars(config)["CACHE_DIR"]
    folder = Path(cache or ".")
    if not cache or (os.cpu_count() or 1) < 2 or has_code(DONE):
        yield False
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError:  # numba finds another folder, or compiles for this process only
        yield False
        return
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        first = True
    except OSError:
        first = False
    try:
        yield first
    finally:
        os.close(lock)


def _is_ours(experiment: Experiment) -> bool:
    """Whether its law is a shipped one: a user's law must run in the flight's process only."""
    controller = experiment.controller
    shipped = type(controller).__module__.startswith("controllers.")
    return shipped and not isinstance(controller, OwnLawParams)


def _start(parts: list[str], experiment: Experiment) -> "subprocess.Popen[bytes]":
    process = subprocess.Popen(
        [sys.executable, "-m", "testbed.rig.compile_ahead", *parts],
        stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    assert process.stdin is not None
    try:
        process.stdin.write(msgspec.json.encode(experiment))
        process.stdin.close()
    except BrokenPipeError:
        pass  # it has failed; this process compiles its parts
    return process


def act(experiment: Experiment) -> None:
    """Compile the chain from the setpoint to the valves."""
    agent = make_agent(experiment, next(iter(experiment.vehicles)))
    references, others = np.empty((0, 10)), np.empty((0, WIDTH))
    CodeAddress(chain.act, (agent.vehicle, np.empty((0, 4)), references, others))


def see(experiment: Experiment) -> None:
    """Compile the estimator."""
    agent = make_agent(experiment, next(iter(experiment.vehicles)))
    CodeAddress(chain.see, (agent.vehicle, np.empty((0, 4))))


def plant(experiment: Experiment) -> None:
    """Compile the twin's plant, cameras and links."""
    twin = make_twin(replace(experiment, board="model", inject=[], forks=[])).twin
    twin.wait_until(experiment.flight.jet_period_s)


def law(experiment: Experiment) -> None:
    """Compile the law of the first vehicle, and its ticks on the twin's host."""
    names = list(experiment.vehicles)
    still, no_bias = Twist(0.0, 0.0, 0.0), Accel(0.0, 0.0, 0.0)
    states = {
        name: State(0.0, Pose(*experiment.vehicles[name].start), still, no_bias, 0.0, 0)
        for name in names
    }
    own = states.pop(names[0])
    if experiment.deploy.law == "vehicle":
        make_guidance(experiment, names[0]).step(0.0, own, states)
        return
    rig = make_twin(replace(experiment, board="model", inject=[], forks=[]))
    links, period = rig.twin.states.links, experiment.flight.jet_period_s
    links.newest[:, : States.width] = States.of([own]).rows[0]
    links.tally[:, SIZE] = States.width
    for k in range(TICKS):
        rig.twin.now = k * period
        rig.hosts[0].tick(rig.twin.now)


# of the other processes, in this order
PARTS: dict[str, Callable[[Experiment], None]] = {"see": see, "plant": plant, "law": law}


if __name__ == "__main__":
    os.nice(GIVE_WAY)
    flown = msgspec.json.decode(sys.stdin.buffer.read(), type=Experiment)
    for part in sys.argv[1:]:
        PARTS[part](flown)
