"""How far a campaign is, where there is no terminal, and where there are no workers."""

import re
from threading import Event

import pytest
from rich.console import Console

from testbed.campaign.row import FlownRun
from testbed.cli import progress
from testbed.cli.progress import Bar


@pytest.fixture
def heard(monkeypatch):
    """Lines that were said, and when the first one was."""
    lines, said = [], Event()

    def hear(line, **_):
        lines.append(line)
        said.set()

    monkeypatch.setattr(progress.errors, "print", hear)
    return lines, said


def test_a_line_says_how_far_it_is_how_fast_and_how_long_still(monkeypatch):
    monkeypatch.setattr(progress.time, "monotonic", lambda: 100.0)
    with Bar("margins") as bar:
        assert bar.line(50.0, no_workers=False) == "getting ready (compiles on the first run)"
        bar.begun(1000, [FlownRun(0, "passed"), FlownRun(1, "failed")])
        bar.flying(lambda: 2)
        assert bar.line(100.0, no_workers=False) == "margins 2 of 1000 runs, flying"
        for k in range(2, 23):
            bar.flown(FlownRun(k, "passed"))
        assert bar.line(110.0, no_workers=False) == (  # 20 more than the first in 10 s
            "margins 23 of 1000 runs, passed 95.7 %, 2 per second, 0:08:08 left"
        )


def test_the_bar_tells_the_time_gone_from_the_time_left():
    console = Console(width=80)
    with Bar("margins") as bar, console.capture() as shown:
        bar.begun(120, [FlownRun(k, "passed") for k in range(30)])
        console.print(bar._progress.get_renderable())
    assert re.search(r"30/120 +25% after 0:00:0\d left -:--:--", shown.get())


def test_it_is_said_by_itself_without_a_terminal(heard):
    lines, said = heard
    with Bar(line_s=1e-3):
        assert said.wait(60.0)
    assert lines[0] == "getting ready (compiles on the first run)"


def test_workers_that_are_all_gone_are_said(heard):
    lines, said = heard
    gone, asked = Event(), Event()

    def count():
        asked.set()
        return 0 if gone.is_set() else 1

    with Bar(line_s=1e-3) as bar:
        bar.begun(3, [])
        bar.flying(count)
        assert asked.wait(60.0)
        gone.set()
        asked.clear()
        assert asked.wait(60.0)
        said.clear()
        assert said.wait(60.0)
    assert lines[-1] == "0 of 3 runs, no workers yet; waiting"


def test_a_cluster_that_does_not_answer_is_left_to_who_flies(heard):
    lines, said = heard

    def count():
        raise OSError("closed")

    with Bar(line_s=1e-3) as bar:
        bar.begun(3, [])
        bar.flying(count)
        said.clear()
        assert said.wait(60.0)
    assert "no workers" not in lines[-1]


def test_a_short_campaign_says_nothing(capsys):
    with Bar() as bar:
        bar.begun(1, [])
        bar.flown(FlownRun(0, "passed"))
    assert capsys.readouterr() == ("", "")
