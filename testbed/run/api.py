"""`import testbed`: fly an experiment from Python."""

import tempfile
import warnings
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from threading import current_thread, main_thread
from typing import Literal

from msgspec.structs import replace

from testbed.config import Experiment, dump, load
from testbed.core.error import TestbedError
from testbed.logs.log_reader import config_of, log_of
from testbed.logs.replay import Replay
from testbed.rig.chain import watched
from testbed.rig.firmware_boards import check_boards
from testbed.rig.interface import Rig
from testbed.rig.twin import make_twin
from testbed.run.arguments import check_experiment, check_number, check_overrides, path_of, wrong
from testbed.run.code_digest import own_version
from testbed.run.experiment import told_by
from testbed.run.flown import Run, read_run
from testbed.run.fly import fly_and_judge
from testbed.run.folder import (
    check_space,
    new_folder,
    take_back,
    utc_ns,
    write_config,
    write_metrics,
)
from testbed.run.fork import ForkError, check_fork, check_log, forked, resumed
from testbed.run.interrupt import Interrupt
from testbed.run.progress import Progress
from testbed.run.replay import replay_experiment
from testbed.run.report import write_page

NEW, FLOWN = "a new or empty folder", "the folder of a finished run"
Maker = Callable[[Path], Callable[[Experiment], Rig]]  # for a folder, what builds the rig


class InterruptedFlight(KeyboardInterrupt):
    """Ctrl-C ended a flight; `run` holds what was flown."""

    def __init__(self, run: Run) -> None:
        super().__init__(f"interrupted after {run.metrics.duration_s:g} s of flight")
        self.run = run


def fly(
    experiment: Experiment,
    rig: Literal["twin", "bench"] = "twin",
    log: str | Path | None = None,
    progress: bool = False,
) -> Run:
    """Fly an experiment and judge it.

    Args:
        experiment: what to fly, from `testbed.load`.
        rig: "twin", the simulated table; or "bench", real wires and firmware on this machine. The
            table itself is flown with `testbed run --rig table`, beside an operator.
        log: a new or empty folder for the run (config.toml, log.mcap, metrics.json); None: the run
            is in memory only.
        progress: show the progress on stderr.

    Returns:
        The run: `run.passed`, `run.metrics`, `run["sat1"].pose`.

    Raises:
        TestbedError: the experiment cannot fly on this rig, or the folder cannot be written. A
            fault in flight raises no exception: see `run.fault`.
        InterruptedFlight: Ctrl-C; a KeyboardInterrupt. The flight was ended and its files were
            finished first.
    """
    check_experiment("testbed.fly", experiment)
    return _fly(experiment, rig, _maker(rig), log, progress)


def _fly(
    experiment: Experiment, rig: str, make: Maker, log: str | Path | None, progress: bool
) -> Run:
    check_boards(experiment.board, {n: v.model for n, v in experiment.vehicles.items()}, rig)
    interrupt = Interrupt()
    with ExitStack() as stack:
        if log is None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="testbed-")))
            check_space(folder, "log=, or the variable TMPDIR")
        else:
            folder = new_folder(
                path_of("testbed.fly, log", log, NEW), experiment.name, option="log="
            )
        if current_thread() is main_thread():  # no other thread can be interrupted
            stack.enter_context(interrupt.caught())
        stack.enter_context(watched(experiment))
        try:
            write_config(folder, dump(experiment), own_version())
            screen = Progress(experiment.duration_s) if progress else None
            metrics = fly_and_judge(
                experiment, folder, interrupt, make(folder), screen=screen, epoch_ns=utc_ns()
            )
        except TestbedError:
            take_back(folder)
            raise
        write_metrics(folder, metrics)
        run = read_run(folder, None if log is None else folder, experiment)
    if interrupt.asked:
        raise InterruptedFlight(run)
    return run


def _maker(rig: str) -> Maker:
    if rig == "twin":
        return lambda folder: make_twin
    if rig == "bench":
        from testbed.rig.wired.host import WireRig

        return lambda folder: lambda experiment: WireRig(experiment, bench=True, log=folder)
    raise TestbedError(
        where="rig", expected='"twin" or "bench"', found=repr(rig),
        hint="an operator flies the table: `testbed run --rig table`" * (rig == "table"),
    )  # fmt: skip


def open_run(folder: str | Path) -> Run:
    """Open the folder of a finished run.

    Args:
        folder: run folder of `testbed run` or `testbed.fly(..., log=folder)`; or a log in it, for
            instance one that was renamed.

    Raises:
        TestbedError: it is not a run's folder, its files are of different runs, or its log cannot
            be read.

    Warns:
        UserWarning: a part of the log is missing; `Run.damage` has the same lines.
    """
    run = read_folder(folder)
    if run.damage:
        warnings.warn("\n".join(run.damage), stacklevel=2)
    return run


def read_folder(folder: str | Path) -> Run:
    """See `open_run`; without a warning."""
    where = "testbed.open_run"
    path = path_of(where, folder, FLOWN)
    if not path.exists():
        raise TestbedError(where=where, expected=FLOWN, found=f"no such folder: {folder}")
    if path.is_file() and not config_of(path).exists():
        raise TestbedError(where=where, expected=FLOWN, found=f"a file outside of one: {folder}")
    log_of(path)  # refuses a folder that is not a run's
    home = path if path.is_dir() else path.parent
    return read_run(path, home, load(config_of(path)))


def replay(run: Run, *overrides: str) -> Replay:
    """Feed a run's logged inputs to today's code and compare its outputs to the last bit.

    Args:
        run: of `open_run`, or of `fly` with a log.
        overrides: "key=value" of the experiment, to replay with other values.

    Returns:
        How many ticks were compared, and the first difference, if there is one.

    Raises:
        TestbedError: the run was not logged.
    """
    check_overrides("testbed.replay", overrides)
    log = _logged(run, "replay")
    with told_by("testbed.replay"):
        experiment = load(config_of(log), overrides)
    return replay_experiment(experiment, log)


def fork(
    run: Run, t: float, *overrides: str, log: str | Path | None = None, progress: bool = False
) -> Run:
    """Fly a run again on the twin up to a time, and on from there with changes.

    Args:
        run: of `open_run`, or of `fly` with a log.
        t: the first tick at or after it is the first with the changes [s].
        overrides: "key=value" as on the command line: of the law, `guidance`, `flight`, `inject`,
            or `seed`, which counts for cameras, links and pulses from then on; `name`,
            `description`, `criteria` and `duration_s` count for the whole run.
        log: a new or empty folder; None: a new one in runs/.
        progress: show the progress on stderr.

    Returns:
        The run, with folder, log and report; its report draws the original, too.

    Raises:
        TestbedError: the run has no log, it ended before `t`, its log lacks a part before `t`, or
            the flight up to `t` is not the one in the log.
        InterruptedFlight: see `fly`.
    """
    with told_by("fork"):
        return fly_on(run, t, *overrides, log=log, progress=progress)


def fly_on(
    run: Run,
    t: float,
    *overrides: str,
    log: str | Path | None = None,
    progress: bool = False,
    option: str = "log=",
) -> Run:
    """See `fork`; `option` is how the caller names another folder."""
    check_number("fork", t, "a time of the flight in seconds")
    t = float(t)  # numpy's too, as in run["sat1"].t
    check_overrides("fork", overrides)
    original = _logged(run, "fork")
    before = load(config_of(original))
    end = run.metrics.duration_s
    if not 0.0 <= t < end:  # first, because it may have ended before its experiment's end
        expected = f"a time of the flight, from 0 to before the flight's end at {end:g} s"
        raise ForkError(where="fork", expected=expected, found=f"{t:g} s")
    experiment = forked(before, t, overrides)
    check_log(original, t)
    make = _maker("twin")
    if run.metrics.rig != "twin":
        experiment, on_wires = replace(experiment, board="model"), resumed(original, t)
        make = lambda folder: on_wires  # noqa: E731
    out = None if log is None else path_of("fork, log", log, NEW)
    folder = new_folder(out, experiment.name, option=option)
    flown = _fly(experiment, "twin", make, folder, progress)
    check_fork(original, folder, t, before, experiment)
    write_page(folder, experiment)
    return flown


Run.fly_on = staticmethod(fly_on)


def _logged(run: Run, verb: str) -> Path:
    if not isinstance(run, Run):
        hint = f"testbed.open_run({str(run)!r})" if isinstance(run, str | Path) else ""
        raise wrong(f"{verb}, run", "a run, of testbed.open_run or testbed.fly", run, hint)
    if run.log is None:
        raise TestbedError(
            where=verb, expected="a run with a log", found="a run in memory",
            hint='fly it with log="folder"',
        )  # fmt: skip
    return run.log
