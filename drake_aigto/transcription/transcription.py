"""From a contact problem to a MathematicalProgram, in the words of Drake's MultipleShooting."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.solvers import MathematicalProgram, MathematicalProgramResult
from pydrake.symbolic import Expression
from pydrake.trajectories import PiecewisePolynomial

from drake_aigto.arrays import Bools, Floats
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import rows
from drake_aigto.transcription.open_program import OpenProgram
from drake_aigto.world import Scenario, World

_START = "initial state"

# The least part that a box around a motion has of its last knot's half widths.
_LEAST_GROWN = 1e-2


class Transcription(OpenProgram):
    """A contact problem as a MathematicalProgram over knots k = 0 … N (AIGTO Sec. III-B, IV).

        minimize over q_k, v_k, u_k    Σ_{k<N} dt g(x_k, u_k) + g_N(x_N),     x = [q, v]
        subject to                     x_0 given, the subclass's dynamics and contact rows

    where g starts as w_u ‖u‖² and g_N as w_f ‖q_N − goal‖². Every row and cost of a kind shares one
    evaluator, whose description names it. Contact forces are never decision variables: the subclass
    eliminates them.

    The decision variables are q, v and u, then, for contacts whose φ reads several coordinates,
    clearances s_k = φ(q_k): bounds and penalties need an inequality in one variable. The program is
    made when it is first asked for.

    Shape letters: N time steps, nq positions, nv = nq velocities, nu controls, m contacts.

    Attributes:
        ROWS: names of the kinds of rows that there may be.
    """

    ROWS: ClassVar[tuple[str, ...]]

    def __init__(self, world: World, scenario: Scenario) -> None:
        """Lays out the variables.

        Raises:
            ScenarioError, ModelError: see `World.check_plain`.
        """
        world.check_plain(scenario)
        super().__init__(world, scenario)

    @property
    def _always_met(self) -> tuple[str, ...]:
        # Which face of a box keeps a motion out depends on the motion.
        has_boxes = self.world.num_solids < self.world.num_contacts
        return (
            (_START, rows.CLEARANCE) if has_boxes else (_START, rows.CLEARANCE, rows.NONPENETRATION)
        )

    def _add_scenario(self) -> None:
        """Adds the initial state, the scenario's costs, then the subclass's rows."""
        world, scenario, given = self.world, self.scenario, self._given
        start = scenario.initial_state
        self._bound(self.state(0), start, start, _START)
        # NumPy takes Drake's boxed constants for invalid numbers, and warns.
        with np.errstate(invalid="ignore"):
            u = world.controls
            error = world.positions - given.goal
            effort = rows.as_expression(given.control_weight * u.dot(u))
            self._bind_stages(rows.shared_cost(self._duration * effort, "control effort"))
            miss = rows.as_expression(given.goal_weight * error.dot(error))
            self._bind(rows.shared_cost(miss, "goal"), self.num_samples() - 1)
            for column, contact in enumerate(self._clearance_contacts):
                distance = self.world.contacts[contact].signed_distance
                row = rows.shared_constraint(
                    Expression(self._clearance[column]) - distance, rows.CLEARANCE
                )
                self._bind_each(row, range(len(self._q)))
            self._add_rows()

    @abstractmethod
    def _add_rows(self) -> None:
        """Adds the dynamics and contact rows to the program."""

    def _bound_distances(self, where: Bools) -> None:
        """Adds φ_i(q_k) ≥ 0 where the mask, shape (N+1, m), is True, k ≥ 1."""
        for i, knots in enumerate(where[1:].T):
            if np.any(knots):
                row = rows.shared_constraint(self._distance(i), rows.NONPENETRATION, 0.0, np.inf)
                self._bind_each(row, (np.flatnonzero(knots) + 1).tolist())

    def _distance(self, contact: int) -> Expression:
        """Returns φ of a contact in placeholders: its clearance if it reads several positions."""
        if contact not in self._clearance_contacts:
            return self.world.contacts[contact].signed_distance
        return Expression(self._clearance[self._clearance_contacts.index(contact)])

    def SetInitialTrajectory(
        self, traj_init_u: PiecewisePolynomial, traj_init_x: PiecewisePolynomial
    ) -> None:
        """Sets the program's initial guess to samples of a control and a state trajectory."""
        times = self.GetSampleTimes()
        states = np.array([traj_init_x.value(t).ravel() for t in times])
        nq = self.world.num_positions
        controls = np.array([traj_init_u.value(t).ravel() for t in times[:-1]])
        for indices, values in (
            (self._q, states[:, :nq]),
            (self._v, states[:, nq:]),
            (self._u, controls),
        ):
            self._prog.SetInitialGuess(self._variables_at(indices), values)

    def GetInputSamples(self, result: MathematicalProgramResult) -> Floats:
        """Returns the controls, shape (nu, N), one column per knot as in Drake."""
        return self.split(result.get_x_val())[2].T

    def GetStateSamples(self, result: MathematicalProgramResult) -> Floats:
        """Returns the states, shape (nq + nv, N+1), one column per knot as in Drake."""
        q, v, _ = self.split(result.get_x_val())
        return np.hstack([q, v]).T

    def ReconstructInputTrajectory(self, result: MathematicalProgramResult) -> PiecewisePolynomial:
        """Returns the control as a zero-order hold."""
        return self.trajectory(result.get_x_val()).to_piecewise()[1]

    def ReconstructStateTrajectory(self, result: MathematicalProgramResult) -> PiecewisePolynomial:
        """Returns the state [q, v] over time."""
        return self.trajectory(result.get_x_val()).to_piecewise()[0]

    def initial_box(self) -> tuple[Floats, Floats]:
        """Returns center and half width, over all decision variables, of AIGO's first box.

        The center goes straight from start to goal. With L the `length_scale`, positions get a half
        width of L, velocities 2L/T and controls 4 M L/T² (which cover 2L in T by accelerating and
        braking), cut to the program's bounds.
        Variables that the program fixes get half width 0.
        """
        return self._box(self.straight_line(), np.ones(self.num_samples()))

    def straight_line(self) -> Floats:
        """Returns all decision variables on the straight line from start to goal, not controlled.

        They need no program, as the program's bounds do.
        """
        q0, goal = self.scenario.initial_position, self.scenario.goal_position
        path = np.linspace(q0, goal, self.num_samples())
        velocities = np.tile((goal - q0) / self.scenario.duration, (len(path), 1))
        velocities[0] = self.scenario.initial_velocity
        return self.vector_of(path, velocities, np.zeros(self._u.shape))

    def box_around(
        self, positions: Floats, velocities: Floats, share: float
    ) -> tuple[Floats, Floats]:
        """Returns center and half width of a box around a motion, narrow at first.

        Half widths are those of `initial_box` times share · (t/T)², like deviations by an unknown
        push, but at least a hundredth of the last ones. Controls are around zero. Positions
        (N+1, nq) [m] and velocities (N+1, nv) [m/s] are those at the knots.
        """
        grown = np.maximum(np.linspace(0, 1, self.num_samples()) ** 2, _LEAST_GROWN)
        center = self.vector_of(positions, velocities, np.zeros(self._u.shape))
        return self._box(center, share * grown)

    def _box(self, center: Floats, shares: Floats) -> tuple[Floats, Floats]:
        """Returns center and half width, the latter times a share at each knot, within bounds."""
        q0, T = self.scenario.initial_position, self.scenario.duration
        length, inertia = self.length_scale(), self.inertia()
        reach = length * np.sum(np.abs(self.world.calc_contact_jacobian(q0)), axis=1)
        column = shares[:, np.newaxis]
        half_width = self._join(
            length * column,
            2 * length / T * column,
            4 * inertia * length / T**2 * column[-1:],
            column * reach[self._clearance_contacts],
        )
        for row in self._rows:
            row.widen(center, half_width)
        return rows.cut_to(self.bounds(), center, half_width)

    def penalized(self) -> MathematicalProgram:
        """Returns `prog` with constraints as costs, each row r_k as r_k²/dt.

        So weights mean the same for every N.
        """
        return rows.penalize(self._prog, scale=1 / self._dt)

    def _stage(self, k: int) -> list[tuple[NDArray[Any], NDArray[Any]]]:
        """Returns pairs of placeholders and their variables at knot k."""
        clearances = self._variables_at(self._clearances[k])
        pairs = [(self.state(), self.state(k)), (self._clearance, clearances)]
        if self._symbols is not None:
            pairs.append((self._symbols.vector(), self._symbols.vector()))
        if k < len(self._u):
            pairs += [
                (self.input(), self.input(k)),
                (self._next_q, self._variables_at(self._q[k + 1])),
                (self._next_v, self._variables_at(self._v[k + 1])),
            ]
        return pairs


def rigid_defects(world: World, restitution: ArrayLike, trajectory: Trajectory) -> dict[str, float]:
    """Returns defects of a trajectory as a motion with rigid impacts at its knots.

    With v⁺_k = v_k + M⁻¹ Jᵀ p_k, τ_k = t_{k+1} − t_k and means over the interval marked by a bar:

        flight          ‖q_{k+1} − q_k − τ_k v̄_k‖∞                                           [m]
        dynamics        ‖v_{k+1} − v⁺_k − τ_k M⁻¹ (B u_k − h(q̄_k, v̄_k) + Jᵀ λ_k)‖∞           [m/s]
        contact         min(φ_k, τ_k p_k/m): the wall pushes from afar; φ_k, φ_{k+1} if λ_k ≠ 0  [m]
        restitution     min(p_k/m, |φ̇⁺_k + e φ̇_k|): the impact returns another speed         [m/s]

    the largest over all contacts, where m is the effective mass of a contact, so that p/m is the
    change of φ̇ by its own impulse. Likewise a pull, p_k < 0 or λ_k < 0, counts as restitution.

    Args:
        world: the plant, read.
        restitution: e of every contact, shape (m,), or of all.
        trajectory: the motion.
    """
    inertia = world.constant_inertia
    J, kicks, masses = inertia.jacobian, inertia.kicks, inertia.masses
    tau = np.diff(trajectory.times)[:, np.newaxis]
    q, v, u = trajectory.positions, trajectory.velocities, trajectory.controls
    jumps, pushes = trajectory.impulses / masses, tau * trajectory.forces / masses
    after = v + trajectory.impulses @ kicks
    q_mean, v_mean = (q[:-1] + q[1:]) / 2, (after[:-1] + v[1:]) / 2
    free = world.calc_acceleration(q_mean, v_mean, u)
    gaps = np.abs(world.calc_signed_distance(q))
    reach = np.vstack([tau, tau[-1]]) * np.abs(jumps)
    missed = np.abs(after @ J.T + np.asarray(restitution) * (v @ J.T))
    held = np.where(trajectory.forces != 0, np.maximum(gaps[:-1], gaps[1:]), 0.0)
    return {
        rows.FLIGHT: float(np.abs(q[1:] - q[:-1] - tau * v_mean).max()),
        rows.DYNAMICS: float(
            np.abs(v[1:] - after[:-1] - tau * (free + trajectory.forces @ kicks)).max()
        ),
        rows.CONTACT: float(max(np.minimum(gaps, reach).max(), held.max())),
        rows.RESTITUTION: float(
            max(np.minimum(np.abs(jumps), missed).max(), -jumps.min(), -pushes.min(), 0.0)
        ),
    }
