"""Multi-phase problems of contact sequences, and what leads from a path to their optimum."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import TYPE_CHECKING

from drake_aigto.arrays import Floats, interpolate
from drake_aigto.local import LocalResult, NewtonLagrange, PolynomialNlp
from drake_aigto.planning.arc_program import ArcPrograms
from drake_aigto.planning.arcs import solve_in_arcs
from drake_aigto.planning.compiled import CompiledPrograms
from drake_aigto.planning.options import PlanOptions
from drake_aigto.planning.problem import PlanningProblem
from drake_aigto.planning.unfolding import least_flight_cost, unfolds
from drake_aigto.transcription import PhaseTranscription, RigidTranscription, TouchSequence
from drake_aigto.transcription.facings import Facing, find_facings
from drake_aigto.transcription.guesses import bend, straight_path
from drake_aigto.transcription.touch import joint_times

if TYPE_CHECKING:
    from drake_aigto.dynamics import ConstantDynamics
    from drake_aigto.world import Scenario

# Times (K,) [s] and positions (K, nq) [m].
Path = tuple[Floats, Floats]
# A multi-phase problem, and its decision variables.
Solved = tuple[PhaseTranscription, Floats]


class PhaseProblem(PlanningProblem):
    """A task between rigid walls, whose contact sequences have a multi-phase problem each.

    Attributes:
        asked_steps: time steps that plans are to have.
        num_steps: those that candidates are judged with, `PlanOptions.aigo_steps` at least: what
            few steps cost has nothing to do with which contacts are best.
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
            num_steps: time steps that plans are to have; the transcription's if None.
            programs: those of the same world, wherever its walls stand, and the same additions.
        """
        super().__init__(transcription, options or PlanOptions(), programs)
        self.asked_steps = num_steps or transcription.scenario.num_steps
        self.num_steps = max(self.asked_steps, self.options.aigo_steps)
        self._arc_programs = ArcPrograms()
        self._scenarios: dict[int, Scenario] = {}  # By their number of steps.

    def _look_along(self, path: Path, sequence: TouchSequence) -> tuple[Floats, tuple[Facing, ...]]:
        """Returns where touches are on a path, and on which sides of boxes it goes."""
        world, (times, positions) = self.transcription.world, path
        through = interpolate(joint_times(sequence), times, positions)
        if world.num_solids == world.num_contacts:
            return through, ()
        # Box centers miss the goal, and neighbors the walls: on which side of it a block is passed
        # is to be seen on a path that does not.
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
        """Returns what plain Newton steps lead to, or else one run of our local solver, if any.

        Of most sequences no bound is active in the optimum: phases have some length.
        """
        quick = NewtonLagrange(cost_unit=self._cost_scale)
        found = quick.solve(nlp, guess)
        if found is None and max_iterations:
            return self._minimize(nlp, guess, max_iterations)
        return found

    @cached_property
    def least_flight_cost(self) -> float:
        """What a motion that touches nothing costs at least; 0 where that has no closed form."""
        dynamics = self._find_dynamics()
        return least_flight_cost(dynamics, self.transcription.scenario) if dynamics else 0.0

    @cached_property
    def unfolds(self) -> bool:
        """Whether plans of the same contacts, in the same order, are expected to be one plan."""
        dynamics, world = self._find_dynamics(), self.transcription.world
        return bool(dynamics and unfolds(dynamics, world, self.transcription.scenario))

    @cached_property
    def _instants(self) -> Floats:
        """The times besides the ends that users bound something to, shape (I,) [s]."""
        return self.additions.times[list(self.additions.instants)]

    @cached_property
    def _has_arcs(self) -> bool:
        return self.options.local_solver == "newton" and self._find_dynamics() is not None

    def _find_dynamics(self) -> ConstantDynamics | None:
        """Returns what has closed forms: flight in parabolas, and nothing that users added."""
        world = self.transcription.world
        is_known = world.has_constant_dynamics and not self.additions
        return world.constant_dynamics if is_known else None

    def _phases(
        self, sequence: TouchSequence, facings: Iterable[Facing], num_steps: int | None
    ) -> PhaseTranscription:
        """Returns the multi-phase problem, with so many steps or AIGO's, one a phase at least."""
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
