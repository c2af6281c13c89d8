"""What the dashboard shows of a flight: the same while it is flown and when it is replayed."""

import ast
from collections import Counter
from collections.abc import Iterator
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

rr = pytest.importorskip("rerun", reason="the dashboard extra is not installed")
chunk = pytest.importorskip("rerun.chunk")
Image = pytest.importorskip("PIL.Image")

from testbed.config import load  # noqa: E402
from testbed.dashboard import feeder  # noqa: E402
from testbed.dashboard.banner import RED as ALARM  # noqa: E402
from testbed.dashboard.recording import write_recording  # noqa: E402
from testbed.dashboard.scene import Scene  # noqa: E402
from testbed.dashboard.static_scene import FAULTY, HUES  # noqa: E402
from testbed.logs.feed import LogFeed, News  # noqa: E402
from testbed.logs.history import gather  # noqa: E402
from testbed.logs.log_reader import LogReader  # noqa: E402
from testbed.logs.truth import Truth  # noqa: E402

NOT_VALUES = ("rerun.controls.RowId", "log_time", "log_tick", "t")


@pytest.fixture(scope="session")
def replayed(flown, tmp_path_factory) -> dict[str, Counter]:
    folder = tmp_path_factory.mktemp("replayed")
    return {name: rows(write_recording(run, folder / f"{name}.rrd")) for name, run in flown.items()}


class Drawn(NamedTuple):
    """One row of a recording."""

    entity: str
    t: int | None  # [ns]; None: always there
    values: tuple[tuple[str, str], ...]  # component and value, in Python's words

    def value(self, component: str) -> Any:
        """One component."""
        return ast.literal_eval(dict(self.values)[component])


def rows(path: Path) -> Counter[Drawn]:
    """All that a recording holds."""
    found: Counter[Drawn] = Counter()
    for one in chunk.RrdReader(str(path)).stream().to_chunks():
        entity, batch = str(one.entity_path), one.to_record_batch()
        if entity.startswith("/__"):
            continue
        names = [name for name in batch.schema.names if name not in NOT_VALUES]
        times = [None] * batch.num_rows
        if "t" in batch.schema.names:
            times = batch.column("t").cast("int64").to_pylist()
        columns = [batch.column(name).to_pylist() for name in names]
        for t, *values in zip(times, *columns, strict=True):
            known = [(n, repr(v)) for n, v in zip(names, values, strict=True) if v is not None]
            found[Drawn(entity, t, tuple(sorted(known)))] += 1
    return found


class Growing:
    """A feed from a log of which there is more at every look, a piece of any size."""

    def __init__(self, log: Path, copy: Path, pieces: int) -> None:
        self._data, self._copy, self._pieces, self._look = log.read_bytes(), copy, pieces, 0
        copy.write_bytes(self._data[:8])
        self._feed = LogFeed(LogReader(copy))

    @property
    def ended(self) -> bool:
        self._look += 1
        share = (self._look / self._pieces) ** 1.7
        self._copy.write_bytes(self._data[: max(8, round(len(self._data) * min(share, 1.0)))])
        return self._feed.ended

    def news(self) -> Iterator[News]:
        return self._feed.news()


def followed(run: Path, tmp_path: Path, pieces: int, batch: int) -> Counter:
    """What the process that tells a viewer draws while the flight goes on."""
    recording = rr.RecordingStream("test", recording_id="test")
    recording.set_sinks(rr.FileSink(tmp_path / "live.rrd"))
    feed = Growing(run / "log.mcap", tmp_path / "log.mcap", pieces)
    feeder.follow(feed, Scene(load(run / "config.toml"), recording), recording, batch)
    recording.disconnect()
    return rows(tmp_path / "live.rrd")


@pytest.mark.parametrize("run", ["moving", "stuck"])
@pytest.mark.parametrize(("pieces", "batch"), [(9, 5000), (3, 17)])
def test_live_and_replayed_are_the_same(flown, replayed, tmp_path, monkeypatch, run, pieces, batch):
    monkeypatch.setattr(feeder, "PERIOD_S", 0.0)
    live = followed(flown[run], tmp_path, pieces, batch)
    assert sum(live.values()) > 1000
    assert live == replayed[run]


@pytest.mark.parametrize("run", ["moving", "stuck"])
def test_what_is_shown_at_a_time_needs_no_later_row(flown, replayed, tmp_path, run):
    scenario, until = load(flown[run] / "config.toml"), 2.5
    recording = rr.RecordingStream("test", recording_id="test")
    recording.set_sinks(rr.FileSink(tmp_path / "cut.rrd"))
    news = list(LogFeed(LogReader(flown[run] / "log.mcap")).news())
    end = next(k for k, one in enumerate(news)
               if isinstance(one.message, Truth) and one.message.t > until - 1e-6)  # fmt: skip
    Scene(scenario, recording).draw(news[: end + 1])
    recording.disconnect()

    def early(found: Counter[Drawn]) -> Counter[Drawn]:  # a plan's pulses have times to come
        return Counter({
            row: n for row, n in found.items()
            if not row.entity.startswith("/valve/") and (row.t is None or row.t < 1e9 * until)
        })  # fmt: skip

    assert early(rows(tmp_path / "cut.rrd")) == early(replayed[run])


def drawn(found: Counter[Drawn], entity: str) -> dict[int, Drawn]:
    """What is drawn of one entity, by time [ns]."""
    own = [row for row in found if row.entity == entity and row.t is not None]
    return {row.t: row for row in sorted(own, key=lambda row: row.t)}


@pytest.mark.parametrize(
    ("run", "entity", "every"),
    [
        ("moving", "/world/obstacle/o1", 0.1),
        ("moving", "/world/link", 0.1),
        ("moving", "/world/stop/sat1", 0.1),
        ("moving", "/plot/error/sat1", 0.1),
        ("stuck", "/world/reference/sat1", 0.1),
        ("stuck", "/world/trail/sat1", 0.5),
    ],
)
def test_how_often_it_is_drawn(replayed, run, entity, every):
    at = [1e-9 * t for t in drawn(replayed[run], entity)]
    assert max(b - a for a, b in pairwise(at)) < every + 0.01


def test_an_obstacle_is_where_it_is_at_that_time(replayed):
    row = drawn(replayed["moving"], "/world/obstacle/o1")[5_000_000_000]
    ((x, y, _),) = row.value("Transform3D:translation")
    assert (x, y) == (pytest.approx(1.25), pytest.approx(-2.4 + 5.0 * 0.063))


def packed(r: int, g: int, b: int) -> int:
    """As rerun keeps a colour."""
    return r << 24 | g << 16 | b << 8 | 255


def test_a_vehicle_with_a_fault_is_red_with_a_cross(replayed):
    found = replayed["stuck"]
    for name, wanted in (("sat1", [HUES[0]]), ("sat2", [HUES[1]]), ("sat3", [HUES[2], FAULTY])):
        bodies = drawn(found, f"/world/vehicle/{name}/body")
        colours = [row.value("Mesh3D:albedo_factor")[0] for row in bodies.values()]
        assert colours == [packed(*one) for one in wanted]
        crosses = drawn(found, f"/world/vehicle/{name}/cross")
        assert [len(row.value("LineStrips3D:strips")) for row in crosses.values()] == [
            2 for _ in wanted[1:]
        ]
    (at,) = crosses
    assert 2.0e9 < at < 4.0e9
    names = {t: row.value("Points3D:labels")[0] for t, row in
             drawn(found, "/world/name/sat3").items()}  # fmt: skip
    assert {t: words for t, words in names.items() if words != "sat3"} == {
        t: "sat3 FAULT" for t in names if t >= at
    }


def test_the_headline_of_a_fault_is_red(replayed):
    *_, last = drawn(replayed["stuck"], "/banner").values()
    image = Image.open(BytesIO(bytes(last.value("EncodedImage:blob")[0])))
    assert image.getpixel((4, 4)) == ALARM
    assert ALARM not in [colour for row in drawn(replayed["moving"], "/banner").values()
                         for _, colour in Image.open(BytesIO(bytes(
                             row.value("EncodedImage:blob")[0]))).getcolors()]  # fmt: skip


def test_a_fault_is_a_critical_event_and_the_culprit_comes_first(replayed):
    said = [
        (
            row.t,
            row.value("TextLog:level")[0],
            row.value("TextLog:text")[0].lstrip().split("   ", 1)[1],
        )
        for row in replayed["stuck"]
        if row.entity == "/event" and row.t > 5e8
    ]
    (fault,) = [one for one in said if "fault: " in one[2]]
    assert fault[1:] == ("CRITICAL", fault[2])
    assert fault[2].startswith("sat3   fault: valve_stuck_open")
    assert fault[0] == min(t for t, _, _ in said)
    (follow,) = [one for one in said if "others" in one[2]]
    assert follow[1:] == ("ERROR", "sat1, sat2   stopping with the others")
    assert [one[2] for one in said if one[1] == "CRITICAL"].count("FAULT: sat3") == 1


def test_a_dot_per_pulse_in_the_row_of_its_jet(flown, replayed):
    vehicle = gather(LogReader(flown["stuck"] / "log.mcap")).vehicles["sat3"]
    for jet in (1, 4):
        opened = vehicle.t[vehicle.on[:, jet - 1] > 0.0]
        dots = drawn(replayed["stuck"], f"/plot/valve/sat3_{jet}")
        assert [1e-9 * t for t in dots] == pytest.approx(opened.tolist(), abs=1e-6)
        assert {row.value("Scalars:scalars")[0] for row in dots.values()} == {30.0 + jet}


def test_limits_are_those_of_the_fault_table(flown, replayed):
    rows_of_table = load(flown["stuck"] / "config.toml").faults
    for name in ("pose_stale", "pose_lost"):
        limit = rows_of_table[name]
        line = drawn(replayed["stuck"], f"/plot/pose_age/limit_{name}")
        (value,) = {row.value("Scalars:scalars")[0] for row in line.values()}
        assert value == pytest.approx(1e3 * limit.above)


def test_the_legend_has_each_vehicles_colour_and_covers_no_plot(replayed):
    (row,) = [row for row in replayed["stuck"] if row.entity == "/legend"]
    (blob,) = row.value("EncodedImage:blob")
    found = np.asarray(Image.open(BytesIO(bytes(blob))).convert("RGB")).reshape(-1, 3).tolist()
    for colour in HUES[:3]:
        assert found.count(list(colour)) > 100
