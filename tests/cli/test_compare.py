"""`testbed compare`: several runs in one table and on one page."""

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest


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
    svgs = page.split("<svg")[1:]
    assert len(svgs) == 4
    for svg in svgs:
        drawn = ET.fromstring("<svg" + svg.partition("</svg>")[0] + "</svg>")
        texts = [t.text for t in drawn.iter("{http://www.w3.org/2000/svg}text")]
        assert {"seed1", "seed2"} <= set(texts)
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
