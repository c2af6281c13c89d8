"""`testbed commission` against planted errors, and against healthy set-ups, on the twin.

    python benchmarks/commission.py [--healthy 50] [--vehicles generic_8jet uky ...]

Every error is planted on every vehicle; it is named when a verdict says what is wrong. Prints what
was not named, false alarms, and the largest true speed.
"""

import argparse
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from msgspec.structs import replace

from testbed.commission.procedure import commission
from testbed.commission.station import BoardFacts
from testbed.commission.twin_station import TwinStation, fastest
from testbed.config import Experiment, find, load
from testbed.config.shipped import SHIPPED
from testbed.core.se2 import wrap
from testbed.core.types import PoseSample
from testbed.identification.vehicle_file import load_vehicle

VEHICLES = ("generic_8jet", "generic_8jet_15kg", "uky", "spot_red", "ita")
EVER = 1e6  # [s]


class Planted(TwinStation):
    """A station with errors in its wires, its cameras and its boards; sat1 is the one concerned."""

    def __init__(self, experiment: Experiment, believed: Experiment | None, how: dict[str, Any]):
        self.how = how
        super().__init__(experiment, believed)
        if "plant" in how:
            for name in self.twin.names:
                self.bearing(name, on=True)  # a vehicle without air has no thrust to change
            how["plant"](self.twin.plant)
            for name in self.twin.names:
                self.bearing(name, on=False)
        self._still: dict[str, PoseSample] = {}

    def _behind(self, name: str) -> str:
        return {"sat1": "sat2", "sat2": "sat1"}[name] if self.how.get("boards") else name

    def poses(self):
        """Poses as the cameras' program would send them."""
        seen = super().poses()
        if self.how.get("bodies"):
            seen = {"sat1": seen["sat2"], "sat2": seen["sat1"]}
        if self.how.get("wrong_body"):
            seen = {**seen, "sat1": [replace(s, x=s.x * 1e-9 + 0.3, y=0.2, theta=1e-9 * s.x)
                                     for s in seen["sat1"]]}  # fmt: skip
        if "see" in self.how:
            made = (self.how["see"](s) for s in seen["sat1"])
            seen = {**seen, "sat1": [s for s in made if s is not None]}
        if self.how.get("frozen"):
            first = self._still
            seen = {**seen, "sat1": [
                replace(first.setdefault("sat1", s), captured_at=s.captured_at)
                for s in seen["sat1"]
            ]}  # fmt: skip
        return seen

    def board(self, name):
        """A board with other firmware, if that is the error."""
        if "believe" in self.how:  # its firmware was built from the file that is wrong
            return BoardFacts("built from the same file")
        return self.how.get("board", super().board(name))

    def health(self, name):
        """Gauges that show the error."""
        return replace(super().health(name), **self.how.get("health", {}))

    def bearing(self, name, *, on):
        """Of the vehicle that the board is in."""
        super().bearing(self._behind(name), on=on)

    def fire(self, name, jet, seconds):
        """Of the valve that the wire leads to."""
        if name == "sat1":
            jet = self.how.get("wires", {}).get(jet, jet)
        at = super().fire(self._behind(name), jet, seconds)
        if name in self.how.get("unplugged", {}) and jet == self.how["unplugged"][name]:
            self._unplay(name, jet)
        return at

    def _unplay(self, name, jet):
        pulses = self.twin.plant.boards[name].pulses
        pulses.down[jet, -1] = pulses.up[jet, -1]
        self.twin.plant.boards[name].openings -= 1


def moved(dx: float = 0.0, dy: float = 0.0, turn: float = 0.0) -> Callable:
    """Cameras whose body is off: by a place in its own frame, and by an angle."""

    def see(s: PoseSample) -> PoseSample:
        c, n = math.cos(s.theta), math.sin(s.theta)
        return replace(
            s, x=s.x + c * dx - n * dy, y=s.y + n * dx + c * dy, theta=wrap(s.theta + turn)
        )

    return see


def in_frame(matrix, scale: float = 1.0, turn: Callable = lambda theta: theta) -> Callable:
    """Cameras with other axes."""

    def see(s: PoseSample) -> PoseSample:
        x, y = scale * np.array(matrix) @ (s.x, s.y)
        return replace(s, x=float(x), y=float(y), theta=wrap(turn(s.theta)))

    return see


def rarely(s: PoseSample) -> PoseSample | None:
    """Every other frame."""
    return s if round(s.captured_at * 100.0) % 2 else None


def shaken(s: PoseSample) -> PoseSample:
    """Ten times the noise: reproducible from the time."""
    n = math.sin(1e7 * s.captured_at), math.cos(1.3e7 * s.captured_at)
    return replace(s, x=s.x + 0.005 * n[0], y=s.y + 0.005 * n[1], theta=s.theta + 0.02 * n[0])


def jets(k: int, **changes) -> Callable:
    """The believed vehicle: jet `k` has another entry in the file."""

    def other(vehicle):
        jet = vehicle.jets[k]
        new = {name: make(jet) for name, make in changes.items()}
        return replace(vehicle, jets=[replace(j, **new) if j is jet else j for j in vehicle.jets])

    return other


def all_arms(vehicle):
    """Every jet on the other side of its axis: the file was made from the drawing's back."""
    return replace(vehicle, jets=[
        replace(j, position=(
            j.position[0] if j.push[0] else -j.position[0],
            j.position[1] if j.push[1] else -j.position[1],
        )) for j in vehicle.jets
    ])  # fmt: skip


def leak(share: float) -> Callable:
    """A valve that does not close."""
    return lambda plant: plant.leak_valve(0, 4, share, 0.0, EVER)


def weaker(jet: int, share: float) -> Callable:
    """A jet that gives less."""

    def change(plant):
        plant.parameters.effect[0, :, jet] *= share
        plant.parameters.thrust[0, jet] *= share

    return change


def pushed(parameter: str, index: Any, value: float) -> Callable:
    """A parameter of the true vehicle, to which something is added."""

    def change(plant):
        getattr(plant.parameters, parameter)[index] += value

    return change


def pulled(plant):
    """A hose: it pulls with a tenth of a jet, and turns."""
    thrust = plant.parameters.thrust[0, 0]
    plant.parameters.hose[0] = 0.15 * thrust, -0.1 * thrust, 0.02 * thrust


def dragging(plant):
    """A pad that drags."""
    plant.parameters.drag[0] += 0.16 * plant.parameters.mass[0]


def flipped(j):
    """The push's sign is wrong."""
    return (-j.push[0], -j.push[1])


def mirrored(j):
    """The jet is on the other side."""
    return (j.position[0] if j.push[0] else -j.position[0],
            j.position[1] if j.push[1] else -j.position[1])  # fmt: skip


FOREIGN = BoardFacts("", "built with limits 12345678, the vehicle file gives 9abcdef0")
QUARTER, HALF = math.pi / 2, math.pi
ERRORS: dict[str, tuple[dict[str, Any], set[str]]] = {  # what is planted, verdicts that name it
    "wires of jets 1 and 3 exchanged": ({"wires": {0: 2, 2: 0}}, {"wires_swapped"}),
    "wires of parallel jets 1 and 2 exchanged": ({"wires": {0: 1, 1: 0}}, {"wires_swapped"}),
    "wires of opposite jets 1 and 6 exchanged": ({"wires": {0: 5, 5: 0}}, {"wires_swapped"}),
    "wires of jets 1, 3, 5 exchanged in a ring": (
        {"wires": {0: 2, 2: 4, 4: 0}}, {"wires_swapped"}),
    "plug of the valves turned": (
        {"wires": {k: (k + 2) % 8 for k in range(8)}}, {"all_turned", "wires_swapped"}),
    "push of jet 2 has the wrong sign in the file": (
        {"believe": jets(1, push=flipped)}, {"jet_reversed", "jet_unlike"}),
    "position of jet 4 is mirrored in the file": (
        {"believe": jets(3, position=mirrored)}, {"jet_mirrored", "jet_unlike"}),
    "all positions are mirrored in the file": ({"believe": all_arms}, {"all_on"}),
    "body registered 90 deg off": ({"see": moved(turn=QUARTER)}, {"body_turned"}),
    "body registered 180 deg off": ({"see": moved(turn=HALF)}, {"body_turned"}),
    "pivot of the body 12 cm off": ({"see": moved(dx=0.12)}, {"pivot"}),
    "frame of the cameras turned by 90 deg": (
        {"see": in_frame([[0, 1], [-1, 0]], turn=lambda a: a - QUARTER)}, {"frame_turned"}),
    "frame of the cameras mirrored": (
        {"see": in_frame([[1, 0], [0, -1]], turn=lambda a: -a)}, {"frame_mirrored"}),
    "y is up, z was told": (
        {"see": in_frame([[1, 0], [0, 0]], turn=lambda a: 1e-3 * math.sin(1e5 * a))}, {"up_axis"}),
    "origin 20 cm off": (
        {"see": lambda s: replace(s, x=s.x + 0.2)}, {"origin"}),
    "mm for m": ({"see": in_frame(np.eye(2), 1000.0)}, {"units"}),
    "bodies of two vehicles exchanged": ({"bodies": True, "two": True}, {"bodies_swapped"}),
    "a body that is not the vehicle's": ({"wrong_body": True}, {"wrong_body", "camera_frozen"}),
    "frame rate halved": ({"see": rarely}, {"camera_rate"}),
    "cameras badly calibrated: noise": ({"see": shaken}, {"camera_noise"}),
    "stream frozen": ({"frozen": True}, {"camera_frozen"}),
    "boards of two vehicles exchanged": ({"boards": True, "two": True}, {"boards_swapped"}),
    "firmware of another vehicle": ({"board": FOREIGN}, {"wrong_firmware"}),
    "vehicle file of a lighter vehicle": (
        {"believe": lambda v: replace(v, mass=0.75 * v.mass, inertia=0.75 * v.inertia)},
        {"all_weak"}),
    "thrust in the file is half": (
        {"believe": lambda v: replace(
            v, jets=[replace(j, thrust=0.5 * j.thrust) for j in v.jets])}, {"all_strong"}),
    "inertia in the file 1.6 times too large": (
        {"believe": lambda v: replace(v, inertia=1.6 * v.inertia)}, {"inertia"}),
    "a valve leaks a fifth": ({"plant": leak(0.2)}, {"leak"}),
    "a valve stays half open": ({"plant": leak(0.5)}, {"leak"}),
    "a valve is stuck open": ({"plant": leak(1.0)}, {"leak"}),
    "a valve opens by half": ({"plant": weaker(2, 0.5)}, {"jet_weak"}),
    "a valve's wire is off": ({"unplugged": {"sat1": 6}}, {"dead", "silent_valve"}),
    "a nozzle is blocked": ({"plant": weaker(5, 0.02)}, {"dead"}),
    "a valve is 80 ms slow": ({"plant": pushed("late", (0, 3), 0.08)}, {"jet_late"}),
    "all valves are 60 ms slow": ({"plant": pushed("late", 0, 0.06)}, {"late"}),
    "a hose pulls": ({"plant": pulled}, {"hose", "pulled", "pushed"}),
    "a pad drags": ({"plant": dragging}, {"drag"}),
    "regulator at 150 %": ({"health": {"supply_pressure": 1.5}, "gauge": True}, {"pressure_high"}),
    "air is shut": ({"health": {"supply_pressure": 0.0}, "gauge": True}, {"pressure_low"}),
    "battery is flat": ({"health": {"battery": 10.0}, "gauge": True}, {"battery"}),
}  # fmt: skip


def setup(vehicle: str, seed: int, table: str = "marble_6m", *, two: bool = False) -> Experiment:
    """One or two vehicles of a kind on a table."""
    words = [f'table="{SHIPPED / "tables" / table}.toml"', f"seed={seed}"]
    experiment = load(find("hold"), words)
    one = replace(
        experiment.vehicles["sat1"], model=load_vehicle(vehicle), start=(-1.0, 0.2, 0.0),
        goal=(-1.0, 0.2, 0.0),
    )  # fmt: skip
    other = replace(one, start=(0.9, -0.3, 0.0), goal=(0.9, -0.3, 0.0))
    vehicles = {"sat1": one, "sat2": other} if two else {"sat1": one}
    return replace(experiment, vehicles=vehicles)


def believed(experiment: Experiment, change: Callable) -> Experiment:
    """The experiment with another file of sat1's vehicle."""
    one = experiment.vehicles["sat1"]
    vehicles = {**experiment.vehicles, "sat1": replace(one, model=change(one.model))}
    return replace(experiment, vehicles=vehicles)


def fly(experiment: Experiment, how: dict[str, Any]) -> tuple[set[str], float, list[str]]:
    """Codes of the verdicts, largest true speed, and the verdicts in words."""
    told = believed(experiment, how["believe"]) if "believe" in how else experiment
    if how.get("gauge"):
        share = how["health"].get("supply_pressure")
        air = experiment.vehicles["sat1"].model.air
        fixed = {} if share is None else {"supply_pressure": share * air.set_pressure}
        how = {**how, "health": {**how["health"], **fixed}}
    station = Planted(experiment, told, how)
    done = commission(told, station)
    bad = [v for v in done.verdicts if v.code]
    words = [f"{v.vehicle} {v.step} {v.code}: {v.text}" for v in bad]
    return {v.code for v in bad}, fastest(station.twin), words


def main() -> None:
    """Plant, commission, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--healthy", type=int, default=50)
    parser.add_argument("--vehicles", nargs="+", default=VEHICLES)
    parser.add_argument("--only", default="", help="errors whose name contains this")
    parser.add_argument("--words", action="store_true", help="print every verdict")
    args = parser.parse_args()
    top, missed, cases, lost = 0.0, set(), 0, 0
    for k, (name, (how, codes)) in enumerate(ERRORS.items()):
        if args.only not in name:
            continue
        for vehicle in args.vehicles:
            experiment = setup(vehicle, k, two=how.get("two", False))
            gauges = experiment.vehicles["sat1"].model.gauges
            if how.get("gauge") and not gauges.supply:
                continue
            found, speed, words = fly(experiment, how)
            cases += 1
            top = max(top, speed)
            if not found & codes:
                lost += 1
                missed.add(name)
                print(f"NOT NAMED {name} on {vehicle}: {words}")
            elif args.words:
                print(f"{name} on {vehicle}: {words} {speed:.3f} m/s")
            if speed > 0.05:
                print(f"FAST {name} on {vehicle}: {speed:.3f} m/s")
    false = 0
    for seed in range(args.healthy):
        vehicle = args.vehicles[seed % len(args.vehicles)]
        table = ("marble_6m", "marble_6m", "rough_6m")[seed % 3]
        found, speed, words = fly(setup(vehicle, 100 + seed, table), {})
        top = max(top, speed)
        false += bool(found)
        if found:
            print(f"FALSE ALARM {vehicle} on {table}, seed {100 + seed}: {words}")
    print(f"{cases - lost} of {cases} planted errors named;", end=" ")
    print(f"{len(ERRORS) - len(missed)} of {len(ERRORS)} kinds on every vehicle")
    print(f"{false} of {args.healthy} healthy set-ups with a false alarm")
    print(f"largest speed of any vehicle {top:.3f} m/s")


if __name__ == "__main__":
    main()
