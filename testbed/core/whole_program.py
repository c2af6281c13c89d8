"""Compiles what compiled code calls once, together with the function that Python calls.

Numba makes every function a library of its own: with a wrapper that unpacks Python's arguments,
optimised with all that it calls, and turned into machine code. A caller takes its callees in and
optimises all of it again, so a function four calls deep is optimised five times, and of all but the
outermost function neither wrapper nor machine code is ever used.

Here an `Entry` is called from Python. What it calls are parts: lowered only, and linked into the
entry, where everything is optimised once, as with a C compiler's whole-program optimisation. So are
numba's own functions for compiled code, such as that of `np.zeros`. The first flight takes a third
less processor time (decision 32). The arithmetic stays the same, because without fast-math no
optimisation may change it.
"""

import gc
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cached_property, partial
from typing import Any, cast

from llvmlite.binding import Linkage, parse_assembly
from numba.core import types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher
from numba.core.target_extension import jit_registry, target_registry
from numba.extending import overload
from numba.np import arrayobj

from testbed.core.code_cache import OwnTypesCache

# Numba counts the owners of arrays by calls, and takes out pairs of them that cancel out. Most of
# what remains counts nothing, because most arrays here have no owner (`borrowed`), but each call
# empties the processor's registers, and the chain has 1500. They are replaced by their code.
COUNTED = "NRT_incref", "NRT_decref"
COUNTING = """
define void @NRT_incref(ptr %array) alwaysinline {
    %none = icmp eq ptr %array, null
    br i1 %none, label %end, label %count
count:
    %before = atomicrmw add ptr %array, i64 1 monotonic
    br label %end
end:
    ret void
}
define void @NRT_decref(ptr %array) alwaysinline {
    %none = icmp eq ptr %array, null
    br i1 %none, label %end, label %count
count:
    fence release
    %before = atomicrmw sub ptr %array, i64 1 monotonic
    %last = icmp eq i64 %before, 1
    br i1 %last, label %free, label %end
free:
    fence acquire
    tail call void @NRT_MemInfo_call_dtor(ptr %array)
    br label %end
end:
    ret void
}
declare void @NRT_MemInfo_call_dtor(ptr)
"""


MAKES_MESSAGE = "__excinfo_unwrap_args"  # numba's function for an error with numbers of the run
SELDOM = 300_000, 5, 100  # thresholds of Python's garbage collector, see gc.set_threshold


@contextmanager
def seldom_collected() -> Iterator[None]:
    """Let Python's garbage collector run a few hundred times less often.

    The compiler makes millions of objects that live until it has finished. A collector that looks
    at all of them again and again takes a fifth of the compile time. This takes 60 MB more memory.
    """
    before = gc.get_threshold()
    gc.set_threshold(*SELDOM)
    try:
        yield
    finally:
        gc.set_threshold(*before)


class PartLibrary(JITCodeLibrary):
    """Code of one function, to be linked into entries; nothing of it is run by itself."""

    @property
    def codegen(self) -> "PartLibrary":
        """Takes calls that are meant for the engine, which does not know this code."""
        return self

    def set_env(self, env_name: str, env: Any) -> None:
        """Give code that makes an error's message its environment; other code needs none."""
        if any(one.name.startswith(MAKES_MESSAGE) for one in self._final_module.functions):
            engine = cast(Any, self._codegen)
            engine._add_module(parse_assembly(f'@"{env_name}" = common global ptr null'))  # noqa: SLF001
            engine.set_env(env_name, env)

    def get_pointer_to_function(self, name: str) -> int:
        """No address: there is no machine code."""
        return 0

    def finalize(self) -> None:
        """Leave optimisation as a whole and machine code to the entries."""
        self.callees = in_order(self._linking_libraries)
        self._finalized = True

    def alone(self) -> Any:
        """The function without those that it calls."""
        return super()._get_module_for_linking()

    def _get_module_for_linking(self) -> Any:
        """The function with all that it calls, for libraries of numba's own kind."""
        whole = self.alone().clone()
        for library in self.callees:
            part = isinstance(library, PartLibrary)
            # numba's own contain all that they call
            module = library.alone() if part else library._get_module_for_linking()  # noqa: SLF001
            whole.link_in(module, preserve=True)
        return whole


class EntryLibrary(JITCodeLibrary):
    """Code of an entry, which takes in all parts that it calls, directly or not."""

    def serialize_using_object_code(self) -> tuple[str, str, tuple[bytes, bytes]]:
        """What is kept on disk: machine code, and the names in it, which numba looks up.

        Numba also keeps the code that callers may inline. Callers of an entry inline its part, and
        to read that code took most of the time to load an entry.
        """
        self._ensure_finalized()
        names = parse_assembly(stubs(self._final_module)).as_bitcode()
        return self.name, "object", (self._get_compiled_object(), names)

    def finalize(self) -> None:
        """See numba, which links its own libraries and then optimises."""
        libraries = in_order(self._linking_libraries)
        self._linking_libraries = [x for x in libraries if not isinstance(x, PartLibrary)]
        for library in libraries:
            if isinstance(library, PartLibrary):
                self._final_module.link_in(library.alone(), preserve=True)
        super().finalize()

    def _optimize_final_module(self) -> None:
        """See numba, which has these two passes and not what is between them."""
        module, codegen = self._final_module, cast(Any, self.codegen)
        passes_of = codegen._module_pass_manager  # noqa: SLF001
        loops, level = codegen._loopvect, codegen._opt_level  # noqa: SLF001
        cheap, builder = passes_of(
            loop_vectorize=loops, slp_vectorize=False, opt=level, cost="cheap"
        )
        cheap.run(module, builder)
        module.link_in(parse_assembly(COUNTING))
        for name in COUNTED:
            module.get_function(name).linkage = "internal"
        full, builder = passes_of()
        full.run(module, builder)


def stubs(module: Any) -> str:
    """Functions and variables of the names that a module gives to others, with nothing in them."""
    functions = (f'define void @"{name}"() {{ ret void }}' for name in given(module.functions))
    variables = (f'@"{name}" = global ptr null' for name in given(module.global_variables))
    return "\n".join((*functions, *variables))


def given(values: Iterable[Any]) -> list[str]:
    """Names of those that are defined and can be found from outside."""
    hidden = Linkage.internal, Linkage.private
    return [one.name for one in values if not one.is_declaration and one.linkage not in hidden]


def in_order(libraries: list[Any]) -> list[Any]:
    """These libraries and all that the parts among them call, directly or not.

    Each comes after all of its callers: the linker takes only what something asks for already.
    """
    found: list[Any] = []  # callers last
    for library in libraries:
        called = library.callees[::-1] if isinstance(library, PartLibrary) else []
        found += [one for one in (*called, library) if one not in found]
    return found[::-1]


class EntryCompiler(Compiler):
    """Numba's compiler, with another kind of library."""

    library: type[JITCodeLibrary] = EntryLibrary

    def define_pipelines(self) -> Any:
        """See numba."""
        state = self.state
        state.library = self.library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super().define_pipelines()


class PartCompiler(EntryCompiler):
    """Numba's compiler for parts."""

    library = PartLibrary


UNWRAPPED = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}  # Python and C never call a part


def make_overloads_parts() -> None:
    """Compile as parts what `numba.extending.overload` gives for a call: numba's own and ours."""
    cpu = target_registry["cpu"]
    jit = jit_registry.pop(cpu)
    jit_registry[cpu] = partial(jit, pipeline_class=PartCompiler, **UNWRAPPED)


make_overloads_parts()


def wrong_size(found: Any, expected: Any) -> None:
    """An array is assigned to a slice of another size."""


@overload(wrong_size)
def _wrong_size(found: Any, expected: Any) -> Any:
    def compiled_wrong_size(found: Any, expected: Any) -> None:
        raise ValueError("cannot assign an array to a slice of another size")

    return compiled_wrong_size


# Numba's own error has both sizes, and functions for text that take 2 s to compile in each process.
cast(Any, arrayobj).raise_with_shape_context = wrong_size


class Part(CPUDispatcher):
    """A function as compiled code calls it."""

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """See numba, which lowers one function for each constant that is an argument."""
        plain = {name: types.unliteral(kind) for name, kind in kws.items()}
        return super().get_call_template(tuple(map(types.unliteral, args)), plain)


class Entry(CPUDispatcher):
    """A function that Python calls; compiled code that calls it takes the part instead."""

    _cache: Any  # numba's, or an OwnTypesCache

    def __init__(
        self, py_func: Any, locals: Any = None, targetoptions: Any = None,
        pipeline_class: Any = EntryCompiler,
    ) -> None:  # fmt: skip
        super().__init__(py_func, locals, targetoptions, pipeline_class)

    def compile(self, sig: Any) -> Any:
        """See numba."""
        try:
            with seldom_collected():
                return super().compile(sig)
        finally:
            if isinstance(self._cache, OwnTypesCache):
                self._cache.unlock()

    @cached_property
    def part(self) -> Part:
        """The function as compiled code calls it."""
        options = self.targetoptions | UNWRAPPED
        return Part(self.py_func, self.locals, options, PartCompiler)

    @property
    def _numba_type_(self) -> Any:
        return types.Dispatcher(self.part)
