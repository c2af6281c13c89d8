"""What the testbed requires of thrusters: plans are played unchanged, and all valves close in time.

The checks play plans on a mock of the hardware, in time that they make pass themselves.
"""

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

from testbed.conformance.check import at_once, factory_of, must, run_all
from testbed.conformance.manual_clock import ManualClock
from testbed.core.ports import ThrusterBoard
from testbed.core.types import ValveCommand
from testbed.core.vehicle import Air, Jet, Tolerance, Valve, Vehicle

PERIOD_S = 0.1
LIKE = 1e-3  # two times that are the same [s]


class ThrusterBench(NamedTuple):
    """A plug-in on a mock of its hardware, and what the mock shows."""

    board: ThrusterBoard
    valves: Callable[[], Sequence[bool]]  # open, in the order of the vehicle's jets
    bearing: Callable[[], bool]  # whether it has air


def some_vehicle() -> Vehicle:
    """Eight jets; pulses of at least 8 ms, 10 ms apart."""
    jets = [
        Jet((0.2 * x, 0.2 * y), push, 0.35)
        for x, y in ((1, 1), (1, -1), (-1, -1), (-1, 1))
        for push in ((-1.0 * x, 0.0), (0.0, -1.0 * y))
    ]
    valve = Valve(0.004, 0.003, 0.002, 0.002, min_on_s=0.008, min_off_s=0.010)
    air = Air(0.5, 2e7, (0.0, 0.0), 6e5, 1e5, 500.0, 0.02, 1e-4)
    exact = Tolerance(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return Vehicle(12.0, 0.3, (0.0, 0.0), 0.3, 0.0, 0.0, 0.0, jets, valve, air, exact)


class BoardDriver:
    """One bench and its clock."""

    def __init__(self, bench: ThrusterBench, clock: ManualClock, jets: int) -> None:
        self.board, self.bench, self.clock, self.jets = bench.board, bench, clock, jets
        self._seq = 0

    def plan(
        self, pulses: dict[int, tuple[int, int]], ahead: float = 0.0, life: float = PERIOD_S
    ) -> None:
        """Say a plan: valve -> offset and open time [ms]; it starts in `ahead` s."""
        start = self.clock.now + ahead
        on, offset = [0] * self.jets, [0] * self.jets
        for valve, (after, length) in pulses.items():
            on[valve], offset[valve] = 1000 * length, 1000 * after
        self._seq += 1
        command = ValveCommand(self._seq, start, start + life, tuple(on), tuple(offset))
        at_once("apply", lambda: self.board.apply(command))

    def open(self) -> set[int]:
        """The valves that are open."""
        return {i for i, is_open in enumerate(self.bench.valves()) if is_open}

    def after(self, ms: float, *expected: int, what: str = "a plan") -> None:
        """Let time pass; these valves must be open then, and no other."""
        self.clock.advance(1e-3 * ms)
        self.now(*expected, what=f"{what}, {ms:g} ms on")

    def now(self, *expected: int, what: str) -> None:
        """These valves must be open, and no other."""
        found = self.open()
        must(found == set(expected), what, f"open valves {sorted(expected)}", sorted(found))


class ThrustersConformance:
    """Subclass it in a test file: `class TestMine(ThrustersConformance): make = on_a_mock`.

    Attributes:
        make: makes a `ThrusterBench` from a `Vehicle` and a `Timer`.
        vehicle: that the plans are for; two jets or more.
    """

    make: Callable[..., ThrusterBench]
    vehicle: Vehicle = some_vehicle()

    @contextmanager
    def _flown(self) -> Iterator[BoardDriver]:
        clock, before = ManualClock(), set(threading.enumerate())
        bench = factory_of(self)(self.vehicle, clock)
        try:
            clock.meet(set(threading.enumerate()) - before)
            yield BoardDriver(bench, clock, len(self.vehicle.jets))
        finally:
            clock.let_go()  # a thread that waits for time must not keep `close` waiting
            at_once("close", bench.board.close)

    def test_nothing_opens_by_itself(self) -> None:
        """Before the first plan valves are shut, and the bearings have no air."""
        with self._flown() as one:
            one.after(300, what="no plan")
            must(not one.bench.bearing(), "bearing air", "off until it is asked for", "on")

    def test_each_valve_is_its_own(self) -> None:
        """Number i of a plan is jet i of the vehicle."""
        with self._flown() as one:
            for i in range(one.jets):
                one.plan({i: (0, 30)})
                one.after(15, i, what=f"a pulse of valve {i}")
                one.after(35, what=f"the end of a pulse of valve {i}")

    def test_offsets_and_open_times(self) -> None:
        """Pulses begin after their offset and last as long as they should."""
        with self._flown() as one:
            one.plan({0: (20, 40), 1: (0, 30)})
            for ms, *valves in ((10, 1), (15, 0, 1), (10, 0), (20, 0), (10,)):
                one.after(ms, *valves, what="valve 0 at 20 to 60 ms, valve 1 at 0 to 30 ms")

    def test_a_plan_replaces_the_one_before(self) -> None:
        """No pulse of the old plan is played any more."""
        with self._flown() as one:
            one.plan({0: (0, 80)})
            one.after(30, 0)
            one.plan({1: (10, 40)})
            one.after(5, what="a plan that begins with every valve shut")
            one.after(10, 1, what="a plan that replaces another")
            one.after(60, what="the end of a plan that replaces another")

    def test_a_plan_ahead_waits_for_its_start(self) -> None:
        """Until then the plan before it is played."""
        with self._flown() as one:
            one.plan({0: (0, 90)})
            one.plan({1: (0, 30)}, ahead=0.05)
            one.after(45, 0, what="a plan that starts at 50 ms, another until then")
            one.after(15, 1, what="a plan that starts at 50 ms")
            one.after(30, what="the end of a plan that started at 50 ms")

    def test_a_late_plan_has_its_rest_played(self) -> None:
        """Offsets count from its start in the past; an expired plan opens no valve."""
        with self._flown() as one:
            one.plan({0: (0, 60), 1: (60, 30)}, ahead=-0.03)
            one.after(10, 0, what="a plan that started 30 ms ago")
            one.after(30, 1, what="a plan that started 30 ms ago")
            one.after(60, what="its end")
            one.plan({0: (0, 90)}, ahead=-0.2)
            one.after(5, what="a plan that ended 100 ms ago")

    def test_valves_shut_at_valid_until(self) -> None:
        """Whatever the plan says, and without another command."""
        with self._flown() as one:
            one.plan({0: (0, 400), 1: (50, 400)})
            one.after(90, 0, 1, what="a pulse longer than its plan")
            one.after(15, what="valid_until, 100 ms after the start")
            one.after(400, what="silence")

    def test_short_pulses_are_not_played(self) -> None:
        """A pulse shorter than `min_on_s` does not open its valve."""
        least = self.vehicle.valve.min_on_s
        with self._flown() as one:
            short = max(1, math.floor(1e3 * least) - 1)
            if short >= 1e3 * least:
                return
            one.plan({0: (0, short), 1: (0, 50)})
            for _ in range(20):
                one.after(1, 1, what=f"a pulse of {short} ms on valve 0, shorter than min_on_s")

    def test_a_valve_rests_before_it_opens_again(self) -> None:
        """A valve stays closed for `min_off_s`, also from one plan to the next."""
        rest = 1e3 * self.vehicle.valve.min_off_s
        with self._flown() as one:
            one.plan({0: (0, 30)})
            one.after(31)
            one.plan({0: (0, 80)})
            if rest > 3.0:
                one.after(0.5 * (rest - 1.0), what="a valve that shut less than min_off_s ago")
            one.after(rest + 5.0, 0, what="a valve that has rested for min_off_s")

    def test_disarm_shuts_the_valves_and_keeps_the_bearings(self) -> None:
        """Valves close at once, and stored plans are dropped."""
        with self._flown() as one:
            at_once("bearing", lambda: one.board.bearing(on=True))
            one.plan({0: (0, 90), 1: (30, 60)})
            one.plan({1: (0, 90)}, ahead=0.05)
            one.after(20, 0)
            at_once("disarm", one.board.disarm)
            one.now(what="disarm")
            one.after(60, what="disarm: plans of before")
            must(one.bench.bearing(), "bearing air after disarm", "on: it still floats", "off")

    def test_land_shuts_everything(self) -> None:
        """`land` shuts valves and bearing air, also when it is called again."""
        with self._flown() as one:
            at_once("bearing", lambda: one.board.bearing(on=True))
            must(one.bench.bearing(), "bearing(on=True)", "air for the bearings", "none")
            one.plan({0: (0, 90)})
            one.after(20, 0)
            for _ in range(2):
                at_once("land", one.board.land)
                one.now(what="land")
                must(not one.bench.bearing(), "bearing air after land", "off", "on")
            one.after(60, what="land: a plan of before")

    def test_close_shuts_everything(self) -> None:
        """Closing works in the middle of a pulse, and twice."""
        with self._flown() as one:
            at_once("bearing", lambda: one.board.bearing(on=True))
            one.plan({0: (0, 90)})
            one.after(20, 0)
            one.clock.let_go()
            for _ in range(2):
                at_once("close", one.board.close)
                one.now(what="close")
                must(not one.bench.bearing(), "bearing air after close", "off", "on")

    def test_edges_tell_what_the_valves_did(self) -> None:
        """Each change once: its time, and which valves are open from then on."""
        with self._flown() as one:
            one.board.edges()
            start = one.clock.now
            one.plan({0: (20, 40), 1: (0, 30)})
            one.after(100)
            found = at_once("edges", one.board.edges)
            expected = [(0.0, 0b10), (0.02, 0b11), (0.03, 0b01), (0.06, 0)]
            same = len(found) == len(expected) and all(
                mask == wanted and abs(t - start - at) <= LIKE
                for (t, mask), (at, wanted) in zip(found, expected, strict=True)
            )
            shown = [(round(t - start, 4), mask) for t, mask in found]
            must(same, "edges, from the plan's start", f"{expected}", shown)
            must(one.board.edges() == [], "edges asked again", "none: each is given once", "some")

    def test_health_is_of_now(self) -> None:
        """Finite numbers, at any time."""
        with self._flown() as one:
            for _ in range(2):
                health = at_once("health", one.board.health)
                numbers = (health.t, health.supply_pressure, health.tank_pressure, health.battery)
                must(all(map(math.isfinite, numbers)), "health", "finite numbers", health)
                age = one.clock.now - health.t
                must(0.0 <= age <= 1.0, "health.t", "the clock's time, less than 1 s ago", health.t)
                one.clock.advance(2.0)


def check_thrusters(factory: Callable[..., ThrusterBench], vehicle: Vehicle | None = None) -> None:
    """All checks of `ThrustersConformance`, without pytest.

    Raises:
        NotConformingError: the first that fails.
    """
    suite = ThrustersConformance()
    suite.__dict__.update(make=factory, vehicle=vehicle or some_vehicle())
    run_all(suite)
