"""The page of a campaign stands alone, shows every run, and lets nothing through unescaped."""

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from msgspec.structs import replace

from testbed.campaign import figures
from testbed.campaign.flight import CampaignEnd, replay_command
from testbed.campaign.grouping import MOST_POINTS, best_front, fields
from testbed.campaign.report import html_report
from testbed.campaign.result import table_of
from testbed.campaign.row import FlownRun
from testbed.campaign.summary import summarise
from testbed.campaign.sweep import load_campaign
from testbed.report.axis import Axis, log_ticks, number, ticks
from testbed.report.chart import draw
from testbed.report.item import Box, Mark

MASS = {"key": "vehicles.*.model.mass", "low": 11.0, "high": 14.0}
GRID = {"key": "controller.bandwidth", "values": [0.1, 0.2, 0.3]}

LAWS = {
    "name": "law",
    "cases": {"soft": [], "stiff": ["controller.bandwidth=0.4"], "a<b": ["controller.damping=1.2"]},
}
RATES = {"key": "table.mocap.rate_hz", "values": [50.0, 100.0, 200.0]}


def page_of(campaign, runs, folder):
    summary = summarise(campaign, "hold", CampaignEnd(runs, 0, 1.0, []))
    return html_report(campaign, summary, runs, table_of(campaign, runs), folder)


def some_runs(count):
    rng = np.random.default_rng(1)
    return [
        FlownRun(
            k, "failed" if k % 5 == 0 else "passed", "settle_s" * (k % 5 == 0),
            {"goal_rms_m": float(rng.lognormal(-7)), "gas_g": float(rng.uniform(5, 20)),
             "settle_s": None if k % 5 == 0 else float(rng.uniform(5, 9))},
        )
        for k in range(count)
    ]  # fmt: skip


def pictures(page):
    return [ET.fromstring(svg) for svg in re.findall(r"<svg.*?</svg>", page, re.DOTALL)]


def test_the_legend_names_the_parameter(write, tmp_path):
    campaign = load_campaign(write(grid=[GRID], samples=20))
    legend = re.search(
        r"<p>(<span class=\"key\">.*?)</p>", page_of(campaign, some_runs(60), tmp_path)
    )
    assert legend is not None
    words = re.sub(r"<.*?>", " ", legend[1]).split()
    assert words[:4] == ["controller.bandwidth:", "0.1", "0.2", "0.3"]


def test_the_page_fetches_nothing_and_every_picture_is_sound(write, tmp_path):
    campaign = load_campaign(write(grid=[GRID], draw=[MASS], samples=20))
    page = page_of(campaign, some_runs(60), tmp_path)
    assert not re.search(r"(https?:)?//[a-z]|@import|url\(|src=|<link", page)
    assert "prefers-color-scheme: dark" in page
    assert len(pictures(page)) > 8
    for label in ("success rate", "distribution of", "gas [g]", "by controller.bandwidth"):
        assert any(label in svg.get("aria-label") for svg in pictures(page) if svg.get("role"))


def test_each_case_has_its_own_medians(write, tmp_path):
    campaign = load_campaign(write(grid=[GRID], samples=20))
    runs = some_runs(60)
    page = page_of(campaign, runs, tmp_path)
    for place, bandwidth in enumerate(GRID["values"]):
        gas = np.median([run.columns["gas_g"] for run in runs[place::3]])
        row = re.search(rf"</svg>{bandwidth}</td>.*?</tr>", page)[0]
        assert f'<td class="n">{gas:.4g}</td>' in row


def drawn(page, label):
    """The pictures that say so."""
    return [svg for svg in pictures(page) if label in (svg.get("aria-label") or "")]


def marks_of(svg, case):
    """A case's runs in a scatter, by what is written on them."""
    found = [e for e in svg if {"mark", f"f{case}"} <= set(e.get("class", "").split())]
    return {e.find("{*}title").text: e for e in found if e.find("{*}title") is not None}


def test_each_case_has_a_colour_and_a_mark_in_every_picture(write, tmp_path):
    campaign = load_campaign(write(grid=[LAWS], draw=[MASS], samples=20))
    runs = some_runs(60)
    page = page_of(campaign, runs, tmp_path)
    for scatter in (*drawn(page, "against vehicles"), *drawn(page, "against gas")):
        names = [
            e.text
            for e in scatter
            if e.get("class") == "name" and e.get("y") and float(e.get("y")) < 60.0
        ]
        assert names == ["soft", "stiff", "a<b", figures.HOLLOW]
        for case in range(3):
            found = marks_of(scatter, case)
            assert {int(hint.split(":")[0][4:]) for hint in found} == set(range(case, 60, 3))
            for hint, e in found.items():
                assert ("open" in e.get("class")) == hint.endswith("failed")
    shapes = {
        re.sub(r"[\d.]+", "", next(iter(marks_of(scatter, case).values())).get("d", "disc"))
        for case in range(3)
    }
    assert len(shapes) == 3
    assert all(f".f{case} {{" in page for case in range(6))


def test_a_distribution_has_a_row_for_each_case_with_the_numbers_of_the_summary(write, tmp_path):
    campaign = load_campaign(write(grid=[LAWS], samples=20))
    runs = some_runs(60)
    svg = drawn(page_of(campaign, runs, tmp_path), "distribution of gas")[0]
    words = [e.text for e in svg if e.text and e.text.startswith("median")]
    for case in range(3):
        values = sorted(run.columns["gas_g"] for run in runs[case::3])
        assert words[case] == f"median {np.median(values):.4g}, 95 % within {values[18]:.4g}"
        kinds = [f"box {look} s{case} f{case}" for look in ("full", "open")]
        hints = [e.find("*").text for e in svg if e.get("class") in kinds and e.tag == "rect"]
        counts = {hint: re.search(r": (\d+) passed, (\d+) not", hint).groups() for hint in hints}
        assert sum(int(g) + int(b) for g, b in counts.values()) == 20


def test_a_front_is_of_one_case(write, tmp_path):
    campaign = load_campaign(write(grid=[LAWS], samples=1000))
    runs = some_runs(3000)
    scatter = drawn(page_of(campaign, runs, tmp_path), "against gas")[0]
    for case in range(3):
        good = [
            (r.columns["gas_g"], r.columns["goal_rms_m"], r.k) for r in runs[case::3] if r.k % 5
        ]
        unbeaten = {k for x, y, k in good if not any(a < x and b < y for a, b, _ in good)}
        front = [
            e.find("*").text for e in scatter
            if {"best", f"f{case}"} <= set(e.get("class", "").split())
        ]  # fmt: skip
        assert {int(hint.split(":")[0][4:]) for hint in front} == unbeaten


def test_a_case_of_which_no_run_passed_is_named_at_the_fronts(write, tmp_path):
    campaign = load_campaign(write(grid=[LAWS], samples=20))
    runs = [replace(run, outcome="failed") if run.k % 3 == 2 else run for run in some_runs(60)]
    assert "No run passed of: a&lt;b." in page_of(campaign, runs, tmp_path)


def test_a_map_is_of_one_law_and_all_are_of_one_scale(write, tmp_path):
    campaign = load_campaign(write(grid=[LAWS, RATES], draw=[MASS], samples=20))
    runs = [replace(r, outcome="failed") if r.k % 9 >= 6 else r for r in some_runs(180)]
    page = page_of(campaign, runs, tmp_path)
    maps = drawn(page, "vehicles.*.model.mass by table.mocap.rate_hz")
    assert len(maps) == 6
    for case, svg in enumerate(maps[:3]):
        hints = [e.find("*").text for e in svg if "box heat" in e.get("class", "")]
        fields = [re.search(r": ([\d.]+) \((\d+) runs\)", hint).groups() for hint in hints]
        met = sum(r.outcome == "passed" for r in runs if r.k % 9 // 3 == case)
        assert sum(float(share) * int(count) for share, count in fields) == pytest.approx(
            100 * met, rel=1e-3
        )
    medians = {}
    for case, svg in enumerate(maps[3:]):
        for e in (e for e in svg if "box heat" in e.get("class", "")):
            count = int(re.search(r"\((\d+) runs\)", e.find("*").text)[1])
            value = float(re.search(r": ([\d.]+) \(", e.find("*").text)[1])
            medians[case, e.find("*").text] = value, float(e.get("style").split(":")[1]), count
    assert sum(count for *_, count in medians.values()) == 180
    low, high = min(v for v, *_ in medians.values()), max(v for v, *_ in medians.values())
    for value, share, _ in medians.values():
        assert share == pytest.approx((value - low) / (high - low), abs=2e-3)


def test_more_cases_than_one_tells_apart_are_put_together_by_what_is_no_number(write, tmp_path):
    campaign = load_campaign(write(grid=[LAWS, RATES], samples=5))
    page = page_of(campaign, some_runs(45), tmp_path)
    assert "each law has a colour and a mark of its own, whatever its table.mocap.rate_hz" in page
    found = marks_of(drawn(page, "against gas")[0], 1)
    assert {int(hint.split(":")[0][4:]) % 9 for hint in found} == {3, 4, 5}


def test_cases_beyond_the_colours_are_left_out_and_counted(write, tmp_path):
    eight = {"name": "law", "cases": {f"law{k}": [f"controller.damping={k + 1}"] for k in range(8)}}
    campaign = load_campaign(write(grid=[eight], draw=[MASS], samples=5))
    page = page_of(campaign, some_runs(40), tmp_path)
    assert page.count("The first 6 of 8 are drawn, 2 left out.") == 5
    rates = drawn(page, "success rate")[0]
    assert sum("rest" in e.get("class", "").split() for e in rates) == 4  # two bars, two discs
    for scatter in drawn(page, "against"):
        assert {int(h.split(":")[0][4:]) % 8 for k in range(8) for h in marks_of(scatter, k)} == {
            *range(6)
        }


def test_numbers_alone_that_are_many_are_drawn_together(write, tmp_path):
    many = {"key": "controller.bandwidth", "values": [0.1 + 0.01 * k for k in range(7)]}
    page = page_of(load_campaign(write(grid=[many], samples=5)), some_runs(35), tmp_path)
    assert "The figures below pool all cases." in page
    assert not re.search(r'class="mark [^"]*s\d', page)


def test_a_crowd_is_thinned_alike_in_each_case(write, tmp_path):
    campaign = load_campaign(write(grid=[LAWS], draw=[MASS], samples=3000))
    scatter = drawn(page_of(campaign, some_runs(9000), tmp_path), "against vehicles")[0]
    counts = [len(marks_of(scatter, case)) for case in range(3)]
    assert min(counts) > 0.8 * MOST_POINTS / 3
    assert max(counts) <= MOST_POINTS / 3 + 1


def test_without_a_run_that_passed_there_is_no_front(write, tmp_path):
    campaign = load_campaign(write(samples=30))
    runs = some_runs(30)
    assert "The line is the Pareto front" in page_of(campaign, runs, tmp_path)
    page = page_of(campaign, [r for r in runs if r.outcome == "failed"], tmp_path)
    assert "No run passed: there is no Pareto front." in page


def test_the_longest_words_beside_a_whisker_have_room():
    rows = [figures.RateRow("smc", 0.1, 0.2, 0.3, "10000 of 1000000")]
    words = next(
        e for e in ET.fromstring(draw(figures.success_rates(rows))) if e.text == rows[0].words
    )
    assert float(words.get("x")) + 7.2 * len(words.text) < figures.WIDTH


def test_an_axis_says_that_it_is_logarithmic():
    for high, words in ((1000.0, ", log scale"), (2.0, "")):
        points = [Mark(1.0, 1.0), Mark(2.0, high)]
        titles = [e.text for e in ET.fromstring(draw(figures.scatter(points, "a", "b"))) if e.text]
        assert f"b{words}" in titles
        assert "a" in titles


def test_the_worst_runs_come_with_the_command_that_flies_them(write, tmp_path):
    campaign = load_campaign(write(draw=[MASS], samples=60))
    runs = some_runs(60)
    page = page_of(campaign, runs, tmp_path)
    worst = max((r for r in runs if r.outcome == "failed"), key=lambda r: r.columns["goal_rms_m"])
    command = replay_command(campaign, tmp_path, worst.k).replace("'", "&#x27;")
    assert command in page


def test_words_of_a_file_are_words_on_the_page(write, tmp_path):
    evil = "<script>alert(1)</script>"
    campaign = load_campaign(write(description=evil, draw=[{**MASS, "name": evil}], samples=9))
    runs = [*some_runs(8), FlownRun(8, "error", f"Traceback\n{evil}")]
    assert evil not in page_of(campaign, runs, tmp_path)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_runs_make_a_page_too(write, tmp_path, count):
    campaign = load_campaign(write(draw=[MASS], samples=3))
    assert "</html>" in page_of(campaign, some_runs(count), tmp_path)


def test_runs_without_numbers_make_a_page_too(write, tmp_path):
    campaign = load_campaign(write(samples=2))
    runs = [FlownRun(0, "error", "boom"), FlownRun(1, "lost", "two workers died")]
    assert "boom" in page_of(campaign, runs, tmp_path)


@pytest.mark.parametrize("columns", [{}, {"goal_rms_m": 1e-3, "gas_g": 1.0}])
def test_many_runs_of_which_none_passed_make_a_page_too(write, tmp_path, columns):
    campaign = load_campaign(write(grid=[LAWS], draw=[MASS], samples=1000))
    runs = [FlownRun(k, "error", "boom", columns) for k in range(3000)]
    assert "boom" in page_of(campaign, runs, tmp_path)
    campaign = load_campaign(write(draw=[MASS], samples=3000))
    assert "boom" in page_of(campaign, runs, tmp_path)


def test_a_number_that_some_runs_do_not_have_says_of_how_many_it_is(write, tmp_path):
    campaign = load_campaign(write(samples=10))
    page = page_of(campaign, some_runs(10), tmp_path)  # two never settled
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", page)
    assert [words.split(":")[0] for words in captions if "of 10 runs" in words] == ["8 of 10 runs"]


def test_ten_thousand_runs_make_a_page_of_some_megabytes_with_every_failure(write, tmp_path):
    campaign = load_campaign(write(draw=[MASS], samples=7000))
    page = page_of(campaign, some_runs(7000), tmp_path)
    assert len(page) < 3e6
    scatter = next(s for s in pictures(page) if "against vehicles" in (s.get("aria-label") or ""))
    marks = [e for e in scatter if "cross" in e.get("class", "")]
    assert len(marks) == 1400
    assert len(scatter) < MOST_POINTS + 100


def test_the_front_is_of_all_runs_also_of_those_that_are_not_drawn(write, tmp_path):
    campaign = load_campaign(write(samples=4000))
    runs = some_runs(4000)
    good = [(r.columns["gas_g"], r.columns["goal_rms_m"], r.k) for r in runs if r.k % 5]
    unbeaten = {k for x, y, k in good if not any(a < x and b < y for a, b, _ in good)}
    page = page_of(campaign, runs, tmp_path)
    scatter = next(s for s in pictures(page) if "against gas" in (s.get("aria-label") or ""))
    hints = [e.find("*").text for e in scatter if "best" in e.get("class", "")]
    assert {int(hint.split(":")[0].removeprefix("run ")) for hint in hints} == unbeaten


def test_no_run_beats_the_front():
    rng = np.random.default_rng(2)
    points = [Mark(*rng.uniform(0, 1, 2), passed=bool(rng.integers(2))) for _ in range(300)]
    good = [p for p in points if p.passed]
    unbeaten = {
        p for p in good
        if not any(q.x <= p.x and q.y <= p.y and (q.x, q.y) != (p.x, p.y) for q in good)
    }  # fmt: skip
    assert set(best_front(points)) == unbeaten


@pytest.mark.parametrize(
    ("low", "high"), [(0.0, 1.0), (-3e-7, 2e-7), (1e6, 1e6 + 3), (0.5, 0.5 + 1e-3)]
)
def test_ticks_are_few_round_and_inside(low, high):
    found = ticks(low, high)
    assert 3 <= len(found) <= 8
    assert all(low - 1e-9 * abs(high) <= t <= high + 1e-9 * abs(high) for t in found)


def test_log_ticks_are_inside():
    assert log_ticks(0.09, 3.0) == pytest.approx([0.1, 0.2, 0.5, 1.0, 2.0])
    assert log_ticks(1e-6, 1e3) == pytest.approx([10.0**n for n in range(-6, 4)])


def test_a_histogram_counts_every_run_once():
    values = np.random.default_rng(3).lognormal(0, 2, 500)
    svg = ET.fromstring(draw(figures.histogram(values[:300].tolist(), values[300:].tolist(), "x")))
    hints = {e.find("title").text for e in svg if e.find("title") is not None}
    counts = [re.search(r": (\d+) passed, (\d+) not", hint).groups() for hint in hints]
    assert sum(int(g) for g, _ in counts) == 300
    assert sum(int(b) for _, b in counts) == 200


def test_fields_of_a_map_hold_every_value():
    values = np.random.default_rng(4).uniform(1.0, 3.0, 100).tolist()
    where, names = fields(values)
    assert (min(where), max(where), len(names)) == (0, 5, 6)
    few, labels = fields([2.0, 1.0, 2.0])
    assert (few, labels) == ([1, 0, 1], ["1", "2"])


def test_a_histogram_has_no_half_runs():
    drawn = ET.fromstring(draw(figures.histogram([1.0, 2.0, 2.0, 3.0], [], "x")))
    ends = [e.text for e in drawn.iter("text") if e.get("text-anchor") == "end"]
    assert ends == ["0", "1", "2"]


def test_a_map_has_room_for_the_names_of_its_rows():
    cells = [Box((0, 1), (0, 1), "heat", "hint", words="1", share=0.5)]
    drawn = ET.fromstring(draw(figures.heat(cells, ["0.1"], ["0.00001234"], "x", "a key [s]")))
    row = next(e for e in drawn.iter("text") if e.text == "0.00001234")
    assert float(row.get("x")) - 7.0 * len(row.text) > 13.0  # the title is turned at x = 13


def test_numbers_along_a_narrow_axis_are_told_apart():
    words = [number(value, 10) for value in Axis(1.19990, 1.20001, 0.0, 1.0).ticks()]
    assert len(words) > 2
    assert len(set(words)) == len(words)
    assert "0.2" in [number(value, 10) for value in Axis(0.0, 1.0, 0.0, 1.0).ticks()]
