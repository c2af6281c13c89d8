"""Metrics of a flight: the numbers of metrics.json and the criteria of an experiment."""

import math
from array import array
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from testbed.core.codes import FaultReport
from testbed.core.jets import JetHealth
from testbed.core.law import Concern
from testbed.core.records.kinds import SetpointKind
from testbed.core.se2 import wrap_all
from testbed.core.table import Obstacle
from testbed.core.types import Demand, Outputs, Tick
from testbed.core.vehicle import NonNegative, Positive
from testbed.flight.arming import Check
from testbed.flight.flown_span import FlownRows
from testbed.flight.flown_tick import AnyTick
from testbed.metrics.afterwards import After
from testbed.metrics.characterisation import Characterisation

Array = NDArray[np.float64]

SETTLED_M = 0.05  # "settled": the position's error stays below this, at any heading [m]
KNOWN_JET = 0.2  # a jet's share of thrust is known if its sigma is at most this
HOLD_S = 30.0  # the last part of a run, which counts as holding [s]
ROUNDING_S = 1e-6  # times of a flight are sums of periods [s]


class FormationCriteria(Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of a formation; the numbers are those of `testbed.metrics.formation`."""

    error_m: Positive | None = None
    settled_s: Positive | None = None
    longest_edge_m: Positive | None = None


class Criteria(Struct, frozen=True, forbid_unknown_fields=True):
    """Limits for passing an experiment; a criterion that is not given is not judged."""

    max_contacts: Annotated[int, Meta(ge=0)] | None = 0
    clear_of_obstacles: bool = True  # every obstacle's danger radius is kept
    final_error_m: Positive | None = None
    settle_s: Positive | None = None
    hold_rms_m: Positive | None = None
    track_rms_m: Positive | None = None
    heading_rms_deg: Positive | None = None
    impulse_ns: NonNegative | None = None
    formation: FormationCriteria | None = None


class Commands(Struct, frozen=True):
    """Counts of setpoints from host to vehicles."""

    sent: int
    late: int  # delayed too long, duplicated or overtaken
    expired: int  # arrived after their valid-until
    rejected: int  # of another session or version, garbled, or refused by a board


class VehicleMetrics(Struct, frozen=True):
    """One vehicle's flight; null where a number does not apply, see config/unmeasured.py."""

    final_error_m: float | None  # true position at the end against the goal's
    settle_s: float | None  # time after which the position stays within 0.05 m of the goal
    track_rms_m: float | None  # true position against the reference; null in wrench mode
    hold_rms_m: float | None  # true position against the goal in the last 30 s of a whole run
    heading_rms_deg: float | None  # true heading against the commanded one
    min_obstacle_distance_m: float | None  # centre to centre, nearest obstacle
    impulse_ns: float | None  # of all jets together
    gas_g: float | None  # jets and bearings
    valve_pulses: int | None  # openings, all valves
    max_force_n: float | None  # largest mean force commanded in one jet period
    filtered_ns: float | None = None  # impulse of the safety filter's changes [N s]


class Touch(Struct, frozen=True):
    """A contact that should not have happened."""

    t: float  # [s]
    vehicle: str
    other: str  # another vehicle, an obstacle or an edge of the table
    speed: float  # closing [m/s]


class FormationMetrics(Struct, frozen=True):
    """Two or more vehicles together; null where a number does not apply to the law."""

    end: Characterisation  # the five elements at the end
    closest_m: float  # smallest gap between two surfaces, of the run
    widest_m: float  # largest distance from the mean position, of the run
    error_m: float | None = None  # largest in the last 5 s, of the run or of each phase
    settled_s: float | None = None  # after which it stays small; of the slowest phase
    longest_edge_m: float | None = None  # of the start's edges, over the run
    lost_edges: int | None = None  # edges that were once longer than the range


class Metrics(Struct, frozen=True):
    """Content of metrics.json."""

    experiment: str
    rig: str
    seed: int
    completed: bool
    duration_s: float  # time flown
    wall_s: float
    real_time_factor: float | None
    contacts: int
    min_vehicle_distance_m: float | None  # centre to centre
    fault: str | None
    criteria: dict[str, bool] | None  # met or not; null: not judged
    vehicles: dict[str, VehicleMetrics]
    lateness_p99_ms: float | None = None  # of ticks, read after waking; null without a wall clock
    pose_to_valve_p50_ms: float | None = None  # newest pose's arrival to the plan's first byte
    pose_to_valve_p99_ms: float | None = None
    commands: Commands | None = None
    board: str | None = None
    formation: FormationMetrics | None = None  # of two or more vehicles
    warnings: list[Concern] = []  # for example assumptions of a law's proof that do not hold
    phase: str = ""  # of the supervisor at the end: DISARMED, STOPPED or FAULT
    red: list[Check] = []  # failed arming checks that kept the run from starting
    fault_report: FaultReport | None = None  # of `fault`
    fault_t: float | None = None  # when it was found; the flight ends at rest, later [s]
    touches: list[Touch] = []  # contacts with known time and place
    after: After | None = None  # state of the vehicles after the flight; null: not known
    jets: dict[str, list[JetHealth]] = {}  # of each vehicle, in the order of its file
    epoch_ns: int | None = None  # UTC at time 0, as in the log; null: not known


class Track(Struct, frozen=True):
    """True states of the vehicles. On the twin: at every camera frame."""

    t: Array  # (n,) [s]
    states: Array  # (n, v, 6) x, y, theta, vx, vy, omega

    def at(self, times: Array, vehicle: int) -> Array:
        """Pose by cubic interpolation, shape (len(times), 3); times within the track."""
        i = np.clip(np.searchsorted(self.t, times) - 1, 0, len(self.t) - 2)
        h = (self.t[i + 1] - self.t[i])[:, None]
        s = (times - self.t[i])[:, None] / h
        a, b = self.states[i, vehicle], self.states[i + 1, vehicle]
        return (
            (1 + 2 * s) * (1 - s) ** 2 * a[:, :3]
            + s * s * (3 - 2 * s) * b[:, :3]
            + h * s * (1 - s) ** 2 * a[:, 3:]
            - h * s * s * (1 - s) * b[:, 3:]
        )


class Consumption(Struct, frozen=True):
    """Consumption of a vehicle."""

    impulse: float  # [N s]
    gas: float  # [kg]
    openings: int | None  # None: not counted


class Aim(Struct, frozen=True):
    """Commands to a vehicle, tick by tick."""

    t: Array  # (n,) [s]
    pose: Array  # (n, 3) reference; x, y are NaN if only a heading was commanded
    force: Array  # (n,) size of the mean force commanded to the jets [N]
    filtered_ns: float = 0.0  # impulse of the safety filter's changes [N s]


class ReferenceLog:
    """Collects a vehicle's commands tick by tick, so that a flight need not keep its outputs."""

    def __init__(self, outputs: Iterable[Outputs] = ()) -> None:
        self._rows = array("d")  # t, x, y, theta, force; one tick after the other
        self._forces = False  # whether the law commands forces
        self._filtered = 0.0  # [N s]
        self._kept: FlownRows | None = None  # not yet in the rows
        for out in outputs:
            self._note(out)

    def note(self, tick: AnyTick) -> None:
        """Add a tick; ticks without a setpoint or a state are ignored."""
        if isinstance(tick, Tick):
            self._add_kept()
            self._note(tick.outputs)
            return
        self.note_rows(FlownRows.of(tick))

    def note_rows(self, rows: FlownRows) -> None:
        """Add ticks."""
        if self._kept is not None and self._kept.goes_on(rows.table, rows.first):
            self._kept.extend(rows)
            return
        self._add_kept()
        self._kept = rows.part(0, rows.count)

    def _note(self, out: Outputs) -> None:
        if out.filtered is not None and out.inhibit_reason is None:
            period = out.command.valid_until - out.command.issued_at
            self._filtered += period * math.hypot(out.filtered.dfx_w, out.filtered.dfy_w)
        if out.active_setpoint is None or out.state is None:
            return
        force = math.hypot(out.commanded_wrench.fx, out.commanded_wrench.fy)
        if isinstance(out.active_setpoint, Demand):
            self._forces = True
            self._rows.extend((out.state.t, math.nan, math.nan, out.active_setpoint.theta, force))
        else:
            pose = out.active_setpoint.pose
            self._rows.extend((out.state.t, pose.x, pose.y, pose.theta, force))

    def _add_kept(self) -> None:
        """Add ticks that are rows one after the other of one table, column by column."""
        kept, self._kept = self._kept, None
        if kept is None:
            return
        records, period = kept.table.records[kept.rows], kept.agent.params.gains.period
        inputs, outputs = records["inputs"], records["outputs"]
        for i in np.flatnonzero((outputs["hazard"] >= 0) & (outputs["inhibit"] == 0)).tolist():
            dfx, dfy, t = float(outputs["dfx"][i]), float(outputs["dfy"][i]), float(inputs["t"][i])
            self._filtered += (t + period - t) * math.hypot(dfx, dfy)
        kind = inputs["setpoint"]["kind"]
        demanded = (kind == SetpointKind.DEMAND) & (outputs["stopping"] == 0)
        active, commanded = outputs["active"], outputs["commanded"]
        force = list(map(math.hypot, commanded["fx"].tolist(), commanded["fy"].tolist()))
        rows = np.column_stack((
            records["state"]["t"],
            np.where(demanded, math.nan, active["x"]),
            np.where(demanded, math.nan, active["y"]),
            np.where(demanded, inputs["setpoint"]["theta"], active["theta"]),
            force,
        ))  # fmt: skip
        flown = (kind != SetpointKind.NONE) & (records["state"]["known"] == 1)
        self._forces = self._forces or bool((demanded & flown).any())
        self._rows.frombytes(rows[flown].tobytes())

    def aim(self) -> Aim:
        """All commands so far.

        If a law commands forces, references from braking without setpoints are not part of the
        track.
        """
        self._add_kept()
        table = np.array(self._rows).reshape(-1, 5)
        if self._forces:
            table[:, 1:3] = math.nan
        return Aim(table[:, 0], table[:, 1:4], table[:, 4], self._filtered)


def _rms(values: Array) -> float | None:
    return float(np.sqrt(np.mean(values))) if len(values) else None


def settle_time(t: Array, error: Array) -> float | None:
    """First time after which `error` stays within SETTLED_M; None if it does not [s]."""
    outside = np.nonzero(~(error <= SETTLED_M))[0]
    if len(outside) == 0:
        return float(t[0])
    last = int(outside[-1])
    return float(t[last + 1]) if last + 1 < len(t) else None


def obstacle_distances(
    track: Track, vehicle: int, obstacles: Mapping[str, Obstacle]
) -> dict[str, float]:
    """Smallest distance of a vehicle to each obstacle, centre to centre [m]."""
    distances = {}
    for name, obstacle in obstacles.items():
        centre = np.array(obstacle.position) + np.outer(track.t, obstacle.velocity)
        gaps = np.hypot(*(track.states[:, vehicle, :2] - centre).T)
        distances[name] = float(np.min(gaps, initial=math.inf))
    return distances


def smallest_separation(track: Track) -> float | None:
    """Smallest distance between any two vehicles, centre to centre [m]."""
    count = track.states.shape[1]
    if len(track.t) == 0:
        return None
    gaps = [
        np.min(np.hypot(*(track.states[:, i, :2] - track.states[:, j, :2]).T))
        for i in range(count)
        for j in range(i)
    ]
    return float(min(gaps)) if gaps else None


def vehicle_metrics(
    track: Track,
    vehicle: int,
    goal: tuple[float, float, float],
    aimed: Aim,
    spent: Consumption,
    distances: Mapping[str, float],
    completed_s: float,
) -> VehicleMetrics:
    """Judge one vehicle's flight.

    Args:
        track: true states of all vehicles.
        vehicle: its number in the track.
        goal: x, y, theta at the end [m, rad].
        aimed: its commands.
        spent: its consumption.
        distances: those of `obstacle_distances` [m].
        completed_s: duration of the flight, if it reached its end, else 0: what was flown until
            then is not the hold. The last state is up to one frame before the end [s].
    """
    error = np.hypot(*(track.states[:, vehicle, :2] - np.array(goal[:2])).T)
    end = track.t[-1] if len(track.t) else 0.0
    inside = (aimed.t >= track.t[0]) & (aimed.t <= end) if len(track.t) > 1 else aimed.t < 0
    asked = aimed.pose[inside]
    flown = track.at(aimed.t[inside], vehicle) if inside.any() else np.zeros((0, 3))
    off = np.sum((flown[:, :2] - asked[:, :2]) ** 2, axis=1)
    turn = wrap_all(flown[:, 2] - asked[:, 2])
    heading = _rms(turn**2)
    held = completed_s >= HOLD_S - ROUNDING_S
    return VehicleMetrics(
        final_error_m=float(error[-1]) if len(error) else None,
        settle_s=settle_time(track.t, error) if len(error) else None,
        track_rms_m=_rms(off[~np.isnan(off)]),
        hold_rms_m=_rms(error[track.t > end - HOLD_S] ** 2) if held else None,
        heading_rms_deg=None if heading is None else math.degrees(heading),
        min_obstacle_distance_m=min(distances.values()) if distances and len(track.t) else None,
        impulse_ns=spent.impulse,
        gas_g=1e3 * spent.gas,
        valve_pulses=spent.openings,
        max_force_n=float(np.max(aimed.force)) if len(aimed.force) else None,
        filtered_ns=aimed.filtered_ns,
    )


def with_jets(metrics: Metrics, jets: Mapping[str, Sequence[JetHealth]]) -> Metrics:
    """The metrics with what the vehicles know about their jets, and a warning for each bad one."""
    found = [
        Concern("jet_reconfigured", f"{name}: jet {k} {one.words}")
        for name, ones in jets.items()
        for k, one in enumerate(ones, 1)
        if one.words
    ]
    known = {name: list(ones) for name, ones in jets.items() if ones}
    return replace(metrics, jets=known, warnings=[*metrics.warnings, *found])


def weakest_jet(metrics: Metrics, name: str) -> float | None:
    """Smallest share of thrust among a vehicle's jets that are known; None: none is."""
    jets = metrics.jets.get(name, [])
    return min((one.share for one in jets if one.sigma <= KNOWN_JET), default=None)


def judge_formation(criteria: FormationCriteria, formation: object) -> dict[str, bool]:
    """Judge each given limit; a run without a formation meets none."""
    verdict = {}
    for key in FormationCriteria.__struct_fields__:
        limit, value = getattr(criteria, key), getattr(formation, key, None)
        if limit is not None:
            verdict[f"formation.{key}"] = value is not None and value <= limit
    return verdict


def judge(
    criteria: Criteria, vehicles: Mapping[str, VehicleMetrics], contacts: int, clear: bool
) -> dict[str, bool]:
    """Judge each given criterion; a number that does not apply does not meet it.

    `track_rms_m` is not judged if no vehicle tracked a reference.
    """
    verdict: dict[str, bool] = {}
    if criteria.max_contacts is not None:
        verdict["max_contacts"] = contacts <= criteria.max_contacts
    if criteria.clear_of_obstacles:
        verdict["clear_of_obstacles"] = clear
    for key in (
        "final_error_m", "settle_s", "hold_rms_m", "track_rms_m", "heading_rms_deg", "impulse_ns",
    ):  # fmt: skip
        limit = getattr(criteria, key)
        values = [getattr(m, key) for m in vehicles.values()]
        if limit is None or (key == "track_rms_m" and all(v is None for v in values)):
            continue
        verdict[key] = all(value is not None and value <= limit for value in values)
    return verdict
