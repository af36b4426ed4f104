"""Options for planning as the paper does: numerics only."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

from drake_aigto.errors import OptionsError
from drake_aigto.planning import Rung, SearchOptions
from drake_aigto.transcription import DYNAMICS, KINEMATICS, NONPENETRATION

AlgorithmName = Literal["annealing", "full gradient", "alternating"]


def _literal_rung(temperature: float, kinematics: float, dynamics: float) -> Rung:
    weights = {KINEMATICS: kinematics, DYNAMICS: dynamics, NONPENETRATION: 5e-4}
    return Rung(temperature, weights)


# Light dynamics rows keep the paper's contact alive while boxes are wide: a heavy (φ + δ)² (…)² is
# least at φ ≈ 0 with no impulse, the collapse of AIGTO Fig. 1. Light kinematics rows let the mass
# jump to the wall at once. The first rung alone finds the bounce of all of Table I by annealing; a
# heavy and cold one ends in free flight; Algorithm 1 needs the lightest.
LITERAL_LADDER = (
    _literal_rung(1e-4, 1e3, 1e-2),
    _literal_rung(1e-5, 1e2, 1e0),
    _literal_rung(1e-4, 1e3, 1e-3),
    _literal_rung(1e-5, 1e2, 1e-4),
    _literal_rung(1e-4, 1e1, 1e-4),
)


@dataclass(frozen=True, kw_only=True)
class LiteralOptions(SearchOptions):
    """Numerics of a plan in the paper's transcription (`LiteralTranscription`).

    Attributes:
        ladder: the starts of AIGO; candidates come out of each. Local_solver, finalists, threads
            and confirm: see `SearchOptions`.
        nonpenetration: whether φ(q_k) ≥ 0 is a constraint. The paper's figures need it off.
        algorithm: "annealing"; or "full gradient", the paper's Algorithm 1, or "alternating", the
            one before it.
        knot_steps: numbers of knots by which contacts of finalists are moved, in turn.
    """

    ladder: tuple[Rung, ...] = field(default=LITERAL_LADDER, repr=False)
    nonpenetration: bool = True
    algorithm: AlgorithmName = "annealing"
    knot_steps: tuple[int, ...] = (16, 8, 4, 2, 1)

    def __post_init__(self) -> None:
        """Checks the choices."""
        super().__post_init__()
        self._check_choice("algorithm", get_args(AlgorithmName))
        if not self.ladder:
            raise OptionsError("ladder", got="no rung", expected="at least one")
