"""A paper's experiment on the twin of the table, with the complete control chain.

Measures are those of the worst vehicle, one value per seed: those of `VehicleMetrics` in
`testbed.metrics.run_metrics`, and `contacts`, `fault` (1 if there was one), `vehicles_m` (least
distance of two vehicles).
"""

from msgspec import Struct

from testbed.config import find, load
from testbed.metrics.run_metrics import (
    VehicleMetrics,
    obstacle_distances,
    smallest_separation,
    vehicle_metrics,
)
from testbed.reproduction.figure import Figure
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
    ways = {
        name: (track.states[::10, k, 0], track.states[::10, k, 1])
        for k, name in enumerate(experiment.vehicles)
    }
    return found, [Figure("obstacle avoidance trajectory", "x [m]", "y [m]", ways, dots=True)]


def run_table(run: TableRun, *, quick: bool) -> tuple[Measures, list[Figure]]:
    """Fly all seeds on the twin and return their measures."""
    flown = [fly_seed(run, seed) for seed in range(run.quick_seeds if quick else run.seeds)]
    return {name: [found[name] for found, _ in flown] for name in flown[0][0]}, flown[0][1]
