"""A flight as arrays, for figures, exports and comparisons."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from testbed.core.codes import LATCHED, FaultReport, Response
from testbed.core.types import Demand, Pose
from testbed.logs.feed import (
    Loop,
    News,
    SeenHost,
    SeenPace,
    SeenPhase,
    SeenTick,
    SeenValves,
    pose_of,
)
from testbed.logs.recorder import Truth

Array = NDArray[np.float64]
NAN3 = (math.nan,) * 3


class Happening(NamedTuple):
    """A change that a vehicle or the supervisor reported."""

    t: float  # [s]
    kind: str  # "valves shut", "flies", "fault", "filter", "cameras", a response or a phase
    words: str = ""
    fault: FaultReport | None = None
    rows: tuple[str, ...] = ()  # of the fault table, for a response

    @property
    def text(self) -> str:
        """The whole line."""
        return f"{self.kind}: {self.words}" if self.words else self.kind


def phase_change(change: SeenPhase) -> Happening:
    """A phase change of the supervisor."""
    words = change.because if change.fault is None else change.fault.words
    return Happening(change.t, change.phase, words, change.fault)


class VehicleHistory(Struct, frozen=True):
    """One vehicle, tick by tick; missing values are NaN."""

    t: Array  # (n,) time of the tick [s]
    at: Array  # (n,) time of estimate and reference: when the plan takes effect [s]
    pose: Array  # (n, 3) estimate [m, m, rad]
    twist: Array  # (n, 3) estimate [m/s, m/s, rad/s]
    reference: Array  # (n, 3) [m, m, rad]
    force_asked: Array  # (n, 2) force in W commanded by a law in wrench mode [N]
    commanded_wrench: Array  # (n, 3) mean over the period, in B [N, N, N m]
    realised_wrench: Array  # (n, 3) mean wrench of the pulses by the jet table [N, N, N m]
    on: Array  # (n, jets) open time [s]
    offset: Array  # (n, jets) from the plan's start to the opening [s]
    supply: Array  # (n,) [Pa]
    tank: Array  # (n,) [Pa]
    pose_age: Array  # (n,) [s]
    filtered: Array  # (n, 2) change of force by the safety filter, in W [N]
    events: list[Happening]  # from gate, fault table, filter and cameras
    edges: Array  # (e, 2) t [s] and mask of its valves; empty: its board reported none
    wires: Array  # (n, 4) t, lateness, setpoint delay [s], share lost; empty: no wires
    true: Array  # (m, 6) x, y, theta, vx, vy, omega; empty if unknown


class History(Struct, frozen=True):
    """A flight: its vehicles, host and supervisor."""

    vehicles: dict[str, VehicleHistory]
    true_t: Array  # (m,) [s]
    heard: dict[str, tuple[Array, Array]]  # per vehicle: t, age of its newest state at the host
    loop: Array  # (k, 3) t, late, busy [s]; empty if the clock was virtual
    phases: list[Happening] = []  # of the supervisor

    @property
    def end(self) -> float:
        """Time of the last tick [s]."""
        return max((float(v.t[-1]) for v in self.vehicles.values() if len(v.t)), default=0.0)

    def together(self) -> tuple[Array, dict[str, Array]]:
        """Common times, and each vehicle's position at them, (n, 2) [m]."""
        flown = {name: self.where(name) for name in self.vehicles}
        flown = {name: (t, state) for name, (t, state) in flown.items() if len(t)}
        if not flown:
            return np.zeros(0), {}
        t = max((t for t, _ in flown.values()), key=len)
        return t, {
            name: np.stack([np.interp(t, at, state[:, k]) for k in (0, 1)], axis=1)
            for name, (at, state) in flown.items()
        }

    def where(self, name: str) -> tuple[Array, Array]:
        """Times and states (m, 6) of a vehicle: the truth if it is known, else the estimate."""
        vehicle = self.vehicles[name]
        if len(vehicle.true) == len(self.true_t) > 0:
            return self.true_t, vehicle.true
        known = ~np.isnan(vehicle.pose[:, 0])
        return vehicle.at[known], np.hstack([vehicle.pose, vehicle.twist])[known]


class _Vehicle(Struct):
    ticks: list[SeenTick] = field(default_factory=list)
    true: list[tuple[float, ...]] = field(default_factory=list)
    edges: list[tuple[float, float]] = field(default_factory=list)
    paces: list[tuple[float, SeenPace]] = field(default_factory=list)


def gather(news: Iterable[News]) -> History:
    """Collect the messages of a flight into a history."""
    vehicles: dict[str, _Vehicle] = {}
    true_t: list[float] = []
    heard: dict[str, list[tuple[float, float]]] = {}
    loop: list[tuple[float, float, float]] = []
    phases: list[Happening] = []
    for one in news:
        match one.message:
            case SeenTick() as tick:
                vehicles.setdefault(one.who, _Vehicle()).ticks.append(tick)
            case SeenHost(inputs=inputs):
                if inputs.own is not None:
                    age = inputs.t - inputs.own.t
                    heard.setdefault(one.who, []).append((inputs.t, age))
            case Truth(t=t, vehicles=motions):
                true_t.append(t)
                for name, m in motions.items():
                    row = (m.x, m.y, m.theta, m.vx, m.vy, m.omega)
                    vehicles.setdefault(name, _Vehicle()).true.append(row)
            case Loop(t=t, late_s=late, busy_s=busy):
                loop.append((t, late, busy))
            case SeenPace() as pace:
                vehicles.setdefault(one.who, _Vehicle()).paces.append((one.t, pace))
            case SeenValves(t=t, mask=mask):
                vehicles.setdefault(one.who, _Vehicle()).edges.append((t, float(mask)))
            case SeenPhase() as change:
                phases.append(phase_change(change))
    return History(
        {name: _arrays(v) for name, v in vehicles.items()},
        np.array(true_t),
        {name: (np.array(r)[:, 0], np.array(r)[:, 1]) for name, r in heard.items()},
        np.array(loop).reshape(-1, 3),
        phases,
    )


def _table(rows: Sequence[Sequence[float]], width: int) -> Array:
    return np.array(rows, dtype=float).reshape(-1, width)


def _pose(pose: Pose | None) -> tuple[float, ...]:
    return NAN3 if pose is None else (pose.x, pose.y, pose.theta)


def _arrays(vehicle: _Vehicle) -> VehicleHistory:
    ticks, true = vehicle.ticks, vehicle.true
    outs = [tick.outputs for tick in ticks]
    jets = max((len(out.command.on_us) for out in outs), default=0)
    states = [out.state for out in outs]
    twists = [
        NAN3 if s is None else (s.twist.vx, s.twist.vy, s.twist.omega) for s in states
    ]  # fmt: skip
    asked = [
        (o.active_setpoint.fx_w, o.active_setpoint.fy_w)
        if isinstance(o.active_setpoint, Demand)
        else NAN3[:2]
        for o in outs
    ]
    changed = [(o.filtered.dfx_w, o.filtered.dfy_w) if o.filtered else (0.0, 0.0) for o in outs]
    return VehicleHistory(
        t=np.array([tick.inputs.t for tick in ticks]),
        at=np.array([math.nan if s is None else s.t for s in states]),
        pose=_table([_pose(None if s is None else s.pose) for s in states], 3),
        twist=_table(twists, 3),
        reference=_table([_pose(pose_of(out.active_setpoint)) for out in outs], 3),
        force_asked=_table(asked, 2),
        commanded_wrench=_table(
            [(o.commanded_wrench.fx, o.commanded_wrench.fy, o.commanded_wrench.tau) for o in outs],
            3,
        ),
        realised_wrench=_table(
            [(o.realised_wrench.fx, o.realised_wrench.fy, o.realised_wrench.tau) for o in outs], 3
        ),
        on=1e-6 * _table([o.command.on_us for o in outs], max(jets, 1)),
        offset=1e-6 * _table([o.command.offset_us for o in outs], max(jets, 1)),
        supply=np.array([tick.inputs.health.supply_pressure for tick in ticks]),
        tank=np.array([tick.inputs.health.tank_pressure for tick in ticks]),
        pose_age=np.array([math.nan if s is None else s.pose_age for s in states]),
        filtered=_table(changed, 2),
        events=sorted(
            [*events(ticks), *camera_events(vehicle.paces)], key=lambda one: (one.t, one.text)
        ),
        edges=_table(vehicle.edges, 2),
        wires=_table(
            [(t, p.late_s, _or_nan(p.setpoint_delay_s), lost_share(p)) for t, p in vehicle.paces], 4
        ),
        true=_table(true, 6),
    )


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def lost_share(pace: SeenPace) -> float:
    """Share of the setpoints so far that were lost."""
    return pace.setpoints_lost / max(1, pace.setpoints_heard + pace.setpoints_lost)


def camera_events(paces: Iterable[tuple[float, SeenPace]], said: str = "") -> list[Happening]:
    """Changes of the camera fault and their times [s]; `said` is the previous one."""
    found = []
    for t, pace in paces:
        if pace.cameras != said:
            found.append(Happening(t, "cameras", pace.cameras or "well again"))
        said = pace.cameras
    return found


def events(ticks: Iterable[SeenTick]) -> list[Happening]:
    """Changes reported by gate, fault table and filter, and their times [s].

    A response is listed with the active rows of the fault table, and again when a row is added.
    """
    said: list[Happening] = []
    shut, fault, response, kept = None, None, Response.NONE, ""
    held: frozenset[str] = frozenset()
    for tick in ticks:
        t, out = tick.inputs.t, tick.outputs
        hazard = out.filtered.words if out.filtered else ""
        if (why := out.inhibit_reason) != shut:
            words = "" if why is None or why.code in LATCHED else why.words
            said.append(Happening(t, "flies" if why is None else "valves shut", words))
        fresh = tuple(row for row in out.faults if row not in held)
        if out.response and (fresh or out.response != response):
            rows = fresh or out.faults
            said.append(Happening(t, out.response.words, ", ".join(rows), rows=rows))
        elif response == Response.HOLD and not out.response:
            said.append(Happening(t, "goes on"))
        if out.fault is not None and out.fault != fault:
            said.append(Happening(t, "fault", out.fault.words, out.fault))
        if hazard and hazard != kept:
            said.append(Happening(t, "filter", hazard))
        shut, fault, response, kept = why, out.fault, out.response, hazard
        held = frozenset(out.faults)
    return said
