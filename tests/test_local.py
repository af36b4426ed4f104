"""The local solver: known optima, exact derivatives, the same optima as Drake's solvers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from box_programs import dense
from local_problems import INF, PROBLEMS, Problem
from pydrake.solvers import (
    BoundingBoxConstraint,
    IpoptSolver,
    MathematicalProgram,
    SnoptSolver,
    SolverOptions,
)
from pydrake.symbolic import log

from drake_aigto import Scenario, World
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.local import InteriorPoint, LocalStatus, NlpBuilder, PolynomialNlp, compile_nlp
from drake_aigto.paper import LiteralTranscription


def test_a_polynomial_program_away_from_the_origin_is_solved_exactly() -> None:
    # min Σ (x_i − a_i)² on the plane Σ x_i = s: x = a + (s − Σ a)/n, λ = −2 (s − Σ a)/n.
    a = np.array([107.0, -41.0, 63.0])
    problem = Problem(
        lambda x: sum((x[i] - a[i]) ** 2 for i in range(3)),
        lambda x: [sum(x) - 300],
        [0.0, 500.0, -200.0],
    )
    result = problem.solve()
    assert result.status is LocalStatus.CONVERGED
    np.testing.assert_allclose(result.x, a + 57.0, rtol=1e-14)
    np.testing.assert_allclose(result.multipliers, [-114.0], rtol=1e-12)


@pytest.mark.parametrize("name", PROBLEMS)
def test_known_optima_are_found_and_meet_the_optimality_conditions(name: str) -> None:
    problem = PROBLEMS[name]
    result = problem.solve()
    assert result.is_success, result.status
    # Complementarity of 1e-9 a bound, and costs printed to ten digits.
    assert result.cost == pytest.approx(problem.optimum, rel=1e-8, abs=1e-8)
    assert result.residual <= 1e-12
    assert len(result.history) <= 60
    x, nlp = result.x, compile_nlp(problem.program())
    gradient, jacobian = numeric_derivatives(nlp, x)
    force = (
        gradient
        + jacobian.T @ result.multipliers
        - result.lower_multipliers
        + result.upper_multipliers
    )
    largest = max(1.0, np.max(np.abs(gradient)))
    held = nlp.lower == nlp.upper
    np.testing.assert_allclose(force[~held], 0.0, atol=1e-6 * largest)
    for gap, z in (
        (x - nlp.lower, result.lower_multipliers),
        (nlp.upper - x, result.upper_multipliers),
    ):
        assert np.all(gap >= 0.0)
        assert np.all(z >= 0.0)
        assert np.all(z[np.isinf(gap)] == 0.0)
        bounded = np.isfinite(gap)
        np.testing.assert_allclose(z[bounded] * gap[bounded], 0.0, atol=1e-7)


def numeric_derivatives(nlp: PolynomialNlp, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    columns = []
    for i in range(x.size):
        h = np.zeros(x.size)
        h[i] = 1e-6 * max(1.0, abs(x[i]))
        (f1, c1), (f0, c0) = nlp.evaluate(x + h), nlp.evaluate(x - h)
        columns.append(np.append(c1 - c0, f1 - f0) / (2 * h[i]))
    table = np.array(columns).T
    return table[-1], table[:-1]


def literal(nonpenetration: bool, row: int = 1, time_step: float = 0.02) -> LiteralTranscription:
    scenario = replace(Scenario.named(f"table1/{row}"), time_step=time_step)
    return LiteralTranscription(World.from_scenario(scenario), scenario, nonpenetration)


def compiled(transcription: LiteralTranscription) -> PolynomialNlp:
    return compile_nlp(transcription.prog(), transcription.elimination_order())


@pytest.mark.parametrize(
    "name",
    [
        *("HS 40", "HS 71, two bounds active", "HS 78", "the contact problem"),
        *("a cosine row", "a power times an exponential", "an arm of two links"),
    ],
)
def test_derivatives_are_those_of_finite_differences(name: str) -> None:
    nlp = compiled(literal(True)) if name not in PROBLEMS else compile_nlp(PROBLEMS[name].program())
    rng = np.random.default_rng(0)
    x, multipliers = rng.uniform(0.5, 2.0, nlp.num_variables), rng.normal(size=nlp.num_rows)
    x = np.where(nlp.lower == nlp.upper, nlp.lower, x)
    structure = nlp.kkt_structure
    assert structure.rows.size == nlp.num_rows
    scales = np.ones(nlp.num_costs + nlp.num_rows)

    def lagrangian_gradient(y: np.ndarray) -> np.ndarray:
        gradient, band = structure.assemble(y, scales, multipliers)
        force = dense(band) @ structure.join(0.0, multipliers)
        return gradient + structure.split(force)[0]

    gradient, band = structure.assemble(x, scales, multipliers)
    matrix = dense(band)
    numeric_gradient, numeric_jacobian = numeric_derivatives(nlp, x)
    free, places = structure.free, structure.variable_places
    jacobian = matrix[np.ix_(structure.row_places, places)]
    np.testing.assert_allclose(gradient, numeric_gradient[free], rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(jacobian, numeric_jacobian[:, free], rtol=1e-6, atol=1e-7)
    assert np.all(matrix[np.ix_(structure.row_places, structure.row_places)] == 0.0)
    direction = np.zeros(x.size)
    direction[free] = rng.normal(size=free.size)
    h = 1e-6
    change = lagrangian_gradient(x + h * direction) - lagrangian_gradient(x - h * direction)
    hessian = matrix[np.ix_(places, places)]
    np.testing.assert_allclose(hessian @ direction[free], change / (2 * h), rtol=1e-6, atol=1e-6)


def test_rows_and_costs_are_those_of_the_program_in_any_order_of_elimination() -> None:
    transcription = literal(False)
    prog, nlp = transcription.prog(), compiled(transcription)
    x = np.random.default_rng(1).normal(size=prog.num_vars())
    cost, rows = nlp.evaluate(x)
    assert cost == pytest.approx(
        sum(prog.EvalBinding(binding, x)[0] for binding in prog.GetAllCosts()), rel=1e-13
    )
    bindings = [
        binding
        for binding in prog.GetAllConstraints()
        if not isinstance(binding.evaluator(), BoundingBoxConstraint)
    ]
    expected = [prog.EvalBinding(b, x)[0] - b.evaluator().upper_bound()[0] for b in bindings]
    np.testing.assert_allclose(np.sort(rows), np.sort(expected), atol=1e-14)
    names = [b.evaluator().get_description() for b in bindings]
    assert sorted(nlp.row_names) == sorted(names)
    start = transcription.initial_box()[0]
    costs = [
        InteriorPoint().solve(compile_nlp(transcription.prog(), order), start).cost
        for order in (None, transcription.elimination_order(), range(len(start))[::-1])
    ]
    assert costs == pytest.approx([costs[0]] * 3, rel=1e-7)


def test_stages_make_a_narrow_band_whatever_the_horizon() -> None:
    widths = {compiled(literal(True, time_step=dt)).kkt_structure.bandwidth for dt in (0.1, 0.01)}
    assert widths == {5}
    without_order = compile_nlp(literal(True).prog()).kkt_structure
    assert without_order.bandwidth <= 8


@pytest.mark.parametrize("nonpenetration", [False, True])
@pytest.mark.parametrize("row", [1, 4])
def test_drakes_solvers_find_nothing_better_nearby(row: int, nonpenetration: bool) -> None:
    transcription = literal(nonpenetration, row, time_step=0.05)
    center = transcription.initial_box()[0]
    result = InteriorPoint().solve(compiled(transcription), center)
    assert result.is_success
    assert result.residual <= 1e-12
    options = SolverOptions()
    options.SetOption(IpoptSolver.id(), "tol", 1e-9)
    options.SetOption(IpoptSolver.id(), "mu_init", 1e-9)
    options.SetOption(IpoptSolver.id(), "bound_push", 1e-9)
    options.SetOption(IpoptSolver.id(), "bound_frac", 1e-9)
    for solver in (SnoptSolver(), IpoptSolver()):
        peer = solver.Solve(transcription.prog(), result.x, options)
        assert peer.get_optimal_cost() == pytest.approx(result.cost, rel=1e-4, abs=1e-7)
        np.testing.assert_allclose(
            transcription.split(peer.get_x_val())[0], transcription.split(result.x)[0], atol=1e-3
        )


def test_random_starts_converge_within_bounds() -> None:
    transcription = literal(True, row=2)
    nlp = compiled(transcription)
    rng = np.random.default_rng(3)
    starts = rng.normal(scale=2.0, size=(4, nlp.num_variables))
    results = [InteriorPoint().solve(nlp, start) for start in starts]
    assert all(result.is_success for result in results)
    for result in results:
        assert max(transcription.defects(result.x).values()) <= 1e-8
        assert np.all(result.x >= nlp.lower)


def test_a_warm_start_takes_few_steps_and_stays() -> None:
    nlp = compiled(literal(True))
    cold = InteriorPoint().solve(nlp, np.zeros(nlp.num_variables))
    warm = InteriorPoint.warm(initial_barrier=1e-9).solve(nlp, cold.x)
    assert warm.iterations <= cold.iterations / 3
    np.testing.assert_allclose(warm.x, cold.x, atol=1e-5)


def test_a_bound_so_large_that_rounding_leads_onto_it() -> None:
    result = Problem(
        lambda x: x[0] - 1e8 - x[1],
        lambda x: [x[2] - x[0] - 5],
        [2e8, 0.0, 0.0],
        lower=[1e8, -INF, -INF],
        upper=[INF, 3.0, INF],
    ).solve()
    assert result.is_success
    assert result.x[0] == pytest.approx(1e8, rel=1e-15)
    np.testing.assert_allclose(result.lower_multipliers, [1.0, 0.0, 0.0], rtol=1e-6)
    np.testing.assert_allclose(result.upper_multipliers, [0.0, 1.0, 0.0], rtol=1e-6)
    assert result.x[0] >= 1e8


def test_equal_bounds_hold_a_variable() -> None:
    problem = Problem(
        lambda x: sum((v - 1) ** 2 for v in x),
        lambda x: [x[0] * x[1] - 6],
        [7.0, 7.0, 7.0],
        lower=[2.0, -INF, 4.0],
        upper=[2.0, INF, 4.0],
    )
    result = problem.solve()
    assert result.is_success
    np.testing.assert_allclose(result.x, [2.0, 3.0, 4.0], rtol=1e-14)


def test_a_program_with_nothing_left_to_choose_is_checked() -> None:
    def problem(product: float) -> Problem:
        bounds = [2.0, 3.0]
        return Problem(
            lambda x: x[0], lambda x: [x[0] * x[1] - product], bounds, 2.0, bounds, bounds
        )

    assert problem(6.0).solve().status is LocalStatus.CONVERGED
    assert problem(7.0).solve().status is LocalStatus.INFEASIBLE


def test_an_affine_row_of_one_variable_is_a_bound() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2, "x")
    prog.AddLinearConstraint(np.array([[-2.0, 0.0], [0.0, 0.0]]), [-6.0, -INF], [4.0, INF], x)
    prog.AddLinearConstraint(3 * x[1] + 1 == 7)
    nlp = compile_nlp(prog)
    np.testing.assert_array_equal(nlp.lower, [-2.0, 2.0])
    np.testing.assert_array_equal(nlp.upper, [3.0, 2.0])
    assert nlp.num_rows == 0


def test_a_start_outside_of_bounds_is_moved_inside() -> None:
    problem = PROBLEMS["HS 71, two bounds active"]
    nlp = compile_nlp(problem.program())
    result = InteriorPoint().solve(nlp, [-100.0, 100.0, 7.0, 7.0, -3.0])
    assert result.cost == pytest.approx(problem.optimum, abs=1e-6)
    first = InteriorPoint(max_iterations=0).solve(nlp, [-100.0, 100.0, 7.0, 7.0, -3.0])
    assert first.status is LocalStatus.ITERATION_LIMIT
    assert np.all((nlp.lower < first.x) & (first.x < nlp.upper))


@pytest.mark.parametrize(
    ("problem", "status"),
    [
        (
            Problem(lambda x: x[0] ** 2, lambda x: [x[0] + x[1] - 1, x[0] + x[1] - 2], [3.0, -1.0]),
            LocalStatus.INFEASIBLE,
        ),
        (
            Problem(lambda x: x[0] + x[1], lambda x: [x[0] ** 2 + x[1] ** 2 + 1], [3.0, -1.0]),
            LocalStatus.INFEASIBLE,
        ),
        (
            Problem(
                lambda x: x[1], lambda x: [x[0] * x[1] + 1], [3.0, 2.0], lower=[1, 0], upper=[9, 9]
            ),
            LocalStatus.INFEASIBLE,
        ),
        (
            Problem(lambda x: x[0] - x[1], lambda x: [x[0] + x[1]], [3.0, 2.0]),
            LocalStatus.UNBOUNDED,
        ),
        (Problem(lambda x: -log(x[0]), lambda x: [], [-1.0]), LocalStatus.NOT_FINITE),
        # Rows whose slopes and values overflow.
        (Problem(lambda x: x[0], lambda x: [x[0] ** 4 - 1], [1e110]), LocalStatus.NOT_FINITE),
    ],
)
def test_what_can_not_be_solved_is_told(problem: Problem, status: LocalStatus) -> None:
    result = problem.solve()
    assert result.status is status
    assert not result.is_success
    assert np.all(np.isfinite(result.x))


def test_the_history_ends_in_the_result_which_is_read_only() -> None:
    result = PROBLEMS["HS 71, two bounds active"].solve()
    last = result.history[-1]
    assert last.optimality == result.optimality
    assert last.cost == pytest.approx(result.cost)
    assert len(result.history) == result.iterations + 1
    assert [h.barrier for h in result.history] == sorted(
        (h.barrier for h in result.history), reverse=True
    )
    with pytest.raises(ValueError, match="read-only"):
        result.x[0] = 1.0


def test_a_built_problem_is_the_compiled_one() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(3, "x")
    s = prog.NewContinuousVariables(1, "s")
    for one, other in ((x[0], x[1]), (x[1], x[2])):
        prog.AddCost(2.0 * one * other + 3.0 * other**2 + 1.5)
        prog.AddConstraint(one**2 * other - 4.0 == 0)
    prog.AddLinearConstraint(2.0 * x[0] - x[2] + 1.0 - s[0] == 0)
    prog.AddLinearConstraint(x[1] + 2.0 * x[2] == 5.0)
    prog.AddBoundingBoxConstraint(-1.0, 2.0, s)
    prog.AddBoundingBoxConstraint(-3.0, 0.5, x[:1])
    compiled = compile_nlp(prog)

    builder = NlpBuilder()
    x_ = builder.new(3)
    pairs = np.column_stack([x_[:-1], x_[1:]])
    builder.add_cost("cost", [(2.0, (0, 1)), (3.0, (1, 1)), (1.5, ()), (0.0, (0,))], pairs)
    builder.add_row("row", [(1.0, (0, 0, 1)), (-4.0, ())], pairs)
    builder.bound_sum("sum", np.array([2.0, 0.0, -1.0]), x_, -1.0, 2.0, offset=1.0)
    builder.bound_sum("equal", np.array([0.0, 1.0, 2.0]), x_, 5.0, 5.0)
    builder.bound_sum("one", np.array([-2.0, 0.0, 0.0]), x_, 0.0, 7.0, offset=1.0)
    built = builder.build()

    np.testing.assert_array_equal(built.lower, compiled.lower)
    np.testing.assert_array_equal(built.upper, compiled.upper)
    point = builder.complete(np.array([0.3, -1.2, 0.7]))
    assert point[3] == pytest.approx(2 * 0.3 - 0.7 + 1.0)
    costs, rows = zip(*(nlp.evaluate(point) for nlp in (built, compiled)), strict=True)
    assert costs[0] == pytest.approx(costs[1])
    np.testing.assert_allclose(np.sort(rows[0]), np.sort(rows[1]), atol=1e-15)
    solved = [InteriorPoint().solve(nlp, point).cost for nlp in (built, compiled)]
    assert solved[0] == pytest.approx(solved[1])


def test_bounds_that_contradict_each_other_are_refused() -> None:
    builder = NlpBuilder()
    x = builder.new(2)
    builder.bound(x, 0.0, 1.0)
    builder.bound(x[1], 2.0, 3.0)
    with pytest.raises(UnsupportedTermError) as error:
        builder.build()
    assert str(error.value) == (
        "the bounds of unknown 1 leave it no value: got [2, 1], expected lower ≤ upper. "
        "Relax one of the constraints on it."
    )
