"""What a log that was read lacks: its damaged places, and its end if the flight went on."""

from pathlib import Path

from testbed.logs.log_reader import LogReader
from testbed.metrics.run_metrics import Metrics
from testbed.report.page import ReportError, read_metrics

SLACK_S = 0.25  # the last message of a whole log is at most this long before its flight's end


def lacks(book: LogReader) -> list[str]:
    """A line for each damaged place of a log that was read, and one if its end is missing."""
    return [*book.missing(), *_end(book)]


def is_whole(book: LogReader) -> bool:
    """Whether a log that was read holds its flight up to the end."""
    return not book.lost and not _end(book)


def metrics_of(folder: Path) -> Metrics | None:
    """Metrics in a run folder; None if there are none that can be read."""
    try:
        return read_metrics(folder)
    except ReportError:
        return None


def _end(book: LogReader) -> list[str]:
    """The line about the end of a log that is missing without damage."""
    metrics, last = metrics_of(book.path.parent), book.last_s or 0.0
    if book.cut_off and metrics is None:
        return [f"{book.path} has no end: its writer was killed, or it is still being flown"]
    if metrics is None:
        return []
    flown = f"{last:.2f} s, but its flight ended at {metrics.duration_s:.2f} s (metrics.json)"
    if book.cut_off:
        return [f"{book.path} is cut off at {flown}"]
    if book.finished and not book.lost and last < metrics.duration_s - SLACK_S:
        return [f"{book.path} ends at {flown}"]
    return []
