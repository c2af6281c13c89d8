"""A log as tables, as a bag, and what is said about it."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from testbed.core.codes import FaultReport, InhibitReason, Refusal
from testbed.core.types import (
    Health,
    Inputs,
    Outputs,
    PoseSample,
    Tick,
    ValveCommand,
    Vitals,
    Wrench,
)
from testbed.logs.export import WRITERS, ExportError, atomic_write, tables, to_bag
from testbed.logs.log_reader import LogError, LogReader, Row
from testbed.logs.recorder import Recorder
from testbed.logs.topics import survey
from testbed.logs.truth import Motion, Truth

STILL = Wrench(0.0, 0.0, 0.0)
FAULT = FaultReport("jet_3", "a jet is stuck", detector="jet_open", value=0.7)


def tick(k: int) -> Tick:
    """The k-th tick of a flight that waits, then flies, then has a fault."""
    health = Health(0.1 * k, 5e5, 2e7, 12.0 if k else 10.5)
    samples = tuple(PoseSample(0.1 * k, 0.01 * j, 2.0, 3.0) for j in range(k % 3))
    command = ValveCommand(k, 0.1 * k, 0.1 * k + 0.1, (k, 2 * k), (0, 0))
    return Tick(
        Inputs(0.1 * k, k > 2, samples, None, {}, health, vitals=Vitals(session_ok=k > 0)),
        Outputs(
            0.1 * k, None, None, Wrench(0.1 * k, 0.0, 0.0), STILL, command,
            None if k else Refusal(InhibitReason.NO_POSE_YET), FAULT if k == 9 else None,
        ),
    )  # fmt: skip


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    """A log of ten ticks."""
    path = tmp_path_factory.mktemp("log") / "log.mcap"
    with Recorder(path, epoch_ns=1_800_000_000 * 10**9) as recorder:
        for k in range(10):
            recorder.write("/sat1/tick", 0.1 * k, tick(k))
            recorder.write("/truth", 0.1 * k, Truth(0.1 * k, {"sat1": Motion(*[0.1 * k] * 6)}))
    return path


def test_columns_are_the_fields_by_their_paths(path):
    found = tables(LogReader(path))
    table = found["/sat1/tick"]
    assert table["inputs.t"].tolist() == [0.1 * k for k in range(10)]  # to the last bit
    assert table["outputs.commanded_wrench.fx"].tolist() == [0.1 * k for k in range(10)]
    assert table["pulses[1].on_us"].tolist() == [2 * k for k in range(10)]
    assert table["inputs.armed"].tolist() == [k > 2 for k in range(10)]
    assert table["inputs.health.battery"].tolist() == [10.5] + [12.0] * 9
    assert table["outputs.inhibit"].tolist() == [InhibitReason.NO_POSE_YET] + [0] * 9
    assert np.isnan(table["outputs.state.pose.x"]).all()
    np.testing.assert_array_equal(
        table["samples[1].x"], [0.01 if k % 3 == 2 else np.nan for k in range(10)]
    )
    assert "samples[2].x" not in table
    assert table["samples_valid"].tolist() == [k % 3 for k in range(10)]
    assert found["/truth"]["vehicles[0].twist.omega"].tolist() == [0.1 * k for k in range(10)]
    assert found["/sat1/event"]["text"].tolist() == [FAULT.words]
    assert found["/names"]["faults"].tolist()[-1] == "jet_3"


def column_of(kind, written, vehicle, name):
    """A column of a vehicle's ticks, from the files that an export wrote."""
    match kind:
        case "csv":
            with written[f"{vehicle}_tick"].open() as file:
                return [float(row[name]) for row in csv.DictReader(file)]
        case "npz":
            with np.load(written["log"]) as arrays:
                return arrays[f"{vehicle}/tick/{name}"]
        case "mat":
            from scipy.io import loadmat

            found = loadmat(written["log"], simplify_cells=True)[vehicle]["tick"]
            for part in name.replace("[0]", "_1").replace("[1]", "_2").split("."):
                found = found[part]
            return found
        case _:
            parquet = pytest.importorskip("pyarrow.parquet")
            return parquet.read_table(written[f"{vehicle}_tick"]).column(name).to_numpy()


KINDS = pytest.mark.parametrize("kind", ["csv", "mat", "npz", "parquet"])


@KINDS
def test_the_same_numbers_come_back(tmp_path, path, kind):
    if kind == "parquet":
        pytest.importorskip("pyarrow")
    found = tables(LogReader(path))
    written = {one.stem: one for one in WRITERS[kind](found, tmp_path)}
    for name in "outputs.commanded_wrench.fx", "pulses[1].on_us":
        got = column_of(kind, written, "sat1", name)
        np.testing.assert_array_equal(np.array(got, dtype=float), found["/sat1/tick"][name])
    with pytest.raises(FileExistsError):
        WRITERS[kind](found, tmp_path)


@KINDS
def test_elements_that_a_row_does_not_have_are_nan_in_every_format(tmp_path, kind):
    if kind == "parquet":
        pytest.importorskip("pyarrow")
    log = tmp_path / "log.mcap"
    with Recorder(log, epoch_ns=10**18) as recorder:
        for k in range(3):
            one = tick(k)
            pulses = ((), (5,), (5, 6))[k]
            command = ValveCommand(k, 0.1 * k, 0.1 * k + 0.1, pulses, (0,) * k)
            recorder.write(
                "/a/tick", 0.1 * k, replace(one, outputs=replace(one.outputs, command=command))
            )
    written = {one.stem: one for one in WRITERS[kind](tables(LogReader(log)), tmp_path)}
    wanted = {"pulses[0].on_us": [np.nan, 5, 5], "pulses[1].on_us": [np.nan, np.nan, 6]}
    for name, values in wanted.items():
        np.testing.assert_array_equal(column_of(kind, written, "a", name), values)


def test_a_bag_is_read_by_rosbags(tmp_path, path):
    pytest.importorskip("rosbags")
    from rosbags.highlevel import AnyReader

    bag = tmp_path / "bag"
    bag.mkdir()
    to_bag(LogReader(path), bag)
    with AnyReader([bag]) as reader:
        seen = [
            reader.deserialize(data, one.msgtype).outputs.commanded_wrench.fx
            for one, _, data in reader.messages(c for c in reader.connections if "tick" in c.topic)
        ]
        assert reader.start_time == 1_800_000_000 * 10**9
    assert seen == [0.1 * k for k in range(10)]


@pytest.mark.parametrize("damage", ["no end", "zeros", "no beginning"])
def test_a_bag_of_a_damaged_log_has_all_that_is_intact(tmp_path, damage):
    rosbags = pytest.importorskip("rosbags.highlevel")
    log, bag = tmp_path / "log.mcap", tmp_path / "bag"
    with Recorder(log, epoch_ns=1_800_000_000 * 10**9) as recorder:
        for k in range(200):
            recorder.write("/sat1/tick", 0.1 * k, tick(k % 9))
            recorder.mark(0.1 * k)  # a chunk
    data = log.read_bytes()
    half = len(data) // 2
    log.write_bytes({
        "no end": data[:half],
        "zeros": data[:half] + bytes(300) + data[half + 300 :],
        "no beginning": bytes(300) + data[300:],
    }[damage])  # fmt: skip
    bag.mkdir()
    wanted = [(row.topic, row.data) for row in LogReader(log).read()]
    to_bag(LogReader(log), bag)
    with rosbags.AnyReader([bag]) as reader:
        found = [(one.topic, bytes(data)) for one, _, data in reader.messages()]
        assert reader.message_count == len(wanted)
    assert 0.2 < sum(topic == "/sat1/tick" for topic, _ in wanted) / 200 < 1.0
    assert sorted(found) == sorted(wanted)


def test_a_bag_does_not_overwrite_a_log(tmp_path, path):
    (tmp_path / "log.mcap").write_bytes(b"the log of another run")
    with pytest.raises(FileExistsError):
        to_bag(LogReader(path), tmp_path)
    assert (tmp_path / "log.mcap").read_bytes() == b"the log of another run"
    assert [one.name for one in tmp_path.iterdir()] == ["log.mcap"]


def test_matlab_has_every_vehicle_under_a_name_that_it_takes(tmp_path, path):
    from scipy.io import loadmat

    found = tables(LogReader(path))
    columns = found.pop("/sat1/tick")
    more = {f"/{name}/tick": columns for name in ("sat-1", "_a", "1")}
    (mat,) = WRITERS["mat"]({**found, **more}, tmp_path)
    log = loadmat(mat, simplify_cells=True)
    for name in ("sat_1", "x_a", "x1"):
        got = log[name]["tick"]["outputs"]["commanded_wrench"]["fx"]
        np.testing.assert_array_equal(got, columns["outputs.commanded_wrench.fx"])
    clash = {"/sat-1/tick": columns, "/sat_1/tick": columns}
    with pytest.raises(ExportError, match="sat-1 and sat_1, which are both sat_1"):
        WRITERS["mat"](clash, tmp_path / "other")


def test_nothing_to_export(tmp_path):
    with Recorder(tmp_path / "log.mcap"):
        pass
    with pytest.raises(LogError, match="no messages"):
        tables(LogReader(tmp_path / "log.mcap"))


def test_rates_and_gaps():
    stamps = [0, 10, 20, 30, 80, 90, 100, 130]
    (topic,) = survey([Row("/a", s * 10**6, b"12345") for s in stamps], {"/a": "Truth"})
    assert (topic.kind, topic.messages, topic.gaps) == ("Truth", 8, 2)
    assert topic.rate_hz == pytest.approx(100.0)
    assert topic.longest_gap_s == pytest.approx(0.05)
    assert topic.megabytes == 40e-6


def test_one_message_has_no_rate():
    (topic,) = survey([Row("/a", 0, b"")], {"/a": "Truth"})
    assert (topic.rate_hz, topic.longest_gap_s, topic.gaps) == (None, None, 0)
    assert not math.isnan(topic.last_s)


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_nothing_is_written_when_one_file_is_there(tmp_path, path, kind):
    if kind == "parquet":
        pytest.importorskip("pyarrow")
    (tmp_path / f"truth.{kind}").write_text("older")
    with pytest.raises(FileExistsError):
        WRITERS[kind](tables(LogReader(path)), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [f"truth.{kind}"]


def test_half_a_file_is_none(tmp_path):
    def full() -> None:
        with atomic_write(tmp_path / "log.npz") as part:
            part.write_text("half")
            raise OSError("full")

    with pytest.raises(OSError, match="full"):
        full()
    assert list(tmp_path.iterdir()) == []
