"""Live gains and flying by hand: from a browser on the twin, and from a program on the bench."""

import pytest
from console_run import PATIENCE_S, address, eventually

from testbed.config import load
from testbed.console.client import PageClient
from testbed.core.types import HostTick, Tick
from testbed.logs.feed import LogFeed
from testbed.logs.log_reader import LogReader
from testbed.run.replay import replay_experiment

INTERRUPTED = 130
KEYS = {"d": ("KeyD", 68), "e": ("KeyE", 69)}


def text(page, selector):
    return page.value(f"document.querySelector({selector!r}).textContent") or ""


def press(page, key, kind):
    code, number = KEYS[key]
    page.call("Input.dispatchKeyEvent", type=kind, key=key, code=code,
              windowsVirtualKeyCode=number)  # fmt: skip


def middle(page, selector):
    return page.value(
        "(r => [r.x + r.width / 2, r.y + r.height / 2])"
        f"(document.querySelector({selector!r}).getBoundingClientRect())"
    )


def mouse(page, kind, x, y):
    page.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)


def click(page, selector):
    for kind in ("mousePressed", "mouseReleased"):
        mouse(page, kind, *middle(page, selector))


def set_field(page, name, value):
    page.value(
        f"(one => {{ one.value = '{value}'; one.dispatchEvent(new Event('change')); }})"
        f"(document.getElementById('gain-{name}').nextElementSibling)"
    )


def moves(page, axis):
    """A vehicle's speed in the page's pictures is there [m/s]."""
    return page.value(f"picture.now.vehicles[0].stop[{axis}] - picture.now.vehicles[0].at[{axis}]")


def flown(out):
    """Whether a log is replayed to the last bit, and its messages."""
    experiment = load(out / "config.toml", [])
    found = replay_experiment(experiment, out / "log.mcap")
    assert found.first_difference is None
    return experiment, [one.message for one in LogFeed(LogReader(out / "log.mcap")).news()]


@pytest.mark.slow
def test_a_browser_changes_gains_and_flies(testbed, browser, tmp_path, pictures):
    out = tmp_path / "out"
    run = testbed("run", "hold", "--console", "0", "--out", out, "duration_s=900", "criteria={}")
    url = address(run)
    with browser.Browser(1366, 768) as page:
        page.open(url)
        eventually(lambda: page.value("!document.getElementById('tools').hidden"), "the flight")
        eventually(
            lambda: text(page, "#clock") not in ("0:00", "\N{EN DASH}:\N{EN DASH}"), "it flies"
        )
        click(page, "#open-gains")
        set_field(page, "bandwidth", "0.3")
        eventually(lambda: "bandwidth 0.2 to 0.3" in text(page, "#gains-told"), "it is changed")
        set_field(page, "bandwidth", "-1")
        eventually(lambda: "refused" in text(page, "#gains-told"), "it is refused")
        assert "bandwidth > 0" in text(page, "#gains-told")
        eventually(lambda: text(page, "#open-gains") == "Gains (1)", "the count of changes")
        eventually(lambda: "bandwidth 0.2 to 0.3" in text(page, "#lines"), "the event")
        (pictures / "controls_gains.png").write_bytes(page.picture())
        click(page, "#revert")
        eventually(lambda: text(page, "#open-gains") == "Gains", "all is as at the start")

        click(page, "#open-hands")
        click(page, "#take")
        eventually(lambda: "you fly sat1" in text(page, "#hands-told"), "it is flown by hand")
        press(page, "d", "keyDown")
        press(page, "e", "keyDown")
        eventually(lambda: moves(page, 0) > 0.02, "it flies to the right")
        eventually(lambda: "flown by hand" in text(page, ".tile .state"), "the stick is fresh")
        (pictures / "controls_hands.png").write_bytes(page.picture())
        press(page, "d", "keyUp")
        press(page, "e", "keyUp")
        x, y = middle(page, "#pad")
        mouse(page, "mousePressed", x, y - 80)
        eventually(lambda: moves(page, 1) > 0.02, "it flies up")
        mouse(page, "mouseReleased", x, y - 80)
        click(page, "#give")
        eventually(lambda: "flies sat1" in text(page, "#hands-told"), "it is given back")
        eventually(lambda: text(page, "#open-hands") == "By hand", "the law flies")
        nodes = page.call("Accessibility.getFullAXTree")["nodes"]
        named = [one for one in nodes if "name" in one]
        # some versions of Chromium keep the spaces around a label's text
        names = {(one["role"]["value"], one["name"]["value"].strip()) for one in named}
        for role, name in (
            ("button", "Fly by hand"), ("button", "Turn left, key Q"), ("combobox", "Vehicle"),
            ("radio", "velocity"), ("button", "Give to its law"), ("region", "By hand keys: arrows"
             " or W A S D, turn Q E"),
            ("application", "Stick: drag, or arrows or W A S D to move; Q and E to turn"),
        ):  # fmt: skip
            assert (role, name) in names, (role, name)
        click(page, "#stop")
        assert run.wait(PATIENCE_S) == INTERRUPTED
    experiment, said = flown(out)
    assert [one.controller.bandwidth for one in experiment.forks] == [0.3, 0.2]
    sticks = [one.inputs.stick for one in said if isinstance(one, HostTick) and one.inputs.stick]
    assert {(one.x, one.turn) for one in sticks} >= {(1.0, -1.0), (0.0, 0.0)}


@pytest.mark.slow
@pytest.mark.parametrize("law", ["host", "vehicle"])
def test_a_program_changes_a_flight_on_the_bench(testbed, tmp_path, law):
    out = tmp_path / "out"
    words = ["--console", "0", "--out", out, "duration_s=900", "criteria={}"]
    run = testbed("run", "hold", "--rig", "bench", f'deploy.law="{law}"', *words)
    page = PageClient(address(run))
    eventually(lambda: page.picture().get("now", {}).get("phase") == "RUNNING", "it flies")
    told = page.request("Tune", values={"bandwidth": 0.3})
    assert told["ok"], told
    told = page.request("Tune", values={"bandwidth": -1.0})
    assert not told["ok"]
    assert "bandwidth > 0" in told["words"]

    def steered():
        page.steer("sat1", 1.0, 0.0)
        return page.picture()["now"]["vehicles"][0]["state"] == "flown by hand"

    if law == "host":
        eventually(steered, "it is flown by hand")
        page.steer("sat1", 0.0, 0.0, mode="law")
    told = page.request("Revert")
    assert told["ok"], told
    changed = float(told["words"].split()[1])
    eventually(lambda: page.picture()["now"]["t"] > changed + 0.5, "it has changed")
    page._link.request("POST", "/stop", "1", {"X-Console": "stop"})
    assert page._answer()["sent"]
    run.wait(PATIENCE_S)
    page.close()
    experiment, said = flown(out)
    assert [one.controller.bandwidth for one in experiment.forks] == [0.3, 0.2]
    assert sum(isinstance(one, Tick) for one in said) > 10
    by_hand = any(isinstance(one, HostTick) and one.inputs.stick for one in said)
    assert by_hand == (law == "host")
