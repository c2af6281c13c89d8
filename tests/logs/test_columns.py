"""Columns of a log: all rows of a topic, whatever their capacities, as the log defines them."""

import subprocess
import sys

import numpy as np
import pytest
from msgspec.structs import replace

from testbed.core.records.definition import DTYPES, MESSAGES
from testbed.core.records.ros import schema_text
from testbed.core.types import (
    Health,
    HostInputs,
    HostOutputs,
    HostTick,
    Inputs,
    Outputs,
    PoseSample,
    Tick,
    ValveCommand,
    Wrench,
)
from testbed.logs.columns import Columns, shape_of
from testbed.logs.frames import Mark, Messages, One, Topic
from testbed.logs.history import gather
from testbed.logs.log_reader import LogError, LogReader
from testbed.logs.mcap_writer import Disk, write_log
from testbed.logs.recorder import Recorder, RecorderError
from testbed.logs.row_reader import RowReader
from testbed.logs.tick_row import RowWriter

STILL = Wrench(0.0, 0.0, 0.0)


def tick(k: int, samples: int) -> Tick:
    poses = tuple(PoseSample(0.1 * k, 1.0 * j, 0.0, 0.0) for j in range(samples))
    command = ValveCommand(k, 0.0, 0.1, (k,) * 8, (0,) * 8)
    return Tick(
        Inputs(0.1 * k, True, poses, None, {}, Health(0.0, 5e5, 2e7)),
        Outputs(0.1 * k, None, None, STILL, STILL, command),
    )


def test_a_burst_of_poses_loses_none(tmp_path):
    """The capacity grows; rows before and after it stand in one array."""
    counts = [0, 3, 3, 50, 2, 3]
    with Recorder(tmp_path / "log.mcap") as recorder:
        for k, number in enumerate(counts):
            recorder.write("/sat1/tick", 0.1 * k, tick(k, number))
    rows = Columns(LogReader(tmp_path / "log.mcap")).rows["/sat1/tick"]
    assert rows["samples_valid"].tolist() == counts
    assert set(rows["samples_length"].tolist()) == {50}
    for row, number in zip(rows, counts, strict=True):
        assert row["samples"]["x"][:number].tolist() == [float(j) for j in range(number)]
        assert not row["samples"]["x"][number:].any()
    assert rows["pulses"]["on_us"][:, 7].tolist() == list(range(6))
    history = gather(LogReader(tmp_path / "log.mcap")).vehicles["sat1"]
    np.testing.assert_array_equal(history.t, [0.1 * k for k in range(6)])
    np.testing.assert_array_equal(history.on[:, 3], 1e-6 * np.arange(6))


def test_a_number_that_fits_no_row_is_an_error_of_the_recorder(tmp_path):
    wrong = replace(tick(1, 0), outputs=replace(tick(1, 0).outputs, t=10**400))

    def write() -> None:
        with Recorder(tmp_path / "log.mcap") as recorder:
            recorder.write("/sat1/tick", 0.1, wrong)

    with pytest.raises(RecorderError, match="a message of /sat1/tick at"):
        write()


def test_a_long_fault_table_is_no_error():
    """The record has a bit for each of the first rows; a fault is an event as well."""
    faults = tuple(f"row {k}" for k in range(70))
    one = tick(1, 0)
    wrong = replace(one, outputs=replace(one.outputs, faults=faults))
    writer, reader = RowWriter(), RowReader()
    for made in writer.rows("/sat1/tick", 0.1, wrong):
        reader.learn(made.topic, made.kind, made.data)
    assert reader.tick("/sat1/tick", made.data).outputs.faults == faults[:64]


def test_a_log_of_another_version_has_columns(tmp_path, monkeypatch):
    text = schema_text("HostTick").replace("float64 pose_age", "float64 age_of_pose")
    writer, message = RowWriter(), HostTick(HostInputs(0.5, None, {}), HostOutputs(0.5, None))
    row = writer.rows("/sat1/host", 0.5, message)[-1].data
    monkeypatch.setattr("testbed.logs.mcap_writer.schema_text", lambda kind: text)
    frames = [Topic("/sat1/host", "HostTick"), Messages([One(0, 5 * 10**8, row)]), Mark()]
    write_log(tmp_path / "log.mcap", iter(frames), Disk(lambda: 10**12, 0, 0), str)
    rows = Columns(LogReader(tmp_path / "log.mcap")).rows["/sat1/host"]
    assert rows["inputs"]["t"].tolist() == [0.5]
    assert "age_of_pose" in rows["inputs"]["own"].dtype.names
    with pytest.raises(LogError, match="another version"):
        gather(LogReader(tmp_path / "log.mcap"))


@pytest.mark.parametrize("name", sorted(set(MESSAGES) & set(DTYPES)))
def test_the_schema_in_a_log_gives_the_same_columns(name):
    ours = shape_of(name, "")
    theirs = shape_of(name, schema_text(name) + "\n")  # not the same text: it is read
    lengths = {one.name: 2 for one in MESSAGES[name].sequences}
    assert theirs.layout(lengths).dtype() == ours.layout(lengths).dtype()


def test_bytes_that_are_no_rows_are_an_error(tmp_path):
    for data in (b"", b"{}", b"\0\1\0\0" + bytes(100)):
        path = tmp_path / f"{len(data)}.mcap"
        frames = [Topic("/sat1/host", "HostTick"), Messages([One(0, 0, data)]), Mark()]
        write_log(path, iter(frames), Disk(lambda: 10**12, 0, 0), str)
        with pytest.raises(LogError, match="/sat1/host"):
            Columns(LogReader(path))


def test_the_writers_process_starts_without_the_compiler():
    """A flight waits for it; numba and what needs it take a third of a second to import."""
    look = "import sys, testbed.logs.mcap_writer as _; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", look], check=False).returncode == 0
