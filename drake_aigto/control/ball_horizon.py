"""The best motion from where balls are, between rigid walls."""

from __future__ import annotations

import copy
import dataclasses

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.control.bounces_seen import SeenBounces
from drake_aigto.control.horizon import Horizon
from drake_aigto.control.motion import Motion
from drake_aigto.control.touches_left import choose, find_left
from drake_aigto.errors import OptionsError, TrajectoryError, UnsupportedTermError
from drake_aigto.planning import (
    BallSearch,
    BallTask,
    Path,
    PlanningError,
    PlanOptions,
    make_ball_task,
)
from drake_aigto.transcription import Touch, TouchSequence
from drake_aigto.world import Scales, Scenario, World

# Iterations of the local solver after plain Newton steps: none, but where these lead to nothing.
_ITERATIONS = (0, 20)
# The same of searches, whose unlikely touches would take most of their time.
_SEARCHED = 10
# Walls may stand this part of the task's length from where they are thought to be; what they are
# thought to return counts like a bounce at this part of the task's velocity; and a bounce is seen
# between samples that are so many periods apart at most.
_OFF, _DOUBT, _RECENT = 0.2, 0.1, 4.0
# Of what they return, and of where they stand in the task's length: programs are compiled for each,
# and noise blurs them by more.
_DIGITS = 3
# So many places of walls are kept compiled.
_MOST_KEPT = 8


class BallHorizon(Horizon):
    """A task of balls between rigid walls: what has to be known of a plan is its touches.

    Each tick polishes the multi-phase problem of those that are still to come, from the last
    plan's times. Which these are, a state does not tell for sure: a bounce may come sooner or later
    than it was planned. So near a touch, or where one was just seen, the motion with it and that
    without it are polished, the likelier first, and the other where that is dearer than the last
    plan was: to have a bounce again that has been is dear, and so is to do without one.
    """

    def __init__(
        self,
        world: World,
        scenario: Scenario,
        options: PlanOptions,
        is_receding: bool,
        period: float,
    ) -> None:
        """Compiles the task.

        Args:
            world: of the balls.
            scenario: the task.
            options: of searches.
            is_receding: whether the horizon always lasts as long as the scenario, or ends with it.
            period: between ticks [s].
        """
        super().__init__(world, scenario, is_receding, scenario.num_steps)
        self._problem = make_ball_task(world, scenario, options).in_brief(_SEARCHED)
        self._period = period
        scales = Scales.of(world, scenario)
        self._length, self._doubt = scales.length, (_DOUBT * scales.velocity) ** 2
        self._bounced: int | None = None
        self._kept: dict[tuple[float, ...], BallTask] = {}

    @property
    def cost_scale(self) -> float:
        """What the way costs from rest, without a wall."""
        return self._problem.transcription.cost_scale()

    def is_inside(self, x: Floats) -> bool:
        """Returns whether a wall is touched: how fast a ball is there, no rigid wall tells."""
        return bool(np.any(self.world.calc_clearance(np.split(x, 2)[0]) <= 0))

    @property
    def restitution(self) -> float:
        """The scenario's, or what was learned."""
        return self.scenario.restitution

    def watch(
        self, seen: SeenBounces, samples: tuple[Floats, Floats], elapsed: float, control: Floats
    ) -> SeenBounces:
        """Returns what is seen of bounces by now."""
        off = _OFF * self._length
        if elapsed <= _RECENT * self._period:
            seen = seen.watch(self.world, samples, elapsed, control, off)
        else:
            seen = dataclasses.replace(seen, latest=None)
        return seen.pass_walls(self.world, np.split(samples[1], 2)[0], off)

    def knowing(self, seen: SeenBounces) -> BallHorizon:
        """Returns the same task between walls that return what was seen, and stand there."""
        if seen == SeenBounces():
            return self
        learned = copy.copy(self)
        learned._bounced = seen.latest
        if seen.squares:
            e = round(seen.find_restitution(self.restitution, self._doubt), _DIGITS)
            learned.scenario = dataclasses.replace(self.scenario, restitution=e)
        places = tuple(round(each / self._length, _DIGITS) for each in seen.nearer)
        if any(places):
            learned._problem = self._move_walls(places)
            learned.world = learned._problem.world
        return learned

    def _move_walls(self, places: tuple[float, ...]) -> BallTask:
        """Returns the problem with walls nearer by these parts of the task's length."""
        if places not in self._kept:
            if len(self._kept) >= _MOST_KEPT:
                del self._kept[next(iter(self._kept))]
            # Nobody simulates its diagram, where walls are as they were.
            moved = self.world.with_walls_nearer(self._length * np.array(places))
            self._kept[places] = self._problem.in_world(moved)
        return self._kept[places]

    def _pose(self, now: float, x: Floats) -> BallTask:
        """Returns the task from a state on."""
        left = self.end(now) - now
        changed = dataclasses.replace(
            self.scenario,
            initial_position=x[: self.world.num_positions],
            initial_velocity=x[self.world.num_positions :],
            duration=left,
            time_step=left / self._num_steps,
        )
        return self._problem.again(changed)

    def advance(self, motion: Motion, now: float, x: Floats) -> Motion | None:
        """Returns the best polished motion of the touches that may be left; None if none is."""
        problem, path = self._pose(now, x), self._find_path(motion, now, x)
        rates, left = self.world.calc_contact_rate(*np.split(x, 2)), self.end(now) - now
        left_over = find_left(motion.touches, now, left, self._period, rates, self._bounced)
        sequences = [each for each in left_over if problem.fits(each)]
        for most in _ITERATIONS:
            tried = (_polish(problem, path, touches, most) for touches in sequences)
            if found := choose(tried, motion.cost):
                return _move(found, now)
        return None

    @staticmethod
    def _find_path(motion: Motion, now: float, x: Floats) -> Path:
        """Returns where a motion goes from now on, from a state."""
        last = motion.trajectory
        is_later = last.times > now
        times = np.append(0.0, last.times[is_later] - now)
        return times, np.vstack([x[: x.size // 2], last.positions[is_later]])

    def search(self, now: float, x: Floats) -> Motion | None:
        """Returns the best motion that boxes, neighbors and polishes lead to; None if none."""
        search = BallSearch(self._pose(now, x))
        try:
            search.run()
            best = search.find_best()
        except PlanningError:
            return None
        if search.is_interrupted:
            raise KeyboardInterrupt
        if not best.is_confirmed:
            return None
        touches = tuple(Touch(each.time, each.last_time, each.index) for each in best.contacts)
        return _move(Motion(best.trajectory, best.cost, touches), now)


def _polish(
    problem: BallTask, path: Path, touches: TouchSequence, max_iterations: int
) -> Motion | None:
    """Returns the local optimum with these touches; None if no motion has them, or none is met."""
    try:
        solved = problem.follow(path, touches, max_iterations)
    except (OptionsError, TrajectoryError, UnsupportedTermError):
        return None
    if solved is None:
        return None
    phases, x = solved
    return Motion(phases.trajectory(x), problem.cost(phases, x), phases.contact_sequence(x))


def _move(motion: Motion, now: float) -> Motion:
    """Returns a motion from time 0 on as one from now on."""
    touches = (Touch(each.start + now, each.end + now, each.contact) for each in motion.touches)
    return Motion(motion.trajectory.later(now), motion.cost, tuple(touches))
