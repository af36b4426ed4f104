"""What measurements share: turns, spreads, figures that are asked for, CSV files, the command."""

from __future__ import annotations

import csv
import os
import platform
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

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
