"""Tables at 80 and 140 columns, and without a terminal: nothing is cut."""

import re
from pathlib import Path

import pytest
from msgspec.structs import replace
from rich.console import Console
from rich.table import Table as Grid

from testbed.cli import (
    benchmark,
    campaign,
    compare,
    drill,
    inspection,
    log,
    poses,
    result,
    screen,
    tune,
)
from testbed.cli.result import print_result
from testbed.config import load
from testbed.config.shipped import SHIPPED
from testbed.report.page import read_metrics

TABLES = (benchmark, campaign, compare, drill, log, inspection, result, tune)


@pytest.fixture
def flown(testbed, here):
    testbed("run", "hold", "duration_s=1", "--out", "flown")
    return here / "flown"


def widest(text: str) -> int:
    return max(map(len, text.splitlines()))


@pytest.mark.parametrize("columns", ["80", "140", ""])
def test_the_tables_of_a_run_are_whole(testbed, flown, monkeypatch, columns):
    monkeypatch.delenv("COLUMNS", raising=False)
    if columns:
        monkeypatch.setenv("COLUMNS", columns)
    metrics = read_metrics(flown)
    for words in (["log", "flown"], ["list"], ["compare", "flown", "flown"], ["check", "hold"]):
        text = testbed(*words).stdout
        assert "…" not in text, words
        if columns and words[0] != "check":  # sentences are left to the terminal
            assert widest(text) <= int(columns), words
    text = testbed("log", "flown").stdout
    for topic in ("/sat1/tick", "/supervisor", "/truth"):
        row = re.search(rf"^ *{topic} .*$", text, re.MULTILINE)
        assert row, topic
    if not columns or columns == "140":  # one row a topic
        assert re.search(r"/sat1/tick +\S*Tick +\d+ +\d+\.\d +\d+\.\d +\d+ +\S+ +\d+\.\d\d", text)
    assert metrics.vehicles.keys() == {"sat1"}


@pytest.mark.parametrize("count", [1, 5, 9])
def test_many_vehicles_fold_into_parts(flown, capsys, monkeypatch, count):
    monkeypatch.setenv("COLUMNS", "80")
    metrics, scenario = read_metrics(flown), load(SHIPPED / "experiments" / "hold.toml")
    names = [f"chaser_{k}" for k in range(1, count + 1)]
    many = replace(metrics, vehicles=dict.fromkeys(names, metrics.vehicles["sat1"]), after=None)
    fleet = replace(scenario, vehicles=dict.fromkeys(names, scenario.vehicles["sat1"]))
    print_result(many, fleet, flown)
    text = capsys.readouterr().out
    table = text.partition("contacts:")[0]
    assert widest(table) <= 80
    assert "…" not in table
    for name in names:
        assert re.search(rf"\b{name}\b", table)
    impulse = f"{metrics.vehicles['sat1'].impulse_ns:.1f}"
    rows = [line for line in table.splitlines() if "impulse [N s]" in line]
    assert sum(row.split("]")[1].count(impulse) for row in rows) == count
    headings = [line for line in table.splitlines() if "limit" in line]
    assert len(headings) == len(rows)  # the limits stand beside each part's vehicles
    assert all("chaser_" in line for line in headings)


def test_text_folds_and_numbers_do_not(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")
    grid = Grid(box=None, padding=(0, 1))
    grid.add_column("name")
    for heading in ("one", "two"):
        grid.add_column(heading, justify="right")
    grid.add_row("a" * 90, "1234567890123456", "6543210987654321")
    screen.show(Console(highlight=False), grid)
    text = capsys.readouterr().out
    assert text.count("a") == 2 * (90 + len("a"))  # in both parts, with the heading
    assert "1234567890123456" in text
    assert "6543210987654321" in text
    assert widest(text) <= 60


def test_a_sentence_folds_between_words_below_its_beginning(capsys):
    path, words = "/a/path/that/is/wider/than/the/terminal/config.toml", "takes 1500 jet periods "
    screen.print_text(
        Console(force_terminal=True, color_system=None, width=40), f"  {path} {3 * words}"
    )
    first, *rest = capsys.readouterr().out.splitlines()
    assert first == f"  {path}"
    assert [line.strip() for line in rest] == ["takes 1500 jet periods takes 1500",
                                               "jet periods takes 1500 jet periods"]  # fmt: skip
    assert all(line.startswith("    ") and len(line) <= 40 for line in rest)
    screen.print_text(Console(), f"  {path} {3 * words}")  # of a file or a pipe
    assert len(capsys.readouterr().out.splitlines()) == 1


def test_each_verb_prints_its_table_in_this_way():
    for module in TABLES:
        assert module.show is screen.show
    folder = Path(screen.__file__).parent
    direct = [path.name for path in folder.glob("*.py") if "out.print(grid" in path.read_text()]
    assert direct == ["screen.py"]
    assert poses.Room  # its table is live, and folds itself


@pytest.mark.parametrize("columns", ["0", "wide", "-5"])
def test_a_width_that_is_none_is_unknown(start, columns):
    for words, said in ((["check", "hold"], "ok: "), (["check", "holdd"], "error: holdd")):
        process = start(*words, COLUMNS=columns)
        assert said in "".join(process.communicate())
