"""The serial port and the process on a pseudo-terminal: what no other board can get wrong."""

import os
import select
import signal
import subprocess
import sys
import tty
from contextlib import closing
from pathlib import Path

import pytest
import serial

from firmware_interface.frame import Decoder, Frame, encode, encode_message
from firmware_interface.host_pty import HostPtyBoard
from firmware_interface.messages import (
    Arm,
    Cmd,
    Disarm,
    Edges,
    HelloAck,
    Ping,
    ResetCause,
    State,
    Status,
)
from firmware_interface.reports import Reports
from firmware_interface.serial_board import BoardError, SerialBoard
from firmware_interface.session import Session

PATIENCE_S = 60  # of waits that end at once on any machine that is not broken


@pytest.fixture
def limits(host):
    return host.limits


@pytest.fixture
def port():
    """A pseudo-terminal: our end, and the name of the other."""
    ours, other = os.openpty()
    tty.setraw(other)
    yield ours, os.ttyname(other)
    os.close(ours)
    os.close(other)


def frames_at(line, count):
    """The next frames that arrive at our end."""
    decoder, frames = Decoder(), []
    while len(frames) < count:
        assert select.select([line], [], [], PATIENCE_S)[0], f"only {frames} came"
        frames += decoder.feed(os.read(line, 4096))
    return frames


def listen_until(board, session, done):
    """Let the session hear the board until `done()`."""
    for _ in range(400):
        session.receive(board.read(), board.now_us)
        if done():
            return
        board.feed(session.due(board.now_us))
        board.run_until(board.now_us + 1_000)
    pytest.fail(f"heard {session.board}, {session.status}")


def gone(pid):
    """Whether this process is there no more, or dead and not yet buried."""
    try:
        return " Z " in Path(f"/proc/{pid}/stat").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return True


def cmd(number):
    return Cmd(1, number, 0, 1, (0,) * 8, (0,) * 8)


# The process


def test_a_session_over_a_real_port(limits):
    with closing(HostPtyBoard(limits, boot_nonce=41)) as board:
        session = Session(limits, 5)
        board.feed(session.hello(board.now_us))
        listen_until(board, session, lambda: session.greeted)
        assert session.board.boot_nonce == 41
        board.sense(21_000, 450_000)
        listen_until(board, session, lambda: session.status and session.status.supply_mv == 21_000)
        board.power_cycle(ResetCause.BROWN_OUT)
        board.feed(session.hello(board.now_us))
        listen_until(board, session, lambda: session.greeted)
        assert session.board.boot_nonce == 42
        assert session.board.reset_cause == ResetCause.BROWN_OUT


def test_no_process_and_no_link_stay_behind(limits, tmp_path):
    board = HostPtyBoard(limits, link=tmp_path / "board")
    pid = board.pid
    assert (tmp_path / "board").resolve().exists()
    board.close()
    assert gone(pid)
    assert not (tmp_path / "board").is_symlink()


def test_the_process_ends_when_its_parent_is_killed(limits):
    code = (
        "import sys; from firmware_interface.host_pty import HostPtyBoard;"
        " from firmware_interface.messages import Config;"
        f" board = HostPtyBoard(Config.unpack(bytes.fromhex('{limits.pack().hex()}')));"
        " print(board.pid, flush=True); sys.stdin.read()"
    )
    root = Path(__file__).parents[2]
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=root
    ) as parent:
        pid = int(parent.stdout.readline())
        assert not gone(pid)
        end = os.pidfd_open(pid)  # becomes readable when the process ends
        parent.kill()
    assert select.select([end], [], [], PATIENCE_S)[0]
    os.close(end)


def test_a_link_of_another_process_is_left_alone(limits, tmp_path):
    first = HostPtyBoard(limits, link=tmp_path / "board")
    second = HostPtyBoard(limits, link=tmp_path / "board")
    first.close()
    assert (tmp_path / "board").resolve().exists()
    second.close()


# The port


def test_a_port_has_one_owner(limits, tmp_path):
    with (
        closing(HostPtyBoard(limits, link=tmp_path / "board")),
        pytest.raises(BoardError, match="no other program uses"),
    ):
        SerialBoard(str(tmp_path / "board"))


def test_a_port_that_is_not_there(tmp_path):
    with pytest.raises(BoardError, match="nothing-here cannot be opened"):
        SerialBoard(str(tmp_path / "nothing-here"))


def test_a_lost_port_is_opened_again_and_nothing_old_is_sent(limits, tmp_path):
    """The cable is pulled: the process goes, its link stays, and comes back as another terminal."""
    link = tmp_path / "cable"
    far = HostPtyBoard(limits, boot_nonce=1, link=tmp_path / "first")
    far._closing = True  # its own port makes room
    far.feed(b"\0")
    far._thread.join()
    link.symlink_to((tmp_path / "first").readlink())
    with closing(SerialBoard(str(link))) as board:
        board.run_until(1)
        os.kill(far.pid, signal.SIGTERM)
        with board._changed:
            assert board._changed.wait_for(lambda: not board.connected, PATIENCE_S)
        board.feed(encode_message(Disarm(), 1, 0))
        assert not board._waiting
        link.unlink()
        second = HostPtyBoard(limits, boot_nonce=2, link=tmp_path / "second")
        second._closing = True
        second.feed(b"\0")
        second._thread.join()
        link.symlink_to((tmp_path / "second").readlink())
        session = Session(limits, 5)
        with board._changed:
            assert board._changed.wait_for(lambda: board.connected, PATIENCE_S)
        board.feed(session.hello(board.now_us))
        listen_until(board, session, lambda: session.greeted)
        assert session.board.boot_nonce == 2
        assert board.reconnects == 1
        assert session.state == State.SAFE
    second.close()
    far.close()


def test_a_command_while_a_lost_port_is_being_closed_is_dropped(monkeypatch):
    ours, other = os.openpty()
    tty.setraw(other)
    close, sending, errors = serial.Serial.close, [], []

    def close_and_send(port):
        close(port)
        for board in sending:
            try:
                board.feed(encode_message(Disarm(), 1, 0))
            except Exception as error:
                errors.append(error)

    monkeypatch.setattr(serial.Serial, "close", close_and_send)
    with closing(SerialBoard(os.ttyname(other))) as board:
        assert select.select([ours], [], [], PATIENCE_S)[0]  # its first byte: nothing is unsent
        with board._changed:
            sending.append(board)
        os.close(ours)
        with board._changed:
            assert board._changed.wait_for(lambda: not board.connected, PATIENCE_S)
        sending.clear()
    os.close(other)
    assert errors == []


def test_of_plans_not_yet_written_only_the_newest_counts(port, monkeypatch):
    line, name = port
    monkeypatch.setattr(SerialBoard, "_write_now", lambda board, data: False)  # a busy line
    with closing(SerialBoard(name)) as board:
        with board._changed:  # the thread waits meanwhile
            for number, message in enumerate([cmd(1), Arm(1), cmd(2), Disarm(), cmd(3)]):
                board.feed(encode_message(message, number, 0))
        assert [frame.type for frame in frames_at(line, 3)] == [Arm.CODE, Disarm.CODE, Cmd.CODE]
        assert board.superseded == 2


def test_a_line_without_a_reader_never_holds_up_the_sender(port):
    _, name = port
    with closing(SerialBoard(name)) as board:
        for number in range(2000):  # 32 000 bytes: more than a terminal keeps
            board.feed(encode_message(Ping(), number, 0))
        assert len(board._waiting) <= 64


def test_half_a_frame_of_a_program_that_died_spoils_nothing(port):
    line, name = port
    with closing(SerialBoard(name)) as board:
        board.feed(encode_message(Ping(), 7, 0))
        assert select.select([line], [], [], PATIENCE_S)[0]
        heard = os.read(line, 1)
        assert heard == b"\0"
        assert frames_at(line, 1)[0].seq == 7


def test_a_silent_board_is_named(port, monkeypatch):
    monkeypatch.setattr("firmware_interface.serial_board.SILENCE_S", 0.01)
    with closing(SerialBoard(port[1])) as board, pytest.raises(BoardError, match="nothing heard"):
        board.run_until(1)


def test_a_port_can_neither_be_told_what_to_measure_nor_unplugged(port):
    with closing(SerialBoard(port[1])) as board:
        with pytest.raises(BoardError, match="measure"):
            board.sense(1, 1)
        with pytest.raises(BoardError, match="power-cycled"):
            board.power_cycle(ResetCause.PIN)


# What the board says of itself


def status(t_us):
    return encode(Frame(Status.CODE, 1, t_us, bytes(Status.LAYOUT.size)))


def test_the_boards_clock_is_carried_over_its_wrap():
    reports = Reports()
    reports.receive(status((1 << 32) - 30_000), 1_000_000)
    reports.receive(status(20_000), 1_050_000)
    assert reports.board_us == (1 << 32) + 20_000
    assert reports.now_us(1_060_000) == (1 << 32) + 30_000


@pytest.mark.parametrize("t_us", [500, 2_000_000_000])
def test_a_clock_that_jumps_is_that_of_another_boot(t_us):
    reports = Reports()
    reports.receive(status(40_000_000), 0)
    reports.receive(status(t_us), 50_000)
    assert reports.board_us == t_us


def test_edges_that_are_not_taken_do_not_pile_up(monkeypatch):
    monkeypatch.setattr("firmware_interface.reports.KEPT", 5)
    reports = Reports()
    for t in range(1, 9):
        frame = Edges(1, (t,) + (0,) * 7, (t & 1,) + (0,) * 7)
        reports.receive(encode_message(frame, t, t), 0)
    assert reports.take_edges() == [(t, t & 1) for t in range(4, 9)]
    assert reports.take_edges() == []


def test_frames_of_the_other_side_are_ignored():
    reports = Reports()
    reports.receive(encode(Frame(99, 1, 5, b"")) + encode(Frame(HelloAck.CODE, 1, 6, b"short")), 0)
    assert reports.board_us == 6
