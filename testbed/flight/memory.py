"""All that a vehicle remembers from one tick to the next, in one array.

A copy of the array saves the vehicle. Written back, it restores the vehicle.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.flight import (
    detectors,
    effectiveness,
    estimator,
    gate,
    innovation_sums,
    jet_faults,
    permanent,
    safety,
    tracker,
)
from testbed.flight.fault_monitor import Counters
from testbed.flight.fired import Fired
from testbed.flight.hypotheses import COLUMNS
from testbed.flight.jet_faults import SPIN_SPREAD, SPREAD, Evidence
from testbed.flight.modulation import Carried
from testbed.flight.nudges import AGO, LONG_AGO, Nudges
from testbed.flight.record import record
from testbed.flight.window import BLOCKS, SHARED, Window, width_of

Array = NDArray[np.float64]

FIXED = record(
    estimator=estimator.MEMORY,
    tracker=tracker.MEMORY,
    detectors=detectors.MEMORY,
    jet_faults=jet_faults.MEMORY,
    permanent=permanent.MEMORY,
    safety=safety.MEMORY,
    gate=gate.MEMORY,
    seq=int,  # number of the last plan
    thrust_scale=float,  # of that plan
    strength=float,  # weakest force of the jets left, as a share of all jets'
    gas_used=float,  # see online.py [kg]
)


class Memory(NamedTuple):
    """The memory of each stage: views of one array, changed in place."""

    fixed: NDArray[Any]  # one record FIXED
    fired: Fired  # plans, for the estimator
    evidence: Evidence  # of the jets, for jet_faults
    counters: Counters  # of the fault table
    carried: Carried  # by the modulator
    begun: Array  # on-time so far of a pulse that may continue, (jets,) [s]
    after: Array  # see flow.flow_shares, (jets,) [s]
    flown: Array  # see estimator.predict_mean, (2, jets)
    flowed: Array  # see flow.flow_shares, of the last period, (2, jets)
    times: Array  # of the last plan: on, then offset, (2 jets,), whole [us]
    permanent: Window  # see permanent.py
    named: Array  # when each jet was taken out or compensated, (jets,) [s]; 0: never


def make_memory(jets: int, plans: int, looks: int, rows: int) -> tuple[Memory, Array]:
    """The memory of a vehicle that has not flown yet, and the array that holds all of it.

    Args:
        jets: of the vehicle.
        plans: that the estimator remembers; they must cover the longest pose loss.
        looks: of jet_faults.Known.shown.
        rows: of the fault table.
    """
    m, size = jets + SHARED, FIXED.itemsize // 8
    one_a_row: tuple[int, ...] = (rows,)
    one_a_jet: tuple[int, ...] = (jets,)
    causes = m + jets + COLUMNS
    window: list[tuple[int, ...]] = [
        (m, m + 1), (BLOCKS, m + 2, width_of(jets)), (BLOCKS,), (1,), (2,), (3,),
    ]  # fmt: skip
    shapes: dict[type, list[tuple[int, ...]]] = {
        Fired: [(plans,), (plans,), *3 * [(plans, jets)], one_a_jet, one_a_jet],
        Evidence: [
            (2, jets), (looks, 3, causes), (3,), (3, causes + 1), (2, 3),
            one_a_jet, one_a_jet, *window, *window, *innovation_sums.shapes_of(jets),
            (m + 2, 3 * AGO), (m + 2, 3 * LONG_AGO),
        ],
        Counters: 5 * [one_a_row],
        Carried: 3 * [one_a_jet],
        Memory: [
            one_a_jet, one_a_jet, (2, jets), (2, jets), (2 * jets,),
            (m, m + 1), (1, m + 2, width_of(jets)), (1,), (1,), (2,), (3,), one_a_jet,
        ],
    }  # fmt: skip
    everything = np.zeros(size + sum(math.prod(s) for each in shapes.values() for s in each))
    views: dict[type, list[Array]] = {}
    for kind, each in shapes.items():
        views[kind] = []
        for shape in each:
            views[kind].append(everything[size : size + math.prod(shape)].reshape(shape))
            size += math.prod(shape)
    fixed = everything[: FIXED.itemsize // 8].view(FIXED)
    duty, recent, bias, total, calm, off, sigma, *parts = views[Evidence]
    near, far = Window(*parts[:6]), Window(*parts[6:12])
    innovations, nudges = innovation_sums.Sums(*parts[12:24]), Nudges(*parts[24:])
    fired = Fired(*views[Fired])
    evidence = Evidence(duty, recent, bias, total, calm, off, sigma, near, far, innovations, nudges)
    fired.start[:] = fired.end[:] = -np.inf
    evidence.sigma[:] = effectiveness.SPREAD
    near.spread[:] = far.spread[:] = SPREAD**2, SPIN_SPREAD**2
    fixed["thrust_scale"] = fixed["strength"] = fired.gives[:] = 1.0
    innovations.gives[:] = 1.0
    begun, after, flown, flowed, times, *always, named = views[Memory]
    memory = Memory(
        fixed, fired, evidence, Counters(*views[Counters]), Carried(*views[Carried]), begun, after,
        flown, flowed, times, Window(*always), named,
    )  # fmt: skip
    return memory, everything
