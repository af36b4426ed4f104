"""Local solves from points that boxes do not lead to: spread, far out, and near the best one."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from drake_aigto.aigo import Box
from drake_aigto.arrays import Bools, Floats
from drake_aigto.local import solve_with_drake
from drake_aigto.solver.far import Outside
from drake_aigto.solver.first_box import make_first_box
from drake_aigto.solver.options import AigoOptions
from drake_aigto.solver.program import AigoProgram
from drake_aigto.solver.staged import StagedProgram

POLISH_STEPS = 200
# So many times `starts` parts of the best point are moved at most, and this is a gain.
_MOST_PARTS, _GAIN = 5, 1e-7
# Programs of more variables have too many local minima for a few starts.
_FEW = 30
# A point farther out than this, in a variable without bounds, is where a cost falls without end;
# and one that is lower than this, which exponentials are well before they are far out.
_FAR, _LOW = 1e8, -1e20
_OUT = 1e-2 * _FAR
# Such a point costs less than nearer ones by this part of their cost, or of 1.
PLAIN = 1e-6
# Rows of such coefficients are singular to SNOPT, which prints so, and ends anywhere.
_SINGULAR = 1e12


@dataclass(frozen=True, eq=False)
class Answer:
    """A point, what led to it, and f multiplied out, which is off by its rounding at most."""

    x: Floats
    cost: float
    rounding: float
    violation: float
    origin: str


class LocalStarts(ABC):
    """What a solve does beside its boxes and ladders."""

    _program: AigoProgram
    _staged: StagedProgram
    _options: AigoOptions
    _first: Box
    _outside: Outside
    _best: Answer | None
    _polishes: int
    _decades: int

    @abstractmethod
    def _search_all(self) -> None:
        """Searches the first box."""

    @abstractmethod
    def _polish(self, y: Floats, name: str) -> Floats:
        """Returns y = (z, s) improved on the true constraints; it is a candidate too."""

    @abstractmethod
    def _offer(self, y: Floats, origin: str) -> None:
        """Keeps a point, z or (z, s), if it is the best so far."""

    def _polish_spread(self) -> None:
        """Polishes points spread over the first box: a box's mean shows nothing that is narrow."""
        first, program, starts = self._first, self._program, self._options.starts
        count = program.reduced.kept.size
        # In one variable alone, boxes find the global minimum (Labbe & Del Prete 2025).
        is_alone = count == 1 and not program.num_rows
        if self._options.polish == "none" or is_alone or count > _FEW:
            return
        rng = np.random.default_rng(self._options.seed)
        # A Latin hypercube: one of each layer of each variable.
        layers = rng.permuted(np.tile(np.arange(starts), (count, 1)), axis=1).T
        for place in (layers + rng.random((starts, count))) / max(1, starts):
            z = first.center[:count] + (2 * place - 1) * first.half_width[:count]
            self._polish_start(z, " of a spread point")

    def _polish_start(self, z: Floats, name: str) -> None:
        """Polishes a point, with what rows define, unless the cost has fallen too far already."""
        if self._has_fallen():
            return
        start = self._program.reduce(self._program.answer(z))
        start = np.where(np.isfinite(start), start, z)
        self._polish(start, name)
        if self._may_be_at_corners():
            self._solve_from(start, name.removeprefix(" of "))

    def _renew_parts(self) -> None:
        """Moves parts of the best point and solves from there, as long as that pays.

        Boxes and interior points come from the middle, and may end in one corner again and again.
        An active-set method keeps to the corner that it starts near to.
        """
        program, options, first = self._program, self._options, self._first
        count = program.reduced.kept.size
        if options.polish == "none" or count > _FEW or not self._may_be_at_corners():
            return
        rng = np.random.default_rng(options.seed)
        idle = 0
        for _ in range(_MOST_PARTS * options.starts):
            best = self._best
            if best is None or idle >= options.starts:
                return
            opened = rng.permutation(count) < rng.integers(1, count + 1)
            z = first.center[:count] + first.half_width[:count] * rng.uniform(-1.0, 1.0, count)
            self._solve_from(np.where(opened, z, self._reduced(best)), "a part of the best, moved")
            idle = 0 if self._best is not None and self._is_gain(self._best, best) else idle + 1

    def _may_be_at_corners(self) -> bool:
        """Whether bounds and rows make corners, and a feasible point is known."""
        best = self._best
        is_feasible = best is not None and best.violation <= self._options.feasibility
        is_closed = not np.any(self._outside.is_open)
        is_regular = self._staged.program.largest_coefficient < _SINGULAR
        return is_feasible and is_closed and is_regular and bool(self._program.num_rows)

    def _is_gain(self, answer: Answer, before: Answer) -> bool:
        """Whether a feasible answer is better by more than what local solvers leave."""
        return answer.cost < before.cost - _GAIN * max(1.0, abs(before.cost))

    def _solve_from(self, z: Floats, name: str) -> None:
        """Offers where an active-set method ends, on the program as it was given."""
        solver = "ipopt" if self._options.polish == "ipopt" else "snopt"
        source = self._program.source
        self._polishes += 1
        try:
            x = solve_with_drake(source, self._program.answer(z), solver, POLISH_STEPS).x
        except (RuntimeError, ValueError):  # A formula has no value on the way.
            return
        self._offer(self._program.reduce(x), name)

    def _search_far(self) -> None:
        """Polishes points beyond the first box, and searches around what is better there."""
        far, options = self._outside, self._options
        if options.polish == "none" or far.box.center.size > _FEW or not np.any(far.is_open):
            return
        rng = np.random.default_rng(options.seed)
        for _ in range(1 + np.count_nonzero(far.is_open)):
            before = self._best
            self._polish_far(rng)
            best = self._best
            if best is before or best is None or self._is_outermost(best):
                return
            is_feasible = best.violation <= options.feasibility
            if is_feasible and far.decade(z := self._reduced(best)) > 0.0:
                self._first = make_first_box(self._program, z, options)
                self._search_all()

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
                base = self._reduced(self._best) if self._best and turn % 2 else None
                exponent = decade - 1 + (part + rng.random()) / count
                start = far.point(places[i], exponent, base, rng)
                self._polish_start(start, f" of a point in decade {decade}")
                number += 1

    def _is_falling(self) -> bool:
        """Whether the best point is in the outermost decade, which may still be passed."""
        best = self._best
        return best is not None and bool(np.max(np.abs(best.x)) < _FAR) and self._is_outermost(best)

    def _is_outermost(self, best: Answer) -> bool:
        """Whether a point is in the outermost decade."""
        decade = self._outside.decade(self._reduced(best))
        return self._decades > 0 and decade > self._decades - 1

    def _has_fallen(self) -> bool:
        """Whether the best point is feasible and too far out, or too low, to be a minimum."""
        best = self._best
        if best is None or best.violation > self._options.feasibility:
            return False
        is_low = bool(np.any(self._is_unbounded(best.x.size))) and best.cost < _LOW
        return is_low or self._is_beyond(best.x)

    def _is_beyond(self, x: Floats) -> bool:
        """Whether a variable of x (n,) without bounds is too far out for a minimum."""
        return bool(np.any(np.abs(x[self._is_unbounded(x.size)]) > _FAR))

    def _nearer(self, x: Floats) -> Floats:
        """Returns x (n,) with what is far too far out moved to where it is only far out."""
        return np.where(self._is_unbounded(x.size), np.clip(x, -_OUT, _OUT), x)

    def _is_unbounded(self, count: int) -> Bools:
        """Returns which of the first variables, so many, have no two bounds."""
        reduced = self._program.reduced
        return (np.isinf(reduced.lower) | np.isinf(reduced.upper))[:count]

    def _reduced(self, answer: Answer) -> Floats:
        return self._program.reduce(answer.x)
