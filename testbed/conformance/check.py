"""Shared by all checks: failing, running all, and calls that must not block."""

import inspect
import threading
from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")

PATIENCE_S = 10.0  # for a call that must return at once, on a machine that is busy


class NotConformingError(AssertionError):
    """A plug-in does not do what the testbed relies on."""

    def __init__(self, what: str, expected: str, found: str) -> None:
        super().__init__(f"{what}: expected {expected}, found {found}")


def must(holds: object, what: str, expected: str, found: object) -> None:
    """Fail the check with `expected` and `found` unless it holds."""
    if not holds:
        raise NotConformingError(what, expected, str(found))


def factory_of(suite: object) -> Callable[..., Any]:
    """`make` of a suite: a function in the body of a class is not one of its methods."""
    made = inspect.getattr_static(suite, "make")
    found: Callable[..., Any] = getattr(made, "__func__", made)
    return found


def run_all(suite: Any) -> None:
    """Run every check of a suite, without pytest."""
    for name in sorted(dir(suite)):
        if name.startswith("test_"):
            getattr(suite, name)()


def at_once(what: str, call: Callable[[], T]) -> T:
    """Result of a call; the check fails if the call blocks."""
    done: list[T] = []
    raised: list[BaseException] = []

    def run() -> None:
        try:
            done.append(call())
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=run, name=what, daemon=True)
    thread.start()
    thread.join(PATIENCE_S)
    must(not thread.is_alive(), what, "to return at once", f"waiting after {PATIENCE_S:g} s")
    if raised:
        raise NotConformingError(
            what, "no exception", f"{type(raised[0]).__name__}: {raised[0]}"
        ) from raised[0]
    return done[0]
