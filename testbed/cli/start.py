"""Where the command begins: a stop does not wait until everything else is imported."""

import sys

PRIORITY = 90  # above hosts, vehicles and the twin


def entry() -> None:
    """`testbed`; a bare `testbed stop` before all else, also before what flies on this machine."""
    if sys.argv[1:] == ["stop"]:
        from testbed.ops.steady import preferred
        from testbed.ops.stop import stop_everything

        with preferred(PRIORITY):
            code = stop_everything(None, "lab")
        sys.exit(code)
    from testbed.cli.main import entry as every_verb

    every_verb()
