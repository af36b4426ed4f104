"""A mechanism's task as problems of optimal control, in any number of time steps."""

from __future__ import annotations

from functools import cache, cached_property

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import RigidLaw, contact_law
from drake_aigto.planning.mechanisms.boxes import CompiledMechanism
from drake_aigto.planning.options import PlanOptions
from drake_aigto.shooting import Mechanism, Phases, ShootingProblem, ShootingResult
from drake_aigto.simulation import state_scales
from drake_aigto.transcription import NO_ADDITIONS, Additions
from drake_aigto.world import Scales, Scenario, TaskCost, World


class PosedTask:
    """A task of a mechanism, posed for shooting (`ShootingProblem`) in any number of time steps.

    Attributes:
        world: the mechanism.
        scenario: the task.
        options: numerics.
        ladder: the starts of AIGO.
        additions: costs and constraints of users.
        task: the scenario's cost.
        bounds: of positions, velocities and controls.
        law: of its contacts.
        scales: of the task.
    """

    def __init__(
        self,
        world: World,
        scenario: Scenario,
        options: PlanOptions,
        compiled: CompiledMechanism | None = None,
        additions: Additions = NO_ADDITIONS,
    ) -> None:
        """Reads the task; programs are compiled as they are needed.

        Args:
            world: the mechanism.
            scenario: the task.
            options: numerics.
            compiled: of the same world, law and additions.
            additions: costs and constraints of users.

        Raises:
            OptionsError: an option does not count for mechanisms.
            ProgramError: a cost or constraint of the user can't be planned here; says why.
            UnsupportedTermError: it has a factor that is no power, sin or cos.
        """
        options.check_for_mechanisms()
        self.world, self.scenario, self.options = world, scenario, options
        self.ladder = options.mechanism_ladder
        self.task, self.bounds = TaskCost.of(world, scenario), world.bounds(scenario)
        self.law = contact_law(world, scenario)
        self.scales = Scales.of(world, scenario)
        self._compiled = compiled or CompiledMechanism.of(world, self.law, additions)
        self.additions = self._compiled.additions
        if isinstance(self.law, RigidLaw) or scenario.duration_range is not None:
            self._compiled.added.check_untimed()
        self.shooting = cache(self._pose)

    @property
    def search_steps(self) -> int:
        """The number of time steps of motions during the search."""
        return min(self.scenario.num_steps, self.options.search_steps)

    @property
    def mechanism(self) -> Mechanism:
        """The mechanism of motions during the search."""
        return self._compiled.mechanism

    @cached_property
    def _hard_goal(self) -> Floats:
        """Prescribed q and v at the end, shape (2n,); NaN where free."""
        scenario, n = self.scenario, self.world.num_positions
        hard = np.full(2 * n, np.nan)
        if scenario.hard_goal:
            hard[:n] = self.task.goal
            if scenario.goal_velocity is not None:
                hard[n:] = self.task.goal_velocity
        return hard

    def _pose(self, num_steps: int) -> ShootingProblem:
        """Returns the task in this number of time steps."""
        scenario, bounds = self.scenario, self.bounds
        T, free = scenario.duration, scenario.duration_range
        return ShootingProblem(
            mechanism=self.mechanism,
            cost=self.task,
            times=np.linspace(0.0, T, num_steps + 1),
            start=np.concatenate([scenario.initial_position, scenario.initial_velocity]),
            scales=self.state_scales,
            state_bounds=np.hstack([bounds.position, bounds.velocity]),
            control_bounds=bounds.control,
            hard_goal=self._hard_goal,
            control_norm=scenario.control_norm or np.inf,
            length=self.scales.length,
            phases=None if free is None else Phases.free(T, free),
            added=self._compiled.added,
        )

    @cached_property
    def state_scales(self) -> Floats:
        """Scales of q and v, shape (2n,)."""
        return state_scales(self.world, self.scenario)

    @cached_property
    def coast(self) -> ShootingResult:
        """The uncontrolled motion."""
        problem = self.shooting(self.search_steps)
        controls = np.zeros((self.search_steps, self.world.num_actuators))
        return problem.simulate(controls, substeps=4)
