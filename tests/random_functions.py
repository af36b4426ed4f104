"""Functions of formulas and of numbers in high precision, and programs of them."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
import pydrake.symbolic as sym
from pydrake.solvers import ExpressionCost, MathematicalProgram

NAMES = ("sin", "cos", "tanh", "exp", "log", "sqrt", "atan")
HIGH_PRECISION = {name: getattr(mpmath, name) for name in NAMES}
HIGH_PRECISION |= {"abs": abs, "max": max, "min": min, "pow": operator.pow}


def box(size: int, lower: Any = -2.0, upper: Any = 2.0) -> tuple[MathematicalProgram, Any]:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(size, "x")
    prog.AddBoundingBoxConstraint(lower * np.ones(size), upper * np.ones(size), x)
    return prog, x


def program(cost: Callable[..., Any], size: int) -> tuple[MathematicalProgram, Any]:
    prog, x = box(size)
    add_cost(prog, cost(*x))
    return prog, x


def add_cost(prog: MathematicalProgram, cost: Any) -> None:
    evaluator = ExpressionCost(sym.Expression(0.0) + cost)
    prog.AddCost(evaluator, vars=evaluator.vars())


FUNCTIONS = (
    lambda x, y: (1.0 - x) ** 2 + 10.0 * (y - x**2) ** 2 + sym.sin(3.0 * x),
    lambda x, y: sym.exp(x) * y + sym.sqrt(x**2 + y**2 + 0.5) - 1.0 / (3.0 + x * y / 2.0),
    lambda x, y: sym.abs(x - 0.3) + sym.max(x, y) - sym.cos(4.0 * x * y) + 0.3 * y**2,
    lambda x, y: sym.pow(3.0 + x, 1.1) * sym.pow(4.0 + y, -0.3) + sym.pow(2.5 + x * y / 4.0, 0.7),
    lambda x, y: sym.log(3.0 + x) * sym.atan(y) + sym.tanh(x * y) + 0.1 * x**4 - 0.3 * x**2,
)


UNARY: tuple[Callable[..., Any], ...] = (
    lambda m, a: m.sin(a),
    lambda m, a: m.cos(2.0 * a),
    lambda m, a: m.tanh(a),
    lambda m, a: m.atan(a),
    lambda m, a: m.exp(m.sin(a)),
    lambda m, a: m.log(1.0 + a * a),
    lambda m, a: (0.1 + m.abs(a)) * m.log(0.1 + m.abs(a)),
    lambda m, a: m.pow(2.0 + m.cos(a), 1.3),
    lambda m, a: m.sqrt(0.5 + a**2),
    lambda m, a: m.pow(m.abs(a), 1.5),
    lambda m, a: m.sqrt(m.abs(a)),
    lambda m, a: m.abs(a),
    lambda m, a: a**2 - 0.5 * a,
    lambda m, a: a**3,
    lambda m, a: 1.0 / (1.5 + m.sin(a)),
    lambda m, a: 1.0 / a,
)
BINARY: tuple[Callable[..., Any], ...] = (
    lambda m, a, b: a + b,
    lambda m, a, b: a - 3.0 * b,
    lambda m, a, b: a * b,
    lambda m, a, b: m.max(a, b),
    lambda m, a, b: m.min(a, b),
    lambda m, a, b: a / (1.0 + b * b),
)


def random_function(rng: np.random.Generator, size: int, depth: int) -> Callable[..., Any]:
    """Returns a function of a namespace of functions, and of numbers or Expressions."""
    if depth == 0:
        i, scale = int(rng.integers(size)), float(rng.choice([1.0, -2.0, 0.3]))
        return lambda m, x: scale * x[i]
    first, last = (random_function(rng, size, depth - 1) for _ in range(2))
    if rng.random() < 0.5:
        one = UNARY[int(rng.integers(len(UNARY)))]
        return lambda m, x: one(m, first(m, x))
    both = BINARY[int(rng.integers(len(BINARY)))]
    return lambda m, x: both(m, first(m, x), last(m, x))


EDGES: tuple[Callable[..., Any], ...] = (
    lambda m, a: m.sqrt(a),
    lambda m, a: m.pow(a, 0.3),
    lambda m, a: m.pow(a, 1.5),
    lambda m, a: m.pow(a, -0.3),
    lambda m, a: m.log(a),
    lambda m, a: a * m.log(a),
    lambda m, a: m.pow(a, 7),
    lambda m, a: m.exp(-a * a),
)


def random_edge(rng: np.random.Generator, point: np.ndarray) -> Callable[..., Any]:
    """Returns a function of one variable whose domain, if it has an edge, ends at a point."""
    i, sign = int(rng.integers(point.size)), float(rng.choice([1.0, -1.0]))
    own, shift = EDGES[int(rng.integers(len(EDGES)))], -sign * float(point[i])
    return lambda m, x: own(m, sign * x[i] + shift)
