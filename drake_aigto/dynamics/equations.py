"""Equations of motion with contact: expressions, and the same compiled."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydrake.symbolic import Expression

from drake_aigto.arrays import Bools, Floats, read_only
from drake_aigto.dynamics.coordinates import Coordinates
from drake_aigto.dynamics.stiction import STICTION_SPEED, calc_friction_share
from drake_aigto.dynamics.sums import (
    Blend,
    ConstantDynamics,
    ConstantInertia,
    SumMap,
    calc_turning,
    is_constant,
    load_kernels,
    read_constant,
)
from drake_aigto.errors import ModelError

_INERTIA_REMEDY = "Use the literal transcription."
_BIAS_REMEDY = (
    "Exact optima and sampling over controls need flight in parabolas; plans, replays and gradient "
    "solvers do not."
)

# Derived attributes, here and of a `World`, that do not depend on positions of walls, nor, but for
# the first of them, on masses and forces.
_OF_MASSES, _OF_FORCES = "_mass_map", "_bias_map"
_PLACELESS = (
    *(_OF_MASSES, _OF_FORCES, "solids", "has_constant_inertia", "has_constant_dynamics"),
    *("_jacobian", "_jacobian_map", "_contact_bias_map", "rubbing", "springs", "damping"),
)

_Self = TypeVar("_Self", bound="EquationsOfMotion")


@dataclass(frozen=True, eq=False)
class Contact:
    """A sphere and a face that can touch, and their distance.

    Attributes:
        name: such as "ball against wall", or "ball against block, +x face".
        signed_distance: φ(q) [m], positive when apart.
        jacobian: J = ∂φ/∂q, shape (nv,), as q̇ = v.
        solid: index of the face's solid. All faces of a box that one sphere can reach have the
        same: the sphere is
            outside if it is in front of one of them.
        restitution: the model's own, in [0, 1]; None leaves it to the scenario.
        radius: of the sphere [m].
    """

    name: str
    signed_distance: Expression
    jacobian: NDArray[Any]
    solid: int = 0
    restitution: float | None = None
    radius: float = 0.0


@dataclass(frozen=True, eq=False)
class EquationsOfMotion(Coordinates):
    """Equations of motion of a mechanism: M, h, B, φ and J of AIGTO eq. (1).

        M(q) v̇ + h(q, v) = B u + J(q)ᵀ λ,    0 ≤ φ(q) ⊥ λ ≥ 0,    q̇ = v

    The expressions are sums of products of powers, sin and cos, which have means over boxes. They
    are the one source: the functions of numbers are compiled from them, and
    `constant_inertia` and `constant_dynamics` are read off them. Letters: nq positions, nv = nq
    velocities, nu actuators, m contacts, S solids; a shape's "…" are axes of many states at once.
    One state goes with many controls or impulses, too.

    A contact is a sphere and a flat face. One sphere and all that it can reach of one box make a
    solid: the sphere is outside when it is in front of one face at least, max_i φ_i ≥ 0. Elsewhere
    each contact is a solid of its own.

    Attributes:
        controls: the variables u, shape (nu,) [N, N m].
        mass_matrix: M(q), shape (nv, nv), Expressions [kg, kg m, kg m²].
        bias: h(q, v), shape (nv,), Expressions [N, N m]: Coriolis and centrifugal terms, gravity,
            springs and dampers, on the left side of the equation above; without dry friction.
        actuation: B, shape (nv, nu).
        contacts: φ and J of each contact, those of one solid in a row.
        dry_friction: F of each coordinate, shape (nv,) [N, N m], or None. F σ(v / v_s) belongs to
            h(q, v), but is no such sum (`calc_friction_share`).
        stiction_speed: v_s [m/s, rad/s].
    """

    controls: NDArray[Any]
    mass_matrix: NDArray[Any]
    bias: NDArray[Any]
    actuation: Floats
    contacts: tuple[Contact, ...]
    dry_friction: Floats | None = field(default=None, kw_only=True)
    stiction_speed: float = field(default=STICTION_SPEED, kw_only=True)

    # Of which worlds this one is a blend; none of its copies is.
    blended: ClassVar[Blend | None] = None

    def find_frames(self, goals: Any) -> Any:
        """Returns goals of frames (`FrameGoals`); None: only worlds in space have any."""
        return None

    def calc_actuation(self, q: Floats) -> Floats:
        """Returns B(q), shape (…, nv, nu)."""
        return self.actuation

    @property
    def num_actuators(self) -> int:
        """The number of controls, nu."""
        return len(self.controls)

    @property
    def num_contacts(self) -> int:
        """The number of contacts, m."""
        return len(self.contacts)

    @property
    def num_solids(self) -> int:
        """The number of solids, S."""
        return len(self.solids)

    @cached_property
    def solids(self) -> tuple[tuple[int, ...], ...]:
        """The contacts of each solid, S of them."""
        found: dict[int, list[int]] = {}
        for i, contact in enumerate(self.contacts):
            found.setdefault(contact.solid, []).append(i)
        return tuple(map(tuple, found.values()))

    @cached_property
    def are_of_one_solid(self) -> Bools:
        """Which contacts are faces of one solid, shape (m, m)."""
        solids = np.array([contact.solid for contact in self.contacts], dtype=int)
        return read_only(solids[:, np.newaxis] == solids, bool)

    @cached_property
    def inverse_actuation(self) -> Floats:
        """B⁺, shape (nu, nv)."""
        return read_only(np.linalg.pinv(self.actuation))

    @cached_property
    def has_constant_inertia(self) -> bool:
        """Whether neither M nor J depends on q."""
        return is_constant(self.mass_matrix) and is_constant(self._jacobian)

    @cached_property
    def has_constant_dynamics(self) -> bool:
        """Whether h is constant, too, so that held controls lead to parabolas."""
        return self.has_constant_inertia and is_constant(self.bias) and self.dry_friction is None

    @cached_property
    def constant_inertia(self) -> ConstantInertia:
        """M, J and what follows from them where they are constant; ConstantDynamics if h is, too.

        Raises:
            ModelError: one of them varies.
        """
        if self.has_constant_dynamics:
            return self.constant_dynamics
        return ConstantInertia(*self._read_inertia())

    def with_walls_nearer(self: _Self, distances: Floats) -> _Self:
        """Returns the same with φ_i less by distances, shape (m,) [m], to plan many times.

        Its diagram, for Drake and for pictures, does not change (`World.with_wall_moved`).
        """
        contacts = tuple(
            replace(contact, signed_distance=contact.signed_distance - distance)
            for contact, distance in zip(self.contacts, distances.tolist(), strict=True)
        )
        moved = self.changed(contacts=contacts)
        if not self.has_constant_inertia:
            return moved
        inertia = self.constant_inertia
        name = "constant_dynamics" if self.has_constant_dynamics else "constant_inertia"
        nearer = vars(moved)[name] = copy.copy(inertia)  # No derived attribute depends on φ(0).
        vars(nearer)["offset"] = read_only(inertia.offset - distances)
        return moved

    def changed(self: _Self, **fields: Any) -> _Self:
        """Returns the same with other fields: M, h, φ or dry friction.

        What is compiled here, and does not depend on these, is kept.
        """
        found = replace(self, **fields)
        kept = {name: vars(self)[name] for name in _PLACELESS if name in vars(self)}
        if found.mass_matrix is not self.mass_matrix:
            kept.pop(_OF_MASSES, None)
        if found.bias is not self.bias:
            kept.pop(_OF_FORCES, None)
        vars(found).update(kept)
        return found

    def blend(self: _Self, *shares: tuple[_Self, float]) -> _Self:
        """Returns the world of f = f₀ + Σ s_k (f_k − f₀) for f in M, h, φ and dry friction.

        Here f₀ is its own, and so are the diagram and all else. Nothing is compiled for it that was
        for all of them.

        Args:
            shares: worlds that were made of this one (`changed`), and s_k of each.
        """
        mixed = Blend.of(self, shares)
        distances = mixed.mix(lambda world: world._distances)
        contacts = (
            replace(contact, signed_distance=distance)
            for contact, distance in zip(self.contacts, distances, strict=True)
        )
        names = "mass_matrix", "bias", *(() if self.dry_friction is None else ("dry_friction",))
        fields = {name: mixed.mix(attrgetter(name)) for name in names}
        found = self.changed(contacts=tuple(contacts), **fields)
        object.__setattr__(found, "blended", mixed)
        return found

    def _compile(self, name: str, expressions: NDArray[Any], *variables: NDArray[Any]) -> SumMap:
        """Returns the map of expressions, of a blend without reading them."""
        mixed = SumMap.of_blend(self.blended, name) if self.blended else None
        return mixed or SumMap(expressions, *variables)

    @cached_property
    def constant_dynamics(self) -> ConstantDynamics:
        """M, J, h and what follows from them where they are constant.

        Raises:
            ModelError: one of them varies.
        """
        if self.dry_friction is not None:
            got = f"dry friction {self.dry_friction.tolist()}"
            raise ModelError("the bias h(q, v)", got, expected="a constant", remedy=_BIAS_REMEDY)
        bias = read_constant("the bias h(q, v)", self.bias, _BIAS_REMEDY)
        return ConstantDynamics(*self._read_inertia(), bias)

    def _read_inertia(self) -> tuple[Floats, Floats, Floats, Floats, tuple[tuple[int, ...], ...]]:
        """Returns M, B, J, φ(0) and the solids."""
        mass_matrix = read_constant("the mass matrix M(q)", self.mass_matrix, _INERTIA_REMEDY)
        slopes = np.empty((self.num_contacts, self.num_velocities))
        for i, contact in enumerate(self.contacts):
            slopes[i] = read_constant(f"∂φ/∂q of {contact.name}", contact.jacobian, _INERTIA_REMEDY)
        offset = self.calc_signed_distance(np.zeros(self.num_positions))
        return mass_matrix, self.actuation, read_only(slopes), read_only(offset), self.solids

    def calc_mass_matrix(self, q: Floats) -> Floats:
        """Returns M(q), shape (…, nv, nv) [kg], at q of shape (…, nq) [m]."""
        return self._mass_map(q)

    def calc_bias(self, q: Floats, v: Floats) -> Floats:
        """Returns h(q, v), shape (…, nv) [N], at q of shape (…, nq) [m], v of (…, nv) [m/s]."""
        bias = self._bias_map(q, v)
        if self.dry_friction is None:
            return bias
        return bias + self.dry_friction * calc_friction_share(v, self.stiction_speed)

    def express_bias(self, q: NDArray[Any], v: NDArray[Any]) -> NDArray[np.object_]:
        """Returns h at other expressions of q and v, shape (nv,), without dry friction."""
        names = np.concatenate([self.positions, self.velocities])
        # A sum with an Expression makes one of variables and floats.
        values = [Expression(0.0) + each for each in (*q, *v)]
        table = dict(zip(names, values, strict=True))
        return np.array([entry.Substitute(table) for entry in self.bias], dtype=object)

    def calc_signed_distance(self, q: Floats) -> Floats:
        """Returns φ(q), shape (…, m) [m], at q of shape (…, nq) [m]."""
        return self._signed_distance_map(q)

    def calc_clearance(self, q: Floats) -> Floats:
        """Returns distances of the sphere to each solid, (…, S) [m], at q of shape (…, nq).

        The largest φ_i of the solid's faces: at least 0 outside, and the distance itself where the
        sphere's center projects onto a face. Past an edge or a corner the distance is larger: the
        corner counts as sharp.
        """
        firsts = np.array([faces[0] for faces in self.solids], dtype=int)
        return np.maximum.reduceat(self.calc_signed_distance(q), firsts, axis=-1)

    def calc_contact_jacobian(self, q: Floats) -> Floats:
        """Returns J(q) = ∂φ/∂q, shape (…, m, nv), at q of shape (…, nq) [m]."""
        return self._jacobian_map(q)

    def calc_contact_rate(self, q: Floats, v: Floats) -> Floats:
        """Returns φ̇ = J v, shape (…, m) [m/s], at q of shape (…, nq) [m], v of (…, nv) [m/s]."""
        rates = self.calc_contact_jacobian(q) @ v[..., np.newaxis]
        return np.asarray(rates[..., 0], dtype=np.float64)

    def calc_contact_bias(self, q: Floats, v: Floats) -> Floats:
        """Returns J̇ v of φ̈ = J v̇ + J̇ v, (…, m) [m/s²], at q (…, nq), v (…, nv)."""
        return self._contact_bias_map(q, v)

    def inertia_at(self, q: Floats) -> ConstantInertia:
        """Returns M and J at q, shape (nq,) [m], with φ linearized there."""
        J, distances = self.calc_contact_jacobian(q), self.calc_signed_distance(q)
        offset = distances - J @ q
        return ConstantInertia(self.calc_mass_matrix(q), self.actuation, J, offset, self.solids)

    def move_onto(self, q: Floats, contacts: Sequence[int]) -> Floats:
        """Returns the nearest positions where φ_i = 0, exact for an affine φ, shape (nq,) [m].

        Args:
            q: the positions, shape (nq,) [m].
            contacts: i, at least one.
        """
        J = self.calc_contact_jacobian(q)[contacts]
        # For one row, a singular value decomposition takes ten times as long as its norm.
        inverse = J.T / np.sum(J**2) if len(contacts) == 1 else np.linalg.pinv(J)
        return q - inverse @ self.calc_signed_distance(q)[contacts]

    def calc_acceleration(
        self,
        q: Floats,
        v: Floats,
        u: Floats,
        forces: Floats | None = None,
        drag: Floats | None = None,
    ) -> Floats:
        """Returns v̇ = M⁻¹ (B u − h(q, v) + Jᵀ f + d), shape (…, nv) [m/s²].

        Args:
            q: shape (…, nq) [m].
            v: shape (…, nv) [m/s].
            u: shape (…, nu) [N].
            forces: f of contacts, shape (…, m) [N]; None: no contact.
            drag: d, friction of contacts, shape (…, nv) [N, N m]; None: none.
        """
        push = self.calc_actuation(q) @ np.asarray(u)[..., np.newaxis]
        force = push[..., 0] - self.calc_bias(q, v)
        if forces is not None:
            force = force + self._calc_push(q, forces)
        if drag is not None:
            force = force + drag
        if self.has_constant_inertia:  # Simulations ask this in every step.
            return force @ self.constant_inertia.inverse_mass.T
        return self._divide_by_mass(q, force)

    def _calc_push(self, q: Floats, impulses: Floats) -> Floats:
        """Returns J(q)ᵀ p, shape (…, nv)."""
        return (impulses[..., np.newaxis, :] @ self.calc_contact_jacobian(q))[..., 0, :]

    def calc_velocity_change(self, q: Floats, impulses: Floats) -> Floats:
        """Returns M⁻¹ J(q)ᵀ p, shape (…, nv) [m/s], for contact impulses p, (…, m) [N s]."""
        if self.has_constant_inertia:
            return impulses @ self.constant_inertia.kicks
        return self._divide_by_mass(q, self._calc_push(q, impulses))

    def calc_kinetic_energy(self, q: Floats, v: Floats) -> Floats:
        """Returns ½ vᵀ M(q) v, shape (…) [J]."""
        return np.einsum("...i,...ij,...j->...", v, self.calc_mass_matrix(q), v) / 2

    def _divide_by_mass(self, q: Floats, momentum: Floats) -> Floats:
        """Returns M(q)⁻¹ times momenta or forces, shape (…, nv)."""
        masses, n = self._mass_map(q), self.num_velocities
        if q.shape != momentum.shape:
            shape = np.broadcast_shapes(q.shape, momentum.shape)
            # Copies, as views may be in any order and read-only: each kind would be compiled anew.
            momentum = np.array(np.broadcast_to(momentum, shape), order="C")
            masses = np.array(np.broadcast_to(masses, (*shape, n)), order="C")
        found = load_kernels().divide_by_masses(masses.reshape(-1, n * n), momentum.reshape(-1, n))
        return np.asarray(found.reshape(momentum.shape))

    @cached_property
    def _distances(self) -> NDArray[Any]:
        """φ, shape (m,), Expressions."""
        return np.array([contact.signed_distance for contact in self.contacts], dtype=object)

    @cached_property
    def _jacobian(self) -> NDArray[Any]:
        """J, shape (m, nv), Expressions."""
        rows = [contact.jacobian for contact in self.contacts]
        return np.array(rows, dtype=object).reshape(-1, self.num_velocities)

    @cached_property
    def _mass_map(self) -> SumMap:
        return self._compile(_OF_MASSES, self.mass_matrix, self.positions)

    @cached_property
    def _bias_map(self) -> SumMap:
        return self._compile(_OF_FORCES, self.bias, self.positions, self.velocities)

    @cached_property
    def _signed_distance_map(self) -> SumMap:
        return self._compile("_signed_distance_map", self._distances, self.positions)

    @cached_property
    def _contact_bias_map(self) -> SumMap:
        turns = calc_turning(self._jacobian, self.positions, self.velocities)
        return SumMap(turns, self.positions, self.velocities)

    @cached_property
    def _jacobian_map(self) -> SumMap:
        return SumMap(self._jacobian, self.positions)
