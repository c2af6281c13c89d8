"""Decorators for compiled inner loops. What they compile is kept on disk, see code_cache.py."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba import types
from numba.core import cgutils, config
from numba.extending import intrinsic, overload

from testbed.core.code_cache import BundleType, OwnTypesCache, is_ours
from testbed.core.whole_program import Entry

F = TypeVar("F", bound=Callable[..., Any])
V = TypeVar("V")

MOST_SEEN = 1000  # dtypes

# The functions are not called from C: without C wrappers compilation takes 10 % less time.
LEAN: Any = {"error_model": "numpy", "no_cfunc_wrapper": True}


def compiled(function: F) -> F:
    """Compile `function` on first use; cache the result on disk if all its types are ours.

    No fast-math: results must be bit-identical in every run. The plain Python function is
    available as `function.py_func`.
    """
    return _compiled(function)


def inlined(function: F) -> F:
    """Compile `function` like `compiled`, inlined into every compiled function that calls it.

    For innermost loops: a law's arguments are two hundred words, and a call would copy them all.
    """
    return _compiled(function, forceinline=True)


def pasted(function: F) -> F:
    """Compile `function` like `compiled`, as part of its callers.

    For a function with one caller: machine code of a function is optimised again in each of its
    callers, and theirs, so every level of calls costs seconds of compiling. No call holds
    references to its arguments, so the caller must `keep` the arguments that it borrows.
    """
    return _compiled(function, inline="always")


def with_fixed_types(function: F) -> F:
    """A compiled function for one caller whose argument types never change.

    At every call numba determines the types of all arguments, down to the last array of a tuple;
    for the small functions of a tick this takes longer than the function. Here it is done at the
    first call, and again if an integer argument becomes a float, which would be truncated
    silently. So such a function has one owner, which must always pass arguments of the same
    types: arrays of the same number of dimensions, layout and dtype, and tuples of the same types.
    This is not checked; tests/experiments/test_fixed_types.py flies with the types compared at
    every call.
    """
    if cast(Any, config).DISABLE_JIT:  # plain Python, for a debugger
        return function
    direct: Callable[..., Any] | None = None
    whole: list[int] = []  # indices of integer arguments

    def call(*args: Any) -> Any:
        nonlocal direct, whole
        for k in whole:
            if not isinstance(args[k], int):
                direct = None
        if direct is None:
            direct = _machine_code(cast(Any, function), args)
            whole = [k for k, value in enumerate(args) if isinstance(value, int)]
        return direct(*args)

    return cast(F, call)


def _machine_code(function: Any, args: tuple[Any, ...]) -> Callable[..., Any]:
    """The machine code for arguments of these types; looked up once for all owners.

    With a hundred vehicles, a lookup by each of them takes a tenth of a short flight.
    """
    found: dict[Any, Callable[..., Any]] = function.__dict__.setdefault("machine_code", {})
    if (code := found.get(look := look_of(args))) is None:
        code = found[look] = function.compile(tuple(map(numba.typeof, args)))
    return code


_NUMBERS: dict[np.dtype, int] = {}  # of equal dtypes
_SEEN: dict[int, tuple[np.dtype, int]] = {}  # by identity: it takes long to hash a record's dtype


def _number_of(dtype: np.dtype) -> int:
    """A number that equal dtypes have."""
    seen = _SEEN.get(id(dtype))
    if seen is None or seen[0] is not dtype:
        if len(_SEEN) > MOST_SEEN:
            _SEEN.clear()
        seen = _SEEN[id(dtype)] = dtype, _NUMBERS.setdefault(dtype, len(_NUMBERS))
    return seen[1]


def look_of(value: Any) -> Any:
    """A key of a value's type: equal keys mean equal numba types.

    Raises:
        TypeError: for a list or similar, whose type depends on its contents.
    """
    if isinstance(value, np.ndarray):
        return _number_of(value.dtype), value.ndim, value.flags.num
    kind = type(value)
    if isinstance(value, tuple):
        return kind, *map(look_of, value)
    if isinstance(value, np.void):  # a record
        return _number_of(value.dtype)
    if isinstance(value, (list, set, dict)):
        raise TypeError(f"expected arrays, tuples and numbers, found a {kind.__name__}")
    if isinstance(value, int) and (inner := getattr(value, "kind", None)) is not None:  # a bundle
        return BundleType, inner._code  # numba: equal types have equal codes
    return kind


def _compiled(function: F, **options: Any) -> F:
    if cast(Any, config).DISABLE_JIT:
        return function
    entry: Any = Entry(function, targetoptions={"nopython": True, **LEAN, **options})
    if is_ours(function):
        entry._cache = OwnTypesCache(function)  # as `cache=True`, with another class
    return cast(F, entry)


def without_counts(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """Code for `value` without the owner of each array in it."""
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value=value)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        array.parent = cgutils.get_null_value(array.parent.type)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        kinds, parts = list(cast(Any, kind)), cgutils.unpack_tuple(builder, value, len(kind))
        lent = [without_counts(context, builder, *pair) for pair in zip(kinds, parts, strict=True)]
        return context.make_tuple(builder, kind, lent)
    return value


@intrinsic
def _lend(typingctx: Any, value: Any) -> Any:
    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return without_counts(context, builder, signature.args[0], args[0])

    return value(value), code


@intrinsic
def _hold(typingctx: Any, value: Any) -> Any:
    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return context.get_dummy_value()

    return types.void(value), code


def borrowed(value: V) -> V:
    """Arrays, or (nested) tuples of arrays, without reference counting.

    In compiled code every use of an array in a tuple changes a reference count with atomic
    instructions: two thirds of a law's time. Borrowed arrays are not counted. The owner must
    outlive them: arguments from Python do, and so do values passed to `keep` afterwards.
    """
    return value


def keep(value: object) -> None:
    """Keep `value` alive until this call."""


@overload(borrowed, jit_options={"forceinline": True})
def _borrowed(value: Any) -> Any:
    def compiled_borrowed(value: Any) -> Any:
        return _lend(value)  # type: ignore[call-arg]

    return compiled_borrowed


@overload(keep, jit_options={"forceinline": True})
def _keep(value: Any) -> Any:
    def compiled_keep(value: Any) -> None:
        _hold(value)  # type: ignore[call-arg]

    return compiled_keep
