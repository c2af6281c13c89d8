"""The detectors of the fault table: each gives a number that measures a deviation."""

import math
from typing import NamedTuple

from testbed.core.compiled import compiled, pasted
from testbed.core.se2 import length
from testbed.flight import bad_jet, innovations, permanent, reconfiguration
from testbed.flight.hypotheses import DRAG, NUDGE, PULL, SURE, certain
from testbed.flight.jet_faults import look, note_pull, pause
from testbed.flight.permanent import heading_off, lateness, wrong_scale
from testbed.flight.pose_check import seen_elsewhere
from testbed.flight.record import NO_SETPOINT, record
from testbed.flight.window import forget

SAME_PLACE = 0.15  # a pose this near to another vehicle's prediction belongs to it [m]
TRUSTED = 8  # most refused poses for evidence about valves
SAME_CLOCK = 0.005  # largest clock offset for evidence about valves [s]
SPOILT = 0.2  # of a jet period: the pulses of a tick that is later may have been cut or lost
NEARLY = 5  # so many more nearly equal poses in a row than equal ones are a frozen pose
MOVING = 0.01  # from this speed a delay shows as a step back [m/s]
SHORTEST, LONGEST = 0.05, 2.0  # such a delay [s]
ALONG = 0.2  # deviation of the step from the motion, relative
TURNED_BY = 0.005  # heading may differ by this [rad]
RATE_S = 1.0  # for which poses are counted [s]
FAR = 0.05  # a pose this far from the own prediction is not the own one [m]


class Sensors(NamedTuple):
    """Constants of a vehicle's detectors for compiled code."""

    set_pressure: float  # of the supply [Pa]
    full: float  # pressure of the full tank [Pa]
    noisy: bool  # these cameras never repeat a pose exactly; others may, for a vehicle at rest
    frame: float  # time between two camera frames [s]
    holding: float  # acceleration by the jets in any direction [m/s^2]


MEMORY = record(
    gauged=int,  # 1: the tank has been read
    gauged_at=float,  # [s]
    tank=float,  # pressure then [Pa]
    seen=int,  # 1: `last` is known
    last=(3,),  # newest pose of the cameras
    repeats=int,  # poses equal to it in a row before it
    known=int,  # 1: `before` is known
    before=(5,),  # last estimate: t, x, y, vx, vy
    timed=int,  # 1: `at` is known
    at=float,  # last tick [s]
    rate=float,  # mean number of poses over what the cameras should give
)


@pasted
def compare(p, m, evidence, fired, always, window, row, step, duty, thrust_scale):
    """Compare the motion with the flow of the last plan; see `jet_faults.look`.

    Poses that are old, refused or of another clock are no evidence about valves. Neither is the way
    to where the body is seen after a `step` of its poses, see estimator.MEMORY: no jet pushed it
    there. After a late tick the valves may have done something else than the plans say. The sums
    have that in them already, so they begin anew.
    """
    state, before = row.state, m.look
    if row.inputs.late_s > SPOILT * p.period / p.ticks:
        distrust(p, m, evidence, fired, always, window)
    ours = abs(row.inputs.clock_offset) < SAME_CLOCK and not seen_elsewhere(step)
    if state.pose_age < p.trusted_age and state.rejected <= TRUSTED and ours:
        look(p, m, evidence, state, duty, thrust_scale)
        # a nudge passes, but it would stay in the sums of the whole flight
        if nudged(p, m) > math.sqrt(2.0 * SURE):
            permanent.restart(always, window)
        if m.look != before and m.summed == 0:
            permanent.refute(always, m.far)
            note_pull(p, m, evidence)
        if m.look != before and m.summed == p.long - 1:  # the next one clears the sums
            permanent.update(p, always, window, evidence, m.far)
    else:
        pause(p, m, evidence)
        forget(always)  # until the next second: one alone is not believed for longer


@compiled
def distrust(p, m, evidence, fired, always, window):
    """Let all that compares motion and plans begin anew; the arguments are those of `compare`."""
    reconfiguration.restart(p, m, evidence, fired)
    innovations.pause(m.innovations)  # while a jet is probed, they have not begun anew
    permanent.restart(always, window)


@compiled
def nudged(known, suspected):
    """Sigmas of a nudge, by the short or the long window."""
    far, least = suspected.far, known.least
    return max(
        certain(far.gains, far.sizes, least, NUDGE),
        certain(suspected.gains, suspected.sizes, least, NUDGE),
    )


@compiled
def measure(p, m, seen, known, suspected, always, row, samples, neighbours, finite, spare):
    """Write the detectors' numbers of this tick to `row.numbers`.

    Args:
        p: Sensors.
        m: MEMORY, changed in place.
        seen: estimator.MEMORY.
        known: jet_faults.Known.
        suspected: jet_faults.MEMORY, changed in place.
        always: permanent.MEMORY.
        row: record.ROW.
        samples: rows (captured at, x, y, theta).
        neighbours: rows as in `barrier.around`.
        finite: whether the demanded wrench is.
        spare: room left after a full stop [m].
    """
    inputs, state, outputs = row.inputs, row.state, row.outputs
    age = rejected = 0.0
    jumped = jump(m, samples, inputs.clock_offset)
    outputs.other, outputs.oldest = whose(jumped, samples, neighbours), -1
    m.known = state.known
    if state.known == 1:
        age, rejected = state.pose_age, float(state.rejected)
        before = m.before
        before[0], before[1], before[2] = state.t, state.x, state.y
        before[3], before[4] = state.vx, state.vy
    waited = overdue = 0.0
    if inputs.setpoint.kind != NO_SETPOINT:
        waited = inputs.effect_at - inputs.setpoint.t
        overdue = inputs.effect_at - inputs.setpoint.valid_until
    oldest = 0.0
    for k in range(neighbours.shape[0]):
        if inputs.t - neighbours[k, 5] > oldest:
            oldest, outputs.oldest = inputs.t - neighbours[k, 5], k
    bad_jet.decide_by(suspected, known.least)
    leaks, leak = suspected.leak_by != bad_jet.NOTHING, bad_jet.leak_of(suspected)
    weak = suspected.weak_by != bad_jet.NOTHING
    either = bad_jet.leaks_or_is_weak(suspected, known.least)
    outputs.leak = bad_jet.sigmas(suspected.leak) if either else 0.0
    repeats = max(float(count_repeats(m, samples)), float(seen.still - NEARLY))
    numbers = (  # in the order of codes.Detector, up to FLEET
        abs(age),
        repeats if p.noisy else 0.0,
        jumped,
        1.0 if outputs.other >= 0 else 0.0,
        rejected,
        waited,
        overdue,
        oldest,
        inputs.supply_pressure / p.set_pressure,
        tank_loss(p, m, inputs.t, inputs.tank_pressure),
        inputs.battery,
        inputs.silent_s,
        leak.share if leaks else 0.0,
        bad_jet.sigmas(leak) if leaks else 0.0,
        outputs.leak,
        bad_jet.sigmas(bad_jet.weak_of(suspected)) if weak else 0.0,
        spare,
        float(inputs.law_failed),
        0.0 if finite else 1.0,
        inputs.late_s,
        inputs.operator_age,
        abs(inputs.clock_offset),
        0.0 if inputs.same_config == 1 else 1.0,
        inputs.disk_free,
        inputs.foreign,
        float(inputs.fleet_failed),
    )
    for k in range(len(numbers)):
        row.numbers[k] = numbers[k]
    explained = explain(p, m, seen, known, suspected, always, row, samples)
    for k in range(len(explained)):
        row.numbers[len(numbers) + k] = explained[k]


@compiled
def explain(p, m, seen, known, suspected, always, row, samples):
    """Numbers of what explains the motion, and of the cameras: from JET_PARTLY_WEAK on."""
    far, least = suspected.far, known.least
    gains, sizes = far.gains, far.sizes
    pull = certain(gains, sizes, least, PULL)
    late_s, frame_step, heading_step = what_stepped(seen.step, seen.going)
    if abs(row.inputs.clock_offset) >= SAME_CLOCK:  # poses of another time lie elsewhere
        late_s = frame_step = heading_step = 0.0
    return (
        bad_jet.sigmas(far.weak) if bad_jet.is_partly_weak(far) else 0.0,
        pull,
        sizes[PULL] / p.holding if pull > 0.0 and gains[PULL] > SURE else 0.0,
        certain(gains, sizes, least, DRAG),
        wrong_scale(suspected, always, least),
        heading_off(suspected, always, least),
        lateness(suspected, always, least),
        late_s,
        frame_step,
        heading_step,
        pose_rate(p, m, row.inputs.t, samples.shape[0]),
        seen.bumped,
        nudged(known, suspected),
    )


@compiled
def what_stepped(step, going):
    """Delay [s], distance [m] and angle [rad] of a body that is seen elsewhere without a push.

    A delay takes the body back along its motion, in position and heading alike. One that explains
    the step is named before a frame or markers that moved.
    """
    far, turn = length(step[0], step[1]), step[2]
    if far == 0.0 and turn == 0.0:
        return 0.0, 0.0, 0.0
    speed = length(going[0], going[1])
    if far > 0.0 and speed > MOVING:
        ahead = -(step[0] * going[0] + step[1] * going[1]) / (speed * speed)
        beside = length(step[0] + ahead * going[0], step[1] + ahead * going[1])
        back = abs(turn + ahead * going[2]) < TURNED_BY + ALONG * abs(ahead * going[2])
        if SHORTEST < ahead < LONGEST and beside < ALONG * far and back:
            return ahead, 0.0, 0.0
    return 0.0, far, abs(turn) if far == 0.0 else 0.0


@compiled
def pose_rate(p, m, t, count):
    """Poses of the last second, roughly, over what the cameras should give."""
    if m.timed == 0:
        m.rate = 1.0
    elif t > m.at:
        h = t - m.at
        m.rate += min(1.0, h / RATE_S) * (count * p.frame / h - m.rate)
    m.timed, m.at = 1, t
    return m.rate


@compiled
def place(then, motion, t):
    """Position at `t` of a vehicle that was at motion = (x, y, vx, vy), at constant velocity."""
    h = t - then
    return motion[0] + h * motion[2], motion[1] + h * motion[3]


@compiled
def jump(m, samples, clock_offset):
    """Distance of the newest pose from the prediction of the last estimate [m].

    The way that the vehicle goes in `clock_offset` [s] is taken off, because the stamp is wrong by
    that time.
    """
    if m.known == 0 or samples.shape[0] == 0:
        return 0.0
    newest = samples[-1]
    x, y = place(m.before[0], m.before[1:], newest[0])
    way = abs(clock_offset) * length(m.before[3], m.before[4])
    return max(0.0, length(newest[1] - x, newest[2] - y) - way)


@compiled
def whose(jumped, samples, neighbours):
    """The neighbour whose prediction matches the newest pose; -1: none."""
    if jumped > FAR and samples.shape[0] > 0:
        newest = samples[-1]
        for k in range(neighbours.shape[0]):
            x, y = place(neighbours[k, 5], neighbours[k], newest[0])
            if length(newest[1] - x, newest[2] - y) < min(SAME_PLACE, jumped):
                return k
    return -1


@compiled
def count_repeats(m, samples):
    """Identical poses in a row after these samples; 0: the newest one differs."""
    for n in range(samples.shape[0]):
        same = m.seen == 1
        for i in range(3):
            same = same and samples[n, i + 1] == m.last[i]
            m.last[i] = samples[n, i + 1]
        m.seen, m.repeats = 1, m.repeats + 1 if same else 0
    return m.repeats


@compiled
def tank_loss(p, m, t, pressure):
    """Loss of the tank since the last tick, as a share of a full tank per second [1/s]."""
    loss = 0.0
    if m.gauged == 1 and t > m.gauged_at:
        loss = (m.tank - pressure) / (p.full * (t - m.gauged_at))
    m.gauged, m.gauged_at, m.tank = 1, t, pressure
    return loss
