"""A vehicle finds its host: connects, gets the experiment, and checks that its name is free."""

from collections.abc import Callable
from pathlib import Path

import msgspec
import zenoh

from testbed.config import Experiment
from testbed.core.error import TestbedError
from testbed.net.keys import Keys
from testbed.net.session import NetworkError, NoHostError, ask, dial
from testbed.realtime.wall_clock import monotonic_ns, sleep_until_ns

LOOK_NS = 10_000_000  # polling period while waiting
PATIENCE_NS = 60_000_000_000  # longest wait for a host that does not answer
TRY_S = 2.0
ALONE_NS = 2_000_000_000  # several leases: a lost session has expired by then


class VehicleError(TestbedError):
    """This vehicle cannot fly."""


def connect(endpoint: str, credentials: Path | None, gone: Callable[[], bool]) -> zenoh.Session:
    """Connect as soon as the host listens; short attempts, because each one blocks Ctrl-C."""
    end = monotonic_ns() + PATIENCE_NS
    while True:
        try:
            return dial(endpoint, TRY_S, credentials)
        except NoHostError:
            if monotonic_ns() > end or gone():
                raise


def ask_experiment(session: zenoh.Session, keys: Keys, gone: Callable[[], bool]) -> Experiment:
    """Get the experiment from the host."""
    end = monotonic_ns() + PATIENCE_NS
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
    end = monotonic_ns() + PATIENCE_NS
    while not Path(port).exists() and monotonic_ns() < end and not gone():
        sleep_until_ns(monotonic_ns() + LOOK_NS)


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


def port_of(experiment: Experiment, name: str, port: str | None) -> str | None:
    """Serial port of the vehicle's board; None for thrusters of a plug-in.

    Raises:
        VehicleError: the host does not fly this vehicle, or its port is unknown.
    """
    if name not in experiment.vehicles:
        raise VehicleError(f"the host flies {', '.join(experiment.vehicles)}, not {name}")
    wires = experiment.table.lab
    if wires.thrusters.system != "serial":
        return None
    port = port or wires.serial.ports.get(name)
    if port is None:
        raise VehicleError(
            f"no serial port for {name}: expected --serial, or an entry of"
            " [lab.serial.ports] in the table file"
        )
    return port
