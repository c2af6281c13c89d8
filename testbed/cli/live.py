"""The live table at a terminal during a flight; without a terminal, a status line at intervals.

The flight only stores its newest tick here; a display thread redraws a few times per second.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from threading import Event, Thread

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table as Grid

from testbed.cli.tracked import LINE_S
from testbed.config import Experiment
from testbed.flight.flown_tick import AnyTick
from testbed.report.fault_story import STOPPING_TOO
from testbed.report.goal_error import GoalError
from testbed.run.fly import FlightScreen

REFRESH_HZ = 8
CALM = "cyan"  # of a progress bar; red is for faults
NUMBERS = "error [mm]", "clearance [m]", "speed [mm/s]", "gas [%]", "pose age [ms]"
LEAST_STATE = 10  # width of a state, which folds [characters]


class LiveTable(FlightScreen):
    """The state of every vehicle in one table, and the progress of the flight.

    Args:
        experiment: the experiment that flies.
        console: where to print.
        line_s: interval of status lines without a terminal, and LINE_S of a line that does not
            change; None: no lines [s].
    """

    def __init__(
        self, experiment: Experiment, console: Console, line_s: float | None = None
    ) -> None:
        self._console, self._line_s = console, None if console.is_terminal else line_s
        self._end = Event()
        self._printer = Thread(target=self._print_lines, name="lines", daemon=True)
        self._experiment, self._goal_error = experiment, GoalError(experiment)
        self._ticks: dict[str, AnyTick] = {}
        self._t = 0.0
        self.phase = "DISARMED"  # of the supervisor
        self._progress = Progress(
            TextColumn("{task.description}"), BarColumn(complete_style=CALM),
            TextColumn("{task.completed:.0f} s"),
            TimeRemainingColumn(), console=console,
        )  # fmt: skip
        self._words = "getting ready (compiles on the first run)"
        self._bar = self._progress.add_task(self._words, total=None)
        self._live = Live(
            console=console, transient=True, refresh_per_second=REFRESH_HZ,
            get_renderable=self.picture,
        ) if console.is_terminal else None  # fmt: skip

    @contextmanager
    def showing(self) -> Iterator[None]:
        """See `FlightScreen`."""
        if self._line_s is not None:
            self._printer.start()
        try:
            with nullcontext() if self._live is None else self._live:
                yield
        finally:
            self._end.set()
            if self._line_s is not None:
                self._printer.join()

    def warn(self, line: str) -> None:
        """See `FlightScreen`."""
        self._console.print(line, style="yellow", markup=False, soft_wrap=True)

    def _print_lines(self) -> None:
        assert self._line_s is not None
        printed, silent_s = "", 0.0
        while not self._end.wait(self._line_s):
            silent_s += self._line_s
            if (line := self.line()) != printed or silent_s >= LINE_S:
                self._console.print(line, markup=False, highlight=False, soft_wrap=True)
                printed, silent_s = line, 0.0

    def line(self) -> str:
        """The status line: time, phase, errors, and vehicles that do not fly, culprits first."""
        if not self._ticks:
            return f"{self._experiment.name}: {self._words}, {self.phase}"
        parts = [f"{self._t:.0f} of {self._experiment.duration_s:g} s", self.phase]
        for name, error in self._off(self._t).items():
            parts.append(f"{name} {1e3 * error:.1f} mm off")
        own, following = list[str](), list[str]()
        for name, tick in self._newest():
            fault = tick.outputs.fault
            if reason := fault or tick.outputs.inhibit_reason:
                follows = fault is not None and fault.cause is not None
                (following if follows else own).append(f"{name}: {reason.words}")
        return f"{self._experiment.name}: {', '.join(parts + own + following)}"

    def _newest(self) -> list[tuple[str, AnyTick]]:
        """The newest tick of each vehicle, in the order of the experiment's file."""
        ticks = dict(self._ticks)  # the flight adds vehicles as their messages arrive
        return [(name, ticks[name]) for name in self._experiment.vehicles if name in ticks]

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Suspend the live table while a question is open."""
        if self._live is not None:
            self._live.stop()
        try:
            yield
        finally:
            if self._live is not None:
                self._live.start()

    def flies(self) -> None:
        """See `FlightScreen`."""
        self._words = "waiting for its vehicles" if self._line_s else self._experiment.name
        self._progress.update(self._bar, total=self._experiment.duration_s)

    def vehicle(self, name: str, tick: AnyTick) -> None:
        """See `Observer`."""
        self._ticks[name] = tick

    def done(self, t: float) -> None:
        """See `Observer`."""
        self._t = t

    def picture(self) -> RenderableType:
        """Table of the vehicles' current numbers."""
        words = f"{self._words} [bold]{self.phase}[/]"
        self._progress.update(self._bar, completed=self._t, description=words)
        if not self._ticks:
            return self._progress
        grid, ticks = Grid(box=None, pad_edge=False), self._newest()
        grid.add_column("vehicle", no_wrap=True)
        grid.add_column("state", overflow="fold")
        count = self._fitting(max(len(name) for name, _ in ticks))
        for heading in NUMBERS[:count]:
            grid.add_column(heading.replace("[", "\\["), justify="right", no_wrap=True)
        for name, tick in ticks:
            grid.add_row(*self._row(name, tick)[: 2 + count])
        return Group(self._progress, grid)

    def _fitting(self, longest_name: int) -> int:
        """How many of NUMBERS fit beside the names and the states."""
        used, count = max(longest_name, len("vehicle")) + 1 + LEAST_STATE, 0
        for heading in NUMBERS:
            used += 1 + len(heading)
            count += used <= self._console.width
        return max(1, count)

    def _off(self, t: float) -> dict[str, float]:
        """Distance of each vehicle from its reference [m]."""
        places = {
            name: np.array([[tick.outputs.state.pose.x, tick.outputs.state.pose.y]])
            for name, tick in self._newest()
            if tick.outputs.state is not None
        }
        off = self._goal_error.by_vehicle(np.array([t]), places)
        return {name: float(value[0]) for name, value in off.items()}

    def _row(self, name: str, tick: AnyTick) -> tuple[str, ...]:
        setup, out = self._experiment.vehicles[name], tick.outputs
        left = tick.inputs.health.tank_pressure / setup.model.air.tank_pressure
        gas = f"{100.0 * left:.0f}" if left > 0.0 else "-"  # no pressure gauge
        state = f"[yellow]{escape(out.inhibit_reason.words)}[/]" if out.inhibit_reason else "flies"
        if out.fault is not None and out.fault.cause is not None:
            state = f"[red]{STOPPING_TOO}[/]"
        elif out.fault is not None:
            state = f"[bold white on red]FAULT {escape(out.fault.title)}[/]"
        if (now := out.state) is None:
            return name, state, "-", "-", "-", gas, "-"
        pose = now.pose
        gaps = [
            math.hypot(
                pose.x - obstacle.position[0] - now.t * obstacle.velocity[0],
                pose.y - obstacle.position[1] - now.t * obstacle.velocity[1],
            )
            - obstacle.radius
            for obstacle in self._experiment.obstacles.values()
        ]
        error = self._off(now.t).get(name, math.nan)
        speed = math.hypot(now.twist.vx, now.twist.vy)
        return (
            name, state, "-" if math.isnan(error) else f"{1e3 * error:.1f}",
            f"{min(gaps):.3f}" if gaps else "-", f"{1e3 * speed:.1f}", gas,
            f"{1e3 * now.pose_age:.0f}",
        )  # fmt: skip
