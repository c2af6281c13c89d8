"""`testbed run`: fly an experiment, watch it, keep it, judge it."""

import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from types import FrameType

import msgspec
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from controllers.plain_law import LawError
from testbed.cli.main import BAD_INPUT, FAILED, FAULT, INTERRUPTED, OK
from testbed.cli.result import print_result
from testbed.config import ConfigError, Experiment, dump, find, load
from testbed.config.guarantee import warnings_of
from testbed.core.types import HostTick, Outputs, Tick
from testbed.flight.loop import Ending
from testbed.ops.folder import FolderError, new_folder, write_config, write_metrics
from testbed.ops.metrics import (
    Metrics,
    aim,
    judge,
    obstacle_distances,
    smallest_separation,
    vehicle_metrics,
)
from testbed.ops.recorder import Motion, Recorder, RecorderError, Truth
from testbed.ops.steady import steady
from testbed.rig import TwinRig, make_twin

errors = Console(stderr=True, highlight=False)


def run_experiment(name: str, overrides: Sequence[str], out: Path | None, as_json: bool) -> int:
    """Fly and return the exit code."""
    interrupt = Interrupt()
    try:
        experiment = load(find(name), overrides)
        with interrupt.caught():
            folder = new_folder(out, experiment.name)
            write_config(folder, dump(experiment), version("airbearing-testbed"))
            metrics = fly_and_judge(experiment, folder, interrupt)
            write_metrics(folder, metrics)
            if as_json:
                sys.stdout.write((folder / "metrics.json").read_text())
            else:
                print_result(metrics, experiment, folder)
    except (ConfigError, FolderError) as error:
        errors.print(f"error: {error}", style="red", markup=False, soft_wrap=True)
        return BAD_INPUT
    if metrics.fault:
        return FAULT
    if not metrics.completed:
        return INTERRUPTED
    return OK if all(metrics.criteria.values()) else FAILED


class Interrupt:
    """Ctrl-C and SIGTERM: noted, and the flight ends after its tick; files are always finished."""

    def __init__(self) -> None:
        self.asked = False
        self._raises = False

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        if self._raises:
            raise KeyboardInterrupt

    @contextmanager
    def caught(self) -> Iterator[None]:
        """Note signals meanwhile."""
        before = {n: signal.signal(n, self._handle) for n in (signal.SIGINT, signal.SIGTERM)}
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
    """Observer of a flight: log and progress bar, and the outputs kept for the metrics."""

    def __init__(
        self,
        rig: TwinRig,
        outputs: dict[str, list[Outputs]],
        recorder: Recorder,
        progress: Progress,
    ) -> None:
        self._rig, self._outputs = rig, outputs
        self._recorder, self._progress = recorder, progress
        total = rig.experiment.duration_s
        self._bar = progress.add_task(rig.experiment.name, total=total)
        self._shown, self._stride = 0.0, total / 100.0

    def vehicle(self, name: str, tick: Tick) -> None:
        """See `Observer`."""
        self._recorder.write(f"/{name}/tick", tick.inputs.t, tick)
        self._outputs[name].append(tick.outputs)

    def host(self, name: str, tick: HostTick) -> None:
        """See `Observer`."""
        self._recorder.write(f"/{name}/host", tick.inputs.t, tick)

    def done(self, t: float) -> None:
        """See `Observer`."""
        motions = {name: Motion(*state) for name, state in self._rig.truth()}
        self._recorder.write("/truth", t, Truth(t, motions))
        if t - self._shown >= self._stride:
            self._shown = t
            self._progress.update(self._bar, completed=t)


class _Nobody:
    """Observer of the warm-up."""

    def vehicle(self, name: str, tick: Tick) -> None: ...

    def host(self, name: str, tick: HostTick) -> None: ...

    def done(self, t: float) -> None: ...


def warm_up(experiment: Experiment, stopped: Callable[[], bool]) -> None:
    """Fly a few ticks of the experiment, so that everything is compiled before the clock runs."""
    period = experiment.flight.jet_period_s
    short = msgspec.structs.replace(experiment, duration_s=4 * period)
    make_twin(short).fly(_Nobody(), stopped)


def fly_and_judge(
    experiment: Experiment, folder: Path, interrupt: Interrupt | None = None
) -> Metrics:
    """Fly, with the log in `folder`, and judge."""
    interrupt = interrupt or Interrupt()
    rig, ending, wall = make_twin(experiment), Ending(0.0, None), 0.0
    progress = Progress(
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed:.0f} s"),
        TimeRemainingColumn(), console=errors, transient=True, disable=not errors.is_terminal,
    )  # fmt: skip
    outputs: dict[str, list[Outputs]] = {name: [] for name in experiment.vehicles}
    try:
        with Recorder(folder / "log.mcap") as recorder, progress:
            warming = progress.add_task("getting ready (compiles on the first run)", total=None)
            with interrupt.at_once():
                warm_up(experiment, lambda: interrupt.asked)
            progress.remove_task(warming)
            if not interrupt.asked:
                watcher = Watcher(rig, outputs, recorder, progress)
                began = time.perf_counter()
                with steady():
                    ending = rig.fly(watcher, stopped=lambda: interrupt.asked)
                wall = time.perf_counter() - began
    except (RecorderError, LawError) as error:
        what = "law" if isinstance(error, LawError) else "log"
        ending = Ending(rig.twin.now, f"{what}: {error}")
    planned = experiment.ticks * experiment.flight.jet_period_s
    completed = ending.fault is None and ending.t >= planned
    return measure(rig, outputs, ending, wall, completed=completed)


def measure(
    rig: TwinRig, outputs: dict[str, list[Outputs]], ending: Ending, wall: float, *, completed: bool
) -> Metrics:
    """Judge a flight."""
    experiment, track = rig.experiment, rig.track()
    obstacles = experiment.obstacles
    vehicles, clear = {}, True
    for k, (name, setup) in enumerate(experiment.vehicles.items()):
        vehicles[name] = vehicle_metrics(
            track, k, setup.goal, aim(outputs[name]), rig.spent(name), obstacles
        )
        distances = obstacle_distances(track, k, obstacles)
        clear &= all(distance >= obstacles[n].radius for n, distance in distances.items())
    contacts = len(rig.twin.plant.touches)
    return Metrics(
        experiment=experiment.name,
        rig="twin",
        seed=experiment.seed,
        completed=completed,
        duration_s=ending.t,
        wall_s=wall,
        real_time_factor=ending.t / wall if wall > 0.0 else None,
        contacts=contacts,
        min_vehicle_distance_m=smallest_separation(track),
        fault=ending.fault,
        criteria=judge(experiment.criteria, vehicles, contacts, clear),
        vehicles=vehicles,
        warnings=[*warnings_of(experiment), *rig.concerns()],
    )
