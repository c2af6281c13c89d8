"""How soon can the poses tell that a jet has lost 30 % of its thrust? The Cramer-Rao bound.

    python benchmarks/jet_information.py [--seeds 1] [--vehicles generic_8jet atmos ...]

Flies the cases of `jets_left.py` with a weak jet that nobody compensates for, and computes what the
cameras' poses carry on a change of that jet's thrust, under the commands that were flown. The best
estimator there can be is a Kalman filter over position, velocity and everything unknown: thrust of
all jets, centre of mass, slope, drag, and the change. Its covariance needs no data. It is given
more than a detector has: the instant of the fault, the true heading and velocity, no error in the
valves' timing and the nozzles' direction. Pulses differ as the vehicle file says, and the slope
from place to place as the table file says.

    sigmas      loss / standard deviation of its estimate: its distance from a healthy jet
    apart       the same if any one other jet may have changed instead, the worst of them
    alone       sigmas if only this jet is unknown, and gave its file's thrust before the fault

SURE sigmas are needed: one of 10^5 windows of a healthy vehicle shows more, with eight jets in
question. To name the jet, `apart` must reach CLEAR, e^3 in likelihood. Printed are flights that get
there at all before they end, and seconds of commanded firing since the fault until they do.
"""

import argparse
import sys
from typing import NamedTuple

import numpy as np
from jets_left import VEHICLES, WEAK, Case, experiment_of
from msgspec.structs import replace
from numpy.typing import NDArray

from testbed.config import Experiment
from testbed.core.jets import effect_matrix
from testbed.core.pulse import open_time, timing
from testbed.faults.drill import ASKED
from testbed.flight.jet_faults import BALANCE, THRUST, slopes
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin

Array = NDArray[np.float64]

SURE = 5.2  # of a normal distribution beyond so many sigmas, one side, eight jets: 1e-6 to 1e-5
CLEAR = 2.45  # sqrt(2 ln e^3)
SLOPE = 0.02  # before a flight, one sigma [m/s^2]
DRAG = 1.0  # [N s/m]
CELL = 1.0  # the slope changes by the file's variation over this way [m, assumed]
FREE = 10.0  # prior of the change, one sigma: unknown
X, Y, TURN = slice(0, 2), slice(2, 4), slice(4, 6)  # position and velocity of each axis


class Flight(NamedTuple):
    """What was flown, by periods."""

    flow: Array  # share of the period for which each jet flowed by its commands, (ticks, jets)
    on: Array  # commanded time [s], (ticks, jets)
    states: Array  # true ones at the start of each period, (ticks, 6)


class Notes(NullObserver):
    """Notes the commands."""

    def __init__(self) -> None:
        self.t, self.on, self.offset = [], [], []

    def vehicle(self, name, tick) -> None:
        """See `Observer`."""
        self.t.append(tick.outputs.t)
        self.on.append(tick.outputs.command.on_us)
        self.offset.append(tick.outputs.command.offset_us)


def fly(experiment: Experiment) -> Flight:
    """Fly with every row of the fault table as a warning."""
    faults = {
        name: replace(row, response="warn", otherwise="brake", latched=False)
        for name, row in experiment.faults.items()
    }
    rig, notes = make_twin(replace(experiment, faults=faults)), Notes()
    rig.fly(notes)
    track, model = rig.track(), experiment.vehicles["sat1"].model
    on, offset = 1e-6 * np.array(notes.on, float), 1e-6 * np.array(notes.offset, float)
    period, valve = experiment.flight.jet_period_s, timing(model.valve)
    flow = np.zeros_like(on)
    for k, j in np.argwhere(on > 0.0):
        up = notes.t[k] + model.command_delay_s + offset[k, j]
        first = int((up - notes.t[0]) / period)
        for i in range(first, min(first + 4, len(flow))):
            start = notes.t[0] + i * period
            flow[i, j] += open_time(up, up + on[k, j], valve, start, start + period) / period
    which = np.searchsorted(track.t, notes.t).clip(0, len(track.t) - 1)
    return Flight(flow, on, track.states[which, 0])


def information(experiment: Experiment, flight: Flight, at_s: float, jet: int) -> Array:
    """Sigmas, apart and alone, after each period: (ticks, 3)."""
    model, table = experiment.vehicles["sat1"].model, experiment.table
    period, n = experiment.flight.jet_period_s, len(model.jets)
    scale = np.array([model.mass, model.mass, model.inertia])[:, None]
    effect = effect_matrix(model.jets, about=model.com) / scale
    tolerance = max(THRUST, model.tolerance.thrust)
    com = max(BALANCE, model.tolerance.com)
    bumps = slopes(table.tilt)[1]
    # x: three axes, gains (n), changes (n), slope (2), centre of mass (2), drag of both kinds (2)
    size = 6 + 2 * n + 6
    gains, changes = 6 + np.arange(n), 6 + n + np.arange(n)
    slope, balance, drag = 6 + 2 * n + np.arange(6).reshape(3, 2)
    prior = np.full(size, 1.0)
    prior[gains], prior[changes], prior[slope] = tolerance, FREE, SLOPE
    prior[balance], prior[drag[0]] = com, DRAG / model.mass
    prior[drag[1]] = DRAG * (0.5 * model.radius) ** 2 / model.inertia
    noise = np.array([table.mocap.noise, table.mocap.noise, np.radians(table.mocap.noise_deg)])
    noise = noise**2 / (period * table.mocap.rate_hz)  # of the mean of a period's poses
    cov, alone = np.diag(prior**2), np.diag(prior**2)
    known = np.setdiff1d(np.arange(6, size), changes[[jet]])
    alone[known] = alone[:, known] = 0.0
    found = np.zeros((len(flight.flow), 3))
    for k, (flow, state) in enumerate(zip(flight.flow, flight.states, strict=True)):
        c, s = np.cos(state[2]), np.sin(state[2])
        push = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ (effect * flow)
        accel = np.zeros((3, size))
        accel[:, gains] = push
        if k * period >= at_s:
            accel[:, changes] = push
        accel[0, slope[0]] = accel[1, slope[1]] = 1.0
        body = (effect * flow).sum(axis=1) * model.mass / model.inertia
        accel[2, balance] = -body[1], body[0]
        accel[X.start // 2, drag[0]], accel[1, drag[0]] = -state[3], -state[4]
        accel[2, drag[1]] = -state[5]
        step = np.eye(size)
        for axis in range(3):
            step[2 * axis, 2 * axis + 1] = period
            step[2 * axis] += 0.5 * period**2 * accel[axis]
            step[2 * axis + 1] += period * accel[axis]
        shake = accel[:, gains] * period * model.tolerance.pulse * np.sqrt(np.minimum(1.0, flow))
        shake = shake @ shake.T  # pulses differ; taken as one pulse in a period
        walk = (bumps / CELL) ** 2 * np.hypot(*state[3:5]) * period * CELL
        for one in (cov, alone):
            one[:] = step @ one @ step.T
            one[np.ix_((1, 3, 5), (1, 3, 5))] += shake
            one[slope, slope] += walk
            for axis in range(3):  # the mean of the poses of a period is taken as at its end
                row = one[2 * axis].copy()
                one -= np.outer(row, row) / (row[2 * axis] + noise[axis])
        if k * period >= at_s:
            told = np.linalg.inv(cov[np.ix_(changes, changes)]) - np.eye(n) / FREE**2
            own, across, others = told[jet, jet], told[jet], np.diag(told)
            shared = np.where(others > 1e-9, across**2 / np.maximum(others, 1e-9), 0.0)
            rest = np.delete(own - shared, jet).min()
            each = np.array([own, rest, 1.0 / alone[changes[jet], changes[jet]]])
            found[k] = (1.0 - WEAK) * np.sqrt(np.maximum(0.0, each))
    return found


def reached(found: Array, used: Array, apart: bool) -> float:
    """Seconds of firing until the bound reaches SURE; infinite if it does not."""
    good = found[:, 0 if apart else 2] >= SURE
    if apart:
        good &= found[:, 1] >= CLEAR
    return float(used[np.argmax(good)]) if good.any() else float("inf")


def main() -> int:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--vehicles", nargs="*", default=VEHICLES)
    options = parser.parse_args()
    for vehicle in options.vehicles:
        rows = []
        for jet in range(8):
            for seed in range(options.seeds):
                experiment, at_s = experiment_of(Case(vehicle, "weak", jet, seed))
                flight = fly(experiment)
                period = experiment.flight.jet_period_s
                since = np.arange(len(flight.on)) * period >= at_s
                used = np.cumsum(np.where(since, flight.on[:, jet], 0.0))
                if used[-1] < ASKED:
                    continue
                found = information(experiment, flight, at_s, jet)
                first = np.argmax(since & (flight.on[:, jet] > 0.0))
                t = np.arange(len(used)) * period - first * period
                firing = reached(found, used, True)
                waits = float(t[np.argmax(used >= firing)]) if np.isfinite(firing) else np.inf
                rows.append((firing, reached(found, used, False), waits, *found[-1], used[-1]))
        if not rows:
            print(f"{vehicle:12} no flight used the jet for {ASKED:g} s", flush=True)
            continue
        table = np.array(rows)
        within = int(np.isfinite(table[:, 0]).sum())
        median = np.median(table, axis=0)
        print(
            f"{vehicle:12} {len(rows)} used the jet: possible in {within}, after"
            f" {median[0]:.2f} s of firing (median), {median[2]:.1f} s after its first command;"
            f" if only it is unknown {median[1]:.2f} s;"
            f" at the end {median[3]:.1f} sigmas, apart {median[4]:.1f}, alone {median[5]:.1f},"
            f" after {median[6]:.1f} s of firing",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
