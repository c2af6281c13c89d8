"""Results of a flight on wires: from vehicles during the flight, from the twin afterwards."""

import math
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import numpy as np

from testbed.config import Experiment
from testbed.core.jets import JetHealth
from testbed.core.law import Concern
from testbed.core.warned import Warned, noticed
from testbed.flight.detectors import SPOILT
from testbed.flight.fault_warnings import is_told
from testbed.flight.loop import Ending, Observer
from testbed.metrics.afterwards import After, Left
from testbed.metrics.run_metrics import Commands, Consumption, Touch, Track
from testbed.net.commands import Ended, Pace, TickReport
from testbed.net.envelope import Acceptance
from testbed.realtime.wall_clock import WallClock
from testbed.rig.firmware_boards import Valves
from testbed.rig.wired.table_report import TableReport

MANY = 0.01  # share of late ticks from which on the operator is told
SLOW = (
    "{} of {} plans were sent late or not played as planned: a computer is busy; after each,"
    " bad jets are looked for anew"
)


class RunResults:
    """Records a flight as its `Book`, and answers the queries of `Rig` about it."""

    def __init__(self, experiment: Experiment) -> None:
        self.experiment = experiment
        self.flown_s = math.inf  # time of the end
        self.clock: WallClock | None = None  # None before the run's time 0 is known
        self._truth: dict[str, list[float]] = {}
        self.report: TableReport | None = None  # of the twin, on the bench
        self.ended: dict[str, Ended] = {}  # the vehicles' reports at the end
        self.boards: dict[str, str] = {}  # names of the boards
        self._paces: list[Pace] = []
        self._lateness: list[float] = []
        self._sent = 0
        self.key_warnings: list[str] = []
        self.law_concerns: list[Concern] = []  # of the laws on the host
        self._new_valves: list[tuple[str, Valves]] = []  # since the last call of `valves`
        self._new_paces: list[tuple[str, float, Pace]] = []
        self.loop: tuple[float, float] | None = None
        self._states: dict[str, list[tuple[float, list[float]]]] = {}
        self._fired_us: dict[str, int] = {}
        self._held: dict[str, dict[str, float]] = {}  # rows of the fault table, and since when [s]
        self._ticks: dict[str, tuple[int, int]] = {}  # of the flight, and how many of them spoilt

    @property
    def epoch_ns(self) -> int | None:
        """The run's time 0 on the monotonic clock; None before that is known."""
        return None if self.clock is None else self.clock.epoch_ns

    @property
    def began_ns(self) -> int | None:
        """See `Rig`."""
        return None if self.clock is None else self.clock.began_ns

    @property
    def now(self) -> float:
        """See `Rig`."""
        return max(0.0, self.clock.now) if self.clock is not None else 0.0

    @property
    def touches(self) -> list[Touch]:
        """See `Rig`."""
        if self.report is None:
            return []
        late = self._released_late()
        return [
            Touch(one.t + late, one.vehicle, one.other, one.speed)
            for one in self.report.touches
            if one.t + late <= self.flown_s
        ]

    def _released_late(self) -> float:
        """The twin's time 0 on the run's clock [s]."""
        if self.report is None or self.report.released_ns is None or self.clock is None:
            return 0.0
        return 1e-9 * (self.report.released_ns - self.clock.epoch_ns)

    def note_truth(self, poses: dict[str, list[float]]) -> None:
        """See `Book`."""
        self._truth = poses

    def note_tick(self, name: str, flown: TickReport) -> None:
        """See `Book`."""
        self._paces.append(flown.pace)
        self._new_paces.append((name, flown.tick.inputs.t, flown.pace))
        self._new_valves += [(name, Valves(t, mask)) for t, mask in flown.edges]
        if flown.tick.inputs.vitals.end or flown.tick.inputs.t >= self.experiment.end_s:
            return
        ticks, spoilt = self._ticks.get(name, (0, 0))
        late = flown.tick.inputs.vitals.late_s > SPOILT * self.experiment.flight.jet_period_s
        self._ticks[name] = ticks + 1, spoilt + late
        state = flown.tick.outputs.state
        if state is not None:
            row = [
                state.pose.x, state.pose.y, state.pose.theta,
                state.twist.vx, state.twist.vy, state.twist.omega,
            ]  # fmt: skip
            self._states.setdefault(name, []).append((state.t, row))
        fired = sum(flown.tick.outputs.command.on_us)
        self._fired_us[name] = self._fired_us.get(name, 0) + fired
        for held in flown.tick.outputs.faults:
            self._held.setdefault(name, {}).setdefault(held, flown.tick.outputs.t)

    def note_end(self, name: str, ended: Ended) -> None:
        """See `Book`."""
        self.ended[name] = ended

    def note_loop(self, late_s: float, busy_s: float) -> None:
        """See `Book`."""
        self.loop = (late_s, busy_s)

    def note_host(self, lateness: list[float], sent: int) -> None:
        """See `Book`."""
        self._lateness, self._sent = lateness, sent

    def truth(self) -> Iterator[tuple[str, list[float]]]:
        """See `Rig`."""
        return iter(self._truth.items())

    def track(self) -> Track:
        """See `Rig`. Without a twin: the vehicles' estimates."""
        names = list(self.experiment.vehicles)
        report = self.report
        if report is not None and report.released_ns is not None and self.clock is not None:
            t = np.array(report.t) + self._released_late()
            flown = t <= self.flown_s  # vehicles drift after the end
            states = np.array(report.states).reshape(-1, len(names), 6)
            return Track(t[flown], states[flown])
        rows = [self._states.get(name, []) for name in names]
        count = min((len(row) for row in rows), default=0)
        if count == 0:
            return Track(np.zeros(0), np.zeros((0, len(names), 6)))
        states = np.array([[state for _, state in row[:count]] for row in rows])
        return Track(np.array([t for t, _ in rows[0][:count]]), states.transpose(1, 0, 2))

    def come_to_rest(
        self, ending: Ending, observer: Observer, stopped: Callable[[], int] = lambda: 0
    ) -> After | None:
        """See `Rig`. The vehicles came to rest by themselves; this only judges the result.

        The twin's server simulated its plant for a minute after its last frame, with valves and
        bearing air as last reported by the boards. Without a twin the vehicles' reports are used.
        """
        names, report = list(self.experiment.vehicles), self.report
        if report is not None and report.released_ns is not None and self.clock is not None:
            return report.after(names, ending.t - self._released_late())
        if not self.ended:
            return None
        left = {
            name: Left(one.landed_s, one.air) for name, one in self.ended.items() if name in names
        } | {name: Left(None, "on") for name in names if name not in self.ended}
        rests = [one.at_rest_s for one in left.values()]
        known = [rest for rest in rests if rest is not None]
        return After(
            None,
            max(known) if len(known) == len(rests) else None,
            "on" if any(one.air == "on" for one in left.values()) else "off",
            left,
        )

    def ended_as(self) -> bytes:
        """Bearing air, "off" or "on", of each vehicle that has ended its flight, for `stop.py`."""
        return msgspec.json.encode({name: one.air for name, one in self.ended.copy().items()})

    def spent(self, name: str) -> Consumption:
        """See `Rig`. Without a twin: from the commands and the vehicle file's thrust."""
        report = self.report
        if report is not None:
            end = self.flown_s - self._released_late()
            return report.spent_by(name, list(self.experiment.vehicles), end)
        model = self.experiment.vehicles[name].model
        thrust = float(np.mean([jet.thrust for jet in model.jets]))
        impulse = 1e-6 * self._fired_us.get(name, 0) * thrust
        return Consumption(impulse, impulse / model.air.exhaust_speed, None)

    def valves(self, since: float) -> Iterator[tuple[str, Valves]]:
        """See `Rig`. All edges that the boards reported since the last call."""
        new, self._new_valves = self._new_valves, []
        yield from new

    def paces(self) -> Iterator[tuple[str, float, Pace]]:
        """See `Rig`."""
        new, self._new_paces = self._new_paces, []
        yield from new

    def concerns(self) -> list[Concern]:
        """See `Rig`. Concerns of laws on board are not collected."""
        return [
            *self.law_concerns, *(Concern("keys_expire", words) for words in self.key_warnings),
            *noticed({name: self._warned(name) for name in self.experiment.vehicles}),
            *(
                Concern("late_plans", f"{name}: {SLOW.format(spoilt, ticks)}")
                for name, (ticks, spoilt) in self._ticks.items() if spoilt > MANY * ticks
            ),
        ]  # fmt: skip

    def _warned(self, name: str) -> dict[str, Warned]:
        """Rows that have held on a vehicle; without their words if its last report is missing."""
        if name in self.ended:
            return self.ended[name].warned
        faults = self.experiment.faults
        return {
            row: Warned(t, math.nan, f"{row} held; the vehicle's last report is missing")
            for row, t in self._held.get(name, {}).items()
            if row in faults and is_told(faults[row])
        }

    def jets(self, name: str) -> tuple[JetHealth, ...]:
        """See `Rig`."""
        return self.ended[name].jets if name in self.ended else ()

    def wires(self) -> dict[str, Any]:
        """See `Rig`."""
        late = [1e3 * p.late_s for p in self._paces] + [1e3 * late for late in self._lateness]
        delays = [1e3 * p.pose_to_valve_s for p in self._paces if p.pose_to_valve_s is not None]
        counts = [ended.counts for ended in self.ended.values()]

        def total(*verdicts: Acceptance) -> int:
            return sum(c.commands.get(v, 0) for c in counts for v in verdicts)

        boards = self.report.boards if self.report is not None else self.boards.values()
        return {
            "lateness_p99_ms": _percentile(late, 99),
            "pose_to_valve_p50_ms": _percentile(delays, 50),
            "pose_to_valve_p99_ms": _percentile(delays, 99),
            "commands": Commands(
                sent=self._sent,
                late=total(Acceptance.LATE, Acceptance.DUPLICATED, Acceptance.REORDERED),
                expired=total(Acceptance.EXPIRED),
                rejected=total(Acceptance.FOREIGN, Acceptance.SCHEMA, Acceptance.GARBLED)
                + sum(sum(c.refusals.values()) for c in counts),
            ),
            "board": "; ".join(sorted(set(boards))) or None,
        }


def _percentile(values: list[float], share: float) -> float | None:
    return float(np.percentile(values, share)) if values else None
