"""Arrays and numbers that compiled code receives as one address.

At every call from Python, numba takes each array of each argument apart, some 30 ns for an
array, and a vehicle's parameters and memory have more than sixty. A `Bundle` is taken apart once,
when it is made.
"""

from struct import Struct, calcsize
from typing import Any, cast

import numba
import numpy as np
from llvmlite import ir
from numba.core import datamodel
from numba.core.registry import cpu_target
from numba.extending import NativeValue, intrinsic, overload, register_model, typeof_impl, unbox
from numpy.typing import NDArray

from testbed.core.code_cache import BundleType
from testbed.core.compiled import look_of, without_counts

WORD = 8  # bytes
# numba's type of values that look alike, and its bytes as a C struct; both take long to find
_KINDS: dict[Any, tuple[Any, Struct]] = {}


class Bundle(int):
    """Address of a (nested) tuple of arrays and numbers, for compiled code: see `unpacked`.

    Compiled code sees changes of what is in the arrays. It does not see other arrays: they need
    another bundle.

    Raises:
        TypeError: something in the tuple is neither an array nor a number.
    """

    value: tuple[Any, ...]
    kind: Any  # numba's type of the value
    _place: NDArray[np.uint8]  # what the address points to

    def __new__(cls, value: tuple[Any, ...]) -> "Bundle":
        """Take `value` apart, and keep it alive."""
        if (known := _KINDS.get(look := look_of(value))) is None:
            known = _KINDS[look] = _kind_of(value)
        kind, layout = known
        words: list[Any] = []
        add_words(value, words)
        place = np.frombuffer(layout.pack(*words), np.uint8)
        bundle = super().__new__(cls, place.ctypes.data)
        bundle.value, bundle.kind, bundle._place = value, kind, place
        return bundle


def _kind_of(value: tuple[Any, ...]) -> tuple[Any, Struct]:
    """See `_KINDS`."""
    layout, kind = Struct(layout_of(value)[0]), numba.typeof(value)
    if layout.size != (needed := _bytes_of(kind)):
        raise TypeError(f"expected {needed} bytes for {kind}, found {layout.size}")
    return kind, layout


def layout_of(value: Any) -> tuple[str, int]:
    """The format, as in `struct`, by which numba represents a value, and its alignment in bytes.

    Raises:
        TypeError: for a value that is not made of arrays and numbers.
    """
    if isinstance(value, np.ndarray):
        return f"{5 + 2 * value.ndim}q", WORD
    if isinstance(value, tuple):
        parts = [layout_of(part) for part in value]
        align = max((its for _, its in parts), default=1)
        edge = "0q" if align == WORD else ""  # a struct begins and ends at its alignment
        return edge + "".join(letters for letters, _ in parts) + edge, align
    for kind, letter in ((bool, "?"), (int, "q"), (float, "d")):
        if isinstance(value, kind):
            return letter, calcsize(letter)
    raise TypeError(f"expected arrays, tuples and numbers, found a {type(value).__name__}")


def add_words(value: Any, words: list[Any]) -> None:
    """Append what `layout_of` has letters for.

    An array is its owner twice (here none), length, item size, address, shape and strides.
    """
    if isinstance(value, tuple):
        for part in value:
            add_words(part, words)
    elif isinstance(value, np.ndarray):
        place = value.ctypes.data
        words += 0, 0, value.size, value.itemsize, place, *value.shape, *value.strides
    else:
        words.append(value)


def unpacked(bundle: Bundle) -> Any:
    """The value of a bundle; in compiled code its arrays are not counted, see `borrowed`."""
    return bundle.value


@register_model(BundleType)
class _BundleModel(datamodel.models.PrimitiveModel):
    def __init__(self, manager: Any, kind: BundleType) -> None:
        super().__init__(manager, kind, ir.IntType(8).as_pointer())


def _bytes_of(kind: Any) -> int:
    context = cpu_target.target_context
    return int(context.get_abi_sizeof(context.get_data_type(kind)))


@typeof_impl.register(Bundle)
def _type_of(bundle: Bundle, context: Any) -> BundleType:
    return BundleType(bundle.kind)


@unbox(BundleType)
def _unbox(kind: BundleType, bundle: Any, c: Any) -> NativeValue:
    return NativeValue(c.pyapi.long_as_voidptr(bundle))


@intrinsic
def _load(typingctx: Any, bundle: Any) -> Any:
    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        inner = signature.return_type
        model = context.data_model_manager[inner]
        place = builder.bitcast(args[0], model.get_data_type().as_pointer())
        value = model.from_data(builder, builder.load(place))
        return without_counts(context, builder, inner, value)

    return bundle.inner(bundle), code


@overload(unpacked, jit_options={"forceinline": True})
def _unpacked(bundle: Any) -> Any:
    if not isinstance(bundle, BundleType):
        return None

    def compiled_unpacked(bundle: Any) -> Any:
        return _load(bundle)  # type: ignore[call-arg]

    return cast(Any, compiled_unpacked)
