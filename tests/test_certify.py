"""Lower bounds: below every value, near the least one, and above nothing that exact numbers say."""

from __future__ import annotations

import itertools
import math
import re
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pydrake.symbolic as sym
import pytest
from pydrake.solvers import ExpressionConstraint, MathematicalProgram
from random_functions import FUNCTIONS, add_cost, box, program

from benchmarks.collections.constrained_programs import concave_programs, planted_program
from benchmarks.random_programs import random_program
from drake_aigto.certify import Method, certify, explain_infeasibility, is_infeasible
from drake_aigto.errors import OptionsError, UnsupportedTermError
from drake_aigto.solver import AigoOptions, AigoSolver, AigoStatus

CERTIFY = AigoOptions(certify=True)


def chain(roots: np.ndarray, links: np.ndarray) -> MathematicalProgram:
    prog, x = box(len(roots))
    for i, own in enumerate(roots):
        well = sym.Expression(1.0)
        for root in own:
            well *= x[i] - root
        add_cost(prog, well + (links[i] * x[i] * x[i + 1] if i + 1 < len(roots) else 0.0))
    return prog


@pytest.mark.parametrize("function", FUNCTIONS)
def test_a_bound_is_at_the_least_of_a_dense_grid(function: Callable[..., Any]) -> None:
    prog, x = program(function, 2)
    found = certify(prog)
    grid = np.linspace(-2.0, 2.0, 81)
    cost = sum(binding.evaluator().expression() for binding in prog.GetAllCosts())
    values = [cost.Evaluate(dict(zip(x, (a, b), strict=True))) for a in grid for b in grid]
    assert found.method == Method.CELLS
    assert found.gap <= 1e-6
    assert found.lower_bound <= min(values)
    assert found.lower_bound >= min(values) - 0.05  # what the grid misses


def test_a_chain_is_proven() -> None:
    rng = np.random.default_rng(3)
    centers = np.linspace(-1.8, 1.8, 4)
    prog = chain(centers + rng.uniform(-0.3, 0.3, (40, 4)), rng.uniform(-0.3, 0.3, 40))
    result = AigoSolver(CERTIFY).Solve(prog)
    details = result.get_solver_details()
    assert details.certificate.method == Method.CLIQUES
    assert details.certificate.cells < 200  # of bins that slopes leave, which are one in two
    assert details.status == AigoStatus.PROVEN
    assert details.gap <= 1e-6
    assert result.get_optimal_cost() <= AigoSolver().Solve(prog).get_optimal_cost() + 1e-9


def test_prices_of_rows_prove_a_chain_once_its_best_point_is_found() -> None:
    problem = planted_program(20, seed=0)
    details = AigoSolver(CERTIFY).Solve(problem.prog()).get_solver_details()
    assert details.status == AigoStatus.PROVEN
    assert details.certificate.method == Method.CLIQUES
    assert details.lower_bound <= problem.minimum + 1e-9


@pytest.mark.slow
def test_rows_of_all_variables_leave_the_bound_that_a_chain_has_without_them() -> None:
    size = 12
    prog, x = box(size)
    for i, own in enumerate(x):
        slope = 0.3 + 0.05 * i / size
        add_cost(prog, own**4 - 2.0 * own**2 + slope * own + sym.cos(5.0 * own))
        if i:
            add_cost(prog, 0.3 * own * x[i - 1])
    without_rows = AigoSolver(CERTIFY).Solve(prog).get_solver_details().lower_bound
    prog.AddConstraint(sum(x) == 1.0)
    prog.AddConstraint(sum(own**2 for own in x) <= 1.2 * size)
    options = AigoOptions(certify=True, cells=3000, rounds=2, starts=2)
    details = AigoSolver(options).Solve(prog).get_solver_details()
    assert details.certificate.method == Method.CLIQUES
    assert details.gap < 0.1  # 1.0 by cells alone
    assert without_rows - 1e-6 * abs(without_rows) <= details.lower_bound <= details.cost


def on_a_circle() -> tuple[MathematicalProgram, float]:
    prog, (x, y) = program(lambda x, y: x**2 * y - x, 2)
    prog.AddConstraint(x**2 + y**2 == 1.0)
    prog.AddConstraint(x * y >= -0.4)
    angles = np.linspace(0.0, 2.0 * np.pi, 100_001)
    a, b = np.cos(angles), np.sin(angles)
    return prog, float(np.min((a**2 * b - a)[a * b >= -0.4]))


def hs29() -> tuple[MathematicalProgram, float]:
    """f is bent along the bound at each of four optima, where the multiplier is 1/√2."""
    prog, (x, y, z) = program(lambda x, y, z: -10.0 * x * y * z, 3)
    prog.AddConstraint(x**2 + 2.0 * y**2 + 4.0 * z**2 <= 6.0)
    return prog, -10.0  # at x = √2, y = 1, z = 1/√2


def hs66() -> tuple[MathematicalProgram, float]:
    """Only rows vary along y."""
    prog = MathematicalProgram()
    x, y, z = prog.NewContinuousVariables(3, "x")
    prog.AddBoundingBoxConstraint(0.0, 10.0, [x, y, z])
    prog.AddCost(0.2 * z - 0.8 * x)
    prog.AddConstraint(y - sym.exp(x) >= 0.0)
    prog.AddConstraint(z - sym.exp(y) >= 0.0)
    return prog, 0.5181632742  # rounded up


@pytest.mark.parametrize(("make", "below"), [(on_a_circle, 1e-5), (hs29, 1e-4), (hs66, 1e-6)])
def test_a_constrained_optimum_is_proven(make: Callable[[], Any], below: float) -> None:
    prog, least = make()
    details = AigoSolver(CERTIFY).Solve(prog).get_solver_details()
    assert details.status == AigoStatus.PROVEN
    assert details.certificate.cells < 10_000
    assert least - below <= details.lower_bound <= least


@pytest.mark.slow
def test_more_cells_are_spent_without_being_asked_for_as_long_as_they_soon_prove_it() -> None:
    prog, least = hs29()
    details = AigoSolver().Solve(prog).get_solver_details()
    assert details.status == AigoStatus.PROVEN
    assert details.boxes == 0
    assert 400 < details.certificate.cells < 2000
    assert details.cost == pytest.approx(least, abs=1e-5)
    options = AigoOptions(rounds=2, starts=2)
    prog = planted_program(10, seed=0).prog()
    details = AigoSolver(options).Solve(prog).get_solver_details()
    assert details.status == AigoStatus.SOLVED
    assert details.certificate.cells < 1300


def test_what_rounding_may_leave_is_not_called_infeasible() -> None:
    """A row that holds at x = 0.3 alone, as 3 · 0.1 is rounded, and one that holds nowhere."""
    prog, (x,) = program(lambda x: x, 1)
    prog.AddConstraint((x - 0.1) ** 2 <= (0.3 - 0.1) ** 2)
    prog.AddConstraint((x - 0.5) ** 2 <= (0.3 - 0.5) ** 2)
    assert not is_infeasible(prog)
    prog.AddConstraint(sym.exp(x) >= 1.36)
    assert is_infeasible(prog)


def test_a_fixed_point_that_meets_a_row_only_nearly_is_an_answer_without_a_proof() -> None:
    prog, x = box(2, 2.0, 2.0)
    add_cost(prog, x[0] ** 2)
    prog.AddConstraint(x[0] * x[1] == 4.0000005)
    result = AigoSolver(CERTIFY).Solve(prog)
    details = result.get_solver_details()
    assert result.GetSolution().tolist() == [2.0, 2.0]
    assert details.status == AigoStatus.SOLVED
    assert details.violation == pytest.approx(5e-7, rel=1e-3)
    assert details.certificate.is_infeasible  # No point meets the row, but for a tolerance.
    assert "no point meets all rows exactly: this one is off by 5.0e-07" in str(details)


def test_a_variable_that_a_row_fixes_does_not_end_the_search() -> None:
    prog, x = program(lambda x, y, z: (x - y) ** 2 + sym.sin(3.0 * y) + y * z**2, 3)
    prog.AddConstraint(x[0] == 1.0 / 3.0)
    details = AigoSolver(CERTIFY).Solve(prog).get_solver_details()
    assert details.status == AigoStatus.PROVEN
    assert details.certificate.cells < 1000


def test_what_a_row_narrows_is_narrow_wherever_it_is_read() -> None:
    prog, (x, y) = program(lambda x, y: -((1.0 + x**3 + y**3) ** 2), 2)
    prog.AddConstraint(1.0 + x**3 + y**3 == 0.0)
    assert -1e-9 <= certify(prog, cells=1).lower_bound <= 0.0


def test_a_concave_program_of_many_coupled_variables_is_proven() -> None:
    problem = next(each for each in concave_programs() if each.num_variables == 13)
    found = certify(problem.prog(), problem.minimizers[0])
    assert found.gap <= 1e-6
    assert found.lower_bound <= problem.minimum


def test_that_coupled_rows_contradict_each_other_is_proven() -> None:
    """Σ_{i<j} x_i x_j ≥ −½ Σ x_i² is −2.5 at least where |x| ≤ 1."""
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(5, "x")
    prog.AddBoundingBoxConstraint(-1.0, 1.0, x)
    pairs = sum(a * b for a, b in itertools.combinations(x, 2))
    prog.AddCost(pairs)
    prog.AddConstraint(pairs <= -1.9)
    assert not certify(prog, cells=500).is_infeasible
    prog.AddConstraint(pairs <= -2.6)
    assert certify(prog).is_infeasible


@pytest.mark.parametrize(
    ("make", "feasible"), [(on_a_circle, [1.0, 0.0]), (hs66, [0.0, 1.0, 2.72])]
)
def test_a_proof_finds_the_points_that_end_it(
    make: Callable[[], Any], feasible: list[float]
) -> None:
    prog, least = make()
    for point in (None, feasible):
        found = certify(prog, point)
        assert found.gap <= 1e-6
        assert found.cells < 2000
        assert least - 1e-5 <= found.lower_bound <= least
        assert prog.CheckSatisfied(prog.GetAllConstraints(), found.best, 1.001e-6)


def test_an_answer_that_a_known_bound_proves_ends_the_search() -> None:
    """A sum of squares is 0 at least: no cells are spent on it until a point is found."""
    prog, x = box(4, -5.0, 5.0)
    rng = np.random.default_rng(0)
    roots = rng.uniform(-4.0, 4.0, 4)
    for k in range(1, 5):
        add_cost(
            prog,
            sum(a * (own**k - r**k) for a, own, r in zip(rng.normal(size=4), x, roots, strict=True))
            ** 2,
        )
    details = AigoSolver(CERTIFY).Solve(prog).get_solver_details()
    assert details.status == AigoStatus.PROVEN
    assert details.certificate.cells < 20_000


def test_a_program_of_many_variables_is_bounded_at_once() -> None:
    seconds = list[float]()
    for size in (12, 12, 60):  # The first one compiles.
        prog, x = box(size, -1.0, 2.0)
        for i, own in enumerate(x):
            others = sum((other * (1.0 + other) for other in x[max(0, i - 5) : i]), 0.0)
            add_cost(prog, (own * (2.0 + 5.0 * own**2) + 1.0 - others) ** 2)
        start = time.process_time()
        assert certify(prog, cells=1).lower_bound == 0.0
        seconds.append(time.process_time() - start)
    assert seconds[2] < 25 * seconds[1]  # It may grow as the square of the size.


def test_what_may_be_better_is_told_when_cells_are_used_up() -> None:
    found = certify(long_proof(), np.zeros(7), cells=300)
    assert found.reason == (
        f"the cells allowed were used up; those with bounds from {found.lower_bound:.6g} on may "
        f"hold a point that is better than the one of cost {found.best_cost:.6g}"
    )
    assert found.lower_bound < found.best_cost - 1e-6


def long_proof() -> MathematicalProgram:
    """Returns a program of many cells: all of seven waves are coupled."""
    prog, x = box(7, -1.0, 2.0)
    add_cost(prog, sum(sym.sin(5.0 * a * b + a) for a, b in itertools.combinations(x, 2)))
    return prog


@pytest.mark.slow
def test_seconds_end_a_proof_and_progress_is_told() -> None:
    lines: list[str] = []
    start = time.monotonic()
    found = certify(long_proof(), seconds=2.2, progress=lines.append)
    assert time.monotonic() - start < 10.0
    assert "depends on the clock" in found.reason
    assert math.isfinite(found.lower_bound)
    assert lines[0].startswith("bound ")


@pytest.mark.slow
def test_an_interruption_keeps_the_bound_so_far() -> None:
    prog = long_proof()
    known = certify(prog, cells=100).lower_bound

    def interrupt(_: str) -> None:
        raise KeyboardInterrupt

    found = certify(prog, progress=interrupt)
    assert found.reason == "interrupted: this is the bound so far"
    assert known <= found.lower_bound < math.inf
    prog.AddVisualizationCallback(interrupt, prog.decision_variables())
    details = AigoSolver(CERTIFY).Solve(prog).get_solver_details()
    assert details.status == AigoStatus.INTERRUPTED
    assert details.certificate.reason == found.reason


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"seconds": 0.0}, "seconds: got 0.0, expected a number above 0"),
        ({"seconds": math.nan}, "seconds: got nan, expected a number above 0"),
        ({"cells": 0}, "cells: got 0, expected a number above 0"),
        ({"point": [0, 0, 0]}, "point: got [0.0, 0.0, 0.0], expected shape (1,), no NaN"),
        ({"point": np.array([math.nan])}, "point: got [nan], expected shape (1,), no NaN"),
        ({"prover": "gurobi"}, "prover: got 'gurobi', expected one of own, scip"),
    ],
)
def test_bad_arguments_are_refused(wrong: dict[str, Any], message: str) -> None:
    prog, _ = program(lambda x: x, 1)
    with pytest.raises(OptionsError, match=re.escape(message)):
        certify(prog, **wrong)


def test_what_has_no_bound_is_refused_by_name() -> None:
    prog, _ = program(lambda x: sym.sinh(x), 1)
    with pytest.raises(UnsupportedTermError, match="got Sinh in sinh"):
        certify(prog)
    prog, _ = program(lambda x: sym.if_then_else(x > 0.0, x, -x), 1)
    with pytest.raises(UnsupportedTermError, match="got IfThenElse in"):
        certify(prog)
    assert not is_infeasible(prog)
    # What Drake folds to an infinite number has no sign that its reciprocal tells.
    for scale in (-math.inf, math.inf):
        prog, (x,) = box(1, -1.0, 1.0)
        row = ExpressionConstraint([sym.exp(x) / scale + x], [0.0], [math.inf])
        prog.AddConstraint(row, vars=row.vars())
        assert not is_infeasible(prog)
        with pytest.raises(UnsupportedTermError, match=r"got the number -?inf in"):
            certify(prog)
    prog, x = program(lambda x: x, 1)
    prog.AddCost(lambda z: z[0] ** 2, vars=x)
    with pytest.raises(UnsupportedTermError, match="PyFunctionCost, whose formula Drake does not"):
        certify(prog)
    prog, x = program(lambda x: x, 1)
    prog.NewBinaryVariables(1, "flag")
    with pytest.raises(UnsupportedTermError, match=re.escape("flag(0) can't be solved for")):
        certify(prog)
    prog, x = program(lambda x: x, 1)
    (bounds,) = prog.bounding_box_constraints()
    bounds.evaluator().UpdateLowerBound(np.array([math.nan]))
    with pytest.raises(UnsupportedTermError, match=re.escape("got the bounds [nan, 2]")):
        certify(prog)


def test_drake_rewrites_a_root_of_a_square_as_the_documentation_says() -> None:
    prog, (x,) = program(lambda x: sym.pow(sym.pow(x, 2), 0.5), 1)
    (cost,) = prog.GetAllCosts()
    assert cost.evaluator().expression().Evaluate({x: -2.0}) == -2.0
    assert "`pow(pow(x, 2), 0.5)`" in (certify.__doc__ or "")
    assert certify(prog).lower_bound == pytest.approx(-2.0, abs=1e-6)


def test_scip_proves_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    prog, least = on_a_circle()
    pytest.importorskip("pyscipopt")
    found = certify(prog, prover="scip")
    assert found.method == Method.SCIP
    assert found.best_cost == pytest.approx(least, abs=1e-5)
    assert found.lower_bound == pytest.approx(least, abs=1e-5)
    monkeypatch.setitem(sys.modules, "pyscipopt", None)
    with pytest.raises(OptionsError, match=re.escape("pip install 'drake_aigto[scip]'")):
        certify(prog, prover="scip")


def test_programs_without_variables_or_costs_are_bounded_too() -> None:
    prog = MathematicalProgram()
    for own, least in ((prog, 0.0), (box(1)[0], 0.0)):
        for total in (least, least + 3.0):
            found = certify(own)
            assert found.lower_bound == pytest.approx(total, abs=1e-9)
            assert found.gap <= 1e-6 and not found.reason
            details = AigoSolver(CERTIFY).Solve(own).get_solver_details()
            assert details.status == AigoStatus.PROVEN
            own.AddCost(sym.Expression(3.0))


def test_few_rows_that_contradict_each_other_are_told_with_numbers() -> None:
    prog, (x, y, z) = program(lambda x, y, z: x + y + z, 3)
    prog.AddConstraint(x * y + z <= 5.0)
    prog.AddConstraint(x >= 1.0 + 0.1 * y)
    wrong = [prog.AddConstraint(x**2 + y**2 <= 1.0), prog.AddConstraint(x + 0.5 * y >= 1.7)]
    prog.AddConstraint(sym.exp(z) >= 0.2)
    wrong[0].evaluator().set_description("disc")
    wrong[1].evaluator().set_description("beyond")
    text = explain_infeasibility(prog)
    assert len(text.splitlines()) == 2
    assert "'disc'" in text and "'beyond'" in text
    assert "has to be in [-inf, -1.7], and is in [-1.5, 1.5] where the others hold" in text
    details = AigoSolver(AigoOptions(rounds=2, starts=2)).Solve(prog).get_solver_details()
    assert details.status == AigoStatus.INFEASIBLE
    assert text in str(details)
    prog.RemoveConstraint(wrong[1])
    assert not explain_infeasibility(prog)
    prog.AddConstraint(x >= 3.0)
    assert explain_infeasibility(prog) == "x(0) has to be at least 3, and at most 2"
    details = AigoSolver().Solve(prog).get_solver_details()
    assert details.status == AigoStatus.CONTRADICTORY_BOUNDS
    assert explain_infeasibility(prog) in str(details)


@pytest.mark.slow
def test_rows_that_cells_alone_prove_to_contradict_each_other_are_told_with_numbers() -> None:
    """Where Σ x_i ≥ 2.5, Σ x_i² ≥ 1.25; ranges of either row say nothing of the other."""
    prog, x = program(lambda *x: (x[0] - 0.3) ** 2, 5)
    prog.AddConstraint(x[0] * x[2] <= 3.0)
    wrong = [prog.AddConstraint(sum(x) >= 2.5), prog.AddConstraint(sum(a * a for a in x) <= 1.2)]
    for row, name in zip(wrong, ("sum", "ball"), strict=True):
        row.evaluator().set_description(name)
    prog.AddConstraint(sym.exp(x[1]) <= 2.6)
    assert not is_infeasible(prog)
    assert is_infeasible(prog, cells=100)
    text = explain_infeasibility(prog, cells=1000)
    assert len(text.splitlines()) == 2
    assert re.search(r"'ball'.* has to be in \[-inf, 1.2\], and is in \[1.2[45]\d*, 20\]", text)
    assert re.search(r"'sum'.* has to be in \[-inf, -2.5\], and is in \[-2.4[45]\d*, ", text)
    details = AigoSolver().Solve(prog).get_solver_details()
    assert details.status == AigoStatus.INFEASIBLE
    assert "'ball'" in str(details) and "'sum'" in str(details)
    prog.RemoveConstraint(wrong[0])
    assert not is_infeasible(prog, cells=100)
    assert not explain_infeasibility(prog, cells=100)


SMALL, TINY = -8.437660688527946e-86, -3.8056667485585995e-75


@pytest.mark.slow
def test_a_bound_that_is_missing_is_derived_or_named() -> None:
    prog = MathematicalProgram()
    (x,) = prog.NewContinuousVariables(1, "speed")
    add_cost(prog, x**4 - 3.0 * x**2 + x)
    assert certify(prog).gap <= 1e-6
    add_cost(prog, -(x**6))
    found = certify(prog, cells=200)
    assert found.lower_bound == -math.inf
    assert "speed(0) has no lower bound" in found.reason
    prog, x = program(lambda x: -(x**2) + 7.0, 1)
    prog.AddLinearCost([0.0], 1.0, x)
    assert certify(prog).lower_bound == pytest.approx(4.0, abs=1e-6)
    options = AigoOptions(certify=True, cells=2000, rounds=4, seed=3)
    result = AigoSolver(options).Solve(random_program(np.random.default_rng([0, 120])))
    assert result.get_solver_details().lower_bound == -math.inf
    # Its cells go so far out that powers overflow.
    result = AigoSolver(options).Solve(random_program(np.random.default_rng([11, 34])))
    assert result.get_solver_details().lower_bound <= result.get_optimal_cost() + 1e-6


@pytest.mark.parametrize(
    ("cost", "row", "reason"),
    [
        (lambda x, y: x**3 + y**2, None, "x(0) has no lower bound"),
        (lambda x, y: x**4 - x * y, None, "x(0) has no lower bound, x(1) has no lower bound"),
        (lambda x, y: x**3 + y**2, (1.0, 1.0), "x(0) has no lower bound, x(1) has no upper bound"),
        (lambda x, y: y**2 - sym.log(x), None, "x(0) has no upper bound"),
    ],
)
def test_a_bound_that_no_cell_gives_far_out_is_named_before_a_search(
    cost: Callable[..., Any], row: Any, reason: str
) -> None:
    prog, (x, y) = box(2, -np.inf, np.inf)
    add_cost(prog, cost(x, y))
    if row:
        prog.AddLinearConstraint([row], [-3.0], [np.inf], [x, y])
    found = certify(prog)
    assert found.lower_bound == -math.inf
    assert found.reason == reason
    assert found.cells < 100  # 400,000, in minutes


def linked(own: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *x: sum(map(own, x)) + sum(a * b for a, b in itertools.pairwise(x))


def partial_power(x: Any, y: Any) -> Any:
    """Has no value in a part of cells, where slopes prove nothing; least at x = .1 and y = 2."""
    return sym.pow(x - 0.1, 1.5) + 0.3 * x + 0.2 * y**2 - sym.pow(y, 2.5)


@pytest.mark.parametrize(
    ("cost", "row", "lower", "upper", "least"),
    [
        (lambda x: x**2, None, 2.0, 2.0, 4.0),  # fixed
        (lambda x: x + 1e-300 * x**2, None, 3.0, 3.0, 3.0),
        (linked(lambda x: x * sym.log(x)), None, [1e-9] * 5, 1.0, math.inf),
        (
            linked(lambda x: 1.0 / (2.0 + sym.sin(x) + sym.cos(x)) - 0.01 * x),
            None,
            [-50.0] * 5,
            50.0,
            0.0,
        ),
        (linked(lambda x: sym.exp(2.0 * x) - sym.exp(x) + x**2), None, [-800.0] * 5, 800.0, 0.0),
        (linked(lambda x: x**30), None, [-1e12] * 5, 1e12, 0.0),
        (lambda x, y: x + sym.pow(x + y, 1.5), None, [-1.0, -1.0], [1.0, 0.5], -0.5),
        (lambda x, y: 3.0 * x + sym.pow(x + y / 3.0, 2.5), None, [-1.0, -1.0], [1.0, 0.7], -0.7),
        (partial_power, None, [-3.0, -1.0], 2.0, 0.83 - 2.0**2.5),
        (partial_power, None, [-0.7, -4.0], 2.0, 0.83 - 2.0**2.5),
        (lambda x, y: 1e-250 * x**2 * y**2, None, [1e80, 1e80], 1e81, 1e70),
        (lambda x: (1e-162 * (x - 0.5)) ** 2, None, -1.0, 1.0, 0.0),
        (lambda x: 1e-300 * sym.exp(800.0 * x), None, 0.5, 1.0, 1e-126),
        # Rows that overflow, of numbers that do, and whose products underflow:
        (
            lambda x, y: x,
            (lambda x, y: 1e-250 * x**2 * y**2, -math.inf, 1e71),
            [1e80, 1e80],
            1e81,
            1e80,
        ),
        (
            lambda x: x,
            (lambda x: 1e200 * (1e200 * x - 1e200) - 1e300, -math.inf, 0.0),
            0.5,
            2.0,
            0.5,
        ),
        (
            lambda x, y, z: x,
            (
                lambda x, y, z: -7.8e22 * x * y**2 - 4.6e-73 * y**2 * z**3,
                -7.8e22 * 1.74e-08 * SMALL**2 * (1 + 1e-13),
                -7.8e22 * 1.74e-08 * SMALL**2 * (1 - 1e-13),
            ),
            [1.7388e-08, SMALL, TINY],
            [1.7406e-08, 8.4e-83, TINY],
            1.74e-08,
        ),
        # 0 log 0 = 0, and so are its multiples.
        (lambda x: x, (lambda x: 0.5 * x * sym.log(0.5 * x), -1e-15, 1e-15), -5.0, 0.0, 0.0),
        # A root that is 0 at an end: its slope there has no value.
        (lambda x: x, (lambda x: sym.sqrt(sym.abs(sym.cos(x))), 0.5, 0.9), 0.0, 3.0, 0.63),
        # Poles within cells, across which slopes say nothing.
        (lambda x, y, z: sym.pow(1.0 / x, 0.3) + y + z, None, [-math.inf, 0, 0], 4.0, 0.66),
        (lambda x: x, (lambda x: sym.exp(x) / x, -math.inf, -1e30), -1e-12, 0.03, -9e-31),
        # A power above the number of operations.
        (lambda x: x, (lambda x: sym.sqrt(0.5 + x**18), -np.inf, 2.5), -16.0, 1.1, -1.0),
    ],
)
def test_edges_of_numbers_and_of_domains_bring_no_false_claim(
    cost: Callable[..., Any], row: Any, lower: Any, upper: Any, least: float
) -> None:
    """Programs with a feasible point that costs no more than the least that is given."""
    prog, x = box(np.size(lower), lower, upper)
    add_cost(prog, cost(*x))
    if row:
        formula, low, high = row
        constraint = ExpressionConstraint([formula(*x)], [low], [high])
        prog.AddConstraint(constraint, vars=constraint.vars())
    assert not is_infeasible(prog)
    for cells in (1, 10, 300):
        found = certify(prog, cells=cells)
        assert not found.is_infeasible
        assert found.lower_bound <= least + 1e-9 * abs(least)


@pytest.mark.parametrize("size", [1, 5])
@pytest.mark.parametrize(("sign", "least"), [(1.0, -math.exp(-1.0)), (-1.0, 0.0)])
def test_x_log_x_is_0_at_0(size: int, sign: float, least: float) -> None:
    prog, x = box(size, 0.0, 1.0)
    for own in x:
        add_cost(prog, sign * own * sym.log(own))
    found = certify(prog)
    assert found.gap <= 1e-6
    assert size * least - 1e-5 <= found.lower_bound <= size * least + 1e-15


def test_numbers_that_overflow_bring_no_warning() -> None:
    prog, (x,) = box(1, -np.inf, 2e60)
    add_cost(prog, 1e150 * sym.sqrt(sym.abs(x**3)))
    details = AigoSolver(AigoOptions(certify=True, rounds=2)).Solve(prog).get_solver_details()
    assert details.lower_bound == 0.0
    assert 0.0 <= details.cost < np.inf
    # Sides of cells do, too.
    prog, (x,) = box(1, -1.5e308, 1.5e308)
    add_cost(prog, sym.atan(x) ** 2)
    assert certify(prog, cells=100).lower_bound == 0.0
