"""How to plan: numerics only. Physics and task are the Scenario's."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pkgutil import resolve_name
from typing import ClassVar, Literal, get_args

from drake_aigto.errors import OptionsError, check_counts
from drake_aigto.transcription import NONPENETRATION
from drake_aigto.transcription.rows import CONTACT, DYNAMICS, FLIGHT, RESTITUTION

LocalSolverName = Literal["newton", "ipopt", "snopt"]
StartName = Literal["line", "coast"]

# Transcription → its options, by name, as the paper's are further down the road than this.
_KINDS = {
    "rigid": "drake_aigto.planning.options:PlanOptions",
    "literal": "drake_aigto.paper.options:LiteralOptions",
    "shooting": "drake_aigto.planning.mechanism_options:MechanismOptions",
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


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """Numerics of any search for a plan.

    Attributes:
        finalists: how many of the best candidates are improved.
        threads: how many starts are run at once, in threads of this process: plans are the same to
            the last bit. None: as many as it has cores where that pays, else one.
        confirm: whether the plan is also replayed on Drake's plant; the independent replay is
            always run.
    """

    finalists: int = 2
    threads: int | None = None
    confirm: bool = True

    transcription: ClassVar[str]

    def __post_init__(self) -> None:
        """Checks what does not depend on the problem."""
        check_counts(self, finalists=1)
        if self.threads is not None and self.threads < 1:
            raise OptionsError("threads", got=self.threads, expected="1 or more, or None")

    @property
    def num_threads(self) -> int:
        """The threads that were asked for, or one a core."""
        if self.threads is not None:
            return self.threads
        if hasattr(os, "sched_getaffinity"):  # Not on macOS.
            return len(os.sched_getaffinity(0))
        return os.cpu_count() or 1

    @staticmethod
    def kind_of(transcription: str) -> type[SearchOptions]:
        """Returns the options that a transcription has, by its name in files.

        Raises:
            OptionsError: there is no such transcription.
        """
        if transcription not in _KINDS:
            known = ", ".join(_KINDS)
            raise OptionsError("transcription", got=repr(transcription), expected=f"one of {known}")
        kind: type[SearchOptions] = resolve_name(_KINDS[transcription])
        return kind

    def _check_choice(self, name: str, known: tuple[str, ...]) -> None:
        if (got := getattr(self, name)) not in known:
            raise OptionsError(name, got=repr(got), expected=f"one of {', '.join(known)}")


@dataclass(frozen=True, kw_only=True)
class LadderOptions(SearchOptions):
    """Numerics of a search that polishes the contact sequences of a ladder of boxes.

    Attributes:
        ladder: the starts of AIGO; candidates come out of each.
        local_solver: polishes AIGO's results: "newton" (`local.InteriorPoint`), or "ipopt" or
            "snopt" through Drake.
        finalists: see `SearchOptions`, as threads and confirm. Threads pay where boxes are of a
            thousand variables or more; for less, starting them takes longer than it saves.
    """

    ladder: tuple[Rung, ...] = field(repr=False)
    local_solver: LocalSolverName = "newton"

    def __post_init__(self) -> None:
        """Checks what does not depend on the problem."""
        self._check_choice("local_solver", get_args(LocalSolverName))
        super().__post_init__()
        if not self.ladder:
            raise OptionsError("ladder", got="no rung", expected="at least one")


@dataclass(frozen=True, kw_only=True)
class PlanOptions(LadderOptions):
    """Numerics of a plan that holds on rigid walls.

    Attributes:
        ladder: see `LadderOptions`, as local_solver, finalists, threads and confirm.
        relaxation: ε of the complementarity φ p = dt ε, which the wall pushes from afar with while
            boxes shrink (`RigidTranscription`).
        aigo_steps: how many time steps boxes have: coarse ones show the contact sequence, and the
            last polish, of finalists, has the scenario's. Candidates are judged with as many or
            more; only the plan itself has the scenario's where these are fewer, or one a phase.
        exhaustive: whether rungs are run, too, that can hardly tell anything new
            (`RigidSearch.rungs`), and flights polished that cost too much (`RigidSearch.add`).
        branches: of how many candidates neighbors are tried, with a bounce more or less.
        certify: whether a lower bound of all plans is found, too (`Plan.lower_bound`).
    """

    ladder: tuple[Rung, ...] = field(default=RIGID_LADDER, repr=False)
    relaxation: float = 1e-4
    aigo_steps: int = 50
    exhaustive: bool = False
    branches: int = 3
    certify: bool = False

    transcription: ClassVar[str] = "rigid"

    def __post_init__(self) -> None:
        """Checks the numbers."""
        super().__post_init__()
        check_counts(self, aigo_steps=1, branches=0)
        if not 0 <= self.relaxation < float("inf"):
            raise OptionsError("relaxation", got=self.relaxation, expected="a number, 0 or more")
