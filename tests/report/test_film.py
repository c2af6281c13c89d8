"""A film of a run: what each frame shows, by pixel, and the file."""

import numpy as np
import pytest

pytest.importorskip("PIL")
from PIL import Image

from testbed.config import find, load
from testbed.logs.history import History, VehicleHistory
from testbed.report.fault_story import EventLine
from testbed.report.film import EDGE, FOOT, HEAD, Film
from testbed.run import film as film_of_a_run
from testbed.run.film import FilmError, make_film

SCENARIO = load(find("hold"))
T = np.arange(0.0, 10.0, 0.1)
WIDTH = 400
ORANGE, PALE, RED = (240, 160, 32), (166, 202, 229), (198, 40, 40)


def history() -> History:
    """A vehicle at 0.2 m/s along x from -1 m; jet 1 is open from 5 s on."""
    n, none = len(T), np.full((len(T), 3), np.nan)
    on = np.zeros((n, 8))
    on[50:, 0] = 0.1
    pose = np.column_stack((0.2 * T - 1.0, np.zeros(n), np.zeros(n)))
    vehicle = VehicleHistory(
        t=T, at=T, pose=pose, twist=np.zeros((n, 3)), seen=np.zeros((0, 4)),
        reference=none, force_asked=none[:, :2],
        commanded_wrench=none, realised_wrench=none, on=on, offset=np.zeros((n, 8)),
        supply=np.zeros(n), tank=np.zeros(n), pose_age=np.zeros(n), filtered=np.zeros((n, 2)),
        events=[], edges=np.zeros((0, 2)), wires=np.zeros((0, 5)), true=np.zeros((0, 6)),
    )  # fmt: skip
    return History({"sat1": vehicle}, np.zeros(0), {}, np.zeros((0, 3)))


@pytest.fixture(scope="module")
def film():
    told = [EventLine(5.0, ("sat1",), "CRITICAL", "hit the table's left edge")]
    return Film(SCENARIO, history(), told, WIDTH)


def near(picture, colour) -> np.ndarray:
    """Where the picture has about this colour."""
    return np.abs(np.asarray(picture).astype(int) - np.array(colour)).max(axis=-1) < 30


def column(x: float) -> int:
    """Pixel of a place on the table."""
    return round(EDGE + (x + 3.0) / 6.0 * (WIDTH - 2 * EDGE))


def test_the_vehicle_is_where_it_was(film):
    for t, x in ((0.0, -1.0), (5.0, 0.0), (9.0, 0.8)):
        body = near(film.frame(t), PALE)[HEAD:-FOOT].sum(axis=0)
        assert body.sum() > 100
        assert np.average(np.arange(WIDTH), weights=body) == pytest.approx(column(x), abs=7)


def test_a_plume_is_drawn_while_the_jet_is_open(film):
    assert not near(film.frame(3.0), ORANGE).any()
    assert near(film.frame(7.0), ORANGE).sum() > 10


def test_an_event_is_told_when_it_happens(film):
    def words(t):
        return near(film.frame(t), RED)[-FOOT:].sum()

    assert words(4.9) == 0
    assert words(5.1) > 30
    assert words(9.9) == 0  # some seconds later it is gone
    assert near(film.frame(0.0), RED)[HEAD - 20 : HEAD].any()  # its mark on the time line


def test_a_gif_has_all_frames(film, tmp_path):
    path = tmp_path / "film.gif"
    film_of_a_run._gif(film.frames(film.times(5.0, 10.0)), film.palette(64), path)
    with Image.open(path) as made:
        assert made.n_frames == 21  # 2 s at 10 frames per second
        assert made.size == film.size
        made.seek(20)
        assert near(made.convert("RGB"), ORANGE).sum() > 10


def test_a_name_that_is_no_film(tmp_path):
    with pytest.raises(FilmError, match=r"\.gif or \.mp4"):
        make_film(tmp_path, tmp_path / "film.avi", None, 400)


def test_an_mp4_needs_ffmpeg(tmp_path, monkeypatch):
    monkeypatch.setattr(film_of_a_run.shutil, "which", lambda name: None)
    with pytest.raises(FilmError, match="apt install ffmpeg"):
        make_film(tmp_path, tmp_path / "film.mp4", None, 400)


def test_an_mp4_is_what_ffmpeg_makes_of_the_frames(film, tmp_path):
    """A stand-in keeps what it is sent; the real program is not on every machine."""
    tool = tmp_path / "ffmpeg"
    tool.write_text('#!/bin/sh\nfor last; do :; done\ncat > "$last"\n')
    tool.chmod(0o755)
    path = tmp_path / "film.mp4"
    film_of_a_run._mp4(str(tool), film.frames(film.times(5.0, 2.0)), film.size, path)
    width, height = film.size
    assert path.stat().st_size == 5 * 3 * width * height
    tool.write_text("#!/bin/sh\necho no room >&2\nexit 1\n")
    with pytest.raises(FilmError, match="no room"):
        film_of_a_run._mp4(str(tool), film.frames(film.times(5.0, 2.0)), film.size, path)
