"""What an integrator needs of a system: how it is steered and how it moves.

A system is a named tuple; its state `y` and its input `u` (thrust, say) are flat arrays.

    input_of(system, t, y, u)              writes u: what the control asks for
    derivative_of(system, t, y, u, rate)   writes y': how the state moves under that u
    control_of(control, t, p, v, u)        writes u, shape (n, 3) [m/s^2], from positions and
                                           velocities in a relative frame, shape (n, 3)

Two steps, so that an integrator may hold `u` over a step. Compiled code picks the function by the
type of the tuple, as `testbed.core.law` does.

What is compiled for a type of someone else's must not be kept on disk: numba would not notice that
their file has changed, and could not even read its list of kept code where their module is not
imported. So everything here that depends on a system's type is compiled anew in each process,
except the integrators, each of which is kept once per system made of our own types only.
"""

import hashlib
from collections.abc import Callable, Iterator
from types import FunctionType
from typing import Any, NamedTuple, cast

import numba
from numba import types
from numba.extending import overload

from testbed.core.compiled import LEAN, compiled

# `compiled` notices when these change
OURS = ("testbed.core.", "testbed.reproduction.kernel.", "controllers.", "sim_twin.")


def generic(function: Callable) -> Callable:
    """Compile a function that is handed a system; see above why it is not kept on disk."""
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
        """The one for systems made of these types."""
        if parts not in self._versions:
            f = self._function
            twin = FunctionType(f.__code__, f.__globals__, f.__name__, f.__defaults__)
            names = "+".join(f"{part.__module__}.{part.__qualname__}" for part in parts)
            digest = hashlib.blake2b(names.encode(), digest_size=8).hexdigest()
            twin.__qualname__ = f"{f.__qualname__}_{digest}"  # numba keeps one list per name
            kept = all(part.__module__.startswith(OURS) for part in parts)
            self._versions[parts] = numba.njit(cache=kept, **LEAN)(twin)
        return self._versions[parts]


def composition(system: Any) -> Iterator[type]:
    """The types of a named tuple and of the named tuples inside it."""
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
    """Write the accelerations that a control asks for, see above; compiled code only."""
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
    """No thrust."""

    unused: float = 0.0  # numba knows no empty tuple's fields


@compiled_control(Coast)
def coast(control, t, p, v, u):
    """Nothing is asked for."""
    u[:] = 0.0


@compiled
def clip_each(u, limit):
    """Bound every component of `u` by `limit`, in place; inf leaves it as it is."""
    flat = u.reshape(-1)
    for k in range(flat.shape[0]):
        flat[k] = min(max(flat[k], -limit), limit)
