"""A film beside a camera's video: which picture of the camera stands beside which time."""

import json
import stat

import numpy as np
import pytest

pytest.importorskip("PIL")
from click.testing import CliRunner
from PIL import Image

from testbed.cli.main import main
from testbed.run import camera_video
from testbed.run.camera_video import CameraVideo
from testbed.run.film import FilmError

COLOURS = [(200, 20, 20), (20, 200, 20), (20, 20, 200)]
SHOWN_MS = [1000, 3000, 500]  # the camera dropped frames during the second


@pytest.fixture
def video(tmp_path):
    first, *more = (Image.new("RGB", (64, 48), colour) for colour in COLOURS)
    path = tmp_path / "camera.gif"
    first.save(path, save_all=True, append_images=more, duration=SHOWN_MS)
    return path


def colour(picture):
    return None if picture is None else tuple(np.asarray(picture)[24, 32] // 20 * 20)


def test_a_frame_is_shown_from_its_time_stamp_until_the_next(video):
    camera = CameraVideo(video, 48)
    times = [-0.5, 0.0, 0.9, 1.0, 3.9, 4.0, 4.4, 4.6]
    found = [colour(one) for one in camera.at(times)]
    red, green, blue = COLOURS
    assert found == [None, red, red, green, green, blue, blue, None]
    assert camera.size == (64, 48)


def test_a_film_with_the_video_at_its_right(video, tmp_path):
    runner, run, out = CliRunner(), str(tmp_path / "run"), str(tmp_path / "both.gif")
    runner.invoke(main, ["run", "hold", "duration_s=6", "criteria={}", "--out", run])
    words = ["film", run, "--out", out, "--width", "240", "--video", str(video)]
    done = runner.invoke(main, [*words, "--offset", "1.5"])
    assert done.exit_code == 0, done.output
    with Image.open(out) as made:
        width, height = made.size
        assert width > 240  # the camera's part
        beside = 240 + (width - 240) // 2, height // 3
        end = 6.0 - 0.1
        for t, expected in ((0.5, None), (2.0, 0), (4.0, 1), (5.8, 2)):
            made.seek(round(t / end * (made.n_frames - 1)))
            pixel = np.array(made.convert("RGB").getpixel(beside))
            if expected is None:
                assert pixel.min() > 200  # no picture yet
            else:
                assert np.abs(pixel - COLOURS[expected]).max() < 30, t
    late = runner.invoke(main, [*words, "--offset", "100"])
    assert late.exit_code == 2
    assert "--offset 100" in late.output


def test_other_videos_need_ffmpeg(tmp_path, monkeypatch):
    path = tmp_path / "camera.mp4"
    path.write_bytes(b"")
    monkeypatch.setattr(camera_video.shutil, "which", lambda name: None)
    with pytest.raises(FilmError, match=r"(?s)reads \.mp4.*apt install ffmpeg"):
        CameraVideo(path, 48)


def test_ffmpeg_is_asked_for_frames_of_the_right_size(tmp_path, monkeypatch):
    """Stand-ins answer as the programs do; the real ones are not on every machine."""
    size = json.dumps({"streams": [{"width": 640, "height": 480}]})
    raw = tmp_path / "raw"
    raw.write_bytes(b"".join(bytes(one) * (64 * 48) for one in COLOURS))
    for name, line in (("ffprobe", f"echo '{size}'"), ("ffmpeg", f"cat {raw}")):
        tool = tmp_path / name
        tool.write_text(f"#!/bin/sh\n{line}\n")
        tool.chmod(tool.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setattr(camera_video.shutil, "which", lambda name: str(tmp_path / name))
    camera = CameraVideo(tmp_path / "camera.mp4", 48)
    assert camera.size == (64, 48)
    found = [colour(one) for one in camera.at([0.0, 1 / 30, 2 / 30, 1.0])]
    assert found == [*COLOURS, None]
    raw.write_bytes(b"")
    with pytest.raises(FilmError, match="no frame in it"):
        list(camera.at([0.0]))
