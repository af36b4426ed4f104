"""How to plan: numerics only. Physics and task are the Scenario's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from drake_aigto.aigo import Algorithm, Annealing, FullGradient
from drake_aigto.errors import OptionsError
from drake_aigto.transcription.literal import DYNAMICS, KINEMATICS, NONPENETRATION

AlgorithmName = Literal["annealing", "full gradient"]
LocalSolverName = Literal["newton", "ipopt", "snopt"]
TranscriptionName = Literal["literal"]

# Option → what it may be.
CHOICES: dict[str, tuple[str, ...]] = {
    "transcription": ("literal",),
    "algorithm": ("annealing", "full gradient"),
    "local_solver": ("newton", "ipopt", "snopt"),
}


@dataclass(frozen=True)
class Rung:
    """One start of AIGO: how hot, and how much each kind of row weighs while boxes shrink.

    Attributes:
        temperature: first temperature μ of the annealing (not used by the full gradient).
        weights: constraint name → weight of its penalty r²/dt.
    """

    temperature: float
    weights: Mapping[str, float]

    def __str__(self) -> str:
        """Returns the weights, as tables and plan files show them."""
        return ", ".join(f"{name} {weight:g}" for name, weight in self.weights.items())


def _rung(temperature: float, kinematics: float, dynamics: float) -> Rung:
    weights = {KINEMATICS: kinematics, DYNAMICS: dynamics, NONPENETRATION: 5e-4}
    return Rung(temperature, weights)


# Light dynamics rows keep the paper's contact alive while boxes are wide: a heavy (φ + δ)² (…)² is
# least at φ ≈ 0 with no impulse, the collapse of AIGTO Fig. 1. Light kinematics rows let the mass
# jump to the wall at once. The first rung alone finds the bounce of all of Table I by annealing; a
# heavy and cold one ends in free flight; Algorithm 1 needs the lightest.
LITERAL_LADDER = (
    _rung(1e-4, 1e3, 1e-2),
    _rung(1e-5, 1e2, 1e0),
    _rung(1e-4, 1e3, 1e-3),
    _rung(1e-5, 1e2, 1e-4),
    _rung(1e-4, 1e1, 1e-4),
)


@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """Numerics of a plan.

    Attributes:
        transcription: "literal", the paper's explicit Euler with λ = ε/(φ + δ).
        nonpenetration: whether the literal transcription asks for φ(q_k) ≥ 0. The paper's figures
            need it off.
        algorithm: "annealing", or "full gradient" for the paper's Algorithm 1.
        ladder: the starts; a candidate plan comes out of each.
        local_solver: polishes AIGO's results: "newton" (`local.InteriorPoint`), or "ipopt" or
            "snopt" through Drake.
        knot_steps: by how many knots the best candidate's contacts are moved to and fro, in turn.
        confirm: whether the plan is also replayed on Drake's plant; the event-driven replay is
            always run.
    """

    transcription: TranscriptionName = "literal"
    nonpenetration: bool = True
    algorithm: AlgorithmName = "annealing"
    ladder: tuple[Rung, ...] = field(default=LITERAL_LADDER, repr=False)
    local_solver: LocalSolverName = "newton"
    knot_steps: tuple[int, ...] = (16, 8, 4, 2, 1)
    confirm: bool = True

    def __post_init__(self) -> None:
        """Checks the choices."""
        for name, known in CHOICES.items():
            if (got := getattr(self, name)) not in known:
                raise OptionsError(name, got=repr(got), expected=f"one of {', '.join(known)}")
        if not self.ladder:
            raise OptionsError("ladder", got="no rung", expected="at least one")

    def describe(self, rung: Rung) -> str:
        """Returns how tables and plan files name a start of AIGO."""
        if self.algorithm == "annealing":
            return f"annealing from temperature {rung.temperature:g}; weights {rung}"
        return f"full gradient; weights {rung}"

    def make_algorithm(self, rung: Rung) -> Algorithm:
        """Returns AIGO's algorithm for a rung."""
        if self.algorithm == "annealing":
            return Annealing(initial_temperature=rung.temperature)
        return FullGradient()
