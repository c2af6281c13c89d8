"""The twin driven tick by tick, by a loop of one's own."""

from collections.abc import Mapping

from msgspec.structs import replace

from sim_twin.twin import Twin as Table
from sim_twin.twin import TwinPoses, TwinThrusters
from testbed.config import Deploy, Experiment
from testbed.core.error import TestbedError
from testbed.core.types import Demand, LawMessage, Pose, Setpoint, State, Tick
from testbed.flight.agent import lead_time
from testbed.flight.loop import VehicleNode
from testbed.rig.chain import make_agent


class Twin:
    """The simulated table and the flight chains of its vehicles; your code is the law.

    Each `step` is one jet period. The chain is the one that flies everywhere: the estimator hears
    noisy cameras, the safety filter and the gate act, and the forces become valve pulses.

    Args:
        experiment: from `testbed.load`; its law is not asked.

    Attributes:
        t: time of the next tick [s].
        period: of a tick [s].
    """

    def __init__(self, experiment: Experiment) -> None:
        setups = experiment.vehicles
        self.t, self.period, self._k = 0.0, experiment.flight.jet_period_s, 0
        self._lead = {name: lead_time(setup.model) for name, setup in setups.items()}
        self._heading = {name: setup.goal[2] for name, setup in setups.items()}
        self._table = Table(
            {name: setup.model for name, setup in setups.items()},
            {name: Pose(*setup.start) for name, setup in setups.items()},
            experiment.table, experiment.obstacles, experiment.seed,
            listeners=list(setups), drivers=None, injections=[],
        )  # fmt: skip
        self._links = {name: _Link() for name in setups}
        chain = replace(experiment, deploy=Deploy(law="host"))
        self._nodes = [
            VehicleNode(
                name, make_agent(chain, name), TwinPoses(self._table, name),
                TwinThrusters(self._table, name), self._links[name],
            )
            for name in setups
        ]  # fmt: skip

    def step(self, forces: Mapping[str, tuple[float, ...]]) -> dict[str, Tick]:
        """Fly one jet period.

        Args:
            forces: of each vehicle, fx and fy in the table frame [N], and the heading to hold
                [rad] if it is not the goal's. A vehicle that is not named gets no force.

        Returns:
            What each vehicle knew and did in this tick: `tick.outputs.state.pose`.

        Raises:
            TestbedError: a vehicle that the experiment does not have.
        """
        for name in forces:
            if name not in self._links:
                raise TestbedError(
                    where="Twin.step", expected=f"one of {', '.join(self._links)}",
                    found=repr(name),
                )  # fmt: skip
        for name, link in self._links.items():
            fx, fy, *heading = forces.get(name, (0.0, 0.0))
            theta = float(heading[0]) if heading else self._heading[name]
            at = self.t + self._lead[name]
            link.asked = Demand(
                at, float(fx), float(fy), theta, 0.0, 0.0, at + 2.0 * self.period
            )  # fmt: skip
        ticks = {node.name: node.tick(self.t, armed=True) for node in self._nodes}
        for name, tick in ticks.items():
            for other, link in self._links.items():
                if other != name and tick.outputs.state is not None:
                    link.heard[name] = tick.outputs.state
        self._k += 1
        self.t = self._k * self.period
        self._table.wait_until(self.t)
        return ticks

    def true_state(self, name: str) -> tuple[float, ...]:
        """True x, y, theta, vx, vy, omega of a vehicle now [m, m, rad, m/s, m/s, rad/s]."""
        x: list[float] = self._table.plant.x[self._table.plant.names.index(name)].tolist()
        return tuple(x)

    @property
    def contacts(self) -> int:
        """Number of touches so far."""
        return len(self._table.plant.touches)


class _Link:
    """The vehicle's end of a network that loses nothing: the caller's force, the others' states."""

    def __init__(self) -> None:
        self.asked: Setpoint | None = None
        self.heard: dict[str, State] = {}

    def setpoint(self) -> Setpoint | None:
        return self.asked

    def neighbours(self) -> dict[str, State]:
        return dict(self.heard)

    def publish(self, state: State) -> None:
        return

    def messages(self) -> dict[str, LawMessage]:
        return {}

    def broadcast(self, message: LawMessage) -> None:
        return
