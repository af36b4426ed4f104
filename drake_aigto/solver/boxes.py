"""Search by boxes: the first one, and costs or augmented Lagrangians, whose means they minimize."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass

import numpy as np

from drake_aigto.aigo import Box, BoxSearch, LowPoint, SearchResult
from drake_aigto.arrays import Bools, Floats
from drake_aigto.box import BoxPolynomial
from drake_aigto.linear import Storage
from drake_aigto.solver.answers import Answers
from drake_aigto.solver.details import AigoOptions
from drake_aigto.solver.program import AigoProgram
from drake_aigto.solver.ranges import Bounds, tighten
from drake_aigto.terms import FunctionKind, TermBlock

_LARGEST_MEAN = 1e20  # of costs or squared rows: beyond it, they hide all else
_MOST_HALVINGS = 60  # of exponentials' variables

# Weights of penalties Σ r², in turn, relative to the variation of the cost over the first box.
_PENALTIES = (1.0, 30.0, 1e3)
# With constraints, the last points on the way are polished too, up to this number, and only every
# second one; and this is the most renewals of all variables.
_POLISHED, _EVERY = 8, 2
_POLISHED_RENEWALS = 10
# The search at one of three weights gives up after this part of the patience.
_PATIENCE_SHARE = 6

_LOG = logging.getLogger(__name__)


def make_first_box(program: AigoProgram, guess: Floats, options: AigoOptions) -> Box:
    """Returns the first box over y = (z, s).

    Between two bounds, it is all that the bounds leave. Otherwise it reaches R = first_half_width ·
    max(1, |guess|) around the guess (0 where there is none), cut to the bound on one side, and R
    doubles until the cost's mean over either face that is no bound exceeds the mean over the box:

        min(F_i(c_i − w_i), F_i(c_i + w_i)) ≥ f̄    ⟺    ∂f̄/∂z_i ≥ w_i |∂f̄/∂c_i|,    z = log w

    so that outside points are worse, on average, than those inside. A slack gets the range of its
    row, by interval arithmetic. Where exponentials make costs or squared rows larger than 1e20 on
    average, their variables' R halves, within bounds too: the search would see nothing else.

    Args:
        program: with n variables z.
        guess: of z, shape (n,); NaN where there is none.
        options: the first reach, and how often it doubles at most.
    """
    n = guess.size
    lower, upper = program.nlp.lower, program.nlp.upper
    bounds = tighten(program.nlp)
    start = np.clip(np.where(np.isfinite(guess), guess, 0.0), *(bound[:n] for bound in bounds))
    reach = options.first_half_width * np.maximum(1.0, np.abs(start))
    is_open = np.isinf(lower[:n]) | np.isinf(upper[:n])
    reach[~is_open] = np.inf
    for _ in range(options.max_doublings):
        box = _box(program, bounds, start, reach)
        _, by_center, by_log_width = program.costs.gradient(box.center, box.half_width)
        fall = box.half_width * np.abs(by_center)
        growing = np.less(by_log_width, fall * (1 - 1e-12))[:n] & is_open
        if not np.any(growing):
            break
        reach[growing] *= 2
    return _cut_exponentials(program, bounds, start, reach)


def _cut_exponentials(program: AigoProgram, bounds: Bounds, start: Floats, reach: Floats) -> Box:
    """Returns the box, smaller in exponentials' variables where that makes means usable."""
    box = whole = _box(program, bounds, start, reach)
    exponents = sorted(
        {
            variable
            for block in (*program.costs.blocks, *program.penalties.blocks)
            for term in block.terms
            for factor in term.factors
            if factor.kind == FunctionKind.EXPONENTIAL
            for variable in block.variables[:, factor.variable].tolist()
        }
    )
    for _ in range(_MOST_HALVINGS if exponents else 0):
        means = [f.mean(box.center, box.half_width) for f in (program.costs, program.penalties)]
        if np.all(np.abs(means) < _LARGEST_MEAN):
            return box
        reach = reach.copy()
        reach[exponents] = box.half_width[exponents] / 2
        box = _box(program, bounds, start, reach)
    return whole


def _box(program: AigoProgram, bounds: Bounds, start: Floats, reach: Floats) -> Box:
    """Returns the box of x within reach of a start and within tight bounds, with its slacks."""
    lower, upper = program.nlp.lower, program.nlp.upper
    n = start.size
    low, high = np.maximum(bounds[0][:n], start - reach), np.minimum(bounds[1][:n], start + reach)
    for number, (least, most) in enumerate(program.slack_ranges(low, high), n):
        first, last = lower[number], upper[number]
        # Where no x of the box is feasible the slack still gets some room.
        room = max(1.0, abs(first) if np.isfinite(first) else abs(last))
        low = np.append(low, first if np.isfinite(first) else min(least, last - room))
        high = np.append(high, last if np.isfinite(last) else max(most, first + room))
    low, high = (np.clip(side, *bounds) for side in (low, high))
    return Box((low + high) / 2, (high - low) / 2)


@dataclass(frozen=True, eq=False)
class Outside:
    """Part of the bounds (lower, upper), some of them infinite, that is outside of a box.

    Its decade d is where the largest |z_i − c_i| / w_i of the variables without two bounds is
    between 10^(d − 1) and 10^d.
    """

    box: Box  # of half widths w around c
    lower: Floats  # shape (n,)
    upper: Floats  # shape (n,)
    is_open: Bools  # whether variables have no two bounds, shape (n,)

    def decade(self, z: Floats) -> float:
        """Returns the decade of a point (n,), as a real number: 0 or less in the box."""
        far = self.is_open
        distance = np.abs(z - self.box.center)[far] / self.box.half_width[far]
        return float(np.log10(max(1e-3, np.max(distance, initial=0.0))))

    def within(self, decade: int) -> Bounds:
        """Returns lower and upper bounds (n,) of a decade and all below."""
        reach = np.where(self.is_open, 10.0**decade, 1.0) * self.box.half_width
        low, high = self.box.center - reach, self.box.center + reach
        return np.maximum(low, self.lower), np.minimum(high, self.upper)

    def point(
        self, farthest: int, exponent: float, base: Floats | None, rng: np.random.Generator
    ) -> Floats:
        """Returns a point (n,).

        Args:
            farthest: the variable, without two bounds, that is farthest out.
            exponent: its decade, 0 or more.
            base: the others, shape (n,); None draws them: in the box, or, every second one without
                two bounds, in any decade below.
            rng: source of random numbers.
        """
        n = self.lower.size
        reach = rng.uniform(-1.0, 1.0, n)
        is_far = self.is_open & (rng.random(n) < 0.5)
        reach[is_far] = np.sign(reach[is_far]) * 10.0 ** (exponent * rng.random(n)[is_far])
        reach[farthest] = rng.choice([-1.0, 1.0]) * 10.0**exponent
        shift = reach * self.box.half_width
        ahead, back = self.box.center + shift, self.box.center - shift
        # The other way where a bound is in the way.
        z = np.where((ahead < self.lower) | (ahead > self.upper), back, ahead)
        if base is not None and np.all(np.isfinite(base)):
            z = np.where(np.arange(n) == farthest, z, base)
        return np.clip(z, self.lower, self.upper)


class AugmentedLagrangian:
    """f + λᵀr + W Σ r² of a program, whose mean over boxes is as closed as that of f.

    Multipliers start at 0 and follow the method of multipliers, λ ← λ + 2 W r at a minimizer for λ
    and W (Hestenes 1969, Powell 1969): there, constraints hold without W having to grow until f no
    longer counts. Rows have no mean of their own in a penalty; λᵀr gives each one.

    W = factor · (variation of f over the first box) / (variation of Σ r²).

    Attributes:
        multipliers: λ, shape (m,).
        is_finite: whether there is a weight: exponentials overflow where bounds let x be far out.
    """

    def __init__(self, program: AigoProgram, first: Box) -> None:
        """Joins the tables of f, r and r² once."""
        costs, penalties, nlp = program.costs, program.penalties, program.nlp
        # Copies of a row have a multiplier each. No cost's name begins as a row's does.
        copies = [
            (block, copy) for block in nlp.blocks[len(nlp.costs) :] for copy in block.variables
        ]
        linear = [
            TermBlock(f"{block.name}, multiplier {i}", block.terms, copy, weight=0.0)
            for i, (block, copy) in enumerate(copies)
        ]
        self._nlp = nlp
        self._names = tuple(block.name for block in linear)
        self._penalties = tuple(penalties.weights)
        self._merged = BoxPolynomial(
            costs.num_variables, (*costs.blocks, *penalties.blocks, *linear)
        )
        self._unit = max(_variation(costs, first), 1e-3) / max(_variation(penalties, first), 1e-12)
        self.multipliers = np.zeros(nlp.num_rows)
        self.is_finite = bool(np.isfinite(self._unit))

    def function(self, factor: float) -> BoxPolynomial:
        """Returns f + λᵀr + W Σ r²."""
        weights = dict(zip(self._names, self.multipliers.tolist(), strict=True))
        weights |= dict.fromkeys(self._penalties, factor * self._unit)
        return self._merged.with_weights(weights)

    def update(self, factor: float, y: Floats) -> None:
        """Moves the multipliers, y (n,) being a minimizer of the function of this factor."""
        _, residuals = self._nlp.evaluate(y)
        with np.errstate(invalid="ignore"):  # Rows that overflow move nothing.
            moved = self.multipliers + 2 * factor * self._unit * residuals
        if np.all(np.isfinite(moved)):
            self.multipliers = moved


def _variation(f: BoxPolynomial, box: Box) -> float:
    """Returns the largest difference of f's means between faces, or from face to middle."""
    _, by_center, by_log_width = f.gradient(box.center, box.half_width)
    differences = np.maximum(box.half_width * np.abs(by_center), np.abs(by_log_width))
    return float(np.max(differences, initial=0.0))


class BoxStage:
    """Searches by boxes, which lead to points, each of them offered and polished.

    Attributes:
        boxes: number of boxes that were shrunk.
        iterations: inner iterations of AIGO.
        widths: of the first box as it shrank, see `AigoDetails.widths`.
        storage: of Newton systems over boxes; None where no box was shrunk.
    """

    def __init__(self, answers: Answers, options: AigoOptions) -> None:
        """Starts with nothing searched."""
        self._answers, self._options = answers, options
        self.boxes = self.iterations = 0
        self.widths: list[tuple[tuple[float, ...], ...]] = []
        self.storage: Storage | None = None

    def search(self, first: Box) -> None:
        """Searches f, or with constraints the augmented Lagrangians of rising weights."""
        options, program = self._options, self._answers.program
        if not np.any(first.free):
            return
        if not program.parsed.rows:
            search = BoxSearch(rounds=options.rounds, patience=options.patience, seed=options.seed)
            self._run(search, first, program.costs, "")
            return
        lagrangian = AugmentedLagrangian(program, first)
        for number, factor in enumerate(_PENALTIES if lagrangian.is_finite else ()):
            search = BoxSearch(
                rounds=math.ceil(options.rounds / len(_PENALTIES)),
                patience=math.ceil(options.patience / _PATIENCE_SHARE),
                polished_renewals=_POLISHED_RENEWALS,
                seed=options.seed + number,
            )
            name = f", penalties {factor:g}"
            found = self._run(search, first, lagrangian.function(factor), name)
            # The least penalized cost need not lead to the least feasible one.
            for candidate in found.candidates[:-1][::-_EVERY][:_POLISHED]:
                self._answers.polish(candidate.x, name)
            lagrangian.update(factor, found.unpolished.x)

    def _run(self, search: BoxSearch, first: Box, f: BoxPolynomial, name: str) -> SearchResult:
        """Searches the first box for low points of f."""

        def look(candidate: LowPoint) -> None:
            self._answers.offer(candidate.x, f"{candidate.origin}{name}")

        self.storage = f.storage
        _LOG.info("boxes%s: %s", name, f.storage)
        found = search.run(f, first, lambda y: self._answers.polish(y, name), look)
        self.boxes += found.num_boxes
        self.iterations += found.num_steps
        self.widths.append(found.widths)
        if found.was_interrupted:
            raise KeyboardInterrupt
        return found
