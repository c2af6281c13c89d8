"""Axes of a chart: position of a number in the figure, round ticks, and labels."""

import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

Array = NDArray[np.float64]

LOG_FROM = 6.0  # ratio of largest to least number that calls for a logarithmic axis


class Axis(Struct, frozen=True):
    """Maps numbers to positions in the figure."""

    low: float
    high: float
    start: float  # position in the figure
    end: float
    log: bool = False
    whole: bool = False  # counts: no ticks between whole numbers

    def at(self, value: float) -> float:
        """Position of a number in the figure."""
        return self.start + (self.end - self.start) * self.share(value)

    def share(self, value: float) -> float:
        """Position of a number as a share of the axis, 0 to 1 inside."""
        if self.log:
            return math.log(max(value, self.low) / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def shares(self, values: Array) -> Array:
        """`share` of many numbers, shape (n,)."""
        if self.log:
            ratios = np.maximum(values, self.low) / self.low
            return np.log(ratios) / math.log(self.high / self.low)
        return (values - self.low) / (self.high - self.low)

    def value(self, share: float) -> float:
        """The number at a share of the axis."""
        if self.log:
            return self.low * (self.high / self.low) ** share
        return self.low + share * (self.high - self.low)

    def ticks(self, about: int = 5) -> list[float]:
        """Round numbers within the axis."""
        if self.log:
            return log_ticks(self.low, self.high)
        found = ticks(self.low, self.high, about)
        return [value for value in found if not self.whole or value == round(value)]


def wants_log(values: Sequence[float]) -> bool:
    """Whether the range is so wide that a linear axis would hide the small numbers."""
    return min(values) > 0.0 and max(values) > LOG_FROM * min(values)


def span(values: Sequence[float], log: bool = False, room: float = 0.04) -> tuple[float, float]:
    """Least to largest with some margin; never zero width."""
    low, high = min(values), max(values)
    if log:
        more = (high / low) ** room
        return low / more, high * more
    if not high - low > 1e-12 * max(1.0, abs(high)):
        return low - 0.5 * (abs(low) or 1.0), high + 0.5 * (abs(high) or 1.0)
    return low - room * (high - low), high + room * (high - low)


def log_ticks(low: float, high: float) -> list[float]:
    """1, 2 and 5 times each power of ten; only the powers if the range is wide."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1.0, 2.0, 5.0) if math.log10(high / low) < 3.0 else (1.0,)
    slack = 1.0 + 1e-9
    found = [m * 10.0**n for n in powers for m in steps]
    return [value for value in found if low / slack <= value <= high * slack]


def ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Round numbers between `low` and `high`."""
    raw = max(high - low, 1e-300) / max(about, 1)
    unit = 10.0 ** math.floor(math.log10(raw))
    step = next(k * unit for k in (1.0, 2.0, 5.0, 10.0) if k * unit >= raw * 0.999)
    first = math.ceil(low / step - 1e-9)
    return [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]


def number(value: float, digits: int = 4) -> str:
    """A number with a typographic minus sign; a tick has ten digits, a result four."""
    return f"{0.0 if abs(value) < 1e-12 else value:.{digits}g}".replace("-", "\N{MINUS SIGN}")
