"""One vehicle's process: cameras and setpoints in, valve commands out.

It gets the experiment from the host, gets ready, reports it, and waits for the order to start. In
every case it ends with closed valves and, as far as possible, at rest and without bearing air:

* the host or the network is lost: setpoints and permit expire, and the vehicle follows the fault
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
import zenoh
from msgspec.structs import replace

from testbed.config import Experiment
from testbed.core.error import TestbedError
from testbed.files import write_atomic
from testbed.flight.loop import VehicleNode, fly
from testbed.mocap.poses import MocapPoses
from testbed.mocap.source import make_source
from testbed.net.clock import HostClock, Reader, read_clock
from testbed.net.commands import (
    Ended,
    Start,
    config_id,
)
from testbed.net.direct_stop import StopListener
from testbed.net.envelope import Outbox
from testbed.net.keys import Keys
from testbed.net.links import Party, ZenohVehicleLink
from testbed.net.roll_call import Enrolment, last_words
from testbed.net.session import NetworkError, NobodyError, Publisher, Subscriber, ask, dial
from testbed.realtime.law_watch import patience
from testbed.realtime.processes import orphaned
from testbed.realtime.scheduling import no_garbage_collection, realtime_priority
from testbed.realtime.wall_clock import WallClock, monotonic_ns, sleep_until_ns
from testbed.rig.chain import brakes_first, make_agent, watched
from testbed.rig.twin import warm_up
from testbed.rig.wired.command_guard import CommandGuard
from testbed.rig.wired.command_server import CommandServer
from testbed.rig.wired.counts import count
from testbed.rig.wired.onboard import Permitted, VehicleFlight, counted, land
from testbed.rig.wired.preflight_monitor import PreflightMonitor
from testbed.rig.wired.process_faults import ProcessFaults
from testbed.rig.wired.thrusters import make_thrusters

PRIORITY = 20
LOOK_NS = 10_000_000  # polling period while waiting
PATIENCE_S = 60.0  # longest wait for a host that does not answer
TRY_S = 2.0
ALONE_NS = 2_000_000_000  # several leases: a lost session has expired by then
KEPT_S = 10.0


class VehicleError(TestbedError):
    """This vehicle cannot fly."""


def unheard(_: str) -> None:
    """Drop a message: there is no terminal."""


def fly_vehicle(
    name: str, endpoint: str, lab: str, port: str | None, badge: Path | None = None, *,
    child: bool, report: Path | None = None, say: Callable[[str], None] = unheard,
) -> None:  # fmt: skip
    """Get ready, wait for the order, fly once, and report to the host.

    Args:
        name: of the vehicle.
        endpoint: of the host.
        lab: first part of the network keys.
        port: serial port of the board; None: from the table file.
        badge: its key folder; None: the host is on this machine.
        child: end when standard input closes.
        report: a file for its final report, in case the host is lost.
        say: called with progress messages; by default they are dropped.

    Raises:
        VehicleError: the vehicle cannot fly.
    """

    def gone() -> bool:
        return child and orphaned()

    keys = Keys(lab)
    with ExitStack() as stack:
        session = stack.enter_context(await_host(endpoint, badge, gone))
        stack.enter_context(last_words(session, keys, name))
        experiment = ask_experiment(session, keys, gone)
        if name not in experiment.vehicles:
            raise VehicleError(f"the host flies {', '.join(experiment.vehicles)}, not {name}")
        setup, wires = experiment.vehicles[name], experiment.table.lab
        serial = wires.thrusters.system == "serial"
        port = port or wires.serial.ports.get(name)
        if serial and port is None:
            raise VehicleError(
                f"no serial port for {name}: expected --serial, or an entry of"
                " [lab.serial.ports] in the table file"
            )
        say(f"the host flies {experiment.name}; getting ready (compiles on the first run)")
        clock = WallClock(monotonic_ns())  # replaced when the run's time 0 is known
        process_faults = ProcessFaults(experiment.inject, lambda: clock.now)
        spoilt = partial(process_faults.spoilt, name) if experiment.inject else None
        stack.enter_context(watched(experiment))
        agent = make_agent(experiment, name, spoilt)
        with patience():
            warm_up(experiment)
        if child and serial and port is not None:
            await_port(port, gone)
        source = make_source(wires.mocap, session, keys)
        stack.callback(source.close)
        thrusters = stack.enter_context(make_thrusters(wires, name, setup.model, port))
        clock_of_host = read_clock(session, keys)
        reader = Reader(session, keys, clock_of_host)
        # these keys must be silent before the order to start
        strangers = [Subscriber(session, key) for key in (keys.of(name, "setpoint"), keys.permit)]
        lookout = PreflightMonitor(experiment, name, source, thrusters, reader, strangers)
        enrolment = Enrolment(session, keys, name)
        tower = CommandServer(
            session, keys, name, thrusters.board, lookout, enrolment.ticket, clock_of_host.to_own
        )
        stack.enter_context(
            no_garbage_collection()
        )  # now, because the last garbage collection takes time
        await_alone(session, keys, name)
        listen_for_stops(name, lab, endpoint, badge, tower, stack, say)
        token = session.liveliness().declare_token(keys.of(name, "alive"))
        stack.callback(token.undeclare)
        say(f"ready, {thrusters.board}; waiting for the host's order to start")

        def wait() -> None:
            lookout.look()
            enrolment.look()

        start = await_start(tower, wait, gone)
        if start is None:
            say(f"not flown: {tower.stop_reason or 'its parent process has ended'}")
            return
        say("flies")
        epoch = clock_of_host.to_own(start.epoch_ns)
        assert epoch is not None
        clock.epoch_ns = epoch
        thrusters.epoch_us = epoch // 1000
        worse = partial(process_faults.air, name)
        party = Party(session, wires, start.session, clock, experiment.seed, name, worse)
        link = ZenohVehicleLink(party, experiment.vehicles)
        event = Publisher(session, keys.of(name, "event"))
        drift = HostClock(session, keys, clock, start.epoch_ns)
        stack.enter_context(realtime_priority(PRIORITY))
        thrusters.bearing(on=True)
        while monotonic_ns() < epoch - LOOK_NS:
            lookout.look()
            sleep_until_ns(min(monotonic_ns() + LOOK_NS, epoch - LOOK_NS))
        for ear in strangers:
            ear.close()
        poses = MocapPoses(source, wires.mocap, clock, name)
        flight = VehicleFlight(
            party, thrusters, poses, tower, config_id(experiment), drift, link, process_faults,
            brakes_first(experiment, name),
        )  # fmt: skip
        if tower.stop_reason is None:
            thrusters.arm()
        tower.take_off(thrusters.land)
        port_gate = CommandGuard(thrusters, lambda: clock.now, experiment.flight.jet_period_s)
        node = VehicleNode(name, agent, poses, port_gate, link, flight.vitals)
        with counted(flight.signals):
            ending = fly(
                clock, [Permitted(node, flight, clock)], [], experiment.flight.jet_period_s,
                experiment.ticks, flight, stopped=flight.over,
            )  # fmt: skip
            last = Permitted(node, flight, clock)
            ended_by = land(experiment, ending, clock, last, flight, thrusters)
        fault = ending.fault or ended_by or flight.fault
        fault = fault and replace(fault, vehicle=name)
        if poses.trouble is not None and fault is not None:
            why = getattr(source, "complaint", "")
            note = f"its body is {poses.trouble}{f': {why}' if why else ''}"
            fault = replace(fault, notes=(*fault.notes, note))
        counts = count(link, thrusters, poses, clock_of_host, port_gate.refused)
        out = Outbox(start.session)
        ended = Ended(
            ending.t, fault, counts, flight.rows, flight.responses,
            None if flight.landed_at is None else max(0.0, flight.landed_at - ending.t),
            "on" if thrusters.floats else "off",
        )  # fmt: skip
        if report is not None:
            write_atomic(report, msgspec.json.encode(ended))
        event.say(out.seal(ended, clock.now, clock.now + KEPT_S))
        say(f"ended after {ending.t:.1f} s{f' by a fault: {fault.words}' if fault else ''}")
        await_end(gone, tower)
        if flight.signals.times:
            raise KeyboardInterrupt


def listen_for_stops(
    name: str, lab: str, endpoint: str, badge: Path | None, tower: CommandServer,
    stack: ExitStack, say: Callable[[str], None],
) -> None:  # fmt: skip
    """Let the operator stop this vehicle without its host, until the stack is closed."""
    try:
        listener = StopListener(
            name, lab, endpoint, badge, lambda stop: tower.operator_stop(stop.encode())
        )
    except (ImportError, OSError, ValueError) as error:
        say(f"warning: `testbed stop` reaches {name} through its host only: {error}")
    else:
        stack.callback(listener.close)


def await_host(endpoint: str, badge: Path | None, gone: Callable[[], bool]) -> zenoh.Session:
    """Connect as soon as the host listens; short attempts, because each one blocks Ctrl-C."""
    end = monotonic_ns() + round(1e9 * PATIENCE_S)
    while True:
        try:
            return dial(endpoint, TRY_S, badge)
        except NobodyError:
            if monotonic_ns() > end or gone():
                raise


def await_alone(session: zenoh.Session, keys: Keys, name: str) -> None:
    """Check that no other agent flies under this name; a killed one has timed out by then.

    Raises:
        VehicleError: another agent does.
    """
    end = monotonic_ns() + ALONE_NS
    while list(session.liveliness().get(keys.of(name, "alive"), timeout=1.0)):
        if monotonic_ns() > end:
            raise VehicleError(
                f"another agent flies as {name}: expected one `testbed agent` for each vehicle;"
                " end the other, or wait until its flight is over"
            )
        sleep_until_ns(monotonic_ns() + 10 * LOOK_NS)


def ask_experiment(session: zenoh.Session, keys: Keys, gone: Callable[[], bool]) -> Experiment:
    """Get the experiment from the host."""
    end = monotonic_ns() + round(1e9 * PATIENCE_S)
    while True:
        try:
            return msgspec.json.decode(ask(session, keys.experiment), type=Experiment)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            raise VehicleError(
                f"the host's experiment cannot be read: {error}; is it of the same version?"
            ) from None
        except NetworkError:
            if monotonic_ns() > end or gone():
                raise
        sleep_until_ns(monotonic_ns() + 20 * LOOK_NS)


def await_port(port: str, gone: Callable[[], bool]) -> None:
    """Wait for the port, which the bench may create later; after the wait go on without it."""
    end = monotonic_ns() + round(1e9 * PATIENCE_S)
    while not Path(port).exists() and monotonic_ns() < end and not gone():
        sleep_until_ns(monotonic_ns() + LOOK_NS)


def await_start(
    tower: CommandServer, poll: Callable[[], object], gone: Callable[[], bool]
) -> Start | None:
    """Wait for the order to start; None if it will not come."""
    while True:
        try:
            return tower.starts.get_nowait()
        except Empty:
            poll()
            if tower.stop_reason is not None or gone():
                return None
            sleep_until_ns(monotonic_ns() + LOOK_NS)


def await_end(gone: Callable[[], bool], tower: CommandServer) -> None:
    """Wait half a second, so that the report is sent."""
    end = monotonic_ns() + 500_000_000
    while monotonic_ns() < end and not gone():
        sleep_until_ns(monotonic_ns() + LOOK_NS)
