"""What the figures of a run show, against a flight made up for it."""

import math

import msgspec
import numpy as np

from controllers.bifurcating_design import distance_to
from testbed.config import find, load
from testbed.logs.history import History, VehicleHistory
from testbed.metrics.run_metrics import Touch
from testbed.report.fault_story import EventLine
from testbed.report.figures import figures
from testbed.report.item import Box, Line, Moment, Point

T = np.linspace(0.0, 10.0, 101)


def still(x: float, y: float) -> VehicleHistory:
    """A vehicle that stays where it is."""
    n = len(T)
    nothing = {
        name: np.full((n, 3), math.nan)
        for name in ("reference", "commanded_wrench", "realised_wrench")
    }
    return VehicleHistory(
        t=T, at=T, pose=np.tile([x, y, 0.0], (n, 1)), twist=np.zeros((n, 3)), seen=np.zeros((0, 4)),
        force_asked=np.full((n, 2), math.nan), on=np.zeros((n, 8)), offset=np.zeros((n, 8)),
        supply=np.full(n, 5e5), tank=np.full(n, 2e7), pose_age=np.full(n, 0.03),
        filtered=np.zeros((n, 2)), events=[], edges=np.zeros((0, 2)), wires=np.zeros((0, 5)),
        true=np.zeros((0, 6)), **nothing,
    )  # fmt: skip


def flown(count: int) -> dict[str, list[Line]]:
    """Lines of each figure, with so many vehicles a metre apart in a row."""
    base = load(find("hold"))
    names = [f"sat{k}" for k in range(count)]
    crew = msgspec.structs.replace(base, vehicles=dict.fromkeys(names, base.vehicles["sat1"]))
    vehicles = {name: still(1.0 * k**2, 0.0) for k, name in enumerate(names)}
    history = History(vehicles, np.zeros(0), {}, np.zeros((0, 3)))
    return {
        chart.key: [item for item in chart.items if isinstance(item, Line)]
        for chart in figures(crew, history)
    }


def test_pairs_of_a_few_and_the_nearest_of_many():
    few = flown(4)["separation"]
    assert [line.name for line in few][:2] == ["sat0, sat1", "sat0, sat2"]
    assert len(few) == 6
    many = flown(6)["separation"]
    assert [line.name for line in many] == [f"sat{k}" for k in range(6)]
    assert [float(line.y[0]) for line in many] == [1.0, 1.0, 3.0, 5.0, 7.0, 9.0]


def test_a_figure_of_nothing_is_left_out():
    drawn = flown(1)
    assert not {"separation", "tracking", "obstacles", "filter", "link", "loop"} & set(drawn)
    assert {"trajectory", "error", "speed", "tank"} <= set(drawn)


def test_contacts_are_marked():
    base = load(find("hold"))
    history = History({"sat1": still(1.0, 0.5)}, np.zeros(0), {}, np.zeros((0, 3)))
    touches = [Touch(4.0, "sat1", "left edge", 0.1), Touch(4.01, "sat1", "o1", 0.1)]
    drawn = {chart.key: chart for chart in figures(base, history, touches)}
    hits = [i for i in drawn["trajectory"].items if isinstance(i, Point) and i.shape == "hit"]
    assert [(one.x, one.y) for one in hits] == [(1.0, 0.5), (1.0, 0.5)]
    moments = [one for one in drawn["speed"].items if isinstance(one, Moment)]
    assert moments == [Moment(4.0, "sat1 hits left edge")]  # the other is too near to be told


def test_an_obstacle_that_moves_stays_inside_the_figure():
    base = load(find("xue2021_table_dynamic"))
    far = np.linspace(0.0, 1000.0, 101)
    vehicles = {
        n: msgspec.structs.replace(still(float(k), 0.0), t=far, at=far)
        for k, n in enumerate(base.vehicles)
    }
    history = History(vehicles, np.zeros(0), {}, np.zeros((0, 3)))
    trajectory = next(c for c in figures(base, history) if c.key == "trajectory")
    (way,) = [i for i in trajectory.items if isinstance(i, Line) and i.style == "way dashed"]
    assert np.abs(way.y).max() <= base.table.size[1] / 2
    edges = [i for i in trajectory.items if isinstance(i, Line) and i.style == "edge"]
    assert len(edges) == 2  # sat1-sat2 and sat2-sat3


def test_no_pressure_without_a_gauge():
    base = load(find("hold"))
    blind = msgspec.structs.replace(still(0.0, 0.0), tank=np.zeros(len(T)), supply=np.zeros(len(T)))
    history = History({"sat1": blind}, np.zeros(0), {}, np.zeros((0, 3)))
    assert not {"tank", "supply"} & {chart.key for chart in figures(base, history)}


def test_events_are_lines_on_every_figure_over_time_and_crosses_on_the_table():
    base = load(find("hold"))
    history = History({"sat1": still(1.0, 0.5)}, np.zeros(0), {}, np.zeros((0, 3)))
    told = [EventLine(2.0, ("sat1",), "WARN", "warn: link_late"),
            EventLine(6.0, ("sat1",), "CRITICAL", "fault: valve_leaks: jet 3 pushes")]  # fmt: skip
    drawn = figures(base, history, [], told)
    over_time = [chart for chart in drawn if chart.x_label == "time [s]"]
    assert len(over_time) >= 5
    for chart in over_time:
        moments = [one for one in chart.items if isinstance(one, Moment)]
        assert moments == [Moment(6.0, "sat1: valve leaks"), Moment(2.0, "", "mild")]
    points = [i for chart in drawn for i in chart.items if isinstance(i, Point)]
    (cross,) = [one for one in points if one.shape == "fault"]
    assert (cross.x, cross.y, cross.name) == (1.0, 0.5, "valve leaks, 6.0 s")


def test_a_small_motion_is_drawn_enlarged():
    base = load(find("hold"))

    def keys(far: float) -> list[str]:
        moved = still(0.0, 0.0)
        moved.pose[:, 0] = np.linspace(0.0, far, len(T))
        flight = History({"sat1": moved}, np.zeros(0), {}, np.zeros((0, 3)))
        return [chart.key for chart in figures(base, flight)]

    assert "near" in keys(0.1)
    assert "near" not in keys(3.0)


def test_each_phase_of_gao2022_has_its_table_and_its_curve():
    base = load(find("gao2022_table"))
    far = np.linspace(0.0, base.duration_s, 101)
    vehicles = {
        n: msgspec.structs.replace(still(float(k) - 2.0, 0.0), t=far, at=far)
        for k, n in enumerate(base.vehicles)
    }
    drawn = figures(base, History(vehicles, np.zeros(0), {}, np.zeros((0, 3))))
    phases = [chart for chart in drawn if chart.key.startswith("phase_")]
    assert [chart.title.split(": ")[1].split(",")[0] for chart in phases] == [
        "circle", "line", "double line", "ellipse", "circle",
    ]  # fmt: skip
    for chart, phase in zip(phases, base.controller.phases, strict=True):
        ways = [i for i in chart.items if isinstance(i, Line) and i.style == "way dashed"]
        assert len(ways) == (2 if phase.shape == "double_line" else 1)
        for way in ways:  # the curve is that of the law's error
            gaps = distance_to(phase.shape, np.column_stack((way.x, way.y)))
            assert gaps.max() < 1e-3


def test_the_times_from_pose_to_valve_are_a_histogram():
    base = load(find("hold"))
    wires = np.zeros((4, 5))
    wires[:, 4] = [0.001, 0.001, 0.004, np.nan]
    bench = msgspec.structs.replace(still(0.0, 0.0), wires=wires)
    drawn = figures(base, History({"sat1": bench}, np.zeros(0), {}, np.zeros((0, 3))))
    (chart,) = [one for one in drawn if one.key == "pose_to_valve"]
    boxes = [one for one in chart.items if isinstance(one, Box)]
    assert [round(box.y[1]) for box in boxes] == [67, 33]
    assert next(i.name for i in chart.items if isinstance(i, Moment)) == "median 1.00 ms"
