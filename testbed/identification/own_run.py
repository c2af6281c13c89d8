"""A run folder of this project as a motion log: poses of the cameras and the pulses that were sent.

The estimates in the log would not do: they follow the vehicle file with which they were made.
"""

from pathlib import Path

import numpy as np

from testbed.config import load
from testbed.core.error import TestbedError
from testbed.core.vehicle import Vehicle
from testbed.identification.columns import LogRefusedError, digest
from testbed.identification.motion_log import FEWEST_POSES, MotionLog, gaps
from testbed.identification.prediction import Valves
from testbed.logs.history import gather
from testbed.logs.log_reader import LogReader, log_of

# A run's commands answer the noise of its poses. In windows of 2.5 s, each with a state of its own,
# that looks like a smaller inertia (4 of 20 intervals missed it); a laboratory's log on a rough
# table needs short ones.
WINDOW_S = 6.0


def read_run_log(folder: Path, body: str | None) -> MotionLog:
    """Read one vehicle's motion log from a run folder.

    Args:
        folder: of the run.
        body: name of the vehicle; None: the only one.

    Raises:
        LogRefusedError: the run has no such vehicle, or too few of its rows.
    """
    path = log_of(folder)
    try:
        history = gather(LogReader(path))
        names = list(history.vehicles)
        found = "" if names else "no vehicle of a run in it"
    except TestbedError as error:
        if folder.is_dir():
            raise
        found = str(error)
    if found:
        raise LogRefusedError(
            where=str(folder), expected="a run of this project", found=found,
            hint="for another log give --mapping, see docs/calibrate.md",
        )  # fmt: skip
    if body is None and len(names) == 1:
        body = names[0]
    if body is None or body not in history.vehicles:
        raise LogRefusedError(
            where=str(folder),
            expected=f"--body, one of: {', '.join(names)}",
            found=body or "none of them chosen",
        )
    own = history.vehicles[body]
    seen = own.seen[np.isfinite(own.seen).all(axis=1)]
    _, first = np.unique(seen[:, 0], return_index=True)
    if len(first) < FEWEST_POSES:
        raise LogRefusedError(
            where=str(folder), expected=f"{FEWEST_POSES} poses", found=f"{len(first)}"
        )
    t, pose = seen[first, 0], seen[first, 1:].copy()
    pose[:, 2] = np.unwrap(pose[:, 2])
    ticks, jets = np.nonzero(own.on > 0.0)
    up = own.t[ticks] + own.offset[ticks, jets]
    order = np.argsort(up, kind="stable")
    down = up + own.on[ticks, jets]
    inputs = Valves(up[order], down[order], jets[order].astype(np.int64))
    whole = np.ones(len(t), dtype=bool)
    flown = _flown(path.parent, body)
    return MotionLog(str(folder), digest(path), t, pose, whole, inputs, gaps(t), flown, WINDOW_S)


def _flown(folder: Path, body: str) -> Vehicle | None:
    """The vehicle of the run's experiment; None: the log was taken out of its folder."""
    config = folder / "config.toml"
    return load(config).vehicles[body].model if config.is_file() else None
