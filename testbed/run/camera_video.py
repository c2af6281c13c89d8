"""A camera's video, frame by frame at given times of the video.

GIF, WebP and APNG are read by Pillow, everything else by the programs ffmpeg and ffprobe. A frame
is shown from its own time stamp until that of the next, so a camera that
drops frames stays in step.
"""

import json
import shutil
import subprocess
import tempfile
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path
from typing import Any

from testbed.report.film import FilmError

BY_PILLOW = (".gif", ".webp", ".png", ".apng")
Stamped = Generator[tuple[float, Any, float], None, None]

RATE = 30.0  # frames per second at which ffmpeg gives the video


class CameraVideo:
    """A video, scaled to a height.

    Args:
        path: the file.
        height: of its frames [px].
    """

    def __init__(self, path: Path, height: int) -> None:
        self._path = path
        if path.suffix.lower() in BY_PILLOW:
            with self._opened() as first:
                width, tall = first.size
        else:
            self._ffmpeg, width, tall = _program("ffmpeg", path), *_size(path)
        self.size = max(2, round(width * height / tall / 2) * 2), height

    def at(self, times: Sequence[float]) -> Iterator[Any]:
        """A picture per time of the video, in order of time [s]; None before and after it."""
        frames = self._stamped()
        shown, now, following = None, None, next(frames, None)
        for t in times:
            while following is not None and following[0] <= t + 1e-6:
                now, shown = following, following[1]
                following = next(frames, None)
            ended = following is None and (now is None or t > now[2] + 1e-6)
            yield None if ended else shown
        frames.close()

    def _stamped(self) -> Stamped:
        """Time stamp, picture and end of each frame."""
        by_pillow = self._path.suffix.lower() in BY_PILLOW
        return self._pillow_frames() if by_pillow else self._ffmpeg_frames()

    def _opened(self) -> Any:
        from PIL import Image

        try:
            return Image.open(self._path)
        except OSError as error:
            raise _unreadable(self._path, str(error)) from None

    def _pillow_frames(self) -> Stamped:
        from PIL import ImageSequence

        t = 0.0
        with self._opened() as video:
            for frame in ImageSequence.Iterator(video):
                end = t + frame.info.get("duration", 100) / 1e3
                yield t, frame.convert("RGB").resize(self.size), end
                t = end

    def _ffmpeg_frames(self) -> Stamped:
        from PIL import Image

        width, height = self.size
        command = [
            self._ffmpeg, "-nostdin", "-loglevel", "error", "-i", str(self._path), "-vf",
            f"fps={RATE:g},scale={width}:{height}", "-f", "rawvideo", "-pix_fmt", "rgb24", "-",
        ]  # fmt: skip
        with tempfile.TemporaryFile() as stderr:
            reader = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr)
            assert reader.stdout is not None
            count = 0
            try:
                while len(data := reader.stdout.read(3 * width * height)) == 3 * width * height:
                    picture = Image.frombytes("RGB", self.size, data)
                    yield count / RATE, picture, (count + 1) / RATE
                    count += 1
                if reader.wait() or not count:
                    stderr.seek(0)
                    raise _unreadable(self._path, stderr.read().decode(errors="replace").strip())
            finally:
                reader.kill()
                reader.wait()
                reader.stdout.close()


def _program(name: str, path: Path) -> str:
    found = shutil.which(name)
    if found is None:
        raise FilmError(
            where=str(path), found="none",
            expected=f"the program {name}, which reads {path.suffix or 'such a file'}; on Debian "
            "`apt install ffmpeg`, or give the video as .gif or .webp",
        )  # fmt: skip
    return found


def _size(path: Path) -> tuple[int, int]:
    """Width and height of a video, as it is shown."""
    command = [_program("ffprobe", path), "-v", "error", "-select_streams", "v:0", "-show_entries",
               "stream=width,height", "-of", "json", str(path)]  # fmt: skip
    done = subprocess.run(command, capture_output=True, check=False)
    try:
        stream = json.loads(done.stdout)["streams"][0]
        return int(stream["width"]), int(stream["height"])
    except (ValueError, KeyError, IndexError):
        raise _unreadable(path, done.stderr.decode(errors="replace").strip()) from None


def _unreadable(path: Path, why: str) -> FilmError:
    return FilmError(where=str(path), expected="a video", found=why or "no frame in it")
