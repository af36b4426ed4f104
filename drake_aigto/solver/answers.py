"""The best point of a solve, and the local solves that lead to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.linear import Storage
from drake_aigto.local import InteriorPoint, PolynomialNlp, solve_with_drake
from drake_aigto.solver.details import AigoOptions
from drake_aigto.solver.program import AigoProgram
from drake_aigto.solver.staged import StagedProgram

Observer = Callable[[Floats, str], None]

_POLISH_STEPS = 200
_RELAXED_STEPS = 60  # from a ladder's top, which is nearly an answer
# A sum of terms is off by no more than this part of the sum of their sizes.
_ROUNDING = 1e-14
# A point farther out than this, in a variable without bounds, is where a cost falls without end;
# and one that is lower than this, which exponentials are well before they are far out.
FAR, _LOW = 1e8, -1e20
_OUT, _REACH = 1e-2 * FAR, 10.0 * FAR
# As many local solves that lose the rows so far out are brought back within reach.
_MOST_RETURNS = 5
# Such a point costs less than nearer ones by this part of their cost, or of 1.
_PLAIN = 1e-6


@dataclass(frozen=True, eq=False)
class CheckedPoint:
    """A point, its origin, and f multiplied out, which is off by its rounding at most."""

    x: Floats
    cost: float
    rounding: float
    violation: float
    origin: str


class Answers:
    """The best of all points that are offered, and local solves, which offer theirs.

    Attributes:
        program: the one that is searched, after presolve if that was done.
        staged: the same without presolve, its complementarities relaxed.
        observe: called with every better point, and a line about it.
        best: None if no point had a finite cost.
        is_unbounded: whether a variable x has no two bounds (n,).
        polishes: number of local solves.
        kkt_storage: of the last one by `InteriorPoint`.
    """

    def __init__(self, staged: StagedProgram, options: AigoOptions, observe: Observer) -> None:
        """Starts without any; `observe` is called with every better point, and a line about it."""
        self.program = program = staged.program
        self.staged = staged
        self._options, self.observe = options, observe
        self.best: CheckedPoint | None = None
        self._best_cost: tuple[CheckedPoint, float] | None = None  # by the program's own formulas
        is_unbounded = np.isinf(program.given.lower) | np.isinf(program.given.upper)
        self.is_unbounded = is_unbounded[: program.source.num_vars()]
        self.polishes = self._returns = 0
        self.kkt_storage: Storage | None = None

    @property
    def is_feasible(self) -> bool:
        """Whether there is a best point, and it meets the constraints."""
        return self.best is not None and self.best.violation <= self._options.feasibility

    @property
    def has_fallen(self) -> bool:
        """Whether the best point is feasible and too far out, or too low, to be a minimum."""
        if self.best is None or not self.is_feasible:
            return False
        is_low = bool(np.any(self.is_unbounded)) and self.best.cost < _LOW
        return is_low or self._is_beyond(self.best.x)

    def _is_beyond(self, x: Floats) -> bool:
        """Whether a variable of x (n,) without bounds is too far out for a minimum."""
        return bool(np.any(np.abs(x[self.is_unbounded]) > FAR))

    def offer(self, y: Floats, origin: str) -> None:
        """Keeps a point, z or (z, s), if it is the best so far."""
        self.keep(self.program.answer(y), origin)

    def keep(self, x: Floats, origin: str) -> None:
        """Keeps a point x (n,) if it is the best so far."""
        program = self.program
        padded = np.zeros(program.nlp.num_variables)
        padded[: program.kept.size] = program.reduce(x)
        cost = program.costs(padded)
        rounding = _ROUNDING * program.nlp.cost_magnitude(padded)
        if not np.isfinite(cost + rounding):
            cost, rounding = program.cost(x), 0.0
        if not np.isfinite(cost):
            return
        answer = CheckedPoint(x, cost, rounding, program.violation(x), origin)
        if self.best is None or self._is_better(answer, self.best):
            self.best = answer
            self.observe(x, f"cost {cost:.9g}, violation {answer.violation:.1e}: {origin}")
            if self._is_beyond(x):  # Nearer is as good where a cost is flat.
                self.keep(np.where(self.is_unbounded, np.clip(x, -_OUT, _OUT), x), origin)

    def _is_better(self, answer: CheckedPoint, best: CheckedPoint) -> bool:
        """Whether an answer violates less beyond the tolerance, or costs less.

        Where rounding hides which costs less, the program's own formulas decide, which take long.
        So far out that only a cost that falls without end leads there, the gain has to be plain:
        terms cancel there, and a cost with an asymptote gains nothing.
        """
        least = self._options.feasibility
        violations = max(answer.violation, least), max(best.violation, least)
        if violations[0] != violations[1]:
            return violations[0] < violations[1]
        if self._is_beyond(answer.x) != self._is_beyond(best.x):
            near, far = (best, answer) if self._is_beyond(answer.x) else (answer, best)
            falls = far.cost + far.rounding < near.cost - _PLAIN * max(1.0, abs(near.cost))
            return falls == (far is answer)
        if abs(answer.cost - best.cost) > answer.rounding + best.rounding:
            return answer.cost < best.cost
        if self._best_cost is None or self._best_cost[0] is not best:
            self._best_cost = best, self.program.cost(best.x)
        if (cost := self.program.cost(answer.x)) >= self._best_cost[1]:
            return False
        self._best_cost = answer, cost
        return True

    def polish(self, y: Floats, name: str) -> Floats:
        """Returns y = (z, s) improved on the true constraints; it is offered too."""
        program = self.program
        if self._options.polish == "none":
            return y
        if self._options.polish == "newton":
            self.polishes += 1
            local = InteriorPoint(max_iterations=_POLISH_STEPS)
            found = local.solve(program.nlp, program.with_slacks(y))
            if self._is_lost(program.answer(found.x)):
                self._returns += 1
                near = self._within_reach()
                start = program.answer(np.clip(found.x, near.lower, near.upper))
                found = local.solve(near, program.with_slacks(program.reduce(start)))
            z, self.kkt_storage = found.x, found.storage
        else:
            z = self._solve_with_drake(program, y)
        self.offer(z, f"polish{name}")
        return program.with_slacks(z)

    def _is_lost(self, x: Floats) -> bool:
        """Whether x (n,) is so far out that rows no longer steer it: it violates them."""
        if self._returns >= _MOST_RETURNS or not (self._is_beyond(x) and np.all(np.isfinite(x))):
            return False
        return self.program.violation(x) > self._options.feasibility

    def _within_reach(self) -> PolynomialNlp:
        """Returns the program with bounds of variables without, beyond which costs have fallen."""
        nlp, kept = self.program.nlp, self.program.kept
        is_open = np.zeros(nlp.num_variables, dtype=bool)
        is_open[: kept.size] = np.isin(kept, np.flatnonzero(self.is_unbounded))
        low, high = np.minimum(nlp.upper, 0.0) - _REACH, np.maximum(nlp.lower, 0.0) + _REACH
        return nlp.with_bounds(
            np.where(is_open & np.isinf(nlp.lower), low, nlp.lower),
            np.where(is_open & np.isinf(nlp.upper), high, nlp.upper),
        )

    def _solve_with_drake(self, program: AigoProgram, y: Floats) -> Floats:
        """Returns the point z where IPOPT, if that polishes, or SNOPT ends on the given program."""
        self.polishes += 1
        solver = "ipopt" if self._options.polish == "ipopt" else "snopt"
        return program.reduce(solve_with_drake(program.source, program.answer(y), solver))

    def solve_from(self, z: Floats, name: str) -> None:
        """Offers the point where an active-set method ends, on the program as it was given."""
        try:
            found = self._solve_with_drake(self.program, z)
        except (RuntimeError, ValueError):  # A formula has no value on the way.
            return
        self.offer(found, name)

    def polish_cell(self, x: Floats) -> Floats | None:
        """Keeps a point x of a cell, and polishes it; returns the best if feasible."""
        self.keep(x, "a cell of the proof")
        program = self.program
        start = program.with_slacks(program.reduce(x))
        if not np.all(np.isfinite(start)):  # Functions of x overflow.
            return None
        better = program.answer(self.polish(start, " of a cell"))
        return better if program.violation(better) <= self._options.feasibility else None

    def polish_as_given(self) -> None:
        """Polishes the best point with all variables: multiplying out in presolve left rounding.

        And once more with a small barrier: a large one drives variables of one bound away from it,
        without end where the cost is small or flat.
        """
        if self._options.polish != "newton" or self.staged.complementarities:
            return
        whole = self.staged.program
        plain = InteriorPoint(max_iterations=_POLISH_STEPS)
        warm = InteriorPoint.warm(max_iterations=_POLISH_STEPS)
        for local in (plain, warm) if self.program.definitions else (warm,):
            if self.best is None:
                return
            start = whole.with_slacks(whole.reduce(self.best.x))
            if np.all(np.isfinite(start)):
                self.polishes += 1
                self.keep(whole.answer(local.solve(whole.nlp, start).x), "polish of all variables")

    def polish_relaxed(self, y: Floats, name: str) -> Floats | None:
        """Offers a point of the program without presolve, improved on its relaxed rows.

        Where that is not feasible, it is improved with corners chosen: of each λ and s, which is 0.

        Returns:
            The point y; None if it is not feasible.
        """
        staged = self.staged
        if self._options.polish != "newton":
            z = self._solve_with_drake(staged.program, y)
            return self._keep_relaxed(staged.program.with_slacks(z), name)
        self.polishes += 1
        found = staged.polish(y, _RELAXED_STEPS)
        self.kkt_storage = found.storage
        kept = self._keep_relaxed(found.x[: y.size], name)
        if kept is None and staged.complementarities:
            local = InteriorPoint.warm(max_iterations=_POLISH_STEPS)
            found = local.solve(staged.at_corners(y), y)
            kept = self._keep_relaxed(found.x, f"{name}, at corners")
        return kept

    def _keep_relaxed(self, y: Floats, name: str) -> Floats | None:
        """Offers a point, and returns it if it is feasible."""
        program = self.staged.program
        x = program.answer(y)
        self.keep(x, f"ladder from {name}")
        return y if program.violation(x) <= self._options.feasibility else None
