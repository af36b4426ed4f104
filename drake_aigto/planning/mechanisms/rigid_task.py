"""A mechanism's task between rigid walls: first on springs, then in phases that meet at walls."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from functools import cached_property

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.planning.candidate import ChangeName
from drake_aigto.planning.mechanisms.closing import COARSE, Aim, begin_at
from drake_aigto.planning.mechanisms.guesses import Guess
from drake_aigto.planning.mechanisms.phased_task import (
    FINE,
    SLOW,
    Dip,
    PhasedTask,
    find_deepest,
    find_grazes,
    find_lacks,
    read_touches,
)
from drake_aigto.planning.mechanisms.task import MechanismTask
from drake_aigto.planning.mechanisms.touches import (
    NEAR,
    find_neighbors,
    lead_over_edges,
    read_replay,
    rests_early,
    switch_modes,
    with_dip,
)
from drake_aigto.planning.options import PlanOptions
from drake_aigto.planning.search import scaled
from drake_aigto.planning.sequence_search import swapped
from drake_aigto.shooting import ShootingOptions, ShootingResult, Smoothing
from drake_aigto.simulation import replay_event_driven
from drake_aigto.transcription import NO_ADDITIONS, Additions, TouchSequence
from drake_aigto.world import Scenario, World

# A bounce is added where a motion penetrates a wall between knots by this part of the task's
# length, and how often at most.
_DEEP, _MOST_ADDED = 1e-2, 4
# Bounces this near each other, as a part of the duration, are as near as phases may be.
_AT_ONCE = 2e-3
# Clearance of walls, as a part of the task's length; how often knots are lifted for it at most.
_MARGIN, _MOST_LIFTS = 1e-4, 6
# How often modes of touches with friction are changed at their edges, at most.
_MOST_SWITCHED = 3
_UNPOLISHED = 1.2  # A polish may lower costs by up to this factor.
# A polish that raised the cost by more than this factor ended at another optimum; while walls are
# cleared, and met to rounding, it falls by up to the second.
_OTHER, _UNSETTLED = 1.01, 1.01
# Bounces at the lowest speed that phases allow, to rounding, would rather be slower: they graze.
_GRAZING = 1.001
_COARSE = ShootingOptions(rungs=(Smoothing(0.0, 40, 1e-3),), multiplier_updates=4)
_FIRST = dataclasses.replace(_COARSE, multiplier_updates=0)
# With friction, motions that cost more than this times the best are left unfinished. Of 185
# neighbors in a shot with spin, no such one led to a better motion; they took 3/4 of the time.
_HOPELESS = 3.0


class RigidMechanismTask(PhasedTask):
    """A task of a mechanism between rigid walls.

    The first shooting has springs in place of the walls (`soften`). The touches of that motion are
    read off, and shooting continues in phases that meet there (`Phases`), at knots with free times.
    """

    @property
    def _falls(self) -> tuple[float, int]:
        """By how much costs may fall in a polish, and how many times more motions it is for."""
        return _UNPOLISHED, 1

    @property
    def num_limiting(self) -> int:
        """One: the best, as costs there tell early."""
        return 1

    @property
    def close_ratio(self) -> float:
        """Motions that cost more than this times the best are left unfinished."""
        return _HOPELESS if self.rigid_law.has_friction else self.polish_ratio

    def close(self, guess: Guess, aim: Aim) -> ShootingResult:
        """Returns the motion on rigid walls near a guess, closed on springs or as it is.

        Args:
            guess: the guess.
            aim: of its `most` see `bounce`.
        """
        soft = self._close_on_springs(guess, begin_at(COARSE, guess.width))
        touches = read_touches(self.world, self.rigid_law, soft, self.lasting)
        found = [self.bounce(touches, soft, aim.most)]
        controls, states = guess.sample(soft.times)
        if (self._sinks_in or guess.touches is not None) and states is not None:
            shown = dataclasses.replace(soft, states=states, controls=controls)
            touches = guess.touches or read_touches(self.world, self.rigid_law, shown, self.lasting)
            found.append(self.bounce(touches, shown, aim.most))
        return min(found, key=self.rank)

    @cached_property
    def _sinks_in(self) -> bool:
        return rests_early(self.world, self.rigid_law, self.scenario)

    @cached_property
    def lasting(self) -> Floats:
        """The shortest touch of a spring that is sustained on a wall, shape (m,) [s].

        With zero restitution, any is; else twice the time in which a spring reverses a velocity.
        """
        time_step = self.scenario.duration / self.search_steps
        return np.where(self.rigid_law.restitution == 0, 0.0, 2 * np.pi * time_step)

    def bounce(
        self, touches: TouchSequence, guess: ShootingResult | None, most: float = np.inf
    ) -> ShootingResult:
        """Returns a motion with these touches after a few steps from another, or from no control.

        A bounce is added where it penetrates a wall deeply between knots. Bounces off two walls at
        once change their order, and touches with friction their modes, if that is better. A motion
        that costs more than the most before its bounds hold is returned as it is.
        """
        tried = list[ShootingResult]()
        for _ in range(1 + _MOST_ADDED):
            motion = self.with_depth(self._close_phases(touches, guess, most))
            if motion.is_left or motion.cost > most:
                return min([*tried, motion], key=self.rank)
            dip = find_deepest(self.world, motion) if np.isfinite(motion.cost) else None
            tried.append(motion)
            is_full = len(motion.phases.knots) + 1 >= self.search_steps
            if dip is None or dip.depth < _DEEP * self.measures.length or is_full:
                break
            guess, touches = motion, self.with_dip(motion, dip)
        ends = [min(tried, key=self.rank)]
        if self._has_corners and ends[0] is not tried[0]:
            ends.append(tried[0])
        return self._switch(min(map(self._lift, ends), key=self.rank))

    def _lift(self, motion: ShootingResult) -> ShootingResult:
        """Returns a motion, led off walls if dips into them are priced higher than it.

        Led off where it dips, it may dip beside that.
        """
        margin, lifted = _MARGIN * self.measures.length, motion
        clearances = np.zeros((len(motion.times), self.world.num_contacts))
        for _ in range(_MOST_LIFTS if self._has_corners else 1):
            if not np.isfinite(lifted.cost) or self.price(lifted) <= 2 * lifted.cost:
                break
            lacks = find_lacks(self.world, lifted, margin)
            if np.max(lacks) <= margin:
                break
            clearances = clearances + lacks
            problem = self.pose_phases(lifted.times, lifted.phases, clearances)
            lifted = self.with_depth(problem.solve(lifted.controls, None, _COARSE))
        return min(motion, lifted, key=self.rank)

    @cached_property
    def _has_corners(self) -> bool:
        """Whether motions may pass beside a wall that they dip into."""
        return any(len(faces) > 1 for faces in self.world.solids)

    def with_dip(self, motion: ShootingResult, dip: Dip) -> TouchSequence:
        """Returns the touches of a motion and its dip (`with_dip`)."""
        step = self.scenario.duration / self.search_steps
        return with_dip(self.world, self.rigid_law, motion, dip, self.lasting, step)

    def _close_phases(
        self, touches: TouchSequence, guess: ShootingResult | None, most: float
    ) -> ShootingResult:
        """Returns a motion in coarse steps, bounces that end at once in their better order."""
        N, near = self.search_steps, _AT_ONCE * self.scenario.duration
        found = self.shoot_phases(touches, guess, N, _COARSE, most)
        if found.is_left or found.cost > most or not swapped(found.touches, near):
            return found
        # Penalties of an order that does not fit only grow: the first pass has none of this yet.
        best = self.shoot_phases(touches, guess, N, _FIRST)
        while orders := swapped(best.touches, near):
            others = [self.shoot_phases(each, best, N, _FIRST, rolls=True) for each in orders]
            if not (other := min(others, key=lambda each: each.cost)).cost < best.cost:
                break
            best = other
        ordered = self.shoot_phases(best.touches, best, N, _COARSE, most, rolls=True)
        return min(found, ordered, key=self.rank)

    def _switch(self, motion: ShootingResult) -> ShootingResult:
        """Returns the best motion found by switching modes of touches at their edges."""
        may_switch = self.rigid_law.has_friction and np.isfinite(motion.cost)
        for _ in range(_MOST_SWITCHED * may_switch):
            world, law = self.world, self.rigid_law
            touches = switch_modes(world, law, motion) or lead_over_edges(world, law, motion)
            if touches is None:
                break
            other = self.with_depth(self.shoot_phases(touches, motion, self.search_steps, _COARSE))
            if not self.rank(other) < self.rank(motion):
                break
            motion = other
        return motion

    @cached_property
    def coasting(self) -> TouchSequence:
        """The touches of the uncontrolled motion; sustained ones last until the next."""
        idle = self.idle_motion
        times = self._end_exactly(idle.times)
        replay = replay_event_driven(self.world, self.scenario, times, idle.controls)
        return read_replay(self.world, self.rigid_law, replay, self.lasting)

    def find_neighbors(self, motion: ShootingResult) -> Iterator[tuple[ChangeName, TouchSequence]]:
        """Yields sequences of touches near a motion's, and how they differ."""
        law, near = self.rigid_law, NEAR * self.scenario.duration
        yield from find_neighbors(self.world, law, motion, self.lasting, near)

    def tighten(self, motion: ShootingResult, least: float = np.inf) -> ShootingResult:
        """Returns a motion as it is: in phases, few steps err little."""
        return motion

    def polish(self, motion: ShootingResult, most: float = np.inf) -> ShootingResult:
        """Returns the local optimum near a motion in phases, in the scenario's time steps.

        Grazed walls are passed at a small distance instead, also between knots: a graze changes the
        motion with the square root of any error. What promises to cost more than the most is left
        before it clears its walls, or meets them to rounding.
        """
        num_steps = self.scenario.num_steps
        motion = dataclasses.replace(motion, is_left=False)  # The search left it, not the polish.
        touches = self._drop_grazes(motion)
        is_as_is = len(touches) == len(motion.touches) and len(motion.controls) == num_steps
        limit = scaled(_UNSETTLED, most)
        first = motion if is_as_is else self.shoot_phases(touches, motion, num_steps, FINE, limit)
        found = self.with_depth(self.refine_phases(first, most=limit))
        clearances = self._no_clearances(found)
        if self._has_corners and not found.is_left:  # It may only have cut one.
            found, clearances = self._clear(found, clearances)
        found, clearances = self._pass_grazes(found, clearances, limit)
        promised = self.price(motion)
        if scaled(_OTHER, promised) < self.price(found) and promised < most:
            # That is another optimum, because of other steps or of a graze left out.
            others = self._polish_otherwise(motion, touches, is_as_is, limit)
            best = min((found, *others), key=lambda each: (each.is_left, self.rank(each)))
            if best is not found:
                found, clearances = best, self._no_clearances(best)
        if found.is_left or found.cost > limit:
            return found
        found, clearances = self._clear(found, clearances)
        return self.with_depth(self.settle_phases(found, clearances, most))

    def _pass_grazes(
        self, found: ShootingResult, clearances: Floats, limit: float
    ) -> tuple[ShootingResult, Floats]:
        """Returns a refined motion without grazes, with its clearances, or as it is."""
        touches = self._drop_grazes(found)
        if len(touches) == len(found.touches):
            return found, clearances
        passing = self.shoot_phases(touches, found, self.scenario.num_steps, FINE, limit)
        passing = self.with_depth(self.refine_phases(passing, most=limit))
        passing, lifts = self._clear(passing, self._no_clearances(passing))
        is_near = self.price(passing) <= scaled(_OTHER, self.price(found))
        return (passing, lifts) if is_near else (found, clearances)

    def _polish_otherwise(
        self, motion: ShootingResult, touches: TouchSequence, is_as_is: bool, limit: float
    ) -> Iterator[ShootingResult]:
        """Yields a motion refined as it is, if that is new, and if need be in cautious steps.

        Those are for its touches without grazes, where the first costs more than it promised.
        """
        cost = np.inf
        if not is_as_is:
            same = self.with_depth(self.refine_phases(motion, most=limit))
            cost = self.price(same)
            yield same
        if scaled(_OTHER, self.price(motion)) < cost:
            steps = self.scenario.num_steps
            wary = self.shoot_phases(touches, motion, steps, FINE.wary, limit)
            yield self.with_depth(self.refine_phases(wary, is_wary=True, most=limit))

    def _drop_grazes(self, motion: ShootingResult) -> TouchSequence:
        """Returns the touches of a motion without its grazes."""
        grazes = find_grazes(self.world, motion, _GRAZING * SLOW * self.measures.speed)
        return tuple(each for i, each in enumerate(motion.touches) if i not in grazes)

    def _no_clearances(self, motion: ShootingResult) -> Floats:
        return np.zeros((len(motion.times), self.world.num_contacts))

    def _clear(self, found: ShootingResult, clearances: Floats) -> tuple[ShootingResult, Floats]:
        """Returns a refined motion that clears its walls between knots, and by how much at them."""
        margin = _MARGIN * self.measures.length
        for _ in range(_MOST_LIFTS):
            lacks = find_lacks(self.world, found, margin)
            if not np.isfinite(found.cost) or np.max(lacks) < margin / 2:
                break
            lifted = self.with_depth(self.refine_phases(found, clearances + lacks))
            if self.price(lifted) > scaled(_OTHER, self.price(found)):
                break
            found, clearances = lifted, clearances + lacks
        return found, clearances


def make_mechanism_task(
    world: World, scenario: Scenario, options: PlanOptions, additions: Additions = NO_ADDITIONS
) -> MechanismTask:
    """Returns a mechanism's task, between rigid walls or others."""
    is_rigid = scenario.contact == "rigid" and bool(world.contacts)
    kind = RigidMechanismTask if is_rigid else MechanismTask
    return kind(world, scenario, options, additions=additions)
