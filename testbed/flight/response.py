"""Computes how fast the estimate shows an unknown push.

The estimator finds such a push in the poses, later with noisier cameras. Its response to a push is
computed here from its gains, without noise, so that suspicions about jets can be compared with the
estimate.
"""

import numpy as np
from numpy.typing import NDArray

from testbed.core.compiled import compiled
from testbed.core.table import Mocap
from testbed.core.vehicle import Vehicle
from testbed.flight.estimator import EstimatorParams, correct, filter_of, predict_covariance

Array = NDArray[np.float64]

LOOKS = 12  # after these the whole push shows
FRAMES = 3000  # until the gains are settled
OUT_OF_STEP = 0.3  # time from the push to the first frame, in frames: any value works


@compiled
def settled(noise, white, walk, frame):
    """The gains, once they have settled; arguments as of `shown`."""
    cov = np.diag(np.array([noise, 1e-4, 1e-5]))
    gain = (0.0, 0.0, 0.0)
    for _ in range(FRAMES):
        predict_covariance(cov, frame, white, walk)
        gain = correct(cov, noise)
    return gain


@compiled
def shown(noise, white, walk, frame, latency, period):
    """Share of a push that appears in the estimate in each look since it began, shape (LOOKS,).

    Args:
        noise: variance of a pose.
        white: see estimator.predict_covariance.
        walk: the same.
        frame: time between two poses [s].
        latency: from a pose to the instant that the estimate is for [s].
        period: of the looks [s].
    """
    gain = settled(noise, white, walk, frame)
    gained = np.zeros(LOOKS)
    x = v = bias = before = 0.0
    seen_at, due = 0.0, OUT_OF_STEP * frame
    for k in range(LOOKS):
        now = (k + 1) * period
        while due <= now - latency:
            h = due - seen_at
            x += h * (v + 0.5 * h * bias)
            v += h * bias
            error = 0.5 * due * due - x  # the push is 1 m/s^2
            x += gain[0] * error
            v += gain[1] * error
            bias += gain[2] * error
            seen_at, due = due, due + frame
        speed = v + bias * (now - seen_at) if seen_at > 0.0 else 0.0
        gained[k] = (speed - before) / period
        before = speed
    return gained


def response(params: EstimatorParams, vehicle: Vehicle, mocap: Mocap, period: float) -> Array:
    """Response of the estimate to a short push, per look, for force and torque: (LOOKS, 2).

    `period` is that of the looks [s].
    """
    frame = mocap.frame_s
    believes = filter_of(params, vehicle, mocap)
    noise, turn_noise = believes.noise.tolist()
    white, walk, turn_white, turn_walk = believes.walk.tolist()
    latency = mocap.latency_s + vehicle.command_delay_s + vehicle.valve.open_delay_s
    of_push = shown(noise, white, walk, frame, latency, period)
    of_turn = shown(turn_noise, turn_white, turn_walk, frame, latency, period)
    return np.diff(np.column_stack((of_push, of_turn)), axis=0, prepend=0.0)
