"""Where the command begins: a stop does not wait until everything else is imported.

What reads or flies a law of the user's own has a second process that looks after it.
"""

import atexit
import os
import sys
from contextlib import suppress
from typing import NoReturn

SUPERVISED = ("run", "check")
PRIORITY = 90  # above hosts, vehicles and the twin


def entry() -> None:
    """`testbed`; a bare `testbed stop` before all else, also before what flies on this machine."""
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
    from testbed.cli.main import entry as every_verb

    try:
        every_verb()
    except SystemExit as end:
        if sys.argv[1:2] and sys.argv[1] in SUPERVISED:
            _leave(end.code if isinstance(end.code, int) else 0)
        raise


def _leave(code: int) -> NoReturn:
    """End at once: Python would wait for threads of a law, and take large packages apart first."""
    from testbed.realtime.heartbeat import heartbeat

    with suppress(OSError):
        sys.stdout.flush()
        sys.stderr.flush()
    heartbeat().finished(code)
    atexit._run_exitfuncs()  # noqa: SLF001  (it has no public door)
    os._exit(code)


if __name__ == "__main__":
    entry()
