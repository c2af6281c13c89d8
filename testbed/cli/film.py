"""`testbed film`: a GIF or MP4 of a run."""

from pathlib import Path

from rich.console import Console

from testbed.cli.exit_code import OK
from testbed.cli.refusal import errors, refuse
from testbed.config import ConfigError
from testbed.logs.log_reader import LogError
from testbed.report.film import FilmError
from testbed.report.page import ReportError
from testbed.run.film import make_film


def film_run(run: Path, out: Path | None, speed: float | None, width: int) -> int:
    """Write the film and print its path."""
    try:
        with errors.status("drawing the film"):
            path = make_film(run, out, speed, width)
    except (FilmError, ReportError, LogError, ConfigError, OSError) as error:
        return refuse(error)
    Console(highlight=False).print(str(path), markup=False, soft_wrap=True)
    return OK
