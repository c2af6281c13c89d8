"""The interface of a board to its host: bytes in, bytes out, and the edges of its valves."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from firmware_interface.messages import ResetCause


class Edge(NamedTuple):
    """The valve outputs from `t_us` on."""

    t_us: int  # since power-on
    mask: int  # V0 is bit 0, 1 is open


def settled(edges: Sequence[Edge]) -> list[Edge]:
    """Edges without glitches: the last of several within one microsecond, and only changes.

    A plan that continues a pulse in the microsecond in which it ends closes and reopens the output;
    this has no effect on a solenoid.
    """
    kept: list[Edge] = []
    for edge in edges:
        while kept and kept[-1].t_us == edge.t_us:
            kept.pop()
        if edge.mask != (kept[-1].mask if kept else 0):
            kept.append(edge)
    return kept


class Board(Protocol):
    """A board that runs the firmware, real or emulated.

    With `virtual_time` the board's clock advances only in `run_until`, and edges are exact. On the
    wall clock `run_until` waits, and edges are those that the board has reported by then.
    """

    virtual_time: bool

    @property
    def now_us(self) -> int:
        """The board's clock: time since power-on [us]."""
        ...

    @property
    def bearing(self) -> bool:
        """Whether bearing air is on."""
        ...

    def feed(self, data: bytes) -> None:
        """Send bytes to the board now."""
        ...

    def run_until(self, t_us: int) -> Sequence[Edge]:
        """Run up to and including `t_us`; returns edges since the last call, in order."""
        ...

    def read(self) -> bytes:
        """Bytes the board has sent since the last call."""
        ...

    def sense(self, supply_mv: int, supply_pa: int) -> None:
        """Set the readings of the board's sensors from now on."""
        ...

    def power_cycle(self, cause: ResetCause) -> None:
        """Reboot for this cause; time restarts at 0, sensor readings are kept."""
        ...

    def close(self) -> None:
        """Release all resources; the board cannot be used afterwards."""
        ...
