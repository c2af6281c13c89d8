"""Defaults that fit the vehicles: every number here follows from the vehicle and table files.

A number in an experiment's file, or on the command line, overrides. The experiment has one value
for all its vehicles, so that of the weakest vehicle counts. `testbed check` prints the arithmetic.

    a      force of the jets in their weakest direction over mass       [m/s^2]
    alpha  torque of the jets without a force over inertia              [rad/s^2]
    T      from a pose to the middle of the pulse that answers it       [s]
"""

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from controllers.pd import PdParams
from testbed.config.experiment import Experiment
from testbed.config.key import Key
from testbed.config.thresholds import blind_s, silence_s
from testbed.core.jets import effect_matrix
from testbed.core.vehicle import Vehicle
from testbed.flight.allocation import weakest_force
from testbed.flight.arming import ArmingParams
from testbed.flight.gate import GateParams
from testbed.flight.guidance import GuidanceParams
from testbed.flight.jet_faults import slopes
from testbed.flight.parameters import SPARE_FORCE

# Shares and upper values. The upper ones suffice for the accuracy in docs/measured.md; [assumption]
# marks what has no other source.
BRISK = 0.03  # acceleration a law should have: 1.4 m in 14 s [m/s^2] [assumption]
SHARE, LEAST_SHARE = 0.6, 0.3  # of the force for the law; the rest is for feedback [assumption]
TURNING = 0.1  # of alpha for a turn: torque is served before force [assumption]
PLANS = 8.0  # jet periods for which references are planned and live, as at 0.1 s [assumption]
LIVES = 3.5  # jet periods for which a demand is valid and its force goes on [assumption]
FASTEST_TURN = 0.1  # half a turn in 13 s [rad/s^2] [assumption]
LOOP, HEADING_LOOP = 1 / 8, 1 / 4  # bandwidth times T: 14 and 29 degrees of phase
WIDEST, WIDEST_HEADING = 0.8, 1.5  # [rad/s]
GENTLE, GENTLE_SHARE = 0.03, 0.5  # stop without setpoints: [m/s^2], of a [assumption]
TOP_SPEED = 0.25  # [m/s] [assumption]
ROOM = 0.25  # of the table's shorter side for a stop from top speed [assumption]
LONGEST_BRAKE = 6.0  # at least [s]
SPARE_BRAKE = 1.25  # factor on the time of a stop from top speed
SATURATED = 4.0  # see `_law`
NOISE, SPIN_NOISE = 1.5e-3, 4e-3  # at least [m/s^2, rad/s^2 / sqrt(Hz)]
SPIN_SHARE = 0.23  # of alpha in use on average [assumption]
PARALLEL = 1e-9  # of two pushes: sine of the angle between them
TINY = 1e-6  # least force and torque, so that nothing divides by zero [m/s^2, rad/s^2]
SPREAD = 3e-3  # of the slope at the start, at least [m/s^2]


class Default(NamedTuple):
    """A derived default."""

    key: Key
    value: float
    how: str  # its arithmetic


class Ability(NamedTuple):
    """What the jets of one vehicle give."""

    name: str
    accel: float  # a
    spin: float  # alpha
    delay: float  # T


def ability(experiment: Experiment, name: str) -> Ability:
    """a, alpha and T of a vehicle."""
    vehicle, mocap = experiment.vehicles[name].model, experiment.table.mocap
    delay = mocap.latency_s + vehicle.command_delay_s + vehicle.valve.open_delay_s
    return Ability(
        name, max(TINY, weakest_force(vehicle) / vehicle.mass),
        max(TINY, weakest_torque(vehicle) / vehicle.inertia),
        delay + 0.5 * experiment.flight.jet_period_s,
    )  # fmt: skip


def weakest_torque(vehicle: Vehicle) -> float:
    """Largest torque of the jets without a force, the smaller of left and right [N m]."""
    effect = effect_matrix(vehicle.jets, about=vehicle.com)
    return _torque(effect.tobytes(), len(vehicle.jets))


@lru_cache(maxsize=64)
def _torque(data: bytes, jets: int) -> float:
    """The same, cached: a campaign loads the same vehicle for every run."""
    effect = np.frombuffer(data).reshape(3, jets)
    return min(most_torque(effect[:2], sign * effect[2]) for sign in (1.0, -1.0))


def most_torque(push: NDArray[np.float64], turn: NDArray[np.float64]) -> float:
    """Largest turn @ u with push @ u = 0 and 0 <= u <= 1, for pushes in more than one direction.

    By duality it is the least sum of max(0, turn - y @ push) over the jets, for any y in the plane.
    That function is convex and made of flat pieces: its least value is at a corner, where two jets
    add nothing. (scipy's linprog takes a third of a second to import.)

    Args:
        push: force of each jet, shape (2, n) [N].
        turn: torque of each jet, shape (n,) [N m].
    """
    one, other = np.triu_indices(len(turn), 1)
    (ax, ay), (bx, by), a, b = push[:, one], push[:, other], turn[one], turn[other]
    cross = ax * by - ay * bx
    (apart,) = np.nonzero(np.abs(cross) > PARALLEL * np.abs(push).max(initial=0.0) ** 2)
    y = np.stack((a * by - b * ay, b * ax - a * bx))[:, apart] / cross[apart]
    gained = np.maximum(0.0, turn - y.T @ push).sum(axis=1)
    return float(gained.min(initial=np.maximum(0.0, turn).sum()))


def defaults_of(experiment: Experiment) -> list[Default]:
    """Every derived default, with its arithmetic."""
    return [one for derive in _DERIVED for one in derive(experiment)]


def fit(experiment: Experiment, given: dict[str, Any]) -> Experiment:
    """The experiment with derived defaults for keys that the tree `given` does not have."""
    for derive in _DERIVED:
        for k in range(len([*derive(experiment)])):
            key, value, _ = [*derive(experiment)][k]  # from the earlier ones, or the file's numbers
            if not _has(given, key):
                experiment = _put(experiment, key, value)
    return experiment


def _has(tree: Any, key: Key) -> bool:
    for part in key:
        if not isinstance(tree, dict) or part not in tree:
            return False
        tree = tree[part]
    return True


def _put(struct: Any, key: Key, value: float) -> Any:
    first, *rest = key
    inner = _put(getattr(struct, str(first)), tuple(rest), value) if rest else value
    return replace(struct, **{str(first): inner})


def _abilities(experiment: Experiment) -> list[Ability]:
    return [ability(experiment, name) for name in experiment.vehicles]


def _guidance(experiment: Experiment) -> Iterator[Default]:
    """In wrench mode the law's force holds the vehicle on a slope, else the rest of the force."""
    every = _abilities(experiment)
    weakest = min(every, key=lambda one: one.accel)
    slowest = min(every, key=lambda one: one.spin)
    slope, _ = slopes(experiment.table.tilt)
    spread = max(s.model.tolerance.thrust for s in experiment.vehicles.values())
    a = weakest.accel
    holds = experiment.guidance.mode == "wrench"
    most = max(LEAST_SHARE, 1.0 - 2.0 * spread - (0.0 if holds else slope / a))
    brisk = BRISK + slope if holds else BRISK
    less = "" if holds else f" - slope {slope:.2g} m/s^2"
    more = f" and the slope {slope:.2g} m/s^2" if holds else ""
    yield Default(
        ("guidance", "force_share"), min(most, max(SHARE, brisk / a)),
        f"at least {SHARE:g}, and {BRISK:g} m/s^2{more} of the {a:.3g} m/s^2 of {weakest.name};"
        f" at most {most:.2f} = 1 - twice the thrust's spread {spread:g}{less}",
    )  # fmt: skip
    yield Default(
        ("guidance", "heading_accel"), min(FASTEST_TURN, TURNING * slowest.spin),
        f"{TURNING:g} of the {slowest.spin:.3g} rad/s^2 of {slowest.name},"
        f" at most {FASTEST_TURN:g} rad/s^2",
    )  # fmt: skip


def _life(experiment: Experiment) -> Iterator[Default]:
    """A burst loses a number of messages, not a time, so a setpoint lives for jet periods."""
    period, usual = experiment.flight.jet_period_s, GuidanceParams().setpoint_life_s
    ahead = experiment.guidance.preview_s
    life, why = PLANS * period - ahead, f", less the {ahead:g} s planned ahead"
    periods = PLANS
    if experiment.guidance.mode == "wrench":
        life, why, periods = LIVES * period, "", LIVES
    yield Default(
        ("guidance", "setpoint_life_s"), max(usual, round(life, 9)),
        f"{periods:g} jet periods of {period:g} s{why}, at least {usual:g} s",
    )  # fmt: skip


def _gate(experiment: Experiment) -> Iterator[Default]:
    """The last line of defence: later than the fault table's `pose_lost` and `link_lost`."""
    flight, guidance = experiment.flight, experiment.guidance
    period, usual = flight.jet_period_s, GateParams().link_timeout_s
    planned = guidance.preview_s + guidance.setpoint_life_s
    silent = max(10.0 * period, silence_s(experiment.table.link, period) - planned)
    yield Default(
        ("flight", "gate", "link_timeout_s"), max(usual, silent + 2.0 * period),
        f"two jet periods after {silent:.2g} s, for which no healthy link is silent after the"
        f" newest setpoint; at least {usual:g} s",
    )  # fmt: skip
    blind = blind_s(experiment.table, flight, len(experiment.vehicles))
    yield Default(
        ("flight", "gate", "pose_timeout_s"), blind + 2.0 * flight.jet_period_s,
        f"two jet periods after {blind:.2g} s, for which a prediction stays within its room",
    )  # fmt: skip


def _arming(experiment: Experiment) -> Iterator[Default]:
    """A pose of slow or late cameras is older; one frame may be lost, as for `pose_stale`."""
    mocap, usual = experiment.table.mocap, ArmingParams().pose_age_s
    yield Default(
        ("arming", "pose_age_s"), max(usual, mocap.oldest_s),
        f"latency {mocap.latency_s:g} s, two frames of {mocap.frame_s:.3g} s and eight times"
        f" the jitter {mocap.jitter_s:g} s; at least {usual:g} s",
    )  # fmt: skip


def _law(experiment: Experiment) -> Iterator[Default]:
    """A PD law that turns its force round half way, where a stop with all of its force begins.

    There x = d / 2 is left at speed v = sqrt(a d), and w^2 x = 2 w v gives w = 4 sqrt(a / d).
    A faster law begins to stop too late and overshoots.
    """
    if not isinstance(experiment.controller, PdParams):
        return
    setups, share = experiment.vehicles.values(), experiment.guidance.force_share
    a = min(one.accel for one in _abilities(experiment))
    way = max(1.0, *(math.dist(one.start[:2], one.goal[:2]) for one in setups))
    most = experiment.flight.tracker.bandwidth
    yield Default(
        ("controller", "bandwidth"), min(most, SATURATED * math.sqrt(share * a / way)),
        f"{SATURATED:g} sqrt({share:.2f} x {a:.3g} m/s^2 / {way:.3g} m),"
        f" at most the tracker's {most:.2g} rad/s",
    )  # fmt: skip


def _flight(experiment: Experiment) -> Iterator[Default]:
    every, end = _abilities(experiment), experiment.flight.ending
    weakest, late = min(every, key=lambda one: one.accel), max(every, key=lambda one: one.delay)
    a, delay = weakest.accel, late.delay
    for name, share, most in (
        ("bandwidth", LOOP, WIDEST),
        ("heading_bandwidth", HEADING_LOOP, WIDEST_HEADING),
    ):
        words = f"{share:g} / {delay:.3g} s from pose to pulse of {late.name}"
        how = f"{words}, at most {most:g} rad/s"
        yield Default(("flight", "tracker", name), min(most, share / delay), how)
    yield Default(
        ("flight", "tracker", "brake_decel"), min(GENTLE, GENTLE_SHARE * a),
        f"{GENTLE_SHARE:g} of the {a:.3g} m/s^2 of {weakest.name}, at most {GENTLE:g} m/s^2",
    )  # fmt: skip
    side = min(experiment.table.size)
    decel = experiment.flight.barrier.effort * SPARE_FORCE * a
    yield Default(
        ("flight", "barrier", "max_speed"), min(TOP_SPEED, math.sqrt(2.0 * decel * ROOM * side)),
        f"sqrt(2 x {decel:.3g} m/s^2 x {ROOM * side:.3g} m), a stop within {ROOM:g} of the table;"
        f" at most {TOP_SPEED:g} m/s",
    )  # fmt: skip
    speed = experiment.flight.barrier.max_speed
    needed = SPARE_BRAKE * speed / (SPARE_FORCE * a)
    yield Default(
        ("flight", "ending", "brake_s"), max(LONGEST_BRAKE, end.settle_s + needed),
        f"{end.settle_s:g} s + {SPARE_BRAKE:g} x {speed:.3g} m/s / {SPARE_FORCE * a:.3g} m/s^2,"
        f" at least {LONGEST_BRAKE:g} s",
    )  # fmt: skip


def _estimator(experiment: Experiment) -> Iterator[Default]:
    """Unknown accelerations: thrust that differs from the file, and the table's slope."""
    every, root = _abilities(experiment), math.sqrt(experiment.flight.jet_period_s)
    spread = max(s.model.tolerance.thrust for s in experiment.vehicles.values())
    for name, share, most, least, unit in (
        ("force_noise", SPARE_FORCE, max(one.accel for one in every), NOISE, "m"),
        ("torque_noise", SPIN_SHARE, max(one.spin for one in every), SPIN_NOISE, "rad"),
    ):
        yield Default(
            ("flight", "estimator", name), max(least, share * spread * most * root),
            f"{share:g} x spread {spread:g} x {most:.3g} {unit}/s^2 over a jet period,"
            f" at least {least:g}",
        )  # fmt: skip
    slope, _ = slopes(experiment.table.tilt)
    yield Default(
        ("flight", "estimator", "bias_spread"), max(SPREAD, slope),
        f"the slope {slope:.2g} m/s^2, at least {SPREAD:g}",
    )  # fmt: skip


# in this order, because each may need defaults of those before
_DERIVED = _guidance, _life, _flight, _estimator, _gate, _law, _arming
