"""A mechanism's motion as a cost over its positions alone, as inverse dynamics has it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import null_space

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.contact import CompliantLaw, RigidLaw, calc_dissipation
from drake_aigto.terms import Sum, TermBlock, TooManyTermsError, add, constant, multiply, to_terms
from drake_aigto.transcription.mechanism_sums import (
    BoxCoordinates,
    StageSums,
    TrackingSums,
    combine,
    scaled,
    variables,
)
from drake_aigto.world import TaskCost, World, find_anywhere

# Names of blocks: J, rows that no control can meet, distances that are variables, hard goals.
COST, ROWS, DISTANCES, GOAL = "cost", "rows", "distances", "goal"

_LEAST_RESTITUTION = 0.2  # of springs that stand in for rigid walls
_LEAST_MOBILITY = 0.01  # of the one elsewhere: an arm that is not quite stretched out


def soften(world: World, law: RigidLaw, time_step: float, speed: float) -> CompliantLaw:
    """Returns springs that stand in for rigid walls, as soft as time steps require.

    They reverse a speed in π dt, k = 1/(dt² J M⁻¹ Jᵀ) at the plant's default position, where
    explicit steps would become unstable at twice the frequency; their restitution is e at a speed.

    Args:
        world: has M and J.
        law: has μ, and e; it is at least 0.2, as springs with less would pull.
        time_step: dt [s].
        speed: φ̇ of an impact with restitution e [m/s].
    """
    mobility = _calc_mobility(world)
    e = np.maximum(law.restitution, _LEAST_RESTITUTION)
    dissipation = np.array([calc_dissipation(each, speed) for each in e])
    return CompliantLaw(1 / (time_step**2 * mobility), dissipation, law.friction)


class Ends(NamedTuple):
    """Start and cost, which may change from plan to plan.

    Attributes:
        position: q_0, shape (n,) [m, rad].
        velocity: v_0, shape (n,) [m/s, rad/s].
        cost: the same weights as the program's, about any goal or reference.
    """

    position: Floats
    velocity: Floats
    cost: TaskCost


class _Parametric(NamedTuple):
    """A sum Σ_i p_i basis_i at some knots, whose parameters p depend on the ends."""

    name: str
    basis: list[Sum]
    knots: Sequence[int]
    calc: Callable[[Ends], Floats]


class MechanismProgram:
    """J and penalties of a mechanism's motion over its positions at knots.

    With q_k at t_k = k dt, k = 0 … N + 1, the last of them beyond the end, and

        v_k = (q_{k+1} − q_{k−1})/2dt,   a_k = (q_{k+1} − 2 q_k + q_{k−1})/dt²,
        p_k = M(q_k) a_k + h(q_k, v_k) − J(q_k)ᵀ f(q_k, v_k),   q_{−1} = q_1 − 2 dt v_0,

    both ends of second order, the control is the part of p_k along actuators, u_k = B⁺ p_k. The
    rest is a residual r_k = S Nᵀ p_k, with N a basis of the null space of Bᵀ and S its inverse
    inertia, so that r is an acceleration. By the trapezoid rule

        minimize   Σ_k dt [u_kᵀ R u_k + e_kᵀ Q e_k + ė_kᵀ Qv ė_k]
                       + e_NᵀQT e_N + ė_NᵀQTv ė_N                                  "cost"
                 + W Σ_k dt |r_k|²                                                 "rows"
                 + W Σ_k dt |κ (s_k − φ(q_k) + b)|²                                "distances"
                 + W_g |e_N/L|²,   |ė_N T/L|²    where the goal is hard            "goal"

    Boxes are of variables z_k = (y_k, s_k), see `BoxCoordinates`; κ = k J M⁻¹ Jᵀ makes an
    acceleration of an error of a distance.

    All knots between start and end share their sums of terms over (z_{k−1}, z_k, z_{k+1}).
    Values of the ends are `parameters`.

    Args:
        world: the mechanism. M and J in S and κ are those of the plant's default position; of
            several faces of one solid, the one in front of the body pushes.
        cost: the weights; the reference is one point, or one per knot, fixed. An angle that counts
            modulo 2π has a chord, which is smooth, in place of its error.
        law: forces of walls; a stiffness of 0 pushes nothing.
        duration: T [s].
        num_steps: N ≥ 2.
        is_hard: which of q and v have to reach the goal, shape (2n,); None: none.

    Raises:
        UnsupportedTermError: a knot has too many terms.

    Attributes:
        coordinates: z.
        num_variables: (n + S)(N + 2), z_0 first.
        num_parameters: P.
        blocks: terms over the variables, and over parameters behind them.
    """

    def __init__(
        self,
        world: World,
        cost: TaskCost,
        law: CompliantLaw,
        duration: float,
        num_steps: int,
        is_hard: Bools | None = None,
    ) -> None:
        """Expands products."""
        self._is_hard = (
            np.zeros(2 * world.num_positions, dtype=bool) if is_hard is None else is_hard
        )
        self.world, self.cost, self.law, self.num_steps = world, cost, law, num_steps
        self.duration, self.time_step = duration, duration / num_steps
        self._efforts = np.sqrt(cost.R)[:, np.newaxis] * world.inverse_actuation
        self._residuals = _calc_residuals(world)
        is_coupled = np.any(cost.QT - np.diag(np.diag(cost.QT)), axis=1)
        self._is_chordal = cost.is_chordal | (cost.is_modulo & ~is_coupled)
        self.coordinates = BoxCoordinates.of(world, self._find_contacts())
        self.num_variables = self.coordinates.num_variables * (num_steps + 2)
        contacts = list(self.coordinates.contacts)
        springs = law.stiffness[contacts], law.dissipation[contacts]
        try:
            stage = StageSums(world, self.coordinates, *springs, self.time_step)
            self._parametric = [*self._start_sums(stage), *self._tracking_sums(stage)]
            self.num_parameters = sum(len(each.basis) for each in self._parametric)
            fixed = self._fixed_blocks(stage, is_damped=bool(np.any(springs[1])))
            self.blocks = (*fixed, *self._parametric_blocks())
        except TooManyTermsError as error:
            raise error.refusal("a knot of the mechanism's motion", "when multiplied out") from None

    def _find_contacts(self) -> list[int]:
        """Returns the contacts that push."""
        if not self.world.num_contacts:
            return []
        phi = self.world.calc_signed_distance(self.world.plant.GetDefaultPositions())
        facing = (max(faces, key=lambda i: phi[i]) for faces in self.world.solids)
        return [i for i in facing if self.law.stiffness[i] > 0]

    def _fixed_blocks(self, stage: StageSums, is_damped: bool) -> Iterator[TermBlock]:
        """Yields blocks that do not depend on the ends."""
        N, dt, motion = self.num_steps, self.time_step, (stage.positions, stage.velocities)
        effort = _sum_of_squares(self._efforts, stage.forces)
        running, half, final, goal = (each.fixed(*motion) for each in self._tracking())
        rows = scaled(dt, _sum_of_squares(self._residuals, stage.forces))
        rates = np.diag(np.sqrt(dt) * self._calc_rates())
        distances = _sum_of_squares(rates, stage.distances)
        yield from self._block(COST, add(scaled(dt, effort), running), range(1, N))
        yield from self._block(COST, add(scaled(dt / 2, effort), half, final), [N])
        yield from self._block(GOAL, goal, [N])
        yield from self._block(ROWS, rows, range(1, N + 1))
        yield from self._block(DISTANCES, distances, range(1, N + 1 + is_damped))

    def _tracking(self) -> Iterator[TrackingSums]:
        """Yields sums of an inner knot, of the last one as such, of the end, and of its goal."""
        cost, dt = self.cost, self.time_step
        Q, Qv = np.diag(dt * cost.Q), np.diag(dt * cost.Qv)
        hard = np.diag(self._is_hard / self._calc_units() ** 2)
        n = len(Q)
        weights = (Q, Qv), (Q / 2, Qv / 2), (cost.QT, cost.QTv), (hard[:n, :n], hard[n:, n:])
        return (TrackingSums(*each, self._is_chordal) for each in weights)

    def _calc_units(self) -> Floats:
        """Returns L of each position, and L/T of each velocity, shape (2n,)."""
        is_hinge = self.world.is_hinge
        ways = np.abs(self.cost.goal - self.world.plant.GetDefaultPositions())[~is_hinge]
        units = np.where(is_hinge, 1.0, np.max(ways, initial=0.0) or 1.0)
        return np.concatenate([units, units / self.duration])

    def _calc_rates(self) -> Floats:
        """Returns κ of each s [1/s²]."""
        rates = np.zeros(self.coordinates.num_variables)
        found = self.law.stiffness * _calc_mobility(self.world)
        for i, reading in zip(self.coordinates.contacts, self.coordinates.readings, strict=True):
            rates[reading.variable] = max(rates[reading.variable], found[i])
        return rates[self.coordinates.num_positions :]

    def _start_sums(self, stage: StageSums) -> Iterator[_Parametric]:
        """Yields the sums of knot 0: p_0 is affine in q_1, which is q at the knot of the sums."""
        q, n = stage.positions, len(stage.positions)
        basis = [multiply(q[i], q[j]) for i in range(n) for j in range(i, n)]
        basis += [*q, constant(1.0)]
        yield _Parametric(COST, basis, [1], self._calc_start_efforts)
        if len(self._residuals):
            yield _Parametric(
                ROWS, basis, [1], lambda ends: self._calc_start(self._residuals, ends)
            )

    def _calc_start_efforts(self, ends: Ends) -> Floats:
        """Returns the parameters of the cost of knot 0."""
        found = self._calc_start(self._efforts, ends)
        none = np.zeros(len(self.cost.R))
        found[-1] += self.time_step / 2 * ends.cost.running(0.0, ends.position, ends.velocity, none)
        return found

    def _calc_start(self, directions: Floats, ends: Ends) -> Floats:
        """Returns the parameters of ½ dt |directions p_0|²."""
        q, v, dt = ends.position, ends.velocity, self.time_step
        slope = directions @ self.world.calc_mass_matrix(q) * (2 / dt**2)
        offset = directions @ self.calc_forces(q, v, np.zeros_like(q)) - slope @ (q + dt * v)
        square = slope.T @ slope
        upper = (2 * square - np.diag(np.diag(square)))[np.triu_indices(len(q))]
        return dt / 2 * np.concatenate([upper, 2 * slope.T @ offset, [offset @ offset]])

    def _tracking_sums(self, stage: StageSums) -> Iterator[_Parametric]:
        """Yields the sums of goals and references."""
        N, times = self.num_steps, self.time_step * np.arange(self.num_steps + 1)
        is_constant = len(self.cost.times) == 1
        groups = [range(1, N)] if is_constant else [range(k, k + 1) for k in range(1, N)]
        running, half, final, goal = self._tracking()

        def about(tracking: TrackingSums, time: float | None) -> Callable[[Ends], Floats]:
            return lambda ends: tracking.calc_parameters(*self._find_target(ends, time))

        way = ((COST, running, knots, times[knots[0]]) for knots in groups if knots)
        end = [(COST, half, [N], times[N]), (COST, final, [N], None), (GOAL, goal, [N], None)]
        for name, tracking, knots, time in (*way, *(end if np.any(self._is_hard) else end[:2])):
            basis = tracking.basis(stage.positions, stage.velocities)
            yield _Parametric(name, basis, knots, about(tracking, time))

    def _find_target(self, ends: Ends, time: float | None) -> tuple[Floats, Floats]:
        """Returns goals of q and v at a time, or at the end (None).

        Coordinates modulo 2π without chords get the goal nearest to the start.
        """
        cost = ends.cost
        q, v = (cost.goal, cost.goal_velocity) if time is None else cost.reference(time)
        turns = np.round((ends.position - q) / (2 * np.pi)) * (cost.is_modulo & ~self._is_chordal)
        return q + 2 * np.pi * turns, v

    def _parametric_blocks(self) -> Iterator[TermBlock]:
        """Yields blocks that depend on the ends."""
        first = 0
        for name, basis, knots, _ in self._parametric:
            parameters = np.arange(first, first + len(basis))
            local = variables(3 * self.coordinates.num_variables + np.arange(len(basis)))
            total = add(*map(multiply, basis, local))
            yield from self._block(name, total, knots, parameters)
            first += len(basis)

    def _block(
        self, name: str, total: Sum, knots: Sequence[int], parameters: Ints | None = None
    ) -> Iterator[TermBlock]:
        """Yields the block of a sum at knots, if there are any."""
        if not total or not knots:
            return
        num = self.coordinates.num_variables
        places = num * (np.array(knots)[:, np.newaxis] - 1) + np.arange(3 * num)
        # A distance beyond the end reads no neighbor.
        places = np.minimum(places, self.num_variables - 1)
        if parameters is not None:
            columns = np.tile(self.num_variables + parameters, (len(knots), 1))
            places = np.hstack([places, columns])
        yield TermBlock(name, to_terms(total), places)

    def parameters(self, ends: Ends) -> Floats:
        """Returns the parameters of ends, shape (num_parameters,)."""
        return np.concatenate([each.calc(ends) for each in self._parametric])

    def calc_forces(self, q: Floats, v: Floats, a: Floats) -> Floats:
        """Returns p = M a + h − Jᵀ f, shape (…, n), at q, v, a of that shape."""
        world = self.world
        p = np.einsum("...ij,...j->...i", world.calc_mass_matrix(q), a) + world.calc_bias(q, v)
        contacts = list(self.coordinates.contacts)
        if not contacts:
            return p
        J = world.calc_contact_jacobian(q)[..., contacts, :]
        k, d = (each[contacts] for each in (self.law.stiffness, self.law.dissipation))
        depth = np.maximum(0.0, -world.calc_signed_distance(q)[..., contacts])
        f = k * depth * (1 - d * np.einsum("...ij,...j->...i", J, v))
        return p - np.einsum("...i,...ij->...j", f, J)

    def calc_controls(self, q: Floats, ends: Ends) -> Floats:
        """Returns u_k, shape (N + 1, nu), of positions at knots, shape (N + 2, n)."""
        return self.calc_forces(*self.calc_motion(q, ends)) @ self.world.inverse_actuation.T

    def calc_motion(self, q: Floats, ends: Ends) -> tuple[Floats, Floats, Floats]:
        """Returns q, v and a at knots 0 … N, shape (N + 1, n) each."""
        dt = self.time_step
        extended = np.vstack([q[1] - 2 * dt * ends.velocity, ends.position, q[1:]])
        v = (extended[2:] - extended[:-2]) / (2 * dt)
        v[0] = ends.velocity
        return extended[1:-1], v, np.diff(extended, 2, axis=0) / dt**2

    def calc_variables(self, q: Floats, ends: Ends) -> Floats:
        """Returns z, shape (num_variables,), of positions at knots, shape (N + 2, n)."""
        q = np.vstack([ends.position, q[1:]])
        return self.coordinates.calc_variables(self.world, q).ravel()

    def calc_positions(self, z: Floats) -> Floats:
        """Returns positions at knots, shape (N + 2, n), of z, shape (num_variables,)."""
        return self.coordinates.calc_positions(z.reshape(self.num_steps + 2, -1))

    @property
    def is_free(self) -> Bools:
        """Which variables have boxes: not z_0, nor unused ones, shape (num_variables,)."""
        used = np.zeros(self.num_variables + self.num_parameters, dtype=bool)
        for block in self.blocks:
            read = {factor.variable for term in block.terms for factor in term.factors}
            used[block.variables[:, list(read)]] = True
        used[: self.coordinates.num_variables] = False
        return used[: self.num_variables]


def _calc_mobility(world: World) -> Floats:
    """Returns J M⁻¹ Jᵀ of each contact at the plant's default position, shape (m,) [1/kg].

    If an arm is stretched out there along the wall's normal, with zero mobility, it is that at
    another position.
    """
    if not world.num_contacts:
        return np.zeros(0)
    mobilities = []
    for q in (world.plant.GetDefaultPositions(), find_anywhere(world.plant)):
        J, M = world.calc_contact_jacobian(q), world.calc_mass_matrix(q)
        mobilities.append(np.einsum("ij,ji->i", J, np.linalg.solve(M, J.T)))
    here, elsewhere = mobilities
    return np.where(here > _LEAST_MOBILITY * elsewhere, here, elsewhere)


def _calc_residuals(world: World) -> Floats:
    """Returns S Nᵀ, shape (n − rank B, n)."""
    N = null_space(world.actuation.T) if world.num_actuators else np.eye(world.num_positions)
    M = world.calc_mass_matrix(world.plant.GetDefaultPositions())
    return (N / np.einsum("ib,ij,jb->b", N, M, N)).T


def _sum_of_squares(rows: Floats, sums: Sequence[Sum]) -> Sum:
    """Returns |rows · sums|², rows of shape (…, n)."""
    combined = [combine(row, sums) for row in rows]
    return add(*(multiply(each, each) for each in combined))
