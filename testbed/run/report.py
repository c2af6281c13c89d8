"""The report page of a run, made from its folder."""

from collections.abc import Callable, Iterable
from pathlib import Path

from testbed.config import Experiment, load
from testbed.core.extra import pip_install
from testbed.logs.history import gather
from testbed.logs.log_reader import LogReader, log_of
from testbed.report.original import Original
from testbed.report.page import ReportError, write_report
from testbed.run.fork import origin_of
from testbed.run.post_mortem import judged

ZOOM = 4  # of a PNG: 2400 pixels wide, 8 inches at 300 dpi


def make_report(folder: Path, warn: Callable[[list[str]], None] = lambda lines: None) -> list[Path]:
    """Write the report page from the files of the run folder; returns its files.

    Args:
        folder: run folder.
        warn: called with a line for each damaged place of the log.
    """
    log_of(folder)  # raises if this is not a run folder
    return write_page(folder, load(folder / "config.toml"), warn)


def write_page(
    folder: Path, scenario: Experiment, warn: Callable[[list[str]], None] = lambda lines: None
) -> list[Path]:
    """Write the page for a loaded experiment, so that no law's file is executed."""
    config, log = folder / "config.toml", log_of(folder)
    book = LogReader(log)
    history = gather(book)
    warn(book.said())
    text = config.read_text(encoding="utf-8")
    metrics = judged(folder, log, scenario, history)
    return write_report(folder, scenario, history, metrics, text, _original(folder))


def _original(folder: Path) -> Original | None:
    """The original of a fork."""
    origin = origin_of(folder)
    if origin is None:
        return None
    run, t = origin
    return Original(run.resolve().name, t, gather(LogReader(log_of(run))))


def make_pictures(drawings: Iterable[Path]) -> None:
    """Write a PNG beside each SVG."""
    try:
        import resvg_py
    except ImportError:
        raise ReportError(f"PNG needs resvg-py: {pip_install('figures')}") from None
    for drawing in drawings:
        png = resvg_py.svg_to_bytes(
            svg_string=drawing.read_text(encoding="utf-8"), zoom=ZOOM, font_family="DejaVu Sans"
        )
        drawing.with_suffix(".png").write_bytes(bytes(png))
