"""Flying by hand: speeds, stops, and hand-overs without a bump."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from testbed.config import find, load
from testbed.core.types import Accel, Pose, State, Stick, Twist
from testbed.flight.pilot import STOP_M, TURN, Pilot
from testbed.flight.turn import Turn
from testbed.rig.chain import make_guidance

H = 0.1
EXPERIMENT = load(find("hold"), ["flight.barrier.on=false"])
VEHICLE = EXPERIMENT.vehicles["sat1"].model
STILL = Accel(0.0, 0.0, 0.0)
MOVING = State(0.0, Pose(0.5, -0.2, 0.3), Twist(0.05, -0.02, 0.1), STILL, 0.0, 0)


def state_of(reference):
    return State(reference.t, reference.pose, reference.twist, STILL, 0.0, 0)


def make_pilot(speed=0.25):
    return Pilot(EXPERIMENT.guidance, VEHICLE, H, speed)


def stick(x=0.0, y=0.0, turn=0.0, *, pushes=False, alive=True):
    return Stick(pushes, x, y, turn, alive)


def fly(pilot, held, seconds, own=MOVING):
    """The first reference of every tick, flown without an error."""
    flown = []
    for k in range(round(seconds / H)):
        first = pilot.step(own.t if k == 0 else own.t + H, own, held, {}).references[0]
        flown.append(first)
        own = state_of(first)
    return flown


def speed(reference):
    return math.hypot(reference.twist.vx, reference.twist.vy)


def test_it_begins_with_the_motion_that_the_vehicle_has():
    first = make_pilot().step(0.2, MOVING, stick(1.0), {}).references[0]
    assert (first.pose.x, first.pose.y) == pytest.approx((0.51, -0.204))
    assert first.pose.theta == pytest.approx(0.32)
    assert (first.twist.vx, first.twist.vy, first.twist.omega) == (0.05, -0.02, 0.1)


def test_references_follow_each_other():
    sent = make_pilot().step(0.0, MOVING, stick(0.3, 0.4), {})
    assert len(sent.references) == 4
    for one, after in zip(sent.references, sent.references[1:], strict=False):
        assert after.t == pytest.approx(one.t + H)
        assert after.pose.x == pytest.approx(one.pose.x + H * (one.twist.vx + after.twist.vx) / 2)
        assert after.twist.vy == pytest.approx(one.twist.vy + H * one.accel.ay)


def test_a_velocity_stick_gives_its_share_of_the_top_speed():
    pilot = make_pilot()
    last = fly(pilot, stick(0.3, -0.4, turn=-0.5), 10.0)[-1]
    assert (last.twist.vx, last.twist.vy) == pytest.approx(
        (0.3 * pilot.top_speed, -0.4 * pilot.top_speed)
    )
    assert last.twist.omega == pytest.approx(-0.5 * TURN)
    assert speed(fly(pilot, stick(1.0, 1.0), 10.0)[-1]) == pytest.approx(pilot.top_speed)


def test_the_top_speed_can_be_stopped_within_the_stop_distance():
    pilot = make_pilot()
    last = fly(pilot, stick(1.0), 10.0)[-1]
    stopped = fly(pilot, stick(alive=False), 10.0, state_of(last))
    assert stopped[-1].pose.x - last.pose.x <= STOP_M + 2 * H * pilot.top_speed
    assert make_pilot(speed=0.1).top_speed == pytest.approx(0.08)  # the filter is slower


def test_a_force_stick_pushes_up_to_the_top_speed():
    pilot = make_pilot()
    flown = fly(pilot, stick(0.2, pushes=True), 2.0, replace(MOVING, twist=Twist(0.0, 0.0, 0.0)))
    ax = [one.accel.ax for one in flown]
    assert ax == pytest.approx([0.2 * pilot._accel] * len(ax))
    last = fly(pilot, stick(1.0, pushes=True), 20.0)[-1]
    assert speed(last) == pytest.approx(pilot.top_speed)
    coasting = fly(pilot, stick(pushes=True), 5.0, state_of(last))[-1]  # without a push
    assert speed(coasting) == pytest.approx(pilot.top_speed)


@pytest.mark.parametrize("pushes", [False, True])
def test_without_fresh_messages_it_rests_and_holds(pushes):
    pilot = make_pilot()
    last = fly(pilot, stick(1.0, 0.5, 1.0, pushes=pushes), 5.0)[-1]
    flown = fly(pilot, stick(1.0, 0.5, 1.0, pushes=pushes, alive=False), 10.0, state_of(last))
    assert speed(flown[-1]) == flown[-1].twist.omega == 0.0
    assert flown[-1].pose == flown[-20].pose


def test_a_vehicle_that_could_not_follow_is_not_pulled():
    pilot = make_pilot()
    pilot.step(0.0, MOVING, stick(), {})
    held_back = State(0.1, Pose(-0.5, 0.0, 0.0), Twist(0.0, 0.0, 0.0), STILL, 0.0, 0)
    assert pilot.step(0.1, held_back, stick(), {}).references[0].pose == held_back.pose


def test_the_law_takes_over_at_the_vehicles_motion():
    guidance = make_guidance(EXPERIMENT, "sat1")
    for k in range(3):
        guidance.step(k * H, replace(MOVING, t=k * H), {})
    elsewhere = State(5.0, Pose(-1.0, 1.0, 2.0), Twist(-0.1, 0.05, 0.2), STILL, 0.0, 0)
    guidance.begin(5.0, elsewhere)
    sent = guidance.step(5.0, elsewhere, {}).references
    assert sent[0].pose == elsewhere.pose
    assert sent[0].twist == elsewhere.twist
    assert sent[1].pose.x == pytest.approx(-1.01, abs=1e-3)


def test_a_turn_that_begins_with_a_rate_has_no_step():
    turn = Turn(1.0, -1.0, 10.0, 0.02, 0.2)
    t = np.arange(10.0, 40.0, 0.01)
    theta, omega, alpha = np.array([turn.at(one) for one in t]).T
    assert (theta[0], omega[0]) == (1.0, 0.2)
    assert np.abs(np.diff(theta)).max() < 0.0021
    assert np.abs(np.diff(omega)).max() < 0.0011
    assert np.abs(alpha).max() <= 0.1
    assert theta[-1] == pytest.approx(-1.0, abs=1e-3)


def test_a_turn_from_rest_is_as_it_was():
    one, other = Turn(0.2, 1.0, 3.0, 0.02), Turn(0.2, 1.0, 3.0, 0.02, 0.0)
    assert [one.at(t) for t in (3.0, 4.0, 30.0)] == [other.at(t) for t in (3.0, 4.0, 30.0)]
    assert one.at(3.0) == (0.2, 0.0, 0.0)
