"""Finalists under the exact law: controls corrected, and steps shortened until it agrees."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.planning.mechanisms.closing import (
    EXACT,
    HOPELESS,
    MOST_SUBSTEPS,
    POLISH,
    close_gaps,
)
from drake_aigto.planning.search import scaled
from drake_aigto.shooting import ShootingProblem, ShootingResult, Smoothing
from drake_aigto.simulation import EVENT_DRIVEN, Held, HeldControl, has_knots, replay_with
from drake_aigto.world import Scenario, SpaceWorld, World

# Passes of a finalist in space.
_PASSES = Smoothing(1e-4, 40, 1e-4), Smoothing(1e-6, 60, 1e-4)
# Steps are short enough where halving them lowers the cost under the exact law by no more than this
# part of it, or where it is as near to that in its own. One that the law wrecks is worth steps that
# are shorter by `_LEAP` at once, and again while these leave no more than this part of its cost: in
# halves, one of six finalists of quadruped/leap_up recovered.
_FALLS, _RECOVERS, _LEAP = 0.01, 0.5, 8
# Costs fall by up to this factor after the first pass in space.
_LEFT = 1.2
# Motions that cost more than this times as much in halved steps have lost contact, and are left.
_WRECKED = 10.0


class _Correcting(HeldControl):
    """Holds a motion's controls between knots, corrected by its gains at each."""

    is_open_loop = False

    def __init__(self, world: World, motion: ShootingResult, gains: Floats, bounds: Floats) -> None:
        super().__init__(motion.times, motion.controls)
        self._world, self._motion, self._gains, self._bounds = world, motion, gains, bounds
        self.controls = np.array(motion.controls)

    def sample(self, time: float, x: Floats, bounces: Sequence[int]) -> Held:
        held = super().sample(time, x, bounces)
        k = int(np.searchsorted(self._motion.times, held.until)) - 1
        (q, v), (about, speed) = map(self._world.split, (x, self._motion.states[k]))
        off = np.concatenate([self._world.subtract(q, about), v - speed])
        answer = self._gains[k] @ off
        self.controls[k] = np.clip(self._motion.controls[k] + answer, *self._bounds)
        return Held(self.controls[k], held.until)


def steady(
    world: World, scenario: Scenario, problem: ShootingProblem, motion: ShootingResult
) -> ShootingResult:
    """Returns a motion with its controls corrected under the exact law.

    Where friction sticks and slips, Runge-Kutta steps are of low order, and instability amplifies
    their errors: an error of 1e-8 becomes 1e-3 for a pole that balances for 3 s. So the motion is
    simulated again by the world's own equations, each control corrected at its knot by the gains
    about its states (`ShootingProblem.linearize`). Between compliant walls, that is what is
    returned, with its cost, so that plans promise what was integrated; else the controls of it.

    Args:
        world: the mechanism.
        scenario: the task.
        problem: that the motion is a result of.
        motion: near an optimum.
    """
    steps, x, order = motion.substeps, motion.states, motion.order
    about, _ = problem.resolve(motion.controls, steps, x, order)
    controller = _Correcting(world, motion, about.gains, problem.control_bounds)
    scenario, found = scenario.starting_at(motion.states[0]), None
    if scenario.contact == "compliant":
        found = replay_with(EVENT_DRIVEN, world, scenario, controller)
    else:
        EVENT_DRIVEN.simulate(world, scenario, controller)
    corrected = dataclasses.replace(motion, controls=controller.controls)
    # Where its cost has kinks between knots, the replay of a plan has knots there, too.
    if found is None or not has_knots(scenario, motion.times):
        return corrected
    states = np.hstack(found.states_at(motion.times))
    return dataclasses.replace(corrected, states=states, exact_cost=found.cost, replay=found)


def settle(
    world: SpaceWorld,
    scenario: Scenario,
    problem: ShootingProblem,
    motion: ShootingResult,
    most: float,
) -> ShootingResult:
    """Returns the local optimum near a motion in space, corrected under the exact law (`steady`).

    Its steps are halved until that lowers its cost under that law no more, or it costs as much in
    its steps; where that law wrecks it, they are shortened by far more. Each time contact is hardly
    smoothed first: with the sharp law at once, a drone slipped off, for 1.4.

    Args:
        world: its shapes touch with friction.
        scenario: the task.
        problem: in the motion's time steps.
        motion: whose states are kept, and gaps between them closed, where steps change it.
        most: what promises to cost more, after a first pass by `_LEFT`, is left unfinished; and so
            is what promises to cost more than it did in longer steps.
    """
    limit = scaled(_LEFT, most)
    options = dataclasses.replace(
        POLISH, rungs=_PASSES, substeps=motion.substeps, order=motion.order, most_promised=limit
    )
    best: ShootingResult | None = None
    while True:
        prices = motion.prices
        motion = close_gaps(problem, motion, motion.controls, motion.states, options, prices)
        is_finite = np.isfinite(motion.exact_cost)
        is_over = motion.is_left or motion.cost > options.most_promised or not is_finite
        if is_over or motion.violation > HOPELESS:
            return best or motion
        found = steady(world, scenario, problem, motion)
        lost = _WRECKED * max(motion.cost, EXACT * problem.cost_scale)
        part = 1 - _FALLS if best is None or best.exact_cost <= lost else _RECOVERS
        falls = best is None or _rank_settled(found) < _rank_settled(best, part)
        if best is None or _rank_settled(found) < _rank_settled(best):
            best = found
        # To first order, the optimum in the shortest steps is as far off as this motion there.
        off = abs(found.exact_cost - motion.cost)
        is_exact = motion.is_converged and off <= _FALLS * abs(motion.cost)
        if is_exact or not falls or motion.substeps >= MOST_SUBSTEPS:
            return best
        times = _LEAP if found.exact_cost > lost else 2
        while times > 2 and times * motion.substeps >= 2 * MOST_SUBSTEPS:
            times //= 2
        promised = min(most, lost, np.inf if _rank_settled(best)[0] else best.exact_cost)
        rungs = tuple(each._replace(most=min(lost, scaled(_LEFT, promised))) for each in _PASSES)
        options = dataclasses.replace(
            options, rungs=rungs, substeps=times * motion.substeps, most_promised=promised
        )


def _rank_settled(motion: ShootingResult, times: float = 1.0) -> tuple[bool, float]:
    """Orders motions by whether they violate bounds, and by their cost, or a part of it."""
    return motion.violation > POLISH.feasibility, scaled(times, motion.exact_cost)
