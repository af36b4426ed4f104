"""Motions that a search keeps, and finalists under the exact law: corrected until it agrees."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats, interpolate
from drake_aigto.errors import ProgramError
from drake_aigto.planning.candidate import Origin
from drake_aigto.planning.mechanisms.closing import (
    EXACT,
    HOPELESS,
    MOST_SUBSTEPS,
    POLISH,
    close_gaps,
)
from drake_aigto.planning.search import scaled
from drake_aigto.shooting import IMPLICIT, TWO_STAGES, ShootingProblem, ShootingResult, Smoothing
from drake_aigto.simulation import EVENT_DRIVEN, Controller, Held, has_knots, replay_with
from drake_aigto.world import Scenario, SpaceWorld, World

# Motions that are kept, at most, no two near each other; and the least difference of their costs.
MOST_KEPT, _SAME = 8, 1e-3
# Every second renewal is of the best motion, the others are of one of this many.
MOST_RENEWED = 4
# Motions whose positions differ by no more than this, relative to their scales, have one optimum.
_NEAR = 0.05
# Motions that cost at most this times the best are near it, as far as a chance of better ones goes,
# if they save this part of what no control costs.
_NEARLY, _SAVED = 1.1, 0.5
# Motions that cost more than this times the best are refined only if none of the others holds: in
# space, where costs fall most, refining takes off up to 72 %, and a polish up to a half.
_FAR = 10.0


@dataclass(frozen=True, eq=False)
class KeptMotion:
    """A motion that the search keeps."""

    origin: Origin  # where it came from
    result: ShootingResult  # of shooting
    # Whether it violates bounds or a hard goal by much; J, plus a price for violations.
    rank: tuple[bool, float]
    found: int = 1  # how many searches found it that did not begin with it
    is_settled: bool = False  # whether it was refined

    def settled(self, refined: KeptMotion) -> KeptMotion:
        """Returns the motion that refining led to, or this one if that costs no less."""
        return replace(refined if refined.rank < self.rank else self, is_settled=True)

    @property
    def cost(self) -> float:
        """Its J, plus a price for violations of bounds and a hard goal."""
        return self.rank[1]


class Found(NamedTuple):
    """A motion that a search found, and the one that the search began with, if any."""

    result: ShootingResult
    parent: KeptMotion | None = None
    known: ShootingResult | None = None  # The guess itself, if it is known where it leads to.


def keep(
    motions: Sequence[KeptMotion], found: KeptMotion, parent: KeptMotion | None, scales: Floats
) -> list[KeptMotion]:
    """Returns the motions to keep, the best first, once one was found, from a parent if any.

    It is kept if it is among the best, and no better one is near by scales of positions, (nq,).
    """
    near = [known for known in motions if are_same(known, found, scales)]
    anew = parent is None or not are_same(parent, found, scales)
    times = near[0].found + anew if near else 1
    if not all(is_better(found, known) for known in near):
        near, found = near[:1], near[0]
    others = [known for known in motions if known not in near]
    return best_of([*others, replace(found, found=times)])


def best_of(motions: Sequence[KeptMotion]) -> list[KeptMotion]:
    """Returns the best motions, the best first."""
    return sorted(motions, key=lambda each: each.rank)[:MOST_KEPT]


def find_limit(motions: Sequence[KeptMotion], count: int) -> float:
    """Returns the highest cost of a count of the best motions; infinite while fewer are kept.

    Motions that violate bounds or a hard goal by much do not count.
    """
    costs = [motion.cost for motion in motions if not motion.rank[0]][:count]
    return costs[-1] if costs and len(motions) >= count else np.inf


def part_far(motions: Sequence[KeptMotion]) -> tuple[list[KeptMotion], list[KeptMotion]]:
    """Returns the motions that may become the best ones, and those that cost far more."""
    most = scaled(_FAR, motions[0].cost) if motions else 0.0
    near = [each for each in motions if each.cost <= most]
    return near, [each for each in motions if each.cost > most]


def calc_chance(motions: Sequence[KeptMotion], searches: int, idle: tuple[bool, float]) -> float:
    """Returns the estimated chance that the next search finds a motion better than all.

    Of n searches, N came near the best, and s of these found what no other did. So the next comes
    near it with N / n, finds something new there with (s + ½) / N (Good and Turing), and any of
    those N + 1 is as likely to be the best: (s + ½) / (n (N + 1)). While the best saves less than
    half of what no control costs, of the rank `idle`, how often that was found tells nothing, and
    it is 1: what starts have in common may keep them all from what matters.
    """
    misses, cost = motions[0].rank
    limit = min((misses, scaled(_NEARLY, cost)), (idle[0], idle[1] - _SAVED * abs(idle[1])))
    near = [motion.found for motion in motions if motion.rank <= limit]
    return (near.count(1) + 0.5) / (searches * (sum(near) + 1)) if near else 1.0


def is_better(motion: KeptMotion, known: KeptMotion) -> bool:
    """Returns whether a motion costs less, or as much with fewer touches.

    One optimum has many sequences, with touches that hardly push. Each touch makes it more
    likely that a simulation deviates.
    """
    costs_same = abs(motion.cost - known.cost) <= _SAME * abs(known.cost)
    fewer = len(motion.result.touches) - len(known.result.touches)
    if motion.rank[0] == known.rank[0] and costs_same and fewer:
        return fewer < 0
    return motion.rank < known.rank


def are_same(one: KeptMotion, other: KeptMotion, scales: Floats) -> bool:
    """Returns whether two motions lead to one optimum, by cost or by path.

    Args:
        one: a motion.
        other: another one.
        scales: of positions, shape (nq,).
    """
    if abs(one.cost - other.cost) <= _SAME * abs(one.cost):
        return True
    (mine, yours), n = (one.result, other.result), len(scales)
    path = yours.states[:, :n]
    if not np.array_equal(mine.times, yours.times):
        path = interpolate(mine.times, yours.times, path)
    return bool(np.max(np.abs(mine.states[:, :n] - path) / scales) < _NEAR)


# Passes of a finalist in space.
_PASSES = Smoothing(1e-4, 40, 1e-4), Smoothing(1e-6, 60, 1e-4)
# Steps are short enough where better ones lower the cost under the exact law by no more than this
# part of it, or where it is as near to that in its own. One that the law wrecks is worth better
# ones, and again while these leave no more than this part of its cost.
_FALLS, _RECOVERS = 0.01, 0.5
# Costs fall by up to this factor after the first pass in space.
_LEFT = 1.2
# Motions that cost more than this times as much in halved steps have lost contact, and are left.
_WRECKED = 10.0


class _Correcting(Controller):
    """Holds a motion's controls between knots, corrected by its gains at each."""

    def __init__(self, world: World, motion: ShootingResult, gains: Floats, bounds: Floats) -> None:
        self.start, self.end = motion.times[[0, -1]].tolist()
        self._world, self._motion, self._gains, self._bounds = world, motion, gains, bounds
        self.controls = np.array(motion.controls)

    def sample(self, time: float, x: Floats, bounces: Sequence[int]) -> Held:
        times = self._motion.times
        k = int(np.searchsorted(times, time, side="right")) - 1
        (q, v), (about, speed) = map(self._world.split, (x, self._motion.states[k]))
        off = np.concatenate([self._world.subtract(q, about), v - speed])
        answer = self._gains[k] @ off
        self.controls[k] = np.clip(self._motion.controls[k] + answer, *self._bounds)
        return Held(self.controls[k], float(times[k + 1]))


def steady(
    world: World, scenario: Scenario, problem: ShootingProblem, motion: ShootingResult
) -> ShootingResult:
    """Returns a motion near an optimum with its controls corrected under the exact law.

    Where friction sticks and slips, Runge-Kutta steps are of low order, and instability amplifies
    their errors: an error of 1e-8 becomes 1e-3 for a pole that balances for 3 s. So the motion is
    simulated again by the world's own equations, each control corrected at its knot by the gains
    about its states (`ShootingProblem.linearize`). Between compliant walls, that is what is
    returned, with its cost, so that plans promise what was integrated; else the controls of it.
    """
    steps, x, order = motion.substeps, motion.states, motion.order
    try:
        gains = problem.resolve(motion.controls, steps, x, order)[0].gains
    except ProgramError:  # Its squares exceed all numbers: nothing corrects it.
        gains = np.zeros((*motion.controls.shape, len(problem.scales)))
    controller = _Correcting(world, motion, gains, problem.control_bounds)
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

    Its states are kept, and gaps between them closed, where steps change it. These are halved until
    that lowers its cost under that law no more, or it costs as much in its steps. Where the two
    costs differ by more than the cost itself, steps get a second stage first: for an arm that
    pushes a box and a quadruped that leaps, 8 and 20 such steps between knots agree with the law to
    0.3 %, and 32 and 80 steps of one stage to 1 %. Used everywhere, they lost a cube that hands
    lift: 0.149 for 0.103. Each time contact is hardly smoothed first: with the sharp law at once, a
    drone slipped off, for 1.4. What promises to cost more than the most, after a first pass by
    `_LEFT`, is left unfinished, and so is what promises to cost more than it did in longer steps.
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
        lost = find_lost(motion.cost, problem)
        part = 1 - _FALLS if best is None or best.exact_cost <= lost else _RECOVERS
        falls = best is None or _rank_settled(found) < _rank_settled(best, part)
        if best is None or _rank_settled(found) < _rank_settled(best):
            best = found
        # To first order, the optimum in the shortest steps is as far off as this motion there.
        off = abs(found.exact_cost - motion.cost)
        is_exact = motion.is_converged and off <= _FALLS * abs(motion.cost)
        if is_exact or not falls or motion.substeps >= MOST_SUBSTEPS:
            return best
        promised = min(most, lost, np.inf if _rank_settled(best)[0] else best.exact_cost)
        rungs = tuple(each._replace(most=min(lost, scaled(_LEFT, promised))) for each in _PASSES)
        gains_stage = motion.order == IMPLICIT and off > abs(motion.cost)
        options = dataclasses.replace(
            options,
            rungs=rungs,
            order=TWO_STAGES if gains_stage else motion.order,
            substeps=motion.substeps * (1 if gains_stage else 2),
            most_promised=promised,
        )


def find_lost(cost: float, problem: ShootingProblem) -> float:
    """Returns the cost of a motion from which on it is wrecked."""
    return _WRECKED * max(cost, EXACT * problem.cost_scale)


def _rank_settled(motion: ShootingResult, times: float = 1.0) -> tuple[bool, float]:
    """Orders motions by whether they violate bounds, and by their cost, or a part of it."""
    return motion.violation > POLISH.feasibility, scaled(times, motion.exact_cost)
