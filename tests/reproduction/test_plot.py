"""Figures of `testbed reproduce --plots`: curves over time, and positions with equal scales."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from testbed.report.chart import alone
from testbed.reproduction.figure import Figure
from testbed.reproduction.plot import MOST, chart_of

T = np.linspace(0.0, 10.0, 50)
SVG = "{http://www.w3.org/2000/svg}"


def drawn(figure: Figure):
    return ET.fromstring(alone(chart_of("key", "xue2022, six", figure)))


def curves(count):
    return {f"agent {k + 1}": (T, np.sin(T + k)) for k in range(count)}


def test_curves_over_time_have_axes_and_a_legend():
    svg = drawn(Figure("errors", "time [s]", "error [m]", curves(8)))
    texts = [e.text for e in svg.iter(f"{SVG}text")]
    assert {"time [s]", "error [m]", "agent 1", "agent 8"} <= set(texts)
    lines = [e.get("class") for e in svg.iter(f"{SVG}path") if e.get("class").startswith("line")]
    assert len(set(lines)) == 8  # a curve beyond the colours has another style


def test_many_curves_have_no_legend():
    texts = [e.text for e in drawn(Figure("errors", "x", "y", curves(MOST + 1))).iter(f"{SVG}text")]
    assert not any(text.startswith("agent") for text in texts)


def test_positions_are_a_square_with_a_mark_at_each_end():
    column = {"agent 1": (0.01 * T, 5.0 * T), "agent 2": (np.full(50, 1.0), T)}
    figure = Figure("positions", "x [m]", "y [m]", column, dots=True)
    chart = chart_of("key", "six", figure)
    assert np.ptp(chart.x_range) == pytest.approx(np.ptp(chart.y_range))
    looks = [e.get("class", "") for e in drawn(figure).iter()]
    assert sum(look.startswith("mark rest") for look in looks) == 2  # the starts
    assert {"mark full s0 f0", "mark full s1 f1"} <= set(looks)  # the ends, and along the curves


def test_a_figure_without_numbers_is_drawn():
    drawn(Figure("errors", "x", "y", {"none": (T, np.full(50, np.nan))}))
    drawn(Figure("positions", "x", "y", {}, dots=True))


def test_obstacles_their_paths_and_shapes_are_within_the_frame():
    way = {"agent 1": (T, T)}
    circle = (300.0 * np.cos(T), 300.0 * np.sin(T))
    figure = Figure("positions", "x [m]", "y [m]", way, dots=True, circles=((-400.0, 0.0, 50.0),),
                    ways=(circle,), shapes=((T, -350.0 + 0.0 * T),))  # fmt: skip
    chart = chart_of("key", "six", figure)
    assert chart.x_range[0] <= -450.0
    assert chart.y_range[0] <= -350.0
    looks = [e.get("class", "") for e in drawn(figure).iter()]
    assert looks.count("danger") == 1
    assert "line s0 way dashed" in looks
    assert "line s0 edge dashed" in looks
