"""What a policy decides for one jet period.

`force`   (2,) in [-1, 1]: force in W as a share of guidance.force_share of the jets' force, longer
          than 1 is shortened; the vehicle's own loop turns to the goal's heading and holds it.
          As with an ONNX law.
`wrench`  (3,) in [-1, 1]: force in the body frame as above, and torque as a share of the jets'.
          Tracker and bias compensation are the chain's; safety filter, allocation and valves, too.
`valves`  (jets,) in [0, 1]: duty of each jet, one centred pulse. Only the gate stands in between.

Numbers beyond their bounds are taken as the bound. One that is not finite opens no valve and is the
fault `not_a_number`, which ends the episode.
"""

import math
import reprlib
from typing import Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from testbed.core.error import TestbedError
from testbed.core.types import Demand, State
from testbed.core.vehicle import Vehicle
from testbed.flight.allocation import weakest_force

Kind = Literal["force", "wrench", "valves"]
Action = NDArray[np.float64]
LIFE = 2.0  # a demand is good for so many periods


def space_of(kind: Kind, vehicle: Vehicle) -> spaces.Box:
    """The space of an action."""
    if kind == "valves":
        return spaces.Box(0.0, 1.0, (len(vehicle.jets),), np.float32)
    return spaces.Box(-1.0, 1.0, (2 if kind == "force" else 3,), np.float32)


def checked(kind: Kind, action: object, vehicle: Vehicle, name: str) -> Action:
    """A vehicle's action as an array.

    Raises:
        TestbedError: it has another shape, or is not numbers.
    """
    shape = space_of(kind, vehicle).shape
    try:
        given = np.asarray(action)
    except (TypeError, ValueError):  # rows of different lengths
        given = np.empty(0, object)
    real = given.dtype.kind in "biuf"  # not complex, nor texts that look like numbers
    numbers = given.astype(float) if real else np.empty(0)
    found = f"shape {given.shape}" if real else reprlib.repr(action)
    if numbers.shape != shape:
        raise TestbedError(
            where=f"action `{kind}` of {name}", expected=f"numbers of shape {shape}", found=found
        )
    return numbers


def largest(vehicle: Vehicle, force_share: float) -> tuple[float, float]:
    """Force [N] and torque [N m] of a full action."""
    arms = [j.position[0] * j.push[1] - j.position[1] * j.push[0] for j in vehicle.jets]
    torque = 0.5 * sum(abs(arm) * jet.thrust for arm, jet in zip(arms, vehicle.jets, strict=True))
    return force_share * weakest_force(vehicle), force_share * torque


def demand_of(
    kind: Kind, action: Action | None, state: State | None, turn: tuple[float, float, float],
    most: tuple[float, float], vehicle: Vehicle, t: float, period: float, spin: float,
) -> tuple[Demand, float]:  # fmt: skip
    """The demand for the period from `t` on, and its angular acceleration.

    Args:
        kind: of "valves" a demand without force, which keeps the gate open.
        action: see above; None: nothing.
        state: newest estimate.
        turn: heading to hold, its rate and acceleration.
        most: see `largest`.
        vehicle: its file.
        t: when the demand takes effect [s].
        period: [s].
        spin: angular acceleration of the demand before [rad/s^2].
    """
    x, y, torque = 0.0, 0.0, 0.0
    if action is not None and not np.isfinite(action).all():
        x = y = math.nan  # the chain finds it
    elif action is not None and kind != "valves":
        x, y, *rest = action.tolist()
        torque = min(1.0, max(-1.0, rest[0])) if rest else 0.0
    size = math.hypot(x, y)
    if size > 1.0:
        x, y = x / size, y / size
    fx, fy, until = most[0] * x, most[0] * y, t + LIFE * period
    if kind != "wrench" or state is None:
        return Demand(t, fx, fy, *turn, until), 0.0
    # the heading loop is given the motion that the torque will cause, so that it adds nothing
    theta = state.pose.theta + period * (state.twist.omega + 0.5 * period * spin)
    omega, alpha = state.twist.omega + period * spin, most[1] * torque / vehicle.inertia
    c, s = math.cos(theta + 0.5 * period * omega), math.sin(theta + 0.5 * period * omega)
    return Demand(t, c * fx - s * fy, s * fx + c * fy, theta, omega, alpha, until), alpha


def pulses_of(
    action: Action, vehicle: Vehicle, period: float
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Open times and offsets of centred pulses [us]; too short ones are left out."""
    whole, shortest = round(1e6 * period), math.ceil(1e6 * vehicle.valve.min_on_s)
    duty = np.clip(action, 0.0, 1.0) if np.isfinite(action).all() else np.zeros(len(action))
    on = [round(whole * one) for one in duty.tolist()]
    on = [one if one >= shortest else 0 for one in on]
    return tuple(on), tuple((whole - one) // 2 for one in on)
