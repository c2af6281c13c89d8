"""The drill on the bench: all faults over real wires, judged from the boards' reports."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np
import tomli_w
from msgspec import Struct
from msgspec.structs import replace

from testbed.config import Experiment, dump
from testbed.core.codes import FaultReport, Response
from testbed.core.error import TestbedError
from testbed.core.fault_injection import Injection
from testbed.faults.catalogue import CATALOGUE, SOON
from testbed.faults.drill import (
    OTHERS,
    Drilled,
    answered,
    called,
    cases_of,
    concerned,
    dead_within,
    deadline,
    draw,
    names_of,
    refused,
    without_means,
)
from testbed.flight.arming import Check
from testbed.flight.loop import Ending
from testbed.metrics.afterwards import HARD
from testbed.net.commands import Ended
from testbed.realtime.wall_clock import monotonic_ns, sleep_until_ns
from testbed.rig.twin import warm_up
from testbed.rig.wired.table_report import TableReport
from testbed.run.drill import shipped, with_random_starts

EXPERIMENT = "zhang2023_table"
WHEN = (1.5, 4.0)  # [s]
LASTS = 6.0  # [s] of flight after an injection
LONGER = {"leak": 12.0, "stick_open": 10.0, "leak_valve": 20.0, "heading_jumps": 12.0}
LONGEST = 20.0  # a flight of a minute costs more than it shows
# kinds after which the vehicle's own process or board cannot act or report, while they last
MUTE = ("kill_process", "stop_process", "cut_serial", "brown_out")
FOR_GOOD = 60.0  # [s]
GRACE_S = 180.0
LONGEST_END = 8.0  # [s] for the vehicles to come to rest after the planned end
NOTHING = TableReport(
    None, [], [], [], {}, {}, {}, {}, {}, [], {}
)  # of a flight that did not start


class Flown(Struct, frozen=True):
    """The files that a flight left."""

    epoch_ns: int
    report: TableReport
    ended: dict[str, Ended]
    fault: FaultReport | None  # as reported by the host
    red: list[Check] = []  # why it did not start


def drill_wires(
    count: int, seed: int, notify: Callable[[str], None], name: str = EXPERIMENT
) -> Iterator[Drilled]:
    """Fly all cases in sequence, because a bench needs the whole machine."""
    warm_up(shipped(name))  # compiles once, before four processes would
    for number in range(count):
        try:
            judged = case(number, seed, name)
        except DrillError as error:  # try again: a flight that did not begin tests nothing
            notify(f"case {number}: {error}")
            judged = case(number, seed, name)
        notify(f"{number}: {msgspec.json.encode(judged).decode()}")
        yield judged


def case(number: int, seed: int, name: str = EXPERIMENT) -> Drilled:
    """Fly case `number`: the rows of the catalogue take turns, the rest is random."""
    rng = np.random.default_rng([seed, number])
    rows = cases_of("bench", len(shipped(name).vehicles))
    row = rows[number % len(rows)]
    begun = with_random_starts(name, rng)
    jets = min(len(setup.model.jets) for setup in begun.vehicles.values())
    what = draw(row, list(begun.vehicles), jets, begun.flight.jet_period_s, rng)
    at = round(float(rng.uniform(*WHEN)), 3)
    what = replace(what, at_s=at if what.at_s else 0.0)
    needed = CATALOGUE[row].flown_s
    lasts = LONGER.get(row, min(needed, LONGEST) if needed > SOON else LASTS)
    experiment = replace(
        begun, seed=int(rng.integers(2**31)), inject=[what],
        duration_s=round((what.at_s or 0.0) + lasts, 1),
    )  # fmt: skip
    with TemporaryDirectory(prefix="airbearing-drill-") as there:
        folder = Path(there)
        file = folder / "experiment.toml"
        file.write_text(tomli_w.dumps(dump(experiment)), encoding="utf-8")
        flown = fly(file, folder, list(experiment.vehicles), experiment.duration_s)
    if flown.red and not CATALOGUE[row].at_start:
        raise DrillError("; ".join(one.words for one in flown.red))
    if flown.red:
        return refused(row, experiment.name, what, experiment.seed, flown.red)
    return judge(what, experiment, flown, row)


class DrillError(TestbedError):
    """A flight of the drill did not begin."""


def fly(file: Path, folder: Path, names: list[str], duration_s: float) -> Flown:
    """Fly once; works even if the host dies or hangs."""
    words = [sys.executable, "-m", "testbed.rig.wired.fault_flight", str(file), str(folder)]
    host = subprocess.Popen(words, start_new_session=True, stderr=subprocess.PIPE)
    start, report = folder / "start.json", folder / "report.json"
    end = monotonic_ns() + round(1e9 * (duration_s + GRACE_S))
    over = None
    while monotonic_ns() < end and not report.exists():
        sleep_until_ns(monotonic_ns() + 50_000_000)
        if host.poll() is not None and not start.exists():
            break
        if start.exists() and over is None:
            epoch_ns = msgspec.json.decode(start.read_bytes())[0]
            over = epoch_ns + round(1e9 * (duration_s + LONGEST_END))
        if over is not None and monotonic_ns() > over:  # a stopped host does not end the flight
            with suppress(ProcessLookupError):
                host.kill()
    with suppress(subprocess.TimeoutExpired):
        host.wait(20.0)
    host.kill()
    _, said = host.communicate()
    ending = folder / "ending.json"
    if ending.exists():
        left = msgspec.json.decode(ending.read_bytes(), type=tuple[Ending, str, list[Check]])
        if left[2]:
            return Flown(0, NOTHING, {}, None, left[2])
    if not report.exists() or not start.exists():
        output = ending.read_text() if ending.exists() else said.decode()[-2000:]
        raise DrillError(f"the flight did not begin: {output}")
    ended = {
        name: msgspec.json.decode((folder / f"{name}.json").read_bytes(), type=Ended)
        for name in names
        if (folder / f"{name}.json").exists()
    }
    fault = left[0].fault if ending.exists() else None
    return Flown(
        msgspec.json.decode(start.read_bytes())[0],
        msgspec.json.decode(report.read_bytes(), type=TableReport), ended, fault,
    )  # fmt: skip


def judge(what: Injection, experiment: Experiment, flown: Flown, row: str = "") -> Drilled:
    """Judge the outcome of an injection; `row` of the catalogue, if not its kind."""
    names, flight = list(experiment.vehicles), experiment.flight
    began, report, listed = what.at_s or 0.0, flown.report, CATALOGUE[row or what.kind]
    wanted = (*listed.names, *listed.on_wires)
    noticed = (*wanted, *listed.answers)
    right = [
        (t, found) for one in flown.ended.values() for found, t in one.rows.items()
        if found in noticed and t >= began
    ]  # fmt: skip
    faults = [flown.fault, *(one.fault for one in flown.ended.values())]
    for fault in faults:
        if fault is not None:
            right += [(_said_at(flown, fault), w) for w in noticed if w in names_of(fault)]
    shut, late = 0.0, 0
    is_mute = what.kind in MUTE and what.for_s > FOR_GOOD
    is_silent = what.kind in OTHERS and what.for_s > FOR_GOOD
    own = [
        (t, one) for name, words in flown.ended.items() for one, t in words.responses.items()
        if t >= began and concerned(what, name, silent=is_silent)
    ]  # fmt: skip
    named, found = answered(right, own, began)
    end = max((one.t for one in flown.ended.values()), default=began)
    for name in names:
        severest, since = Response.NONE, began
        if (one := flown.ended.get(name)) is not None:
            responses = [r for r, t in one.responses.items() if t >= began]
            severest = max(responses, default=Response.NONE)
            since = one.responses.get(severest, began)
        limit = since + deadline(severest, flight.jet_period_s, flight.ending.brake_s)
        if is_mute and name == what.vehicle:
            limit = began + dead_within(flight.jet_period_s)
        closed, open_after = _closing(report.edges[name], flown.epoch_ns, limit)
        shut, late = max(shut, closed), late + open_after
    offset = 1e-9 * ((report.released_ns or 0) - flown.epoch_ns)
    touches = [
        touch for touch in report.touches
        if began <= touch.t + offset and (touch.t + offset <= end or touch.speed > HARD)
    ]  # fmt: skip
    after = report.after(names, end - offset)
    helpless = [
        touch for touch in touches
        if without_means(what, (touch.vehicle, touch.other))
        or (what.kind in MUTE and what.vehicle in (touch.vehicle, touch.other))
    ]  # fmt: skip
    adrift = len(helpless)
    over = any(fault is not None for fault in faults)
    early = sorted({o.fault.words for o in flown.ended.values() if o.fault and o.t < began})
    ended = next((fault for fault in faults if fault is not None), None)
    rows = [
        (t, one) for name, words in flown.ended.items() for one, t in words.rows.items()
        if t >= began and concerned(what, name, silent=is_silent)
    ]  # fmt: skip
    told, said, rightly = called(ended, rows, wanted, listed.alike)
    return Drilled(
        row or what.kind, experiment.name, what.vehicle, experiment.seed, began, named,
        found,
        max((one for _, one in own), default=Response.NONE),
        shut - began if over else None, late, len(touches) - adrift, _travelled(flown, began),
        ended, tuple(early), adrift,
        dormant=False,
        contacts_after=sum(t.t + offset > end and t not in helpless for t in touches),
        at_rest_s=after.at_rest_s, air=after.air, called=told, said=said, rightly=rightly,
    )  # fmt: skip


def _said_at(flown: Flown, fault: FaultReport) -> float:
    """When a vehicle's flight ended with this fault [s]; the end of the run for the host's."""
    at = [one.t for one in flown.ended.values() if one.fault == fault]
    return min(at, default=max((one.t for one in flown.ended.values()), default=0.0))


def _closing(edges: list[tuple[int, int]], epoch_ns: int, limit: float) -> tuple[float, int]:
    """When a board's last valve closed [s], and the number of valves open after the limit."""
    closed, mask, late = 0.0, 0, 0
    for at_us, new in edges:
        t = 1e-9 * (1000 * at_us - epoch_ns)
        if mask & ~new:
            closed = t
            if t > limit:
                late |= mask & ~new
        mask = new
    return closed, (late | mask).bit_count()


def _travelled(flown: Flown, began: float) -> float:
    """Largest distance of any vehicle from its position at `began` [m]."""
    report = flown.report
    t = np.array(report.t) + 1e-9 * ((report.released_ns or 0) - flown.epoch_ns)
    since = np.array(report.states)[t >= began, :, :2]
    if len(since) == 0:
        return 0.0
    return float(np.hypot(*(since - since[0]).transpose(2, 0, 1)).max())
