import os
from pathlib import Path

import msgspec
import pytest
from board_limits import LIMITS

from firmware_interface.board import settled
from firmware_interface.compiler import CompilerError, compiler, cross_compiler
from firmware_interface.frame import Decoder, encode_message
from firmware_interface.inproc import InprocBoard
from firmware_interface.messages import (
    Ack,
    Arm,
    Bearing,
    Cmd,
    Disarm,
    Hello,
    HelloAck,
    Ping,
    Status,
)


def need(tool_missing: str | None) -> None:
    """Skip where a tool is missing; in CI that is a failure, or nobody would notice."""
    if tool_missing is None:
        return
    if os.environ.get("CI") == "true":
        pytest.fail(f"{tool_missing}; in CI every tool must be there")
    pytest.skip(tool_missing)


@pytest.fixture(scope="session")
def need_tool():
    return need


@pytest.fixture(scope="session", autouse=True)
def a_compiler():
    try:
        compiler()
    except CompilerError as error:
        need(str(error))


@pytest.fixture(scope="session")
def a_cross_compiler():
    try:
        cross_compiler()
    except CompilerError as error:
        need(str(error))


def another_build() -> Path | None:
    """Of the same firmware: measured for coverage, or with a fault in it."""
    return Path(os.environ["ABT_LIBRARY"]) if "ABT_LIBRARY" in os.environ else None


@pytest.fixture(scope="session")
def limits():
    return LIMITS


class Host:
    """Talks to a board in frames, by hand: the tests choose every field."""

    def __init__(self, board, limits):
        self.board = board
        self.limits = limits
        self.decoder = Decoder()
        self.seq = 0
        self.session = 0
        self.status: Status | None = None
        self.heard = []
        self.edges = []

    def send(self, message, seq=None, t_us=None):
        """One frame; returns the answer to it, None if there is none."""
        self.seq = (self.seq + 1) & 0xFFFF
        used = self.seq if seq is None else seq
        t_us = self.board.now_us if t_us is None else t_us
        self.listen()
        self.board.feed(encode_message(message, used, t_us))
        return next((m for m in self.listen() if isinstance(m, Ack | HelloAck)), None)

    def listen(self):
        new = [frame.message for frame in self.decoder.feed(self.board.read())]
        self.heard += new
        return new

    def hello(self):
        answer = self.send(Hello(7))
        self.session = answer.session
        return answer

    def arm(self):
        return self.send(Arm(self.session))

    def disarm(self):
        return self.send(Disarm())

    def ping(self):
        return self.send(Ping())

    def bearing(self, on):
        return self.send(Bearing(self.session, int(on)))

    def plan(self, number, on, offset=None, ttl=900_000, age=0):
        """`on` and `offset` are dicts from valve to us."""
        offset = offset or {}
        cmd = Cmd(
            self.session,
            number,
            age,
            ttl,
            tuple(on.get(i, 0) for i in range(8)),
            tuple(offset.get(i, 0) for i in range(8)),
        )
        return self.send(cmd)

    def report(self):
        """The next STATUS, whenever it comes."""
        self.listen()
        self.wait(max(100_000, self.limits.status_period_us))
        return [m for m in self.listen() if isinstance(m, Status)][-1]

    def keep_alive(self, number, until_us, every_us=100_000):
        """Refresh plan `number` while time passes."""
        while self.board.now_us < until_us:
            self.plan(number, {})
            self.wait(min(until_us - self.board.now_us, every_us))

    def wait(self, us):
        """Let time pass; all edges since boot."""
        self.edges = settled([*self.edges, *self.board.run_until(self.board.now_us + us)])
        return self.edges

    def edges_from(self, t_us):
        return [edge for edge in self.wait(0) if edge.t_us >= t_us]


@pytest.fixture
def new_host():
    """Makes a host with a board of its own; `armed=False` leaves it in SAFE."""
    boards = []

    def make(armed=True, board=None, **limits):
        config = msgspec.structs.replace(LIMITS, **limits)
        boards.append(InprocBoard(config, path=another_build(), **(board or {})))
        host = Host(boards[-1], config)
        host.hello()
        if armed:
            host.arm()
        return host

    yield make
    for board in boards:
        assert board.entered == 0, "a critical section was left open, or left twice"


@pytest.fixture
def host(new_host):
    return new_host()
