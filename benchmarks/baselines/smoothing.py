"""Randomized smoothing of the very cost that AIGO's boxes integrate in closed form."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from benchmarks.baselines.baseline import Baseline, Recorder
from benchmarks.baselines.enumeration import offer_polished
from drake_aigto.aigo import Box, Iterate
from drake_aigto.arrays import Floats
from drake_aigto.box import BoxPolynomial
from drake_aigto.planning import PlanOptions, make_ball_task

# Adam's, of the gradient and of its square (D. P. Kingma and J. Ba, 2015, but for 0.999: runs are
# short).
_BETA_1, _BETA_2 = 0.9, 0.99
_TINY = 1e-12


@dataclass(frozen=True)
class Moments:
    """What Adam carries along: means of the gradient and of its square, shape (n,), of k steps."""

    mean: Floats
    square: Floats
    steps: int
    generator: np.random.Generator


@dataclass(frozen=True, kw_only=True)
class GaussianSmoothing:
    """Descends a smoothed cost by sampled gradients, while the Gaussian shrinks.

        f_σ(x) = E f(x + σ D w),  w ~ N(0, I),      ∇f_σ(x) ≈ mean over samples of ∇f(x + σ D w)

    The first-order bundled gradients of H. J. T. Suh, T. Pang and R. Tedrake ("Bundled gradients
    through contact via randomized smoothing", 2022; AIGTO's [6]-[8]), with samples in pairs ±w. D
    is the half width of AIGO's first box, steps are Adam's, in units of σ D, and σ falls from 1
    geometrically. An `Algorithm`, so that it runs where AIGO's run; its box is c ± σ D.

    Attributes:
        pairs: of samples a step.
        max_steps: how often σ falls.
        last: the last σ.
        rate: of Adam, as a part of σ.
        seed: of the samples.
    """

    pairs: int = 2
    max_steps: int = 100
    last: float = 1e-2
    rate: float = 0.3
    seed: int = 0

    def init(self, f: BoxPolynomial, box: Box) -> Iterate:
        """Returns the first box."""
        zeros = np.zeros(f.num_variables)
        memory = Moments(zeros, zeros, 0, np.random.default_rng(self.seed))
        return Iterate(box, f(box.center), 1.0, memory=memory)

    def step(self, f: BoxPolynomial, iterate: Iterate) -> Iterate:
        """Takes one step of Adam, then shrinks; the temperature is σ."""
        box, moments = iterate.box, iterate.memory
        gradient = self._sample_gradient(f, box, moments.generator)
        k = moments.steps + 1
        mean = _BETA_1 * moments.mean + (1 - _BETA_1) * gradient
        square = _BETA_2 * moments.square + (1 - _BETA_2) * gradient**2
        size = np.sqrt(square / (1 - _BETA_2**k)) + _TINY
        center = box.center - self.rate * box.half_width * mean / (1 - _BETA_1**k) / size
        factor = self.last ** (1 / self.max_steps)
        return Iterate(
            Box(center, factor * box.half_width),
            f(center),
            factor * iterate.temperature,
            2 * self.pairs,
            float(np.linalg.norm(gradient)),
            Moments(mean, square, k, moments.generator),
        )

    def _sample_gradient(
        self, f: BoxPolynomial, box: Box, generator: np.random.Generator
    ) -> Floats:
        """Returns the mean of sampled gradients, shape (n,), in units of 1 / D."""
        total, point = np.zeros(f.num_variables), np.zeros(f.num_variables)
        for _ in range(self.pairs):
            offset = box.half_width * generator.standard_normal(f.num_variables)
            for x in (box.center + offset, box.center - offset):
                total += f.gradient(x, point)[1]
        return box.half_width * total / (2 * self.pairs)

    def terminate(self, f: BoxPolynomial, iterate: Iterate) -> bool:
        """Returns whether σ has passed the last one, which the number of steps sees to."""
        return False


class Smoothing(Baseline):
    """Randomized smoothing in AIGO's place: the same cost, weights and first boxes.

    One descent after another, over the rungs of the planner's ladder in turn. What is offered of
    each is its control as it is, and what a local solver makes of its end:

        "smoothing"           penalties are raised (`ProgramTask.pull`), then the rigid program
                              is solved, as the gradient baselines do but by our interior point
        "smoothing polished"  contact sequences are read off it and polished as AIGO's are

    Tried for `GaussianSmoothing`: 2 and 5 pairs; 50, 100 and 300 steps; rates 0.1, 0.3 and 1; last
    σ 1e-1, 1e-2 and 1e-3. Polished, the defaults found 6 of 8 optima in 0.3 s, other settings 0 to
    6; not polished, all found 1 or 2.
    """

    def __init__(self, is_polished: bool = False) -> None:
        """Chooses what becomes of a descent's end."""
        self.name = "smoothing polished" if is_polished else "smoothing"
        self._is_polished = is_polished

    def search(self, recorder: Recorder, generator: np.random.Generator) -> None:
        """Descends again and again."""
        question = recorder.world, recorder.scenario
        problem = solved = make_ball_task(*question)
        if not self._is_polished:
            solved = make_ball_task(*question, PlanOptions(relaxation=0.0))
        transcription = problem.transcription
        for rung in itertools.cycle(problem.ladder):
            if recorder.is_over:
                return
            seed = int(generator.integers(2**63))
            result = problem.run_aigo(rung, GaussianSmoothing(seed=seed))
            x = result.box.center
            recorder.offer(transcription.GetSampleTimes(), transcription.split(x)[2])
            if self._is_polished:
                offer_polished(recorder, problem, problem.find_sequences(result, rung), x)
            else:
                x = solved.solve_locally(problem.pull(x, rung))
                recorder.offer(transcription.GetSampleTimes(), transcription.split(x)[2])
