"""What the laws' proofs ask of an experiment and it does not have: warnings, not mistakes."""

import math

import numpy as np

from controllers.bifurcating import BifurcatingParams
from controllers.bifurcating_design import reaches
from controllers.guarantee import Start, concerns
from testbed.config.experiment import Experiment
from testbed.core.law import Concern, Discs
from testbed.flight.allocation import weakest_force

LOOKS = 200  # at a goal's path, for its largest acceleration


def warnings_of(experiment: Experiment) -> list[Concern]:
    """All that whoever flies it should know beforehand."""
    setups, rocks = list(experiment.vehicles.values()), list(experiment.obstacles.values())
    times = np.linspace(0.0, experiment.duration_s, LOOKS).tolist()
    moves = [s.path.at(0.0).v if s.path else (0.0, 0.0) for s in setups]
    accels = [math.hypot(*s.path.at(t).a) for s in setups if s.path for t in times]
    share = experiment.guidance.force_share
    start = Start(
        np.array([s.model.mass for s in setups]),
        np.array([s.start[:2] for s in setups]),
        np.array([s.goal[:2] for s in setups]),
        np.array(moves),
        max(accels, default=0.0),
        share * min(weakest_force(s.model) for s in setups),
        Discs(
            np.array([rock.position for rock in rocks]).reshape(-1, 2),
            np.array([rock.velocity for rock in rocks]).reshape(-1, 2),
            np.array([rock.radius for rock in rocks]),
        ),
    )
    found = concerns(experiment.controller, list(experiment.vehicles), start)
    return [*found, *_off_the_table(experiment)]


def _off_the_table(experiment: Experiment) -> list[Concern]:
    """Curves of gao2022's field that no table of this size holds; a line has no end."""
    params = experiment.controller
    if not isinstance(params, BifurcatingParams):
        return []
    rim = max(setup.model.radius for setup in experiment.vehicles.values())
    middle = params.centre or (0.0, 0.0)
    for k, phase in enumerate(params.phases):
        for axis, reach in enumerate(reaches(params.field(phase))):
            room = 0.5 * experiment.table.size[axis] - rim
            need = (abs(middle[axis]) + reach) / params.scale.length
            if need > room:
                text = (
                    f"the curve of phases[{k}] goes out to {need:.4g} m along {'xy'[axis]}, a "
                    f"vehicle on this table to {room:.4g} m"
                )
                return [Concern("curve-off-table", text)]
    return []
