"""Local solvers that other people wrote, on the literal transcription."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from pydrake.solvers import IpoptSolver, SnoptSolver

from drake_aigto.arrays import Floats
from drake_aigto.local import PolynomialNlp
from drake_aigto.paper import LiteralTranscription
from drake_aigto.terms import Factor, TermBlock

casadi: Any
try:
    casadi = importlib.import_module("casadi")
except ModuleNotFoundError:
    casadi = None

Solver = Callable[[Floats], Floats]  # of a start

_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.max_iter": 300,
    "ipopt.tol": 1e-6,
}
# IPOPT's options where a program is solved first, and again with its relaxation tightened.
COLD = {**_OPTIONS, "ipopt.mu_strategy": "adaptive"}
WARM = {
    **_OPTIONS,
    "ipopt.warm_start_init_point": "yes",
    "ipopt.warm_start_bound_push": 1e-6,
    "ipopt.warm_start_mult_bound_push": 1e-6,
    "ipopt.mu_init": 1e-4,
}


def prepare() -> None:
    """Has CasADi take NumPy's sin and cos of its symbols, which new versions ask for."""
    if hasattr(casadi.GlobalOptions, "setNumpyMode"):
        casadi.GlobalOptions.setNumpyMode(1)


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


def casadi_ipopt(nlp: PolynomialNlp) -> Solver:
    """IPOPT on the same polynomials, with exact derivatives in CasADi's virtual machine."""
    x = casadi.SX.sym("x", nlp.num_variables)
    sums = sum_blocks(nlp.blocks, lambda f, i: (f.scale * x[i] + f.offset) ** f.exponent)
    problem = {"x": x, "f": sum(sums[: nlp.num_costs]), "g": casadi.vertcat(*sums[nlp.num_costs :])}
    quiet = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
    compiled = casadi.nlpsol("ipopt", "ipopt", problem, quiet)

    def solve(start: Floats) -> Floats:
        found = compiled(x0=start, lbx=nlp.lower, ubx=nlp.upper, lbg=0, ubg=0)
        return np.asarray(found["x"]).ravel()

    return solve


def drake_solver(transcription: LiteralTranscription, name: str) -> Solver:
    """IPOPT or SNOPT, "ipopt" or "snopt", through Drake, by its own defaults."""
    solver = {"ipopt": IpoptSolver, "snopt": SnoptSolver}[name]()
    return lambda start: solver.Solve(transcription.prog(), start, None).get_x_val()
