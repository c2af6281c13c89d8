"""The plan for one jet period: a wrench becomes valve times, as the last stage of the chain."""

from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from testbed.core.compiled import compiled
from testbed.core.vehicle import Vehicle
from testbed.flight.flow import HAIR, ROUNDED
from testbed.flight.modulation import PWPF, Modulator, ModulatorParams, modulator_of


class Planner(NamedTuple):
    """Constants of a vehicle's plans for compiled code."""

    modulator: Modulator
    stretch: float  # commanded time minus time of flow [s]


def planner_of(params: ModulatorParams, vehicle: Vehicle, period: float) -> Planner:
    """The constants of a vehicle's plans.

    The modulator works with times of flow, so it carries over what the board cannot execute.
    """
    valve = vehicle.valve
    ramps = valve.open_ramp_s - valve.close_ramp_s
    stretch = (valve.open_delay_s - valve.close_delay_s) + 0.5 * ramps
    flow = replace(
        valve,
        min_on_s=max(0.0, valve.min_on_s - stretch),
        min_off_s=max(0.0, valve.min_off_s + 0.5 * stretch),
    )
    # at the start or end of a plan one end of a pulse may take the whole stretch
    pause = max(0.0, valve.min_off_s + stretch + max(0.0, stretch))
    return Planner(modulator_of(params, replace(vehicle, valve=flow), period, pause), stretch)


@compiled
def in_microseconds(p, on, offset, times):
    """Write command times in whole microseconds for the wanted times of flow.

    Args:
        p: Planner.
        on: shape (jets,) [s].
        offset: shape (jets,) [s].
        times: on, then offsets, of the plan before; overwritten, shape (2 jets,) [us].
    """
    jets, period = on.shape[0], p.modulator.period
    whole = np.rint(1e6 * period)
    for j in range(jets):
        command = on[j]
        lasted = times[j] > 0.0 and times[j] + times[jets + j] >= whole
        if 0.0 < on[j] < period:
            command = min(max(on[j] + p.stretch, 0.0), period)
        start = min(max(offset[j] - 0.5 * (command - on[j]), 0.0), period - command)
        times[j] = np.rint(1e6 * command)
        times[jets + j] = np.rint(1e6 * start)
        if p.modulator.kind == PWPF and 0.0 < on[j] < period:
            goes_on, lasts = lasted and offset[j] < HAIR, offset[j] + on[j] > period - HAIR
            if goes_on or lasts:  # a pulse of several plans: only its own two ends move
                begin, end = offset[j] - 0.5 * p.stretch, offset[j] + on[j] + 0.5 * p.stretch
                # the board does not open for less than the shortest pulse in its first plan
                latest = period - p.modulator.min_on - p.stretch - ROUNDED
                begin = 0.0 if goes_on else max(0.0, min(begin, latest))
                end = period if lasts else min(max(end, begin), period)
                times[jets + j] = np.rint(1e6 * begin)
                times[j] = np.rint(1e6 * end) - times[jets + j]
