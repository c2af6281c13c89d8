"""Where the command begins: a stop does not wait until everything else is imported."""

import sys

PRIORITY = 90  # above hosts, vehicles and the twin


def entry() -> None:
    """`testbed`; a bare `testbed stop` before all else, also before what flies on this machine."""
    if sys.argv[1:] == ["stop"]:
        from testbed.net.stop import stop_everything
        from testbed.realtime.scheduling import preferred

        with preferred(PRIORITY):
            code = stop_everything(None, "lab")
        sys.exit(code)
    from testbed.cli.main import entry as every_verb

    every_verb()
