"""From a continuous duty to on/off pulses a solenoid can follow: one pulse per jet and period.

All pulses are centred in the period, so that their impulse has the same moment in time as the
steady thrust they stand for.

`pwm`          pulse width only: what is shorter than the valve can do is lost, a dead band.
`sigma_delta`  pulse width, and the unfired remainder is carried to the next period; remainders of
               two opposing jets cancel. No dead band, on average exact.
`pwpf`         pulse-width pulse-frequency: a lag filter and a Schmitt trigger per jet. The
               textbook's analogue form fires when it likes; here each period gets the first pulse
               that the filter asks for.
"""

import math
from collections.abc import Sequence
from typing import Literal, Protocol

from msgspec import Struct

from testbed.core.jets import opposing_pairs
from testbed.core.vehicle import Positive, Valve, Vehicle

Pulses = tuple[list[float], list[float]]  # on and offset per jet [s]


class PwmParams(Struct, frozen=True, forbid_unknown_fields=True, tag="pwm"):
    """No parameters: the valve file has the minimum times."""


class SigmaDeltaParams(Struct, frozen=True, forbid_unknown_fields=True, tag="sigma_delta"):
    """No parameters: the valve file has the minimum times."""


class PwpfParams(Struct, frozen=True, forbid_unknown_fields=True, tag="pwpf"):
    """Filter and trigger; defaults keep the static gain within a few percent above duty 0.1."""

    gain: Positive = 4.0  # of the filter
    lag_s: Positive = 0.1
    trigger_on: Positive = 0.6  # filter output that opens the valve
    trigger_off: Positive = 0.2  # and closes it again


ModulatorParams = PwmParams | SigmaDeltaParams | PwpfParams
ModulatorName = Literal["pwm", "sigma_delta", "pwpf"]


class Modulator(Protocol):
    """Pulses for one period; may remember what it could not fire."""

    def pulses(self, duty: Sequence[float]) -> Pulses:
        """On-time and offset of each jet [s]; 0 <= offset, offset + on <= period."""
        ...


def realisable(on: float, period: float, valve: Valve) -> float:
    """The nearest on-time that the valve can do in one period [s].

    Shorter than the minimum on-time: nothing. A centred pulse leaves half its gap on either side,
    which must be at least the minimum off-time, or none at all.
    """
    if on < valve.min_on_s:
        return 0.0
    longest = max(0.0, period - 2.0 * valve.min_off_s)
    if on > longest:
        on = longest if on - longest < period - on else period
    return on if on >= valve.min_on_s else 0.0


def _centred(on: list[float], period: float) -> Pulses:
    return on, [0.5 * (period - width) for width in on]


class Pwm:
    """Plain pulse width."""

    def __init__(self, vehicle: Vehicle, period: float) -> None:
        self._valve = vehicle.valve
        self._period = period

    def pulses(self, duty: Sequence[float]) -> Pulses:
        """See `Modulator`."""
        period = self._period
        return _centred([realisable(u * period, period, self._valve) for u in duty], period)


class SigmaDelta:
    """Pulse width with the remainder carried over."""

    def __init__(self, vehicle: Vehicle, period: float) -> None:
        self._valve = vehicle.valve
        self._period = period
        self._thrust = [jet.thrust for jet in vehicle.jets]
        self._opposing = opposing_pairs(vehicle.jets)
        self._carry = [0.0] * len(vehicle.jets)  # wanted and not yet fired [s]

    def pulses(self, duty: Sequence[float]) -> Pulses:
        """See `Modulator`."""
        period, thrust = self._period, self._thrust
        # one period's worth at most: a saturated jet must not repay for minutes afterwards
        wish = [
            u * period + max(-period, min(period, left))
            for u, left in zip(duty, self._carry, strict=True)
        ]
        for i, j in self._opposing:  # two that push against each other owe only the difference
            impulse = thrust[i] * wish[i] - thrust[j] * wish[j]
            wish[i] = max(0.0, impulse) / thrust[i]
            wish[j] = max(0.0, -impulse) / thrust[j]
        on = [realisable(w, period, self._valve) for w in wish]
        self._carry = [w - fired for w, fired in zip(wish, on, strict=True)]
        return _centred(on, period)


class Pwpf:
    """Lag filter f' = (gain (duty - y) - f) / lag, y = 1 from f > trigger_on to f < trigger_off."""

    def __init__(self, params: PwpfParams, vehicle: Vehicle, period: float) -> None:
        self._p = params
        self._valve = vehicle.valve
        self._period = period
        self._filter = [0.0] * len(vehicle.jets)
        self._on = [False] * len(vehicle.jets)

    def pulses(self, duty: Sequence[float]) -> Pulses:
        """See `Modulator`."""
        fired = [self._pulse(j, u) for j, u in enumerate(duty)]
        return [on for on, _ in fired], [offset for _, offset in fired]

    def _pulse(self, j: int, duty: float) -> tuple[float, float]:
        p, period = self._p, self._period
        start = 0.0
        if not self._on[j]:
            start = self._cross(j, p.gain * duty, p.trigger_on, rising=True)
            self._advance(j, p.gain * duty, min(start, period))
            if start >= period:
                return 0.0, 0.0
            self._on[j] = True
        left = period - start
        width = self._cross(j, p.gain * (duty - 1.0), p.trigger_off, rising=False)
        width = max(width, self._valve.min_on_s)
        if width < left:  # closes inside the period; the rest of it the filter just recovers
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
    """The modulator that the configuration names."""
    match params:
        case PwmParams():
            return Pwm(vehicle, period)
        case SigmaDeltaParams():
            return SigmaDelta(vehicle, period)
        case PwpfParams():
            return Pwpf(params, vehicle, period)
