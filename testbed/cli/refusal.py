"""What a verb says when it cannot go on: where, what was expected, what was found."""

import errno
import textwrap
import traceback
from collections.abc import Iterable

from rich.console import Console

from testbed.cli.exit_code import BAD_INPUT, OUR_FAULT

LABEL = 12  # characters of "  expected  "

errors = Console(stderr=True, highlight=False)


def refuse(error: Exception | str, code: int = BAD_INPUT) -> int:
    """Tell the operator what is wrong; the exit code."""
    if isinstance(error, BrokenPipeError):  # nobody reads any more: click ends the program
        raise error
    text = of_the_disk(error) if isinstance(error, OSError) else error
    errors.print(laid_out(f"error: {text}"), style="red", markup=False, soft_wrap=True)
    return code


def warn(lines: Iterable[str]) -> None:
    """Tell the operator what is not as it should be, and go on."""
    for line in lines:
        errors.print(f"warning: {line}", style="yellow", markup=False, soft_wrap=True)


def confess() -> int:
    """Tell the operator where this software has failed; the exit code."""
    errors.print(traceback.format_exc().rstrip(), markup=False, soft_wrap=True)
    text = (
        "error: this software has failed, not your files\n"
        "  expected  to fly, or to say what is wrong\n"
        "  found     what is above; please report it, with the command and `testbed --version`"
    )
    errors.print(laid_out(text), style="red", markup=False, soft_wrap=True)
    return OUR_FAULT


def laid_out(text: str) -> str:
    """At a terminal, long lines of a message broken between words, under their beginning."""
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
    """What the system says of a file, in the form of every other message."""
    place, expected = error.filename2 or error.filename, "a file or folder that can be used"
    if place is None and error.errno == errno.ENOSPC:
        place, expected = "standard output", "room for what is printed"
    elif place is None:  # of a socket, for instance
        return str(error)
    elif isinstance(error, FileExistsError):
        expected = "a new file: nothing is written over; remove it, or name another with --out"
    return f"{place}\n  expected  {expected}\n  found     {error.strerror}"
