"""The interface of all rigs: twin, bench and table."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

from testbed.config import Experiment
from testbed.core.codes import FaultId, FaultReport
from testbed.core.jets import JetHealth
from testbed.core.law import Concern
from testbed.flight.arming import Check
from testbed.flight.loop import Ending, Observer
from testbed.flight.supervisor import Supervisor
from testbed.metrics.afterwards import After
from testbed.metrics.run_metrics import Consumption, Touch, Track
from testbed.rig.firmware_boards import Valves


class Rig(Protocol):
    """An experiment on a rig, ready to fly."""

    @property
    def experiment(self) -> Experiment:
        """The experiment of this flight."""
        ...

    @property
    def name(self) -> str:
        """`twin`, `bench` or `table`."""
        ...

    @property
    def now(self) -> float:
        """Time of the run [s]."""
        ...

    @property
    def began_ns(self) -> int | None:
        """UTC at time 0 of the run, once that is known [ns]; None: virtual time."""
        ...

    @property
    def touches(self) -> list[Touch]:
        """Contacts so far; empty on a rig that cannot measure them."""
        ...

    @property
    def supervisor(self) -> Supervisor:
        """The supervisor, which decides whether vehicles may fire."""
        ...

    @property
    def red(self) -> list[Check]:
        """Arming checks that kept the run from starting."""
        ...

    def fly(self, observer: Observer, stopped: Callable[[], int] = lambda: 0) -> Ending:
        """Fly to the end, to a fault, or until `stopped()`; it returns the number of stops."""
        ...

    def come_to_rest(
        self, ending: Ending, observer: Observer, stopped: Callable[[], int] = lambda: 0
    ) -> After | None:
        """After `fly`: bring every vehicle to rest and judge the minute after the flight.

        Metrics of the flight itself are taken before. None: the rig does not know the truth.
        """
        ...

    def track(self) -> Track:
        """True poses of the vehicles so far, or the best estimate of them."""
        ...

    def truth(self) -> Iterator[tuple[str, list[float]]]:
        """Each vehicle and its true x, y, theta, vx, vy, omega now, if the rig knows them."""
        ...

    def valves(self, since: float) -> Iterator[tuple[str, Valves]]:
        """Valve outputs of each vehicle's board after `since` [s], if it reports them."""
        ...

    @property
    def loop(self) -> tuple[float, float] | None:
        """Lateness and duration of the newest tick [s]; None: virtual time."""
        ...

    def paces(self) -> Iterator[tuple[str, float, Any]]:
        """Each vehicle's `Pace` reports and their times since the last call, on real wires."""
        ...

    def spent(self, name: str) -> Consumption:
        """Consumption of a vehicle so far."""
        ...

    def jets(self, name: str) -> tuple[JetHealth, ...]:
        """A vehicle's jets as it knows them at the end; empty: not known."""
        ...

    def wires(self) -> dict[str, Any]:
        """Network and timing entries of metrics.json; empty on the twin."""
        ...

    def concerns(self) -> list[Concern]:
        """Concerns that the laws in this process report, and what the vehicles have noticed."""
        ...


def holds(experiment: Experiment, ending: Ending) -> bool:
    """Whether vehicles hold position after this flight: only after a planned end."""
    planned = ending.fault is None and ending.t >= experiment.end_s
    return planned and experiment.flight.ending.after == "hold"


def not_armed(red: Sequence[Check]) -> FaultReport:
    """The report of a run that was not started."""
    return FaultReport(FaultId.NOT_STARTED, "not started: " + "; ".join(one.words for one in red))
