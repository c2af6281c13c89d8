"""Ten simulated minutes of random commands, loss and garbage, judged from the pins and the line.

The emulated chip gets two of them, and all ten under `make fuzz`: it takes a while.
"""

import os

import numpy as np
import pytest

from firmware_interface.board import Edge, settled
from firmware_interface.compiler import CompilerError, cross_compiler
from firmware_interface.frame import Decoder, encode_message
from firmware_interface.inproc import InprocBoard
from firmware_interface.messages import (
    Ack,
    Arm,
    Cmd,
    Disarm,
    Hello,
    HelloAck,
    Result,
    State,
    Status,
)
from firmware_interface.unicorn_board import UnicornBoard

MINUTES = 10
ON_THE_CHIP = float(os.environ.get("ABT_SOAK", "2"))  # minutes
STEP_US = 20_000


class FirstFaultObserver:
    """Knows edges and what the board said; complains when they do not go together."""

    def __init__(self, limits):
        self.limits = limits
        self.mask = self.openings = 0
        self.opened, self.closed = [None] * 8, [None] * 8
        self.fed_us = None  # newest ARM, or plan accepted
        self.open_us = 0

    def receive(self, message):
        accepted = isinstance(message, Ack) and message.result in (Result.OK, Result.REFRESHED)
        if accepted and message.type in (Cmd.CODE, Arm.CODE):
            self.fed_us = message.t2_us
        if isinstance(message, Status):
            assert message.state == State.ARMED or message.mask == 0

    def see(self, edge):
        t, limits = edge.t_us, self.limits
        for valve in range(8):
            was, now = self.mask >> valve & 1, edge.mask >> valve & 1
            if now:
                assert not edge.mask & limits.opposing[valve], f"opposing at {t}"
            if now and not was:
                self.openings += 1
                self.opened[valve] = t
                rest = self.closed[valve]
                assert rest is None or t - rest >= limits.min_off_us, f"V{valve} at {t}"
                for other in range(8):
                    if limits.opposing[valve] >> other & 1 and self.closed[other] is not None:
                        assert t - self.closed[other] >= limits.dead_us, f"V{valve} at {t}"
            if was and not now:
                self.closed[valve] = t
                assert t - self.opened[valve] <= limits.max_on_us, f"V{valve} at {t}"
                self.open_us += t - self.opened[valve]
        self.mask = edge.mask

    def look(self, t):
        """Nothing is open without a reason that is young enough."""
        if self.mask:
            assert self.fed_us is not None
            assert t - self.fed_us <= self.limits.watchdog_us, f"open at {t}"


def frames(dice, session, number):
    """What a confused host says next; mostly plans."""
    what = dice.random()
    if what < 0.01:
        return Hello(3), number
    if what < 0.03:
        return Disarm(), number
    if what < 0.15:
        return Arm(session), number
    number += int(dice.random() < 0.3)
    on = [int(dice.choice([0, 0, 0, 10_006, 10_007, dice.integers(450_000)])) for _ in range(8)]
    offset = [int(dice.choice([0, 0, dice.integers(100_000)])) for _ in range(8)]
    return Cmd(
        session, number, int(dice.choice([0, dice.integers(30_000)])),
        int(dice.integers(1, 900_000)), tuple(on), tuple(offset),
    ), number  # fmt: skip


def soak(board, limits, minutes):
    dice, witness, decoder = np.random.default_rng(11), FirstFaultObserver(limits), Decoder()
    session = number = seq = 0
    while board.now_us < minutes * 60_000_000:
        before = [Edge(-1, witness.mask)] if witness.mask else []
        new = board.run_until(board.now_us + int(dice.integers(STEP_US * 2)))
        edges = settled([*before, *new])[len(before) :]
        for frame in decoder.feed(board.read()):
            if frame.type == HelloAck.CODE:
                session = frame.message.session
            witness.receive(frame.message)
        for edge in edges:
            witness.see(edge)
        witness.look(board.now_us)
        seq = (seq + int(dice.random() < 0.98)) & 0xFFFF  # now and then a replay
        message, number = frames(dice, session, number)
        data = bytearray(encode_message(message, seq, board.now_us))
        fate = dice.random()
        if fate < 0.10:
            data[int(dice.integers(len(data)))] ^= 1 << int(dice.integers(8))
        elif fate < 0.15:
            data = bytearray(dice.bytes(int(dice.integers(200))))
        elif fate < 0.20:
            del data[int(dice.integers(len(data))) :]
        elif fate < 0.40:
            continue  # lost
        board.feed(bytes(data))
    return witness


def test_on_this_machine(host):
    witness = soak(InprocBoard(host.limits), host.limits, MINUTES)
    assert witness.openings > 1000
    assert witness.open_us > 10_000_000


@pytest.mark.slow
def test_on_the_chip(host, need_tool):
    try:
        cross_compiler()
    except CompilerError as error:
        need_tool(str(error))
    board = UnicornBoard(host.limits)
    witness = soak(board, host.limits, ON_THE_CHIP)
    assert witness.openings > 100 * ON_THE_CHIP
    assert board.machine.unknown == set()
    assert len(board.machine.resets) == 1  # the independent watchdog never bit
