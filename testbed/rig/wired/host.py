"""The host's process: laws on the host, the log, and the start and end of a flight.

On the bench it also starts the twin's server and one process per vehicle. On the table these run
elsewhere, and the host waits for them.
"""

import os
import secrets
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

import msgspec
import tomli_w
import zenoh

from testbed.config import Experiment, dump
from testbed.core.codes import FaultId, FaultReport
from testbed.core.error import TestbedError
from testbed.flight.arming import Check
from testbed.flight.loop import Ending, Observer
from testbed.flight.supervisor import Answer, Request, Supervisor
from testbed.metrics.run_metrics import Touch
from testbed.net.access import open_lab
from testbed.net.commands import Accepted, Refused, Start, Stop
from testbed.net.credentials import neighbour
from testbed.net.flight_note import noted
from testbed.net.keys import Keys
from testbed.net.links import Party
from testbed.net.roll_call import Roll
from testbed.net.session import NetworkError, Subscriber, answer_to, on_word
from testbed.net.stop import NOT_STARTED
from testbed.realtime.processes import ChildError, ProcessGroup
from testbed.realtime.wall_clock import WallClock, monotonic_ns, sleep_until_ns
from testbed.rig.fault_latch import FaultLatch
from testbed.rig.interface import not_armed
from testbed.rig.live import LiveFlight
from testbed.rig.wired.agent_process import AgentOptions
from testbed.rig.wired.blame import blamed
from testbed.rig.wired.local import loopback
from testbed.rig.wired.preflight import Preflight, order
from testbed.rig.wired.run_results import RunResults
from testbed.rig.wired.stop_requests import Asked
from testbed.rig.wired.suitable import check_wires
from testbed.rig.wired.table_report import TableReport
from testbed.rig.wired.trial_call import compile_host
from testbed.rig.wired.wired_flight import HostFlight

READY_S = 180.0  # time for vehicles to get ready; the first start compiles
GREEN_S = 10.0  # time for checks to pass: the camera rate is counted over a second
AHEAD_NS = 1_500_000_000  # from the order to start to the run's time 0
LEASE_NS = 100_000_000  # between two leases before time 0
LOOK_NS = 20_000_000
ANSWER_NS = 500_000_000  # after a stop before the start: `testbed stop` asks who stands


class HostError(TestbedError):
    """The flight cannot begin."""


class NotArmedError(TestbedError):
    """The flight must not begin: arming checks failed, or the operator declined."""

    def __init__(self, red: Sequence[Check]) -> None:
        super().__init__(not_armed(red).text)
        self.red = red


class WireRig:
    """The experiment on real wires.

    Args:
        experiment: the experiment to fly.
        bench: start the twin and the vehicles here; else wait for those of the lab.
        keep: folder for the twin's report; None: a temporary folder.
        log: run folder; its disk must not be full.
        agree: asks the operator whether these vehicles may be armed; by default they may.
        latch: keeps a fault for the next run.
        latched: fault of the previous run, which must be reset first.
        say: called with messages for the operator; by default they are dropped.
        checked: called with every result of the arming checks; by default they are dropped.
        relay: maps the host's endpoint to the endpoint of the bench's vehicles.
        live: carries out the operator's requests; None: the flight cannot be changed.
    """

    def __init__(
        self,
        experiment: Experiment,
        *,
        bench: bool,
        keep: Path | None = None,
        log: Path | None = None,
        agree: Callable[[Sequence[str]], bool] = lambda names: True,
        latch: FaultLatch | None = None,
        latched: FaultReport | None = None,
        say: Callable[[str], None] = lambda text: None,
        checked: Callable[[Sequence[Check]], None] = lambda checks: None,
        relay: Callable[[str], str] = str,
        live: LiveFlight | None = None,
    ) -> None:
        self.experiment = experiment
        self.results = results = RunResults(experiment)
        self.track, self.truth, self.valves = results.track, results.truth, results.valves
        self.paces, self.spent, self.wires = results.paces, results.spent, results.wires
        self.concerns, self.come_to_rest = results.concerns, results.come_to_rest
        self.jets = results.jets
        self._bench, self._keep = bench, keep
        check_wires(experiment, bench=bench)
        self._log, self._agree, self._latch = log, agree, latch
        self._say, self._checked = say, checked
        self.supervisor = Supervisor(latched)
        self.red: list[Check] = []
        self._ran = False  # valves may have opened
        self._relay = relay
        self.name = "bench" if bench else "table"
        self.children: dict[str, int] = {}  # process ids of the bench, by name
        self.live = live
        self.on_start: Callable[[WireRig], None] | None = None  # called when the flight begins

    @property
    def now(self) -> float:
        """See `Rig`."""
        return self.results.now

    @property
    def began_ns(self) -> int | None:
        """See `Rig`."""
        return self.results.began_ns

    @property
    def touches(self) -> list[Touch]:
        """See `Rig`."""
        return self.results.touches

    @property
    def loop(self) -> tuple[float, float] | None:
        """See `Rig`."""
        return self.results.loop

    # The flight

    def fly(self, observer: Observer, stopped: Callable[[], int] = lambda: 0) -> Ending:
        """See `Rig`."""
        compile_host(self.experiment)
        if stopped():
            return Ending(0.0, None)
        try:
            with ExitStack() as stack:
                ending = self._fly(stack, observer, stopped)
        except NotArmedError as error:
            self.red.extend(error.red)
            return Ending(0.0, not_armed(error.red))
        except (NetworkError, ChildError, HostError) as error:
            ending = Ending(self.now, FaultReport(FaultId.RIG_FAILED, str(error)))
            self._close(ending)
            return ending
        self.results.flown_s = ending.t
        return ending

    def _close(self, ending: Ending) -> None:
        """Record the end of the flight in the supervisor and the latch."""
        flown = ending.t >= self.experiment.end_s
        self.supervisor.close(ending.t, ending.fault, flown=flown)
        if self._latch is None or not self._ran:
            return
        if self.supervisor.fault is not None:
            self._latch.set(self.supervisor.fault)
        else:
            self._latch.clear()

    def disk_free(self) -> float:
        """Free space on the disk of the log [bytes]."""
        if self._log is None:
            return 1e12
        room = os.statvfs(self._log)
        return float(room.f_bavail * room.f_frsize)

    def _fly(self, stack: ExitStack, observer: Observer, stopped: Callable[[], int]) -> Ending:
        children = None
        if self._bench:
            children = stack.enter_context(ProcessGroup())
            self.experiment = loopback(self.experiment, children.folder)
        network = self.experiment.table.lab.network
        opened, self.results.key_warnings = open_lab(network, self.experiment.vehicles)
        session = stack.enter_context(opened)
        keys, asked = Keys(network.lab), Asked()
        text = msgspec.json.encode(self.experiment)
        roll = Roll(session, keys, self.experiment.vehicles)

        def called_off() -> bool:
            return asked.times > 0 or roll.stopped  # the stop may have reached a vehicle first

        answering = [
            answer_to(session, keys.experiment, lambda _: text),
            answer_to(session, keys.ended, lambda _: self._ended_as(called_off=called_off())),
            on_word(session, keys.stop, asked.hear),
            answer_to(session, keys.clock, lambda _: monotonic_ns().to_bytes(8, "little")),
        ]
        truth = Subscriber(session, keys.truth)
        note = noted(
            network.endpoint, network.lab, network.keys, list(self.experiment.vehicles),
            self.experiment.name, say=self._say, folder=self._log,
        )  # fmt: skip
        stack.enter_context(note)  # from now on a stop is heard
        if children is not None:
            self._start_children(children)
        try:
            try:
                flight = self._prepare(
                    session, keys, roll, children, lambda: max(stopped(), called_off()), asked
                )
            except (NotArmedError, HostError, NetworkError, ChildError):
                if not called_off():  # else the vehicle has ended because of the stop
                    raise
                flight = None
            if flight is None:
                return self._not_flown(children, roll, called_off=called_off())
            flight.truth = truth
            if self.on_start is not None:
                self.on_start(self)
            flight.live = self.live
            ending = flight.fly(observer, stopped, self.supervisor)
            self.results.law_concerns = flight.concerns
            if children is not None:
                flown = [n for n in self.experiment.vehicles if n not in self.results.ended]
                fault = blamed(children, flown, ending.fault)
                ending = Ending(ending.t, fault, ending.found_t)
            if flight.stopped:
                self.supervisor.request(ending.t, "stop")
            self._close(ending)
        finally:
            if children is not None:
                self._end_children(children)
            del answering  # last: a stop may come while the processes end
        return ending

    def _not_flown(self, children: ProcessGroup | None, roll: Roll, *, called_off: bool) -> Ending:
        """How a run ends that was stopped before its start."""
        for name in self.experiment.vehicles:
            if children is not None and name not in roll.tickets:
                children.kill(name)  # it compiles, which cannot be interrupted
        if not called_off:
            return Ending(0.0, None)
        sleep_until_ns(monotonic_ns() + ANSWER_NS)
        return Ending(0.0, FaultReport(FaultId.STOPPED, "stopped by the operator"))

    def _ended_as(self, *, called_off: bool) -> bytes:
        """The bearing air of vehicles whose flight has ended, or that do not start, by name."""
        if not called_off or self.results.boards:
            return self.results.ended_as()
        return msgspec.json.encode(dict.fromkeys(self.experiment.vehicles, NOT_STARTED))

    def _start_children(self, children: ProcessGroup) -> None:
        config = children.folder / "experiment.toml"
        config.write_text(tomli_w.dumps(dump(self.experiment)), encoding="utf-8")
        report = self._keep or children.folder / "report.json"
        network = self.experiment.table.lab.network
        python = [sys.executable, "-m"]
        twin = [*python, "testbed.rig.wired.twin_process", str(config), str(report)]
        children.start("twin", twin)
        for name in self.experiment.vehicles:
            agent = AgentOptions(
                name, self._relay(network.endpoint), network.lab,
                keys=neighbour(Path(network.keys), "vehicle", name) if network.keys else None,
                report=None if self._keep is None else self._keep.with_name(f"{name}.json"),
                heartbeat=children.folder / f"{name}.heartbeat",
            )  # fmt: skip
            words = msgspec.json.encode(agent, enc_hook=str).decode()
            children.start(name, [*python, "testbed.rig.wired.agent_process", words])
        self.children = {n: children.pid(n) for n in ("twin", *self.experiment.vehicles)}

    def _end_children(self, children: ProcessGroup) -> None:
        children.end(list(self.experiment.vehicles))
        children.end(["twin"])  # last, because the boards hold the valves
        report = self._keep or children.folder / "report.json"
        if report.exists():
            self.results.report = msgspec.json.decode(report.read_bytes(), type=TableReport)

    def _prepare(
        self,
        session: zenoh.Session,
        keys: Keys,
        roll: Roll,
        children: ProcessGroup | None,
        stopped: Callable[[], int],
        asked: Asked,
    ) -> "HostFlight | None":
        """Wait for the vehicles and order them to start; None: the operator stopped it.

        Raises:
            HostError: a vehicle cannot start.
        """
        there, reported, lost = set[str](), set[str](), dict[str, str]()
        end = monotonic_ns() + round(1e9 * READY_S)
        while missing := set(self.experiment.vehicles) - there:
            if not self._bench:
                for name, why in lost.items():
                    self._say(f"{name} has ended: {why}; start `testbed agent {name}` again")
            if missing != reported:
                self._checked([
                    Check("agent", name, "not on the network" if name in missing else "")
                    for name in self.experiment.vehicles
                ])  # fmt: skip
                if not self._bench:
                    absent = ", ".join(sorted(missing))
                    self._say(f"waiting for {absent}; start `testbed agent` on each computer")
                reported = missing
            if stopped():
                return None
            if children is not None:
                children.check()
            if monotonic_ns() > end:
                raise HostError(
                    f"not ready after {READY_S:g} s: {', '.join(sorted(missing))}; is `testbed"
                    " agent` running there, and does it reach"
                    f" {self.experiment.table.lab.network.endpoint}?"
                )
            sleep_until_ns(monotonic_ns() + LOOK_NS)
            before, there = there, {
                name for name in self.experiment.vehicles
                if name in roll.tickets
                and list(session.liveliness().get(keys.of(name, "alive"), timeout=1.0))
            }  # fmt: skip
            lost = dict.fromkeys(before - there, "no longer on the network")
            lost |= roll.farewells()
        preflight = Preflight(
            self.experiment, session, keys, self.disk_free, hardware=not self._bench
        )
        names = list(self.experiment.vehicles)
        if self.supervisor.fault is not None:
            self._request("reset", preflight, monotonic_ns() + round(1e9 * GREEN_S), stopped)
            if self._latch is not None:
                self._latch.clear()
        self._request("arm", preflight, monotonic_ns() + round(1e9 * GREEN_S), stopped)
        if stopped():
            return None
        if not self._agree(names):
            self.supervisor.request(0.0, "disarm")
            raise NotArmedError([Check("operator", "", "declined arming")])
        run, epoch = secrets.randbits(32), monotonic_ns() + AHEAD_NS
        clock = self.results.clock = WallClock(epoch)
        party = Party(session, self.experiment.table.lab, run, clock, self.experiment.seed, "host")
        flight = HostFlight(self.experiment, self.results, party, self.disk_free, asked)
        try:
            for name in names:
                match order(session, keys, name, Start(run, epoch, roll.tickets[name])):
                    case Accepted(board):
                        self.results.boards[name] = board
                    case Refused(reason):
                        raise HostError(f"{name} refuses to start: {reason}")
            # the vehicles float now: check them again
            self._request("run", preflight, epoch - LEASE_NS, stopped)
        except (HostError, NotArmedError, NetworkError):
            self._call_off(session, keys)
            raise
        if not self.supervisor.may_fire:  # the operator stopped it
            self._call_off(session, keys)
            return None
        self._ran = True
        if self._latch is not None:
            self._latch.set()
        while monotonic_ns() < epoch - LEASE_NS:
            flight.lease()
            sleep_until_ns(monotonic_ns() + LEASE_NS)
        return flight

    def _call_off(self, session: zenoh.Session, keys: Keys) -> None:
        """Stop vehicles that may already have an order to start."""
        self.supervisor.request(0.0, "disarm")
        for name in self.experiment.vehicles:
            with suppress(NetworkError):
                order(session, keys, name, Stop("the flight was called off"))

    def _request(
        self, what: Request, preflight: Preflight, end: int, stopped: Callable[[], int]
    ) -> None:
        """Ask the supervisor until it agrees.

        Raises:
            NotArmedError: it has not agreed by the time `end`; lists every failed check.
        """
        late = Check("checks", "", "no time for them")
        answer = Answer(False, self.supervisor.phase, (late,))
        while monotonic_ns() < end and not stopped():
            checks = preflight.checks()
            self._checked(checks)
            answer = self.supervisor.request(0.0, what, checks)
            if answer.done:
                return
            sleep_until_ns(monotonic_ns() + 5 * LOOK_NS)
        if not stopped():
            raise NotArmedError(answer.red)
