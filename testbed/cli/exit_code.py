"""Exit codes of `testbed`."""

OK = 0  # flown, all criteria met
FAILED = 1  # flown, a criterion failed
BAD_INPUT = 2
FAULT = 3  # aborted by a fault
NOT_STARTED = 4  # an arming check is red, or the operator declined
OUR_FAULT = 70  # internal error, as in sysexits.h
INTERRUPTED = 130  # by Ctrl-C, a signal or an operator's stop, on every rig: not judged
