"""`testbed log` and `testbed export`: list the topics of a log, and convert it."""

from pathlib import Path

from rich.console import Console
from rich.table import Table as Grid

from testbed.cli.exit_code import OK
from testbed.cli.refusal import refuse, warn
from testbed.cli.screen import print_json, show
from testbed.logs.export import WRITERS, ExportError, tables, to_bag
from testbed.logs.log_reader import LogError, LogReader, log_of
from testbed.logs.topics import Contents, survey
from testbed.run.missing_parts import lacks
from testbed.run.recorded import check_files


def show_log(run: Path, as_json: bool) -> int:
    """Print the topics of a log."""
    try:
        book = LogReader(log_of(run))
        topics = survey(book.read(), book.kinds)
        if not topics:
            raise LogError(f"{book.path}: there are no messages in the log")
    except LogError as error:
        return refuse(error)
    missing = lacks(book)
    warn(missing)
    contents = Contents(book.finished, topics, missing)
    if as_json:
        print_json(contents)
        return OK
    out, grid = Console(highlight=False), Grid(box=None, padding=(0, 1))
    for heading in ("topic", "kind"):
        grid.add_column(heading)
    for heading in ("count", "Hz", "to \\[s]", "gaps", "longest \\[s]", "MB"):
        grid.add_column(heading, justify="right")
    for topic in topics:
        longest = topic.longest_gap_s
        grid.add_row(
            topic.topic, topic.kind, str(topic.messages),
            "-" if topic.rate_hz is None else f"{topic.rate_hz:.1f}",
            f"{topic.last_s:.1f}", str(topic.gaps),
            "-" if longest is None else f"{longest:.2f}", f"{topic.megabytes:.2f}",
        )  # fmt: skip
    show(out, grid)
    return OK


def export_run(run: Path, kind: str, out: Path | None) -> int:
    """Convert the log to another format."""
    try:
        check_files(log_of(run))
        folder = out or log_of(run).parent / "export"
        folder.mkdir(parents=True, exist_ok=True)
        if kind == "rrd":
            from testbed.dashboard.recording import write_recording

            paths = [write_recording(run, folder / "run.rrd", warn)]
        else:
            book = LogReader(log_of(run))
            try:
                found = {} if kind == "bag" else tables(book)
                paths = to_bag(book, folder) if kind == "bag" else WRITERS[kind](found, folder)
            finally:
                warn(lacks(book))
            if book.last_s is None:
                raise LogError(f"{book.path}: there are no messages in the log")
    except (LogError, ExportError, ValueError, OSError) as error:
        return refuse(error)
    for path in paths:
        Console(highlight=False).print(str(path), markup=False, soft_wrap=True)
    return OK
