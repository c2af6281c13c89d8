"""Verbs of the processes on the wires: `twin` and `agent`."""

import contextlib
import signal
from collections.abc import Sequence
from pathlib import Path

import msgspec

from firmware_interface.compiler import CompilerError
from firmware_interface.limits import LimitsError
from firmware_interface.line_tap import TapError
from firmware_interface.serial_board import BoardError
from firmware_interface.serial_thrusters import ThrustersError
from testbed.cli.exit_code import FAULT, INTERRUPTED, OK
from testbed.cli.refusal import errors, refuse
from testbed.config import ConfigError, find, load
from testbed.core.lab import Network
from testbed.files import write_atomic
from testbed.net.credentials import BadgeError, read_badge, trouble
from testbed.net.session import NetworkError
from testbed.realtime.heartbeat import attach, in_file
from testbed.realtime.processes import end_on_terminate, orphaned
from testbed.realtime.scheduling import prefer_process, preferred, steady
from testbed.rig.twin import warm_up
from testbed.rig.wired.local import local
from testbed.rig.wired.server import TableServer, port_of
from testbed.rig.wired.vehicle import VehicleError, fly_vehicle

PRIORITY = 30  # the table does not wait for anybody


def serve_twin(
    name: str, overrides: Sequence[str], ports: Path | None, report: Path | None, *, child: bool,
    here: bool = False,
) -> int:  # fmt: skip
    """Serve until told to end; the exit code."""
    end_on_terminate()
    try:
        experiment = load(find(name), overrides)
        if here:
            experiment = local(experiment)
    except ConfigError as error:
        return refuse(error)
    try:
        warm_up(experiment)
        with TableServer(experiment, ports) as server:
            wire = experiment.table.lab.mocap
            if not child:
                errors.print(
                    f"NatNet {wire.version} at {wire.server}, commands at {wire.command_port}"
                )
                for vehicle in experiment.vehicles:
                    errors.print(f"{vehicle}: {port_of(experiment, vehicle, ports)}")
            signal.signal(signal.SIGUSR1, lambda number, frame: server.cut_next())
            for pid in server.pids.values():  # a chip does not wait for a turn either
                prefer_process(pid, PRIORITY + 10)
            with steady(), preferred(PRIORITY), contextlib.suppress(KeyboardInterrupt):
                server.run(lambda: child and orphaned())
            if report is not None:
                write_atomic(report, msgspec.json.encode(server.report()))
    except (OSError, TapError, BoardError, CompilerError, LimitsError) as error:
        return refuse(error, FAULT)
    except KeyboardInterrupt:
        return INTERRUPTED
    return OK


def fly_agent(
    name: str, endpoint: str | None, lab: str | None, port: str | None,
    keys: Path | None = None, *, child: bool, report: Path | None = None,
    heart: Path | None = None,
) -> int:  # fmt: skip
    """Fly one vehicle; the exit code."""
    end_on_terminate()
    try:
        if keys is not None:
            badge = read_badge(keys)
            if (badge.role, badge.name) != ("vehicle", name):
                raise BadgeError(f"{keys} has the keys of {badge.common_name}, not of {name}")
            if badge.ending:
                errors.print(badge.ending, style="yellow", markup=False, soft_wrap=True)
            endpoint, lab = endpoint or badge.endpoint, lab or badge.lab
        endpoint, lab = endpoint or Network().endpoint, lab or Network().lab
        if (why := trouble(endpoint, keys)) is not None:
            raise BadgeError(f"{endpoint} is not opened: {why}")
    except BadgeError as error:
        return refuse(error)

    def say(text: str) -> None:
        if not child:
            errors.print(f"{name}: {text}", markup=False, soft_wrap=True)

    if heart is not None:
        attach(in_file(heart))  # the host sees there whether this vehicle's law is being called
    say(f"looking for the host at {endpoint}")
    try:
        fly_vehicle(
            name, endpoint, lab, port, keys, child=child, report=report, say=say,
        )  # fmt: skip
    except (NetworkError, VehicleError, ThrustersError, BoardError, LimitsError, OSError) as error:
        return refuse(error, FAULT)
    except KeyboardInterrupt:
        return INTERRUPTED
    return OK
