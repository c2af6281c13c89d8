"""STOP in a browser ends a flight on the twin and on the bench, also if its law hangs."""

import io
import json
import re

import numpy as np
import pytest
from console_run import PATIENCE_S, address, eventually

from testbed.logs.feed import LogFeed, SeenPhase
from testbed.logs.log_reader import LogReader

Image = pytest.importorskip("PIL.Image")

RED = (200, 20, 28)
INTERRUPTED, FAULT = 130, 3


def value(page, script):
    return page.value(f"document.querySelector({script!r}).textContent") or ""


def click(page):
    x, y = page.value("(r => [r.x + r.width / 2, r.y + r.height / 2])"
                      "(document.getElementById('stop').getBoundingClientRect())")  # fmt: skip
    for kind in ("mousePressed", "mouseReleased"):
        page.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)


def red_share(page) -> float:
    """Share of the button's pixels that are red."""
    x, y, right, bottom = page.value(
        "(r => [r.x, r.y, r.right, r.bottom].map(Math.round))"
        "(document.getElementById('stop').getBoundingClientRect())"
    )
    picture = np.asarray(Image.open(io.BytesIO(page.picture())).convert("RGB")).astype(int)
    return float(np.mean(np.abs(picture[y:bottom, x:right] - RED).max(axis=-1) < 30))


@pytest.mark.slow
@pytest.mark.parametrize("rig", ["twin", "bench"])
def test_stop_ends_the_flight(testbed, browser, tmp_path, rig):
    out = tmp_path / "out"
    run = testbed("run", "hold", "--rig", rig, "--console", "0", "--out", out, "duration_s=900")
    url = address(run)
    with browser.Browser(390, 844) as page:
        page.open(url)
        eventually(lambda: value(page, "#phase") == "RUNNING", "it flies")
        eventually(lambda: value(page, "#clock") not in ("0:00", "0:01"), "the clock runs")
        assert red_share(page) > 0.5
        click(page)
        told = "hold on the twin: stops" if rig == "twin" else "sat1: stops"
        eventually(lambda: told in value(page, "#told"), "the stop is answered")
    assert run.wait(PATIENCE_S) == INTERRUPTED
    assert (out / "arming.json").exists() == (rig == "bench")
    assert json.loads((out / "metrics.json").read_text())["criteria"] is None
    assert re.search(r"(interrupted at|stopped by the operator after) \d+\.\d s: not judged",
                     (out / "report.html").read_text())  # fmt: skip
    phases = [one.message for one in LogFeed(LogReader(out / "log.mcap")).news()]
    assert [one.phase for one in phases if isinstance(one, SeenPhase)][-1] in ("STOPPED", "FAULT")


HANGS = """
import numpy as np


class Mine:
    step_s = 0.02

    def force(self, own, neighbours, world, t):
        while t > 1.5:
            pass
        return np.zeros(2)
"""


@pytest.mark.slow
def test_the_key_stops_a_flight_whose_law_hangs(testbed, browser, tmp_path):
    law = tmp_path / "my_law.py"
    law.write_text(HANGS)
    out = tmp_path / "out"
    own = f'controller={{type="python",law="{law}:Mine"}}'
    words = ["deploy.law_limit_s=1000", "criteria={}", "duration_s=900", "--out", out]
    run = testbed("run", "hold", own, "--console", "0", *words)
    url = address(run)
    with browser.Browser(1366, 768) as page:
        page.open(url)
        eventually(lambda: "no news from the host" in value(page, "#head"), "it hangs")
        assert "picture" in value(page, "#veil")
        page.call("Input.dispatchKeyEvent", type="keyDown", key="Escape", code="Escape",
                  windowsVirtualKeyCode=27)  # fmt: skip
        eventually(lambda: "on the twin: stops" in value(page, "#told"), "the stop is answered")
    assert run.wait(PATIENCE_S) == FAULT
    assert "my_law.py" in json.loads((out / "metrics.json").read_text())["fault"]
