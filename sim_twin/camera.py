"""Motion capture model: turns true states into delayed, noisy poses."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_twin.plant_parameters import AS_IN_THE_FILES
from sim_twin.randomness import Words, normal, stream, uniform, words
from testbed.core.compiled import borrowed, compiled, with_fixed_types
from testbed.core.rows import PoseSamples
from testbed.core.se2 import wrap_compiled
from testbed.core.table import Mocap, Spread
from testbed.core.types import PoseSample

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

ROOM = 16  # poses of a body that are not yet taken, at first


class Optics(NamedTuple):
    """Parameters of the camera system for compiled code."""

    noise: float  # [m]
    spin_noise: float  # [rad]
    latency: float  # [s]
    jitter: float  # [s]
    losing: float  # probability that a loss begins, per frame
    lost: float  # mean length of a loss [s]


class Film(NamedTuple):
    """What the cameras saw of each body, for compiled code."""

    noise: Words  # (n, WORDS) stream of noise and jitter
    losses: Words  # (n, WORDS) stream of losses
    lost_until: Array  # (n,) end of the last loss [s]
    poses: Array  # (n, room, 5) arrival, time of exposure, x, y, theta; in order of arrival
    tally: Whole  # (n, 3) poses, how many of them have arrived, how many were taken


POSES, ARRIVED, TAKEN = range(3)  # columns of `Film.tally`


@compiled
def photograph(film, optics, times, states, shown, now):
    """Measure the pose of every body at each exposure, and note which poses have arrived.

    Args:
        film: with room for one more pose of each body per exposure.
        optics: the cameras.
        times: of the exposures, shape (m,) [s].
        states: true x, y, theta, ... at these times, shape (m, v, 6).
        shown: the vehicle that each body shows, shape (m, n), or (1, n) for all exposures.
        now: [s].

    Returns:
        the largest number of poses of a body.
    """
    film, most = borrowed(film), 0
    for k in range(film.tally.shape[0]):
        poses, noise, losses = film.poses[k], film.noise[k], film.losses[k]
        taken = film.tally[k, TAKEN]
        n = film.tally[k, POSES] - taken
        for i in range(n if taken > 0 else 0):
            poses[i] = poses[i + taken]
        for m in range(times.shape[0]):
            t, lost_until = times[m], film.lost_until[k]
            # a fixed number of draws per exposure: results do not depend on how often one looks
            dx, dy, turn, late = normal(noise), normal(noise), normal(noise), normal(noise)
            begins, length = uniform(losses), uniform(losses)
            if t >= lost_until and begins < optics.losing:
                lost_until = film.lost_until[k] = t - optics.lost * np.log1p(-length)
            if t < lost_until:
                continue
            state = states[m, shown[m % shown.shape[0], k]]
            latency = optics.latency + optics.jitter * late
            arrival, i = t + max(latency, 0.5 * optics.latency), n
            while i > 0 and poses[i - 1, 0] > arrival:
                poses[i] = poses[i - 1]
                i -= 1
            n += 1
            poses[i, 0], poses[i, 1] = arrival, t
            poses[i, 2] = state[0] + optics.noise * dx
            poses[i, 3] = state[1] + optics.noise * dy
            poses[i, 4] = wrap_compiled(state[2] + optics.spin_noise * turn)
        arrived = 0
        while arrived < n and poses[arrived, 0] <= now:
            arrived += 1
        film.tally[k, POSES], film.tally[k, ARRIVED], film.tally[k, TAKEN] = n, arrived, 0
        most = max(most, n)
    return most


class Markers(NamedTuple):
    """A body of the cameras: where its markers are on its vehicle, and the cameras' clock."""

    body: int  # its number
    exact: bool  # false: the offsets below count
    x: float  # in B [m]
    y: float  # [m]
    turn: float  # [rad]
    clock: float  # of the cameras, minus that of the run [s]


@compiled
def take(film, markers, out):
    """Take the poses of a body that have arrived since the last time, in order of arrival.

    Args:
        film: of the cameras.
        markers: of the body.
        out: written to: time of exposure, x, y, heading; shape (most, 4).

    Returns:
        how many; -1: `out` is too small, and none was taken.
    """
    film = borrowed(film)
    count, poses = film.tally[markers.body], film.poses[markers.body]
    first, n = count[TAKEN], count[ARRIVED] - count[TAKEN]
    if n > out.shape[0]:
        return -1
    for i in range(n):
        t, x, y, theta = (
            poses[first + i, 1],
            poses[first + i, 2],
            poses[first + i, 3],
            poses[first + i, 4],
        )
        if not markers.exact:
            c, s = math.cos(theta), math.sin(theta)
            t, x, y, theta = (
                t + markers.clock,
                x + c * markers.x - s * markers.y,
                y + s * markers.x + c * markers.y,
                wrap_compiled(theta + markers.turn),
            )
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = t, x, y, theta
    count[TAKEN] = count[ARRIVED]
    return n


class Cameras:
    """The poses that the camera system reports for the bodies `names`."""

    def __init__(
        self, names: Sequence[str], mocap: Mocap, seed: int, lab: Spread = AS_IN_THE_FILES
    ) -> None:
        pairs = [stream(seed, name, "camera").spawn(2) for name in names]
        self.optics = Optics(
            mocap.noise,
            float(np.radians(mocap.noise_deg)),
            mocap.latency_s,
            mocap.jitter_s,
            mocap.dropout_rate / mocap.rate_hz,
            mocap.dropout_s,
        )
        n = len(names)
        sigma = lab.body, lab.body, float(np.radians(lab.body_deg))
        clock = lab.clock_s * float(stream(seed, "clock").standard_normal())
        exact = not any((*sigma, lab.clock_s))
        self.markers = [
            Markers(k, exact, float(x), float(y), float(turn), clock)
            for k, (x, y, turn) in enumerate(
                stream(seed, one, "body").standard_normal(3) * sigma for one in names
            )
        ]
        self.film = Film(
            np.array([words(noise) for noise, _ in pairs]),
            np.array([words(losses) for _, losses in pairs]),
            np.full(n, -np.inf),
            np.empty((n, ROOM, 5)),
            np.zeros((n, 3), np.int64),
        )
        self.own: Whole = np.arange(n, dtype=np.int64)[None]  # each body its own vehicle
        self._take = with_fixed_types(take)
        self.most = 0  # poses of any body that are not yet taken, at most

    def reseed(self, names: Sequence[str], seed: int) -> None:
        """Draw other random numbers from now on."""
        for k, name in enumerate(names):
            noise, losses = stream(seed, name, "camera").spawn(2)
            self.film.noise[k], self.film.losses[k] = words(noise), words(losses)

    def load(self, exposures: int) -> Film:
        """The film, with room for so many exposures."""
        room = self.film.poses.shape[1]
        if self.most + exposures > room:
            more = np.empty((len(self.film.poses), self.most + exposures + room, 5))
            more[:, :room] = self.film.poses
            self.film = self.film._replace(poses=more)
        self.most += exposures
        return self.film

    def expose(self, times: Array, states: Array, now: float, shown: Whole | None = None) -> None:
        """Take exposures, see `photograph`."""
        film = self.load(len(times))
        shown = self.own if shown is None else shown
        self.most = photograph(film, self.optics, times, states, shown, now)

    def arrived(self, k: int) -> Sequence[PoseSample]:
        """Poses of body `k` that have arrived since the last call, in order of arrival."""
        _, arrived, taken = self.film.tally[k].tolist()
        rows = np.empty((arrived - taken, PoseSamples.width))
        self._take(self.film, self.markers[k], rows)
        return PoseSamples(rows)
