"""The structs of an experiment."""

from typing import Annotated, Literal

from msgspec import Meta, Struct, field
from msgspec.structs import replace

from controllers.catalogue import Controller
from testbed.config.shipped import shipped_faults
from testbed.core.fault_injection import Injection
from testbed.core.path import Path
from testbed.core.table import Obstacle, Table
from testbed.core.vehicle import NonNegative, Positive, Vehicle
from testbed.flight.arming import ArmingParams
from testbed.flight.faults import FaultTable
from testbed.flight.guidance import GuidanceParams
from testbed.flight.parameters import FlightParams
from testbed.metrics.run_metrics import Criteria

Seed = Annotated[int, Meta(ge=0, le=2**63 - 1)]  # the range of integers in TOML


BoardKind = Literal["model", "inproc", "unicorn", "host", "qemu"]


class VehicleSetup(Struct, frozen=True, forbid_unknown_fields=True):
    """One vehicle of an experiment."""

    model: Vehicle
    start: tuple[float, float, float]  # x, y [m], theta [rad]
    goal: tuple[float, float, float]  # at the start of the run
    path: Path | None = None  # motion of the goal


class Deploy(Struct, frozen=True, forbid_unknown_fields=True):
    """Where the law runs, and its limits."""

    law: Literal["host", "vehicle"] = "host"
    law_limit_s: Positive | None = (
        None  # limit of one call of a user's law; null: see call_limit [s]
    )
    law_memory_mb: Positive = 4000.0  # memory that calls of a user's law may add [MB]

    def call_limit(self, jet_period_s: float) -> float:
        """Time after which a call of a law counts as hanging [s]."""
        return self.law_limit_s or max(2.0, 20.0 * jet_period_s)


class Fork(Struct, frozen=True, forbid_unknown_fields=True):
    """A change in flight, on the twin: from the first tick at `at_s` on, other values count."""

    at_s: NonNegative  # [s]
    controller: Controller | None = None  # null: as before
    guidance: GuidanceParams | None = None
    flight: FlightParams | None = None
    seed: Seed | None = None  # of cameras, links and pulses; the true vehicles stay


CHANGEABLE = tuple(one for one in Fork.__struct_fields__ if one != "at_s")


class Experiment(Struct, frozen=True, forbid_unknown_fields=True):
    """Everything a run depends on."""

    name: str
    duration_s: Positive
    table: Table
    vehicles: dict[str, VehicleSetup]
    controller: Controller
    description: str = ""
    seed: Seed = 0
    obstacles: dict[str, Obstacle] = field(default_factory=dict)
    guidance: GuidanceParams = field(default_factory=GuidanceParams)
    flight: FlightParams = field(default_factory=FlightParams)
    deploy: Deploy = field(default_factory=Deploy)
    criteria: Criteria = field(default_factory=Criteria)
    arming: ArmingParams = field(default_factory=ArmingParams)
    board: BoardKind = "model"  # what executes the valve plans, see rig/boards.py
    faults: FaultTable = field(default_factory=shipped_faults)
    inject: list[Injection] = []
    forks: list[Fork] = []  # in order of time; `testbed replay --from` adds them

    @property
    def ticks(self) -> int:
        """Number of jet periods of the run."""
        return max(1, round(self.duration_s / self.flight.jet_period_s))

    @property
    def end_s(self) -> float:
        """Duration of the run in whole jet periods [s]."""
        return self.ticks * self.flight.jet_period_s

    def stages(self) -> list[tuple[float, "Experiment"]]:
        """For each fork its time [s], and the experiment from then on."""
        now, found = replace(self, forks=[]), []
        for fork in self.forks:
            values = {key: getattr(fork, key) for key in CHANGEABLE}
            now = replace(now, **{key: v for key, v in values.items() if v is not None})
            found.append((fork.at_s, now))
        return found
