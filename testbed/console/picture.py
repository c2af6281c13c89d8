"""What the operator's page shows now, made from the log's messages as they arrive."""

import math
from collections import deque
from collections.abc import Iterable
from typing import Any, TypeVar

from testbed.config import Experiment
from testbed.console.tiles import Judge
from testbed.console.valve_pulses import Pulse, ValveHistory
from testbed.core.codes import Response
from testbed.core.types import HostTick, Tick
from testbed.logs.feed import News, SeenPace, SeenPhase, SeenValves, pose_of, stopping_point
from testbed.logs.history import FlightEvent, camera_events, events, phase_change
from testbed.logs.truth import Truth
from testbed.report.fault_story import (
    OVER,
    STOPPING_TOO,
    SUPERVISOR,
    EventLine,
    FaultyVehicles,
    Story,
)

SILENT_S = 1.0  # a vehicle without a tick for this long is silent
SILENT_STICK = "by hand, no fresh stick: rests"
LOSS_S = 5.0  # over which the share of lost messages is taken
TRAIL_S = 0.2  # between two points of a trail

T = TypeVar("T")


class LivePicture:
    """The state of one run; `take` messages, then read `now` and what is new since then."""

    def __init__(self, scenario: Experiment) -> None:
        self._scenario, self._names = scenario, list(scenario.vehicles)
        self.t = 0.0  # newest message of the run [s]
        self.phase = SeenPhase(0.0, "")  # of the supervisor
        self._ticks: dict[str, Tick] = {}
        self._hosts: dict[str, HostTick] = {}
        self._paces: dict[str, deque[tuple[float, SeenPace]]] = {n: deque() for n in self._names}
        self._fresh: dict[str, deque[tuple[float, bool]]] = {n: deque() for n in self._names}
        self._places: dict[str, tuple[float, ...]] = {}
        self._true: set[str] = set()  # vehicles whose true pose the rig knows
        self._traced: dict[str, float] = {}
        self._trouble, self._story = FaultyVehicles(scenario), Story(scenario)
        self._judges = {n: Judge(scenario, n) for n in self._names}
        self._pulses = {
            n: ValveHistory(k, len(one.model.jets), one.model.command_delay_s)
            for k, (n, one) in enumerate(scenario.vehicles.items())
        }
        self.pulses: list[Pulse] = []  # new since the last `clear`
        self.trail: list[tuple[int, float, float]] = []
        self.events: list[EventLine] = []

    def clear(self) -> None:
        """Drop the pulses, paths and messages added since the last call."""
        self.pulses, self.trail, self.events = [], [], []

    def take(self, news: Iterable[News]) -> None:
        """Update the picture with new messages of the log."""
        rows: list[tuple[str, FlightEvent]] = []
        for _, who, t, message in news:
            self.t = max(self.t, t)
            match message:
                case Tick() if who in self._pulses:
                    rows += self._tick(who, message)
                case HostTick() if who in self._pulses:
                    self._host(who, message)
                case SeenPace() if who in self._pulses:
                    rows += self._pace(who, t, message)
                case SeenValves() if who in self._pulses:
                    self.pulses += self._pulses[who].driven(message)
                case Truth(vehicles=vehicles):
                    for name, m in vehicles.items():
                        self._true.add(name)
                        self._stand(name, t, m.x, m.y, m.theta)
                case SeenPhase():
                    self.phase = message
                    rows.append((SUPERVISOR, phase_change(message)))
        self._trouble.see(self._ticks)
        self.events += self._story.lines_of(rows)

    def _tick(self, name: str, tick: Tick) -> list[tuple[str, FlightEvent]]:
        previous = [self._ticks[name]] if name in self._ticks else []
        fresh = events([*previous, tick])[len(events(previous)) :]
        self._ticks[name] = tick
        self.pulses += self._pulses[name].planned(tick)
        if (state := tick.outputs.state) is not None and name not in self._true:
            self._stand(name, tick.inputs.t, state.pose.x, state.pose.y, state.pose.theta)
        return [(name, one) for one in fresh]

    def _stand(self, name: str, t: float, x: float, y: float, theta: float) -> None:
        self._places[name] = x, y, theta
        if name in self._pulses and t >= self._traced.get(name, -math.inf) + TRAIL_S - 1e-6:
            self._traced[name] = t
            self.trail.append((self._names.index(name), round(x, 3), round(y, 3)))

    def _host(self, name: str, host: HostTick) -> None:
        before, own = self._hosts.get(name), host.inputs.own
        self._hosts[name] = host
        old = before.inputs.own if before is not None else None
        fresh = own is not None and (old is None or own.t > old.t)
        _push(self._fresh[name], host.inputs.t, fresh)

    def _pace(self, name: str, t: float, pace: SeenPace) -> list[tuple[str, FlightEvent]]:
        seen = self._paces[name]
        before = seen[-1][1].cameras if seen else ""
        _push(seen, t, pace)
        return [(name, one) for one in camera_events([(t, pace)], before)]

    # Now

    @property
    def over(self) -> bool:
        """Whether the supervisor has ended the flight."""
        return self.phase.phase in OVER and self.phase.t > 0.0

    def now(self) -> dict[str, Any]:
        """The newest state of everything that moves."""
        culprits = self._culprits()
        words, level = self._headline()
        states = {n: one.outputs.state for n, one in self._ticks.items()}
        known = {n: s for n, s in states.items() if s is not None}
        return {
            "t": round(self.t, 3),
            "phase": self.phase.phase,
            "head": words,
            "level": level,
            "reported": any(one.reported for one in self._pulses.values()),
            "open": [pulse for one in self._pulses.values() for pulse in one.open],
            "vehicles": [self._vehicle(name, culprits, known) for name in self._names],
        }

    def _culprits(self) -> dict[str, str]:
        """Vehicles with a fault of their own; a silent one is known from the supervisor only."""
        found, fault = self._trouble.culprits(self._ticks), self.phase.fault
        origin = fault.origin if fault is not None else None
        if origin is not None and origin.vehicle in self._names:
            return {origin.vehicle: origin.title} | found
        return found

    def _headline(self) -> tuple[str, str]:
        if fault := self._trouble.banner(self._ticks):
            return fault, "bad"
        if self.phase.phase == "FAULT":
            return f"FAULT {phase_change(self.phase).words}", "bad"
        return "", "ok"

    def _vehicle(self, name: str, culprits: dict[str, str], known: dict[str, Any]) -> Any:
        tick = self._ticks.get(name)
        if tick is None:
            words, level = "not heard yet", "off"
            if name in culprits:
                words, level = f"FAULT: {culprits[name]}", "bad"
            return {"name": name, "state": words, "level": level, "numbers": []}
        out, state = tick.outputs, tick.outputs.state
        words, level = self._state(name, tick, culprits)
        asked = pose_of(out.active_setpoint)
        period = self._scenario.flight.jet_period_s
        decel = self._scenario.flight.tracker.brake_decel
        delay, lost = self._link(name)
        flies = not self.over
        return {
            "name": name,
            "state": words,
            "level": level,
            "culprit": name in culprits,
            "at": [round(v, 4) for v in self._places.get(name, ())],
            "stale": state is None or state.pose_age > self._judges[name].pose_warn,
            "reference": None if asked is None else [asked.x, asked.y, asked.theta],
            "stop": None if state is None else list(stopping_point(state, decel)),
            "jets": [round(min(1.0, 1e-6 * on / period), 2) * flies for on in out.command.on_us],
            "numbers": self._judges[name].numbers(self.t, tick, known, delay, lost),
        }

    def _state(self, name: str, tick: Tick, culprits: dict[str, str]) -> tuple[str, str]:
        """A vehicle's state in words, and its level."""
        out, silent = tick.outputs, self.t - tick.inputs.t
        if name in culprits:
            return f"FAULT: {culprits[name]}", "bad"
        if out.fault is not None and out.fault.cause is not None:
            return STOPPING_TOO, "warn"  # red is for the culprit
        if out.fault is not None:
            return out.fault.title, "bad"
        if self.over:
            return "flight over", "off"
        if silent > SILENT_S:
            return f"silent for {silent:.1f} s", "bad"
        if out.inhibit_reason:
            return f"waits: {out.inhibit_reason.words}", "warn"
        if out.response >= Response.HOLD:
            return out.response.words, "warn"
        host = self._hosts.get(name)
        if host is not None and (stick := host.inputs.stick) is not None:
            return ("flown by hand", "ok") if stick.alive else (SILENT_STICK, "warn")
        if out.filtered is not None:
            return f"flies, filter: {out.filtered.words}", "warn"
        return "flies", "ok"

    def _link(self, name: str) -> tuple[float | None, float]:
        """Age of what a vehicle's link delivers [s], and the share of messages lost."""
        paces = self._paces[name]
        if paces and paces[-1][1].setpoint_delay_s is not None:
            (_, first), (_, last) = paces[0], paces[-1]
            lost = last.setpoints_lost - first.setpoints_lost
            heard = last.setpoints_heard - first.setpoints_heard
            return last.setpoint_delay_s, lost / max(1, lost + heard)
        host = self._hosts.get(name)
        if host is None or host.inputs.own is None:
            return None, 0.0
        fresh = self._fresh[name]
        lost = sum(not is_fresh for _, is_fresh in fresh)
        return max(0.0, host.inputs.t - host.inputs.own.t), lost / max(1, len(fresh))


def _push(window: "deque[tuple[float, T]]", t: float, value: T) -> None:
    """Append to a window of the last LOSS_S seconds."""
    window.append((t, value))
    while window[-1][0] - window[0][0] > LOSS_S:
        window.popleft()
