"""Machine code on disk, never stale: of earlier processes, and what an installed package has."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import platform
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import IO, Any, cast

import llvmlite
import numba
from llvmlite.binding import get_host_cpu_features
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile

# Where a built package has machine code for processors of these levels, the better one first, with
# what a processor must have for it (the psABI's x86-64-v3, as LLVM names its parts).
_FOLDER, MANIFEST = Path(__file__).parent / "machine_code", "manifest.json"
LEVELS = {
    "x86-64-v3": ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "popcnt", "xsave"),
    "x86-64": (),
}
# Names the folder that code is put into while a package is built (`.ci/build_hook.py`).
BUILT_INTO = "DRAKE_AIGTO_BUILD_MACHINE_CODE"

_PACKAGE = __name__.partition(".")[0]
_IMPORT = re.compile(
    r"^[ \t]*(?:from|import)[ \t]+(\.*)([\w.]*)(?:[ \t]+import[ \t]+(\([^)]*\)|.*))?", re.M
)
_ALIAS = re.compile(r"\bas \w+")  # of an imported name


class _NoFolder:
    """Place of code that can be kept nowhere, as numba's locators have it."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._line = function.__code__.co_firstlineno

    @classmethod
    def from_function(cls, function: Callable[..., Any], _: str) -> _NoFolder:
        """Returns one for any function."""
        return cls(function)

    def get_cache_path(self) -> str:
        """Returns no folder."""
        return os.devnull

    def get_source_stamp(self) -> str:
        """Returns what never changes."""
        return ""

    def get_disambiguator(self) -> str:
        """Returns the function's line."""
        return str(self._line)


class _CacheImpl(CompileResultCacheImpl):
    """Numba's, which finds a place for every function."""

    _locator_classes = [*CompileResultCacheImpl._locator_classes, cast(Any, _NoFolder)]  # noqa: RUF012


class CodeCache(FunctionCache):
    """Numba's cache of a function, which is fresh while all sources that it may use are.

    Machine code holds the functions that it calls, the constants that it reads and the layout of
    its arguments, wherever these are defined. Numba itself looks at the function's file alone.

    Of processes that need the same code one compiles, and the others wait for it.

    Code is kept beside the source, else in ``NUMBA_CACHE_DIR`` or the user's cache folder. Where
    none of them can be written to, as in a package that root installed, run by a user without a
    home, each process compiles for itself.

    A package that was built with machine code (docs/develop.md) has it in a folder of its own,
    which is read alone, and counts for the same sources, versions of Python, Numba and LLVM, and
    processors that have what it needs. It computes what code for this very processor computes, to
    the last bit, as nothing may reorder floating point.

    Attributes:
        keeps: whether what is compiled is kept.
    """

    _impl_class = _CacheImpl

    def __init__(self, function: Callable[..., Any]) -> None:
        """Adds a digest of those sources to what Numba compares first, which is its version.

        It does not even read what other versions cached: classes named there may be gone.
        """
        super().__init__(function)  # type: ignore[no-untyped-call]
        self.keeps = not isinstance(self._impl.locator, _NoFolder)
        file, package = function.__code__.co_filename, function.__module__.partition(".")[0]
        used = _digest(os.path.abspath(file), package)
        self._cache_file._version = numba.__version__, llvmlite.__version__, used
        folder = os.environ.get(BUILT_INTO) or (_FOLDER if _read_manifest() else None)
        self._lock: IO[str] | None = None
        self._shipped: IndexDataCacheFile | None = None
        if folder and package == _PACKAGE:
            name = f"{function.__module__}.{function.__qualname__}.py{sys.version_info.minor}"
            self._shipped = IndexDataCacheFile(str(folder), name, "")  # type: ignore[no-untyped-call]
            self._shipped._version = self._cache_file._version

    def _load_overload(self, sig: Any, target_context: Any) -> Any:
        """Returns what the package has, or else what was kept; None if neither is there."""
        for key in self._list_keys(sig, target_context.codegen()) if self._shipped else ():
            if (code := self._shipped.load(key)) is not None:  # type: ignore[union-attr]
                return self._impl.rebuild(target_context, code)
        if not self.keeps:
            return None
        code = super()._load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        if code is None and self._lock is None:
            with suppress(OSError):  # Some file systems have no locks: all compile for themselves.
                self._impl.locator.ensure_cache_path()
                self._lock = open(f"{self._cache_file._index_path}.lock", "a")  # noqa: SIM115
                fcntl.flock(self._lock, fcntl.LOCK_EX)
            code = super()._load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        return code

    @contextmanager
    def releasing(self) -> Iterator[None]:
        """Ends what keeps other processes from compiling: for around a compilation, as it ends."""
        try:
            yield
        finally:
            if self._lock is not None:
                self._lock.close()
                self._lock = None

    def _list_keys(self, sig: Any, codegen: Any) -> Iterator[Any]:
        """Yields keys of code that this processor may run."""
        own, (triple, *_), *function = self._index_key(sig, codegen)  # type: ignore[no-untyped-call]
        for level in _list_levels():
            yield own, (triple, level, ""), *function

    def _save_overload(self, sig: Any, data: Any) -> None:
        """Keeps code; in a build that is the package's."""
        if os.environ.get(BUILT_INTO) and self._shipped:
            key = self._index_key(sig, data.codegen)  # type: ignore[no-untyped-call]
            self._shipped.save(key, self._impl.reduce(data))  # type: ignore[no-untyped-call]
        elif self.keeps:
            super()._save_overload(sig, data)  # type: ignore[no-untyped-call]


@cache
def _read_manifest() -> dict[str, str]:
    """Returns the versions that the package's machine code is for; empty: it has none."""
    try:
        found: dict[str, str] = json.loads((_FOLDER / MANIFEST).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    return found


def list_versions() -> dict[str, str]:
    """Returns the versions that machine code depends on."""
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    return {"Python": python, "numba": numba.__version__, "llvmlite": llvmlite.__version__}


def find_reason() -> str:
    """Returns why the package's own machine code does not count, in words; "" if it has none."""
    if not (built := _read_manifest()):
        return ""
    for name, found in list_versions().items():
        if built[name] != found:
            return f"the package's machine code is for {name} {built[name]}, not {found}: "
    if not _list_levels():
        return "the package has no machine code for this processor: "
    return "the package's machine code is of other sources, or lacks this kernel: "


@cache
def _list_levels() -> tuple[str, ...]:
    """Returns the levels that this processor has all parts of, the better one first."""
    if platform.machine() not in ("x86_64", "AMD64"):
        return ()
    has = set(get_host_cpu_features().flatten().split(","))
    return tuple(
        level for level, parts in LEVELS.items() if all(f"+{part}" in has for part in parts)
    )


@cache
def _digest(file: str, package: str) -> str:
    """Returns a digest of a file and all that it imports, directly or by way of others.

    Only sources of its own package and of ours count, also those imported for type checkers alone.
    """
    paths = {name: getattr(sys.modules.get(name), "__path__", None) for name in (package, _PACKAGE)}
    folders = tuple((name, path[0]) for name, path in paths.items() if path)
    files, digest = [file], hashlib.sha256()
    for each in files:  # It grows meanwhile.
        digest.update(hashlib.sha256(_read(each)).digest())
        files += [found for found in _imported_files(each, folders) if found not in files]
    return digest.hexdigest()


@cache
def _read(file: str) -> bytes:
    with open(file, "rb") as source:
        return source.read()


@cache
def _imports(file: str) -> tuple[tuple[str, str, tuple[str, ...]], ...]:
    """Returns what a file imports: leading dots, a module, and names in it (or none)."""
    found = _IMPORT.findall(_ALIAS.sub("", _read(file).decode()))
    return tuple((dots, module, tuple(re.findall(r"\w+", names))) for dots, module, names in found)


@cache
def _imported_files(file: str, folders: tuple[tuple[str, str], ...]) -> tuple[str, ...]:
    """Returns the files that a file imports from packages in these folders, by name."""
    found = (
        origin
        for dots, module, names in _imports(file)
        for name in names or ("",)
        for origin in _origins(file, folders, dots, module, name)
    )
    return tuple(dict.fromkeys(found))


def _origins(
    file: str, folders: tuple[tuple[str, str], ...], dots: str, module: str, name: str
) -> tuple[str, ...]:
    """Returns the files that a name comes from: beyond a package's door, where it is passed on."""
    root, _, rest = module.partition(".")
    base = dict(folders).get(root)
    if dots:
        base, rest = os.path.join(os.path.dirname(file), *[".."] * (len(dots) - 1)), module
    if base is None:
        return ()
    stem = os.path.normpath(os.path.join(base, *rest.split(".")))
    submodule = _sources(os.path.join(stem, name))
    if submodule:
        return submodule
    for door in _sources(stem):
        for dots, module, names in _imports(door) if name else ():
            if name in names:
                return _origins(door, folders, dots, module, name)
    return _sources(stem)


@cache
def _sources(stem: str) -> tuple[str, ...]:
    """Returns the files of a module or package, the stub of a lazy door among them."""
    names = (f"{stem}.py", os.path.join(stem, "__init__.py"), os.path.join(stem, "__init__.pyi"))
    return tuple(name for name in names if os.path.isfile(name))
