"""Guidance: runs a law and gives one setpoint per jet period.

Both modes fly the law ahead over the coming jet period at a fine step, because a law with sgn and
an integral diverges when it is stepped once per period:

`reference`  the law controls a reference model, an undisturbed double integrator that runs a
             little ahead of time, and sends its future states: the paper's Fig. 13. The vehicle
             tracks them.
`wrench`     the law is integrated ahead from the vehicle's estimate, with its own state kept from
             period to period, and sends the mean force. The loop closes through the law.

It may run on the host, with states one period old and setpoints one period ahead, or on the
vehicle; it only needs the time for which its setpoint is meant.
"""

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from enum import IntEnum
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from testbed.core.bundle import Bundle
from testbed.core.compiled import with_fixed_types
from testbed.core.law import Ahead, Body, Concern, Discs, Goal, Law, Neighbours, World, concerns_of
from testbed.core.path import Path
from testbed.core.rows import References, States, setpoint_of
from testbed.core.table import Obstacle
from testbed.core.types import (
    Intervention,
    LawMessage,
    Pose,
    Setpoint,
    State,
)
from testbed.core.vehicle import NonNegative, Positive, Vehicle
from testbed.flight.allocation import weakest_force
from testbed.flight.barrier import UNLIMITED, WIDTH, Barrier, discs_of
from testbed.flight.heard_vehicles import HeardVehicles, heard_vehicles
from testbed.flight.record import DEMAND, TRAJECTORY
from testbed.flight.reference_model import ReferenceModel, advance_model, extrapolate
from testbed.flight.turn import Turn, TurnAlong, turn_to

Array = NDArray[np.float64]

ZERO = np.zeros(2)  # shared: laws must not write to their arguments


class GuidanceParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters for flying a law."""

    mode: Literal["reference", "wrench"] = "reference"
    step_s: Annotated[float, Meta(gt=0.0, le=0.001)] = 0.001
    neighbour_distance: NonNegative = 0.8  # to keep between centres of two vehicles [m]
    force_share: Annotated[float, Meta(gt=0.0, le=1.0)] = (
        0.6  # of the jets' force; the rest is for feedback
    )
    heading_accel: Positive = 0.02  # of a turn to the goal's heading [rad/s^2]
    preview_s: NonNegative = 0.3  # how far ahead references are sent, against lost messages
    setpoint_life_s: Positive = 0.5  # after the last reference, or of a demand


class Kept(IntEnum):
    """How much memory a guidance takes over from another; each includes those before."""

    NOTHING = 0  # as at take-off
    MODEL = 1  # the reference model, and what was sent ahead
    STATE = 2  # the state of the law, which has other gains
    LAW = 3  # the law itself


OF_MODEL = ("_turn", "_t", "_p", "_v", "_ahead", "_sent", "message", "filtered")
OF_LAW = ("_law", "_law_state")


class Received(NamedTuple):
    """Newest states and messages of the other vehicles."""

    names: tuple[str, ...]  # of those whose state is known
    states: Array  # (n, 12) in this order, see rows.States
    messages: Mapping[str, LawMessage]


class Guidance:
    """One vehicle's law at work."""

    def __init__(
        self,
        params: GuidanceParams,
        law: Law,
        vehicle: Vehicle,
        goal: Pose,
        obstacles: Sequence[Obstacle],
        period: float,
        *,
        name: str = "",
        formation: Sequence[str] = (),
        path: Path | None = None,
        barrier: Barrier | None = None,
    ) -> None:
        """Guide vehicle `name` of `formation`; its law knows the others by their index in it.

        `barrier` filters the force on a reference model; a demanded force is filtered on the
        vehicle.
        """
        self._barrier = barrier
        self.filtered: Intervention | None = None  # of the newest reference
        self._params, self._law, self._goal, self._period = params, law, goal, period
        self._mass = vehicle.mass
        self._max_force = params.force_share * weakest_force(vehicle)
        self._steps = math.ceil(period / params.step_s - 1e-9)
        self._who = {one: k for k, one in enumerate(formation)}
        self._own = self._who.get(name, 0)
        self._path = path
        self._fixed_goal = Goal(np.array([goal.x, goal.y]), ZERO, ZERO, ZERO)
        self._obstacles = Discs(
            np.array([o.position for o in obstacles]).reshape(-1, 2),
            np.array([o.velocity for o in obstacles]).reshape(-1, 2),
            np.array([o.radius for o in obstacles]),
        )
        self._world = World(self._fixed_goal, self._obstacles)
        self._they_move = bool(self._obstacles.v.any())
        self._heard: tuple[object, HeardVehicles] | None = None  # names, and their vehicles
        self._law_state: Array | None = None
        self._inherited: Array | None = None  # state of the same law with other gains
        self.message: LawMessage | None = None  # the law's message to the others, if it sends any
        self._turn: Turn | TurnAlong | None = None
        self._t, self._p, self._v = 0.0, np.zeros(2), np.zeros(2)  # the reference model
        self._extrapolate, self._advance_model = (
            with_fixed_types(extrapolate),
            with_fixed_types(advance_model),
        )
        self._ahead = np.empty((0, References.width))  # references not due yet, see rows.References
        self.model: Bundle | None = None  # of a law in compiled code, see reference_model.py
        self._compiled = self._compiled_law()
        self._sent: deque[tuple[float, Array]] = deque(maxlen=8)  # (start, mean force) of demands

    def _compiled_law(self) -> Any:
        """The law for `advance_model`; None: it cannot fly this law here."""
        make = getattr(self._law, "for_compiled_code", None)
        if make is None or self.message_size or self._path is not None or self._they_move:
            return None
        return make(self._mass)

    def take_over(self, before: "Guidance", kept: Kept) -> None:
        """Go on from the memory of another guidance of this vehicle."""
        parts = (OF_MODEL if kept >= Kept.MODEL else ()) + (OF_LAW if kept == Kept.LAW else ())
        for part in parts:
            setattr(self, part, getattr(before, part))
        self.model, self._compiled = None, self._compiled_law()
        if kept == Kept.STATE:
            self._inherited = getattr(before, OF_LAW[1])

    def begin(self, t: float, own: State) -> None:
        """Begin anew at `t`, from the motion that the vehicle has."""
        late, pose, twist = t - own.t, own.pose, own.twist
        theta, accel = pose.theta + late * twist.omega, self._params.heading_accel
        self._turn = Turn(theta, self._goal.theta, t, accel, twist.omega)
        self._t, self._v = t, np.array([twist.vx, twist.vy])
        self._p = np.array([pose.x, pose.y]) + late * self._v
        self._law_state = self._inherited = self.message = self.filtered = self.model = None
        self._ahead = self._ahead[:0]
        self._sent.clear()

    @property
    def message_size(self) -> int:
        """Numbers in the law's message to the others."""
        return self._law.message_size

    @property
    def concerns(self) -> list[Concern]:
        """The law's concerns so far, for the operator."""
        return [] if self._law_state is None else concerns_of(self._law, self._law_state)

    def step(
        self,
        t: float,
        own: State,
        neighbours: Mapping[str, State],
        messages: Mapping[str, LawMessage] | None = None,
    ) -> Setpoint:
        """Setpoint for the jet period that starts at `t`.

        Args:
            t: one period after the last step's, and not before own.t [s].
            own: newest estimate of the vehicle.
            neighbours: newest state of each other vehicle.
            messages: newest message of each other vehicle's law.
        """
        states = States.of(list(neighbours.values())).rows
        received = Received(tuple(neighbours), states, messages or {})
        return setpoint_of(self.step_row(t, States.numbers(own), received))

    def step_row(self, t: float, own: Sequence[float], received: Received) -> Array:
        """`step` with rows of numbers: of the own state, see rows.States, and of the others.

        Returns:
            the setpoint, see rows.row_of_setpoint.
        """
        if self._turn is None:
            self._turn = turn_to(
                self._goal.theta, self._path, own[3], t, self._params.heading_accel
            )
            self._t = t
            self._p, self._v = np.array(own[1:3]), np.zeros(2)
        if self._params.mode == "wrench":
            return self._demand(t, own, received, self._turn)
        rows: list[Sequence[float]] = [*self._ahead.tolist()]
        while self._t <= t + self._params.preview_s + 1e-9:
            rows.append(self._reference(received, self._turn))
        ahead, until = np.array(rows), rows[-1][0] + self._params.setpoint_life_s
        if self._knows(received) and len(rows) == 1 + len(self._ahead):
            self._ahead[:] = ahead[1:]
        else:
            self._ahead = ahead[1:]
            self.model = None if self._compiled is None else self._model(received, t)
        head = TRAJECTORY, ahead[0, 0], until, 0.0, 0.0, 0.0, 0.0, 0.0
        return np.concatenate((head, ahead.ravel()))

    def turns(self, times: Iterable[float]) -> list[tuple[float, float, float]]:
        """The turn at the model's time for each of the coming setpoints.

        Args:
            times: of the setpoints [s]. The first one that `next_setpoint` cannot make, because it
                does not need exactly one more reference, ends the list.
        """
        found: list[tuple[float, float, float]] = []
        if self.model is None or self._turn is None:
            return found
        at = self._t
        for t in times:
            if not at <= t + self._params.preview_s + 1e-9 < at + self._period:
                break
            found.append(self._turn.at(at))
            at += self._period
        return found

    @property
    def model_t(self) -> float:
        """The model's time [s]."""
        return self._t

    def advanced(self, names: tuple[str, ...], dfx: float, dfy: float, hazard: int) -> None:
        """Note that compiled code has advanced the model by a period; see `advance_model`.

        Args:
            names: of the vehicles received.
            dfx, dfy: change of the law's force [N].
            hazard: that the safety filter avoided.
        """
        self._t += self._period
        self.filtered = None
        if hazard >= 0 and self._barrier is not None:
            self.filtered = Intervention(dfx, dfy, *self._barrier.hazard(hazard, names))

    def _demand(
        self, t: float, own: Sequence[float], received: Received, turn: Turn | TurnAlong
    ) -> Array:
        """Wrench mode: integrate the law ahead from the estimate and demand its mean force."""
        disturbance = np.array(own[7:9])
        force = self._fly(t, *self._predict(own, disturbance, t), disturbance, received).mean_force
        self._sent.append((t, force))
        until = t + self._params.setpoint_life_s
        return np.array((DEMAND, t, until, *force.tolist(), *turn.at(t)))

    def _reference(self, received: Received, turn: Turn | TurnAlong) -> tuple[float, ...]:
        """Reference mode: the model's state now, as a row; then advance it by one period."""
        if self._compiled is not None:
            return self._advance(received, turn)
        t, (px, py), (vx, vy) = self._t, self._p.tolist(), self._v.tolist()
        ahead = self._fly(t, self._p, self._v, ZERO, received)
        self._t, p, v = t + self._period, ahead.p, ahead.v
        fx, fy = ahead.mean_force.tolist()
        if self._barrier is not None:
            motion = (px, py, vx, vy, 0.0, 0.0)
            fx, fy, self.filtered = self._barrier.filter_rows(
                t, (fx, fy), motion, received.names, received.states
            )
            if self.filtered is not None:
                h, accel = self._period, np.array([fx, fy]) / self._mass
                p, v = self._p + h * (self._v + 0.5 * h * accel), self._v + h * accel
        self._p, self._v = p, v
        theta, omega, alpha = turn.at(t)
        return t, px, py, theta, vx, vy, omega, fx / self._mass, fy / self._mass, alpha

    def _advance(self, received: Received, turn: Turn | TurnAlong) -> tuple[float, ...]:
        """`_reference` of a law in compiled code."""
        if not self._knows(received):
            self.model = self._model(received, self._t)
        row = np.empty(References.width)
        changed = self._advance_model(self.model, received.states, self._t, turn.at(self._t), row)
        self.advanced(received.names, *changed)
        return tuple(row.tolist())

    def _knows(self, received: Received) -> bool:
        """Whether the model is made for these vehicles."""
        heard = self._heard
        return self.model is not None and heard is not None and heard[0] == (received.names, ())

    def _model(self, received: Received, t: float) -> Bundle:
        """The model and what it knows of the vehicles that it hears."""
        others, barrier = self._others(received, t), self._barrier
        assert self._heard is not None
        if self._law_state is None:
            own = Body(self._p, self._v, self._mass, ZERO, ZERO, self._max_force, self._own)
            self._law_state = self._begun(own, others, self._world)
        motion = np.array((self._p, self._v))
        # changed in place from now on
        self._p, self._v, self._law_state = *motion, self._law_state.copy()
        self._ahead = self._ahead.copy()
        n = len(received.names)
        return Bundle(ReferenceModel(
            self._compiled, self._law_state, motion, ZERO, self._mass, self._max_force, self._own,
            self._period, self._steps, self._world, others, self._heard[1].order,
            barrier is not None, discs_of([]) if barrier is None else barrier.obstacles,
            UNLIMITED if barrier is None else barrier.limits,
            np.zeros((n, 2)) if barrier is None else barrier.neighbour_limits(received.names),
            np.empty((n, WIDTH)), self._ahead, self._params.setpoint_life_s,
        ))  # fmt: skip

    def _begun(self, own: Body, others: Neighbours, world: World) -> Array:
        """The state with which the law begins: another guidance's, if it is one of this law."""
        state, kept = self._law.initial(own, others, world), self._inherited
        return kept if kept is not None and kept.shape == state.shape else state

    def _fly(self, t: float, p: Array, v: Array, disturbance: Array, received: Received) -> Ahead:
        """Integrate the law ahead over one period and keep its state."""
        own = Body(p, v, self._mass, disturbance, ZERO, self._max_force, self._own)
        world, others = self._world_at(t), self._others(received, t)
        if self._law_state is None:
            self._law_state = self._begun(own, others, world)
        ahead = self._law.propagate(
            self._law_state, own, others, world, t, self._period, self._steps
        )
        self._law_state = ahead.law_state
        if self._law.message_size:
            self.message = LawMessage(t + self._period, tuple(ahead.message.tolist()))
        return ahead

    def _world_at(self, t: float) -> World:
        """The goal, moved along its path, and the obstacles, moved along theirs."""
        goal, obstacles = self._world
        if self._path is not None:
            p, v, a, jerk = (np.array(value) for value in self._path.at(t))
            goal = Goal(goal.p + p, v, a, jerk)
        elif not self._they_move:
            return self._world
        if self._they_move:
            obstacles = Discs(obstacles.p + t * obstacles.v, obstacles.v, obstacles.radius)
        return World(goal, obstacles)

    def _predict(self, own: Sequence[float], disturbance: Array, t: float) -> tuple[Array, Array]:
        """Position and velocity at `t`, including demands that were sent but not yet flown."""
        now, p, v = own[0], np.array(own[1:3]), np.array(own[4:6])
        while now < t - 1e-9:
            force, until = np.zeros(2), t
            for start, sent in self._sent:
                if start <= now + 1e-9 < start + self._period:
                    force, until = sent, min(until, start + self._period)
                elif start > now + 1e-9:
                    until = min(until, start)
            h = until - now
            a = force / self._mass + disturbance
            p = p + h * (v + 0.5 * h * a)
            v = v + h * a
            now = until
        return p, v

    def _others(self, received: Received, t: float) -> Neighbours:
        """The others, extrapolated to time `t`; for a law with messages, those that sent one."""
        words, k = received.messages, self._law.message_size
        known = received.names, tuple(words) if k else ()
        if self._heard is None or self._heard[0] != known:
            self._heard = (
                known,
                heard_vehicles(
                    *known, self._who, self._params.neighbour_distance, self._law.message_size
                ),
            )
        names, order, others = self._heard[1]
        p, v = np.empty((2, len(order), 2))
        self._extrapolate(received.states, order, t, p, v)
        sent, sent_at = others.message, others.message_t
        if k and names:
            sent = np.array([words[name].values for name in names])
            sent_at = np.array([words[name].t for name in names])
        return Neighbours(p, v, others.radius, others.vehicle_index, sent, sent_at)
