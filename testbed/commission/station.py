"""What a commissioning needs of a rig."""

from collections.abc import Mapping, Sequence
from typing import Protocol

from msgspec import Struct

from testbed.commission.cameras import Mark
from testbed.core.types import Health, PoseSample


class BoardFacts(Struct, frozen=True):
    """What a valve board says of itself."""

    text: str  # firmware and port
    trouble: str = ""  # why it cannot be used: other limits, another protocol, no answer


class Station(Protocol):
    """A rig whose vehicles are being commissioned. Times are of one clock, in seconds."""

    carries: bool  # a vehicle can be carried to a mark
    listens: bool  # a click of a valve can be heard

    @property
    def now(self) -> float:
        """Time [s]."""
        ...

    def agree(self, what: str) -> bool:
        """Say what will move, and ask whether it may."""
        ...

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        ...

    def poses(self) -> Mapping[str, Sequence[PoseSample]]:
        """New poses of every body, in the order of arrival; vehicles' bodies by their names."""
        ...

    def board(self, name: str) -> BoardFacts:
        """The valve board of a vehicle."""
        ...

    def health(self, name: str) -> Health:
        """Readings of its gauges."""
        ...

    def bearing(self, name: str, *, on: bool) -> None:
        """Let the vehicle float, or stand."""
        ...

    def fire(self, name: str, jet: int, seconds: float) -> float:
        """Open one valve, from 0, for some time; returns the time of the command [s]."""
        ...

    def clicked(self, name: str, jet: int) -> bool:
        """Whether the vehicle's valve was heard since it was fired."""
        ...

    def carry(self, name: str, mark: Mark) -> bool:
        """Have a person put the vehicle on a mark; false: it was refused."""
        ...
