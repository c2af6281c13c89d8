"""Arming checks of one vehicle: each has a name, and a reason if it fails.

The limits are stricter than those of the fault table: a vehicle close to a fault must not start.
"""

import math
from collections.abc import Mapping

from msgspec import Struct

from testbed.core.se2 import wrap
from testbed.core.types import Health, State, Vitals
from testbed.core.vehicle import NonNegative, Positive
from testbed.flight.gate import Fence

NO_SENSOR = "if there is no such sensor, `[gauges] {} = false` in the vehicle file"


class ArmingParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of a healthy start."""

    pose_age_s: Positive = 0.1
    pose_rate_share: Positive = 0.8  # of the cameras' rate, over the last second
    rejected: NonNegative = 2  # poses in a row
    at_rest: Positive = 0.01  # [m/s]
    no_spin: Positive = 0.05  # [rad/s]
    start_distance: Positive = 0.15  # from where the experiment starts it [m]
    start_turn_deg: Positive = 20.0
    clearance: NonNegative = 0.05  # between the rims of two vehicles [m]
    supply_share: Positive = 0.95
    battery: Positive = 11.0  # [V]
    round_trip_s: Positive = 0.1
    clock_offset_s: Positive = 0.01
    disk_free: Positive = 5e8  # [bytes]
    operator_age_s: Positive = 0.5
    commissioned: bool = False  # on the table: only with a record of `testbed commission`


class Readiness(Struct, frozen=True):
    """Data of a vehicle for its arming checks."""

    t: float  # [s]
    state: State | None
    pose_rate: float  # poses in the last second [Hz]
    health: Health | None
    vitals: Vitals
    round_trip: float  # to the host and back [s]
    valves_shut: bool  # as the board reports
    neighbours: Mapping[str, State]


class Check(Struct, frozen=True):
    """One check of one vehicle."""

    name: str  # "sat1 pose"
    reason: str  # why it failed; empty: passed
    at_reset: bool  # also required at a reset


class Expected(Struct, frozen=True):
    """Expected values for the arming checks."""

    name: str
    camera_rate: float  # [Hz]
    set_pressure: float  # [Pa]
    fence: Fence
    start: tuple[float, float, float]  # x, y, theta, as the experiment gives it [m, rad]
    reach: Mapping[str, float]  # per other vehicle: distance of the centres at contact [m]


def arming_checks(ready: Readiness, expected: Expected, params: ArmingParams) -> list[Check]:
    """All checks of a vehicle, passed and failed."""
    p, state, health, vitals = params, ready.state, ready.health, ready.vitals
    found: list[tuple[str, bool, str, bool]] = []  # name, green, reason, at reset

    def check(name: str, green: bool, reason: str, *, at_reset: bool = True) -> None:
        found.append((name, green, reason, at_reset))

    if state is None:
        check("pose", False, "no pose yet")
    else:
        pose, twist, fence = state.pose, state.twist, expected.fence
        speed = math.hypot(twist.vx, twist.vy)
        age = state.pose_age
        check("pose", -p.pose_age_s <= age <= p.pose_age_s, f"the newest is {age:.2f} s old")
        check("estimate", state.rejected <= p.rejected, f"contradicts {state.rejected} poses")
        inside = abs(pose.x) <= fence.half_x and abs(pose.y) <= fence.half_y
        check("fence", inside, f"outside at ({pose.x:.2f}, {pose.y:.2f}) m")
        x, y, theta = expected.start
        away = math.hypot(pose.x - x, pose.y - y)
        turn = math.degrees(abs(wrap(pose.theta - theta)))
        placed = away <= p.start_distance and turn <= p.start_turn_deg
        off = f"{away:.2f} m and {turn:.0f} deg from where the experiment starts it"
        check("start", placed, off, at_reset=False)  # also finds wrong camera axes
        rests = speed <= p.at_rest and abs(twist.omega) <= p.no_spin
        moving = f"moves at {speed:.3f} m/s, turns at {twist.omega:.3f} rad/s"
        check("at rest", rests, moving)
        for name, other in ready.neighbours.items():
            gap = math.hypot(other.pose.x - pose.x, other.pose.y - pose.y) - expected.reach[name]
            check(f"clear of {name}", gap >= p.clearance, f"{gap:.3f} m between the rims")
    slow = f"{ready.pose_rate:.0f} Hz of {expected.camera_rate:.0f} Hz"
    rate_ok = ready.pose_rate >= p.pose_rate_share * expected.camera_rate
    check("pose rate", rate_ok, slow)
    if health is None:
        check("board", False, "has not answered")
    else:
        share = health.supply_pressure / expected.set_pressure
        level = f"at {share:.0%} of its set value"
        if share <= 0.0:
            level = f"no pressure: open the air; {NO_SENSOR.format('supply')}"
        check("supply", share >= p.supply_share, level, at_reset=False)
        volts = f"{health.battery:.1f} V"
        if health.battery <= 0.0:
            volts = f"no voltage: connect the battery; {NO_SENSOR.format('battery')}"
        check("battery", health.battery >= p.battery, volts, at_reset=False)
        silent = f"silent for {health.silent_s:.2f} s"
        check("board", health.silent_s <= p.pose_age_s, silent)
    check("valves", ready.valves_shut, "the board reports an open valve")
    trip = f"round trip of {ready.round_trip:.3f} s"
    check("link", ready.round_trip <= p.round_trip_s, trip, at_reset=False)
    offset = vitals.clock_offset
    check("clock", abs(offset) <= p.clock_offset_s, f"{offset:+.3f} s from the host's")
    check("session", vitals.session_ok, "messages of another session")
    check("config", vitals.same_config, "host and vehicle differ: start the agent again")
    check("disk", vitals.disk_free >= p.disk_free, f"{vitals.disk_free:.1e} bytes free")
    absent = f"not heard for {vitals.operator_age:.1f} s"
    check("operator", vitals.operator_age <= p.operator_age_s, absent)
    check("law", not vitals.law_error, vitals.law_error)
    return [
        Check(f"{expected.name} {name}", "" if green else reason, at_reset)
        for name, green, reason, at_reset in found
    ]
