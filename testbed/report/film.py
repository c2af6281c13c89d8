"""A film of a run, frame by frame: the table with vehicles, plumes, trails and events."""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from typing import Any

from testbed.config.experiment import Experiment
from testbed.core.error import TestbedError
from testbed.core.extra import pip_install
from testbed.logs.history import History
from testbed.report.chart import THEME
from testbed.report.fault_story import RANK, EventLine
from testbed.report.goal_error import GoalError
from testbed.report.item import HUES
from testbed.report.scrubber import FULL, flight_data

try:
    from PIL import Image, ImageDraw, ImageFont
except ImportError:  # an optional extra; `Film` says so
    Image = None  # type: ignore[assignment]

COLOURS = dict(re.findall(r"--(\w+): (#\w+)", THEME.partition("}")[0]))  # of the light theme
PLUME, PLUME_M, GRANITE = "#f0a020", 0.3, "#b4bac4"
TRAIL_S = 20.0
TOLD_S = 4.0  # for which an event is shown
HEAD, FOOT, EDGE = 64, 40, 16  # heights of the strips, and margin [px]
FINE = 2  # drawn so many times larger, then reduced: smooth lines


class FilmError(TestbedError):
    """The film cannot be made."""


class Film:
    """Frames of one run."""

    def __init__(
        self, scenario: Experiment, history: History, events: Sequence[EventLine], width: int
    ) -> None:
        if Image is None:
            raise FilmError(f"a film needs Pillow: {pip_install('film')}")
        self._scenario, self._events = scenario, events
        self._data = flight_data(scenario, history, events)
        self.end: float = self._data["end"]
        self._scale = FINE * (width - 2 * EDGE) / scenario.table.size[0]  # pixels per metre
        high = round(scenario.table.size[1] * self._scale / FINE)
        self.size = width, (HEAD + high + FOOT + 1) // 2 * 2  # even, as video codecs want
        self._still = self._background()

    def times(self, speed: float, rate: float) -> list[float]:
        """Times of all frames [s]; `speed` is a multiple of real time, `rate` in frames per s."""
        count = max(2, round(self.end / speed * rate) + 1)
        return [self.end * k / (count - 1) for k in range(count)]

    def frames(self, times: Iterable[float]) -> Iterator["Image.Image"]:
        """The frames at these times."""
        return map(self.frame, times)

    def palette(self, colours: int, beside: Sequence["Image.Image"] = ()) -> "Image.Image":
        """The colours of all frames and of pictures `beside` them, for a GIF."""
        height = self.size[1]
        shown = [self.frame(0.0), self.frame(self.end), *beside]
        widest = max(one.width for one in shown)
        sample = Image.new("RGB", (widest, len(shown) * height), COLOURS["paper"])
        for k, one in enumerate(shown):
            sample.paste(one, (0, k * height))
        pen, looks = ImageDraw.Draw(sample), [*COLOURS.values(), PLUME, GRANITE]
        for k, colour in enumerate(looks):  # of events and plumes that these two may not have
            pen.rectangle((20 * k, 0, 20 * k + 19, HEAD), fill=colour)
        return sample.quantize(colours)

    def frame(self, t: float) -> "Image.Image":
        """The picture at time t [s]."""
        picture = self._still.copy()
        pen = ImageDraw.Draw(picture)
        for rock in self._scenario.obstacles.values():
            if rock.velocity != (0.0, 0.0):
                x, y = (p + t * v for p, v in zip(rock.position, rock.velocity, strict=True))
                self._rock(pen, x, y, rock.radius, rock.solid)
        for car in self._data["vehicles"]:
            if car["x"]:
                self._car(pen, car, t)
        self._words(pen, t)
        return picture.reduce(FINE)

    def beside(self, frame: "Image.Image", camera: "Image.Image | None", wide: int) -> Any:
        """A frame with the camera's picture at its right; None: the camera has none then."""
        whole = Image.new("RGB", (frame.width + wide, frame.height), COLOURS["stone"])
        whole.paste(frame, (0, 0))
        if camera is not None:
            whole.paste(camera, (frame.width, 0))
        else:
            at = frame.width + wide // 2, frame.height // 2
            pen = ImageDraw.Draw(whole)
            pen.text(at, "no picture of the camera", COLOURS["soft"], font=_font(16), anchor="mm")
        return whole

    def _at(self, x: float, y: float) -> tuple[float, float]:
        half_x, half_y = (0.5 * side for side in self._scenario.table.size)
        return FINE * EDGE + (x + half_x) * self._scale, FINE * HEAD + (half_y - y) * self._scale

    def _disc(self, pen: Any, x: float, y: float, radius: float, **look: Any) -> None:
        (a, b), r = self._at(x, y), radius * self._scale
        pen.ellipse((a - r, b - r, a + r, b + r), **look)

    def _background(self) -> "Image.Image":
        width, height = self.size
        picture = Image.new("RGB", (FINE * width, FINE * height), COLOURS["paper"])
        pen, (w, h) = ImageDraw.Draw(picture), self._scenario.table.size
        corners = (self._at(-w / 2, h / 2), self._at(w / 2, -h / 2))
        pen.rectangle(corners, fill=COLOURS["stone"], outline=COLOURS["soft"], width=FINE)
        for x in range(math.ceil(-w / 2 + 0.01), math.ceil(w / 2)):
            pen.line((self._at(x, h / 2), self._at(x, -h / 2)), COLOURS["grid"], FINE)
        for y in range(math.ceil(-h / 2 + 0.01), math.ceil(h / 2)):
            pen.line((self._at(-w / 2, y), self._at(w / 2, y)), COLOURS["grid"], FINE)
        for rock in self._scenario.obstacles.values():
            if rock.velocity == (0.0, 0.0):
                self._rock(pen, *rock.position, rock.radius, rock.solid)
        for k, setup in enumerate(self._scenario.vehicles.values()):
            if setup.path is None and not GoalError(self._scenario).forms:
                (a, b), r = self._at(*setup.goal[:2]), 6 * FINE
                for line in ((a - r, b - r, a + r, b + r), (a - r, b + r, a + r, b - r)):
                    pen.line(line, COLOURS[f"h{k % HUES}"], 2 * FINE)
        name = self._scenario.name
        pen.text((FINE * EDGE, FINE * 10), name, COLOURS["ink"], font=_font(20 * FINE))
        return picture

    def _rock(self, pen: Any, x: float, y: float, radius: float, solid: float) -> None:
        self._disc(pen, x, y, radius, fill="#f6e3e3", outline=COLOURS["danger"], width=FINE)
        if solid > 0.0:
            self._disc(pen, x, y, solid, fill=GRANITE)

    def _car(self, pen: Any, car: dict[str, Any], t: float) -> None:
        step, last, hue = self._data["step"], len(car["x"]) - 1, COLOURS[f"h{car['hue']}"]
        s = min(max(t / step, 0.0), float(last))
        k = min(int(s), last)
        following, share = min(k + 1, last), s - k

        def mixed(key: str) -> float:
            return float(car[key][k] + share * (car[key][following] - car[key][k]))

        x, y, turn = mixed("x") / 1e3, mixed("y") / 1e3, math.radians(mixed("turn") / 1e2)
        first = max(0, k - round(TRAIL_S / step))
        trail = [self._at(car["x"][i] / 1e3, car["y"][i] / 1e3) for i in range(first, k + 1)]
        if len(trail) > 1:
            pen.line(trail, hue, 2 * FINE, joint="curve")
        cos, sin = math.cos(turn), math.sin(turn)

        def body(a: float, b: float) -> tuple[float, float]:
            return self._at(x + cos * a - sin * b, y + sin * a + cos * b)

        shares = car["on"][k * len(car["jets"]) : (k + 1) * len(car["jets"])]
        for (jx, jy, px, py), digit in zip(car["jets"], shares, strict=False):
            if digit != "0" and t <= car["end"] + step:
                long = (0.3 + 0.7 * math.sqrt(int(digit) / FULL)) * PLUME_M
                back = jx - long * px, jy - long * py
                pen.polygon((body(jx, jy), body(back[0] - 0.06 * py, back[1] + 0.06 * px),
                             body(back[0] + 0.06 * py, back[1] - 0.06 * px)), PLUME)  # fmt: skip
        self._disc(pen, x, y, car["radius"], fill=_pale(hue), outline=hue, width=2 * FINE)
        pen.line((body(0.0, 0.0), body(car["radius"], 0.0)), hue, 3 * FINE)
        name = self._at(x, y + car["radius"])
        pen.text(
            (name[0], name[1] - 4 * FINE), car["name"], hue, font=_font(14 * FINE), anchor="mb"
        )

    def _words(self, pen: Any, t: float) -> None:
        (width, height), clock = self.size, f"{t:.1f} s"
        at = FINE * (width - EDGE), FINE * 10
        pen.text(at, clock, COLOURS["ink"], font=_font(20 * FINE), anchor="ra")
        left, right, y = FINE * EDGE, FINE * (width - EDGE), FINE * (HEAD - 12)
        pen.line((left, y, right, y), COLOURS["grid"], 4 * FINE)
        pen.line((left, y, left + (right - left) * t / self.end, y), COLOURS["h0"], 4 * FINE)
        for one in self._events:
            if one.level in ("CRITICAL", "ERROR"):
                mark = left + (right - left) * min(1.0, one.t / self.end)
                pen.line((mark, y - 5 * FINE, mark, y + 5 * FINE), COLOURS["danger"], 2 * FINE)
        recent = [one for one in self._events if t - TOLD_S < one.t <= t + 1e-6]
        if not recent:
            return
        worst = min(recent, key=lambda one: RANK.index(one.level))
        colour = COLOURS[{"WARN": "warn", "INFO": "soft"}.get(worst.level, "danger")]
        words = f"{worst.t:.1f} s   {', '.join(worst.who)}: {worst.words}"
        font = _font(16 * FINE)
        while font.getlength(words) > FINE * (width - 2 * EDGE):
            words = words[:-5] + "..."
        pen.text((left, FINE * (height - FOOT // 2)), words, colour, font=font, anchor="lm")


@cache
def _font(size: int) -> Any:
    return ImageFont.load_default(size)


def _pale(colour: str) -> tuple[int, ...]:
    """A light shade of a colour."""
    return tuple(int(0.35 * int(colour[i : i + 2], 16) + 0.65 * 255) for i in (1, 3, 5))
