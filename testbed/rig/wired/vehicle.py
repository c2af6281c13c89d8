"""One vehicle's process: cameras and setpoints in, valve commands out.

    connect -> prepare -> check -> await_start -> start -> fly -> stand -> report -> ended
                                        |                                              |
                                        +------------------ no order ------------------+

An error in any phase ends the process. In every case it ends with closed valves and, as far as
possible, at rest and without bearing air:

* the host or the network is lost: setpoints and lease expire, and the vehicle follows the fault
  table, wherever its law runs;
* this process hangs or is killed: the plan ends and the board's watchdog latches SAFE;
* the board, its line or the cameras fail: the flight ends, and the host gets a report.
"""

from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from queue import Empty

import msgspec
from msgspec.structs import replace

from testbed.core.codes import FaultId, FaultReport
from testbed.files import write_atomic
from testbed.flight.frame_watch import FrameWatch
from testbed.flight.loop import Ending, VehicleNode, fly
from testbed.mocap.poses import MocapPoses
from testbed.mocap.source import make_source
from testbed.net.clock import HostClock, Reader, read_clock
from testbed.net.commands import Ended, Start, config_id
from testbed.net.direct_stop import StopListener
from testbed.net.envelope import Outbox
from testbed.net.keys import Keys
from testbed.net.links import Party, ZenohVehicleLink
from testbed.net.roll_call import Enrolment, farewell, last_words
from testbed.net.session import Publisher, Subscriber
from testbed.realtime.law_watch import patience
from testbed.realtime.scheduling import realtime_priority, steady_memory
from testbed.realtime.wall_clock import WallClock, monotonic_ns, sleep_until_ns
from testbed.rig.chain import brakes_first, watched
from testbed.rig.forked import ForkedAgent, make_vehicle
from testbed.rig.twin import warm_up
from testbed.rig.wired.command_guard import CommandGuard
from testbed.rig.wired.command_server import CommandServer
from testbed.rig.wired.counts import count
from testbed.rig.wired.gains import OnboardGains
from testbed.rig.wired.host_contact import (
    LOOK_NS,
    ask_experiment,
    await_alone,
    await_port,
    connect,
    port_of,
)
from testbed.rig.wired.onboard import KEPT_S, LeasedNode, VehicleFlight, counted, land
from testbed.rig.wired.preflight_monitor import PreflightMonitor
from testbed.rig.wired.process_faults import ProcessFaults
from testbed.rig.wired.thrusters import make_thrusters
from testbed.rig.wired.valve_watch import ValveWatch

PRIORITY = 20
SENT_NS = 500_000_000  # time for the report to be sent


class VehicleProcess:
    """Goes through the phases once. The stack closes all that they open, valves included."""

    def __init__(
        self, name: str, endpoint: str, lab: str, port: str | None = None,
        credentials: Path | None = None, *, gone: Callable[[], bool] | None = None,
        report: Path | None = None, notify: Callable[[str], None] = lambda text: None,
    ) -> None:  # fmt: skip
        """Name what the vehicle needs.

        Args:
            name: of the vehicle.
            endpoint: of the host.
            lab: first part of the network keys.
            port: serial port of the board; None: from the table file.
            credentials: its key folder; None: the host is on this machine.
            gone: whether the parent process has ended, for the child of a host.
            report: a file for its final report, in case the host is lost.
            notify: called with progress messages; by default they are dropped.
        """
        self.name, self.endpoint, self.lab, self.port = name, endpoint, lab, port
        self.credentials, self.report_file, self.notify = credentials, report, notify
        self.keys, self.stack, self.child = Keys(lab), ExitStack(), gone is not None
        self.gone = gone or (lambda: False)

    def run(self) -> None:
        """All phases and what follows each.

        Raises:
            VehicleError: the vehicle cannot fly.
            KeyboardInterrupt: stopped at its own terminal; it stands.
        """
        with self.stack:
            self.connect()
            self.prepare()
            self.check()
            start = self.await_start()
            if start is None:
                why = self.commands.stop_reason or "its parent process has ended"
                self.notify(f"not flown: {why}")
                if self.commands.operator_stops:
                    farewell(self.session, self.keys, self.name, why, by_operator=True)
                return
            self.start(start)
            with counted(self.flight.signals):
                ending = self.fly()
                ended_by = self.stand(ending)
            self.report(start, ending, ended_by)
            if self.flight.signals.times:
                raise KeyboardInterrupt

    def connect(self) -> None:
        """Find the host and get the experiment."""
        self.session = self.stack.enter_context(connect(self.endpoint, self.credentials, self.gone))
        self.stack.enter_context(last_words(self.session, self.keys, self.name))
        self.experiment = ask_experiment(self.session, self.keys, self.gone)
        self.port = port_of(self.experiment, self.name, self.port)

    def prepare(self) -> None:
        """Compile the chain, and open the cameras and the board."""
        name, experiment, wires = self.name, self.experiment, self.experiment.table.lab
        self.notify(f"the host flies {experiment.name}; getting ready (compiles on the first run)")
        self.clock = WallClock(monotonic_ns())  # replaced when the run's time 0 is known
        self.process_faults = ProcessFaults(experiment.inject, lambda: self.clock.now)
        spoilt = partial(self.process_faults.spoilt, name) if experiment.inject else None
        self.stack.enter_context(watched(experiment))
        self.agent = make_vehicle(experiment, name, spoilt)
        with patience():
            warm_up(experiment)
        if self.child and self.port is not None:
            await_port(self.port, self.gone)
        self.source = make_source(wires.mocap, self.session, self.keys)
        self.stack.callback(self.source.close)
        self.thrusters = self.stack.enter_context(
            make_thrusters(wires, name, experiment.vehicles[name].model, self.port)
        )

    def check(self) -> None:
        """Check that no other agent has this name; then open the vehicle to orders and stops."""
        name, session, keys = self.name, self.session, self.keys
        self.clock_of_host = read_clock(session, keys)
        reader = Reader(session, keys, self.clock_of_host)
        # these keys must be silent before the order to start
        self.foreign_keys = [
            Subscriber(session, key) for key in (keys.of(name, "setpoint"), keys.lease)
        ]
        self.preflight = PreflightMonitor(
            self.experiment, name, self.source, self.thrusters, reader, self.foreign_keys
        )
        self.enrolment = Enrolment(session, keys, name)
        self.commands = CommandServer(
            session, keys, name, self.thrusters.board, self.preflight, self.enrolment.ticket,
            self.clock_of_host.to_own,
        )  # fmt: skip
        # now, because the last garbage collection takes time
        self.stack.enter_context(steady_memory())
        await_alone(session, keys, name)
        try:
            listener = StopListener(
                name, self.lab, self.endpoint, self.credentials,
                lambda stop: self.commands.operator_stop(stop.encode()),
            )  # fmt: skip
        except (ImportError, OSError, ValueError) as error:
            self.notify(f"warning: `testbed stop` reaches {name} through its host only: {error}")
        else:
            self.stack.callback(listener.close)
        self.stack.callback(session.liveliness().declare_token(keys.of(name, "alive")).undeclare)

    def await_start(self) -> Start | None:
        """Wait for the order to start; None if it will not come."""
        self.notify(f"ready, {self.thrusters.board}; waiting for the host's order to start")
        while True:
            try:
                return self.commands.starts.get_nowait()
            except Empty:
                self.preflight.look()
                self.enrolment.look()
                if self.commands.stop_reason is not None or self.gone():
                    return None
                sleep_until_ns(monotonic_ns() + LOOK_NS)

    def start(self, start: Start) -> None:
        """Switch the bearing air on, wait for the run's time 0, and arm unless it was stopped."""
        self.notify("flies")
        name, experiment, clock, thrusters = self.name, self.experiment, self.clock, self.thrusters
        epoch = self.clock_of_host.to_own(start.epoch_ns)
        assert epoch is not None
        clock.epoch_ns, thrusters.epoch_us = epoch, epoch // 1000
        wires, worse = experiment.table.lab, partial(self.process_faults.radio, name)
        party = Party(self.session, wires, start.session, clock, experiment.seed, name, worse)
        self.link = ZenohVehicleLink(party, experiment.vehicles)
        self.event = Publisher(self.session, self.keys.of(name, "event"))
        host_clock = HostClock(self.session, self.keys, clock, start.epoch_ns)
        self.stack.enter_context(realtime_priority(PRIORITY))
        thrusters.bearing(on=True)
        while monotonic_ns() < epoch - LOOK_NS:
            self.preflight.look()
            sleep_until_ns(min(monotonic_ns() + LOOK_NS, epoch - LOOK_NS))
        for key in self.foreign_keys:
            key.close()
        self.poses = MocapPoses(self.source, wires.mocap, clock, name)
        model, period = experiment.vehicles[name].model, experiment.flight.jet_period_s
        self.flight = VehicleFlight(
            party, thrusters, self.poses, self.commands, config_id(experiment), host_clock,
            self.link, self.process_faults, brakes_first(experiment, name),
            FrameWatch(wires.mocap.reference, experiment.table.mocap.noise),
            ValveWatch(len(model.jets), model.command_delay_s, period),
        )  # fmt: skip
        if self.commands.stop_reason is None:
            thrusters.arm()
        self.commands.take_off(thrusters.land)
        self.guard = CommandGuard(thrusters, lambda: clock.now, period)
        node = VehicleNode(name, self.agent, self.poses, self.guard, self.link, self.flight.vitals)
        self.node = LeasedNode(node, self.flight, clock)
        if isinstance(self.agent, ForkedAgent):
            gains = OnboardGains(experiment, self.agent, start.session, lambda: clock.now)
            self.commands.retune = gains.obey

    def fly(self) -> Ending:
        """Fly until the last tick, a fault or a stop."""
        return fly(
            self.clock, [self.node], [], self.experiment.flight.jet_period_s,
            self.experiment.ticks, self.flight, stopped=self.flight.over,
        )  # fmt: skip

    def stand(self, ending: Ending) -> FaultReport | None:
        """Hold if asked, brake, shut valves and air; returns the fault that ended a hold."""
        return land(self.experiment, ending, self.clock, self.node, self.flight, self.thrusters)

    def fault(self, ending: Ending, ended_by: FaultReport | None) -> FaultReport | None:
        """The loop's fault, or else that of a hold, the board, the lease or the terminal."""
        fault = ending.fault or ended_by or self.flight.fault
        fault = fault and self.flight.flood.blamed(replace(fault, vehicle=self.name))
        if self.poses.trouble is None or fault is None:
            return fault
        why = getattr(self.source, "complaint", "")
        note = f"its body is {self.poses.trouble}{f': {why}' if why else ''}"
        return replace(fault, notes=(*fault.notes, note))

    def report(self, start: Start, ending: Ending, ended_by: FaultReport | None) -> None:
        """Tell the host how the flight ended; wait half a second, so that it is sent."""
        flight, fault, now = self.flight, self.fault(ending, ended_by), self.clock.now
        refused = self.guard.refused
        ended = Ended(
            ending.t, fault,
            count(self.link, self.thrusters, self.poses, self.clock_of_host, refused),
            flight.rows, flight.responses,
            None if flight.landed_at is None else max(0.0, flight.landed_at - ending.t),
            "on" if self.thrusters.floats else "off", self.agent.jets,
            self.agent.warned,
        )  # fmt: skip
        if self.report_file is not None:
            write_atomic(self.report_file, msgspec.json.encode(ended))
        self.event.send(Outbox(start.session).seal(ended, now, now + KEPT_S))
        by = "" if fault is None or fault.id == FaultId.STOPPED else " by a fault"
        self.notify(f"ended after {ending.t:.1f} s{by}{f': {fault.words}' if fault else ''}")
        end = monotonic_ns() + SENT_NS
        while monotonic_ns() < end and not self.gone():
            sleep_until_ns(monotonic_ns() + LOOK_NS)
