"""A log as tables, and what is said about it."""

import csv
import json
import math

import numpy as np
import pytest

from testbed.ops.export import WRITERS, tables
from testbed.ops.logbook import LogError, Row
from testbed.ops.topics import survey


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
