"""Figures: axes with units, everything inside them, thinning that hides nothing."""

import math
import re
import xml.etree.ElementTree as ET
from itertools import pairwise

import numpy as np
import pytest

from testbed.report.axis import number, ticks
from testbed.report.chart import SHAPES, THEME, alone, draw, thinned
from testbed.report.item import HUES, WIDTH, Chart, Disc, Limit, Line, Moment, Point, Raster

T = np.linspace(0.0, 100.0, 20_001)


def chart(*items, **more) -> Chart:
    return Chart("key", "A title", "time [s]", "error [mm]", items, (0.0, 100.0), **more)


def test_it_is_xml_with_axes_units_and_legend():
    y = np.sin(T)
    y[500:600] = math.nan
    svg = draw(chart(Line(T, y, 0, "sat1 <&>"), Limit(2.0, "limit 2 mm")))
    root = ET.fromstring(svg)
    texts = [t.text for t in root.iter("text")]
    assert {"time [s]", "error [mm]", "sat1 <&>", "limit 2 mm", "20", "100"} <= set(texts)
    assert "nan" not in svg


def test_a_file_of_its_own_needs_nothing_else():
    root = ET.fromstring(alone(chart(Line(T, np.cos(T), 1, "sat1"))))
    assert root.get("width") == str(WIDTH)
    assert float(root.get("height")) > 100.0
    assert "var(" not in alone(chart(Line(T, T, 0)))  # drawing programs do not know it
    assert "http" not in alone(chart(Line(T, T, 0))).replace("http://www.w3.org/2000/svg", "")


@pytest.mark.parametrize(
    "made",
    [
        chart(),
        chart(Line(np.zeros(0), np.zeros(0), 0, "empty")),
        chart(Line(T[:1], T[:1], 0, "one")),
        chart(Line(T, np.full(len(T), 5.0), 0, "constant")),
        chart(Line(T, np.zeros(len(T)), 0, "zero"), log=True),
        chart(Line(T, np.full(len(T), math.nan), 0, "nothing")),
        chart(Disc(1.0, 2.0, 0.5, "danger"), Disc(1.0, 2.0, 0.5, "ghost", 7),
              Point(0.0, 0.0, 1, "ring"), Point(1.0, 1.0, 2, "cross", "goal"),
              y_range=(-50.0, 50.0), equal=True),
        chart(Raster(-1, np.array([1.0, 50.0]), np.array([0.01, 5.0]), 0),
              Raster(0, np.zeros(0), np.zeros(0), 1), y_ticks=[(-0.5, "jet 1"), (0.5, "jet 2")]),
    ],
)  # fmt: skip
def test_whatever_is_in_it_is_a_picture(made):
    svg = draw(made)
    ET.fromstring(svg)
    assert "nan" not in svg
    assert "inf" not in svg


def test_eight_vehicles_differ_in_colour_and_mark_in_both_themes():
    svg = draw(chart(*(Line(T, T + k, k, f"sat{k + 1}") for k in range(HUES))))
    assert all(f'class="line s{k} "' in svg for k in range(HUES))
    assert f"s{HUES}" not in svg
    assert HUES == len(set(SHAPES)) == 8  # as the console and the dashboard
    for k in range(HUES):
        light, dark = re.findall(rf"--h{k}: (#\w+)", THEME)
        assert light != dark
        assert f".s{k} {{ stroke: var(--h{k}); }}" in THEME
        assert f".f{k} {{ fill: var(--h{k}); }}" in THEME
    assert len(set(re.findall(r"--h\d: (#\w+)", THEME))) == 2 * HUES


def test_thinning_keeps_the_extremes():
    y = np.sin(T)
    y[12_345] = 9.0
    y[777] = -9.0
    x, kept = thinned(T, y, 300)
    assert len(x) <= 602
    assert np.all(np.diff(x) > 0.0)
    assert (kept.max(), kept.min()) == (9.0, -9.0)


@pytest.mark.parametrize(
    ("low", "high", "wanted"),
    [(0.0, 100.0, [0, 20, 40, 60, 80, 100]), (-1.0, 1.0, [-1, -0.5, 0, 0.5, 1]),
     (0.0, 3e-7, [0, 1e-7, 2e-7, 3e-7])],
)  # fmt: skip
def test_ticks_are_round(low, high, wanted):
    assert ticks(low, high, 5) == pytest.approx(wanted)


def test_numbers_as_a_reader_writes_them():
    assert [number(v, 10) for v in (0.1 + 0.2, -2.0, 1e-17, 1500.0)] == [
        "0.3", "\N{MINUS SIGN}2", "0", "1500",
    ]  # fmt: skip


def test_a_long_legend_goes_on_in_another_row():
    lines = [Line(T, T * k, k, f"sat{k} demanded") for k in range(9)]
    root = ET.fromstring(draw(chart(*lines)))
    names = [t for t in root.iter("text") if "dem" in (t.text or "")]
    assert len(names) == 9
    assert all(float(t.get("x")) + 7.2 * len(t.text) <= WIDTH for t in names)
    assert len({t.get("y") for t in names}) > 1
    axis = next(e for e in root if e.get("class") == "axis").get("d")
    top = float(axis.rpartition("M")[2].partition("V")[0].split()[1])
    assert top > max(float(t.get("y")) for t in names)


def test_names_of_limits_that_are_near_do_not_overlap():
    near = chart(Line(T, T, 0), Limit(80.0, "settled"), Limit(78.0, "at the end"))
    root = ET.fromstring(draw(near))
    ys = [
        float(t.get("y")) for t in root.iter("text")
        if t.get("class") == "limitname"
    ]  # fmt: skip
    assert abs(ys[0] - ys[1]) > 12.0


def test_a_name_at_the_edge_stays_inside():
    goal = Point(99.0, 99.0, 0, "cross", "sat1", 3.0)
    root = ET.fromstring(draw(chart(goal, y_range=(0.0, 100.0), equal=True)))
    name = next(t for t in root.iter("text") if t.text == "sat1")
    assert name.get("text-anchor") == "end"
    assert float(name.get("y")) > 10.0


def test_no_two_names_of_limits_overlap_however_many_are_near():
    """gao2022 has three limits within a few millimetres."""
    limits = [Limit(80.0 - k, f"limit {k}") for k in range(4)]
    root = ET.fromstring(draw(chart(Line(T, T, 0), *limits)))
    ys = sorted(
        float(t.get("y")) for t in root.iter("text")
        if t.get("class") == "limitname"
    )  # fmt: skip
    assert all(b - a > 12.0 for a, b in pairwise(ys))


def test_moments_are_marked_inside_and_do_not_overlap():
    svg = draw(chart(Line(T, T, 0), Moment(10.0, "sat1 hits o1"), Moment(99.0, "sat1 hits o1")))
    root = ET.fromstring(svg)
    names = [t for t in root.iter("text") if t.text == "sat1 hits o1"]
    assert [t.get("text-anchor") for t in names] == ["start", "end"]
    assert float(names[1].get("y")) - float(names[0].get("y")) > 12.0


def test_no_line_covers_a_name_and_no_vehicle_either():
    drawn = chart(Limit(50.0, "limit"), Moment(20.0, "fault"), Point(5.0, 5.0, 1, "ring", "sat2"),
                  Point(9.0, 9.0, 0, "hit", "contact"), Line(T, T, 0, "sat1"))  # fmt: skip
    root = ET.fromstring(draw(drawn))
    kinds = [child.get("class") or "" for child in root]
    at = kinds.index("names")
    assert [t.text for t in root[at]] == ["limit", "fault", "sat2", "contact"]
    assert max(k for k, kind in enumerate(kinds) if kind.startswith("line s0 ")) > at  # the legend
    assert kinds.index("line s0 ") < at
    assert kinds.index("line hit") < at  # the report draws its vehicles below that


def test_a_figure_over_time_tells_its_unit():
    line = Line(T, T, 0, "sat1")
    assert 'data-unit="mm"' in draw(chart(line))
    logarithmic = Chart("k", "t", "time [s]", "distance [m], log scale", [line], (0.0, 1.0))
    assert 'data-unit="m"' in draw(logarithmic)
    assert "data-unit" not in draw(Chart("k", "t", "x [m]", "y [m]", [line], (0.0, 1.0)))


def test_what_is_constant_but_for_rounding_has_an_axis_of_different_numbers():
    root = ET.fromstring(draw(chart(Line(T, 92.0 + 1e-13 * np.sin(T), 0, "sat1"))))
    ticks = [t.text for t in root.iter("text") if t.get("text-anchor") == "end"]
    assert len(ticks) > 1
    assert len(ticks) == len(set(ticks))


def test_names_in_a_legend_have_room_for_the_large_letters_of_a_phone():
    names = ["sat1", "sat1, sat2", "sat1 delivered", "satellite_long_8"] * 2
    root = ET.fromstring(draw(chart(*(Line(T, T, k, name) for k, name in enumerate(names)))))
    found = [t for t in root.iter("text") if t.text in names]
    for one, other in pairwise(found):
        if one.get("y") == other.get("y"):
            sample = float(other.get("x")) - 28.0
            assert float(one.get("x")) + 9.0 * len(one.text) <= sample + 1.0
