"""`testbed run`: fly an experiment, log it and judge it."""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, redirect_stdout
from functools import partial
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from controllers.law_file import LawError, UnusableLawError
from testbed.cli.live import LiveTable
from testbed.cli.operator import Operator
from testbed.cli.refusal import errors, refuse, warn
from testbed.cli.result import code_of, print_result
from testbed.cli.screen import print_text
from testbed.cli.viewers import Viewers
from testbed.config import ConfigError, Experiment, dump, find, load
from testbed.dashboard.viewer import ViewerError
from testbed.flight.safety import SPARE_S
from testbed.logs.log_reader import LogError
from testbed.metrics.run_metrics import Metrics
from testbed.net.flight_note import noted, own_note, request_socket, tell_heard
from testbed.net.operator_requests import RequestServer
from testbed.realtime.heartbeat import RunPhase, heartbeat, process_to_end
from testbed.report.page import ReportError
from testbed.rig.chain import watched
from testbed.rig.firmware_boards import check_boards
from testbed.rig.interface import Rig
from testbed.rig.live import LiveFlight
from testbed.rig.twin import make_twin
from testbed.run.code_digest import own_version
from testbed.run.fly import fly_and_judge
from testbed.run.folder import (
    FolderError,
    new_folder,
    take_back,
    utc_ns,
    write_config,
    write_forks,
    write_metrics,
)
from testbed.run.interrupt import Interrupt
from testbed.run.report import write_page

LINE_S = 10.0  # interval of status lines without a terminal [s]
FILES_S = 4.0  # time to finish the log of a flight that was stopped [s]


class RunOptions(Struct, frozen=True):
    """The command line of `testbed run`, beside the experiment and its overrides."""

    rig: str = "twin"
    out: Path | None = None  # run folder; None: a new one in runs/
    as_json: bool = False
    view: str | None = None  # dashboard: "window" or "web"
    console: int | None = None  # port of the operator's page; 0: its default
    bind: str | None = None  # network address of what is served
    port: int | None = None  # data port of the dashboard
    speed: float | None = None  # multiple of real time; None: as fast as possible
    arm: bool = False  # without asking
    reset: bool = False  # the latched fault
    here: bool = False  # with loopback addresses instead of the lab's

    @property
    def pace(self) -> float | None:
        """The multiple of real time, which is 1 for a viewer."""
        watched_live = self.view is not None or self.console is not None
        return 1.0 if watched_live and self.speed is None else self.speed


def run_experiment(name: str, overrides: Sequence[str], options: RunOptions) -> int:
    """Fly an experiment; return the exit code."""
    interrupt, viewers, folder = Interrupt(tell_heard), None, None
    operator = Operator(arm=options.arm, reset=options.reset, at_once=interrupt.at_once)
    try:
        experiment = _experiment(name, overrides, options)
        operator.must_be_there(options.rig)
        viewers = Viewers(options.view, options.console, options.bind, options.port)
        with interrupt.caught(), watched(experiment):
            folder = new_folder(options.out, experiment.name)
            metrics, experiment = _flown(experiment, folder, options, interrupt, operator, viewers)
            write_metrics(folder, metrics)
            if options.as_json:
                sys.stdout.write((folder / "metrics.json").read_text())
            else:
                print_result(metrics, experiment, folder)
            report(folder, experiment)
    except (ConfigError, ViewerError, UnusableLawError, LawError) as error:
        if viewers is not None:
            viewers.end()
        if folder is not None:
            take_back(folder)
        return refuse(error)
    except FolderError as error:
        return refuse(error)
    viewers.finish()
    for check in metrics.red:
        print_text(errors, f"red: {check.words}", "red")
    return code_of(metrics)


def _experiment(name: str, overrides: Sequence[str], options: RunOptions) -> Experiment:
    with redirect_stdout(sys.stderr):  # keeps a law's prints out of the result
        experiment = load(find(name), overrides)
    if options.here:
        experiment = on_this_machine(experiment, options.rig)
    models = {vehicle: setup.model for vehicle, setup in experiment.vehicles.items()}
    check_boards(experiment.board, models, options.rig)
    return experiment


def _flown(
    experiment: Experiment, folder: Path, options: RunOptions,
    interrupt: Interrupt, operator: Operator, viewers: Viewers,
) -> tuple[Metrics, Experiment]:  # fmt: skip
    """Fly; the metrics, and the experiment with the changes that its page made."""
    rig, pace = options.rig, options.pace
    with ExitStack() as stack, noted_here(rig, experiment, folder, pace):
        write_config(folder, dump(experiment), own_version())
        own = heartbeat()
        own.rig, own.folder, own.phase = rig, str(folder), RunPhase.COMPILING
        viewers.start(experiment, folder)
        has_page = options.console is not None
        live = stack.enter_context(opened(experiment, folder)) if has_page else None
        make = maker(rig, experiment, folder, operator, live)
        # without a terminal, a flight in real time prints status lines
        line_s = None if rig == "twin" and pace is None else LINE_S
        operator.live = LiveTable(experiment, errors, line_s)
        with redirect_stdout(sys.stderr):
            metrics = fly_and_judge(
                experiment, folder, interrupt, make, pace, operator.live, utc_ns()
            )
        return metrics, experiment if live is None else live.experiment


def on_this_machine(experiment: Experiment, rig: str) -> Experiment:
    """The experiment with the addresses of `testbed twin --local` instead of the lab's."""
    if rig != "table":
        raise ConfigError("command line", "--local", "--rig table", f"--rig {rig}")
    from testbed.rig.wired.local import local

    return local(experiment)


def noted_here(
    rig: str, experiment: Experiment, folder: Path, pace: float | None
) -> AbstractContextManager[None]:
    """Registers the run for `testbed stop`; a host on bench or table replaces the note by its own.

    That one also warns if there is no place for it.
    """
    flight = experiment.flight
    # a tick that has begun is finished before the brake
    brake_s = flight.jet_period_s + flight.ending.brake_s + SPARE_S

    def warn_on_twin(text: str) -> None:
        if rig == "twin":
            errors.print(text, style="yellow", markup=False, soft_wrap=True)

    return noted(
        "", "", vehicles=list(experiment.vehicles), name=experiment.name, pid=process_to_end(),
        warn=warn_on_twin, folder=folder, rig=rig, ends_s=brake_s / (pace or 1.0) + FILES_S,
    )  # fmt: skip


def report(folder: Path, experiment: Experiment) -> None:
    """Write the report page; a failure is only a warning and keeps the verdict."""
    try:
        write_page(folder, experiment, warn)
    except (ReportError, LogError) as error:
        errors.print(
            f"warning: no report: {error}\n  later     testbed report {folder}",
            style="yellow", markup=False, soft_wrap=True,
        )  # fmt: skip


@contextmanager
def opened(experiment: Experiment, folder: Path) -> Iterator[LiveFlight | None]:
    """A flight that its page can change; None: it cannot."""
    try:
        server = RequestServer(request_socket(own_note()))
    except OSError as error:
        warn([f"no live gains and no flying by hand: {error}"])
        yield None
        return
    with server:
        yield LiveFlight(experiment, server, partial(write_forks, folder))


def maker(
    rig: str, experiment: Experiment, folder: Path, operator: Operator,
    live: LiveFlight | None = None,
) -> Callable[[Experiment], Rig]:  # fmt: skip
    """The function that builds this rig."""
    if rig == "twin":
        return lambda experiment: replace(make_twin(experiment), live=live)
    from testbed.console.checklist import write_checks
    from testbed.rig.wired.host import WireRig

    latch, latched = operator.latched(rig, experiment, str(folder))
    return lambda experiment: WireRig(
        experiment, bench=rig == "bench", log=folder, latch=latch, latched=latched, live=live,
        agree=operator.agree if rig == "table" else lambda names: True,
        notify=lambda text: errors.print(text, markup=False, soft_wrap=True),
        checked=partial(write_checks, folder),
    )  # fmt: skip
