"""A MathematicalProgram over knots, in the words of Drake's MultipleShooting."""

from __future__ import annotations

import copy
import operator
from abc import abstractmethod
from collections.abc import Hashable, Iterable
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydrake.solvers import BoundingBoxConstraint, Cost, EvaluatorBase, MathematicalProgram
from pydrake.symbolic import Expression, MakeVectorVariable, Variable

from drake_aigto.arrays import Floats, Ints
from drake_aigto.errors import ProgramError
from drake_aigto.terms import read_bounds
from drake_aigto.transcription.knots import Knots
from drake_aigto.transcription.rows import Bounds, SharedEvaluator, substitutions
from drake_aigto.world import Scenario, World


class Parameters(NamedTuple):
    """Parameters of a program from a scenario without its start: numbers, or symbols for them.

    Rows divide by none of these, so that programs are polynomials of the symbols.

    Attributes:
        goal: of q(T), shape (nq,) [m].
        control_weight: w_u [1/(N² s)].
        goal_weight: w_f [1/m²].
        time_step: dt [s].
        rate: 1/dt [1/s].
        per_length: 1/L, of the length scale [1/m].
        restitutions: e of each contact, shape (m,).
    """

    goal: NDArray[Any]
    control_weight: Any
    goal_weight: Any
    time_step: Any
    rate: Any
    per_length: Any
    restitutions: NDArray[Any]

    @classmethod
    def of(cls, scenario: Scenario, length_scale: float, restitutions: Floats) -> Parameters:
        """Returns a scenario's numbers."""
        return cls(
            goal=scenario.goal_position,
            control_weight=scenario.control_weight,
            goal_weight=scenario.goal_weight,
            time_step=scenario.time_step,
            rate=1 / scenario.time_step,
            per_length=1 / length_scale,
            restitutions=restitutions,
        )

    @classmethod
    def symbols(cls, num_positions: int, num_contacts: int) -> Parameters:
        """Returns new symbols."""
        names = cls._fields[1:-1]
        found = MakeVectorVariable(num_positions + len(names) + num_contacts, "p")
        goal, scalars, returned = np.split(found, [num_positions, num_positions + len(names)])
        given = dict(zip(names, scalars.tolist(), strict=True))
        return cls(goal=goal, **given, restitutions=returned)

    def vector(self) -> NDArray[Any]:
        """Returns all of them, shape (nq + 5 + m,)."""
        return np.array([*self.goal, *self[1:-1], *self.restitutions])


_Self = TypeVar("_Self", bound="KnotProgram")

_NUMBERS = ("lower_bound", "upper_bound", "GetDenseA", "Q", "a", "b", "c")


class KnotProgram(Knots):
    """A program over knots, made at its first use; it distinguishes additions of users."""

    def __init__(self, world: World, scenario: Scenario) -> None:
        """Lays out the variables, and makes placeholders for those of a stage."""
        self._forget_program()
        self._symbols: Parameters | None = None  # In place of `parameters`, in a twin.
        super().__init__(world, scenario)

    def _forget_program(self) -> None:
        self._last = None, None
        self._made: MathematicalProgram | None = None
        self._bounds: Bounds | None = None  # If known without it.
        # Placeholder id → decision variable, of each stage that something was bound to.
        self._chosen: dict[int, dict[int, Variable]] = {}
        # The evaluators of all rows and costs that the class bound, as they were, and how often.
        self._own: dict[EvaluatorBase, Hashable] = {}
        self._num_bound = 0

    @property
    def is_as_made(self) -> bool:
        """Whether the program has no additions, as it was not used yet."""
        return self._made is None

    @property
    def _prog(self) -> MathematicalProgram:
        if self._made is None:
            self._made = MathematicalProgram()
            self._layout.add_to(self._made)
            self._variables = self._made.decision_variables()
            if self._symbols is not None:
                self._made.AddDecisionVariables(self._symbols.vector())
            self._add_all()
        return self._made

    @cached_property
    def parameters(self) -> Parameters:
        """The numbers of the scenario that rows and costs read; the start is a bound."""
        returned = self.world.restitutions(self.scenario)
        return Parameters.of(self.scenario, self.length_scale(), returned)

    @property
    def _given(self) -> Parameters:
        """Parameters of rows and costs: the numbers, or symbols for them."""
        return self._symbols or self.parameters

    def _of(self: _Self, scenario: Scenario) -> _Self:
        """Returns a copy for another scenario, of the same structure."""
        scenario.check_plain()
        other = copy.copy(self)
        for derived in ("parameters", "scales"):
            other.__dict__.pop(derived, None)
        bounds = self._bounds
        other._forget_program()
        other.scenario, other._dt, other._bounds = scenario, scenario.time_step, bounds
        return other

    def twin(self: _Self) -> _Self:
        """Returns a copy with a decision variable for each of `parameters` in its program.

        They come after the others. Its penalties hold for all scenarios of one `structure`.
        """
        twin = copy.copy(self)
        twin._forget_program()
        twin._symbols = Parameters.symbols(self.world.num_positions, self.world.num_contacts)
        return twin

    @property
    def structure(self) -> Hashable:
        """All that rows and costs depend on besides the world, users, and `parameters`."""
        return self.scenario.num_steps

    def bounds(self) -> Bounds:
        """Returns the tightest lower and upper bound of each decision variable, shape (n,) each."""
        if self._bounds is None:
            return read_bounds(self._prog)
        lower, upper = (bound.copy() for bound in self._bounds)
        first = np.concatenate([self._q[0], self._v[0]])
        start = np.concatenate([self.scenario.initial_position, self.scenario.initial_velocity])
        lower[first], upper[first] = start, start
        return lower, upper

    def take_bounds(self, bounds: Bounds) -> None:
        """Takes the bounds of another transcription of the same structure, but for x_0."""
        self._bounds = bounds

    @abstractmethod
    def _add_all(self) -> None:
        """Adds costs and rows."""

    @abstractmethod
    def _stage(self, k: int) -> list[tuple[NDArray[Any], NDArray[Any]]]:
        """Returns pairs of placeholders and their variables at knot k."""

    def _num_variables(self) -> int:
        return super()._num_variables() if self._made is None else self._made.num_vars()

    # Placeholders of a stage; those of its start and control are the world's own.

    @cached_property
    def _next_q(self) -> NDArray[Any]:
        return MakeVectorVariable(self.world.num_positions, "q_next")

    @cached_property
    def _next_v(self) -> NDArray[Any]:
        return MakeVectorVariable(self.world.num_velocities, "v_next")

    @cached_property
    def _clearance(self) -> NDArray[Any]:
        return MakeVectorVariable(len(self._clearance_contacts), "s")

    @property
    def _duration(self) -> Expression:
        """The length of a stage."""
        return Expression(self._given.time_step)

    def prog(self) -> MathematicalProgram:
        """Returns the constrained program; add costs and constraints until it is solved.

        Constraints on variables of `state(k)` and `input(k)` hold at the time of knot k, or over
        the time from it to the next, whatever the knots of a plan are; at an impact, before it.
        Costs are linear, quadratic or an ExpressionCost; constraints are bounds, linear, quadratic
        or other formulas. An initial guess has no effect on plans: AIGO starts from a box.
        """
        return self._prog

    def state(self, k: int | None = None) -> NDArray[Any]:
        """Returns x_k = [q_k, v_k], shape (nq + nv,); without k, placeholders for it.

        Raises:
            ProgramError: there is no such knot.
        """
        if k is None:
            return np.concatenate([self.world.positions, self.world.velocities])
        _check_knot("state", k, len(self._q))
        return self._variables_at(np.concatenate([self._q[k], self._v[k]]))

    def input(self, k: int | None = None) -> NDArray[Any]:
        """Returns u_k, held from knot k to the next, shape (nu,); without k, placeholders for it.

        Raises:
            ProgramError: there is no such knot, or it is the last.
        """
        if k is None:
            return self.world.controls
        _check_knot("input", k, len(self._u))
        return self._variables_at(self._u[k])

    def _variables_at(self, indices: Ints) -> NDArray[Any]:
        """Returns the program's variables of these indices, in an array of their shape."""
        self.prog()
        return self._variables[indices]

    def initial_state(self) -> NDArray[Any]:
        """Returns x_0."""
        return self.state(0)

    def final_state(self) -> NDArray[Any]:
        """Returns x_N."""
        return self.state(self.num_samples() - 1)

    def _attach(self, evaluator: EvaluatorBase, variables: Iterable[Variable]) -> None:
        """Adds a cost or a constraint of the class's own."""
        if evaluator not in self._own:
            self._own[evaluator] = numbers_of(evaluator)
        self._num_bound += 1
        if isinstance(evaluator, Cost):
            self._prog.AddCost(evaluator, vars=variables)
        else:
            self._prog.AddConstraint(evaluator, vars=variables)

    def _bound(self, variables: Any, lower: Any, upper: Any, name: str = "") -> None:
        """Adds bounds, one for each variable or the same for all."""
        flat = np.ravel(variables)
        limits = (np.broadcast_to(bound, flat.shape) for bound in (lower, upper))
        constraint = BoundingBoxConstraint(*limits)
        constraint.set_description(name)
        self._attach(constraint, flat)

    def _bind_stages(self, shared: SharedEvaluator) -> None:
        """Binds an evaluator to every step k = 0 … N−1."""
        self._bind_each(shared, range(len(self._u)))

    def _bind_each(self, shared: SharedEvaluator, knots: Iterable[int]) -> None:
        for k in knots:
            self._bind(shared, k)

    def _bind(self, shared: SharedEvaluator, k: int) -> None:
        """Binds an evaluator over the placeholders of knot k, its control and the next knot."""
        if k not in self._chosen:
            self._chosen[k] = substitutions(*zip(*self._stage(k), strict=True))
        self._attach(shared.evaluator, shared.variables(self._chosen[k]))


def numbers_of(evaluator: EvaluatorBase) -> Hashable:
    """Returns the mutable parts of a cost or constraint: bounds and coefficients."""
    getters = (getattr(evaluator, name, None) for name in _NUMBERS)
    return tuple(np.asarray(getter()).tobytes() for getter in getters if getter)


def _check_knot(name: str, k: int, count: int) -> None:
    if not 0 <= operator.index(k) < count:
        raise ProgramError(
            f"{name}({k})",
            got=f"knot {k}",
            expected=f"one of 0 … {count - 1}",
            remedy="GetSampleTimes() has their times, final_state() is the last one's.",
        )
