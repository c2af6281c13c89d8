"""Flying on with the jets that are left: how much they can give, and flights with a bad jet."""

import sys
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.optimize import linprog

from stages import Allocator, Modulator, agent_of
from testbed.config import find, load
from testbed.config.shipped import shipped_faults
from testbed.core.codes import Detector
from testbed.core.error import MismatchError
from testbed.core.fault_injection import Injection
from testbed.core.jets import JetHealth, effect_matrix
from testbed.flight import allocation, bad_jet, modulation
from testbed.flight.allocation import AllocatorParams, weakest_force
from testbed.flight.bad_jet import INNOVATIONS, NEAR
from testbed.flight.fault_monitor import rows_of
from testbed.flight.hypotheses import KINDS, LEAK
from testbed.flight.modulation import SigmaDeltaParams
from testbed.flight.reconfiguration import (
    LEAST,
    PROBE_S,
    change,
    end_probe,
    flies_with_a_leak,
    is_a_guess,
    restart,
    room,
    suffices,
    suspicion_of,
    whole_of,
)
from testbed.metrics.run_metrics import weakest_jet, with_jets
from testbed.rig.observers import MetricsObserver, NullObserver
from testbed.rig.twin import make_twin
from testbed.run.judge import measure

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from filter import scenario
from jets_left import WEAK, Case, experiment_of

WAYS = 24  # directions of the linear programs


def furthest(effect, gives, leaks, way):
    """The largest multiple of a wrench that the jets can give, by a linear program."""
    n = effect.shape[1]
    columns = np.column_stack((effect * (gives - leaks), -np.array(way)))
    best = linprog(
        -np.eye(n + 1)[n], A_eq=columns, b_eq=-effect @ leaks, bounds=[(0.0, 1.0)] * n + [(0, 1e3)]
    )
    return best.x[n] if best.status == 0 else 0.0


@pytest.mark.parametrize("seed", range(8))
def test_room_is_what_linear_programs_find(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(5, 10))
    effect = rng.normal(size=(3, n))
    effect[:, -1] = -effect[:, :-1].sum(axis=1)  # then they push every way
    gives, leaks = rng.uniform(0.5, 1.0, n), np.zeros(n)
    if seed % 2:
        leaks[0] = rng.uniform(0.1, 0.5)
    force, torque = room(effect, gives, leaks)
    angles = np.linspace(0.0, 2.0 * np.pi, WAYS, endpoint=False)
    found = [furthest(effect, gives, leaks, (np.cos(a), np.sin(a), 0.0)) for a in angles]
    turns = [furthest(effect, gives, leaks, (0.0, 0.0, sign)) for sign in (1.0, -1.0)]
    assert torque == pytest.approx(min(turns), abs=1e-6)
    assert force <= min(found) + 1e-6
    # the directions that are tried are within 7.5 degrees of the weakest one
    if force > 0.0:
        assert force >= np.cos(np.pi / WAYS) * min(found) * 0.9


def test_the_room_of_the_shipped_vehicle_is_its_weakest_force(vehicle):
    effect, ones = effect_matrix(vehicle.jets, about=vehicle.com), np.ones(8)
    force, _ = room(effect, ones, 0.0 * ones)
    assert force == pytest.approx(weakest_force(vehicle))
    for jet in range(8):
        shut = np.where(np.arange(8) == jet, 0.0, 1.0)
        stuck = np.where(np.arange(8) == jet, 1.0, 0.0)
        assert room(effect, shut, 0.0 * ones)[0] == pytest.approx(0.5 * force)
        assert room(effect, ones, stuck)[0] == pytest.approx(0.5 * force)
    both = np.where(np.arange(8) < 2, 0.0, 1.0)  # no jet pushes back
    assert room(effect, both, 0.0 * ones) == (0.0, 0.0)
    assert room(np.zeros((3, 4)) + 1e-3, np.ones(4), np.zeros(4)) == (0.0, 0.0)


def test_what_is_left_must_suffice(vehicle):
    effect = effect_matrix(vehicle.jets, about=vehicle.com)
    whole = whole_of(effect, slope=0.0)
    assert suffices(whole, LEAST * whole.force, LEAST * whole.torque)
    assert not suffices(whole, 0.99 * LEAST * whole.force, whole.torque)
    assert not suffices(whole, whole.force, 0.99 * LEAST * whole.torque)
    assert not suffices(whole._replace(slope=0.6 * whole.force), whole.force, whole.torque)


@pytest.mark.parametrize(
    ("detector", "share", "gives", "leaks"),
    [
        (Detector.JET_MISSING, 0.3, 0.7, 0.0),
        (Detector.JET_MISSING, 0.9, 0.0, 0.0),
        (Detector.JET_LEAKS_OR_WEAK, 1.0, 0.0, 0.0),
        (Detector.JET_OPEN, 0.93, 1.0, 1.0),
        (Detector.JET_LEAKS, 0.3, 1.0, 0.3),
    ],
)
def test_a_finding_changes_its_jet_only(vehicle, table, detector, share, gives, leaks):
    memory = agent_of(vehicle, table, shipped_faults()).memory
    suspected, given, leaked = memory.fixed[0].jet_faults, memory.fired.gives, memory.fired.leaks
    suspected.weak_by = suspected.leak_by = NEAR
    suspected.weak.jet = suspected.leak.jet = 5
    suspected.weak.share = suspected.leak.share = share
    found = suspicion_of(suspected, detector.value)
    assert found.jet == 5
    change(given, leaked, found, detector.value)
    assert given[5] == pytest.approx(gives)
    assert leaked[5] == pytest.approx(leaks)
    assert (np.delete(given, 5) == 1.0).all()
    assert (np.delete(leaked, 5) == 0.0).all()


def test_the_jet_that_the_innovations_name_is_the_one_that_changes(vehicle, table):
    memory = agent_of(vehicle, table, shipped_faults()).memory
    suspected, given = memory.fixed[0].jet_faults, memory.fired.gives
    suspected.weak.jet, suspected.far.weak.jet, suspected.innovations.weak.jet = 1, 2, 6
    suspected.weak_by, suspected.innovations.weak.share = INNOVATIONS, 0.3
    missing = Detector.JET_MISSING.value
    change(given, memory.fired.leaks, suspicion_of(suspected, missing), missing)
    assert given[6] == pytest.approx(0.7)
    assert (np.delete(given, 6) == 1.0).all()


@pytest.mark.parametrize(
    ("detector", "leak", "weak", "guess"),
    [
        (Detector.JET_LEAKS_OR_WEAK, 0.0, 0.0, True),
        (Detector.JET_MISSING, 300.0, 400.0, False),
        (Detector.JET_MISSING, 380.0, 400.0, True),  # the opposite jet fires all the time
        (Detector.JET_OPEN, 380.0, 400.0, False),
    ],
)
def test_a_weak_jet_is_a_guess_if_a_leak_is_nearly_as_likely(
    detector, leak, weak, guess, vehicle, table
):
    suspected = agent_of(vehicle, table, shipped_faults()).memory.fixed[0].jet_faults
    fine = suspected.innovations
    fine.leak.gain = fine.gains[LEAK] = leak
    fine.weak.gain, fine.weak.share, fine.weak.jet = weak, 0.9, 3
    suspected.weak_by = INNOVATIONS
    assert is_a_guess(suspected, detector.value) == guess


@pytest.mark.parametrize(
    ("share", "flies_open", "named"), [(0.06, 0, True), (0.15, 1, False), (0.25, 1, True)]
)
def test_a_small_leak_beside_a_jet_that_is_stuck_open_may_be_its_own_error(
    share, flies_open, named, vehicle, table
):
    suspected = agent_of(vehicle, table, shipped_faults()).memory.fixed[0].jet_faults
    suspected.leak.gain = suspected.gains[LEAK] = 40.0
    suspected.leak.share, suspected.flies_open = share, flies_open
    assert bad_jet.leaks(suspected, np.zeros(KINDS)) == named
    assert bad_jet.leaks_or_is_weak(suspected, np.zeros(KINDS)) == named


def test_the_row_of_a_valve_stuck_open_says_whether_a_leak_is_flown_around():
    shipped = shipped_faults()
    assert not flies_with_a_leak(rows_of(shipped))
    row = replace(shipped["valve_stuck_open"], response="reconfigure", otherwise="land")
    assert flies_with_a_leak(rows_of({**shipped, "valve_stuck_open": row}))


def test_a_jet_that_gives_nothing_is_not_used(vehicle):
    allocator, share = Allocator(AllocatorParams(), vehicle), np.ones(8)
    share[0], share[4] = 0.0, 0.7
    for k in range(20):
        wanted = 0.3 * np.cos(k), 0.3 * np.sin(k), 0.02 * np.cos(2 * k)
        duty = allocation.allocate(allocator.p, wanted, share)
        assert duty[0] == 0.0
        assert allocator.effect @ (share * duty) == pytest.approx(np.array(wanted), abs=1e-9)


def test_what_a_jet_owes_is_not_fired_by_one_that_is_shut(vehicle):
    modulator = Modulator(SigmaDeltaParams(), vehicle, 0.1)
    i, j = modulator.p.opposing[0]
    share, duty = np.ones(8), np.zeros(8)
    share[i] = 0.0
    modulator.carried.rest[j] = -0.05  # it has fired more than was wanted
    for _ in range(5):
        on, _ = modulation.pulses(modulator.p, modulator.carried, duty, share)
        assert on[i] == 0.0


def test_only_rows_about_jets_reconfigure():
    rows = shipped_faults()
    assert rows["valve_stuck_closed"].reconfigures
    with pytest.raises(MismatchError):
        replace(rows["pose_lost"], response="reconfigure")


def flown(*changes, inject=(), seed=3, lasts=40.0):
    experiment = load(find("hold"), [*changes, f"seed={seed}", f"duration_s={lasts}"])
    rig = make_twin(replace(experiment, inject=list(inject)))
    observer = MetricsObserver(experiment.vehicles)
    ending = rig.fly(observer)
    metrics = measure(rig, observer.aims, ending, 0.0, completed=ending.fault is None)
    return ending, with_jets(metrics, {"sat1": rig.jets("sat1")})


STARTS = ("vehicles.sat1.start=[-0.5,-0.5,0.0]", "vehicles.sat1.goal=[0.3,0.3,1.0]")


def shut(jet):
    return Injection("stick_closed", "sat1", at_s=0.5, jet=jet)


WEAK_JETS = ("vehicles.*.model.jets.*.thrust=0.25", "vehicles.*.model.mass=20")
OPEN = (
    "faults.valve_stuck_open.response=reconfigure", "faults.valve_stuck_open.otherwise=land",
)  # fmt: skip


@pytest.mark.parametrize("jet", range(1, 9))
def test_a_jet_that_sticks_open_on_the_way_of_a_weak_vehicle_is_named_and_no_other(jet):
    """The opposite jet fires all the time, so it looks as if it gave nothing."""
    stuck = Injection("stick_open", "sat1", at_s=4.0, jet=jet)
    ending, metrics = flown(*STARTS, *WEAK_JETS, *OPEN, inject=[stuck], lasts=20.0)
    assert ending.fault is None
    assert [k for k, one in enumerate(metrics.jets["sat1"], 1) if one.words] == [jet]


def test_the_shipped_table_lands_a_vehicle_whose_valve_is_stuck_open():
    stuck = Injection("stick_open", "sat1", at_s=4.0, jet=1)
    ending, metrics = flown(*STARTS, *WEAK_JETS, inject=[stuck], lasts=20.0)
    assert "jet 1" in ending.fault.words
    assert not any(one.words for k, one in enumerate(metrics.jets["sat1"], 1) if k != 1)


def test_a_vehicle_flies_on_without_a_jet_that_is_stuck_shut():
    ending, metrics = flown(*STARTS, inject=[shut(1)])
    assert ending.fault is None
    jets = metrics.jets["sat1"]
    assert [k for k, one in enumerate(jets, 1) if one.words] == [1]
    assert jets[0].gives == 0.0
    assert metrics.vehicles["sat1"].final_error_m < 0.01
    assert metrics.warnings[-1].name == "jet_reconfigured"
    assert metrics.warnings[-1].text.startswith("sat1: jet 1 taken out since ")


def test_it_brakes_where_the_jets_left_do_not_suffice():
    ending, _ = flown(*STARTS, inject=[shut(1), shut(2)])
    assert ending.fault is not None
    assert ending.fault.id in ("valve_stuck_closed", "valve_leaks_or_weak", "too_near")


def test_a_row_may_still_say_brake():
    rows = "faults.valve_stuck_closed.response=brake", "faults.valve_leaks_or_weak.response=land"
    ending, metrics = flown(*STARTS, *rows, inject=[shut(1)])
    assert ending.fault.id in ("valve_stuck_closed", "valve_leaks_or_weak")
    assert not any(one.words for one in metrics.jets["sat1"])


def test_the_effectiveness_of_jets_is_within_its_sigmas():
    """Of healthy jets that differ: against the truth of the twin, which only the test knows."""
    off = []
    for seed in (0, 1):
        experiment = load(find("hold"), [*STARTS, f"seed={seed}", "duration_s=60"])
        rig = make_twin(experiment)
        model = experiment.vehicles["sat1"].model
        true = rig.twin.plant.parameters.thrust[0] / [jet.thrust for jet in model.jets]
        rig.fly(NullObserver())
        jets = rig.jets("sat1")
        off += [
            (one.share - real) / one.sigma for one, real in zip(jets, true, strict=True)
        ]  # fmt: skip
        assert min(one.sigma for one in jets) < 0.2
        assert all(0.0 <= one.share <= 1.5 and 0.0 < one.sigma <= 0.3 for one in jets)
    assert np.abs(off).max() < 3.0


def test_a_law_that_answers_the_noise_makes_no_jet_look_strong():
    """It closes the loop itself, and the noise that it answers goes by itself."""
    noisy = "table.mocap.noise=1e-3", "table.mocap.noise_deg=0.15"
    experiment = load(find("zhang2023_table_wrench"), [*noisy, "seed=1", "duration_s=60"])
    rig = make_twin(experiment)
    true, off = rig.twin.plant.parameters, []
    rig.fly(NullObserver())
    for k, (name, setup) in enumerate(experiment.vehicles.items()):
        heavier = true.mass[k] / setup.model.mass  # less of a push looks the same
        thrusts = true.thrust[k] / [jet.thrust for jet in setup.model.jets]
        off += [
            one.share - real / heavier for one, real in zip(rig.jets(name), thrusts, strict=True)
        ]
    assert abs(np.mean(off)) < 0.05


def test_full_thrust_while_the_estimator_settles_names_no_jet():
    """A velocity that is found in the first second looks like a push, and stayed in the window."""
    experiment = replace(scenario(342, 41), duration_s=5.0)
    rig = make_twin(experiment)
    rig.fly(NullObserver())
    assert not [one.words for name in experiment.vehicles for one in rig.jets(name) if one.words]


@pytest.mark.parametrize("seed", [3, 4])
def test_a_hose_is_no_wrong_mass_and_no_weak_jet(seed):
    """A vehicle that holds against it fires the same jets all the time."""
    hose = Injection("hose", "sat1", at_s=10.0, value=0.2, towards_deg=40.0)
    ending, metrics = flown(inject=[hose], seed=seed, lasts=60.0)
    assert ending.fault is None
    shares = [(one.share, one.sigma) for one in metrics.jets["sat1"]]
    assert all(share > 1.0 - 3.0 * sigma for share, sigma in shares)
    assert (weakest_jet(metrics, "sat1") or 1.0) > 0.9


def test_the_benchmark_takes_thrust_from_its_weak_jet():
    experiment, at_s = experiment_of(Case("generic_8jet", "weak", 2, 0))
    (fault,) = experiment.inject
    assert (fault.kind, fault.jet, fault.value, fault.at_s) == ("weak_jet", 3, WEAK, at_s)


def test_words_say_how_a_jet_is_flown():
    assert JetHealth(1.0, 0.1).words == ""
    assert JetHealth(0.0, 0.3, 0.0, 0.0, 4.0).words == "taken out since 4.0 s"
    assert JetHealth(0.7, 0.1, 0.7, 0.0, 4.0).words == "flown at 70% since 4.0 s"
    assert "compensated since 4.0 s" in JetHealth(1.0, 0.1, 1.0, 1.0, 4.0).words


@pytest.mark.parametrize(
    "case",
    [
        Case("spot_red", "open", 0, 61),  # the opposite jet is probed first, and taken back
        Case("freeflyer", "open", 4, 61),
        Case("freeflyer", "weak", 4, 61),  # a leak of the opposite jet explained as much
    ],
)
def test_a_jet_that_was_in_doubt_is_named_after_all(case):
    experiment, at_s = experiment_of(case)
    rig = make_twin(replace(experiment, duration_s=at_s + 6.0))
    ending = rig.fly(NullObserver())
    assert ending.fault is None
    assert [k for k, one in enumerate(rig.jets("sat1")) if one.words] == [case.jet]


def test_a_landing_for_an_open_valve_takes_the_probed_jet_back():
    experiment = load(
        find("hold"), [*STARTS, "vehicles.sat1.model=uky", "vehicles.sat1.goal=[0.5,0.3,1.0]"]
    )
    stuck = Injection("stick_open", "sat1", at_s=3.0, jet=2)
    rig = make_twin(replace(experiment, inject=[stuck], duration_s=10.0))
    probed = []

    class Watch(NullObserver):
        def vehicle(self, name, tick):
            probed.extend(k for k, one in enumerate(rig.jets(name), 1) if one.words)

    ending = rig.fly(Watch())
    assert "jet 2 gives" in ending.fault.words
    assert set(probed) == {5}
    assert not [one.words for one in rig.jets("sat1") if one.words]


def test_a_probe_keeps_what_the_innovations_heard_and_ends(vehicle, table):
    agent = agent_of(vehicle, table, shipped_faults())
    memory, p = agent.memory, agent.params
    m, evidence = memory.fixed[0].jet_faults, memory.evidence
    m.innovations.remembered, m.probed, memory.fired.gives[4] = 90.0, 5, 0.7
    memory.named[4] = 20.0
    restart(p.jets_known, m, evidence, memory.fired)
    assert (m.innovations.remembered, evidence.innovations.gives[4]) == (90.0, 1.0)
    end_probe(p.jets_known, m, evidence, memory.fired, memory.named, 20.0 + PROBE_S)
    assert m.probed == 5
    end_probe(p.jets_known, m, evidence, memory.fired, memory.named, 20.1 + PROBE_S)
    assert (m.probed, m.innovations.remembered, evidence.innovations.gives[4]) == (0, 0.0, 0.7)
