"""A flight as arrays, for figures, exports and comparisons."""

import math
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from testbed.core.codes import LATCHED, FaultReport, Response
from testbed.core.records.cdr import decode
from testbed.core.records.definition import MESSAGES
from testbed.core.records.kinds import Active
from testbed.core.types import Tick
from testbed.logs.columns import Columns
from testbed.logs.feed import SeenPace, SeenPhase, TypedRows, same_version
from testbed.logs.log_reader import UNREADABLE, LogError, LogReader

Array = NDArray[np.float64]


class FlightEvent(NamedTuple):
    """A change that a vehicle or the supervisor reported."""

    t: float  # [s]
    kind: str  # "valves shut", "flies", "fault", "filter", "cameras", a response or a phase
    words: str = ""
    fault: FaultReport | None = None
    rows: tuple[str, ...] = ()  # of the fault table, for a response

    @property
    def text(self) -> str:
        """The event's line: its kind and words."""
        return f"{self.kind}: {self.words}" if self.words else self.kind


def phase_change(change: SeenPhase) -> FlightEvent:
    """A phase change of the supervisor."""
    words = change.because if change.fault is None else change.fault.words
    return FlightEvent(change.t, change.phase, words, change.fault)


class VehicleHistory(Struct, frozen=True):
    """One vehicle, tick by tick; missing values are NaN."""

    t: Array  # (n,) time of the tick [s]
    at: Array  # (n,) time of estimate and reference: when the plan takes effect [s]
    pose: Array  # (n, 3) estimate [m, m, rad]
    twist: Array  # (n, 3) estimate [m/s, m/s, rad/s]
    seen: Array  # (s, 4) poses of the cameras as they arrived: captured at, x, y, theta
    reference: Array  # (n, 3) [m, m, rad]
    force_asked: Array  # (n, 2) force in W commanded by a law in wrench mode [N]
    commanded_wrench: Array  # (n, 3) mean over the period, in B [N, N, N m]
    realised_wrench: Array  # (n, 3) mean wrench of the jets [N, N, N m]
    on: Array  # (n, jets) open time [s]
    offset: Array  # (n, jets) from the plan's start to the opening [s]
    supply: Array  # (n,) [Pa]
    tank: Array  # (n,) [Pa]
    pose_age: Array  # (n,) [s]
    filtered: Array  # (n, 2) change of force by the safety filter, in W [N]
    events: list[FlightEvent]  # from gate, fault table, filter and cameras
    edges: Array  # (e, 2) t [s] and mask of its valves; empty: its board reported none
    wires: Array  # (n, 5) t, lateness, setpoint delay [s], share lost, pose to valve [s]; or empty
    true: Array  # (m, 6) x, y, theta, vx, vy, omega; empty if unknown


class History(Struct, frozen=True):
    """A flight: its vehicles, host and supervisor."""

    vehicles: dict[str, VehicleHistory]
    true_t: Array  # (m,) [s]
    state_ages: dict[
        str, tuple[Array, Array]
    ]  # per vehicle: t, age of its newest state at the host
    loop: Array  # (k, 3) t, late, busy [s]; empty if the clock was virtual
    phases: list[FlightEvent] = []  # of the supervisor

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


def gather(book: LogReader) -> History:
    """The history in a log.

    Raises:
        LogError: it is of another version or damaged in a way that cannot be skipped.
    """
    log = Columns(book)
    for topic in log.rows:
        same_version(book, topic)
    try:
        return _history(log)
    except UNREADABLE as error:
        raise LogError(f"{book.path}: {error}") from None


def _history(log: Columns) -> History:
    reader, vehicles, none = TypedRows(), dict[str, VehicleHistory](), np.zeros(0)
    for data in log.texts.get("/names", [])[-1:]:
        reader.message("/names", "Names", data)
    truth = log.rows.get("/truth")
    for name in dict.fromkeys(topic.split("/")[1] for topic in log.rows):
        ticks = log.rows.get(f"/{name}/tick")
        if ticks is not None:
            true, names = none, reader.read.names.vehicles
            if truth is not None and name in names:
                motion = truth["vehicles"][:, names.index(name)]
                true = np.column_stack((_numbers(motion["pose"]), _numbers(motion["twist"])))
            vehicles[name] = _vehicle(log, name, ticks, true, reader)
    state_ages = {}
    for topic, host in log.rows.items():
        if topic.endswith("/host") and (known := host["inputs"]["own_known"] > 0).any():
            inputs = host["inputs"][known]
            state_ages[topic.split("/")[1]] = inputs["t"], inputs["t"] - inputs["own"]["t"]
    phases = [
        phase_change(one)
        for data in log.texts.get("/supervisor", [])
        if isinstance(one := reader.message("/supervisor", "Event", data), SeenPhase)
    ]
    loop = log.rows.get("/loop")
    return History(
        vehicles,
        none if truth is None else truth["t"],
        state_ages,
        _numbers(loop) if loop is not None else none.reshape(0, 3),
        phases,
    )


def _numbers(records: Any) -> Array:
    """Records of numbers as one array with a column for each, shape (n, columns)."""
    names = [name for name in records.dtype.names if name != "header"]
    return np.column_stack([records[name] for name in names])


def _vehicle(
    log: Columns, name: str, ticks: Any, true: Array, reader: TypedRows
) -> VehicleHistory:  # fmt: skip
    inputs, out = ticks["inputs"], ticks["outputs"]
    state, pulses = out["state"], ticks["pulses"]
    paces = _paces(log, name, reader)
    flies = out["active"] == Active.REFERENCE
    asked = np.where(out["active"] == Active.DEMAND, out["demand"]["fx_w"], math.nan)
    asked_y = np.where(out["active"] == Active.DEMAND, out["demand"]["fy_w"], math.nan)
    edges = log.rows.get(f"/{name}/valves")
    found = [*events(_changes(log, name, ticks, reader)), *camera_events(paces)]
    return VehicleHistory(
        t=inputs["t"],
        at=state["t"],
        pose=_numbers(state["pose"]),
        twist=_numbers(state["twist"]),
        seen=_seen(ticks),
        reference=np.where(flies[:, None], _numbers(out["reference"]["pose"]), math.nan),
        force_asked=np.column_stack((asked, asked_y)),
        commanded_wrench=_numbers(out["commanded_wrench"]),
        realised_wrench=_numbers(out["realised_wrench"]),
        on=1e-6 * pulses["on_us"],
        offset=1e-6 * pulses["offset_us"],
        supply=inputs["health"]["supply_pressure"],
        tank=inputs["health"]["tank_pressure"],
        pose_age=state["pose_age"],
        filtered=np.column_stack((out["filtered"]["dfx_w"], out["filtered"]["dfy_w"])),
        events=sorted(found, key=lambda one: (one.t, one.text)),
        edges=np.zeros((0, 2)) if edges is None else _numbers(edges).astype(float),
        wires=_wires(log.rows.get(f"/{name}/pace"), paces),
        true=true if len(true) else np.zeros((0, 6)),
    )  # fmt: skip


def _seen(ticks: Any) -> Array:
    """The column `VehicleHistory.seen`."""
    room = ticks["samples"].shape[1]
    return _numbers(ticks["samples"][np.arange(room) < ticks["samples_valid"][:, None]])


def _changes(log: Columns, name: str, ticks: Any, reader: TypedRows) -> Iterator[Tick]:
    """The first tick, and every tick whose codes or texts are not those of the tick before."""
    out, t = ticks["outputs"], ticks["inputs"]["t"]
    codes = np.column_stack(
        (
            *(out[one] for one in ("inhibit", "fault", "faults", "response")),
            out["filtered"]["hazard"], out["filtered"]["subject"],
            np.ascontiguousarray(out["inhibit_values"]).view(np.uint64),
        )
    )  # fmt: skip
    changed = np.ones(len(t), bool)
    changed[1:] = (codes[1:] != codes[:-1]).any(axis=1)
    texts = log.texts.get(f"/{name}/event", [])
    at = [decode(MESSAGES["Event"], one)["t"] for one in texts]
    changed[np.isin(t, at)] = True
    done, topic = 0, f"/{name}/tick"
    for k in np.flatnonzero(changed):
        while done < len(texts) and at[done] <= t[k]:
            reader.message(f"/{name}/event", "Event", texts[done])
            done += 1
        yield reader.read.tick(topic, ticks[k].tobytes())


def _paces(log: Columns, name: str, reader: TypedRows) -> list[tuple[float, SeenPace]]:
    rows = log.rows.get(f"/{name}/pace")
    found = []
    for row in [] if rows is None else rows:
        one = reader.message(f"/{name}/pace", "Pace", row.tobytes())
        assert isinstance(one, SeenPace)
        found.append((float(row["t"]), one))
    return found


def _wires(rows: Any, paces: list[tuple[float, SeenPace]]) -> Array:
    """The columns of `VehicleHistory.wires`."""
    if rows is None:
        return np.zeros((0, 5))
    columns = [(t, p.late_s, _or_nan(p.setpoint_delay_s), lost_share(p)) for t, p in paces]
    return np.column_stack((np.array(columns).reshape(-1, 4), rows["pose_to_valve_s"]))


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def lost_share(pace: SeenPace) -> float:
    """Share of the setpoints so far that were lost."""
    return pace.setpoints_lost / max(1, pace.setpoints_heard + pace.setpoints_lost)


def camera_events(paces: Iterable[tuple[float, SeenPace]], before: str = "") -> list[FlightEvent]:
    """Changes of the camera fault and their times [s]; `before` is the previous one."""
    found = []
    for t, pace in paces:
        if pace.cameras != before:
            found.append(FlightEvent(t, "cameras", pace.cameras or "well again"))
        before = pace.cameras
    return found


def events(ticks: Iterable[Tick]) -> list[FlightEvent]:
    """Changes reported by gate, fault table and filter, and their times [s].

    A response is listed with the active rows of the fault table, and again when a row is added.
    """
    found: list[FlightEvent] = []
    shut, fault, response, kept = None, None, Response.NONE, ""
    held: frozenset[str] = frozenset()
    for tick in ticks:
        t, out = tick.inputs.t, tick.outputs
        hazard = out.filtered.words if out.filtered else ""
        if (why := out.inhibit_reason) != shut:
            words = "" if why is None or why.code in LATCHED else why.words
            found.append(FlightEvent(t, "flies" if why is None else "valves shut", words))
        fresh = tuple(row for row in out.faults if row not in held)
        if out.response and (fresh or out.response != response):
            rows = fresh or out.faults
            found.append(FlightEvent(t, out.response.words, ", ".join(rows), rows=rows))
        elif response == Response.HOLD and not out.response:
            found.append(FlightEvent(t, "goes on"))
        if out.fault is not None and out.fault != fault:
            found.append(FlightEvent(t, "fault", out.fault.words, out.fault))
        if hazard and hazard != kept:
            found.append(FlightEvent(t, "filter", hazard))
        shut, fault, response, kept = why, out.fault, out.response, hazard
        held = frozenset(out.faults)
    return found
