"""Confidence interval of a success rate.

Source: E. B. Wilson, "Probable inference, the law of succession, and statistical inference",
Journal of the American Statistical Association 22, 1927; as scipy computes it. Its coverage is near
the nominal one for few runs and for rates near 0 or 1, where the usual interval collapses.
"""

from msgspec import Struct
from scipy.stats import binomtest


class Rate(Struct, frozen=True):
    """Successes among runs, with the interval that covers the true rate."""

    runs: int
    succeeded: int
    rate: float | None
    low: float
    high: float
    confidence: float


def success_rate(succeeded: int, runs: int, confidence: float) -> Rate:
    """Wilson's interval; 0 to 1 without runs."""
    if runs == 0:
        return Rate(0, 0, None, 0.0, 1.0, confidence)
    found = binomtest(succeeded, runs).proportion_ci(confidence, method="wilson")
    return Rate(runs, succeeded, succeeded / runs, float(found.low), float(found.high), confidence)
