"""Makes a film of a run folder: GIF, or MP4 where the program ffmpeg is installed."""

import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from testbed.config import load
from testbed.logs.log_reader import config_of, log_of
from testbed.report.events import lines
from testbed.report.film import Film, FilmError
from testbed.run.camera_video import CameraVideo
from testbed.run.recorded import recorded

RATE = 15.0  # frames per second
LENGTH_S = 30.0  # of a film whose speed is not given, if the run is longer
COLOURS = 64  # of a GIF
SAMPLES = 6  # pictures of a camera that choose the colours of a GIF


def make_film(
    run: Path, out: Path | None, speed: float | None, width: int,
    warn: Callable[[list[str]], None] = lambda lines: None,
    video: Path | None = None, offset: float = 0.0,
    watch: Callable[[Iterator[Any], int], Iterator[Any]] = lambda frames, count: frames,
) -> Path:  # fmt: skip
    """Write the film; returns its path.

    Args:
        run: run folder.
        out: *.gif or *.mp4; None: in the run folder, MP4 if ffmpeg is installed.
        speed: multiple of real time; None: at most LENGTH_S long.
        width: of the picture [px].
        warn: called with a line for each part of the log that is missing.
        video: a camera's video, shown at the right.
        offset: time of the run at which the video begins [s].
        watch: passes the frames on, of which there are so many, to show progress.
    """
    ffmpeg = shutil.which("ffmpeg")
    path = out or run / ("film.mp4" if ffmpeg else "film.gif")
    if path.suffix not in (".gif", ".mp4"):
        raise FilmError(
            where=str(path), expected="a name that ends in .gif or .mp4", found=path.suffix
        )
    if path.suffix == ".mp4" and ffmpeg is None:
        raise FilmError(where=str(path), expected="the program ffmpeg, which writes MP4; on Debian"
                        " `apt install ffmpeg`, or choose .gif", found="none")  # fmt: skip
    log, experiment = log_of(run), load(config_of(run))
    history, metrics, _ = recorded(log, experiment, warn)
    events = lines(experiment, history, metrics.touches)
    film = Film(experiment, history, events, width - width % 2)
    times = film.times(speed or max(1.0, film.end / LENGTH_S), RATE)
    frames, size = film.frames(times), film.size
    samples: list[Any] = []
    if video is not None:
        camera = CameraVideo(video, film.size[1])
        wide, places = camera.size[0], [t - offset for t in times]
        samples = [one for one in camera.at(places[:: max(1, len(places) // SAMPLES)]) if one]
        if not samples:
            raise FilmError(where=str(video), expected=f"pictures of the run's 0 to {film.end:g} s",
                            found=f"none with --offset {offset:g}")  # fmt: skip
        frames = (film.beside(one, seen, wide)
                  for one, seen in zip(frames, camera.at(places), strict=True))  # fmt: skip
        size = size[0] + wide, size[1]
    frames = watch(frames, len(times))
    if path.suffix == ".gif":
        _gif(frames, film.palette(COLOURS if video is None else 256, samples), path)
    else:
        _mp4(str(ffmpeg), frames, size, path)
    return path


def _gif(frames: Iterator[Any], palette: Any, path: Path) -> None:
    made = (one.quantize(palette=palette, dither=0) for one in frames)
    next(made).save(path, save_all=True, append_images=made, duration=round(1000 / RATE), loop=0)


def _mp4(ffmpeg: str, frames: Iterator[Any], size: tuple[int, int], path: Path) -> None:
    command = [
        ffmpeg, "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24",
        "-s", f"{size[0]}x{size[1]}", "-r", f"{RATE:g}", "-i", "-", "-pix_fmt", "yuv420p",
        "-movflags", "+faststart", str(path),
    ]  # fmt: skip
    with tempfile.TemporaryFile() as stderr:
        writer = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=stderr)
        assert writer.stdin is not None
        with suppress(BrokenPipeError):  # it says why on its standard error
            for one in frames:
                writer.stdin.write(one.tobytes())
        with suppress(BrokenPipeError):
            writer.stdin.close()
        if writer.wait():
            stderr.seek(0)
            raise FilmError(where=str(path), expected="ffmpeg to write it",
                            found=stderr.read().decode(errors="replace").strip())  # fmt: skip
