"""What is possible but improbable is said by `check`, and changes no exit code."""

import re

import numpy as np
import pytest
from scipy.optimize import linprog

from testbed.config import SHIPPED, find, load
from testbed.config.capability import pure
from testbed.config.parts import doubtful_parts
from testbed.config.plausibility import doubts_of
from testbed.core.jets import effect_matrix
from testbed.identification.vehicle_file import load_vehicle

MODEL = "vehicles.sat1.model"
SHIPPED_ONES = sorted(path.stem for path in (SHIPPED / "experiments").glob("*.toml"))
BLIND = {"zhang2023_table_pd", "zhang2023_table_lqr"}  # they show what avoidance avoids
PUSHES = [(-1, 0), (-1, 0), (0, 1), (0, 1), (1, 0), (1, 0), (0, -1), (0, -1)]  # of generic_8jet
DOUBTED = {  # what is changed: what is said
    "thrust": ([f"{MODEL}.jets.*.thrust=250"], ["thrust", "acceleration"]),
    "one jet": ([f"{MODEL}.jets.4.thrust=0.06"], ["jets-unequal", "jets-unequal"]),
    "mass": (
        [f"{MODEL}.mass=20000", f"{MODEL}.inertia=100"],
        ["mass", "acceleration", "slope", "too-short"],
    ),
    "inertia in other units": ([f"{MODEL}.inertia=0.003"], ["inertia"]),
    "jets that weaken each other": ([f"{MODEL}.air.droop=0.54"], ["droop"]),
    "exhaust speed in km/s": ([f"{MODEL}.air.exhaust_speed=0.6"], ["exhaust-speed", "gas"]),
    "longer than the tank lasts": (["duration_s=3600"], ["gas"]),
    "as long as it lasts": (["duration_s=2000"], []),
    "a specific impulse": ([f"{MODEL}.air.exhaust_speed=61"], ["exhaust-speed"]),
    "a pulse that lasts a jet period": ([f"{MODEL}.valve.min_on_s=0.1"], ["pulse"]),
    "small demands that pwm never fires": (
        ["flight.modulator={type='pwm'}", "flight.jet_period_s=0.02", "guidance.mode='wrench'"],
        ["dead-band"],
    ),
    "small demands of a fast loop": (["flight.modulator={type='pwm'}"], []),
    "a vehicle that hardly coasts": ([f"{MODEL}.drag=20", f"{MODEL}.spin_drag=0.4"], ["drag"] * 2),
    "landing in other units": (
        [f"{MODEL}.landing.speed=200", f"{MODEL}.landing.room=50", f"{MODEL}.landing.slope=0.5",
         f"{MODEL}.landing.friction=10"], ["landing"] * 4,
    ),
    "pressure": ([f"{MODEL}.air.set_pressure=5"], ["pressure"]),
    "slope": (["table.tilt.uniform=[0.05,0.0]"], ["slope"]),
    "noise": (["table.mocap.noise=0.2"], ["cameras"]),
    "noise of the heading": (["table.mocap.noise_deg=9"], ["cameras"]),
    "cameras in milliseconds": (
        ["table.mocap.jitter_s=1", "table.mocap.dropout_s=50"], ["cameras"] * 2,
    ),
    "radio in milliseconds and percent": (
        ["table.link.delay_s=5", "table.link.jitter_s=3", "table.link.loss=1.0"], ["radio"] * 3,
    ),
    "criteria in millimetres": (
        ["criteria.hold_rms_m=1", "criteria.track_rms_m=1.5", "criteria.final_error_m=50"],
        ["criterion"] * 3,
    ),
    "angles in rad": (
        ["table.mocap.noise_deg=0.0005", f"{MODEL}.tolerance.direction_deg=0.017"],
        ["cameras", "tolerance"],
    ),
    "no angle noise, no tolerance": (
        ["table.mocap.noise_deg=0", f"{MODEL}.tolerance.direction_deg=0"], [],
    ),
    "a tolerance in kg": ([f"{MODEL}.tolerance.mass=0.2"], ["tolerance"]),
    "slow cameras": (["table.mocap.rate_hz=5"], ["cameras"]),
    "a period in Hz": (["flight.jet_period_s=1"], ["period"]),
    "a centre of mass in another frame": ([f"{MODEL}.com=[0.12,0.05]"], ["com"]),
    "plumes for pushes": (
        [f"{MODEL}.jets.{k}.push=[{-x},{-y}]" for k, (x, y) in enumerate(PUSHES, 1)],
        ["jets-turned"],
    ),
    "a battery of 24 V": (
        [f"{MODEL}.gauges.battery_v=24", f"{MODEL}.gauges.undervoltage_v=18"], [],
    ),
    "arming of a battery of 24 V": (["arming.battery=22", "arming.battery_most=29"], ["battery"]),
    "an undervoltage that leaves no room": (
        [f"{MODEL}.gauges.battery_v=24", f"{MODEL}.gauges.undervoltage_v=23"], ["battery"],
    ),
    "no voltmeter": (
        [f"{MODEL}.gauges.battery=false", f"{MODEL}.gauges.undervoltage_v=0"], [],
    ),
    "a landing for a table that is more level": (
        [f"{MODEL}.landing.room=0.2", "table.tilt.uniform=[0.03,0.0]"], ["landing"],
    ),
    "a landing for slower flights": (
        [f"{MODEL}.landing.room=0.2", "flight.barrier.max_speed=0.25"], ["landing"],
    ),
    "a landing that fits": (
        [f"{MODEL}.landing.room=0.2", "flight.barrier.max_speed=0.2"], [],
    ),
    "a pulse that opens nothing": (
        [f"{MODEL}.valve.open_delay_s=0.05", f"{MODEL}.valve.min_on_s=0.001"], ["valve"],
    ),
    "an obstacle on the way": (
        ["obstacles.rock={position=[0.0,1.0],radius=0.5}", "vehicles.sat1.goal=[0.0,2.0,0.0]"],
        ["way-blocked"],
    ),
    "an obstacle beside the way": (["obstacles.rock={position=[0.0,1.0],radius=0.5}"], []),
    "an obstacle off the table": (
        ["obstacles.rock={position=[3.5,0.0],radius=0.5}"], ["obstacle-off-table"],
    ),
    "an obstacle over the edge": (["obstacles.rock={position=[3.4,0.0],radius=0.5}"], []),
    "an obstacle that may come": (
        ["obstacles.rock={position=[3.5,0.0],radius=0.5,velocity=[-0.1,0.0]}"], [],
    ),
    "too far for the time": (["duration_s=10"], ["too-short"]),
    "a body of another name": (["table.lab.mocap.bodies={sta1='Body 1'}"], ["body-unnamed"]),
    "bodies of others, too": (["table.lab.mocap.bodies={sat1='a',sat2='b'}"], []),
    "a port of another name": (["table.lab.serial.ports={stat1='/dev/a'}"], ["port-unnamed"]),
}  # fmt: skip


@pytest.mark.parametrize("case", DOUBTED)
def test_each_improbable_value_has_its_warning_and_no_other(case):
    changes, names = DOUBTED[case]
    assert [one.name for one in doubts_of(load(find("hold"), changes))] == names


def test_a_slope_that_the_jets_cannot_hold_is_called_that():
    for tilt, said in ((0.06, "little is left to steer with"), (0.12, "the vehicle slides off")):
        (one,) = doubts_of(load(find("hold"), [f"table.tilt.uniform=[{tilt},0.0]"]))
        assert said in one.text


def test_the_steepest_place_of_a_map_counts():
    level = "[[0,0],[0,0],[0,0]]"
    steep = [
        f"table.tilt.map=[{level},[[0,0],[0.06,0],[-0.06,0]],{level}]",
        "table.tilt.uniform=[0,0]",
    ]
    (one,) = doubts_of(load(find("hold"), steep))
    assert "at the steepest place of its map, takes 0.06 of the 0.096" in one.text


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (["duration_s=29.9"], ["criteria.hold_rms_m looks at the last 30 s of a run"]),
        (["duration_s=30"], []),
        (["duration_s=20", "criteria={}"], []),
        (["criteria.formation={error_m=0.1}"], ["criteria.formation is about a formation"]),
    ],
)
def test_a_criterion_that_is_never_measured_is_named(testbed, changes, said):
    assert never_measured(testbed("check", "hold", *changes)) == said


def never_measured(result):
    assert result.exit_code == 0
    return re.findall(r"never-measured: (.*), and .*: it is never met", result.stderr)


def test_criteria_of_a_goal_that_rests_are_never_measured_on_a_path(testbed):
    asked = ["criteria.hold_rms_m=0.01", "criteria.settle_s=90", "criteria.final_error_m=0.05"]
    about = "is about a goal that rests"
    assert never_measured(testbed("check", str(SHIPPED / "scenarios/circle.toml"), *asked)) == [
        f"criteria.settle_s {about}", f"criteria.hold_rms_m {about}",
    ]  # fmt: skip


def test_criteria_of_a_goal_are_never_measured_under_a_law_of_a_formation(testbed):
    asked = ["criteria.hold_rms_m=0.01", "criteria.settle_s=90"]
    about = "is about a vehicle's own goal"
    assert never_measured(testbed("check", "xue2022_table", *asked)) == [
        f"criteria.settle_s {about}", f"criteria.hold_rms_m {about}",
    ]  # fmt: skip


def test_edges_of_a_curve_are_never_measured(testbed):
    asked = "criteria.formation.longest_edge_m=2.0"
    said = ["criteria.formation.longest_edge_m is about a graph"]
    assert never_measured(testbed("check", "gao2022_table", asked)) == said


def test_a_formation_of_one_vehicle_is_never_measured(testbed, here):
    alone = [
        "controller={type='bounded_formation',beta=2.4,formation={range=1.2,safe=0.35,"
        "far_margin=0.1,near_margin=0.1,distances={}},proxy={spring=12.0,limit=0.8,weight=0.284,"
        "height=0.2,mass=1.0}}",
        "guidance.mode=wrench", "criteria={formation={error_m=0.02,settled_s=60.0}}",
    ]  # fmt: skip
    said = ["criteria.formation is about two vehicles or more"]
    assert never_measured(testbed("check", "hold", *alone)) == said
    result = testbed("run", "hold", *alone, "duration_s=1", "--out", "out")
    assert result.exit_code == 1
    assert " ".join(result.stdout.split()).count("(nothing was measured)") == 2


@pytest.mark.parametrize("name", SHIPPED_ONES)
def test_what_is_shipped_is_not_doubted(name):
    found = {one.name for one in doubts_of(load(find(name)))}
    assert found == ({"way-blocked"} if name in BLIND else set())


WAYS = ["towards -x", "towards -x", "towards +y", "towards +y", "towards +x", "towards +x",
        "towards -y", "towards -y"]  # fmt: skip


@pytest.mark.parametrize("lost", range(8))
def test_a_forgotten_jet_is_missed_by_its_direction(testbed, tmp_path, lost):
    whole = (SHIPPED / "vehicles" / "generic_8jet.toml").read_text()
    rows = re.findall(r"^  \{ position = .*\n", whole, re.MULTILINE)
    assert len(rows) == 8
    file = tmp_path / "seven.toml"
    file.write_text(whole.replace(rows[lost], ""))
    result = testbed("check", "hold", f"vehicles.sat1.model={file}")
    assert result.exit_code == 0
    assert f"7 jets, 0.6 N {WAYS[lost]} but 1.2 N" in result.stderr
    assert f"is a jet {WAYS[lost]} missing?" in result.stderr
    assert "  sat1: 7 jets, 0.60 N per axis, 0.108 N m, 0.048 m/s^2, at least" in result.stdout


@pytest.mark.parametrize("name", ["uky", "spot_black", "freeflyer"])
def test_the_force_of_an_axis_needs_no_torque_and_the_torque_no_force(name):
    """Against a linear program of scipy; uky's jets are not symmetric."""
    vehicle = load_vehicle(name)
    effect = effect_matrix(vehicle.jets, about=vehicle.com)
    wanted = []
    for axis in range(3):
        rest = np.delete(effect, axis, axis=0)
        both = [
            -linprog(-sign * effect[axis], A_eq=rest, b_eq=[0.0, 0.0], bounds=(0.0, 1.0)).fun
            for sign in (1.0, -1.0)
        ]
        wanted.append(min(both))
    assert pure(vehicle) == pytest.approx(wanted, rel=1e-9)
    all_helpful = np.minimum(effect.clip(min=0.0).sum(1), -effect.clip(max=0.0).sum(1))
    less = any(a < 0.99 * b for a, b in zip(pure(vehicle), all_helpful, strict=True))
    assert less == (name == "uky")


@pytest.mark.parametrize(("listed", "said"), [(1, "jets 1 and 9 are"), (8, ", 8 and 16 are")])
def test_a_jet_that_is_listed_twice_is_named(testbed, tmp_path, listed, said):
    whole = (SHIPPED / "vehicles" / "generic_8jet.toml").read_text()
    rows = re.findall(r"^  \{ position = .*\n", whole, re.MULTILINE)
    file = tmp_path / "twice.toml"
    file.write_text(whole.replace(rows[7], rows[7] + "".join(rows[:listed])))
    result = testbed("check", "hold", f"vehicles.sat1.model={file}")
    assert f"{said} at the same place and push the same way" in result.stderr


VEHICLES = sorted({path.resolve().stem for path in (SHIPPED / "vehicles").glob("*.toml")} - {"ita"})


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_the_parts_of_what_is_shipped_are_not_doubted(vehicle):
    """Except ita, whose jets stand for propellers."""
    model = SHIPPED / "vehicles" / f"{vehicle}.toml"
    experiment = load(find("hold"), [f"vehicles.sat1.model={model}"])
    assert list(doubtful_parts(experiment, experiment.vehicles["sat1"].model)) == []


def test_the_jets_that_are_missing_altogether_are_named(testbed, tmp_path):
    whole = (SHIPPED / "vehicles" / "generic_8jet.toml").read_text()
    rows = re.findall(r"^  \{ position = .*\n", whole, re.MULTILINE)
    file = tmp_path / "six.toml"
    file.write_text(whole.replace(rows[0], "").replace(rows[1], ""))
    result = testbed("check", "hold", f"vehicles.sat1.model={file}")
    assert result.exit_code == 2
    assert "6: none towards -x" in result.stderr


def test_check_says_what_each_vehicle_can_do(testbed):
    said = testbed("check", "zhang2023_table").stdout
    assert said.count(": 8 jets, 1.20 N per axis, 0.216 N m, 0.096 m/s^2, at least 15") == 3
    formation = testbed("check", "xue2022_table").stdout  # has no goals
    assert "to the place of the goal" not in formation


@pytest.mark.parametrize("changes", [case for case, _ in DOUBTED.values()], ids=list(DOUBTED))
def test_a_doubt_changes_no_exit_code(testbed, changes):
    assert testbed("check", "hold", *changes).exit_code == 0


def test_the_arithmetic_is_shown(testbed):
    said = testbed("check", "hold", "--faults").stdout
    words = "pose_stale: pose_age above 0.048: warn = latency + 2 * frame + 8 * jitter, with"
    assert f"{words} frame 0.01, latency 0.02, jitter 0.001" in said
    assert all(f"  {name}: " in said for name in load(find("hold")).faults)
    plain = testbed("check", "hold", "--faults", "faults.pose_lost.above=0.4").stdout
    assert "  pose_lost: pose_age above 0.4: brake\n" in plain


def test_the_defaults_are_shown(testbed):
    said = testbed("check", "hold", "--defaults").stdout
    assert "guidance.heading_accel 0.1: 0.1 of the 1.08 rad/s^2 of sat1" in said
    assert "the file has 0.02" in said


def test_check_says_more_of_what_a_vehicle_can_do(testbed):
    said = testbed("check", "hold").stdout
    assert (
        "along x 1.2 N, along y 1.2 N, without a torque; in the weakest direction 0.096 m/s^2"
        in said
    )
    assert "turning 1.1 rad/s^2" in said
    assert "shortest pulse 10 ms: 6 mN s, 0.48 mm/s" in said  # 0.6 N for 10 ms, on 12.5 kg
    assert "about 1.5 g of 250 g gas to the goal" in said
    assert "stop from 0.25 m/s: 0.34 m in 2.7 s" in said  # 0.25^2 / (2 x 0.0912)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (f"{MODEL}.jets.*.thrust=250", "250 N: published vehicles have 0.1 to 12 N; mN meant?"),
        (f"{MODEL}.air.set_pressure=5", "published vehicles have 2e5 to 1e6 Pa; bar meant?"),
        ("table.mocap.noise=0.2", "published cameras have 0.0001 to 0.001 m; mm meant?"),
    ],
)  # fmt: skip
def test_a_doubt_says_what_it_compares_with(testbed, change, words):
    assert words in testbed("check", "hold", change).stderr


def test_one_jet_in_millinewtons_is_named(testbed):
    said = testbed("check", "hold", f"{MODEL}.jets.1.thrust=1000").stderr
    assert "jet 1 has 1000 N: mN meant?" in said
