"""A leak and the weakness of another jet: which of them is named, and when both are."""

from types import SimpleNamespace

import numpy as np
import pytest

from stages import agent_of
from testbed.config import find, load
from testbed.config.shipped import shipped_faults
from testbed.core.codes import Detector
from testbed.flight import bad_jet, jet_faults, window
from testbed.flight.bad_jet import CLEARER
from testbed.flight.hypotheses import LEAK, WEAK, leaking
from testbed.flight.reconfiguration import PROBE_S, end_probe, needs_no_probe, suspicion_of
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin

DOUBTFUL = Detector.JET_LEAKS_OR_WEAK.value


def memory():
    """A detector that has heard nothing."""
    return np.zeros(1, jet_faults.MEMORY).view(np.recarray)[0]


@pytest.mark.parametrize(("jet", "at_s"), [(5, 3.4), (7, 3.4), (7, 5.0)])
def test_a_small_leak_of_a_weak_vehicle_is_named_and_no_other_jet(jet, at_s):
    """The short window took the neighbour of the jet for leaking, or an opposite one for weak."""
    model = "vehicles.sat1.model"
    leak = f'{{kind="leak_valve",vehicle="sat1",jet={jet},value=0.2,at_s={at_s}}}'
    experiment = load(
        find("hold"),
        [
            "vehicles.sat1.start=[-0.5,-0.5,0.0]", "vehicles.sat1.goal=[0.5,0.5,1.0]",
            f"{model}.mass=9.0", f"{model}.inertia=0.08", f"{model}.jets.*.thrust=0.12",
            'controller={type="pd"}', "guidance={}", "flight.jet_period_s=0.05",
            "table.mocap.noise=0.0001", "duration_s=30", "seed=50", f"inject=[{leak}]",
        ],
    )  # fmt: skip
    rig = make_twin(experiment)
    ending = rig.fly(NullObserver())
    assert ending.fault is not None
    assert ending.fault.id == "valve_leaks"
    assert f"jet {jet} leaks" in ending.fault.words
    assert not [one.words for one in rig.jets("sat1") if one.words]


@pytest.mark.parametrize(
    ("leak", "weak", "goes_on", "named"),
    [
        (100.0, 99.0 - CLEARER, True, True),  # the probe has shown it
        (100.0, 99.9, True, False),  # the jet still fires all the time
        (100.0, 101.1, False, False),  # it is weak
        (5.0, 3.0, False, False),  # neither is likely
    ],
)
def test_a_probe_ends_when_the_weak_jet_explains_more(leak, weak, goes_on, named, vehicle, table):
    agent = agent_of(vehicle, table, shipped_faults())
    memory, p = agent.memory, agent.params
    m = memory.fixed[0].jet_faults
    found = m.innovations
    found.leak.gain = found.gains[LEAK] = leak
    found.weak.gain = found.gains[WEAK] = weak
    found.leak.share, found.leak_held, m.probed, memory.named[4] = 0.3, 5, 5, 20.0
    assert not bad_jet.leaks_by_innovations(m)
    end_probe(p.jets_known, m, memory.evidence, memory.fired, memory.named, 19.9 + PROBE_S)
    assert (m.probed, m.tested) == (5, 0)
    end_probe(p.jets_known, m, memory.evidence, memory.fired, memory.named, 20.1 + PROBE_S)
    assert (m.probed, m.tested) == ((5, 1) if goes_on else (0, 0))
    assert bad_jet.leaks_by_innovations(m) == named


def test_two_jets_that_push_alike_are_both_named():
    leak = SimpleNamespace(jet=4, share=0.3, gain=100.0, next=91.0, other=7)
    assert leaking(leak) == "jet 5 or jet 8"
    leak.next = 90.0
    assert leaking(leak) == "jet 5"


def test_the_next_best_jet_is_kept_with_its_gain():
    found = memory()
    fits, own = np.zeros(32), np.ones(32)
    fits[8:11] = 0.5, 0.8, 0.7  # of leaks, the last eight of 16
    window.suspect_jets(own, fits, own, 8, found)
    assert (found.leak.jet, found.leak.other) == (1, 2)
    assert (found.leak.gain, found.leak.next) == (pytest.approx(0.32), pytest.approx(0.245))
    fits[8:11] = 0.5, 0.6, 0.9  # at another beginning
    window.suspect_jets(own, fits, own, 8, found)
    assert (found.leak.jet, found.leak.other) == (2, 1)
    assert (found.leak.gain, found.leak.next) == (pytest.approx(0.405), pytest.approx(0.32))


@pytest.mark.parametrize(
    ("near", "innovations", "jet", "probes"),
    [
        ((20.0, 18.0), (0.0, 0.0), 1, True),
        ((20.0, 9.0), (0.0, 0.0), 1, False),  # a leak, or another cause
        ((20.0, 9.0), (200.0, 190.0), 6, True),
        ((20.0, 18.0), (200.0, 180.0), 6, False),
    ],
)
def test_only_a_jet_that_may_well_be_weak_is_probed(near, innovations, jet, probes):
    m = memory()
    m.weak.jet, m.innovations.weak.jet = 1, 6
    m.leak.gain, m.weak.gain = near
    m.innovations.leak.gain, m.innovations.weak.gain = innovations
    assert suspicion_of(m, DOUBTFUL).jet == jet
    assert needs_no_probe(m, DOUBTFUL) != probes
    assert not needs_no_probe(m, Detector.JET_MISSING.value)
    m.probed = 3  # the doubt comes back: it is a leak
    assert not needs_no_probe(m, DOUBTFUL)
