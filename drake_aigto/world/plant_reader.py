"""The equations of motion of a MultibodyPlant, read as sums of products of q and v."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces, RigidBody
from pydrake.symbolic import Expression, MakeVectorVariable, cos, sin

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.dynamics import SumMap, check_force, find_joint, tidy
from drake_aigto.errors import ModelError
from drake_aigto.world.diagram import find_hinges, scale_masses
from drake_aigto.world.model_facts import FixableError

# q of shape (nq,) ↦ numbers of any one shape.
Function = Callable[[Floats], Floats]

# Largest part of a null vector of M that is none.
_TOLERANCE = 1e-9
# Largest difference of equal entries by rounding, relative to the largest.
_ROUNDING = 1e-12
_NUM_PROBES = 3  # Positions, or states, at which functions are compared: one might agree by chance.
MAX_SAMPLES = 20_000  # Of one function, half a second's worth.
# Of M, whose derivatives h is made of: with 3,700 that takes half a minute, and what plans with it
# has hundreds of millions.
MAX_TERMS = 2_500
_MANY = 4  # Coordinates that a function can depend on at once, whatever their axes.


class PlantReader:
    """A plant's equations as expressions, from samples of its numbers.

    Drake's symbolic twin gives them too, but a product of rotations that nobody has multiplied out
    has exponentially many terms. Hinges and sliders leave so few functions of q that samples tell
    them apart (`interpolate`), and each result is checked against the plant at other states.

    Attributes:
        q: variables, shape (nq,) [m, rad].
        v: variables, shape (nv,) [m/s, rad/s], v = q̇.
    """

    def __init__(self, plant: MultibodyPlant, mass_factor: float = 1.0) -> None:
        """Names the variables; masses and inertias of links that move are multiplied."""
        self._plant = plant
        self._context = plant.CreateDefaultContext()
        scale_masses(plant, self._context, mass_factor)
        self._is_hinge = find_hinges(plant)
        self.q = MakeVectorVariable(plant.num_positions(), "q")
        self.v = MakeVectorVariable(plant.num_velocities(), "v")

    def set_mass(self, body: RigidBody, mass: float) -> None:
        """Replaces a body's mass [kg]; its inertia scales along."""
        body.SetMass(self._context, mass)

    def calc_mass_matrix(self) -> NDArray[Any]:
        """Returns M(q), shape (nv, nv) [kg, kg m, kg m²].

        Raises:
            ModelError: it is singular at the default positions, or depends on too many joints.
        """
        return tidy(self.read_mass_matrix())

    def read_mass_matrix(self) -> NDArray[Any]:
        """Returns M(q) as it is interpolated, its terms not yet gathered."""
        M = self.read(MultibodyPlant.CalcMassMatrix, degree=2, what="the mass matrix")
        self._plant.SetPositions(self._context, self._plant.GetDefaultPositions())
        values = self._plant.CalcMassMatrix(self._context)
        rank, (_, _, rows) = np.linalg.matrix_rank(values), np.linalg.svd(values)
        if rank < len(values):
            still = np.flatnonzero(np.abs(rows[rank:]).max(axis=0) > _TOLERANCE)
            joints = dict.fromkeys(find_joint(self._plant, int(i)).name() for i in still)
            raise ModelError(
                "the mass matrix is singular",
                got=f"no inertia along {', '.join(joints)}",
                remedy="Give every link that moves a mass.",
            )
        return M

    def calc_bias(self, mass_matrix: NDArray[Any]) -> NDArray[Any]:
        """Returns h(q, v), shape (nv,) [N, N m]: all that B u and contact must balance at v̇ = 0.

            h = Σ_jk (∂M_ij/∂q_k − ½ ∂M_jk/∂q_i) v_j v_k − gravity(q) + K q + D v + constant

        Raises:
            ModelError: a force is none of these: names the joint that it acts on.
        """
        gravity = self.read(MultibodyPlant.CalcGravityGeneralizedForces, degree=1, what="gravity")
        with np.errstate(invalid="ignore"):  # As Drake's arithmetic on Expressions looks for NaN.
            slopes = np.array([[each.Jacobian(self.q) for each in row] for row in mass_matrix])
            momentum_rate = slopes @ self.v @ self.v
            energy_slope = slopes.T @ self.v @ self.v / 2  # M is symmetric.
            # Forces of joints.
            nothing, units = np.zeros(len(self.q)), np.eye(len(self.q))
            constant = self._calc_joint_forces(nothing, nothing)
            K = np.array([self._calc_joint_forces(unit, nothing) - constant for unit in units]).T
            D = np.array([self._calc_joint_forces(nothing, unit) - constant for unit in units]).T
            springs = K @ self.q + D @ self.v + constant
            h = tidy(momentum_rate - energy_slope - gravity + springs)
        compiled = SumMap(h, self.q, self.v)
        for q, v in np.random.default_rng(1).uniform(-1.0, 1.0, (_NUM_PROBES, 2, len(self.q))):
            check_force(self._plant, compiled(q, v), self._calc_bias(q, v))
        return h

    def _calc_joint_forces(self, q: Floats, v: Floats) -> Floats:
        """Returns all of h(q, v) but gravity, Coriolis and centrifugal terms, shape (nv,)."""
        bias = self._calc_bias(q, v)
        nothing, at_rest = MultibodyForces(self._plant), np.zeros(len(v))
        coriolis = self._plant.CalcInverseDynamics(self._context, at_rest, nothing)
        gravity = self._plant.CalcGravityGeneralizedForces(self._context)
        return np.asarray(bias - coriolis + gravity)

    def _calc_bias(self, q: Floats, v: Floats) -> Floats:
        """Returns h(q, v) as Drake computes it, shape (nv,)."""
        self._plant.SetPositions(self._context, q)
        self._plant.SetVelocities(self._context, v)
        # Force elements (gravity, springs) and joint damping go into `forces`; inverse dynamics
        # adds the Coriolis and centrifugal terms.
        forces = MultibodyForces(self._plant)
        self._plant.CalcForceElementsContribution(self._context, forces)
        return self._plant.CalcInverseDynamics(self._context, np.zeros(len(v)), forces)

    def read(self, function: Callable[[Any, Any], Floats], degree: int, what: str) -> NDArray[Any]:
        """Returns a function of q as expressions (`interpolate`).

        Args:
            function: takes the plant and a context at q, returns numbers of any shape.
            degree: see `interpolate`.
            what: the function's name in an error.

        Raises:
            ModelError: it depends on too many joints.
        """

        def calc(q: Floats) -> Floats:
            self._plant.SetPositions(self._context, q)
            return function(self._plant, self._context)

        try:
            return interpolate(calc, self.q, self._is_hinge, degree)
        except TooManySamples as error:
            joints, fixed = (
                list(dict.fromkeys(find_joint(self._plant, i).name() for i in found))
                for found in (error.coordinates, error.to_fix)
            )
            raise FixableError(
                what,
                got=f"a function of {len(error.coordinates)} coordinates at once: of "
                f"{', '.join(joints)}",
                expected="four or five, or six about parallel axes",
                remedy="Fix joints that a plan can do without, by the scenario's fixed_joints: "
                f"[{', '.join(fixed)}], or others, or take contact: compliant, with any number.",
                fields={"fixed_joints": fixed},
            ) from None


@dataclass(frozen=True)
class TooManySamples(Exception):
    """A function of too many coordinates at once."""

    # The positions that one of its values depends on, or all of them do.
    coordinates: tuple[int, ...]
    to_fix: tuple[int, ...]  # those without which it is one of few


def interpolate(
    function: Function, q: NDArray[Any], is_hinge: Sequence[bool], degree: int
) -> NDArray[Any]:
    """Returns a function of q, shape (nq,), as expressions, exact but for rounding.

    Each of its values has to be a polynomial of the degree in every slider's position, and one in
    the sine and cosine of every hinge's angle: a point on a link has degree 1, as each joint
    between two links moves it once, and M = Σ JᵀmJ has degree 2. Such a function is known from
    degree + 1 positions of each slider, and 2 · degree + 1 angles of each hinge,

        f(q) = Σ_k a_k ∏_i b_{k_i}(q_i),    b ∈ {1, q, q², …} or {1, cos q, sin q, cos 2q, …}.

    Fewer do in coordinates in which its degree is lower: about parallel axes M has degree 1.
    Whether it is such a function, the caller has to check.
    """
    example = function(np.zeros(len(q)))
    result = np.empty(example.size, dtype=object)
    degrees = _find_degrees(function, [_Basis.of(hinge, degree) for hinge in is_hinge])
    bases = _choose_bases(is_hinge, degrees)
    depends = degrees > 0
    patterns = np.unique(depends, axis=0)
    sampled: list[tuple[list[int], Floats]] = []
    num_samples = num_terms = 0
    for pattern in sorted(patterns, key=np.sum, reverse=True):
        entries = np.flatnonzero((depends == pattern).all(axis=1))
        coordinates = np.flatnonzero(pattern).tolist()
        found = (
            grid[tuple(slice(None) if i in coordinates else 0 for i in known)]
            for known, grid in sampled
            if set(coordinates) <= set(known)
        )
        if (grid := next(found, None)) is None:
            nodes = [bases[i].nodes for i in coordinates]
            num_samples += math.prod(each.size for each in nodes)
            if num_samples > MAX_SAMPLES:
                raise _refuse_many(patterns, sampled, coordinates)
            grid = _sample(function, nodes, coordinates, len(q), example.size)
            sampled.append((coordinates, grid))
        grid = grid[..., entries]
        for axis, i in enumerate(coordinates):
            grid = np.moveaxis(np.tensordot(bases[i].weights, grid, (1, axis)), 0, axis)
        num_terms += int(np.count_nonzero(np.abs(grid) > _ROUNDING * np.abs(grid).max(initial=0)))
        if num_terms > MAX_TERMS:
            raise _refuse_many(patterns, sampled, coordinates)
        functions = [bases[i].express(q[i]) for i in coordinates]
        for entry, coefficients in zip(entries, np.moveaxis(grid, -1, 0), strict=True):
            result[entry] = _sum_up(coefficients, functions)
    return result.reshape(example.shape)


def _sample(
    function: Function,
    nodes: list[NDArray[Any]],
    coordinates: list[int],
    num_positions: int,
    size: int,
) -> Floats:
    """Returns all values of a function on a grid, (nodes of each coordinate, values)."""
    point, values = np.zeros(num_positions), np.empty((math.prod(n.size for n in nodes), size))
    for row, place in zip(values, itertools.product(*nodes), strict=True):
        point[coordinates] = place
        row[:] = function(point).ravel()
    return values.reshape(*(each.size for each in nodes), -1)


def _refuse_many(
    depends: Bools, sampled: list[tuple[list[int], Floats]], more: list[int]
) -> TooManySamples:
    """Returns the error of a function whose values depend on coordinates, some of them sampled."""
    coordinates = sorted({*(i for known, _ in sampled for i in known), *more})
    beyond = sorted({int(i) for pattern in depends for i in np.flatnonzero(pattern)[_MANY:]})
    to_fix = beyond or coordinates[_MANY:] or coordinates[-1:]
    return TooManySamples(tuple(coordinates), tuple(to_fix))


@dataclass(frozen=True)
class _Basis:
    """Functions of one coordinate, and the nodes that tell them apart."""

    is_hinge: bool  # whether they are waves, or powers
    nodes: NDArray[Any]  # as many as functions (b,)
    weights: NDArray[Any]  # W of shape (b, b): coefficients are W times the values at the nodes
    degrees: Ints  # of the functions, (b,)

    @classmethod
    def of(cls, is_hinge: bool, degree: int) -> _Basis:
        """Returns powers or waves up to a degree."""
        if not is_hinge:
            nodes = np.linspace(-1.0, 1.0, degree + 1)
            inverse = np.linalg.inv(np.vander(nodes, increasing=True))
            return cls(is_hinge, nodes, inverse, np.arange(degree + 1))
        count = 2 * degree + 1
        nodes = np.array([2.0 * np.pi * j / count for j in range(count)])
        waves = [np.full(count, 0.5)]
        for k in range(1, degree + 1):
            waves += [np.cos(k * nodes), np.sin(k * nodes)]
        return cls(is_hinge, nodes, 2.0 / count * np.array(waves), (np.arange(count) + 1) // 2)

    def express(self, x: Any) -> list[Expression]:
        """Returns the functions of a variable."""
        count = self.nodes.size
        if not self.is_hinge:
            return [Expression(1.0), *(x**k * Expression(1.0) for k in range(1, count))]
        waves = [[cos(k * x), sin(k * x)] for k in range(1, count // 2 + 1)]
        return [Expression(1.0), *itertools.chain(*waves)]


def _choose_bases(is_hinge: Sequence[bool] | Bools, degrees: Ints) -> list[_Basis]:
    """Returns functions of each coordinate up to the degree that values have in it."""
    return [_Basis.of(*each) for each in zip(is_hinge, degrees.max(axis=0), strict=True)]


def _find_degrees(function: Function, bases: Sequence[_Basis]) -> Ints:
    """Returns the degree of each value in each coordinate alone, (values, nq)."""
    rng, size = np.random.default_rng(0), len(bases)
    found: list[Ints] = []
    for q in rng.uniform(-1.0, 1.0, (_NUM_PROBES, size)):
        least = _ROUNDING * np.abs(function(q)).max(initial=0.0)
        columns = []
        for i, basis in enumerate(bases):
            moved = [np.where(np.arange(size) == i, node, q) for node in basis.nodes]
            values = np.array([function(each).ravel() for each in moved])
            terms = np.abs(basis.weights @ values) > least
            columns.append(np.max(terms * basis.degrees[:, np.newaxis], axis=0))
        found.append(np.array(columns).T)
        if len(found) == 1:
            sizes = [
                each.nodes.size for each in _choose_bases([b.is_hinge for b in bases], found[0])
            ]
            counts = np.log(np.where(found[0] > 0, sizes, 1)).sum(axis=1)
            if counts.max(initial=0.0) > math.log(MAX_SAMPLES):
                most = np.flatnonzero(found[0][np.argmax(counts)])
                raise _refuse_many(np.unique(found[0] > 0, axis=0), [], most.tolist())
    return np.maximum.reduce(found)


def _sum_up(coefficients: Floats, functions: list[list[Expression]]) -> Expression:
    """Returns Σ coefficient · ∏ functions, without rounding."""
    total = Expression(0.0)
    for place in np.argwhere(np.abs(coefficients) > _ROUNDING * np.abs(coefficients).max()):
        product = Expression(float(coefficients[tuple(place)]))
        for choice, options in zip(place, functions, strict=True):
            product *= options[choice]
        total += product
    return total
