"""A log as tables, and what is said about it."""

import csv
import json
import math

import msgspec
import numpy as np
import pytest

from testbed.core.types import Health, Inputs, Outputs, Tick, ValveCommand, Vitals, Wrench
from testbed.logs.export import WRITERS, atomic_write, tables
from testbed.logs.log_reader import LogError, Row
from testbed.logs.topics import survey


def rows() -> list[Row]:
    found = []
    for k in range(10):
        state = None if k == 0 else {"x": 0.1 * k, "near": "nan" if k == 1 else 2.0}
        message = {
            "t": 0.1 * k, "state": state, "on_us": [k, 2 * k], "seq": k, "armed": k > 2,
            "why": None if k else "no pose yet", "samples": [[0.1, 2.0]] * (k % 3),
        }  # fmt: skip
        found.append(Row("/sat1/tick", k * 10**8, json.dumps(message).encode()))
    return found


def test_columns():
    table = tables(rows())["/sat1/tick"]
    assert list(table) == [
        "t", "on_us[0]", "on_us[1]", "seq", "armed", "why", "samples", "state.x", "state.near",
    ]  # fmt: skip
    assert table["t"].tolist() == [k * 10**8 * 1e-9 for k in range(10)]
    assert table["on_us[1]"].dtype == np.int64
    assert table["armed"].dtype == bool
    assert table["why"].tolist() == ["no pose yet"] + [""] * 9
    assert np.isnan(table["state.x"][0])
    assert table["state.x"][3] == 0.1 * 3  # to the last bit
    assert np.isnan(table["state.near"][:2]).all()
    assert json.loads(table["samples"][2]) == [[0.1, 2.0]] * 2


@pytest.mark.parametrize("kind", ["csv", "npz", "parquet"])
def test_the_same_numbers_come_back(tmp_path, kind):
    if kind == "parquet":
        pytest.importorskip("pyarrow")
    found = tables(rows())
    (path,) = WRITERS[kind](found, tmp_path)
    wanted = found["/sat1/tick"]["state.x"]
    match kind:
        case "csv":
            with path.open() as file:
                got = [float(row["state.x"]) for row in csv.DictReader(file)]
        case "npz":
            with np.load(path) as arrays:
                got = arrays["sat1/tick/state.x"]
        case _:
            from pyarrow import parquet

            got = parquet.read_table(path).column("state.x").to_pylist()
    np.testing.assert_array_equal(np.array(got, dtype=float), wanted)
    with pytest.raises(FileExistsError):
        WRITERS[kind](found, tmp_path)


def test_nothing_to_export():
    with pytest.raises(LogError, match="no messages"):
        tables([])


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


def test_what_the_log_leaves_out_is_in_the_table():
    health = Health(0.0, 5e5, 2e7)
    low = msgspec.structs.replace(health, battery=10.5)
    at = ValveCommand(0, 0.0, 0.1, (0,) * 8, (0,) * 8)
    still = Wrench(0.0, 0.0, 0.0)
    bad = Vitals(session_ok=False, late_s=1.0)
    ticks = [
        Tick(Inputs(0.1 * k, True, (), None, {}, said, vitals=vitals),
             Outputs(0.1 * k, None, None, still, still, at))
        for k, (said, vitals) in enumerate([(health, Vitals()), (low, bad)])
    ]  # fmt: skip
    log = [Row("/sat1/tick", k * 10**8, msgspec.json.encode(t)) for k, t in enumerate(ticks)]
    assert b"session_ok" not in log[0].data  # as it has its default
    table = tables(log, {"/sat1/tick": "Tick"})["/sat1/tick"]
    assert table["inputs.health.battery"].tolist() == [12.0, 10.5]
    assert table["inputs.vitals.session_ok"].tolist() == [True, False]
    assert table["inputs.vitals.session_ok"].dtype == bool
    assert table["inputs.vitals.late_s"].tolist() == [0.0, 1.0]
    assert table["outputs.response"].tolist() == [0, 0]


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_nothing_is_written_when_one_file_is_there(tmp_path, kind):
    if kind == "parquet":
        pytest.importorskip("pyarrow")
    two = [*rows(), Row("/truth", 0, b'{"t": 0.0}')]
    (tmp_path / f"truth.{kind}").write_text("older")
    with pytest.raises(FileExistsError):
        WRITERS[kind](tables(two), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [f"truth.{kind}"]


def test_half_a_file_is_none(tmp_path):
    def full() -> None:
        with atomic_write(tmp_path / "log.npz") as part:
            part.write_text("half")
            raise OSError("full")

    with pytest.raises(OSError, match="full"):
        full()
    assert list(tmp_path.iterdir()) == []
