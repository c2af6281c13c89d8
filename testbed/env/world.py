"""One episode on the twin: actions in; observations, rewards and ends out."""

import math
from collections.abc import Mapping
from typing import Any, get_args

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from testbed.config import Experiment, VehicleSetup
from testbed.core.error import TestbedError
from testbed.core.law import Goal
from testbed.core.path import heading_at
from testbed.core.se2 import wrap
from testbed.core.spelling import did_you_mean
from testbed.core.types import State, Tick
from testbed.env.action import Action, Kind, checked, demand_of, largest, pulses_of
from testbed.env.observation import Layout, seen
from testbed.flight.turn import Turn, TurnAlong, turn_to
from testbed.rig.chain import fence_of
from testbed.run.arguments import wrong
from testbed.run.stepper import Twin, check_flown

Array = NDArray[np.float64]
FAILED = -10.0  # reward of a contact, of leaving the fence, or of a fault
HEADING, GAS = 0.2, 0.05  # weights of the reward: [m/rad], and [m] for all jets open
SETTLING = 20  # ticks at most until the estimator knows where every vehicle is
TRIES = 1000  # to place vehicles at random
OF_EPISODE = {"_twin", "_spin", "_turns", "_last"}  # of a world: a copy makes its own
ROOM = 0.2  # between things placed at random [m]


class World:
    """Vehicles of an experiment, its law replaced by actions.

    Args:
        experiment: vehicles, table, obstacles, chain and duration; its law is not used.
        action: see action.py.
        layout: see observation.py.
        randomise: draw the true vehicles from their tolerances; else they are as in their files.
        anywhere: draw starts and goals anywhere on the table; else they are the experiment's.

    Raises:
        TestbedError: no such action or observation, or the experiment has injected faults, forks or
            a board, which are not flown here.
    """

    def __init__(
        self, experiment: Experiment, action: Kind, layout: Layout, *,
        randomise: bool = True, anywhere: bool = False,
    ) -> None:  # fmt: skip
        _check_choice("action", action, get_args(Kind))
        _check_choice("observation", layout, get_args(Layout))
        check_flown(experiment)
        self.experiment = experiment if randomise else _exact(experiment)
        self._action, self._layout, self._anywhere = action, layout, anywhere
        share = experiment.guidance.force_share
        self._most = {n: largest(v.model, share) for n, v in experiment.vehicles.items()}
        self._fence = {name: fence_of(experiment, name) for name in experiment.vehicles}

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode: cameras, links, valves and true vehicles are drawn anew."""
        flown = replace(self.experiment, seed=int(rng.integers(2**31)))
        if self._anywhere:
            flown = replace(flown, vehicles=_placed(flown, rng))
        self._begin(flown)

    def _begin(self, flown: Experiment) -> None:
        self._flown, self._done = flown, list[dict[str, Action]]()
        self.setups, self._twin, self.ticks = flown.vehicles, Twin(flown), 0
        self._spin = dict.fromkeys(self.setups, 0.0)
        self._turns: dict[str, Turn | TurnAlong] = {}
        self._last: dict[str, Tick] = {}
        for _ in range(SETTLING):
            self._fly({})
            outputs = [tick.outputs for tick in self._last.values()]
            if all(one.state is not None and one.inhibit_reason is None for one in outputs):
                return
        raise TestbedError(
            where="testbed.env", expected=f"poses and an open gate within {SETTLING} ticks",
            found="; ".join(one.inhibit_reason.words for one in outputs if one.inhibit_reason),
        )  # fmt: skip

    def step(self, actions: Mapping[str, Any]) -> None:
        """Fly one jet period; for the actions see action.py.

        Raises:
            TestbedError: there was no reset, or not each vehicle has an action of the right shape.
        """
        if not hasattr(self, "setups"):
            raise TestbedError(where="step", expected="a `reset` before it", found="none")
        if not isinstance(actions, Mapping) or actions.keys() != self.setups.keys():
            raise wrong("step", f"an action for each of {', '.join(self.setups)}", actions)
        self._obey({
            name: checked(self._action, actions[name], setup.model, name)
            for name, setup in self.setups.items()
        })  # fmt: skip

    def _obey(self, actions: dict[str, Action]) -> None:
        self._fly(actions)
        self._done.append(actions)
        self.ticks += 1

    def __getstate__(self) -> dict[str, Any]:
        """For `copy` and `pickle`: the episode's experiment and actions, not the twin's memory."""
        return {name: value for name, value in vars(self).items() if name not in OF_EPISODE}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        """Fly the episode again, which gives the same state to the last bit."""
        vars(self).update(kept)
        if "_flown" in kept:
            done = self._done
            self._begin(self._flown)
            for actions in done:
                self._obey(actions)

    def _fly(self, actions: Mapping[str, Action]) -> None:
        twin, period, demands = self._twin, self._twin.period, {}
        for name, setup in self.setups.items():
            t, state = twin.effect_at(name), self.state(name)
            demands[name], self._spin[name] = demand_of(
                self._action, actions.get(name), state, self._turned(name, state, t),
                self._most[name], setup.model, t, period, self._spin[name],
            )  # fmt: skip
        pulses = None
        if self._action == "valves" and actions:
            pulses = {
                name: pulses_of(actions[name], setup.model, period)
                for name, setup in self.setups.items()
            }
        self._last = twin.obey(demands, pulses)

    def _turned(self, name: str, state: State | None, t: float) -> tuple[float, float, float]:
        """Heading, turn rate and its acceleration of a smooth turn to the goal's heading."""
        if name not in self._turns:
            if state is None:
                return self._heading(name, self._twin.t), 0.0, 0.0
            setup, accel = self.setups[name], self.experiment.guidance.heading_accel
            self._turns[name] = turn_to(setup.goal[2], setup.path, state.pose.theta, t, accel)
        return self._turns[name].at(t)

    def state(self, name: str) -> State | None:
        """A vehicle's newest estimate."""
        return self._last[name].outputs.state if self._last else None

    def _goal(self, name: str, t: float) -> Goal:
        setup, zero = self.setups[name], np.zeros(2)
        place = np.array(setup.goal[:2])
        if setup.path is None:
            return Goal(place, zero, zero, zero)
        p, v, a, jerk = (np.array(one) for one in setup.path.at(t))
        return Goal(place + p, v, a, jerk)

    def _heading(self, name: str, t: float) -> float:
        setup = self.setups[name]
        return heading_at(setup.path, setup.goal[2], t)

    def seen(self, name: str) -> Any:
        """A vehicle's observation: all of it for the time of its estimate."""
        state, setup = self.state(name), self.setups[name]
        assert state is not None, "reset waits for the first pose"
        goal, heading = self._goal(name, state.t), self._heading(name, state.t)
        found = seen(self._layout, setup.model, state, goal, heading)
        if self._layout != "pose":
            return found
        return np.concatenate(
            [found, *(self._disc(state, one) for one in self._discs(name, state.t))]
        )

    def _discs(self, name: str, t: float) -> list[tuple[float, ...]]:
        """Place, velocity and distance to keep of each obstacle and other vehicle at a time."""
        discs: list[tuple[float, ...]] = []
        for one in self.experiment.obstacles.values():
            (x, y), (vx, vy) = one.position, one.velocity
            discs.append((x + t * vx, y + t * vy, vx, vy, one.radius))
        keep = self.experiment.guidance.neighbour_distance
        for other in self.setups:
            state = self.state(other)
            if other != name and state is not None:
                pose, twist = state.pose, state.twist
                discs.append((pose.x, pose.y, twist.vx, twist.vy, keep))
        return discs

    def _disc(self, own: State, disc: tuple[float, ...]) -> NDArray[np.float32]:
        x, y, vx, vy, keep = disc
        pose, twist = own.pose, own.twist
        return np.array([x - pose.x, y - pose.y, vx - twist.vx, vy - twist.vy, keep], np.float32)

    def off(self, name: str) -> tuple[float, float]:
        """True distance to the goal [m], and heading error [rad]."""
        x, y, theta, *_ = self._twin.true_state(name)
        goal, heading = self._goal(name, self._twin.t).p, self._heading(name, self._twin.t)
        return math.hypot(goal[0] - x, goal[1] - y), abs(wrap(heading - theta))

    def reward(self, name: str) -> float:
        """Reward of a vehicle for the last period; docs/learning.md has the formula."""
        if self.ended(name):
            return FAILED
        (distance, heading), period = self.off(name), self._twin.period
        on = self._last[name].outputs.command.on_us
        open_share = 1e-6 * sum(on) / (len(on) * period)
        return -period * (distance + HEADING * heading + GAS * open_share)

    def ended(self, name: str) -> str:
        """Why a vehicle's flight is over: "contact", "fence", "fault"; or not: ""."""
        x, y, *_ = self._twin.true_state(name)
        if name in self._twin.touched:
            return "contact"
        if abs(x) > self._fence[name][0] or abs(y) > self._fence[name][1]:
            return "fence"
        return "fault" if self._last[name].outputs.fault is not None else ""

    def info(self, name: str) -> dict[str, Any]:
        """What Gymnasium calls `info`: times, true errors, and how the episode ended."""
        distance, heading = self.off(name)
        fault = self._last[name].outputs.fault
        return {
            "t": self._twin.t, "distance_m": distance, "heading_error_rad": heading,
            "true_state": self._twin.true_state(name), "ended": self.ended(name),
            "fault": "" if fault is None else fault.words,
        }  # fmt: skip

    @property
    def late(self) -> bool:
        """The experiment's duration is over."""
        return self.ticks >= self.experiment.ticks


def _check_choice(what: str, value: object, choices: tuple[str, ...]) -> None:
    if value not in choices:
        hint = did_you_mean(value, choices) if isinstance(value, str) else ""
        raise TestbedError(
            where=f"testbed.env, {what}", expected=f"one of {', '.join(choices)}",
            found=f"{value!r}{hint}",
        )  # fmt: skip


def _exact(experiment: Experiment) -> Experiment:
    """The experiment with vehicles that are exactly as in their files."""

    def exact(setup: VehicleSetup) -> VehicleSetup:
        zero = dict.fromkeys(setup.model.tolerance.__struct_fields__, 0.0)
        tolerance = type(setup.model.tolerance)(**zero)
        return replace(setup, model=replace(setup.model, tolerance=tolerance))

    return replace(experiment, vehicles={n: exact(v) for n, v in experiment.vehicles.items()})


def _placed(experiment: Experiment, rng: np.random.Generator) -> dict[str, VehicleSetup]:
    """The vehicles with starts and goals anywhere, clear of obstacles and of each other."""
    setups = experiment.vehicles
    taken: dict[str, list[tuple[float, float, float]]] = {
        which: [(*one.position, one.radius) for one in experiment.obstacles.values()]
        for which in ("start", "goal")
    }
    for name, setup in setups.items():
        for which, others in taken.items():
            place = _free(others, fence_of(experiment, name), setup.model.radius, rng)
            others.append((*place[:2], setup.model.radius))
            setup = replace(setup, **{which: place})
        setups = {**setups, name: setup}
    return setups


def _free(
    taken: list[tuple[float, float, float]], fence: tuple[float, float], radius: float,
    rng: np.random.Generator,
) -> tuple[float, float, float]:  # fmt: skip
    half_x, half_y = (max(0.0, one - ROOM) for one in fence)
    for _ in range(TRIES):
        x, y = float(rng.uniform(-half_x, half_x)), float(rng.uniform(-half_y, half_y))
        if all(math.hypot(x - a, y - b) > r + radius + ROOM for a, b, r in taken):
            return x, y, float(rng.uniform(-math.pi, math.pi))
    raise TestbedError(
        where="testbed.env", expected="free places for all vehicles", found="a table that is full"
    )
