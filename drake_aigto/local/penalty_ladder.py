"""Local optima from anywhere: rows are penalized, first little, then ever more."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.local.nlp import PolynomialNlp
from drake_aigto.local.penalty_newton import (
    PenaltyIterate,
    PenaltyProgram,
    PenaltyRung,
    PenaltyTables,
    descend,
)

_PUSH = 1e-2  # of the distance between two bounds, or of a unit: a start's least slack
_PROBES, _REACH = 4, 0.6  # points, within this part of the box, where slopes are looked at
# Slope of a scaled cost on average, per unit; and of a relaxed row, others having 1: it counts
# more, as it is 0 on wide plains.
_COST, _RELAXED = 150.0, 5.0
# A scaled cost once a point's is known, and the largest factor from the first scale then.
_KNOWN_COST, _MOST_RESCALED = 75.0, 1e6

# Measured on the push-bot between soft walls (`benchmarks.staged_programs`): barriers of a lower
# weight, relative to ε, end at points that are not feasible.
_BARRIER = 250.0
_RELAXED_LESS, _PENALIZED_MORE = 0.3, 5.6
_STEPS, _FIRST_STEPS, _LAST_STEPS = 12, 20, 20
_ROUGH, _FINE = 1e5, 1e7  # weights
_LAST_WEIGHT, _LAST_RELAXATIONS = 1e8, (2e-5, 2e-6, 2e-7)
# A cost that is this part above the most that is of use is given up between these two weights.
_ABOVE = 0.05
# A residual of scaled rows that the last weight does not mend any more; and that of an end.
_HOPELESS, _FEASIBLE = 1e-3, 1e-4


@dataclass(frozen=True, eq=False)
class Climb:
    """End of a ladder.

    Attributes:
        x: the point (n,).
        cost: f(x).
        residual: the largest of scaled rows; inf if it was given up as it costs too much.
        steps: Newton steps.
    """

    x: Floats
    cost: float
    residual: float
    steps: int

    @property
    def is_nearly_feasible(self) -> bool:
        """Whether a polish has little left to do."""
        return self.residual <= _FEASIBLE


def rungs(relaxation: float, weight: float) -> Iterator[PenaltyRung]:
    """Yields the rungs of a ladder from a first ε, relative to the rows' variation, and weight."""
    count = _FIRST_STEPS
    while True:
        tolerance = 1e-1 if weight < _ROUGH else 1e-2
        yield PenaltyRung(relaxation, weight, _BARRIER * relaxation, count, tolerance)
        if weight >= _FINE:
            break
        weight = min(_PENALIZED_MORE * weight, _FINE)
        relaxation = max(_RELAXED_LESS * relaxation, _LAST_RELAXATIONS[0])
        count = _STEPS
    for number, last in enumerate(_LAST_RELAXATIONS):
        count = _LAST_STEPS // (1 + bool(number))
        yield PenaltyRung(last, _LAST_WEIGHT, _BARRIER * last, count, 1e-3 * 0.1**number)


class PenaltyLadder:
    """Minimizes f(x) subject to c(x) = 0, lower ≤ x ≤ upper on rungs of rising penalties.

    On each, a point that need not be near the rows is moved to a minimizer of f, a barrier of the
    bounds and the rows' augmented Lagrangian (`penalty_newton`). The lowest rungs forget most of
    where they start, and see past much of a program's nonconvexity; the highest hold the
    rows.

    Rows may be relaxed: c_i(x) = ε in place of 0, with ε → 0. Of complementarities λ s = 0 that
    makes a smooth law of a corner.

    Attributes:
        sizes: variation of rows over the box (m,).
    """

    def __init__(
        self,
        nlp: PolynomialNlp,
        tables: PenaltyTables,
        center: Floats,
        half_width: Floats,
        relaxed: Ints,
        is_upper: Bools,
    ) -> None:
        """Scales costs and rows by how steep they are over a box.

        Args:
            nlp: the program.
            tables: of it.
            center: of the box (n,).
            half_width: of the box, the units of variables (n,).
            relaxed: numbers of the rows that are relaxed.
            is_upper: rows that are to be at or below 0, or ε, in place of at it (m,).
        """
        self._nlp = nlp
        self._units = np.where(half_width > 0.0, half_width, 1.0)
        self._places = tables.places
        self._relaxed, self._tables = relaxed, tables
        self._program = PenaltyProgram(
            *(tables.places, np.array([nlp.lower, nlp.upper]), self._units),
            *(np.ones(nlp.num_rows), is_upper.copy(), 1.0),
        )
        self._scale(center, np.random.default_rng(0))

    def _scale(self, center: Floats, rng: np.random.Generator) -> None:
        """Sets the scales of the rows and of the cost."""
        structure, slopes, steepness = self._nlp.kkt_structure, np.zeros(self._nlp.num_rows), 0.0
        units = structure.join(self._units[structure.free], 1.0)
        ones, no_multipliers = np.ones(self._nlp.copy_weights.size), np.zeros(structure.rows.size)
        for _ in range(_PROBES):
            x = center + _REACH * self._units * rng.uniform(-1.0, 1.0, center.size)
            x = np.where(self._places < 0, center, x)
            gradient, matrix = structure.assemble(x, ones, no_multipliers)
            slopes[structure.rows] += structure.steepest_slopes(matrix, units) ** 2 / _PROBES
            steepness += np.sum((gradient * self._units[structure.free]) ** 2) / _PROBES
        self.sizes = np.sqrt(slopes)
        self.sizes[~(self.sizes > 0.0) | ~np.isfinite(self.sizes)] = 1.0
        scales = 1.0 / self.sizes
        scales[self._relaxed] *= _RELAXED
        cost = _COST / np.sqrt(steepness) if 0.0 < steepness < np.inf else 1.0
        self._first_scale = float(cost)
        self._program = self._program._replace(row_scales=scales, cost_scale=float(cost))

    def scale_cost(self, cost: float) -> None:
        """Scales costs anew, by that of a point that is feasible.

        Over a box, penalties that are part of a cost hide its other terms,
        which remain where they are met.
        """
        most = _MOST_RESCALED * self._first_scale
        scale = min(_KNOWN_COST / max(abs(cost), 1e-300), most)
        self._program = self._program._replace(cost_scale=max(scale, self._first_scale))

    def judge(self, x: Floats, steps: int) -> Climb:
        """Returns a point (n,) that another method found, in these steps, as the end of a climb."""
        cost, rows = self._nlp.evaluate(x)
        return Climb(x, cost, self._residual(rows), steps)

    def climb(self, start: Floats, relaxation: float, weight: float, most: float = np.inf) -> Climb:
        """Goes up a ladder, until its top or until that is hopeless.

        Args:
            start: x (n,); it is moved within the bounds.
            relaxation: first ε, relative to the rows' variation over the box.
            weight: first weight of penalties.
            most: a cost beyond which the point is of no use.
        """
        program = self._program
        lower, upper = program.bounds
        room = _PUSH * np.minimum(self._units, upper - lower)  # It is strictly within the bounds.
        x = np.where(self._places < 0, lower, np.clip(start, lower + room, upper - room))
        slacks = np.where(self._places < 0, 1.0, np.abs(x - program.bounds))
        multipliers = np.zeros(program.row_scales.size)
        iterate = PenaltyIterate(x, multipliers, _BARRIER * relaxation / slacks)
        rows, targets = np.empty(multipliers.size), np.zeros(multipliers.size)
        total, cost, residual = 0, np.inf, np.inf
        for rung in rungs(relaxation, weight):
            targets[self._relaxed] = rung.relaxation * self.sizes[self._relaxed]
            steps, cost = descend(self._tables, program, targets, rung, iterate, rows)
            total, residual = total + steps, self._residual(rows)
            above = 0.0 if rung.weight >= _FINE else _ABOVE * abs(most)
            if rung.weight >= _ROUGH and cost > most + above:
                residual = np.inf
                break
            if rung.weight == _LAST_WEIGHT and not residual <= _HOPELESS:
                break
        return Climb(iterate.x, cost, residual, total)

    def _residual(self, rows: Floats) -> float:
        """Returns the largest of scaled rows."""
        over = np.where(self._program.is_upper, np.maximum(rows, 0.0), np.abs(rows))
        return float(np.max(self._program.row_scales * over))
