"""Arrays on the stack, for what a compiled function needs only until it returns.

Memory from numba's heap takes 40 ns for each array, as long as the arithmetic of a small one, and
every use of the array counts its owners. An array on the stack takes nothing and has no owner.
"""

from typing import Any

import numpy as np
from numba.core import cgutils, types
from numba.extending import lower_builtin, type_callable
from numba.np.arrayobj import populate_array
from numpy.typing import NDArray

ALIGNED = 32  # bytes: a processor's registers


def scratch(shape: Any) -> NDArray[np.float64]:
    """An array of this shape, whose numbers are not set.

    In compiled code its memory is gone when the function returns. Return no part of it, and call it
    neither in a loop nor in a function that is `pasted` into one (`inlined` is fine).
    """
    return np.empty(shape)


@type_callable(scratch)
def _type(context: Any) -> Any:
    def of(shape: Any) -> Any:
        axes = 1 if isinstance(shape, types.Integer) else len(shape)
        return types.Array(types.float64, axes, "C")

    return of


@lower_builtin(scratch, types.Integer)
@lower_builtin(scratch, types.BaseTuple)
def _code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    kind, whole, pairs = signature.args[0], types.intp, [(signature.args[0], args[0])]
    if not isinstance(kind, types.Integer):
        pairs = list(zip(kind.types, cgutils.unpack_tuple(builder, args[0]), strict=True))
    shape = [context.cast(builder, size, its, whole) for its, size in pairs]
    eight = context.get_constant(whole, 8)
    strides = [eight]
    for size in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], size))
    count = builder.udiv(builder.mul(strides[0], shape[0]), eight)
    memory = builder.alloca(context.get_value_type(types.float64), size=count)
    memory.align = ALIGNED
    array = context.make_array(signature.return_type)(context, builder)
    populate_array(array, memory, shape, strides, eight, meminfo=None)
    return array._getvalue()  # noqa: SLF001
