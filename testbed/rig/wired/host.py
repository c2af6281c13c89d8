"""The host's process: laws on the host, the log, and the start and end of a flight.

On the bench it also starts the twin's server and one process per vehicle. On the table these run
elsewhere, and the host waits for them.
"""

import os
import secrets
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path

import msgspec
import tomli_w

from testbed.config import Experiment, dump
from testbed.core.codes import FaultId, FaultReport
from testbed.flight.arming import Check
from testbed.flight.loop import Ending, Observer
from testbed.flight.supervisor import Supervisor
from testbed.metrics.run_metrics import Touch
from testbed.net.access import open_lab
from testbed.net.credentials import neighbour
from testbed.net.flight_note import noted
from testbed.net.keys import Keys
from testbed.net.links import Party
from testbed.net.session import NetworkError, answer_to, on_message
from testbed.net.stop import NOT_STARTED
from testbed.realtime.processes import ChildError, ProcessGroup
from testbed.realtime.wall_clock import WallClock, monotonic_ns, sleep_until_ns
from testbed.rig.fault_latch import FaultLatch
from testbed.rig.interface import not_armed
from testbed.rig.live import LiveFlight
from testbed.rig.wired.agent_process import AgentOptions
from testbed.rig.wired.arming_requests import ArmingRequests, NotArmedError
from testbed.rig.wired.blocking_law import blamed
from testbed.rig.wired.local import loopback
from testbed.rig.wired.preflight import Preflight
from testbed.rig.wired.run_results import RunResults
from testbed.rig.wired.stop_requests import StopRequests
from testbed.rig.wired.suitable import check_wires
from testbed.rig.wired.table_report import TableReport
from testbed.rig.wired.trial_call import compile_host
from testbed.rig.wired.vehicle_contact import HostError, VehicleContact
from testbed.rig.wired.wired_flight import HostFlight

READY_S = 180.0  # time for vehicles to get ready; the first start compiles
GREEN_S = 10.0  # time for checks to pass: the camera rate is counted over a second
AHEAD_NS = 1_500_000_000  # from the order to start to the run's time 0
LEASE_NS = 100_000_000  # between two leases before time 0
LOOK_NS = 20_000_000
ANSWER_NS = 500_000_000  # after a stop before the start: `testbed stop` asks who stands


class WireRig:
    """The experiment on real wires.

    Args:
        experiment: the experiment to fly.
        bench: start the twin and the vehicles here; else wait for those of the lab.
        keep: file for the twin's report, beside which the vehicles' reports are written; None: a
            file in a temporary folder.
        log: run folder; its disk must not be full.
        agree: asks the operator whether these vehicles may be armed; by default they may.
        latch: keeps a fault for the next run.
        latched: fault of the previous run, which must be reset first.
        notify: called with messages for the operator; by default they are dropped.
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
        notify: Callable[[str], None] = lambda text: None,
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
        self._notify, self._checked = notify, checked
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
        children = stack.enter_context(ProcessGroup()) if self._bench else None
        if children is not None:
            self.experiment = loopback(self.experiment, children.folder)
        contact = self._open_network(stack)
        if children is not None:
            self._start_children(children)
        try:
            flight = self._prepare(contact, children, lambda: max(stopped(), contact.called_off))
            if flight is None:
                return self._not_flown(children, contact)
            return self._flown(flight, children, observer, stopped)
        finally:
            if children is not None:
                self._end_children(children)

    def _open_network(self, stack: ExitStack) -> VehicleContact:
        """Open the host's end of the network; from then on a stop reaches the host.

        It stays open until `stack` is closed, because a stop may come while the processes end.
        """
        network = self.experiment.table.lab.network
        opened, self.results.key_warnings = open_lab(network, self.experiment.vehicles)
        session, keys = stack.enter_context(opened), Keys(network.lab)
        names, text = list(self.experiment.vehicles), msgspec.json.encode(self.experiment)
        contact = VehicleContact(session, keys, names, StopRequests())
        answering = [
            answer_to(session, keys.experiment, lambda _: text),
            answer_to(session, keys.ended, lambda _: self._ended_as(contact)),
            on_message(session, keys.stop, contact.stops.count),
            answer_to(session, keys.clock, lambda _: monotonic_ns().to_bytes(8, "little")),
        ]
        stack.callback(answering.clear)
        note = noted(
            network.endpoint, network.lab, network.keys, names,
            self.experiment.name, warn=self._notify, folder=self._log,
        )  # fmt: skip
        stack.enter_context(note)
        return contact

    def _flown(
        self, flight: HostFlight, children: ProcessGroup | None, observer: Observer,
        stopped: Callable[[], int],
    ) -> Ending:  # fmt: skip
        """Fly, and find out why it ended."""
        if self.on_start is not None:
            self.on_start(self)
        ending = flight.fly(observer, stopped, self.supervisor)
        self.results.law_concerns = flight.concerns
        if children is not None:
            flying = [n for n in self.experiment.vehicles if n not in self.results.ended]
            fault = blamed(children, flying, ending.fault)
            ending = Ending(ending.t, fault, ending.found_t)
        if flight.stopped:
            self.supervisor.request(ending.t, "stop")
        self._close(ending)
        return ending

    def _not_flown(self, children: ProcessGroup | None, contact: VehicleContact) -> Ending:
        """How a run ends that was stopped before its start."""
        for name in self.experiment.vehicles:
            if children is not None and name not in contact.roll.tickets:
                children.kill(name)  # it compiles, which cannot be interrupted
        if not contact.called_off:
            return Ending(0.0, None)
        sleep_until_ns(monotonic_ns() + ANSWER_NS)
        return Ending(0.0, FaultReport(FaultId.STOPPED, "stopped by the operator"))

    def _ended_as(self, contact: VehicleContact) -> bytes:
        """The bearing air of vehicles whose flight has ended, or that do not start, by name."""
        if not contact.called_off or self.results.boards:
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

    # Before the start

    def _prepare(
        self, contact: VehicleContact, children: ProcessGroup | None, stopped: Callable[[], int]
    ) -> HostFlight | None:
        """Wait for the vehicles and order them to start; None: an operator stopped the run.

        Raises:
            HostError: a vehicle cannot start.
            NotArmedError: arming checks failed, or the operator declined.
        """
        try:
            if not self._await_vehicles(contact, children, stopped):
                return None
            preflight = Preflight(
                self.experiment, contact.session, contact.keys, self.disk_free,
                hardware=not self._bench,
            )  # fmt: skip
            arming = ArmingRequests(self.supervisor, preflight, self._checked, stopped)
            return self._start(contact, arming) if self._arm(arming) else None
        except (NotArmedError, HostError, NetworkError, ChildError):
            if contact.called_off:  # a vehicle has ended because of the stop
                return None
            raise

    def _await_vehicles(
        self, contact: VehicleContact, children: ProcessGroup | None, stopped: Callable[[], int]
    ) -> bool:
        """Wait until all vehicles are on the network; False: an operator stopped the run.

        Raises:
            HostError: they are not within READY_S.
        """
        reported = set[str]()
        end = monotonic_ns() + round(1e9 * READY_S)
        while missing := set(self.experiment.vehicles) - contact.present:
            if missing != reported:
                self._report_missing(missing)
                reported = missing
            if stopped():
                return False
            if children is not None:
                children.check()
            if monotonic_ns() > end:
                raise HostError(
                    f"not ready after {READY_S:g} s: {', '.join(sorted(missing))}; is `testbed"
                    " agent` running there, and does it reach"
                    f" {self.experiment.table.lab.network.endpoint}?"
                )
            sleep_until_ns(monotonic_ns() + LOOK_NS)
            gone = contact.update()
            if not self._bench:
                for name, why in gone.items():
                    self._notify(f"{name} has ended: {why}; start `testbed agent {name}` again")
        return True

    def _report_missing(self, missing: set[str]) -> None:
        """Tell the operator which vehicles are not on the network."""
        self._checked([
            Check("agent", name, "not on the network" if name in missing else "")
            for name in self.experiment.vehicles
        ])  # fmt: skip
        if not self._bench:
            absent = ", ".join(sorted(missing))
            self._notify(f"waiting for {absent}; start `testbed agent` on each computer")

    def _arm(self, arming: ArmingRequests) -> bool:
        """Reset the fault of the previous run, and arm; False: an operator stopped the run.

        Raises:
            NotArmedError: arming checks failed, or the operator declined.
        """
        if self.supervisor.fault is not None:
            arming.ask("reset", monotonic_ns() + round(1e9 * GREEN_S))
            if self._latch is not None:
                self._latch.clear()
        arming.ask("arm", monotonic_ns() + round(1e9 * GREEN_S))
        if arming.stopped():
            return False
        if not self._agree(list(self.experiment.vehicles)):
            self.supervisor.request(0.0, "disarm")
            raise NotArmedError([Check("operator", "", "declined arming")])
        return True

    def _start(self, contact: VehicleContact, arming: ArmingRequests) -> HostFlight | None:
        """Order the armed vehicles to start, and send leases until the run's time 0.

        None: an operator stopped the run.

        Raises:
            HostError: a vehicle refuses to start.
            NotArmedError: a check failed while the vehicles float.
        """
        run, epoch = secrets.randbits(32), monotonic_ns() + AHEAD_NS
        clock = self.results.clock = WallClock(epoch)
        lab, seed = self.experiment.table.lab, self.experiment.seed
        party = Party(contact.session, lab, run, clock, seed, "host")
        flight = HostFlight(
            self.experiment, self.results, party, self.disk_free, contact.stops, self.live
        )
        try:
            for name, board in contact.start(run, epoch):
                self.results.boards[name] = board
            # the vehicles float now: check them again
            arming.ask("run", epoch - LEASE_NS)
        except (HostError, NotArmedError, NetworkError):
            self._call_off(contact)
            raise
        if not self.supervisor.may_fire:  # the operator stopped it
            self._call_off(contact)
            return None
        self._ran = True
        if self._latch is not None:
            self._latch.set()
        while monotonic_ns() < epoch - LEASE_NS:
            flight.lease()
            sleep_until_ns(monotonic_ns() + LEASE_NS)
        return flight

    def _call_off(self, contact: VehicleContact) -> None:
        self.supervisor.request(0.0, "disarm")
        contact.call_off()
