"""Judges a flight: the numbers of metrics.json and the criteria that were met."""

from collections.abc import Mapping

from msgspec.structs import replace

from testbed.config.experiment import Experiment
from testbed.config.guarantee import warnings_of
from testbed.config.unmeasured import without_number
from testbed.core.codes import FaultId
from testbed.flight.loop import Ending
from testbed.metrics.formation import formation_metrics
from testbed.metrics.run_metrics import (
    Aim,
    Consumption,
    Metrics,
    ReferenceLog,
    Track,
    VehicleMetrics,
    judge,
    judge_formation,
    obstacle_distances,
    smallest_separation,
    vehicle_metrics,
)
from testbed.metrics.touching import nearest_obstacles, nearest_vehicles
from testbed.report.goal_error import goal_at
from testbed.rig.chain import formation_context
from testbed.rig.interface import Rig


def measure(
    rig: Rig,
    references: Mapping[str, ReferenceLog],
    ending: Ending,
    wall: float,
    *,
    completed: bool,
) -> Metrics:
    """Judge a flight.

    Args:
        rig: the rig that flew; its true states are judged.
        references: the references of each vehicle.
        ending: how the flight ended.
        wall: wall-clock duration [s].
        completed: the flight reached its end.
    """
    experiment, track = rig.experiment, rig.track()
    obstacles, touches = experiment.obstacles, rig.touches
    radii = {name: setup.model.radius for name, setup in experiment.vehicles.items()}
    vehicles, clear = {}, True
    for k, name in enumerate(experiment.vehicles):
        sampled = obstacle_distances(track, k, obstacles)
        distances = nearest_obstacles(sampled, touches, name, radii[name], obstacles)
        vehicles[name] = measure_vehicle(
            experiment,
            name,
            track,
            references[name].aim(),
            rig.spent(name),
            distances,
            ending.t if completed else 0.0,
        )
        clear &= all(distance >= obstacles[n].radius for n, distance in distances.items())
    # ended by an operator, or never started: not judged
    fault = ending.fault
    is_judged = not rig.red and (completed if fault is None else fault.id != FaultId.STOPPED)
    context = formation_context(experiment)
    together = formation_metrics(experiment.controller, context, track, touches)
    wanted = experiment.criteria.formation
    return Metrics(
        experiment=experiment.name,
        rig=rig.name,
        seed=experiment.seed,
        completed=completed,
        duration_s=ending.t,
        wall_s=wall,
        real_time_factor=ending.t / wall if wall > 0.0 else None,
        contacts=len(touches),
        min_vehicle_distance_m=nearest_vehicles(smallest_separation(track), touches, radii),
        fault=ending.fault.words if ending.fault else None,
        fault_report=ending.fault,
        fault_t=ending.found_t,
        criteria=judge(experiment.criteria, vehicles, len(touches), clear)
        | (judge_formation(wanted, together) if wanted else {})
        if is_judged
        else None,
        vehicles=vehicles,
        **rig.wires(),
        formation=together,
        warnings=[*warnings_of(experiment), *rig.concerns()],
        phase=rig.supervisor.phase,
        red=rig.red,
        touches=touches,
    )


def measure_vehicle(
    experiment: Experiment,
    name: str,
    track: Track,
    aimed: Aim,
    spent: Consumption,
    distances: Mapping[str, float],
    completed_s: float,
) -> VehicleMetrics:
    """Metrics of one vehicle; None for those that do not apply to its goal.

    Args:
        experiment: that was flown.
        name: of the vehicle.
        track, aimed, spent, distances, completed_s: see `vehicle_metrics`.
    """
    setup, k = experiment.vehicles[name], list(experiment.vehicles).index(name)
    goal = setup.goal
    if len(track.t):
        x, y = goal_at(setup, track.t[-1:])[0].tolist()
        goal = (x, y, goal[2])
    found = vehicle_metrics(track, k, goal, aimed, spent, distances, completed_s)
    return replace(found, **dict.fromkeys(without_number(experiment, name)))
