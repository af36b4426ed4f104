"""Lower bounds of SPOT's push-bot: how they grow with the number of cells, and what they cost.

    python -m benchmarks.push_bot_bounds [--steps 6 12 30] [--cells 20000 200000]

Source: Kang, Liu & Yang, RSS 2025, arXiv:2502.02829, from its README's start. No point is given.
"""

from __future__ import annotations

import time

from pydrake.solvers import MathematicalProgram

from benchmarks.collections.staged_programs import push_bot
from benchmarks.script import machine, read_flags
from drake_aigto.certify import Certifier, certify

START = (0.9, 0.0, 0.0, 0.0)
WALL = 1.0  # [m]


def main() -> None:
    arguments = read_flags(
        __doc__,
        workers=None,
        steps=((6, 12, 30), "", {"nargs": "+"}),
        cells=((20_000, 200_000), "that bounds are taken of", {"nargs": "+"}),
    )
    print(machine(), flush=True)
    certify(program(2), cells=100)  # has machine code compiled or loaded
    for steps in arguments.steps:
        print(f"{steps:2} steps, ranges of summands {Certifier(program(steps)).least_sum:6.2f}")
        for cells in arguments.cells:
            start = time.process_time()
            value = certify(program(steps), cells=cells).lower_bound
            seconds = time.process_time() - start
            print(
                f"{steps:2} steps, {cells:8} cells     {value:6.2f}  {seconds:5.1f} CPU s",
                flush=True,
            )


def program(steps: int) -> MathematicalProgram:
    return push_bot(START, WALL, "equalities", steps)


if __name__ == "__main__":
    main()
