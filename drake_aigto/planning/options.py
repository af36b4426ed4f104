"""How to plan: numerics only. Physics and task are the Scenario's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

from drake_aigto.aigo import Algorithm, Alternating, Annealing, EqualWidths, FullGradient
from drake_aigto.errors import OptionsError
from drake_aigto.transcription import NONPENETRATION
from drake_aigto.transcription.literal import DYNAMICS, KINEMATICS
from drake_aigto.transcription.rigid_contact import CONTACT, FLIGHT, RESTITUTION
from drake_aigto.transcription.with_forces import PUSH

AlgorithmName = Literal["annealing", "full gradient", "alternating", "equal widths", "no boxes"]
LocalSolverName = Literal["newton", "ipopt", "snopt"]
StartName = Literal["line", "coast"]
TranscriptionName = Literal["rigid", "literal"]

# Option → what it may be.
CHOICES: dict[str, tuple[str, ...]] = {
    "transcription": get_args(TranscriptionName),
    "algorithm": get_args(AlgorithmName),
    "local_solver": get_args(LocalSolverName),
}


@dataclass(frozen=True)
class Rung:
    """One start of AIGO: how hot, and how much each kind of row weighs while boxes shrink.

    Weights and temperature are in units of the transcription's `cost_scale`.

    Attributes:
        temperature: first temperature μ of the annealing; other algorithms have none.
        weights: constraint name → weight of its penalty r²/dt.
        others: weight of rows that have no name there, such as those that users add.
        start: what the first box is around: "line", the straight line from start to goal, as far
            as the walls; or "coast", the motion without control in simulation, narrow at first and
            wider with time.
    """

    temperature: float
    weights: Mapping[str, float]
    others: float = 1.0
    start: StartName = "line"

    def __post_init__(self) -> None:
        """Checks the start."""
        if self.start not in (known := get_args(StartName)):
            raise OptionsError("start", got=repr(self.start), expected=f"one of {known}")

    def describe(self, algorithm: str) -> str:
        """Returns an algorithm's start here, in words; only "annealing" has a temperature."""
        weights = ", ".join(f"{name} {weight:g}" for name, weight in self.weights.items())
        hot = f" from temperature {self.temperature:g}" if algorithm == "annealing" else ""
        return f"{algorithm}{hot}; around the {self.start}; weights {weights}"


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


def _rigid_rung(temperature: float, restitution: float, start: StartName = "line") -> Rung:
    weights = {FLIGHT: 3e2, DYNAMICS: 3e2, CONTACT: 3e2, RESTITUTION: restitution}
    return Rung(temperature, {**weights, NONPENETRATION: 3e3}, others=3e2, start=start)


# Hot boxes under a light restitution row find the wall, whether a bounce pays or not; cold ones
# under a heavy row, which no impulse pleases while boxes are wide, the free flight; the rung in
# between often tells which is better. What is best is only known after the polish. Between several
# walls, boxes around the straight line hold every sequence at once and lose all of them; those
# around the coasting motion keep its bounces, or one more or less near the end.
RIGID_LADDER = (
    _rigid_rung(3.0, 2.0),
    _rigid_rung(0.5, 5.0),
    _rigid_rung(0.03, 1000.0),
    _rigid_rung(0.1, 50.0, "coast"),
    _rigid_rung(1.0, 5.0, "coast"),
)

# How far a rigid anneal cools down. Which contacts a plan has, boxes show long before they are
# stationary: a loose tolerance at few temperatures reads as many sequences right as careful ones.
# Fewer Newton steps than that takes are too few around the straight line, where bounces get lost.
_COOLED = 5e-5

# Those that need no temperature.
_ALGORITHMS: dict[AlgorithmName, Algorithm] = {
    "full gradient": FullGradient(),
    "alternating": Alternating(),
    "equal widths": EqualWidths(),
    "no boxes": EqualWidths(first_share=0.0, final_share=0.0, max_newton_steps=200),
}

_LADDERS = {"rigid": RIGID_LADDER, "literal": LITERAL_LADDER}


@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """Numerics of a plan.

    Attributes:
        transcription: "rigid", impulses at knots and Newton restitution: what is planned holds on a
            rigid wall; or "literal", the paper's explicit Euler with λ = ε/(φ + δ).
        relaxation: ε of the rigid transcription's complementarity φ p = dt ε, which the wall pushes
            from afar with while boxes shrink (`RigidTranscription`).
        aigo_steps: how many time steps the boxes of the rigid transcription have: coarse ones show
            the contact sequence, and the last polish has the scenario's.
        nonpenetration: whether the literal transcription asks for φ(q_k) ≥ 0. The paper's figures
            need it off.
        algorithm: "annealing"; or, to compare with, "full gradient", the paper's Algorithm 1,
            "alternating", the one before it, "equal widths", whose boxes keep the shape of the
            first, and "no boxes", a local optimum of the penalised cost itself.
        ladder: the starts; candidates come out of each. None: the transcription's own.
        exhaustive: whether rungs are run, too, that can hardly tell anything new
            (`RigidSearch.rungs`), and flights polished that cost too much (`RigidSearch.add`).
        local_solver: polishes AIGO's results: "newton" (`local.InteriorPoint`), or "ipopt" or
            "snopt" through Drake.
        pull: rigid: whether contact sequences are read off box centers that a penalty continuation
            has pulled towards the rows.
        force_variables: whether contact impulses are decision variables too while boxes shrink
            (`RigidWithForces`, `LiteralWithForces`), which AIGTO Sec. III-B advises against.
        branches: rigid: of how many candidates neighbours are tried, with a bounce more or less.
        finalists: how many of the best candidates are improved: by a polish with the scenario's
            time step, where theirs is another (rigid), or by moving their contacts (literal).
        knot_steps: by how many knots a literal candidate's contacts are moved to and fro, in turn.
        threads: how many rungs are run at once, in threads of this process: plans are the same to
            the last bit. None: as many as it has cores where boxes are of a thousand variables or
            more, else one, as starting threads takes longer than it saves.
        confirm: whether the plan is also replayed on Drake's plant; the event-driven replay is
            always run.
    """

    transcription: TranscriptionName = "rigid"
    relaxation: float = 1e-4
    aigo_steps: int = 50
    nonpenetration: bool = True
    algorithm: AlgorithmName = "annealing"
    ladder: tuple[Rung, ...] | None = field(default=None, repr=False)
    exhaustive: bool = False
    local_solver: LocalSolverName = "newton"
    pull: bool = False
    force_variables: bool = False
    branches: int = 3
    finalists: int = 2
    knot_steps: tuple[int, ...] = (16, 8, 4, 2, 1)
    threads: int | None = None
    confirm: bool = True

    def __post_init__(self) -> None:
        """Checks the choices."""
        for name, known in CHOICES.items():
            if (got := getattr(self, name)) not in known:
                raise OptionsError(name, got=repr(got), expected=f"one of {', '.join(known)}")
        for name, least in {"aigo_steps": 1, "finalists": 1, "branches": 0}.items():
            if (count := getattr(self, name)) < least:
                raise OptionsError(name, got=count, expected=f"{least} or more")
        if not 0 <= self.relaxation < float("inf"):
            raise OptionsError("relaxation", got=self.relaxation, expected="a number, 0 or more")
        if self.threads is not None and self.threads < 1:
            raise OptionsError("threads", got=self.threads, expected="1 or more, or None")
        if not self.rungs:
            raise OptionsError("ladder", got="no rung", expected="at least one")
        names = [*_LADDERS[self.transcription][0].weights]
        names += [name for name in (CONTACT, PUSH) if self.force_variables and name not in names]
        for rung in self.rungs:
            for name in rung.weights:
                if name not in names:
                    raise OptionsError(
                        "ladder",
                        got=f"a weight for {name!r}",
                        expected=f"names of {self.transcription} rows: {', '.join(names)}",
                    )

    @property
    def rungs(self) -> tuple[Rung, ...]:
        """The ladder, or the transcription's own."""
        return _LADDERS[self.transcription] if self.ladder is None else self.ladder

    def make_algorithm(self, rung: Rung, unit: float = 1.0) -> Algorithm:
        """Returns AIGO's algorithm for a rung, whose temperature is in this unit."""
        if self.algorithm == "annealing":
            start = rung.temperature * unit
            if self.transcription == "literal":
                return Annealing(initial_temperature=start)
            return Annealing(
                initial_temperature=start,
                final_temperature=_COOLED * start,
                cooling=0.1,
                tolerance=0.1,
                narrowing=0.5,
            )
        return _ALGORITHMS[self.algorithm]
