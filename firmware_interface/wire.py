"""A sender and a board in virtual time, connected by a serial line, for the twin.

The line carries the same frames as a real one, one after the other, with ten bits per byte; a frame
arrives with its last bit. The valves follow the board's EDGES frames, read as they leave the board;
they must agree with the board's pins.

The host's clock is the run's; the board is powered on `HEAD_START_US` before the run begins, and is
armed at its start.
"""

from collections import deque
from collections.abc import Callable, Sequence

from msgspec.structs import replace

from firmware_interface.board import Board, Edge
from firmware_interface.messages import Config, State
from firmware_interface.reports import Reports
from firmware_interface.session import Session
from testbed.core.error import TestbedError
from testbed.core.types import ValveCommand

BAUD = 460_800  # as in the firmware's board file
BITS = 10  # 8N1
HEAD_START_US = 200_000
PATIENCE_US = 100_000  # longest wait for an answer; the line is lossless


class WireError(TestbedError):
    """The board does not behave as the run requires."""


class Line:
    """One direction of the serial line."""

    def __init__(self, baud: int) -> None:
        self._baud = baud
        self._free_us = 0
        self._on_the_way: deque[tuple[int, bytes]] = deque()

    def send(self, t_us: int, data: bytes) -> None:
        """Queue bytes on the line."""
        if data:
            took_us = -(-len(data) * BITS * 1_000_000 // self._baud)
            self._free_us = max(t_us, self._free_us) + took_us
            self._on_the_way.append((self._free_us, data))

    @property
    def next_us(self) -> int | None:
        """Time of the next arrival; None if the line is empty."""
        return self._on_the_way[0][0] if self._on_the_way else None

    def arrived(self, t_us: int) -> Sequence[tuple[int, bytes]]:
        """Bytes that have arrived by `t_us`, with their times."""
        came = []
        while self._on_the_way and self._on_the_way[0][0] <= t_us:
            came.append(self._on_the_way.popleft())
        return came


class WiredBoard:
    """Converts plans to valve edges; times are the run's, in microseconds.

    Args:
        board: in virtual time, fresh.
        config: the limits that it was built with.
        baud: of the line.

    Raises:
        WireError: the board cannot be armed.
    """

    def __init__(self, board: Board, config: Config, baud: int = BAUD) -> None:
        self.session = Session(config, nonce=1)
        self.board = board
        self._there, self._back = Line(baud), Line(baud)
        self._reports = Reports()
        self._now_us = 0  # since power-on, like all internal times
        self._new: list[Edge] = []
        self._mask = self._before = 0  # after the newest edge, and before it
        self._landed = False
        self._start()

    def _start(self) -> None:
        session, line = self.session, self._there
        line.send(0, session.hello(0))
        self._expect("answers HELLO", lambda: session.greeted)
        line.send(self._now_us, session.bearing(True, self._now_us))
        self._expect("turns bearing air on", lambda: self.board.bearing)
        self._pass(HEAD_START_US - 20_000)
        line.send(self._now_us, session.arm(self._now_us))
        self._pass(HEAD_START_US)
        if session.state != State.ARMED:
            raise WireError(f"the board cannot be armed: {session.ack}")

    def _expect(self, what: str, done: Callable[[], bool]) -> None:
        give_up_us = self._now_us + PATIENCE_US
        while not done():
            if self._now_us >= give_up_us:
                raise WireError(f"expected a board that {what} within {PATIENCE_US} us")
            self._pass(self._now_us + 1_000)

    @property
    def trouble(self) -> str | None:
        """Reason why the board no longer plays plans; None while it does."""
        session = self.session
        if self._landed or (session.state == State.ARMED and not session.refusals):
            return None
        faults = session.status.faults.name if session.status else None
        refused = ", ".join(result.name for result in session.refusals)
        return f"board in {session.state and session.state.name}, faults {faults}" + (
            f", refused plans: {refused}" if refused else ""
        )

    def apply(self, command: ValveCommand) -> None:
        """Send a plan, moved to start `HEAD_START_US` later."""
        if self._landed:
            return
        shift = HEAD_START_US * 1e-6
        shifted = replace(
            command,
            issued_at=command.issued_at + shift,
            valid_until=command.valid_until + shift,
        )
        self._there.send(self._now_us, self.session.apply(shifted, self._now_us))

    def land(self) -> None:
        """Disarm and shut off bearing air permanently; no more plans are sent."""
        if self._landed:
            return
        self._landed = True
        self._there.send(self._now_us, self.session.disarm(self._now_us))
        self._there.send(self._now_us, self.session.bearing(False, self._now_us))

    @property
    def floats(self) -> bool:
        """Whether bearing air is on."""
        return self.board.bearing

    def run_until(self, t_us: int) -> list[Edge]:
        """Run to `t_us`; returns valve edges since the last call."""
        self._pass(HEAD_START_US + t_us)
        edges, self._new = self._new, []
        return [Edge(edge.t_us - HEAD_START_US, edge.mask) for edge in edges]

    def _pass(self, until_us: int) -> None:
        """Run up to and including `until_us`; frames repeated then follow a new plan."""
        while True:
            arrival, due = self._there.next_us, self.session.due_us
            events = [t for t in (arrival, due if due != until_us else None) if t is not None]
            event = min(events, default=until_us + 1)
            if event > until_us:
                break
            self._let_board_run(max(event, self._now_us))
            for _, data in self._there.arrived(self._now_us):
                self.board.feed(data)
            if due is not None and due <= self._now_us:
                self._there.send(self._now_us, self.session.due(self._now_us))
        self._let_board_run(until_us)
        for t_us, data in self._back.arrived(until_us):
            self.session.receive(data, t_us)
        self.session.edges.clear()  # the twin already has them

    def _let_board_run(self, until_us: int) -> None:
        driven = list(self.board.run_until(until_us))
        self._now_us = until_us
        for coded in self.board.read().split(b"\0")[:-1]:
            self._reports.receive(coded + b"\0", until_us)
            self._back.send(self._reports.board_us, coded + b"\0")
        reported = self._reports.take_edges()
        if reported != driven:
            raise WireError(f"the board drove {driven} and reported {reported}")
        for edge in reported:
            self._take(edge)

    def _take(self, edge: Edge) -> None:
        """Keep the last of several edges within one microsecond; the others have no effect."""
        if self._new and self._new[-1].t_us == edge.t_us:
            self._new.pop()
            self._mask = self._before
        if edge.mask != self._mask:
            self._before, self._mask = self._mask, edge.mask
            self._new.append(edge)
