"""AIGO on programs of contact that other systems were made for, beside IPOPT from their own start.

    python -m benchmarks.peer_programs [--only payload] [--every 3] [--seeds 1] [--workers 1]
        [--minutes 60]

IPOPT runs through CasADi on the same rows, with exact Hessians and complementarities λ s ≤ ε that
are relaxed and tightened, once from the start that the program's authors give (ours has none), and
once from our answer on the smallest ε alone, which is how that is checked a second time: it is to
stay feasible, and to cost what it did. Violations are of the program as it was given. Best known is
the least of all feasible answers, those of ours from other seeds and a published one among them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from benchmarks.collections.peer_programs import KNOWN, peer_problems
from benchmarks.script import machine, read_flags, run_all, run_as
from benchmarks.staged_programs import FEASIBLE, GLOBAL, Ipopt, cost_of, run_ours, warm_up
from drake_aigto.arrays import Floats
from drake_aigto.solver import AigoSolver, StagedProgram, read_program


@dataclass(frozen=True)
class Answer:
    """What a method found.

    Attributes:
        cost: of it; inf if it is not feasible.
        violation: of the program as it was given.
        seconds: of the processor.
    """

    cost: float
    violation: float
    seconds: float

    def is_within(self, cost: float) -> bool:
        """Whether it costs no more than this and 1 %."""
        return bool(self.cost <= cost + GLOBAL * abs(cost))

    def __str__(self) -> str:
        """Returns a table's columns."""
        return f"{self.cost:11.5g} {self.violation:8.0e} {self.seconds:7.2f}"


class Run(NamedTuple):
    """What came of one program.

    Attributes:
        problem: its name.
        ours: without a start.
        checked: of IPOPT from our answer.
        peer: of IPOPT from its authors' start.
        known: the least of all answers.
    """

    problem: str
    ours: Answer
    checked: Answer
    peer: Answer
    known: float


def main() -> None:
    """Runs all programs, and prints a table and shares."""
    arguments = read_flags(
        __doc__,
        only=("", "programs whose name has this in it"),
        every=(1, "of the programs, the first of so many"),
        seeds=(1, "of ours, for the best known"),
    )
    print(machine())
    columns = "cost        violation seconds"
    print(
        f"{'':20} ours: {columns:25}   IPOPT from our answer        IPOPT from its authors' start"
    )
    names = [each.name for each in peer_problems() if arguments.only in each.name]
    names = names[:: arguments.every]
    runs = run_all(partial(run, num_seeds=arguments.seeds), names, arguments)
    for family in dict.fromkeys(each.problem.rpartition("/")[0] for each in runs):
        summarise(family, [each for each in runs if each.problem.startswith(f"{family}/")])
    summarise("all", runs)


def summarise(family: str, runs: list[Run]) -> None:
    """Prints how often ours is as good as the peer, or better, and seconds."""
    ours, peer = ([getattr(each, name).seconds for each in runs] for name in ("ours", "peer"))
    costs = [(each.ours.cost, each.peer.cost) for each in runs]
    confirmed = (abs(r.checked.cost - r.ours.cost) <= GLOBAL * abs(r.ours.cost) for r in runs)
    print(
        f"{family}: {len(runs)} programs; ours no worse than IPOPT by 1 % in "
        f"{sum(each.ours.is_within(each.peer.cost) for each in runs)}, better in "
        f"{sum(own < other - GLOBAL * abs(other) for own, other in costs)}; within 1 % of the best "
        f"known {sum(each.ours.is_within(each.known) for each in runs)}, IPOPT "
        f"{sum(each.peer.is_within(each.known) for each in runs)};\n"
        f"  confirmed {sum(confirmed)}; "
        f"median {np.median(ours):.1f} s, {max(ours):.1f} s at most, "
        f"IPOPT {np.median(peer):.1f} s, {max(peer):.1f} s"
    )


def run(name: str, *, num_seeds: int) -> Run:
    """Runs ours, IPOPT twice, and ours from other seeds."""
    warm_up()
    (problem,) = (each for each in peer_problems() if each.name == name)
    if problem.guess is None:
        raise ValueError(f"{problem.name} has no start of its authors")
    program, start = read_program(problem.prog()), problem.guess()
    ipopt = Ipopt(StagedProgram(program, FEASIBLE))

    def answer(solve: Callable[[], Floats]) -> tuple[Answer, Floats]:
        """Returns what a call finds, and its x (n,)."""
        begin = time.process_time()
        x = solve()
        seconds = time.process_time() - begin
        return Answer(cost_of(program, x), program.violation(x), seconds), x

    prog = problem.prog()
    ours, x = answer(lambda: AigoSolver().Solve(prog).get_x_val())
    checked, peer = answer(lambda: ipopt.polish(x))[0], answer(lambda: ipopt.solve(start))[0]
    others = [run_ours(problem, seed)[0] for seed in range(1, num_seeds + 1)]
    known = min(ours.cost, checked.cost, peer.cost, *others, KNOWN.get(name, np.inf))
    mark = "*" if ours.is_within(known) else "-"
    print(f"{name:20} {mark} {ours}   {checked}   {peer}", flush=True)
    return Run(name, ours, checked, peer, known)


if __name__ == "__main__":
    run_as("benchmarks.peer_programs")
