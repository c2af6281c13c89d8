"""Decodes a board's reports from its bytes: time, edges, bearing air."""

import contextlib
import struct
from collections import deque

from firmware_interface.board import Edge
from firmware_interface.frame import WRAP, Decoder, Frame
from firmware_interface.messages import Edges, Status

KEPT = 100_000  # edges kept until taken; five minutes of eight valves at 20 Hz
JUMP_US = 1_000_000  # a larger jump of the clock means that the board rebooted


class Reports:
    """State of a board as decoded from its bytes."""

    def __init__(self) -> None:
        self._decoder = Decoder()
        self._stamp: int | None = None  # of the newest frame
        self._heard_us = 0  # host's clock at that frame
        self.board_us = 0  # since power-on, at that frame
        self.bearing = False
        self._edges: deque[Edge] = deque(maxlen=KEPT)

    def receive(self, data: bytes, host_us: int) -> bool:
        """Decode bytes received at `host_us`; returns whether they completed a frame."""
        frames = self._decoder.feed(data)
        for frame in frames:
            self._take(frame, host_us)
        return bool(frames)

    def take_edges(self) -> list[Edge]:
        """Edges since the last call, in order; only the newest `KEPT`."""
        edges = list(self._edges)
        self._edges.clear()
        return edges

    def now_us(self, host_us: int) -> int:
        """Estimate of the board's clock."""
        return self.board_us if self._stamp is None else self.board_us + host_us - self._heard_us

    def _take(self, frame: Frame, host_us: int) -> None:
        ahead = 0 if self._stamp is None else (frame.t_us - self._stamp) % WRAP
        if self._stamp is None or ahead > host_us - self._heard_us + JUMP_US:
            self.board_us, ahead = frame.t_us, 0  # first frame, or rebooted
        self.board_us += ahead
        self._stamp, self._heard_us = frame.t_us, host_us
        with contextlib.suppress(KeyError, ValueError, struct.error):  # the session reports these
            match frame.message:
                case Edges(count, at_us, mask):
                    for t, open_valves in zip(at_us[:count], mask[:count], strict=True):
                        back = (frame.t_us - t) % WRAP
                        self._edges.append(Edge(self.board_us - back, open_valves))
                case Status(bearing=on):
                    self.bearing = bool(on)
