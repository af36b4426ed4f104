"""Counts the files of the package whose functions run during a warm plan.

    python -m benchmarks.files_run                            # a ball, a soft and a rigid cart-pole
    python -m benchmarks.files_run table1/1 paddle/bat --list

A plan is made once before, so that what is compiled or cached is not counted; compiled kernels are
not seen, but the functions that call them are. The share is that of the first scenario's files that
run for the others as well.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Any

import drake_aigto
from benchmarks.script import read_flags
from drake_aigto import PlanOptions, Scenario, plan

_ROOT = Path(drake_aigto.__file__).parent
_USUAL = ("table1/1", "cart_pole/soft_06", "cart_pole/rigid_06")


def list_files(name: str) -> set[str]:
    """Returns the files of the package whose functions run in a scenario's second plan."""
    scenario, options = Scenario.named(name), PlanOptions(threads=1)
    plan(scenario, options)
    seen: set[str] = set()

    def note(frame: FrameType, event: str, _: Any) -> None:
        if event == "call" and frame.f_code.co_name != "<module>":
            seen.add(frame.f_code.co_filename)

    sys.setprofile(note)
    threading.setprofile(note)
    try:
        plan(scenario, options)
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    paths = (Path(each) for each in seen)
    return {str(path.relative_to(_ROOT)) for path in paths if path.is_relative_to(_ROOT)}


def main(arguments: Sequence[str] | None = None) -> None:
    """Prints the counts, and the files if asked."""
    place = "scenarios", {"nargs": "*", "default": _USUAL, "metavar": "SCENARIO"}
    options = read_flags(
        __doc__, arguments, workers=None, place=place, list=(False, "print the files as well")
    )
    found = {name: list_files(name) for name in options.scenarios}
    first = found[options.scenarios[0]]
    for name, files in found.items():
        print(f"{name:24}{len(files):4} files{len(first & files) / len(first):7.0%} of the first's")
    shared = set.intersection(*found.values())
    print(f"run for all: {len(shared)} ({len(shared) / len(first):.0%} of the first's)")
    if options.list:
        for name in sorted(set.union(*found.values())):
            print(f"  {name:44}" + " ".join("x" if name in f else "." for f in found.values()))


if __name__ == "__main__":
    main()
