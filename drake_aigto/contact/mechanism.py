"""A mechanism as tables of numbers, with its law of contact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact.acceleration import accelerate_once, evaluate_tape
from drake_aigto.contact.laws import ContactLaw, RigidLaw, calc_mobilities
from drake_aigto.contact.tables import (
    COEFFICIENT,
    GIVE,
    SOURCE,
    SPIN,
    Load,
    Mechanics,
    calc_gives,
    copy_writable,
    fit_to_steps,
    list_friction,
    make_mechanics_memory,
)
from drake_aigto.contact.tapes import read_tape
from drake_aigto.world import World

# Contacts with a smaller mobility bear no weight [1/kg].
_IMMOBILE = 1e-12


@dataclass(frozen=True, eq=False)
class Mechanism:
    """Dynamics of a mechanism between compliant walls, as arrays that can be pickled.

        M(q) v̇ + h(q, v) = B u + Σ_i J_i(q)ᵀ f_i − Σ_r T_r(q)ᵀ c_r N_r σ(s_r / w_r)
        f = k p(−φ) max(0, 1 − d φ̇),    p(y) = (y + √(y² + ε²)) / 2,    k min(1, g/ε) for k

    That is Hunt and Crossley's force as Drake's point contact has it, with max(0, −φ) smoothed over
    a length ε [m]; at ε = 0 it is the law itself. Of the faces of one solid only that one pushes
    which the sphere is farthest in front of. Friction is that of `FrictionTerm`. Letters as in
    `EquationsOfMotion`, n = nq = nv.

    Attributes:
        mechanics: the tables.
        edges: upper bounds of φ_j where a sphere touches face i, with its center in front of that
            and not beyond an edge: −r for other faces of its solid, else ∞, shape (m, m) [m].
        damping: d of joints, whose force is −d v, shape (n,) [N s/m, N m s/rad].
    """

    mechanics: Mechanics
    edges: Floats
    damping: Floats

    @classmethod
    def of(cls, world: World, law: ContactLaw, brakes: bool = True) -> Mechanism:
        """Returns the tables of a world with a contact law. Rigid contacts do not push in flight.

        Args:
            world: the mechanism.
            law: of its contacts.
            brakes: whether friction is to be softened for steps (`list_friction`).

        Raises:
            UnsupportedTermError: an equation is no sum of products of powers, sin and cos.
        """
        contacts = np.zeros((world.num_contacts, 5))
        frictions = list_friction(world, law, brakes)
        if isinstance(law, RigidLaw):
            contacts[:, 2] = law.restitution
        else:
            contacts[:, 0], contacts[:, 1] = law.stiffness, law.dissipation
            contacts[:, 3], contacts[:, GIVE] = law.reaches, np.inf
        tables = Mechanics(
            *read_tape(world, isinstance(law, RigidLaw), frictions),
            actuation=world.actuation,
            contacts=contacts,
            solids=np.cumsum([0, *map(len, world.solids)], dtype=np.int64),
            frictions=np.reshape(
                [term.numbers for term in frictions], (-1, SPIN + world.num_velocities)
            ),
        )
        is_other = world.are_of_one_solid & ~np.eye(world.num_contacts, dtype=bool)
        radii = [contact.radius for contact in world.contacts]
        edges = np.where(is_other, np.negative(radii), np.inf)
        return cls(copy_writable(tables), edges, world.damping)

    @property
    def num_positions(self) -> int:
        """The number of coordinates, n."""
        return self.mechanics.actuation.shape[0]

    @property
    def num_velocities(self) -> int:
        """The number of velocities, n."""
        return self.num_positions

    @property
    def actuation(self) -> Floats:
        """B, shape (n, nu)."""
        return self.mechanics.actuation

    @property
    def contacts(self) -> Floats:
        """Laws of contacts, see `Mechanics`, shape (m, 5)."""
        return self.mechanics.contacts

    @property
    def frictions(self) -> Floats:
        """Numbers of friction, see `FrictionTerm`, one row each."""
        return self.mechanics.frictions

    @property
    def is_smoothed(self) -> bool:
        """Whether a smoothing ε changes anything: without compliance and friction, it does not."""
        return bool(np.any(self.contacts[:, 0] > 0) or len(self.frictions))

    def fit(
        self, step: float, duration: float, speed: float, load: Load | None = None
    ) -> Mechanics:
        """Returns the tables for Runge-Kutta steps of a length [s] (`fit_to_steps`) and a load."""
        fitted = fit_to_steps(self.frictions, step, duration, speed)
        contacts = self.contacts.copy()
        if load is not None:
            contacts[:, GIVE] = calc_gives(contacts[:, 0], *self._read_kicks(load.q), load.force)
        return self.mechanics._replace(contacts=contacts, frictions=fitted)

    def subtract(self, state: Floats, before: Floats) -> Floats:
        """Returns the difference of two states, shape (2n,)."""
        return state - before

    @property
    def num_controls(self) -> int:
        """The number of controls, nu."""
        return self.mechanics.actuation.shape[1]

    @property
    def num_contacts(self) -> int:
        """The number of contacts, m."""
        return len(self.mechanics.contacts)

    @property
    def has_friction(self) -> bool:
        """Whether there is friction."""
        return len(self.mechanics.frictions) > 0

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
        accelerate_once(self.mechanics, x, u, float(smoothing), memory)
        return memory.acceleration[0], memory.slopes.T

    def calc_inertia(self, q: Floats) -> tuple[Floats, Floats]:
        """Returns M(q), shape (n, n), and h(q, 0), shape (n,)."""
        n, sums = len(q), self.calc_sums(q)
        half = n * (n + 1) // 2
        mass = np.zeros((n, n))
        for i in range(n):  # The upper triangle, by rows.
            first = i * n - i * (i - 1) // 2
            mass[i, i:] = mass[i:, i] = sums[first : first + n - i]
        return mass, sums[half : half + n]

    def calc_mobilities(self, q: Floats) -> Floats:
        """Returns T M⁻¹ Tᵀ of contacts with friction, 0 of others, shape (m,) [1/kg]."""
        if not self.has_friction:
            return np.zeros(self.num_contacts)
        tangents, (mass, _) = self._read_tangents(q), self.calc_inertia(q)
        return calc_mobilities(mass, tangents)

    def calc_drag(self, q: Floats) -> Floats:
        """Returns the friction of all rigid contacts where each bears the weight, (n,) [N, N m].

        That is Σ |T_i| μ_i N_i with N = |J M⁻¹ h| / (J M⁻¹ Jᵀ), whether it touches or not.
        """
        friction = np.zeros(self.num_contacts)
        for term in self.frictions:
            if term[SOURCE] >= 0 and self.contacts[int(term[SOURCE]), 0] == 0:
                friction[int(term[SOURCE])] = term[COEFFICIENT]
        if not friction.any():
            return np.zeros(len(q))
        kicks, mobility = self._read_kicks(q)
        loads = np.abs(self.calc_inertia(q)[1] @ kicks) / mobility
        return np.asarray((friction * loads) @ np.abs(self._read_tangents(q)))

    def _read_kicks(self, q: Floats) -> tuple[Floats, Floats]:
        """Returns M⁻¹ Jᵀ of contacts, shape (n, m), and J M⁻¹ Jᵀ of each, shape (m,) [1/kg]."""
        n, m = len(q), self.num_contacts
        J = self.calc_sums(q)[n * (n + 1) // 2 + n + m :][: m * n].reshape(m, n)
        kicks: Floats = np.asarray(np.linalg.solve(self.calc_inertia(q)[0], J.T), dtype=float)
        return kicks, np.maximum(np.einsum("ij,ji->i", J, kicks), _IMMOBILE)

    def _read_tangents(self, q: Floats) -> Floats:
        """Returns T of contacts with friction, zero of others, shape (m, n)."""
        n, m, R, sums = len(q), self.num_contacts, len(self.mechanics.frictions), self.calc_sums(q)
        found = np.zeros((m, n))
        rows = sums[n * (n + 1) // 2 + n + m + m * n :][: R * n].reshape(R, n)
        for T, source in zip(rows, self.mechanics.frictions[:, SOURCE].astype(int), strict=True):
            if source >= 0:
                found[source] = T
        return found

    def calc_sums(self, q: Floats) -> Floats:
        """Returns the sums of the tape at rest."""
        memory, of = make_mechanics_memory(self.mechanics), self.mechanics
        rest = np.concatenate([q, np.zeros(len(q))])
        evaluate_tape(of.code, of.numbers, rest, memory.values, memory.sums)
        return memory.sums
