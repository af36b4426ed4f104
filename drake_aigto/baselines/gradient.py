"""Gradient solvers without AIGO: from zero and from random guesses (AIGTO Sec. IV's comparison)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import numpy as np

from drake_aigto.baselines.baseline import Baseline, Recorder
from drake_aigto.planning.literal import LiteralProblem
from drake_aigto.planning.options import PlanOptions, TranscriptionName
from drake_aigto.planning.origin import Origin
from drake_aigto.planning.plan import LARGEST_DEFECT, Candidate
from drake_aigto.planning.planner import make_problem
from drake_aigto.transcription import Transcription

if TYPE_CHECKING:
    import numpy.typing as npt


class GradientBaseline(Baseline):
    """A gradient solver from one random guess after another (AIGTO Sec. IV).

    A guess is uniform over AIGO's first box. In little time that is the solver from a single random
    guess, in much time multistart. Each result's control is offered, whether the solver converged
    or not; the literal program's cost is a claim if the result meets its rows.

    The rigid program is the planner's, but for its relaxed contact, which no motion meets under a
    restitution: with relaxation 1e-4 neither solver ended near an optimum once. It has the
    planner's 50 time steps: of the scenario's 200, SNOPT solves in 1 to 8 s instead of 0.05 to
    0.2 s and IPOPT in 2 to 5 s instead of 0.4 to 0.8 s, and no more of them in equal time; of 20,
    which are faster still, bounces fall so far from knots that optima cost up to three times J*.
    Neither keeps to time limits in Drake (SNOPT has none that it heeds), so the count of its
    iterations, 200, does: half of it changed nothing but the time of hopeless starts.
    """

    def __init__(self, solver: Literal["snopt", "ipopt"], kind: TranscriptionName) -> None:
        """Chooses the solver and the transcription whose rows it meets."""
        self.name = solver if kind == "rigid" else f"{solver} {kind}"
        self._options = PlanOptions(transcription=kind, relaxation=0.0, local_solver=solver)

    def search(self, recorder: Recorder, generator: np.random.Generator) -> None:
        """Solves from guess after guess."""
        problem = make_problem(recorder.world, recorder.scenario, self._options)
        transcription = problem.transcription
        is_literal = self._options.transcription == "literal"
        while not recorder.is_over:
            x = problem.solve_locally(random_guess(transcription, generator))
            is_met = max(transcription.defects(x).values()) <= LARGEST_DEFECT
            claim = transcription.scenario_cost(x) if is_literal and is_met else math.inf
            recorder.offer(transcription.GetSampleTimes(), transcription.split(x)[2], claim)


def gradient_from_zero(problem: LiteralProblem) -> Candidate:
    """Returns what the problem's local solver makes of a guess of zeros."""
    start = np.zeros(problem.transcription.prog().num_vars())
    return _run(problem, "zero", start)


def gradient_from_random(problem: LiteralProblem, generator: np.random.Generator) -> Candidate:
    """Returns what the local solver makes of a guess, uniform over the first box of AIGO."""
    return _run(problem, "random", random_guess(problem.transcription, generator))


def random_guess(
    transcription: Transcription, generator: np.random.Generator
) -> npt.NDArray[np.float64]:
    """Returns all decision variables, uniform over the first box of AIGO."""
    center, half_width = transcription.initial_box()
    return generator.uniform(center - half_width, center + half_width)


def _run(problem: LiteralProblem, proposer: str, start: npt.NDArray[np.float64]) -> Candidate:
    x = problem.solve_locally(start)
    return problem.judge(Origin(proposer), start, problem.transcription, x)
