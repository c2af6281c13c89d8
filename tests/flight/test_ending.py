"""The end of a flight on board: brake, rest, air off; what a vehicle cannot do it does not try."""

import pytest
from msgspec.structs import replace

from stages import Safety, longest_brake
from testbed.config.shipped import shipped_faults
from testbed.core.codes import InhibitReason, Refusal, Response
from testbed.core.types import Health, Inputs, Vitals, Wrench
from testbed.flight.ending import EndingParams
from testbed.flight.safety import AT_REST

PERIOD = 0.1  # [s]
OVER = Vitals(end=True)


@pytest.fixture
def safety(vehicle, table):
    return Safety(vehicle, table, shipped_faults(), 0.08)


def act(safety, state, t=0.0, vitals=OVER, **changes):
    inputs = replace(Inputs(t, True, (), None, {}, Health(t, 0.5e6, 2e7), vitals=vitals), **changes)
    return safety.act(inputs, t + 0.008, state, None, Wrench(0.3, 0.0, 0.0), 1.0, "")


def test_a_vehicle_that_sees_itself_brakes_and_at_rest_shuts_its_air_off(safety, make_state):
    braking = act(safety, make_state((0, 0, 0), (0.1, 0, 0)))
    assert (braking.braking, braking.air_off, braking.inhibit_reason) == (True, False, None)
    assert braking.commanded_wrench.fx < 0.0
    rested = act(safety, make_state((0, 0, 0), (0.9 * AT_REST, 0, 0)), 1.0)
    assert (rested.braking, rested.air_off) == (False, True)
    assert rested.inhibit_reason == Refusal(InhibitReason.FLIGHT_OVER)
    assert act(safety, make_state((0, 0, 0), (0.1, 0, 0)), 1.1).air_off  # and stays down


def test_a_vehicle_that_does_not_know_where_it_is_lands_at_once(safety):
    assert act(safety, None).air_off


@pytest.mark.parametrize(
    "changes",
    [{"health": Health(0.0, 0.5e6, 2e7, silent_s=1.0)}],
)
def test_a_vehicle_whose_jets_cannot_be_trusted_lands_at_once(safety, make_state, changes):
    acted = act(safety, make_state((0, 0, 0), (0.1, 0, 0)), **changes)
    assert (acted.response, acted.braking, acted.air_off) == (Response.LAND, False, True)


def test_what_is_found_after_the_end_is_no_fault_of_the_flight(safety, make_state):
    gone = replace(OVER, operator_age=5.0)
    acted = act(safety, make_state((0, 0, 0), (0.1, 0, 0)), vitals=gone)
    assert acted.holding == ("operator_gone",)
    assert acted.fault is None
    assert acted.braking


def test_a_flight_that_goes_on_keeps_its_air(safety, make_state):
    acted = act(safety, make_state(), vitals=Vitals())
    assert (acted.air_off, acted.braking, acted.inhibit_reason) == (False, False, None)


@pytest.mark.parametrize(
    ("speed", "decel", "longest"),
    [(0.0, 0.1, 2.5), (0.05, 0.1, 3.5), (0.1, 0.05, 6.0), (9.0, 0.1, 6.0)],
)
def test_a_stop_is_bounded_by_what_its_speed_needs(speed, decel, longest):
    assert longest_brake(EndingParams(), speed, decel) == pytest.approx(longest)


def test_the_bound_holds_also_for_a_vehicle_that_never_seems_to_rest(vehicle, table, make_state):
    limits = EndingParams(brake_s=1.0)
    safety = Safety(vehicle, table, shipped_faults(), 0.08, limits)
    moving = make_state((0, 0, 0), (0.1, 0, 0))
    assert act(safety, moving, 0.0).braking
    assert act(safety, moving, 0.95).braking
    assert act(safety, moving, 1.05).air_off
