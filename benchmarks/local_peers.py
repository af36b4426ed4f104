"""Local solvers that other people wrote, on the literal transcription."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from pydrake.solvers import IpoptSolver, SnoptSolver, SolverOptions

from drake_aigto.arrays import Floats
from drake_aigto.local import PolynomialNlp
from drake_aigto.paper import LiteralTranscription
from drake_aigto.terms import Factor, TermBlock

casadi: Any
try:
    casadi = importlib.import_module("casadi")
except ModuleNotFoundError:
    casadi = None

# Start, and whether it is near a solution → x, the solver's word, iterations (0 if not told).
Solver = Callable[[Floats, bool], tuple[Floats, bool, int]]

IPOPT_WARM = {"mu_init": 1e-6, "bound_push": 1e-9, "bound_frac": 1e-9}


def sum_blocks(blocks: Iterable[TermBlock], calc_factor: Callable[[Factor, int], Any]) -> list[Any]:
    """Returns each copy's sum of terms, in CasADi's symbols.

    Args:
        blocks: sums of products, and the variables of their copies.
        calc_factor: of a factor and its variable's number.
    """
    return [
        sum(
            term.coefficient * np.prod([calc_factor(f, int(row[f.variable])) for f in term.factors])
            for term in block.terms
        )
        for block in blocks
        for row in block.variables
    ]


def casadi_ipopt(nlp: PolynomialNlp, options: Mapping[str, Any] | None = None) -> Solver:
    """IPOPT on the same polynomials, with exact derivatives in CasADi's virtual machine.

    Args:
        nlp: the program.
        options: of IPOPT; its own defaults where nothing is said.
    """
    x = casadi.SX.sym("x", nlp.num_variables)
    sums = sum_blocks(nlp.blocks, lambda f, i: (f.scale * x[i] + f.offset) ** f.exponent)
    problem = {"x": x, "f": sum(sums[: nlp.num_costs]), "g": casadi.vertcat(*sums[nlp.num_costs :])}
    quiet = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}

    def compiled(options: Mapping[str, Any]) -> Any:
        named = {f"ipopt.{name}": value for name, value in options.items()}
        return casadi.nlpsol("ipopt", "ipopt", problem, {**quiet, **named})

    given = dict(options or {})
    cold, warm = compiled(given), compiled(given | IPOPT_WARM)

    def solve(start: Floats, is_near: bool) -> tuple[Floats, bool, int]:
        solver = warm if is_near else cold
        found = solver(x0=start, lbx=nlp.lower, ubx=nlp.upper, lbg=0, ubg=0)
        stats = solver.stats()
        return np.asarray(found["x"]).ravel(), stats["success"], stats["iter_count"]

    return solve


def drake_solver(
    transcription: LiteralTranscription,
    name: str,
    ipopt_options: Mapping[str, Any] | None = None,
    snopt_options: Mapping[str, Any] | None = None,
) -> Solver:
    """IPOPT or SNOPT through Drake, which does not tell the iterations.

    Args:
        transcription: its program.
        name: "ipopt" or "snopt".
        ipopt_options: its own defaults where nothing is said.
        snopt_options: likewise.
    """
    solver = {"ipopt": IpoptSolver, "snopt": SnoptSolver}[name]()
    options = SolverOptions()
    given, warm = dict(ipopt_options or {}), SolverOptions()
    for target, values in ((options, given), (warm, given | IPOPT_WARM)):
        for key, value in values.items():
            target.SetOption(IpoptSolver.id(), key, value)
        for key, value in (snopt_options or {}).items():
            target.SetOption(SnoptSolver.id(), key, value)

    def solve(start: Floats, is_near: bool) -> tuple[Floats, bool, int]:
        result = solver.Solve(transcription.prog(), start, warm if is_near else options)
        return result.get_x_val(), result.is_success(), 0

    return solve
