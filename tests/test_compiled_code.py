"""Machine code that was kept on disk is used while its sources are as they were, and no longer."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numba.core.event import Event, Listener, install_listener

import drake_aigto
from drake_aigto import kernels
from drake_aigto.arrays import Floats

CHECKOUT = Path(drake_aigto.__file__).parents[1]

# A kernel that calls two others, one of them through a package's lazy door, reads a
# constant, and takes a record whose type is only named.
SOURCES = {
    "__init__.py": "",
    "numbers.py": "STEP = 10.0\n",
    "record.py": """
from typing import NamedTuple
class Record(NamedTuple):
    first: float
    second: float
""",
    "below.py": """
from drake_aigto.kernels import borrowing
@borrowing
def double(x):
    return 2.0 * x
""",
    "door/__init__.py": """
import lazy_loader
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
""",
    "door/__init__.pyi": """
from .called import raised as raised
from .unused import nothing as nothing
""",
    "door/called.py": """
from drake_aigto.kernels import inner
@inner
def raised(x):
    return x + 1.0
""",
    "door/unused.py": "nothing = 0.0",
    "outer.py": """
from __future__ import annotations
from typing import TYPE_CHECKING
from drake_aigto.kernels import kernel
from little.door import raised
from little.below import double
from .numbers import STEP
if TYPE_CHECKING:
    from little.record import Record
@kernel
def outer(record: Record):
    return STEP * record.first + double(raised(record.second))
""",
}

PROGRAM = """
from numba.core import event
from drake_aigto.kernels import tell_compilation
from little.outer import outer
from little import record
told = []
record = getattr(record, "Record", None) or record.Pair
with event.install_recorder("numba:compile") as recorder, tell_compilation(told.append):
    print(outer(record(first=1.0, second=2.0)), len(recorder.buffer) > 0)
compiled = len(recorder.buffer) > 0
assert len(told) == compiled, told
assert all(line.endswith("; it is kept for next time") for line in told), told
"""

Run = Callable[[], tuple[float, bool]]
Start = Callable[[], subprocess.Popen[str]]


@pytest.fixture
def little(tmp_path: Path) -> Path:
    folder = tmp_path / "little"
    (folder / "door").mkdir(parents=True)
    for name, source in SOURCES.items():
        (folder / name).write_text(source, encoding="utf-8")
    return folder


@pytest.fixture
def start(little: Path) -> Start:
    path = os.pathsep.join([str(little.parent), str(CHECKOUT)])
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"}

    def start_process() -> subprocess.Popen[str]:
        command = [sys.executable, "-c", PROGRAM]
        return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)

    return start_process


def wait(process: subprocess.Popen[str]) -> tuple[float, bool]:
    value, compiled = process.communicate()[0].split()
    assert process.returncode == 0
    return float(value), compiled == "True"


@pytest.fixture
def run(start: Start) -> Run:
    return lambda: wait(start())


@pytest.mark.slow
def test_of_processes_that_need_the_same_kernel_one_compiles_it(start: Start) -> None:
    assert sorted(map(wait, [start() for _ in range(3)])) == [(16.0, False)] * 2 + [(16.0, True)]


def edit(file: Path, old: str, new: str) -> None:
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new), encoding="utf-8")


@pytest.mark.slow
def test_an_edit_of_anything_that_a_kernel_uses_is_in_the_next_run(little: Path, run: Run) -> None:
    assert run() == (16.0, True)
    edit(little / "door" / "unused.py", "0.0", "1.0")
    assert run() == (16.0, False)
    edit(little / "below.py", "2.0 * x", "3.0 * x")
    assert run() == (19.0, True)
    edit(little / "door" / "called.py", "x + 1.0", "x + 2.0")
    assert run() == (22.0, True)
    edit(little / "numbers.py", "10.0", "20.0")
    assert run() == (32.0, True)
    # Numba's types of the two records are equal: it would read one field for the other.
    fields = "    first: float\n    second: float\n"
    edit(little / "record.py", fields, "    second: float\n    first: float\n")
    assert run() == (32.0, True)
    # What is on disk names a class that is gone.
    for name in ("record.py", "outer.py"):
        edit(little / name, "Record", "Pair")
    assert run() == (32.0, True)
    assert run() == (32.0, False)


class Part(NamedTuple):
    """What a tuple has within."""

    numbers: Floats
    sign: float


class Whole(NamedTuple):
    """Fields of all kinds that tables of kernels have."""

    part: Part
    counts: bool
    sizes: tuple[int, int]
    matrix: Floats


@kernels.borrowing
def _weigh(whole: Whole, part: Part) -> float:
    total = 0.0
    for i in range(whole.sizes[0]):
        for j in range(whole.sizes[1]):
            total += whole.matrix[i, j] * part.numbers[j]
            whole.matrix[i, j] += 1.0
    return part.sign * total if whole.counts else total


@kernels.kernel
def _weigh_once(whole: Whole) -> float:
    whole = kernels.borrow(whole)
    return _weigh(whole, whole.part)


@kernels.kernel
def _weigh_often(first: Whole, second: Whole) -> float:
    """Alternates: what an address holds in one call must not be taken for that of the next."""
    lent, total = kernels.borrow(first), 0.0
    for i in range(4):
        total += (i + 1) * (_weigh_once(lent) if i % 2 == 0 else _weigh_once(second))
    return total


def test_compiled_code_reads_borrowed_tuples_as_python_does() -> None:
    """Else a field's place, or a value that was read before, would be wrong."""

    def make(sign: float, counts: bool) -> Whole:
        matrix = np.arange(6.0).reshape(2, 3)
        return Whole(Part(np.array([1.0, 10.0, 100.0]), sign), counts, (2, 3), matrix)

    expected = 0.0
    first, second = make(-1.0, True), make(-2.0, False)
    for i in range(4):
        whole = first if i % 2 == 0 else second
        total = float((whole.matrix @ whole.part.numbers).sum())
        expected += (i + 1) * (whole.part.sign if whole.counts else 1.0) * total
        whole.matrix[:] += 1.0
    given = make(-1.0, True), make(-2.0, False)
    assert _weigh_often(*given) == expected
    np.testing.assert_array_equal(given[0].matrix, first.matrix)
    np.testing.assert_array_equal(given[1].matrix, second.matrix)


@kernels.kernel
def _make_ones(size: int) -> float:
    return float(np.ones(size).sum())


@kernels.borrowing
def _add_ones(size: int) -> float:
    return _make_ones(size) + _make_ones(1)


@kernels.kernel
def _add_ones_below(size: int) -> float:
    return _add_ones(size)


def test_kernels_make_arrays_also_where_what_borrows_calls_them_first() -> None:
    """As AIGO's descent calls the means of a program whose systems are sparse."""
    assert _add_ones_below(2) == 3.0
    assert _make_ones(2) == 2.0


@pytest.mark.parametrize("is_collecting", [True, False])
def test_garbage_is_collected_after_a_compilation_if_it_was_before(is_collecting: bool) -> None:
    functions: dict[str, Callable[[float], float]] = {}
    exec("def called(x):\n    return x + 1.0", functions)
    if not is_collecting:
        gc.disable()
    try:
        assert kernels.kernel(functions["called"])(1.0) == 2.0
        assert gc.isenabled() == is_collecting
    finally:
        gc.enable()


class Interruption(Listener):
    """Presses Ctrl-C as each compilation begins, and counts them."""

    def __init__(self) -> None:
        """Starts with none."""
        self.count = 0

    def on_start(self, event: Event) -> None:
        self.count += 1
        signal.raise_signal(signal.SIGINT)

    def on_end(self, event: Event) -> None:
        pass


def test_ctrl_c_ends_what_compiles_once_that_is_whole() -> None:
    functions: dict[str, Callable[[float], float]] = {}
    exec("def called(x):\n    return x + 1.0", functions)  # Without a file none is kept on disk.
    called = functions["called"] = kernels.kernel(functions["called"])
    exec("def caller(x):\n    return 2.0 * called(x)", functions)
    caller, before = kernels.kernel(functions["caller"]), signal.getsignal(signal.SIGINT)
    interruption = Interruption()
    with install_listener("numba:compile", interruption), pytest.raises(KeyboardInterrupt):
        caller(2.0)
    assert signal.getsignal(signal.SIGINT) is before
    # Neither is compiled again.
    assert interruption.count == 2
    with install_listener("numba:compile", interruption):
        assert (caller(2.0), called(2.0)) == (6.0, 3.0)
    assert interruption.count == 2
