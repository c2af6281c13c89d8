r"""The supervisor: decides when valves may open, on the operator's requests.

                 arm (checks)         run (checks)
    DISARMED ----------------> ARMED ----------------> RUNNING ---- stop, end ----> STOPPED
       ^  ^                      |                        |                            |
       |  +------- disarm -------+------------------------+                            |
       |                         | fault                  | fault                      |
       |                         +-----------> FAULT <----+                            |
       +------------- reset (state check) ------+--------------------------------------+

It starts in DISARMED. Valves may open in RUNNING only. A fault is latched: only a reset leaves
FAULT, and a reset requires the vehicles' checks first, so that a flight is not resumed blindly
after a lost pose. The caller passes in time, requests and checks.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

from msgspec import Struct

from testbed.core.codes import FaultReport
from testbed.flight.arming import Check

Phase = Literal["DISARMED", "ARMED", "RUNNING", "STOPPED", "FAULT"]
Request = Literal["arm", "run", "stop", "disarm", "reset"]

ARMED_FOR = 60.0  # arming expires after this time without a run [s]

# request -> phases in which it is accepted, next phase, whether the checks must pass
MOVES: dict[str, tuple[tuple[str, ...], Phase, bool]] = {
    "arm": (("DISARMED",), "ARMED", True),
    "run": (("ARMED",), "RUNNING", True),
    "stop": (("ARMED", "RUNNING"), "STOPPED", False),
    "disarm": (("ARMED", "RUNNING"), "DISARMED", False),
    "reset": (("STOPPED", "FAULT"), "DISARMED", True),
}
HARMLESS = ("stop", "disarm")  # always accepted, also if there is nothing to do


class Answer(NamedTuple):
    """Answer of the supervisor to a request: granted, or why not."""

    done: bool
    phase: Phase  # afterwards
    red: tuple[Check, ...]  # why it was refused


class Event(Struct, frozen=True, omit_defaults=True):
    """A change of phase, for the log."""

    t: float  # [s]
    phase: Phase
    because: str  # a request, a timeout, the end; empty: the fault
    fault: FaultReport | None = None


class Supervisor:
    """The supervisor of a table: either all vehicles may fire or none."""

    def __init__(self, fault: FaultReport | None = None) -> None:
        """Start DISARMED, or in FAULT with a `fault` latched by an earlier run."""
        self._phase: Phase = "DISARMED" if fault is None else "FAULT"
        self._since = 0.0
        self._fault = fault
        self.events: list[Event] = []

    @property
    def phase(self) -> Phase:
        """Phase that the supervisor is in now."""
        return self._phase

    @property
    def may_fire(self) -> bool:
        """Whether valves may open; passed to the gates as `armed`."""
        return self._phase == "RUNNING"

    @property
    def fault(self) -> FaultReport | None:
        """The latched fault, None without one."""
        return self._fault

    def request(self, t: float, what: Request, checks: Sequence[Check] = ()) -> Answer:
        """Handle an operator's request at time `t` [s]; `checks` are the newest of all vehicles."""
        self.tick(t)
        heard_in, to, checked = MOVES[what]
        if self._phase not in heard_in:
            if what in HARMLESS:
                return Answer(True, self._phase, ())
            where = " or ".join(heard_in)
            why = f"{what} is accepted in {where}, not in {self._phase}"
            return Answer(False, self._phase, (Check("phase", "", why),))
        if checked:
            if not checks:
                return Answer(False, self._phase, (Check("checks", "", "none was made"),))
            asked = [one for one in checks if what != "reset" or one.at_reset]
            if red := tuple(one for one in asked if one.reason):
                return Answer(False, self._phase, red)
        if what == "reset":
            self._fault = None
        self._move(t, to, what)
        return Answer(True, self._phase, ())

    def take_off(self, t: float, checks: Sequence[Check]) -> tuple[Check, ...]:
        """Arm and run in one step, without asking the operator; returns the checks that refuse."""
        return self.request(t, "arm", checks).red or self.request(t, "run", checks).red

    def fail(self, t: float, fault: FaultReport) -> None:
        """A fault that ends the run: latched; the first one is kept."""
        if self._fault is None:
            self._fault = fault
        if self._phase != "FAULT":
            self._move(t, "FAULT", "", fault)

    def end(self, t: float) -> None:
        """End a running flight as planned: its phase becomes STOPPED."""
        if self._phase == "RUNNING":
            self._move(t, "STOPPED", "the end of the run")

    def close(self, t: float, fault: FaultReport | None, *, flown: bool) -> None:
        """The flight is over: by a fault, at its end (`flown`), or by a stop."""
        if self._phase not in ("ARMED", "RUNNING"):
            return
        if fault is not None:
            self.fail(t, fault)
        elif flown:
            self.end(t)
        else:
            self.request(t, "stop")

    def tick(self, t: float) -> None:
        """Let an unused arming expire."""
        if self._phase == "ARMED" and not t - self._since <= ARMED_FOR:
            self._move(t, "DISARMED", f"armed for {ARMED_FOR:g} s without a run")

    def note(self, t: float, words: str) -> None:
        """Record what an operator has done at time `t` [s], without a change of phase."""
        self.events.append(Event(t, self._phase, words))

    def _move(self, t: float, phase: Phase, because: str, fault: FaultReport | None = None) -> None:
        self._phase, self._since = phase, t
        self.events.append(Event(t, phase, because, fault))
