"""One solve: boxes or ladders lead to points, these are polished, and the best is kept."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.solvers import GetProgramType, ProgramType

from drake_aigto.aigo import Box, BoxSearch, LowPoint, SearchResult
from drake_aigto.arrays import Floats
from drake_aigto.box import BoxPolynomial
from drake_aigto.certify import Certificate, relative_gap
from drake_aigto.linear import Storage
from drake_aigto.local import InteriorPoint, solve_with_drake
from drake_aigto.solver.far import Outside
from drake_aigto.solver.first_box import make_first_box
from drake_aigto.solver.lagrangian import AugmentedLagrangian
from drake_aigto.solver.options import AigoOptions
from drake_aigto.solver.program import AigoProgram
from drake_aigto.solver.proof import PROVEN, Proof
from drake_aigto.solver.question import ContradictionError
from drake_aigto.solver.result import AigoDetails, AigoStatus
from drake_aigto.solver.staged import StagedProgram, StagedSearch
from drake_aigto.solver.starts import PLAIN, POLISH_STEPS, Answer, LocalStarts
from drake_aigto.solver.tighten import may_be_feasible, tighten

_LOG = logging.getLogger(__name__)

Observer = Callable[["Floats", str], Any]

# Penalties Σ r² weigh so many times what the cost varies by over the first box, in turn.
_PENALTIES = (1.0, 30.0, 1e3)
_RELAXED_STEPS = 60  # from a ladder's top, which is nearly an answer
# With constraints, so many of the points on the way are polished too, the last ones, and every
# such a one; and so many renewals of all variables.
_POLISHED, _EVERY = 8, 2
_POLISHED_RENEWALS = 10
# The search at one of three weights gives up after this part of the patience.
_PATIENCE_SHARE = 6
# A sum of terms is off by no more than this part of the sum of their sizes.
_ROUNDING = 1e-14
# A local minimum of these is the global one, wherever it is.
_CONVEX = (ProgramType.kLP, ProgramType.kQP)


class Solve(LocalStarts):
    """Runs once.

    Args:
        program: with its slacks.
        staged: the same without presolve, its complementarities relaxed.
        options: numerics.
        guess: shape (n,), NaN where there is none.
        observers: called with every better point, and a line about it.
    """

    def __init__(
        self,
        program: AigoProgram,
        staged: StagedProgram,
        options: AigoOptions,
        guess: Floats,
        observers: list[Observer],
    ) -> None:
        """Makes the first box."""
        self._program, self._options, self._observers = program, options, observers
        self._asked, self._guess = guess, program.reduce(guess)
        self._staged = staged
        self._ladders: StagedSearch | None = None
        if staged.is_worth_ladders and options.polish != "none":
            whole = staged.program.reduce(guess)
            self._ladders = StagedSearch(staged, options, whole, self._polish_relaxed)
        ladders = self._ladders if staged.is_beyond_boxes else None
        self._proof: Proof | None = None
        if options.certify:
            self._proof = Proof(program, options.cells, self._polish_cell)
        self._begin(ladders.first if ladders else self._make_first_box())
        self._best: Answer | None = None
        self._best_cost: tuple[Answer, float] | None = None  # by the program's own formulas
        self._boxes = self._iterations = self._polishes = self._decades = 0
        self._widths: list[tuple[tuple[float, ...], ...]] = []
        self._box_storage: Storage | None = None
        self._kkt_storage: Storage | None = None

    def _make_first_box(self) -> Box:
        return make_first_box(self._program, self._guess, self._options)

    def _begin(self, first: Box) -> None:
        """Sets the first box, and what is outside of it."""
        count = self._program.reduced.kept.size
        self._first = first
        is_bounded = not np.any(self._is_unbounded(self._program.source.num_vars()))
        self._outside = Outside.of(first, tighten(self._program.nlp), count, is_bounded)

    def run(self) -> tuple[Floats, float, AigoDetails]:
        """Returns the answer x (n,), its cost, and details."""
        status = None
        try:
            if not self._begin_proof():
                if not self._search_stages():
                    self._search_boxes()
                self._finish_proof()
        except KeyboardInterrupt:
            status = AigoStatus.INTERRUPTED
        except ContradictionError:  # Found by presolve, after ladders were gone up in vain.
            status = AigoStatus.CONTRADICTORY_BOUNDS
        best = self._best
        if best is None:
            x = self._program.answer(self._first.center)
            return x, np.inf, AigoDetails.of_nothing(AigoStatus.NOT_FINITE, x)
        return best.x, self._program.cost(best.x), self._details(best, status or self._judge(best))

    def _begin_proof(self) -> bool:
        """Bounds the cost before the search, if asked to; returns whether that proves an answer."""
        if self._proof is None:
            return False
        self._offer_guess()
        is_for_boxes = not self._staged.is_beyond_boxes
        if is_for_boxes:
            self._polish(self._program.with_slacks(self._first.center), " of the middle")
        self._tell_proof()
        self._proof.begin()
        if is_for_boxes:
            self._first = self._proof.cut(self._first, self._program)
        return self._proof.is_over and self._best is not None

    def _finish_proof(self) -> None:
        if self._proof is not None:
            self._tell_proof()
            self._proof.finish()

    def _tell_proof(self) -> None:
        """Hands the best point on, if it is feasible."""
        best, proof = self._best, self._proof
        if proof and best and best.violation <= self._options.feasibility:
            proof.offer(best.x)

    def _polish_cell(self, x: Floats) -> Floats | None:
        """Keeps a point x of a cell, and what it is polished to; returns the best if feasible."""
        self._keep(x, "a cell of the proof")
        y = self._polish(self._program.with_slacks(self._program.reduce(x)), " of a cell")
        better = self._program.answer(y)
        is_feasible = self._program.violation(better) <= self._options.feasibility
        return better if is_feasible else None

    def _search_stages(self) -> bool:
        """Goes up ladders, where that is worth it; returns whether boxes are no longer needed."""
        if self._ladders is None:
            return False
        self._offer_guess()
        self._ladders.run()
        is_found = self._best is not None and self._best.violation <= self._options.feasibility
        return is_found and self._staged.is_beyond_boxes

    def _search_boxes(self) -> None:
        if self._staged.is_beyond_boxes:
            if self._options.presolve:
                self._program = self._program.presolved()
                self._guess = self._program.reduce(self._asked)
            self._begin(self._make_first_box())
        self._offer(self._first.center, "the middle of the first box")
        if self._offer_guess():
            self._polish(self._program.with_slacks(self._guess), " of the guess")
        self._search_all()
        self._polish_spread()
        self._renew_parts()
        self._search_far()
        self._polish_as_given()

    def _polish_as_given(self) -> None:
        """Polishes the best point with all variables: what presolve multiplied out is rounded.

        And once more with a small barrier: a large one drives what has one bound away from it,
        without end where the cost is small or flat.
        """
        if self._options.polish != "newton" or self._staged.complementarities:
            return
        if self._program.reduced.definitions:
            self._polish_whole(InteriorPoint(max_iterations=POLISH_STEPS))
        self._polish_whole(InteriorPoint.warm(max_iterations=POLISH_STEPS))

    def _polish_whole(self, local: InteriorPoint) -> None:
        """Polishes the best point on the program without presolve."""
        best, whole = self._best, self._staged.program
        if best is None:
            return
        start = whole.with_slacks(whole.reduce(best.x))
        if np.all(np.isfinite(start)):
            self._polishes += 1
            self._keep(whole.answer(local.solve(whole.nlp, start).x), "polish of all variables")

    def _offer_guess(self) -> bool:
        """Offers the guess, and returns whether there is one."""
        is_given = bool(np.all(np.isfinite(self._guess)))
        if is_given:
            self._offer(self._guess, "the guess")
        return is_given

    def _details(self, best: Answer, status: AigoStatus) -> AigoDetails:
        first, reduced = self._outside.box, self._program.reduced
        certificate = self._proof.certificate if self._proof else None
        half_width = np.full(reduced.lower.size, np.nan)
        half_width[reduced.kept] = first.half_width
        searched = np.tile([[-np.inf], [np.inf]], reduced.lower.size)
        searched[:, reduced.kept] = self._outside.within(self._decades)
        return AigoDetails(
            status=status,
            violation=best.violation,
            boxes=self._boxes,
            iterations=self._iterations,
            polishes=self._polishes,
            origin=best.origin,
            substituted=tuple(j for j in reduced.defined if j < best.x.size),
            lifted=tuple(map(str, self._program.lifted.formulas)),
            complementarities=len(self._staged.complementarities),
            ladders=self._ladders.climbs if self._ladders else 0,
            repeats=self._ladders.repeats if self._ladders else 0,
            first_center=self._program.answer(first.center),
            first_half_width=half_width[: best.x.size],
            searched=tuple(searched[:, : best.x.size]),
            widths=tuple(self._widths),
            box_storage=self._box_storage,
            kkt_storage=self._kkt_storage,
            cost=self._program.cost(best.x),
            certificate=certificate,
        )

    def _judge(self, best: Answer) -> AigoStatus:
        found = self._proof.certificate if self._proof else None
        if best.violation > self._options.feasibility:
            if found and found.is_infeasible:
                return AigoStatus.INFEASIBLE
            is_proven = not may_be_feasible(self._program.nlp)
            return AigoStatus.INFEASIBLE if is_proven else AigoStatus.NO_FEASIBLE_POINT
        if self._has_fallen() or self._is_outermost(best):
            return AigoStatus.FALLS_WITHOUT_END
        if found and self._gap(best, found) <= PROVEN:
            return AigoStatus.PROVEN
        is_convex = GetProgramType(self._program.source) in _CONVEX
        is_whole = is_convex or not np.any(self._outside.is_open)
        return AigoStatus.SOLVED if is_whole else AigoStatus.SOLVED_IN_PART

    def _gap(self, best: Answer, found: Certificate) -> float:
        return relative_gap(self._program.cost(best.x), found.lower_bound, found.scale)

    def _search_all(self) -> None:
        """Searches f, or with constraints the augmented Lagrangians of rising weights."""
        options, program = self._options, self._program
        if not np.any(self._first.free):
            return
        if not program.num_rows:
            search = BoxSearch(rounds=options.rounds, patience=options.patience, seed=options.seed)
            self._search(search, program.costs, "")
            return
        lagrangian = AugmentedLagrangian(program, self._first)
        if lagrangian.is_finite:
            self._search_lagrangians(lagrangian)

    def _search_lagrangians(self, lagrangian: AugmentedLagrangian) -> None:
        options = self._options
        for number, factor in enumerate(_PENALTIES):
            search = BoxSearch(
                rounds=math.ceil(options.rounds / len(_PENALTIES)),
                patience=math.ceil(options.patience / _PATIENCE_SHARE),
                polished_renewals=_POLISHED_RENEWALS,
                seed=options.seed + number,
            )
            name = f", penalties {factor:g}"
            found = self._search(search, lagrangian.function(factor), name)
            # The least penalized cost need not lead to the least feasible one.
            for candidate in found.candidates[:-1][::-_EVERY][:_POLISHED]:
                self._polish(candidate.x, name)
            lagrangian.update(factor, found.unpolished.x)

    def _search(self, search: BoxSearch, f: BoxPolynomial, name: str) -> SearchResult:
        """Searches the first box for low points of f, each a candidate."""

        def look(candidate: LowPoint) -> None:
            self._offer(candidate.x, f"{candidate.origin}{name}")

        self._box_storage = f.storage
        _LOG.info("boxes%s: %s", name, f.storage)
        found = search.run(f, self._first, lambda y: self._polish(y, name), look)
        self._boxes += found.num_boxes
        self._iterations += found.num_steps
        self._widths.append(found.widths)
        if found.was_interrupted:
            raise KeyboardInterrupt
        return found

    def _polish(self, y: Floats, name: str) -> Floats:
        """Returns y = (z, s) improved on the true constraints; it is a candidate too."""
        program = self._program
        if self._options.polish == "none":
            return y
        self._polishes += 1
        if self._options.polish == "newton":
            found = InteriorPoint(max_iterations=POLISH_STEPS).solve(
                program.nlp, program.with_slacks(y)
            )
            z, self._kkt_storage = found.x, found.storage
        else:
            x = solve_with_drake(program.source, program.answer(y), self._options.polish).x
            z = program.reduce(x)
        self._offer(z, f"polish{name}")
        return program.with_slacks(z)

    def _polish_relaxed(self, y: Floats, name: str) -> Floats | None:
        """Offers a point of the program without presolve, improved on its relaxed rows.

        Where that is not feasible, it is improved with corners chosen: of each λ and s, which is 0.

        Returns:
            The point y; None if it is not feasible.
        """
        staged, options = self._staged, self._options
        self._polishes += 1
        if options.polish != "newton":
            start = staged.program.answer(y)
            x = solve_with_drake(staged.program.source, start, options.polish).x
            return self._keep_relaxed(staged.program.with_slacks(staged.program.reduce(x)), name)
        found = staged.polish(y, _RELAXED_STEPS)
        self._kkt_storage = found.storage
        kept = self._keep_relaxed(found.x[: y.size], name)
        if kept is None and staged.complementarities:
            local = InteriorPoint.warm(max_iterations=POLISH_STEPS)
            found = local.solve(staged.at_corners(y), y)
            kept = self._keep_relaxed(found.x, f"{name}, at corners")
        return kept

    def _keep_relaxed(self, y: Floats, name: str) -> Floats | None:
        """Offers a point, and returns it if it is feasible."""
        program = self._staged.program
        x = program.answer(y)
        self._keep(x, f"ladder from {name}")
        return y if program.violation(x) <= self._options.feasibility else None

    def _offer(self, y: Floats, origin: str) -> None:
        """Keeps a point, z or (z, s), if it is the best so far."""
        self._keep(self._program.answer(y), origin)

    def _keep(self, x: Floats, origin: str) -> None:
        """Keeps a point x (n,) if it is the best so far."""
        program = self._program
        padded = np.zeros(program.nlp.num_variables)
        padded[: self._guess.size] = program.reduce(x)
        cost = program.costs(padded)
        rounding = _ROUNDING * program.nlp.cost_magnitude(padded)
        if not np.isfinite(cost + rounding):
            cost, rounding = program.cost(x), 0.0
        if not np.isfinite(cost):
            return
        answer = Answer(x, cost, rounding, program.violation(x), origin)
        if self._best is None or self._is_better(answer, self._best):
            self._best = answer
            for observer in self._observers:
                observer(x, f"cost {cost:.9g}, violation {answer.violation:.1e}: {origin}")
            if self._is_beyond(x):  # Nearer is as good where a cost is flat.
                self._keep(self._nearer(x), origin)

    def _is_better(self, answer: Answer, best: Answer) -> bool:
        """Whether an answer violates less beyond the tolerance, or costs less.

        Where rounding hides which costs less, the program's own formulas decide, which take long.
        So far out that only a cost that falls without end leads there, the gain has to be plain:
        terms cancel there, and what ends in an asymptote gains nothing.
        """
        least = self._options.feasibility
        violations = max(answer.violation, least), max(best.violation, least)
        if violations[0] != violations[1]:
            return violations[0] < violations[1]
        if self._is_beyond(answer.x) != self._is_beyond(best.x):
            near, far = (best, answer) if self._is_beyond(answer.x) else (answer, best)
            falls = far.cost + far.rounding < near.cost - PLAIN * max(1.0, abs(near.cost))
            return falls == (far is answer)
        if abs(answer.cost - best.cost) > answer.rounding + best.rounding:
            return answer.cost < best.cost
        if self._best_cost is None or self._best_cost[0] is not best:
            self._best_cost = best, self._program.cost(best.x)
        if (cost := self._program.cost(answer.x)) >= self._best_cost[1]:
            return False
        self._best_cost = answer, cost
        return True
