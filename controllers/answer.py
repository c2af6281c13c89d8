"""What a function of a user's law may return: finite real numbers, in an array of one shape.

numpy makes numbers of text and of booleans, and NaN of None; here they are errors that name the
function.
"""

import inspect
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.law_file import LawError
from testbed.core.law import Ahead

Array = NDArray[np.float64]

LONGEST = 60  # shown characters of what was returned
FORCE = "return np.array([fx, fy]), a number for each coordinate"
WHAT = {  # each function returns, and what to do if its shape is another one
    "force": ("a force [N]", FORCE),
    "rate": ("a force [N]", FORCE),
    "initial": ("the law's state", "return a flat array, as np.zeros(3)"),
    "jump": ("the law's state after the jump", "return a state as long as that of `initial`"),
    "broadcast": ("a message", "set `message_size` to the count of its numbers"),
    "propagate": ("an `Ahead` of testbed.core.law", "return its five parts, in their shapes"),
}
PAIR = "a force [N] and the rate of the law's state", "write `return force, rate`"
STATE_RATE = "the rate of the law's state", "return as many numbers as `initial` does"


class Asked(NamedTuple):
    """What is asked of a law's function."""

    place: str  # file, line and name of the function
    what: str  # it returns
    hint: str  # for another shape


def asked(verb: str, method: Any, path: Path | None) -> Asked:
    """What is asked of a law's function, the law's method `verb`; `path` of the law's file."""
    code = getattr(inspect.unwrap(method), "__code__", None)
    line = f":{code.co_firstlineno}" if code and code.co_filename == str(path) else ""
    return Asked(f"{path.name}{line}, in {verb}" if path else f"in {verb}", *WHAT[verb])


def numbers(
    value: Any, shape: tuple[int, ...] | None, asked: Asked, t: float | None = None
) -> Array:
    """A law's answer as an array of this shape; None is (n,), any length. `t` is the law's time.

    Raises:
        LawError: it is something else.
    """
    found = _read(value)
    if found is None:
        trouble, hint = shown(value), _cure(value)
    elif found.shape != shape and (shape is not None or found.ndim != 1):
        trouble, hint = f"shape {found.shape}, {shown(value)}", asked.hint
    elif not np.isfinite(found).all():
        trouble, hint = shown(value), "look for a division by zero, or a value never set"
    else:
        return found
    wanted = "(n,)" if shape is None else str(shape)
    raise _error(asked, f"{asked.what}: finite real numbers of shape {wanted}", trouble, hint, t)


def pair(
    value: Any, force: tuple[int, ...], state: tuple[int, ...], asked: Asked, t: float
) -> tuple[Array, Array]:
    """The answer of `rate`, a force and a rate of these shapes.

    Raises:
        LawError: it is something else.
    """
    several = isinstance(value, tuple | list) or (isinstance(value, np.ndarray) and value.ndim > 1)
    if not several or len(value) != 2:
        what, hint = PAIR
        raise _error(asked, what, shown(value), _cure(value) if value is None else hint, t)
    of_state = asked._replace(what=STATE_RATE[0], hint=STATE_RATE[1])
    return numbers(value[0], force, asked, t), numbers(value[1], state, of_state, t)


def ahead_of(value: Any, like: Ahead, asked: Asked, t: float) -> Ahead:
    """The answer of `propagate`, with the shapes of `like`.

    Raises:
        LawError: it is something else.
    """
    for name, part in zip(Ahead._fields, like, strict=True):
        if not hasattr(value, name):
            raise _error(asked, asked.what, shown(value), asked.hint, t)
        of_part = asked._replace(what=f"`{name}` of its `Ahead`")
        numbers(getattr(value, name), part.shape, of_part, t)
    found: Ahead = value
    return found


def shown(value: Any) -> str:
    """A value in one short line."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # a user's own object may define its text
        text = f"a {type(value).__name__}"
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def _error(asked: Asked, expected: str, found: str, hint: str, t: float | None) -> LawError:
    when = "" if t is None else f" at {t:.4g} s"
    return LawError(f"{asked.place}{when}", expected, found, hint)


def _read(value: Any) -> Array | None:
    """The value as real numbers; None: it has others, or none."""
    if isinstance(value, np.ndarray) and value.dtype == np.float64:
        return value
    try:
        found = np.asarray(value)
    except (ValueError, TypeError):  # rows of different lengths
        return None
    real = found.dtype.kind in "iuf" or (
        found.dtype.kind == "O"
        and all(isinstance(one, Real) and not isinstance(one, bool) for one in found.flat)
    )
    return found.astype(np.float64) if real else None


def _cure(value: Any) -> str:
    """What to do about something that is not real numbers."""
    if value is None:
        return "end the function with `return`, in each of its branches"
    try:
        kind = np.asarray(value).dtype.kind
    except (ValueError, TypeError):
        return "give all rows the same length"
    cures = {
        "c": "take the real part, or look for the square root of a negative number",
        "b": "return numbers, 1.0 and 0.0 instead of True and False",
        "U": "return numbers instead of text",
    }
    return cures.get(kind, "return numbers, as in np.array([0.1, 0.0])")
