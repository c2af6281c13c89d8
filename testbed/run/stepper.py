"""The twin, stepped tick by tick from your own loop."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec.structs import replace

from sim_twin.twin import Twin as Table
from sim_twin.twin import TwinPoses, TwinThrusters
from testbed.config import Deploy, Experiment
from testbed.core.error import TestbedError
from testbed.core.types import Demand, LawMessage, Pose, Setpoint, State, Tick, ValveCommand
from testbed.flight.agent import lead_time
from testbed.flight.flow import flow_shares
from testbed.flight.loop import VehicleNode
from testbed.rig.chain import make_agent
from testbed.run.arguments import check_experiment, wrong

Times = tuple[int, ...]  # of each jet [us]
Pulses = tuple[Times, Times]  # open times and offsets


class Twin:
    """The simulated table and the flight chains of its vehicles; your code is the law.

    Each `step` is one jet period. The flight chain is the same as on all rigs: the estimator gets
    noisy poses, the safety filter and the gate act, and the forces become valve pulses.

    Args:
        experiment: from `testbed.load`; its law and its duration are not used: your loop ends the
            flight. It has no injected faults, no forks, and the board `model`.

    Attributes:
        t: time of the next tick [s].
        period: duration of a tick [s].

    Raises:
        TestbedError: it is not an experiment, or has what is not flown here.
    """

    def __init__(self, experiment: Experiment) -> None:
        check_experiment("testbed.Twin", experiment)
        check_flown(experiment)
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
        self._agents = {name: make_agent(chain, name) for name in setups}
        self._boards = {name: _Board(TwinThrusters(self._table, name)) for name in setups}
        self._nodes = [
            VehicleNode(
                name, self._agents[name], TwinPoses(self._table, name),
                self._boards[name], self._links[name],
            )
            for name in setups
        ]  # fmt: skip

    def __getstate__(self) -> object:
        """For `copy` and `pickle`, which cannot copy memory that compiled code writes to.

        Raises:
            TestbedError: always.
        """
        raise TestbedError(
            where="testbed.Twin", expected="a twin that is neither copied nor pickled",
            found=f"a copy at {self.t:g} s",
            hint="make another testbed.Twin of the same experiment and repeat the steps: "
            "it flies the same to the last bit",
        )  # fmt: skip

    def step(self, forces: Mapping[str, Sequence[float]]) -> dict[str, Tick]:
        """Fly one jet period.

        Args:
            forces: for each vehicle, fx and fy in the table frame [N], and the heading to hold
                [rad] if not the goal's. Vehicles that are not named get no force.

        Returns:
            Inputs and outputs of each vehicle in this tick: `tick.outputs.state.pose`.

        Raises:
            TestbedError: the experiment has no such vehicle, or a force is not two or three finite
                numbers.
        """
        for name in forces:
            if name not in self._links:
                raise TestbedError(
                    where="Twin.step", expected=f"one of {', '.join(self._links)}",
                    found=repr(name),
                )  # fmt: skip
        demands: dict[str, Demand] = {}
        for name in self._links:
            fx, fy, theta = self._asked(name, forces.get(name, (0.0, 0.0)))
            at, life = self.effect_at(name), 2.0 * self.period
            demands[name] = Demand(at, fx, fy, theta, 0.0, 0.0, at + life)
        return self.obey(demands)

    def _asked(self, name: str, force: Sequence[float]) -> tuple[float, float, float]:
        """A vehicle's force and heading."""
        try:
            fx, fy, theta = map(float, (*force, self._heading[name])[:3])
            fits = len(force) <= 3 and all(map(math.isfinite, (fx, fy, theta)))
        except (TypeError, ValueError):
            fits = False
        if not fits:
            expected = "fx, fy [N] and, if wanted, the heading [rad]: 2 or 3 finite numbers"
            raise wrong(f"Twin.step, {name}", expected, force)
        return fx, fy, theta

    def effect_at(self, name: str) -> float:
        """When the pulses of the next tick take effect [s]."""
        return self.t + self._lead[name]

    def obey(
        self, setpoints: Mapping[str, Setpoint], pulses: Mapping[str, Pulses] | None = None
    ) -> dict[str, Tick]:
        """Fly one jet period with a setpoint for each vehicle.

        Args:
            setpoints: for each vehicle.
            pulses: open times and offsets [us] that a vehicle's valves get instead of its plan,
                unless its gate keeps them shut.
        """
        ticks = {}
        for node in self._nodes:
            name = node.name
            self._links[name].asked = setpoints[name]
            memory = self._agents[name].memory
            begun, after = memory.begun.copy(), memory.after.copy()
            tick = node.tick(self.t, armed=True)
            if pulses is not None and tick.outputs.inhibit_reason is None:
                memory.begun[:], memory.after[:] = begun, after
                tick = self._instead(name, tick, *pulses[name])
            self._boards[name].play(tick.outputs.command)
            ticks[name] = tick
        for name, tick in ticks.items():
            for other, link in self._links.items():
                if other != name and tick.outputs.state is not None:
                    link.neighbour_states[name] = tick.outputs.state
        self._k += 1
        self.t = self._k * self.period
        self._table.wait_until(self.t)
        return ticks

    def _instead(self, name: str, tick: Tick, on: Times, offset: Times) -> Tick:
        """The tick with other pulses, which estimator and jet watch are told of, too."""
        agent = self._agents[name]
        memory, times = agent.memory, np.array(on + offset, dtype=float)
        memory.times[:] = times
        memory.fired.on[-1], memory.fired.offset[-1] = 1e-6 * np.array((on, offset))
        fired, model = memory.fired, agent.params.model
        flow_shares(
            times, memory.begun, memory.after, model, fired.gives, fired.leaks, self.period,
            memory.flowed,
        )  # fmt: skip
        command = replace(tick.outputs.command, on_us=on, offset_us=offset)
        return replace(tick, outputs=replace(tick.outputs, command=command))

    def true_state(self, name: str) -> tuple[float, ...]:
        """True x, y, theta, vx, vy, omega of a vehicle now [m, m, rad, m/s, m/s, rad/s]."""
        x: list[float] = self._table.plant.x[self._table.plant.names.index(name)].tolist()
        return tuple(x)

    @property
    def touched(self) -> set[str]:
        """The vehicles that have touched something."""
        names = {one for touch in self._table.plant.touches for one in (touch.vehicle, touch.other)}
        return names & self._links.keys()

    @property
    def contacts(self) -> int:
        """Number of contacts so far."""
        return len(self._table.plant.touches)


def check_flown(experiment: Experiment) -> None:
    """Refuse what `testbed.fly` flies and a `Twin` does not: it would be left out silently.

    Raises:
        TestbedError: the experiment has injected faults, forks or another board.
    """
    for key, given, none in (
        ("inject", experiment.inject, []), ("forks", experiment.forks, []),
        ("board", experiment.board, "model"),
    ):  # fmt: skip
        if given != none:
            found = given if isinstance(given, str) else f"{len(given)} of them"
            raise TestbedError(
                where=f"testbed.Twin, or testbed.env: {key} of the experiment",
                expected=f"{none!r}: only `testbed.fly` flies others", found=found,
                hint=f"experiment.with_({key}={none!r})",
            )  # fmt: skip


class _Board:
    """A vehicle's board; it keeps a plan until it is known which one is played."""

    def __init__(self, board: TwinThrusters) -> None:
        self.land, self.health, self.play = board.land, board.health, board.apply

    def apply(self, command: ValveCommand) -> None:
        """See `Thrusters`; `play` does it."""


class _Link:
    """A vehicle's end of a lossless network: the caller's force, the others' states."""

    def __init__(self) -> None:
        self.asked: Setpoint | None = None
        self.neighbour_states: dict[str, State] = {}

    def setpoint(self) -> Setpoint | None:
        return self.asked

    def neighbours(self) -> dict[str, State]:
        return dict(self.neighbour_states)

    def publish(self, state: State) -> None:
        return

    def messages(self) -> dict[str, LawMessage]:
        return {}

    def broadcast(self, message: LawMessage) -> None:
        return
