"""Interfaces of a rig that the rest of the stack uses, as small Protocols.

The twin, the bench and the table each provide objects with these methods; the flight code does not
depend on the rig.
"""

from collections.abc import Sequence
from typing import Protocol

from testbed.core.types import Health, LawMessage, PoseSample, Setpoint, State, ValveCommand


class Clock(Protocol):
    """Time of a run. On the twin waiting advances the simulation."""

    def wait_until(self, t: float) -> None:
        """Return at time `t` of the run [s]."""
        ...


class Timer(Clock, Protocol):
    """The clock of a plug-in's thread: the machine's, or that of a test."""

    @property
    def now(self) -> float:
        """Time [s]; it never goes back."""
        ...


class PoseSource(Protocol):
    """Source of one vehicle's poses."""

    def samples(self) -> Sequence[PoseSample]:
        """Poses that arrived since the last call, in order of arrival."""
        ...


class Thrusters(Protocol):
    """The board that drives the valves."""

    def apply(self, command: ValveCommand) -> None:
        """Send a plan; it replaces the one before."""
        ...

    def land(self) -> None:
        """Turn the air off, including the bearings'; may be called repeatedly."""
        ...

    def health(self) -> Health:
        """The board's newest report."""
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
        """Close all valves and release the hardware; may be called again."""
        ...


class VehicleLink(Protocol):
    """The vehicle's end of the network. It keeps the newest message of each kind."""

    def setpoint(self) -> Setpoint | None:
        """The newest setpoint; None before the first."""
        ...

    def neighbours(self) -> dict[str, State]:
        """The newest state of each other vehicle."""
        ...

    def publish(self, state: State) -> None:
        """Send the state to host and neighbours."""
        ...

    def messages(self) -> dict[str, LawMessage]:
        """The newest message of each other vehicle's law."""
        ...

    def broadcast(self, message: LawMessage) -> None:
        """Send a message to the laws of the others."""
        ...


class HostLink(Protocol):
    """The host's end, one per vehicle; it keeps messages like `VehicleLink`."""

    def own(self) -> State | None:
        """The vehicle's newest state; None before the first."""
        ...

    def neighbours(self) -> dict[str, State]:
        """The newest state of each other vehicle."""
        ...

    def publish(self, setpoint: Setpoint) -> None:
        """Send a setpoint to the vehicle."""
        ...

    def messages(self) -> dict[str, LawMessage]:
        """The newest message of each other vehicle's law."""
        ...

    def broadcast(self, message: LawMessage) -> None:
        """Send a message to the laws of the others."""
        ...
