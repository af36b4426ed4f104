"""Sampling over controls with the rigid wall as simulator.

Settings here, and those of the other baselines, were chosen on random scenarios of the study's
ranges (starts and goals 0.2 to 1.5 m, −3 to 0.5 m/s, e of 1, 0.8 or 0.5), with NumPy's seeds 1000
to 1019 and no others.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.baselines.baseline import Baseline, Recorder
from benchmarks.baselines.control_space import ControlSpace, has_converged
from drake_aigto.arrays import Floats

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
                excess = costs - np.min(costs)
                unit = self._temperature * np.mean(excess) or 1.0  # All alike: any unit does.
                weights = np.exp(-excess / unit)
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
