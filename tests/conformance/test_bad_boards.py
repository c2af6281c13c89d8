"""A board with a planted fault is caught, by the check that is for it."""

import math
import threading

import pytest
from msgspec.structs import replace

from gpio_board import GpioBoard
from test_plugins import MockChip, on_a_mock
from testbed.conformance import ThrusterBench, ThrustersConformance, check, check_thrusters
from testbed.conformance.check import NotConformingError
from testbed.conformance.thrusters import some_vehicle


@pytest.fixture(autouse=True)
def soon(monkeypatch):
    monkeypatch.setattr(check, "PATIENCE_S", 0.5)


class OpensAtTheStart(GpioBoard):
    def __init__(self, *words):
        super().__init__(*words)
        self._chip.write(self._bearing, True)


class SwapsTwoPins(GpioBoard):
    def __init__(self, vehicle, clock, valves, bearing, chip):
        super().__init__(vehicle, clock, [valves[1], valves[0], *valves[2:]], bearing, chip)


class KnowsNoOffsets(GpioBoard):
    def apply(self, command):
        super().apply(replace(command, offset_us=(0,) * len(command.on_us)))


class AddsToThePlanBefore(GpioBoard):
    def apply(self, command):
        with self._lock:
            for plan in self._plans[:1]:
                end = plan.valid_until
                if plan.issued_at < command.issued_at <= self._clock.now < end:
                    on = tuple(map(max, command.on_us, plan.on_us))
                    command = replace(command, on_us=on)
        super().apply(command)


class PlaysAtOnce(GpioBoard):
    def apply(self, command):
        now, life = self._clock.now, command.valid_until - command.issued_at
        if command.valid_until > now:
            super().apply(replace(command, issued_at=now, valid_until=now + life))


class BelievesOldPlans(GpioBoard):
    def apply(self, command):
        now = self._clock.now
        if command.valid_until < now:
            command = replace(command, issued_at=now, valid_until=now + 0.05)
        super().apply(command)


class NeverShuts(GpioBoard):
    def apply(self, command):
        super().apply(replace(command, valid_until=command.valid_until + 10.0))


class PlaysShortPulses(GpioBoard):
    def __init__(self, vehicle, *words):
        super().__init__(replace(vehicle, valve=replace(vehicle.valve, min_on_s=0.0)), *words)


class LetsNoValveRest(GpioBoard):
    def __init__(self, vehicle, *words):
        super().__init__(replace(vehicle, valve=replace(vehicle.valve, min_off_s=0.0)), *words)


class DisarmsLate(GpioBoard):
    def disarm(self):
        with self._lock:
            self._plans = []


class DisarmForgetsNothing(GpioBoard):
    def disarm(self):
        with self._lock:
            self._set(0, self._clock.now)


class DisarmGrinds(GpioBoard):
    def disarm(self):
        super().disarm()
        self.bearing(on=False)


class LandsInTheAir(GpioBoard):
    def land(self):
        self.disarm()


class LeavesThemOpen(GpioBoard):
    def close(self):
        with self._lock:
            self._closed = True


class TellsTwice(GpioBoard):
    def edges(self):
        return list(self._edges)


class TellsInMilliseconds(GpioBoard):
    def edges(self):
        return [(1e3 * t, mask) for t, mask in super().edges()]


class NoPressure(GpioBoard):
    def health(self):
        return replace(super().health(), supply_pressure=math.nan)


class OldHealth(GpioBoard):
    def health(self):
        return replace(super().health(), t=0.0)


class Hangs(GpioBoard):
    def apply(self, command):
        threading.Event().wait()


class Sleeps(GpioBoard):
    """Its thread waits for something else than the clock."""

    def _keep(self):
        self._clock.wait_until(self._clock.now + 0.001)
        while not self._closed:
            threading.Event().wait(0.01)


BAD = {  # board: (the check, what it says)
    OpensAtTheStart: ("nothing_opens_by_itself", "bearing air"),
    SwapsTwoPins: ("each_valve_is_its_own", "valve 0"),
    KnowsNoOffsets: ("offsets_and_open_times", "valve 0 at 20"),
    AddsToThePlanBefore: ("a_plan_replaces_the_one_before", "open valves"),
    PlaysAtOnce: ("a_plan_ahead_waits_for_its_start", "starts at 50 ms"),
    BelievesOldPlans: ("a_late_plan_has_its_rest_played", "ended 100 ms ago"),
    NeverShuts: ("valves_shut_at_valid_until", "valid_until"),
    PlaysShortPulses: ("short_pulses_are_not_played", "shorter than min_on_s"),
    LetsNoValveRest: ("a_valve_rests_before_it_opens_again", "min_off_s"),
    DisarmsLate: ("disarm_shuts_the_valves_and_keeps_the_bearings", "disarm"),
    DisarmForgetsNothing: ("disarm_shuts_the_valves_and_keeps_the_bearings", "plans of before"),
    DisarmGrinds: ("disarm_shuts_the_valves_and_keeps_the_bearings", "it still floats"),
    LandsInTheAir: ("land_shuts_everything", "bearing air after land"),
    LeavesThemOpen: ("close_shuts_everything", "close"),
    TellsTwice: ("edges_tell_what_the_valves_did", "asked again"),
    TellsInMilliseconds: ("edges_tell_what_the_valves_did", "from the plan's start"),
    NoPressure: ("health_is_of_now", "finite numbers"),
    OldHealth: ("health_is_of_now", "the clock's time"),
    Hangs: ("offsets_and_open_times", "to return at once"),
    Sleeps: ("offsets_and_open_times", "to be called again"),
}


def suite(kind):
    def make(vehicle, clock):
        pins = list(range(len(vehicle.jets)))
        chip = MockChip([*pins, 26])
        board = kind(vehicle, clock, pins, 26, chip)
        return ThrusterBench(board, lambda: [chip.levels[i] for i in pins], lambda: chip.levels[26])

    return type("Suite", (ThrustersConformance,), {"make": make})()


@pytest.mark.parametrize("bad", BAD, ids=lambda bad: bad.__name__)
def test_it_is_caught(bad):
    name, words = BAD[bad]
    with pytest.raises(NotConformingError, match=words):
        getattr(suite(bad), f"test_{name}")()


def test_what_they_are_planted_in_conforms():
    check_thrusters(on_a_mock)


def test_a_valve_without_limits_is_checked_too():
    vehicle = some_vehicle()
    free = replace(vehicle.valve, min_on_s=0.0, min_off_s=0.0)
    check_thrusters(on_a_mock, replace(vehicle, valve=free))


# The example itself


class BrokenChip(MockChip):
    broken = False

    def write(self, pin, level):
        if self.broken and pin != 26:
            raise OSError("the pin is gone")
        super().write(pin, level)


def test_a_chip_that_fails_is_said_and_the_bearing_is_shut():
    from testbed.conformance.manual_clock import ManualClock
    from testbed.conformance.thrusters import BoardDriver

    clock, vehicle = ManualClock(), some_vehicle()
    pins = list(range(8))
    chip = BrokenChip([*pins, 26])
    before = set(threading.enumerate())
    board = GpioBoard(vehicle, clock, pins, 26, chip)
    clock.meet(set(threading.enumerate()) - before)
    one = BoardDriver(ThrusterBench(board, list, lambda: True), clock, 8)
    board.bearing(on=True)
    one.plan({0: (0, 50)})
    chip.broken = True
    clock.advance(0.2)
    with pytest.raises(OSError, match="the pin is gone"):
        board.health()
    with pytest.raises(OSError, match="the pin is gone"):
        board.land()
    assert not chip.levels[26]
    clock.let_go()
    with pytest.raises(OSError, match="the pin is gone"):
        board.close()


@pytest.mark.parametrize(
    ("pins", "words"), [([0, 1], "2 pins in `valves`, 8 jets"), ([0, *range(7)], "named twice")]
)
def test_pins_that_do_not_fit_are_refused(pins, words):
    with pytest.raises(ValueError, match=words):
        GpioBoard(some_vehicle(), None, pins, 26, MockChip(range(27)))
