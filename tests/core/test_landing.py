"""When the board lands a vehicle whose commands have stopped: against the motion, step by step."""

import math

import pytest

from testbed.core.landing import GRAVITY, WATCHDOG_S, brakes_shorter, landing_delay
from testbed.core.vehicle import Landing


def way(v, slope, friction, drift, dt=1e-5):
    """Distance of a drift of so many seconds and the slide after it, step by step [m]."""
    gone, t = 0.0, 0.0
    while v > 0.0:
        gain = slope if t < drift else slope - friction * GRAVITY
        gone += dt * v
        v += dt * gain
        t += dt
    return gone


@pytest.mark.parametrize("slope", [0.0, 0.002, 0.05])
@pytest.mark.parametrize(("speed", "room"), [(0.1, 0.05), (0.2, 0.3), (0.05, 0.2)])
@pytest.mark.parametrize("friction", [0.1, 0.03])
def test_drift_and_slide_use_the_room_exactly(speed, slope, room, friction):
    landing = Landing(speed=speed, slope=slope, room=room, friction=friction)
    drift = WATCHDOG_S + landing_delay(landing)
    assert drift > WATCHDOG_S
    assert way(speed, slope, friction, drift) == pytest.approx(room, rel=1e-3)


def test_the_watchdog_is_part_of_the_drift():
    landing = Landing(speed=0.1, room=0.1)
    assert landing_delay(landing, 0.5) == pytest.approx(landing_delay(landing, 0.1) - 0.4)


def test_air_goes_off_at_once_without_room_and_never_if_the_file_says_so():
    assert landing_delay(Landing(room=0.0)) == 0.0
    assert landing_delay(Landing(friction=0.01, slope=0.2)) == 0.0
    assert landing_delay(Landing(by_board=False)) == math.inf


def test_a_shipped_vehicle_lands_with_the_watchdog():
    """0.2 m/s: 3 cm until the watchdog and 2 cm of sliding use up the 5 cm to the fence."""
    assert landing_delay(Landing()) == 0.0


@pytest.mark.parametrize("slope", [0.0, 0.002, 0.05])
@pytest.mark.parametrize("wait", [0.0, 0.1])
def test_an_emergency_takes_the_shorter_way(slope, wait):
    """Where braking and sliding take the same way, by the equation of uniform deceleration."""
    v, decel = 0.2, 0.3
    gained = v + slope * wait
    waits = v * wait + 0.5 * slope * wait**2
    brake = waits + gained**2 / (2.0 * (decel - slope))
    friction = (v**2 / (2.0 * brake) + slope) / GRAVITY
    assert way(v, slope, friction, 0.0) == pytest.approx(brake, rel=1e-3)
    for share, shorter in ((0.99, True), (1.01, False)):
        landing = Landing(speed=v, slope=slope, friction=share * friction)
        assert brakes_shorter(landing, decel, wait) is shorter


def test_on_a_slope_that_beats_jets_or_pads_the_other_one_stops_it():
    assert not brakes_shorter(Landing(slope=0.3), 0.2, 0.0)
    assert brakes_shorter(Landing(slope=0.1, friction=0.01), 0.2, 0.0)


def test_shipped_vehicles_land_in_an_emergency():
    assert not brakes_shorter(Landing(), 0.4, 0.0)
