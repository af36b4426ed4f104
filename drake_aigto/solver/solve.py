"""One solve: boxes or ladders lead to points, local solves start from others, the best is kept."""

from __future__ import annotations

import math
from contextlib import suppress

import numpy as np
from pydrake.solvers import GetProgramType, MathematicalProgram, ProgramType

from drake_aigto.aigo import Box
from drake_aigto.arrays import Floats
from drake_aigto.certify import Certificate, Certifier, Method, relative_gap
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.solver.answers import FAR, Answers, CheckedPoint, Observer
from drake_aigto.solver.boxes import BoxStage, Outside, make_first_box
from drake_aigto.solver.details import AigoDetails, AigoOptions, AigoStatus
from drake_aigto.solver.presolve import presolve
from drake_aigto.solver.program import AigoProgram, ContradictionError
from drake_aigto.solver.ranges import LARGEST, tighten
from drake_aigto.solver.staged import StagedProgram, StagedSearch

# A local minimum of these is the global one, wherever it is.
_CONVEX = (ProgramType.kLP, ProgramType.kQP)
_PROVEN = 1e-6  # of the gap
# Before the search, which may then be over, at most this part of all cells is spent: this number at
# first, and twice as many as long as that leaves no more than the last part of the gap.
_FIRST_SHARE, _FIRST_CELLS, _SLOW = 0.1, 1000, 0.9
# Where no bound is asked for: the most variables of a program that is bounded all the same, its
# cells at first and at most, and the part of the gap that twice as many have to leave at most for
# more. Of 104 programs with rows these prove 89, and 400 cells 75 in more time, search included.
_PROVABLE, _FEW_CELLS, _MORE_CELLS, _STEEP = 100, 400, 6400, 1.0 / 3.0
# At most this number times `starts` parts of the best point are moved, and this is a gain.
_MOST_PARTS, _GAIN = 5, 1e-7
# Programs of more variables have too many local minima for a few starts.
_FEW = 30
# Rows of such coefficients are singular to SNOPT, which prints so, and ends anywhere.
_SINGULAR = 1e12


class _ProvenError(Exception):
    """No cost is lower than the best by more than the gap: the search is over."""


class Solve:
    """Runs once.

    Args:
        whole: the program, with its slacks.
        options: numerics.
        guess: shape (n,), NaN where there is none.
        observe: called with every better point, and a line about it.
    """

    def __init__(
        self, whole: AigoProgram, options: AigoOptions, guess: Floats, observe: Observer
    ) -> None:
        """Makes the first box."""
        self._options, self._asked = options, guess
        self._staged = staged = StagedProgram(whole, options.feasibility)
        self._answers, self._observe = Answers(staged, options, self._note), observe
        self._boxes = BoxStage(self._answers, options)
        self._ladders: StagedSearch | None = None
        if staged.is_worth_ladders and options.polish != "none":
            polish = self._answers.polish_relaxed
            self._ladders = StagedSearch(staged, options, whole.reduce(guess), polish)
        self._cells = options.cells if options.certify else min(options.cells, _MORE_CELLS)
        self._certifier = self._make_certifier(whole.source)
        self._certificate: Certificate | None = None
        self._decades = 0
        if staged.is_beyond_boxes and self._ladders:
            self._begin(self._ladders.first)
        else:
            self._begin_boxes()

    def _make_certifier(self, prog: MathematicalProgram) -> Certifier | None:
        """Returns bounds of formulas as they were given, not as presolve made them.

        None where they are not asked for, and hopeless, or a formula has none.
        """
        options = self._options
        is_hopeless = self._staged.is_beyond_boxes or prog.num_vars() > _PROVABLE
        if not options.certify and (is_hopeless or not self._cells or options.polish == "none"):
            return None
        try:
            return Certifier(prog, _PROVEN, options.seconds, self._tell)
        except UnsupportedTermError:
            if options.certify:
                raise
            return None

    def _begin_boxes(self) -> None:
        """Presolves, and makes the first box."""
        if self._options.presolve:
            self._answers.program = presolve(self._staged.program)
        self._begin(make_first_box(self._program, self._guess, self._options))

    def _begin(self, first: Box) -> None:
        """Sets the first box, and the part outside of it.

        Bounds of 1e15 in size are none, for ranges end there. If all variables of the program's own
        have two, nothing is open, whatever the ranges of functions of them.
        """
        count = self._program.kept.size
        own = Box(first.center[:count], first.half_width[:count])
        lower, upper = (side[:count] for side in tighten(self._program.nlp))
        is_open = ((lower <= -LARGEST) | (upper >= LARGEST)) & own.free
        is_open &= np.any(self._answers.is_unbounded)
        self._first, self._outside = first, Outside(own, lower, upper, is_open)

    def _tell(self, line: str) -> None:
        """Reports the proof's progress."""
        if self._answers.best is not None:
            self._observe(self._answers.best.x, line)

    def _note(self, x: Floats, line: str) -> None:
        """Reports a better point, and ends the search if the bound so far proves it."""
        self._observe(x, line)
        if self._certifier is not None and self._certificate is not None:
            self._offer_best(self._certifier)
            self._certificate = self._certifier.certificate()
            if self._certificate.gap <= _PROVEN:
                raise _ProvenError

    @property
    def _program(self) -> AigoProgram:
        return self._answers.program

    @property
    def _guess(self) -> Floats:
        return self._program.reduce(self._asked)

    @np.errstate(over="ignore")  # Far out functions do, and what is infinite is no answer.
    def run(self) -> tuple[Floats, float, AigoDetails]:
        """Returns the answer x (n,), its cost, and details."""
        status = None
        try:
            try:
                self._search()
            except _ProvenError:
                with suppress(_ProvenError):
                    self._answers.polish_as_given()
        except KeyboardInterrupt:
            status = AigoStatus.INTERRUPTED
            if self._certifier:
                self._certificate = self._certifier.certificate(is_interrupted=True)
        except ContradictionError:  # Found by presolve, after ladders were gone up in vain.
            status = AigoStatus.CONTRADICTORY_BOUNDS.if_proven(self._program.source)
        best = self._answers.best
        if best is None:
            x = self._program.answer(self._first.center)
            status = status or AigoStatus.NOT_FINITE
            return x, np.inf, AigoDetails.of_nothing(status, x, self._program.source)
        return best.x, self._program.cost(best.x), self._details(best, status or self._judge(best))

    def _search(self) -> None:
        """Searches, from what a proof leaves on."""
        if self._begin_proof():
            raise _ProvenError
        if self._ladders is not None:
            self._offer_guess()
            self._ladders.run()
        if not (self._ladders and self._answers.is_feasible and self._staged.is_beyond_boxes):
            self._search_boxes()
        if self._certifier and self._certificate and not self._is_proof_over:
            is_asked = self._options.certify
            self._prove(self._certifier, is_asked * (self._cells - self._certificate.cells))

    @property
    def _is_proof_over(self) -> bool:
        """Whether the best point is proven, or that there is no feasible one."""
        return bool((c := self._certificate) and (c.gap <= _PROVEN or c.is_infeasible))

    def _begin_proof(self) -> bool:
        """Bounds the cost before the search, if it can; returns whether that proves an answer."""
        if self._certifier is None:
            return False
        self._offer_guess()
        if not self._staged.is_beyond_boxes:
            self._answers.polish(self._program.with_slacks(self._first.center), " of the middle")
        self._prove_first(self._certifier)
        is_cut = self._options.certify and not self._staged.is_beyond_boxes
        if is_cut and not self._is_proof_over:  # A few cells leave hardly less than the whole.
            self._cut_first_box()
        return self._is_proof_over and self._answers.best is not None

    def _prove_first(self, certifier: Certifier) -> None:
        """Bounds the cost on some cells, and on as many again as long as that is worth it.

        Bins of cliques are halved until they prove it: the first halves may be worth nothing.
        """
        is_asked, has_rows = self._options.certify, self._program.nlp.num_rows > 0
        most = int(_FIRST_SHARE * self._cells) if is_asked else self._cells
        count, slow = (_FIRST_CELLS, _SLOW) if is_asked else (_FEW_CELLS, _STEEP)
        count, gap, used = max(1, min(count, most)), math.inf, 0
        while not self._is_proof_over and max(used, count) <= max(1, most):
            found = self._prove(certifier, count)
            if found.method == Method.CLIQUES and not has_rows:
                most = max(most, self._cells // 2)
            elif found.gap > slow * gap and found.cells > used:
                return
            if not is_asked and found.gap == math.inf:
                return
            gap, used, count = found.gap, found.cells, 2 * count

    def _prove(self, certifier: Certifier, cells: int) -> Certificate:
        """Bounds the cost on cells, from the best point on, if it is feasible."""
        self._offer_best(certifier)
        self._certificate = certifier.run(cells, self._answers.polish_cell)
        return self._certificate

    def _offer_best(self, certifier: Certifier) -> None:
        if (best := self._answers.best) is not None and self._answers.is_feasible:
            certifier.offer(best.x)

    def _cut_first_box(self) -> None:
        """Leaves the part of the first box that may hold a minimizer."""
        assert self._certificate is not None
        box, (low, high) = self._first, self._certificate.hull
        ends = np.array([box.center - box.half_width, box.center + box.half_width])
        for k, i in enumerate(self._program.kept.tolist()):
            if i < low.size and box.half_width[k] > 0.0:
                a, b = max(ends[0, k], low[i]), min(ends[1, k], high[i])
                if a <= b:
                    ends[:, k] = a, b
        center = np.where(box.half_width > 0.0, 0.5 * (ends[0] + ends[1]), box.center)
        self._first = Box(center, 0.5 * (ends[1] - ends[0]))

    def _search_boxes(self) -> None:
        if self._staged.is_beyond_boxes:
            self._begin_boxes()
        self._answers.offer(self._first.center, "the middle of the first box")
        if self._offer_guess():
            self._answers.polish(self._program.with_slacks(self._guess), " of the guess")
        self._boxes.search(self._first)
        self._polish_spread()
        self._renew_parts()
        self._search_far()
        self._answers.polish_as_given()

    def _offer_guess(self) -> bool:
        """Offers the guess, and returns whether there is one."""
        if is_given := bool(np.all(np.isfinite(self._guess))):
            self._answers.offer(self._guess, "the guess")
        return is_given

    def _polish_spread(self) -> None:
        """Polishes points spread over the first box: a box's mean shows nothing that is narrow."""
        first, program, starts = self._first, self._program, self._options.starts
        count = program.kept.size
        # In one variable alone, boxes find the global minimum (Labbe & Del Prete 2025).
        is_alone = count == 1 and not program.parsed.rows
        if self._options.polish == "none" or is_alone or count > _FEW:
            return
        rng = np.random.default_rng(self._options.seed)
        # A Latin hypercube: one of each layer of each variable.
        layers = rng.permuted(np.tile(np.arange(starts), (count, 1)), axis=1).T
        for place in (layers + rng.random((starts, count))) / max(1, starts):
            z = first.center[:count] + (2 * place - 1) * first.half_width[:count]
            self._polish_start(z, " of a spread point")

    def _polish_start(self, z: Floats, name: str) -> None:
        """Polishes a point, unless the cost has fallen too far already."""
        if self._answers.has_fallen:
            return
        start = self._program.reduce(self._program.answer(z))
        start = np.where(np.isfinite(start), start, z)
        self._answers.polish(start, name)
        if self._may_be_at_corners():
            self._answers.solve_from(start, name.removeprefix(" of "))

    def _may_be_at_corners(self) -> bool:
        """Whether bounds and rows make corners, and a feasible point is known."""
        is_closed = not np.any(self._outside.is_open)
        is_regular = self._staged.program.largest_coefficient < _SINGULAR
        has_rows = self._program.nlp.num_rows > 0
        return self._answers.is_feasible and is_closed and is_regular and has_rows

    def _renew_parts(self) -> None:
        """Moves parts of the best point and solves from there, as long as that pays.

        Boxes and interior points come from the middle, and may end in one corner again and again.
        An active-set method keeps to the corner that it starts near to.
        """
        answers, options, first = self._answers, self._options, self._first
        count = self._program.kept.size
        if options.polish == "none" or count > _FEW or not self._may_be_at_corners():
            return
        rng = np.random.default_rng(options.seed)
        idle = 0
        for _ in range(_MOST_PARTS * options.starts):
            best = answers.best
            if best is None or idle >= options.starts:
                return
            opened = rng.permutation(count) < rng.integers(1, count + 1)
            z = first.center[:count] + first.half_width[:count] * rng.uniform(-1.0, 1.0, count)
            start = np.where(opened, z, self._program.reduce(best.x))
            answers.solve_from(start, "a part of the best, moved")
            least = best.cost - _GAIN * max(1.0, abs(best.cost))
            idle = 0 if answers.best is not None and answers.best.cost < least else idle + 1

    def _search_far(self) -> None:
        """Polishes points beyond the first box, and searches around a better one there."""
        far, options, answers = self._outside, self._options, self._answers
        if options.polish == "none" or far.box.center.size > _FEW or not np.any(far.is_open):
            return
        rng = np.random.default_rng(options.seed)
        for _ in range(1 + np.count_nonzero(far.is_open)):
            before = answers.best
            self._polish_far(rng)
            best = answers.best
            if best is before or best is None or self._is_outermost(best):
                return
            z = self._program.reduce(best.x)
            if answers.is_feasible and far.decade(z) > 0.0:
                self._first = make_first_box(self._program, z, options)
                self._boxes.search(self._first)

    def _polish_far(self, rng: np.random.Generator) -> None:
        """Polishes points of all decades, and more as long as the best is in the outermost one."""
        far, options = self._outside, self._options
        places = rng.permutation(np.flatnonzero(far.is_open))
        count = math.ceil(options.starts / max(1, options.decades))
        decade = number = 0
        while decade < options.decades or self._is_falling():
            decade += 1
            self._decades = max(decade, self._decades)
            for part in range(count):
                turn, i = divmod(number, places.size)
                best = self._answers.best
                base = self._program.reduce(best.x) if best and turn % 2 else None
                exponent = decade - 1 + (part + rng.random()) / count
                start = far.point(places[i], exponent, base, rng)
                self._polish_start(start, f" of a point in decade {decade}")
                number += 1

    def _is_falling(self) -> bool:
        """Whether the best point is in the outermost decade, which may still be passed."""
        best = self._answers.best
        return best is not None and bool(np.max(np.abs(best.x)) < FAR) and self._is_outermost(best)

    def _is_outermost(self, best: CheckedPoint) -> bool:
        """Whether a point is in the outermost decade."""
        decade = self._outside.decade(self._program.reduce(best.x))
        return self._decades > 0 and decade > self._decades - 1

    def _judge(self, best: CheckedPoint) -> AigoStatus:
        found = self._certificate
        if not self._answers.is_feasible:
            if found and found.is_infeasible:
                return AigoStatus.INFEASIBLE
            return AigoStatus.INFEASIBLE.if_proven(self._program.source)
        if self._answers.has_fallen or self._is_outermost(best):
            return AigoStatus.FALLS_WITHOUT_END
        cost = self._program.cost(best.x)
        if found and relative_gap(cost, found.lower_bound, found.scale) <= _PROVEN:
            return AigoStatus.PROVEN
        is_open = np.any(self._outside.is_open)
        is_whole = not is_open or GetProgramType(self._program.source) in _CONVEX
        return AigoStatus.SOLVED if is_whole else AigoStatus.SOLVED_IN_PART

    def _details(self, best: CheckedPoint, status: AigoStatus) -> AigoDetails:
        first, program, boxes = self._outside.box, self._program, self._boxes
        found = self._certificate
        n, size = best.x.size, program.given.lower.size
        half_width, searched = np.full(size, np.nan), np.tile([[-np.inf], [np.inf]], size)
        half_width[program.kept] = first.half_width
        searched[:, program.kept] = self._outside.within(self._decades)
        return AigoDetails(
            status=status,
            violation=best.violation,
            boxes=boxes.boxes,
            iterations=boxes.iterations,
            polishes=self._answers.polishes,
            origin=best.origin,
            substituted=tuple(each.variable for each in program.definitions if each.variable < n),
            lifted=tuple(map(str, program.lifted.formulas)),
            complementarities=len(self._staged.complementarities),
            ladders=self._ladders.climbs if self._ladders else 0,
            repeats=self._ladders.repeats if self._ladders else 0,
            first_center=program.answer(first.center),
            first_half_width=half_width[:n],
            searched=tuple(searched[:, :n]),
            widths=tuple(boxes.widths),
            box_storage=boxes.storage,
            kkt_storage=self._answers.kkt_storage,
            cost=program.cost(best.x),
            certificate=found,
            conflict=status.explain(program.source, found.cells if found else 0),
        )
