"""Judges and reports a run whose process died, from its log.

No user code runs here: the law that ended the run would do it again.
"""

import sys
from contextlib import suppress
from pathlib import Path

import msgspec
from msgspec.structs import replace

from testbed.cli.refusal import errors
from testbed.cli.result import print_result
from testbed.cli.screen import print_text
from testbed.config import Experiment, read_toml
from testbed.config.guarantee import warnings_of
from testbed.core.codes import FaultId, FaultReport
from testbed.logs.history import gather
from testbed.logs.log_reader import LogError, LogReader
from testbed.metrics.run_metrics import Metrics
from testbed.report.page import UNCOUNTED
from testbed.run.folder import write_metrics
from testbed.run.post_mortem import of_the_log
from testbed.run.report import write_page


def finish_run(folder: Path, rig: str, fault: str | None, *, as_json: bool) -> None:
    """Write metrics.json and the report, and print the result; `fault` is None if interrupted."""
    experiment = msgspec.convert(read_toml(folder / "config.toml"), Experiment)
    metrics = replace(
        _of_what_is_there(folder / "log.mcap", experiment),
        rig=rig,
        fault=fault,
        fault_report=None if fault is None else FaultReport(FaultId.PROCESS_ENDED, fault),
        phase="FAULT" if fault else "STOPPED",
        warnings=list(warnings_of(experiment)),
    )
    write_metrics(folder, metrics)
    with suppress(OSError):  # the terminal may be closed; the page is still written
        if as_json:
            sys.stdout.write((folder / "metrics.json").read_text())
        else:
            print_result(metrics, experiment, folder)
        sys.stdout.flush()
    with suppress(LogError):  # the warning above says why there is no page
        write_page(folder, experiment)


def _of_what_is_there(log: Path, experiment: Experiment) -> Metrics:
    """Metrics from the readable part of the log; empty metrics without a log."""
    try:
        return of_the_log(log, experiment, gather(LogReader(log)))
    except LogError as error:
        print_text(errors, f"warning: {error}", "yellow")
    return Metrics(
        experiment=experiment.name,
        rig="",
        seed=experiment.seed,
        completed=False,
        duration_s=0.0,
        wall_s=0.0,
        real_time_factor=None,
        contacts=UNCOUNTED,
        min_vehicle_distance_m=None,
        fault=None,
        criteria={},
        vehicles={},
    )
