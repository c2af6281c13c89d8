"""The emulator leaves nothing behind."""

import os
import select
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from firmware_interface.compiler import CompilerError, cross_compiler
from firmware_interface.messages import Config
from firmware_interface.qemu import QEMU, QemuBoard
from firmware_interface.serial_board import BoardError

PATIENCE_S = 120


@pytest.fixture
def limits(host, need_tool):
    need_tool(None if shutil.which(QEMU) else f"{QEMU} is not installed")
    try:
        cross_compiler()
    except CompilerError as error:
        need_tool(str(error))
    return host.limits


def emulators(guard):
    """What the guard has started."""
    return [int(pid) for pid in Path(f"/proc/{guard}/task/{guard}/children").read_text().split()]


def test_closing_ends_it(limits):
    board = QemuBoard(limits)
    (pid,) = emulators(board._process.pid)
    end = os.pidfd_open(pid)
    board.close()
    assert select.select([end], [], [], PATIENCE_S)[0]
    os.close(end)


def start_and_say(record: str) -> None:
    """What the doomed program does."""
    board = QemuBoard(Config.unpack(bytes.fromhex(record)))
    sys.stdout.write(f"{emulators(board._process.pid)[0]}\n")
    sys.stdout.flush()
    sys.stdin.read()


def test_it_ends_when_its_parent_is_killed(limits):
    code = "import sys; from test_qemu import start_and_say; start_and_say(sys.argv[1])"
    here = Path(__file__).parent
    with subprocess.Popen(
        [sys.executable, "-c", code, limits.pack().hex()],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONPATH": f"{here.parents[1]}:{here}"},
    ) as parent:  # fmt: skip
        end = os.pidfd_open(int(parent.stdout.readline()))
        parent.kill()
    assert select.select([end], [], [], PATIENCE_S)[0]
    os.close(end)


def test_without_it_the_error_says_what_to_install(limits, monkeypatch):
    which = shutil.which
    monkeypatch.setattr(shutil, "which", lambda name: None if name == QEMU else which(name))
    with pytest.raises(BoardError, match=f"apt install --no-install-recommends {QEMU}"):
        QemuBoard(limits)
