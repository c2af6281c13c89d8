"""Verdicts on the jets: which wrench each pulse gave, beside those that wrong wiring would give."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from testbed.commission.motion import Array, Kick
from testbed.commission.verdict import Verdict
from testbed.core.jets import effect_matrix
from testbed.core.table import Spread
from testbed.core.vehicle import Vehicle

STEP = "jets"
DEAD = 0.15  # share of its thrust below which a jet does not push
LIKE = 0.35  # largest misfit of a wrench, as a share of it
OWN = 0.12  # a jet's own wrench may fit by this much worse than another's
LATE_S = 0.012  # error of a delay that is healthy [s]
WEAK = 0.1  # error of a jet's strength that is healthy, beside its tolerance
COMMON = 0.05  # the same of all jets together
DRAG = 0.06  # beyond the file's [1/s]
ASIDE = 5.0  # of the pushes of all jets together, beside the alignment of nozzles [deg]
UNCLEAR = 0.3  # largest error of a wrench, as a share of it
SURE = 4.0  # standard deviations
WHOLE = {  # what an error of the whole vehicle makes of a wrench (fx, fy, tau)
    "turned by 90 deg": ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "turned by 180 deg": ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
    "turned by -90 deg": ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "reversed": ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
    "on mirrored arms": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)),
    "mirrored left to right": ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
    "mirrored front to back": ((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)),
}


class Pulse(NamedTuple):
    """One pulse of one jet, and what it did."""

    jet: int  # from 0
    flow_s: float  # full flow that it should give [s]
    kick: Kick
    others: Mapping[str, float]  # speed that other vehicles gained [m/s]


class Strength(NamedTuple):
    """Jets measured against the file, in the file's order."""

    share: Array  # of the file's thrust
    sigma: Array
    delay: Array  # beyond the file's [s]
    delay_sigma: Array
    aside: Array  # angle from the file's push to the found one, counter-clockwise [rad]


def flow_times(vehicle: Vehicle, on_s: float) -> tuple[float, float]:
    """From the command to the middle of the rise of the flow; length of the flow [s]."""
    valve = vehicle.valve
    opens = valve.open_delay_s + 0.5 * valve.open_ramp_s
    closes = valve.close_delay_s + 0.5 * valve.close_ramp_s
    return vehicle.command_delay_s + opens, max(1e-3, on_s + closes - opens)


def wrench_of(vehicle: Vehicle, pulse: Pulse) -> tuple[Array, Array]:
    """Mean wrench about the centre of mass in B during a pulse, by the file's mass; its errors."""
    kick, flow = pulse.kick, pulse.flow_s
    c, s = np.cos(kick.theta), np.sin(kick.theta)
    ax, ay = kick.change[:2] / flow
    alpha = kick.change[2] / flow
    cx, cy = vehicle.com
    push = np.array([c * ax + s * ay - alpha * cy, c * ay - s * ax + alpha * cx])
    scale = np.array([vehicle.mass, vehicle.mass, vehicle.inertia])
    return scale * [*push, alpha], scale * kick.sigma / flow


def judge(name: str, vehicle: Vehicle, pulses: Sequence[Pulse], lab: Spread) -> list[Verdict]:
    """Verdicts on all jets of a vehicle, the worst first."""
    n = len(vehicle.jets)
    columns = effect_matrix(vehicle.jets, about=vehicle.com)
    arm = float(np.sqrt(np.mean(columns[2] ** 2) / np.mean(columns[0] ** 2 + columns[1] ** 2)))
    unit = np.array([1.0, 1.0, 1.0 / max(arm, 0.02)])
    wrench, error = np.zeros((n, 3)), np.zeros(n)
    for pulse in pulses:
        found, sigma = wrench_of(vehicle, pulse)
        wrench[pulse.jet] = found * unit
        error[pulse.jet] = float(np.linalg.norm(sigma * unit))
    own = columns.T * unit
    size = np.linalg.norm(own, axis=1)
    if np.median(error / size) > UNCLEAR:
        text = "pushes do not stand out from slope and noise here: try a more level place"
        return [Verdict(STEP, name, text, skipped=True)]
    moved = [
        max(pulse.others.items(), key=lambda one: one[1], default=("", 0.0)) for pulse in pulses
    ]
    dead = [j for j in range(n) if np.linalg.norm(wrench[j]) < max(DEAD * size[j], 2.0 * error[j])]
    if len(dead) == n:
        other, speed = max(moved, key=lambda one: one[1])
        if speed > 0.3 * _expected(vehicle, pulses):
            text = f"its jets move {other}: the boards are exchanged"
            return [Verdict(STEP, name, text, "boards_swapped")]
        return [Verdict(STEP, name, "no jet moves it: no air, or it does not float", "dead")]
    verdicts = [
        Verdict(STEP, name, f"jet {j + 1} does not push: valve, wire or air", "dead") for j in dead
    ]
    live = [j for j in range(n) if j not in dead]
    fits = np.array([[_misfit(wrench[j], own[k], error[j]) for k in range(n)] for j in range(n)])
    spread = vehicle.tolerance
    reach = max(math.hypot(*jet.position) for jet in vehicle.jets)
    inexact = (math.radians(spread.direction_deg) * reach + spread.com) / max(arm, 0.02)
    like = min(0.8, LIKE + 2.0 * inexact)
    right = [j for j in live if fits[j, j] < min(like, fits[j].min() + OWN)]
    wrong = [j for j in live if j not in right]
    if wrong:
        whole = _of_whole(wrench, own, unit, error, live) if len(wrong) > n / 3 else ""
        if whole:
            text = f"every jet pushes {whole}: the file, the plug of the valves, or the body's axis"
            verdicts.append(Verdict(STEP, name, text, "all_" + whole.split()[0]))
        else:
            verdicts += _of_each(name, wrench, own, error, fits, right, wrong)
        return verdicts
    measured = _strengths(name, vehicle, strength_of(vehicle, pulses), live, pulses, lab)
    return [*verdicts, *(v for v in measured if v.code or not verdicts)]


def strength_of(vehicle: Vehicle, pulses: Sequence[Pulse]) -> Strength:
    """Thrust and delay of each jet beside the file, by the change of momentum along its push."""
    n = len(vehicle.jets)
    columns = effect_matrix(vehicle.jets, about=vehicle.com)
    share, sigma, delay, unsure = np.ones(n), np.full(n, np.inf), np.zeros(n), np.full(n, np.inf)
    aside = np.zeros(n)
    for pulse in pulses:
        found, error = wrench_of(vehicle, pulse)
        own = columns[:2, pulse.jet]
        j, square = pulse.jet, float(own @ own)
        share[j] = found[:2] @ own / square
        sigma[j] = float(np.hypot(*error[:2]) / np.sqrt(2.0 * square))
        aside[j] = np.arctan2(own[0] * found[1] - own[1] * found[0], own @ found[:2])
        delay[j] = pulse.kick.delay - flow_times(vehicle, pulse.flow_s)[0]
        unsure[j] = pulse.kick.delay_sigma
    return Strength(share, sigma, delay, unsure, aside)


def _expected(vehicle: Vehicle, pulses: Sequence[Pulse]) -> float:
    """Smallest speed that one of the pulses should have given [m/s]."""
    return min(vehicle.jets[p.jet].thrust * p.flow_s / vehicle.mass for p in pulses)


def _misfit(found: Array, expected: Array, error: float) -> float:
    """Distance from a wrench of any size along `expected`, as a share of it; less the noise."""
    share = float(found @ expected / (expected @ expected))
    if share <= 0.0:
        return 2.0
    size = share * float(np.linalg.norm(expected))
    return max(0.0, float(np.linalg.norm(found - share * expected)) - 2.0 * error) / size


def _of_whole(wrench: Array, own: Array, unit: Array, error: Array, live: Sequence[int]) -> str:
    """The error of the whole vehicle that explains every jet."""
    for word, matrix in WHOLE.items():
        turned = (own / unit) @ np.array(matrix).T * unit
        if all(_misfit(wrench[j], turned[j], error[j]) < LIKE for j in live):
            return word
    return ""


def _of_each(
    name: str, wrench: Array, own: Array, error: Array, fits: Array,
    right: Sequence[int], wrong: Sequence[int],
) -> list[Verdict]:  # fmt: skip
    """Verdicts on jets one by one: exchanged wires, or an entry of the file."""
    verdicts, named = list[Verdict](), set[int]()
    like = {j: {k for k in range(len(own)) if k != j and fits[j, k] < LIKE} for j in wrong}
    for j in wrong:
        if j in named:
            continue
        partner = next((k for k in wrong if k in like[j] and j in like[k]), None)
        if partner is not None:
            named |= {j, partner}
            text = f"jets {j + 1} and {partner + 1} push as each other: their wires are exchanged"
            verdicts.append(Verdict(STEP, name, text, "wires_swapped"))
            continue
        if like[j] and not like[j] & set(right):
            text = f"jet {j + 1} pushes as jet {min(like[j]) + 1}: wires are exchanged"
            verdicts.append(Verdict(STEP, name, text, "wires_swapped"))
            continue
        if _misfit(wrench[j], -own[j], error[j]) < LIKE:
            text = f"jet {j + 1} pushes the other way: `push` in the file has the wrong sign"
            verdicts.append(Verdict(STEP, name, text, "jet_reversed"))
        elif _misfit(wrench[j], own[j] * (1.0, 1.0, -1.0), error[j]) < LIKE:
            text = f"jet {j + 1} turns it the other way: `position` in the file is mirrored"
            verdicts.append(Verdict(STEP, name, text, "jet_mirrored"))
        else:
            text = f"jet {j + 1} pushes unlike any jet of the file: its `position` or `push`"
            verdicts.append(Verdict(STEP, name, text, "jet_unlike"))
    return verdicts


def _strengths(
    name: str, vehicle: Vehicle, found: Strength, live: Sequence[int], pulses: Sequence[Pulse],
    lab: Spread,
) -> list[Verdict]:  # fmt: skip
    """Verdicts on thrust, mass, inertia, delay and drag."""
    spread, verdicts = vehicle.tolerance, list[Verdict]()
    share, common = found.share, float(np.median(found.share[live]))
    turning = _turning(vehicle, pulses, live)
    kicks = [pulse.kick for pulse in pulses if pulse.jet in live]
    weights = np.array([k.drag_sigma for k in kicks]) ** -2.0
    drag = float(weights @ [k.drag for k in kicks] / max(weights.sum(), 1e-9))
    late = float(np.median(found.delay[live]))
    aside = float(np.degrees(np.median(found.aside[live])))
    numbers = {"thrust_share": common, "turning_share": turning, "drag_1_s": drag, "late_s": late}
    numbers |= {"aside_deg": aside}
    numbers |= {f"jet{j + 1}_share": float(share[j]) for j in live}

    def add(code: str, text: str) -> None:
        verdicts.append(Verdict(STEP, name, text, code, numbers))

    for j in live:
        limit = WEAK + 3.0 * spread.thrust + 3.0 * float(found.sigma[j])
        if abs(share[j] / common - 1.0) > limit:
            word = "weak" if share[j] < common else "strong"
            add(f"jet_{word}", f"jet {j + 1} gives {share[j] / common:.0%} of what the others give")
    slack = 3.0 * np.sqrt(spread.thrust**2 / len(live) + spread.mass**2 + lab.thrust**2)
    if abs(common - 1.0) > COMMON + slack:
        text = f"all jets give {common:.0%} of the file's push: mass, pressure, or a wrong file"
        add("all_weak" if common < 1.0 else "all_strong", text)
    slack = 3.0 * np.sqrt(spread.thrust**2 / len(live) + spread.inertia**2 + spread.mass**2)
    if abs(turning / common - 1.0) > 2.0 * COMMON + slack:
        text = f"they turn it by {turning / common:.0%} of the file's: inertia, arms, a wrong file"
        add("inertia", text)
    unsure = np.degrees(float(np.median(found.sigma[live]))) / common
    limit = ASIDE + (3.0 * spread.direction_deg + SURE * unsure) / np.sqrt(len(live))
    if abs(aside) > limit:
        text = f"all jets push {aside:+.0f} deg aside of the file's: the body in motion capture is"
        add("body_aside", f"{text} turned against the vehicle's x, or `push` in the file is")
    early = 3.0 * lab.clock_s + LATE_S
    unsure = float(np.median(found.delay_sigma[live]))
    if abs(late) > early + SURE * unsure / np.sqrt(len(live)):
        text = f"all jets push {1e3 * late:+.0f} ms later than the file's: valves, line, or clocks"
        add("late", text)
    for j in live:
        apart = float(found.delay[j] - late)
        limit = LATE_S + 3.5 * lab.delay_s + SURE * float(found.delay_sigma[j])
        if abs(apart) > limit:
            add("jet_late", f"jet {j + 1} pushes {1e3 * apart:+.0f} ms later than the others")
    if drag > DRAG + SURE / np.sqrt(max(weights.sum(), 1e-9)):
        known = vehicle.drag / vehicle.mass
        text = f"it slows down by {known + drag:.2f} 1/s, by the file {known:.2f} 1/s: a pad?"
        add("drag", text)
    if not verdicts:
        delay = f"{round(1e3 * late):+d} ms"
        text = f"each jet is its own; thrust {common:.0%} of the file's, delay {delay}"
        verdicts.append(Verdict(STEP, name, text, numbers=numbers))
    return verdicts


def _turning(vehicle: Vehicle, pulses: Sequence[Pulse], live: Sequence[int]) -> float:
    """Torque of all jets beside the file's, by the file's inertia."""
    columns = effect_matrix(vehicle.jets, about=vehicle.com)
    used = [pulse for pulse in pulses if pulse.jet in live]
    torque = np.array([wrench_of(vehicle, pulse)[0][2] for pulse in used])
    own = columns[2, [pulse.jet for pulse in used]]
    return float(torque @ own / (own @ own)) if own.any() else 1.0
