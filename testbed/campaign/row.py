"""The stored result of a run: flat columns, the same for every run of a campaign.

"sat1.settle_s" is a vehicle's column. Without a name, a column is for all vehicles: the worst error
or distance, the sum of a consumption.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Literal

from msgspec import Struct
from msgspec.structs import replace

from testbed.config import ConfigError, Experiment
from testbed.config.error import did_you_mean
from testbed.core.codes import FaultReport
from testbed.metrics.fault_line import fault_line
from testbed.metrics.run_metrics import Metrics, VehicleMetrics
from testbed.report.verdict import NOTHING_MEASURED, unmeasured

Task = tuple[int, tuple[str, ...]]  # run, "key=value" on top of the base experiment
Number = float | int | None
Outcome = Literal["passed", "failed", "fault", "error", "refused", "lost"]

OUTCOMES = {
    "passed": "flown to the end, all criteria met",
    "failed": "flown to the end, a criterion missed",
    "fault": "ended early, by a fault or an operator",
    "error": "ended by an exception",
    "refused": "its configuration is invalid",
    "lost": "its workers died or did not return, repeatedly",
}

TOGETHER: dict[str, Callable[[Iterable[float]], float]] = {
    "final_error_m": max,
    "settle_s": max,
    "track_rms_m": max,
    "hold_rms_m": max,
    "heading_rms_deg": max,
    "goal_rms_m": max,
    "shape_rms_m": max,
    "min_obstacle_distance_m": min,
    "clearance_m": min,
    "impulse_ns": sum,
    "gas_g": sum,
    "valve_pulses": sum,
    "filtered_ns": sum,
    "max_force_n": max,
}
SINGLE = ("duration_s", "contacts", "min_vehicle_distance_m")  # of the whole run
BESIDE = ("goal_rms_m", "shape_rms_m", "clearance_m")  # not among a vehicle's metrics
OF_A_VEHICLE = (*VehicleMetrics.__struct_fields__, *BESIDE)
COLUMNS = ("run", "outcome", "reason", *SINGLE, *OF_A_VEHICLE)  # beside the file's parameters


class FlownRun(Struct, frozen=True):
    """Outcome and numbers of one run of a campaign."""

    k: int
    outcome: Outcome
    reason: str = ""  # why it did not pass
    columns: dict[str, Number] = {}
    criteria: dict[str, bool] = {}
    wall_s: float = 0.0  # not a column: columns are the same on every machine
    memory_mb: float = 0.0  # peak of the worker so far
    seed: int | None = None  # None: the experiment could not be read
    fault_t: float | None = None  # detection time of the fault that ended the flight [s]
    fault: FaultReport | None = None  # that ended the flight
    limit_s: float | None = None  # of a lost run: how long its workers were waited for [s]

    def explained(self, reason: str) -> str:
        """The reason with the seed that repeats the run, and the time of a fault."""
        if self.fault is not None:
            return fault_line(self.seed, self.fault, self.fault_t)
        return f"seed {self.seed}: {reason}" if self.seed is not None else reason


class Kept(Struct, frozen=True):
    """A run that was flown again for its log."""

    k: int
    files: dict[str, bytes]
    columns: dict[str, Number]


FLOWN = ("passed", "failed")  # outcomes of runs that reached their end


def outcome_of(experiment: Experiment, metrics: Metrics) -> tuple[Outcome, str]:
    """The outcome of a flight, and the reason if it did not pass."""
    if metrics.fault:
        return "fault", metrics.fault
    if not metrics.completed:  # an operator ended it or prevented its start
        return "fault", "not flown to its end"
    failed = [
        f"{name}{_why_not(experiment, metrics, name)}"
        for name, met in (metrics.criteria or {}).items()
        if not met
    ]
    return ("failed", ", ".join(failed)) if failed else ("passed", "")


def _why_not(experiment: Experiment, metrics: Metrics, criterion: str) -> str:
    """Says that a criterion has no number; empty if it has one."""
    if unmeasured(experiment, metrics, criterion):
        return NOTHING_MEASURED
    unreached = any(getattr(one, criterion, 0.0) is None for one in metrics.vehicles.values())
    return " not reached" if unreached else ""


def broken_bound(
    columns: Mapping[str, Number], most: Mapping[str, float], least: Mapping[str, float]
) -> str:
    """The first bound that a run breaks, as text; empty if it keeps all.

    Raises:
        ConfigError: there is no such column.
    """
    for bounds, sign, words in ((most, 1.0, "more"), (least, -1.0, "less")):
        for name, bound in bounds.items():
            value = column(columns, name)
            if value is None:
                return f"{name} does not apply, or was not reached"
            if sign * (value - bound) > 0.0:
                return f"{name} is {value:.4g}, {words} than {bound:g}"
    return ""


def check_columns(where: str, key: str, bounds: Mapping[str, float]) -> None:
    """Refuse a bound that is not finite, or on a column that does not exist.

    Raises:
        ConfigError: there is no such column, or the bound is NaN or infinite.
    """
    known = [*SINGLE, *OF_A_VEHICLE]
    for name, bound in bounds.items():
        if not math.isfinite(bound):
            raise ConfigError(where, f"{key}.{name}", "a finite number", f"{bound:g}")
        vehicle, _, last = name.rpartition(".")
        if last not in known or (vehicle and last in SINGLE):
            found = f"no such column{did_you_mean(last, known)}"
            raise ConfigError(where, f"{key}.{name}", f"one of: {', '.join(known)}", found)


def check_vehicles(where: str, key: str, bounds: Iterable[str], names: Iterable[str]) -> None:
    """Refuse a bound on a vehicle that does not exist.

    Raises:
        ConfigError: there is no such vehicle.
    """
    for bound in bounds:
        vehicle = bound.rpartition(".")[0]
        if vehicle and vehicle not in names:
            found = f"no such vehicle{did_you_mean(vehicle, names)}"
            raise ConfigError(where, f"{key}.{bound}", f"one of: {', '.join(names)}", found)


def column(columns: Mapping[str, Number], name: str) -> Number:
    """The number in a column of a run.

    Raises:
        ConfigError: there is no such column.
    """
    if name not in columns:
        found = f"no such column{did_you_mean(name, columns)}"
        raise ConfigError("cost, most, least", name, f"one of: {', '.join(sorted(columns))}", found)
    return columns[name]


def within(run: FlownRun, most: Mapping[str, float], least: Mapping[str, float]) -> FlownRun:
    """The run; changed to failed if it passed but breaks a bound."""
    reason = broken_bound(run.columns, most, least) if run.outcome == "passed" else ""
    return replace(run, outcome="failed", reason=reason) if reason else run


def columns_of(
    metrics: Metrics, experiment: Experiment, extra: dict[str, dict[str, Number]]
) -> dict[str, Number]:
    """All columns of a flight.

    Args:
        metrics: metrics of the flight.
        experiment: the experiment that was flown.
        extra: by vehicle, numbers that are not among its metrics.
    """
    columns: dict[str, Number] = {
        "duration_s": metrics.duration_s,
        "contacts": metrics.contacts,
        "min_vehicle_distance_m": metrics.min_vehicle_distance_m,
    }
    each: dict[str, dict[str, Number]] = {}
    for vehicle, one in metrics.vehicles.items():
        beside = extra.get(vehicle, {})
        each[vehicle] = {
            name: beside.get(name) if name in BESIDE else getattr(one, name)
            for name in OF_A_VEHICLE
        }
    for name in OF_A_VEHICLE:
        values = [numbers[name] for numbers in each.values()]
        known = [value for value in values if value is not None]
        unsettled = name == "settle_s" and len(known) < len(values)  # a vehicle never settled
        lost = any(math.isnan(value) for value in known)  # `max` and `min` may skip NaN
        columns[name] = TOGETHER[name](known) if known and not unsettled and not lost else None
    if len(experiment.vehicles) > 1:
        for vehicle, numbers in each.items():
            columns |= {f"{vehicle}.{name}": value for name, value in numbers.items()}
    return {name: _finite(value) for name, value in columns.items()}


def _finite(value: Number) -> Number:
    """None for NaN and infinity, which JSON does not have."""
    return value if value is not None and math.isfinite(value) else None
