"""Lower bounds of SPOT's push-bot: what each way gives, and what it costs.

    python -m benchmarks.push_bot_bounds [--steps 6 12 30] [--cut 4 8 12]

Source: Kang, Liu & Yang, RSS 2025, arXiv:2502.02829, from its README's start. Squares are of order
1: of the program as it is written, and with rows that say what cos and sin of the turns in a step
are. Cells are all signs of cos θ at some steps; the least of their bounds counts.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from pydrake.solvers import MathematicalProgram
from pydrake.symbolic import cos, sin

from benchmarks.collections.staged_programs import push_bot
from benchmarks.script import machine, read_flags
from drake_aigto.certify import Certifier, certify

START = (0.9, 0.0, 0.0, 0.0)
WALL = 1.0  # [m]
LEAST_COSINE = 0.7  # of a turn


def main() -> None:
    arguments = read_flags(
        __doc__,
        workers=None,
        steps=((6, 12, 30), "", {"nargs": "+"}),
        cut=((4, 8, 12), "steps of cells"),
    )
    print(machine(), flush=True)
    squares(program(2))  # has machine code compiled or loaded
    for steps in arguments.steps:
        show(steps, "ranges of summands", partial(ranges, steps))
        show(steps, "squares", partial(least_of_cells, steps, ()))
        show(steps, "squares, with turns", partial(squares_with_turns, steps))
    steps, cut = max(arguments.steps), [k for k in arguments.cut if k <= max(arguments.steps)]
    show(steps, f"squares, {2 ** len(cut)} cells", partial(least_of_cells, steps, cut))


def show(steps: int, way: str, bound: Callable[[], float]) -> None:
    start = time.process_time()
    value = bound()
    print(
        f"{steps:2} steps, {way:20} {value:6.2f}  {time.process_time() - start:5.1f} CPU s",
        flush=True,
    )


def program(steps: int) -> MathematicalProgram:
    return push_bot(START, WALL, "equalities", steps)


def ranges(steps: int) -> float:
    return Certifier(program(steps)).least_sum


def squares(prog: MathematicalProgram) -> float:
    return certify(prog).lower_bound


def squares_with_turns(steps: int) -> float:
    """Returns the bound of a program with rows that follow from others: c and s of each turn."""
    prog = program(steps)
    angle = prog.decision_variables()[steps + 2 : 2 * steps + 4]
    turn = prog.NewContinuousVariables(steps + 1, "turn")
    for k, own in enumerate(turn):
        before, after = angle[k], angle[k + 1]
        prog.AddConstraint(cos(own) >= LEAST_COSINE)
        prog.AddConstraint(cos(after) - cos(before) * cos(own) + sin(before) * sin(own) == 0)
        prog.AddConstraint(sin(after) - sin(before) * cos(own) - cos(before) * sin(own) == 0)
        prog.AddConstraint(cos(own) - cos(after - before) == 0)
        prog.AddConstraint(sin(own) - sin(after - before) == 0)
    return squares(prog)


def least_of_cells(steps: int, cut: Sequence[int]) -> float:
    """Returns the least bound over cells, which are the whole program where nothing is cut."""
    bounds = []
    for signs in itertools.product((-1.0, 1.0), repeat=len(cut)):
        prog = program(steps)
        angle = prog.decision_variables()[steps + 2 : 2 * steps + 4]
        for k, sign in zip(cut, signs, strict=True):
            prog.AddConstraint(sign * cos(angle[k]) >= 0.0)
        bounds.append(squares(prog))
    return float(np.min(bounds))


if __name__ == "__main__":
    main()
