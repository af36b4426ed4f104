"""The search over boxes: against exact optima, within bounds, and the same bits every time."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from box_programs import power
from hypothesis import given, settings
from hypothesis import strategies as st
from marks import slow

from drake_aigto.aigo import (
    Annealing,
    Box,
    BoxSearch,
    CenterObjective,
    FaceFlow,
    Fusion,
    Iterate,
    LowPoint,
)
from drake_aigto.box import BoxPolynomial
from drake_aigto.terms import Factor, FunctionKind, Term, TermBlock


def sextic_chain(n: int, seed: int) -> tuple[BoxPolynomial, np.ndarray, np.ndarray]:
    """Returns the family of [5] with its coefficients a (n, 7) and b (n − 1,)."""
    rng = np.random.default_rng(seed)
    roots = -2 + 0.8 * np.arange(6) + rng.uniform(-1 / 3, 1 / 3, (n, 6))
    a = np.array([np.polynomial.polynomial.polyfromroots(row) for row in roots])
    b = rng.uniform(-1, 1, n - 1)
    blocks = [
        TermBlock(
            f"{i}", tuple(Term(c, (power(0, p),) if p else ()) for p, c in enumerate(row)), [[i]]
        )
        for i, row in enumerate(a)
    ]
    blocks += [
        TermBlock(f"{i}, {i + 1}", (Term(c, (power(0, 1), power(1, 1))),), [[i, i + 1]])
        for i, c in enumerate(b)
    ]
    return BoxPolynomial(n, tuple(blocks)), a, b


def exact_minimum(a: np.ndarray, b: np.ndarray) -> float:
    """Returns the least value over a grid, by dynamic programming along the chain."""
    grid = np.linspace(-2.2, 2.2, 401)
    values = np.polynomial.polynomial.polyval(grid, a.T)
    best = values[0]
    for i, link in enumerate(b):
        best = values[i + 1] + np.min(best[:, None] + link * np.outer(grid, grid), axis=0)
    return float(best.min())


def rosenbrock_pair() -> BoxPolynomial:
    terms = (
        Term(1.0, ()),
        Term(-2.0, (power(0, 1),)),
        Term(1.0, (power(0, 2),)),
        Term(100.0, (power(1, 2),)),
        Term(-200.0, (power(0, 2), power(1, 1))),
        Term(100.0, (power(0, 4),)),
    )
    return BoxPolynomial(2, (TermBlock("valley", terms, [[0, 1]]),))


@pytest.mark.parametrize("n", [10, *slow(2)])
def test_chains_reach_their_exact_minimum(n: int) -> None:
    for seed in range(2):
        f, a, b = sextic_chain(n, seed)
        found = BoxSearch().run(f, Box(np.zeros(n), np.full(n, 2.2))).best.cost
        exact = exact_minimum(a, b)
        assert found <= exact + 1e-6 * abs(exact)
        assert found >= exact * 1.01 - 1.0  # The grid is within 1 % of the true minimum.


@pytest.mark.slow
def test_renewal_lowers_what_one_run_leaves() -> None:
    n = 40
    f, a, b = sextic_chain(n, 0)
    box = Box(np.zeros(n), np.full(n, 2.2))
    once = BoxSearch(rounds=0).run(f, box).best.cost
    renewed = BoxSearch().run(f, box).best.cost
    exact = exact_minimum(a, b)
    assert renewed - exact < 0.2 * (once - exact)
    assert renewed - exact < 0.005 * abs(exact)


def test_a_bent_valley_is_followed_to_its_end() -> None:
    best = BoxSearch().run(rosenbrock_pair(), Box(np.zeros(2), np.full(2, 5.0))).best
    np.testing.assert_allclose(best.x, 1.0, atol=1e-6)


@settings(max_examples=5)
@given(st.integers(0, 10**6), st.floats(-1.5, 1.5), st.floats(0.1, 1.0))
def test_every_candidate_is_inside_the_box(seed: int, shift: float, width: float) -> None:
    f, _, _ = sextic_chain(4, seed)
    box = Box(np.full(4, shift), width * np.array([1.0, 0.0, 1.0, 0.5]))  # One variable is held.
    result = BoxSearch(rounds=15).run(f, box)
    for candidate in result.candidates:
        assert np.all(candidate.x >= box.center - box.half_width)
        assert np.all(candidate.x <= box.center + box.half_width)
        assert candidate.cost == f(candidate.x)
    costs = [candidate.cost for candidate in result.candidates]
    assert costs == sorted(costs, reverse=True)
    assert result.best.cost == costs[-1]


def test_the_same_seed_gives_the_same_bits_and_another_one_other_boxes() -> None:
    f, _, _ = sextic_chain(12, 5)
    box = Box(np.zeros(12), np.full(12, 2.2))
    one, two, other = (BoxSearch(rounds=20, seed=seed).run(f, box) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.best.x, two.best.x)
    assert [c.origin for c in one.candidates] == [c.origin for c in two.candidates]
    assert one.num_steps == two.num_steps
    assert one.num_steps != other.num_steps


def test_polish_has_the_last_word_and_callbacks_see_every_improvement() -> None:
    f, _, _ = sextic_chain(6, 1)
    polished: list[np.ndarray] = []
    seen: list[LowPoint] = []

    def polish(x: np.ndarray) -> np.ndarray:
        polished.append(x)
        return x

    result = BoxSearch(rounds=5).run(f, Box(np.zeros(6), np.full(6, 2.2)), polish, seen.append)
    np.testing.assert_array_equal(polished[-1], result.best.x)
    assert tuple(seen) == result.candidates


def test_ctrl_c_within_a_box_ends_the_search_not_only_that_box(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    f, _, _ = sextic_chain(6, 1)
    calls: list[int] = []

    def interrupted_step(self: FaceFlow, f: BoxPolynomial, iterate: Iterate) -> Iterate:
        calls.append(1)
        raise KeyboardInterrupt

    monkeypatch.setattr(FaceFlow, "step", interrupted_step)
    box = Box(np.zeros(6), np.full(6, 2.2))
    assert BoxSearch().run(f, box).was_interrupted
    assert len(calls) == 1
    assert not BoxSearch(first=(Annealing(),), rounds=0).run(f, box).was_interrupted


def test_rounds_that_cost_much_are_fewer(monkeypatch: pytest.MonkeyPatch) -> None:
    f, _, _ = sextic_chain(6, 1)
    box = Box(np.zeros(6), np.full(6, 2.2))
    many = BoxSearch().run(f, box)
    monkeypatch.setattr("drake_aigto.aigo.box_search._MOST_TERMS", many.num_steps * f.num_terms / 2)
    few = BoxSearch().run(f, box)
    assert 0 < few.num_rounds < many.num_rounds


def test_a_box_without_free_variables_is_its_own_answer() -> None:
    f, _, _ = sextic_chain(3, 0)
    result = BoxSearch().run(f, Box(np.ones(3), np.full(3, 0.0)))
    np.testing.assert_array_equal(result.best.x, 1.0)


def test_several_first_algorithms_each_leave_their_widths() -> None:
    f, _, _ = sextic_chain(4, 0)
    search = BoxSearch(first=(FaceFlow(), FaceFlow(share=0.3)), rounds=0)
    result = search.run(f, Box(np.zeros(4), np.full(4, 2.2)))
    assert len(result.widths) == 2
    assert all(widths[0] == pytest.approx(2.2) for widths in result.widths)
    assert all(widths[-1] < 2.2e-3 for widths in result.widths)


def test_newton_ends_on_a_bound_that_is_in_the_way() -> None:
    # The minimum of Rosenbrock's function over x ≤ 0.5 is where that bound is, on the valley.
    lower, upper = np.array([-2.0, -2.0]), np.array([0.5, 2.0])
    objective = CenterObjective(rosenbrock_pair(), np.ones(2, bool), 1e-8, (lower, upper))
    x = objective.descend(np.array([-1.2, 1.0]), 200).x
    np.testing.assert_allclose(x, [0.5, 0.25], atol=1e-8)
    assert x[0] == 0.5


def test_renewals_are_polished_where_f_only_stands_in_for_the_goal() -> None:
    f, _, _ = sextic_chain(3, 0)
    box = Box(np.zeros(3), np.full(3, 2.2))
    polished: list[np.ndarray] = []

    def polish(x: np.ndarray) -> np.ndarray:
        polished.append(x)
        return x

    BoxSearch(rounds=30, patience=30).run(f, box, polish)
    without = len(polished)
    polished.clear()
    BoxSearch(rounds=30, patience=30, polished_renewals=4).run(f, box, polish)
    assert len(polished) == without + 4
    # They are points that the search itself need not keep.
    assert len({f(x) for x in polished}) >= 3


def test_the_best_that_no_polish_led_to_is_kept_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    f = rosenbrock_pair()
    box = Box(np.zeros(2), np.full(2, 3.0))
    alone = BoxSearch(rounds=4).run(f, box)
    assert alone.unpolished is alone.best
    for name in ("_MOST_STEPS", "_BOLD_STEPS"):
        monkeypatch.setattr(f"drake_aigto.aigo.box_search.{name}", 1)
    once = BoxSearch(first=(FaceFlow(max_steps=1),), rounds=4)
    found = once.run(f, box, lambda x: np.ones(2))
    assert found.best.is_polished and found.best.cost == 0
    assert not found.unpolished.is_polished and found.unpolished.cost > 0


def test_only_renewals_that_lead_below_the_best_get_all_their_newton_steps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    f, box = rosenbrock_pair(), Box(np.zeros(2), np.full(2, 3.0))
    search = BoxSearch(first=(FaceFlow(max_steps=1),), rounds=30, patience=30)
    monkeypatch.setattr("drake_aigto.aigo.box_search._MOST_STEPS", 60)
    found = {}
    for steps in (2, 60):
        monkeypatch.setattr("drake_aigto.aigo.box_search._TRIAL_STEPS", steps)
        found[steps] = search.run(f, box)
        assert found[steps].best.cost < 1e-10 and found[steps].num_rounds == 30
    assert found[2].num_steps < 0.9 * found[60].num_steps


def test_a_slope_that_overflows_is_no_warning() -> None:
    square = Term(0.5, (Factor(0, FunctionKind.POWER, 2),))
    f = BoxPolynomial(
        1, (TermBlock("f", (Term(1e160, (Factor(0, FunctionKind.POWER),)), square), [0]),)
    )
    objective = CenterObjective(f, np.ones(1, bool), 1.0)
    assert objective.descend(np.zeros(1), 0).residual == np.inf
    assert objective.descend_boldly(np.zeros(1), 1)[1] == 1


def random_grid(rows: int, columns: int, seed: int) -> BoxPolynomial:
    """x⁴ − 2 x² + a x at each node, b x y along each edge."""
    rng = np.random.default_rng(seed)
    place = np.arange(rows * columns).reshape(rows, columns)
    across = np.column_stack([place[:, :-1].ravel(), place[:, 1:].ravel()])
    down = np.column_stack([place[:-1].ravel(), place[1:].ravel()])
    wells = Term(1.0, (power(0, 4),)), Term(-2.0, (power(0, 2),))
    blocks = [
        TermBlock(f"node {i}", (*wells, Term(rng.normal(), (power(0),))), [[i]])
        for i in range(place.size)
    ]
    blocks += [
        TermBlock(f"edge {i} {j}", (Term(rng.normal(), (power(0), power(1))),), [[i, j]])
        for i, j in np.vstack([across, down]).tolist()
    ]
    return BoxPolynomial(place.size, tuple(blocks))


def test_the_best_of_all_combinations_is_found() -> None:
    f, rng = random_grid(2, 4, 0), np.random.default_rng(1)
    points = list(rng.uniform(-2, 2, (3, 8)))
    fusion = Fusion.of(f, 3)
    assert fusion is not None
    free = np.ones(8, dtype=bool)
    mixed = fusion.mix(points, free, rng)
    choices = itertools.product(range(3), repeat=8)
    least = min(f(np.array(points)[list(choice), np.arange(8)]) for choice in choices)
    assert f(mixed) == pytest.approx(least, rel=1e-12)

    free[[1, 6]] = False
    mixed = fusion.mix(points, free, rng)
    np.testing.assert_array_equal(mixed[~free], points[0][~free])
    choices = itertools.product(*(range(3) if each else (0,) for each in free))
    least = min(f(np.array(points)[list(choice), np.arange(8)]) for choice in choices)
    assert f(mixed) == pytest.approx(least, rel=1e-12)


def test_where_loops_are_cut_the_mix_is_no_worse_than_the_first_point() -> None:
    f, rng = random_grid(12, 12, 0), np.random.default_rng(0)
    fusion = Fusion.of(f, 4)
    assert fusion is not None
    free = np.ones(144, dtype=bool)
    best = rng.uniform(-2, 2, 144)
    for _ in range(5):
        points = [best, *rng.uniform(-2, 2, (3, 144))]
        mixed = fusion.mix(points, free, rng)
        assert np.all((mixed == points).any(axis=0))
        assert f(mixed) < f(best) - 1.0
        best = mixed


def test_terms_of_many_variables_are_not_mixed() -> None:
    product = Term(1.0, tuple(power(i) for i in range(5)))
    assert Fusion.of(BoxPolynomial(5, (TermBlock("", (product,), [range(5)]),)), 4) is None


@pytest.mark.slow
def test_a_frustrated_grid_is_searched_to_its_minimum() -> None:
    """Each node's value is near ±1, so that the minimum is found from all signs."""
    f = random_grid(3, 4, 2)
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=12)))
    values = [f(x) for x in signs]
    box = Box(np.zeros(12), np.full(12, 2.5))
    starts = signs[np.argsort(values)[:64]]
    least = min(BoxSearch(rounds=0).run(f, Box(x, np.full(12, 0.3))).best.cost for x in starts)
    found = BoxSearch().run(f, box).best
    assert found.cost <= least + 1e-9 * abs(least)
