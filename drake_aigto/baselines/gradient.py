"""Gradient solvers without AIGO: from zero and from random guesses (AIGTO Sec. IV's comparison)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from drake_aigto.planning.literal import LiteralProblem
from drake_aigto.planning.plan import Candidate

if TYPE_CHECKING:
    import numpy.typing as npt


def gradient_from_zero(problem: LiteralProblem) -> Candidate:
    """Returns what the problem's local solver makes of a guess of zeros."""
    start = np.zeros(problem.transcription.prog().num_vars())
    return _run(problem, "zero", start)


def gradient_from_random(problem: LiteralProblem, generator: np.random.Generator) -> Candidate:
    """Returns what the local solver makes of a guess, uniform over the first box of AIGO."""
    box = problem.box
    start = generator.uniform(box.center - box.half_width, box.center + box.half_width)
    return _run(problem, "random", start)


def _run(problem: LiteralProblem, origin: str, start: npt.NDArray[np.float64]) -> Candidate:
    return problem.judge(origin, start, problem.transcription, problem.solve_locally(start))
