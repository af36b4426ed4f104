"""Test functions and their gradients as machine code, so that no peer waits for Python.

A function is called once on `Node`s, which write down every operation. What they wrote is turned
into a straight-line program and its reverse sweep, and compiled by Numba.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from benchmarks.collections.known_optimum import GlobalProblem, Part

Values = Callable[[np.ndarray], float]
Gradients = Callable[[np.ndarray], tuple[float, np.ndarray]]


class Tape:
    """Lines of Python: forward, and backward from the last to the first."""

    def __init__(self) -> None:
        self.forward: list[str] = []
        self.backward: list[str] = []

    def new(self, formula: str, slopes: dict[str, str]) -> Node:
        """Writes down a value, and what its adjoint adds to those of its arguments."""
        name = f"v{len(self.forward)}"
        self.forward.append(f"{name} = {formula}")
        adds = [f"d{argument} += d{name} * ({slope})" for argument, slope in slopes.items()]
        self.backward.append("; ".join(adds))
        return Node(self, name)


@dataclass(frozen=True)
class Node:
    """A number that is not known yet."""

    tape: Tape
    name: str

    def _with(self, other: Any, formula: str, slope: str, other_slope: str) -> Node:
        is_node = isinstance(other, Node)
        names = {"a": self.name, "b": other.name if is_node else repr(float(other))}
        if is_node and other.name == self.name:
            slope, other_slope = f"({slope}) + ({other_slope})", ""
        slopes = {self.name: slope.format(**names)}
        if is_node and other_slope:
            slopes[other.name] = other_slope.format(**names)
        return self.tape.new(formula.format(**names), slopes)

    def __add__(self, other: Any) -> Node:
        return self._with(other, "{a} + {b}", "1.0", "1.0")

    def __sub__(self, other: Any) -> Node:
        return self._with(other, "{a} - {b}", "1.0", "-1.0")

    def __rsub__(self, other: Any) -> Node:
        return self._with(other, "{b} - {a}", "-1.0", "")

    def __mul__(self, other: Any) -> Node:
        return self._with(other, "{a} * {b}", "{b}", "{a}")

    def __truediv__(self, other: float) -> Node:
        return self._with(other, "{a} / {b}", "1.0 / {b}", "")

    def __pow__(self, exponent: int) -> Node:
        if exponent == 0:
            return self * 0.0 + 1.0
        slope = f"{float(exponent)!r} * {self.name} ** {exponent - 1}" if exponent > 1 else "1.0"
        return self.tape.new(f"{self.name} ** {exponent}", {self.name: slope})

    def __neg__(self) -> Node:
        return self * -1.0

    def cos(self) -> Node:
        """What np.cos calls."""
        return self.tape.new(f"math.cos({self.name})", {self.name: f"-math.sin({self.name})"})

    __radd__, __rmul__ = __add__, __mul__


def compile_function(problem: GlobalProblem) -> tuple[Values, Gradients]:
    """Returns f and its gradient as machine code."""
    tables = [table for part in problem.parts for table in (part.variables, part.parameters)]
    value, gradient = (_compile(problem.parts, with_gradient) for with_gradient in (False, True))
    # Own arrays, so that Numba sees one type, whatever the layout and flags of those it is given.
    point, slope = np.array(problem.lower), np.empty(problem.num_variables)

    def values(x: np.ndarray) -> float:
        point[:] = x
        return value(point, slope, *tables)

    def gradients(x: np.ndarray) -> tuple[float, np.ndarray]:
        point[:] = x
        slope[:] = 0.0
        return gradient(point, slope, *tables), slope.copy()

    values(point)
    gradients(point)
    return values, gradients


def _compile(parts: tuple[Part, ...], with_gradient: bool) -> Callable[..., float]:
    """One function for the sum of all parts: a loop over the copies of each."""
    arguments = [f"index{p}, numbers{p}" for p in range(len(parts))]
    lines = [f"def kernel(x, slope, {', '.join(arguments)}):", "    total = 0.0"]
    for p, part in enumerate(parts):
        lines.append(f"    for k in range({len(part.variables)}):")
        lines += [f"        {line}" for line in _loop_body(p, part, with_gradient)]
    lines.append("    return total")
    namespace: dict[str, Any] = {"math": math}
    exec("\n".join(lines), namespace)  # what Node wrote, and nothing else
    return numba.njit(error_model="numpy")(namespace["kernel"])


def _loop_body(p: int, part: Part, with_gradient: bool) -> list[str]:
    tape = Tape()
    num_inputs = part.variables.shape[1]
    inputs = [Node(tape, f"x{j}") for j in range(num_inputs)]
    constants = [Node(tape, f"c{j}") for j in range(part.parameters.shape[1])]
    result = part.function(*inputs, *constants)
    lines = [f"x{j} = x[index{p}[k, {j}]]" for j in range(num_inputs)]
    lines += [f"c{j} = numbers{p}[k, {j}]" for j in range(len(constants))]
    lines += [*tape.forward, f"total += {result.name}"]
    if with_gradient:
        names = [node.name for node in (*inputs, *constants)]
        names += [f"v{i}" for i in range(len(tape.forward))]
        lines += [f"d{name} = 0.0" for name in names]
        lines += [f"d{result.name} = 1.0", *reversed(tape.backward)]
        lines += [f"slope[index{p}[k, {j}]] += dx{j}" for j in range(num_inputs)]
    return lines
