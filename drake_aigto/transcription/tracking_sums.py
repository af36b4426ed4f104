"""The squares of how far a motion is from where it should be, with that as parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drake_aigto.arrays import Bools, Floats
from drake_aigto.terms import FunctionKind, Sum, add, compose, constant, function
from drake_aigto.transcription.stage_sums import quadratic

_COSINE, _SINE = (function(0, kind, 0) for kind in (FunctionKind.COSINE, FunctionKind.SINE))


@dataclass(frozen=True, eq=False)
class TrackingSums:
    """eᵀ Q e + ėᵀ Qv ė = fixed + Σ_i p_i basis_i, e = q − about_q, ė = v − about_v.

    Attributes:
        position_weight: Q, shape (n, n).
        velocity_weight: Qv, shape (n, n).
        is_chordal: of which coordinates e² is 2 − 2 cos e; Q has only its diagonal there.
    """

    position_weight: Floats
    velocity_weight: Floats
    is_chordal: Bools

    @property
    def _chord_weights(self) -> Floats:
        return np.where(self.is_chordal, np.diag(self.position_weight), 0.0)

    @property
    def _exact_weight(self) -> Floats:
        return self.position_weight - np.diag(self._chord_weights)

    def fixed(self, positions: Sequence[Sum], velocities: Sequence[Sum]) -> Sum:
        """Returns what depends on no parameter, of sums that are q and v."""
        return add(
            quadratic(self._exact_weight, positions),
            quadratic(self.velocity_weight, velocities),
            constant(2.0 * float(np.sum(self._chord_weights))),
        )

    def basis(self, positions: Sequence[Sum], velocities: Sequence[Sum]) -> list[Sum]:
        """Returns what parameters are factors of."""
        chords, exact, rates = self._members()
        waves = [compose(wave, [positions[i]]) for wave in (_COSINE, _SINE) for i in chords]
        lines = [*(positions[i] for i in exact), *(velocities[i] for i in rates)]
        return [*waves, *lines, constant(1.0)]

    def calc_parameters(self, about_q: Floats, about_v: Floats) -> Floats:
        """Returns p."""
        chords, exact, rates = self._members()
        slope, rate = self._exact_weight @ about_q, self.velocity_weight @ about_v
        angles, weights = about_q[chords], self._chord_weights[chords]
        parts = weights * np.cos(angles), weights * np.sin(angles), slope[exact], rate[rates]
        return np.append(-2 * np.concatenate(parts), about_q @ slope + about_v @ rate)

    def _members(self) -> list[list[int]]:
        """Returns which coordinates have chords, other squares, and squares of velocities."""
        weights = np.diag(self._chord_weights), self._exact_weight, self.velocity_weight
        return [np.flatnonzero(np.any(each, axis=1)).tolist() for each in weights]
