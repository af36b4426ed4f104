"""``drake-aigto bench``: measurements, a file for each."""

from __future__ import annotations

from typing import Any

from drake_aigto.cli.bench.page import add_page
from drake_aigto.cli.bench.scenarios import add_scenarios
from drake_aigto.cli.flags import add_common, format_examples

_EXAMPLES = """\
drake-aigto bench scenarios --count 50 --json scenarios.json   # how often, and how fast
drake-aigto bench page scenarios.json --out results.md         # with figures
drake-aigto bench scenarios --help                             # all that a benchmark takes
"""


def add_bench(commands: Any) -> None:
    """Adds the command and all that it measures."""
    text = "measure: how often, how fast, against what else"
    bench = commands.add_parser(
        "bench", help=text, description=f"{text.capitalize()}.", epilog=format_examples(_EXAMPLES)
    )
    add_common(bench)
    benchmarks = bench.add_commands("BENCHMARK")
    add_scenarios(benchmarks)
    add_page(benchmarks)
