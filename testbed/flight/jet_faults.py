r"""Whether each jet really pushes: what the commands explain of the motion, jet by jet.

In a tick the estimate of momentum moves by more than plan and bias say: that is the residual e. A
jet that gives nothing leaves a residual of minus its own effect x_j, every time it fires. So e is
compared with every x_j over the last ten seconds or so, in units of the residual's own spread:

    S_j = sum e x_j / s^2,    N_jk = sum x_j x_k / s^2,    both forgotten at the rate 1/MEMORY

S_j / N_jj is how much of the jet is missing (-1: all of it, if it shows in full). Jets that always
fire together are told apart by their torques.

Where all jets are well S_j has the variance N_jj from noise, and d^2 sum_k N_jk^2 because no jet
has quite the thrust of the file, with its tolerance d: after a rest, a hard turn with one that is
too strong looks as if its weaker companions gave nothing. Divided by the root of both together, S_j
says how many standard deviations the jet is from one that is well.

The velocity estimate follows the poses with a lag of about a jet period, so x_j is smoothed alike.
The estimator's bias would take over what is missing in the mean within half a second; the one here
is an average over SETTLING, so that it knows tilt and drag but not what is missing since a while.
"""

import numpy as np
from numpy.typing import NDArray

from testbed.core.compiled import compiled, settled
from testbed.core.jets import effect_matrix
from testbed.core.types import State
from testbed.core.vehicle import Vehicle

Array = NDArray[np.float64]

MEMORY = 10.0  # [s]
SETTLING = 20.0  # [s]
LAG = 0.35  # [s] of the velocity estimate behind the pulses
ENOUGH = 0.3  # share of a jet's effect that has to be missing; thrust spread is 0.05
SPREAD = 1.5e-3  # of a velocity residual at the start, one sigma [m/s]
SPIN_SPREAD = 5e-3  # [rad/s]


@compiled
def weigh(
    before,
    now,
    duty,
    share,
    effect,
    smooth,
    sums,
    spread,
    bias,
    settling,
    memory,
    lag,
    thrust,
    period,
):
    """Add one tick to the sums, in place.

    Args:
        before: theta, vx, vy, omega at the last tick, shape (4,).
        now: the same at this one.
        duty: of the plan in between, shape (n,).
        share: of the thrust that the supply gave.
        effect: acceleration by each fully open jet in B, shape (3, n).
        smooth: smoothed effects in W, shape (n, 3).
        sums: N, and S as its last row, shape (n + 1, n).
        spread: variance of the residual in push and turn, shape (2,).
        bias: slow mean of what the jets do not explain, shape (3,) [m/s^2, rad/s^2].
        settling: share of a tick in it.
        memory: share kept of the sums per tick.
        lag: share kept of the smoothed effects per tick.
        thrust: tolerance of a jet, one sigma, relative.
        period: [s].

    Returns:
        standard deviations by which the worst jet gives too little, and which one that is.
    """
    n = duty.shape[0]
    theta = before[0] + 0.5 * period * before[3]
    c, s = np.cos(theta), np.sin(theta)
    ex = now[1] - before[1] - period * bias[0]
    ey = now[2] - before[2] - period * bias[1]
    ew = now[3] - before[3] - period * bias[2]
    worst, which = 0.0, 0
    for j in range(n):
        open_for = period * (duty[j] * share)
        x = open_for * (c * effect[0, j] - s * effect[1, j])
        y = open_for * (s * effect[0, j] + c * effect[1, j])
        w = open_for * effect[2, j]
        ex -= x
        ey -= y
        ew -= w
        smooth[j, 0] = lag * smooth[j, 0] + (1.0 - lag) * x
        smooth[j, 1] = lag * smooth[j, 1] + (1.0 - lag) * y
        smooth[j, 2] = lag * smooth[j, 2] + (1.0 - lag) * w
    ex, ey, ew = min(max(ex, -0.02), 0.02), min(max(ey, -0.02), 0.02), min(max(ew, -0.1), 0.1)
    bias[0] += settling * ex / period
    bias[1] += settling * ey / period
    bias[2] += settling * ew / period
    spread[0] += (1.0 - memory) * (0.5 * (ex * ex + ey * ey) - spread[0])
    spread[1] += (1.0 - memory) * (ew * ew - spread[1])
    for j in range(n):
        x, y, w = smooth[j, 0] / spread[0], smooth[j, 1] / spread[0], smooth[j, 2] / spread[1]
        sums[n, j] = memory * sums[n, j] + ex * x + ey * y + ew * w
        variance = 0.0
        for k in range(n):
            sums[j, k] = (
                memory * sums[j, k] + x * smooth[k, 0] + y * smooth[k, 1] + w * smooth[k, 2]
            )
            variance += (thrust * sums[j, k]) ** 2
        if sums[n, j] < -ENOUGH * sums[j, j]:
            sigmas = -sums[n, j] / np.sqrt(sums[j, j] + variance)
            if sigmas > worst:
                worst, which = sigmas, j
    return worst, which


class JetFaultDetector:
    """One vehicle's jets in the light of its motion."""

    def __init__(self, vehicle: Vehicle, period: float) -> None:
        n = len(vehicle.jets)
        scale = np.array([[vehicle.mass], [vehicle.mass], [vehicle.inertia]])
        self._effect = effect_matrix(vehicle.jets, about=vehicle.com) / scale
        self._smooth, self._sums = np.zeros((n, 3)), np.zeros((n + 1, n))
        self._spread = np.array([SPREAD**2, SPIN_SPREAD**2])
        self._memory, self._lag = 1.0 - period / MEMORY, 1.0 - min(1.0, period / LAG)
        self._period, self._thrust = period, vehicle.tolerance.thrust
        self._bias, self._ticks = np.zeros(3), 0
        self._before: Array | None = None
        self.missing = 0.0  # standard deviations by which the worst jet gives too little
        self.jet = 0
        self._weigh = settled(weigh)

    def look(self, state: State, duty: Array, share: float) -> None:
        """Note a tick: the estimate, and the duties (n,) of the plan that led to it."""
        twist = state.twist
        now = np.array((state.pose.theta, twist.vx, twist.vy, twist.omega))
        if self._before is not None:
            self._ticks += 1
            settling = max(1.0 / self._ticks, self._period / SETTLING)
            self.missing, self.jet = self._weigh(
                self._before, now, duty, share, self._effect, self._smooth, self._sums,
                self._spread, self._bias, settling, self._memory, self._lag, self._thrust,
                self._period,
            )  # fmt: skip
        self._before = now
