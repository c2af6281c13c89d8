"""The report page of a run, made from its folder."""

from collections.abc import Callable, Iterable
from pathlib import Path

from msgspec.structs import replace

from testbed.config import Experiment, load
from testbed.core.extra import pip_install
from testbed.core.law import Concern
from testbed.logs.log_reader import log_of
from testbed.report.page import ReportError, write_report
from testbed.run.origin import drawn_original, read_origin
from testbed.run.recorded import recorded

ZOOM = 4  # of a PNG: 2400 pixels wide, 8 inches at 300 dpi


def make_report(folder: Path, warn: Callable[[list[str]], None] = lambda lines: None) -> list[Path]:
    """Write the report page from the files of the run folder; returns its files.

    Args:
        folder: run folder.
        warn: called with a line for each thing that is missing; the page has them, too.
    """
    log_of(folder)  # raises if this is not a run folder
    return write_page(folder, load(folder / "config.toml"), warn)


def write_page(
    folder: Path, scenario: Experiment, warn: Callable[[list[str]], None] = lambda lines: None
) -> list[Path]:
    """Write the page for a loaded experiment, so that no law's file is executed."""
    history, metrics, missing = recorded(log_of(folder), scenario, warn)
    note, original, changed = read_origin(folder), None, []
    if note is not None:
        original, unread = drawn_original(folder, note, history)
        warn(unread)
        missing, changed = [*missing, *unread], note.whole
    # the page may be read elsewhere: its files are named without their folder
    concerns = [Concern("missing", line.replace(f"{folder}/", "")) for line in missing]
    metrics = replace(metrics, warnings=[*metrics.warnings, *concerns])
    text = (folder / "config.toml").read_text(encoding="utf-8")
    return write_report(folder, scenario, history, metrics, text, original, changed)


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
