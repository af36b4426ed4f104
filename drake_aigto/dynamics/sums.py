"""Sums of products of powers, sin and cos, as arrays; M, J and h where these are constant."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.symbolic import Expression, cos, sin

from drake_aigto.arrays import Floats, Ints, read_only
from drake_aigto.errors import ModelError
from drake_aigto.terms import Factor, FunctionKind, Term, expression_terms

# Coefficients below this, relative to the largest, are rounding left by rotations such as
# cos(π/2) = 6e-17, not physics. They would make constants look like functions.
_ROUNDING = 1e-13
# Significant digits of a coefficient: 0.7 read as a difference is 0.70000000000000018.
_DIGITS = 14


def tidy(expressions: NDArray[Any]) -> NDArray[Any]:
    """Returns expressions expanded and without rounding errors, as a read-only array.

    Args:
        expressions: any shape; each a sum of products of powers, sin and cos.

    Raises:
        UnsupportedTermError: one is not.
    """
    found = {v.get_id(): v for expression in expressions.flat for v in expression.GetVariables()}
    variables = list(found.values())
    sums = [_read(expression, variables) for expression in expressions.flat]
    largest = max((abs(term.coefficient) for sum_ in sums for term in sum_), default=0.0)
    result = np.empty(expressions.size, dtype=object)
    for i, sum_ in enumerate(sums):
        kept = (term for term in sum_ if abs(term.coefficient) > _ROUNDING * largest)
        result[i] = sum((_express(term, variables) for term in kept), Expression(0.0))
    result.flags.writeable = False
    return result.reshape(expressions.shape)


def calc_turning(rows: Iterable[NDArray[Any]], q: NDArray[Any], v: NDArray[Any]) -> NDArray[Any]:
    """Returns J̇ v of each row J(q), (nv,): rates of change of velocities J v at constant v.

    Args:
        rows: m of them.
        q: the variables of positions, shape (nq,).
        v: the variables of velocities, shape (nv,), v = q̇.
    """
    turns = [_dot(_dot(row, v).Jacobian(q), v) for row in rows]
    return tidy(np.array(turns, dtype=object))


def _dot(row: NDArray[Any], variables: NDArray[Any]) -> Expression:
    """Returns Σ_k row_k variable_k; NumPy's product of objects warns at random."""
    return sum((a * b for a, b in zip(row, variables, strict=True)), Expression(0.0))


def is_constant(expressions: Any) -> bool:
    """Returns whether expressions, one or an array of them, have no variable."""
    return all(expression.GetVariables().empty() for expression in np.ravel(expressions))


def evaluate(expressions: NDArray[Any], at: dict[Any, float] | None = None) -> Floats:
    """Returns the values of expressions, of the same shape.

    Args:
        expressions: any shape.
        at: the value of each of their variables.
    """
    values = [expression.Evaluate(at or {}) for expression in expressions.flat]
    return np.array(values, dtype=float).reshape(expressions.shape)


def _read(expression: Expression, variables: Iterable[Any]) -> tuple[Term, ...]:
    """Returns the terms of an expression, each variable being its place."""
    return expression_terms("the world", expression, variables, is_row=True)


def _express(term: Term, variables: list[Any]) -> Expression:
    """Returns a term as an expression."""
    product = Expression(float(f"{term.coefficient:.{_DIGITS}g}"))
    for factor in term.factors:
        x = variables[factor.variable]
        if factor.kind != FunctionKind.POWER:
            wave = cos if factor.kind == FunctionKind.COSINE else sin
            product *= wave(factor.scale * x + factor.offset)
        if factor.exponent:
            product *= x**factor.exponent
    return product


class Blend(NamedTuple):
    """Shares s_k of worlds that differ from a first one: f = f₀ + Σ s_k (f_k − f₀)."""

    first: Any
    others: tuple[Any, ...]
    shares: tuple[float, ...]

    @classmethod
    def of(cls, first: Any, shares: Sequence[tuple[Any, float]]) -> Blend:
        """Returns shares of others, each with its own."""
        return cls(first, tuple(other for other, _ in shares), tuple(each for _, each in shares))

    def mix(self, read: Callable[[Any], Any]) -> Any:
        """Returns f of an array that is read off each, of numbers or of Expressions."""
        found = mine = read(self.first)
        with np.errstate(invalid="ignore"):  # As Drake's arithmetic on Expressions looks for NaN.
            for other, share in zip(self.others, self.shares, strict=True):
                if share and (theirs := read(other)) is not mine:
                    found = found + share * (theirs - mine)
        return found

    def are_alike(self, read: Callable[[Any], tuple[Any, ...]]) -> bool:
        """Returns whether arrays that are read off each are the same of all."""
        mine = read(self.first)
        return all(all(map(np.array_equal, mine, read(other))) for other in self.others)


class SumMap:
    """Sums of products f: ℝⁿ → ℝᵐ compiled to arrays, f(x)ⱼ = Σₖ Cⱼₖ ∏ᵢ gₖᵢ(x).

    A simulator calls this in every derivative; it takes a few microseconds.

    Attributes:
        coefficients: C, shape (m, products).
    """

    def __init__(self, expressions: NDArray[Any], *variables: NDArray[Any]) -> None:
        """Compiles.

        Args:
            expressions: any shape of m entries, which values have, too; sums of products of powers,
                sin and cos of the variables.
            variables: arrays of n in all.
        """
        self._shape, names = expressions.shape, np.concatenate(variables)
        sums = [_read(expression, names) for expression in expressions.flat]
        products = list(dict.fromkeys(term.factors for sum_ in sums for term in sum_))
        row = {product: k for k, product in enumerate(products)}
        self.coefficients = np.zeros((len(sums), len(products)))
        for j, sum_ in enumerate(sums):
            for term in sum_:
                self.coefficients[j, row[term.factors]] += term.coefficient
        self._compile_factors(products)
        self._compile_affine(products, len(names))

    def _compile_factors(self, products: list[tuple[Factor, ...]]) -> None:
        """Lists the functions g, and which of them each product has; beyond the last one: none."""
        factors = list(dict.fromkeys(factor for product in products for factor in product))
        place = {factor: i for i, factor in enumerate(factors)}
        most = max(map(len, products), default=0)
        self._members = np.full((len(products), most), len(factors))
        for k, product in enumerate(products):
            self._members[k, : len(product)] = [place[factor] for factor in product]
        rows = [(f.variable, f.exponent, f.kind) for f in factors]
        self._factors = np.array(rows, dtype=np.int64).reshape(-1, 3)
        self._waves = np.array([(f.scale, f.offset) for f in factors], dtype=float).reshape(-1, 2)

    def _compile_affine(self, products: list[tuple[Factor, ...]], num_variables: int) -> None:
        """Finds whether f is affine, and its slope and constant."""
        degrees = [
            sum(f.exponent if f.kind == FunctionKind.POWER else np.inf for f in product)
            for product in products
        ]
        self._is_affine = max(degrees, default=0) <= 1
        self._constant = self.coefficients @ np.equal(degrees, 0)
        self._slope = np.zeros((len(self.coefficients), num_variables))
        for k, product in enumerate(products):
            if degrees[k] == 1:
                self._slope[:, product[0].variable] = self.coefficients[:, k]

    @classmethod
    def of_blend(cls, blend: Blend, name: str) -> SumMap | None:
        """Returns the map of worlds' maps, by its name; None: they are of other products."""

        def find(array: str) -> Callable[[Any], Floats]:
            return lambda world: getattr(getattr(world, name), array)

        if not blend.are_alike(lambda world: getattr(world, name)._products):
            return None
        mixed = copy.copy(getattr(blend.first, name))
        for array in ("coefficients", "_constant", "_slope"):
            setattr(mixed, array, blend.mix(find(array)))
        return mixed

    @property
    def _products(self) -> tuple[Ints, Floats, Ints]:
        return self._factors, self._waves, self._members

    @property
    def tables(self) -> tuple[Ints, Floats, Ints, Floats]:
        """Factors, waves, members and coefficients, for compiled code (`evaluate_sums`)."""
        return *self._products, self.coefficients

    def __call__(self, *x: Floats) -> Floats:
        """Returns f, shape (…, *shape of the expressions), of variables (…, n) in all."""
        points = x[0] if len(x) == 1 else np.concatenate(x, axis=-1)
        values: Floats
        if self._is_affine:
            values = points @ self._slope.T + self._constant
            if len(self._shape) == 1:  # Simulations ask for distances in every step.
                return values
        else:
            # A copy, as what is read-only would be compiled anew.
            rows = np.array(points, dtype=float, order="C").reshape(-1, points.shape[-1])
            values = load_kernels().evaluate_sums(rows, *self.tables)
        return values.reshape(*points.shape[:-1], *self._shape)

    def calc_range(self, low: Floats, high: Floats) -> Floats:
        """Returns lower and upper bounds of f(x) over low ≤ x ≤ high, shape (2, m).

        Each product by itself, waves between −1 and 1: f may not come near them.

        Args:
            low: shape (n,), −∞ where there is no bound.
            high: shape (n,).
        """
        ranges = [_find_range(int(kind), low[i], high[i], int(p)) for i, p, kind in self._factors]
        total = np.zeros((2, len(self.coefficients)))
        for members, column in zip(self._members, self.coefficients.T, strict=True):
            ends = (1.0, 1.0)
            for member in members[members < len(ranges)]:
                ends = _multiply(ends, ranges[member])
            total += np.array([_multiply((a, a), ends) for a in column]).T
        return total


def _find_range(kind: int, low: float, high: float, exponent: int) -> tuple[float, float]:
    """Returns the range of x^p, times a wave if there is one, over low ≤ x ≤ high."""
    ends = float(low) ** exponent, float(high) ** exponent
    least = 0.0 if exponent and exponent % 2 == 0 and low <= 0 <= high else min(ends)
    most = max(ends)
    return (least, most) if kind == FunctionKind.POWER else _multiply((least, most), (-1.0, 1.0))


def _multiply(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
    """Returns the range of x y over x in a and y in b, with 0 · ∞ = 0."""
    products = [x * y if x and y else 0.0 for x in a for y in b]
    return min(products), max(products)


@cache
def load_kernels() -> ModuleType:
    """Returns the compiled code when it is needed, as Numba takes a second to load."""
    from drake_aigto.dynamics import sum_kernels

    return sum_kernels


@dataclass(frozen=True, eq=False)
class ConstantInertia:
    """Equations of motion whose M and J are constant, as those of bodies that only translate.

        φ(q) = J q + φ(0),    φ̇ = J v,    φ̈ = J v̇

    Effects of impulses and controls do not depend on q; with springs and dampers the bias h may
    still vary. Functions that need this take it instead of a World.

    Letters as in `EquationsOfMotion`. Arrays are read-only.

    Attributes:
        mass_matrix: M, shape (nv, nv) [kg].
        actuation: B, shape (nv, nu).
        jacobian: J, shape (m, nv).
        offset: φ(0), shape (m,) [m].
        solids: the contacts of each solid, S of them.
    """

    mass_matrix: Floats
    actuation: Floats
    jacobian: Floats
    offset: Floats
    solids: tuple[tuple[int, ...], ...]

    @cached_property
    def inverse_mass(self) -> Floats:
        """M⁻¹, shape (nv, nv) [1/kg]."""
        return read_only(np.linalg.inv(self.mass_matrix))

    @cached_property
    def gain(self) -> Floats:
        """M⁻¹ B, shape (nv, nu) [1/kg]: the acceleration by each control."""
        return read_only(self.inverse_mass @ self.actuation)

    @cached_property
    def kicks(self) -> Floats:
        """M⁻¹ J_iᵀ, shape (m, nv) [1/kg]: how v changes by an impulse of 1 N s at contact i."""
        return read_only(self.jacobian @ self.inverse_mass.T)

    @cached_property
    def delassus(self) -> Floats:
        """A = J M⁻¹ Jᵀ, shape (m, m) [1/kg]: how φ̇_i changes by 1 N s at contact j."""
        return read_only(self.jacobian @ self.kicks.T)

    @cached_property
    def masses(self) -> Floats:
        """1 / A_ii, shape (m,) [kg]: effective mass of each contact, infinite if it can't move."""
        with np.errstate(divide="ignore"):
            return read_only(1 / np.diag(self.delassus))

    @cached_property
    def lifts(self) -> Floats:
        """M⁻¹ J_iᵀ / A_ii, shape (m, nv): how v changes as contact i changes φ̇_i by 1.

        It is 0 if it can't move, as for an arm stretched out along the wall's normal.
        """
        mobility = np.diag(self.delassus)[:, np.newaxis]
        return read_only(self.kicks / np.where(mobility > 0, mobility, np.inf))


@dataclass(frozen=True, eq=False)
class ConstantDynamics(ConstantInertia):
    """Equations of motion with constant bias, too: held controls lead to parabolas.

        v̇ = M⁻¹ (B u − h)    without contact

    Attributes:
        bias: h, shape (nv,) [N].
    """

    bias: Floats

    @cached_property
    def drift(self) -> Floats:
        """−M⁻¹ h, shape (nv,) [m/s²]: the acceleration without control."""
        return read_only(-self.inverse_mass @ self.bias)

    @cached_property
    def mirrors_keep_costs(self) -> bool:
        """Whether G Gᵀ, of G = M⁻¹ B, is its own image in each wall's mirror.

        The mirror changes velocities as an elastic impact does.
        """
        worth = self.gain @ self.gain.T
        for J, kick in zip(self.jacobian, self.kicks, strict=True):
            mirror = np.eye(J.size) - 2 * np.outer(kick, J) / (J @ kick)
            if not np.allclose(mirror @ worth @ mirror.T, worth, atol=1e-9 * np.max(worth)):
                return False
        return True


def read_constant(name: str, expressions: NDArray[Any], remedy: str) -> Floats:
    """Returns the values of expressions of this name, of the same shape, read-only."""
    if not is_constant(expressions):
        got = ", ".join(map(str, expressions.flat))
        raise ModelError(name, got, expected="a constant", remedy=remedy)
    return read_only(evaluate(expressions))
