"""Numba's compiler, where there may be no place for its cache."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

_Function = TypeVar("_Function", bound=Callable[..., Any])


def njit(**options: Any) -> Callable[[_Function], _Function]:
    """Returns `numba.njit` with these options, as a decorator that never fails for want of a cache.

    With ``cache=True`` Numba keeps machine code beside the source, else in ``NUMBA_CACHE_DIR`` or
    the user's cache folder, and raises when it can write to none of them: a package that root
    installed, run by a user without a home. Then each process compiles for itself.

    No function gets a C entry, which nothing here calls and which takes time to compile.
    """
    options["no_cfunc_wrapper"] = True

    def compile_later(function: _Function) -> _Function:
        try:
            return numba.njit(**options)(function)
        except RuntimeError as error:
            # Numba has no class of its own for this.
            if not str(error).startswith("cannot cache function"):
                raise
            return numba.njit(**{**options, "cache": False})(function)

    return compile_later


# What Python calls.
kernel = njit(cache=True, nogil=True, error_model="numpy")

# What compiled code alone calls: without an entry for Python, which takes as long to compile as the
# function itself if that is short. Python must not call it: Numba does not check that.
inner = njit(cache=True, nogil=True, error_model="numpy", no_cpython_wrapper=True)

# What one place in compiled code calls, and itself calls much: Numba pastes it there. On its own,
# LLVM would optimise all of it once more. Short functions gain nothing by it, and many in one lose,
# as Numba's time grows faster than a function's length.
pasted = njit(cache=True, nogil=True, error_model="numpy", inline="always")
