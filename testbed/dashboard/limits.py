"""Limits of the fault table and of the figures, for the dashboard's plots."""

from collections.abc import Iterator
from typing import NamedTuple

from testbed.config.experiment import Experiment
from testbed.report.goal_error import GoalError

MILD = ("warn", "hold")  # responses that do not end the flight


class PlotLimit(NamedTuple):
    """A horizontal line of a plot."""

    plot: str
    key: str  # unique in the plot
    name: str  # of its series
    value: float  # in the plot's unit
    ends: bool  # beyond it the flight ends

    @property
    def path(self) -> str:
        """Entity of the line."""
        return f"plot/{self.plot}/limit_{self.key}"


def plot_limits(scenario: Experiment) -> list[PlotLimit]:
    """All limits that do not change during a flight."""
    goal_error = GoalError(scenario)
    found = [PlotLimit("error", "settled", "settled", 1e3 * goal_error.settled_m, ends=False)]
    if scenario.obstacles:
        found.append(PlotLimit("clearance", "danger_radius", "danger radius", 0.0, ends=True))
    found += _of_table(scenario, "pose_age", "pose_age", 1e3)
    found += _of_table(scenario, "link", "setpoint_age", 1e3)
    pressures = {setup.model.air.set_pressure for setup in scenario.vehicles.values()}
    if len(pressures) == 1:
        found += _of_table(scenario, "supply", "supply_share", 1e-3 * max(pressures))
    return found


def _of_table(scenario: Experiment, plot: str, detector: str, scale: float) -> Iterator[PlotLimit]:
    for name, row in scenario.faults.items():
        limit = row.above if row.above is not None else row.below
        if row.detector == detector and limit is not None:
            ends = row.response not in MILD
            yield PlotLimit(plot, name, f"{row.response} ({name})", scale * limit, ends)
