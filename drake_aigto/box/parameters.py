"""Costs that are compiled once for many values of their parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.box.polynomial import BoxPolynomial
from drake_aigto.box.tapes import Order
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.linear import Storage
from drake_aigto.terms import Factor, FunctionKind, Term, TermBlock


class _Summand(NamedTuple):
    """factor · ∏ p_j^powers_j, a part of a coefficient."""

    coefficient: int
    factor: float
    powers: tuple[int, ...]


class ParametricPolynomial:
    """f(x; p) = Σ_m a_m(p) ∏_i g_mi(x_i), whose coefficients a_m are polynomials of P numbers p.

    Boxes are not over parameters: `at` folds their powers into coefficients. What depends on the
    structure of f alone (tables, tapes, the storage of Newton systems) is made once.

    Args:
        num_variables: Dimension n of x.
        num_parameters: P.
        blocks: Terms over x, the variables 0 … n − 1, and over p, n … n + P − 1. Of parameters they
            read powers only, and all copies of a sum read the same ones.
        order: Elimination order of x, see `BoxPolynomial`.
        derivatives: What is made now, for all values; the rest for each when first asked for.

    Raises:
        UnsupportedTermError: A function of a parameter that is no power.
    """

    def __init__(
        self,
        num_variables: int,
        num_parameters: int,
        blocks: Iterable[TermBlock],
        order: ArrayLike | None = None,
        derivatives: Iterable[Order] = (Order.MEAN, Order.BOXES),
    ) -> None:
        """Takes coefficients apart."""
        summands: list[_Summand] = []
        known: dict[tuple[object, ...], tuple[Term, ...]] = {}
        structure: list[TermBlock] = []
        for block in blocks:
            is_parameter = block.variables[0] >= num_variables
            places = np.where(is_parameter, block.variables[0] - num_variables, -1).tolist()
            key = block.terms, tuple(places)
            if key not in known:
                known[key] = _take_apart(block, places, num_parameters, summands)
            variables = block.variables[:, ~is_parameter]
            structure.append(TermBlock(block.name, known[key], variables, block.weight))
        self._structure = BoxPolynomial(num_variables, tuple(structure), order)
        for each in derivatives:
            self._structure.lanes(each)
        self._targets = np.array([each.coefficient for each in summands], dtype=np.int64)
        self._factors = np.array([each.factor for each in summands])
        powers = [each.powers for each in summands]
        self._powers = np.array(powers, dtype=np.int64).reshape(-1, num_parameters)

    @property
    def storage(self) -> Storage:
        """How Newton systems are stored, see `BoxPolynomial`."""
        return self._structure.storage

    def at(self, parameters: ArrayLike) -> BoxPolynomial:
        """Returns f(·; p) at p of shape (P,)."""
        p = np.asarray(parameters, dtype=float)
        parts = self._factors * np.prod(p**self._powers, axis=1)
        return self._structure.with_coefficients(np.bincount(self._targets, parts).astype(float))


def _take_apart(
    block: TermBlock, places: list[int], num_parameters: int, summands: list[_Summand]
) -> tuple[Term, ...]:
    """Returns the terms of a block over x alone, and adds the parts of their coefficients.

    The coefficient of each new term is its number, counted on from the last summand's. Places are,
    of each local variable, which parameter it is; −1 for those of x.
    """
    local = (np.cumsum(np.array(places) < 0) - 1).tolist()
    numbers: dict[tuple[Factor, ...], int] = {}
    first = 1 + max((each.coefficient for each in summands), default=-1)
    for term in block.terms:
        powers, kept = [0] * num_parameters, []
        for factor in term.factors:
            if places[factor.variable] < 0:
                kept.append(dataclasses.replace(factor, variable=local[factor.variable]))
            elif (factor.kind, factor.scale, factor.offset) == (FunctionKind.POWER, 1.0, 0.0):
                powers[places[factor.variable]] = factor.exponent
            else:
                raise UnsupportedTermError(
                    f"the cost '{block.name}' can't be compiled for any value of its parameters",
                    got=f"the factor {factor} of a parameter",
                    expected="powers of parameters",
                )
        number = numbers.setdefault(tuple(kept), first + len(numbers))
        summands.append(_Summand(number, term.coefficient, tuple(powers)))
    return tuple(Term(float(number), factors) for factors, number in numbers.items())
