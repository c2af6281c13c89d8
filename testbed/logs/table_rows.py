"""Rows of the log from ticks that are rows of a table, column by column.

The numbers of a tick's record are eight bytes each, and so are most of the log's row, so one
indexed copy moves them all. The result is that of `tick_row.py` for the same ticks, byte for byte.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from testbed.core.codes import InhibitReason, Intervention
from testbed.core.records.definition import DTYPES, MESSAGES
from testbed.core.records.kinds import Active, SetpointKind
from testbed.core.records.layout import COUNT, SPARE, WORD, Layout, Rows
from testbed.flight.flown_span import FlownHostRows, FlownRows, FlownSpan
from testbed.flight.record import ROW
from testbed.flight.tick_table import REFERENCES, SAMPLES, STATES
from testbed.logs.frames import Stack
from testbed.logs.tick_row import RowWriter, value_of

Array = NDArray[np.float64]

_HEALTH = "supply_pressure", "tank_pressure", "battery", "silent_s"
_VITALS = "operator_age", "clock_offset", "late_s", "disk_free"
_MOTION = (
    ("pose.x", "x"), ("pose.y", "y"), ("pose.theta", "theta"),
    ("twist.vx", "vx"), ("twist.vy", "vy"), ("twist.omega", "omega"),
)  # fmt: skip
_DEMAND = ("t", "fx_w", "fy_w", "theta", "omega", "alpha", "valid_until")
_OF_SETPOINT = ("t", "fx", "fy", "theta", "omega", "alpha", "valid_until")
_AXES = ("fx", "fy", "tau")

# numbers of the log's row, and where the record has them
SAME = {
    "inputs.t": "inputs.t",
    "inputs.health.t": "inputs.t",
    **{f"inputs.health.{one}": f"inputs.{one}" for one in _HEALTH},
    **{f"inputs.vitals.{one}": f"inputs.{one}" for one in _VITALS},
    "outputs.t": "inputs.t",
    "outputs.issued_at": "inputs.t",
    **{f"outputs.commanded_wrench.{one}": f"outputs.commanded.{one}" for one in _AXES},
    **{f"outputs.realised_wrench.{one}": f"outputs.realised.{one}" for one in _AXES},
}
STATE = {
    "outputs.state.t": "state.t",
    **{f"outputs.state.{one}": f"state.{other}" for one, other in _MOTION},
    **{f"outputs.state.bias.{one}": f"state.{one}" for one in ("ax", "ay", "alpha")},
    "outputs.state.pose_age": "state.pose_age",
}
REFERENCE = {
    "outputs.reference.t": "outputs.active.t",
    **{f"outputs.reference.{one}": f"outputs.active.{other}" for one, other in _MOTION},
    **{f"outputs.reference.accel.{one}": f"outputs.active.{one}" for one in ("ax", "ay", "alpha")},
}
_PAIRS = tuple(zip(_DEMAND, _OF_SETPOINT, strict=True))
DEMAND = {f"outputs.demand.{one}": f"inputs.setpoint.{other}" for one, other in _PAIRS}
ASKED = {f"inputs.setpoint.demand.{one}": f"inputs.setpoint.{other}" for one, other in _PAIRS}
UNTIL = {"inputs.setpoint.valid_until": "inputs.setpoint.valid_until"}

_WORDS = np.zeros(max(InhibitReason) + 1, np.int64)  # values in the words of each reason
for _one in InhibitReason:
    _WORDS[_one] = _one.words.count("{")


def place(dtype: np.dtype, path: str) -> int:
    """The place of a number in a record, in words."""
    at = 0
    for name in path.split("."):
        assert dtype.fields is not None
        dtype, offset = dtype.fields[name][:2]
        at += offset
    return at // WORD


class Columns:
    """Numbers that the rows of a message share with others: places in words."""

    def __init__(self, message: str, to: Iterable[str], of: Sequence[int]) -> None:
        fixed = DTYPES[message]
        self.to = _index([1 + place(fixed, one) for one in to])  # after the header's word
        self.of = _index(of)

    def copy(self, words: Array, records: Array, where: NDArray[np.bool_] | None = None) -> None:
        """Copy these numbers; where not `where`, they are unknown."""
        if where is not None and not where.any():
            words[:, self.to] = np.nan
            return
        values = records[:, self.of]
        if where is not None and not where.all():
            values = np.where(where[:, None], values, np.nan)
        words[:, self.to] = values


def _index(places: Sequence[int]) -> slice | NDArray[np.int64]:
    """An index of these places; a slice, which is faster, if they follow one another."""
    first, after = places[0], places[0] + len(places)
    return slice(first, after) if [*places] == [*range(first, after)] else np.array(places)


_SAME, _STATE, _REFERENCE, _DEMANDS, _ASKED, _UNTIL = (
    Columns("Tick", pairs, [place(ROW, one) for one in pairs.values()])
    for pairs in (SAME, STATE, REFERENCE, DEMAND, ASKED, UNTIL)
)
# of the host's row: the vehicle's state in the order of rows.States, and the setpoint's numbers
_OWN = Columns("HostTick", [one.replace("outputs.state", "inputs.own") for one in STATE], range(11))
_HOST_DEMAND = Columns(
    "HostTick", [f"outputs.setpoint.demand.{one}" for one in _DEMAND], (1, 3, 4, 5, 6, 7, 2)
)
_HOST_UNTIL = Columns("HostTick", ["outputs.setpoint.valid_until"], (2,))


class TableRows:
    """Makes the messages of one topic."""

    def __init__(self, writer: RowWriter, topic: str) -> None:
        self._writer, self._topic = writer, topic

    def truth(self, spans: Sequence[FlownSpan]) -> Stack:
        """The messages of the true states at the ticks of these spans."""
        states = np.concatenate([span.truth for span in spans])
        n, vehicles, _ = states.shape
        packer, names = self._writer.packer(self._topic, "Truth"), self._writer.names
        packer.grow([max(packer.most[0], vehicles)])
        names.vehicles += [one for one in spans[0].vehicles if one not in names.vehicles]
        rows = Layout("Truth", {"vehicles": packer.most[0]}).rows(n)
        rows.fixed["t"][:n] = [t for span in spans for t in span.times]
        _fill(rows, "vehicles", states, np.full(n, vehicles))
        return _stack(rows, n)

    def messages(self, ticks: FlownRows | FlownHostRows) -> list[Stack]:
        """The messages of ticks."""
        make: Callable[..., None] = self._tick
        name, longest = "Tick", _longest(ticks)
        if isinstance(ticks, FlownHostRows):
            name, make = "HostTick", self._host
        packer, begin, made = self._writer.packer(self._topic, name), 0, []
        so_far, ends = np.array([packer.most]), [len(ticks)]
        if (longest.max(axis=0) > packer.most).any():
            so_far = np.maximum.accumulate(np.vstack((packer.most, longest)))[1:]
            ends = [*(1 + np.flatnonzero(np.diff(so_far, axis=0).any(axis=1))), len(ticks)]
        for end in ends:
            packer.grow(so_far[begin].tolist())  # a capacity grows with the first that needs it
            some = ticks.part(begin, int(end))
            rows = _layout(name, *packer.most).rows(len(some))
            make(rows, some, some.rows)
            made.append(_stack(rows, len(some)))
            begin = int(end)
        return made

    def _tick(self, rows: Rows, ticks: FlownRows, k: slice) -> None:
        table, n = ticks.table, len(ticks)
        counts, jets = table.counts[k], table.plans.shape[1] // 2
        self._fixed(rows, ticks, table.records[k], table.values[k])
        _fill(rows, "samples", table.samples[k], counts[:, SAMPLES])
        _fill(rows, "references", table.references[k], counts[:, REFERENCES])
        _fill_neighbours(rows, table.states[k], table.vehicles[k], counts[:, STATES])
        part = rows.layout.part("pulses")
        rows.counts(part)["valid"][:n] = jets
        pulses = rows.elements(part)[:n]
        pulses["on_us"][:, :jets] = table.plans[k, :jets]
        pulses["offset_us"][:, :jets] = table.plans[k, jets:]

    def _host(self, rows: Rows, ticks: FlownHostRows, k: slice) -> None:
        table, n = ticks.table, len(ticks)
        states, ahead = table.counts[k].T
        words, kind = rows.memory.view(np.float64)[:n], table.setpoints[k, 0]
        inputs, outputs = rows.fixed["inputs"][:n], rows.fixed["outputs"][:n]
        inputs["t"] = outputs["t"] = table.t[k]
        _OWN.copy(words, table.own[k])
        inputs["own"]["rejected"], inputs["own_known"] = table.own[k, -1], 1
        _HOST_DEMAND.copy(words, table.setpoints[k], kind == SetpointKind.DEMAND)
        _HOST_UNTIL.copy(words, table.setpoints[k], kind == SetpointKind.TRAJECTORY)
        outputs["setpoint"]["kind"], outputs["message_t"] = kind, np.nan
        for i, filtered in ticks.notes.items():
            self._intervene(outputs["filtered"][i : i + 1], filtered)
        _fill(rows, "references", table.references[k], ahead)
        _fill_neighbours(rows, table.states[k], table.vehicles[k], states)

    def _intervene(self, row: NDArray, filtered: Intervention | None) -> None:
        row["dfx_w"], row["dfy_w"], row["subject"], row["hazard"] = self._writer.filtered(filtered)

    def _fixed(self, rows: Rows, ticks: FlownRows, records: NDArray, values: Array) -> None:
        n, writer = len(ticks), self._writer
        words = rows.memory.view(np.float64)[:n]
        numbers = records.view(np.float64).reshape(n, -1)
        given, state, done = records["inputs"], records["state"], records["outputs"]
        aim, known = given["setpoint"]["kind"], state["known"] == 1
        flown = known & (aim != SetpointKind.NONE)
        demanded = flown & (aim == SetpointKind.DEMAND) & (done["stopping"] == 0)
        _SAME.copy(words, numbers)
        _STATE.copy(words, numbers, known)
        _REFERENCE.copy(words, numbers, flown & ~demanded)
        _DEMANDS.copy(words, numbers, demanded)
        _ASKED.copy(words, numbers, aim == SetpointKind.DEMAND)
        _UNTIL.copy(words, numbers, aim == SetpointKind.TRAJECTORY)
        inputs, outputs = rows.fixed["inputs"][:n], rows.fixed["outputs"][:n]
        inputs["setpoint"]["kind"] = aim
        inputs["armed"], inputs["end"] = given["armed"], given["ended"]
        vitals = inputs["vitals"]
        vitals["foreign"], vitals["session_ok"] = given["foreign"], given["session_ok"]
        vitals["same_config"], vitals["fleet"] = given["same_config"], given["fleet_failed"]
        outputs["state"]["rejected"] = np.where(known, state["rejected"], 0)
        period = ticks.agent.params.gains.period
        outputs["valid_until"] = given["t"] + period
        outputs["message_t"] = np.nan
        outputs["inhibit"], outputs["inhibit_values"] = done["inhibit"], np.nan
        if done["inhibit"].any():
            latched = (done["inhibit"] == done["gate_fault"]) & (done["inhibit"] > 0)
            length = np.where(latched, _WORDS[done["inhibit"]], 0)
            outputs["inhibit_values"] = np.where(np.arange(3) < length[:, None], values, np.nan)
            outputs["inhibit_length"] = length
        outputs["seq"], outputs["response"] = done["seq"], done["response"]
        outputs["state_known"], outputs["air_off"] = known, done["air_off"]
        active = np.where(demanded, Active.DEMAND, Active.REFERENCE)
        outputs["active"] = np.where(flown, active, Active.NONE)
        outputs["fault_value"] = np.nan
        for i, fault in ticks.notes.items():
            outputs["fault"][i] = writer.fault_code(fault)
            outputs["fault_value"][i] = value_of(fault)
        for i in np.flatnonzero(done["holding"]).tolist():
            outputs["faults"][i] = writer.held(ticks[i].outputs.faults)
        for i in np.flatnonzero(done["hazard"] >= 0).tolist():
            self._intervene(outputs["filtered"][i : i + 1], ticks[i].outputs.filtered)


def _stack(rows: Rows, number: int) -> Stack:
    """The messages of the first rows; their memory is not copied."""
    memory = rows.memory[:number]
    return Stack(memory.shape[1], SPARE, memory.reshape(-1).data)


@cache
def _layout(message: str, *most: int) -> Layout:
    """The layout with these capacities of the message's sequences."""
    names = [one.name for one in MESSAGES[message].sequences]
    return Layout(message, dict(zip(names, most, strict=True)))


def _longest(ticks: FlownRows | FlownHostRows) -> NDArray[np.int64]:
    """Elements of each sequence of these ticks' messages, in the order of the message."""
    counts, host = ticks.table.counts[ticks.rows], isinstance(ticks, FlownHostRows)
    found = np.zeros((len(ticks), len(MESSAGES["HostTick" if host else "Tick"].sequences)), int)
    found[:, : counts.shape[1]] = counts
    if isinstance(ticks, FlownRows):
        found[:, counts.shape[1]] = ticks.table.plans.shape[1] // 2  # pulses
    return found


def _fill(rows: Rows, name: str, values: Array, counts: NDArray[np.int64]) -> None:
    """Write the elements of a sequence; `values` are their first numbers, (n, most, numbers)."""
    n, _, width = values.shape
    part = rows.layout.part(name)
    rows.counts(part)["valid"][:n] = counts
    most = min(part.capacity, values.shape[1])
    shape, strides = (n, most, width), (rows.memory.shape[1], part.dtype.itemsize, WORD)
    out: Array = np.ndarray(shape, np.float64, rows.memory, part.offset + COUNT.itemsize, strides)
    out[...] = values[:, :most]
    if counts.min() < most:
        out[_unused(most, counts)] = 0.0  # few: to copy only the used ones takes six times as long


def _unused(most: int, counts: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of the first `most` elements of each row do not exist."""
    return np.arange(most) >= counts[:, None]


def _fill_neighbours(
    rows: Rows, states: Array, vehicles: NDArray[np.int64], counts: NDArray[np.int64]
) -> None:
    """Write the newest states of the others, and whose they are."""
    n, known, _ = states.shape
    _fill(rows, "neighbours", states[:, :, :-1], counts)
    others = rows.elements(rows.layout.part("neighbours"))[:n, :known]
    most = others.shape[1]
    unused = _unused(most, counts)
    others["state"]["rejected"] = np.where(unused, 0, states[:, :most, -1])
    others["vehicle"] = np.where(unused, 0, vehicles[:, :most])
