"""What the laws' proofs ask of an experiment and it does not have: warnings, not mistakes."""

import math

import numpy as np

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
    return concerns(experiment.controller, list(experiment.vehicles), start)
