"""A MathematicalProgram over knots, in the words of Drake's MultipleShooting, and its motions."""

from __future__ import annotations

import copy
import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Hashable, Iterable
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydrake.solvers import BoundingBoxConstraint, Cost, EvaluatorBase, MathematicalProgram
from pydrake.symbolic import Expression, MakeVectorVariable, Variable

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.errors import ProgramError
from drake_aigto.terms import read_bounds
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import rows
from drake_aigto.world import Scales, Scenario, World, calc_inertia

_Self = TypeVar("_Self", bound="KnotProgram")

_NUMBERS = ("lower_bound", "upper_bound", "GetDenseA", "Q", "a", "b", "c")
# A time within this part of the duration is that of a knot: rounding.
_ON_KNOT = 1e-9


class Layout:
    """Places of decision variables, before there is a program with them.

    Attributes:
        size: the number of variables.
    """

    def __init__(self) -> None:
        """Starts without variables."""
        self.size = 0
        self._groups: list[tuple[str, tuple[int, ...]]] = []

    def new(self, name: str, *shape: int) -> Ints:
        """Returns the indices of new variables, of this shape."""
        self._groups.append((name, shape))
        first, self.size = self.size, self.size + math.prod(shape)
        # Drake counts the variables of a matrix column by column. In C's order, as motions are: the
        # rounding of products depends on it.
        return np.ascontiguousarray(np.arange(first, self.size).reshape(shape, order="F"))

    def copy(self) -> Layout:
        """Returns a layout of the same variables, to which others may be added."""
        other = Layout()
        other.size, other._groups = self.size, [*self._groups]
        return other

    def add_to(self, prog: MathematicalProgram) -> None:
        """Adds the variables to an empty program."""
        for name, shape in self._groups:
            prog.NewContinuousVariables(*shape, name)


class KnotProgram(ABC):
    """A program over knots k = 0 … N, made at its first use; it distinguishes additions of users.

    Its variables are q, v and u, then, for contacts whose φ reads several coordinates, clearances
    s_k = φ(q_k), and what the subclass adds. Vectors x of all of them are motions and back.

    Shape letters: N time steps, nq positions, nv = nq velocities, nu controls, m contacts.
    """

    def __init__(self, world: World, scenario: Scenario) -> None:
        """Lays out the variables, and makes placeholders for those of a stage."""
        self._forget_program()
        self._symbols: rows.Parameters | None = None  # In place of `parameters`, in a twin.
        self.world, self.scenario, self._dt = world, scenario, scenario.time_step
        self._layout = Layout()
        self._lay_out()

    def _forget_program(self) -> None:
        self._made: MathematicalProgram | None = None
        self._bounds: rows.Bounds | None = None  # If known without it.
        # Placeholder id → decision variable, of each stage that something was bound to.
        self._chosen: dict[int, dict[int, Variable]] = {}
        # The evaluators of all rows and costs that the class bound, as they were, and how often.
        self._own: dict[EvaluatorBase, Hashable] = {}
        self._num_bound = 0

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
    def parameters(self) -> rows.Parameters:
        """The numbers of the scenario that rows and costs read; the start is a bound."""
        returned = self.world.restitutions(self.scenario)
        return rows.Parameters.of(self.scenario, self.length_scale(), returned)

    @property
    def _given(self) -> rows.Parameters:
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
        twin._symbols = rows.Parameters.symbols(self.world.num_positions, self.world.num_contacts)
        return twin

    @property
    def structure(self) -> Hashable:
        """All that rows and costs depend on besides the world, users, and `parameters`."""
        return self.scenario.num_steps

    def bounds(self) -> rows.Bounds:
        """Returns the tightest lower and upper bound of each decision variable, shape (n,) each."""
        if self._bounds is None:
            return read_bounds(self._prog)
        lower, upper = (bound.copy() for bound in self._bounds)
        first = np.concatenate([self._q[0], self._v[0]])
        lower[first] = upper[first] = self.scenario.initial_state
        return lower, upper

    def take_bounds(self, bounds: rows.Bounds) -> None:
        """Takes the bounds of another transcription of the same structure, but for x_0."""
        self._bounds = bounds

    @abstractmethod
    def _add_all(self) -> None:
        """Adds costs and rows."""

    @abstractmethod
    def _stage(self, k: int) -> list[tuple[NDArray[Any], NDArray[Any]]]:
        """Returns pairs of placeholders and their variables at knot k."""

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

    def _bind_stages(self, shared: rows.SharedEvaluator) -> None:
        """Binds an evaluator to every step k = 0 … N−1."""
        self._bind_each(shared, range(len(self._u)))

    def _bind_each(self, shared: rows.SharedEvaluator, knots: Iterable[int]) -> None:
        for k in knots:
            self._bind(shared, k)

    def _bind(self, shared: rows.SharedEvaluator, k: int) -> None:
        """Binds an evaluator over the placeholders of knot k, its control and the next knot."""
        if k not in self._chosen:
            self._chosen[k] = rows.substitutions(*zip(*self._stage(k), strict=True))
        self._attach(shared.evaluator, shared.variables(self._chosen[k]))

    def _lay_out(self) -> None:
        """Makes the arrays of indices."""
        N, world, new = self.scenario.num_steps, self.world, self._layout.new
        self._q = new("q", N + 1, world.num_positions)
        self._v = new("v", N + 1, world.num_velocities)
        self._u = new("u", N, world.num_actuators)
        self._clearance_contacts = [
            i
            for i in np.flatnonzero(self._is_bounded()).tolist()
            if len(world.contacts[i].signed_distance.GetVariables()) > 1
        ]
        columns = [new(f"s{i}", N + 1, 1) for i in self._clearance_contacts]
        self._clearances = np.hstack([np.empty((N + 1, 0), dtype=np.int64), *columns])

    @abstractmethod
    def _is_bounded(self) -> Bools:
        """Returns which contacts have bounds on φ at knots k ≥ 1, shape (m,)."""

    @abstractmethod
    def defects(self, x: Floats) -> dict[str, float]:
        """Returns the largest violation of each kind of row at x, in that row's unit (m, m/s)."""

    @abstractmethod
    def impulses(self, x: Floats) -> Floats:
        """Returns the contact impulses that x implies, shape (N+1, m) [N s]."""

    def close_rows(self, x: Floats) -> Floats:
        """Returns x without the rounding errors of rows, where these can be removed."""
        return x

    def _depth(self, x: Floats) -> float:
        """Returns the penetration of knots after the start, 0 outside [m]."""
        clearances = self.world.calc_clearance(self.split(x)[0][1:])
        return max(0.0, -float(np.min(clearances)))

    def num_samples(self) -> int:
        """Returns the number of knots, N + 1."""
        return len(self._q)

    def time_step(self, k: int = 0) -> float:
        """Returns the length of step k [s]; all are equal."""
        return self._dt

    def GetSampleTimes(self) -> Floats:
        """Returns the knots' times, shape (N+1,) [s]."""
        return np.arange(self.num_samples()) * np.float64(self._dt)

    def knot_at(self, time: float) -> int:
        """Returns the knot at a time [s].

        Raises:
            ProgramError: there is none; the message has the nearest ones' times.
        """
        times = self.GetSampleTimes()
        nearest = np.argsort(np.abs(times - time))[:2]
        if not abs(times[nearest[0]] - time) <= _ON_KNOT * times[-1]:
            raise ProgramError(
                "time",
                got=f"{time:g} s",
                expected=f"a knot's, as {' and '.join(f'{t:g}' for t in np.sort(times[nearest]))}",
                remedy="The number of knots is PlanOptions.aigo_steps + 1.",
            )
        return int(nearest[0])

    def trajectory(self, x: Floats) -> Trajectory:
        """Returns the trajectory of a vector of all decision variables."""
        (q, v, u), impulses = self.split(x), self.impulses(x)
        return Trajectory(self.GetSampleTimes(), q, v, u, impulses, np.zeros_like(impulses[1:]))

    def vector(self, trajectory: Trajectory) -> Floats:
        """Returns all decision variables of a trajectory at these knots; undoes `trajectory`."""
        return self.vector_of(trajectory.positions, trajectory.velocities, trajectory.controls)

    def vector_of(self, positions: Floats, velocities: Floats, controls: Floats) -> Floats:
        """Returns all decision variables, for arrays as `split` returns them."""
        clearances = self.world.calc_signed_distance(positions)[:, self._clearance_contacts]
        return self._join(positions, velocities, controls, clearances)

    def _join(self, *parts: Floats) -> Floats:
        """Returns q, v, u and clearances in the program's order; other variables are 0."""
        x = np.zeros(self._layout.size if self._made is None else self._made.num_vars())
        places = self._q, self._v, self._u, self._clearances
        for indices, values in zip(places, parts, strict=True):
            x[indices] = values
        return x

    def split(self, x: Floats) -> list[Floats]:
        """Returns q (N+1, nq), v (N+1, nv) and u (N, nu) out of all decision variables."""
        return [x[indices] for indices in (self._q, self._v, self._u)]

    def signed_distances(self, x: Floats) -> Floats:
        """Returns φ at the knots, shape (N+1, m) [m]."""
        return self.world.calc_signed_distance(self.split(x)[0])

    def scenario_cost(self, x: Floats) -> float:
        """Returns J = w_u Σ dt ‖u_k‖² + w_f ‖q_N − goal‖², without penalties or added costs."""
        q, _, u = self.split(x)
        return rows.calc_cost(self.scenario, self.GetSampleTimes(), q, u)

    def elimination_order(self) -> Ints:
        """Returns all decision variables' indices by stage: Newton systems are banded then."""
        return np.concatenate([self._stage_indices(k) for k in range(self.num_samples())])

    def _stage_indices(self, k: int) -> Ints:
        """Returns the decision variables of knot k and of the step after it."""
        return np.concatenate([self._q[k], self._v[k], self._clearances[k], *self._u[k : k + 1]])

    @cached_property
    def scales(self) -> Scales:
        """The task's own units."""
        return Scales.of(self.world, self.scenario)

    def length_scale(self) -> float:
        """Returns the longest of the ways to the goal and, from both ends, to the wall [m]."""
        return self.scales.length

    def inertia(self) -> float:
        """Returns the largest entry of B⁺ M at the start: control per acceleration [kg]."""
        return calc_inertia(self.world, self.scenario.initial_position)

    def cost_scale(self) -> float:
        """Returns the unit of penalty weights and temperatures."""
        return 1.0


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
