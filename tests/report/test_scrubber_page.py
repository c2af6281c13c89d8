"""A report in a browser: a planted failure at one look, the scrubber, values at the cursor."""

import io
import os
import re
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from chromium import chromium

Image = pytest.importorskip("PIL.Image")

ROOT = Path(__file__).resolve().parents[2]
MOST_BYTES = 3_000_000
TITLE = "document.querySelector('h1')"


@pytest.fixture(scope="module")
def browser():
    return chromium()


def failed(folder: Path, *words: str) -> Path:
    """The report of a flight that ends by a fault."""
    ended = subprocess.run(
        [sys.executable, "-m", "testbed", "run", *words, "--out", str(folder / "run")],
        cwd=ROOT, capture_output=True, check=False, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert ended.returncode == 3, ended.stderr.decode()
    return folder / "run" / "report.html"


@pytest.fixture(scope="module")
def crash(tmp_path_factory) -> Path:
    """PD knows nothing of obstacles: sat3 flies into o1."""
    return failed(tmp_path_factory.mktemp("crash"), "zhang2023_table_pd", "duration_s=20")


@pytest.fixture
def page(browser, crash):
    with browser.Browser(1366, 768) as opened:
        opened.open(crash.as_uri())
        opened.value("new Promise(done => setTimeout(done, 400))")
        yield opened


def test_a_long_name_does_not_widen_the_page(browser, crash, tmp_path):
    page = tmp_path / "long.html"
    html, found = re.subn(
        "<h1>.*?</h1>", f"<h1>{'experiment_' * 5}of_a_name</h1>", crash.read_text()
    )
    assert found == 1
    page.write_text(html)
    with browser.Browser(400, 800) as opened:
        opened.open(page.as_uri())
        assert loaded(opened, "document.documentElement.scrollWidth") <= 400


def loaded(page, script):
    """The value of an expression, once the page is there."""
    for _ in range(1000):
        with suppress(ConnectionError):  # in the middle of the navigation
            if found := page.value(f"document.readyState === 'complete' && {TITLE} && {script}"):
                return found
        threading.Event().wait(0.05)
    raise AssertionError("the page is not loaded")


def text(page, selector: str) -> str:
    return page.value(f"document.querySelector({selector!r}).innerText") or ""


def box(page, selector: str) -> list[int]:
    return page.value(
        "(r => [r.x, r.y, r.right, r.bottom].map(Math.round))"
        f"(document.querySelector({selector!r}).getBoundingClientRect())"
    )


def region(page, selector: str) -> np.ndarray:
    left, top, right, bottom = box(page, selector)
    picture = np.asarray(Image.open(io.BytesIO(page.picture())).convert("RGB")).astype(int)
    return picture[max(0, top) : bottom, max(0, left) : right]


def near(area: np.ndarray, colour: tuple[int, int, int]) -> float:
    """Share of pixels of about this colour."""
    return float(np.mean(np.abs(area - np.array(colour)).max(axis=-1) < 30))


def move(page, t: float) -> None:
    page.value(
        f"(i => {{ i.value = {t}; i.dispatchEvent(new Event('input')); }})"
        "(document.querySelector('#scrub input'))"
    )


@pytest.mark.slow
def test_the_failure_is_understood_without_scrolling(page, crash, tmp_path):
    assert crash.stat().st_size < MOST_BYTES
    assert text(page, ".verdict").startswith("sat3 hit obstacle o1 at 10.0 s")
    assert near(region(page, ".verdict"), (198, 40, 40)) > 0.6
    assert text(page, "#scrub output") == "10.0 s"  # it opens at the contact
    assert "sat3: hit obstacle o1" in text(page, "#scrub .told")
    for selector in (".verdict", "#trajectory .hit", "#scrub"):
        _, top, _, bottom = box(page, selector)
        assert top >= 0, selector
        assert bottom <= 768, selector
    assert box(page, "#trajectory .hit")[3] < box(page, "#scrub")[1]  # not behind the bar
    assert near(region(page, "#trajectory .hit"), (198, 40, 40)) > 0.1  # a red star
    words = page.value("document.querySelector('#trajectory').textContent")
    assert "contact, 10.0 s" in words
    Path(os.environ.get("DASHBOARD_PICTURES", tmp_path), "report_crash.png").write_bytes(
        page.picture()
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("inject", "badge", "story"),
    [
        ('kind="stick_open",vehicle="sat3",at_s=2.03,jet=3', "sat3: valve stuck open", "jet 3"),
        ('kind="drop_mocap",vehicle="sat2",at_s=2.0', "sat2: pose lost", "no pose for 3.00 s"),
    ],
)
def test_a_fault_is_understood_without_scrolling(browser, tmp_path, inject, badge, story):
    report = failed(tmp_path, "zhang2023_table", "duration_s=12", f"inject=[{{{inject}}}]")
    with browser.Browser(1366, 768) as page:
        page.open(report.as_uri())
        page.value("new Promise(done => setTimeout(done, 400))")
        assert text(page, ".verdict").startswith(f"{badge}; aborted by a fault after ")
        assert story in text(page, "header")
        assert "fault: " in text(page, "#scrub .told")
        assert story in text(page, "#scrub .told")
        for selector in (".verdict", "#trajectory .hit", "#scrub"):
            assert 0 <= box(page, selector)[1] < box(page, selector)[3] <= 768, selector


@pytest.mark.slow
def test_dragging_moves_vehicles_jets_and_cursors(page):
    def there():
        return page.value(
            "[...document.querySelectorAll('#live .car')].map(g => g.getAttribute('transform'))"
        )

    def cursor():
        return page.value("document.querySelector('#error .cursor').getAttribute('d')")

    late, line = there(), cursor()
    assert len(late) == 3
    move(page, 2.0)
    assert text(page, "#scrub output") == "2.0 s"
    assert all(a != b for a, b in zip(late, there(), strict=True))
    assert cursor() != line
    assert text(page, "#error .values").startswith("at 2.0 s, in mm: sat1 ")
    plumes = []
    for t in np.arange(1.0, 6.0, 0.2).tolist():
        move(page, t)
        plumes.append(page.value("document.querySelector('#live .car .plume').getAttribute('d')"))
    assert len(set(plumes)) > 3  # jets open and shut


@pytest.mark.slow
def test_an_event_and_a_plot_set_the_time(page):
    page.value("[...document.querySelectorAll('#scrub .tick')][1].click()")
    assert text(page, "#scrub output") == "10.0 s"
    rows = "[...document.querySelectorAll('tr[data-t]')]"
    page.value(f"{rows}.find(row => row.innerText.includes('fault: bumped')).click()")
    assert text(page, "#scrub output") == "10.1 s"
    left, top, right, bottom = box(page, "#error svg")
    spot = {"x": (left + right) / 2, "y": (top + bottom) / 2, "button": "left", "clickCount": 1}
    page.call("Input.dispatchMouseEvent", type="mousePressed", **spot)
    page.call("Input.dispatchMouseEvent", type="mouseReleased", **spot)
    assert 4.5 < float(text(page, "#scrub output").split()[0]) < 7.0


@pytest.mark.slow
def test_values_at_the_cursor_are_those_of_the_flight(page, crash):
    from testbed.logs.history import gather
    from testbed.logs.log_reader import LogReader

    move(page, 6.0)
    history = gather(LogReader(crash.parent / "log.mcap"))
    t, state = history.where("sat1")
    speed = 1e3 * np.interp(6.0, t, np.hypot(state[:, 3], state[:, 4]))
    page.value("document.querySelector('#speed').scrollIntoView()")
    page.picture()  # draws a frame, and so tells the page that it was scrolled
    told = text(page, "#speed .values")
    shown = float(told.partition("sat1 ")[2].split()[0])
    assert shown == pytest.approx(speed, rel=0.02, abs=1.0)


@pytest.fixture(scope="module")
def short(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("short") / "run"
    subprocess.run(
        [sys.executable, "-m", "testbed", "run", "zhang2023_table", "duration_s=5", "criteria={}",
         "--out", str(folder)],
        cwd=ROOT, capture_output=True, check=True, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    return folder / "report.html"


@pytest.mark.slow
def test_the_bar_ends_with_the_flight_and_the_cursors_stay(browser, short):
    with browser.Browser(1366, 768) as opened:
        opened.open(short.as_uri())
        assert loaded(opened, "document.querySelector('#scrub output').innerText") == "5.0 s"
        cursor = "document.querySelector('#error .cursor').getAttribute('visibility')"
        assert opened.value(cursor) == "visible"


@pytest.mark.slow
def test_the_tables_fit_a_phone(browser, short):
    with browser.Browser(360, 800) as opened:
        opened.open(short.as_uri())
        tables = "[...document.querySelectorAll('.wide')]"
        assert loaded(opened, f"{tables}.length") >= 3
        assert opened.value(f"{tables}.filter(t => t.scrollWidth > t.clientWidth + 1).length") == 0
        opened.value("document.querySelector('#scrub .told').textContent = 'word '.repeat(60)")
        hidden = "(t => t.scrollWidth > t.clientWidth + 1)(document.querySelector('#scrub .told'))"
        assert not opened.value(hidden)
