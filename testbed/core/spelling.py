"""Suggests the known name that an unknown one probably meant."""

import difflib
from collections.abc import Iterable

LONGEST = 72  # characters of a name that are compared


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """A hint at the nearest known name, or nothing."""
    close = difflib.get_close_matches(name[:LONGEST], list(known), n=1)
    return f" (did you mean `{close[0]}`?)" if close else ""
