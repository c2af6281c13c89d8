"""Flying on with what is left: the jets as they are, after one of them was found at fault.

Each jet gives the share `gives` of its thrust while commanded and `leaks` while not: 1 and 0 for a
healthy jet, 0 and 0 stuck shut, 0.7 and 0 weak, 1 and 1 stuck open. With B of the vehicle file the
wrench is B leaks + B diag(gives - leaks) u for duties u in [0, 1]; estimator, detector, allocator
and modulator use this. All wrenches that the jets can give form a zonotope. Its faces are
orthogonal to two of its edges, so a few cross products give its room around zero exactly.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.codes import Detector
from testbed.core.compiled import compiled
from testbed.flight import innovations
from testbed.flight.bad_jet import (
    CLEARER,
    DOUBT,
    INNOVATIONS,
    innovations_are_surer,
    leak_of,
    weak_is_likely,
    weak_of,
)
from testbed.flight.effectiveness import SPREAD
from testbed.flight.hypotheses import SURE
from testbed.flight.jet_faults import AGAIN, CALM, pause_windows
from testbed.flight.window import clear

LEAST = 0.2  # of the whole vehicle's weakest force and torque, both: less does not fly on
UPHILL = 2.0  # and this many times the force that the table's slope takes
SHUT = 0.35  # a jet that gives less is not used: its share is hardly known
WIDE_OPEN = 0.65  # a jet that leaks more is stuck open, see the row of the fault table
FLAT = 1e-9  # squared length of a cross product that counts as zero

PROBE_S = 10.0  # so long a jet that may only look weak is taken back if another one is named [s]
OPEN, LEAKS = Detector.JET_OPEN.value, Detector.JET_LEAKS.value
DOUBTFUL = Detector.JET_LEAKS_OR_WEAK.value


class Whole(NamedTuple):
    """Constants of a vehicle with all its jets for compiled code."""

    force: float  # without torque, in the weakest direction [N]
    torque: float  # without force, in the weaker sense [N m]
    slope: float  # force that the table's slope takes [N]


@compiled
def room(effect, gives, leaks):
    """Largest pure force in the weakest direction [N], and pure torque in the weaker sense [N m].

    Both are 0 if the jets cannot hold the vehicle.

    Args:
        effect: B, shape (3, jets).
        gives: share of its thrust that each jet gives while commanded, shape (jets,).
        leaks: and while not commanded, shape (jets,).
    """
    n = effect.shape[1]
    push, turn = np.max(np.abs(effect[:2])), np.max(np.abs(effect[2]))
    edge, whole = np.empty((n, 3)), np.zeros(3)
    for j in range(n):
        for i in range(3):
            scaled = effect[i, j] / (turn if i == 2 else push)
            edge[j, i] = scaled * (gives[j] - leaks[j])
            whole[i] += scaled * leaks[j]
    force = torque = np.inf
    for a in range(n):
        for b in range(a):
            nx = edge[a, 1] * edge[b, 2] - edge[a, 2] * edge[b, 1]
            ny = edge[a, 2] * edge[b, 0] - edge[a, 0] * edge[b, 2]
            nt = edge[a, 0] * edge[b, 1] - edge[a, 1] * edge[b, 0]
            if nx * nx + ny * ny + nt * nt < FLAT:
                continue
            reach = nx * whole[0] + ny * whole[1] + nt * whole[2]
            back = -reach
            for j in range(n):
                along = nx * edge[j, 0] + ny * edge[j, 1] + nt * edge[j, 2]
                reach, back = reach + max(0.0, along), back + max(0.0, -along)
            least = max(0.0, min(reach, back))
            sideways = np.hypot(nx, ny)
            # a face that neither pure force nor pure torque can meet bounds nothing, unless it is 0
            force = min(force, least / max(sideways, FLAT) if least > 0.0 else 0.0)
            torque = min(torque, least / max(abs(nt), FLAT) if least > 0.0 else 0.0)
    if force == np.inf:
        return 0.0, 0.0
    return force * push, torque * turn


def whole_of(effect: NDArray[np.float64], slope: float) -> Whole:
    """The room of a vehicle with all its jets; `slope` is the force that the table takes [N]."""
    jets = effect.shape[1]
    force, torque = room(effect, np.ones(jets), np.zeros(jets))
    return Whole(float(force), float(torque), slope)


@compiled
def names_a_leak(detector):
    """Whether a detector is sure of a leak, or of a valve that is stuck open."""
    return detector in (OPEN, LEAKS)


@compiled
def suspicion_of(suspected, detector):
    """The suspicion that a detector names, see window.SUSPICION.

    If one jet may leak or the other may be weak, the weak one is believed: a leak shows clearly as
    soon as the other jet is no longer commanded.

    Args:
        suspected: jet_faults.MEMORY.
        detector: codes.Detector, one of the jets'.
    """
    if names_a_leak(detector):
        return leak_of(suspected)
    if detector != DOUBTFUL:
        return weak_of(suspected)
    return suspected.innovations.weak if innovations_are_surer(suspected) else suspected.weak


@compiled
def change(gives, leaks, found, detector):
    """Write to `gives` and `leaks`, see `room`, what a detector has found: a suspicion."""
    j = found.jet
    if not names_a_leak(detector):
        left = 1.0 - min(1.0, found.share)
        gives[j], leaks[j] = gives[j] * left, leaks[j] * left
        if gives[j] < SHUT:
            gives[j] = leaks[j] = 0.0
        return
    leaks[j] = min(1.0, leaks[j] + found.share)
    if leaks[j] > WIDE_OPEN:
        leaks[j] = 1.0
    gives[j] = max(gives[j], leaks[j])


@compiled
def is_a_guess(suspected, detector):
    """Whether a leak of another jet is nearly as likely as the jet that was named.

    While the jet opposite to one that is stuck open fires all the time, the two are the same.
    """
    found = suspected.innovations
    near = found.leak.gain > (1.0 - DOUBT) * found.weak.gain
    guessed = not names_a_leak(detector) and suspected.weak_by == INNOVATIONS and near
    return detector == DOUBTFUL or guessed


@compiled
def needs_no_probe(suspected, detector):
    """Whether a leak is in doubt, but with another cause than a weak jet: a probe tells nothing."""
    first = detector == DOUBTFUL and suspected.probed == 0
    return first and not weak_is_likely(suspected)


@compiled
def flies_with_a_leak(rows):
    """Whether the fault table flies on with a valve stuck open; `rows` is fault_monitor.Rows."""
    for k in range(rows.detector.shape[0]):
        if rows.detector[k] == OPEN and rows.reconfigures[k] == 1:
            return True
    return False


@compiled
def probes_another(suspected, jet):
    """Whether a jet other than `jet` is left out on probation; `suspected` is jet_faults.MEMORY."""
    return suspected.probed > 0 and suspected.probed - 1 != jet


@compiled
def others_at_fault(named, jet):
    """Number of jets but `jet` that were found at fault; `named` has the times of it, 0: not."""
    count = 0
    for i in range(named.shape[0]):
        count += named[i] > 0.0 and i != jet
    return count


@compiled
def suffices(whole, force, torque):
    """Whether a vehicle with this force and torque flies on."""
    return force >= max(LEAST * whole.force, UPHILL * whole.slope) and (
        torque >= LEAST * whole.torque
    )


@compiled
def restart(p, m, evidence, fired):
    """Let the detector begin anew: its evidence is explained, and the jets are other ones now.

    While a jet is probed, the innovations go on with the jets as they were: their evidence of the
    doubt still counts.

    Args:
        p: jet_faults.Known.
        m: jet_faults.MEMORY, changed in place.
        evidence: jet_faults.Evidence.
        fired: fired.Fired.
    """
    pause_windows(p, m, evidence)
    if m.probed == 0:
        believe(p, m, evidence, fired)
    m.counted, m.again = max(0, m.counted - 2 * CALM), AGAIN
    m.noted, m.stretches = 0, 0
    clear(evidence.near)
    clear(evidence.far)
    evidence.nudges.near[:] = evidence.nudges.far[:] = 0.0
    evidence.duty[:], evidence.bias[:] = 0.0, evidence.calm[0]
    evidence.innovations.slow[:], evidence.off[:], evidence.sigma[:] = 0.0, 0.0, SPREAD


@compiled
def believe(p, m, evidence, fired):
    """Let the innovations begin anew, with the jets as they are now; see `restart`."""
    innovations.restart(p.innovations, m.innovations, evidence.innovations)
    evidence.innovations.gives[:], evidence.innovations.leaks[:] = fired.gives, fired.leaks


@compiled
def take_back(m, fired, named):
    """Fly with the probed jet as before: it was not that one; `m` is jet_faults.MEMORY."""
    if m.probed > 0:
        fired.gives[m.probed - 1], named[m.probed - 1], m.probed = 1.0, 0.0, 0


@compiled
def end_probe(p, m, evidence, fired, named, t):
    """Trust a jet that was probed for long enough; `p` and `m` are jet_faults' Known and MEMORY.

    If a leak of another one explains more by then, it was not that jet; if both explain as much,
    because the jet still fires all the time, the doubt goes on.
    """
    m.tested = 0
    if m.probed == 0 or t - named[m.probed - 1] <= PROBE_S:
        return
    leak, weak = m.innovations.leak.gain, m.innovations.weak.gain
    if leak > SURE and leak > weak - CLEARER:
        m.tested = 1
        return
    m.probed = 0
    believe(p, m, evidence, fired)


@compiled
def relearn(model, m, effect, j):
    """Let the estimator learn its bias anew: a part of it was jet `j`; `m` is estimator.MEMORY."""
    push = np.hypot(effect[0, j], effect[1, j]) / model.mass
    turn = effect[2, j] / model.inertia
    m.cov[2, 2] += push * push
    m.cov_spin[2, 2] += turn * turn
