"""Mass and thrust of a vehicle in flight: less gas is less mass, less supply pressure less thrust.

The gas left follows from the tank's pressure where the board tells it. Without that gauge, as on
the shipped board, the tank counts as full at the start, and the flow of jets and bearings is added
up. The thrust of each jet follows from the motion, see effectiveness.py.
"""

from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from testbed.core.compiled import compiled
from testbed.core.vehicle import LOWEST_SHARE, Vehicle
from testbed.flight.fired import Model
from testbed.flight.tracker import Gains

SLOWLY_S = 10.0  # time constant with which a jet's assumed thrust follows its estimate [s]
LEAST, MOST = 0.35, 1.5  # share of the file's thrust that is assumed of a jet


class OnlineParams(Struct, frozen=True, forbid_unknown_fields=True):
    """What estimator and tracker follow in flight; off, they keep the values of the file."""

    mass: bool = False  # by the gas used; inertia and centre of mass stay
    thrust: bool = False  # of the fired pulses, by the supply pressure; the allocator always does
    jets: bool = False  # thrust of each jet by the motion, also for the allocator


class Online(NamedTuple):
    """Constants for compiled code."""

    mass: bool
    thrust: bool
    each_jet: bool
    gas: float  # in the full tank [kg]
    full: float  # pressure of the full tank [Pa]
    bearings: float  # flow [kg/s]
    jets: NDArray[np.float64]  # flow of each open jet at the set pressure, (jets,) [kg/s]


def online_of(params: OnlineParams, vehicle: Vehicle) -> Online:
    """The constants of a vehicle file."""
    air = vehicle.air
    jets = np.array([jet.thrust for jet in vehicle.jets]) / air.exhaust_speed
    return Online(
        params.mass, params.thrust, params.jets, air.gas, air.tank_pressure, air.bearing_flow, jets
    )


@compiled
def gas_used(p, used, tank_pressure, flowed, thrust_scale, period):
    """Gas used since the tank was full [kg], after a period.

    Args:
        p: Online.
        used: before the period [kg].
        tank_pressure: 0: no gauge [Pa].
        flowed: share of the period for which each jet flowed, in times of its flow without
            droop, (jets,).
        thrust_scale: supply pressure over set pressure.
        period: [s].
    """
    if tank_pressure > 0.0:
        return p.gas * (1.0 - min(1.0, tank_pressure / p.full))
    flow = 0.0
    for j in range(flowed.shape[0]):
        flow += flowed[j] * p.jets[j]
    return min(p.gas, used + period * (thrust_scale * flow + p.bearings))


@compiled
def model_now(p, model, used, thrust_scale):
    """The estimator's model: a thrust that is a share of the file's acts like more mass."""
    mass = model.mass - used if p.mass else model.mass
    share = max(LOWEST_SHARE, thrust_scale) if p.thrust else 1.0
    return Model(
        model.effect, model.com, mass / share, model.inertia / share, model.droop, model.drag,
        model.spin_drag, model.valve,
    )  # fmt: skip


@compiled
def gains_now(p, gains, used):
    """The tracker's gains, with the mass that is left."""
    mass = gains.mass - used if p.mass else gains.mass
    return Gains(
        gains.bandwidth, gains.damping, gains.heading_bandwidth, gains.heading_damping,
        gains.brake_decel, mass, gains.inertia, gains.com, gains.period,
    )  # fmt: skip


@compiled
def follow_jets(fired, evidence, probed, period):
    """Let the thrust that is assumed of each jet follow what the motion tells of it, in place.

    Only what is beyond one sigma moves it: an estimate of noise would wander. The innovations keep
    the thrust that they began with, so what they tell does not depend on what is assumed. A jet
    that leaks, was taken out or is probed stays as it was found.

    Args:
        fired: fired.Fired.
        evidence: jet_faults.Evidence.
        probed: see jet_faults.MEMORY.
        period: [s].
    """
    believed = evidence.innovations.gives
    for j in range(believed.shape[0]):
        if fired.leaks[j] > 0.0 or fired.gives[j] == 0.0 or j == probed - 1:
            continue
        left = believed[j] * (1.0 + evidence.off[j]) - fired.gives[j]
        sure = max(0.0, abs(left) - believed[j] * evidence.sigma[j])
        after = fired.gives[j] + np.copysign(sure, left) * period / SLOWLY_S
        fired.gives[j] = min(max(after, LEAST), MOST)
