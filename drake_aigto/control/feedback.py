"""Feedback about a plan: one law, by phases in which contacts go on as they do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import Mode
from drake_aigto.control.stretches import (
    Cut,
    check_impacts,
    check_sizes,
    is_at_rest_on,
    touches_walls,
)
from drake_aigto.control.sweep import FeedbackPhase, PhaseEnd, Sweep
from drake_aigto.planning import MechanismTask, PlanOptions, needs_shooting
from drake_aigto.simulation import Controller, Held
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import Scenario, World

# Runge-Kutta steps between knots, and how far from walls gains know of them, in parts of the task's
# length: a state a little off its plan may meet a wall where the plan does not.
_SUBSTEPS, _SMOOTHING = 8, 1e-3
# A slip has ended at this part of its largest value in the plan.
_STOPPED = 1e-2


class Feedback(Controller):
    """Tracks a plan through its contacts.

    On phase i, in which the same contacts last in the same modes or none does, a control that is
    held from t_k on is

        u = u_k + K_k (x − x_i(t)),    cut to the bounds of the control,

    the best answer of held controls to a deviation from the phase, to second order (`Sweep`).

    The next phase begins when a wall is hit, or a slip stops, not when the plan's clock says so.
    For that each phase goes on before and after its own part of the plan, as if its contacts were
    all there is: a bounce that comes early is followed by what the next phase was before its
    beginning, and one that is late by the last phase, with its last gain. Impacts are counted at
    each wall: those that the plan lacks change nothing. What a control ends, as when it lets go of
    a wall, ends by the clock.

    A plan of a mechanism between compliant walls, or one that touches nothing, is one phase. Its
    gains are those of the descent that found the plan (`ShootingProblem.calc_gains`), the law of
    compliant contact included.

    Attributes:
        phases: of the plan, in order.
        ends: of all phases but the last.
    """

    def __init__(self, world: World, scenario: Scenario, trajectory: Trajectory) -> None:
        """Computes the gains.

        Raises:
            TrajectoryError: the plan does not fit the world; or it has several impacts at once, one
                at the start, or one that only grazes a wall: no feedback is known there.
        """
        check_sizes(world, trajectory)
        self._world, times = world, trajectory.times
        self.start, self.end = float(times[0]), float(times[-1])
        self.longest_hold = float(np.max(np.diff(times)))
        self._bounds = world.bounds(scenario).control
        self._norm = scenario.control_norm or np.inf
        touches = scenario.contact == "rigid" and touches_walls(world, trajectory)
        self.feels_contact = touches or not needs_shooting(world, scenario)
        self.phases, self.ends = list[FeedbackPhase](), list[PhaseEnd]()
        if self.feels_contact:
            check_impacts(world, trajectory)
            sweep = Sweep(world, scenario, trajectory)
            self.phases, self.ends = sweep.run(), sweep.find_ends()
        else:
            task = MechanismTask(world, scenario, PlanOptions()).shooting(len(times) - 1)
            problem = replace(task, times=times, phases=None)
            gains = problem.calc_gains(trajectory.controls, _SUBSTEPS, _SMOOTHING)
            state, _ = trajectory.to_piecewise()
            self.phases = [FeedbackPhase(times, state, trajectory.controls, gains)]

    def sample(self, time: float, x: Floats, bounces: Sequence[int]) -> Held:
        """Returns u_k + K_k (x − x_i(t)), within bounds."""
        phase = self.phases[self.find_phase(time, x, bounces)]
        last = len(phase.controls) - 1
        k = int(np.clip(np.searchsorted(phase.times, time, side="right") - 1, 0, last))
        u = phase.controls[k] + phase.gains[k] @ (x - phase.calc_state(time))
        size = float(np.linalg.norm(u := np.clip(u, *self._bounds)))
        until = float(phase.times[k + 1])
        return Held(
            u * min(1.0, self._norm / size) if size else u, until if until > time else self.end
        )

    def find_state(self, time: float, bounces: Sequence[int]) -> Floats:
        """Returns the state that is planned for a time after such bounces, (q, v), shape (2n,).

        Where the phase has ended, it is where that would lead. Whether a contact lasts, or has
        stopped to slip, no bounce tells: that is as planned.
        """
        return self.phases[self.find_phase(time, None, bounces)].calc_state(time)

    def find_phase(self, time: float, x: Floats | None, bounces: Sequence[int]) -> int:
        """Returns in which phase it is: all that ends those before it has happened."""
        left = list(bounces)
        for i, end in enumerate(self.ends):
            if end.stretch.cut == Cut.HIT and end.stretch.contact in left:
                left.remove(end.stretch.contact)
            elif not self._is_over(end, time, x):
                return i
        return len(self.ends)

    def _is_over(self, end: PhaseEnd, time: float, x: Floats | None) -> bool:
        """Returns whether a phase has ended other than by an impact that was counted."""
        if end.stretch.cut == Cut.CLOCK or (x is None and end.is_shown_by_state):
            return time >= end.time
        if x is None or time < end.earliest or not end.is_shown_by_state:
            return False
        contact, (q, v) = end.stretch.contact, np.split(x, 2)
        if end.stretch.cut == Cut.HIT:
            return bool(is_at_rest_on(self._world, q, v, end.speed / 2)[contact])
        slip = float(self._world.rubbing.calc_slips(q, v)[contact])
        mode: Mode = end.stretch.find_mode(contact)
        return slip * mode <= _STOPPED * end.speed
