"""The numbers of a vehicle's tile, each judged against the vehicle's own limits.

A level is `ok`, `warn` (a row of the fault table that warns or holds, or little is left), `bad` (a
row that ends the flight) or `off` (not measured).
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

from testbed.config import Experiment
from testbed.core.types import State, Tick

WINDOW_S = 60.0  # over which the rate of gas is taken
SHORTEST_S = 5.0  # before that there is no rate
NEAR_M = 0.05  # room on top of the braking distance, below which a tile is amber
MILD = ("warn", "hold")


class Number(NamedTuple):
    """One number of a vehicle's tile, with label, level and limit."""

    key: str
    label: str
    text: str
    level: str
    limit: str = ""  # in words


class Bounds(NamedTuple):
    """Limits of one detector of the fault table; infinite where no row has one."""

    warn: float
    bad: float
    is_floor: bool  # the number must stay above them

    def level(self, value: float) -> str:
        """`ok`, `warn` or `bad` for a value."""
        sign = -1.0 if self.is_floor else 1.0
        if sign * value > sign * self.bad:
            return "bad"
        return "warn" if sign * value > sign * self.warn else "ok"


def bounds(scenario: Experiment, detector: str) -> Bounds:
    """The limits of a detector."""
    rows = [row for row in scenario.faults.values() if row.detector == detector]
    is_floor = any(row.below is not None for row in rows)

    def limit(*, mild: bool) -> float:
        some = [row for row in rows if (row.response in MILD) == mild]
        if is_floor:
            return max((row.below for row in some if row.below is not None), default=-math.inf)
        return min((row.above for row in some if row.above is not None), default=math.inf)

    return Bounds(limit(mild=True), limit(mild=False), is_floor)


class Gas:
    """The tank's pressure over the last minute."""

    def __init__(self, empty: float, full: float) -> None:
        self._empty, self._full = empty, full  # where the supply begins to fall; a full tank [Pa]
        self._seen: list[tuple[float, float]] = []  # time [s], pressure [Pa]

    def see(self, t: float, pressure: float) -> None:
        """Note a pressure, at most once a second."""
        if not self._seen or t >= self._seen[-1][0] + 1.0:
            self._seen.append((t, pressure))
            while self._seen[-1][0] - self._seen[0][0] > WINDOW_S:
                self._seen.pop(0)

    def left_s(self, pressure: float) -> float | None:
        """Time until the supply begins to fall at this rate [s]; None: no rate yet."""
        if not self._seen or self._seen[-1][0] - self._seen[0][0] < SHORTEST_S:
            return None
        (t0, p0), (t1, p1) = self._seen[0], self._seen[-1]
        rate = (p0 - p1) / (t1 - t0)
        return math.inf if rate <= 0.0 else max(0.0, pressure - self._empty) / rate

    def number(self, pressure: float, to_fly_s: float) -> Number:
        """The tile's number: minutes at this rate, or per cent."""
        if pressure <= 0.0:
            return Number("gas", "Gas left", "no gauge", "off")
        share = pressure / self._full
        left = self.left_s(pressure)
        level = "bad" if pressure <= self._empty else "ok"
        if left is None:
            return Number("gas", "Gas left", f"{share:.0%}", level, "no rate yet")
        if left < to_fly_s:
            level = "bad" if left < 0.5 * to_fly_s or left < 30.0 else "warn"
        digits = 1 if left < 600.0 else 0
        minutes = "> 99 min" if left >= 5940.0 else f"{left / 60.0:.{digits}f} min"
        return Number("gas", "Gas left", f"{minutes}, {share:.0%}", level,
                      f"{to_fly_s / 60.0:.1f} min are still to be flown")  # fmt: skip


class Judge:
    """Makes the numbers of one vehicle's tile."""

    def __init__(self, scenario: Experiment, name: str) -> None:
        self._scenario, self._name = scenario, name
        model = scenario.vehicles[name].model
        self._model, air = model, model.air
        self.gas = Gas(air.set_pressure + air.dropout, air.tank_pressure)
        self._supply = bounds(scenario, "supply_share")
        self._battery = bounds(scenario, "battery")
        self._pose = bounds(scenario, "pose_age")
        self._link = bounds(scenario, "setpoint_age")

    @property
    def pose_warn(self) -> float:
        """Age from which a pose is a prediction [s]."""
        return self._pose.warn

    def numbers(
        self, t: float, tick: Tick, states: Mapping[str, State],
        delay_s: float | None, lost: float,
    ) -> list[Number]:  # fmt: skip
        """All numbers.

        Args:
            t: time of the run [s].
            tick: its newest.
            states: newest states of all vehicles.
            delay_s: age of what its link delivers; None: it has no link.
            lost: share of messages lost on that link over the last seconds.
        """
        health, state = tick.inputs.health, tick.outputs.state
        gauges, share = self._model.gauges, health.supply_pressure / self._model.air.set_pressure
        to_fly = max(0.0, self._scenario.duration_s - t)
        self.gas.see(t, health.tank_pressure)
        supply = Number("supply", "Supply", f"{health.supply_pressure / 1e5:.2f} bar",
                        self._supply.level(share), f"at least {self._supply.warn:.0%} of"
                        f" {self._model.air.set_pressure / 1e5:.1f} bar")  # fmt: skip
        battery = Number("battery", "Battery", f"{health.battery:.1f} V",
                         self._battery.level(health.battery),
                         f"at least {self._battery.bad:g} V")  # fmt: skip
        return [
            self.gas.number(health.tank_pressure, to_fly),
            supply if gauges.supply else Number("supply", "Supply", "no gauge", "off"),
            self._age(t, state),
            self._delay(delay_s, lost),
            self._room(t, state, states),
            battery if gauges.battery else Number("battery", "Battery", "no gauge", "off"),
        ]

    def _age(self, t: float, state: State | None) -> Number:
        if state is None:
            return Number("pose", "Pose age", "no pose", "bad")
        age = state.pose_age
        return Number("pose", "Pose age", f"{1e3 * age:.0f} ms" if age < 1.0 else f"{age:.1f} s",
                      self._pose.level(age), f"at most {1e3 * self._pose.warn:.0f} ms, a fault at"
                      f" {self._pose.bad:g} s")  # fmt: skip

    def _delay(self, delay_s: float | None, lost: float) -> Number:
        if delay_s is None:
            return Number("link", "Link, lost", "none", "off")
        level = self._link.level(delay_s)
        if lost > 0.5:
            level = "bad"
        elif lost > 0.1 and level == "ok":
            level = "warn"
        return Number("link", "Link, lost", f"{1e3 * delay_s:.0f} ms, {lost:.0%}", level,
                      f"at most {1e3 * self._link.warn:.0f} ms and 10 % lost")  # fmt: skip

    def _room(self, t: float, state: State | None, states: Mapping[str, State]) -> Number:
        """Distance to the nearest hazard, against the braking distance."""
        if state is None:
            return Number("room", "Clearance", "unknown", "off")
        x, y, scenario = state.pose.x, state.pose.y, self._scenario
        reach = self._model.radius + scenario.flight.gate.fence_margin
        size = scenario.table.size
        gaps = [(size[0] / 2 - reach - abs(x), "edge"), (size[1] / 2 - reach - abs(y), "edge")]
        for name, rock in scenario.obstacles.items():
            rx, ry = (p + t * v for p, v in zip(rock.position, rock.velocity, strict=True))
            gaps.append((math.hypot(x - rx, y - ry) - rock.radius, name))
        for name, other in states.items():
            if name != self._name:
                gap = math.hypot(x - other.pose.x, y - other.pose.y)
                gap -= self._model.radius + scenario.vehicles[name].model.radius
                gaps.append((gap, name))
        gap, what = min(gaps)
        speed = math.hypot(state.twist.vx, state.twist.vy)
        braking = speed**2 / (2.0 * scenario.flight.tracker.brake_decel)
        level = "bad" if gap <= 0.0 else "warn" if gap < braking + NEAR_M else "ok"
        limit = f"more than the braking distance, {braking:.2f} m, and {NEAR_M:g} m"
        return Number("room", "Clearance", f"{gap:.2f} m, {what}", level, limit)
