"""Make the pictures of the README and the docs: the paths flown, the dashboard, reports, a film.

    python docs/pictures/make.py

Needs the dashboard extra, a Vulkan driver (Debian: mesa-vulkan-drivers) and Chromium. The run is
zhang2023's table experiment; the dashboard shows it in the middle of its way.
"""

import io
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from threading import Event

from browser import Browser
from PIL import Image
from rerun.experimental import ViewerClient

import testbed
from testbed.cli.dash import Dashboard, address_for
from testbed.logs.history import gather
from testbed.logs.log_reader import LogReader

HERE = Path(__file__).parent
MIDDLE_S = 37.0  # two vehicles pass the obstacles
PATIENCE_S = 300.0


def fly(folder: Path, *overrides: str) -> None:
    """Fly the experiment into `folder`; its verdict does not matter here."""
    words = ["run", "zhang2023_table", *overrides, "--out", str(folder)]
    command = [sys.executable, "-m", "testbed", *words]
    subprocess.run(command, stdout=subprocess.DEVNULL, check=False)


def cut(whole: Path, half: Path) -> None:
    """Copy a run with its log cut at MIDDLE_S, as it was at that time in flight."""
    half.mkdir()
    shutil.copy(whole / "config.toml", half)
    log = (whole / "log.mcap").read_bytes()
    end = gather(LogReader(whole / "log.mcap")).end
    (half / "log.mcap").write_bytes(log[: round(len(log) * MIDDLE_S / end)])


def keep(png: bytes, name: str, width: int) -> None:
    """Save a picture, reduced in size and in number of colours."""
    picture = Image.open(io.BytesIO(png)).convert("RGB")
    height = round(picture.height * width / picture.width)
    picture = picture.resize((width, height), Image.Resampling.LANCZOS)
    picture.quantize(255, dither=Image.Dither.NONE).save(HERE / name, optimize=True)
    sys.stdout.write(f"{HERE / name}: {(HERE / name).stat().st_size / 1e3:.0f} kB\n")


def dashboard(run: Path) -> bytes:
    """Take a screenshot of the headless viewer when it has received the whole log."""
    end = gather(LogReader(run / "log.mcap")).end
    board = Dashboard(run, "headless", address_for())
    try:
        board.open(Event().wait)
        client = ViewerClient.connect(board.address.data)
        until = time.monotonic() + PATIENCE_S
        while time.monotonic() < until:
            Event().wait(1.0)
            try:
                ends = [
                    line.end
                    for recording in client.get_state().recordings
                    for line in recording.timelines
                    if line.name == "t"
                ]
                if ends and max(ends) >= 1e9 * (end - 0.2):
                    client.take_screenshot()
                    Event().wait(2.0)
                    return client.take_screenshot()
            except (ConnectionError, TimeoutError):
                continue
        raise TimeoutError("the viewer did not get there")
    finally:
        board.close()


def report(run: Path) -> bytes:
    """Take a screenshot of the top of the report."""
    with Browser(1240, 1500) as page:
        page.open((run / "report.html").resolve().as_uri())
        page.value("new Promise(done => setTimeout(done, 500))")
        return page.picture()


def failure(folder: Path) -> None:
    """The report and the film of a vehicle that flies into an obstacle."""
    command = [sys.executable, "-m", "testbed"]
    words = ["run", "zhang2023_table_pd", "duration_s=20", "--out", str(folder)]
    subprocess.run([*command, *words], stdout=subprocess.DEVNULL, check=False)
    with Browser(1366, 900) as page:
        page.open((folder / "report.html").resolve().as_uri())
        page.value("new Promise(done => setTimeout(done, 500))")
        keep(page.picture(), "report_fault.png", 1366)
    film = [*command, "film", str(folder), "--out", str(HERE / "film.gif"), "--width", "480"]
    subprocess.run(film, stdout=subprocess.DEVNULL, check=True)


def trajectory(run: Path) -> None:
    """Save the report's figure of the paths as flight.svg."""
    drawing = testbed.open_run(run).plot("trajectory")["trajectory"]
    (HERE / "flight.svg").write_text(drawing, encoding="utf-8")


def scene(run: Path) -> None:
    """The log's standard messages, as a 3D panel shows them from above."""
    command = [HERE.parents[1] / "tests/scene_picture.py", run / "log.mcap", str(MIDDLE_S)]
    subprocess.run([sys.executable, *command, HERE / "scene.png"], check=True)


def main() -> None:
    """Make all of them."""
    with tempfile.TemporaryDirectory() as folder:
        failure(Path(folder) / "failure")
        half, whole = Path(folder) / "half", Path(folder) / "whole"
        fly(whole)
        trajectory(whole)
        scene(whole)
        cut(whole, half)
        keep(dashboard(half), "dashboard.png", 1600)
        keep(report(whole), "report.png", 1240)


if __name__ == "__main__":
    main()
