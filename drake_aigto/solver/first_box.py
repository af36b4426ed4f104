"""Where AIGO starts: a box from the bounds, and from the cost's growth where there are none."""

from __future__ import annotations

import numpy as np

from drake_aigto.aigo import Box
from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.solver.options import AigoOptions
from drake_aigto.solver.program import AigoProgram
from drake_aigto.solver.ranges import sum_range
from drake_aigto.solver.tighten import Bounds, tighten
from drake_aigto.terms import FunctionKind

_LARGEST_MEAN = 1e20  # of costs or squared rows: beyond it, they hide all else
_MOST_HALVINGS = 60  # of exponentials' variables


def make_first_box(program: AigoProgram, guess: Floats, options: AigoOptions) -> Box:
    """Returns the first box over y = (z, s).

    Between two bounds, it is all that the bounds leave. Otherwise it reaches R = first_half_width ·
    max(1, |guess|) around the guess (0 where there is none), cut to the bound on one side, and R
    doubles until the cost's mean over either face that is no bound exceeds the mean over the box:

        min(F_i(c_i − w_i), F_i(c_i + w_i)) ≥ f̄    ⟺    ∂f̄/∂z_i ≥ w_i |∂f̄/∂c_i|,    z = log w

    so that what is outside is worse, on average, than what is inside. A slack gets the range of
    what it stands for, by interval arithmetic. Where exponentials make costs or squared rows
    larger than 1e20 on average, their variables' R halves, within bounds too: the search would see
    nothing else.

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
        growing = _is_growing(program, box)[:n] & is_open
        if not np.any(growing):
            break
        reach[growing] *= 2
    return _cut_exponentials(program, bounds, start, reach)


def _cut_exponentials(program: AigoProgram, bounds: Bounds, start: Floats, reach: Floats) -> Box:
    """Returns the box, smaller in exponentials' variables where that makes means usable."""
    box = whole = _box(program, bounds, start, reach)
    exponents = _exponents(program)
    for _ in range(_MOST_HALVINGS if exponents.size else 0):
        if not _overflows(program, box):
            return box
        reach = reach.copy()
        reach[exponents] = box.half_width[exponents] / 2
        box = _box(program, bounds, start, reach)
    return whole


def _exponents(program: AigoProgram) -> Ints:
    """Returns the variables x that exponentials are of."""
    found = {
        variable
        for block in (*program.costs.blocks, *program.penalties.blocks)
        for term in block.terms
        for factor in term.factors
        if factor.kind == FunctionKind.EXPONENTIAL
        for variable in block.variables[:, factor.variable].tolist()
    }
    return np.array(sorted(found), dtype=np.int64)


def _overflows(program: AigoProgram, box: Box) -> bool:
    """Returns whether costs or penalties are too large to be of use, or not finite, on average."""
    means = [f.mean(box.center, box.half_width) for f in (program.costs, program.penalties)]
    return not np.all(np.abs(means) < _LARGEST_MEAN)


def _is_growing(program: AigoProgram, box: Box) -> Bools:
    """Returns which faces have a lower mean than the box."""
    _, by_center, by_log_width = program.costs.gradient(box.center, box.half_width)
    fall = box.half_width * np.abs(by_center)
    return np.less(by_log_width, fall * (1 - 1e-12))


def _box(program: AigoProgram, bounds: Bounds, start: Floats, reach: Floats) -> Box:
    """Returns the box of x within reach of a start and within tight bounds, with its slacks."""
    lower, upper = program.nlp.lower, program.nlp.upper
    n = start.size
    low, high = np.maximum(bounds[0][:n], start - reach), np.minimum(bounds[1][:n], start + reach)
    for number, slack in enumerate(program.slacks):
        places = list(slack.variables)
        least, most = sum_range(slack.terms, low[places], high[places])
        first, last = lower[n + number], upper[n + number]
        # Where no x of the box is feasible the slack still gets some room.
        room = max(1.0, abs(first) if np.isfinite(first) else abs(last))
        low = np.append(low, first if np.isfinite(first) else min(least, last - room))
        high = np.append(high, last if np.isfinite(last) else max(most, first + room))
    low, high = (np.clip(side, *bounds) for side in (low, high))
    return Box((low + high) / 2, (high - low) / 2)
