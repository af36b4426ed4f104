"""The decision variables over knots k = 0 … N, and the motion of their values."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np
from pydrake.solvers import MathematicalProgram

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.errors import ProgramError
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import Scales, Scenario, World, calc_inertia

# A time within this part of the duration is that of a knot: rounding.
_ON_KNOT = 1e-9


def calc_cost(scenario: Scenario, motion: Trajectory) -> float:
    """Returns J = w_u Σ h_k ‖u_k‖² + w_f ‖q_N − goal‖², without penalties or added costs."""
    effort = np.diff(motion.times) @ np.sum(motion.controls**2, axis=1)
    miss = np.sum((motion.positions[-1] - scenario.goal_position) ** 2)
    return float(scenario.control_weight * effort + scenario.goal_weight * miss)


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

    def scatter(self, name: str, mask: Bools) -> Ints:
        """Returns new variables where the mask is True, in an array of its shape; −1 elsewhere."""
        places = np.full(mask.shape, -1)
        places[mask] = self.new(name, int(np.sum(mask)))
        return places

    def add_to(self, prog: MathematicalProgram) -> None:
        """Adds the variables to an empty program."""
        for name, shape in self._groups:
            prog.NewContinuousVariables(*shape, name)


class Knots(ABC):
    """The numbers of a transcription: from a vector of all decision variables to a motion and back.

    They are q, v and u, then, for contacts whose φ reads several coordinates, clearances
    s_k = φ(q_k), and what the subclass adds.

    Shape letters: N time steps, nq positions, nv = nq velocities, nu controls, m contacts.
    """

    # The last read-only vector and its trajectory.
    _last: tuple[Floats | None, Trajectory | None] = (None, None)

    def __init__(self, world: World, scenario: Scenario) -> None:
        """Lays out the variables."""
        self.world = world
        self.scenario = scenario
        self._dt = scenario.time_step
        self._layout = Layout()
        self._lay_out()

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

    def _num_variables(self) -> int:
        return self._layout.size

    @abstractmethod
    def defects(self, x: Floats) -> dict[str, float]:
        """Returns the largest violation of each kind of row at x, in that row's unit (m, m/s)."""

    @abstractmethod
    def impulses(self, x: Floats) -> Floats:
        """Returns the contact impulses that x implies, shape (N+1, m) [N s]."""

    def forces(self, x: Floats) -> Floats:
        """Returns the contact forces that are held over each step, shape (N, m) [N]."""
        return np.zeros((len(self._u), self.world.num_contacts))

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

    def sample_times(self, x: Floats) -> Floats:
        """Returns the knots' times at x, shape (N+1,) [s]."""
        return self.GetSampleTimes()

    def trajectory(self, x: Floats) -> Trajectory:
        """Returns the trajectory of a vector of all decision variables.

        That of a read-only vector is kept until the next call.
        """
        known, trajectory = self._last
        if x is not known or trajectory is None:
            q, v, u = self.split(x)
            trajectory = Trajectory(self.sample_times(x), q, v, u, self.impulses(x), self.forces(x))
            self._last = (None, None) if x.flags.writeable else (x, trajectory)
        return trajectory

    def vector(self, trajectory: Trajectory) -> Floats:
        """Returns all decision variables of a trajectory at these knots; undoes `trajectory`."""
        return self.vector_of(trajectory.positions, trajectory.velocities, trajectory.controls)

    def vector_of(self, positions: Floats, velocities: Floats, controls: Floats) -> Floats:
        """Returns all decision variables, for arrays as `split` returns them."""
        clearances = self.world.calc_signed_distance(positions)[:, self._clearance_contacts]
        return self._join(positions, velocities, controls, clearances)

    def _join(self, *parts: Floats) -> Floats:
        """Returns q, v, u and clearances in the program's order; other variables are 0."""
        x = np.zeros(self._num_variables())
        for indices, values in zip(
            (self._q, self._v, self._u, self._clearances), parts, strict=True
        ):
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
        durations = np.diff(self.sample_times(x))
        effort = self.scenario.control_weight * durations @ np.sum(u**2, axis=1)
        miss = self.scenario.goal_weight * np.sum((q[-1] - self.scenario.goal_position) ** 2)
        return float(effort + miss)

    def elimination_order(self) -> Ints:
        """Returns all decision variables' indices by stage: Newton systems are banded then."""
        return np.concatenate([self._stage_indices(k) for k in range(self.num_samples())])

    def _stage_indices(self, k: int) -> Ints:
        """Returns the decision variables of knot k and of the step after it."""
        rows = self._q[k], self._v[k], self._clearances[k], *self._u[k : k + 1]
        return np.concatenate(rows)

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
