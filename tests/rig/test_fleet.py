"""Flights on the twin, many ticks in one call, equal those that are flown tick by tick."""

import numpy as np
import pytest

from testbed.config import find, load
from testbed.logs.log_reader import LogReader
from testbed.logs.recorder import CAREFUL_SPAN_NS, FAST_SPAN_NS, SPAN_NS, Recorder
from testbed.metrics.run_metrics import ReferenceLog
from testbed.rig.fleet.fleet import MOST_TICKS
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin
from testbed.run.fly import FlightLog, FlightScreen, names_of

INTO_A_POST = [
    "flight.barrier.on=false", "obstacles.post={position=[0.0,0.0],radius=0.3,solid=0.25}",
    "vehicles.sat1.start=[-0.8,0.0,0.0]", "vehicles.sat1.goal=[0.8,0.0,0.0]",
]  # fmt: skip
FLIGHTS = {
    "three vehicles": ("zhang2023_table", []),
    "another camera and period": (
        "zhang2023_table", ["table.mocap.rate_hz=240", "flight.jet_period_s=0.05", "seed=5"]
    ),
    "messages lost and late": (
        "zhang2023_table",
        ["table.link.loss=0.3", "table.link.delay_s=0.05", "table.link.jitter_s=0.2", "seed=3"],
    ),
    "poses lost": (
        "zhang2023_table", ["table.mocap.dropout_rate=0.5", "table.mocap.dropout_s=0.1"]
    ),
    "a law without memory": ("hold", ["vehicles.sat1.goal=[0.5,0.4,1.0]"]),
    "the filter changes the force": (
        "hold",
        ["obstacles.post={position=[0.0,0.0],radius=0.3}", "vehicles.sat1.start=[-0.8,0.02,0.0]",
         "vehicles.sat1.goal=[0.8,0.0,0.0]"],
    ),
    "a collision": ("hold", INTO_A_POST),
}  # fmt: skip


class Rows(NullObserver):
    """Keeps all ticks, in order."""

    def __init__(self):
        self.kept, self.spans = [], []

    def vehicle(self, name, tick):
        self.kept.append((name, tick.inputs, tick.outputs, tick.fault, tick.shut))

    def host(self, name, tick):
        self.kept.append((name, tick.inputs, tick.outputs, tick.own_t))

    def done(self, t):
        self.kept.append(t)

    def ticks(self, span):
        self.spans.append(len(span.times))
        span.show(self)


class TickByTick(Rows):
    """The same for a flight that is flown tick by tick."""

    ticks = None


def flown(experiment, observer, stopped=lambda: 0):
    rig = make_twin(experiment)
    ending = rig.fly(observer, stopped)
    rest = rig.come_to_rest(ending, NullObserver(), stopped)
    names = list(experiment.vehicles)
    spent = [rig.spent(name) for name in names], [rig.jets(name) for name in names]
    track = rig.track()
    return ending, rest, spent, rig.touches, track.t.tobytes(), track.states.tobytes()


@pytest.mark.parametrize("name", FLIGHTS)
def test_many_ticks_in_one_call_change_no_bit(name):
    shipped, overrides = FLIGHTS[name]
    experiment = load(find(shipped), ["duration_s=12", *overrides])
    together, apart = Rows(), TickByTick()
    assert flown(experiment, together) == flown(experiment, apart)
    assert repr(together.kept) == repr(apart.kept)
    assert max(together.spans) > 1
    assert sum(together.spans) > 0.3 * len([one for one in apart.kept if isinstance(one, float)])


def test_what_the_cases_are_for_happens():
    def kept(name):
        shipped, overrides = FLIGHTS[name]
        rows = Rows()
        found = flown(load(find(shipped), ["duration_s=12", *overrides]), rows)
        return rows.kept, found

    rows, _ = kept("the filter changes the force")
    filtered = [one for one in rows if isinstance(one, tuple) and one[2].filtered is not None]
    assert len(filtered) > 3
    _, (ending, *_, touches, _, _) = kept("a collision")
    assert ending.fault is not None
    assert touches


def test_a_stop_is_heard_between_two_calls_and_loses_no_tick():
    asked = []

    def stopped():
        asked.append(1)
        return int(len(asked) > 5)

    rows = Rows()
    experiment = load(find("zhang2023_table"))
    ending, *_ = flown(experiment, rows, stopped)
    times = [one for one in rows.kept if isinstance(one, float)]
    assert ending.fault is None
    assert 0.0 < ending.t <= 5 * 0.1 * MOST_TICKS < experiment.duration_s
    assert times == [k * 0.1 for k in range(len(times))]
    assert ending.t == len(times) * 0.1


def test_a_valve_that_is_stuck_is_not_overlooked():
    experiment = load(find("hold"), ["duration_s=6", "vehicles.sat1.goal=[0.5,0.4,1.0]"])
    rows, rig = Rows(), make_twin(experiment)
    for jet in range(8):
        rig.twin.plant.stick(0, jet, False, 0.0, 100.0)
    rig.fly(rows)
    assert rows.spans == []
    assert not np.any(rig.twin.plant.impulse)


def test_spans_are_cut_without_losing_notes():
    experiment = load(find("hold"), ["duration_s=12", *FLIGHTS["the filter changes the force"][1]])
    whole, cut = Rows(), Rows()

    def show_cut(span):
        for begin in range(0, len(span.times), 7):
            span.part(begin, min(begin + 7, len(span.times))).show(cut)

    make_twin(experiment).fly(whole)
    cut.ticks = show_cut
    make_twin(experiment).fly(cut)
    assert repr(cut.kept) == repr(whole.kept)


@pytest.mark.parametrize("span_ns", [SPAN_NS, CAREFUL_SPAN_NS, FAST_SPAN_NS])
def test_the_log_is_that_of_a_flight_tick_by_tick(tmp_path, span_ns):
    experiment = load(find("zhang2023_table"), ["duration_s=40"])

    class Slowly(FlightLog):
        ticks = None

    logs = []
    for kind in (FlightLog, Slowly):
        rig, path = make_twin(experiment), tmp_path / f"{kind.__name__}.mcap"
        aims = {name: ReferenceLog() for name in experiment.vehicles}
        with Recorder(path, names=names_of(experiment), span_ns=span_ns) as recorder:
            rig.fly(kind(rig, aims, recorder, FlightScreen()))
        reference = [aim.aim().pose.tobytes() for aim in aims.values()]
        logs.append((path.read_bytes(), reference))
    assert logs[0] == logs[1]
    assert len(list(LogReader(path).read())) > 7 * 400
