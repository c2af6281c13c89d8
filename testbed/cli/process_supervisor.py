"""A small supervisor process that finishes a run even if the flying process dies or hangs.

`testbed run` forks before it imports large packages. The child reads, flies and finishes. The
parent runs no user code and only watches: if a law hangs where Python cannot interrupt it, uses up
the memory or ends its process, the run is still judged and reported. The parent also ends processes
that the child started and left behind.

    child                             exit code of the parent
    finished                          the child's exit code
    died or was killed                3; the fault names the law; the run folder is finished
    the same after the operator's     130, interrupted; the run folder is finished
      stop, or did not obey it
    the same while reading a law's    2; the file is refused; no run folder
      file

Signals to the parent are forwarded, unless the child has received them too. Until the child counts
signals (`run/interrupt.py`), each of them kills it at once: Python drops the exception of a Ctrl-C
that comes in a callback of the compiler, and prints one that comes during an import.
"""

import ctypes
import mmap
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from time import monotonic

from testbed.cli.exit_code import BAD_INPUT, FAULT, INTERRUPTED
from testbed.core.error import TestbedError
from testbed.realtime.heartbeat import SIZE, Heartbeat, RunPhase, attach

STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
HEARD = {*STOPS, signal.SIGCHLD}
LOOK_S = 0.05
GRACE_S = 1.0  # on top of the child's own limit, so that it can interrupt its law itself
READ_S, FIRST_S = 45.0, 60.0  # limits for reading a law's file, and for calls that may compile
ASKED_S = 1.0  # limit of a law's call, or of the compiler, after the operator's stop
# limit of silence after the operator's stop: a run beats every tick, also while vehicles brake, and
# without it they stand by then (a lease of 1 s and a brake of 6 s)
HUNG_S = 7.0
LEAVE_S = 2.0  # time for a finished process to exit
MUCH = 1.5  # one call may add this multiple of deploy.law_memory_mb
LAST_S = 20.0  # time for the log writer, and for vehicles that brake
FINISH_S = 60.0  # time to judge and report the run
SENT_BY_KERNEL = 0x80  # SI_KERNEL: Ctrl-C, which the terminal sends to all processes of a command
PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36
SHOW_CURSOR = "\x1b[?25h"


def supervised() -> int | None:
    """Fork. Returns the exit code in the parent, None in the child, which runs the command."""
    heartbeat = Heartbeat(mmap.mmap(-1, SIZE))
    libc = ctypes.CDLL(None)
    libc.prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)  # orphans of a dead child become our children
    signal.pthread_sigmask(signal.SIG_BLOCK, HEARD)
    parent = os.getpid()
    child = os.fork()
    if child == 0:
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else ignored, as by `&`
            signal.signal(signal.SIGINT, signal.SIG_DFL)
        _begin(libc, parent)
        attach(heartbeat, parent)
        return None
    return ProcessSupervisor(child, heartbeat, libc).watch()


def _begin(libc: ctypes.CDLL, parent: int) -> None:
    """Begin a new process: it dies with its parent, and signals are unblocked."""
    libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:
        os._exit(FAULT)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, HEARD)


class ProcessSupervisor:
    """Watches one child process and finishes its run."""

    def __init__(self, child: int, heartbeat: Heartbeat, libc: ctypes.CDLL) -> None:
        self._child, self._heartbeat, self._libc = child, heartbeat, libc
        self._ended: int | None = None  # wait status of the child
        self._asked = 0  # the operator's stop signal
        self._to_hand_on: tuple[int, int] | None = (
            None  # signal, and the child's count of signals before it
        )
        self._looks, self._beats = 0, -1  # looks since the last heartbeat, and its count
        self._since_asked = 0
        self._asked_ending, self._since_asked_ending = False, 0  # while the files are written
        self._hung = False
        self._entered_mb = 0.0

    def watch(self) -> int:
        """Wait until the child has ended and the run is finished; returns the exit code."""
        fault = ""
        while self._ended is None:
            self._take_signals()
            if self._ended is None and (why := self._stuck()):
                fault = why
                self._end_child()
        code = self._heartbeat.result
        strays = [pid for pid in children() if session_of(pid) == os.getsid(0)]
        for pid in strays:  # in the child's session: started by a law
            kill(pid)
        if code is not None:
            return code
        from testbed.net.flight_note import withdraw

        rig = self._heartbeat.rig
        wired = rig in ("bench", "table") and self._heartbeat.phase >= RunPhase.FLYING
        if not wired:
            withdraw(self._child)  # that of a killed host leads to its vehicles
        if sys.stderr.isatty():
            sys.stderr.write(SHOW_CURSOR)
        code = self._finish(fault or self._words())
        if rig == "bench":
            withdraw(self._child)  # its vehicles have ended, too
        return code

    # Looking

    def _take_signals(self) -> None:
        """Wait for a signal, at most LOOK_S; reap, and forward what the child did not get."""
        if self._to_hand_on is not None:
            number, noted = self._to_hand_on
            self._to_hand_on = None
            if self._heartbeat.signals == noted:
                kill(self._child, number)
        info = signal.sigtimedwait(HEARD, LOOK_S)
        if info is not None and info.si_signo in STOPS:
            self._asked = self._asked or info.si_signo
            self._asked_ending |= self._heartbeat.phase is RunPhase.ENDING
            sent_to_both = (info.si_signo, info.si_code) == (signal.SIGINT, SENT_BY_KERNEL)
            if not (sent_to_both and self._heartbeat.folder):  # early: there was no child perhaps
                self._to_hand_on = info.si_signo, self._heartbeat.signals
                signal.sigtimedwait([signal.SIGCHLD], LOOK_S)
        self._reap()

    def _reap(self) -> None:
        with suppress(ChildProcessError):
            while (found := os.waitpid(-1, os.WNOHANG))[0]:
                if found[0] == self._child:
                    self._ended = found[1]

    def _stuck(self) -> str:
        """The reason to kill the child now, or an empty string.

        Looks are counted, not seconds: a suspended command must not look like a hanging law.
        """
        heartbeat = self._heartbeat
        beats, vehicle = heartbeat.beats, heartbeat.inside
        self._looks = 0 if beats != self._beats else self._looks + 1
        self._since_asked += bool(self._asked)
        self._since_asked_ending += self._asked_ending
        memory = resident_mb(self._child)
        if beats != self._beats:
            self._beats, self._entered_mb = beats, memory
        still_s = LOOK_S * self._looks
        if heartbeat.result is not None:
            return "it did not exit" if still_s > LEAVE_S else ""
        if self._asked and still_s > ASKED_S and LOOK_S * self._since_asked > ASKED_S:
            if heartbeat.phase is RunPhase.COMPILING:
                return "it was still compiling"
            if vehicle is not None:
                return self._law(f"did not return after the stop, within {ASKED_S:g} s")
        if vehicle is None:
            self._hung = self._is_silent(still_s)
            return "it did not obey the stop" if self._hung else ""
        limit_s, memory_mb = heartbeat.limits
        limit = limit_s + GRACE_S
        limit = {RunPhase.READING: READ_S, RunPhase.COMPILING: max(FIRST_S, limit)}.get(
            heartbeat.phase, limit
        )
        if still_s > limit:
            return self._law(f"did not return within {still_s:.0f} s")
        if (grown := memory - self._entered_mb) > MUCH * memory_mb:
            return self._law(
                f"took {grown:.0f} MB of memory in one call, more than {MUCH:g} times"
                f" deploy.law_memory_mb = {memory_mb:g}"
            )
        return ""

    def _is_silent(self, still_s: float) -> bool:
        """Whether a child that is in no law has not obeyed the stop, and does nothing else."""
        if self._heartbeat.phase is RunPhase.ENDING:  # a page may stay until the next Ctrl-C
            return min(still_s, LOOK_S * self._since_asked_ending) > FINISH_S
        return min(still_s, LOOK_S * self._since_asked) > HUNG_S

    def _end_child(self) -> None:
        kill(self._child)
        while self._ended is None:
            signal.sigtimedwait(HEARD, LOOK_S)
            self._reap()

    # Words

    def _law(self, what: str) -> str:
        vehicle, law = self._heartbeat.inside, self._heartbeat.law
        return f"law of {vehicle} ({law}) {what}" if vehicle else f"law {law} {what}"

    def _words(self) -> str:
        """Describe how the child ended before it finished the run."""
        assert self._ended is not None
        code = os.waitstatus_to_exitcode(self._ended)
        how = f"with exit code {code}"
        if code < 0:
            how = f"by {signal.Signals(-code).name}"
            if code == -signal.SIGKILL:
                how += ", as the system does when memory runs out"
        if self._heartbeat.inside is not None:
            return self._law(f"ended its process {how}")
        flew = f" of the law {law}" if (law := self._heartbeat.law) else ""
        return f"the process of the run{flew} ended {how} before it had finished"

    # Finishing

    def _finish(self, fault: str) -> int:
        heartbeat, code = self._heartbeat, os.waitstatus_to_exitcode(self._ended or 0)
        if self._asked and not heartbeat.folder:
            return INTERRUPTED
        if heartbeat.phase is RunPhase.READING and heartbeat.inside is not None:
            where, expected = "the file of the law", "a readable law"
            print_error(f"error: {TestbedError(where=where, expected=expected, found=fault)}")
            return BAD_INPUT
        if not heartbeat.folder:  # the child has printed its error, or the operator stopped it
            return INTERRUPTED if code in (-n for n in STOPS) else code if code > 0 else FAULT
        for pid in children():
            if b"testbed.logs.mcap_writer" in words_of(pid):
                self._wait([pid], LAST_S)
        if self._asked and (heartbeat.inside is None or heartbeat.phase is RunPhase.COMPILING):
            fault = ""
        if self._hung:
            print_error("warning: the run's process did not obey the stop, and was killed")
        if not Path(heartbeat.folder, "config.toml").exists():
            print_error(f"aborted by a fault: {fault}; the run folder is gone: {heartbeat.folder}")
            return FAULT
        self._judge(fault)
        self._wait([pid for pid in children() if not shows(words_of(pid))], LAST_S)
        return FAULT if fault else INTERRUPTED

    def _judge(self, fault: str) -> None:
        """Finish the run folder in a separate process, as the run itself would have."""
        parent = os.getpid()
        finisher = os.fork()
        if finisher == 0:
            _begin(self._libc, parent)
            for number in STOPS:
                signal.signal(number, signal.SIG_IGN)  # it takes a moment only
            from testbed.cli.finish import finish_run

            folder, rig = Path(self._heartbeat.folder), self._heartbeat.rig
            finish_run(folder, rig, fault or None, as_json="--json" in sys.argv)
            sys.stdout.flush()
            os._exit(0)
        if self._wait([finisher], FINISH_S):
            print_error(f"warning: the run folder is incomplete: {self._heartbeat.folder}")

    def _wait(self, pids: list[int], limit_s: float) -> bool:
        """Wait for processes to end and kill the rest; returns whether any was killed."""
        end, left = monotonic() + limit_s, [pid for pid in pids if not gone(pid)]
        while left and monotonic() < end:
            signal.sigtimedwait([signal.SIGCHLD], LOOK_S)
            left = [pid for pid in left if not gone(pid)]
        for pid in left:
            kill(pid)
            gone(pid)
        return bool(left)


# Processes


def print_error(text: str) -> None:
    """Print on stderr; its terminal may be closed."""
    with suppress(OSError):
        sys.stderr.write(text + "\n")
        sys.stderr.flush()


def kill(pid: int, number: int = signal.SIGKILL) -> None:
    """Send a signal to a child, unless it has ended."""
    with suppress(ProcessLookupError):
        os.kill(pid, number)


def gone(pid: int) -> bool:
    """Whether a child has ended; reaps it."""
    try:
        return os.waitpid(pid, os.WNOHANG)[0] != 0
    except ChildProcessError:
        return True


def children() -> Iterator[int]:
    """PIDs of this process's children, including orphans of a dead child."""
    me = os.getpid()
    for found in Path("/proc").iterdir():
        if found.name.isdigit() and parent_of(int(found.name)) == me:
            yield int(found.name)


def _stat(pid: int) -> list[str]:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []


def parent_of(pid: int) -> int:
    """PID of a process's parent; 0: it has ended."""
    fields = _stat(pid)
    return int(fields[1]) if fields else 0


def session_of(pid: int) -> int:
    """Session id of a process; 0: it has ended."""
    fields = _stat(pid)
    return int(fields[3]) if fields else 0


def words_of(pid: int) -> bytes:
    """Command line of a process, from /proc; empty: it has ended."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def shows(words: bytes) -> bool:
    """Whether a command line is of a page that stays after the flight."""
    return b"dash" in words or b"testbed.console" in words


def resident_mb(pid: int) -> float:
    """Resident memory of a process [MB]; 0: it has ended."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except (OSError, IndexError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
