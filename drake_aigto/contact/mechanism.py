"""A mechanism as tables of numbers: sums of products, compiled to a list of multiplications."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from drake_aigto.arrays import Floats, Ints, read_only
from drake_aigto.contact.acceleration import accelerate_once, evaluate_tape
from drake_aigto.contact.laws import ContactLaw, RigidLaw
from drake_aigto.contact.tables import (
    COEFFICIENT,
    GIVE,
    SOURCE,
    SPIN,
    FrictionTerm,
    Load,
    Mechanics,
    Row,
    calc_gives,
    copy_writable,
    fit_to_steps,
    list_friction,
    make_mechanics_memory,
)
from drake_aigto.dynamics import EquationsOfMotion
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.terms import Factor, FunctionKind, Term, expression_terms
from drake_aigto.world import World

# Contacts with a smaller mobility bear no weight [1/kg].
_IMMOBILE = 1e-12
# The places of the factors of a product, in order ↦ coefficient.
Sum = dict[tuple[int, ...], float]


class SumTape(NamedTuple):
    """Z sums f: ℝⁿ → ℝᶻ of products, in the order in which they are computed.

    Each value has a place: 1 at 0, then the n coordinates, then cos y and sin y of each of W waves,
    y = scale·x + offset, then P products of two earlier values each.

    Attributes:
        code: W, P, the number of early products, of sums that change, and of early ones of these;
            then x of each wave, two factors of each product, and for each sum that changes its
            number, the number of its summands and their places. Early ones suffice for values
            without derivatives.
        numbers: scale and offset of each wave, then the coefficient of each summand.
        constants: the sums that never change, shape (Z,); others are 0 there.
    """

    code: Ints
    numbers: Floats
    constants: Floats


class TapeBuilder:
    """Reads sums, differentiates them, and compiles them to a `SumTape`."""

    def __init__(self, variables: Iterable[Any]) -> None:
        """Takes the variables of the sums, in their order."""
        self.variables = list(variables)
        self._waves: dict[tuple[int, float, float], int] = {}

    def read(self, expression: Any) -> Sum:
        """Returns a sum of products of powers, sin and cos.

        Raises:
            UnsupportedTermError: it is none.
        """
        terms = expression_terms("the world", expression, self.variables, is_row=True)
        return self.collect("the world", terms, range(len(self.variables)))

    def collect(self, label: str, terms: Iterable[Term], variables: Sequence[int]) -> Sum:
        """Returns the sum of terms over these of the variables.

        Raises:
            UnsupportedTermError: a factor is no power, sin or cos; names it by the label.
        """
        found: Sum = {}
        for term in terms:
            places = [p for each in term.factors for p in self._find_places(label, each, variables)]
            _add(found, tuple(sorted(places)), term.coefficient)
        return found

    def _find_places(self, label: str, factor: Factor, variables: Sequence[int]) -> list[int]:
        """Returns the places of values with this factor as their product."""
        variable = int(variables[factor.variable])
        powers = [1 + variable] * factor.exponent
        if factor.kind == FunctionKind.POWER:
            return powers
        if factor.kind not in (FunctionKind.COSINE, FunctionKind.SINE):
            raise UnsupportedTermError(label, got=str(factor), expected="powers, sin and cos")
        number = self._waves.setdefault((variable, factor.scale, factor.offset), len(self._waves))
        is_sine = factor.kind == FunctionKind.SINE
        return [*powers, 1 + len(self.variables) + 2 * number + is_sine]

    def differentiate(self, sum_: Sum, variable: int) -> Sum:
        """Returns ∂f/∂x of a sum."""
        found: Sum = {}
        waves, first = list(self._waves), 1 + len(self.variables)
        for product, coefficient in sum_.items():
            for i, place in enumerate(product):
                rest = product[:i] + product[i + 1 :]
                if place == 1 + variable:
                    _add(found, rest, coefficient)
                elif place >= first and waves[(place - first) // 2][0] == variable:
                    scale, is_sine = waves[(place - first) // 2][1], (place - first) % 2
                    other = place - 1 if is_sine else place + 1
                    slope = coefficient * (scale if is_sine else -scale)
                    _add(found, tuple(sorted((*rest, other))), slope)
        return {product: c for product, c in found.items() if c != 0.0}

    def differentiate_along(self, sum_: Sum, rates: Floats) -> Sum:
        """Returns Σ_j (c_j0 + Σ_k c_jk x_k) ∂f/∂x_j of a sum; rates are c, shape (J, 1 + K)."""
        found: Sum = {}
        for j in np.flatnonzero(rates.any(axis=1)).tolist():
            for product, slope in self.differentiate(sum_, j).items():
                for k in np.flatnonzero(rates[j]).tolist():
                    longer = tuple(sorted((*product, k))) if k else product
                    _add(found, longer, slope * float(rates[j, k]))
        return {product: c for product, c in found.items() if c != 0.0}

    def build(self, values: list[Sum], slopes: list[Sum]) -> SumTape:
        """Returns the tape of sums: values and slopes; values can be computed alone."""
        sums = [*values, *slopes]
        places = _ProductPlaces(1 + len(self.variables) + 2 * len(self._waves))
        changing = [
            (
                number,
                {places.find(product): c for product, c in sums[number].items()},
                len(places.factors),
            )
            for number in range(len(sums))
            if any(sums[number])
        ]
        early = [row for row in changing if row[0] < len(values)]
        waves = list(self._waves)
        code = [len(waves), len(places.factors), early[-1][2] if early else 0]
        code += [len(changing), len(early), *(variable for variable, _, _ in waves)]
        code += [place for pair in places.factors for place in pair]
        numbers = [number for _, *wave in waves for number in wave]
        for number, summands, _ in changing:
            code += [number, len(summands), *summands]
            numbers += summands.values()
        constants = [0.0 if any(sum_) else sum_.get((), 0.0) for sum_ in sums]
        return SumTape(read_only(code, np.int64), read_only(numbers), read_only(constants))


class _ProductPlaces:
    """Places of products, each made of a shorter one and one more factor."""

    def __init__(self, first: int) -> None:
        self.factors: list[tuple[int, int]] = []
        self._first = first
        self._known: dict[tuple[int, ...], int] = {(): 0}

    def find(self, product: tuple[int, ...]) -> int:
        if len(product) == 1:
            return product[0]
        if product not in self._known:
            self.factors.append((self.find(product[:-1]), product[-1]))
            self._known[product] = self._first + len(self.factors) - 1
        return self._known[product]


def _add(sum_: Sum, product: tuple[int, ...], coefficient: float) -> None:
    sum_[product] = sum_.get(product, 0.0) + coefficient


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
    def of(cls, world: World, law: ContactLaw) -> Mechanism:
        """Returns the tables of a world with a contact law. Rigid contacts do not push in flight.

        Raises:
            UnsupportedTermError: an equation is no sum of products of powers, sin and cos.
        """
        contacts, frictions = np.zeros((world.num_contacts, 5)), list_friction(world, law)
        if isinstance(law, RigidLaw):
            contacts[:, 2] = law.restitution
        else:
            contacts[:, 0], contacts[:, 1] = law.stiffness, law.dissipation
            contacts[:, 3], contacts[:, GIVE] = law.reaches, np.inf
        tables = Mechanics(
            *_read_tape(world, isinstance(law, RigidLaw), frictions),
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
        mass[np.triu_indices(n)] = sums[:half]
        return mass + np.triu(mass, 1).T, sums[half : half + n]

    def calc_mobilities(self, q: Floats) -> Floats:
        """Returns T M⁻¹ Tᵀ of contacts with friction, 0 of others, shape (m,) [1/kg]."""
        tangents, (mass, _) = self._read_tangents(q), self.calc_inertia(q)
        return np.einsum("ij,ji->i", tangents, np.linalg.solve(mass, tangents.T))

    def calc_drag(self, q: Floats) -> Floats:
        """Returns the friction of all rigid contacts where each bears the weight, (n,) [N, N m].

        That is Σ |T_i| μ_i N_i with N = |J M⁻¹ h| / (J M⁻¹ Jᵀ), whether it touches or not.
        """
        (kicks, mobility), friction = self._read_kicks(q), np.zeros(self.num_contacts)
        for term in self.frictions:
            if term[SOURCE] >= 0 and self.contacts[int(term[SOURCE]), 0] == 0:
                friction[int(term[SOURCE])] = term[COEFFICIENT]
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


# Reading a world takes longer than simulating it for a period, as filters and controllers do.
_tapes: WeakKeyDictionary[World, dict[tuple[float, ...], SumTape]] = WeakKeyDictionary()


def _read_tape(world: World, is_rigid: bool, frictions: Sequence[FrictionTerm]) -> SumTape:
    """Returns the tape of a world, compiled once for the contacts with friction."""
    known = _tapes.setdefault(world, {})
    key = is_rigid, *(term.numbers[SOURCE] for term in frictions)
    if key not in known:
        known[key] = _compile(world, is_rigid, [term.row for term in frictions])
    return known[key]


def _compile(world: EquationsOfMotion, is_rigid: bool, rows: Sequence[Row]) -> SumTape:
    """Returns the tape of M, h, φ, J, T and their derivatives; with those for `hold` if rigid.

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
    bends = [[differentiate(row[i], j) for i, j in zip(*upper, strict=True)] for row in jacobian]
    tangents = [builder.read(entry) for row in rows for entry in row]
    spins = [differentiate(entry, c) for entry in tangents for c in range(n)]
    slopes += [*(bend for each in bends for bend in each), *spins]
    if is_rigid:
        of_contacts = [_contract(each, np.transpose(upper).tolist(), n) for each in bends]
        of_friction = [
            _contract(spins[first : first + n * n], list(np.ndindex(n, n)), n)
            for first in range(0, len(spins), n * n)
        ]
        slopes += [differentiate(f, c) for f in (*of_contacts, *of_friction) for c in range(n)]
    normals = [entry for row in jacobian for entry in row]
    return builder.build([*mass, *bias, *distance, *normals, *tangents], slopes)


def _contract(bends: Sequence[Sum], places: Sequence[Sequence[int]], n: int) -> Sum:
    """Returns vᵀ S v of the entries of a matrix: all, or a symmetric one's upper triangle."""
    found: Sum = {}
    for bend, (i, j) in zip(bends, places, strict=True):
        for product, coefficient in bend.items():
            whole = tuple(sorted((*product, 1 + n + i, 1 + n + j)))
            twice = len(bends) < n * n and i != j
            found[whole] = found.get(whole, 0.0) + (2 if twice else 1) * coefficient
    return found
