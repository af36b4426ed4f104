"""What README and docs say was measured: commands, what they printed, figures read off that.

    python -m benchmarks.records run                  # all of them, into docs/results
    python -m benchmarks.records run corridor room    # only these
    python -m benchmarks.records run friction --parts build/parts   # in parts: Ctrl-C, then again
    python -m benchmarks.records quote                # put their figures into README and docs

A page quotes a figure of `FIGURES` between marks that readers do not see:

    <!-- figure: plan_ms -->12.8<!-- end -->

One of several lines becomes a block of its own.

A test compares the pages with the records, so that neither changes without the other.
"""

from __future__ import annotations

import argparse
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from datetime import date
from pathlib import Path

from benchmarks.measure import machine, versions
from benchmarks.recorded import CHECKOUT, FIGURES, RECORDS, path_of, read_output
from drake_aigto.output import write_text

MARKED = re.compile(r"(<!-- figure: (\w+) -->).*?(<!-- end -->)", re.DOTALL)
PAGES = (CHECKOUT / "README.md", *sorted((CHECKOUT / "docs").glob("*.md")))


def run(name: str, parts: Path | None = None) -> int:
    """Runs a record's command, saves what it prints, and returns its exit status.

    With a folder of parts, what is done is kept there, and gone on from when it is run again.
    """
    arguments = shlex.split(RECORDS[name])[1:]  # after `python`
    saved = CHECKOUT / arguments[arguments.index("--json") + 1] if "--json" in arguments else None
    if saved:  # From the beginning, and not where an earlier run ended.
        saved.unlink(missing_ok=True)
    kept = parts and parts.absolute() / name
    if kept:
        kept.parent.mkdir(parents=True, exist_ok=True)
        arguments += _flags_of_parts(arguments, kept)
    begin = time.perf_counter()
    result = subprocess.run(
        [sys.executable, *arguments], cwd=CHECKOUT, stdout=subprocess.PIPE, text=True, check=False
    )
    seconds = time.perf_counter() - begin
    head = (
        RECORDS[name],
        f"{machine()}; {versions()}",
        f"commit {_commit()}, {date.today()}, {seconds:.0f} s, exit status {result.returncode}",
    )
    if kept and saved:
        shutil.copy(kept, saved)
    write_text(path_of(name), "".join(f"# {line}\n" for line in head) + result.stdout)
    return result.returncode


def _flags_of_parts(arguments: Sequence[str], kept: Path) -> list[str]:
    """Returns what has a command keep its results in a file, and go on from them."""
    if arguments[1] in ("benchmarks", "benchmarks.robots") and arguments[2] != "page":
        return ["--json", str(kept), "--resume"]
    return ["--keep", str(kept)] if "--workers" in arguments else []


def _commit() -> str:
    """Returns the commit, and whether what is measured was changed since."""

    def git(*arguments: str) -> str:
        command = ["git", *arguments]
        return subprocess.run(
            command, cwd=CHECKOUT, capture_output=True, text=True, check=True
        ).stdout.strip()

    changed = git("status", "--porcelain", "--", "drake_aigto", "benchmarks", "models")
    return git("rev-parse", "--short", "HEAD") + ("-dirty" if changed else "")


def quote(text: str) -> str:
    """Returns a page's text with the figures that the records have now.

    Raises:
        LookupError: a figure is not in its record.
    """
    return MARKED.sub(lambda mark: f"{mark[1]}{_read_figure(mark[2])}{mark[3]}", text)


def _read_figure(name: str) -> str:
    record, pattern = FIGURES[name]
    found = re.search(pattern, read_output(record), re.MULTILINE)
    if not found:
        raise LookupError(f"figure {name!r}: record {record!r} has nothing like {pattern!r}")
    return f"\n\n```text\n{found[1]}\n```\n\n" if "\n" in found[1] else found[1]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs or quotes, and returns the exit status: 1 if a command's is not 0."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    running = commands.add_parser("run", help="run commands and save what they print")
    running.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(RECORDS)}")
    running.add_argument("--parts", type=Path, metavar="FOLDER", help="keep parts, and go on")
    commands.add_parser("quote", help="put what is saved into README and docs")
    options = parser.parse_args(arguments)
    if options.command == "quote":
        for page in PAGES:
            write_text(page, quote(page.read_text(encoding="utf-8")))
        return 0
    if unknown := set(options.names) - set(RECORDS):
        parser.error(f"unknown records {sorted(unknown)}, expected some of {', '.join(RECORDS)}")
    failed = False
    for name in options.names or RECORDS:  # in turn: two at once slow each other down
        status = run(name, options.parts)
        failed |= status != 0
        print(f"{name}: exit status {status}, {path_of(name).relative_to(CHECKOUT)}", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
