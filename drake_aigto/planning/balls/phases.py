"""Multi-phase problems of contact sequences, and their optima near a path."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cached_property

import numpy as np

from drake_aigto.arrays import Floats, interpolate
from drake_aigto.dynamics import ConstantDynamics
from drake_aigto.local import LocalResult, NewtonLagrange, PolynomialNlp
from drake_aigto.planning.balls.arc_program import ArcPrograms
from drake_aigto.planning.balls.arcs import solve_in_arcs
from drake_aigto.planning.options import PlanOptions
from drake_aigto.planning.program_task import ProgramTask
from drake_aigto.planning.programs import CompiledPrograms
from drake_aigto.transcription import (
    AT_ONCE,
    Facing,
    PhaseTranscription,
    RigidTranscription,
    TouchSequence,
    bend,
    find_facings,
    joint_times,
    straight_path,
)
from drake_aigto.world import Scenario, World

# AIGO's boxes distinguish a bounce from the start's own impulse if this many steps lead to the
# wall; and the factor by which they may have more steps for that, unless the scenario has more.
_STEPS_TO_WALL, _MOST_FINER = 3, 4


def transcribe(world: World, scenario: Scenario, options: PlanOptions) -> RigidTranscription:
    """Returns the scenario, transcribed with the time steps of `coarsen`."""
    world.check_plain(scenario)
    return RigidTranscription(world, coarsen(world, scenario, options), options.relaxation)


def coarsen(world: World, scenario: Scenario, options: PlanOptions) -> Scenario:
    """Returns the scenario with the time steps of AIGO's boxes (`PlanOptions.aigo_steps`).

    There are more of them if a wall would be touched in less than three: up to the scenario's, or
    four times as many if those are few.
    """
    most = max(scenario.num_steps, _MOST_FINER * options.aigo_steps)
    return scenario.in_steps(max(options.aigo_steps, min(_count_steps(world, scenario), most)))


def _count_steps(world: World, scenario: Scenario) -> int:
    """Returns the number of steps of T for which the ball flies three before the wall.

    Walls that are touched at once do not count: they are known without boxes.
    """
    distances = world.calc_signed_distance(scenario.initial_position)
    jacobian = world.calc_contact_jacobian(scenario.initial_position)
    speeds, T = -jacobian @ scenario.initial_velocity, scenario.duration
    counts = T * speeds[distances > 0] / distances[distances > 0]
    return math.ceil(_STEPS_TO_WALL * np.max(counts[counts < 1 / AT_ONCE], initial=0.0))


def least_flight_cost(dynamics: ConstantDynamics, scenario: Scenario) -> float:
    """Returns a lower bound of the cost of motions without contact.

    Without walls, and with a control that may change at any time, which then is affine in t:

        d = goal − q₀ − T v₀ − ½ T² a₀,   G = M⁻¹ B,   J ≥ dᵀ (I/w_f + T³/(3 w_u) G Gᵀ)⁻¹ d
    """
    w_u, w_f, T = scenario.control_weight, scenario.goal_weight, scenario.duration
    if w_f == 0:
        return 0.0
    way = scenario.goal_position - scenario.initial_position
    way = way - T * scenario.initial_velocity - T**2 / 2 * dynamics.drift
    compliance = np.eye(way.size) / w_f + T**3 / (3 * w_u) * dynamics.gain @ dynamics.gain.T
    return float(way @ np.linalg.solve(compliance, way))


def unfolds(dynamics: ConstantDynamics, world: World, scenario: Scenario) -> bool:
    """Returns whether the contacts and their order are expected to determine a plan.

    Mirrored at each wall that it bounces off, a motion under controls alone is a free flight to the
    goal's image. The cost of that is convex, if accelerations cost the same in the image. But a
    block can be passed on two sides; under gravity a ball bounces high and late or low and early;
    and of two masses the lighter one costs less.
    """
    return bool(
        world.num_solids == world.num_contacts
        and np.all(world.restitutions(scenario) > 0)
        and not np.any(dynamics.drift)
        and _mirrors_keep_costs(dynamics)
    )


def _mirrors_keep_costs(dynamics: ConstantDynamics) -> bool:
    """Returns whether G Gᵀ, of G = M⁻¹ B, is its own image in each wall's mirror.

    The mirror changes velocities as an elastic impact does.
    """
    worth = dynamics.gain @ dynamics.gain.T
    for J, kick in zip(dynamics.jacobian, dynamics.kicks, strict=True):
        mirror = np.eye(J.size) - 2 * np.outer(kick, J) / (J @ kick)
        if not np.allclose(mirror @ worth @ mirror.T, worth, atol=1e-9 * np.max(worth)):
            return False
    return True


# Times (K,) [s] and positions (K, nq) [m].
Path = tuple[Floats, Floats]
# A multi-phase problem, and its decision variables.
Solved = tuple[PhaseTranscription, Floats]


class PhaseTask(ProgramTask):
    """A task between rigid walls, whose contact sequences have a multi-phase problem each.

    Attributes:
        asked_steps: time steps of plans.
        num_steps: those that candidates are judged with, `PlanOptions.aigo_steps` at least: costs
            with few steps do not show which contacts are best.
    """

    transcription: RigidTranscription
    options: PlanOptions

    def __init__(
        self,
        transcription: RigidTranscription,
        options: PlanOptions | None = None,
        num_steps: int | None = None,
        programs: CompiledPrograms | None = None,
    ) -> None:
        """Compiles, unless there is a program of this structure already.

        Args:
            transcription: for AIGO.
            options: numerics.
            num_steps: time steps of plans; the transcription's if None.
            programs: of the same world, wherever its walls stand, and the same additions.
        """
        options = options or PlanOptions()
        options.check_for_balls()
        super().__init__(transcription, options, options.ball_ladder, programs)
        self.asked_steps = num_steps or transcription.scenario.num_steps
        self.num_steps = max(self.asked_steps, self.options.aigo_steps)
        self._arc_programs = ArcPrograms()
        self._scenarios: dict[int, Scenario] = {}  # By their number of steps.

    def _look_along(self, path: Path, sequence: TouchSequence) -> tuple[Floats, tuple[Facing, ...]]:
        """Returns the positions of touches on a path, and the sides on which it passes boxes."""
        world, (times, positions) = self.transcription.world, path
        through = interpolate(joint_times(sequence), times, positions)
        if world.num_solids == world.num_contacts:
            return through, ()
        # Box centers miss the goal, and neighbors the walls: the side on which a block is passed is
        # read off a path that does not.
        stops = straight_path(world, self.transcription.scenario, sequence, through)
        return through, tuple(find_facings(world, *bend(path, *stops), sequence))

    def _solve_in_arcs(
        self,
        through: Floats,
        facings: Iterable[Facing],
        sequence: TouchSequence,
        most: int,
    ) -> Solved | None:
        """Returns the local optimum if arcs lead to it."""
        phases = self._phases(sequence, facings, self.num_steps)
        x = solve_in_arcs(
            phases,
            phases.guess(through),
            lambda nlp, start: self._settle(nlp, start, most),
            self._arc_programs,
        )
        return None if x is None else (phases, x)

    def _settle(self, nlp: PolynomialNlp, guess: Floats, max_iterations: int) -> LocalResult | None:
        """Returns the result of plain Newton steps, or else of one run of our local solver.

        For most sequences no bound is active in the optimum: phases have some length.
        """
        quick = NewtonLagrange(cost_unit=self._cost_scale)
        found = quick.solve(nlp, guess)
        if found is None and max_iterations:
            return self._minimize(nlp, guess, max_iterations)
        return found

    @cached_property
    def least_flight_cost(self) -> float:
        """Lower bound of the cost without contact; 0 if it has no closed form."""
        dynamics = self._find_dynamics()
        return least_flight_cost(dynamics, self.transcription.scenario) if dynamics else 0.0

    @cached_property
    def unfolds(self) -> bool:
        """Whether the contacts and their order are expected to determine a plan."""
        dynamics, world = self._find_dynamics(), self.transcription.world
        return bool(dynamics and unfolds(dynamics, world, self.transcription.scenario))

    @cached_property
    def _instants(self) -> Floats:
        """Times of users' costs and constraints, without the ends, shape (I,) [s]."""
        return self.additions.times[list(self.additions.instants)]

    @cached_property
    def _has_arcs(self) -> bool:
        return self.options.local_solver == "newton" and self._find_dynamics() is not None

    def _find_dynamics(self) -> ConstantDynamics | None:
        """Returns the dynamics if flights are parabolas without additions of users."""
        world = self.transcription.world
        is_known = world.has_constant_dynamics and not self.additions
        return world.constant_dynamics if is_known else None

    def _phases(
        self, sequence: TouchSequence, facings: Iterable[Facing], num_steps: int | None
    ) -> PhaseTranscription:
        """Returns the multi-phase problem in num_steps or AIGO's, at least one per phase."""
        coarse, facings = self.transcription, tuple(facings)
        scenario = coarse.scenario
        turns = (facing.start for facing in facings)
        phases = {0.0, *joint_times(sequence), *turns, *self._instants.tolist()}
        steps = max(num_steps or scenario.num_steps, len(phases))
        if steps != scenario.num_steps:
            if steps not in self._scenarios:
                self._scenarios[steps] = scenario.in_steps(steps)
            scenario = self._scenarios[steps]
        return PhaseTranscription(coarse.world, scenario, sequence, facings, self.additions)
