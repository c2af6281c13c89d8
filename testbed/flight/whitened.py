"""A window for jets that are too weak, in which the cameras' noise costs least.

The residual of a look is the difference of two velocities, so its noise is mostly taken back by the
next look, while the push of a jet stays. Looks on their own, and sums of them, take this noise for
as many independent ones. Here residuals and their causes pass the filter

    r_k = e_k + a r_{k-1},   0 < a < 1,

which makes the noise of such differences white if a is right (Wold's representation of a moving
average; A. C. Harvey, "Forecasting, structural time series models and the Kalman filter", 1989,
section 2.4). With a = 1 it would be the velocity itself, for which every slow disturbance adds up;
the time constant of `a` is chosen between both. A short pulse then counts for as long as the
velocity shows it. Everything else is as in the other windows, see `jet_faults`.
"""

from testbed.core.compiled import borrowed, compiled, keep
from testbed.flight.window import age, decide, factor, forget, listen

PASSES_S = 0.3  # time constant of the filter [s]
MEMORY_S = 40.0  # time constant of forgetting [s]
BELIEVED = 30.0  # weight of the spread by the files at the start [looks]
WHITE = 2.0  # variance of the difference of two residuals, in variances of one


@compiled
def whiten(white, passes, e, x, bias, period):
    """Add a look to the filtered causes and, in the last row, the residual; `bias` counts, too."""
    white *= passes
    white[:-1] += x
    white[-1] += e
    for axis in range(2):
        white[-1, axis] += period * bias[axis]


@compiled
def weigh_whitened(known, m, heard, due):
    """Add the filtered look to its window, and if `due`, keep what it says in `m.fine`.

    Args:
        known: jet_faults.Known.
        m: jet_faults.MEMORY.
        heard: jet_faults.Heard.
        due: whether a block ends.
    """
    fine, remembers = heard.fine, 1.0 - min(0.5, known.period / MEMORY_S)
    if fine.spread[0] == 0.0:
        fine.spread[:] = known.quiet
    trust = max(1.0 - remembers, 1.0 / (m.counted + BELIEVED))
    rough = known.rough / (1.0 - known.passes * known.passes)
    listen(fine, heard.white[-1], heard.white[:-1], trust, remembers, rough, WHITE)
    if not due:
        return
    forget(m.fine)
    root = factor(fine.told, known.sure, 1.0 / (known.bumps**2 + known.slope**2))
    least, y = borrowed(root)
    decide(fine, least, y, known.period, True, m.fine)
    age(fine.blocks)
    keep(root)
