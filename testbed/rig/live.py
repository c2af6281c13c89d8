"""Changes in flight that an operator asks for: gains of the law, and flying by hand.

A change of gains is a fork of the experiment at a tick soon: the flight goes on with the law's
state, and the fork is added to the run's config.toml, so that a replay flies it at the same tick. A
stick is an input of the host's tick, and is logged with it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from queue import SimpleQueue
from threading import Thread
from typing import Protocol

from msgspec.structs import replace

from testbed.config import Experiment, Fork
from testbed.config.tunable import retuned, tunables
from testbed.core.ports import Clock
from testbed.core.types import Stick
from testbed.flight.loop import HostNode
from testbed.flight.supervisor import Supervisor
from testbed.net.operator_requests import (
    Controls,
    Mode,
    OperatorRequest,
    ReadControls,
    Reply,
    RequestSource,
    Revert,
    Steer,
    Tune,
)
from testbed.realtime.wall_clock import monotonic_ns

AHEAD = 2  # ticks from a request to its change of gains; the time to save it
AHEAD_ON_BOARD = 15  # the same where vehicles are asked over the network
DEAD_MAN_NS = 300_000_000  # age of a stick message from which the vehicle comes to rest
ON_BOARD = 'the law runs on the vehicle; by hand needs deploy.law = "host"'


class Changes(Protocol):
    """A vehicle's law, on the host or on board."""

    def change(self, at_s: float, before: Experiment, after: Experiment) -> None:
        """See `ForkedHost`."""
        ...

    def withdraw(self, at_s: float) -> None:
        """See `ForkedHost`."""
        ...


class LiveFlight:
    """Carries out the operator's requests during a flight.

    What may take longer than a tick is done in another thread: to save a fork, and to ask vehicles
    whose law is on board of another computer.

    Args:
        experiment: as it was started.
        requests: where they come from.
        save: adds the newest fork to the run's config.toml.
        now_ns: the clock of the requests' stamps.
    """

    def __init__(
        self, experiment: Experiment, requests: RequestSource, save: Callable[[Experiment], None],
        now_ns: Callable[[], int] = monotonic_ns,
    ) -> None:  # fmt: skip
        self.experiment = experiment  # with a fork for each change
        self._requests, self._save, self._now_ns = requests, save, now_ns
        self._period = experiment.flight.jet_period_s
        self._stage = experiment  # its gains count now, or soon
        self._start = gains_of(experiment)
        self._laws: Sequence[Changes] = ()
        self._hosts: Sequence[HostNode] = ()
        self._supervisor = Supervisor()
        self._sticks: dict[str, Steer] = {}
        self._later: list[tuple[OperatorRequest, Callable[[Reply], None]]] = []
        self._t, self._far = 0.0, False  # newest tick [s]; laws are on other computers
        self._work: SimpleQueue[Callable[[], None] | None] = SimpleQueue()

    @contextmanager
    def flying(
        self, clock: Clock, laws: Sequence[Changes], hosts: Sequence[HostNode],
        supervisor: Supervisor, *, far: bool = False,
    ) -> Iterator["LiveClock"]:  # fmt: skip
        """While open, requests are carried out; yields the flight's clock, which reads them.

        Args:
            clock: of the flight.
            laws: of all vehicles.
            hosts: those of them that run on the host.
            supervisor: notes what was changed.
            far: `laws` ask over the network.
        """
        self._laws, self._hosts, self._supervisor, self._far = laws, hosts, supervisor, far
        worker = Thread(target=self._do, name="requests", daemon=True)
        worker.start()
        try:
            yield LiveClock(clock, self)
        finally:
            self._work.put(None)
            worker.join()

    def _do(self) -> None:
        while (work := self._work.get()) is not None:
            work()

    # Between two ticks

    def prepare(self, t: float) -> None:
        """Carry out the requests before the tick at `t`."""
        requests, self._later = [*self._later, *self._requests.received()], []
        for request, reply in requests:
            if self._far and not isinstance(request, Steer | ReadControls):
                self._work.put(partial(self._answer, request, reply))
            else:
                self._answer(request, reply)

    def sample(self, t: float) -> None:
        """Give each host's tick at `t` the newest stick."""
        self._t = t
        for request, reply in self._requests.received():
            if isinstance(request, Steer):
                self._answer(request, reply)
            else:
                self._later.append((request, reply))
        for host in self._hosts:
            before, host.stick = host.stick, self.stick(host.name)
            if (before is None) != (host.stick is None):
                words = "the law flies" if host.stick is None else "flown by hand"
                self._supervisor.note(t, f"{host.name}: {words}")

    def _answer(self, request: OperatorRequest, reply: Callable[[Reply], None]) -> None:
        ok, words = self._carry_out(request)
        reply(Reply(ok, words, self.controls))

    def _carry_out(self, request: OperatorRequest) -> tuple[bool, str]:
        match request:
            case ReadControls():
                return True, ""
            case Tune(values):
                return self._tune(values)
            case Revert():
                return self._tune(self._start)
            case Steer():
                return self._steer(request)

    @property
    def controls(self) -> Controls:
        """What can be changed now."""
        sticks = self._sticks
        modes: dict[str, Mode] = {host.name: "law" for host in self._hosts}
        modes |= {name: one.mode for name, one in sticks.items()}
        flown = {name: one.by for name, one in sticks.items() if one.mode != "law"}
        why_no_manual = "" if self.experiment.deploy.law == "host" else ON_BOARD
        return Controls(gains_of(self._stage), self._start, modes, flown, why_no_manual)

    # Gains

    def _tune(self, values: Mapping[str, float]) -> tuple[bool, str]:
        """Change gains from a tick soon on; whether they change, and why not."""
        before, now = self._stage, gains_of(self._stage)
        values = {name: value for name, value in values.items() if now.get(name) != value}
        ahead = AHEAD_ON_BOARD if self._far else AHEAD
        at_s = (round(self._t / self._period) + 1 + ahead) * self._period
        if not values:
            return True, "nothing to change"
        if at_s >= self.experiment.end_s:
            return False, "the flight is nearly over"
        try:
            after = retuned(before, values)
            for law in self._laws:
                law.change(at_s, before, after)
        except Exception as error:  # a user's law may raise anything
            for law in self._laws:
                law.withdraw(at_s)
            return False, str(error)
        if not self._laws:
            return False, "no law of this flight can change"
        self._stage = after
        forks = [*self.experiment.forks, Fork(at_s, controller=after.controller)]
        self.experiment = replace(self.experiment, forks=forks)
        self._work.put(partial(self._keep, self.experiment))
        words = ", ".join(f"{name} {now[name]:g} to {value:g}" for name, value in values.items())
        self._supervisor.note(self._t, f"gains from {at_s:.1f} s on: {words}")
        return True, f"from {at_s:.1f} s on: {words}"

    def _keep(self, experiment: Experiment) -> None:
        try:
            self._save(experiment)
        except OSError as error:
            words = f"gains not saved, a replay will differ: {error.strerror}"
            self._supervisor.note(self._t, words)

    # By hand

    def _steer(self, request: Steer) -> tuple[bool, str]:
        if request.vehicle not in {host.name for host in self._hosts}:
            return False, self.controls.why_no_manual or f"no vehicle {request.vehicle}"
        held = self._sticks.get(request.vehicle)
        if held is not None and held.by != request.by and self._is_alive(held):
            return False, f"another page flies {request.vehicle}"
        if held is not None and held.by == request.by and request.stamp_ns < held.stamp_ns:
            return False, "older than the newest"
        self._sticks[request.vehicle] = request
        return True, request.mode

    def _is_alive(self, stick: Steer) -> bool:
        return stick.mode != "law" and 0 <= self._now_ns() - stick.stamp_ns <= DEAD_MAN_NS

    def stick(self, name: str) -> Stick | None:
        """A vehicle's stick now; None: its law flies."""
        held = self._sticks.get(name)
        if held is None or held.mode == "law":
            return None
        if not self._is_alive(held):
            return Stick(pushes=False, x=0.0, y=0.0, turn=0.0, alive=False)
        x, y, turn = (max(-1.0, min(1.0, one)) for one in (held.x, held.y, held.turn))
        return Stick(pushes=held.mode == "force", x=x, y=y, turn=turn, alive=True)


class LiveClock:
    """The clock of a flight that an operator can change."""

    def __init__(self, clock: Clock, live: LiveFlight) -> None:
        self._clock, self._live = clock, live

    def wait_until(self, t: float) -> None:
        """See `Clock`."""
        self._live.prepare(t)
        self._clock.wait_until(t)
        self._live.sample(t)


def gains_of(experiment: Experiment) -> dict[str, float]:
    """The parameters of the law that may change, and their values."""
    return {one.name: one.value for one in tunables(experiment.controller)}
