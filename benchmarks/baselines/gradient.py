"""Gradient solvers without AIGO, from random guesses (AIGTO Sec. IV's comparison).

Contact sequences listed by hand, what `plan` never does; and polishes, as those of plans are.

Randomized smoothing of the very cost that AIGO's boxes integrate in closed form.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from benchmarks.baselines.baseline import Baseline, Recorder
from drake_aigto.aigo import Box, Iterate
from drake_aigto.arrays import Floats
from drake_aigto.box import BoxPolynomial
from drake_aigto.errors import AigtoError
from drake_aigto.paper import LiteralOptions, make_literal_task, random_guess
from drake_aigto.planning import BallTask, PlanOptions, ProgramTask, make_ball_task
from drake_aigto.transcription import Touch, TouchSequence
from drake_aigto.world import World


class GradientBaseline(Baseline):
    """A gradient solver from one random guess after another (AIGTO Sec. IV).

    A guess is uniform over AIGO's first box. In little time that is the solver from a single random
    guess, in much time multistart. Each result's control is offered, whether the solver converged
    or not.

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
            recorder.offer(transcription.GetSampleTimes(), transcription.split(x)[2])

    def _make_problem(self, recorder: Recorder) -> ProgramTask:
        question = recorder.world, recorder.scenario
        if self._is_literal:
            return make_literal_task(*question, LiteralOptions(local_solver=self._solver))
        return make_ball_task(*question, PlanOptions(relaxation=0.0, local_solver=self._solver))


_MOST_BOUNCES = 6
# At even parts s of the duration bounces are at T s^p: evenly, towards the start, towards the end.
_POWERS = (1.0, 2.0, 0.5)


class Enumeration(Baseline):
    """Every sequence of up to six bounces, at a few sets of times, polished as the planner's are.

    Polishes move the times, so that a few sets are enough. Contacts that last are not listed.
    """

    name = "enumeration"

    def search(self, recorder: Recorder, generator: np.random.Generator) -> None:
        """Goes through the list, which ends; there is no chance in it."""
        problem = make_ball_task(recorder.world, recorder.scenario)
        sequences = list_sequences(recorder.world, recorder.scenario.duration)
        offer_polished(recorder, problem, sequences, problem.box.center)


def list_sequences(world: World, duration: float) -> Iterator[TouchSequence]:
    """Yields all bounces within a duration [s] in all orders, evenly spread and shorter ones first.

    None follows itself where there are several contacts.
    """
    yield ()
    for power, number in itertools.product(_POWERS, range(1, _MOST_BOUNCES + 1)):
        times = duration * (np.arange(1, number + 1) / (number + 1)) ** power
        for contacts in itertools.product(range(world.num_contacts), repeat=number):
            repeats = any(one == other for one, other in itertools.pairwise(contacts))
            if world.num_contacts == 1 or not repeats:
                yield tuple(map(Touch.bounce, times.tolist(), contacts))


def offer_polished(
    recorder: Recorder, problem: BallTask, sequences: Iterable[TouchSequence], x: Floats
) -> None:
    """Polishes sequence after sequence of contacts until it is over, and offers the controls.

    As plans are polished: with the time steps of AIGO's boxes, and once more with the scenario's
    what is cheaper than all before. They start where the path of x goes, the problem's variables.
    """
    start = problem.transcription.GetSampleTimes(), problem.transcription.split(x)[0]
    for sequence in filter(problem.fits, sequences):
        if recorder.is_over:
            return
        cost, path = recorder.cost, start
        try:
            for num_steps in (None, recorder.scenario.num_steps):
                found = problem.polish_along(path, sequence, num_steps)
                motion = found.trajectory
                if recorder.offer(motion.times, motion.controls) >= cost:
                    break
                path, sequence = found.path, found.sequence
        except AigtoError:
            continue  # Touches that no motion has.


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
