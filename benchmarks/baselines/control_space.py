"""Controls as points of a small space, and their cost on the rigid wall: what samplers search."""

from __future__ import annotations

import dataclasses

import numpy as np

from benchmarks.baselines.baseline import Recorder
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
