"""The board as its host sees it: bytes in, bytes out, and the edges of its valves."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from firmware_interface.messages import ResetCause


class Edge(NamedTuple):
    """The valve outputs from `t_us` on."""

    t_us: int  # since the board got power
    mask: int  # V0 is bit 0, 1 is open


def settled(edges: Sequence[Edge]) -> list[Edge]:
    """Edges that last: of several within one microsecond only the last, and only changes.

    A plan that continues a pulse at the very microsecond it ended closes and opens the output
    again; no solenoid notices.
    """
    kept: list[Edge] = []
    for edge in edges:
        while kept and kept[-1].t_us == edge.t_us:
            kept.pop()
        if edge.mask != (kept[-1].mask if kept else 0):
            kept.append(edge)
    return kept


class Board(Protocol):
    """A board running the firmware, whichever way.

    With `virtual_time` the board's clock moves in `run_until` only, and edges are exact. On the
    wall clock `run_until` waits, and edges are what the board reported of itself by then.
    """

    virtual_time: bool

    @property
    def now_us(self) -> int:
        """Time since the board got power."""
        ...

    @property
    def bearing(self) -> bool:
        """Whether bearing air is on."""
        ...

    def feed(self, data: bytes) -> None:
        """Bytes arrive at the board, now."""
        ...

    def run_until(self, t_us: int) -> Sequence[Edge]:
        """Let time pass up to and with `t_us`; edges since the last call, in order."""
        ...

    def read(self) -> bytes:
        """Bytes the board has sent since the last call."""
        ...

    def sense(self, supply_mv: int, supply_pa: int) -> None:
        """What the board's sensors say from now on."""
        ...

    def power_cycle(self, cause: ResetCause) -> None:
        """Boot again for this reason; time starts at 0, sensors stay as they are."""
        ...

    def close(self) -> None:
        """Give back what the board holds; nothing may be called afterwards."""
        ...
