"""The scrubber of a report: the flight as data for report.js, and the bar to drag its time."""

from collections.abc import Sequence
from html import escape
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from testbed.config.experiment import Experiment
from testbed.logs.history import History, VehicleHistory
from testbed.report.fault_story import SUPERVISOR, EventLine
from testbed.report.item import HUES
from testbed.report.valves import openings

SAMPLES = 2400  # most samples of a vehicle; keeps the page small
LONGEST = 160  # characters of an event
FULL = 9  # of a digit: a jet that is open all the time


def flight_data(
    scenario: Experiment, history: History, events: Sequence[EventLine] = ()
) -> dict[str, Any]:
    """What report.js needs of a flight; positions in mm, headings in 0.01 deg."""
    period = scenario.flight.jet_period_s
    end = max(history.end + period, 1e-3)  # the plan of the last tick lasts a period
    step = max(period, end / SAMPLES)
    label = [one for one in events if one.t >= 0.0]
    bad = [one.t for one in label if one.level == "CRITICAL"]
    return {
        "end": round(end, 3), "step": step,
        "first": round(min(bad), 2) if bad else round(end, 3),  # shown when the page opens
        "obstacles": [
            {"at": rock.position, "velocity": rock.velocity, "radius": rock.radius,
             "solid": rock.solid}
            for rock in scenario.obstacles.values()
            if rock.velocity != (0.0, 0.0)
        ],
        "events": [
            [round(min(one.t, end), 2), one.level,
             "" if one.who == (SUPERVISOR,) else ", ".join(one.who), one.words[:LONGEST]]
            for one in label
        ],
        "vehicles": [
            vehicle_data(scenario, history, name, k, step)
            for k, name in enumerate(history.vehicles)
        ],
    }  # fmt: skip


def vehicle_data(
    scenario: Experiment, history: History, name: str, hue: int, step: float, style: str = ""
) -> dict[str, Any]:
    """One vehicle's poses and jets."""
    model, vehicle = scenario.vehicles[name].model, history.vehicles[name]
    t, state = history.where(name)
    end = float(t[-1]) if len(t) else 0.0
    at = np.arange(0.0, end + step, step) if len(t) else t
    return {
        "name": name, "hue": hue % HUES, "style": style, "radius": model.radius,
        "end": round(end, 3),
        "jets": [[*jet.position, *jet.push] for jet in model.jets],
        "x": _whole(1e3 * np.interp(at, t, state[:, 0])) if len(t) else [],
        "y": _whole(1e3 * np.interp(at, t, state[:, 1])) if len(t) else [],
        "turn": _whole(1e2 * np.degrees(np.interp(at, t, np.unwrap(state[:, 2]))))
        if len(t) else [],
        "on": "".join(map(str, _shares(vehicle, at, step, model.command_delay_s).ravel())),
    }  # fmt: skip


def _whole(values: NDArray[np.float64]) -> list[int]:
    return np.rint(values).astype(int).tolist()


def _shares(
    vehicle: VehicleHistory, at: NDArray[np.float64], step: float, delay: float
) -> NDArray[np.int64]:
    """How long each jet is open in each sample, 0 to FULL; a short pulse is at least 1."""
    edges, jets = np.append(at, at[-1] + step) if len(at) else np.zeros(1), vehicle.on.shape[1]
    found = np.zeros((len(at), jets))
    for jet in range(jets):
        start, length = openings(vehicle, jet, delay)
        open_s = (
            np.interp(edges, *_open_time(start, length)) if len(start) else np.zeros(len(edges))
        )
        found[:, jet] = np.diff(open_s)
    return np.ceil(FULL * np.clip(found / step, 0.0, 1.0) - 1e-9).astype(int)


def _open_time(
    start: NDArray[np.float64], length: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Total time open so far, at every opening and shutting."""
    total = np.concatenate([[0.0], np.cumsum(length)])
    return (
        np.maximum.accumulate(np.column_stack((start, start + length)).ravel()),
        np.column_stack((total[:-1], total[1:])).ravel(),
    )


def bar(data: dict[str, Any]) -> str:
    """The bar and the data, as HTML; report.js shows it."""
    end = data["end"]
    ticks = "".join(_tick(end, *one) for one in data["events"] if one[1] != "INFO")
    text = msgspec.json.encode(data).decode().replace("</", "<\\/")
    return (
        '<div id="scrub" class="scrub" hidden><button class="play" aria-label="Play">'
        "\N{BLACK RIGHT-POINTING TRIANGLE}</button>"
        '<select aria-label="Speed"><option value="1">1\N{MULTIPLICATION SIGN}</option>'
        '<option value="5" selected>5\N{MULTIPLICATION SIGN}</option>'
        '<option value="20">20\N{MULTIPLICATION SIGN}</option></select><output></output>'
        f'<div class="way"><input type="range" min="0" max="{end}" step="0.01"'
        f' aria-label="Time of the flight in seconds">{ticks}</div><div class="told"></div></div>'
        f'<script type="application/json" id="flight">{text}</script>'
    )


def _tick(end: float, t: float, level: str, who: str, words: str) -> str:
    """A button at the time of an event."""
    label, share = escape(f"{t:.1f} s {who}: {words}"), min(1.0, max(0.0, t / end))
    return (
        f'<button class="tick {level}" data-t="{t}" style="--at:{share:.4f}" title="{label}"'
        f' aria-label="{label}"></button>'
    )
