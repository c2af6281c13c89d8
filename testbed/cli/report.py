"""`testbed report`: the page of a run, made from its folder."""

from collections.abc import Iterable
from pathlib import Path

from rich.console import Console

from testbed.cli.main import OK
from testbed.cli.refusal import refuse
from testbed.config import ConfigError, Experiment, load
from testbed.logs.feed import LogFeed
from testbed.logs.history import gather
from testbed.logs.log_reader import LogError, LogReader, log_of
from testbed.report.page import ReportError, write_report
from testbed.run.post_mortem import judged

ZOOM = 4  # of a picture made of pixels: 2400 wide, 8 inches at 300 dpi


def report_run(folder: Path, png: bool = False) -> int:
    """Make the page and say where it is."""
    try:
        paths = make_report(folder)
        if png:
            make_pictures(paths[1:])
    except (ReportError, LogError, ConfigError, OSError) as error:
        return refuse(error)
    Console(highlight=False).print(str(paths[0]), markup=False, soft_wrap=True)
    return OK


def make_report(folder: Path) -> list[Path]:
    """The files of the page; all that it says is in the folder."""
    log_of(folder)  # or say that this is no run folder
    return write_page(folder, load(folder / "config.toml"))


def write_page(folder: Path, scenario: Experiment) -> list[Path]:
    """The same for an experiment that was read already, so that no file of a law is executed."""
    config, log = folder / "config.toml", log_of(folder)
    history = gather(LogFeed(LogReader(log)).news())
    text = config.read_text(encoding="utf-8")
    return write_report(folder, scenario, history, judged(folder, log, scenario, history), text)


def make_pictures(drawings: Iterable[Path]) -> None:
    """A PNG beside each SVG."""
    try:
        import resvg_py
    except ImportError:
        raise ReportError("PNG needs resvg-py: pip install 'airbearing-testbed[figures]'") from None
    for drawing in drawings:
        png = resvg_py.svg_to_bytes(
            svg_string=drawing.read_text(encoding="utf-8"), zoom=ZOOM, font_family="DejaVu Sans"
        )
        drawing.with_suffix(".png").write_bytes(bytes(png))
