"""A task, asked again from where things are: what a controller that plans again goes through."""

from __future__ import annotations

import copy
import dataclasses

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.control.closers import BallCloser, Closer, CompliantCloser, RigidCloser
from drake_aigto.control.touches import PlannedMotion, SeenBounces
from drake_aigto.errors import ControlError
from drake_aigto.planning import Planner
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import Scales, Scenario

_ASKED = "the planner of a controller that plans again"
# A step of which less than this part is left is over.
_OVER = 1e-3
# Walls may stand this part of the task's length from where they are thought to be; what they are
# thought to return counts like a bounce at this part of the task's velocity; and a bounce is seen
# between samples that are at most this number of periods apart.
_OFF, _DOUBT, _RECENT = 0.2, 0.1, 4.0
# Of what they return, and of where they stand in the task's length: programs are compiled for each,
# and noise blurs them by more.
_DIGITS = 3


class Horizon:
    """A planner's task, as it is asked again from where things are.

    A motion is a plan from a state on. `advance` leads the last one to the best one near it, from
    another state; `search` finds one without. How depends on what the world is made of, which its
    closer knows (`Closer`).

    Attributes:
        world: where the task is.
        scenario: the task; its start does not count.
        is_receding: whether the horizon always lasts as long as the scenario, or ends with it.
    """

    def __init__(self, planner: Planner, is_receding: bool, iterations: int, period: float) -> None:
        """Compiles the planner's task once more: what searches in a thread shares nothing.

        Args:
            planner: of the task.
            is_receding: whether the horizon always lasts as long as the scenario, or ends with it.
            iterations: of a descent in a tick, at most.
            period: between ticks [s].

        Raises:
            ControlError: a free duration, or costs or constraints that were added: those at knots
                of a plan are at none of a motion that goes on.
        """
        _check(planner)
        self.world, self.scenario, self.is_receding = planner.world, planner.scenario, is_receding
        self._closer: Closer
        if planner.is_of_balls:
            self._closer = BallCloser(planner, period)
        elif self.scenario.contact == "rigid" and self.world.contacts:
            self._closer = RigidCloser(planner, iterations, period)
        else:
            self._closer = CompliantCloser(planner, iterations)
        self._learns, self._period = planner.is_of_balls, period
        self._scales = Scales.of(self.world, self.scenario)
        self._step = self.scenario.duration / self._closer.num_steps

    @property
    def cost_scale(self) -> float:
        """Cost of the task where all is off by its scale."""
        return self._closer.cost_scale

    @property
    def restitution(self) -> float | None:
        """Restitution that walls are planned with; None where that is no number."""
        return self.scenario.restitution if self._closer.is_rigid else None

    def end(self, now: float) -> float:
        """Returns when a horizon ends that begins now [s]."""
        return now + self.scenario.duration if self.is_receding else self.scenario.duration

    def is_over(self, now: float) -> bool:
        """Returns whether hardly anything is left of a horizon that begins now [s]."""
        return self.end(now) - now <= _OVER * self._step

    def is_inside(self, x: Floats) -> bool:
        """Returns whether a state is inside of a wall that nothing can be planned from."""
        return self._closer.is_inside(x)

    def rest(self, now: float, x: Floats) -> PlannedMotion:
        """Returns no control, as far as bounds allow, where nothing better is known."""
        count, m = self._closer.num_steps, self.world.num_contacts
        times = np.linspace(now, max(self.end(now), now + self._step), count + 1)
        q, v = (np.tile(part, (count + 1, 1)) for part in np.split(x, 2))
        none = np.zeros((count, self.world.num_actuators))
        controls = np.clip(none, *self.world.bounds(self.scenario).control)
        impulses, forces = np.zeros((count + 1, m)), np.zeros((count, m))
        return PlannedMotion(Trajectory(times, q, v, controls, impulses, forces), np.inf, ())

    def advance(self, motion: PlannedMotion, now: float, x: Floats) -> PlannedMotion | None:
        """Returns the best motion near what is left of another one; None if there is none."""
        if now >= motion.trajectory.times[-1]:  # Where it leads from there on, no plan says.
            motion = self.rest(now, x)
        left = self._shift(motion.trajectory, now, x)
        return self._closer.lead(motion, left, self._ask(now, x))

    def search(self, now: float, x: Floats) -> PlannedMotion | None:
        """Returns the best motion that the planner finds; None if it finds none.

        It takes what the planner's options allow: counts, not seconds.
        """
        return self._closer.search(self._ask(now, x), now, x)

    def _ask(self, now: float, x: Floats) -> Scenario:
        """Returns the task from a state on."""
        # No plan may start beyond its bounds, where an estimate may be.
        bounds, (q, v) = self.world.bounds(self.scenario), np.split(x, 2)
        left = self.end(now) - now
        return dataclasses.replace(
            self.scenario,
            initial_position=np.clip(q, *bounds.position),
            initial_velocity=np.clip(v, *bounds.velocity),
            duration=left,
            time_step=left / self.scenario.num_steps,
        )

    def _shift(self, last: Trajectory, now: float, x: Floats) -> Trajectory:
        """Returns what is left of a trajectory, from a state on, and what comes after it.

        Knots stay where they are, so that a motion stays what it was. Where the horizon recedes, as
        many as are over come at its end, with the last control and state.
        """
        k = int(np.searchsorted(last.times, now + _OVER * self._step, side="right")) - 1
        added = k if self.is_receding else 0
        ahead = last.times[-1] + self._step * np.arange(1, added + 1)
        q, v = np.split(x, 2)

        def go_on(first: Floats, rows: Floats) -> Floats:
            return np.vstack([first, rows[k + 1 :], *[rows[-1:]] * added])

        controls = np.vstack([last.controls[k:], *[last.controls[-1:]] * added])
        none = np.zeros(self.world.num_contacts)
        return Trajectory(
            times=np.concatenate([[now], last.times[k + 1 :], ahead]),
            positions=go_on(q, last.positions),
            velocities=go_on(v, last.velocities),
            controls=controls,
            impulses=np.vstack([none, last.impulses[k + 1 :], np.zeros((added, len(none)))]),
            forces=np.zeros((len(controls), len(none))),
        )

    def watch(
        self, seen: SeenBounces, samples: tuple[Floats, Floats], elapsed: float, control: Floats
    ) -> SeenBounces:
        """Returns what is seen of bounces by now; the arguments are those of `SeenBounces`.

        Only J that does not change tells where a wall is: mechanisms learn nothing.
        """
        if not self._learns:
            return seen
        off = _OFF * self._scales.length
        if elapsed <= _RECENT * self._period:
            seen = seen.watch(self.world, samples, elapsed, control, off)
        else:
            seen = dataclasses.replace(seen, latest=None)
        return seen.pass_walls(self.world, np.split(samples[1], 2)[0], off)

    def knowing(self, seen: SeenBounces) -> Horizon:
        """Returns the same task between walls that return what was seen, and stand there."""
        if seen == SeenBounces():
            return self
        learned, length = copy.copy(self), self._scales.length
        if seen.squares:
            doubt = (_DOUBT * self._scales.velocity) ** 2
            e = round(seen.find_restitution(self.scenario.restitution, doubt), _DIGITS)
            learned.scenario = dataclasses.replace(self.scenario, restitution=e)
        places = tuple(length * round(each / length, _DIGITS) for each in seen.nearer)
        assert isinstance(self._closer, BallCloser)
        learned._closer = self._closer.knowing(seen.latest, places)
        return learned


def _check(planner: Planner) -> None:
    """Refuses what can't be asked again and again.

    Raises:
        ControlError: says what it is.
    """
    if planner.scenario.duration_range is not None:
        raise ControlError(
            _ASKED,
            got="a task whose duration is free",
            expected="one that is given",
            remedy="Leave duration_range out.",
        )
    if planner.transcription.additions():
        raise ControlError(
            _ASKED,
            got="costs or constraints that were added to its transcription",
            expected="the scenario's alone",
        )
