"""The fixed part of the operator's page: table, obstacles, vehicles, goals and planned paths."""

from typing import Any

import numpy as np

from testbed.config import Experiment
from testbed.console.controls import sliders
from testbed.report.goal_error import GoalError, goal_at
from testbed.report.law import law_of, range_of

POINTS = 121  # of a planned path


def scene(scenario: Experiment) -> dict[str, Any]:
    """Table, obstacles and vehicles, which the page draws once."""
    width, height = scenario.table.size
    reach = max(one.model.radius for one in scenario.vehicles.values())
    reach += scenario.flight.gate.fence_margin
    goal_error = GoalError(scenario)
    t = np.linspace(0.0, scenario.duration_s, POINTS)
    led = goal_error.leader_at(t) if goal_error.led else None
    return {
        "name": scenario.name,
        "description": scenario.description,
        "law": law_of(scenario),
        "sliders": sliders(scenario),
        "duration": scenario.duration_s,
        "size": [width, height],
        "fence": [width / 2 - reach, height / 2 - reach],
        "range": range_of(scenario),
        "edges": [[a, b] for a, b, _ in goal_error.edges],
        "leader": None if led is None else _rounded(led),
        "obstacles": [
            {
                "name": name, "at": list(rock.position), "velocity": list(rock.velocity),
                "radius": rock.radius, "solid": rock.solid,
            }
            for name, rock in scenario.obstacles.items()
        ],
        "vehicles": [
            {
                "name": name,
                "radius": setup.model.radius,
                "jets": [[*jet.position, *jet.push] for jet in setup.model.jets],
                "goal": None if goal_error.forms else list(setup.goal),
                "path": None if goal_error.forms or setup.path is None
                else _rounded(goal_at(setup, t)),
            }
            for name, setup in scenario.vehicles.items()
        ],
    }  # fmt: skip


def _rounded(points: Any) -> list[list[float]]:
    return [[round(x, 3), round(y, 3)] for x, y in points.tolist()]
