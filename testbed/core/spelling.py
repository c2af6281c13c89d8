"""Words of messages: counts with their nouns, and the known name that an unknown one meant."""

import difflib
from collections.abc import Iterable

LONGEST = 72  # characters of a name that are compared


def counted(count: int, noun: str) -> str:
    """Count and noun, as in "1 vehicle" and "2 vehicles"."""
    return f"{count} {noun}{'s' * (count != 1)}"


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """A hint at the nearest known name, or nothing."""
    close = difflib.get_close_matches(name[:LONGEST], list(known), n=1)
    return f" (did you mean `{close[0]}`?)" if close else ""
