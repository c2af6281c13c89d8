"""The host's contact with its vehicles before a flight: who is there, orders to start, stops."""

from collections.abc import Iterator, Sequence
from contextlib import suppress

import zenoh

from testbed.core.error import TestbedError
from testbed.net.commands import Accepted, Refused, Start, Stop
from testbed.net.keys import Keys
from testbed.net.roll_call import Roll
from testbed.net.session import NetworkError
from testbed.rig.wired.preflight import order
from testbed.rig.wired.stop_requests import StopRequests


class HostError(TestbedError):
    """The flight cannot begin."""


class VehicleContact:
    """The vehicles as the host reaches them over the network.

    Args:
        session, keys: the network of the lab.
        names: the flight's vehicles.
        stops: counts the stops that reach the host.
    """

    def __init__(
        self, session: zenoh.Session, keys: Keys, names: Sequence[str], stops: StopRequests
    ) -> None:
        self.session, self.keys, self.stops = session, keys, stops
        self.roll = Roll(session, keys, names)
        self.present: set[str] = set()  # on the network and ready to take an order
        self._names = names

    @property
    def called_off(self) -> bool:
        """Whether an operator has stopped the run; the stop may have reached a vehicle first."""
        return self.stops.times > 0 or self.roll.stopped

    def update(self) -> dict[str, str]:
        """Look again who is present; returns vehicles that have gone since, and why."""
        before, self.present = self.present, {
            name for name in self._names if name in self.roll.tickets and self._is_alive(name)
        }  # fmt: skip
        gone = dict.fromkeys(before - self.present, "no longer on the network")
        return gone | self.roll.farewells()

    def _is_alive(self, name: str) -> bool:
        return bool(list(self.session.liveliness().get(self.keys.of(name, "alive"), timeout=1.0)))

    def start(self, run: int, epoch_ns: int) -> Iterator[tuple[str, str]]:
        """Order each vehicle to start; yields its name and that of its board.

        Args:
            run: id of this run's messages.
            epoch_ns: time 0 of the run on the monotonic clock.

        Raises:
            HostError: a vehicle refuses.
            NetworkError: a vehicle does not answer.
        """
        for name in self._names:
            start = Start(run, epoch_ns, self.roll.tickets[name])
            match order(self.session, self.keys, name, start):
                case Accepted(board):
                    yield name, board
                case Refused(reason):
                    raise HostError(f"{name} refuses to start: {reason}")

    def call_off(self) -> None:
        """Stop vehicles that may already have an order to start."""
        for name in self._names:
            with suppress(NetworkError):
                order(self.session, self.keys, name, Stop("the flight was called off"))
