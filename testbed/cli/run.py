"""`testbed run`: fly an experiment, watch it, keep it, judge it."""

import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from types import FrameType

import msgspec
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from testbed.cli.main import BAD_INPUT, FAILED, FAULT, INTERRUPTED, OK
from testbed.cli.result import print_result
from testbed.config import ConfigError, Experiment, dump, find, load
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
    try:
        experiment = load(find(name), overrides)
        folder = new_folder(out, experiment.name)
    except (ConfigError, FolderError) as error:
        errors.print(f"error: {error}", style="red", markup=False, soft_wrap=True)
        return BAD_INPUT
    write_config(folder, dump(experiment), version("airbearing-testbed"))
    metrics, interrupted = fly_and_judge(experiment, folder)
    write_metrics(folder, metrics)
    if as_json:
        sys.stdout.write((folder / "metrics.json").read_text())
    else:
        print_result(metrics, experiment, folder)
    if interrupted:
        return INTERRUPTED
    if metrics.fault:
        return FAULT
    return OK if all(metrics.criteria.values()) else FAILED


class Interrupt:
    """Ctrl-C and SIGTERM: in flight the first one asks the loop to end after its tick.

    Before and after the flight, and the second time, they raise KeyboardInterrupt.
    """

    def __init__(self) -> None:
        self.asked = False
        self._flying = False

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.asked or not self._flying:
            raise KeyboardInterrupt
        self.asked = True

    @contextmanager
    def caught(self) -> Iterator[None]:
        """Handle signals meanwhile."""
        before = {n: signal.signal(n, self._handle) for n in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    @contextmanager
    def in_flight(self) -> Iterator[None]:
        """Ask instead of raise meanwhile."""
        self._flying = True
        try:
            yield
        finally:
            self._flying = False


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


def warm_up(experiment: Experiment) -> None:
    """Fly a few ticks of the experiment, so that everything is compiled before the clock runs."""
    period = experiment.flight.jet_period_s
    make_twin(msgspec.structs.replace(experiment, duration_s=4 * period)).fly(_Nobody())


def fly_and_judge(experiment: Experiment, folder: Path) -> tuple[Metrics, bool]:
    """Fly into `folder`; the metrics, and whether the operator interrupted."""
    rig = make_twin(experiment)
    interrupt, ending, wall = Interrupt(), Ending(0.0, None), 0.0
    progress = Progress(
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed:.0f} s"),
        TimeRemainingColumn(), console=errors, transient=True, disable=not errors.is_terminal,
    )  # fmt: skip
    outputs: dict[str, list[Outputs]] = {name: [] for name in experiment.vehicles}
    with interrupt.caught():
        try:
            with Recorder(folder / "log.mcap") as recorder, progress:
                warming = progress.add_task("getting ready (compiles on the first run)", total=None)
                warm_up(experiment)
                progress.remove_task(warming)
                watcher = Watcher(rig, outputs, recorder, progress)
                began = time.perf_counter()
                with interrupt.in_flight(), steady():
                    ending = rig.fly(watcher, stopped=lambda: interrupt.asked)
                wall = time.perf_counter() - began
        except KeyboardInterrupt:
            interrupt.asked = True
            ending = Ending(rig.twin.now, None)
        except RecorderError as error:
            ending = Ending(rig.twin.now, f"log: {error}")
    done = ending.fault is None and ending.t >= experiment.ticks * experiment.flight.jet_period_s
    metrics = measure(rig, outputs, ending, wall, completed=done)
    return metrics, interrupt.asked and not done


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
    )
