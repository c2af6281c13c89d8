"""The steps of a commissioning, one after the other, on any rig.

A vehicle floats only while it is measured. A body that gets faster than `pace.STOP` ends the
measurement: the bearing air of every vehicle is turned off, and friction stops them at once.
"""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from sim_twin.ground import lay, tilt_at
from testbed.commission import cameras
from testbed.commission.cameras import Mark
from testbed.commission.floating import afloat
from testbed.commission.jets import Pulse, flow_times, judge
from testbed.commission.marks import marks_of
from testbed.commission.motion import (
    Array,
    Drift,
    Noise,
    drift_of,
    gained,
    kick_of,
    mean_of,
    noise_of,
    speed_of,
)
from testbed.commission.pace import PROBE, PUSH, STOP, drags_of, float_time, pulse_length
from testbed.commission.station import Station
from testbed.commission.verdict import Verdict
from testbed.config import Experiment
from testbed.core.error import TestbedError
from testbed.core.table import Table

LOOK = 0.05  # between two looks at the poses [s]
WINDOW = 0.2  # over which a speed is measured [s]
LAG = 0.2  # age of a measured speed: half of the window, the cameras' latency, a look [s]
STANDS_S = 2.0  # for which a standing body is watched
FLOATS_S = 2.5
BEFORE_S, AFTER_S = 1.6, 2.2  # around a pulse
SETTLE_S = 0.4  # for air and friction to stop it
EXACT, REPEATS = 0.08, 4  # error of a push, as a share, above which it is repeated
LONG = BEFORE_S + AFTER_S
ASTRAY = 0.1  # a vehicle this far from its place is carried back [m]
HIGH = 1.1  # largest pressure, as a share of the regulator's
ENDS = ("no_poses", "units", "camera_frozen", "frame_mirrored", "frame_turned", "up_axis",
        "wrong_body", "bodies_swapped", "frame", "scale", "body_turned", "camera_noise",
        "origin", "pivot")  # fmt: skip


NO_BOARD = ("no_board", "wrong_firmware")


class Commissioned(NamedTuple):
    """The outcome: verdicts, and what each jet of each vehicle did."""

    verdicts: list[Verdict]
    pulses: dict[str, list[Pulse]]

    @property
    def passed(self) -> bool:
        """Whether no step found an error and none was left out."""
        return not any(v.code or v.skipped for v in self.verdicts)


class TooFastError(Exception):
    """A vehicle got too fast; its air is off."""


class Procedure:
    """Commissions the vehicles of an experiment.

    Args:
        experiment: as the lab believes it.
        station: the rig.
        report: called with every verdict.
        slope: of the table file at a place [m/s^2].
    """

    def __init__(
        self, experiment: Experiment, station: Station, report: Callable[[Verdict], Any],
        slope: Callable[[float, float], Array],
    ) -> None:  # fmt: skip
        self._experiment, self._station, self._report_to = experiment, station, report
        self._slope = slope
        self._rows: dict[str, list[tuple[float, ...]]] = {}
        self._noise: dict[str, Noise] = {}
        self._names: Sequence[str] = ()
        self._floats_since = 0.0
        self._places: dict[str, list[Mark]] = {}
        self.verdicts: list[Verdict] = []
        self.pulses: dict[str, list[Pulse]] = {}

    @property
    def _table(self) -> Table:
        return self._experiment.table

    def run(self, names: Sequence[str]) -> list[Verdict]:
        """All steps; those that need what failed before are left out."""
        self._names = names
        try:
            for name in names:
                self._station.bearing(name, on=False)
                self._board(name)
                if not self._failed(name, *NO_BOARD):
                    self._pressure(name)
                self._standing(name)
            for name in names:
                self._frame(name)
            for name in names:
                if not self._failed(name, *NO_BOARD):
                    self._clicks(name)
            for name in names:
                if not self._failed(name, *NO_BOARD, *ENDS):
                    self._float(name)
            for name in names:
                ends = (*ENDS, *NO_BOARD, "leak", "pushed", "too_fast")
                if not self._failed(name, *ends):
                    self._jets(name)
        finally:
            for name in names:
                with suppress(TestbedError):  # of its board; the next vehicle's air goes off, too
                    self._station.bearing(name, on=False)
        return self.verdicts

    def _report(self, verdict: Verdict) -> None:
        self.verdicts.append(verdict)
        self._report_to(verdict)

    def _marks(self, name: str) -> list[Mark]:
        if name not in self._places:
            self._places[name] = marks_of(self._experiment, name, self._slope)
        return self._places[name]

    def _skip(self, step: str, name: str, why: str) -> None:
        self._report(Verdict(step, name, why, skipped=True))

    def _failed(self, name: str, *codes: str) -> bool:
        return any(v.vehicle == name and v.code in codes for v in self.verdicts)

    # Steps

    def _board(self, name: str) -> None:
        facts = self._station.board(name)
        code = ""
        if facts.trouble:
            code = "wrong_firmware" if "limits" in facts.trouble else "no_board"
        self._report(Verdict("board", name, facts.trouble or facts.text, code))

    def _pressure(self, name: str) -> None:
        vehicle, health = self._experiment.vehicles[name].model, self._station.health(name)
        arming, gauges = self._experiment.arming, vehicle.gauges
        if not gauges.supply:
            self._skip("pressure", name, "no gauge behind the regulator")
        else:
            share = health.supply_pressure / vehicle.air.set_pressure
            text, code = f"{share:.0%} of the regulator's pressure", ""
            if share < arming.supply_share:
                code, text = "pressure_low", f"{text}: is the air open, the tank full?"
            elif share > HIGH:
                code, text = "pressure_high", f"{text}: turn the regulator down"
            self._report(Verdict("pressure", name, text, code, {"share": share}))
        least, _ = arming.battery_limits(gauges.battery_v)
        if gauges.battery and health.battery < least:
            text = f"{health.battery:.1f} V: charge the battery"
            self._report(Verdict("battery", name, text, "battery", {"volts": health.battery}))

    def _standing(self, name: str) -> None:
        rows = self._watch(STANDS_S, guard=False).get(name, np.zeros((0, 4)))
        self._report(cameras.standing(name, rows, STANDS_S, self._table))
        if len(rows) >= 8:
            self._noise[name] = noise_of(rows)

    def _frame(self, name: str) -> None:
        step = "frame"
        marks = self._marks(name)
        if self._failed(name, "no_poses"):
            return
        if not self._station.carries or not marks:
            why = "it cannot be carried here" if marks else "no room to carry it"
            return self._skip(step, name, why)
        seen: dict[str, list[Array]] = {}
        for k, mark in enumerate(marks):
            if not self._station.carry(name, mark):
                return self._skip(step, name, "not carried")
            rows = self._watch(0.5, guard=False)
            for body in {*seen, *rows, name}:
                kept = seen.setdefault(body, [np.zeros((0, 4))] * k)
                kept.append(rows.get(body, np.zeros((0, 4))))
        self._report(cameras.carried(name, marks, seen))
        self._station.carry(name, marks[0])

    def _clicks(self, name: str) -> None:
        step, jets = "clicks", self._experiment.vehicles[name].model.jets
        if not self._station.listens:
            return self._skip(step, name, "nothing listens to the valves here")
        if not self._station.agree(f"{name}: its {len(jets)} valves click, bearing air off"):
            return self._skip(step, name, "declined")
        valve = self._experiment.vehicles[name].model.valve
        silent = []
        for jet in range(len(jets)):
            self._station.fire(name, jet, max(0.1, valve.min_on_s))
            self._station.wait(SETTLE_S)
            if not self._station.clicked(name, jet):
                silent.append(str(jet + 1))
        code = "silent_valve" if silent else ""
        text = f"no click of valve {', '.join(silent)}" if silent else f"{len(jets)} clicks"
        self._report(Verdict(step, name, text, code))

    def _float(self, name: str) -> None:
        step, vehicle = "float", self._experiment.vehicles[name].model
        if not self._station.agree(f"{name}: floats for {FLOATS_S:g} s, no valve opens"):
            return self._skip(step, name, "declined")
        marks = self._marks(name)
        drifts, slopes = list[Drift](), list[Array]()
        for turn in (0.0, math.pi) if self._station.carries and marks else (0.0,):
            if marks and self._station.carries:
                self._station.carry(name, (*marks[0][:2], turn))
            rows = self._floating(name, FLOATS_S)
            if len(rows) < 8:
                return self._report(Verdict(step, name, "no poses while it floats", "no_poses"))
            drifts.append(drift_of(rows, self._noise[name], drags_of(vehicle)))
            slopes.append(self._slope(*drifts[-1].pose[:2].tolist()))
        self._report(afloat(name, vehicle, drifts, slopes, self._table.spread))
        return None

    def _jets(self, name: str) -> None:
        step, vehicle = "jets", self._experiment.vehicles[name].model
        jets = len(vehicle.jets)
        asked = f"{name}: each of its {jets} jets pushes two to five times, at most {PUSH:g} m/s"
        if not self._station.agree(asked):
            return self._skip(step, name, "declined")
        pulses = self.pulses[name] = []
        for jet in range(jets):
            pulse = self._measured(name, jet)
            if pulse is None:
                text = f"jet {jet + 1} made a vehicle faster than {STOP:g} m/s: thrust or mass?"
                return self._report(Verdict(step, name, text, "too_fast"))
            pulses.append(pulse)
        for verdict in judge(name, vehicle, pulses, self._table.spread):
            self._report(verdict)
        return None

    # Measurements

    def _measured(self, name: str, jet: int) -> Pulse | None:
        """A pulse of a jet after a careful first one, repeated while its error is large."""
        vehicle = self._experiment.vehicles[name].model
        on_s = pulse_length(vehicle, jet, PROBE)
        pulse = self._pushed(name, jet, on_s)
        if pulse is None:
            return None
        change = float(np.hypot(*pulse.kick.change[:2]))
        expected = vehicle.jets[jet].thrust * pulse.flow_s / vehicle.mass
        error = float(np.hypot(*pulse.kick.sigma[:2]))
        strong = change / expected if change - 2.0 * error > 1.5 * expected else 1.0
        longer = pulse_length(vehicle, jet, PUSH, strong)
        kicks = [pulse.kick] if longer <= 1.1 * on_s else []
        while len(kicks) < REPEATS:
            if kicks:
                mean = mean_of(kicks)
                size = float(np.hypot(*mean.change[:2]))
                if np.hypot(*mean.sigma[:2]) < EXACT * max(size, expected):
                    break
            pulse = self._pushed(name, jet, longer)
            if pulse is None:
                return None
            kicks.append(pulse.kick)
        return pulse._replace(kick=mean_of(kicks))

    def _pushed(self, name: str, jet: int, on_s: float) -> Pulse | None:
        """One pulse on a floating vehicle, shorter watched if it got too fast; None: it did."""
        setup = self._experiment.vehicles[name]
        place = (self._marks(name) or [setup.start])[0]
        for share in (1.0, 0.6, 0.35):
            rows = self._watch(0.15, guard=False).get(name, np.zeros((0, 4)))
            at = np.median(rows[:, 1:3], axis=0) if len(rows) else np.array(place[:2])
            if self._station.carries and math.dist(at, place[:2]) > ASTRAY:
                self._station.carry(name, place)
                at = np.array(place[:2])
            pulse = self._push(name, jet, on_s, share * float_time(self._pull(name, at), LONG))
            if pulse is not None:
                return pulse
        return None

    def _push(self, name: str, jet: int, on_s: float, floats_s: float) -> Pulse | None:
        """One pulse while it floats for a time; None: something got too fast."""
        vehicle, station = self._experiment.vehicles[name].model, self._station
        share = floats_s / LONG
        _, flow = flow_times(vehicle, on_s)
        self._rows.clear()
        station.poses()
        self._floats_since = station.now
        station.bearing(name, on=True)
        try:
            self._watch(share * BEFORE_S, fresh=False)
            at = station.fire(name, jet, on_s)
            rows = self._watch(on_s + share * AFTER_S, fresh=False)
        except TooFastError:
            return None
        finally:
            station.bearing(name, on=False)
            station.wait(SETTLE_S)
        own = rows.get(name, np.zeros((0, 4)))
        if len(own) < 12:
            return None
        others = {
            other: gained(other_rows, at)
            for other, other_rows in rows.items() if other != name
        }  # fmt: skip
        kick = kick_of(own, at, flow, self._noise[name], drags_of(vehicle))
        return Pulse(jet, flow, kick, others)

    def _pull(self, name: str, at: Array) -> float:
        """Acceleration of the floating vehicle at a place: the file's slope and its verdict."""
        for v in self.verdicts:
            if v.step == "float" and v.vehicle == name and v.numbers:
                found = (v.numbers["slope_x_m_s2"], v.numbers["slope_y_m_s2"])
                return float(np.hypot(*(self._slope(*at.tolist()) + found)))
        return 0.0

    def _floating(self, name: str, seconds: float) -> Array:
        """Poses of a vehicle that floats, until it gets too fast."""
        self._rows.clear()
        self._station.poses()
        self._floats_since = self._station.now
        self._station.bearing(name, on=True)
        try:
            self._watch(seconds, fresh=False)
        except TooFastError:
            pass
        finally:
            self._station.bearing(name, on=False)
        rows = self._collected().get(name, np.zeros((0, 4)))
        self._station.wait(SETTLE_S)
        return rows

    def _watch(self, seconds: float, *, guard: bool = True, fresh: bool = True) -> dict[str, Array]:
        """Poses of every body over some time.

        Raises:
            TooFastError: with `guard`; every vehicle stands by then.
        """
        if fresh:
            self._rows.clear()
            self._station.poses()
        end = self._station.now + seconds
        while (left := end - self._station.now) > 1e-9:
            self._station.wait(min(LOOK, left))
            for body, samples in self._station.poses().items():
                self._rows.setdefault(body, []).extend(
                    (s.captured_at, s.x, s.y, s.theta) for s in samples
                )
            if guard:
                self._guard()
        return self._collected()

    def _collected(self) -> dict[str, Array]:
        return {body: np.array(rows).reshape(-1, 4) for body, rows in self._rows.items()}

    def _guard(self) -> None:
        """Turn every vehicle's air off when one gets fast; it keeps on speeding up until then."""
        since_rest = max(self._station.now - self._floats_since, LAG)
        for body, rows in self._rows.items():
            if not rows:
                continue
            since = rows[-1][0] - WINDOW
            recent = np.array([row for row in rows[-60:] if row[0] >= since])
            noise = self._noise.get(body, Noise(0.0, 0.0)).place
            if len(recent) < 6 or (span := float(recent[-1, 0] - recent[0, 0])) < 0.5 * WINDOW:
                continue
            unsure = 3.5 * noise / (span * math.sqrt(len(recent)))
            speed = max(0.0, speed_of(recent) - 2.0 * unsure) * (1.0 + LAG / since_rest)
            if speed > STOP:
                for name in self._names:
                    self._station.bearing(name, on=False)
                raise TooFastError(body)


def commission(
    experiment: Experiment, station: Station, report: Callable[[Verdict], Any] = lambda _: None,
    names: Sequence[str] | None = None,
) -> Commissioned:  # fmt: skip
    """Commission the vehicles of an experiment.

    Args:
        experiment: as the lab's files say.
        station: the rig.
        report: called with every verdict.
        names: vehicles whose boards the station has; None: all.
    """
    ground = lay(experiment.table)
    procedure = Procedure(experiment, station, report, lambda x, y: np.array(tilt_at(ground, x, y)))
    return Commissioned(procedure.run(names or list(experiment.vehicles)), procedure.pulses)
