"""Warns before a flight: of a proof that does not hold, of obstacles, of missing detectors."""

import math

import numpy as np

from controllers.bifurcating import BifurcatingParams
from controllers.bifurcating_design import reaches
from controllers.guarantee import Bounded, InitialState, Unbounded, concerns
from testbed.config.experiment import Experiment
from testbed.core.codes import Detector
from testbed.core.law import Concern, Discs
from testbed.flight.allocation import weakest_force

SPARE = 1.1  # allowed ratio of mass and force to the design values
ROUNDED = 1e-9  # [m]
LOOKS = 200  # samples of a goal's path, for its largest acceleration


def warnings_of(experiment: Experiment) -> list[Concern]:
    """Warnings before a flight."""
    setups, obstacles = list(experiment.vehicles.values()), list(experiment.obstacles.values())
    times = np.linspace(0.0, experiment.duration_s, LOOKS).tolist()
    moves = [s.path.at(0.0).v if s.path else (0.0, 0.0) for s in setups]
    accels = [math.hypot(*s.path.at(t).a) for s in setups if s.path for t in times]
    share = experiment.guidance.force_share
    start = InitialState(
        np.array([s.model.mass for s in setups]),
        np.array([s.start[:2] for s in setups]),
        np.array([s.goal[:2] for s in setups]),
        np.array(moves),
        max(accels, default=0.0),
        share * min(weakest_force(s.model) for s in setups),
        Discs(
            np.array([obstacle.position for obstacle in obstacles]).reshape(-1, 2),
            np.array([obstacle.velocity for obstacle in obstacles]).reshape(-1, 2),
            np.array([obstacle.radius for obstacle in obstacles]),
        ),
    )
    found = concerns(experiment.controller, list(experiment.vehicles), start)
    found += _unseen(experiment) + _within_reach(experiment) + _unwatched(experiment)
    return [*found, *_field(experiment, start.max_force)]


def _unseen(experiment: Experiment) -> list[Concern]:
    """Warn about obstacles that a formation law ignores."""
    params = experiment.controller
    blind = (
        isinstance(params, BifurcatingParams)
        or (isinstance(params, Bounded) and params.proxy.obstacle_band == 0.0)
        or (isinstance(params, Unbounded) and params.potential.k_o == 0.0)
    )
    if not blind or not experiment.obstacles:
        return []
    text = f"nothing in the law keeps off {', '.join(experiment.obstacles)}"
    return [Concern("obstacles-unseen", text)]


def _within_reach(experiment: Experiment) -> list[Concern]:
    """Warn about solid cores that a vehicle touches although its centre keeps the danger radius."""
    setups, found = experiment.vehicles, []
    widest = max(setups, key=lambda name: setups[name].model.radius)
    wide = setups[widest].model.radius
    for name, obstacle in experiment.obstacles.items():
        touch = obstacle.solid + wide
        if obstacle.solid > 0.0 and touch > obstacle.radius + ROUNDED:
            text = (
                f"{widest} touches the core of {name} at {touch:g} m, and laws and safety filter"
                f" keep its centre only {obstacle.radius:g} m away;"
                f" obstacles.{name}.radius should be {touch:g} m or more"
            )
            found.append(Concern("core-within-reach", text))
    return found


def _unwatched(experiment: Experiment) -> list[Concern]:
    """Warn about detectors without a row in the fault table, e.g. in a user's own file."""
    asked = {row.detector for row in experiment.faults.values()}
    blind = [one.words for one in Detector if one.words not in asked]
    if not blind:
        return []
    return [Concern("faults-unwatched", f"no row of `faults` looks at {', '.join(blind)}")]


def _field(experiment: Experiment, force: float) -> list[Concern]:
    """Warn about differences from the design of gao2022's field."""
    params = experiment.controller
    if not isinstance(params, BifurcatingParams):
        return []
    found = _off_the_table(experiment, params)
    n, mass = len(experiment.vehicles), max(s.model.mass for s in experiment.vehicles.values())
    plan = params.fleet
    if plan and (n != plan.count or mass > SPARE * plan.mass or SPARE * force < plan.force):
        text = (
            f"the field is designed for {plan.count} vehicles of {plan.mass:g} kg that push with "
            f"{plan.force:g} N; here are {n} of up to {mass:.4g} kg and {force:.4g} N"
        )
        found.append(Concern("fleet-differs", text))
    for k, phase in enumerate(params.phases, 1):
        if phase.at >= experiment.duration_s:
            text = (
                f"phases.{k} begins at {phase.at:g} s, the run ends at {experiment.duration_s:g} s"
            )
            found.append(Concern("phase-never-flown", text))
            break
    return found


def _off_the_table(experiment: Experiment, params: BifurcatingParams) -> list[Concern]:
    """Warn about curves that do not fit on the table or inside the law's wall."""
    rim = max(setup.model.radius for setup in experiment.vehicles.values())
    middle = params.centre or (0.0, 0.0)
    for k, phase in enumerate(params.phases):
        for axis, reach in enumerate(reaches(params.field(phase))):
            room = 0.5 * experiment.table.size[axis] - rim
            need = (abs(middle[axis]) + reach) / params.scale.length
            if need > room:
                text = (
                    f"the curve of phases.{k + 1} goes out to {need:.4g} m along {'xy'[axis]}, a "
                    f"vehicle on this table to {room:.4g} m"
                )
                return [Concern("curve-off-table", text)]
            if params.wall and need > params.wall.at / params.scale.length:
                text = f"the curve of phases.{k + 1} goes out to {need:.4g} m, the wall is nearer"
                return [Concern("curve-behind-wall", text)]
    return []
