"""What a board says of itself, on the way to whoever reads its bytes: time, edges, bearing air."""

import contextlib
import struct
from collections import deque

from firmware_interface.board import Edge
from firmware_interface.frame import WRAP, Decoder, Frame
from firmware_interface.messages import Edges, Status

KEPT = 100_000  # edges that nobody has taken; five minutes of eight valves at 20 Hz
JUMP_US = 1_000_000  # a clock further off than that is the clock of another boot


class Reports:
    """Listens along."""

    def __init__(self) -> None:
        self._decoder = Decoder()
        self._stamp: int | None = None  # of the newest frame
        self._heard_us = 0  # host's clock then
        self.board_us = 0  # since the board got power, at that frame
        self.bearing = False
        self._edges: deque[Edge] = deque(maxlen=KEPT)

    def hear(self, data: bytes, host_us: int) -> bool:
        """Take bytes that came in at `host_us`; whether a frame was among them."""
        frames = self._decoder.feed(data)
        for frame in frames:
            self._take(frame, host_us)
        return bool(frames)

    def take_edges(self) -> list[Edge]:
        """Edges since the last call, in order; the newest if nobody asked for long."""
        edges = list(self._edges)
        self._edges.clear()
        return edges

    def now_us(self, host_us: int) -> int:
        """The board's clock, as far as known."""
        return self.board_us if self._stamp is None else self.board_us + host_us - self._heard_us

    def _take(self, frame: Frame, host_us: int) -> None:
        ahead = 0 if self._stamp is None else (frame.t_us - self._stamp) % WRAP
        if self._stamp is None or ahead > host_us - self._heard_us + JUMP_US:
            self.board_us, ahead = frame.t_us, 0  # heard for the first time, or booted again
        self.board_us += ahead
        self._stamp, self._heard_us = frame.t_us, host_us
        with contextlib.suppress(KeyError, ValueError, struct.error):  # the session says so
            match frame.message:
                case Edges(count, at_us, mask):
                    for t, open_valves in zip(at_us[:count], mask[:count], strict=True):
                        back = (frame.t_us - t) % WRAP
                        self._edges.append(Edge(self.board_us - back, open_valves))
                case Status(bearing=on):
                    self.bearing = bool(on)
