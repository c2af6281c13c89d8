"""A paper's experiment on the twin of the table, with the complete control chain.

Measures are those of the worst vehicle, one value per seed: those of `VehicleMetrics` in
`testbed.metrics.run_metrics`, and `contacts`, `fault` (1 if there was one), `vehicles_m` (least
distance of two vehicles).
"""

import numpy as np
from msgspec import Struct

from testbed.config import Experiment, find, load
from testbed.metrics.run_metrics import (
    Track,
    VehicleMetrics,
    obstacle_distances,
    smallest_separation,
    vehicle_metrics,
)
from testbed.report.goal_error import goal_at
from testbed.reproduction.figure import Figure, Reading
from testbed.reproduction.targets import Measures
from testbed.rig.observers import MetricsObserver
from testbed.rig.twin import make_twin

SMALLEST = ("min_obstacle_distance_m",)  # measures whose worst value is the smallest


class TableRun(Struct, frozen=True, forbid_unknown_fields=True, tag="table"):
    """An experiment with overrides."""

    experiment: str
    overrides: tuple[str, ...] = ()
    seeds: int = 3
    quick_seeds: int = 1
    corrections: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()


def fly_seed(run: TableRun, seed: int) -> tuple[dict[str, float | None], list[Figure]]:
    """Fly once; returns measures and figures."""
    alone = "flight.barrier.on=false"  # tests the law without the safety filter
    experiment = load(find(run.experiment), [*run.overrides, alone, f"seed={seed}"])
    rig, judge = make_twin(experiment), MetricsObserver(experiment.vehicles)
    ending = rig.fly(judge)
    track = rig.track()
    judged = [
        vehicle_metrics(
            track, k, setup.goal, judge.aims[name].aim(), rig.spent(name),
            obstacle_distances(track, k, experiment.obstacles),
            ending.t if ending.fault is None else 0.0,
        )
        for k, (name, setup) in enumerate(experiment.vehicles.items())
    ]  # fmt: skip
    found: dict[str, float | None] = {}
    for what in VehicleMetrics.__struct_fields__:
        values = [getattr(one, what) for one in judged]
        known = [float(value) for value in values if value is not None]
        pick = min if what in SMALLEST else max
        found[what] = pick(known) if len(known) == len(values) else None
    found["contacts"] = float(len(rig.twin.plant.touches))
    found["fault"] = float(ending.fault is not None)
    found["vehicles_m"] = smallest_separation(track)
    return found, figures_of(experiment, track)


def figures_of(experiment: Experiment, track: Track) -> list[Figure]:
    """The paths with the obstacles, and distances to obstacles and goals over time."""
    t, ways, gaps, errors = track.t[::10], {}, {}, {}
    for k, (name, setup) in enumerate(experiment.vehicles.items()):
        p = track.states[::10, k, :2]
        ways[name] = (p[:, 0], p[:, 1])
        errors[name] = (t, np.hypot(*(p - goal_at(setup, t)).T))
        centres = [np.array(o.position) + np.outer(t, o.velocity)
                   for o in experiment.obstacles.values()]  # fmt: skip
        if centres:
            gaps[name] = (t, np.min([np.hypot(*(p - c).T) for c in centres], axis=0))
    circles = tuple((*o.position, o.radius) for o in experiment.obstacles.values())
    found = [
        Figure("obstacle avoidance trajectory", "x [m]", "y [m]", ways, dots=True, circles=circles,
               readings=(Reading(("vehicles_m", "contacts"), ""),)),
        Figure("distance to the goal", "time [s]", "distance [m], log scale", errors, log=True,
               readings=(Reading(("hold_rms_m", "final_error_m")), Reading(("settle_s",), "x"))),
    ]  # fmt: skip
    if gaps:
        found.insert(1, Figure("distance to the nearest obstacle", "time [s]", "distance [m]", gaps,
                               readings=(Reading(("min_obstacle_distance_m",)),)))  # fmt: skip
    return found


def run_table(run: TableRun, *, quick: bool) -> tuple[Measures, list[Figure]]:
    """Fly all seeds on the twin and return their measures."""
    flown = [fly_seed(run, seed) for seed in range(run.quick_seeds if quick else run.seeds)]
    return {name: [found[name] for found, _ in flown] for name in flown[0][0]}, flown[0][1]
