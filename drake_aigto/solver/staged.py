"""Programs that are chains of stages, or have complementarities: local solves from many starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from drake_aigto.aigo import Box
from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.local import (
    InteriorPoint,
    LocalResult,
    PenaltyLadder,
    PenaltyTables,
    PolynomialNlp,
    make_penalty_tables,
)
from drake_aigto.solver import complementarity
from drake_aigto.solver.details import AigoOptions
from drake_aigto.solver.program import AigoProgram
from drake_aigto.terms import TermBlock, constant, evaluate

# Least length of a chain relative to its half bandwidth, and its least number of variables.
_LEAST_LENGTH, _FEW = 6, 40
# Least number of equalities, relative to the variables, that link stages: where there are fewer,
# much is free, and boxes see more of it.
_LEAST_EQUALITIES = 1 / 3
# Programs whose systems take longer to factorize, in multiplications, are left to boxes.
_MOST_WORK = 3e7
# λ s ends at this part of the violation that an answer may have.
_PART_OF_FEASIBILITY = 0.1
# Number of points that are kept; and the least relative difference of their costs, which is also
# the gain, relative to the best cost, that makes a point better.
_MOST_KEPT, _SAME = 4, 1e-3
# Costs this much above the best one, relative to it, are of no use.
_TOO_COSTLY = 0.05
# Reach of starts over the box; ladders begin at these powers of ten.
_REACH = 0.6
_START_TIGHTENED, _RENEWED_TIGHTENED = (-2.0, 0.0), (-3.0, 0.0)
# Share of climbs by the other way than the one that led to the best point; ladders of penalties
# that a climb by interior points, which takes about twice as long, counts as.
_OTHER, _TIGHTENED_WORK = 0.25, 3
_START_RELAXATIONS, _START_WEIGHTS = (-2.2, -0.7), (2.5, 5.0)
_RENEWED_RELAXATIONS, _RENEWED_WEIGHTS, _SHIFTS = (-3.7, -1.2), (3.5, 6.0), (-1.5, 0.0)
# Points are kept anew, as those that are renewed are of few basins, until this many populations,
# and ladders, ended at the best cost; each lasts until this part of the patience is over.
_AGREEING, _REPEATS, _PART_OF_PATIENCE = 2, 8, 0.375
_MOST_BENDS = 6  # of a smooth start
_RENEWED_PART = 0.7  # of all climbs after the first starts


class StagedProgram:
    """A program with complementarities as rows λ s = ε, after all other rows.

    Attributes:
        program: as it was read, without presolve.
        complementarities: those of its rows.
        nlp: costs and rows over y, with ε as small as an answer has to have it.
    """

    def __init__(self, program: AigoProgram, feasibility: float) -> None:
        """Looks for complementarities.

        Args:
            program: as it was read.
            feasibility: largest violation of a row in an answer.
        """
        self.program = program
        self.complementarities = complementarity.find_complementarities(program)
        self._least = _PART_OF_FEASIBILITY * feasibility
        rows = [
            each.product_row(constant(-max(self._least, each.allowed)))
            for each in self.complementarities
        ]
        self.nlp = self._with_rows(rows, [])

    @property
    def relaxed(self) -> Ints:
        """Numbers of the rows of `nlp` that are complementarities."""
        last = self.nlp.num_rows
        return np.arange(last - len(self.complementarities), last)

    @cached_property
    def is_upper(self) -> Bools:
        """Whether rows of `nlp` are λ s ≤ ε: of complementarities that share a side (m,)."""
        found = np.zeros(self.nlp.num_rows, dtype=bool)
        found[self.relaxed] = complementarity.are_shared(self.complementarities)
        return found

    @cached_property
    def tightened(self) -> complementarity.TightenedProgram | None:
        """The program for interior points, if complementarities share sides."""
        if not np.any(self.is_upper):
            return None
        return complementarity.TightenedProgram(self._with_rows([], []), self.complementarities)

    def polish(self, y: Floats, max_steps: int) -> LocalResult:
        """Returns an optimum for the smallest ε from a point y (n,) that is nearly feasible."""
        local = InteriorPoint.warm(max_iterations=max_steps)
        if self.tightened is None:
            return local.solve(self.nlp, y)
        return self.tightened.solve(local, y, self._least)

    @cached_property
    def tables(self) -> PenaltyTables:
        """Tables of `nlp` that penalty ladders read."""
        return make_penalty_tables(self.nlp)

    @cached_property
    def _is_chain(self) -> bool:
        """Whether this is a chain of stages: its band is narrow beside its length."""
        if self.nlp.num_variables < _FEW or not self.program.parsed.rows:
            return False
        return bool(self.tables.size >= max(_FEW, _LEAST_LENGTH * self.tables.bandwidth))

    @cached_property
    def is_worth_ladders(self) -> bool:
        """Whether there are complementarities, or a chain linked by rows, and steps are quick."""
        num_equalities = self.nlp.num_rows - len(self.program.slack_rows)
        if not self.complementarities and not (
            self._is_chain and num_equalities >= _LEAST_EQUALITIES * self.tables.size
        ):
            return False
        return self.tables.size * self.tables.bandwidth**2 <= _MOST_WORK

    @property
    def is_beyond_boxes(self) -> bool:
        """Whether ladders alone search it: it has stages with contact, which boxes average."""
        return self.is_worth_ladders and self._is_chain and bool(self.complementarities)

    def at_corners(self, y: Floats) -> PolynomialNlp:
        """Returns the program in which of each λ and s the one that is smaller at y (n,) is 0."""
        rows, held = [], []
        for each in self.complementarities:
            if each.allowed:
                rows.append(each.product_row(constant(-each.allowed)))
            elif abs(evaluate(each.gap, y)) >= abs(y[each.variable]):
                held.append(each.variable)
            else:
                rows.append(complementarity.as_row(each.gap))
        return self._with_rows(rows, held)

    def _with_rows(self, rows: list[TermBlock], held: list[int]) -> PolynomialNlp:
        """Returns the program with other rows for complementarities, and variables held at 0."""
        nlp, found = self.program.nlp, self.complementarities
        if not found:
            return nlp
        gone = {each.row for each in found}
        others, number = [], 0
        for block in nlp.blocks[len(nlp.costs) :]:
            kept = [i for i in range(len(block.variables)) if number + i not in gone]
            number += len(block.variables)
            if kept:
                others.append(TermBlock(block.name, block.terms, block.variables[kept]))
        lower, upper = nlp.lower.copy(), nlp.upper.copy()
        unused = held + [each.slack for each in found if each.slack >= 0]
        lower[unused] = upper[unused] = np.clip(0.0, lower[unused], upper[unused])
        return PolynomialNlp(nlp.num_variables, nlp.costs, (*others, *rows), lower, upper)


def find_quantities(nlp: PolynomialNlp, places: Ints) -> list[Ints]:
    """Returns variables (k,) that are one quantity each, stage after stage, by their places (n,).

    Those have the same bounds, and appear in the same terms of costs and rows.
    """
    roles: list[list[int]] = [[] for _ in range(nlp.num_variables)]
    for number, block in enumerate(nlp.blocks):
        is_cost = number < len(nlp.costs)
        for term in block.terms:
            for factor in term.factors:
                form = factor._replace(variable=0)
                role = hash((is_cost, term.coefficient, len(term.factors), form))
                for variable in block.variables[:, factor.variable].tolist():
                    roles[variable].append(role)
    found: dict[tuple[Any, ...], list[int]] = {}
    for i in np.argsort(places, kind="stable").tolist():
        key = nlp.lower[i], nlp.upper[i], *sorted(roles[i])
        found.setdefault(key, []).append(i)
    return [np.array(members) for members in found.values()]


class StagedSearch:
    """Ladders of penalties from many starts, and from renewed stretches of the best points.

    Random numbers depend on the seed alone; work is cut off by counts.

    Attributes:
        first: the box that starts are drawn from.
        climbs: number of ladders.
        repeats: number of those that ended at the cost of the best point.
        best: cost of the best point; inf if none was nearly feasible.
    """

    def __init__(
        self,
        staged: StagedProgram,
        options: AigoOptions,
        guess: Floats,
        polish: Callable[[Floats, str], Floats | None],
    ) -> None:
        """Makes the tables.

        A guess is of z, NaN where there is none. Points y that are nearly feasible, and better than
        others, are polished: to what they become, or None if that is not feasible.
        """
        self.climbs = self.repeats = self._work = 0
        self.best, self._is_tightened = np.inf, True
        self._options, self._polish = options, polish
        self._guess, self._program, self._staged = guess, staged.program, staged
        self._nlp, self._places = staged.nlp, staged.tables.places
        self.first = self._box()
        self._ladder = PenaltyLadder(
            self._nlp,
            staged.tables,
            self.first.center,
            self.first.half_width,
            staged.relaxed,
            staged.is_upper,
        )
        self._quantities = find_quantities(self._nlp, self._places)
        self._kept: list[tuple[float, Floats]] = []
        self._rng = np.random.default_rng(options.seed)

    def _box(self) -> Box:
        """Returns the box of starts: between bounds, or around the guess or a bound."""
        lower, upper = self._nlp.lower, self._nlp.upper
        guess = np.zeros(lower.size)
        guess[: self._guess.size] = np.nan_to_num(self._guess)
        reach = self._options.first_half_width * np.maximum(1.0, np.abs(guess))
        near = self._near = np.clip(guess, lower, upper)
        low = np.where(np.isfinite(lower), lower, np.minimum(near, upper - reach) - reach)
        high = np.where(np.isfinite(upper), upper, np.maximum(near, low + reach) + reach)
        return Box((low + high) / 2, (high - low) / 2)

    def run(self) -> None:
        """Goes up ladders for as long as that pays, in several populations of kept points."""
        if np.all(np.isfinite(self._guess)):
            self._climb(self._program.with_slacks(self._guess), "the guess", renewed=True)
        ends: list[float] = []
        while not ends or self._is_in_doubt(ends):
            self._kept = []
            self._evolve(are_smooth=len(ends) % 2 == 1)
            ends.append(self._kept[0][0] if self._kept else np.inf)

    def _is_in_doubt(self, ends: Sequence[float]) -> bool:
        """Returns whether too little ended at the best cost, and rounds are left."""
        if self._staged.tightened is not None or self._work >= self._options.rounds:
            return False
        num_agreeing = sum(end <= self.best + _SAME * abs(self.best) for end in ends)
        return num_agreeing < _AGREEING or self.repeats < _REPEATS

    def _evolve(self, are_smooth: bool) -> None:
        """Starts by chance, then renews the best points, until none is better for long.

        Every second population starts at smooth points, whose shape the lowest rungs would forget.
        """
        first, best, better = self._work, np.inf, self._work
        num_starts = max(1, self._options.starts)
        patience = max(1, int(_PART_OF_PATIENCE * self._options.patience))
        while self._work < self._options.rounds and (
            self._work < better + patience or np.isinf(self.best)
        ):
            is_start = not self._kept or self._work < first + num_starts
            if is_start or self._rng.random() > _RENEWED_PART:
                start = self._smooth_start() if are_smooth else self._start()
                self._climb(start, "a start by chance", renewed=are_smooth)
            else:
                self._climb(self._renewed(), "a renewed stretch", renewed=True)
            now = self._kept[0][0] if self._kept else np.inf
            if not self._kept or self._is_better(now, best):
                better = self._work
            best = min(now, best)

    def _start(self) -> Floats:
        if self.climbs == 0 and self._staged.tightened is not None:
            return self._near
        reach = self._rng.uniform(0.0, _REACH)
        return self.first.center + reach * self._shift()

    def _smooth_start(self) -> Floats:
        """Returns a point of the box whose quantities bend a few times along the stages."""
        shift = np.empty(self.first.center.size)
        for members in self._quantities:
            bends = np.linspace(0.0, 1.0, int(self._rng.integers(2, _MOST_BENDS + 1)))
            values = self._rng.uniform(-1.0, 1.0, bends.size)
            shift[members] = np.interp(np.linspace(0.0, 1.0, members.size), bends, values)
        return self.first.center + self._rng.uniform() * self.first.half_width * shift

    def _shift(self) -> Floats:
        return self.first.half_width * self._rng.uniform(-1.0, 1.0, self.first.center.size)

    def _renewed(self) -> Floats:
        """Returns one of the best points, a stretch of its stages moved."""
        rng = self._rng
        is_best = rng.random() < 0.5
        _, x = self._kept[0 if is_best else int(rng.integers(len(self._kept)))]
        size = int(np.max(self._places)) + 1
        count = max(1, size * int(rng.integers(1, 5)) // 4)
        first = int(rng.integers(-count // 2, size - count // 2))
        is_open = (self._places >= first) & (self._places < first + count)
        return np.where(is_open, x + 10 ** rng.uniform(*_SHIFTS) * self._shift(), x)

    def _climb(self, start: Floats, name: str, renewed: bool) -> None:
        """Goes up a ladder, and keeps where it ends.

        Where several complementarities share sides, interior points climb too. Mostly the way is
        chosen that led to the best point.
        """
        tightened, is_tightened = self._staged.tightened, self._is_tightened
        if tightened is not None and self.climbs and self._rng.random() < _OTHER:
            is_tightened = not is_tightened
        if tightened is not None and is_tightened:
            y = self._program.with_slacks(start)
            first = 10 ** self._rng.uniform(*(_RENEWED_TIGHTENED if renewed else _START_TIGHTENED))
            sizes = self._ladder.sizes[self._staged.relaxed]
            y, steps = tightened.tighten(y, sizes, first, renewed)
            found = self._ladder.judge(y, steps)
            self._work += _TIGHTENED_WORK
        else:
            relaxations = _RENEWED_RELAXATIONS if renewed else _START_RELAXATIONS
            weights = _RENEWED_WEIGHTS if renewed else _START_WEIGHTS
            relaxation, weight = (10 ** self._rng.uniform(*each) for each in (relaxations, weights))
            most = self.best + _TOO_COSTLY * abs(self.best)
            found = self._ladder.climb(start, relaxation, weight, most)
            self._work += 1
        self.climbs += 1
        if not found.is_nearly_feasible:
            return
        cost, x = found.cost, found.x
        if self._is_better(cost, self.best):
            polished = self._polish(x, name)
            if polished is None:
                return
            cost, x = self._nlp.evaluate(polished)[0], polished
            self._is_tightened = is_tightened
            self._ladder.scale_cost(cost)
        if self._is_better(cost, self.best):
            self.repeats = 0
        self.repeats += int(cost <= self.best + _SAME * abs(self.best) or self.repeats == 0)
        self.best = min(self.best, cost)
        if all(abs(cost - other) > _SAME * abs(other) for other, _ in self._kept):
            self._kept = sorted([*self._kept, (cost, x)], key=lambda pair: pair[0])[:_MOST_KEPT]

    @staticmethod
    def _is_better(cost: float, best: float) -> bool:
        """Whether a cost is lower by enough to count, or the first one."""
        return bool(cost < best - _SAME * abs(best) or np.isinf(best))
