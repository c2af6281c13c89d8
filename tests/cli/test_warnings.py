"""Starts that a law's proof does not cover: an error or a named warning, never silence."""

import json
import re
from pathlib import Path

import pytest

from testbed.config import find, load
from testbed.config.guarantee import warnings_of


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def warnings(testbed, *words) -> list[str]:
    result = testbed("check", *words)
    assert result.exit_code == 0, result.output
    return re.findall(r"^warning: ([a-z-]+): ", result.stderr, re.MULTILINE)


SHAPE = "controller.formation"
NEAR = "vehicles.sat3.start=[0.75,0.0,0.0]"
BASELINE = [
    "controller={type='collision_sliding',k_d=1.5,gamma=0.2,formation={range=2.5,safe=0.45,"
    "far_margin=0.05,near_margin=0.05,edges=['sat1-sat2','sat2-sat3'],"
    "distances={sat1-sat2=1.25,sat2-sat3=1.667,sat1-sat3=2.083}}}",
]
WARNED = {  # experiment, what is changed: what is said
    "as shipped": ("xue2022_table", [], []),
    "as shipped, obstacle": ("xue2022_table_obstacle", [], []),
    "as shipped, constant leader": ("xue2024_table_constant", [], []),
    "a boundary layer is always said": ("xue2024_table_varying", [], ["boundary-layer"]),
    "true sgn": ("xue2024_table_varying", ["controller.layer=0.0"], ["lock-in"]),
    "as shipped, static obstacle": ("xue2021_table_static", [], []),
    "a core that the rim of a vehicle reaches": (
        "xue2021_table_static", ["obstacles.o1.solid=0.3"], ["core-within-reach"],
    ),
    "a core as wide as a vehicle may touch": (
        "xue2021_table_static", ["obstacles.o1.solid=0.25"], [],
    ),
    "Theorem 2 has an unverifiable condition": (
        "xue2021_table_dynamic", [], ["beta-unproven", "boundary-layer"],
    ),
    "the same with true sgn": (
        "xue2021_table_dynamic", ["controller.layer=0.0"], ["beta-unproven"],
    ),
    "an obstacle that the static law has no proof for": (
        "xue2021_table_static", ["obstacles.o1.velocity=[0.01,0.0]"], ["obstacle-moves"],
    ),
    "a fault table that looks at nothing": ("xue2022_table", ["faults={}"], ["faults-unwatched"]),
    "a fault table that has lost a row": (
        "xue2022_table", ["faults.operator_gone.detector=pose_age"], ["faults-unwatched"],
    ),
    "as shipped, field": ("gao2022_table", [], []),
    "a field without damping": (
        "gao2022_table", ["controller.phases=[{shape='circle',k_v=0.0}]"], ["no-damping"],
    ),
    "a circle larger than the table": (
        "gao2022_table", ["controller.phases=[{shape='circle',r=3.0}]"], ["curve-off-table"],
    ),
    "a double line off the table": (
        "gao2022_table", ["controller.phases=[{shape='double_line',mu=3.0}]"], ["curve-off-table"],
    ),
    "a field for other vehicles": (
        "gao2022_table", ["controller.fleet.count=3"], ["fleet-differs"],
    ),
    "a field for lighter vehicles": (
        "gao2022_table", ["controller.fleet.mass=5.0"], ["fleet-differs"],
    ),
    "a formation after the end": ("gao2022_table", ["duration_s=200"], ["phase-never-flown"]),
    "a wall inside the circle": (
        "gao2022_table", ["controller.wall.at=1.0"], ["curve-behind-wall"],
    ),
    "an obstacle that the field does not know": (
        "gao2022_table", ["obstacles.o1={position=[0.0,2.4],radius=0.3}"], ["obstacles-unseen"],
    ),
    "an obstacle that the proxies do not know": (
        "xue2022_table", ["obstacles.o1={position=[0.0,2.4],radius=0.3}"], ["obstacles-unseen"],
    ),
    "a potential beyond the jets": (
        "xue2021_table_static", ["controller.potential.k_f=5.0"], ["demand-beyond-thrust"],
    ),
    "an obstacle that pushes nobody": (
        "xue2021_table_static", ["controller.potential.k_o=0.0"], ["obstacles-unseen"],
    ),
    "laws without a proof": ("zhang2023_table", [], []),
    "a start too far from the shape": (
        "xue2022_table", ["vehicles.sat3.start=[0.75,0.0,0.0]"], ["start-energy"],
    ),
    "a low barrier": (
        "xue2022_table",
        ["vehicles.sat3.start=[0.72,0.0,0.0]", "controller.proxy.height=0.15"], ["barrier-height"],
    ),
    "a strong spring": ("xue2022_table", ["controller.proxy.limit=0.9"], ["limit-beyond-thrust"]),
    "an edge beyond the potential": (
        "xue2022_table", ["vehicles.sat3.start=[1.85,0.3,0.0]"],
        ["edge-outside-potential", "start-energy", "barrier-height"],
    ),
    "an edge beyond the range": (
        "xue2022_table", ["vehicles.sat3.start=[2.2,0.3,0.0]"],
        ["edge-beyond-range", "start-not-connected", "edge-outside-potential", "start-energy",
         "barrier-height"],
    ),
    "the same without proxies": (
        "xue2021_table_static", ["vehicles.sat1.start=[1.5,2.3,0.0]"],
        ["edge-beyond-range", "start-not-connected"],
    ),
    "distances that no triangle has": (
        "xue2021_table_static", [f"{SHAPE}.distances.sat1-sat2=0.6",
        f"{SHAPE}.distances.sat2-sat3=0.7"], ["unreachable-distances"],
    ),
    "a baseline whose edge is too long": (
        "xue2021_table_static", [*BASELINE, "vehicles.sat1.start=[1.5,2.3,0.0]"],
        ["edge-beyond-range", "start-not-connected"],
    ),
    "a leader where no triangle has its third corner": (
        "xue2024_table_constant",
        [f"{SHAPE}.distances.sat2-leader=1.75", f"{SHAPE}.distances.sat2-sat3=0.8",
         f"{SHAPE}.distances.sat3-leader=0.75"],
        ["several-leaders", "edge-outside-potential", "start-energy", "barrier-height",
         "unreachable-distances"],
    ),
    "a leader whose velocity is not the proof's": (
        "xue2024_table_constant", ["vehicles.sat3.path.velocity=[0.0,0.05]", "duration_s=30"],
        ["start-energy", "barrier-height"],
    ),
    "a weak friction": (
        "xue2024_table_varying", ["controller.beta=0.02"], ["beta-too-small", "boundary-layer"],
    ),
    "a leader that accelerates": (
        "xue2024_table_constant",
        ["vehicles.sat3.path={type='circle',radius=0.2,period_s=120.0}"], ["leader-accelerates"],
    ),
    "an obstacle that moves": (
        "xue2022_table_obstacle", ["obstacles.o1.velocity=[0.0,0.01]"], ["obstacle-moves"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", WARNED)
def test_a_start_that_may_be_flown_is_warned_of(testbed, case):
    name, overrides, expected = WARNED[case]
    assert warnings(testbed, name, *overrides) == expected


FOLLOWING = f"{SHAPE}.edges=['sat1-sat2','sat2-sat3','sat3-leader']"
ERRORS = {
    "not connected by its own edges": (
        "xue2022_table", [f'{SHAPE}.edges=["sat1-sat2"]'],
        "found     the initial graph is not connected", "sat3",
    ),
    "a distance that the range does not reach": (
        "xue2022_table", [f'{SHAPE}.edges=["sat1-sat2","sat1-sat3"]'], "less than range", "2.5 m",
    ),
    "a distance nearer than safe": (
        "xue2022_table", [f"{SHAPE}.distances.sat1-sat2=0.6"], "safe + near_margin", "0.6 m",
    ),
    "no distance for a pair": (
        "xue2022_table", [f"{SHAPE}.distances={{sat1-sat2=1.5,sat2-sat3=1.5}}"], "sat1-sat3", "",
    ),
    "a leader whom nobody hears": (
        "xue2024_table_constant", [f'{SHAPE}.edges=["sat1-sat2","sat2-sat3"]'], "not connected",
        "",
    ),
    "not connected, behind a leader that swings": (
        "xue2024_table_varying", [f'{SHAPE}.edges=["sat1-sat2","sat3-leader"]'], "not connected",
        "sat1, sat2",
    ),
    "not connected, among obstacles": (
        "xue2021_table_static", [f'{SHAPE}.edges=["sat1-sat2"]'], "not connected", "sat3",
    ),
    "not connected, among obstacles that move": (
        "xue2021_table_dynamic", [f'{SHAPE}.edges=["sat2-sat3"]'], "not connected", "sat2, sat3",
    ),
    "not connected, in the baseline": (
        "xue2021_table_static", [*BASELINE, f'{SHAPE}.edges=["sat2-sat3"]'], "not connected",
        "sat2, sat3",
    ),
    "beyond the range of a leader": (
        "xue2024_table_constant", [f"{SHAPE}.distances.sat3-leader=1.9", FOLLOWING],
        "cannot reach its desired distance", "1.9 m",
    ),
    "beyond the range of a leader that swings": (
        "xue2024_table_varying", [f"{SHAPE}.distances.sat3-leader=1.9", FOLLOWING],
        "cannot reach its desired distance", "1.9 m",
    ),
    "beyond the range among obstacles that move": (
        "xue2021_table_dynamic", [f"{SHAPE}.distances.sat1-sat2=2.48"],
        "cannot reach its desired distance", "2.48 m",
    ),
    "a field of no size for whom": (
        "gao2022_table", ["controller.fleet.count=40"], "room for 40 vehicles", "",
    ),
    "an exponent outside the proof": ("zhang2023_table", ["controller.p=3"], "p/q", ""),
    "a potential without room": (
        "xue2022_table", [f"{SHAPE}.near_margin=1.4"], "safe + near_margin", "",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", ERRORS)
def test_a_formation_that_cannot_be_is_an_error(testbed, case):
    name, overrides, expected, found = ERRORS[case]
    result = testbed("run", name, *overrides)
    assert result.exit_code == 2
    assert "controller" in result.stderr
    assert expected in result.stderr
    assert found in result.stderr
    assert not Path("runs").exists()


def test_the_result_has_the_warnings(testbed):
    words = ("xue2022_table", "duration_s=1", "controller.proxy.limit=0.9")
    result = testbed("run", *words, "--out", "out")
    assert "warning: limit-beyond-thrust: the spring's limit 0.9 N" in result.stdout
    (warning,) = json.loads(Path("out/metrics.json").read_text())["warnings"]
    assert warning["name"] == "limit-beyond-thrust"
    assert "0.9 N" in warning["text"]


def test_a_plan_that_gives_up_a_margin_is_in_the_result(testbed):
    inside = "obstacles={rock={position=[0.1,0.3],radius=0.3}}"
    pair = "guidance.neighbour_distance=0.8"
    law = "controller={type='mpc',margin=0.15}"
    words = ("run", "hold", law, pair, inside, "criteria={}", "duration_s=2", "--json")
    result = testbed(*words, "--out", "out")
    names = {warning["name"] for warning in json.loads(result.stdout)["warnings"]}
    assert names == {"margin-given-up"}


def test_in_the_papers_units_it_is_the_same():
    # lengths 20 times, times 4 times as large: forces are 20/16, energies 400/16 as large
    plain = load(find("xue2022_table"), [NEAR])
    shape = {"range": 40.0, "safe": 10.0, "far_margin": 4.0, "near_margin": 4.0}
    distances = "{sat1-sat2=30.0,sat2-sat3=30.0,sat1-sat3=50.0}"
    scaled = load(
        find("xue2022_table"),
        [
            NEAR,
            "controller.scale={length=20.0,time=4.0}",
            *(f"{SHAPE}.{key}={value}" for key, value in shape.items()),
            f"{SHAPE}.distances={distances}",
            "controller.proxy={spring=0.75,limit=0.875,weight=0.017,height=80.0}",
        ],
    )
    assert [w.name for w in warnings_of(scaled)] == [w.name for w in warnings_of(plain)]
    joules = [float(re.search(r"V\(0\) = (\S+) J", w.text)[1]) for w in warnings_of(plain)]
    theirs = [float(re.search(r"V\(0\) = (\S+) J", w.text)[1]) for w in warnings_of(scaled)]
    assert theirs == pytest.approx([25.0 * value for value in joules], rel=1e-3)
