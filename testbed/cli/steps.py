"""Names the steps of a long calculation, on standard error; at a terminal with the time of each."""

from types import TracebackType

from rich.console import Console
from rich.progress import Progress, TaskID, TextColumn, TimeElapsedColumn

from testbed.cli.screen import print_text


class Steps:
    """A context manager that is called with the name of each step as it begins.

    Args:
        console: where to print.
        silent: print nothing.
    """

    def __init__(self, console: Console, *, silent: bool = False) -> None:
        self._console, self._silent = console, silent
        self._progress = Progress(
            TextColumn("{task.description}", style="dim", markup=False), TimeElapsedColumn(),
            console=console, disable=silent or not console.is_terminal,
        )  # fmt: skip
        self._step: TaskID | None = None

    def __enter__(self) -> "Steps":
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:  # fmt: skip
        self._end()
        self._progress.stop()

    def __call__(self, text: str) -> None:
        """A step begins; the one before has ended."""
        self._end()
        if self._silent:
            return
        if self._console.is_terminal:
            self._step = self._progress.add_task(text, total=1)
        else:
            print_text(self._console, text, "dim")

    def _end(self) -> None:
        if self._step is not None:
            self._progress.update(self._step, completed=1)
            self._step = None
