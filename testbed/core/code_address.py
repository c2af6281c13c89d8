"""Machine code that compiled code calls by its address, like a function pointer of C.

An entry takes in all that it calls and optimises it again (whole_program.py). A function that calls
entries one after the other would so compile the chain, the plant and the law a second time. It
calls their machine code instead.
"""

from collections.abc import Callable
from typing import Any, cast

import numba
from llvmlite import ir
from numba.core import cgutils, config, datamodel, types
from numba.extending import NativeValue, intrinsic, overload, register_model, typeof_impl, unbox

from testbed.core.code_cache import CodeType


class CodeAddress(int):
    """Address of a compiled function's machine code, see `call`."""

    kind: CodeType
    function: Any  # keeps the code in memory

    def __new__(cls, function: Callable[..., Any], args: tuple[Any, ...]) -> "CodeAddress":
        """The address of `function`, compiled by `compiled`, for arguments of these types."""
        entry, kinds = cast(Any, function), tuple(map(numba.typeof, args))
        if vars(config)["DISABLE_JIT"]:  # there is no machine code, see `called`
            address = super().__new__(cls, 0)
            address.function = function
            return address
        entry.compile(kinds)
        made = entry.overloads[kinds]
        place = made.library.get_pointer_to_function(made.fndesc.llvm_func_name)
        address = super().__new__(cls, place)
        address.kind, address.function = CodeType(made.signature), function
        return address


@register_model(CodeType)
class _CodeModel(datamodel.models.PrimitiveModel):
    def __init__(self, manager: Any, kind: CodeType) -> None:
        super().__init__(manager, kind, ir.IntType(8).as_pointer())


@typeof_impl.register(CodeAddress)
def _type_of(address: CodeAddress, context: Any) -> CodeType:
    return address.kind


@unbox(CodeType)
def _unbox(kind: CodeType, address: Any, c: Any) -> NativeValue:
    return NativeValue(c.pyapi.long_as_voidptr(address))


@intrinsic
def call(typingctx: Any, address: Any, args: Any) -> Any:
    """Call the code at a `CodeAddress` with a tuple of arguments; in compiled code only."""

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        called, (_, given) = address.signature, signature.args
        parts = cgutils.unpack_tuple(builder, values[1], len(given))
        cast_to = zip(parts, given, called.args, strict=True)
        parts = [context.cast(builder, part, *kinds) for part, *kinds in cast_to]
        convention = context.call_conv
        kind = convention.get_function_type(called.return_type, called.args)
        place = builder.bitcast(values[0], kind.as_pointer())
        status, value = convention.call_function(
            builder, place, called.return_type, called.args, parts
        )
        with cgutils.if_unlikely(builder, status.is_error):
            convention.return_status_propagate(builder, status)
        return value

    return address.signature.return_type(address, args), code


def called(address: CodeAddress, args: tuple[Any, ...]) -> Any:
    """`call` for code that may also run without a compiler."""
    return address.function(*args)


@overload(called, jit_options={"forceinline": True})
def _called(address: Any, args: Any) -> Any:
    def compiled_called(address: Any, args: Any) -> Any:
        return call(address, args)  # type: ignore[call-arg]

    return compiled_called


@intrinsic
def same_kind(typingctx: Any, example: Any, address: Any) -> Any:
    """A bundle of the kind of `example` at this address, an integer; in compiled code only."""

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.inttoptr(values[1], ir.IntType(8).as_pointer())

    return example(example, types.int64), code
