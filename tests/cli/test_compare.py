"""`testbed compare`: several runs in one table and on one page."""

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import msgspec
import numpy as np
import pytest

from testbed.cli.compare import read_run, residuals, together_data
from testbed.cli.compare_paper import Printed, with_paper
from testbed.config import SHIPPED
from testbed.report.chart import TIME
from testbed.report.item import Chart, Line, Mark
from testbed.reproduction.claim import Points


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_runs_side_by_side(testbed):
    for seed in ("1", "2"):
        testbed("run", "hold", "duration_s=2", "--seed", seed, "--out", f"seed{seed}")
    result = testbed("compare", "seed1", "seed2", "--out", "both.html")
    assert result.exit_code == 0
    for word in ("seed1", "seed2", "final error [mm]", "gas [g]", "failed", "both.html"):
        assert word in result.stdout
    page = Path("both.html").read_text()
    assert "<th></th>" not in page
    svgs = page.split("<svg")[1:]
    assert len(svgs) == 8
    for svg in svgs:
        drawn = ET.fromstring("<svg" + svg.partition("</svg>")[0] + "</svg>")
        names = {"seed2"} if "Residual" in svg.partition(">")[0] else {"seed1", "seed2"}
        assert names <= {t.text for t in drawn.iter("text")}
    found = json.loads(testbed("compare", "seed1", "seed2", "--json").stdout)
    for seed in ("seed1", "seed2"):
        metrics = json.loads(Path(seed, "metrics.json").read_text())["vehicles"]["sat1"]
        assert found[seed]["final_error_m"] == metrics["final_error_m"]
    assert testbed("compare", "seed1", "--out", "both.html").exit_code == 2  # never over it


def test_what_is_no_run(testbed):
    Path("empty").mkdir()
    result = testbed("compare", "empty")
    assert result.exit_code == 2
    assert result.stderr.startswith("error: ")


def test_a_formation_beside_a_flight_to_a_goal(testbed):
    testbed("run", "xue2024_table_constant", "duration_s=2", "--out", "together")
    testbed("run", "hold", "duration_s=2", "--out", "alone")
    found = json.loads(testbed("compare", "together", "alone", "--json").stdout)
    metrics = json.loads(Path("together/metrics.json").read_text())
    assert found["together"]["formation_error_m"] == metrics["formation"]["error_m"]
    assert found["together"]["final_error_m"] is None  # nobody has a goal of his own
    assert found["alone"]["formation_error_m"] is None
    testbed("compare", "together", "alone", "--out", "both.html")
    assert "Formation edges: length error; Distance to the goal" in Path("both.html").read_text()


def test_a_goal_that_moves_is_followed(testbed):
    circle = str(SHIPPED / "scenarios" / "circle.toml")
    testbed("run", circle, "duration_s=30", "--out", "round")
    page = Path("round/report.html").read_text()
    testbed("compare", "round", "--out", "one.html")
    line = re.search(r'id="error".*?<path class="line s0 "[^>]*( d="[^"]*")', page, re.DOTALL)
    assert line is not None
    assert line[1] in Path("one.html").read_text()  # the same curve as in the report
    found = json.loads(testbed("compare", "round", "--json").stdout)["round"]
    assert found["hold_rms_m"] is None  # it would be to where the goal had started
    assert found["track_rms_m"] is not None


def test_a_killed_flight_is_compared_and_reported_from_its_log(testbed):
    for name in ("whole", "killed"):
        testbed("run", "hold", "duration_s=40", "--out", name)
    for name in ("metrics.json", "report.html"):
        Path("killed", name).unlink()
    result = testbed("report", "killed")
    assert result.exit_code == 0
    page = Path("killed/report.html").read_text()
    assert "not judged, 39.9 s in the log" in page
    assert "killed before it was judged" in page
    found = json.loads(testbed("compare", "whole", "killed", "--json").stdout)
    close = {
        "final_error_m": 2e-4,
        "settle_s": 0.11,
        "track_rms_m": 1e-4,
        "hold_rms_m": 3e-4,
        "heading_rms_deg": 1e-3,
        "max_force_n": 1e-12,
    }  # ten times a second, not every frame
    for key, within in close.items():
        assert found["killed"][key] == pytest.approx(found["whole"][key], abs=within), key
    assert found["killed"]["gas_g"] is None
    assert "not judged" in testbed("compare", "killed").stdout
    log = Path("killed/log.mcap")
    whole = log.read_bytes()
    log.write_bytes(whole[: len(whole) // 2])
    assert testbed("report", "killed").exit_code == 0
    assert "the log has no end" in Path("killed/report.html").read_text()


def test_residuals_are_differences_to_the_first_run(testbed):
    for name, x in (("first", 0.0), ("second", 0.03), ("third", 0.0)):
        start = f"vehicles.sat1.start=[{x},-0.1,0.0]"
        testbed("run", "hold", "duration_s=2", start, "--out", name)
    runs = [read_run(Path(name), name) for name in ("first", "second", "third")]
    apart, turned = residuals(runs, (0.0, 2.0))
    second, third = apart.items
    assert second.y[0] == pytest.approx(30.0, abs=1.0)  # [mm]
    assert np.all(third.y == 0.0)  # the same flight
    assert np.abs(turned.items[1].y).max() == 0.0
    data = together_data(runs)
    assert [one["name"] for one in data["vehicles"]] == [
        "first: sat1", "second: sat1", "third: sat1",
    ]  # fmt: skip
    assert [one["hue"] for one in data["vehicles"]] == [0, 1, 2]


def test_runs_of_other_vehicles_have_no_residuals(testbed):
    testbed("run", "hold", "duration_s=1", "--out", "one")
    run = read_run(Path("one"), "one")
    other = msgspec.structs.replace(run, history=msgspec.structs.replace(run.history, vehicles={}))
    assert [chart.items for chart in residuals([run, other], (0.0, 1.0))] == [[], []]


def test_the_papers_numbers_stand_beside_the_runs(testbed):
    testbed("run", "zhang2023_table", "duration_s=3", "--out", "flown")
    result = testbed("compare", "flown", "--paper", "--out", "page.html")
    assert result.exit_code == 0, result.stderr
    for words in ("Fig. 15, reference mode", "Table 7", "zhang2023, and the runs"):
        assert words in result.stdout
    page = Path("page.html").read_text()
    table = next(svg for svg in page.split("<svg")[1:] if 'aria-label="Trajectories"' in svg)
    assert len(re.findall(r'class="mark paper', table.partition("</svg>")[0])) == 6
    assert "initial positions, (1.4, -1.4)" in table
    nearest = json.loads(testbed("compare", "flown", "--json").stdout)["flown"]
    found = nearest["min_obstacle_distance_m"]
    assert f"{found:.4g} ({found - 0.8:+.3g})" in page
    missed = re.search(r"\(1.818, 1.915\) m</td><td>([\d.]+) mm from the path", page)
    assert missed is not None
    assert float(missed[1]) > 2000.0  # three seconds lead nowhere near the goal


def test_an_experiment_without_a_papers_numbers_is_refused(testbed):
    testbed("run", "hold", "duration_s=1", "--out", "flown")
    result = testbed("compare", "flown", "--paper")
    assert result.exit_code == 2
    assert "hold, about which no file of configs/papers has a number" in result.stderr


def test_residuals_to_a_digitised_curve_are_at_its_times():
    curve = Points("Fig. 16", "error", "zhang2023_table", "error", (1.0, 2.0), (5.0, 3.0))
    t = np.linspace(0.0, 3.0, 31)
    chart = Chart("error", "Error", TIME, "mm", [Line(t, 10.0 - t, 0, "run")], (0.0, 3.0))
    drawn, off = with_paper([chart], Printed("zhang2023", (), (curve,)))
    assert len([item for item in drawn.items if isinstance(item, Mark)]) == 2
    assert off.items[0].x.tolist() == [1.0, 2.0]
    assert off.items[0].y == pytest.approx([4.0, 5.0])
