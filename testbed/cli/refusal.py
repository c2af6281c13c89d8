"""Error messages of the verbs: where, what was expected, what was found."""

import errno
import textwrap
import traceback
from collections.abc import Iterable

from rich.console import Console

from testbed.cli.exit_code import BAD_INPUT, OUR_FAULT
from testbed.cli.screen import print_text
from testbed.core.error import TestbedError

LABEL = 12  # characters of "  expected  "

errors = Console(stderr=True, highlight=False)


def refuse(error: Exception | str, code: int = BAD_INPUT) -> int:
    """Print an error; returns the exit code."""
    if isinstance(error, BrokenPipeError):  # the reader of the pipe has ended: click exits
        raise error
    text = of_the_disk(error) if isinstance(error, OSError) else error
    errors.print(laid_out(f"error: {text}"), style="red", markup=False, soft_wrap=True)
    return code


def warn(lines: Iterable[str]) -> None:
    """Print warnings on stderr, one line each."""
    for line in lines:
        print_text(errors, f"warning: {line}", "yellow")


def print_internal_error() -> int:
    """Print the traceback of an internal error; returns the exit code."""
    errors.print(traceback.format_exc().rstrip(), markup=False, soft_wrap=True)
    text = TestbedError(
        where="internal error; your files are not the cause", expected="no exception",
        found="the traceback above",
        hint="please report it with the command and `testbed --version`",
    )  # fmt: skip
    errors.print(laid_out(f"error: {text}"), style="red", markup=False, soft_wrap=True)
    return OUR_FAULT


def laid_out(text: str) -> str:
    """The message, its long lines wrapped and indented at a terminal."""
    if not errors.is_terminal:
        return text
    lines = []
    for line in text.splitlines():
        indent = " " * LABEL if line.startswith("  ") else "  "
        lines += textwrap.wrap(
            line, errors.width, subsequent_indent=indent,
            break_long_words=False, break_on_hyphens=False, drop_whitespace=True,
        ) or [""]  # fmt: skip
    return "\n".join(lines)


def of_the_disk(error: OSError) -> str:
    """An OSError as where, expected and found."""
    place, expected = error.filename2 or error.filename, "a usable file or folder"
    if place is None and error.errno == errno.ENOSPC:
        place, expected = "standard output", "free space on its disk"
    elif place is None:  # of a socket, for instance
        return str(error)
    elif isinstance(error, FileExistsError):
        expected = (
            "a new file, because nothing is overwritten; remove it, or name another with --out"
        )
    return str(TestbedError(where=str(place), expected=expected, found=str(error.strerror)))
