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
def whiten(white, passes, x, bias, period):
    """Add a look to the filtered causes and residual, see `jet_faults.residual`.

    What `bias` has taken from the residual counts, too.
    """
    for axis in range(3):
        for i in range(x.shape[1]):
            white[axis, i] = passes * white[axis, i] + x[axis, i]
    for axis in range(2):
        white[axis, -1] += period * bias[axis]


@compiled
def hear_whitened(fine, white, quiet, passes, rough, counted, period):
    """Add the filtered look to its window.

    Args:
        fine: window.Window.
        white: see `whiten`.
        quiet: see jet_faults.Known.
        passes: the same.
        rough: the same.
        counted: looks so far.
        period: of a look [s].
    """
    remembers = 1.0 - min(0.5, period / MEMORY_S)
    if fine.spread[0] == 0.0:
        fine.spread[:] = quiet
    trust = max(1.0 - remembers, 1.0 / (counted + BELIEVED))
    listen(fine, white, trust, remembers, rough / (1.0 - passes * passes), WHITE)


@compiled
def weigh_whitened(fine, sure, slope, period, found):
    """Keep what the window of filtered looks says in `found`, a record of VERDICT; begin a block.

    Args:
        fine: window.Window.
        sure: see window.factor.
        slope: the same.
        period: of a look [s].
        found: changed in place.
    """
    forget(found)
    root = factor(fine.told, sure, slope)
    least, y = borrowed(root)
    decide(fine, least, y, period, True, found)
    age(fine)
    keep(root)
