"""The dashboard in real viewers: one without a screen, one in a browser."""

import importlib.util
import io
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event
from types import ModuleType
from typing import Any

import msgspec
import numpy as np
import psutil
import pytest

pytest.importorskip("rerun_cli", reason="the dashboard extra is not installed")
Image = pytest.importorskip("PIL.Image")

from testbed.cli.dash import Dashboard, address_for  # noqa: E402
from testbed.dashboard import feeder  # noqa: E402
from testbed.dashboard.static_scene import HUES  # noqa: E402
from testbed.dashboard.viewer import (  # noqa: E402
    ViewerAddress,
    ViewerError,
    command,
    free_port,
    start,
)

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 240.0  # of the test, not of what is tested: software draws every pixel here
VULKAN = any(Path("/usr/share/vulkan/icd.d").glob("*.json"))
needs_vulkan = pytest.mark.skipif(not VULKAN, reason="no Vulkan driver to draw with")


def eventually(look: Callable[[], Any], what: str) -> Any:
    """The first true value of `look`."""
    until, last = time.monotonic() + PATIENCE_S, None
    while time.monotonic() < until:
        try:
            if found := look():
                return found
        except (ConnectionError, TimeoutError, RuntimeError) as error:
            last = error
        Event().wait(0.3)
    raise AssertionError(f"never: {what} ({last})")


def colours(png: bytes) -> dict[tuple[int, int, int], int]:
    """How many pixels are about the colour of each of the first three vehicles."""
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
    left = pixels[:, : int(0.54 * pixels.shape[1])]
    return {hue: int(np.sum(np.abs(left - np.array(hue)).max(axis=-1) < 40)) for hue in HUES[:3]}


def seen(png: bytes, kept: Path) -> bool:
    """Whether all three vehicles are there; the newest picture is kept to be looked at."""
    kept.write_bytes(png)
    return min(colours(png).values()) > 300


def alive(process: subprocess.Popen[bytes]) -> bool:
    return process.poll() is None


@pytest.fixture
def headless(run) -> Iterator[Dashboard]:
    board = Dashboard(run, "headless", address_for())
    yield board
    board.close()


@pytest.mark.slow
@needs_vulkan
@pytest.mark.parametrize("rig", ["twin", "bench"])
def test_a_run_is_followed_while_it_is_flown(tmp_path, pictures, rig):
    from rerun.experimental import ViewerClient

    paced = ["duration_s=4000", "--speed", "1"] if rig == "twin" else ["duration_s=900"]

    folder = tmp_path / "run"
    flight = subprocess.Popen(
        [sys.executable, "-m", "testbed", "run", "zhang2023_table",
         "--rig", rig, *paced, "--out", str(folder)],
        cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": str(ROOT), "XDG_STATE_HOME": str(tmp_path / "state")},
    )  # fmt: skip
    eventually((folder / "config.toml").exists, "the run has a folder")
    board = Dashboard(folder, "headless", address_for())
    try:
        board.open(Event().wait)
        client = eventually(lambda: ViewerClient.connect(board.address.data), "it answers")

        def now() -> float:
            ends = [
                line.end * 1e-9
                for recording in client.get_state().recordings
                for line in recording.timelines
                if line.name == "t" and line.end is not None
            ]
            return max(ends, default=0.0)

        first = eventually(now, "ticks arrive")
        eventually(lambda: now() > first + 1.0, "time advances")
        assert eventually(
            lambda: seen(client.take_screenshot(), pictures / f"headless_{rig}.png"),
            "the table and three vehicles are seen",
        )
        state = eventually(client.get_state, "it says what it shows")
        views = {view.name: view for view in state.views}
        for wanted in ("Table from above", "Distance to the goal [mm]", "Clearance", "Force",
                       "Valves", "Gas left [%]", "Age of the newest pose [ms]", "Link delay",
                       "Loop lateness [ms]", "Events", "State"):  # fmt: skip
            assert any(wanted in name for name in views), wanted
        assert not [view.reports for view in views.values() if view.reports]
        assert alive(flight)
    finally:
        board.close()
        flight.send_signal(signal.SIGINT)
        ended = flight.wait(PATIENCE_S)
    assert ended == 130


@pytest.mark.slow
@needs_vulkan
def test_who_dies_is_started_again(headless):
    headless.open(Event().wait)
    headless.viewer.kill()
    headless.viewer.wait()
    assert headless.keep(Event().wait)
    assert alive(headless.viewer)
    assert headless.restarts == 1
    headless.feeder.kill()
    headless.feeder.wait()
    assert headless.keep(Event().wait)
    assert headless.restarts == 2
    assert headless.feeder.wait(PATIENCE_S) == 0  # all is told


def test_a_feeder_without_its_viewer_says_so_and_no_more(monkeypatch, capsys):
    def tell(words):
        raise RuntimeError(words)

    monkeypatch.setattr(sys, "argv", ["feeder", "a run", "an address"])
    monkeypatch.setattr(feeder, "feed", lambda *_: tell("gRPC connection severed: no such viewer"))
    assert feeder.main() == feeder.SEVERED
    assert capsys.readouterr() == ("", "")
    monkeypatch.setattr(feeder, "feed", lambda *_: tell("something else"))
    with pytest.raises(RuntimeError):
        feeder.main()


@pytest.mark.slow
def test_the_dashboard_of_a_run_ends_with_its_terminal(run):
    leader, terminal = os.openpty()
    words = ["dash", str(run), "--web"]
    dash = subprocess.Popen(
        [sys.executable, "-m", "testbed", *words],
        cwd=ROOT, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=terminal,
        start_new_session=True, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    os.close(terminal)
    try:
        viewers = eventually(
            lambda: [one.pid for one in psutil.Process(dash.pid).children()], "a viewer is started"
        )
        os.close(leader)
        dash.wait(PATIENCE_S)
        assert not any(map(psutil.pid_exists, viewers))
    finally:
        dash.kill()
        dash.wait()


@pytest.mark.slow
def test_a_browser_shows_the_table(run, pictures):
    browser = module(ROOT / "docs" / "pictures" / "browser.py")
    if browser.find() is None:
        pytest.skip("Chromium is not installed")
    board = Dashboard(run, "web", address_for())
    try:
        board.open(Event().wait)
        with browser.Browser(1600, 1000, dark=True) as page:
            page.open(board.address.page + "&renderer=webgl")
            assert eventually(
                lambda: seen(page.picture(), pictures / "web.png"),
                "the table and three vehicles are seen",
            )
    finally:
        board.close()


def module(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def test_a_viewer_listens_to_this_machine_only():
    for kind in ("window", "web", "headless"):
        words = command(kind, address_for())
        assert words[words.index("--bind") + 1] == "127.0.0.1"
        assert "--memory-limit" in words


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="needs /proc")
def test_no_other_user_can_connect(run):
    board = Dashboard(run, "web", address_for())
    try:
        board.open(Event().wait)
        ports = {f"{port:04X}" for port in (board.address.port, board.address.web_port)}
        eventually(lambda: ports <= set(listeners()), "both listen")
        assert {listeners()[port] for port in ports} == {"0100007F"}  # 127.0.0.1
    finally:
        board.close()


def listeners() -> dict[str, str]:
    """Port and address of who listens, in hexadecimal."""
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    local = [row[1].split(":") for row in rows if row[3] == "0A"]
    return {port: host for host, port in local}


def test_no_screen_is_said(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ViewerError, match="try --web"):
        start("window", address_for())


def test_addresses():
    everywhere = ViewerAddress("0.0.0.0", 9876, 9877)
    assert everywhere.data == "rerun+http://127.0.0.1:9876/proxy"
    assert everywhere.page.startswith("http://127.0.0.1:9877/?url=rerun%2Bhttp%3A%2F%2F127.0.0.1")
    with socket.socket() as one:
        one.bind(("127.0.0.1", free_port()))


def test_a_recording_has_everything(run, tmp_path, capfd):
    chunk = pytest.importorskip("rerun.chunk")
    from testbed.dashboard.recording import write_recording

    path = write_recording(run, tmp_path / "run.rrd")
    assert capfd.readouterr().err == ""  # rerun warns of a space in a path
    found = {str(c.entity_path) for c in chunk.RrdReader(str(path)).stream().to_chunks()}
    for name in ("sat1", "sat2", "sat3"):
        wanted = {
            f"/world/vehicle/{name}", f"/world/vehicle/{name}/jets", f"/world/trail/{name}",
            f"/world/reference/{name}", f"/world/stop/{name}", f"/world/goal/{name}",
            f"/plot/error/{name}", f"/plot/force/{name}_delivered", f"/plot/gas/{name}",
            f"/plot/link/{name}", f"/plot/link/{name}_setpoints", f"/valve/{name}/jet_8",
        }  # fmt: skip
        assert wanted <= found, wanted - found
    assert {
        "/banner",
        "/event",
        "/world/fence",
        "/world/link",
        "/plot/clearance/limit_danger_radius",
    } <= found
    assert json.dumps(sorted(found))  # plain words


def test_a_formation_is_shown_with_its_leader_and_without_goals(tmp_path):
    chunk = pytest.importorskip("rerun.chunk")
    from testbed.dashboard.recording import write_recording

    flown = tmp_path / "flown"
    words = ["run", "xue2024_table_constant", "duration_s=2", "--out", str(flown)]
    subprocess.run(
        [sys.executable, "-m", "testbed", *words], cwd=ROOT, check=False,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    path = write_recording(flown, tmp_path / "run.rrd")
    chunks = list(chunk.RrdReader(str(path)).stream().to_chunks())
    found = {str(c.entity_path) for c in chunks}
    assert {"/world/goal/leader", "/plot/error/sat1", "/plot/error/sat3"} <= found
    assert "/world/goal/sat1" not in found


def test_the_legend_of_eight_vehicles_is_not_cut_and_their_colours_differ():
    from testbed.dashboard.legend import BACK, WIDTH, picture

    lines = [("dark: delivered, or to the vehicle", (120, 130, 145), True)]
    lines += [("warns", (224, 160, 60), True), ("ends the flight", (255, 107, 107), True)]
    for names in (["sat1"], [f"satellite_{k}" for k in range(8)]):
        entries = [*((name, hue, False) for name, hue in zip(names, HUES, strict=False)), *lines]
        drawn = np.asarray(Image.open(io.BytesIO(picture(entries))))
        used = np.flatnonzero((drawn != BACK).any(axis=(0, 2)))
        assert used.max() < WIDTH - 10
        assert all((drawn == colour).all(axis=2).any() for _, colour, _ in entries)
    assert len(set(HUES)) == 8  # as in the report and on the console


def test_the_title_of_many_valves_is_short():
    from testbed.config import find, load
    from testbed.dashboard.blueprint import _valve_rows

    base = load(find("hold"))
    for count, words in (
        (2, "row 11: sat1 jet 1, 21: sat2 jet 1"),
        (8, "row 11: sat1 jet 1, 21: sat2 jet 1, ..., 81: sat8 jet 1"),
    ):
        crew = {f"sat{k + 1}": base.vehicles["sat1"] for k in range(count)}
        view = _valve_rows(msgspec.structs.replace(base, vehicles=crew), 60.0)
        assert str(view.name).endswith(words)


def test_those_in_the_same_state_share_the_banner():
    from testbed.dashboard.scene_table import grouped

    states = {"sat1": "flies", "sat2": "waits: not armed", "sat3": "flies"}
    assert grouped(states) == ["sat1, sat3 flies", "sat2 waits: not armed"]


def test_only_an_edge_of_the_formation_has_to_stay_in_range():
    from testbed.config import find, load
    from testbed.dashboard.columns import ColumnBuffer
    from testbed.dashboard.scene_goals import AimScene

    rr = pytest.importorskip("rerun")
    columns = ColumnBuffer(rr.RecordingStream("test"))
    aims = AimScene(load(find("xue2024_table_constant")), columns)
    assert aims.matters("sat2", "sat1")
    assert not aims.matters("sat1", "sat3")
