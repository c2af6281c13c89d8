"""Entry point of the command. `testbed stop` runs before anything large is imported.

Verbs that execute a user's law run under a supervisor process.
"""

import atexit
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import NoReturn

from testbed.cli.exit_code import BAD_INPUT, INTERRUPTED, OUR_FAULT

SUPERVISED = ("run", "check")
UNFINISHED = (BAD_INPUT, OUR_FAULT)  # of a run that could not write its files, or of an error here
PRIORITY = 90  # above hosts, vehicles and the twin


def entry() -> None:
    """Run `testbed`; a Ctrl-C while modules are imported ends it without a traceback."""
    try:
        _run()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


def _run() -> None:
    """Run a verb; a bare `testbed stop` gets priority over all flights on this machine."""
    if sys.argv[1:] == ["stop"]:
        from testbed.net.stop import stop_everything
        from testbed.realtime.scheduling import realtime_priority

        with realtime_priority(PRIORITY):
            code = stop_everything(None, "lab")
        sys.exit(code)
    if sys.argv[1:2] and sys.argv[1] in SUPERVISED:
        from testbed.cli.process_supervisor import supervised

        result = supervised()
        if result is not None:
            sys.exit(result)
    with interruptible():
        from testbed.cli.main import entry as every_verb
    try:
        every_verb()
    except SystemExit as end:
        if sys.argv[1:2] and sys.argv[1] in SUPERVISED:
            _leave(end.code if isinstance(end.code, int) else 0)
        raise


@contextmanager
def interruptible() -> Iterator[None]:
    """While open, a Ctrl-C ends the process at once; for imports.

    Python drops a KeyboardInterrupt that is raised in a callback of the import system, prints it,
    and goes on.
    """
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, lambda number, frame: os._exit(INTERRUPTED))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _leave(code: int) -> NoReturn:
    """Exit at once: Python would wait for a law's threads and tear down large packages first."""
    from testbed.realtime.heartbeat import RunPhase, heartbeat

    heart = heartbeat()
    with suppress(OSError, ValueError, AttributeError):  # a law may have closed or replaced them
        sys.stdout.flush()
        sys.stderr.flush()
    # an error after take-off may be the law's, which shares this process: the supervisor finishes
    if not (heart.law and heart.phase >= RunPhase.FLYING and code in UNFINISHED):
        heart.finished(code)
    atexit._run_exitfuncs()  # noqa: SLF001  (there is no public function)
    os._exit(code)


if __name__ == "__main__":
    entry()
