"""The rigid transcription: impulses are residuals of flight, along their directions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy  # Not scipy.optimize, which takes a tenth of a second and few need.
from numpy.typing import NDArray
from pydrake.solvers import MathematicalProgram
from pydrake.symbolic import Expression

from drake_aigto.arrays import Bools, Floats
from drake_aigto.dynamics import ConstantInertia
from drake_aigto.errors import OptionsError
from drake_aigto.transcription.rows import (
    CLEARANCE,
    CONTACT,
    DYNAMICS,
    FLIGHT,
    NONPENETRATION,
    RESTITUTION,
    as_expression,
    penalize,
    shared_constraint,
)
from drake_aigto.transcription.touches import Fronts, find_facings
from drake_aigto.transcription.transcription import Transcription, rigid_defects
from drake_aigto.world import Scenario, World

# Jacobians are parallel, or directions dependent, within this.
_PARALLEL = 1e-9
# Weight of pushes from afar relative to those from nearby, where either may explain impulses.
_AFAR = 0.3


@dataclass(frozen=True, eq=False)
class ImpulseDirections:
    """Readings of a net impulse p = Σ_i J_iᵀ λ_i: π = R p = G λ.

    Contacts whose Jacobians are parallel share a direction d_a; two opposite walls for one. A
    reading ρ·p is blind to as many independent directions as it can be, so it shows few contacts:

    - of independent directions each has its own reading, R = (D M⁻¹ Dᵀ)⁻¹ D M⁻¹ for the rows D of
      all d_a;
    - of dependent ones, such as those of two bodies between two walls, with three directions for
      two coordinates, there is a reading for each set of directions that leaves only one free: for
      the first body, for the second one, and for both.

    The law λ_i φ_i = dt ε then leaves, for each reading,

        π_a ∏_i φ_i = dt ε Σ_i G_ai ∏_{l≠i} φ_l        over the contacts i with G_ai ≠ 0

    without any λ, and whatever walls are touched, some reading does not see them.

    Attributes:
        jacobians: J, shape (m, nv), constant.
        directions: D, shape (r, nv).
        readers: R, shape (R, nv); R = r if the directions are independent.
        shares: G = R Jᵀ, shape (R, m), the largest of each reading 1.
        masses: ρ M ρᵀ, shape (R,) [kg].
        tangents: basis of the velocities along all walls, J t = 0, shape (nv, nv − rank J).
        are_independent: whether no direction is a combination of others.
    """

    jacobians: Floats
    directions: Floats
    readers: Floats
    shares: Floats
    masses: Floats
    tangents: Floats
    are_independent: bool

    @classmethod
    def of(cls, inertia: ConstantInertia) -> ImpulseDirections:
        """Returns the directions of all contacts."""
        J, inverse = inertia.jacobian, inertia.inverse_mass
        kept: list[Floats] = []  # Rows that are not parallel to earlier ones.
        for row in J:
            unit = row / np.linalg.norm(row)
            if all(abs(unit @ other) < np.linalg.norm(other) * (1 - _PARALLEL) for other in kept):
                kept.append(row)
        D = np.array(kept)
        _, sizes, basis = np.linalg.svd(J)
        rank = int(np.sum(sizes > _PARALLEL * sizes[0]))
        are_independent = len(D) == rank
        if are_independent:
            R = np.asarray(np.linalg.solve(D @ inverse @ D.T, D @ inverse), dtype=np.float64)
        else:
            R = _readers(D, inverse, rank)
        shares = R @ J.T
        shares[np.abs(shares) < _PARALLEL] = 0.0
        masses = np.array([float(rho @ inertia.mass_matrix @ rho) for rho in R])
        return cls(J, D, R, shares, masses, basis[rank:].T, are_independent)

    def contact_impulses(self, impulses: Floats, distances: Floats, in_force: Bools) -> Floats:
        """Returns λ (K, m) of net impulses p (K, nv) [N s]: the nearest wall that pushes so has it.

        Pulls, which no wall can exert, are assigned to the nearest wall, too. If directions are
        dependent, λ ≥ 0 explain p best, with pushes from nearby before those from afar.
        Distances φ [m], and which contacts there are, are of shape (K, m).
        """
        if not self.are_independent:
            return np.array(list(map(self._explain, impulses, distances, in_force)))
        found = np.zeros(distances.shape)
        for reader, share in zip(self.readers, self.shares, strict=True):
            pushes = impulses @ reader
            # The last key counts first: those in force, then those that push, then the nearest.
            cannot = np.sign(share) != np.sign(pushes)[:, np.newaxis]
            is_none = ~in_force | (share == 0)
            chosen = np.lexsort((distances, cannot, is_none), axis=1)[:, 0]
            rows = np.flatnonzero(~np.take_along_axis(is_none, chosen[:, np.newaxis], 1)[:, 0])
            found[rows, chosen[rows]] = pushes[rows] / share[chosen[rows]]
        return found

    def _explain(self, impulse: Floats, distances: Floats, in_force: Bools) -> Floats:
        """Returns λ ≥ 0 of one net impulse, shape (m,)."""
        prices = _AFAR * np.abs(distances) / max(np.max(np.abs(distances)), 1e-300)
        matrix = np.vstack([self.jacobians.T, np.diag(prices)]) * in_force
        return scipy.optimize.nnls(matrix, np.append(impulse, np.zeros(len(prices))))[0]


def _readers(directions: Floats, inverse: Floats, rank: int) -> Floats:
    """Returns ρ = M⁻¹ Dᵀ c, each blind to rank − 1 independent directions, once."""
    span = np.linalg.svd(directions @ inverse)[2][:rank].T
    found: list[Floats] = []
    for hidden in itertools.combinations(directions @ span, rank - 1):
        _, sizes, basis = np.linalg.svd(np.reshape(hidden, (rank - 1, rank)))
        if rank > 1 and sizes[-1] < _PARALLEL * sizes[0]:
            continue
        reader = span @ basis[-1]
        seen = directions @ reader
        reader = reader / seen[np.argmax(np.abs(seen))]
        reader[np.abs(reader) < _PARALLEL * np.max(np.abs(reader))] = 0.0
        if not any(np.allclose(reader, other, atol=_PARALLEL) for other in found):
            found.append(reader)
    return np.array(found)


class RigidTranscription(Transcription):
    """Impulses at knots, exact flight between them, relaxed complementarity, Newton restitution.

    The impulse at knot k is the residual of flight, so it is not a decision variable:

        p_k = M (v_{k+1} − v_k) − dt (B u_k − h̄_k),   h̄_k = h((q_k + q_{k+1})/2, (q_{k+1} − q_k)/dt)

    Its reading a (`ImpulseDirections`) is π_ak, with the mass m_a, and the velocity after it is
    v⁺_k = v_{k+1} − dt M⁻¹ (B u_k − h̄_k):

        q_{k+1} = q_k + dt v_{k+1} − (dt²/2) M⁻¹ (B u_k − h̄_k)                             "flight"
        tᵀ p_k = 0 for all t along all walls, J t = 0                                    "dynamics"
        π_ak ∏_i φ_i = dt ε Σ_i G_ai ∏_{l≠i} φ_l;  π_a0 = 0, off the walls                 "contact"
        π_ak (d_a v⁺_k + e d_a v_k) = 0, k ≥ 1                                        "restitution"
        φ_i(q_k) ≥ 0, k ≥ 1                                                         "nonpenetration"

    Products and sums are over the contacts i that show in a reading: for one wall the contact row
    is φ λ = dt ε, for two that face each other λ = λ_0 − λ_1 and φ_0 φ_1 λ = dt ε (φ_1 − φ_0). So
    rows stay polynomials, and their number linear in N. Where directions depend on each other, two
    bodies between two walls for one, restitution is the one row p_kᵀ (v⁺_k + e v_k) = 0. Walls of
    different restitution share their mean here.

    Flight is exact for a constant h, gravity for one, and the implicit midpoint rule, of second
    order in dt, where there are springs and dampers. For ε = 0 contacts are rigid. With ε > 0 the
    wall pushes a little from afar, λ_k = dt ε/φ_k as in AIGTO Sec. IV, which contradicts its
    restitution: such a program is for penalties, not for a solver that wants its rows met.

    Rows, or their penalties, are divided by their units, those of mass m_a, the `length_scale` L
    and T, so that penalty weights mean the same for every scale.

    Args:
        world: the plant, read; its signed distances have to be affine.
        scenario: the task, with its restitution e; its ε and δ are the literal transcription's.
        relaxation: ε ≥ 0, in units of m L²/T² [1].
        path: positions at the knots, shape (N+1, nq) [m]. Of a box with several faces only those
            along the path are in force (`find_facings`), as being outside of all of it is not a
            polynomial inequality. If None, the straight line from start to goal.
    """

    ROWS: ClassVar[tuple[str, ...]] = (FLIGHT, DYNAMICS, CONTACT, RESTITUTION, NONPENETRATION)

    def __init__(
        self, world: World, scenario: Scenario, relaxation: float = 1e-4, path: Floats | None = None
    ) -> None:
        """Makes the program."""
        if not 0 <= relaxation < np.inf:
            raise OptionsError("relaxation", got=relaxation, expected="a number, 0 or more")
        self.relaxation, self._inertia = relaxation, world.constant_inertia
        self.impulse_directions = ImpulseDirections.of(self._inertia)
        self._fronts = _find_fronts(world, scenario, path)
        super().__init__(world, scenario)

    def again(self, scenario: Scenario, path: Floats | None = None) -> RigidTranscription:
        """Returns the same, with additions, for another scenario or around another path."""
        additions = self.additions()
        fronts = _find_fronts(self.world, scenario, path)
        if additions or not np.array_equal(fronts, self._fronts):
            other = RigidTranscription(self.world, scenario, self.relaxation, path)
            return other.with_additions(additions) if additions else other
        return self._of(scenario)

    def in_world(self, world: World) -> RigidTranscription:
        """Returns the same, without additions, with walls elsewhere.

        Args:
            world: see `EquationsOfMotion.with_walls_nearer`.
        """
        other = self._of(self.scenario)
        other.world, other._inertia, other._bounds = world, world.constant_inertia, None
        other._fronts = _find_fronts(world, self.scenario, None)
        return other

    @property
    def structure(self) -> Hashable:
        """All that rows and costs depend on besides users, `parameters`, and M, B and J."""
        return super().structure, self._fronts.tobytes(), self._inertia.offset.tobytes()

    def _is_bounded(self) -> Bools:
        return np.any(self._fronts[1:], axis=0)

    def _add_rows(self) -> None:
        ways, per_speed = self.impulse_directions, self._per_speed
        after, impulse = self._add_flight_rows()
        for row in ways.tangents.T @ impulse:
            row = row / np.max(ways.masses) * per_speed
            self._bind_stages(shared_constraint(as_expression(row), DYNAMICS))
        jumps = ways.readers @ impulse / ways.masses
        for direction, jump in enumerate(jumps):
            self._bind(shared_constraint(as_expression(jump * per_speed), CONTACT), 0)
            # The contacts in force that show in a direction → at which knots 1 … N−1.
            in_force = self._fronts & (self.impulse_directions.shares[direction] != 0)
            found: dict[tuple[int, ...], list[int]] = {}
            for k in range(1, len(self._u)):
                found.setdefault(tuple(np.flatnonzero(in_force[k]).tolist()), []).append(k)
            for members, knots in found.items():
                pushed = self._pushed_row(direction, members, jump)
                self._bind_each(shared_constraint(pushed, CONTACT), knots)
        for row in self._restitution_rows(jumps, impulse, after):
            returned = shared_constraint(as_expression(row * per_speed**2), RESTITUTION)
            self._bind_each(returned, range(1, len(self._u)))
        self._bound_distances(self._fronts)

    def _add_flight_rows(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Adds flight; returns v⁺_k and p_k of a stage, the residual of flight."""
        world, inertia, given = self.world, self._inertia, self._given
        mean_velocity = (self._next_q - world.positions) * given.rate
        bias = world.express_bias((world.positions + self._next_q) / 2, mean_velocity)
        force = world.actuation @ world.controls - bias
        kick = given.time_step * inertia.inverse_mass @ force  # of control and bias
        after = self._next_v - kick
        for row in self._next_q - world.positions - given.time_step * (self._next_v - kick / 2):
            row = as_expression(row * given.per_length)
            self._bind_stages(shared_constraint(row, FLIGHT))
        return after, inertia.mass_matrix @ (after - world.velocities)

    @property
    def _per_speed(self) -> Any:
        """T/L, the factor of speeds in rows [s/m]."""
        return self.scenario.num_steps * self._given.time_step * self._given.per_length

    def _pushed_row(self, direction: int, members: tuple[int, ...], jump: Any) -> Expression:
        """Returns π_a ∏ φ_i − dt ε Σ G_ai ∏_{l≠i} φ_l of one direction, without unit.

        Distances are in units of L; that of a wall which is not the one touched, of two that face
        each other, as a part of the way between them, which is how far it is then.
        """
        ways, per_length = self.impulse_directions, self._given.per_length
        if not members:
            return as_expression(jump * self._per_speed)
        phi = [self.world.contacts[i].signed_distance for i in members]
        law = sum(
            (
                ways.shares[direction, i] * _product(phi[:place] + phi[place + 1 :])
                for place, i in enumerate(members)
            ),
            Expression(0.0),
        )
        gap = sum(phi, Expression(0.0)).Expand()
        is_gap = len(phi) == 2 and gap.GetVariables().empty()
        # Of all distances but that of the touched wall.
        per_others = 1 / gap.Evaluate() if is_gap else per_length ** (len(phi) - 1)
        law = self.relaxation / self.scenario.num_steps * law
        pushed = jump * self._per_speed * per_length * _product(phi)
        return as_expression((pushed - law) * per_others)

    def _restitution_rows(
        self, jumps: NDArray[Any], impulse: NDArray[Any], after: NDArray[Any]
    ) -> list[Any]:
        """Returns jump times missed speed, of each direction if they are independent [m²/s²]."""
        ways, e = self.impulse_directions, self._given.restitutions
        before = self.world.velocities
        if not ways.are_independent:
            missed = after + np.mean(e) * before
            return [impulse @ missed / np.max(ways.masses)]
        means = [np.mean(e[share != 0]) for share in ways.shares]
        return [
            jump * (d @ after + mean * (d @ before))
            for jump, d, mean in zip(jumps, ways.directions, means, strict=True)
        ]

    def cost_scale(self) -> float:
        """Returns the cost of a way L in T from rest, without a wall.

        The optimum of ∫ w_u u² dt + w_f (L − q(T))² with m q̈ = u, which is w_f L² / (1 + w_f T³ /
        (3 w_u m²)): penalty weights and temperatures in this unit mean the same for every scale.
        """
        scenario = self.scenario
        effort = 3 * scenario.control_weight * self.inertia() ** 2 / scenario.duration**3
        miss = scenario.goal_weight
        price = effort * miss / (effort + miss) if miss else effort
        return price * self.length_scale() ** 2

    def penalized(self) -> MathematicalProgram:
        """Returns `prog` with constraints as costs, each row r_k as N r_k²: r_k²/dt in units of T.

        So weights mean the same for every N and T. Distances are in units of L here too: Drake
        makes φ/L ≥ 0 a bound on q, which has no unit left.
        """
        per_unit = dict.fromkeys((NONPENETRATION, CLEARANCE), self._given.per_length)
        return penalize(self._prog, scale=self.scenario.num_steps, per_unit=per_unit)

    def defects(self, x: Floats) -> dict[str, float]:
        """Returns the largest of each kind, as `rigid_defects`, and nonpenetration [m]."""
        restitutions = self.world.restitutions(self.scenario)
        found = rigid_defects(self.world, restitutions, self.trajectory(x))
        return {**found, NONPENETRATION: self._depth(x)}

    def impulses(self, x: Floats) -> Floats:
        """Returns λ_k, shape (N+1, m) [N s]; 0 at the last knot: no step follows."""
        q, v, u = self.split(x)
        means = (q[:-1] + q[1:]) / 2, np.diff(q, axis=0) / self._dt
        free = self.world.calc_acceleration(*means, u)
        net = (np.diff(v, axis=0) - self._dt * free) @ self._inertia.mass_matrix
        distances = self.world.calc_signed_distance(q[:-1])
        found = self.impulse_directions.contact_impulses(net, distances, self._fronts[:-1])
        return np.vstack([found, np.zeros((1, self.world.num_contacts))])


def _find_fronts(world: World, scenario: Scenario, path: Floats | None) -> Bools:
    """Returns which contacts are in force at each knot, shape (N+1, m)."""
    N, T = scenario.num_steps, scenario.duration
    if world.num_solids == world.num_contacts:
        return np.ones((N + 1, world.num_contacts), dtype=bool)
    if path is None:
        path = np.linspace(scenario.initial_position, scenario.goal_position, N + 1)
    facings = find_facings(world, np.linspace(0.0, T, N + 1), path)
    fronts = Fronts(world, facings, T)
    times = np.array([0.0, *fronts.times, T])
    return fronts.at_knots(times, np.round(N * times / T).astype(int).tolist())


def _product(factors: Sequence[Expression]) -> Expression:
    return math.prod(factors, start=Expression(1.0))
