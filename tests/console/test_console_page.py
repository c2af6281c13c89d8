"""The page in a real browser: what it shows, at three sizes, light and dark."""

import io
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from console_run import eventually

Image = pytest.importorskip("PIL.Image")

SIZES = {"screen": (1366, 768), "tablet": (820, 1180), "phone": (390, 844)}
STALE = "document.body.classList.contains('stale')"


class Pages:
    """Starts the page of a run; returns its address."""

    def __init__(self):
        self._started = []

    def __call__(self, run: Path, port: str = "0") -> str:
        one = subprocess.Popen(
            [sys.executable, "-m", "testbed.console.process", str(run), "127.0.0.1", port],
            stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        self._started.append(one)
        line = one.stderr.readline()
        assert line.startswith("console: http://127.0.0.1:"), line
        return line.split()[-1]

    def end(self) -> None:
        for one in self._started:
            one.terminate()
            one.communicate(timeout=20)


@pytest.fixture
def page_of():
    pages = Pages()
    yield pages
    pages.end()


def text(page, selector: str) -> str:
    return page.value(f"document.querySelector({selector!r}).innerText") or ""


def pixels(page, selector: str) -> np.ndarray:
    """The pixels of an element that is in the window."""
    box = page.value(
        "(r => [r.x, r.y, r.right, r.bottom].map(Math.round))"
        f"(document.querySelector({selector!r}).getBoundingClientRect())"
    )
    picture = np.asarray(Image.open(io.BytesIO(page.picture())).convert("RGB")).astype(int)
    return picture[box[1] : box[3], box[0] : box[2]]


def near(area: np.ndarray, colour: tuple[int, int, int]) -> float:
    """Share of pixels of about this colour."""
    return float(np.mean(np.abs(area - np.array(colour)).max(axis=-1) < 30))


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("dark", [False, True])
def test_a_run_is_shown(flown, browser, page_of, pictures, size, dark):
    width, height = SIZES[size]
    url = page_of(flown["three"])
    with browser.Browser(width, height, dark=dark) as page:
        page.open(url)
        eventually(lambda: "not met" in text(page, "#head"), "the verdict is there")
        assert page.value("document.documentElement.scrollWidth") <= width
        if size == "screen":  # all of it at one look
            assert page.value("document.documentElement.scrollHeight") <= height
        assert text(page, "#clock") == "0:12"
        assert text(page, "#phase") == "STOPPED"
        cars = "document.querySelectorAll('#top .vehicle[visibility=visible]').length"
        assert page.value(cars) == 3
        assert page.value("document.querySelectorAll('#top .zone').length") == 2
        assert page.value(
            "[...document.querySelectorAll('#top .trail')]"
            ".every(one => one.getAttribute('points').split(' ').length > 30)"
        )
        for name in ("sat1", "sat2", "sat3"):
            tile = text(page, f".tile[data-name={name}]")
            for label in ("Gas left", "Supply", "Pose age", "Link", "Clearance", "Battery"):
                assert label in tile
        assert "RUNNING" in text(page, "#lines")
        # the button: where a finger finds it, red, and large
        wide, high, bottom = page.value(
            "(r => [r.width, r.height, r.bottom])"
            "(document.getElementById('stop').getBoundingClientRect())"
        )
        assert min(wide, high) >= 60
        assert bottom <= height
        if size == "phone":
            assert wide > 0.9 * width
        assert text(page, "#stop-hint") == "flight over"
        (pictures / f"console_{size}_{'dark' if dark else 'light'}.png").write_bytes(page.picture())


@pytest.mark.slow
def test_valves_are_drawn_as_they_opened(flown, browser, page_of):
    with browser.Browser(1366, 768) as page:
        page.open(page_of(flown["three"]))
        eventually(lambda: "not met" in text(page, "#head"), "the verdict is there")
        bars = page.value("raster.pulses.length")
        assert bars > 50
        area = pixels(page, "#raster")
        for hue in ((0, 105, 180), (200, 84, 0), (0, 120, 95)):  # each vehicle in its colour
            assert near(area[:, 60:], hue) > 0.0002  # few fire in 12 s
        assert near(area[:, 60:], (160, 0, 160)) == 0.0  # of no vehicle


@pytest.mark.slow
def test_eight_vehicles_leave_room_for_the_valves_and_differ_in_colour(flown, browser, page_of):
    with browser.Browser(1366, 768) as page:
        page.open(page_of(flown["three"]))
        eventually(lambda: "not met" in text(page, "#head"), "the verdict is there")
        eight = (
            "Array.from({length: 8}, (_, k) => ({...picture.now.vehicles[0], name: `sat${k + 1}`}))"
        )
        page.value(f"drawn = tiles; tiles = () => {{}}; drawn({eight})")  # and not the three again
        box = "(id => document.getElementById(id).getBoundingClientRect())"
        assert page.value(f"{box}('raster').height") > 90
        assert page.value(f"{box}('raster').bottom") < page.value(f"{box}('valves').bottom")
        assert page.value(f"{box}('valves').bottom") < page.value(f"{box}('events').top")
        assert page.value(f"{box}('events').bottom") <= 768
        hues = page.value(
            "JSON.stringify([...document.querySelectorAll('.tile h3 i')]"
            ".map(one => getComputedStyle(one).backgroundColor))"
        )
        assert len(set(json.loads(hues))) == 8


@pytest.mark.slow
@pytest.mark.parametrize("width", [1366, 1920])
def test_eight_tiles_are_two_rows_of_four_and_hold_long_names(flown, browser, page_of, width):
    with browser.Browser(width, 900) as page:
        page.open(page_of(flown["three"]))
        eventually(lambda: "not met" in text(page, "#head"), "the verdict is there")
        page.value(
            "drawn = tiles; tiles = () => {};"
            " drawn(Array.from({length: 8}, (_, k) => ({...picture.now.vehicles[0],"
            " name: `a_long_name_of_satellite_${k + 1}`})))"
        )
        inside = page.value(
            "[...document.querySelectorAll('.tile')].map(tile => {"
            " const name = document.createRange(); name.selectNodeContents(tile.firstElementChild);"
            " const box = tile.getBoundingClientRect();"
            " return [box.x, box.right - name.getBoundingClientRect().right] })"
        )
        assert len({round(x) for x, _ in inside}) == 4
        assert min(room for _, room in inside) >= 0


@pytest.mark.slow
def test_a_long_name_is_cut_in_its_middle_beside_the_valves(flown, browser, page_of):
    with browser.Browser(1366, 768) as page:
        page.open(page_of(flown["three"]))
        eventually(lambda: "not met" in text(page, "#head"), "the verdict is there")
        pen = "document.getElementById('raster').getContext('2d')"
        for name in ("sat1", "a_rather_long_name_of_a_sat1", "m" * 30 + "_2"):
            words = page.value(f"fitting({pen}, '{name}', 120)")
            assert page.value(f"{pen}.measureText('{words}').width") <= 120
            assert words[-2:] == name[-2:]
            assert words == name or "\N{HORIZONTAL ELLIPSIS}" in words


@pytest.mark.slow
def test_an_experiment_without_a_description_has_no_colon_after_its_law(flown, browser, page_of):
    with browser.Browser(1366, 768) as page:
        page.open(page_of(flown["three"]))
        eventually(lambda: text(page, "#law").startswith("law sotsmc: zhang2023"), "its law")
        page.value(
            "(real => { ask = async (...words) =>"
            " ({...await real(...words), description: ''}) })(ask)"
        )
        page.value("begin().then(() => 0)")
        eventually(lambda: text(page, "#law") == "law sotsmc", "no colon")


@pytest.mark.slow
def test_a_fault_screams_and_names_the_culprit(flown, browser, page_of, pictures):
    with browser.Browser(1366, 768) as page:
        page.open(page_of(flown["stuck"]))
        eventually(lambda: text(page, "#head").startswith("FAULT sat3"), "the headline")
        assert near(pixels(page, "#head"), (179, 21, 28)) > 0.6
        assert page.value("document.querySelector('.vehicle.culprit').dataset.name") == "sat3"
        assert page.value("[...document.querySelectorAll('.tile.bad')].map(one => one.dataset.name)"
                          ) == ["sat3"]  # fmt: skip
        assert "FAULT: valve stuck open" in text(page, ".tile.bad")
        assert page.value("document.querySelectorAll('.tile.warn').length") == 2
        first = page.value("document.querySelector('#lines li').className")
        assert first == "CRITICAL"
        assert "sat3" in page.value("document.querySelector('#lines li').innerText")
        (pictures / "console_fault.png").write_bytes(page.picture())


@pytest.mark.slow
def test_a_red_check_says_what_to_do(flown, browser, page_of, pictures):
    with browser.Browser(1366, 768) as page:
        page.open(page_of(flown["red"]))
        eventually(lambda: "battery" in text(page, "#checks"), "the checklist")
        assert "3 red" in text(page, "#arming-title")
        assert "charge or change the battery" in text(page, "#checks")
        assert "not started" in text(page, "#head")
        (pictures / "console_red.png").write_bytes(page.picture())


@pytest.fixture
def unfinished(flown, tmp_path) -> Path:
    """A run in the middle of its flight, whose log does not grow."""
    folder = tmp_path / "unfinished"
    folder.mkdir()
    shutil.copy(flown["three"] / "config.toml", folder)
    log = (flown["three"] / "log.mcap").read_bytes()
    (folder / "log.mcap").write_bytes(log[: len(log) // 2])
    return folder


@pytest.mark.slow
def test_an_old_picture_is_grey_and_says_its_age(unfinished, browser, page_of):
    with browser.Browser(1366, 768) as page:
        page.open(page_of(unfinished))
        eventually(lambda: text(page, "#veil").startswith("picture is "), "it is old")
        assert page.value(STALE)
        assert text(page, "#phase") == "RUNNING"
        assert "grayscale" in page.value("getComputedStyle(document.getElementById('top')).filter")
        assert text(page, "#stop-word") == "NOT CONNECTED"  # no flight of this run is there
        assert "does not fly on this machine" in text(page, "#ways")


@pytest.mark.slow
def test_a_page_without_its_server_says_so_in_red(unfinished, browser, page_of, pictures):
    with browser.Browser(1366, 768) as page:
        page.open(page_of(unfinished))
        eventually(lambda: page.value(STALE), "it is old")
        page.call("Network.enable")
        page.call("Network.emulateNetworkConditions", offline=True, latency=0,
                  downloadThroughput=-1, uploadThroughput=-1)  # fmt: skip
        eventually(lambda: text(page, "#phase") == "not connected", "it says so")
        assert text(page, "#stop-word") == "NOT CONNECTED"
        assert text(page, "#veil").startswith("not connected, picture is ")
        word = page.value("getComputedStyle(document.getElementById('stop-word')).color")
        assert word == "rgb(192, 31, 38)"
        (pictures / "console_lost.png").write_bytes(page.picture())


@pytest.mark.slow
def test_a_finished_run_stays_as_it_was_when_the_server_ends(flown, browser, page_of):
    with browser.Browser(1366, 768) as page:
        page.open(page_of(flown["stuck"]))
        eventually(lambda: text(page, "#age") == "flight over", "the flight is over")
        page.call("Network.enable")
        page.call("Network.emulateNetworkConditions", offline=True, latency=0,
                  downloadThroughput=-1, uploadThroughput=-1)  # fmt: skip
        eventually(lambda: not page.value("linked"), "the server is gone")
        assert text(page, "#head").startswith("FAULT sat3")
        assert not page.value(STALE)


@pytest.mark.slow
def test_a_page_that_meets_another_run_at_its_address_starts_anew(flown, browser, page_of):
    with browser.Browser(1366, 768) as page:
        url = page_of(flown["three"])
        page.open(url)
        eventually(lambda: text(page, "#clock") == "0:12", "the first run")
        page_of.end()
        page_of(flown["stuck"], url.rpartition(":")[2].strip("/"))
        eventually(lambda: text(page, "#head").startswith("FAULT sat3"), "the second run")
        assert text(page, "#of") == "of 0:08"


@pytest.mark.slow
def test_each_part_has_a_name_for_a_screen_reader(flown, browser, page_of):
    with browser.Browser(1366, 768) as page:
        page.open(page_of(flown["three"]))
        eventually(lambda: "not met" in text(page, "#head"), "the verdict is there")
        nodes = page.call("Accessibility.getFullAXTree")["nodes"]
        names = {
            (one["role"]["value"], one["name"]["value"])
            for one in nodes
            if "name" in one and "role" in one
        }
        for role, name in (
            ("button", "Stop all vehicles of this run"), ("image", "Table from above, 6 m by 6 m"),
            ("image", "Open valves of the last ten seconds"), ("log", "Events"),
            ("article", "sat1: flight over"), ("region", "Vehicles"),
        ):  # fmt: skip
            assert (role, name) in names, (role, name)
        assert ("alert", "") in names or any(role == "alert" for role, _ in names)
        page.call("Input.dispatchKeyEvent", type="keyDown", key="Tab", code="Tab",
                  windowsVirtualKeyCode=9)  # fmt: skip
        assert page.value("document.activeElement.id") == "stop"  # the first of all
