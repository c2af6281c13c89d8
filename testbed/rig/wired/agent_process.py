"""A vehicle's process: connects to its host and flies on its order.

    python -m testbed.rig.wired.agent_process '{"name": "sat1", "endpoint": "tcp/...", ...}'

A host on the bench starts it with this command; it ends when its standard input closes.
"""

import sys
from collections.abc import Callable
from pathlib import Path

import msgspec
from msgspec import Struct

from firmware_interface.limits import LimitsError
from firmware_interface.serial_board import BoardError
from firmware_interface.serial_thrusters import ThrustersError
from testbed.core.lab import Network
from testbed.net.credentials import CredentialsError, read_credentials, untrusted
from testbed.net.session import NetworkError
from testbed.realtime.heartbeat import attach, in_file
from testbed.realtime.processes import orphaned, run_as_child
from testbed.rig.wired.host_contact import VehicleError
from testbed.rig.wired.vehicle import VehicleProcess

FAILURES = (NetworkError, VehicleError, ThrustersError, BoardError, LimitsError, OSError)


class AgentOptions(Struct, frozen=True):
    """Which vehicle flies, and where its host and board are."""

    name: str
    endpoint: str | None = None  # None: from the keys, or loopback
    lab: str | None = None  # None: from the keys, or "lab"
    port: str | None = None  # serial port of the board; None: from the table file
    keys: Path | None = None
    report: Path | None = None  # file for the report at the end
    heartbeat: Path | None = None  # heartbeat file: shows the host whether the law is being called


def fly(agent: AgentOptions, notify: Callable[[str], None], *, child: bool) -> None:
    """Fly one vehicle, until its host or the operator ends it.

    Raises:
        CredentialsError: the keys are not this vehicle's, or do not match the endpoint.
        NetworkError, VehicleError, ThrustersError, BoardError, LimitsError, OSError: the host or
            the board is not available.
    """
    endpoint, lab = agent.endpoint, agent.lab
    if agent.keys is not None:
        credentials = read_credentials(agent.keys)
        if (credentials.role, credentials.name) != ("vehicle", agent.name):
            raise CredentialsError(
                f"{agent.keys} has the keys of {credentials.common_name}, not of {agent.name}"
            )
        if credentials.ending:
            notify(credentials.ending)
        endpoint, lab = endpoint or credentials.endpoint, lab or credentials.lab
    endpoint, lab = endpoint or Network().endpoint, lab or Network().lab
    if (why := untrusted(endpoint, agent.keys)) is not None:
        raise CredentialsError(f"{endpoint} is not opened: {why}")
    if agent.heartbeat is not None:
        attach(in_file(agent.heartbeat))
    notify(f"looking for the host at {endpoint}")
    VehicleProcess(
        agent.name, endpoint, lab, agent.port, agent.keys, gone=orphaned if child else None,
        report=agent.report, notify=notify,
    ).run()  # fmt: skip


def main() -> None:
    """Fly as the child of a host."""
    agent = msgspec.json.decode(
        sys.argv[1], type=AgentOptions, dec_hook=lambda kind, text: kind(text)
    )
    fly(agent, lambda text: None, child=True)


if __name__ == "__main__":
    sys.exit(run_as_child(main, (CredentialsError, *FAILURES)))
