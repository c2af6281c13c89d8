"""A finished run: its metrics, columns and figures."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from testbed.config import Experiment
from testbed.core.error import TestbedError
from testbed.core.extra import needs_extra
from testbed.logs.history import History, VehicleHistory
from testbed.logs.log_reader import log_of
from testbed.metrics.run_metrics import Metrics
from testbed.report.chart import alone
from testbed.report.figures import figures
from testbed.report.verdict import NOTHING_TO_JUDGE
from testbed.run.arguments import path_of
from testbed.run.experiment import texts_of, told_by
from testbed.run.recorded import recorded
from testbed.run.table import Table, UnknownNameError

Array = NDArray[np.float64]
UNITS = ("m", "m", "rad")
RATES = ("m/s", "m/s", "rad/s")
WRENCH = ("N", "N", "N m")


@dataclass(frozen=True, eq=False)
class Vehicle:
    """One vehicle's flight, one row per tick; NaN for missing values."""

    t: Array  # (n,) time of the tick [s]
    state_t: Array  # (n,) time of pose, twist and reference [s]
    pose: Array  # (n, 3) estimated x, y, theta [m, m, rad]
    twist: Array  # (n, 3) estimated vx, vy, omega [m/s, m/s, rad/s]
    reference: Array  # (n, 3) reference pose [m, m, rad]
    wrench: Array  # (n, 3) commanded wrench, mean over the period, body frame [N, N, N m]
    on_us: Array  # (n, jets) open time of each valve in the period; column 0 is jet 1 [us]
    true_pose: Array  # (n, 3) true pose at `t`; NaN if the rig has no ground truth [m, m, rad]

    def __repr__(self) -> str:
        return f"Vehicle of {len(self.t)} ticks, {self.on_us.shape[1]} jets"


class Run(Mapping[str, Vehicle]):
    """A run: `run["sat1"].pose`, `run.metrics`, `run.plot()`. A run equals itself only.

    Attributes:
        experiment: what was flown.
        metrics: the numbers of metrics.json.
        folder: where the run is kept; None for a run without a log.
        log: its log, which may have another name than log.mcap; None for a run without one.
        damage: a line for each part of the log that is missing; the rest is read.
        fly_on: as `testbed.fork`; api.py, which can fly, sets it.
    """

    fly_on: ClassVar[Callable[..., "Run"]]

    def __init__(
        self, experiment: Experiment, metrics: Metrics, history: History,
        folder: Path | None = None, damage: tuple[str, ...] = (), log: Path | None = None,
    ) -> None:  # fmt: skip
        self.experiment, self.metrics, self.folder, self.log = experiment, metrics, folder, log
        self._history, self.damage = history, damage

    @property
    def criteria(self) -> dict[str, bool]:
        """Each criterion of the experiment, met or not; empty if the run is not judged."""
        return dict(self.metrics.criteria or {})

    @property
    def passed(self) -> bool:
        """The flight reached its end without a fault and met all criteria."""
        m = self.metrics
        return m.completed and m.fault is None and not m.red and all(self.criteria.values())

    @property
    def fault(self) -> str | None:
        """Fault that ended the flight early; None without one."""
        return self.metrics.fault

    def __getitem__(self, name: str) -> Vehicle:
        """One vehicle's columns.

        Raises:
            KeyError: the run has no vehicle of this name; a `TestbedError` too.
        """
        if name not in self._history.vehicles:
            raise UnknownNameError(
                where="run", expected=f"one of {', '.join(self)}", found=repr(name)
            )
        return self._vehicles[name]

    __eq__, __hash__ = object.__eq__, object.__hash__  # a mapping's would compare arrays

    def __iter__(self) -> Iterator[str]:
        return iter(self._history.vehicles)

    def __len__(self) -> int:
        return len(self._history.vehicles)

    @cached_property
    def _vehicles(self) -> dict[str, Vehicle]:
        return {n: _columns(v, self._history.true_t) for n, v in self._history.vehicles.items()}

    def table(self, name: str) -> Table:
        """One vehicle's columns as a table with units, one number per cell."""
        vehicle = self[name]
        parts = (
            ("", vehicle.pose, ("x", "y", "theta"), UNITS),
            ("", vehicle.twist, ("vx", "vy", "omega"), RATES),
            ("reference_", vehicle.reference, ("x", "y", "theta"), UNITS),
            ("", vehicle.wrench, ("fx", "fy", "tau"), WRENCH),
            ("true_", vehicle.true_pose, ("x", "y", "theta"), UNITS),
        )
        columns, units = {"t": vehicle.t, "state_t": vehicle.state_t}, {"t": "s", "state_t": "s"}
        for prefix, values, names, kinds in parts:
            for k, (one, unit) in enumerate(zip(names, kinds, strict=True)):
                columns[prefix + one], units[prefix + one] = values[:, k], unit
        for k in range(vehicle.on_us.shape[1]):
            columns[f"jet{k + 1}_on"], units[f"jet{k + 1}_on"] = vehicle.on_us[:, k], "us"
        return Table(columns, units)

    def to_pandas(self) -> Any:
        """All vehicles in one pandas DataFrame, the vehicle's name in the first column."""
        with needs_extra("notebook"):
            import pandas as pd

        frames = []
        for name in self:
            frame = self.table(name).to_pandas()
            frame.insert(0, "vehicle", name)
            frames.append(frame)
        whole = pd.concat(frames, ignore_index=True)
        whole.attrs["units"] = self.table(next(iter(self))).units
        return whole

    def plot(self, *keys: str) -> "Figures":
        """The report's figures; a notebook shows them inline.

        Args:
            keys: names of figures ("trajectory", "error", "valves", ...); default: all.

        Raises:
            TestbedError: this run has no figure of that name.
        """
        charts = {chart.key: chart for chart in figures(self.experiment, self._history)}
        for key in keys:
            if key not in charts:
                raise TestbedError(
                    where="plot", expected=f"one of {', '.join(charts)}", found=repr(key)
                )
        return Figures({key: alone(charts[key]) for key in keys or charts})

    def fork(
        self, t: float, changes: Mapping[str, Any] | None = None, *,
        log: str | Path | None = None, **more: Any,
    ) -> "Run":  # fmt: skip
        """Fly this run again up to `t`, and on from there with changes; see `testbed.fork`.

        Args:
            t: the first tick at or after it is the first with the changes [s].
            changes: values by dotted key: `{"controller.bandwidth": 0.4}`, `seed=7`.
            log: a new or empty folder; None: a new one in runs/.
            more: changes as keyword arguments.

        Raises:
            TestbedError: see `testbed.fork`.
        """
        with told_by("fork"):
            return self.fly_on(self, t, *texts_of("fork", changes, more), log=log)

    def __repr__(self) -> str:
        m = self.metrics
        passed = "passed" if self.criteria else NOTHING_TO_JUDGE
        verdict = passed if self.passed else m.fault or (
            "not completed" if not m.completed
            else "failed " + ", ".join(k for k, met in self.criteria.items() if not met)
        )  # fmt: skip
        return f"Run of {m.experiment} on the {m.rig}, seed {m.seed}, {m.duration_s:g} s: {verdict}"


class Figures(Mapping[str, str]):
    """Figures as SVG, by name."""

    def __init__(self, drawings: Mapping[str, str]) -> None:
        self._drawings = dict(drawings)

    def __getitem__(self, key: str) -> str:
        """One figure of the report as SVG."""
        return self._drawings[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._drawings)

    def __len__(self) -> int:
        return len(self._drawings)

    def save(self, folder: str | Path) -> list[Path]:
        """Write each figure as KEY.svg into a folder, which is made if needed.

        Raises:
            TestbedError: `folder` is not the path of one.
            OSError: it cannot be written.
        """
        out = path_of("save", folder, "the path of a folder")
        out.mkdir(parents=True, exist_ok=True)
        paths = [out / f"{key}.svg" for key in self]
        for path, drawing in zip(paths, self.values(), strict=True):
            path.write_text(drawing, encoding="utf-8")
        return paths

    def __repr__(self) -> str:
        return f"Figures: {', '.join(self)}"

    def _repr_html_(self) -> str:
        return "".join(f'<div style="max-width:640px">{drawing}</div>' for drawing in self.values())


def _columns(vehicle: VehicleHistory, true_t: Array) -> Vehicle:
    true = np.full((len(vehicle.t), 3), np.nan)
    if len(true_t) == len(vehicle.true) and len(true_t):
        at = np.clip(np.searchsorted(true_t, vehicle.t - 1e-9), 0, len(true_t) - 1)
        same = np.abs(true_t[at] - vehicle.t) < 1e-6
        true[same] = vehicle.true[at[same], :3]
    return Vehicle(
        vehicle.t, vehicle.at, vehicle.pose, vehicle.twist, vehicle.reference,
        vehicle.commanded_wrench, np.rint(1e6 * vehicle.on), true,
    )  # fmt: skip


def read_run(files: Path, folder: Path | None, experiment: Experiment) -> Run:
    """Read the files of a run; `folder` is what `Run.folder` reports."""
    log = log_of(files)
    history, metrics, missing = recorded(log, experiment)
    return Run(
        experiment, metrics, history, folder, tuple(missing), None if folder is None else log
    )
