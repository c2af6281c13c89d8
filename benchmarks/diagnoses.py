"""Are the faults of a lab noticed, and are they named right? On the twin.

    python benchmarks/diagnoses.py [--each 40] [--only leak_valve,hose] [--seed 0] [--jobs 1]
                                   [--labs ring] [--set KEY=VALUE]

Flies every fault of `FAULTS` in flights of one vehicle that moves a metre and turns a radian, and
of zhang2023's three vehicles; with `--labs` in flights of one vehicle of another lab (labs.py).
Size, jet, direction and time are drawn. A fault of "believed wrong" is there from the start, all
others begin after 3 to 9 s.

not asked flights in which a weak jet was commanded too little to show
noticed   a row of the fault table holds that fault-free flights do not show
named     the first such row that stops or, if none stops, the first one is the right one; of a jet,
          the words must say its number
unclear   the words name the right fault beside another one; counts as named
contacts  flights with a contact before the first response
fell      the response: warn, hold, brake, land
"""

import argparse
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np
from labs import LAYOUTS, lab
from msgspec.structs import replace

from testbed.config import find, load
from testbed.core.codes import Response
from testbed.core.fault_injection import Injection
from testbed.faults.drill import ASKED, ROUTINE
from testbed.rig.twin import make_twin
from testbed.run.drill import Notes

METRE = ["vehicles.sat1.start=[-0.5,-0.5,0.0]", "vehicles.sat1.goal=[0.5,0.5,1.0]"]
EXPERIMENTS = (("hold", METRE), ("zhang2023_table", []))
WHEN = (3.0, 9.0)  # [s]


class Fault(NamedTuple):
    """A fault of a lab."""

    kind: str  # of the injection
    sizes: tuple[float, float]
    right: tuple[str, ...]  # rows that name it
    words: str = ""  # that the report must have; {jet}: the number of the jet
    either: tuple[str, ...] = ()  # rows that name it beside another fault
    lasts_s: float = 30.0
    from_start: bool = False
    watched: bool = False  # with reference bodies on the table


LEAKS = ("valve_leaks", "valve_stuck_open")
SCALE = ("thrust_or_mass",)
FRAME = ("frame_shifted", "frame_moved")
FIXED = "table.lab.mocap.reference={north=[0.0,2.9,0.0],east=[2.9,0.0,0.0]}"
FAULTS = {
    "leak 10-30 %": Fault("leak_valve", (0.1, 0.3), LEAKS, "jet {jet} ", ("valve_leaks_or_weak",)),
    "leak 30-60 %": Fault("leak_valve", (0.3, 0.6), LEAKS, "jet {jet} ", ("valve_leaks_or_weak",)),
    "stuck open": Fault("leak_valve", (0.8, 1.0), LEAKS, "jet {jet} "),
    "half open": Fault("half_open", (0.3, 0.7), LEAKS, "jet {jet} ", ("valve_leaks_or_weak",)),
    "weak 60-80 %": Fault("weak_jet", (0.6, 0.8), ("jet_weak",), "", ("valve_stuck_closed",), 60.0),
    "weak 20-60 %": Fault(
        "weak_jet",
        (0.2, 0.6),
        ("valve_stuck_closed",),
        "jet {jet} ",
        ("valve_leaks_or_weak", "jet_weak"),
        60.0,
    ),
    "dead": Fault(
        "stick_closed",
        (0.0, 0.0),
        ("valve_stuck_closed",),
        "jet {jet} ",
        ("valve_leaks_or_weak",),
        60.0,
    ),
    "hose 0.05-0.3 N": Fault("hose", (0.05, 0.3), ("pulled", "pulled_hard")),
    "pad drag 1-3 N s/m": Fault("pad_drag", (1.0, 3.0), ("pads_drag",)),
    "regulator x1.3-2": Fault("regulator", (1.3, 2.0), ("supply_high",)),
    "regulator x0.3-0.65": Fault("regulator", (0.3, 0.65), ("supply_low",)),
    "thrust x0.5-0.7 of the file": Fault(
        "thrust", (0.5, 0.7), SCALE, "", (), 60.0, from_start=True
    ),
    "thrust x1.4-2 of the file": Fault("thrust", (1.4, 2.0), SCALE, "", (), 60.0, from_start=True),
    "mass x1.5-2 of the file": Fault("mass", (1.5, 2.0), SCALE, "", (), 60.0, from_start=True),
    "mass x0.5-0.7 of the file": Fault("mass", (0.5, 0.7), SCALE, "", (), 60.0, from_start=True),
    "frame shift 5-49 mm": Fault("shift_frame", (0.005, 0.049), FRAME, either=("poses_step_back",)),
    "frame turn 0.5-2 deg": Fault("turn_frame", (0.5, 2.0), FRAME, either=("heading_shifted",)),
    "frame shift, reference": Fault(
        "shift_frame", (0.006, 0.049), FRAME, either=("poses_step_back",), watched=True
    ),
    "frame creep, reference": Fault("creep_frame", (0.01, 0.03), FRAME, watched=True),
    "heading jump 2-5 deg": Fault("turn_body", (2.0, 5.0), ("heading_shifted",)),
    "heading off 6-19 deg": Fault(
        "turn_body",
        (6.0, 19.0),
        ("heading_off", "heading_may_be_off"),
        "",
        (),
        60.0,
        from_start=True,
    ),
    "poses 0.15-0.4 s late": Fault(
        "delay_mocap", (0.15, 0.4), ("poses_late",), either=("poses_step_back",)
    ),
    "late from the start": Fault("delay_mocap", (0.15, 0.4), ("poses_late",), from_start=True),
    "frozen, dither to 20 um": Fault("freeze_mocap", (1e-9, 2e-5), ("pose_frozen", "pose_quiet")),
    "4 Hz instead of 100": Fault("slow_mocap", (3.0, 10.0), ("pose_rate_low",)),
}


class Found(NamedTuple):
    """Result of a flight."""

    fault: str
    number: int
    noticed: bool
    named: bool
    unclear: bool
    contact: bool  # before the response
    asked: bool  # the jet was commanded for long enough to show
    after_s: float  # from the fault to the row that names it
    response: str
    words: str


def prepared(name, number, seed, layout, changes=()):
    """The experiment of a flight, with its fault; `layout` of another lab's jets, or ""."""
    fault = FAULTS[name]
    rng = np.random.default_rng([seed, list(FAULTS).index(name), number])
    low, high = fault.sizes
    size = float(np.exp(rng.uniform(np.log(low), np.log(high)))) if high else None
    at_s = 0.0 if fault.from_start else round(float(rng.uniform(*WHEN)), 4)
    jet, towards = rng.integers(1, 9), round(float(rng.uniform(-180.0, 180.0)), 1)
    shipped, overrides = EXPERIMENTS[0 if layout else number % len(EXPERIMENTS)]
    if layout:
        overrides = [*overrides, *lab(layout, seed, number)]
    lasts = fault.lasts_s + at_s
    overrides = [*overrides, *changes, f"seed={1000 + number}", f"duration_s={lasts}"]
    experiment = load(find(shipped), [*overrides, FIXED] if fault.watched else overrides)
    model = experiment.vehicles["sat1"].model
    jet = int(1 + (jet - 1) % len(model.jets))
    if layout and fault.kind == "hose":  # as strong beside the jets as on the shipped vehicle
        size = round(size * min(one.thrust for one in model.jets) / 0.6, 6)
    what = Injection(fault.kind, "sat1", at_s=at_s, value=size, jet=jet, towards_deg=towards)
    return replace(experiment, inject=[what])


def fly(name, number, seed, layout, changes=()):
    """Fly a case and judge it."""
    fault, experiment = FAULTS[name], prepared(name, number, seed, layout, changes)
    what = experiment.inject[0]
    rig, notes = make_twin(experiment), Notes()
    ending = rig.fly(notes)
    began = what.at_s or 0.0
    rows = [
        (t, row) for t, who, row in notes.rows
        if t >= began and row not in ROUTINE and (who == "sat1" or row in FRAME)
    ]  # fmt: skip
    report = ending.fault
    words = "" if report is None else report.words
    stopped = "" if report is None else report.origin.id
    first = rows[0][1] if rows else ""
    decided = stopped or first
    needed = fault.words.format(jet=what.jet)
    told = not stopped or needed in words
    right, either = decided in fault.right and told, decided in fault.either and told
    found_t = ending.t if ending.found_t is None else ending.found_t
    since = next((t for t, row in rows if row == decided), found_t)  # the run may name it itself
    answers = [t for t, _, one in notes.responses if t >= began and one != Response.WARN]
    until = min(answers, default=ending.t)
    contact = any(began <= touch.t <= until for touch in rig.touches)
    response = max((one for t, _, one in notes.responses if t >= began), default=Response.NONE)
    flowed = sum(on[what.jet - 1] for t, who, on in notes.asked if who == "sat1" and t > began)
    lacks = 1.0 - what.size if fault.kind in ("weak_jet", "stick_closed") else 0.0
    asked = bool(rows or stopped) or not lacks or 1e-6 * flowed > ASKED / lacks**2
    return Found(
        name, number, bool(rows or stopped), right or either, either, contact, asked, since - began,
        response.words, f"{what.size:.3g} jet {what.jet}: {decided}: {words}",
    )  # fmt: skip


def main():
    """Fly, print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--each", type=int, default=40)
    parser.add_argument("--only", default="", help="kinds of injections, or parts of names")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--labs", choices=LAYOUTS, default="", help="layout of the jets")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="changes")
    options = parser.parse_args()
    wanted = options.only.split(",")
    names = [n for n, f in FAULTS.items() if any(w in n or w == f.kind for w in wanted)]
    always = options.seed, options.labs, options.changes
    cases = [(name, k, *always) for name in names for k in range(options.each)]
    if options.jobs == 1:
        found = [fly(*case) for case in cases]
    else:
        with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
            found = list(pool.map(fly, *zip(*cases, strict=True), chunksize=4))
    for one in found:
        if (one.asked and not one.named) or one.contact:
            print(f"{one.fault} {one.number}: {one.response}: {one.words}")
    heads = "fault", "flights", "not asked", "noticed", "named", "unclear", "contacts"
    print("|", " | ".join((*heads, "median [s]", "worst [s]", "fell")), "|")
    print("|---" * (len(heads) + 3) + "|")
    for name in names:
        own = [one for one in found if one.fault == name]
        counts = [
            len(own), sum(not o.asked for o in own), sum(o.noticed for o in own),
            sum(o.named for o in own), sum(o.unclear for o in own), sum(o.contact for o in own),
        ]  # fmt: skip
        after = [one.after_s for one in own if one.named]
        times = [f"{np.median(after):.2f}", f"{max(after):.2f}"] if after else ["-", "-"]
        responses = Counter(one.response or "none" for one in own)
        fell = ", ".join(f"{what} {count}" for what, count in responses.items())
        print("|", " | ".join([name, *map(str, counts), *times, fell]), "|")
    return int(not all(one.named or not one.asked for one in found))


if __name__ == "__main__":
    sys.exit(main())
