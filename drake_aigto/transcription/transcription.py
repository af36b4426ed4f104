"""From a contact problem to a MathematicalProgram, in the words of Drake's MultipleShooting."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.solvers import MathematicalProgram, MathematicalProgramResult
from pydrake.symbolic import Expression, Formula, MakeVectorVariable, Variable
from pydrake.trajectories import PiecewisePolynomial

from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription.penalties import InequalityPenalty, cut_to_bounds, penalize
from drake_aigto.transcription.shared import (
    SharedEvaluator,
    as_expression,
    shared_constraint,
    shared_cost,
    substitutions,
)
from drake_aigto.world import Scenario, World

if TYPE_CHECKING:
    import numpy.typing as npt

NONPENETRATION = "nonpenetration"
CLEARANCE = "clearance"

# The least part that a box around a motion has of its last knot's half widths.
_LEAST_GROWN = 1e-2


class Transcription(ABC):
    """A contact problem as a MathematicalProgram over knots k = 0 … N (AIGTO Sec. III-B, IV).

        minimise over q_k, v_k, u_k    Σ_{k<N} dt g(x_k, u_k) + g_N(x_N),     x = [q, v]
        subject to                     x_0 given, the subclass's dynamics and contact rows

    where g starts as w_u ‖u‖² and g_N as w_f ‖q_N − goal‖². Every row and cost of a kind shares one
    evaluator, whose description names it. Contact forces are never decision variables: the subclass
    eliminates them.

    The decision variables are q, v and u, then, for contacts whose φ reads several coordinates,
    clearances s_k = φ(q_k): bounds and penalties need an inequality in one variable.

    Shape letters: N time steps, nq positions, nv = nq velocities, nu controls, m contacts.
    """

    def __init__(self, world: World, scenario: Scenario) -> None:
        """Makes variables, initial state, the scenario's costs, then the subclass's rows."""
        self.world = world
        self.scenario = scenario
        self._dt = scenario.time_step
        self._prog = MathematicalProgram()
        # What users add: applied again to the phases of a contact sequence.
        self._additions: list[Callable[[Transcription], None]] = []
        self._make_variables()

        start = np.concatenate([scenario.initial_position, scenario.initial_velocity])
        self._prog.AddBoundingBoxConstraint(
            start, start, self.state(0)
        ).evaluator().set_description("initial state")
        # NumPy takes Drake's boxed constants for invalid numbers, and warns.
        with np.errstate(invalid="ignore"):
            u = world.controls
            error = world.positions - scenario.goal_position
            self._add_running_cost(scenario.control_weight * u.dot(u), "control effort")
            self._add_final_cost(scenario.goal_weight * error.dot(error), "goal")
            self._add_rows()

    def _make_variables(self) -> None:
        """Makes the decision variables, and placeholders for those of a stage."""
        N, world = self.scenario.num_steps, self.world
        self._q = self._prog.NewContinuousVariables(N + 1, world.num_positions, "q")
        self._v = self._prog.NewContinuousVariables(N + 1, world.num_velocities, "v")
        self._u = self._prog.NewContinuousVariables(N, world.num_actuators, "u")
        # A stage's start and control are the world's own variables; this is its end.
        self._next_q = MakeVectorVariable(world.num_positions, "q_next")
        self._next_v = MakeVectorVariable(world.num_velocities, "v_next")
        self._duration = Expression(self._dt)
        # Column by column, of those contacts whose φ reads several coordinates.
        self._clearances = np.empty((N + 1, 0), dtype=object)
        self._clearance = np.empty(0, dtype=object)
        self._clearance_contacts: list[int] = []
        # Placeholder id → decision variable, of each stage that something was bound to.
        self._chosen: dict[int, dict[int, Variable]] = {}

    @abstractmethod
    def _add_rows(self) -> None:
        """Adds the dynamics and contact rows to the program."""

    def _bound_distances(
        self,
        where: npt.NDArray[np.bool_],
        name: str = NONPENETRATION,
        lower: float = 0.0,
        upper: float = np.inf,
    ) -> None:
        """Adds lower ≤ φ_i(q_k) ≤ upper where the mask, shape (N+1, m), says so, k ≥ 1."""
        for i, knots in enumerate(where[1:].T):
            if np.any(knots):
                row = shared_constraint(self._distance(i), name, lower, upper)
                self._bind_each(row, (np.flatnonzero(knots) + 1).tolist())

    def _distance(self, contact: int) -> Expression:
        """Returns φ of a contact in placeholders, as its clearance if it reads several positions.

        Such a clearance is added the first time: variables s_k with rows s_k = φ(q_k).
        """
        distance = self.world.contacts[contact].signed_distance
        if len(distance.GetVariables()) <= 1:
            return distance
        if contact not in self._clearance_contacts:
            self._add_clearance(contact)
        return Expression(self._clearance[self._clearance_contacts.index(contact)])

    def _add_clearance(self, contact: int) -> None:
        name = f"s{contact}"
        variables = self._prog.NewContinuousVariables(len(self._q), 1, name)
        self._clearances = np.hstack([self._clearances, variables])
        self._clearance_contacts.append(contact)
        self._clearance = np.append(self._clearance, MakeVectorVariable(1, name))
        self._chosen.clear()
        distance = self.world.contacts[contact].signed_distance
        row = shared_constraint(Expression(self._clearance[-1]) - distance, CLEARANCE)
        self._bind_each(row, range(len(self._q)))

    @abstractmethod
    def defects(self, x: npt.NDArray[np.float64]) -> dict[str, float]:
        """Returns the largest violation of each kind of row at x, in that row's unit (m, m/s)."""

    @abstractmethod
    def impulses(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Returns the contact impulses that x implies, shape (N+1, m) [N s]."""

    def forces(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Returns the contact forces that are held over each step, shape (N, m) [N]."""
        return np.zeros((len(self._u), self.world.num_contacts))

    def close_rows(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Returns x with the rounding that a solver left in the rows taken out, where it can be."""
        return x

    def _depth(self, x: npt.NDArray[np.float64]) -> float:
        """Returns how deep inside of solids the knots are after the start, 0 outside [m]."""
        clearances = [self.world.calc_clearance(q) for q in self.split(x)[0][1:]]
        return max(0.0, -float(np.min(clearances)))

    def prog(self) -> MathematicalProgram:
        """Returns the constrained program; add costs and constraints until it is solved."""
        return self._prog

    def num_samples(self) -> int:
        """Returns the number of knots, N + 1."""
        return len(self._q)

    def time_step(self, k: int = 0) -> float:
        """Returns the length of step k [s]; all are equal."""
        return self._dt

    def state(self, k: int | None = None) -> npt.NDArray[Any]:
        """Returns x_k = [q_k, v_k], shape (nq + nv,); without k, placeholders for it."""
        if k is None:
            return np.concatenate([self.world.positions, self.world.velocities])
        return np.concatenate([self._q[k], self._v[k]])

    def input(self, k: int | None = None) -> npt.NDArray[Any]:
        """Returns u_k, shape (nu,), 0 ≤ k < N; without k, placeholders for it."""
        return self.world.controls if k is None else self._u[k]

    def initial_state(self) -> npt.NDArray[Any]:
        """Returns x_0."""
        return self.state(0)

    def final_state(self) -> npt.NDArray[Any]:
        """Returns x_N."""
        return self.state(self.num_samples() - 1)

    def AddRunningCost(self, g: Any, description: str = "running cost") -> None:
        """Adds Σ_{k<N} dt g(x_k, u_k).

        Args:
            g: polynomial in the placeholders `state()` and `input()`.
            description: its name in the program and in costs by name.
        """
        self._additions.append(lambda other: other.AddRunningCost(g, description))
        self._add_running_cost(g, description)

    def _add_running_cost(self, g: Any, description: str) -> None:
        self._bind_stages(shared_cost(self._duration * as_expression(g), description))

    def AddFinalCost(self, e: Any, description: str = "final cost") -> None:
        """Adds e(x_N), polynomial in the placeholders `state()`."""
        self._additions.append(lambda other: other.AddFinalCost(e, description))
        self._add_final_cost(e, description)

    def _add_final_cost(self, e: Any, description: str) -> None:
        self._bind(shared_cost(as_expression(e), description), self.num_samples() - 1)

    def AddConstraintToAllKnotPoints(self, f: Formula | npt.NDArray[Any]) -> None:
        """Adds a constraint on placeholders at every knot, as MultipleShooting does.

        Constraints that read the control act at k < N. A bound on one variable, such as `input()[0]
        <= 3`, becomes a bounding box.
        """
        self._additions.append(lambda other: other.AddConstraintToAllKnotPoints(f))
        for formula in np.ravel(np.asarray(f, dtype=object)):
            reads_control = any(formula.GetFreeVariables().include(u) for u in self.world.controls)
            for k in range(len(self._u) if reads_control else self.num_samples()):
                names, values = self.state(), self.state(k)
                if reads_control:
                    names = np.concatenate([names, self.input()])
                    values = np.concatenate([values, self.input(k)])
                self._prog.AddConstraint(
                    formula.Substitute(dict(zip(names, map(Expression, values), strict=True)))
                )

    def add_what_was_added_to(self, other: Transcription) -> None:
        """Adds what users added to another transcription: its costs and constraints.

        Args:
            other: of the same world; it may have other knots.
        """
        for addition in other._additions:
            addition(self)

    def SetInitialTrajectory(
        self, traj_init_u: PiecewisePolynomial, traj_init_x: PiecewisePolynomial
    ) -> None:
        """Sets the program's initial guess to samples of a control and a state trajectory."""
        times = self.GetSampleTimes()
        states = np.array([traj_init_x.value(t).ravel() for t in times])
        nq = self.world.num_positions
        self._prog.SetInitialGuess(self._q, states[:, :nq])
        self._prog.SetInitialGuess(self._v, states[:, nq:])
        self._prog.SetInitialGuess(
            self._u, np.array([traj_init_u.value(t).ravel() for t in times[:-1]])
        )

    def GetSampleTimes(self) -> npt.NDArray[np.float64]:
        """Returns the knots' times, shape (N+1,) [s]."""
        return np.arange(self.num_samples()) * np.float64(self._dt)

    def sample_times(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Returns the knots' times at x, shape (N+1,) [s]."""
        return self.GetSampleTimes()

    def GetInputSamples(self, result: MathematicalProgramResult) -> npt.NDArray[np.float64]:
        """Returns the controls, shape (nu, N), a column a knot as in Drake."""
        return result.GetSolution(self._u).reshape(self._u.shape).T

    def GetStateSamples(self, result: MathematicalProgramResult) -> npt.NDArray[np.float64]:
        """Returns the states, shape (nq + nv, N+1), a column a knot as in Drake."""
        q, v = (result.GetSolution(part).reshape(part.shape) for part in (self._q, self._v))
        return np.hstack([q, v]).T

    def ReconstructInputTrajectory(self, result: MathematicalProgramResult) -> PiecewisePolynomial:
        """Returns the control as a zero-order hold."""
        return self.trajectory(result.get_x_val()).to_piecewise()[1]

    def ReconstructStateTrajectory(self, result: MathematicalProgramResult) -> PiecewisePolynomial:
        """Returns the state [q, v] over time."""
        return self.trajectory(result.get_x_val()).to_piecewise()[0]

    def trajectory(self, x: npt.NDArray[np.float64]) -> Trajectory:
        """Returns the trajectory that a vector of all decision variables stands for."""
        q, v, u = self.split(x)
        return Trajectory(self.sample_times(x), q, v, u, self.impulses(x), self.forces(x))

    def vector(self, trajectory: Trajectory) -> npt.NDArray[np.float64]:
        """Returns all decision variables of a trajectory at these knots; undoes `trajectory`."""
        return self.vector_of(trajectory.positions, trajectory.velocities, trajectory.controls)

    def vector_of(
        self,
        positions: npt.NDArray[np.float64],
        velocities: npt.NDArray[np.float64],
        controls: npt.NDArray[np.float64],
    ) -> npt.NDArray[np.float64]:
        """Returns all decision variables, for arrays as `split` returns them."""
        clearances = self._distances(positions)[:, self._clearance_contacts]
        return self._join(positions, velocities, controls, clearances)

    def _join(self, *parts: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Returns q, v, u and clearances in the program's order; other variables are 0."""
        x = np.zeros(self._prog.num_vars())
        for variables, values in zip(
            (self._q, self._v, self._u, self._clearances), parts, strict=True
        ):
            x[self._prog.FindDecisionVariableIndices(variables.ravel())] = values.ravel()
        return x

    def split(self, x: npt.NDArray[np.float64]) -> list[npt.NDArray[np.float64]]:
        """Returns q (N+1, nq), v (N+1, nv) and u (N, nu) out of all decision variables."""
        return [self._values(x, variables) for variables in (self._q, self._v, self._u)]

    def _values(
        self, x: npt.NDArray[np.float64], variables: npt.NDArray[Any]
    ) -> npt.NDArray[np.float64]:
        """Returns what x gives an array of decision variables, of the same shape."""
        # Drake counts the variables of a matrix column by column.
        indices = self._prog.FindDecisionVariableIndices(variables.ravel())
        return x[indices].reshape(variables.shape)

    def signed_distances(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Returns φ at the knots, shape (N+1, m) [m]."""
        return self._distances(self.split(x)[0])

    def _distances(self, positions: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        return np.array([self.world.calc_signed_distance(q) for q in positions])

    def scenario_cost(self, x: npt.NDArray[np.float64]) -> float:
        """Returns J = w_u Σ dt ‖u_k‖² + w_f ‖q_N − goal‖², without penalties or added costs."""
        q, _, u = self.split(x)
        durations = np.diff(self.sample_times(x))
        effort = self.scenario.control_weight * durations @ np.sum(u**2, axis=1)
        miss = self.scenario.goal_weight * np.sum((q[-1] - self.scenario.goal_position) ** 2)
        return float(effort + miss)

    def elimination_order(self) -> npt.NDArray[np.int64]:
        """Returns all decision variables' indices by stage: Newton systems are banded then."""
        stages = [self._stage_variables(k) for k in range(self.num_samples())]
        return np.array(self._prog.FindDecisionVariableIndices(np.concatenate(stages)))

    def _stage_variables(self, k: int) -> npt.NDArray[Any]:
        """Returns the decision variables of knot k and of the step after it."""
        return np.concatenate([self.state(k), self._clearances[k], *self._u[k : k + 1]])

    def initial_box(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Returns center and half width, over all decision variables, of AIGO's first box.

        The center goes straight from start to goal. With L the `length_scale`, positions get a half
        width of L, velocities 2L/T and controls 4 M L/T² (what covers 2L in T by accelerating and
        braking), cut to the program's bounds.
        Variables that the program fixes get half width 0.
        """
        scenario = self.scenario
        q0, goal = scenario.initial_position, scenario.goal_position
        path = np.linspace(q0, goal, self.num_samples())
        speed = np.broadcast_to((goal - q0) / scenario.duration, self._v.shape)
        return self._box(path, speed, np.ones(self.num_samples()))

    def box_around(
        self,
        positions: npt.NDArray[np.float64],
        velocities: npt.NDArray[np.float64],
        share: float,
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Returns center and half width of a box around a motion, narrow at first.

        Half widths are those of `initial_box` times share · (t/T)², as far off as a push of unknown
        size leads, but at least a hundredth of the last ones. Controls are around zero.

        Args:
            positions: q at the knots, shape (N+1, nq) [m].
            velocities: v at the knots, shape (N+1, nv) [m/s].
            share: of the first box's size, at the end.
        """
        grown = np.maximum(np.linspace(0, 1, self.num_samples()) ** 2, _LEAST_GROWN)
        return self._box(positions, velocities, share * grown)

    def _box(
        self,
        positions: npt.NDArray[np.float64],
        velocities: npt.NDArray[np.float64],
        shares: npt.NDArray[np.float64],
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Returns center and half width, the latter times a share at each knot, within bounds."""
        q0, T = self.scenario.initial_position, self.scenario.duration
        length, inertia = self.length_scale(), self.inertia()
        center = self.vector_of(positions, velocities, np.zeros(self._u.shape))
        reach = length * np.sum(np.abs(self.world.calc_contact_jacobian(q0)), axis=1)
        column = shares[:, np.newaxis]
        half_width = self._join(
            length * np.broadcast_to(column, self._q.shape),
            2 * length / T * np.broadcast_to(column, self._v.shape),
            4 * inertia * length / T**2 * np.broadcast_to(column[-1], self._u.shape),
            column * reach[self._clearance_contacts],
        )
        return cut_to_bounds(self._prog, center, half_width)

    def length_scale(self) -> float:
        """Returns the longest of the ways to the goal and, from both ends, to the wall [m]."""
        q0, goal = self.scenario.initial_position, self.scenario.goal_position
        # A joint askew to the wall has to go farther than φ.
        steepness = np.linalg.norm(self.world.calc_contact_jacobian(q0), axis=1)
        ways = self._distances(np.array([q0, goal])) / steepness
        return float(max(np.max(np.abs(goal - q0)), np.max(ways)))

    def inertia(self) -> float:
        """Returns the largest entry of B⁺ M: control per acceleration [kg]."""
        return float(
            np.max(np.abs(np.linalg.pinv(self.world.actuation) @ self.world.mass_matrix_values))
        )

    def cost_scale(self) -> float:
        """Returns the unit of penalty weights and temperatures."""
        return 1.0

    def penalized(self, inequality: InequalityPenalty = "squared hinge") -> MathematicalProgram:
        """Returns `prog` with constraints as costs, each row r_k as r_k²/dt.

        So weights mean the same for every N.
        """
        return penalize(self._prog, inequality, scale=1 / self._dt)

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
        shared.bind(self._prog, self._chosen[k])

    def _stage(self, k: int) -> list[tuple[npt.NDArray[Any], npt.NDArray[Any]]]:
        """Returns pairs of placeholders and what they stand for at knot k."""
        pairs = [(self.state(), self.state(k)), (self._clearance, self._clearances[k])]
        if k < len(self._u):
            pairs += [
                (self.input(), self.input(k)),
                (self._next_q, self._q[k + 1]),
                (self._next_v, self._v[k + 1]),
            ]
        return pairs
