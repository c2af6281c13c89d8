"""The functions of a law by the type of its gains: `rate`, and perhaps `jump` and `broadcast`.

Compiled code has no methods. It finds a law's functions here when it is compiled; a function as an
argument would do the same, but numba cannot cache on disk what takes one. In plain Python a law may
also be an object with these methods.
"""

import inspect
from collections.abc import Callable
from functools import cache, partial
from typing import Any, TypeVar, cast

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from testbed.core.compiled import compiled, inlined

Array = NDArray[np.float64]
F = TypeVar("F", bound=Callable[..., Any])

_RATES: dict[type, Callable] = {}  # by the type of a law's gains
_JUMPS: dict[type, Callable] = {}
_BROADCASTS: dict[type, Callable] = {}

ASKED = "gains", "law_state", "own", "neighbours", "world", "t"  # arguments of all these functions
WRITES = "force", "change"  # the last arguments of a rate that writes, and returns nothing


def compiled_rate(gains_type: type) -> Callable[[F], F]:
    """Compile a law's rate and register it for laws with gains of this type.

    It returns the force (d,) and the rate of the law's state (n,). If it has the arguments `force`
    and `change` after `t`, it writes to these instead: a new array takes a tenth of a law's time.

    Raises:
        TypeError: the function has other arguments.
    """
    into = _compiled_into(_RATES, gains_type)

    def decorate(function: F) -> F:
        names = tuple(inspect.signature(function).parameters)
        if names[len(ASKED) :] not in ((), WRITES) or len(names) < len(ASKED):
            expected = f"rate({', '.join(ASKED)}), or with {' and '.join(WRITES)} after them"
            raise TypeError(f"expected {expected}, found ({', '.join(names)})")
        return into(function)

    return decorate


def compiled_jump(gains_type: type) -> Callable[[F], F]:
    """Compile a law's jump, which returns a new array, and register it in `jump_of`."""
    return _compiled_into(_JUMPS, gains_type)


def compiled_broadcast(gains_type: type) -> Callable[[F], F]:
    """Compile a law's broadcast and register it in `broadcast_of`."""
    return _compiled_into(_BROADCASTS, gains_type)


def _compiled_into(table: dict[type, Callable], gains_type: type) -> Callable[[F], F]:
    def decorate(function: F) -> F:
        table[gains_type] = inlined(function)
        return cast(F, table[gains_type])

    return decorate


@cache
def writes(rate: Any) -> bool:
    """Whether a registered rate writes to its last arguments, see `compiled_rate`."""
    return tuple(inspect.signature(getattr(rate, "py_func", rate)).parameters)[-2:] == WRITES


def write_rate(law, law_state, own, neighbours, world, t, force, change):
    """Write the force, shape (d,), and the rate of a law's state, shape (n,)."""
    rate = _RATES.get(type(law))
    if rate is not None and writes(rate):
        rate(law, law_state, own, neighbours, world, t, force, change)
        return
    ask = law.rate if rate is None else partial(rate, law)
    force[:], change[:] = ask(law_state, own, neighbours, world, t)


@overload(write_rate, jit_options={"forceinline": True})  # the arguments are many words
def _write_rate(law, law_state, own, neighbours, world, t, force, change):
    rate = _registered(_RATES, law)
    if rate is None:
        return None
    if writes(rate):
        return lambda law, law_state, own, neighbours, world, t, force, change: rate(
            law, law_state, own, neighbours, world, t, force, change
        )

    def copied(law, law_state, own, neighbours, world, t, force, change):
        found = rate(law, law_state, own, neighbours, world, t)
        for i in range(force.shape[0]):
            force[i] = found[0][i]
        for i in range(change.shape[0]):
            change[i] = found[1][i]

    return copied


def _plain(table: dict[type, Callable], law: Any, verb: str) -> Any:
    """A law's function: registered for its gains, or the law's own method; None: it has none."""
    found = table.get(type(law))
    return getattr(law, verb, None) if found is None else partial(found, law)


def _registered(table: dict[type, Callable], law: Any, default: Callable | None = None) -> Any:
    """The function for a law of this numba type; None: there is none."""
    known = isinstance(law, types.BaseNamedTuple)
    return table.get(law.instance_class, default) if known else None


def jump_of(law, law_state, own, neighbours, world, t):
    """A law's state after a jump of its discrete parts; most laws have none."""
    jump = _plain(_JUMPS, law, "jump")
    return law_state if jump is None else jump(law_state, own, neighbours, world, t)


def broadcast_of(law, law_state, own, neighbours, world, t):
    """A law's message to the others, shape (k,); most laws send none."""
    broadcast = _plain(_BROADCASTS, law, "broadcast")
    return np.zeros(0) if broadcast is None else broadcast(law_state, own, neighbours, world, t)


@compiled
def _keep(law, law_state, own, neighbours, world, t):
    return law_state


@compiled
def _say_nothing(law, law_state, own, neighbours, world, t):
    return np.empty(0)


def _dispatch(verb: Callable, table: dict[type, Callable], default: Callable) -> None:
    """Make compiled code look up a function in `table` by the type of a law's gains."""

    @overload(verb, jit_options={"forceinline": True})
    def choose(law, law_state, own, neighbours, world, t):
        kernel = _registered(table, law, default)
        if kernel is None:
            return None
        return lambda law, law_state, own, neighbours, world, t: kernel(
            law, law_state, own, neighbours, world, t
        )


_dispatch(jump_of, _JUMPS, _keep)
_dispatch(broadcast_of, _BROADCASTS, _say_nothing)
