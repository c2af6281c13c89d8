"""`testbed run`: fly an experiment, watch it, keep it, judge it."""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, redirect_stdout
from importlib.metadata import version
from pathlib import Path
from types import FrameType

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from controllers.law_file import UnusableLawError
from controllers.plain_law import LawError
from testbed.cli.live import LiveTable
from testbed.cli.main import FAILED, FAULT, INTERRUPTED, NOT_STARTED, OK
from testbed.cli.operator import Operator
from testbed.cli.refusal import errors, refuse
from testbed.cli.report import write_page
from testbed.cli.result import print_result
from testbed.config import ConfigError, Experiment, dump, find, load
from testbed.config.guarantee import warnings_of
from testbed.core.law import Concern
from testbed.core.types import HostTick, Tick
from testbed.dashboard.viewer import ViewerError
from testbed.flight.loop import Ending
from testbed.logs.feed import Loop
from testbed.logs.log_reader import LogError
from testbed.logs.recorder import Motion, Recorder, RecorderError, Truth
from testbed.metrics.characterisation import characterise
from testbed.metrics.formation import formation_metrics
from testbed.metrics.run_metrics import (
    Metrics,
    ReferenceLog,
    judge,
    judge_formation,
    obstacle_distances,
    smallest_separation,
    vehicle_metrics,
)
from testbed.net.stop import noted
from testbed.realtime.heartbeat import Phase, heartbeat, process_to_end
from testbed.realtime.law_watch import hurry, left_running, patience
from testbed.realtime.pacer import Pace
from testbed.realtime.scheduling import steady
from testbed.report.page import ReportError
from testbed.rig.boards import check_boards
from testbed.rig.chain import formation_context, watched
from testbed.rig.interface import Rig
from testbed.rig.twin import TwinRig, make_twin, warm_up
from testbed.run.folder import FolderError, new_folder, take_back, write_config, write_metrics

FORMATION_S = 1.0  # between two entries of the five elements in the log [s]


def run_experiment(
    name: str,
    overrides: Sequence[str],
    out: Path | None,
    as_json: bool,
    rig: str = "twin",
    view: str | None = None,
    speed: float | None = None,
    *,
    arm: bool = False,
    reset: bool = False,
) -> int:
    """Fly and return the exit code."""
    interrupt, board, folder = Interrupt(), None, None
    operator = Operator(arm=arm, reset=reset, at_once=interrupt.at_once)
    if view is not None and speed is None:
        speed = 1.0  # to be looked at
    try:
        with redirect_stdout(sys.stderr):  # what a law prints is not the result
            experiment = load(find(name), overrides)
        check_boards(experiment.board, {n: v.model for n, v in experiment.vehicles.items()})
        operator.must_be_there(rig)
        with interrupt.caught(), watched(experiment):
            folder = new_folder(out, experiment.name)
            write_config(folder, dump(experiment), version("airbearing-testbed"))
            heart = heartbeat()
            heart.rig, heart.folder, heart.phase = rig, str(folder), Phase.COMPILING
            if view is not None:
                from testbed.cli.dash import beside_run

                board = beside_run(folder, view)
            make = maker(rig, experiment, folder, operator)
            with redirect_stdout(sys.stderr), noted_on_twin(rig, experiment):
                metrics = fly_and_judge(experiment, folder, interrupt, make, speed, operator)
            write_metrics(folder, metrics)
            if as_json:
                sys.stdout.write((folder / "metrics.json").read_text())
            else:
                print_result(metrics, experiment, folder)
            report(folder, experiment)
    except (ConfigError, ViewerError, UnusableLawError, LawError) as error:
        if board is not None:
            board.terminate()
            board.wait()
        if folder is not None:
            take_back(folder)
        return refuse(error)
    except FolderError as error:
        return refuse(error)
    if view == "web" and board is not None:
        from testbed.cli.dash import leave

        leave(board)
    if metrics.red:
        for reason in metrics.red:
            errors.print(f"red: {reason}", style="red", markup=False, soft_wrap=True)
        return NOT_STARTED
    if metrics.fault:
        return FAULT
    if not metrics.completed:
        return INTERRUPTED
    return OK if all(metrics.criteria.values()) else FAILED


def noted_on_twin(rig: str, experiment: Experiment) -> AbstractContextManager[None]:
    """A note for `testbed stop`; a host on wires leaves its own."""
    if rig != "twin":
        return nullcontext()
    return noted(
        "", "", vehicles=list(experiment.vehicles), name=experiment.name, pid=process_to_end(),
        say=lambda text: errors.print(text, style="yellow", markup=False, soft_wrap=True),
    )  # fmt: skip


def report(folder: Path, experiment: Experiment) -> None:
    """Make the page; the verdict on the flight stands without it."""
    try:
        write_page(folder, experiment)
    except (ReportError, LogError) as error:
        errors.print(
            f"warning: no report: {error}\n  later     testbed report {folder}",
            style="yellow", markup=False, soft_wrap=True,
        )  # fmt: skip


class Interrupt:
    """Ctrl-C, SIGTERM, a closed terminal: noted, and the flight ends after its tick.

    Files are always finished.
    """

    def __init__(self) -> None:
        self.asked = False
        self._raises = False
        self._terminals: list[int] = []

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        heartbeat().signalled()
        hurry()
        if number == signal.SIGHUP:
            self._leave_terminal()
        if self._raises:
            raise KeyboardInterrupt

    def _leave_terminal(self) -> None:
        """Write nowhere what was for a terminal that was closed, so that nothing fails at it."""
        for descriptor in self._terminals:
            if not os.isatty(descriptor):
                os.dup2(os.open(os.devnull, os.O_RDWR), descriptor)

    @contextmanager
    def caught(self) -> Iterator[None]:
        """Note signals meanwhile; a closed terminal only where it would end the command."""
        self._terminals = [descriptor for descriptor in (0, 1, 2) if os.isatty(descriptor)]
        numbers = [signal.SIGINT, signal.SIGTERM]
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as under nohup
            numbers.append(signal.SIGHUP)
        before = {number: signal.signal(number, self._handle) for number in numbers}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Something long that leaves no files, such as compiling: drop it when interrupted."""
        self._raises = not self.asked
        try:
            yield
        except KeyboardInterrupt:
            self.asked = True
        finally:
            self._raises = False


class Watcher:
    """Observer of a flight: log and live table, and what the metrics need."""

    def __init__(
        self,
        rig: Rig,
        aims: Mapping[str, ReferenceLog],
        recorder: Recorder,
        live: LiveTable,
        pace: Pace | None = None,
    ) -> None:
        self._rig, self._aims = rig, aims
        self._recorder, self._live, self._pace = recorder, live, pace
        self._seen = -1.0  # up to here the valves are in the log
        self._told = 0  # changes of phase that are in the log
        self.trouble: str | None = None  # the log cannot be written: the flight has to end
        self._next = 0.0  # when the five elements are due [s]

    def vehicle(self, name: str, tick: Tick) -> None:
        """See `Observer`."""
        self._record(f"/{name}/tick", tick.inputs.t, tick)
        self._aims[name].note(tick.outputs)
        self._live.vehicle(name, tick)

    def host(self, name: str, tick: HostTick) -> None:
        """See `Observer`."""
        self._record(f"/{name}/host", tick.inputs.t, tick)

    def reports(self) -> None:
        """Log what boards, wires and the supervisor have said since they were asked last."""
        for name, valves in self._rig.valves(since=self._seen):
            self._record(f"/{name}/valves", max(0.0, valves.t), valves)
        self._seen = self._rig.now
        for name, at, wires in self._rig.paces():
            self._record(f"/{name}/pace", at, wires)
        events = self._rig.supervisor.events
        for event in events[self._told :]:
            self._record("/supervisor", max(0.0, event.t), event)
            self._live.phase = event.phase
        self._told = len(events)

    def _record(self, topic: str, t: float, message: Struct) -> None:
        if self.trouble is None:
            try:
                self._recorder.write(topic, t, message)
            except RecorderError as error:
                self.trouble = str(error)

    def _mark(self, t: float) -> None:
        if self.trouble is None:
            try:
                for line in self._recorder.mark(t):
                    errors.print(line, style="yellow", markup=False, soft_wrap=True)
            except RecorderError as error:
                self.trouble = str(error)

    def done(self, t: float) -> None:
        """See `Observer`."""
        heartbeat().beat()
        motions = {name: Motion(*state) for name, state in self._rig.truth()}
        self._record("/truth", t, Truth(t, motions))
        if len(motions) > 1 and t >= self._next:  # the five elements, live
            self._next = t + FORMATION_S - 1e-6  # ticks are sums of periods
            states = np.array([(m.x, m.y, m.vx, m.vy) for m in motions.values()])
            self._record("/formation", t, characterise(states[:, :2], states[:, 2:]))
        self.reports()
        if (loop := self._rig.loop) is not None:
            self._record("/loop", t, Loop(t, *loop))
        if self._pace is not None:
            self._record("/loop", t, Loop(t, self._pace.late_s, self._pace.busy_s))
        self._mark(t)
        self._live.done(t)


def maker(
    rig: str, experiment: Experiment, folder: Path, operator: Operator
) -> Callable[[Experiment], Rig]:
    """What builds this rig."""
    if rig == "twin":
        return make_twin
    from testbed.rig.wired.host import WireRig, anybody

    latch, latched = operator.latched(rig, experiment, str(folder))
    return lambda experiment: WireRig(
        experiment, bench=rig == "bench", log=folder, latch=latch, latched=latched,
        agree=operator.agree if rig == "table" else anybody,
        say=lambda text: errors.print(text, markup=False, soft_wrap=True),
    )  # fmt: skip


def fly_and_judge(
    experiment: Experiment,
    folder: Path,
    interrupt: Interrupt | None = None,
    make: Callable[[Experiment], Rig] | None = None,
    speed: float | None = None,
    operator: Operator | None = None,
) -> Metrics:
    """Fly, with the log in `folder`, and judge. `make` builds the rig; by default the twin."""
    interrupt = interrupt or Interrupt()
    rig, ending, wall = (make or make_twin)(experiment), Ending(0.0, None), 0.0
    live = LiveTable(experiment, errors)
    if operator is not None:
        operator.live = live
    pace = None
    if speed is not None and isinstance(rig, TwinRig):
        pace = Pace(rig.twin, speed)
        rig = replace(rig, pace=pace)
    aims = {name: ReferenceLog() for name in experiment.vehicles}
    recorder = Recorder(folder / "log.mcap", waits=rig.name == "twin")
    try:
        with recorder, live:
            with interrupt.at_once(), patience():
                warm_up(experiment, lambda: interrupt.asked)
            if not interrupt.asked:
                heartbeat().phase = Phase.FLYING
                watcher = Watcher(rig, aims, recorder, live, pace)
                live.flies()
                with steady():
                    began = time.perf_counter()
                    ending = rig.fly(
                        watcher,
                        stopped=lambda: interrupt.asked or watcher.trouble is not None,
                    )
                    wall = time.perf_counter() - began
                watcher.reports()
                if watcher.trouble is not None:
                    raise RecorderError(watcher.trouble)
    except RecorderError as error:
        ending = Ending(rig.now, f"log: {error}")
    heartbeat().phase = Phase.ENDING
    if ending.fault is None and (left := left_running()):
        ending = Ending(ending.t, left)
    completed = ending.fault is None and ending.t >= experiment.end_s
    metrics = measure(rig, aims, ending, wall, completed=completed)
    if recorder.lost:
        lost = Concern("log_rows_lost", f"{recorder.lost} rows: their writer did not keep up")
        metrics = replace(metrics, warnings=[*metrics.warnings, lost])
    return metrics


def measure(
    rig: Rig, aims: Mapping[str, ReferenceLog], ending: Ending, wall: float, *, completed: bool
) -> Metrics:
    """Judge a flight."""
    experiment, track = rig.experiment, rig.track()
    obstacles = experiment.obstacles
    vehicles, clear = {}, True
    for k, (name, setup) in enumerate(experiment.vehicles.items()):
        distances = obstacle_distances(track, k, obstacles)
        vehicles[name] = vehicle_metrics(
            track,
            k,
            setup.goal,
            aims[name].aim(),
            rig.spent(name),
            distances,
        )
        clear &= all(distance >= obstacles[n].radius for n, distance in distances.items())
    contacts = rig.contacts
    together = formation_metrics(
        experiment.controller, formation_context(experiment), track, obstacles
    )
    wanted = experiment.criteria.formation
    return Metrics(
        experiment=experiment.name,
        rig=rig.name,
        seed=experiment.seed,
        completed=completed,
        duration_s=ending.t,
        wall_s=wall,
        real_time_factor=ending.t / wall if wall > 0.0 else None,
        contacts=contacts,
        min_vehicle_distance_m=smallest_separation(track),
        fault=ending.fault,
        criteria=judge(experiment.criteria, vehicles, contacts, clear)
        | (judge_formation(wanted, together) if wanted else {}),
        vehicles=vehicles,
        **rig.wires(),
        formation=together,
        warnings=[*warnings_of(experiment), *rig.concerns()],
        phase=rig.supervisor.phase,
        red=rig.red,
    )
