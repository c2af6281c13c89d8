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

SMALLEST = 0.01  # [m] from its start, where the safety filter keeps no room
NO_SENSOR = "if there is no such sensor, `[gauges] {} = false` in the vehicle file"


FLAT, CHARGED = 11.0 / 12.0, 16.0 / 12.0  # limits of a battery: of 12 V, 11 and 16 V


class ArmingParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of a healthy start."""

    pose_age_s: Positive = 0.1  # also of the board's last answer
    pose_rate_share: Positive = 0.8  # of the cameras' rate, over the last second
    pose_rate_most: Positive = 1.2  # of that rate: a second source sends poses of this body, too
    rejected: NonNegative = 2  # poses that the estimator refused, less those taken since
    at_rest: Positive = 0.01  # [m/s]
    no_spin: Positive = 0.05  # [rad/s]
    # from where the experiment starts it [m]; None: the room that the safety filter keeps, because
    # a frame that is farther off than that lets a vehicle hit what the filter believes it misses
    start_distance: Positive | None = None
    start_turn_deg: Positive = 20.0  # turns the jets' force as much, of which 94 % remains
    clearance: NonNegative = 0.05  # between the rims of two vehicles [m]
    supply_share: Positive = 0.95
    supply_most: Positive = 1.1  # as of the fault `supply_high`: the jets push harder than believed
    battery: Positive | None = None  # [V]; None: FLAT of the vehicle's `gauges.battery_v`
    battery_most: Positive | None = None  # [V]; None: CHARGED of it; the coils heat
    round_trip_s: Positive = 0.1
    clock_offset_s: Positive = 0.01
    disk_free: Positive = 5e8  # [bytes]
    operator_age_s: Positive = 0.5
    commissioned: bool = False  # on the table: only with a record of `testbed commission`

    def battery_limits(self, nominal: float) -> tuple[float, float]:
        """Least and most voltage of a battery of `nominal` [V] that passes."""
        least = FLAT * nominal if self.battery is None else self.battery
        most = CHARGED * nominal if self.battery_most is None else self.battery_most
        return least, most


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


class Check(Struct, frozen=True, omit_defaults=True):
    """One check of one vehicle."""

    id: str  # "pose_rate"
    vehicle: str  # empty: of the whole table
    reason: str = ""  # why it failed; empty: passed
    at_reset: bool = True  # also required at a reset
    value: float | None = None  # that was checked; None: it is no number, or not finite
    least: float | None = None  # that passes
    most: float | None = None
    other: str = ""  # vehicle that it must be clear of

    @property
    def name(self) -> str:
        """For people: "sat1 pose rate"."""
        return " ".join(filter(None, (self.vehicle, self.id.replace("_", " "), self.other)))

    @property
    def words(self) -> str:
        """The check and why it failed, in one line."""
        return f"{self.name}: {self.reason}"


class Expected(Struct, frozen=True):
    """Expected values for the arming checks."""

    name: str
    camera_rate: float  # [Hz]
    set_pressure: float  # [Pa]
    battery_v: float  # nominal [V]
    fence: Fence
    start: tuple[float, float, float]  # x, y, theta, as the experiment gives it [m, rad]
    reach: Mapping[str, float]  # per other vehicle: distance of the centres at contact [m]
    room: float  # the filter's margin to the fence, or half of that to a vehicle if less [m]


def arming_checks(ready: Readiness, expected: Expected, params: ArmingParams) -> list[Check]:
    """All checks of a vehicle, passed and failed."""
    p, state, health, vitals = params, ready.state, ready.health, ready.vitals
    found: list[Check] = []

    def check(
        what: str, value: float | None, reason: str, least: float | None = None,
        most: float | None = None, *, at_reset: bool = True, other: str = "", green: bool = True,
    ) -> None:  # fmt: skip
        if value is not None:  # red if it is not a number, too
            green = (least is None or value >= least) and (most is None or value <= most)
        numbers = (value, least, most) if value is None or math.isfinite(value) else (None,) * 3
        why = "" if green else reason
        found.append(Check(what, expected.name, why, at_reset, *numbers, other))

    if state is None:
        check("pose", None, "no pose yet", green=False)
    else:
        pose, twist, fence = state.pose, state.twist, expected.fence
        speed = math.hypot(twist.vx, twist.vy)
        age, limit = state.pose_age, p.pose_age_s
        check("pose", age, f"the newest is {age:.2f} s old", -limit, limit)
        rejected = state.rejected
        check("estimate", rejected, f"contradicts {rejected} poses", most=p.rejected)
        beyond = max(abs(pose.x) - fence.half_x, abs(pose.y) - fence.half_y)
        check("fence", beyond, f"outside at ({pose.x:.2f}, {pose.y:.2f}) m", most=0.0)
        x, y, theta = expected.start
        away = math.hypot(pose.x - x, pose.y - y)
        turn = math.degrees(abs(wrap(pose.theta - theta)))
        near = max(SMALLEST, expected.room) if p.start_distance is None else p.start_distance
        off = f"{away:.3f} m from where the experiment starts it, at most {near:.3f} m"
        check("start", away, off, most=near, at_reset=False)  # also finds wrong camera axes
        off = f"{turn:.0f} deg from the experiment's, at most {p.start_turn_deg:.0f} deg"
        check("heading", turn, off, most=p.start_turn_deg, at_reset=False)
        check("at_rest", speed, f"moves at {speed:.3f} m/s", most=p.at_rest)
        spins = f"turns at {twist.omega:.3f} rad/s"
        check("spin", twist.omega, spins, -p.no_spin, p.no_spin)
        for name, other in ready.neighbours.items():
            gap = math.hypot(other.pose.x - pose.x, other.pose.y - pose.y) - expected.reach[name]
            check("clear_of", gap, f"{gap:.3f} m between the rims", p.clearance, other=name)
    rate, full = ready.pose_rate, expected.camera_rate
    slow = f"{rate:.0f} Hz of {full:.0f} Hz"
    check("pose_rate", rate, slow, p.pose_rate_share * full, p.pose_rate_most * full)
    if health is None:
        check("board", None, "has not answered", green=False)
    else:
        share = health.supply_pressure / expected.set_pressure
        level = f"at {share:.0%} of its set value"
        if share <= 0.0:
            level = f"no pressure: open the air; {NO_SENSOR.format('supply')}"
        check("supply", share, level, p.supply_share, p.supply_most, at_reset=False)
        volts = f"{health.battery:.1f} V"
        if health.battery <= 0.0:
            volts = f"no voltage: connect the battery; {NO_SENSOR.format('battery')}"
        check(
            "battery", health.battery, volts, *p.battery_limits(expected.battery_v), at_reset=False
        )
        silent = f"silent for {health.silent_s:.2f} s"
        check("board", health.silent_s, silent, most=p.pose_age_s)
    check("valves", None, "the board reports an open valve", green=ready.valves_shut)
    trip = f"round trip of {ready.round_trip:.3f} s"
    check("link", ready.round_trip, trip, most=p.round_trip_s, at_reset=False)
    offset, within = vitals.clock_offset, p.clock_offset_s
    check("clock", offset, f"{offset:+.3f} s from the host's", -within, within)
    check("session", None, "messages of another session", green=vitals.session_ok)
    differs = "host and vehicle differ: start the agent again"
    check("config", None, differs, green=vitals.same_config)
    check("disk", vitals.disk_free, f"{1e-6 * vitals.disk_free:.0f} MB free", p.disk_free)
    absent = f"not heard for {vitals.operator_age:.1f} s"
    check("operator", vitals.operator_age, absent, most=p.operator_age_s)
    check("law", None, vitals.law_error, green=not vitals.law_error)
    return found
