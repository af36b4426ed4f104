"""A mechanism as tables of numbers, and its acceleration with all derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.jit import inner, kernel, pasted
from drake_aigto.shooting.layout import find_rows, triangle
from drake_aigto.shooting.mechanics import (
    Mechanics,
    MechanicsMemory,
    copy_writable,
    make_mechanics_memory,
)
from drake_aigto.shooting.rubbing import Row, differentiate_rubs, list_rubs, rub_all
from drake_aigto.shooting.tape import Sum, Tape, TapeBuilder, run_tape
from drake_aigto.world import ContactLaw, EquationsOfMotion, RigidLaw, World


@dataclass(frozen=True, eq=False)
class Mechanism:
    """How a mechanism moves between walls that yield, as arrays that can be pickled.

        M(q) v̇ + h(q, v) = B u + Σ_i J_i(q)ᵀ f_i − Σ_r T_r(q)ᵀ c_r N_r σ(s_r / w_r)
        f = k p(−φ) max(0, 1 − d φ̇),    p(y) = (y + √(y² + ε²)) / 2

    That is Hunt and Crossley's force as Drake's point contact has it, with max(0, −φ) smoothed over
    a length ε [m]; at ε = 0 it is the law itself. Of the faces of one solid only that one pushes
    which the sphere is farthest in front of. Friction is that of `rubbing`. Letters as in
    `EquationsOfMotion`, n = nq = nv.

    Attributes:
        mechanics: the tables.
        edges: what φ_j is at most where a sphere touches face i, its center before that and not
            beyond an edge: −r of other faces of its solid, else ∞, shape (m, m) [m].
    """

    mechanics: Mechanics
    edges: Floats

    @classmethod
    def of(
        cls,
        world: World,
        law: ContactLaw,
    ) -> Mechanism:
        """Returns the tables of a world with a contact law. Rigid contacts do not push in flight.

        Raises:
            UnsupportedTermError: an equation is no sum of products of powers, sin and cos.
        """
        contacts, rubs = np.zeros((world.num_contacts, 4)), list_rubs(world, law)
        if isinstance(law, RigidLaw):
            contacts[:, 2] = law.restitution
        else:
            contacts[:, 0], contacts[:, 1] = law.stiffness, law.dissipation
            contacts[:, 3] = law.reaches
        tables = Mechanics(
            *_compile(world, isinstance(law, RigidLaw), [rub.row for rub in rubs]),
            actuation=world.actuation,
            contacts=contacts,
            solids=np.cumsum([0, *map(len, world.solids)], dtype=np.int64),
            rubs=np.array([rub.numbers for rub in rubs]).reshape(-1, 5),
        )
        is_other = world.are_of_one_solid & ~np.eye(world.num_contacts, dtype=bool)
        radii = [contact.radius for contact in world.contacts]
        return cls(copy_writable(tables), np.where(is_other, np.negative(radii), np.inf))

    @property
    def num_positions(self) -> int:
        """The number of coordinates, n."""
        return self.mechanics.actuation.shape[0]

    @property
    def num_controls(self) -> int:
        """The number of controls, nu."""
        return self.mechanics.actuation.shape[1]

    @property
    def num_contacts(self) -> int:
        """The number of contacts, m."""
        return len(self.mechanics.contacts)

    @property
    def rubs(self) -> bool:
        """Whether there is friction."""
        return len(self.mechanics.rubs) > 0

    def calc_acceleration(
        self, state: Floats, control: Floats, smoothing: float = 0.0
    ) -> tuple[Floats, Floats]:
        """Returns v̇, shape (n,), and ∂v̇/∂(q, v, u), shape (n, 2n + nu).

        Args:
            state: q and v, shape (2n,).
            control: u, shape (nu,).
            smoothing: ε [m].
        """
        memory = make_mechanics_memory(self.mechanics)
        x, u = np.array(state, dtype=float), np.array(control, dtype=float)
        _accelerate(self.mechanics, x, u, smoothing, True, memory)
        return memory.acceleration[0], memory.slopes.T

    def calc_inertia(self, q: Floats) -> tuple[Floats, Floats]:
        """Returns M(q), shape (n, n), and h(q, 0), shape (n,)."""
        n, sums = len(q), self.calc_sums(q)
        half = n * (n + 1) // 2
        mass = np.zeros((n, n))
        mass[np.triu_indices(n)] = sums[:half]
        return mass + np.triu(mass, 1).T, sums[half : half + n]

    def calc_sums(self, q: Floats) -> Floats:
        """Returns the sums of the tape at rest, but for those of slopes that change."""
        n, memory = len(q), make_mechanics_memory(self.mechanics)
        rest, no_control = np.concatenate([q, np.zeros(n)]), np.zeros(self.num_controls)
        _accelerate(self.mechanics, rest, no_control, 0.0, False, memory)
        return memory.sums


def _compile(world: EquationsOfMotion, is_rigid: bool, rows: Sequence[Row]) -> Tape:
    """Returns the tape of M, h, φ, J and T and of their derivatives; what holding takes if rigid.

    Rows T are expressions, shape (n,) each.
    """
    n = world.num_positions
    builder = TapeBuilder([*world.positions, *world.velocities])
    upper = np.triu_indices(n)
    mass = [builder.read(entry) for entry in world.mass_matrix[upper]]
    bias = [builder.read(entry) for entry in world.bias]
    distance = [builder.read(contact.signed_distance) for contact in world.contacts]
    differentiate: Any = builder.differentiate
    jacobian = [[differentiate(phi, j) for j in range(n)] for phi in distance]
    slopes = [differentiate(entry, j) for entry in mass for j in range(n)]
    slopes += [differentiate(entry, j) for entry in bias for j in range(2 * n)]
    bends = [differentiate(row[i], j) for row in jacobian for i, j in zip(*upper, strict=True)]
    slopes += bends
    if is_rigid:
        half = len(upper[0])
        for first in range(0, len(bends), half):
            pairs = list(zip(*(each.tolist() for each in upper), strict=True))
            turns = _contract(bends[first : first + half], pairs, n)
            slopes += [differentiate(turns, c) for c in range(n)]
    tangents = [builder.read(entry) for row in rows for entry in row]
    spins = [differentiate(entry, c) for entry in tangents for c in range(n)]
    if is_rigid:
        for first in range(0, len(spins), n * n):
            turns = _contract(spins[first : first + n * n], list(np.ndindex(n, n)), n)
            slopes += [differentiate(turns, c) for c in range(n)]
    slopes += spins
    normals = [entry for row in jacobian for entry in row]
    return builder.build([*mass, *bias, *distance, *normals], slopes, tangents)


def _contract(bends: Sequence[Sum], places: Sequence[tuple[int, int]], n: int) -> Sum:
    """Returns vᵀ S v of the entries of a matrix: all, or a symmetric one's upper triangle."""
    found: Sum = {}
    for bend, (i, j) in zip(bends, places, strict=True):
        for product, coefficient in bend.items():
            whole = tuple(sorted((*product, 1 + n + int(i), 1 + n + int(j))))
            twice = len(bends) < n * n and i != j
            found[whole] = found.get(whole, 0.0) + (2 if twice else 1) * coefficient
    return found


@inner
def factor_mass(n: int, sums: Floats, L: Floats) -> None:
    """Factors M = L Lᵀ, which the tape has computed; 1 / L_ii takes the place of L_ii."""
    at = 0
    for i in range(n):
        for j in range(i, n):
            total = sums[at]
            at += 1
            for k in range(i):
                total -= L[i, k] * L[j, k]
            L[j, i] = 1.0 / np.sqrt(total) if j == i else total * L[i, i]


@inner
def divide_by_mass(n: int, L: Floats, y: Floats) -> None:
    """Replaces each row of y by M⁻¹ times it."""
    for c in range(y.shape[0]):
        for i in range(n):
            for k in range(i):
                y[c, i] -= L[i, k] * y[c, k]
            y[c, i] *= L[i, i]
        for i in range(n - 1, -1, -1):
            for k in range(i + 1, n):
                y[c, i] -= L[k, i] * y[c, k]
            y[c, i] *= L[i, i]


@inner
def find_foremost(first: int, last: int, phi: int, sums: Floats) -> int:
    """Returns the contact of a solid whose face the sphere is farthest in front of."""
    foremost = first
    for i in range(first + 1, last):
        if sums[phi + i] > sums[phi + foremost]:
            foremost = i
    return foremost


@inner
def accelerate(
    code: Ints,
    numbers: Floats,
    actuation: Floats,
    contacts: Floats,
    solids: Ints,
    rubs: Floats,
    x: Floats,
    u: Floats,
    eps: float,
    has_slopes: bool,
    values: Floats,
    sums: Floats,
    factor: Floats,
    force: Floats,
    rub: Floats,
    acceleration: Floats,
    slopes: Floats,
) -> None:
    """Computes v̇ at a state x = (q, v), and ∂v̇/∂(q, v, u) if asked; see `Mechanics` for names."""
    n, nu = actuation.shape
    run_tape(code, numbers, x, has_slopes, values, sums)
    factor_mass(n, sums, factor)
    bias = n * (n + 1) // 2
    for i in range(n):
        total = -sums[bias + i]
        for j in range(nu):
            total += actuation[i, j] * u[j]
        acceleration[0, i] = total
    _push(contacts, solids, x, eps, sums, force, acceleration)
    if rubs.shape[0] > 0:
        rub_all(rubs, x, eps, sums, force, rub, acceleration)
    divide_by_mass(n, factor, acceleration)
    if has_slopes:
        _differentiate(actuation, rubs, x, sums, factor, force, rub, acceleration, slopes)


@pasted
def _push(
    contacts: Floats,
    solids: Ints,
    x: Floats,
    eps: float,
    sums: Floats,
    force: Floats,
    total: Floats,
) -> None:
    """Computes contact forces and their derivatives by φ and φ̇, and adds Jᵀ f to the total."""
    n, m = total.shape[1], contacts.shape[0]
    phi = n * (n + 1) // 2 + n
    for s in range(solids.size - 1):
        for i in range(solids[s], solids[s + 1]):
            force[i, 0] = force[i, 1] = force[i, 2] = force[i, 4] = 0.0
            force[i, 3] = 1.0
        i = find_foremost(solids[s], solids[s + 1], phi, sums)
        row, rate, distance, lever = phi + m + i * n, 0.0, sums[phi + i], 1.0
        for j in range(n):
            rate += sums[row + j] * x[n + j]
        if contacts[i, 3] > 0.0:
            apart = np.sqrt(max(contacts[i, 3] ** 2 + 2 * contacts[i, 3] * distance, 1e-12))
            lever = contacts[i, 3] / apart
            distance, rate = apart - contacts[i, 3], lever * rate
        root = np.sqrt(distance * distance + eps * eps)
        stiffness, brake = contacts[i, 0], 1.0 - contacts[i, 1] * rate
        if stiffness == 0.0 or brake <= 0.0 or root == 0.0:
            continue
        # Without cancellation where nothing touches.
        is_in = distance <= 0.0
        depth = (root - distance) / 2 if is_in else eps * eps / (2 * (root + distance))
        force[i, 0] = stiffness * depth * brake
        force[i, 1] = -stiffness * depth / root * brake
        force[i, 2] = -stiffness * depth * contacts[i, 1]
        if contacts[i, 3] > 0.0:
            bend = -(lever**3) / contacts[i, 3]
            force[i, 3], force[i, 4] = lever, bend
            force[i, 1] = lever**2 * force[i, 1] + bend * (force[i, 0] + force[i, 2] * rate)
            force[i, 0] *= lever
            force[i, 2] *= lever**2
        for j in range(n):
            total[0, j] += force[i, 0] * sums[row + j]


@pasted
def _differentiate(
    actuation: Floats,
    rubs: Floats,
    x: Floats,
    sums: Floats,
    factor: Floats,
    force: Floats,
    rub: Floats,
    acceleration: Floats,
    slopes: Floats,
) -> None:
    """Computes ∂v̇/∂(q, v, u) = M⁻¹ (∂r − ∂M v̇), with M v̇ = r."""
    n, nu = actuation.shape
    m, half = force.shape[0], n * (n + 1) // 2
    slope_of_mass = half + n + m + m * n
    slope_of_bias = slope_of_mass + half * n
    for c in range(2 * n):
        for i in range(n):
            slopes[c, i] = -sums[slope_of_bias + 2 * n * i + c]
    for j in range(nu):
        for i in range(n):
            slopes[2 * n + j, i] = actuation[i, j]
    at = slope_of_mass
    for i in range(n):
        for j in range(i, n):
            for c in range(n):
                slope = sums[at]
                at += 1
                slopes[c, i] -= slope * acceleration[0, j]
                if j != i:
                    slopes[c, j] -= slope * acceleration[0, i]
    for i in range(m):
        if force[i, 0] != 0.0:
            _differentiate_force(n, m, i, x, sums, force, slopes)
    if rubs.shape[0] > 0:
        differentiate_rubs(rubs, x, sums, force, rub, slopes)
    divide_by_mass(n, factor, slopes)


@inner
def _differentiate_force(
    n: int, m: int, i: int, x: Floats, sums: Floats, force: Floats, slopes: Floats
) -> None:
    """Adds ∂(J_iᵀ f_i)/∂(q, v), transposed."""
    row, bends = find_rows(n, m, i)
    for c in range(n):
        rate = 0.0
        for j in range(n):
            bend = sums[bends + triangle(n, j, c)]
            rate += bend * x[n + j]
            slopes[c, j] += force[i, 0] * bend
        by_position = force[i, 1] * sums[row + c] + force[i, 2] * rate
        by_velocity = force[i, 2] * sums[row + c]
        for j in range(n):
            slopes[c, j] += by_position * sums[row + j]
            slopes[n + c, j] += by_velocity * sums[row + j]


@kernel
def _accelerate(
    mechanics: Mechanics,
    x: Floats,
    u: Floats,
    eps: float,
    has_slopes: bool,
    memory: MechanicsMemory,
) -> None:
    code, numbers, _, actuation, contacts, solids, rubs = mechanics
    values, sums, factor, force, rub, acceleration, slopes, _, _, _ = memory
    accelerate(
        code,
        numbers,
        actuation,
        contacts,
        solids,
        rubs,
        x,
        u,
        eps,
        has_slopes,
        values,
        sums,
        factor,
        force,
        rub,
        acceleration,
        slopes,
    )
