"""What is in the journal survives a kill, and nothing is in it twice."""

import msgspec
import pytest

from testbed.campaign.journal import Head, Journal, JournalError
from testbed.campaign.row import FlownRun

HEAD = Head("campaign", "code")
RUNS = [FlownRun(k, "passed", columns={"gas_g": 0.1 * k}) for k in range(5)]


@pytest.fixture
def path(tmp_path):
    return tmp_path / "journal.jsonl"


def write(path, runs, head=HEAD):
    with Journal(path, head, FlownRun) as journal:
        for run in runs:
            journal.append(run)


def read(path, head=HEAD):
    with Journal(path, head, FlownRun) as journal:
        return journal.found


def test_what_was_appended_is_found(path):
    write(path, RUNS[:2])
    write(path, RUNS[2:])
    assert read(path) == RUNS


def test_cut_anywhere_it_has_every_whole_line_and_goes_on(path):
    write(path, RUNS)
    data = path.read_bytes()
    ends = [i + 1 for i, byte in enumerate(data) if byte == ord("\n")]
    for length in range(len(data)):
        path.write_bytes(data[:length])
        whole = max(0, sum(end <= length for end in ends) - 1)
        assert read(path) == RUNS[:whole]
        write(path, RUNS[whole:])
        assert path.read_bytes() == data


def test_damage_in_the_middle_is_not_passed_over(path):
    write(path, RUNS)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(JournalError, match=r"line \d is damaged"):
        read(path)


def test_without_the_damaged_line_its_run_is_the_only_one_that_is_missing(path):
    write(path, RUNS)
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*lines[:3], b"hello\n", *lines[4:]]))
    with pytest.raises(JournalError, match="delete the line to fly its run again"):
        read(path)
    path.write_bytes(b"".join(lines[:3] + lines[4:]))
    assert read(path) == RUNS[:2] + RUNS[3:]
    path.write_bytes(b"hello\n" + b"".join(lines[1:]))
    with pytest.raises(JournalError) as refused:
        read(path)
    assert refused.value.where == f"{path}: line 1 is damaged"
    assert (refused.value.found, refused.value.hint) == ("'hello'", "start anew (--out)")


@pytest.mark.parametrize(
    ("head", "words"),
    [
        (msgspec.structs.replace(HEAD, campaign="x"), "campaign or experiment has changed"),
        (msgspec.structs.replace(HEAD, code="x"), "code of laws, flight or twin has changed"),
        (msgspec.structs.replace(HEAD, version=2), "another version"),
    ],
)
def test_runs_of_two_campaigns_are_not_mixed(path, head, words):
    write(path, RUNS)
    with pytest.raises(JournalError, match=words):
        read(path, head)
    assert read(path) == RUNS


def test_one_writes_at_a_time(path):
    with (
        Journal(path, HEAD, FlownRun),
        pytest.raises(JournalError, match="another process"),
        Journal(path, HEAD, FlownRun),
    ):
        pass
    assert read(path) == []


def test_a_full_disk_is_said_and_leaves_whole_lines(path, monkeypatch):
    import os

    from testbed.campaign import journal as module

    write(path, RUNS[:1])
    whole = os.write
    with Journal(path, HEAD, FlownRun) as journal:
        monkeypatch.setattr(module.os, "write", lambda file, data: whole(file, data[:9]))
        with pytest.raises(JournalError, match="No space left"):
            journal.append(RUNS[1])
        monkeypatch.undo()
        journal.append(RUNS[2])
    assert read(path) == [RUNS[0], RUNS[2]]
