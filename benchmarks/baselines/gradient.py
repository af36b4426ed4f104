"""Gradient solvers without AIGO, from random guesses (AIGTO Sec. IV's comparison)."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from benchmarks.baselines.baseline import Baseline, Recorder
from drake_aigto.paper import LiteralOptions, make_literal_task, random_guess
from drake_aigto.planning import PlanOptions, ProgramTask, make_ball_task
from drake_aigto.planning.candidate import LARGEST_DEFECT
from drake_aigto.transcription.rows import largest_defect


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

    def __init__(self, solver: Literal["snopt", "ipopt"], is_literal: bool = False) -> None:
        """Chooses the solver, and whether it meets the paper's rows."""
        self.name = f"{solver} literal" if is_literal else solver
        self._solver, self._is_literal = solver, is_literal

    def search(self, recorder: Recorder, generator: np.random.Generator) -> None:
        """Solves from guess after guess."""
        problem = self._make_problem(recorder)
        transcription = problem.transcription
        while not recorder.is_over:
            x = problem.solve_locally(random_guess(transcription, generator))
            is_met = largest_defect(transcription.defects(x), problem.scales) <= LARGEST_DEFECT
            claim = transcription.scenario_cost(x) if self._is_literal and is_met else math.inf
            recorder.offer(transcription.GetSampleTimes(), transcription.split(x)[2], claim)

    def _make_problem(self, recorder: Recorder) -> ProgramTask:
        question = recorder.world, recorder.scenario
        if self._is_literal:
            return make_literal_task(*question, LiteralOptions(local_solver=self._solver))
        return make_ball_task(*question, PlanOptions(relaxation=0.0, local_solver=self._solver))
