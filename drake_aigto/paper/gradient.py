"""Gradient solvers from zero and from random guesses, as AIGTO Sec. IV compares itself with."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.paper.problem import LiteralProblem
from drake_aigto.planning import Candidate, Origin
from drake_aigto.transcription import Transcription


def gradient_from_zero(problem: LiteralProblem) -> Candidate:
    """Returns what the problem's local solver makes of a guess of zeros."""
    start = np.zeros(problem.transcription.prog().num_vars())
    return _run(problem, "zero", start)


def gradient_from_random(problem: LiteralProblem, generator: np.random.Generator) -> Candidate:
    """Returns what the local solver makes of a guess, uniform over the first box of AIGO."""
    return _run(problem, "random", random_guess(problem.transcription, generator))


def random_guess(transcription: Transcription, generator: np.random.Generator) -> Floats:
    """Returns all decision variables, uniform over the first box of AIGO."""
    center, half_width = transcription.initial_box()
    return generator.uniform(center - half_width, center + half_width)


def _run(problem: LiteralProblem, proposer: str, start: Floats) -> Candidate:
    x = problem.solve_locally(start)
    return problem.judge(Origin(proposer), start, problem.transcription, x)
