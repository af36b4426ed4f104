"""Compiled functions: Numba's compiler, which leaves inner functions to the kernels above them."""

from __future__ import annotations

import gc
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar, cast

import numba
from llvmlite import ir
from numba import _dynfunc  # type: ignore[attr-defined]
from numba.core import cgutils, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.environment import lookup_environment
from numba.core.event import Event, Listener, install_listener
from numba.core.imputils import lower_getattr_generic
from numba.core.typed_passes import NativeLowering
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import intrinsic, models, overload, register_model

from drake_aigto.code_cache import CodeCache, find_reason
from drake_aigto.progress import Notice

_Function = TypeVar("_Function", bound=Callable[..., Any])
_Borrowed = TypeVar("_Borrowed")

# `python -m benchmarks.start_time` measures 10 s on idle cores; shooting takes 25, in space 40.
_COMPILES = "compiling machine code, up to a minute or so (Ctrl-C waits for that); "
_KEPT = "it is kept for next time"
_LOST = "it can be kept nowhere: NUMBA_CACHE_DIR may name a folder"

# Instructions of a function, before it is optimized, above which it stays a call: with none inlined
# above this, kernels are as fast, and compile sooner (`python -m benchmarks.start_time`).
_LARGE = 200


def njit(**options: Any) -> Callable[[_Function], _Function]:
    """Returns `numba.njit` with these options and a cache, as a decorator.

    A function without an entry for Python (``no_cpython_wrapper``) is compiled no further than to
    LLVM's intermediate code, unoptimized; kernels that call it, also by way of others, are
    optimized and emitted with it as a whole. Numba on its own optimizes and emits each function
    with all that it calls, and then once more for each function above, which doubles the time.

    What is compiled is kept, and installed packages may have it from the start (`CodeCache`).

    No function gets a C entry, which nothing here calls and which takes time to compile. Each may
    make arrays unless its options say otherwise: Numba would forbid it to what is first called by a
    function that may not, as if that were for all below.
    """
    options = {"no_cfunc_wrapper": True, "_nrt": True, **options}
    is_inner = options.get("no_cpython_wrapper", False)
    pipeline = _InnerPipeline if is_inner else _KernelPipeline

    def compile_later(function: _Function) -> _Function:
        compiled = numba.njit(pipeline_class=pipeline, **options)(function)
        _forget_literals(compiled)
        compiled.compile = _undisturbed()(compiled.compile)
        is_typed_in = not os.path.exists(function.__code__.co_filename)
        if is_inner or is_typed_in:  # Kernels keep inner functions within their own code.
            return compiled
        compiled._cache = CodeCache(function)  # As njit(cache=True) does with its own.
        compiled.compile = compiled._cache.releasing()(compiled.compile)
        return compiled

    return compile_later


def _forget_literals(compiled: Any) -> None:
    """Lets calls with a constant share the code of those with any value: it is compiled once.

    Of Python's own constants, Numba would compile a function anew for each.
    """
    find_template = compiled.get_call_template

    def find_shared_template(args: Any, kws: Any) -> Any:
        return find_template(tuple(map(types.unliteral, args)), kws)

    compiled.get_call_template = find_shared_template


@contextmanager
def uncollected() -> Iterator[None]:
    """Lets Python's collector of garbage rest, in all threads."""
    is_collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if is_collecting:
            gc.enable()


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Makes Ctrl-C wait for the end of a call, and Python's collector of garbage, too.

    LLVM calls Python back, and swallows what signals raise there: the function would be half
    compiled. They reach the main thread alone. Of a compiler's many objects hardly any are garbage
    before its end, and to look for it takes an eighth of the time.
    """
    handle = signal.getsignal(signal.SIGINT)
    is_main = threading.current_thread() is threading.main_thread() and callable(handle)
    caught: list[tuple[Any, ...]] = []
    if is_main:
        signal.signal(signal.SIGINT, lambda *arguments: caught.append(arguments))
    try:
        with uncollected():
            yield
    finally:
        if is_main:
            signal.signal(signal.SIGINT, handle)
        if caught and callable(handle):
            handle(*caught[0])


class _InnerLibrary(JITCodeLibrary):
    """Function for others to call: intermediate code, which is neither optimized nor emitted."""

    def finalize(self) -> None:
        """Lets nothing be added any more."""
        self._raise_if_finalized()  # type: ignore[no-untyped-call]
        self._finalized = True


class _KernelLibrary(JITCodeLibrary):
    """Function that Python calls, with all inner functions that it needs."""

    def finalize(self) -> None:
        """Links, optimizes and emits them as a whole."""
        for library in self._linking_libraries:  # It grows meanwhile.
            if isinstance(library, _InnerLibrary):
                below = library._linking_libraries
                self._linking_libraries += [b for b in below if b not in self._linking_libraries]
        super().finalize()  # type: ignore[no-untyped-call]

    def _optimize_final_module(self) -> None:
        """Optimizes; large functions stay calls, as inlining them gains nothing but work."""
        for function in self._final_module.functions:
            if not function.is_declaration and _count_instructions(function) > _LARGE:
                function.add_function_attribute("noinline")
        super()._optimize_final_module()  # type: ignore[no-untyped-call]


def _count_instructions(function: Any) -> int:
    return sum(sum(1 for _ in block.instructions) for block in function.blocks)


@register_pass(mutates_CFG=True, analysis_only=False)  # type: ignore[no-untyped-call]
class _InnerLowering(NativeLowering):
    """Lowering to an `_InnerLibrary`, with an object in place of an entry for Python."""

    _name = "inner_lowering"

    def run_pass(self, state: Any) -> bool:
        """Lowers the function, and tells Numba by what others call it."""
        state.library = _InnerLibrary(state.targetctx.codegen(), state.func_id.func_qualname)  # type: ignore[no-untyped-call]
        state.flags.no_compile = True
        super().run_pass(state)  # type: ignore[no-untyped-call]
        name, lowered = state.func_id.func_name, state["cr"]
        module = lowered.fndesc.lookup_module()
        entry = _dynfunc.make_function(module, name, "inner", 0, lowered.env, (state.library,))
        state.targetctx.insert_user_function(entry, lowered.fndesc, [state.library])
        state["cr"] = lowered._replace(cfunc=entry)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)  # type: ignore[no-untyped-call]
class _KernelLowering(NativeLowering):
    """Lowering to a `_KernelLibrary`, whose inner functions get their environments."""

    _name = "kernel_lowering"

    def run_pass(self, state: Any) -> bool:
        """Lowers, optimizes and emits the function."""
        state.library = _KernelLibrary(state.targetctx.codegen(), state.func_id.func_qualname)  # type: ignore[no-untyped-call]
        state.library.enable_object_caching()
        super().run_pass(state)  # type: ignore[no-untyped-call]
        for variable in state.library._final_module.global_variables:
            if (environment := lookup_environment(variable.name)) is not None:  # type: ignore[no-untyped-call]
                state.library.codegen.set_env(variable.name, environment)
        return True


class _Pipeline(CompilerBase):
    """Numba's pipeline with a lowering of ours."""

    lowering: type[NativeLowering]

    def define_pipelines(self) -> list[Any]:
        """Returns Numba's passes, the lowering replaced."""
        manager = DefaultPassBuilder.define_nopython_pipeline(self.state)  # type: ignore[no-untyped-call]
        passes = [(self.lowering if p is NativeLowering else p, text) for p, text in manager.passes]
        manager.passes[:] = passes
        return [manager]


class _InnerPipeline(_Pipeline):
    lowering = _InnerLowering


class _KernelPipeline(_Pipeline):
    lowering = _KernelLowering


# For functions that Python calls.
kernel = njit(nogil=True, error_model="numpy")

# For functions that compiled code alone calls: without an entry for Python, which takes as long to
# compile as the function itself if that is short. Python must not call it: Numba does not check
# that.
inner = njit(nogil=True, error_model="numpy", no_cpython_wrapper=True)

# The same for functions that make no arrays, and return none: they count no references, neither to
# arguments nor to views of them, which whoever calls holds meanwhile. Recursions over short arrays
# are three times as fast as with `inner` and `borrow`.
borrowing = njit(nogil=True, error_model="numpy", no_cpython_wrapper=True, _nrt=False)


def chosen(choose: Callable[..., Callable[..., Any]]) -> Callable[[_Function], _Function]:
    """Returns a decorator: compiled code calls in a function's place what is chosen by its types.

    Args:
        choose: takes Numba's types of the arguments, returns a Python function of the same
            parameters, which is compiled as with `borrowing`.
    """
    options: Any = {
        **{"nogil": True, "error_model": "numpy", "pipeline_class": _InnerPipeline, "_nrt": False},
        **{"no_cpython_wrapper": True, "no_cfunc_wrapper": True},
    }

    def register(function: _Function) -> _Function:
        overload(function, strict=False, jit_options=options)(choose)
        return function

    return register


class _Lent(types.Type):
    """Numba's type of a named tuple that compiled code passes by its address."""

    def __init__(self, kind: Any) -> None:
        """Lends tuples of a type."""
        self.kind, self.instance_class = kind, kind.instance_class
        super().__init__(f"lent({kind})")

    def find(self, name: str) -> tuple[int, Any]:
        """Returns the place of a field, and its type: tuples within are lent, too."""
        place = self.kind.fields.index(name)
        part = self.kind.types[place]
        return place, _Lent(part) if isinstance(part, types.BaseNamedTuple) else part


@register_model(_Lent)
class _LentModel(models.PrimitiveModel):
    """An address."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, cgutils.voidptr_t)  # type: ignore[no-untyped-call]


@infer_getattr
class _LentAttributes(AttributeTemplate):
    key = _Lent

    def generic_resolve(self, kind: Any, name: str) -> Any:  # type: ignore[override]
        """Returns the type of a field; None if there is none of this name."""
        return kind.find(name)[1] if name in kind.kind.fields else None


@lower_getattr_generic(_Lent)  # type: ignore[no-untyped-call, untyped-decorator]
def _read_lent(context: Any, builder: Any, kind: Any, address: Any, name: str) -> Any:
    place, part = kind.find(name)
    layout = context.get_value_type(kind.kind).as_pointer()
    address = cgutils.gep_inbounds(builder, builder.bitcast(address, layout), 0, place)  # type: ignore[no-untyped-call]
    if isinstance(part, _Lent):
        return builder.bitcast(address, cgutils.voidptr_t)
    return _forget_owners(context, builder, part, _load(builder, address))


def _load(builder: Any, address: Any) -> Any:
    """Returns what is at an address, each number read on its own, as one that never changes."""
    kind = address.type.pointee
    if isinstance(kind, ir.Aggregate):
        value = ir.Constant(kind, ir.Undefined)
        for i in range(len(kind)):
            part = _load(builder, cgutils.gep_inbounds(builder, address, 0, i))  # type: ignore[no-untyped-call]
            value = builder.insert_value(value, part, i)
        return value
    value = builder.load(address)
    value.set_metadata("invariant.load", builder.module.add_metadata([]))
    return value


def _borrow(_: Any, value: Any) -> Any:
    is_tuple = isinstance(value, types.BaseNamedTuple)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        found = _forget_owners(context, builder, signature.args[0], arguments[0])
        return _lend(builder, found) if is_tuple else found

    return (_Lent(value) if is_tuple else value)(value), generate


def _lend(builder: Any, value: Any) -> Any:
    """Returns the address of a value, which LLVM may not look behind: there it never changes."""
    address = builder.bitcast(cgutils.alloca_once_value(builder, value), cgutils.voidptr_t)  # type: ignore[no-untyped-call]
    same = ir.FunctionType(cgutils.voidptr_t, [cgutils.voidptr_t])
    return builder.asm(same, "", "=r,0,~{memory}", [address], side_effect=True)


def _forget_owners(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo = array.meminfo.type(None)
        array.parent = array.parent.type(None)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        each: Any
        for i, each in enumerate(kind):  # type: ignore[arg-type]
            part = _forget_owners(context, builder, each, builder.extract_value(value, i))
            value = builder.insert_value(value, part, i)
    return value


# Returns arrays, or tuples of them, whose references are not counted. A kernel may call it first on
# what Python holds meanwhile, and must return none of it. Else each view of an array, and each
# function that takes one, counts up and down: atomic operations of some 20 cycles.
#
# Named tuples become addresses of theirs, of which functions read the fields that they use. Passed
# by value, a problem of shooting and its memory would be 700 arguments of each function, which is
# most of what there would be to compile.
borrow: Callable[[_Borrowed], _Borrowed] = cast(Any, intrinsic(_borrow))


@contextmanager
def tell_compilation(tell: Callable[[Notice], None]) -> Iterator[None]:
    """Reports the first compilation in a `with` block; nothing if none is needed.

    Args:
        tell: called once, in the thread that compiles, before it does.
    """
    with install_listener("numba:compile", _FirstCompilation(tell)):
        yield


class _FirstCompilation(Listener):
    """Listener that reports the first compilation."""

    def __init__(self, tell: Callable[[Notice], None]) -> None:
        self._tell: Callable[[Notice], None] | None = tell

    def on_start(self, event: Event) -> None:
        if self._tell:
            tell, self._tell = self._tell, None
            is_kept = getattr(event.data["dispatcher"]._cache, "keeps", False)
            tell(Notice(find_reason() + _COMPILES + (_KEPT if is_kept else _LOST)))

    def on_end(self, event: Event) -> None:
        pass
