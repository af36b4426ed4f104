"""Sampling controllers in MuJoCo: what they make of a task in as many CPU seconds as a plan took.

Half of the time they sample controls of the whole task, from random spreads; then they act, and at
each step sample what is left of it again, from the state that they are in. The plant is the model
that they sample in, so nothing is unknown to them. Controls are linear between eight knots.
"""

from __future__ import annotations

import importlib
import time
from typing import Any

import numpy as np

from benchmarks.mujoco_model import MujocoModel
from benchmarks.rivals import Sampler, hold_linear
from drake_aigto.arrays import Floats
from drake_aigto.shooting import ShootingProblem
from drake_aigto.world import Scenario, TaskCost, World

# Of MuJoCo's simulation, at most [s]. With 5 and 2 ms it is slower, and puck/spin fails: 10 ms are
# what samplers are given elsewhere, too (MJPC).
_STEP = 1e-2
_SHARE = 0.5  # Of the time, before they act.
_RUN = 20  # Generations from one random spread.
_WIDEST = 0.3  # The largest spread of samples on the way, in units of controls.


class MujocoTask:
    """A task in MuJoCo, and a controller of it.

    Args:
        world: in space.
        scenario: its task.
        problem: the same as one of shooting, for the bounds and units of controls.
    """

    def __init__(self, world: World, scenario: Scenario, problem: ShootingProblem) -> None:
        mujoco: Any = importlib.import_module("mujoco")
        self._roll: Any = importlib.import_module("mujoco.rollout").rollout
        self._found, self._problem = MujocoModel.of(world, scenario), problem
        self._cost, self._times = TaskCost.of(world, scenario), problem.times
        step = float(np.max(np.diff(self._times)))
        self._substeps = int(np.ceil(step / _STEP - 1e-9))
        model = self._found.model
        model.opt.timestep = step / self._substeps
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        self._data: Any = mujoco.MjData(model)
        self._found.write(self._data, scenario.initial_position, scenario.initial_velocity)
        self._whole = mujoco.mjtState.mjSTATE_FULLPHYSICS
        self._start = np.empty(mujoco.mj_stateSize(model, self._whole))
        mujoco.mj_getState(model, self._data, self._start, self._whole)

    def control(self, method: str, seconds: float) -> tuple[float, Floats]:
        """Returns the cost of a run of a method, and where it ends, q (nq,)."""
        begin, N = time.process_time(), len(self._times) - 1
        sampler = Sampler(self._problem, method)
        now = self._start
        mean = self._search(sampler, now, 0, None, begin + _SHARE * seconds)
        states, acted = [now], list[Floats]()
        for k in range(N):
            end = begin + seconds * (_SHARE + (1 - _SHARE) * (k + 1) / N)
            mean = self._search(sampler, now, k, mean, end)
            acted.append(hold_linear(self._problem, mean, N - k)[0])
            now = self._simulate(now, acted[-1][np.newaxis, np.newaxis])[0, -1]
            states.append(now)
            mean = _leave_out_first(mean, N - k)
        costs, ends = self._price(np.array(states)[np.newaxis], np.array(acted)[np.newaxis], 0)
        return float(costs[0]), ends[0]

    def _search(
        self, sampler: Sampler, now: Floats, k: int, about: Floats | None, end: float
    ) -> Floats:
        """Returns the best values from knot k on, (L, nu), about others if there are any."""
        mean, known = sampler.start()[0], np.inf
        best = mean if about is None else about
        while time.process_time() < end:
            mean, spread = sampler.start()
            if about is not None:
                mean, spread = best, np.minimum(spread, _WIDEST)
            for _ in range(_RUN):
                points = sampler.draw(mean, spread)
                costs = self._calc_costs(now, k, points)
                lowest = int(np.argmin(costs))
                if costs[lowest] < known:
                    known, best = costs[lowest], points[lowest]
                mean, spread = sampler.improve(points, costs, mean, spread)
                if time.process_time() > end:
                    break
        return best

    def _calc_costs(self, now: Floats, k: int, points: Floats) -> Floats:
        """Returns what values of controls from knot k on cost, (S,)."""
        N = len(self._times) - 1
        us = np.array([hold_linear(self._problem, each, N - k) for each in points])
        states = np.empty((len(us), N - k + 1, len(now)))
        states[:, 0], states[:, 1:] = now, self._simulate(now, us)
        costs, _ = self._price(states, us, k)
        return np.where(np.isfinite(costs), costs, np.inf)

    def _simulate(self, now: Floats, us: Floats) -> Floats:
        """Returns states at knots (S, K, …) under controls (S, K, nu)."""
        model, data = self._found.model, self._data
        held = np.repeat(us, self._substeps, axis=1)
        found, _ = self._roll(model, data, now[np.newaxis], held)
        return np.asarray(found)[:, self._substeps - 1 :: self._substeps]

    def _price(self, states: Floats, us: Floats, k: int) -> tuple[Floats, Floats]:
        """Returns costs (S,) and last positions (S, nq) of states at knots from k on."""
        model = self._found.model
        positions, velocities = np.split(states[..., 1 : 1 + model.nq + model.nv], [model.nq], -1)
        x = self._found.read(positions, velocities)
        q, v = np.split(x, [len(self._found.places)], axis=-1)
        steps, cost = np.diff(self._times[k:]), self._cost
        total = (us**2 @ cost.R) @ steps + cost.final(q[:, -1], v[:, -1])
        if cost.Q.any() or cost.Qv.any():
            still = np.zeros((*q.shape[:-1], us.shape[-1]))
            rates = cost.running(self._times[k:], q, v, still)
            total = total + (rates[:, 1:] + rates[:, :-1]) / 2 @ steps
        return total, q[:, -1]


def _leave_out_first(values: Floats, steps: int) -> Floats:
    """Returns values at knots (L, nu) of what is left after the first of some steps."""
    if steps < 2:
        return values
    shares, kept = np.linspace(0, 1, len(values)), np.linspace(1 / steps, 1, len(values))
    return np.column_stack([np.interp(kept, shares, column) for column in values.T])
