"""Adapters for user-defined laws: plain Python objects as a `Law`, errors with file and line."""

import inspect
import math
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.law_file import UnusableLawError, blame
from testbed.core.error import TestbedError
from testbed.core.law import Ahead, Body, Concern, Law, Neighbours, World, concerns_of, fly_ahead

Array = NDArray[np.float64]

VERBS = {
    "force": ("own", "neighbours", "world", "t"),
    "rate": ("law_state", "own", "neighbours", "world", "t"),
    "initial": ("own", "neighbours", "world"),
    "jump": ("law_state", "own", "neighbours", "world", "t"),
    "broadcast": ("law_state", "own", "neighbours", "world", "t"),
}


class LawError(TestbedError):
    """A law failed in flight; the message names the line in its file."""


class PlainLaw:
    """A `Law` around an object with `force` or `rate` and, optionally, the other methods."""

    def __init__(self, law: Any, path: Path | None) -> None:
        has: dict[str, Any] = {verb: getattr(law, verb, None) for verb in VERBS}
        if not callable(has["force"]) and not callable(has["rate"]):
            expected = "an object with force(own, neighbours, world, t) or with rate(...)"
            raise UnusableLawError("law", expected, f"{type(law).__name__} with neither")
        for verb, method in has.items():
            if callable(method):
                _check_signature(verb, method, path)
        self._force, self._rate, self._initial = has["force"], has["rate"], has["initial"]
        for verb in ("jump", "broadcast"):  # `propagate` looks for them
            if callable(has[verb]):
                setattr(self, verb, has[verb])
        self.message_size = int(getattr(law, "message_size", 0))
        self._step = float(getattr(law, "step_s", 0.0))

    def initial(self, own: Body, neighbours: Neighbours, world: World) -> Array:
        """See `Law`."""
        if self._initial is None:
            return np.zeros(0)
        return np.array(self._initial(own, neighbours, world), dtype=float)

    def rate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World, t: float
    ) -> tuple[Array, Array]:
        """See `Law`."""
        if self._rate is None:
            force, change = self._force(own, neighbours, world, t), law_state
        else:
            force, change = self._rate(law_state, own, neighbours, world, t)
        if np.iscomplexobj(force) or np.iscomplexobj(change):
            raise ValueError(f"expected real numbers, found {force} and {change}")
        force, change = np.asarray(force, dtype=float), np.asarray(change, dtype=float)
        if force.shape != own.p.shape or change.shape != law_state.shape:
            raise ValueError(
                f"expected a force of shape {own.p.shape} and a rate of shape {law_state.shape}, "
                f"found {force.shape} and {change.shape}"
            )
        return force, change

    def propagate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World,
        t: float, duration: float, steps: int,
    ) -> Ahead:  # fmt: skip
        """See `Law`."""
        if self._step > 0.0:
            steps = min(steps, math.ceil(duration / self._step - 1e-9))
        return propagate_plain(self, law_state, own, neighbours, world, t, duration, steps)


def propagate_plain(
    law: Any, law_state: Array, own: Body, neighbours: Neighbours, world: World,
    t: float, duration: float, steps: int,
) -> Ahead:  # fmt: skip
    """`propagate` in plain Python, for a law with a method `rate`."""
    plain = getattr(fly_ahead, "py_func", fly_ahead)  # numba may be switched off
    return plain(own.p.shape[0], law, law_state, own, neighbours, world, t, duration, steps)


def _check_signature(verb: str, method: Callable[..., Any], path: Path | None) -> None:
    signature = inspect.signature(method)
    try:
        signature.bind(*VERBS[verb])
    except TypeError:
        found = f"{path.name}: " if path else ""
        expected = f"{verb}({', '.join(VERBS[verb])})"
        raise UnusableLawError("law", expected, f"{found}{verb}{signature}") from None


class Watched:
    """Wraps a user-defined law; its errors become `LawError`s with file and line."""

    def __init__(self, law: Law, path: Path | None) -> None:
        self._law, self._path = law, path
        self.message_size = law.message_size

    def concerns(self, law_state: Array) -> list[Concern]:
        """See `concerns_of`."""
        return concerns_of(self._law, law_state)

    def _watch(self, verb: str, *arguments: Any) -> Any:
        try:
            return getattr(self._law, verb)(*arguments)
        except KeyboardInterrupt as error:
            if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
                raise  # the operator's: in flight a handler counts Ctrl-C
            raise LawError(blame(error, self._path)) from error
        except BaseException as error:  # it is the user's code, and may call sys.exit
            raise LawError(blame(error, self._path)) from error

    def initial(self, own: Body, neighbours: Neighbours, world: World) -> Array:
        """See `Law`."""
        return self._watch("initial", own, neighbours, world)

    def rate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World, t: float
    ) -> tuple[Array, Array]:
        """See `Law`."""
        return self._watch("rate", law_state, own, neighbours, world, t)

    def propagate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World,
        t: float, duration: float, steps: int,
    ) -> Ahead:  # fmt: skip
        """See `Law`."""
        ahead = self._watch("propagate", law_state, own, neighbours, world, t, duration, steps)
        if not np.isfinite(ahead.mean_force).all():
            name = self._path.name if self._path else "the law"
            raise LawError(f"{name}: force is not finite, {ahead.mean_force}, at {t:g} s")
        return ahead
