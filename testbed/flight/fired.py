"""The pulses that were fired, and the wrench that they give, valve delay and ramp included."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.compiled import compiled
from testbed.core.jets import effect_matrix
from testbed.core.pulse import Timing, timing
from testbed.core.scratch import scratch
from testbed.core.vehicle import Vehicle
from testbed.flight.droop import COLUMNS, give, note_pulse
from testbed.flight.flow import HAIR, ROUNDED

Array = NDArray[np.float64]


class Fired(NamedTuple):
    """The last plans, newest last, and the jets, as the wrench model needs them."""

    start: Array  # (m,) when each plan starts on the board [s]
    end: Array  # (m,) when it is replaced or over [s]
    on: Array  # (m, n) [s]
    offset: Array  # (m, n) [s]
    held: Array  # (m, n) on-time of the same pulse in the plans before [s]
    gives: Array  # see the first lines of reconfiguration, (n,)
    leaks: Array  # (n,)


@compiled
def note(fired, start, end, times_us):
    """Add a plan, in place; `times_us` are on, then offset in microseconds, shape (2 n,).

    A pulse that lasts to the end of its plan may continue with the next one. Its valve stays open.
    """
    last, jets = fired.start.shape[0] - 1, fired.on.shape[1]
    fired.end[last] = min(fired.end[last], start)
    for m in range(last):
        fired.start[m], fired.end[m] = fired.start[m + 1], fired.end[m + 1]
        fired.on[m] = fired.on[m + 1]
        fired.offset[m] = fired.offset[m + 1]
        fired.held[m] = fired.held[m + 1]
    fired.start[last], fired.end[last] = start, end
    for j in range(jets):
        fired.on[last, j] = 1e-6 * times_us[j]
        fired.offset[last, j] = 1e-6 * times_us[jets + j]
        before, fired.held[last, j] = last - 1, 0.0
        if before >= 0 and fired.on[before, j] > 0.0 and fired.offset[last, j] < HAIR:
            up = fired.start[before] + fired.offset[before, j]
            if min(up + fired.on[before, j], fired.end[before]) > start - ROUNDED:
                fired.held[last, j] = fired.held[before, j] + fired.on[before, j]


class Model(NamedTuple):
    """Constants of the vehicle for compiled code."""

    effect: Array  # (3, n), about the centre of mass, see jets.py
    com: tuple[float, float]  # centre of mass in B [m]
    mass: float  # [kg]
    inertia: float  # [kg m^2]
    droop: float  # see vehicle.Air
    drag: float  # of the bearing, over mass [1/s]
    spin_drag: float  # over inertia [1/s]
    valve: Timing


def model_of(vehicle: Vehicle) -> Model:
    """The constants of a vehicle file."""
    return Model(
        effect_matrix(vehicle.jets, about=vehicle.com),
        vehicle.com,
        vehicle.mass,
        vehicle.inertia,
        vehicle.air.droop,
        vehicle.drag / vehicle.mass,
        vehicle.spin_drag / vehicle.inertia,
        timing(vehicle.valve),
    )


@compiled
def mean_wrench(fired, model, flow, start, end):
    """Mean body wrench of the fired pulses over [start, end]: (fx, fy, tau).

    Args:
        fired: the last plans.
        model: of the vehicle.
        flow: written; for how long each jet flowed, if it does what is commanded, in times of its
            whole thrust, (n,) [s].
        start: [s].
        end: [s].
    """
    jets = model.effect.shape[1]
    closing, last = model.valve.close_delay + model.valve.close_ramp, fired.start.shape[0] - 1
    first = last  # of the plans that still give something
    while first > 0 and fired.end[first - 1] + closing > start:
        first -= 1
    pulses, given, count = scratch((jets * (last + 1 - first), COLUMNS)), scratch(jets), 0
    for m in range(first, last + 1):
        if fired.start[m] >= end or fired.end[m] + closing <= start:
            continue
        for j in range(jets):
            if fired.on[m, j] > 0.0:
                up = fired.start[m] + fired.offset[m, j]
                down = min(up + fired.on[m, j], fired.end[m])
                held = fired.held[m, j]  # counted with the plans before
                count = note_pulse(pulses, count, j, up - held, up, down, model.valve, start, end)
    give(pulses, count, model.droop, model.valve, fired.gives, fired.leaks, start, end, flow, given)
    fx = fy = tau = 0.0
    for j in range(jets):
        level = given[j] / (end - start)
        fx += model.effect[0, j] * level
        fy += model.effect[1, j] * level
        tau += model.effect[2, j] * level
    return fx, fy, tau
