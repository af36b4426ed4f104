"""The best motion from where a mechanism is, between rigid walls."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_aigto.arrays import Bools, Floats, interpolate
from drake_aigto.control.motion import Motion
from drake_aigto.control.shooting_horizon import ShootingHorizon
from drake_aigto.control.touches_left import choose, find_left, keep_apart
from drake_aigto.planning import (
    BouncingResult,
    PlanOptions,
    RigidMechanismSearch,
    RigidMechanismTask,
    find_deepest,
    lay_onto,
)
from drake_aigto.shooting import ShootingOptions, Smoothing
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import TouchSequence
from drake_aigto.world import Scenario, World

# What misses its walls, bounds or hard goal by more than this part of the scales is no motion.
_MUCH = 1e-2
# Where nothing promises more than this part of the cost, a tick ends before its iterations do.
_TOLERANCE = 1e-4
# What lies at a wall is this near to it, as a part of the task's length, and so slow, of its speed.
_AT_WALL, _STILL = 1e-4, 1e-2
# Times that differ by less than this part are the same.
_SAME = 1e-9
# A tick's iterations are run so often more, until walls are met.
_UPDATES = 4
# What is tried where these lead to nothing, and leads on from what a search finds. The last plan is
# near: steps that close gaps at any cost leave it for motions twice as dear.
_MORE = ShootingOptions(
    rungs=(Smoothing(0.0, 20, _TOLERANCE),),
    substeps=4,
    order=2,
    multiplier_updates=8,
    is_wary=True,
)


class RigidMechanismHorizon(ShootingHorizon):
    """A task of a mechanism between rigid walls: a plan is its touches, and its motion.

    A few iterations of the descent, in the phases between the touches that are still to come, lead
    from the last plan to the next (`Phases`). Which touches these are is asked as for balls. Where
    they lead into a wall, as after a kick, a bounce is added there. With friction each touch keeps
    its mode, stick or slip. What lies at a wall goes on there as long as it was planned to, in the
    modes of the last plan, but for a slip that is seen to be another.
    """

    _problem: RigidMechanismTask

    def __init__(
        self,
        world: World,
        scenario: Scenario,
        options: PlanOptions,
        is_receding: bool,
        iterations: int,
        period: float,
    ) -> None:
        """Takes the planner's world, task and options.

        Args:
            world: the mechanism.
            scenario: the task.
            options: of searches.
            is_receding: whether the horizon always lasts as long as the scenario, or ends with it.
            iterations: of a descent in a tick, at most.
            period: between ticks [s].
        """
        super().__init__(RigidMechanismTask(world, scenario, options), is_receding)
        self._period = period
        rungs = (Smoothing(0.0, iterations, _TOLERANCE),)
        self._options = dataclasses.replace(_MORE, rungs=rungs, multiplier_updates=_UPDATES)

    @property
    def restitution(self) -> float:
        """The scenario's."""
        return self.scenario.restitution

    def is_inside(self, x: Floats) -> bool:
        """Returns whether a wall is touched that nothing lies at: how fast, no rigid wall tells."""
        of_solids = self.world.are_of_one_solid @ self._lies(x)
        inside = self.world.calc_signed_distance(np.split(x, 2)[0]) <= 0
        return any(
            np.all(inside[list(faces)]) and not np.any(of_solids[list(faces)])
            for faces in self.world.solids
        )

    def _lies(self, x: Floats) -> Bools:
        """Returns which contacts lie at their walls, shape (m,)."""
        scales, (q, v) = self._problem.scales, np.split(x, 2)
        at = np.abs(self.world.calc_signed_distance(q)) <= _AT_WALL * scales.length
        rates = self.world.calc_contact_rate(q, v)
        return np.asarray(at & (np.abs(rates) <= _STILL * scales.velocity))

    def _read_slips(self, x: Floats) -> dict[int, int]:
        """Returns, of contacts that lie at their walls, the sign of the slip, 0 if they stick."""
        q, v = np.split(x, 2)
        slips = self.world.rubbing.calc_slips(q, v)
        is_still = np.abs(slips) <= _STILL * self._problem.scales.velocity
        rubs = self._problem.rigid_law.friction > 0
        signs = np.where(is_still | ~rubs, 0.0, np.sign(slips)).astype(int)
        return {int(i): int(signs[i]) for i in np.flatnonzero(self._lies(x))}

    def advance(self, motion: Motion, now: float, x: Floats) -> Motion | None:
        """Returns what a few iterations make of what is left of a motion; None if that is none."""
        motion = self._renew(motion, now, x)
        left = self._shift(motion.trajectory, now, x)
        rates = self.world.calc_contact_rate(*np.split(x, 2))
        duration, touches = float(left.times[-1]) - now, self._go_on(motion)
        slips = self._read_slips(x)
        sequences = list(find_left(touches, now, duration, self._period, rates, None, slips))
        missed = list[BouncingResult]()
        for options in (self._options, _MORE):
            tried = (self._lead(left, touches, options, missed) for touches in sequences)
            if found := choose(tried, motion.cost):
                return found
        last = missed[len(sequences) :]
        return choose((self._with_bounce(each, now) for each in last), motion.cost)

    def _go_on(self, motion: Motion) -> TouchSequence:
        """Returns the touches of a motion; what lasts to its end goes on beyond it."""
        end = (1 - _SAME) * float(motion.trajectory.times[-1])
        return tuple(
            dataclasses.replace(touch, end=np.inf) if touch.lasts and touch.end >= end else touch
            for touch in motion.touches
        )

    def _lead(
        self,
        left: Trajectory,
        touches: TouchSequence,
        options: ShootingOptions,
        tried: list[BouncingResult],
    ) -> Motion | None:
        """Returns the motion of a descent, and appends what it led to, which may be none."""
        tried.append(self._descend(left, touches, options))
        return self._read(tried[-1], float(left.times[0]))

    def _with_bounce(self, missed: BouncingResult, now: float) -> Motion | None:
        """Returns the best motion near one that misses walls, with a bounce where it is deepest."""
        dip = find_deepest(self.world, missed) if np.isfinite(missed.cost) else None
        if dip is None:
            return None
        motion = missed.as_trajectory(self.world)
        apart = keep_apart(self._problem.with_dip(missed, dip), 0.0, float(motion.times[-1]))
        return self._read(self._descend(motion.later(now), apart, _MORE), now)

    def _descend(
        self, left: Trajectory, touches: TouchSequence, options: ShootingOptions
    ) -> BouncingResult:
        """Returns the best motion near a trajectory, with touches as times after its start."""
        now, (q, v) = float(left.times[0]), (left.positions, left.velocities)
        elapsed = left.times - now
        times, phases = lay_onto(touches, elapsed, self.world.num_contacts)
        after = np.hstack([q, v + self.world.calc_velocity_change(q, left.impulses)])
        middles = (times[1:] + times[:-1]) / 2
        problem = dataclasses.replace(self._problem.pose_phases(times, phases), start=after[0])
        controls = left.controls[np.searchsorted(elapsed, middles) - 1]
        found = problem.solve(controls, interpolate(times, elapsed, after), options)
        return BouncingResult.of(found, phases)

    def _read(self, found: BouncingResult, now: float) -> Motion | None:
        """Returns a result as a motion from now on; None if it leads nowhere, or misses walls."""
        is_finite = np.isfinite(found.cost) and np.all(np.isfinite(found.states))
        if not is_finite or found.violation > _MUCH:
            return None
        touches = (
            dataclasses.replace(each, start=each.start + now, end=each.end + now)
            for each in found.touches
        )
        motion = found.as_trajectory(self.world).later(now)
        return Motion(motion, self._problem.price(found), tuple(touches))

    def search(self, now: float, x: Floats) -> Motion | None:
        """Returns the best motion that boxes, renewals and neighbors lead to; None if none."""
        problem = self._problem.again(self._ask(now, x))
        assert isinstance(problem, RigidMechanismTask)
        search = RigidMechanismSearch(problem)
        search.explore()
        if not search.motions:
            return None
        found = search.motions[0].result
        assert isinstance(found, BouncingResult)
        left = self._shift(found.as_trajectory(self.world).later(now), now, x)
        return self._read(self._descend(left, found.touches, _MORE), now)
