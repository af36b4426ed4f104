"""A lower bound beside the answer, which bounds the search and may end it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drake_aigto.aigo import Box
from drake_aigto.arrays import Floats
from drake_aigto.certify import Certificate, Certifier
from drake_aigto.solver.program import AigoProgram

PROVEN = 1e-6  # of the gap
# This part of the cells is spent before the search, which may then be over.
_FIRST_SHARE = 0.1


class Proof:
    """The certificate of a solve, as it grows.

    Args:
        program: what is solved.
        cells: how many cells are bounded at most.
        improve: polishes a point of the program and keeps it; None where it is not feasible.

    Raises:
        UnsupportedTermError: a function has no enclosure, by name.
    """

    def __init__(
        self, program: AigoProgram, cells: int, improve: Callable[[Floats], Floats | None]
    ) -> None:
        """Reads the formulas of the program as it was given, not of what presolve made of it."""
        self._certifier = Certifier(program.source, gap=PROVEN)
        self._left, self._first = cells, max(1, int(_FIRST_SHARE * cells))
        self._improve = improve
        self.certificate: Certificate | None = None

    def offer(self, x: Floats) -> None:
        """Takes a feasible point x (n,)."""
        self._certifier.offer(x)

    @property
    def is_over(self) -> bool:
        """Whether the best point is proven, or that there is no feasible one."""
        found = self.certificate
        return found is not None and (found.gap <= PROVEN or found.is_infeasible)

    def begin(self) -> None:
        """Spends the first share of the cells."""
        self._run(self._first)

    def finish(self) -> None:
        """Spends the cells that are left, unless it is over."""
        if not self.is_over:
            self._run(self._left)

    def _run(self, cells: int) -> None:
        self._left -= cells
        self.certificate = self._certifier.run(cells, self._improve)

    def cut(self, box: Box, program: AigoProgram) -> Box:
        """Returns the part of a box over y that may hold a minimizer."""
        if self.certificate is None or self.is_over:
            return box
        low, high = self.certificate.hull
        own = [(k, i) for k, i in enumerate(program.reduced.kept.tolist()) if i < low.size]
        ends = np.array([box.center - box.half_width, box.center + box.half_width])
        for k, i in own:
            a, b = max(ends[0, k], low[i]), min(ends[1, k], high[i])
            if a <= b and box.half_width[k] > 0.0:
                ends[:, k] = a, b
        center = np.where(box.half_width > 0.0, 0.5 * (ends[0] + ends[1]), box.center)
        return Box(center, 0.5 * (ends[1] - ends[0]))
