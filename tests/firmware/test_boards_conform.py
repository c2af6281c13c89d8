"""What every board does, whichever way its firmware runs: one suite against all of them.

On a wall clock only assertions about exact times are left out: a machine may stall between any two
of its instructions. A board in the lab takes part with

    export ABT_BOARD=/dev/ttyUSB0 ABT_VEHICLE=configs/vehicles/generic_8jet.toml
    pytest tests/firmware -k serial

Its valves will click: shut off the air.
"""

import os
import shutil
from pathlib import Path

import msgspec
import numpy as np
import pytest

from firmware_interface.board import settled
from firmware_interface.compiler import CompilerError, cross_compiler, firmware_id
from firmware_interface.frame import CODED_MAX, Decoder, Frame, encode, encode_message
from firmware_interface.host_pty import HostPtyBoard
from firmware_interface.inproc import InprocBoard
from firmware_interface.limits import config_hash, limits_of
from firmware_interface.messages import (
    VERSION,
    Ack,
    Arm,
    Bearing,
    Cmd,
    Disarm,
    Fault,
    Hello,
    HelloAck,
    Ping,
    ResetCause,
    Result,
    State,
    Status,
)
from firmware_interface.qemu import QemuBoard
from firmware_interface.serial_board import BoardError, SerialBoard
from firmware_interface.session import Session
from firmware_interface.unicorn_board import UnicornBoard
from testbed.core.types import ValveCommand
from testbed.core.vehicle import Vehicle

PATIENCE_US = 30_000_000  # of the board's time, for what comes at once
VIRTUAL = ("inproc", "unicorn")
COUNTERS = ("bad_length", "bad_crc", "bad_version", "unknown_type", "foreign", "replayed")
V0, V1, V5 = 1 << 0, 1 << 1, 1 << 5  # V5 pushes against V0


def no_cross_compiler():
    try:
        cross_compiler()
    except CompilerError as error:
        return str(error)
    return None


def missing(kind):
    """The tool that this board needs and this machine has not."""
    if kind in ("unicorn", "qemu") and (trouble := no_cross_compiler()):
        return trouble
    if kind == "qemu" and shutil.which("qemu-system-arm") is None:
        return "qemu-system-arm is not installed"
    return None


class Bench:
    """Talks to any board in frames, and waits by the board's own clock."""

    def __init__(self, kind, board, limits):
        self.kind, self.board, self.limits = kind, board, limits
        self.exact = board.virtual_time
        self.decoder, self.heard, self.edges = Decoder(), [], []
        self.seq = self.session = 0

    def listen(self):
        new = [frame.message for frame in self.decoder.feed(self.board.read())]
        self.heard += new
        return new

    def wait(self, us):
        """Let time pass; all edges since boot."""
        self.edges = settled([*self.edges, *self.board.run_until(self.board.now_us + us)])
        self.listen()
        return self.edges

    def until(self, found):
        """Wait for something that `found` finds in all that was heard, or in the edges."""
        give_up = self.board.now_us + PATIENCE_US
        while not (result := found()):
            assert self.board.now_us < give_up, (self.edges, self.heard[-5:])
            self.wait(1_000)
        return result

    def answer(self, message, again_us=None):
        """Send a frame; its answer."""
        while True:
            self.seq = (self.seq + 1) & 0xFFFF
            seq, before = self.seq, len(self.heard)
            self.board.feed(encode_message(message, seq, self.board.now_us))
            deadline = self.board.now_us + (again_us or PATIENCE_US)
            self.wait(0)
            while self.board.now_us < deadline:
                for one in self.heard[before:]:
                    if isinstance(one, HelloAck) and isinstance(message, Hello):
                        return one
                    if isinstance(one, Ack) and one.seq == seq:
                        return one
                self.wait(1_000)
            assert again_us, f"no answer to {message}"

    def hello(self):
        """Until it is answered: a board that is booting hears nothing. The newest answer counts."""
        self.answer(Hello(7), again_us=200_000)
        self.answer(Ping())
        found = [one for one in self.heard if isinstance(one, HelloAck)][-1]
        self.session = found.session
        return found

    def arm(self):
        return self.answer(Arm(self.session))

    def plan(self, number, on, offset=None, ttl=None, age=0):
        return self.answer(self.cmd(number, on, offset, ttl, age))

    def cmd(self, number, on, offset=None, ttl=None, age=0):
        offset = offset or {}
        return Cmd(
            self.session, number, age, ttl or self.limits.max_ttl_us,
            tuple(on.get(i, 0) for i in range(8)), tuple(offset.get(i, 0) for i in range(8)),
        )  # fmt: skip

    def report(self):
        """A STATUS made from now on."""
        seen = self.answer(Ping())
        self.heard.clear()
        assert seen.result == Result.OK
        self.until(lambda: any(isinstance(one, Status) for one in self.heard))
        return next(one for one in self.heard if isinstance(one, Status))

    def masks(self):
        return [edge.mask for edge in self.edges]

    def wait_for_masks(self, masks):
        """These, one after the other, and nothing else for a while."""
        self.until(lambda: len(self.edges) >= len(masks))
        self.wait(100_000)
        assert self.masks() == masks

    def boot(self, cause):
        try:
            self.board.power_cycle(cause)
        except BoardError as error:
            pytest.skip(str(error))
        self.decoder, self.heard, self.edges = Decoder(), [], []


@pytest.fixture(params=["inproc", "unicorn", "host_pty", "qemu", "serial"])
def kind(request, need_tool):
    need_tool(missing(request.param))
    if request.param == "serial" and "ABT_BOARD" not in os.environ:
        pytest.skip("no board: its port is expected in ABT_BOARD, its vehicle file in ABT_VEHICLE")
    return request.param


@pytest.fixture
def new_bench(kind, host, monkeypatch):
    """Makes a bench with a board of this kind; `armed=False` leaves it in SAFE."""
    monkeypatch.setattr("firmware_interface.serial_board.SILENCE_S", 60)  # of a busy machine
    boards = []

    def make(armed=True, **changes):
        limits = msgspec.structs.replace(host.limits, **({"watchdog_us": 1_900_000} | changes))
        if kind == "qemu":  # there is nothing to measure
            limits = msgspec.structs.replace(limits, undervoltage_mv=0)
        match kind:
            case "inproc":
                board = InprocBoard(limits)
            case "unicorn":
                board = UnicornBoard(limits)
            case "host_pty":
                board = HostPtyBoard(limits)
            case "qemu":
                board = QemuBoard(limits)
            case _:
                vehicle = Path(os.environ["ABT_VEHICLE"]).read_bytes()
                limits = limits_of(msgspec.toml.decode(vehicle, type=Vehicle))
                board = SerialBoard(os.environ["ABT_BOARD"])
        boards.append(board)
        bench = Bench(kind, board, limits)
        bench.hello()
        bench.edges.clear()
        if armed:
            assert bench.arm().state == State.ARMED
        return bench

    yield make
    for board in boards:
        board.close()


# Who it is


def test_hello_names_firmware_limits_and_state(new_bench):
    bench = new_bench(armed=False)
    ack = bench.hello()
    assert (ack.host_nonce, ack.state) == (7, State.SAFE)
    assert ack.firmware_id == firmware_id()
    assert ack.config_hash == config_hash(bench.limits)


@pytest.mark.parametrize("cause", list(ResetCause))
def test_after_a_reset_for_any_cause_nothing_is_as_before(new_bench, cause):
    bench = new_bench()
    before = bench.hello()
    bench.arm()
    bench.plan(1, {0: 100_000})
    bench.boot(cause)
    after = bench.hello()
    assert (after.reset_cause, after.state) == (cause, State.SAFE)
    assert after.boot_nonce != before.boot_nonce
    assert bench.wait(0) == []
    bench.session, new = before.session, after.session
    assert new != before.session
    assert bench.arm().result == Result.FOREIGN_SESSION
    assert bench.wait(10_000) == []


# What it plays


def test_nothing_opens_before_arm(new_bench):
    bench = new_bench(armed=False)
    assert bench.plan(1, {0: 50_000}).result == Result.NOT_ARMED
    assert bench.wait(100_000) == []


def test_each_valve_opens_at_its_offset_for_its_time(new_bench):
    bench = new_bench()
    start = bench.board.now_us
    answer = bench.plan(1, {0: 60_000, 3: 100_000}, {3: 20_001})
    assert answer.result == Result.OK
    bench.wait_for_masks([V0, V0 | 8, 8, 0])
    if bench.exact:
        times = [edge.t_us - start for edge in bench.edges]
        assert times == [0, 20_001, 60_000, 120_001]


def test_a_refresh_changes_nothing(new_bench):
    bench = new_bench()
    assert bench.plan(1, {0: 100_000}).result == Result.OK
    assert bench.plan(1, {0: 100_000}).result == Result.REFRESHED
    assert bench.plan(0, {0: 100_000}).result == Result.STALE_PLAN
    bench.wait_for_masks([V0, 0])
    assert bench.report().open_us[0] >= (100_000 if bench.exact else 1)


def test_too_short_a_pulse_is_not_played(new_bench):
    bench = new_bench()
    bench.plan(1, {0: bench.limits.min_on_us - 1, 1: bench.limits.min_on_us})
    bench.wait_for_masks([V1, 0])
    assert bench.report().unplayed == 1


def test_disarm_closes_at_once(new_bench):
    bench = new_bench()
    bench.plan(1, {0: 300_000})
    bench.until(lambda: bench.edges)
    bench.wait(1_000)
    answer = bench.answer(Disarm())
    assert (answer.result, answer.state) == (Result.OK, State.SAFE)
    bench.wait_for_masks([V0, 0])
    if bench.exact:
        assert bench.edges[1].t_us - bench.edges[0].t_us < 2_000


def test_bearing_air(new_bench):
    bench = new_bench(armed=False)
    for on in (True, False):
        assert bench.answer(Bearing(bench.session, int(on))).result == Result.OK
        assert bench.report().bearing == on
        assert bench.board.bearing is on


# Interlocks and limits


def test_opposing_jets_in_one_plan_are_refused(new_bench):
    bench = new_bench()
    assert bench.plan(1, {0: 50_000, 5: 50_000}).result == Result.OPPOSING
    apart = 50_000 + bench.limits.dead_us
    assert bench.plan(2, {0: 50_000, 5: 50_000}, {5: apart - 1}).result == Result.OPPOSING
    assert bench.plan(3, {0: 50_000, 5: 50_000}, {5: apart}).result == Result.OK
    bench.wait_for_masks([V0, 0, V5, 0])
    assert bench.edges[2].t_us - bench.edges[1].t_us >= bench.limits.dead_us


def test_from_plan_to_plan_the_dead_time_is_kept(new_bench):
    bench = new_bench()
    bench.plan(1, {0: 300_000})
    bench.until(lambda: bench.edges)
    bench.wait(1_000)
    bench.plan(2, {5: 100_000})
    bench.wait_for_masks([V0, 0, V5, 0])
    gap = bench.edges[2].t_us - bench.edges[1].t_us
    assert gap == bench.limits.dead_us if bench.exact else gap >= bench.limits.dead_us


def test_maximum_on_time(new_bench):
    bench = new_bench()
    assert bench.plan(1, {0: bench.limits.max_on_us + 1}).result == Result.ON_TOO_LONG
    assert bench.plan(2, {0: bench.limits.max_on_us}).result == Result.OK
    bench.wait_for_masks([V0, 0])
    if bench.exact:
        assert bench.edges[1].t_us - bench.edges[0].t_us == bench.limits.max_on_us


def test_duty_budget(new_bench):
    bench = new_bench(duty_window_us=3_200_000, duty_budget_us=50_000)
    bench.plan(1, {0: 100_000})
    bench.wait_for_masks([V0, 0])
    assert bench.report().cut_duty == 1
    if bench.exact:
        assert bench.edges[1].t_us - bench.edges[0].t_us == 50_000


# Watchdog and SAFE


def impatient(kind):
    """Limits under which the watchdog ends a pulse; on a wall clock it allows for a stall."""
    watchdog_us = 150_001 if kind in VIRTUAL else 1_500_001
    return {
        "watchdog_us": watchdog_us, "max_on_us": 4_000_000, "max_ttl_us": 9_000_000,
        "duty_window_us": 16_000_000, "duty_budget_us": 12_000_000,
    }  # fmt: skip


def test_a_silent_host_trips_the_watchdog_and_safe_is_latched(new_bench, kind):
    bench = new_bench(**impatient(kind))
    start = bench.board.now_us
    bench.plan(1, {0: bench.limits.max_on_us})
    bench.wait_for_masks([V0, 0])
    if bench.exact:
        assert bench.edges[1].t_us - start == bench.limits.watchdog_us
    status = bench.report()
    assert (status.state, status.faults) == (State.SAFE, Fault.WATCHDOG)
    assert bench.plan(2, {0: 50_000}).result == Result.NOT_ARMED
    assert bench.arm().faults == 0
    bench.plan(3, {1: 50_000})
    bench.wait_for_masks([V0, 0, V1, 0])


def refresh(bench, **frame):
    payload = bench.cmd(1, {0: 300_000}).pack()
    return encode(Frame(**({"type": Cmd.CODE, "seq": 500, "t_us": 0, "payload": payload} | frame)))


BAD = {
    "flipped bit": (lambda b: refresh(b)[:-9] + b"\x55" + refresh(b)[-8:], None),
    "truncated": (lambda b: refresh(b)[:40] + b"\0", None),
    "oversized": (lambda _: b"\x01" * (CODED_MAX + 9) + b"\0", "bad_length"),
    "another version": (lambda b: refresh(b, version=VERSION + 1), "bad_version"),
    "unknown type": (lambda b: refresh(b, type=77), "unknown_type"),
    "replayed": (lambda b: refresh(b, seq=b.seq), "replayed"),
    "of another session": (
        lambda b: refresh(b, payload=bytes(4) + b.cmd(1, {}).pack()[4:]), "foreign",
    ),
}  # fmt: skip


def test_bad_frames_are_counted_and_feed_nothing(new_bench, kind):
    """All of them in every round, until the watchdog bites in spite of them."""
    bench = new_bench(**impatient(kind))
    before = bench.report()  # a chip that boots slowly has heard the end of somebody's first words
    start = bench.board.now_us
    assert bench.plan(1, {0: bench.limits.max_on_us}).result == Result.OK
    rounds, seq = 0, bench.seq
    while bench.board.now_us < start + bench.limits.watchdog_us + 40_000:
        bench.seq = seq
        for bad, _ in BAD.values():
            bench.board.feed(bad(bench))
            if not bench.exact:
                bench.wait(1_000)  # to be written before another one takes its place
        rounds += 1
        bench.wait(40_000)
    bench.until(lambda: len(bench.edges) == 2)
    if bench.exact:
        assert bench.edges[1].t_us - start == bench.limits.watchdog_us
    status = bench.report()
    assert status.faults == Fault.WATCHDOG
    counted = {name: getattr(status, name) - getattr(before, name) for name in COUNTERS}
    unsent = getattr(bench.board, "superseded", 0)  # on a port a plan replaces one not yet written
    assert sum(counted.values()) == rounds * len(BAD) - unsent
    for _, counter in BAD.values():
        assert counter is None or counted[counter] >= (rounds if bench.exact else 1)


def test_garbage_between_frames_costs_nothing(new_bench):
    bench = new_bench()
    noise = np.random.default_rng(4).integers(1, 256, 300, dtype=np.uint8)
    bench.board.feed(noise.tobytes() + b"\0")
    assert bench.plan(1, {0: 50_000}).result == Result.OK
    bench.wait_for_masks([V0, 0])


def test_undervoltage_trips_and_cannot_be_armed_away(new_bench):
    bench = new_bench()
    try:
        bench.board.sense(24_000, 500_000)
    except BoardError as error:
        pytest.skip(str(error))
    bench.plan(1, {0: 400_000})
    bench.until(lambda: bench.edges)
    bench.wait(1_000)
    bench.board.sense(bench.limits.undervoltage_mv - 500, 500_000)
    bench.wait_for_masks([V0, 0])
    status = bench.report()
    assert (status.state, status.faults) == (State.SAFE, Fault.UNDERVOLTAGE)
    assert abs(status.supply_mv - (bench.limits.undervoltage_mv - 500)) <= 9  # a converter's step
    assert bench.arm().result == Result.UNDERVOLTAGE
    bench.board.sense(24_000, 500_000)
    bench.wait(5_000)
    assert bench.arm().state == State.ARMED


# A whole session


def test_a_session_of_the_sender_stays_armed_and_plays_every_plan(new_bench):
    bench = new_bench(armed=False)
    board, session = bench.board, Session(bench.limits, 99)
    board.feed(session.hello(board.now_us))

    def step(us):
        end = board.now_us + us
        while board.now_us < end:
            board.feed(session.due(board.now_us))
            bench.edges += board.run_until(board.now_us + 5_000)
            session.receive(board.read(), board.now_us)

    while not session.greeted:
        step(10_000)
    board.feed(session.arm(board.now_us))
    step(20_000)
    for number in range(10):
        t = board.now_us * 1e-6
        on = tuple(50_000 if i == number % 8 else 0 for i in range(8))
        board.feed(session.apply(ValveCommand(number, t, t + 0.3, on, (0,) * 8), board.now_us))
        step(100_000)
    assert session.state == State.ARMED
    assert session.refusals == {}
    opened = [edge.mask for edge in settled(bench.edges) if edge.mask]
    assert opened == [1 << number % 8 for number in range(10)]


# The same every time


def fly(make, seed):
    """A random flight; its edges and all bytes that the board sent."""
    bench, dice = make(), np.random.default_rng(seed)
    said = b""
    for number in range(100):
        on = {int(v): int(dice.integers(60_000)) for v in dice.integers(0, 8, 3)}
        bench.seq += 1
        bench.board.feed(encode_message(bench.cmd(number, on), bench.seq, bench.board.now_us))
        bench.edges += bench.board.run_until(bench.board.now_us + int(dice.integers(40_000)))
        said += bench.board.read()
    return bench.edges, said


def test_in_virtual_time_the_same_flight_gives_the_same_bytes(new_bench, kind):
    if kind not in VIRTUAL:
        pytest.skip("on a wall clock no two flights are the same")
    first = fly(new_bench, 3)
    assert len(first[0]) > 50
    assert fly(new_bench, 3) == first


def test_a_board_in_virtual_time_never_goes_back(new_bench, kind):
    if kind not in VIRTUAL:
        pytest.skip("a wall clock does not either")
    bench = new_bench()
    bench.wait(1_000)
    with pytest.raises(ValueError, match="already"):
        bench.board.run_until(bench.board.now_us - 1)
