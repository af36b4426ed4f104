"""One Newton iteration of the annealing against its own banded Cholesky, and against CasADi.

    python -m benchmarks.newton_speed [--steps 200] [--repeats 15] [--no-c]

On Table I's first problem at N = 200, in turns, seconds of one core:

- an iteration: an annealing from the ladder's first rung, divided by its Newton iterations, so
  that trials which failed, line searches and all else are counted;
- LAPACK's dpbtrf of a matrix of the same shape, and the copy of it that it works on;
- value, gradient and Hessian of the smoothed objective f̄(c, e^z) − μ Σ z alone, ours and by
  CasADi: exact and sparse, in its virtual machine; and as C that ``cc -O2`` compiled, one function
  for each kind of stage, called for all stages. (All stages as one function are 40,000 lines of C,
  which take minutes to compile.) To the favour of the C, what stages share is not added up.

Writes newton_speed.csv; exits with 1 if an iteration takes more than three factorizations.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import dataclasses
import math
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpbtrf

from benchmarks.local_peers import casadi, sum_blocks
from benchmarks.script import Spread, clock, is_met, read_flags, take_turns, write_csv
from drake_aigto.box import BoxPolynomial
from drake_aigto.planning import PlanOptions, ProgramTask, make_ball_task
from drake_aigto.terms import Factor, FunctionKind, TermBlock
from drake_aigto.world import Scenario, World

MOST_FACTORIZATIONS = 3.0
CALLS = 20  # of what takes less than a millisecond, in a turn
ITERATION, CHOLESKY = "iteration", "dpbtrf"
OURS, MACHINE, COMPILED = "Hessian", "Hessian, CasADi", "Hessian, CasADi's C"


@dataclass(frozen=True)
class Timing:
    """One turn: a line of the CSV file."""

    what: str
    turn: int
    seconds: float


def main() -> int:
    """Measures, prints, writes and judges."""
    arguments = read_flags(
        __doc__,
        workers=None,
        steps=(200, "N of the boxes"),
        repeats=(15, "turns"),
        no_c=(False, "compile no C, which takes a minute"),
        out=(Path(), "folder of the CSV"),
    )
    problem = make_boxes(arguments.steps)
    seconds = take_turns(make_works(problem, not arguments.no_c), arguments.repeats, CALLS)
    seconds[ITERATION] = time_iterations(problem, arguments.repeats)
    spreads = {what: Spread.of(each) for what, each in seconds.items()}
    for what, spread in spreads.items():
        ratio = spread.median / spreads[CHOLESKY].median
        print(f"{what:22}{spread.show(1e-6, 1):>24} µs   {ratio:6.2f} × dpbtrf")
    timings = [
        Timing(what, turn, each)
        for what, found in seconds.items()
        for turn, each in enumerate(found)
    ]
    write_csv(arguments.out / "newton_speed.csv", timings, f"one thread, N = {arguments.steps}")
    ratio = spreads[ITERATION].median / spreads[CHOLESKY].median
    return 0 if is_met("an iteration / its banded Cholesky", ratio, MOST_FACTORIZATIONS) else 1


def make_boxes(steps: int) -> ProgramTask:
    """Returns Table I's first problem, its boxes at so many time steps."""
    scenario = dataclasses.replace(Scenario.named("table1/1"), time_step=1.0 / steps)
    options = PlanOptions(aigo_steps=steps)
    return make_ball_task(World.from_scenario(scenario), scenario, options)


def time_iterations(problem: ProgramTask, repeats: int) -> list[float]:
    """Returns seconds a Newton iteration, of whole annealings."""
    rung = problem.ladder[0]
    problem.run_aigo(rung)  # Loads compiled code.
    found = []
    for _ in range(repeats):
        result, seconds = clock(lambda: problem.run_aigo(rung))
        found.append(seconds.cpu / result.num_inner_steps)
    return found


def make_works(problem: ProgramTask, with_c: bool) -> dict[str, Callable[[], Any]]:
    """Returns what takes turns."""
    f, box = problem.polynomial, problem.box
    free = box.free
    half_width = np.where(free, box.half_width, 0.1)  # Held or not, CasADi takes its logarithm.
    band = f.newton_system(box.center, half_width).band
    # A matrix of that shape which is positive definite for sure.
    band = np.asfortranarray(np.vstack([np.full_like(band[0], 1e3), band[1:] / np.abs(band).max()]))
    works: dict[str, Callable[[], Any]] = {
        CHOLESKY: lambda: dpbtrf(band, lower=1),
        OURS: lambda: f.newton_system(box.center, half_width),
    }
    if casadi is not None:
        y = np.concatenate([box.center, np.log(half_width)])
        works[MACHINE] = with_buffers(smoothed_derivatives(f), y)
        (value,), *_ = works[MACHINE]()[-1]
        ours = f.mean(box.center, half_width) - np.sum(y[f.num_variables :])
        assert math.isclose(value, ours, rel_tol=1e-9), "not the same objective"
        if with_c and shutil.which("cc"):
            works[COMPILED] = call_stages(f, box.center, np.log(half_width))
    return works


def smoothed_derivatives(f: BoxPolynomial) -> Any:
    """Returns CasADi's function y = (c, z) → value, gradient and Hessian of f̄(c, e^z) − μ Σ z."""
    n = f.num_variables
    y = casadi.SX.sym("y", 2 * n)
    value = sum(block.weight * sum(sum_means(block, y[:n], y[n:])) for block in f.blocks)
    return derive("smoothed", value - casadi.sum1(y[n:]), y)


def sum_means(block: TermBlock, c: Any, z: Any) -> list[Any]:
    """Returns the mean of each copy of a block."""
    return sum_blocks([block], lambda factor, i: calc_mean(factor, c[i], casadi.exp(z[i])))


def derive(name: str, value: Any, y: Any) -> Any:
    """Returns the function y → value, gradient, lower half of the Hessian."""
    hessian, gradient = casadi.hessian(value, y)
    return casadi.Function(name, [y], [value, gradient, casadi.tril(hessian)])


def call_stages(
    f: BoxPolynomial, center: NDArray[np.float64], log_width: NDArray[np.float64]
) -> Callable[[], Any]:
    """Returns a call of compiled functions, one for each block, for all copies of the block."""
    functions, inputs = [], []
    for number, block in enumerate(f.blocks):
        count, size = block.variables.shape
        y = casadi.SX.sym("y", 2 * size)
        stage = TermBlock(block.name, block.terms, np.arange(size)[np.newaxis])
        (mean,) = sum_means(stage, y[:size], y[size:])
        functions.append(derive(f"stage_{number}", block.weight * mean, y).map(count))
        copies = np.hstack([center[block.variables], log_width[block.variables]])
        inputs.append(np.ascontiguousarray(copies).ravel())
    compiled = compile_c(functions)
    calls = [with_buffers(*pair) for pair in zip(compiled, inputs, strict=True)]
    return lambda: [call() for call in calls]


def calc_mean(factor: Factor, center: Any, half_width: Any) -> Any:
    """Returns a factor's mean over c ± w, in CasADi's symbols."""
    c, w = factor.scale * center + factor.offset, abs(factor.scale) * half_width
    if factor.kind == FunctionKind.POWER:
        p = factor.exponent
        return sum(
            math.comb(p, 2 * j) / (2 * j + 1) * c ** (p - 2 * j) * w ** (2 * j)
            for j in range(p // 2 + 1)
        )
    assert factor.kind == FunctionKind.SQUARED_HINGE
    inside = casadi.if_else(c > -w, (w - c) ** 3 / (6 * w), c**2 + w**2 / 3)
    return casadi.if_else(c >= w, 0, inside)


def compile_c(functions: Sequence[Any]) -> list[Any]:
    """Returns the same functions as C, compiled by ``cc -O2``."""
    begin = time.perf_counter()
    generator = casadi.CodeGenerator("stages.c")
    for function in functions:
        generator.add(function)
    with tempfile.TemporaryDirectory() as folder:
        source, library = generator.generate(f"{folder}/"), f"{folder}/stages.so"
        command = ["cc", "-O2", "-fPIC", "-shared", "-o", library, source]
        subprocess.run(command, check=True)
        print(f"CasADi's C was compiled in {time.perf_counter() - begin:.1f} s", flush=True)
        return [casadi.external(function.name(), library) for function in functions]


def with_buffers(function: Any, y: NDArray[np.float64]) -> Callable[[], Any]:
    """Returns a call without conversions: CasADi reads and writes NumPy's memory."""
    buffer, evaluate = function.buffer()
    results = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
    buffer.set_arg(0, memoryview(y.data))
    for i, result in enumerate(results):
        buffer.set_res(i, memoryview(result.data))

    def call() -> Any:
        evaluate()
        return buffer, y, results  # All of these have to live as long as the call.

    return call


if __name__ == "__main__":
    sys.exit(main())
