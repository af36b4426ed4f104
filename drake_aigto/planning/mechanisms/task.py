"""A mechanism's task, compiled for shooting: the road's steps one by one."""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import ClassVar

import numpy as np

from drake_aigto.contact import CompliantLaw
from drake_aigto.errors import ProgramError
from drake_aigto.planning.feedback import calc_divergence
from drake_aigto.planning.mechanisms import closing
from drake_aigto.planning.mechanisms.guesses import Guess, Guesses, sample_cubic
from drake_aigto.planning.mechanisms.posed import PosedMechanism
from drake_aigto.planning.mechanisms.settling import (
    MOST_KEPT,
    MOST_RENEWED,
    find_lost,
    settle,
    steady,
)
from drake_aigto.planning.search import scaled
from drake_aigto.shooting import IMPLICIT, ShootingOptions, ShootingResult, is_implicit
from drake_aigto.world import SpaceWorld

# Price of violating bounds (relative to the state's scales) in the task's scale. As a violation may
# save more than that, motions with a larger one than `_MUCH` rank after all others.
_PRICE, _MUCH = 10.0, 1e-2
# How often multipliers of bounds are updated where a penalty leaves a violation.
_UPDATES = 3
# Horizons of more periods than this are searched at half their length first: of all tasks, and of
# those with a goal at an unstable equilibrium, where errors of whole motions grow most.
_LONG, _LONG_IF_UNSTABLE = 4.0, 1.5
# The factor by which costs fall at most as steps become shorter, which changes their order, and how
# many times as many finalists are polished for that: without friction; with it; and in space, where
# motions are ranked after few iterations. With friction, 63 finalists of 15 plans of a hopper, a
# spinner and a block that is pushed fell by 6 % at most.
_PLAIN, _SLIDING, _IN_SPACE = (1.0, 1), (1.1, 2), (2.0, 2)
# The same once contact is sharpened in the plane, in the shortest steps: these fell by 3 %.
_SHARPENED = 1.05
# Motions that promise to cost more than this times the worst kept one are left unfinished. In 3,072
# boxes around cart-poles between soft walls that saves 31 % of all iterations and loses 10 of 346
# motions that would have been the best so far; 1.0 saves 37 % and loses 13, and 1.5 22 % and 8.
_WORTH = 1.2
# With friction, motions that cost more after a pass at smoothing ε than 1 + r ε times the limit of
# the last one are left there, from a first ε on: this and r, in the plane and in space. In six
# traces of 250 closings, around discs, blocks, spinners and a hopper, that saves up to 40 % of the
# time, none around one of the spinners, and no best motion is lost. In space, in five traces of 538
# closings, it saves 23 %, and of the motions that were kept one is lost, not the best.
_TELLS, _TELLS_IN_SPACE = (0.1, 40.0), (1.0, 1000.0)
# Errors of stages that add up to more units of the state are those of contact that steps do not
# resolve. Those of the best motions after 16 renewals add up to 0.3 to 0.8 for the spinner, the
# block and the disc that a pusher goes round, and to 29 to 220 for the hopper and the planar hand.
_UNRESOLVED = 5.0


class MechanismTask(PosedMechanism):
    """A task of a mechanism between compliant walls, or of one without contacts.

    Guesses of its motion (`Guesses`) are closed by shooting (`ShootingProblem`), which is compiled
    for the world, once.
    """

    transcription_name: ClassVar[str] = "shooting"
    remedy: ClassVar[str] = "Allow more time or control, or try more renewals."

    @cached_property
    def coast(self) -> ShootingResult:
        """The uncontrolled motion."""
        return self.let_go(self.search_steps)

    @property
    def num_starts(self) -> int:
        """How many guesses are closed first."""
        return self.options.starts + 2 * len(self.guesses.sharp_starts)

    @property
    def sources(self) -> str:
        """The sources of candidates, in words."""
        return f"{self.num_starts} starts and {self.options.renewals} renewals"

    @property
    def polish_ratio(self) -> float:
        """Motions that cost more than this times the best finalist are not polished."""
        return self._falls[0]

    @property
    def finalists(self) -> int:
        """How many of the best motions are polished, at most."""
        return self.options.finalists * self._falls[1]

    @property
    def _falls(self) -> tuple[float, int]:
        """By how much costs may fall in a polish, and how many times more motions it is for."""
        if not self.mechanism.has_friction:
            return _PLAIN
        return _IN_SPACE if isinstance(self.world, SpaceWorld) else _SLIDING

    @property
    def num_limiting(self) -> int:
        """How many motions, at least, cost less than what is left unfinished.

        As many as are kept; in space as are renewed, as most of what costs more is closed
        in many steps for nothing.
        """
        return MOST_RENEWED if isinstance(self.world, SpaceWorld) else MOST_KEPT

    @property
    def close_ratio(self) -> float:
        """Motions that promise to cost more than this times a kept one are left unfinished."""
        return _WORTH

    @cached_property
    def _springs(self) -> CompliantLaw:
        """The springs that replace walls in guesses."""
        if isinstance(self.law, CompliantLaw):
            return self.law
        time_step = self.scenario.duration / self.search_steps
        return closing.soften(self.world, self.law, time_step, self.measures.speed)

    @cached_property
    def guesses(self) -> Guesses:
        """Guesses of motions."""
        problem, measures = self.shooting(self.search_steps), self.measures
        steps = self.scenario.num_steps
        return Guesses(self.world, self._springs, problem, measures, self.coast, self._total, steps)

    @property
    def _total(self) -> tuple[float, float]:
        """The least and the most that a motion may last [s]."""
        duration = self.scenario.duration
        return self.scenario.duration_range or (duration, duration)

    def shortened(self) -> MechanismTask | None:
        """Returns the task in half of the time, if the mechanism may rest in the other half.

        None where the duration is free, or no longer than a few periods of the mechanism, or hands
        push, which take their time.
        """
        scenario, step = self.scenario, self.scenario.time_step
        periods = _LONG_IF_UNSTABLE if calc_divergence(self.world, scenario) else _LONG
        is_long = scenario.duration > periods * self.measures.period
        if scenario.duration_range is not None or not is_long or "push" in self.guesses.starts:
            return None
        half = dataclasses.replace(scenario, duration=step * max(2, scenario.num_steps // 2))
        options = dataclasses.replace(self.options, renewals=self.options.renewals // 2)
        return type(self)(self.world, half, options, self._compiled)

    def read(self, guess: Guess) -> ShootingResult | None:
        """Returns the motion that a guess leads to as it is; None: it is not known."""
        if guess.known is None or not self._is_sure:
            return None
        problem = self.shooting(len(guess.controls))
        if problem.phases is not None:
            return None
        substeps, (q, v) = self._closing.substeps, self.world.split(guess.known)
        found = problem.simulate(guess.controls, substeps, order=IMPLICIT)
        try:
            cost = problem.linearize(found.controls, substeps, 0.0, guess.known, IMPLICIT).cost
        except ProgramError:
            return None
        at = np.hstack([self.world.in_tangent(q, np.zeros(1)), v])
        off = np.max(np.abs(at - np.clip(at, *problem.state_bounds)) / problem.scales)
        known = dataclasses.replace(found, states=guess.known, violation=float(off))
        return dataclasses.replace(known, cost=cost, exact_cost=cost)

    def is_known(self, motion: ShootingResult) -> bool:
        """Returns whether a motion was read: it is one of the exact law, that feedback follows."""
        is_as_guessed = motion.iterations == 0 and motion is not self.coast
        return is_as_guessed and not motion.is_left and self._is_sure

    @property
    def _is_sure(self) -> bool:
        """Whether where hands' simulation led is worth to be judged as it is."""
        return self.guesses.hurries or self.guesses.must_carry

    def close(self, guess: Guess, aim: closing.Aim) -> ShootingResult:
        """Returns the motion after a few steps from a guess, and more if its bounds ask for them.

        What a penalty leaves of a violation may be priced at many times what it costs to mend. It
        is mended where that price is more than all else: elsewhere it hardly changes an order.
        """
        found = self._close_roughly(guess, aim)
        is_off = closing.POLISH.feasibility < found.violation <= closing.HOPELESS
        is_dear = self.rank(found)[1] > scaled(2.0, found.cost)
        if not (is_off and is_dear) or self.mechanism.has_friction or not found.cost <= aim.most:
            return found
        options = dataclasses.replace(
            self._closing,
            rungs=self._closing.rungs[-1:],
            substeps=found.substeps,
            order=found.order,
            multiplier_updates=_UPDATES,
        )
        mended = self.pose_again(found).solve(found.controls, None, options, found.prices)
        return min(found, mended, key=self.rank)

    def _close_roughly(self, guess: Guess, aim: closing.Aim) -> ShootingResult:
        options = closing.begin_at(self._closing, guess.width)
        tells = None
        if self.mechanism.has_friction:
            tells = _TELLS_IN_SPACE if isinstance(self.world, SpaceWorld) else _TELLS
        options = aim.limit(options, tells)
        (*wide, last), order = options.rungs, aim.order or options.order
        if not wide or (aim.substeps <= options.substeps and order == options.order):
            substeps = max(options.substeps, aim.substeps)
            options = dataclasses.replace(options, substeps=substeps, order=order)
            return self._close_on_springs(guess, options, aim.is_patient)
        coarse = dataclasses.replace(options, rungs=tuple(wide), most_promised=wide[-1].most)
        found = self._close_on_springs(guess, coarse, aim.is_patient)
        if found.is_left or not np.isfinite(found.cost):
            return found
        fine = dataclasses.replace(options, rungs=(last,), substeps=aim.substeps, order=order)
        return self.pose_again(found).solve(found.controls, None, fine, found.prices)

    def is_coarse(self, motion: ShootingResult) -> bool:
        """Returns whether Runge-Kutta steps are too long for a motion's contacts."""
        is_known, most = self.is_known(motion), closing.MOST_SUBSTEPS
        if not self._is_sliding or is_known or motion.substeps >= most:
            return False
        return self.pose_again(motion).add_errors(motion) > _UNRESOLVED

    def refine(self, motion: ShootingResult) -> closing.Aim:
        """Returns steps that resolve a motion's contacts better: implicit ones, or half as long."""
        if self._is_stiff(motion):
            return closing.Aim(substeps=motion.substeps, order=IMPLICIT)
        return closing.Aim(substeps=2 * motion.substeps, order=motion.order)

    def _is_stiff(self, motion: ShootingResult) -> bool:
        """Returns whether explicit steps of a motion soften the friction of shapes in space."""
        return self._rubs_in_space and not is_implicit(motion.order)

    @property
    def _is_sliding(self) -> bool:
        """Whether compliant contacts slide, and no joint does."""
        is_compliant = isinstance(self.law, CompliantLaw)
        return is_compliant and self.mechanism.has_friction and self.world.dry_friction is None

    @property
    def ends_early(self) -> bool:
        """Whether closings end where costs may yet fall far: with friction in space.

        With 24 renewals, a puck costs 0.0186 at six seeds of six if kept motions are not refined
        before, as those of one strike displace all others, and 0.0014 at three if they are.
        """
        return self._rubs_in_space

    @property
    def _rubs_in_space(self) -> bool:
        return self.mechanism.has_friction and isinstance(self.world, SpaceWorld)

    @property
    def _slides_in_plane(self) -> bool:
        return self._is_sliding and not isinstance(self.world, SpaceWorld)

    @cached_property
    def _closing(self) -> ShootingOptions:
        """Options for closing guesses."""
        q, is_aimed = self.scenario.initial_position, self.scenario.hard_goal
        time_step = self.scenario.duration / self.search_steps
        options = closing.find_closing(self.world, self.law, q, time_step, is_aimed)
        if self.guesses.must_carry:  # In explicit steps friction creeps, and hands lose objects.
            options = dataclasses.replace(options, order=IMPLICIT)
        return self._resolve(options)

    @cached_property
    def _tightening(self) -> ShootingOptions:
        """Options for refining closed motions."""
        scenario = self.scenario
        tight = closing.find_tight(self.world, scenario.initial_position, scenario.time_step)
        if self._rubs_in_space:
            tight = dataclasses.replace(tight, order=IMPLICIT)
        return self._resolve(tight)

    def _resolve(self, options: ShootingOptions) -> ShootingOptions:
        """Returns options with as many Runge-Kutta steps as are asked for."""
        substeps = max(options.substeps, self.options.search_substeps)
        return dataclasses.replace(options, substeps=substeps)

    def _close_on_springs(
        self, guess: Guess, options: ShootingOptions, is_patient: bool = True
    ) -> ShootingResult:
        problem = self.shooting(self.search_steps).lasting(float(guess.times[-1]))
        if guess.start is not None:
            problem = problem.beginning_at(guess.start)
        controls, states = guess.sample(problem.knot_times)
        found = problem.solve(controls, states, options)
        if states is None or not is_patient or self.is_of_use(found):
            return found
        # Worse than no control, it has most likely diverged.
        return min(found, problem.solve(controls, states, options.wary), key=self.rank)

    def is_of_use(self, motion: ShootingResult) -> bool:
        """Returns whether a motion is better than no control, or was left unfinished."""
        return motion.is_left or self.rank(motion) < self.rank(self.coast)

    def tighten(self, motion: ShootingResult, least: float = np.inf) -> ShootingResult:
        """Returns the local optimum near a motion, in the scenario's time steps.

        As other steps change an unstable motion, its states are kept, and gaps between them are
        closed. In space, what may still cost more than the least so far after a polish is left
        unfinished.
        """
        if self.is_known(motion):
            return motion
        return self._tighten(motion, closing.FINER, np.inf, scaled(self.polish_ratio, least))

    def _tighten(
        self, motion: ShootingResult, parts: int, most: float, most_at_first: float = np.inf
    ) -> ShootingResult:
        """Does what `tighten` does, in such parts of closings' steps if sliding in a plane.

        What promises to cost more than the most is left unfinished; in space, so is what costs more
        than the most at first, after a few iterations.
        """
        problem = self.shooting(self.scenario.num_steps).starting_from(motion)
        times = problem.knot_times
        controls = motion.controls[np.searchsorted(motion.times, (times[1:] + times[:-1]) / 2) - 1]
        q, v = self.world.split(motion.states)
        states = sample_cubic(self.world, motion.times, q, v, times)
        options, substeps = self._tightening, max(self._tightening.substeps, motion.substeps)
        if self._slides_in_plane:
            steps = parts * self._closing.substeps * self.search_steps
            options, substeps = closing.SLIDING, max(substeps, -(-steps // self.scenario.num_steps))
        if self._rubs_in_space:
            first, *others = options.rungs
            rungs = first._replace(most=most_at_first), *others
            options = dataclasses.replace(options, rungs=rungs)
        options = dataclasses.replace(options, substeps=substeps, most_promised=most)
        return closing.close_gaps(problem, motion, controls, states, options)

    def polish(self, motion: ShootingResult, most: float = np.inf) -> ShootingResult:
        """Returns the local optimum near a motion, its time steps halved until they agree.

        A steady motion is refined from its controls, by steps that never raise the cost. With
        friction it may not be steady: as friction sharpens, the same controls lose contact. What
        promises to cost more than the most is left unfinished.
        """
        has_friction, num_steps = self.mechanism.has_friction, self.scenario.num_steps
        problem, is_beside = self.shooting(num_steps), bool(self.lead.any())
        if is_beside:  # It is an optimum, but ends beside a hard goal.
            motion = problem.restore(motion)
        if is_beside or self.is_known(motion):
            known = steady(self.world, self.scenario, problem.starting_from(motion), motion)
            return dataclasses.replace(known, cost=known.exact_cost)
        if self._slides_in_plane:
            motion = self._tighten(motion, closing.FINEST, scaled(_SHARPENED, most))
            if motion.is_left:
                return motion
        elif (
            len(motion.controls) < num_steps
            or motion.substeps < closing.POLISH.substeps
            or self._is_stiff(motion)
        ):
            motion = self.tighten(motion)
        if self.world.dry_friction is not None:
            # While a joint sticks, only far smoother friction has slopes that show what moves it.
            substeps = max(closing.COOLING.substeps, motion.substeps)
            cooling = dataclasses.replace(closing.COOLING, substeps=substeps)
            cooled = problem.starting_from(motion).solve(motion.controls, None, cooling)
            motion = min(motion, cooled, key=self.rank)
        if isinstance(self.world, SpaceWorld) and has_friction:
            problem = problem.starting_from(motion)
            if self.guesses.hurries and most < np.inf:  # Another one holds.
                found = steady(self.world, self.scenario, problem, motion)
                if not found.exact_cost <= find_lost(motion.cost, problem):
                    return dataclasses.replace(found, is_left=True)
            return settle(self.world, self.scenario, problem, motion, most)
        finest = closing.MOST_OF_SLIDING if self._slides_in_plane else closing.MOST_SUBSTEPS
        motion = closing.halve_steps(problem, motion, most, finest)
        is_done = motion.is_left or motion.violation > closing.HOPELESS
        if is_done or not (has_friction and np.isfinite(motion.exact_cost)):
            return motion
        return steady(self.world, self.scenario, problem.starting_from(motion), motion)

    def price(self, motion: ShootingResult) -> float:
        """Returns J of a motion, plus a price for violations of bounds and a hard goal."""
        missed = max(0.0, motion.violation - closing.POLISH.feasibility)
        return motion.cost + _PRICE * self.scales.cost * missed

    def rank(self, motion: ShootingResult) -> tuple[bool, float]:
        """Orders motions by whether their violation is large, and by their price."""
        return motion.violation > _MUCH, self.price(motion)
