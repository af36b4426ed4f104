"""AIGO for any mechanism: boxes of its positions shrink to centers that shooting closes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

from drake_aigto.aigo import Box, CenterObjective, minimize
from drake_aigto.arrays import Bools, Floats, interpolate
from drake_aigto.box import Order, ParametricPolynomial
from drake_aigto.contact import CompliantLaw, ContactLaw
from drake_aigto.planning.rungs import MechanismRung, Renewal, Shrinking
from drake_aigto.shooting import NO_TERMS, AddedTerms, Mechanism
from drake_aigto.transcription import (
    COST,
    DISTANCES,
    GOAL,
    NO_ADDITIONS,
    ROWS,
    Additions,
    Ends,
    MechanismProgram,
)
from drake_aigto.world import World

_POINT_STEPS, _POINT_TOLERANCE = 30, 1e-3
_GOAL_WEIGHT = 10.0  # of a hard goal, in the cost of standing still: 10 at a distance of L
# Programs of boxes that are kept, at most: durations and weights may change with every scenario.
_MOST_PROGRAMS = 32
_SAMPLES = 16  # of a motion, for typical values
_NEXT_DURATION = 1.1  # ratio of neighboring durations of boxes, where these are free


@dataclass(frozen=True, eq=False)
class Center:
    """Center of a box that has shrunk: positions over time, perhaps infeasible.

    Attributes:
        times: t_0 … t_N, shape (N + 1,) [s].
        positions: q_0 … q_{N+1}, shape (N + 2, n).
        velocities: v_0 … v_N, shape (N + 1, n).
        controls: that the positions require, within bounds, shape (N + 1, nu).
        boxes: of z, as they shrank; the first is the start.
        iterations: Newton steps.
    """

    times: Floats
    positions: Floats
    velocities: Floats
    controls: Floats
    boxes: tuple[Box, ...]
    iterations: int

    def lasting(self, start: float, end: float) -> Center:
        """Returns the same path from one time to another [s]."""
        pace = (end - start) / self.times[-1]
        return replace(self, times=start + pace * self.times, velocities=self.velocities / pace)

    def sample(self, times: Floats) -> tuple[Floats, Floats]:
        """Returns states (K + 1, 2n) at times, and controls to hold from each to the next, (K, nu).

        Positions are cubic between knots, and controls linear; their means are held.
        """
        states = sample_cubic(self.times, self.positions[:-1], self.velocities, times)
        return states, interpolate((times[1:] + times[:-1]) / 2, self.times, self.controls)


def round_duration(duration: float, usual: float) -> float:
    """Returns one of the few durations that boxes are compiled for, the usual one among them."""
    number = np.round(np.log(duration / usual) / np.log(_NEXT_DURATION))
    return float(usual * _NEXT_DURATION**number)


def sample_cubic(knots: Floats, positions: Floats, velocities: Floats, times: Floats) -> Floats:
    """Returns states at times, cubic between knots that have these q and v, shape (K, 2n)."""
    motion = PiecewisePolynomial.CubicHermite(knots, positions.T, velocities.T)
    each = motion.vector_values(times), motion.MakeDerivative().vector_values(times)
    return np.vstack(each).T


def _bump(count: int) -> Floats:
    """Returns half a sine wave, 0 beyond both ends, shape (count, 1)."""
    return np.sin(np.pi * np.arange(1, count + 1) / (count + 1))[:, np.newaxis]


class MechanismBoxes:
    """Boxes of a mechanism's motion from one start to one goal.

    Args:
        program: of positions.
        control_bounds: of u, shape (2, nu) [N, N m]; only used in `Center.controls`.
        ends: start and goal.
        compiled: the program's polynomial, which serves all ends; None: compiled here.
    """

    def __init__(
        self,
        program: MechanismProgram,
        control_bounds: Floats,
        ends: Ends,
        compiled: ParametricPolynomial | None = None,
    ) -> None:
        """Sets the program's parameters."""
        self.program, self.ends, self._bounds = program, ends, control_bounds
        n, order = program.num_variables, (Order.MEAN, Order.CENTERS, Order.BOXES)
        self._compiled = compiled or ParametricPolynomial(
            n, program.num_parameters, program.blocks, np.arange(n), order
        )
        self._num_free = np.count_nonzero(program.is_free)
        self.polynomial = self._compiled.at(program.parameters(ends))

    def start(self, ends: Ends) -> MechanismBoxes:
        """Returns the boxes from another start to another goal."""
        return MechanismBoxes(self.program, self._bounds, ends, self._compiled)

    def rest(self) -> Floats:
        """Returns the path of standing still, shape (2, n)."""
        return np.tile(self.ends.position, (2, 1))

    def line(self) -> Floats:
        """Returns the straight line to the goal, shape (2, n).

        For a hinge that counts modulo 2π, that is to the nearest goal.
        """
        q, _, cost = self.ends
        return np.vstack([q, np.where(cost.is_modulo, q - cost.goal_errors(q), cost.goal)])

    @cached_property
    def temperature_unit(self) -> float:
        """Cost of standing still and holding that, per free variable."""
        world, (q, _, cost), T = self.program.world, self.ends, self.program.duration
        rest = np.zeros_like(q)
        hold = world.inverse_actuation @ world.calc_bias(q, rest)
        times = np.linspace(0.0, T, _SAMPLES)
        waiting = np.mean(cost.running(times, q, rest, hold)) * T + cost.final(q, rest)
        return float(waiting or 1.0) / self._num_free

    @cached_property
    def weight_unit(self) -> float:
        """W under which typical accelerations cost as much as standing still."""
        world, v, T = self.program.world, self.ends.velocity, self.program.duration
        start, goal = self.line()
        path = np.linspace(start, goal, _SAMPLES)
        falls = np.linalg.solve(
            world.calc_mass_matrix(path), world.calc_bias(path, 0 * path)[..., np.newaxis]
        )
        square = np.mean(np.sum(falls**2, axis=(1, 2)))
        square += np.sum((goal - start) ** 2) / T**4 + np.sum(v**2) / T**2
        return self.temperature_unit * self._num_free / (T * (square or 1.0))

    @cached_property
    def widths(self) -> Floats:
        """Units of half widths of z at a knot, shape (n + S,): 1 rad, and a length of the task.

        That is the longest way of a slider to its goal or of a contact at the start, or 1 m.
        """
        world, (q, _, cost) = self.program.world, self.ends
        coordinates = self.program.coordinates
        ways = np.abs(cost.goal - q)[~world.is_hinge]
        if coordinates.contacts:
            distances = world.calc_signed_distance(q)[list(coordinates.contacts)]
            ways = np.concatenate([ways, np.abs(distances)])
        found = np.full(coordinates.num_variables, float(np.max(ways, initial=0.0)) or 1.0)
        found[: len(q)][world.is_hinge] = 1.0
        return found

    def run(self, rung: MechanismRung, path: Floats) -> Center:
        """Returns the center of a rung's boxes.

        Args:
            rung: how they shrink.
            path: positions at even times from 0 to T, shape (K, n), K ≥ 2.
        """
        program = self.program
        times = program.time_step * np.arange(program.num_steps + 2)
        given = np.linspace(0.0, program.duration, len(path))
        q = interpolate(times, given, path)
        if rung.shift:
            q[1:] += _bump(len(q) - 1) * np.array(rung.shift) * self.widths[: q.shape[1]]
        q[-1] = 2 * q[-2] - q[-3]
        return self._shrink(rung, program.calc_variables(q, self.ends), program.is_free)

    def renew(self, positions: Floats, renewal: Renewal) -> Center:
        """Returns the center after a stretch of a motion is perturbed and opened.

        Args:
            positions: at the knots, shape (N + 2, n).
            renewal: which stretch, and how.
        """
        knots = np.arange(renewal.first, min(renewal.first + renewal.count, len(positions)))
        q = positions.copy()
        q[knots] += _bump(len(knots)) * renewal.shift * self.widths[: q.shape[1]]
        is_open = np.zeros((len(positions), len(self.widths)), dtype=bool)
        is_open[knots] = True
        z = self.program.calc_variables(q, self.ends)
        return self._shrink(renewal, z, self.program.is_free & is_open.ravel())

    def _shrink(self, how: Shrinking, z: Floats, is_open: Bools) -> Center:
        W, waiting = how.weight * self.weight_unit, self.temperature_unit * self._num_free
        weights = {COST: 1.0, ROWS: W, DISTANCES: W, GOAL: _GOAL_WEIGHT * waiting}
        known = self.polynomial.weights
        f = self.polynomial.with_weights({name: weights[name] for name in known})
        if how.half_width == 0:
            found = CenterObjective(f, is_open, _POINT_TOLERANCE).descend(z, _POINT_STEPS)
            return self._center((Box(found.x, np.zeros_like(z)),), found.steps)
        widths = how.half_width * np.tile(self.widths, self.program.num_steps + 2)
        first = Box(z, np.where(is_open, widths, 0.0))
        result = minimize(f, first, how.annealing(self.temperature_unit))
        return self._center(tuple(each.box for each in result.history), result.num_inner_steps)

    def _center(self, boxes: tuple[Box, ...], iterations: int) -> Center:
        q = self.program.calc_positions(boxes[-1].center)
        _, v, _ = self.program.calc_motion(q, self.ends)
        u = np.clip(self.program.calc_controls(q, self.ends), *self._bounds)
        times = np.linspace(0.0, self.program.duration, len(u))
        return Center(times, q, v, u, boxes, iterations)


@dataclass(frozen=True, eq=False)
class CompiledMechanism:
    """Programs that all tasks with one contact law share.

    Attributes:
        mechanism: the world as shooting has it.
        boxes: the last boxes, by the weights, bounds, duration and steps of their programs.
        additions: costs and constraints of users.
        added: these, compiled for shooting.
    """

    mechanism: Mechanism
    boxes: dict[tuple[Any, ...], MechanismBoxes]
    additions: Additions = NO_ADDITIONS
    added: AddedTerms = NO_TERMS

    @classmethod
    def of(cls, world: World, law: ContactLaw, additions: Additions) -> CompiledMechanism:
        """Compiles a world with its contact law, and costs and constraints of users.

        Raises:
            ProgramError, UnsupportedTermError: see `AddedTerms.of`.
        """
        added = AddedTerms.of(world, additions) if additions else NO_TERMS
        return cls(Mechanism.of(world, law), {}, additions, added)

    def find_boxes(
        self,
        world: World,
        ends: Ends,
        springs: CompliantLaw,
        duration: float,
        num_steps: int,
        is_hard: Bools,
        control_bounds: Floats,
    ) -> MechanismBoxes:
        """Returns boxes (`MechanismProgram`), compiled if no others have their program."""
        task = ends.cost
        weights = task.R, task.Q, task.Qv, task.QT, task.QTv, task.is_chordal, task.is_modulo
        arrays = *weights, is_hard, control_bounds, springs.stiffness, springs.dissipation
        key = num_steps, duration, *(each.tobytes() for each in arrays)
        if (known := self.boxes.get(key)) is not None:
            return known.start(ends)
        program = MechanismProgram(world, task, springs, duration, num_steps, is_hard)
        if len(self.boxes) >= _MOST_PROGRAMS:
            self.boxes.pop(next(iter(self.boxes)), None)
        boxes = self.boxes[key] = MechanismBoxes(program, control_bounds, ends)
        return boxes
