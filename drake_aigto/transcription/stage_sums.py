"""What a knot adds to a mechanism's cost, as sums of terms over its own and its neighbors' z."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_aigto.arrays import Floats
from drake_aigto.terms import Sum, add, compose, constant, multiply
from drake_aigto.transcription.box_coordinates import BoxCoordinates, Reading, read_sum, variables
from drake_aigto.world import World


class StageSums:
    """Positions, velocities and forces at a knot as sums over (z_{k−1}, z_k, z_{k+1}).

    Args:
        world: the mechanism.
        coordinates: what z is.
        stiffness: k of the springs of its contacts [N/m].
        dissipation: d of these [s/m].
        time_step: dt [s].

    Attributes:
        positions: q_k, n sums.
        velocities: v_k, n sums.
        forces: p_k = M a + h − Jᵀ f, n sums.
        distances: s_k − φ(q_k) + b, S sums.
    """

    def __init__(
        self,
        world: World,
        coordinates: BoxCoordinates,
        stiffness: Floats,
        dissipation: Floats,
        time_step: float,
    ) -> None:
        """Multiplies out."""
        self._coordinates, self._dt = coordinates, time_step
        self._num = coordinates.num_variables
        positions = coordinates.positions
        before, self.positions, after = ([self._at(q, k) for q in positions] for k in range(3))
        self.velocities = [self._slope(*ends) for ends in zip(before, after, strict=True)]
        own = variables(range(coordinates.num_positions, coordinates.num_variables))
        self.distances = [
            self._at(add(s, scaled(-1.0, distance)), 1)
            for s, distance in zip(own, coordinates.distances, strict=True)
        ]
        accelerations = [
            scaled(time_step**-2, add(a, b, scaled(-2.0, q)))
            for a, q, b in zip(before, self.positions, after, strict=True)
        ]
        self.forces = self._calc_forces(world, accelerations, stiffness, dissipation)

    def _at(self, total: Sum, k: int) -> Sum:
        """Returns a sum over z as one over z_{k−1}, z_k or z_{k+1}, k = 0, 1, 2."""
        return compose(total, variables(range(k * self._num, (k + 1) * self._num)))

    def _slope(self, before: Sum, after: Sum) -> Sum:
        return scaled(1 / (2 * self._dt), add(after, scaled(-1.0, before)))

    def _calc_forces(
        self, world: World, accelerations: list[Sum], stiffness: Floats, dissipation: Floats
    ) -> list[Sum]:
        springs = zip(self._coordinates.readings, stiffness, dissipation, strict=True)
        pushes = [self._push(*spring) for spring in springs]
        jacobian = [
            self._read(world.contacts[i].jacobian, world) for i in self._coordinates.contacts
        ]
        bias = self._read(world.bias, world)
        return [
            add(
                bias[i],
                *map(multiply, self._read(row, world), accelerations),
                *(scaled(-1.0, multiply(J[i], f)) for J, f in zip(jacobian, pushes, strict=True)),
            )
            for i, row in enumerate(world.mass_matrix)
        ]

    def _push(self, reading: Reading, stiffness: float, dissipation: float) -> Sum:
        """Returns k max(0, −φ) (1 − d φ̇) of a spring."""
        (z,) = variables([reading.variable])
        rate = scaled(reading.scale, self._slope(self._at(z, 0), self._at(z, 2)))
        damping = add(constant(1.0), scaled(-dissipation, rate))
        return scaled(stiffness, multiply(self._at(reading.depth, 1), damping))

    def _read(self, expressions: NDArray[Any], world: World) -> list[Sum]:
        """Returns expressions of q and v at the knot."""
        names = [*world.positions, *world.velocities]
        values = [*self.positions, *self.velocities]
        return [compose(read_sum(each, names), values) for each in expressions]


def scaled(factor: float, total: Sum) -> Sum:
    """Returns a sum times a number."""
    return multiply(constant(factor), total) if factor else {}


def combine(weights: Iterable[float], sums: Iterable[Sum]) -> Sum:
    """Returns Σ w_i sum_i."""
    return add(*map(scaled, map(float, weights), sums))


def quadratic(weights: Floats, sums: Sequence[Sum]) -> Sum:
    """Returns Σ_ij w_ij sum_i sum_j of a symmetric matrix (n, n)."""
    pairs = zip(*np.nonzero(np.triu(weights)), strict=True)
    return add(
        *(
            scaled((1 + (i != j)) * float(weights[i, j]), multiply(sums[i], sums[j]))
            for i, j in pairs
        )
    )
