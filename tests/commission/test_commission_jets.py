"""What the pulses of a wrongly wired vehicle look like, and which verdict they get."""

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from testbed.commission.floating import afloat
from testbed.commission.jets import Pulse, flow_times, judge
from testbed.commission.motion import Drift, Kick
from testbed.core.jets import effect_matrix
from testbed.core.table import Spread
from testbed.identification.vehicle_file import load_vehicle

FLOW = 0.2
LAB = Spread()
FLOATER = load_vehicle("generic_8jet")


def pulses(vehicle, wires=range(8), share=(1.0,) * 8, late=(0.0,) * 8, drag=0.0, others=0.0):
    """What the jets of the true `vehicle` do; the command of jet j opens valve `wires[j]`."""
    about = vehicle.com
    scale = np.array([vehicle.mass, vehicle.mass, vehicle.inertia])[:, None]
    columns = effect_matrix(vehicle.jets, about=about) / scale
    theta, found = 0.7, []
    c, s = np.cos(theta), np.sin(theta)
    for j, k in enumerate(wires):
        ax, ay, alpha = FLOW * share[k] * columns[:, k]
        change = np.array([c * ax - s * ay, s * ax + c * ay, alpha])
        delay = flow_times(vehicle, FLOW)[0] + late[k]
        sigma = np.array([1e-4, 1e-4, 3e-4])
        kick = Kick(change, sigma, theta, delay, 0.002, drag, 0.02, 1.0)
        found.append(Pulse(j, FLOW, kick, {"sat2": others}))
    return found


def codes(believed, found):
    return {v.code for v in judge("sat1", believed, found, LAB)}


def exchanged(*cycle):
    wires = list(range(8))
    for a, b in zip(cycle, (*cycle[1:], cycle[0]), strict=True):
        wires[a] = b
    return wires


def entry(k, **changes):
    jets = [replace(j, **changes) if i == k else j for i, j in enumerate(FLOATER.jets)]
    return replace(FLOATER, jets=jets)


@pytest.mark.parametrize("name", ["generic_8jet", "uky", "spot_red", "ita"])
def test_a_healthy_vehicle_passes(name):
    vehicle = load_vehicle(name)
    assert codes(vehicle, pulses(vehicle)) == {""}


@pytest.mark.parametrize("wires", [exchanged(a, b) for a in range(8) for b in range(a)])
def test_any_two_exchanged_wires_are_named(wires):
    verdicts = judge("sat1", FLOATER, pulses(FLOATER, wires), LAB)
    a, b = (j + 1 for j in range(8) if wires[j] != j)
    assert [v.code for v in verdicts] == ["wires_swapped"]
    assert f"jets {a} and {b} " in verdicts[0].text


def test_three_wires_in_a_ring_are_named():
    assert codes(FLOATER, pulses(FLOATER, exchanged(0, 2, 5))) == {"wires_swapped"}


@pytest.mark.parametrize("k", range(8))
def test_an_entry_with_a_wrong_sign_or_side_is_named(k):
    jet = FLOATER.jets[k]
    reversed_ = entry(k, push=(-jet.push[0], -jet.push[1]))
    assert codes(reversed_, pulses(FLOATER)) == {"jet_reversed"}
    x, y = jet.position
    mirrored = entry(k, position=(x, -y) if jet.push[0] else (-x, y))
    assert codes(mirrored, pulses(FLOATER)) == {"jet_mirrored"}


@pytest.mark.parametrize(
    ("turn", "code"),
    [
        (lambda x, y: (-y, x), "all_turned"),
        (lambda x, y: (-x, -y), "all_turned"),
        (lambda x, y: (x, -y), "all_mirrored"),
    ],
)
def test_errors_of_the_whole_vehicle_are_one_verdict(turn, code):
    odd = load_vehicle("spot_red")  # not symmetric: no jet looks like another
    jets = [replace(j, push=turn(*j.push), position=turn(*j.position)) for j in odd.jets]
    verdicts = judge("sat1", replace(odd, jets=jets), pulses(odd), LAB)
    assert [v.code for v in verdicts] == [code]


@pytest.mark.parametrize(
    ("how", "code"),
    [
        ({"share": (1, 1, 0, 1, 1, 1, 1, 1)}, {"dead"}),
        ({"share": (1, 1, 0.5, 1, 1, 1, 1, 1)}, {"jet_weak"}),
        ({"share": (0.7,) * 8}, {"all_weak"}),
        ({"share": (1.5,) * 8}, {"all_strong"}),
        ({"late": (0, 0, 0, 0.05, 0, 0, 0, 0)}, {"jet_late"}),
        ({"late": (0.05,) * 8}, {"late"}),
        ({"drag": 0.15}, {"drag"}),
        ({"share": (0,) * 8, "others": 0.01}, {"boards_swapped"}),
        ({"share": (0,) * 8}, {"dead"}),
    ],
)
def test_weak_late_and_absent_pushes(how, code):
    assert codes(FLOATER, pulses(FLOATER, **how)) == code


@pytest.mark.parametrize("deg", [-25.0, -9.0, 9.0, 25.0])
def test_a_body_that_is_turned_in_motion_capture_pushes_aside(deg):
    found = [
        pulse._replace(kick=pulse.kick._replace(theta=pulse.kick.theta + np.radians(deg)))
        for pulse in pulses(FLOATER)
    ]
    (verdict,) = judge("sat1", FLOATER, found, LAB)
    assert verdict.code == "body_aside"
    assert verdict.numbers["aside_deg"] == pytest.approx(-deg, abs=0.1)


def test_mass_and_inertia_are_told_apart():
    light = replace(FLOATER, mass=0.7 * FLOATER.mass, inertia=0.7 * FLOATER.inertia)
    assert codes(FLOATER, pulses(light)) == {"all_strong"}
    assert codes(FLOATER, pulses(replace(FLOATER, inertia=1.6 * FLOATER.inertia))) == {"inertia"}


def test_pushes_that_noise_hides_are_no_verdict():
    found = [p._replace(kick=p.kick._replace(sigma=np.full(3, 0.01))) for p in pulses(FLOATER)]
    (verdict,) = judge("sat1", FLOATER, found, LAB)
    assert verdict.skipped


def drifts(vehicle, *, leak=None, slope=(0.0, 0.0), hose=(0.0, 0.0, 0.0)):
    """Floating at headings 0 and 180 degrees."""
    found = []
    for theta in (0.0, np.pi):
        push = np.array(slope) + np.array(hose[:2]) / vehicle.mass
        alpha = hose[2] / vehicle.inertia
        if leak is not None:
            jet, share = leak
            fx, fy, tau = share * effect_matrix(vehicle.jets, about=vehicle.com)[:, jet]
            push = push + np.cos(theta) * np.array([fx, fy]) / vehicle.mass
            alpha += tau / vehicle.inertia
        sigma = np.array([3e-4, 3e-4, 1e-3])
        found.append(Drift(np.array([*push, alpha]), sigma, np.array([0.0, 0.0, theta])))
    return found


@pytest.mark.parametrize(
    ("how", "code"),
    [
        (SimpleNamespace(), ""),
        (SimpleNamespace(slope=(0.002, 0.0)), ""),
        (SimpleNamespace(slope=(0.01, 0.0)), "pulled"),
        (SimpleNamespace(hose=(0.1, 0.0, 0.0)), "pulled"),
        (SimpleNamespace(hose=(0.02, 0.0, 0.01)), "hose"),
        *(
            (SimpleNamespace(leak=(k, share)), "leak")
            for k in range(8)
            for share in (0.1, 0.5, 1.0)
        ),
    ],
)
def test_what_moves_a_vehicle_that_floats(how, code):
    verdict = afloat("sat1", FLOATER, drifts(FLOATER, **vars(how)), [np.zeros(2)] * 2, LAB)
    assert verdict.code == code, verdict.text
    if code == "leak":
        assert verdict.text.startswith(f"jet {how.leak[0] + 1} ")
        assert verdict.numbers["share"] == pytest.approx(how.leak[1], rel=0.05)


@pytest.mark.parametrize(
    ("how", "code"),
    [
        (SimpleNamespace(), ""),
        (SimpleNamespace(slope=(0.0028, 0.0)), ""),
        (SimpleNamespace(hose=(0.05, 0.0, 0.0)), "pulled"),  # 4 mm/s^2
        (SimpleNamespace(leak=(4, 0.5)), "leak"),
    ],
)
def test_one_heading_tells_a_pull_beyond_a_healthy_slope(how, code):
    one = drifts(FLOATER, **vars(how))[:1]
    verdict = afloat("sat1", FLOATER, one, [np.zeros(2)], LAB)
    assert verdict.code == code, verdict.text
    assert ("a jet that leaks" in verdict.text) == (code == "pulled")


def test_two_headings_tell_a_pull_from_a_leak():
    how = drifts(FLOATER, hose=(0.1, 0.0, 0.0))
    verdict = afloat("sat1", FLOATER, how, [np.zeros(2)] * 2, LAB)
    assert verdict.code == "pulled"
    assert "leaks" not in verdict.text
