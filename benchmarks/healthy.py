"""Do random healthy vehicles fly on? Every stop of a healthy vehicle is false.

    python benchmarks/healthy.py [--flights 200] [--seed 0] [--jobs 1] [--centre 100] [--show 17]
                                 [--labs ring] [--lasts 30]

Flight k of a seed is always the same. Drawn are the valves' opening delay and shortest pulse, the
thrust, the mass, the cameras' rate and noise, the table's slope, the spread of the thrust, losses
of 60 ms of the cameras, and losses of the radio; `RANGES` has the limits. Two vehicles fly the
start of zhang2023's experiment or one vehicle moves a metre and turns a radian. With `--centre` the
centre of mass is up to so many millimetres off the origin on each axis, as the file says. With
`--labs` the vehicles and cameras are those of labs.py instead.

Prints each false stop, contact, compensated jet and named cause of motion (a healthy vehicle has
none) with the corner of the ranges in which it lies, then a count by cause. `--show K` prints the
command that repeats flight K.
"""

import argparse
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np
from labs import LAYOUTS, lab

from testbed.config import ConfigError, find, load
from testbed.flight.hypotheses import CAUSES
from testbed.rig.twin import make_twin
from testbed.run.drill import Notes

RANGES = {  # name: low, high
    "open delay [ms]": (5.0, 60.0),
    "min_on [ms]": (5.0, 40.0),
    "thrust [N]": (0.1, 1.5),
    "mass [kg]": (8.0, 25.0),
    "camera [Hz]": (50.0, 240.0),
    "noise [mm]": (0.1, 1.0),
    "tilt [mm/s^2]": (0.0, 20.0),
    "spread [%]": (0.0, 20.0),
    "cameras lost [%]": (0.0, 20.0),
    "radio lost [%]": (0.0, 40.0),
}
METRE = ["vehicles.sat1.start=[-0.5,-0.5,0.0]", "vehicles.sat1.goal=[0.5,0.5,1.0]"]
LOSS_S = 0.06  # mean length of a loss of the cameras
LASTS_S = 30.0
HOLDS = 0.5  # largest share of the jets' force that the slope and an unequal pair may take
EDGE = 0.1  # of a range: nearer to an end than that is in the corner


class Flown(NamedTuple):
    """One flight."""

    number: int
    drawn: dict[str, float]
    cause: str  # id of the fault; "": none
    text: str
    contacts: int
    jets: str = ""  # that were named and compensated, although they are healthy
    warned: tuple[str, ...] = ()  # rows that named a cause of motion, although there is none


def draw(seed: int, number: int) -> dict[str, float]:
    """A healthy vehicle, table and lab; one that the slope would carry away is drawn again."""
    rng = np.random.default_rng([seed, number])
    while True:
        drawn = {name: float(rng.uniform(*limits)) for name, limits in RANGES.items()}
        # uniform in the logarithm: 0.1 to 0.4 N are as frequent as 0.4 to 1.5 N
        low, high = np.log(RANGES["thrust [N]"])
        drawn["thrust [N]"] = float(np.exp(rng.uniform(low, high)))
        spread = 1.0 - 2e-2 * drawn["spread [%]"]
        force = 2.0 * drawn["thrust [N]"] * spread
        if 1e-3 * drawn["tilt [mm/s^2]"] * drawn["mass [kg]"] < HOLDS * force:
            return drawn


def overrides_of(drawn: dict[str, float], number: int, lasts: float, centre: float) -> list[str]:
    """What differs from the shipped files, as for `testbed run`."""
    rng = np.random.default_rng(number)
    way = rng.uniform(0.0, 2.0 * np.pi)
    tilt = 1e-3 * drawn["tilt [mm/s^2]"]
    opens, mass = 1e-3 * drawn["open delay [ms]"], drawn["mass [kg]"]
    lost, radio = 1e-2 * drawn["cameras lost [%]"], 1e-2 * drawn["radio lost [%]"]
    model = "vehicles.*.model"
    numbers = {
        f"{model}.valve.open_delay_s": opens,
        f"{model}.valve.close_delay_s": opens * rng.uniform(0.5, 1.0),
        f"{model}.valve.min_on_s": 1e-3 * drawn["min_on [ms]"],
        f"{model}.jets.*.thrust": drawn["thrust [N]"],
        f"{model}.mass": mass,
        f"{model}.inertia": 0.016 * mass,  # of the shipped vehicle: a radius of gyration of 13 cm
        f"{model}.tolerance.thrust": 1e-2 * drawn["spread [%]"],
        "table.mocap.rate_hz": drawn["camera [Hz]"],
        "table.mocap.noise": 1e-3 * drawn["noise [mm]"],
        "table.mocap.noise_deg": 0.15 * drawn["noise [mm]"],  # as of the shipped cameras
        "table.mocap.dropout_s": LOSS_S,
        "table.mocap.dropout_rate": lost / (1.0 - lost) / LOSS_S,
        "table.link.loss": radio,
        "table.link.burst_loss": max(0.5, radio),
    }
    words = [f"{key}={value:.6g}" for key, value in numbers.items()]
    x, y = 1e-3 * centre * rng.uniform(-1.0, 1.0, 2)
    words.append(f"{model}.com=[{x:.6g},{y:.6g}]")
    words.append(f"table.tilt.uniform=[{tilt * np.cos(way):.6g},{tilt * np.sin(way):.6g}]")
    if number % 3:
        words += METRE
    return [*words, f"duration_s={lasts:g}", f"seed={number}"]


def prepared(number: int, options: argparse.Namespace) -> tuple[str, list[str], dict[str, float]]:
    """The experiment of a flight, what differs from its file, and what was drawn from `RANGES`."""
    if options.labs:
        words = [*METRE, f"duration_s={options.lasts:g}", f"seed={number}"]
        return "hold", [*lab(options.labs, options.seed, number), *words], {}
    drawn = draw(options.seed, number)
    name = "hold" if number % 3 else "zhang2023_table_wrench"
    return name, overrides_of(drawn, number, options.lasts, options.centre), drawn


def fly(number: int, options: argparse.Namespace) -> Flown:
    """One flight."""
    name, words, drawn = prepared(number, options)
    try:
        experiment = load(find(name), words)
        rig, notes = make_twin(experiment), Notes()
        ending = rig.fly(notes)
    except ConfigError as error:
        return Flown(number, drawn, "refused", str(error).replace("\n", " "), 0)
    fault = ending.fault
    text = "" if fault is None else f"{ending.t:.1f} s: {fault.words}"
    jets = ", ".join(
        f"{name}: jet {k} {jet.words}"
        for name in experiment.vehicles
        for k, jet in enumerate(rig.jets(name), 1)
        if jet.words
    )
    words = {detector.words for detector in CAUSES}
    causes = {name for name, row in experiment.faults.items() if row.detector in words}
    warned = tuple(sorted({row for _, _, row in notes.rows} & causes))
    cause = "" if fault is None else fault.id
    return Flown(number, drawn, cause, text, len(rig.touches), jets, warned)


def corner(drawn: dict[str, float]) -> str:
    """The values near an end of their range."""
    near = [
        f"{name} {value:.3g}"
        for name, value in drawn.items()
        if min(value - RANGES[name][0], RANGES[name][1] - value) < EDGE * np.ptp(RANGES[name])
    ]
    return ", ".join(near) or "no corner"


def main() -> int:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flights", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--lasts", type=float, default=LASTS_S, help="of a flight [s]")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--centre", type=float, default=0.0, help="off the origin, at most [mm]")
    parser.add_argument("--show", type=int)
    parser.add_argument("--labs", choices=LAYOUTS, default="", help="layout of the jets")
    options = parser.parse_args()
    if options.show is not None:
        name, words, _ = prepared(options.show, options)
        print(f"testbed run {name} " + " ".join(f"'{word}'" for word in words))
        return 0
    numbers = range(options.flights)
    flown_as = partial(fly, options=options)
    if options.jobs == 1:
        flown = list(map(flown_as, numbers))
    else:
        with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
            flown = list(pool.map(flown_as, numbers, chunksize=4))
    for one in flown:
        if one.cause or one.contacts:
            print(f"{one.number}: {one.contacts} contacts, {one.text}\n    {corner(one.drawn)}")
        if one.jets:
            print(f"{one.number}: {one.jets}\n    {corner(one.drawn)}")
        if one.warned:
            print(f"{one.number}: {', '.join(one.warned)}\n    {corner(one.drawn)}")
    causes = Counter(one.cause for one in flown if one.cause)
    contacts = sum(one.contacts for one in flown)
    named = sum(bool(one.jets) for one in flown)
    print(
        f"{len(flown)} flights, {sum(causes.values())} false stops, {contacts} contacts,"
        f" {named} in which a healthy jet was compensated,"
        f" {sum(bool(one.warned) for one in flown)} in which a cause of motion was named"
    )
    for cause, count in causes.most_common():
        print(f"  {cause}: {count}")
    return int(bool(causes) or contacts > 0)


if __name__ == "__main__":
    sys.exit(main())
