"""The verbs: what the rest of the stack needs from a rig, in a handful of small Protocols.

The twin, the bench and the table each bring objects with these methods; nothing above them knows
which rig it is on.
"""

from collections.abc import Sequence
from typing import Protocol

from testbed.core.types import Health, LawMessage, PoseSample, Setpoint, State, ValveCommand


class Clock(Protocol):
    """Time. In the twin waiting is what moves the world."""

    def wait_until(self, t: float) -> None:
        """Return at time `t` of the run [s]."""
        ...


class Timer(Clock, Protocol):
    """A clock that a plug-in's thread lives by; of the machine, or of a test."""

    @property
    def now(self) -> float:
        """Time [s]; it never goes back."""
        ...


class PoseSource(Protocol):
    """The cameras, as one vehicle hears them."""

    def samples(self) -> Sequence[PoseSample]:
        """Poses that have arrived since the last call, in order of arrival."""
        ...


class Thrusters(Protocol):
    """The board with the solenoids."""

    def apply(self, command: ValveCommand) -> None:
        """Send a plan; it replaces the one before."""
        ...

    def land(self) -> None:
        """Shut the air off, the bearings' too; may be said again and again."""
        ...

    def health(self) -> Health:
        """Newest report of the board."""
        ...


class ThrusterBoard(Thrusters, Protocol):
    """Thrusters of a plug-in. No method waits; each may be called from any thread.

    Times are of the `Timer` that the plug-in was given. A plan starts at its `issued_at`, which may
    be a little ahead; until then the one before it is played. Offsets count from there. Of a plan
    that comes late the rest is played. At `valid_until` every valve is shut.
    """

    def bearing(self, *, on: bool) -> None:
        """Air of the bearings on or off."""
        ...

    def disarm(self) -> None:
        """Shut every valve now, and forget all plans; the bearings keep their air."""
        ...

    def edges(self) -> list[tuple[float, int]]:
        """What the valves did since the last call: when [s], and a bit for each that is open."""
        ...

    def close(self) -> None:
        """Shut everything and give the hardware back; may be said again."""
        ...


class VehicleLink(Protocol):
    """The vehicle's end of the network. It remembers the newest message of each kind."""

    def setpoint(self) -> Setpoint | None:
        """Newest setpoint heard; None before the first."""
        ...

    def neighbours(self) -> dict[str, State]:
        """Newest state heard of each other vehicle."""
        ...

    def publish(self, state: State) -> None:
        """Tell host and neighbours."""
        ...

    def messages(self) -> dict[str, LawMessage]:
        """Newest words heard of the law of each other vehicle."""
        ...

    def broadcast(self, message: LawMessage) -> None:
        """Say something to the laws of the others."""
        ...


class HostLink(Protocol):
    """The host's end, one per vehicle; it remembers like `VehicleLink`."""

    def own(self) -> State | None:
        """Newest state heard of the vehicle; None before the first."""
        ...

    def neighbours(self) -> dict[str, State]:
        """Newest state heard of each other vehicle."""
        ...

    def publish(self, setpoint: Setpoint) -> None:
        """Tell the vehicle."""
        ...

    def messages(self) -> dict[str, LawMessage]:
        """Newest words heard of the law of each other vehicle."""
        ...

    def broadcast(self, message: LawMessage) -> None:
        """Say something to the laws of the others."""
        ...
