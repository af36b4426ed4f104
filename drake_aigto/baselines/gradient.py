"""Gradient solvers without AIGO: from zero and from random guesses (AIGTO Sec. IV's comparison)."""

from __future__ import annotations

import numpy as np

from drake_aigto.planning.plan import Candidate
from drake_aigto.planning.problem import PlanningProblem


def gradient_from_zero(problem: PlanningProblem) -> Candidate:
    """Returns what the problem's local solver makes of a guess of zeros."""
    start = np.zeros(problem.transcription.prog().num_vars())
    return problem.judge("zero", start, problem.solve_locally(start))


def gradient_from_random(problem: PlanningProblem, generator: np.random.Generator) -> Candidate:
    """Returns what the local solver makes of a guess, uniform over the first box of AIGO."""
    box = problem.box
    start = generator.uniform(box.center - box.half_width, box.center + box.half_width)
    return problem.judge("random", start, problem.solve_locally(start))
