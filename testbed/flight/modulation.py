"""Converts a continuous duty to on/off pulses of a solenoid: one pulse per jet and period.

All pulses are centred in the period, so that their impulse has the same centre in time as the
steady thrust they replace.

`pwm`          pulse width only, rounded to the valve's limits: a dead band around zero.
`sigma_delta`  pulse width, and the unfired remainder is carried to the next period; remainders of
               two opposing jets cancel. No dead band, exact on average.
`pwpf`         pulse-width pulse-frequency: a lag filter and a Schmitt trigger per jet. The
               textbook's analogue form fires at any time; here each period gets the first pulse of
               the filter.
"""

import math
from typing import Protocol

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from testbed.core.compiled import compiled, settled
from testbed.core.error import MismatchError
from testbed.core.jets import opposing_pairs
from testbed.core.vehicle import NonNegative, Positive, Vehicle

Array = NDArray[np.float64]
Pulses = tuple[Array, Array]  # on and offset per jet, shape (jets,) [s]


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


class Modulator(Protocol):
    """Computes the pulses of one period; may carry over a remainder."""

    def pulses(self, duty: Array) -> Pulses:
        """On-time and offset of each jet [s]; 0 <= offset, offset + on <= period."""
        ...


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
def fire_with_carry(duty, carry, thrust, opposing, period, min_on, min_off):
    """Centred pulses for a duty and the remainder so far; `carry` is updated in place.

    Args:
        duty: shape (jets,).
        carry: wanted and not yet fired, shape (jets,) [s].
        thrust: shape (jets,).
        opposing: pairs of jets that push against each other, shape (n, 2).
        period: [s].
        min_on: [s].
        min_off: [s].

    Returns:
        on-times and offsets, both of shape (jets,) [s].
    """
    # one period at most: a saturated jet must not fire for minutes afterwards
    wish = duty * period + np.minimum(np.maximum(carry, -period), period)
    for k in range(opposing.shape[0]):  # opposing jets carry only the difference
        i, j = opposing[k]
        impulse = thrust[i] * wish[i] - thrust[j] * wish[j]
        wish[i] = max(0.0, impulse) / thrust[i]
        wish[j] = max(0.0, -impulse) / thrust[j]
    on = np.empty_like(wish)
    for j in range(wish.shape[0]):
        # no rounding up to the shortest pulse: the remainder is fired later
        due = wish[j] >= min_on
        on[j] = realisable(wish[j], period, min_on, min_off) if due else 0.0
        carry[j] = wish[j] - on[j]
    return on, 0.5 * (period - on)


class Pwm:
    """Plain pulse width."""

    def __init__(self, vehicle: Vehicle, period: float) -> None:
        self._limits = period, vehicle.valve.min_on_s, vehicle.valve.min_off_s

    def pulses(self, duty: Array) -> Pulses:
        """See `Modulator`."""
        period = self._limits[0]
        on = np.array([realisable(u * period, *self._limits) for u in duty.tolist()])
        return on, 0.5 * (period - on)


class SigmaDelta:
    """Pulse width with the remainder carried over."""

    def __init__(self, vehicle: Vehicle, period: float) -> None:
        self._limits = period, vehicle.valve.min_on_s, vehicle.valve.min_off_s
        self._thrust = np.array([jet.thrust for jet in vehicle.jets])
        self._opposing = np.array(opposing_pairs(vehicle.jets), dtype=np.int64).reshape(-1, 2)
        self._carry = np.zeros(len(vehicle.jets))
        self._fire = settled(fire_with_carry)

    def pulses(self, duty: Array) -> Pulses:
        """See `Modulator`."""
        return self._fire(duty, self._carry, self._thrust, self._opposing, *self._limits)


class Pwpf:
    """Lag filter f' = (gain (duty - y) - f) / lag, y = 1 from f > trigger_on to f < trigger_off."""

    def __init__(self, params: PwpfParams, vehicle: Vehicle, period: float) -> None:
        self._p = params
        self._valve = vehicle.valve
        self._period = period
        self._filter = [0.0] * len(vehicle.jets)
        self._on = [False] * len(vehicle.jets)

    def pulses(self, duty: Array) -> Pulses:
        """See `Modulator`."""
        fired = np.array([self._pulse(j, u) for j, u in enumerate(duty.tolist())])
        return fired[:, 0], fired[:, 1]

    def _pulse(self, j: int, duty: float) -> tuple[float, float]:
        p, period = self._p, self._period
        start = 0.0
        if not self._on[j]:
            start = self._cross(j, p.gain * duty, p.trigger_on, rising=True)
            if start > period - self._valve.min_on_s:  # the rest of the period is too short
                self._advance(j, p.gain * duty, period)
                return 0.0, 0.0
            self._advance(j, p.gain * duty, start)
            self._on[j] = True
        left = period - start
        width = self._cross(j, p.gain * (duty - 1.0), p.trigger_off, rising=False)
        width = max(width, self._valve.min_on_s)
        if width < left:  # closes inside the period; the filter recovers in the rest of it
            self._advance(j, p.gain * (duty - 1.0), width)
            self._advance(j, p.gain * duty, left - width)
            self._on[j] = False
            return width, start
        self._advance(j, p.gain * (duty - 1.0), left)
        return left, start

    def _advance(self, j: int, target: float, span: float) -> None:
        self._filter[j] = target + (self._filter[j] - target) * math.exp(-span / self._p.lag_s)

    def _cross(self, j: int, target: float, level: float, *, rising: bool) -> float:
        """Time until the filter, heading for `target`, passes `level` [s]; inf if it never does."""
        value = self._filter[j]
        if (value >= level) if rising else (value <= level):
            return 0.0
        if (target <= level) if rising else (target >= level):
            return math.inf
        return self._p.lag_s * math.log((value - target) / (level - target))


def make_modulator(params: ModulatorParams, vehicle: Vehicle, period: float) -> Modulator:
    """Create the modulator of the configuration."""
    match params:
        case PwmParams():
            return Pwm(vehicle, period)
        case SigmaDeltaParams():
            return SigmaDelta(vehicle, period)
        case PwpfParams():
            return Pwpf(params, vehicle, period)
