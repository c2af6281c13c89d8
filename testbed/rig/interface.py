"""What flies an experiment, whatever it is made of."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

from testbed.config import Experiment
from testbed.core.law import Concern
from testbed.flight.loop import Ending, Observer
from testbed.flight.supervisor import Supervisor
from testbed.metrics.afterwards import After
from testbed.metrics.run_metrics import Consumption, Touch, Track
from testbed.rig.boards import Valves


class Rig(Protocol):
    """An experiment on a rig, ready to fly."""

    @property
    def experiment(self) -> Experiment:
        """What is flown."""
        ...

    @property
    def name(self) -> str:
        """Of the rig."""
        ...

    @property
    def now(self) -> float:
        """Time of the run [s]."""
        ...

    @property
    def touches(self) -> list[Touch]:
        """Contacts so far, as far as anybody can know."""
        ...

    @property
    def supervisor(self) -> Supervisor:
        """Who may fire."""
        ...

    @property
    def red(self) -> list[str]:
        """Arming checks that kept the run from starting."""
        ...

    def fly(self, observer: Observer, stopped: Callable[[], int] = lambda: 0) -> Ending:
        """Fly to the end, to a fault, or until `stopped()`, which counts how often."""
        ...

    def come_to_rest(
        self, ending: Ending, observer: Observer, stopped: Callable[[], int] = lambda: 0
    ) -> After | None:
        """After `fly`: see that every vehicle stands, and what a minute makes of it.

        What is measured of the flight itself is measured before. None where nobody knows the truth.
        """
        ...

    def track(self) -> Track:
        """Where the vehicles really were so far, or what comes nearest to it."""
        ...

    def truth(self) -> Iterator[tuple[str, list[float]]]:
        """Each vehicle and its true x, y, theta, vx, vy, omega now, where somebody knows."""
        ...

    def valves(self, since: float) -> Iterator[tuple[str, Valves]]:
        """What each vehicle's board drove after `since` [s], where it reports that."""
        ...

    @property
    def loop(self) -> tuple[float, float] | None:
        """How late the newest tick began and how long it took [s], by a real clock."""
        ...

    def paces(self) -> Iterator[tuple[str, float, Any]]:
        """What each vehicle said of its wires since the last call, and when, where it has any."""
        ...

    def spent(self, name: str) -> Consumption:
        """What a vehicle has used so far."""
        ...

    def wires(self) -> dict[str, Any]:
        """What metrics.json says of the wires; nothing where there are none."""
        ...

    def concerns(self) -> list[Concern]:
        """What the laws have to say of the flight, where they run in this process."""
        ...


def not_armed(reasons: Sequence[str]) -> str:
    """What a run that was not started says instead of a fault."""
    return "not started: " + "; ".join(reasons)
