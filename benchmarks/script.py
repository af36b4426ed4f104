"""What scripts that measure share: flags, jobs side by side, clocks, spreads, and CSV files."""

from __future__ import annotations

import argparse
import csv
import importlib
import math
import os
import pickle
import platform
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import asdict, dataclass, fields
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np

from drake_aigto import AigtoError
from drake_aigto.cli import BAD_INPUT, add_workers, read_workers
from drake_aigto.errors import OptionsError
from drake_aigto.jobs import open_jobs

# `drake-aigto`, for an interpreter that is started with -c.
COMMAND = "import sys; from drake_aigto.cli import main; sys.exit(main(sys.argv[1:]))"
PACKAGES = ("drake", "numpy", "scipy", "numba", "casadi", "cma")


class Seconds(NamedTuple):
    """How long something took."""

    wall: float
    cpu: float  # of this process, all its threads


def clock(work: Callable[[], Any]) -> tuple[Any, Seconds]:
    """Returns what the work returns, and how long it took."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = work()
    return result, Seconds(time.perf_counter() - wall, time.process_time() - cpu)


def within(seconds: float) -> Iterator[None]:
    """Yields once, and again until this process has used the given CPU time [s]."""
    end = time.process_time() + seconds
    yield
    while time.process_time() <= end:
        yield


def take_turns(
    works: Mapping[str, Callable[[], Any]], repeats: int, calls: int = 1
) -> dict[str, list[float]]:
    """Returns CPU seconds a call, A, B, …, A, B, …: what disturbs one disturbs all.

    Args:
        works: name → what is timed.
        repeats: how many turns.
        calls: of each, in a turn.
    """
    found: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(repeats):
        for name, work in works.items():
            begin = time.process_time()
            for _ in range(calls):
                work()
            found[name].append((time.process_time() - begin) / calls)
    return found


@dataclass(frozen=True)
class Spread:
    """Median and quartiles."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Iterable[float]) -> Spread:
        low, median, high = np.percentile(list(values), [25, 50, 75]).tolist()
        return cls(median, low, high)

    def show(self, unit: float = 1.0, digits: int = 2) -> str:
        """Returns the median and the quartiles, in a unit."""
        low, median, high = (
            f"{each / unit:.{digits}f}" for each in (self.low, self.median, self.high)
        )
        return f"{median} ({low} … {high})"


def is_met(figure: str, value: float, most: float) -> bool:
    """Prints whether a figure that is asked for is reached, and returns it."""
    met = value <= most
    print(
        f"{'met   ' if met else 'MISSED'} {figure}: {value:.3g}, asked for ≤ {most:g}", flush=True
    )
    return met


def machine() -> str:
    """The processor and the system."""
    names = [platform.processor() or platform.machine()]
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        lines = cpuinfo.read_text(encoding="utf-8").splitlines()
        names = [line.split(":", 1)[1].strip() for line in lines if "model name" in line] or names
    return f"{names[0]}, {platform.system()}"


def versions() -> str:
    """Python and the packages that are installed."""
    found = [f"Python {platform.python_version()}"]
    for package in PACKAGES:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            found.append(f"no {package}")
    return ", ".join(found)


def write_csv(path: Path, records: Sequence[Any], note: str) -> None:
    """Writes dataclasses of one class; the first lines, behind #, say on what and with what."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f"{path.name}.tmp")
    with unfinished.open("w", newline="", encoding="utf-8") as file:
        file.write(f"# {machine()}, {os.cpu_count()} cores, {note}\n# {versions()}\n")
        writer = csv.DictWriter(file, [field.name for field in fields(records[0])])
        writer.writeheader()
        writer.writerows(asdict(record) for record in records)
    unfinished.replace(path)


# Flags of where, for how long and to what file jobs run: they do not change what comes of them.
_WHERE = ("workers", "scheduler", "minutes", "keep", "json")


def read_flags(
    doc: str | None,
    words: Sequence[str] | None = None,
    *,
    workers: int | None = 1,
    place: tuple[str, Mapping[str, Any]] | None = None,
    **flags: tuple[Any, ...],
) -> argparse.Namespace:
    """Returns the parsed flags of a script, whose docstring begins with what it measures.

    Args:
        doc: the docstring.
        words: what was typed; None takes it from `sys.argv`.
        workers: how many processes run jobs if nothing is said; None: there are no jobs.
        place: name of what stands without a flag, and what argparse takes.
        flags: name → default, which tells the type (of a tuple's items, if it is one), what it is,
            and, if need be, what else argparse takes.
    """
    parser = argparse.ArgumentParser(description=(doc or "").partition("\n")[0])
    if place is not None:
        parser.add_argument(place[0], **place[1])
    for name, (default, text, *more) in flags.items():
        look: dict[str, Any] = {"default": default, "help": text}
        if isinstance(default, bool):
            look["action"] = "store_true"
        elif isinstance(default, tuple):
            look |= {"type": type(default[0]), "nargs": "*"}
        elif isinstance(default, list):
            look |= {"type": type(default[0])} if default else {}
        elif default is not None:
            look["type"] = type(default)
        flag = f"--{name.replace('_', '-')}"
        parser.add_argument(flag, **{**look, **(more[0] if more else {})})
    if workers is not None:
        add_workers(parser, workers)
        text = "then what runs is ended, the rest reported"
        parser.add_argument("--minutes", type=float, default=math.inf, help=text)
        text = "keep what is done in this file, and go on from it"
        parser.add_argument("--keep", type=Path, metavar="FILE", help=text)
    return parser.parse_args(words)


def run_jobs(
    work: Callable[[Any], Any], jobs: Sequence[Any], options: argparse.Namespace
) -> Iterator[tuple[int, Future[Any]]]:
    """Starts jobs in this order and yields each one's number as it ends, with result or exception.

    Jobs that have not ended when time is up are not yielded: nobody knows what would have come of
    them.

    Args:
        work: a function of a module.
        jobs: what it is called with; they are told apart by how they are printed.
        options: of `read_flags`.

    Raises:
        OptionsError: what was kept is of other flags.
    """
    kept = _Kept(options)
    names = list(map(repr, jobs))
    for number, name in enumerate(names):
        if name in kept.results:
            done: Future[Any] = Future()
            done.set_result(kept.results[name])
            yield number, done
    with open_jobs(read_workers(options)) as under_way:
        left = {number for number, name in enumerate(names) if name not in kept.results}
        for number in sorted(left):
            under_way.start(number, work, jobs[number])
        try:
            for number, future in under_way.ended(60.0 * options.minutes):
                left.discard(number)
                if not future.exception():
                    kept.add(names[number], future.result())
                yield number, future
        except TimeoutError:
            print(f"TIME IS UP: {len(left)} jobs not done", flush=True)


class _Kept:
    """Results of jobs by name, in a file that grows with each: flags first, then pairs."""

    def __init__(self, options: argparse.Namespace) -> None:
        """Reads the file, if there is one; one that was cut short ends where it is whole."""
        self._path: Path | None = options.keep
        self.results: dict[str, Any] = {}
        if self._path is None:
            return
        flags = {name: value for name, value in vars(options).items() if name not in _WHERE}
        there = []
        if self._path.exists():
            with self._path.open("rb") as file:
                try:
                    while True:
                        there.append(pickle.load(file))
                except (EOFError, pickle.UnpicklingError):
                    pass
        if there and there[0] != flags:
            raise OptionsError(f"--keep {self._path}", got=there[0], expected=flags)
        self.results = dict(there[1:])
        self._path.write_bytes(b"".join(map(pickle.dumps, [flags, *there[1:]])))

    def add(self, name: str, result: Any) -> None:
        """Keeps a result."""
        self.results[name] = result
        if self._path is not None:
            with self._path.open("ab") as file:
                pickle.dump((name, result), file)


def run_all(
    work: Callable[[Any], Any], jobs: Sequence[Any], options: argparse.Namespace
) -> list[Any]:
    """Runs jobs, tells which fail, and returns the results of the others in the order of the jobs.

    The arguments are those of `run_jobs`.
    """
    done: dict[int, Any] = {}
    for number, future in run_jobs(work, jobs, options):
        if error := future.exception():
            print(f"FAILED {jobs[number]}: {error!r}", flush=True)
        else:
            done[number] = future.result()
    return [done[number] for number in sorted(done)]


def run_as(name: str) -> NoReturn:
    """Runs `main` of a module under its name, by which workers find its functions, and exits."""
    try:
        sys.exit(importlib.import_module(name).main())
    except AigtoError as error:
        print(f"{name}: {error}", file=sys.stderr)
        sys.exit(BAD_INPUT)
