"""Controls as points of a small space, and their cost on the rigid wall: what samplers search.

Settings here, and those of the other baselines, were chosen on random scenarios of the study's
ranges (starts and goals 0.2 to 1.5 m, −3 to 0.5 m/s, e of 1, 0.8 or 0.5), with NumPy's seeds 1000
to 1019 and no others.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from benchmarks.baselines.baseline import Baseline, Recorder
from drake_aigto.arrays import Floats
from drake_aigto.simulation import Parabolas
from drake_aigto.transcription import RigidTranscription

# Pieces, and held steps of each: a slope over ten steps costs 1/400 less without them at most.
_PIECES, _STEPS = 3, 10
# The shortest piece, as a part of the duration.
_SHORTEST = 1e-3
# What lowers the cost by less than this part is not offered: replays take time.
_WORTHWHILE = 1e-3
# A population whose costs differ by less than this part of the least, or than this, has converged.
_RELATIVE, _ABSOLUTE = 1e-3, 1e-9


class ControlSpace:
    """Controls of three straight pieces, as points y, and what they cost.

        J(y) = w_u ∫ ‖u‖² dt + w_f ‖q(T) − goal‖²

    where q(T) is where the exactly rigid wall leads (`Parabolas`): contact is simulated, and
    nothing else has to be met. A point says how long pieces are, T_j ∝ exp(2 y_j) but for the
    shortest allowed, and each one's first and last control in units of what AIGO's first box
    reaches, so that |y_i| ≤ 1 is where AIGO looks. Pieces are ten held steps long.

    Such pieces suit samplers best. With 10 or 20 holds of equal length no control comes within 1 %
    of J* where e < 1, as its control jumps at the bounce: of 20 scenarios CMA-ES found 8 or 9 in
    1 s, with 8 holds of free length 8, with 2, 3, 4 and 6 straight pieces 18, 19, 17 and 14. Two
    pieces are what one bounce needs and do better in 0.3 s (16 to 11); but who samples does not
    know that.

    Raises:
        ModelError: flight is no parabola in this world (`World.constant_dynamics`).
    """

    def __init__(self, recorder: Recorder) -> None:
        """Reads the scale and the walls."""
        world, scenario = recorder.world, recorder.scenario
        dynamics = world.constant_dynamics
        coarse = dataclasses.replace(scenario, time_step=scenario.duration)
        transcription = RigidTranscription(world, coarse)
        self._scale = transcription.split(transcription.initial_box()[1])[2][0]
        self._recorder = recorder
        start = scenario.initial_position, scenario.initial_velocity
        times = np.linspace(0.0, scenario.duration, _PIECES * _STEPS + 1)
        self._walls = Parabolas(dynamics, world.restitutions(scenario), start, times)
        self._offered = np.inf
        self.dimension = _PIECES - 1 + 2 * _PIECES * self._scale.size

    def costs(self, points: Floats) -> Floats:
        """Returns J of points (B, dimension), shape (B,); offers the best if it is worth it."""
        scenario = self._recorder.scenario
        times, controls = self.decode(points)
        misses = self._walls.find_ends(controls, times) - scenario.goal_position
        effort = np.sum(np.diff(times) * np.sum(controls**2, axis=2), axis=1)
        found = scenario.control_weight * effort + scenario.goal_weight * np.sum(misses**2, axis=1)
        best = int(np.argmin(found))
        if found[best] < (1 - _WORTHWHILE) * self._offered:
            self._offered = found[best]
            self._recorder.offer(times[best], controls[best])
        return found

    def decode(self, points: Floats) -> tuple[Floats, Floats]:
        """Returns the knots (B, N+1) [s] and the held controls (B, N, nu) of points."""
        points = np.atleast_2d(points)
        free, ends = np.split(points, [_PIECES - 1], axis=1)
        weights = np.hstack([2 * free, np.zeros((len(points), 1))])
        weights = np.exp(weights - np.max(weights, axis=1, keepdims=True))
        shares = weights / np.sum(weights, axis=1, keepdims=True)
        T = self._recorder.scenario.duration
        steps = T * (_SHORTEST + (1 - _PIECES * _SHORTEST) * shares) / _STEPS
        times = np.zeros((len(points), _PIECES * _STEPS + 1))
        np.cumsum(np.repeat(steps, _STEPS, axis=1), axis=1, out=times[:, 1:])
        times[:, -1] = T
        first, last = ends.reshape(len(points), 2, _PIECES, 1, -1).transpose(1, 0, 2, 3, 4)
        part = ((np.arange(_STEPS) + 0.5) / _STEPS)[:, np.newaxis]
        controls = self._scale * (first + part * (last - first))
        return times, controls.reshape(len(points), _PIECES * _STEPS, -1)


def has_converged(costs: Floats) -> bool:
    """Returns whether a population's costs are so near to each other that it will find no more."""
    least = float(np.min(costs))
    return bool(np.max(costs) - least <= _RELATIVE * least + _ABSOLUTE)


def weigh(costs: Floats, temperature: float) -> Floats:
    """Returns MPPI's weights of samples, w_i = exp(-(J_i - min J) / λ); where J is infinite, 0.

    Args:
        costs: J, one at least finite.
        temperature: λ, as a part of the mean of finite J_i - min J.
    """
    excess = costs - np.min(costs)
    unit = temperature * np.mean(excess[np.isfinite(excess)]) or 1.0  # All alike: any unit does.
    return np.asarray(np.exp(-excess / unit))


# The first standard deviation of all populations: half of where AIGO looks for controls.
_SPREAD = 0.5


class CovarianceAdaptation(Baseline):
    """CMA-ES, N. Hansen's own, from one random mean after another, each time with more samples."""

    name = "cma-es"
    modules = ("cma",)

    def search(self, recorder: Recorder, generator: np.random.Generator) -> None:
        """Adapts until a population has converged, and starts again with twice its size."""
        space = ControlSpace(recorder)
        size = 4 + int(3 * np.log(space.dimension))  # The default of `cma`.
        while not recorder.is_over:
            strategy = _make_strategy(space.dimension, size, generator)
            is_done = False
            while not (is_done or strategy.stop() or recorder.is_over):
                points = strategy.ask()
                costs = space.costs(np.array(points))
                strategy.tell(points, costs.tolist())
                is_done = has_converged(costs)
            size *= 2


def _make_strategy(dimension: int, size: int, generator: np.random.Generator) -> Any:
    """Returns CMA-ES with a population of a size, from a random start."""
    import cma

    options = {
        "popsize": size,
        "randn": lambda *shape: generator.standard_normal(shape),
        "seed": np.nan,  # It is not to seed a generator of its own.
        "verbose": -9,
    }
    return cma.CMAEvolutionStrategy(generator.uniform(-1.0, 1.0, dimension), _SPREAD, options)


class CrossEntropy(Baseline):
    """The cross-entropy method: a Gaussian is fitted to the best samples, and so on.

    With all covariances, and part of the last one kept lest it collapses at once (R. Y. Rubinstein
    and D. P. Kroese, "The Cross-Entropy Method", 2004). Tried on 12 or 20 scenarios for 0.3 s: the
    best 10 of 100 with 0, 0.3, 0.5 or 0.7 of the covariance kept, 20 of 200 with 0, 0.3 or 0.5, and
    variances only. The settings here found 9 of 12, as with half kept; others 20 % to 50 %.
    """

    name = "cross-entropy"
    _samples, _elites, _kept = 200, 20, 0.3

    def search(self, recorder: Recorder, generator: np.random.Generator) -> None:
        """Fits until the elite has converged, and starts again."""
        space = ControlSpace(recorder)
        n, kept = space.dimension, self._kept
        while not recorder.is_over:
            mean, covariance = generator.uniform(-1.0, 1.0, n), _SPREAD**2 * np.eye(n)
            is_done = False
            while not (is_done or recorder.is_over):
                # Positive definite even where the elite has no extent.
                root = np.linalg.cholesky(covariance + 1e-14 * np.eye(n))
                points = mean + generator.standard_normal((self._samples, n)) @ root.T
                costs = space.costs(points)
                best = np.argsort(costs, kind="stable")[: self._elites]
                is_done = has_converged(costs[best])
                fit = np.cov(points[best], rowvar=False, bias=True)
                mean = kept * mean + (1 - kept) * np.mean(points[best], axis=0)
                covariance = kept * covariance + (1 - kept) * fit


class PathIntegral(Baseline):
    """MPPI-style: the mean moves to the samples, weighed by exp(−cost / temperature).

        y ← Σ w_i y_i,    w_i ∝ exp(−(J_i − min J) / λ),    y_i ~ N(y, σ² I)

    As for control with a model (G. Williams, A. Aldrich and E. A. Theodorou, 2017), but for a plan
    made once: λ is a part of the mean of J_i − min J, as nobody knows J beforehand, and σ shrinks,
    after which it starts again. Tried on 12 scenarios for 0.3 s: λ at 0.3, 0.1 and 0.03 of that
    mean, and shrinking by 0.9, 0.95 and 0.98. The settings here found 9, others 1 to 6.
    """

    name = "mppi"
    _samples, _temperature, _factor, _last_spread = 100, 0.03, 0.95, 1e-3

    def search(self, recorder: Recorder, generator: np.random.Generator) -> None:
        """Moves the mean while σ shrinks, and starts again."""
        space = ControlSpace(recorder)
        while not recorder.is_over:
            mean, spread = generator.uniform(-1.0, 1.0, space.dimension), _SPREAD
            while spread > self._last_spread and not recorder.is_over:
                noise = generator.standard_normal((self._samples, space.dimension))
                points = np.vstack([mean, mean + spread * noise])
                costs = space.costs(points)
                weights = weigh(costs, self._temperature)
                mean = weights @ points / np.sum(weights)
                spread *= self._factor


class DualAnnealing(Baseline):
    """SciPy's dual annealing with its own local search, L-BFGS-B by finite differences.

    Ten rounds of annealing, then anew. With 10, 100 and 1000 rounds it found 7, 5 and 5 of 12
    scenarios in 0.3 s; from a temperature of 100 instead of 5230, 6.
    """

    name = "dual annealing"
    _rounds = 10

    def search(self, recorder: Recorder, generator: np.random.Generator) -> None:
        """Anneals again and again where AIGO looks for controls."""
        from scipy.optimize import dual_annealing  # A tenth of a second, for whom it is.

        space = ControlSpace(recorder)

        def objective(point: Floats) -> float:
            if recorder.is_over:
                raise _IsOverError
            return float(space.costs(point)[0])

        bounds = [(-1.0, 1.0)] * space.dimension
        try:
            while True:
                dual_annealing(objective, bounds, maxiter=self._rounds, seed=generator)
        except _IsOverError:
            return


class _IsOverError(Exception):
    """Leaves SciPy's search from within its objective: it has no other way out at any time."""
