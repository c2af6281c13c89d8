"""The image for the board's chip: boot order, reset causes, watchdog, faults; edges as natively.

It runs unmodified on an emulated Cortex-M4. What only hardware can show is in docs/firmware.md.
"""

import struct

import numpy as np
import pytest

from firmware_interface.compiler import image
from firmware_interface.frame import Decoder, encode_message
from firmware_interface.inproc import InprocBoard
from firmware_interface.messages import (
    Ack,
    Arm,
    Cmd,
    Disarm,
    Hello,
    HelloAck,
    Ping,
    ResetCause,
    State,
    Status,
)
from firmware_interface.stm32 import (
    GPIOC_BSRR,
    GPIOC_MODER,
    RCC_CR,
    USART1_CR1,
    Machine,
    MachineError,
)
from firmware_interface.unicorn_board import UnicornBoard

pytestmark = pytest.mark.usefixtures("a_cross_compiler")

CLOSE = 0x01FF_0000  # all valves and bearing air low
OUTPUTS = 0x0001_5555  # PC0 to PC8
BITE_US = 50_000
V0 = 1


@pytest.fixture
def limits(host):
    return host.limits


@pytest.fixture
def path(limits):
    return image(limits).with_suffix(".bin")


def messages(board):
    return [frame.message for frame in Decoder().feed(board.read())]


def greet(board):
    """Arm; the session."""
    board.feed(encode_message(Hello(7), 1, 0))
    ack = next(m for m in messages(board) if isinstance(m, HelloAck))
    board.feed(encode_message(Arm(ack.session), 2, 0))
    assert next(m for m in messages(board) if isinstance(m, Ack)).state == State.ARMED
    return ack


def plan(session, number, on, ttl=400_000, age=0, offset=(0,) * 8):
    return Cmd(session, number, age, ttl, tuple(on), tuple(offset))


# Boot


@pytest.mark.parametrize("cause", list(ResetCause))
def test_the_first_writes_to_the_pins_close_everything_whatever_the_cause(path, cause):
    machine = Machine(path, cause)
    first, second = machine.stores[:2]
    assert (first.register, first.value) == (GPIOC_BSRR, CLOSE)
    assert (second.register, second.value) == (GPIOC_MODER, OUTPUTS)
    assert machine.outputs == []  # no pin was ever high


def test_a_reset_with_open_valves_drops_them_and_boots_closed(path, limits):
    board = UnicornBoard(limits)
    session = greet(board).session
    board.feed(encode_message(plan(session, 1, (100_000,) * 4 + (0,) * 4), 3, 0))
    assert board.run_until(10_000) == [(0, 15)]
    board.machine.stores.clear()
    board.machine.reset(ResetCause.SOFTWARE)
    assert board.run_until(20_000) == [(10_000, 0)]
    assert [store.value for store in board.machine.stores[:2]] == [CLOSE, OUTPUTS]


def test_nothing_that_the_machine_does_not_model_is_touched(path, limits):
    board = UnicornBoard(limits)
    greet(board)
    board.run_until(500_000)
    assert board.machine.unknown == set()


@pytest.mark.parametrize("lost", [0x0101_0000, 0x0001_0000])
def test_it_runs_without_crystal_and_without_clock_multiplier(limits, path, lost, monkeypatch):
    """The ready flags never come; the waits end before the independent watchdog bites."""

    def load(self, uc, offset, size, start):
        value = loaded(self, uc, offset, size, start)
        return value & ~(lost << 1) if start + offset == RCC_CR else value

    loaded = Machine._load
    monkeypatch.setattr(Machine, "_load", load)
    assert greet(UnicornBoard(limits)).reset_cause == ResetCause.POWER_ON


def test_boot_nonces_differ_although_the_random_generator_is_stuck(path):
    machine = Machine(path, random=5)
    nonces = set()
    for _ in range(5):
        machine._random = 5
        machine.reset(ResetCause.PIN)
        machine.sent.clear()
        machine.feed(encode_message(Hello(1), 1, 0))
        said = Decoder().feed(bytes(machine.sent))
        nonces |= {f.message.boot_nonce for f in said if f.type == HelloAck.CODE}
    assert len(nonces) == 5


# Independent watchdog and faults


def test_the_independent_watchdog_is_fed_every_millisecond(path):
    machine = Machine(path)
    machine.run_until(1_000_000)
    assert 1000 <= machine.feeds <= 1100
    assert machine.resets == [ResetCause.POWER_ON]


def test_without_alarms_the_independent_watchdog_closes_the_valves(limits):
    board = UnicornBoard(limits)
    session = greet(board).session
    board.feed(encode_message(plan(session, 1, (100_000,) + (0,) * 7), 3, 0))
    board.machine.mute_alarm = True
    edges = board.run_until(1_000)
    for seq in range(4, 40):  # the main loop lives and answers
        board.feed(encode_message(Ping(), seq, 0))
        edges += board.run_until(board.now_us + 10_000)
        if len(edges) == 2:
            break
    assert edges[0] == (0, V0)
    assert 0 < edges[1].t_us <= BITE_US + 1_000
    assert board.machine.resets == [ResetCause.POWER_ON, ResetCause.WATCHDOG]
    board.machine.mute_alarm = False
    board.feed(encode_message(Hello(7), 1, 0))
    ack = next(m for m in messages(board) if isinstance(m, HelloAck))
    assert (ack.reset_cause, ack.state) == (ResetCause.WATCHDOG, State.SAFE)


LOOP = b"\xfe\xe7"  # b .
TWO_LOOPS = b"\x00\xbf\xbf\xf3\x6f\x8f\xfb\xe7"  # nop; isb; b to the nop


@pytest.mark.parametrize("program", [LOOP, TWO_LOOPS])
def test_an_image_that_never_sleeps_is_named(tmp_path, program):
    vectors = (0x2000_2000).to_bytes(4, "little") + (0x0800_0201).to_bytes(4, "little")
    (tmp_path / "endless.bin").write_bytes(vectors.ljust(0x200, b"\0") + program)
    with pytest.raises(MachineError, match="does not leave a loop"):
        Machine(tmp_path / "endless.bin")


@pytest.mark.parametrize("exception", [2, 3, 4, 5, 6])
def test_a_fault_closes_the_valves_at_once_and_waits_for_the_watchdog(limits, exception):
    board = UnicornBoard(limits)
    session = greet(board).session
    board.feed(encode_message(plan(session, 1, (100_000,) * 4 + (0,) * 4), 3, 0))
    board.run_until(5_300)
    machine = board.machine
    machine._asleep = False
    machine._pc = machine._vector(exception - 16)  # the core's part: it jumps to the handler
    machine.settle()
    assert board.run_until(5_300) == [(5_300, 0)]
    board.run_until(5_300 + BITE_US + 1_000)
    assert machine.resets[-1] == ResetCause.WATCHDOG


def test_every_vector_that_can_be_taken_leads_somewhere(path):
    words = struct.unpack("<54I", path.read_bytes()[: 54 * 4])
    handlers = {number: word for number, word in enumerate(words) if word}
    reserved = {7, 8, 9, 10, 13}
    assert set(handlers) == set(range(16)) - reserved | {16 + 28, 16 + 37}
    assert all(word & 1 and word > 0x0800_0000 for word in list(handlers.values())[1:])


# The line


def test_bytes_one_by_one_are_as_good_as_all_at_once(limits):
    board = UnicornBoard(limits)
    for byte in encode_message(Ping(), 9, 5):
        board.feed(bytes([byte]))
        board.run_until(board.now_us + 22)
    ack = next(m for m in messages(board) if isinstance(m, Ack))
    assert (ack.seq, ack.t2_us) == (9, board.now_us - 22)  # when the last byte came


def test_more_than_the_ring_holds_is_lost_and_the_next_frame_is_not(limits):
    board = UnicornBoard(limits)
    board.feed(b"\x01" * 3000 + b"\0")
    board.feed(b"\0" + encode_message(Ping(), 9, 5))
    assert any(isinstance(m, Ack) for m in messages(board))


def test_nothing_is_sent_twice_or_lost_when_the_line_is_slow(limits, monkeypatch):
    """The transmit register takes three bytes per look, the interrupt brings the rest."""

    def load(self, uc, offset, size, start):
        value = loaded(self, uc, offset, size, start)
        if start + offset == 0x4001_1000:
            self.looks = getattr(self, "looks", 0) + 1
            value &= ~0x80 if self.looks % 4 == 0 else ~0
        return value

    loaded = Machine._load
    monkeypatch.setattr(Machine, "_load", load)
    board = UnicornBoard(limits)
    board.run_until(1_000_000)
    decoder = Decoder()
    seqs = [frame.seq for frame in decoder.feed(board.read())]
    assert decoder.bad == {}
    assert seqs == list(range(20)) or seqs == list(range(21))
    assert board.machine._reg[USART1_CR1] & 0x80 == 0


def test_interrupts_in_the_middle_of_a_frame_change_nothing(limits):
    """A few of the boundaries between instructions; every one has a test of its own."""
    board = UnicornBoard(limits)
    session = greet(board).session
    board.feed(encode_message(plan(session, 1, (100_000,) * 4 + (0,) * 4), 3, 0))
    board.run_until(10_000)
    before = board.machine.save()
    frame = encode_message(plan(session, 2, (0,) * 4 + (100_000,) * 4), 4, 0)
    seen, added = [], []
    for after in (*range(0, 8000, 800), 10**6):
        board.machine.restore(before)
        added.append(board.machine.feed_preempted(frame, after))
        seen.append(tuple(board.run_until(150_000)))
        board._mask = 15
    assert set(seen) == {((10_000, 0), (10_000 + limits.dead_us, 0xF0), (110_000, 0))}
    assert added == [True] * 10 + [False]


# As the core natively


def script(seed, ticks):
    """Commands, re-arms, garbage and damage: (time, sensor or None, frame of a session)."""
    dice = np.random.default_rng(seed)
    t = number = 0
    for seq in range(ticks):
        t += int(dice.choice([1000, 1000, 1000, dice.integers(1, 3000)]))
        what, message, noise, supply = dice.random(), None, b"", None
        if what < 0.02:
            message = lambda _: Hello(5)  # noqa: E731
        elif what < 0.06:
            message = Arm
        elif what < 0.07:
            message = lambda _: Disarm()  # noqa: E731
        elif what < 0.40:
            number += int(dice.random() < 0.6)
            on = [int(dice.choice([0, 0, 0, dice.integers(60_000), 10_007])) for _ in range(8)]
            offset = [int(dice.choice([0, 0, dice.integers(30_000)])) for _ in range(8)]
            ttl, age = int(dice.integers(1, 300_000)), int(dice.choice([0, 0, 5_000]))
            message = lambda s, p=(number, on, ttl, age, offset): plan(s, *p)  # noqa: E731
        elif what < 0.45:
            noise = dice.bytes(int(dice.integers(1, 120)))
        elif what < 0.46:  # the chip looks at its sensors when it runs: a frame makes it
            supply, message = int(dice.choice([24_000, 15_000])), lambda _: Ping()
        hurt = (int(dice.integers(94)), 1 << int(dice.integers(8)))
        damaged = dice.random() < 0.1 and supply is None
        yield t, seq & 0xFFFF, message, noise, supply, hurt if damaged else None


def play(board, seed, ticks):
    """Edges, and what the board has counted in the end."""
    decoder, session, edges = Decoder(), 0, []
    for t, seq, message, noise, supply, hurt in script(seed, ticks):
        edges += board.run_until(t)
        if supply:
            board.sense(supply, 500_000)
            board.feed(b"\0")  # ends what garbage began
        data = bytearray(encode_message(message(session), seq, t) if message else noise)
        if hurt and data:
            data[hurt[0] % len(data)] ^= hurt[1]
        board.feed(bytes(data))
        for frame in decoder.feed(board.read()):
            if frame.type == HelloAck.CODE:
                session = frame.message.session
    edges += board.run_until(t + 1_000_000)
    *_, status = (f.message for f in decoder.feed(board.read()) if f.type == Status.CODE)
    return edges, status


@pytest.mark.parametrize("seed", range(10))
def test_the_chip_and_this_machine_give_the_same_edges(limits, seed):
    """3000 commands each, with garbage and re-arms; clocks near their wrap."""
    clock_us = (1 << 32) - 2_000_000
    nonce = greet(UnicornBoard(limits)).boot_nonce  # session numbers and so all bytes are equal
    native = play(InprocBoard(limits, boot_nonce=nonce, clock_us=clock_us), seed, 3000)
    chip = play(UnicornBoard(limits, clock_us=clock_us), seed, 3000)
    assert chip[0] == native[0]
    assert len(native[0]) > 50
    measured = {"supply_mv", "supply_pa"}  # in steps of the chip's converter
    for name in (n for n in Status.__struct_fields__ if n not in measured):
        assert getattr(chip[1], name) == getattr(native[1], name), name
