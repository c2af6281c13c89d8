"""Adapters for user-defined laws: plain Python objects as a `Law`, errors with file and line.

A plain law gets read-only arrays, because a write would move the vehicle of its prediction. The
norm of its force is limited to `own.max_force`, as that of the shipped laws.
"""

import inspect
import math
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from numbers import Integral, Real
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from controllers.answer import ahead_of, asked, numbers, pair
from controllers.law_file import LawError, UnusableLawError, blame
from testbed.core.law import (
    Ahead,
    Body,
    CompiledLaw,
    Concern,
    Law,
    Neighbours,
    World,
    concerns_of,
    fly_ahead,
)
from testbed.core.law_verbs import broadcast_of, jump_of

Array = NDArray[np.float64]
T = TypeVar("T")

ROUNDING = 1e-9  # a law that limits its own force may exceed the limit by this share
TRIAL_S = 0.1  # of a trial of `propagate`
VERBS = {
    "force": ("own", "neighbours", "world", "t"),
    "rate": ("law_state", "own", "neighbours", "world", "t"),
    "initial": ("own", "neighbours", "world"),
    "jump": ("law_state", "own", "neighbours", "world", "t"),
    "broadcast": ("law_state", "own", "neighbours", "world", "t"),
}


class PlainLaw:
    """A `Law` around an object with `force` or `rate` and, optionally, the other methods.

    Args:
        law: the object.
        path: of its file, for messages.
        limited: limit its force.
    """

    def __init__(self, law: Any, path: Path | None, *, limited: bool = True) -> None:
        has: dict[str, Any] = {verb: getattr(law, verb, None) for verb in VERBS}
        if not callable(has["force"]) and not callable(has["rate"]):
            expected = "an object with force(own, neighbours, world, t) or with rate(...)"
            raise UnusableLawError("law", expected, f"{type(law).__name__} with neither")
        for verb, method in has.items():
            if callable(method):
                _check_signature(verb, method, path)
        self._force, self._rate, self._initial = has["force"], has["rate"], has["initial"]
        self._jump, self._broadcast = has["jump"], has["broadcast"]
        if callable(self._jump):  # `propagate` looks for `jump` and `broadcast`
            self.jump = self._jumped
        if callable(self._broadcast):
            self.broadcast = self._checked_message
        self.message_size = _message_size(law, path)
        if self.message_size and not callable(self._broadcast):
            expected = f"a method broadcast({', '.join(VERBS['broadcast'])}), which gives a message"
            raise UnusableLawError("law", expected, f"message_size = {self.message_size} and none")
        made = {verb: method for verb, method in has.items() if callable(method)}
        self._asked = {verb: asked(verb, method, path) for verb, method in made.items()}
        self._step, self._limited = _step(law, path), limited
        self._given: tuple[Any, ...] = (None, None, None)  # of the newest call
        self._shown: tuple[Any, ...] = self._given  # the same, read-only

    def _show(self, own: Body, neighbours: Neighbours, world: World) -> tuple[Any, ...]:
        """The arguments with read-only arrays; `propagate` gives the same ones in all steps."""
        mine, theirs, around = self._given
        if own is not mine or neighbours is not theirs or world is not around:
            self._given = own, neighbours, world
            self._shown = read_only(self._given)
        return self._shown

    def initial(self, own: Body, neighbours: Neighbours, world: World) -> Array:
        """See `Law`."""
        if self._initial is None:
            return np.zeros(0)
        state = self._initial(*self._show(own, neighbours, world))
        return numbers(state, None, self._asked["initial"]).copy()

    def _jumped(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World, t: float
    ) -> Array:
        """The law may change this state in place: it is a copy."""
        after = self._jump(law_state.copy(), *self._show(own, neighbours, world), t)
        return numbers(after, law_state.shape, self._asked["jump"], t)

    def _checked_message(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World, t: float
    ) -> Array:
        shown = self._show(own, neighbours, world)
        message = self._broadcast(read_only(law_state), *shown, t)
        return numbers(message, (self.message_size,), self._asked["broadcast"], t)

    def rate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World, t: float
    ) -> tuple[Array, Array]:
        """See `Law`."""
        shown = self._show(own, neighbours, world)
        if self._rate is None:
            force = numbers(self._force(*shown, t), own.p.shape, self._asked["force"], t)
            change = np.zeros(len(law_state))
        else:
            both = self._rate(read_only(law_state), *shown, t)
            force, change = pair(both, own.p.shape, law_state.shape, self._asked["rate"], t)
        size = math.hypot(*force.tolist())
        if self._limited and own.max_force * (1.0 + ROUNDING) < size < math.inf:
            force = force * (own.max_force / size)
        return force, change

    def propagate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World,
        t: float, duration: float, steps: int,
    ) -> Ahead:  # fmt: skip
        """See `Law`."""
        if self._step > 0.0:
            times = duration / max(self._step, duration / steps)
            steps = max(1, math.ceil(times - 1e-9))
        return propagate_plain(self, law_state, own, neighbours, world, t, duration, steps)


def propagate_plain(
    law: Any, law_state: Array, own: Body, neighbours: Neighbours, world: World,
    t: float, duration: float, steps: int,
) -> Ahead:  # fmt: skip
    """`propagate` in plain Python, for a law with a method `rate`."""
    plain = getattr(fly_ahead, "py_func", fly_ahead)  # numba may be switched off
    return plain(own.p.shape[0], law, law_state, own, neighbours, world, t, duration, steps)


def read_only(value: T) -> T:
    """Arrays, or (nested) tuples of arrays, as views that cannot be written to."""
    if isinstance(value, np.ndarray):
        view = value.view()
        view.flags.writeable = False
        return view
    if isinstance(value, tuple):
        parts = map(read_only, value)
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)  # type: ignore[return-value]
    return value


def _step(law: Any, path: Path | None) -> float:
    """The law's `step_s`; 0: it has none."""
    if not hasattr(law, "step_s"):
        return 0.0
    step = law.step_s
    real = isinstance(step, Real) and not isinstance(step, bool)
    if not real or not 0.0 < float(step) < math.inf:
        raise _bad_value("step_s", "a time in seconds, more than 0 and finite", step, path)
    return float(step)


def _message_size(law: Any, path: Path | None) -> int:
    size = getattr(law, "message_size", 0)
    if not isinstance(size, Integral) or isinstance(size, bool) or size < 0:
        raise _bad_value("message_size", "a whole number, at least 0", size, path)
    return int(size)


def _bad_value(name: str, expected: str, value: object, path: Path | None) -> UnusableLawError:
    where = f"{path.name}: " if path else ""
    return UnusableLawError("law", f"{name}: {expected}", f"{where}{name} = {value!r}")


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
        self.message_size = _message_size(law, path)
        verbs = "initial", "rate", "propagate"
        self._asked = {verb: asked(verb, getattr(law, verb, None), path) for verb in verbs}

    def concerns(self, law_state: Array) -> list[Concern]:
        """See `concerns_of`."""
        return concerns_of(self._law, law_state)

    def try_out(self, own: Body, neighbours: Neighbours, world: World) -> None:
        """Call each of the law's functions once.

        Raises:
            LawError: one fails, or returns something else than it should.
        """
        state = self.initial(own, neighbours, world)
        scene = own, neighbours, world, 0.0
        self.rate(state, *scene)
        if not isinstance(self._law, CompiledLaw):
            self.propagate(state, *scene, TRIAL_S, 1)
            return
        # `propagate` would compile for ten seconds, and code with wrong shapes reads other memory
        messages = self.message_size
        for verb, function, n in (
            ("jump", jump_of, len(state)), ("broadcast", broadcast_of, messages),
        ):  # fmt: skip
            with self._blamed():
                message = function(self._law.gains, state, *scene)
            numbers(message, (n,), asked(verb, None, self._path))

    @contextmanager
    def _blamed(self) -> Iterator[None]:
        """While open, an error is the law's."""
        try:
            yield
        except KeyboardInterrupt as error:
            if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
                raise  # the operator's: in flight a handler counts Ctrl-C
            raise LawError(blame(error, self._path)) from error
        except LawError:
            raise  # it names the place
        except BaseException as error:  # it is the user's code, and may call sys.exit
            raise LawError(blame(error, self._path)) from error

    def initial(self, own: Body, neighbours: Neighbours, world: World) -> Array:
        """See `Law`."""
        with self._blamed():
            state = self._law.initial(own, neighbours, world)
        return numbers(state, None, self._asked["initial"])

    def rate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World, t: float
    ) -> tuple[Array, Array]:
        """See `Law`."""
        with self._blamed():
            both = self._law.rate(law_state, own, neighbours, world, t)
        return pair(both, own.p.shape, law_state.shape, self._asked["rate"], t)

    def propagate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World,
        t: float, duration: float, steps: int,
    ) -> Ahead:  # fmt: skip
        """See `Law`."""
        with self._blamed():
            ahead = self._law.propagate(
                law_state, own, neighbours, world, t, duration, steps
            )  # fmt: skip
        message = np.empty(self.message_size)
        like = Ahead(law_state, own.p, own.v, own.p, message)
        return ahead_of(ahead, like, self._asked["propagate"], t)
