"""Metrics of a run that was killed before it was judged, from its log only.

Impulse, gas, openings and contacts, which only the rig knew, stay unknown; no criterion is judged.
"""

from pathlib import Path

import numpy as np
from msgspec.structs import replace

from testbed.config import Experiment
from testbed.core.codes import FaultId, FaultReport
from testbed.core.types import Tick
from testbed.logs.feed import LogFeed
from testbed.logs.history import Array, History
from testbed.logs.log_reader import LogReader
from testbed.metrics.formation import formation_metrics
from testbed.metrics.run_metrics import (
    Aim,
    Consumption,
    Metrics,
    ReferenceLog,
    Track,
    VehicleMetrics,
    obstacle_distances,
    smallest_separation,
)
from testbed.report.page import read_metrics
from testbed.report.verdict import UNCOUNTED
from testbed.rig.chain import formation_context
from testbed.run.judge import measure_vehicle

LAST_TICKS = 1.5  # the log of a completed flight ends so many before the flight, at most


def judged(folder: Path, log: Path, experiment: Experiment, history: History) -> Metrics:
    """metrics.json of a run, or metrics from its log if the file is missing."""
    if (folder / "metrics.json").exists() or not history.vehicles:
        return read_metrics(folder)
    return of_the_log(log, experiment, history)


def of_the_log(log: Path, experiment: Experiment, history: History) -> Metrics:
    """Metrics from the log only."""
    aims = {name: ReferenceLog() for name in experiment.vehicles}
    book = LogReader(log)
    for one in LogFeed(book).news():
        if isinstance(one.message, Tick) and one.who in aims:
            aims[one.who].note(one.message)
    track = track_of(experiment, history)
    last = experiment.end_s - LAST_TICKS * experiment.flight.jet_period_s
    completed_s = history.end if history.end > last else 0.0
    wires = any(len(vehicle.wires) for vehicle in history.vehicles.values())
    why = "the flight was killed before it was judged; gas and contacts are not in the log"
    if not book.finished:
        why = "the log has no end: its writer was killed, or it is still being flown"
    return Metrics(
        experiment=experiment.name,
        rig="table" if not len(history.true_t) else "bench" if wires else "twin",
        seed=experiment.seed,
        completed=False,
        duration_s=history.end,
        wall_s=0.0,
        real_time_factor=None,
        contacts=UNCOUNTED,
        min_vehicle_distance_m=smallest_separation(track),
        fault=why,
        fault_report=FaultReport(FaultId.PROCESS_ENDED, why),
        criteria=None,
        vehicles={
            name: _vehicle(experiment, name, track, aims[name].aim(), completed_s)
            for name in experiment.vehicles
        },
        formation=formation_metrics(experiment.controller, formation_context(experiment), track),
    )


def _vehicle(
    experiment: Experiment, name: str, track: Track, aimed: Aim, completed_s: float
) -> VehicleMetrics:
    unknown, k = Consumption(0.0, 0.0, None), list(experiment.vehicles).index(name)
    distances = obstacle_distances(track, k, experiment.obstacles)
    found = measure_vehicle(experiment, name, track, aimed, unknown, distances, completed_s)
    return replace(found, impulse_ns=None, gas_g=None)


def track_of(experiment: Experiment, history: History) -> Track:
    """States of all vehicles on common times; NaN for a vehicle without states."""
    t, _ = history.together()
    states = np.full((len(t), len(experiment.vehicles), 6), np.nan)
    for k, name in enumerate(experiment.vehicles):
        if name not in history.vehicles:
            continue
        at, state = history.where(name)
        if len(at):
            state = np.column_stack([state[:, :2], np.unwrap(state[:, 2]), state[:, 3:]])
            columns: list[Array] = [np.interp(t, at, state[:, i]) for i in range(6)]
            states[:, k] = np.stack(columns, axis=1)
    return Track(t, states)
