"""Converts a continuous duty to on/off pulses of a solenoid: one pulse per jet and period.

The pulses of `pwm` and `sigma_delta` are centred in the period, so that their impulse has the same
centre in time as the steady thrust they replace. Where the supply droops, jets that are open
together get longer pulses.

`pwm`          pulse width only, rounded to the valve's limits: a dead band around zero.
`sigma_delta`  pulse width, and the unfired remainder is carried to the next period; remainders of
               two opposing jets cancel. No dead band, exact on average.
`pwpf`         pulse-width pulse-frequency: a lag filter and a Schmitt trigger per jet. The
               textbook's analogue form fires at any time. Here a period has at most one pulse: the
               filter's first, and not before the valve has paused since the last one.
"""

import math
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from testbed.core.compiled import compiled
from testbed.core.error import MismatchError
from testbed.core.jets import opposing_pairs
from testbed.core.vehicle import NonNegative, Positive, Vehicle

Array = NDArray[np.float64]
PWM, SIGMA_DELTA, PWPF = range(3)


class PwmParams(Struct, frozen=True, forbid_unknown_fields=True, tag="pwm"):
    """No parameters: the valve file has the minimum times."""


class SigmaDeltaParams(Struct, frozen=True, forbid_unknown_fields=True, tag="sigma_delta"):
    """No parameters: the valve file has the minimum times."""


class PwpfParams(Struct, frozen=True, forbid_unknown_fields=True, tag="pwpf"):
    """Filter and trigger.

    The shortest pulse is about (trigger_on - trigger_off) lag / gain, here 25 ms, and at half duty
    a pulse and its pause last four times that, one jet period. Below a duty of trigger_on / gain,
    here 0.02, nothing fires.
    """

    gain: Positive = 50.0  # of the filter
    lag_s: Positive = 1.25
    trigger_on: Positive = 1.0  # filter output that opens the valve
    trigger_off: NonNegative = 0.0  # and closes it again

    def __post_init__(self) -> None:
        off, on, gain = self.trigger_off, self.trigger_on, self.gain
        if not off < on < gain:  # else the valve would never close, or never open
            found = f"{off:g}, {on:g}, {gain:g}"
            raise MismatchError("trigger_off < trigger_on < gain", found)


ModulatorParams = PwmParams | SigmaDeltaParams | PwpfParams


class Modulator(NamedTuple):
    """Constants of a vehicle's modulator for compiled code; times of flow, not of the command."""

    kind: int  # PWM, SIGMA_DELTA or PWPF
    period: float  # [s]
    min_on: float  # [s]
    min_off: float  # [s]
    gain: float  # of PWPF, as in PwpfParams
    lag: float  # [s]
    trigger_on: float
    trigger_off: float
    droop: float  # see vehicle.Air
    thrust: Array  # (jets,) [N]
    opposing: NDArray[np.int64]  # pairs that push against each other, shape (n, 2)
    pause: float  # of PWPF: between two pulses [s]


def modulator_of(
    params: ModulatorParams, vehicle: Vehicle, period: float, pause: float | None = None
) -> Modulator:
    """The constants of the configured modulator.

    Args:
        params: the configured modulator.
        vehicle: its jets and valves; the times are those of flow.
        period: [s].
        pause: of PWPF, between two pulses; None: the shortest off-time of the valves [s].
    """
    kinds = {PwmParams: PWM, SigmaDeltaParams: SIGMA_DELTA, PwpfParams: PWPF}
    pwpf = params if isinstance(params, PwpfParams) else PwpfParams()
    return Modulator(
        kinds[type(params)], period, vehicle.valve.min_on_s, vehicle.valve.min_off_s,
        pwpf.gain, pwpf.lag_s, pwpf.trigger_on, pwpf.trigger_off, vehicle.air.droop,
        np.array([jet.thrust for jet in vehicle.jets]),
        np.array(opposing_pairs(vehicle.jets), dtype=np.int64).reshape(-1, 2),
        vehicle.valve.min_off_s if pause is None else pause,
    )  # fmt: skip


class Carried(NamedTuple):
    """Memory of a modulator, changed in place."""

    rest: Array  # SIGMA_DELTA: wanted and not yet fired; PWPF: left of a pause, (jets,) [s]
    filter: Array  # of PWPF, (jets,)
    open: Array  # of PWPF: 1 while the valve is open, (jets,)


@compiled
def pulses(p, carried, duty, share):
    """On-time and offset of each jet, both (jets,) [s]; 0 <= offset, offset + on <= period.

    Args:
        p: Modulator.
        carried: Carried.
        duty: without droop, shape (jets,).
        share: of its thrust that a command adds to each jet, shape (jets,).
    """
    if p.kind == SIGMA_DELTA:
        return fire_with_carry(p, duty, carried.rest, p.thrust * share)
    on, offset, together = np.empty_like(duty), np.empty_like(duty), duty.sum()
    longer = against_droop(duty, p.droop)
    for j in range(duty.shape[0]):
        if p.kind == PWM:
            on[j] = realisable(longer[j] * p.period, p.period, p.min_on, p.min_off)
            offset[j] = 0.5 * (p.period - on[j])
        else:  # these pulses are not nested: each other jet flows for its share of the time
            beside = 1.0 + p.droop * (together - duty[j])
            on[j], offset[j] = pulse_frequency(p, carried, j, min(1.0, beside * duty[j]))
    return on, offset


@compiled
def against_droop(on, droop):
    """The lengths at which centred pulses give, with droop, the impulse of `on` without.

    The pulses are nested. While the pulse of jet j flows, a longer one flows all the time and a
    shorter one for its whole length, so

        T_j = on_j + k sum_{i != j} min(on_i, on_j)

    gives each jet its impulse exactly, if no T_j is longer than the period.

    Args:
        on: shape (jets,), in any unit of time.
        droop: k of vehicle.Air.
    """
    longer = on.copy()
    if droop > 0.0:
        for j in range(on.shape[0]):
            for i in range(on.shape[0]):
                if i != j:
                    longer[j] += droop * min(on[i], on[j])
    return longer


@compiled
def realisable(on, period, min_on, min_off):
    """The nearest on-time that a valve can execute in one period [s].

    Zero, or at least the minimum on-time. A centred pulse leaves half its gap on either side, which
    must be at least the minimum off-time, or zero.
    """
    longest = period - 2.0 * min_off
    if longest < min_on:  # a pulse with pauses does not fit: all or nothing
        return period if on > 0.5 * period else 0.0
    if on > longest:
        return longest if on - longest < period - on else period
    if on < min_on:
        return min_on if on > 0.5 * min_on else 0.0
    return on


@compiled
def fire_with_carry(p, duty, carry, thrust):
    """Centred pulses for a duty and the remainder so far; `carry` is updated in place.

    Args:
        p: Modulator.
        duty: without droop, shape (jets,).
        carry: wanted and not yet fired, shape (jets,) [s].
        thrust: that a command adds to each jet, shape (jets,).

    Returns:
        on-times and offsets, both of shape (jets,) [s].
    """
    # one period at most: a saturated jet must not fire for minutes afterwards
    wish = duty * p.period + np.minimum(np.maximum(carry, -p.period), p.period)
    for k in range(p.opposing.shape[0]):  # opposing jets carry only the difference
        i, j = p.opposing[k]
        if thrust[i] <= 0.0 or thrust[j] <= 0.0:
            continue
        impulse = thrust[i] * wish[i] - thrust[j] * wish[j]
        wish[i] = max(0.0, impulse) / thrust[i]
        wish[j] = max(0.0, -impulse) / thrust[j]
    due = np.empty_like(wish)
    for j in range(wish.shape[0]):
        # no rounding up to the shortest pulse: the remainder is fired later
        due[j] = min(wish[j], p.period) if wish[j] >= p.min_on else 0.0
    on = against_droop(due, p.droop)
    for j in range(wish.shape[0]):
        carry[j] = wish[j] - due[j]
        if due[j] > 0.0:
            # what droop asks for beyond the period is lost, as the demand beyond full thrust is
            worth, possible = due[j] / on[j], min(on[j], p.period)
            on[j] = realisable(possible, p.period, p.min_on, p.min_off)
            carry[j] += (possible - on[j]) * worth
    return on, 0.5 * (p.period - on)


@compiled
def pulse_frequency(p, carried, j, duty):
    """On-time and offset of jet `j` by PWPF.

    Lag filter f' = (gain (duty - y) - f) / lag, y = 1 from f > trigger_on to f < trigger_off.
    """
    value, period, begin = carried.filter[j], p.period, 0.0
    shortest = min(p.min_on, period)  # a valve that closes slowly may flow for longer than that
    shut, opened = p.gain * duty, p.gain * (duty - 1.0)  # targets of the filter
    if carried.open[j] == 0.0:
        begin = max(crossing(value, shut, p.trigger_on, 1.0, p.lag), carried.rest[j])
        if begin > period - shortest:  # the rest of the period is too short
            carried.filter[j] = lagged(value, shut, period, p.lag)
            carried.rest[j] = max(0.0, carried.rest[j] - period)
            return 0.0, 0.0
        value = lagged(value, shut, begin, p.lag)
    elif shortest == period:
        shortest = 0.0  # it has been open for a whole plan, and may close
    left = period - begin
    width = max(crossing(value, opened, p.trigger_off, -1.0, p.lag), shortest)
    if width < left:  # closes inside the period; the filter recovers in the rest of it
        value = lagged(value, opened, width, p.lag)
        carried.filter[j] = lagged(value, shut, left - width, p.lag)
        carried.open[j] = 0.0
        carried.rest[j] = max(0.0, p.pause - (left - width))
        return width, begin
    carried.filter[j] = lagged(value, opened, left, p.lag)
    carried.open[j], carried.rest[j] = 1.0, 0.0
    return left, begin


@compiled
def lagged(value, target, span, lag):
    """The filter, heading for `target`, after `span` [s]."""
    return target + (value - target) * math.exp(-span / lag)


@compiled
def crossing(value, target, level, direction, lag):
    """Time until the filter passes `level` upwards (direction 1) or downwards (-1) [s]; or inf."""
    if direction * (value - level) >= 0.0:
        return 0.0
    if direction * (target - level) <= 0.0:
        return math.inf
    return lag * math.log((value - target) / (level - target))
