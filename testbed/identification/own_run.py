"""A run folder of this project as a motion log: estimated poses and the pulses that were sent."""

from pathlib import Path

import numpy as np

from testbed.config import load
from testbed.core.vehicle import Vehicle
from testbed.identification.columns import LogRefusedError, digest
from testbed.identification.motion_log import FEWEST_POSES, MotionLog, gaps
from testbed.identification.prediction import Valves
from testbed.logs.history import gather
from testbed.logs.log_reader import LogReader, log_of


def read_run_log(folder: Path, body: str | None) -> MotionLog:
    """Read one vehicle's motion log from a run folder.

    Args:
        folder: of the run.
        body: name of the vehicle; None: the only one.

    Raises:
        LogRefusedError: the run has no such vehicle, or too few of its rows.
    """
    path = log_of(folder)
    history = gather(LogReader(path))
    names = list(history.vehicles)
    if body is None and len(names) == 1:
        body = names[0]
    if body is None or body not in history.vehicles:
        raise LogRefusedError(
            where=str(folder),
            expected=f"--body, one of: {', '.join(names)}",
            found=body or "none of them chosen",
        )
    own = history.vehicles[body]
    known = np.isfinite(own.pose).all(axis=1) & np.isfinite(own.at)
    if known.sum() < FEWEST_POSES:
        raise LogRefusedError(
            where=str(folder), expected=f"{FEWEST_POSES} poses", found=f"{known.sum()}"
        )
    pose = own.pose[known].copy()
    pose[:, 2] = np.unwrap(pose[:, 2])
    ticks, jets = np.nonzero(own.on > 0.0)
    up = own.t[ticks] + own.offset[ticks, jets]
    order = np.argsort(up, kind="stable")
    down = up + own.on[ticks, jets]
    inputs = Valves(up[order], down[order], jets[order].astype(np.int64))
    t = own.at[known]
    whole = np.ones(len(t), dtype=bool)
    return MotionLog(
        str(folder), digest(path), t, pose, whole, inputs, gaps(t), _flown(path.parent, body)
    )


def _flown(folder: Path, body: str) -> Vehicle | None:
    """The vehicle of the run's experiment; None: the log was taken out of its folder."""
    config = folder / "config.toml"
    return load(config).vehicles[body].model if config.is_file() else None
