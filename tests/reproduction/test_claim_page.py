"""The audit's web pages: index, papers, claims with limits, obstacles and the paper's numbers."""

import re

import numpy as np
import pytest

from testbed.reproduction.claim import judge
from testbed.reproduction.claim_page import Audited, write_pages
from testbed.reproduction.figure import Figure, Reading
from testbed.reproduction.paper import PAPERS, read_paper
from testbed.reproduction.paper_numbers import points

T = np.linspace(0.0, 5000.0, 200)
TABLE5 = {3000.0: 0.06967, 4000.0: 0.07092, 4050.0: 0.02099, 4100.0: 0.004614,
          4500.0: 0.006609, 5000.0: 0.008613}  # fmt: skip


@pytest.fixture(scope="module")
def gao():
    return read_paper(PAPERS / "gao2022.toml")


@pytest.fixture(scope="module")
def zhang():
    return read_paper(PAPERS / "zhang2023.toml")


def uniformity():
    return Figure("distribution uniformity", "time [s]", "L", {"L": (T, np.full(200, 0.05))},
                  readings=(Reading(("uniformity at *",)),))  # fmt: skip


def test_the_papers_numbers_are_points_at_their_times(gao):
    marks = points(uniformity(), "table5", gao.claims)
    found = {mark.x: mark.y for mark in marks}
    assert found.keys() == TABLE5.keys()
    for x, y in TABLE5.items():
        # the text's 0.7 at 4000 s is a misprint, and a claim of its own
        assert y in [mark.y for mark in marks if mark.x == x]
    assert all("Table 5" in mark.hint or "Fig. 21" in mark.hint for mark in marks)
    assert points(uniformity(), "circle_kn", gao.claims)[0].y == 0.01  # Fig. 14
    assert points(uniformity(), "no such run", gao.claims) == []


def audited(paper, key, run, measures, figures):
    values = dict.fromkeys(paper.runs, measures)
    rows = [
        judge(key, paper, claim, values, quick=True)
        for claim in paper.claims
        if claim.run == run and claim.over is None and claim.measure in measures
    ]
    return Audited(paper, rows, values, {run: figures})


def test_a_claims_page_has_limit_measured_value_and_obstacles(zhang, tmp_path):
    way = {"sat1": (T, 100.0 - 0.01 * T)}
    figures = [
        Figure("trajectory", "x [m]", "y [m]", way, dots=True, circles=((60.0, 80.0, 50.0),)),
        Figure("distance to the obstacles", "time [s]", "distance [m]", way,
               readings=(Reading(("* obstacle*_m",)),)),
        Figure("controller output", "time [s]", "u", way),
    ]  # fmt: skip
    one = audited(zhang, "zhang2023", "sotsmc", {"sat1 obstacle1_m": [49.0]}, figures)
    index = write_pages(tmp_path, {"zhang2023": one})
    assert 'href="zhang2023.html"' in index.read_text()
    assert (
        'href="zhang2023.sat1.min_distance.obstacle1.html"'
        in (tmp_path / "zhang2023.html").read_text()
    )
    page = (tmp_path / "zhang2023.sat1.min_distance.obstacle1.html").read_text()
    assert "\N{GREATER-THAN OR EQUAL TO} 50 m" in page
    assert '<div class="verdict fault">fails</div>' in page
    assert "Tables 2, 6: printed N_i = diag(15, 15, 15)" in page  # the corrections it needs
    gauge, trajectory, distance = page.split("<figure")[1:]
    assert "mark  cross" in gauge or "cross" in gauge  # not met, so not only a colour says it
    assert len(re.findall(r'<circle class="danger"', trajectory)) == 1
    assert "limit \N{GREATER-THAN OR EQUAL TO} 50 m" in distance
    assert "measured 49" in distance
    assert "controller output" not in page  # it does not show this measure


def test_a_value_that_meets_its_claim_is_a_disc(zhang, tmp_path):
    one = audited(zhang, "zhang2023", "sotsmc", {"sat1 obstacle1_m": [53.0]}, [])
    write_pages(tmp_path, {"zhang2023": one})
    page = (tmp_path / "zhang2023.sat1.min_distance.obstacle1.html").read_text()
    gauge = page.split("<figure")[1]
    assert "cross" not in gauge.partition("</svg>")[0]
    assert '<div class="verdict passed">holds with a correction</div>' in page


def test_every_link_leads_to_a_page(gao, tmp_path):
    one = audited(gao, "gao2022", "table5", {"uniformity at 4000": [0.0712]}, [uniformity()])
    write_pages(tmp_path, {"gao2022": one})
    for path in tmp_path.glob("*.html"):
        for link in re.findall(r'href="([^"]+)"', path.read_text()):
            assert (tmp_path / link).exists(), (path.name, link)
