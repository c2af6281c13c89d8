"""Make the pictures of docs/console.md: the operator's page in flight, and in trouble.

    python docs/pictures/console.py [NAME ...]

Needs Chromium. Each case is a flight with the page open, on the twin unless it says `bench`; the
picture is taken when the page says what the case is about. `sheet_NAME.png` shows a case on a
screen, a tablet and a phone, light and dark; `replay_NAME.png` the report at the same instant.
"""

import io
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from threading import Event, Thread
from time import monotonic
from typing import NamedTuple

import numpy as np
from browser import Browser
from PIL import Image
from scipy.spatial import cKDTree

HERE = Path(__file__).parent
PATIENCE_S = 400.0
SCREEN, TABLET, PHONE = (1366, 768), (820, 1180), (390, 844)
COLOURS, EXACT = 256, 64  # of a picture, and how many of them are kept as they are
LOW, GAP = 420, 10  # height of a picture in a sheet, and room between two [px]


class Shot(NamedTuple):
    """A picture to take of a case."""

    name: str
    size: tuple[int, int] = SCREEN
    dark: bool = False


class Case(NamedTuple):
    """A flight, what to wait for, and the pictures."""

    words: list[str]  # of `testbed run`
    until: str  # JavaScript, true when the picture is due
    shots: list[Shot]
    replay: bool = False  # also the report, at the time of the pictures
    sheet: bool = True  # also all sizes and themes


def clock(seconds: int) -> str:
    """Whether the flight is that far."""
    return f"picture && picture.now && picture.now.t > {seconds}"


def fault(kind: str, vehicle: str, at_s: float, more: str = "") -> str:
    """An injected fault."""
    return f'inject=[{{kind="{kind}",vehicle="{vehicle}",at_s={at_s}{more}}}]'


CASES = {
    "arming": Case(
        ["hold", "--rig", "bench", "arming.battery=13", "arming.supply_share=1.1"],
        "document.querySelectorAll('#checks li').length > 0 && "
        "document.getElementById('arming-title').textContent.includes('green')",
        [Shot("console_arming"), Shot("console_arming_phone", PHONE)],
    ),
    "one": Case(["hold", "duration_s=300"], clock(12), [Shot("console_one", TABLET)]),
    "three": Case(
        ["zhang2023_table", "--speed", "2"],
        clock(30),
        [Shot("console_three"), Shot("console_three_dark", SCREEN, True),
         Shot("console_three_phone", PHONE, True)],
        replay=True,
    ),
    "gains": Case(
        ["zhang2023_table", "--speed", "2"],
        "picture && picture.now && picture.now.t > 20 && controls.now && (window.asked ||= ("
        "controls.open('gains', true), controls.tune({type: 'Tune', values: {beta: 1.7}}), 1))"
        " && document.getElementById('open-gains').textContent === 'Gains (1)'"
        " && !document.body.classList.contains('stale')",
        [Shot("console_gains")],
        sheet=False,
    ),
    "hands": Case(
        ["zhang2023_table"],
        "picture && picture.now && picture.now.t > 20 && controls.now && (window.asked ||= ("
        "controls.open('hands', true), controls.take(), controls.drag = [0.6, 0.5], 1))"
        " && document.querySelector('.tile .state').textContent === 'flown by hand'"
        " && !document.body.classList.contains('stale')"
        " && document.getElementById('hands-told').className === 'ok'",
        [Shot("console_hands")],
        sheet=False,
    ),
    "five": Case(
        ["gao2022_table", "--speed", "4"], clock(60), [Shot("console_five", SCREEN, True)]
    ),
    "fault": Case(
        ["zhang2023_table", "--speed", "0.05", fault("stick_open", "sat2", 6.0, ",jet=3"),
         "duration_s=40"],
        "document.getElementById('head').textContent.startsWith('FAULT')",
        [Shot("console_fault"), Shot("console_fault_tablet", TABLET, True)],
        replay=True,
    ),
    "cameras": Case(
        ["zhang2023_table", "--speed", "0.2", fault("drop_mocap", "sat2", 8.0)],
        "document.querySelectorAll('.vehicle.blind').length > 0 && "
        "document.getElementById('head').textContent.startsWith('FAULT')",
        [Shot("console_cameras")],
    ),
    "hung": Case(
        ["hold", "--rig", "bench", fault("stop_host", "sat1", 8.0)],
        "document.getElementById('head').textContent.includes('no news from the host')"
        " && (performance.now() - answered) / 1000 + picture.age > 3",
        [Shot("console_hung"), Shot("console_hung_dark", SCREEN, True)],
    ),
}  # fmt: skip


def keep(png: bytes, name: str) -> None:
    """Save a picture with a palette."""
    picture = Image.open(io.BytesIO(png)).convert("RGB")
    few(picture).save(HERE / f"{name}.png", optimize=True)
    sys.stdout.write(f"{name}.png: {(HERE / f'{name}.png').stat().st_size / 1e3:.0f} kB\n")


def few(picture: Image.Image) -> Image.Image:
    """The picture with 256 colours: the frequent ones as they are, and a choice of the others.

    Pillow chooses colours for all pixels alike and looks for the nearest one roughly: areas would
    get a tint.
    """
    pixels = np.asarray(picture).reshape(-1, 3)
    colours, which, counts = np.unique(pixels, axis=0, return_inverse=True, return_counts=True)
    chosen = colours[np.argsort(-counts)]
    if len(chosen) > COLOURS:
        rest = Image.fromarray(chosen[None, EXACT:])
        found = rest.quantize(COLOURS - EXACT, Image.Quantize.MAXCOVERAGE).getpalette() or []
        chosen = np.vstack([chosen[:EXACT], np.reshape(found, (-1, 3))])
    nearest = cKDTree(chosen).query(colours)[1].astype(np.uint8)
    small = Image.fromarray(nearest[which.ravel()].reshape(picture.height, picture.width), "P")
    small.putpalette(chosen.ravel().tolist())
    return small


def sheet(pictures: Sequence[bytes], name: str) -> None:
    """Save the pictures of one case in two rows, light and dark, all equally high."""
    rows = [pictures[: len(pictures) // 2], pictures[len(pictures) // 2 :]]
    small = [[scaled(one) for one in row] for row in rows]
    width = sum(one.width + GAP for one in small[0]) + GAP
    whole = Image.new("RGB", (width, 2 * (LOW + GAP) + GAP), (128, 134, 142))
    for k, row in enumerate(small):
        at = GAP
        for one in row:
            whole.paste(one, (at, GAP + k * (LOW + GAP)))
            at += one.width + GAP
    out = io.BytesIO()
    whole.save(out, format="PNG")
    keep(out.getvalue(), name)


def scaled(png: bytes) -> Image.Image:
    """A picture of height LOW."""
    one = Image.open(io.BytesIO(png)).convert("RGB")
    return one.resize((round(one.width * LOW / one.height), LOW), Image.Resampling.LANCZOS)


def replay(run: Path, t: float, name: str) -> None:
    """Save the report's picture of the table and its bar at a time of the run."""
    with Browser(*SCREEN) as page:
        page.open((run / "report.html").resolve().as_uri())
        while not page.value(
            "document.readyState === 'complete' && !!window.scrub && !scrub.hidden"
        ):
            Event().wait(0.1)
        page.value(
            "(() => { const bar = document.querySelector('#scrub input');"
            f" bar.value = {t}; bar.dispatchEvent(new Event('input'));"
            " document.getElementById('trajectory').scrollIntoView();"
            " return new Promise(done => setTimeout(done, 600)); })()"
        )
        keep(page.picture(), name)


def page_of(run: "subprocess.Popen[str]") -> str:
    """Address of the page that the run serves."""
    assert run.stderr is not None
    for line in run.stderr:
        if line.startswith("console: http"):
            Thread(target=run.stderr.read, daemon=True).start()
            return line.split()[-1]
    raise RuntimeError("the run serves no page")


def take(name: str, case: Case, folder: Path) -> None:
    """Fly one case and take its pictures."""
    t = None
    run = subprocess.Popen(
        [sys.executable, "-m", "testbed", "run", *case.words, "--console", "0", "--out",
         str(folder)],
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        url, end = page_of(run), monotonic() + PATIENCE_S
        with Browser(*SCREEN) as page:
            page.open(url)

            def wait() -> None:
                while not page.value(case.until):
                    if monotonic() > end:
                        words = page.value("document.body.innerText")
                        raise TimeoutError(f"{case.words[0]}: {words}")
                    Event().wait(0.1)

            wait()
            if case.replay:  # all pictures at one instant
                page.value("take = () => {}")
                t = page.value("picture.now.t")
            for shot in case.shots:
                look(page, shot)
                wait()  # a busy machine may have kept the page waiting
                keep(page.picture(), shot.name)
            if case.sheet:
                sheet(all_looks(page), f"sheet_{name}")
    finally:
        run.send_signal(signal.SIGTERM)
        try:
            run.wait(60)
        except subprocess.TimeoutExpired:
            run.kill()
    if t is not None:
        replay(folder, t, f"replay_{name}")


def all_looks(page: Browser) -> list[bytes]:
    """The page on a screen, a tablet and a phone, light, then dark."""
    every = []
    for dark in (False, True):
        for size in (SCREEN, TABLET, PHONE):
            look(page, Shot("", size, dark))
            every.append(page.picture())
    return every


def look(page: Browser, shot: Shot) -> None:
    """Give the page a size and a theme."""
    width, height = shot.size
    page.call("Emulation.setDeviceMetricsOverride", width=width, height=height,
              deviceScaleFactor=1, mobile=False)  # fmt: skip
    theme = {"name": "prefers-color-scheme", "value": "dark" if shot.dark else "light"}
    still = {"name": "prefers-reduced-motion", "value": "reduce"}
    page.call("Emulation.setEmulatedMedia", features=[theme, still])
    page.value("new Promise(done => setTimeout(done, 400))")


def main() -> None:
    """Take all pictures, or those of the named cases."""
    for name in sys.argv[1:] or CASES:
        with tempfile.TemporaryDirectory() as folder:
            take(name, CASES[name], Path(folder) / "run")


if __name__ == "__main__":
    main()
