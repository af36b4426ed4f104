"""AIGO's algorithms: invariants of their steps, and functions whose global minimum is known."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from box_programs import add, compile_program, power, program, univariate
from hypothesis import given, settings
from hypothesis import strategies as st
from marks import slow

from benchmarks.equal_widths import EqualWidths
from drake_aigto.aigo import (
    Algorithm,
    Alternating,
    Annealing,
    BoundedAnnealing,
    Box,
    BoxSearch,
    CenterObjective,
    CouplingGraph,
    FaceFlow,
    FullGradient,
    Iterate,
    SlowMotion,
    Status,
    minimize,
    raise_penalties,
)
from drake_aigto.box import BoxPolynomial
from drake_aigto.errors import OptionsError
from drake_aigto.terms import Factor, FunctionKind, Term, TermBlock
from drake_aigto.transcription import NONPENETRATION, RESTITUTION, RigidTranscription
from drake_aigto.world import Scenario, World

ALGORITHMS: dict[str, Algorithm] = {
    "annealing": Annealing(initial_temperature=10.0, final_temperature=1e-12),
    "bounded annealing": BoundedAnnealing(initial_temperature=0.1, final_temperature=1e-12),
    "full gradient": FullGradient(zeta=1.0),
    "alternating": Alternating(final_width=1e-5),
    "equal widths": EqualWidths(final_share=1e-5),
    "face flow": FaceFlow(final_width=1e-5),
}


def chain(n: int, weight: float = 3.0) -> BoxPolynomial:
    """Returns Σ (x_i² − 1)² + x_i/5 + weight (x_{i+1} − x_i)²; the lower valley is near −1."""
    well = (
        Term(1.0, (power(0, 4),)),
        Term(-2.0, (power(0, 2),)),
        Term(1.0, ()),
        Term(0.2, (power(0, 1),)),
    )
    link = (
        Term(1.0, (power(0, 2),)),
        Term(1.0, (power(1, 2),)),
        Term(-2.0, (power(0, 1), power(1, 1))),
    )
    i = np.arange(n)
    return BoxPolynomial(
        n,
        (
            TermBlock("well", well, i[:, np.newaxis]),
            TermBlock("link", link, np.column_stack([i[:-1], i[1:]]), weight),
        ),
    )


@settings(max_examples=3)
@given(degree=st.sampled_from([4, 6, 8]), seed=st.integers(0, 10**6), shift=st.floats(-20, 20))
def test_the_papers_algorithm_solves_one_variable_globally(
    degree: int, seed: int, shift: float
) -> None:
    # Random critical points in [−2, 2] + shift; f is the integral of ∏ (x − r). Annealing has no
    # such guarantee: it follows one stationary box, also where a wide one turns into the better of
    # two.
    roots = np.random.default_rng(seed).uniform(-2, 2, degree - 1)
    f = np.polynomial.Polynomial.fromroots(roots).integ()
    values = np.sort(f(roots))
    if np.diff(values[:2])[0] < 1e-3:
        return  # Two minima as good as equal: no unique one to find.
    best = roots[np.argmin(f(roots))]
    shifted = f(np.polynomial.Polynomial([-shift, 1.0]))
    box = Box(np.array([shift]), np.array([4.0]))
    result = minimize(univariate(shifted.coef), box, ALGORITHMS["full gradient"])
    assert result.is_converged
    # The expanded coefficients carry rounding of up to 22⁸ ε ≈ 1e-5.
    assert result.box.center[0] - shift == pytest.approx(best, abs=0.02)


@pytest.mark.parametrize("name", ALGORITHMS)
def test_a_chain_of_double_wells_ends_in_the_lower_valley(name: str) -> None:
    f = chain(12)
    result = minimize(f, Box(np.full(12, 0.5), np.full(12, 2.0)), ALGORITHMS[name])
    assert np.all(result.box.center < -0.9)
    assert result.cost == pytest.approx(f(np.full(12, -1.0247)), abs=1e-3)


@pytest.mark.parametrize("name", ALGORITHMS)
def test_sizes_shrink_at_every_outer_step(name: str) -> None:
    result = minimize(chain(8), Box(np.full(8, 0.5), np.full(8, 2.0)), ALGORITHMS[name])
    sizes = [iterate.box.mean_half_width for iterate in result.history]
    settled = sizes[1:]  # The first step may widen: the start is not stationary.
    assert all(after < before for before, after in pairwise(settled))
    assert settled[-1] < 1e-4


def test_an_annealed_box_is_stationary() -> None:
    # w_i ∂f̄/∂w_i = μ for every i, and ∂f̄/∂c = 0.
    algorithm = Annealing(initial_temperature=0.3, final_temperature=0.2, tolerance=1e-8)
    f = chain(5)
    result = minimize(f, Box(np.full(5, 0.5), np.full(5, 2.0)), algorithm)
    _, gradient_c, gradient_z = f.gradient(result.box.center, result.box.half_width)
    np.testing.assert_allclose(gradient_c, 0.0, atol=1e-7)
    np.testing.assert_allclose(gradient_z, 0.3, rtol=1e-7)


def test_equal_widths_keep_the_first_boxs_shape_and_end_in_a_minimum() -> None:
    f, first = chain(6), Box(np.full(6, 0.5), np.linspace(1.0, 2.0, 6))
    result = minimize(f, first, EqualWidths(final_share=1e-3, shrink=0.5))
    assert result.is_converged
    for share, iterate in zip(0.5 ** np.arange(10), result.history[1:], strict=True):
        np.testing.assert_allclose(iterate.box.half_width, share * first.half_width, rtol=1e-12)
        _, gradient, _ = f.gradient(iterate.box.center, iterate.box.half_width)
        np.testing.assert_allclose(gradient, 0.0, atol=1e-4)


def test_shares_of_zero_are_no_boxes_but_a_local_minimum() -> None:
    # From the upper valley's slope there is no way to the lower one for points.
    f, first = chain(6), Box(np.full(6, 0.5), np.full(6, 2.0))
    points = minimize(f, first, EqualWidths(first_share=0.0, final_share=0.0))
    boxes = minimize(f, first, EqualWidths())
    assert len(points.history) == 2
    np.testing.assert_array_equal(points.box.half_width, 0.0)
    assert np.all(points.box.center > 0.9)
    assert np.all(boxes.box.center < -0.9)


def test_a_quadratics_boxes_follow_from_the_temperature() -> None:
    # f = a (x − 1)²: mean a ((c − 1)² + w²/3), stationary at w = √(3μ/(2a)).
    f = univariate(np.array([4.0, -8.0, 4.0]))
    algorithm = Annealing(initial_temperature=1e-2, final_temperature=5e-3, tolerance=1e-10)
    result = minimize(f, Box(np.array([7.0]), np.array([2.0])), algorithm)
    hot, cold = result.history[1], result.history[2]
    assert hot.box.half_width[0] == pytest.approx(np.sqrt(3 * 1e-2 / 8))
    assert cold.box.half_width[0] == pytest.approx(np.sqrt(3 * 5e-3 / 8))
    assert hot.box.center[0] == pytest.approx(1.0)


def test_steps_by_hand_are_the_loops_steps() -> None:
    algorithm, f = Annealing(initial_temperature=1.0, final_temperature=1e-3), chain(4)
    box = Box(np.full(4, 0.5), np.full(4, 2.0))
    seen: list[Iterate] = []
    result = minimize(f, box, algorithm, callback=seen.append)
    iterate = algorithm.init(f, box)
    by_hand = [iterate]
    while not algorithm.terminate(f, iterate):
        iterate = algorithm.step(f, iterate)
        by_hand.append(iterate)
    for one, two, three in zip(by_hand, result.history, seen, strict=True):
        np.testing.assert_array_equal(one.box.center, two.box.center)
        assert two is three


@pytest.mark.parametrize("name", ALGORITHMS)
def test_ctrl_c_returns_the_best_so_far(name: str) -> None:
    def interrupt(iterate: Iterate, steps: list[int] = []) -> None:  # noqa: B006 (a counter)
        steps.append(1)
        if len(steps) == 4:
            raise KeyboardInterrupt

    result = minimize(chain(4), Box(np.full(4, 0.5), np.full(4, 2.0)), ALGORITHMS[name], interrupt)
    assert result.status is Status.INTERRUPTED
    assert len(result.history) == 4
    assert np.isfinite(result.cost)


def test_a_run_says_why_it_ended() -> None:
    barrier = Term(1.0, (Factor(0, FunctionKind.NEG_LOG),))
    f = BoxPolynomial(1, (TermBlock("barrier", (barrier,), [[0]]),))
    beyond = minimize(f, Box(np.array([0.5]), np.array([1.0])), Annealing())
    assert beyond.status is Status.NOT_FINITE and not beyond.is_converged
    short = minimize(chain(4), Box(np.zeros(4), np.ones(4)), FullGradient(max_steps=3))
    assert short.status is Status.STEP_LIMIT and not short.is_converged


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Annealing(initial_temperature=0.0), "initial_temperature: got 0, expected"),
        (lambda: Annealing(cooling=1.0), "cooling: got 1, expected a number above 0 and below 1"),
        (lambda: Annealing(tolerance=float("nan")), "tolerance: got nan"),
        (lambda: Annealing(max_newton_steps=0), "max_newton_steps: got 0, expected 1 or more"),
        (lambda: FullGradient(gamma=1.0), "gamma: got 1, expected a number above 1"),
        (lambda: FullGradient(beta=1.0), r"beta: got 1, expected a number in \[0, 1\)"),
        (lambda: Annealing(narrowing=-0.5), "narrowing: got -0.5, expected a number, 0 or more"),
        (lambda: FullGradient(zeta=-1.0), "zeta: got -1, expected a number above 0"),
        (lambda: FullGradient(inner_steps=0), "inner_steps: got 0, expected 1 or more"),
        (lambda: FaceFlow(share=1.0), "share: got 1, expected a number above 0 and below 1"),
        (lambda: FaceFlow(least_shrink=0.0), "least_shrink: got 0, expected a number above 0"),
        (lambda: FaceFlow(final_width=2.0), "final_width: got 2, expected a number above 0 and"),
        (lambda: FaceFlow(max_steps=0), "max_steps: got 0, expected 1 or more"),
        (lambda: BoxSearch(rounds=-1), "rounds: got -1, expected 0 or more"),
        (lambda: BoxSearch(patience=0), "patience: got 0, expected 1 or more"),
        (lambda: BoxSearch(first=()), "first: got no algorithm, expected one or more"),
        (lambda: EqualWidths(shrink=1.0), "shrink: got 1, expected a number above 0 and below 1"),
        (lambda: EqualWidths(final_share=2.0), "final_share: got 2 with a first_share of 1"),
        (lambda: EqualWidths(final_share=0.0), "final_share: got 0, expected a number above 0"),
        (lambda: EqualWidths(max_newton_steps=0), "max_newton_steps: got 0, expected 1 or more"),
        (lambda: Box(np.zeros(2), np.array([1.0, -1.0])), "half_width: got -1, expected 0"),
        (lambda: Box(np.array([np.nan]), np.ones(1)), "box: got NaN or infinity"),
    ],
)
def test_bad_options_are_refused(make: object, message: str) -> None:
    with pytest.raises(OptionsError, match=message):
        make()  # type: ignore[operator]


def test_a_box_is_read_only_and_spreads_scalars() -> None:
    box = Box(np.zeros(3), 2.0)  # type: ignore[arg-type]
    np.testing.assert_array_equal(box.half_width, [2.0, 2.0, 2.0])
    with pytest.raises(ValueError, match="read-only"):
        box.center[0] = 1.0
    assert box.log_size == pytest.approx(np.log(4.0**3))
    assert box.mean_half_width == pytest.approx(2.0)


@given(st.integers(1, 30), st.integers(0, 9), st.integers(0, 2**32 - 1))
def test_one_newton_step_solves_a_convex_quadratic_whatever_is_held_or_at_a_bound(
    size: int, bandwidth: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    lower = np.tril(np.triu(rng.normal(size=(size, size)), -bandwidth))
    matrix, b = lower @ lower.T + 0.1 * np.eye(size), rng.normal(size=size)
    free = rng.random(size) < 0.8
    # Where x = 0 is a lower bound and the slope −b is positive, it stays.
    low = np.where((b < 0.0) & (rng.random(size) < 0.5), 0.0, -np.inf)
    moved = free & (low < 0.0)
    inner = matrix[np.ix_(moved, moved)]
    least = np.linalg.eigvalsh(inner)[0] if moved.any() else 0.0
    for shift, is_convex in ((0.0, True), (-0.9 * least, True), (-1.1 * least, False)):
        prog, x = program(size)
        prog.AddQuadraticCost(matrix + shift * np.eye(size), -b, x, is_convex=False)
        f = compile_program(prog, range(size))
        bounds = low, np.full(size, np.inf)
        found = CenterObjective(f, free, 0.0, bounds).descend(np.zeros(size), 1)
        if moved.any():
            assert (found.damping < 1e-6) == is_convex
        if is_convex:
            shifted, expected = inner + shift * np.eye(len(inner)), np.zeros(size)
            expected[moved] = np.linalg.solve(shifted, b[moved])
            slack = 1e-14 * size * np.linalg.cond(shifted) if moved.any() else 0.0
            np.testing.assert_allclose(
                found.x, expected, rtol=0, atol=slack * (1.0 + np.max(np.abs(expected)))
            )


def test_a_step_never_changes_a_width_by_more_than_e() -> None:
    f, box = chain(3), Box(np.zeros(3), np.full(3, 2.0))
    hot = Annealing(initial_temperature=1e3, final_temperature=900.0, tolerance=1e-3)
    ends = [minimize(f, box, replace(hot, max_newton_steps=steps)) for steps in range(1, 6)]
    widths = [box.half_width, *(end.history[1].box.half_width for end in ends)]
    changes = np.max(np.abs(np.diff(np.log(widths), axis=0)), axis=1)
    assert np.all(changes <= 1.0 + 1e-12)
    assert changes[0] == pytest.approx(1.0), "the hot box is far larger than the first"


def test_boxes_that_narrow_with_the_temperature_follow_a_quadratic_by_themselves() -> None:
    f, box = univariate(np.array([0.0, -2.0, 1.0])), Box(np.zeros(1), np.ones(1))
    steps = {}
    for narrowing in (0.0, 0.5):
        annealing = Annealing(cooling=0.1, tolerance=1e-6, narrowing=narrowing)
        result = minimize(f, box, annealing)
        steps[narrowing] = [iterate.inner_steps for iterate in result.history[2:]]
        slow = minimize(f, box, SlowMotion(annealing))
        assert result.is_converged and slow.is_converged
        for end in (result, slow):
            # (x − 1)² over a box: c = 1 and w ∂/∂w w²/3 = μ, at the last of the temperatures.
            np.testing.assert_allclose(end.box.center, 1.0, atol=1e-9)
            np.testing.assert_allclose(end.box.half_width, np.sqrt(1.5e-10), rtol=1e-5)
    assert steps[0.5] == [0] * 7
    assert min(steps[0.0]) > 1


def test_slow_motion_ends_a_temperature_early_where_annealing_does() -> None:
    f, box = chain(4), Box(np.zeros(4), np.full(4, 2.0))
    annealing = Annealing(cooling=0.1, narrowing=0.5, tolerance=1e-9, max_newton_steps=3)
    fast, slow = (minimize(f, box, algorithm) for algorithm in (annealing, SlowMotion(annealing)))
    assert slow.is_converged and slow.num_inner_steps == fast.num_inner_steps
    np.testing.assert_array_equal(slow.box.center, fast.box.center)
    np.testing.assert_array_equal(slow.box.half_width, fast.box.half_width)


def test_raised_penalties_meet_the_constraint() -> None:
    # minimise (x − 3)² + (y − 1)² subject to x y = 1, from near the solution of the penalised
    # problem.
    cost = (
        Term(1.0, (power(0, 2),)),
        Term(-6.0, (power(0, 1),)),
        Term(1.0, (power(1, 2),)),
        Term(-2.0, (power(1, 1),)),
    )
    row = (
        Term(1.0, (power(0, 2), power(1, 2))),
        Term(-2.0, (power(0, 1), power(1, 1))),
        Term(1.0, ()),
    )
    f = BoxPolynomial(2, (TermBlock("cost", cost, [[0, 1]]), TermBlock("row", row, [[0, 1]])))
    x = np.array([2.5, 0.8])
    for weight in (1.0, 100.0):  # 1e7 at last.
        x = raise_penalties(f.with_weights({"row": weight}), ["row"], x, np.ones(2, dtype=bool))
    assert x[0] * x[1] == pytest.approx(1.0, abs=1e-6)
    # Stationarity along the constraint: (x − 3)/y = (y − 1)/x.
    assert (x[0] - 3) / x[1] == pytest.approx((x[1] - 1) / x[0], abs=1e-5)


def valley(scale: float) -> BoxPolynomial:
    """Returns a well in x₀, whose middle depends on x₁, a slope in x₁, and nothing of x₂."""
    prog, x = program()
    add(prog, scale * ((x[0] + 1) ** 4 + 0.5 * (x[0] + 1) ** 2 + x[1] + 0.1 * (x[0] + 1) * x[1]))
    return compile_program(prog)


BOX = Box(np.array([0.1, 0.5, -1.0]), np.array([2.0, 1.5, 0.25]))


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_the_scale_of_a_cost_does_not_matter(scale: float) -> None:
    result = minimize(valley(scale), BOX, BoundedAnnealing())
    plain = minimize(valley(1.0), BOX, BoundedAnnealing())
    assert result.is_converged
    np.testing.assert_allclose(result.box.center, plain.box.center, atol=1e-4)
    # x₁ falls to its bound.
    np.testing.assert_allclose(result.box.center[:2], [-0.9, -1.0], atol=0.05)


def test_no_box_leaves_the_first_one_nor_grows_where_the_cost_is_flat() -> None:
    result = minimize(valley(1.0), BOX, BoundedAnnealing())
    for iterate in result.history:
        box = iterate.box
        assert np.all(box.half_width <= BOX.half_width * (1 + 1e-12))
        assert np.all(np.abs(box.center - BOX.center) <= BOX.half_width * (1 + 1e-12))
    np.testing.assert_allclose(result.box.half_width[2], 0.25)


@pytest.mark.slow
@pytest.mark.parametrize("row", [1, 2, 3])
def test_the_default_search_finds_the_bounce_that_face_flow_misses(row: int) -> None:
    scenario = replace(Scenario.named(f"table1/{row}"), time_step=0.02)
    world = World.from_scenario(scenario)
    transcription = RigidTranscription(world, scenario)
    f = compile_program(transcription.penalized(), transcription.elimination_order())
    # Light restitution rows, as hot boxes have them in plans.
    unit = transcription.cost_scale()
    rows = {c.evaluator().get_description() for c in transcription.prog().GetAllConstraints()}
    known = {RESTITUTION: 2.0, NONPENETRATION: 3e3}
    weights = {name: unit * known.get(name, 3e2) for name in rows & set(f.weights)}
    box = Box(*transcription.initial_box())
    flow, both = (
        search.run(f.with_weights(weights), box).best
        for search in (BoxSearch(first=(FaceFlow(is_coupled=False),)), BoxSearch())
    )
    assert np.max(transcription.impulses(flow.x)) < 0.01
    assert np.max(transcription.impulses(both.x)) > 1.0
    assert both.cost < 0.5 * flow.cost


def random_chain(n: int, seed: int) -> BoxPolynomial:
    """Returns Σ of random quartics of x_i, and of b_i x_i x_{i+1}."""
    rng = np.random.default_rng(seed)
    blocks = []
    for i in range(n):
        quartic = np.polynomial.polynomial.polyfromroots(rng.uniform(-2, 2, 4))
        terms = tuple(Term(float(a), (power(0, p),) if p else ()) for p, a in enumerate(quartic))
        blocks.append(TermBlock(f"well {i}", terms, [[i]]))
    for i in range(n - 1):
        link = Term(rng.uniform(-1, 1), (power(0, 1), power(1, 1)))
        blocks.append(TermBlock(f"link {i}", (link,), [[i, i + 1]]))
    return BoxPolynomial(n, tuple(blocks))


@pytest.mark.parametrize("degree", [4, 12])
def test_random_polynomials_of_one_variable_are_solved_globally(degree: int) -> None:
    rng = np.random.default_rng(degree)
    for _ in range(10):
        roots = rng.uniform(-2, 2, degree - 1)
        f = np.polynomial.Polynomial.fromroots(roots).integ()
        result = minimize(univariate(f.coef), Box(np.zeros(1), np.array([2.5])), FaceFlow())
        assert result.is_converged
        # A last half width of 2.5e-3 around the minimizer leaves this much.
        low = float(np.min(f(roots)))
        nearby = f(roots[np.argmin(f(roots))] + np.array([-3e-3, 3e-3]))
        assert result.cost <= max(low + 1e-9, float(np.max(nearby)))


@given(st.booleans(), st.integers(0, 10**6), st.floats(0.01, 0.9), st.floats(-3, 3))
def test_every_box_from_the_first_on_holds_the_next(
    is_coupled: bool, seed: int, share: float, shift: float
) -> None:
    first = Box(np.full(5, shift), np.array([1.0, 2.0, 0.3, 5.0, 1.0]))
    algorithm = FaceFlow(is_coupled=is_coupled, share=share, least_shrink=0.05)
    result = minimize(random_chain(5, seed), first, algorithm)
    assert result.is_converged
    for before, after in pairwise(i.box for i in result.history):
        slack = before.half_width - np.abs(after.center - before.center) - after.half_width
        assert np.all(slack >= -1e-12)


def test_what_is_cut_off_was_worse() -> None:
    # x² + 3x on [−2, 2]: the face at 2 is the worse one, and all that moves.
    f = univariate(np.array([0.0, 3.0, 1.0]))
    box = Box(np.zeros(1), np.array([2.0]))
    after = FaceFlow().step(f, FaceFlow().init(f, box)).box
    assert after.center[0] - after.half_width[0] == pytest.approx(-2.0)
    assert after.center[0] + after.half_width[0] < 0.01


@pytest.mark.parametrize("is_coupled", [True, False])
def test_parts_that_are_not_coupled_do_not_see_each_other(is_coupled: bool) -> None:
    alone = random_chain(3, 1)
    moved = [TermBlock(b.name + "'", b.terms, b.variables + 3, 50.0) for b in alone.blocks]
    both = BoxPolynomial(6, (*alone.blocks, *moved))
    algorithm = FaceFlow(is_coupled=is_coupled)
    one = minimize(alone, Box(np.zeros(3), np.full(3, 2.2)), algorithm).box.center
    two = minimize(both, Box(np.zeros(6), np.full(6, 2.2)), algorithm).box.center
    # The boxes of the part that is done first go on to shrink: 1e-3 of 2.2 is their last width.
    np.testing.assert_allclose(two[:3], one, atol=2e-3)
    np.testing.assert_allclose(two[3:], one, atol=2e-3)


def test_a_flat_cost_leaves_the_center_where_it_is() -> None:
    f = univariate(np.array([3.0]))
    result = minimize(f, Box(np.array([1.5]), np.array([2.0])), FaceFlow(least_shrink=0.1))
    assert result.is_converged
    assert result.box.center[0] == 1.5


@pytest.mark.parametrize("units", [5.0, *slow(1.0)])
def test_a_box_of_a_few_units_in_the_last_place_ends(units: float) -> None:
    first = Box(np.array([0.0, 4.0]), np.array([1.0, 0.5 * units * np.spacing(4.0)]))
    result = minimize(random_chain(2, 0), first, FaceFlow())
    assert result.is_converged
    assert abs(result.box.center[1] - 4.0) <= units * np.spacing(4.0)


def test_alternating_stays_inside_the_first_box() -> None:
    first = Box(np.full(3, 0.5), np.full(3, 1.5))
    for iterate in minimize(random_chain(3, 3), first, Alternating()).history:
        reach = np.abs(iterate.box.center - first.center) + iterate.box.half_width
        assert np.all(reach <= first.half_width * (1 + 1e-9))


@given(st.integers(1, 30), st.integers(1, 8), st.integers(0, 10**6), st.sets(st.integers(0, 29)))
def test_clusters_are_small_connected_and_apart(
    n: int, size: int, seed: int, held: set[int]
) -> None:
    free = np.array([i not in held for i in range(n)])
    graph = CouplingGraph.of(random_chain(n, 0))
    labels = graph.clusters(size, free, np.random.default_rng(seed))
    assert np.all(labels[~free] == -1)
    for cluster in range(labels.max(initial=-1) + 1):
        members = np.flatnonzero(labels == cluster)
        assert 1 <= members.size <= size
        assert np.all(np.diff(members) == 1)  # connected, in a chain
    left, right = labels[:-1], labels[1:]
    assert np.all((left == right) | (left < 0) | (right < 0))
    # Nothing could be added: who is left out stands beside a cluster.
    for i in np.flatnonzero(free & (labels < 0)):
        assert max(labels[max(i - 1, 0) : i + 2]) >= 0


def test_components_are_split_by_what_is_held() -> None:
    free = np.array([True, True, False, True, False, True])
    labels = CouplingGraph.of(random_chain(6, 0)).components(free)
    np.testing.assert_array_equal(labels, [0, 0, -1, 1, -1, 2])
