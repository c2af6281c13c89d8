"""Plans over a serial line to real firmware, with a twin listening in on the line."""

import os
import threading
from contextlib import contextmanager

import pytest

from firmware_interface.frame import encode_message
from firmware_interface.line_tap import LineTap, TapError
from firmware_interface.messages import Hello, ResetCause
from firmware_interface.serial_board import BoardError, monotonic_us
from firmware_interface.serial_thrusters import CAUSES, SerialThrusters, ThrustersError
from patience import wait_for
from testbed.core.codes import FaultId
from testbed.core.types import ValveCommand
from testbed.core.vehicle import Gauges

PERIOD_US = 100_000


@contextmanager
def served(limits, folder, **options):
    """A tap that passes bytes on, and all edges it has seen."""
    edges, over = [], threading.Event()
    with LineTap(limits, 3, folder / "port", **options) as tap:

        def serve():
            while not over.wait(0.0005):
                tap.serve()
                edges.extend(tap.edges())

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield tap, edges
        finally:
            over.set()
            thread.join()


def plan(seq, issued_at, on, offset=0):
    until = issued_at + 1e-6 * PERIOD_US
    return ValveCommand(seq, issued_at, until, (on,) + (0,) * 7, (offset,) + (0,) * 7)


@contextmanager
def pulsing(limits, folder):
    """A tap, its edges and armed thrusters, while a jet is open."""
    with (
        served(limits, folder) as (tap, edges),
        SerialThrusters(str(tap.link), limits, 0.0, 1) as thrusters,
    ):
        thrusters.epoch_us = monotonic_us()
        thrusters.arm()
        thrusters.apply(plan(1, 0.0, 90_000))
        wait_for(lambda: edges)
        yield tap, edges, thrusters


@pytest.fixture
def limits(host):
    return host.limits


def test_a_plan_is_played_as_long_as_it_says(limits, tmp_path):
    with served(limits, tmp_path) as (tap, edges):
        with SerialThrusters(str(tap.link), limits, 0.002, 1) as thrusters:
            thrusters.epoch_us = monotonic_us()
            thrusters.bearing(on=True)
            wait_for(lambda: tap.bearing)
            thrusters.arm()
            issued = 1e-6 * (monotonic_us() - thrusters.epoch_us)
            thrusters.apply(plan(1, issued, 40_000, 20_000))
            wait_for(lambda: len(edges) >= 2)
            thrusters.apply(plan(2, 1e-6 * (monotonic_us() - thrusters.epoch_us), 0))
            assert thrusters.health().supply_pressure == 500_000
            assert thrusters.trouble is None
            assert thrusters.refusals == {}
        (opened, first), (closed, second) = edges
    assert (first, second) == (1, 0)
    start = thrusters.epoch_us + round(1e6 * issued) + 2_000
    # the board's stamps: the length is the firmware's, the start also the line's and the wait's
    assert closed - start >= 60_000
    assert opened >= start
    assert thrusters.sent[0][0] == 1
    assert thrusters.sent[0][1] >= start


def test_leaving_disarms(limits, tmp_path):
    with served(limits, tmp_path) as (tap, edges):
        with SerialThrusters(str(tap.link), limits, 0.0, 1) as thrusters:
            thrusters.epoch_us = monotonic_us()
            thrusters.arm()
            thrusters.apply(plan(1, 0.0, 90_000))
            wait_for(lambda: edges)
        wait_for(lambda: tap.status.state.name == "SAFE")
        assert tap.status.faults == 0
        assert edges[-1].mask == 0


def test_a_cut_line_is_trouble_and_the_board_closes(limits, tmp_path):
    with pulsing(limits, tmp_path) as (tap, edges, thrusters):
        tap.cut = True
        wait_for(lambda: tap.status.faults)
        assert edges[-1].mask == 0
        assert tap.status.state.name == "SAFE"
        tap.cut = False
        wait_for(lambda: thrusters.trouble)
        assert thrusters.trouble.text == "the board has left ARMED: watchdog"
        thrusters.apply(plan(2, 1e-6 * (monotonic_us() - thrusters.epoch_us), 90_000))
        wait_for(lambda: thrusters.refusals.get("not_armed"))
        assert edges[-1].mask == 0


def test_another_process_has_the_port(limits, tmp_path):
    with (
        served(limits, tmp_path) as (tap, _),
        SerialThrusters(str(tap.link), limits, 0.0, 1),
        pytest.raises(BoardError, match="no other program uses"),
        SerialThrusters(str(tap.link), limits, 0.0, 2),
    ):
        pass


def test_no_board_at_the_other_end(limits, tmp_path, monkeypatch):
    monkeypatch.setattr("firmware_interface.serial_thrusters.ANSWER_US", 100_000)
    with (
        LineTap(limits, 1, tmp_path / "port") as tap,  # it does not pass anything on
        pytest.raises(ThrustersError, match="does not answer HELLO"),
        SerialThrusters(str(tap.link), limits, 0.0, 1),
    ):
        pass


def test_a_board_that_answered_two_hellos_is_armed_all_the_same(limits, tmp_path):
    with LineTap(limits, 1, tmp_path / "port") as tap:
        late = threading.Timer(0.35, lambda: None)  # until then HELLOs pile up on the line
        late.start()

        def serve():
            late.join()
            while not over.wait(0.001):
                tap.serve()

        over = threading.Event()
        thread = threading.Thread(target=serve)
        thread.start()
        try:
            with SerialThrusters(str(tap.link), limits, 0.0, 1) as thrusters:
                thrusters.arm()
                thrusters.bearing(on=True)
        finally:
            over.set()
            thread.join()


def test_nothing_is_left_of_a_tap(limits, tmp_path):
    with LineTap(limits, 1, tmp_path / "port") as tap:
        assert tap.link.is_symlink()
        pid = tap.pid
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


@pytest.mark.parametrize(
    ("gauges", "read"),
    [
        (Gauges(), (0.0, 0.0)),
        (Gauges(supply=False), (4e5, 0.0)),
        (Gauges(battery=False), (0.0, 12.0)),
    ],
)
def test_a_sensor_that_reads_0_from_boot_is_believed_unless_there_is_none(
    gauges, read, limits, tmp_path
):
    with served(limits, tmp_path) as (tap, _):
        tap.sense(0, 0)
        wait_for(lambda: tap.status is not None and tap.status.supply_pa == tap.status.supply_mv)
        with SerialThrusters(
            str(tap.link), limits, 0.0, 1, set_pressure=4e5, gauges=gauges
        ) as thrusters:
            health = thrusters.health()
            assert (health.supply_pressure, health.battery) == read


def test_a_gauge_that_falls_to_nothing_is_believed(limits, tmp_path):
    with served(limits, tmp_path) as (tap, _), SerialThrusters(
        str(tap.link), limits, 0.002, 1, set_pressure=600_000.0
    ) as thrusters:  # fmt: skip
        wait_for(lambda: thrusters.health().supply_pressure == 500_000)
        tap.sense(0, 0)  # the tank is empty, and the battery too
        wait_for(lambda: thrusters.health().supply_pressure == 0.0)
        wait_for(lambda: thrusters.health().battery == 0.0)
        assert thrusters.health().silent_s < 5.0


def test_a_twin_does_not_take_the_place_of_what_is_there(limits, tmp_path):
    board, link = tmp_path / "ttyACM0", tmp_path / "port"
    board.write_text("what a lab has")
    link.symlink_to(board)
    for place in (board, link):
        with pytest.raises(TapError, match="not created by a twin"), LineTap(limits, 1, place):
            pass
    assert board.read_text() == "what a lab has"
    assert link.readlink() == board


def test_the_port_of_a_twin_that_was_killed_is_taken_over(limits, tmp_path):
    link = tmp_path / "port"
    link.symlink_to("/dev/pts/4096")
    with LineTap(limits, 1, link) as tap:
        assert tap.link.exists()
    assert not link.is_symlink()


def test_a_twin_takes_away_no_port_but_its_own(limits, tmp_path):
    link = tmp_path / "port"
    with LineTap(limits, 1, link):
        link.unlink()
        link.symlink_to("/dev/pts/4096")
    assert str(link.readlink()) == "/dev/pts/4096"


def test_a_board_that_was_reset_says_why(limits, tmp_path):
    with pulsing(limits, tmp_path) as (tap, _, thrusters):
        tap.power(on=False)
        tap.power(on=True)
        wait_for(lambda: thrusters.trouble)
        assert thrusters.trouble.id is FaultId.BOARD_RESET
        assert thrusters.trouble.text == "the board was reset: its supply dipped (brown-out)"
        thrusters.apply(plan(2, 0.0, 90_000))  # neither raises nor opens a valve
        thrusters.land()
        wait_for(lambda: tap.status.mask == 0)


def test_a_board_with_another_session_was_taken_by_another_program(limits, tmp_path):
    with pulsing(limits, tmp_path) as (tap, _, thrusters):
        os.write(tap.board_fd, encode_message(Hello(99), 1, 0))
        wait_for(lambda: thrusters.trouble)
        assert thrusters.trouble.id is FaultId.BOARD_LEFT_ARMED
        assert "another program has opened a session" in thrusters.trouble.text


def test_every_cause_of_a_reset_has_words():
    assert set(CAUSES) == set(ResetCause)
