"""The interface between integrators and systems: input and derivative.

A system is a named tuple; its state `y` and its input `u`, such as thrust, are flat arrays.

    input_of(system, t, y, u)              writes u, the control's output
    derivative_of(system, t, y, u, rate)   writes y', the state's derivative under u
    control_of(control, t, p, v, u)        writes u, shape (n, 3) [m/s^2], from positions and
                                           velocities in a relative frame, shape (n, 3)

They are separate so that an integrator can hold `u` over a step. Compiled code selects the function
by the type of the tuple, as `testbed.core.law` does.

Code compiled for a type from outside the package must not be cached on disk: numba would not notice
changes of that file and cannot read its cache index unless that module is imported. So everything
here that depends on a system's type is compiled again in each process, except the integrators,
which are cached for systems composed of types of this package only.
"""

import hashlib
from collections.abc import Callable, Iterator
from types import FunctionType
from typing import Any, NamedTuple, cast

import numba
from numba import types
from numba.extending import overload

from testbed.core.code_cache import is_ours
from testbed.core.compiled import LEAN, compiled


def generic(function: Callable) -> Callable:
    """Compile a function that takes a system; not cached on disk, see above."""
    return numba.njit(**LEAN)(function)


class Integrator:
    """A function (system, ...) that is compiled once per composition of the system."""

    def __init__(self, function: Callable) -> None:
        self._function = cast(FunctionType, function)
        self._versions: dict[tuple[type, ...], Callable] = {}

    def __call__(self, system: Any, *arguments: Any) -> Any:
        """Call the version for this system."""
        return self.version(tuple(composition(system)))(system, *arguments)

    def version(self, parts: tuple[type, ...]) -> Callable:
        """The version for systems composed of these types."""
        if parts not in self._versions:
            f = self._function
            twin = FunctionType(f.__code__, f.__globals__, f.__name__, f.__defaults__)
            names = "+".join(f"{part.__module__}.{part.__qualname__}" for part in parts)
            digest = hashlib.blake2b(names.encode(), digest_size=8).hexdigest()
            twin.__qualname__ = f"{f.__qualname__}_{digest}"  # numba has one cache index per name
            kept = all(map(is_ours, parts))  # `compiled` detects their changes
            self._versions[parts] = numba.njit(cache=kept, **LEAN)(twin)
        return self._versions[parts]


def composition(system: Any) -> Iterator[type]:
    """The types of a named tuple and, recursively, of the named tuples in it."""
    if isinstance(system, tuple):
        yield type(system)
        for value in system:
            yield from composition(value)


def input_of(system, t, y, u):
    """Write the input of a system, see above; compiled code only."""
    raise TypeError(f"no compiled input for {type(system).__name__}")


def derivative_of(system, t, y, u, rate):
    """Write the derivative of a system's state, see above; compiled code only."""
    raise TypeError(f"no compiled derivative for {type(system).__name__}")


def control_of(control, t, p, v, u):
    """Write the accelerations of a control, see above; compiled code only."""
    raise TypeError(f"no compiled control {type(control).__name__}")


def _is(numba_type, tuple_type):
    return isinstance(numba_type, types.BaseNamedTuple) and numba_type.instance_class is tuple_type


def compiled_input(system_type: type) -> Callable[[Callable], Callable]:
    """Compile a function and make it `input_of` for that type of system."""

    def decorate(function: Callable) -> Callable:
        kernel = generic(function)

        @overload(input_of)
        def choose(system, t, y, u):
            if _is(system, system_type):
                return lambda system, t, y, u: kernel(system, t, y, u)
            return None

        return kernel

    return decorate


def compiled_derivative(system_type: type) -> Callable[[Callable], Callable]:
    """Compile a function and make it `derivative_of` for that type of system."""

    def decorate(function: Callable) -> Callable:
        kernel = generic(function)

        @overload(derivative_of)
        def choose(system, t, y, u, rate):
            if _is(system, system_type):
                return lambda system, t, y, u, rate: kernel(system, t, y, u, rate)
            return None

        return kernel

    return decorate


def compiled_control(control_type: type) -> Callable[[Callable], Callable]:
    """Compile a function and make it `control_of` for that type of control."""

    def decorate(function: Callable) -> Callable:
        kernel = generic(function)

        @overload(control_of)
        def choose(control, t, p, v, u):
            if _is(control, control_type):
                return lambda control, t, p, v, u: kernel(control, t, p, v, u)
            return None

        return kernel

    return decorate


class Coast(NamedTuple):
    """Free flight: the thrust is zero."""

    unused: float = 0.0  # numba does not support fields of an empty tuple


@compiled_control(Coast)
def coast(control, t, p, v, u):
    """Write zero acceleration."""
    u[:] = 0.0


@compiled
def clip_each(u, limit):
    """Limit every component of `u` to [-limit, limit], in place; inf: no limit."""
    flat = u.reshape(-1)
    for k in range(flat.shape[0]):
        flat[k] = min(max(flat[k], -limit), limit)
