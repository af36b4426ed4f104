"""How to plan for mechanisms, numerics only; and which tasks are planned for in that way."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

from drake_aigto.errors import OptionsError, check_counts
from drake_aigto.planning.mechanism_boxes import MechanismRung, MechanismStart
from drake_aigto.planning.options import SearchOptions
from drake_aigto.world import Scenario, World


def _rung(
    start: MechanismStart, weight: float, temperature: float, num_steps: int
) -> MechanismRung:
    return MechanismRung(start=start, weight=weight, temperature=temperature, num_steps=num_steps)


# No rung is right everywhere: boxes that hold the dynamics tightly keep to passive motions, loose
# ones jump to the goal. Both starts, decades of weights and of temperatures, fine and coarse.
MECHANISM_LADDER = (
    _rung("rest", 0.1, 0.1, 60),
    _rung("coast", 0.1, 1.0, 30),
    _rung("rest", 1.0, 0.1, 30),
    _rung("coast", 1.0, 10.0, 60),
    _rung("rest", 0.01, 10.0, 60),
    _rung("coast", 0.001, 10.0, 30),
    _rung("coast", 0.01, 10.0, 30),
    _rung("coast", 1.0, 1.0, 30),
    _rung("rest", 0.001, 10.0, 30),
    _rung("rest", 0.01, 1.0, 30),
    _rung("rest", 0.01, 0.1, 30),
)


@dataclass(frozen=True, kw_only=True)
class MechanismOptions(SearchOptions):
    """Numerics of a plan for a mechanism, or for soft walls.

    Attributes:
        finalists: how many of the best candidates are improved at most; between soft walls, fewer
            where the next ones promise no less than what was found, and between rigid ones not to
            the end where they cost more. Threads and confirm: see `SearchOptions`.
        ladder: the starts of AIGO; the center of each last box is closed by shooting. If no rung
            has a half width, renewals have none either: a search without boxes.
        renewals: how many times at most a stretch of a candidate is opened to boxes again, or boxes
            are drawn around another start.
        patience: renewals in a row that find nothing better, after which there are no more; twice
            as many where something turns fast at the start, or once a wall has thrown it off.
        search_steps: how many time steps candidates have at most; finalists have the scenario's.
        seed: of what is drawn.
        certify: whether it is said why there is no lower bound of plans, as there is between rigid
            walls (`Plan.bound`).
    """

    finalists: int = 2
    ladder: tuple[MechanismRung, ...] = field(default=MECHANISM_LADDER, repr=False)
    renewals: int = 240
    patience: int = 72
    search_steps: int = 60
    seed: int = 0
    certify: bool = False

    transcription: ClassVar[str] = "shooting"

    def __post_init__(self) -> None:
        """Checks the numbers."""
        super().__post_init__()
        check_counts(self, renewals=0, patience=1, search_steps=2, seed=0)
        if not self.ladder:
            raise OptionsError("ladder", got="no rung", expected="at least one")


def needs_shooting(world: World, scenario: Scenario) -> bool:
    """Returns whether a task is more than one of balls between rigid walls.

    Where something turns, M or J depends on q, something has limits or rubs, contact is compliant,
    or the task is not AIGTO's (`Scenario.is_plain`). Balls that nothing can touch stay theirs, for
    whoever asks for AIGTO's task has forgotten a wall.
    """
    is_free = world.has_constant_inertia and not (world.limits.are_any or world.is_hinge.any())
    rubs = scenario.contact == "rigid" and world.friction_coefficients(scenario).any()
    return not (is_free and not rubs and scenario.is_plain)
