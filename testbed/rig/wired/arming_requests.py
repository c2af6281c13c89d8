"""The host asks the supervisor to reset, to arm and to run, as soon as the arming checks pass."""

from collections.abc import Callable, Sequence

from testbed.core.error import TestbedError
from testbed.flight.arming import Check
from testbed.flight.supervisor import Answer, Request, Supervisor
from testbed.realtime.wall_clock import monotonic_ns, sleep_until_ns
from testbed.rig.interface import not_armed
from testbed.rig.wired.preflight import Preflight

PERIOD_NS = 100_000_000  # between two rounds of checks


class NotArmedError(TestbedError):
    """The flight must not begin: arming checks failed, or the operator declined."""

    def __init__(self, red: Sequence[Check]) -> None:
        super().__init__(not_armed(red).text)
        self.red = red


class ArmingRequests:
    """Repeats the checks until the supervisor agrees.

    Args:
        supervisor: decides.
        preflight: collects the checks.
        checked: called with the results of each round.
        stopped: whether an operator has stopped the run; then a request ends without an answer.
    """

    def __init__(
        self,
        supervisor: Supervisor,
        preflight: Preflight,
        checked: Callable[[Sequence[Check]], None],
        stopped: Callable[[], int],
    ) -> None:
        self.stopped = stopped
        self._supervisor, self._preflight, self._checked = supervisor, preflight, checked

    def ask(self, what: Request, end_ns: int) -> None:
        """Ask until the supervisor agrees, or until a time on the monotonic clock.

        Raises:
            NotArmedError: it has not agreed by then; lists every failed check.
        """
        late = Check("checks", "", "no time for them")
        answer = Answer(False, self._supervisor.phase, (late,))
        while monotonic_ns() < end_ns and not self.stopped():
            checks = self._preflight.checks()
            self._checked(checks)
            answer = self._supervisor.request(0.0, what, checks)
            if answer.done:
                return
            sleep_until_ns(monotonic_ns() + PERIOD_NS)
        if not self.stopped():
            raise NotArmedError(answer.red)
