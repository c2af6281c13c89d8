"""`testbed report`: regenerate the report page of a run folder."""

from pathlib import Path

from rich.console import Console

from testbed.cli.exit_code import OK
from testbed.cli.refusal import refuse, warn
from testbed.config import ConfigError
from testbed.logs.log_reader import LogError
from testbed.report.page import ReportError
from testbed.run.report import make_pictures, make_report


def report_run(folder: Path, png: bool = False) -> int:
    """Write the page and print its path."""
    try:
        paths = make_report(folder, warn)
        if png:
            make_pictures(paths[1:])
    except (ReportError, LogError, ConfigError, OSError) as error:
        return refuse(error)
    Console(highlight=False).print(str(paths[0]), markup=False, soft_wrap=True)
    return OK
