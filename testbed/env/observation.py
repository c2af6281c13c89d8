"""What a policy sees: layouts of the observation, from a vehicle's own estimate.

`goal`  the input of controllers/onnx_policy.py, shape (8,): goal - position, goal - velocity,
        acceleration of the goal, estimated disturbance; in W
`pose`  the same, then sine and cosine of the heading error and the turn rate, shape (11,)
`rans`  the dictionary of RANS (github.com/elharirymatteo/RANS, task GoToPose): `state` (10,) is
        cos and sin of the heading, vx, vy, turn rate, task 1, goal - position, cos and sin of the
        heading error; `transforms` (jets, 5) is cos and sin of each jet's push, its position and
        thrust; `masks` (jets,) is 1 for a dead jet, so 0 here
"""

import math
from typing import Any, Literal

import numpy as np
from gymnasium import spaces

from controllers.onnx_policy import observation
from testbed.core.law import Body, Goal
from testbed.core.se2 import wrap
from testbed.core.types import State
from testbed.core.vehicle import Vehicle

Layout = Literal["goal", "pose", "rans"]
GO_TO_POSE = 1.0  # task flag of RANS
ZERO = np.zeros(2)


def space_of(layout: Layout, vehicle: Vehicle) -> spaces.Space[Any]:
    """The space of a layout; numbers are in SI units and not bounded."""

    def numbers(*shape: int) -> spaces.Box:
        return spaces.Box(-np.inf, np.inf, shape, np.float32)

    if layout == "rans":
        jets = len(vehicle.jets)
        return spaces.Dict(
            {"state": numbers(10), "transforms": numbers(jets, 5), "masks": numbers(jets)}
        )
    return numbers(8 if layout == "goal" else 11)


def seen(layout: Layout, vehicle: Vehicle, state: State, goal: Goal, heading: float) -> Any:
    """The observation of a vehicle.

    Args:
        layout: see above.
        vehicle: its file, which is not quite the true vehicle.
        state: its estimate.
        goal: at the time of the estimate.
        heading: of the goal [rad].
    """
    pose, twist, bias = state.pose, state.twist, state.bias
    error = wrap(heading - pose.theta)
    if layout == "rans":
        place = [goal.p[0] - pose.x, goal.p[1] - pose.y, math.cos(error), math.sin(error)]
        motion = [math.cos(pose.theta), math.sin(pose.theta), twist.vx, twist.vy, twist.omega]
        jets = [(*jet.push, *jet.position, jet.thrust) for jet in vehicle.jets]
        return {
            "state": np.array([*motion, GO_TO_POSE, *place], np.float32),
            "transforms": np.array(jets, np.float32),
            "masks": np.zeros(len(jets), np.float32),
        }
    own = Body(
        np.array([pose.x, pose.y]), np.array([twist.vx, twist.vy]), vehicle.mass,
        np.array([bias.ax, bias.ay]), ZERO, 1.0,
    )  # fmt: skip
    numbers = observation(own, goal)
    if layout == "goal":
        return numbers
    turn = np.array([math.sin(error), math.cos(error), twist.omega], np.float32)
    return np.concatenate([numbers, turn])
