"""`testbed calibrate thrust`: thrust of one jet from pulses on a load cell."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from testbed.identification.columns import LogRefusedError, NumericColumns

Array = NDArray[np.float64]
GRAM_FORCE = 9.80665e-3  # [N]
SETTLING = 2.0  # [s] after a change that the scale still filters
LEAST = 1.0  # [s] of steady reading per pulse
HUGE = 100.0  # [N] of one jet


def thrust_of(
    columns: NumericColumns, time: str, force: str, unit: str, pulse: str
) -> dict[str, Any]:
    """Mean thrust, its interval and its change over the run, from a stand log.

    Args:
        columns: of the log.
        time: column of time [s].
        force: column of the reading.
        unit: of the reading: N or g.
        pulse: column that is above 0 while the jet is on, such as a bit mask or a phase number.

    Raises:
        LogRefusedError: there are no pulses with a steady reading.
    """
    t, on = columns.whole(time), columns.whole(pulse) > 0
    reading = columns[force] * (GRAM_FORCE if unit == "g" else 1.0)
    known = np.isfinite(reading)
    edges = np.flatnonzero(np.diff(on.astype(int))) + 1
    parts = np.split(np.arange(len(t)), edges)
    levels: list[tuple[float, float]] = []  # time [s] and reading [N] of each pulse
    rests: list[tuple[float, float]] = []
    for rows in parts:
        steady = rows[(t[rows] > t[rows[0]] + SETTLING) & known[rows]]
        if len(steady) < 3 or t[steady[-1]] - t[steady[0]] < LEAST:
            continue
        (levels if on[rows[0]] else rests).append((t[steady].mean(), np.median(reading[steady])))
    if len(levels) < 2 or not rests:
        raise LogRefusedError(
            where=columns.where, expected="two pulses or more, with rest before and after",
            found=f"{len(levels)} pulses, {len(rests)} rests of more than {SETTLING + LEAST:g} s",
        )  # fmt: skip
    times = np.array([level[0] for level in levels])
    zero = np.interp(times, [r[0] for r in rests], [r[1] for r in rests])
    force_n = np.array([level[1] for level in levels]) - zero
    mean, spread = float(np.mean(force_n)), float(np.std(force_n, ddof=1))
    if not 0.0 < abs(mean) < HUGE:
        raise LogRefusedError(
            where=columns.where, expected=f"a thrust below {HUGE:g} N", found=f"{mean:.4g} N",
            hint="is the unit of the reading right (--unit)?",
        )  # fmt: skip
    reach = float(stdtrit(len(force_n) - 1, 0.975) * spread / np.sqrt(len(force_n)))
    third = max(1, len(force_n) // 3)
    return {
        "thrust_n": abs(mean), "low_n": abs(mean) - reach, "high_n": abs(mean) + reach,
        "pulses": len(force_n), "pulse_spread": spread / abs(mean),
        "change": float(np.mean(force_n[-third:]) / np.mean(force_n[:third]) - 1.0),
    }  # fmt: skip
