r"""The supervisor: who may fire, and how an operator gets there.

                 arm (checks)         run (checks)
    DISARMED ----------------> ARMED ----------------> RUNNING ---- stop, end ----> STOPPED
       ^  ^                      |                        |                            |
       |  +------- disarm -------+------------------------+                            |
       |                         | fault                  | fault                      |
       |                         +-----------> FAULT <----+                            |
       +------------- reset (state check) ------+--------------------------------------+

It boots DISARMED. Valves may open in RUNNING only. A fault is latched: nothing but a reset leaves
FAULT, and a reset asks for the vehicles' state first, so that nobody resumes after a lost pose
without having looked. Whoever owns the clock hands in time, requests and checks.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

from msgspec import Struct

from testbed.flight.arming import Check

Phase = Literal["DISARMED", "ARMED", "RUNNING", "STOPPED", "FAULT"]
Request = Literal["arm", "run", "stop", "disarm", "reset"]

ARMED_FOR = 60.0  # [s] arming is worth nothing after so long without a run

# request -> the phases it is heard in, where it leads, whether the checks must be green
MOVES: dict[str, tuple[tuple[str, ...], Phase, bool]] = {
    "arm": (("DISARMED",), "ARMED", True),
    "run": (("ARMED",), "RUNNING", True),
    "stop": (("ARMED", "RUNNING"), "STOPPED", False),
    "disarm": (("ARMED", "RUNNING"), "DISARMED", False),
    "reset": (("STOPPED", "FAULT"), "DISARMED", True),
}
HARMLESS = ("stop", "disarm")  # asked for where there is nothing to do, they are done already


class Answer(NamedTuple):
    """What became of a request."""

    done: bool
    phase: Phase  # afterwards
    reasons: tuple[str, ...]  # why not, one per red check


class Event(Struct, frozen=True):
    """A change of phase, for the log."""

    t: float  # [s]
    phase: Phase
    because: str


class Supervisor:
    """One table's supervisor: all its vehicles fire, or none."""

    def __init__(self, fault: str | None = None) -> None:
        """Boot DISARMED; or in FAULT, with a `fault` that was latched before this boot."""
        self._phase: Phase = "DISARMED" if fault is None else "FAULT"
        self._since = 0.0
        self._fault = fault
        self.events: list[Event] = []

    @property
    def phase(self) -> Phase:
        """Where it stands."""
        return self._phase

    @property
    def may_fire(self) -> bool:
        """Whether valves may open: what the gates are told as `armed`."""
        return self._phase == "RUNNING"

    @property
    def fault(self) -> str | None:
        """The latched fault, None without one."""
        return self._fault

    def request(self, t: float, what: Request, checks: Sequence[Check] = ()) -> Answer:
        """Hear an operator at time `t` [s]; `checks` are the newest of all vehicles."""
        self.tick(t)
        heard_in, to, checked = MOVES[what]
        if self._phase not in heard_in:
            if what in HARMLESS:
                return Answer(True, self._phase, ())
            where = " or ".join(heard_in)
            return Answer(False, self._phase, (f"{what} is heard in {where}, not {self._phase}",))
        if checked:
            if not checks:
                return Answer(False, self._phase, ("no check was made",))
            asked = [one for one in checks if what != "reset" or one.at_reset]
            if red := tuple(f"{one.name}: {one.reason}" for one in asked if one.reason):
                return Answer(False, self._phase, red)
        if what == "reset":
            self._fault = None
        self._move(t, to, what)
        return Answer(True, self._phase, ())

    def take_off(self, t: float, checks: Sequence[Check]) -> tuple[str, ...]:
        """Arm and run at once, where nobody needs to be asked in between; why not."""
        return self.request(t, "arm", checks).reasons or self.request(t, "run", checks).reasons

    def fail(self, t: float, fault: str) -> None:
        """A fault that ends the run: latched; the first one is kept."""
        if self._fault is None:
            self._fault = fault
        if self._phase != "FAULT":
            self._move(t, "FAULT", fault)

    def end(self, t: float) -> None:
        """The run has come to its end."""
        if self._phase == "RUNNING":
            self._move(t, "STOPPED", "the end of the run")

    def close(self, t: float, fault: str | None, *, flown: bool) -> None:
        """The flight is over: by a fault, at its end (`flown`), or because somebody said stop."""
        if self._phase not in ("ARMED", "RUNNING"):
            return
        if fault is not None:
            self.fail(t, fault)
        elif flown:
            self.end(t)
        else:
            self.request(t, "stop")

    def tick(self, t: float) -> None:
        """Time passes: an arming that nobody used runs out."""
        if self._phase == "ARMED" and not t - self._since <= ARMED_FOR:
            self._move(t, "DISARMED", f"armed for {ARMED_FOR:g} s without a run")

    def _move(self, t: float, phase: Phase, because: str) -> None:
        self._phase, self._since = phase, t
        self.events.append(Event(t, phase, because))
