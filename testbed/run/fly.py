"""One run: fly the experiment on its rig, write the log, judge the flight."""

import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from pathlib import Path

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from controllers.catalogue import UsersLaw
from testbed.config import Experiment
from testbed.core.codes import FaultId, FaultReport
from testbed.core.law import Concern
from testbed.core.types import EndingTick
from testbed.flight.flown_span import FlownSpan
from testbed.flight.flown_tick import AnyHostTick, AnyTick, FlownHostTick, FlownTick
from testbed.flight.loop import Ending
from testbed.logs.feed import Loop
from testbed.logs.recorder import CAREFUL_SPAN_NS, FAST_SPAN_NS, SPAN_NS, Recorder, RecorderError
from testbed.logs.tick_row import Names
from testbed.logs.truth import Motion, Truth
from testbed.metrics.run_metrics import Metrics, ReferenceLog, with_jets
from testbed.realtime.heartbeat import RunPhase, heartbeat
from testbed.realtime.law_watch import complaint, patience
from testbed.realtime.pacer import PacedClock
from testbed.realtime.scheduling import steady_memory
from testbed.rig.compile_ahead import Compilers, compiling_ahead
from testbed.rig.interface import Rig
from testbed.rig.observers import NullObserver, handles_single_ticks
from testbed.rig.twin import TwinRig, make_twin, warm_up
from testbed.run.formation_log import FormationLog
from testbed.run.interrupt import Interrupt
from testbed.run.judge import measure
from testbed.run.markers import scene_of


class FlightScreen(NullObserver):
    """Display during a run; this one shows nothing."""

    phase = ""  # the supervisor's phase

    def showing(self) -> AbstractContextManager[object]:
        """Context in which the display is active."""
        return nullcontext()

    def ticks(self, span: FlownSpan) -> None:
        """Show the newest tick of these; no screen is as fast as the twin."""
        if handles_single_ticks(self):
            span.show(self, begin=max(0, len(span.times) - 1))

    def flies(self) -> None:
        """The code is compiled and the flight begins."""

    def warn(self, line: str) -> None:
        """Print a line for the operator."""


class FlightLog:
    """Observer of a flight: writes the log and stores data for the metrics."""

    def __init__(
        self,
        rig: Rig,
        references: Mapping[str, ReferenceLog],
        recorder: Recorder,
        screen: FlightScreen,
        pace: PacedClock | None = None,
    ) -> None:
        self._rig, self._references = rig, references
        self._recorder, self._screen, self._pace = recorder, screen, pace
        self._seen = -1.0  # valve data up to this time are logged
        self._logged = 0  # number of phase changes in the log
        self._dated = False  # whether the log's time is settled
        self.trouble: str | None = None  # error of the log's writer, which ends the flight
        self._formation = FormationLog()

    def vehicle(self, name: str, tick: AnyTick) -> None:
        """See `Observer`."""
        if tick.ended:
            heartbeat().beat()
            last = EndingTick(tick.inputs, tick.outputs)
            self._record(f"/{name}/ending", tick.t, last)
            return
        self._record(f"/{name}/tick", tick.t, tick)
        self._references[name].note(tick)
        self._screen.vehicle(name, tick)

    def host(self, name: str, tick: AnyHostTick) -> None:
        """See `Observer`."""
        self._record(f"/{name}/host", tick.t, tick)

    def ticks(self, span: FlownSpan) -> None:
        """See `NullObserver`."""
        heartbeat().beat()
        self._screen.ticks(span)
        for name, rows in span.vehicles.items():
            self._references[name].note_rows(rows)
        begin, later = 0, self._formation.found
        while begin < len(span.times):
            end = begin + self._recorder.due_in(span.times[begin:])
            part, begin = span.part(begin, end), end
            self._formation.note(part.times, part.truth)
            self._write(partial(self._recorder.write_span, part, "/formation", later))
            self._mark(part.times[-1])
        self.reports()

    def reports(self) -> None:
        """Log what boards, wires and the supervisor have reported since the last call."""
        for name, valves in self._rig.valves(since=self._seen):
            self._record(f"/{name}/valves", max(0.0, valves.t), valves)
        self._seen = self._rig.now
        for name, at, wires in self._rig.paces():
            self._record(f"/{name}/pace", at, wires)
        events = self._rig.supervisor.events
        for event in events[self._logged :]:
            self._record("/supervisor", max(0.0, event.t), event)
            self._screen.phase = event.phase
        self._logged = len(events)

    def _record(self, topic: str, t: float, message: Struct | FlownTick | FlownHostTick) -> None:
        self._write(partial(self._recorder.write, topic, t, message))

    def _write(self, write: Callable[[], None]) -> None:
        if not self._dated:
            self._dated = True  # before the first row
            began_ns = self._rig.began_ns if self._pace is None else self._pace.began_ns
            if began_ns is not None:
                self._recorder.epoch_ns = began_ns
        if self.trouble is None:
            try:
                write()
            except RecorderError as error:
                self.trouble = str(error)

    def _mark(self, t: float) -> None:
        if self.trouble is None:
            try:
                for line in self._recorder.mark(t):
                    self._screen.warn(line)
            except RecorderError as error:
                self.trouble = str(error)

    def done(self, t: float) -> None:
        """See `Observer`."""
        heartbeat().beat()
        truth = dict(self._rig.truth())
        self._record("/truth", t, Truth(t, {name: Motion(*x) for name, x in truth.items()}))
        if self._formation.note([t], np.array([*truth.values()]).reshape(1, -1, 6)):
            self._record("/formation", t, self._formation.found()[t])
        self.reports()
        if (loop := self._rig.loop) is not None:
            self._record("/loop", t, Loop(t, *loop))
        if self._pace is not None:
            self._record("/loop", t, Loop(t, self._pace.late_s, self._pace.busy_s))
        self._mark(t)
        self._screen.done(t)


def names_of(experiment: Experiment) -> Names:
    """Names that rows of its log refer to by number."""
    return Names(list(experiment.vehicles), list(experiment.obstacles), list(experiment.faults))


def span_of(experiment: Experiment) -> int:
    """Time of the run per chunk of the log, faster than real time [ns]."""
    flown = [experiment, *(after for _, after in experiment.stages())]
    own = any(isinstance(one.controller, UsersLaw) for one in flown)
    return CAREFUL_SPAN_NS if own else FAST_SPAN_NS


def tick_of(experiment: Experiment) -> int:
    """Time from one tick to the next [ns]."""
    return round(1e9 * experiment.flight.jet_period_s)


def fly_and_judge(
    experiment: Experiment,
    folder: Path,
    interrupt: Interrupt | None = None,
    make: Callable[[Experiment], Rig] = make_twin,
    speed: float | None = None,
    screen: FlightScreen | None = None,
    epoch_ns: int = 0,
) -> Metrics:
    """Fly, with the log in `folder`, and judge.

    Args:
        experiment: what to fly.
        folder: the run folder, for `log.mcap`.
        interrupt: ends the flight on request.
        make: builds the rig; default: the twin.
        speed: of the twin, as a multiple of real time; None: as fast as possible.
        screen: display during the flight.
        epoch_ns: time of the log, UTC, at time 0 of the run; 0: two runs give the same bytes.
    """
    interrupt, screen = interrupt or Interrupt(), screen or FlightScreen()
    with compiling_ahead(experiment) as compilers:
        return _fly_and_judge(
            experiment, folder, interrupt, make(experiment), speed, screen, epoch_ns, compilers
        )


def _fly_and_judge(
    experiment: Experiment, folder: Path, interrupt: Interrupt, rig: Rig, speed: float | None,
    screen: FlightScreen, epoch_ns: int, compilers: Compilers,
) -> Metrics:  # fmt: skip
    """`fly_and_judge` with a rig that is made; the compilers are ended before the flight."""
    pace = None
    if speed is not None and isinstance(rig, TwinRig):
        pace = PacedClock(rig.twin, speed)
        rig = replace(rig, pace=pace)
    references = {name: ReferenceLog() for name in experiment.vehicles}
    fast = rig.name == "twin" and pace is None
    recorder = Recorder(
        folder / "log.mcap", names=names_of(experiment), waits=rig.name == "twin",
        span_ns=span_of(experiment) if fast else SPAN_NS, tick_ns=tick_of(experiment),
        epoch_ns=epoch_ns, scene=scene_of(experiment),
    )  # fmt: skip
    metrics, ending = None, Ending(0.0, None)
    try:
        with recorder, screen.showing():
            with interrupt.at_once(), patience():
                compilers.join_in()
                warm_up(experiment, lambda: interrupt.asked)
            compilers.end()  # nothing else may run beside a flight
            if not interrupt.asked:
                heartbeat().phase = RunPhase.FLYING
                log = FlightLog(rig, references, recorder, screen, pace)
                recorder.wait_for_writer()  # else the flight waits for it
                screen.flies()
                metrics = _fly(rig, log, references, interrupt)
                if log.trouble is not None:
                    raise RecorderError(log.trouble)
    except RecorderError as error:
        fault = FaultReport(FaultId.LOG_FAILED, f"log: {error}")
        ending = Ending(rig.now, fault)
        if metrics is not None:
            if (first := metrics.fault_report) is not None:  # it had ended the flight before
                fault = replace(first, notes=(*first.notes, fault.text))
            metrics = replace(metrics, fault=fault.words, fault_report=fault, completed=False)
    heartbeat().phase = RunPhase.ENDING
    metrics = metrics or measure(rig, references, ending, 0.0, completed=False)
    if recorder.lost:
        lost = Concern("log_rows_lost", f"{recorder.lost} rows: the log writer did not keep up")
        metrics = replace(metrics, warnings=[*metrics.warnings, lost])
    return replace(metrics, epoch_ns=recorder.epoch_ns or None)


def _fly(
    rig: Rig, log: FlightLog, references: dict[str, ReferenceLog], interrupt: Interrupt
) -> Metrics:
    """Fly until every vehicle is at rest, and measure."""

    def stopped() -> int:
        heartbeat().beat()  # also while vehicles are waited for, and while they brake
        return interrupt.asked or int(log.trouble is not None)

    with steady_memory():
        began = time.perf_counter()
        ending = rig.fly(log, stopped)
        wall = time.perf_counter() - began
        log.reports()
        if ending.fault is None and (fault := complaint()):
            ending = replace(ending, fault=fault)
        completed = ending.fault is None and ending.t >= rig.experiment.end_s
        metrics = measure(rig, references, ending, wall, completed=completed)
        after = rig.come_to_rest(ending, log, lambda: interrupt.asked)
        jets = {name: rig.jets(name) for name in rig.experiment.vehicles}
        return with_jets(replace(metrics, after=after), jets)
