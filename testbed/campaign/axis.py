"""Axes of a chart: position of a number on the page, round ticks, and labels."""

import math
from collections.abc import Sequence
from typing import NamedTuple

LOG_FROM = 6.0  # ratio of largest to least number that calls for a logarithmic axis


class Axis(NamedTuple):
    """Maps numbers to positions on the page."""

    low: float
    high: float
    start: float  # position on the page
    end: float
    title: str
    log: bool = False
    whole: bool = False  # counts: no ticks between whole numbers

    @property
    def words(self) -> str:
        """The axis title."""
        return f"{self.title}, log scale" if self.log else self.title

    def at(self, value: float) -> float:
        """Position of a number on the page."""
        share = (value - self.low) / (self.high - self.low)
        if self.log:
            share = math.log(value / self.low) / math.log(self.high / self.low)
        return self.start + (self.end - self.start) * share

    def value(self, share: float) -> float:
        """The number at a share, 0 to 1, of the axis."""
        if self.log:
            return self.low * (self.high / self.low) ** share
        return self.low + share * (self.high - self.low)

    def ticks(self) -> list[float]:
        """Round numbers within the axis."""
        if self.log:
            return log_ticks(self.low, self.high)
        return [t for t in ticks(self.low, self.high) if not self.whole or t == round(t)]

    def labels(self) -> list[tuple[float, str]]:
        """Ticks with labels, with enough digits to tell them apart."""
        values = self.ticks()
        tries = [[number(value, digits) for value in values] for digits in range(4, 13)]
        words = next((one for one in tries if len(set(one)) == len(one)), tries[-1])
        return list(zip(values, words, strict=True))


def wants_log(values: Sequence[float]) -> bool:
    """Whether the range is so wide that a linear axis would hide the small numbers."""
    return min(values) > 0.0 and max(values) > LOG_FROM * min(values)


def log_span(values: Sequence[float], room: float = 0.04) -> tuple[float, float]:
    """Like `span`, for a logarithmic axis."""
    more = (max(values) / min(values)) ** room
    return min(values) / more, max(values) * more


def log_ticks(low: float, high: float) -> list[float]:
    """1, 2 and 5 times each power of ten; only the powers if the range is wide."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1.0, 2.0, 5.0) if math.log10(high / low) < 3.0 else (1.0,)
    return [m * 10.0**n for n in powers for m in steps if low <= m * 10.0**n <= high]


def span(values: Sequence[float], room: float = 0.04) -> tuple[float, float]:
    """Least to largest with some margin; never zero width."""
    low, high = min(values), max(values)
    if not high - low > 1e-12 * max(1.0, abs(high)):
        return low - 0.5 * (abs(low) or 1.0), high + 0.5 * (abs(high) or 1.0)
    return low - room * (high - low), high + room * (high - low)


def ticks(low: float, high: float, count: int = 5) -> list[float]:
    """Round numbers between `low` and `high`, about `count`."""
    raw = (high - low) / count
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(power * m for m in (1.0, 2.0, 2.5, 5.0, 10.0) if power * m >= raw)
    first = math.ceil(low / step - 1e-9)
    return [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]


def number(value: float, digits: int = 4) -> str:
    """A number as a label."""
    return f"{0.0 if abs(value) < 1e-12 else value:.{digits}g}".replace("-", "\N{MINUS SIGN}")
