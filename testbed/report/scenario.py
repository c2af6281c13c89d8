"""The interface of an experiment for reports and the dashboard.

`testbed.config.Experiment` implements it. Reports and the dashboard are below the configuration in
the import order and cannot import it.
"""

from collections.abc import Mapping
from pathlib import PurePath
from typing import Protocol

from msgspec import Struct

from testbed.core.path import Path
from testbed.core.table import Obstacle, Table
from testbed.core.vehicle import Vehicle
from testbed.flight.faults import FaultTable
from testbed.flight.guidance import GuidanceParams
from testbed.flight.parameters import FlightParams
from testbed.metrics.run_metrics import Criteria


class Setup(Protocol):
    """One vehicle of a scenario."""

    @property
    def model(self) -> Vehicle:
        """The vehicle's parameters."""
        ...

    @property
    def start(self) -> tuple[float, float, float]:
        """Start pose: x, y [m], theta [rad]."""
        ...

    @property
    def goal(self) -> tuple[float, float, float]:
        """Goal pose: x, y [m], theta [rad]."""
        ...

    @property
    def path(self) -> Path | None:
        """Path of the goal; None: the goal is fixed."""
        ...


class Scenario(Protocol):
    """An experiment: vehicles, table, law and criteria."""

    @property
    def name(self) -> str:
        """Name of the experiment."""
        ...

    @property
    def description(self) -> str:
        """Description in one line."""
        ...

    @property
    def duration_s(self) -> float:
        """Planned duration [s]."""
        ...

    @property
    def seed(self) -> int:
        """Random seed of the twin."""
        ...

    @property
    def table(self) -> Table:
        """The table."""
        ...

    @property
    def obstacles(self) -> Mapping[str, Obstacle]:
        """Obstacles by name."""
        ...

    @property
    def vehicles(self) -> Mapping[str, Setup]:
        """Vehicles by name."""
        ...

    @property
    def controller(self) -> Struct:
        """The law's parameters."""
        ...

    @property
    def flight(self) -> FlightParams:
        """Parameters of the control chain on board."""
        ...

    @property
    def guidance(self) -> GuidanceParams:
        """Parameters of the guidance, which runs the law."""
        ...

    @property
    def faults(self) -> FaultTable:
        """Detected faults and the responses to them."""
        ...

    @property
    def criteria(self) -> Criteria:
        """Criteria of a passed run."""
        ...


def law_of(scenario: Scenario) -> str:
    """The law's name in an experiment file; for a user-defined law, its file and name."""
    own = getattr(scenario.controller, "law", None)
    if isinstance(own, str):
        return PurePath(own).name
    return str(type(scenario.controller).__struct_config__.tag)


def range_of(scenario: Scenario) -> float | None:
    """Communication range that the law assumes [m]; None if it assumes none."""
    formation = getattr(scenario.controller, "formation", scenario.controller)
    found = getattr(formation, "range", None)
    scale = getattr(scenario.controller, "scale", None)
    if not isinstance(found, float):
        return None
    return found / scale.length if scale is not None else found
