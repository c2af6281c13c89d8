"""An experiment as those who look on need it.

`testbed.config.Experiment` is one. What looks on lies below the configuration and may not know it.
"""

from collections.abc import Mapping
from pathlib import PurePath
from typing import Protocol

from msgspec import Struct

from testbed.core.path import Path
from testbed.core.table import Obstacle, Table
from testbed.core.vehicle import Vehicle
from testbed.flight.agent import FlightParams
from testbed.flight.faults import FaultTable
from testbed.flight.guidance import GuidanceParams
from testbed.metrics.run_metrics import Criteria


class Setup(Protocol):
    """One vehicle of it."""

    @property
    def model(self) -> Vehicle:
        """What it is."""
        ...

    @property
    def start(self) -> tuple[float, float, float]:
        """Where it starts: x, y [m], theta [rad]."""
        ...

    @property
    def goal(self) -> tuple[float, float, float]:
        """Where it is sent: x, y [m], theta [rad]."""
        ...

    @property
    def path(self) -> Path | None:
        """How the goal moves; null: not at all."""
        ...


class Scenario(Protocol):
    """What is flown, and where."""

    @property
    def name(self) -> str:
        """Of the experiment."""
        ...

    @property
    def description(self) -> str:
        """In one line."""
        ...

    @property
    def duration_s(self) -> float:
        """Planned."""
        ...

    @property
    def seed(self) -> int:
        """Of all chance."""
        ...

    @property
    def table(self) -> Table:
        """What they fly on."""
        ...

    @property
    def obstacles(self) -> Mapping[str, Obstacle]:
        """What stands there."""
        ...

    @property
    def vehicles(self) -> Mapping[str, Setup]:
        """Who flies."""
        ...

    @property
    def controller(self) -> Struct:
        """The law's parameters."""
        ...

    @property
    def flight(self) -> FlightParams:
        """The chain on board."""
        ...

    @property
    def guidance(self) -> GuidanceParams:
        """How the law is flown."""
        ...

    @property
    def faults(self) -> FaultTable:
        """What is watched, and what is done about it."""
        ...

    @property
    def criteria(self) -> Criteria:
        """When it counts as passed."""
        ...


def law_of(scenario: Scenario) -> str:
    """The law's name in an experiment file; of somebody's own, its file and name in there."""
    own = getattr(scenario.controller, "law", None)
    if isinstance(own, str):
        return PurePath(own).name
    return str(type(scenario.controller).__struct_config__.tag)


def range_of(scenario: Scenario) -> float | None:
    """How far vehicles hear each other by the law's own account; None where it has no say [m]."""
    formation = getattr(scenario.controller, "formation", scenario.controller)
    found = getattr(formation, "range", None)
    scale = getattr(scenario.controller, "scale", None)
    if not isinstance(found, float):
        return None
    return found / scale.length if scale is not None else found
