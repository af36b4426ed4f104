"""The answer: a trajectory, its verdict, every candidate, and what it took. Immutable, JSON."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drake_aigto.errors import AigtoError, PlanFileError
from drake_aigto.planning.origin import Origin
from drake_aigto.simulation.contacts import PlannedContact
from drake_aigto.simulation.replay import Replay, confirms
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import Scenario
from drake_aigto.world.files import write_text

if TYPE_CHECKING:
    from collections.abc import Iterator

FORMAT = "drake_aigto plan"
FORMAT_VERSION = 4

# A candidate whose rows are off by more than this is no solution of the transcription [m, m/s].
LARGEST_DEFECT = 1e-6


@dataclass(frozen=True)
class Replays:
    """The plan's control, run in simulation from the start state.

    Attributes:
        event_driven: on an exactly rigid wall.
        drake: on the continuous plant with its compliant contact; None if it was not asked for.
    """

    event_driven: Replay
    drake: Replay | None

    def __iter__(self) -> Iterator[Replay]:
        """Yields those that were run."""
        yield self.event_driven
        if self.drake is not None:
            yield self.drake


@dataclass(frozen=True)
class Candidate:
    """One start, solved locally and replayed on the rigid wall.

    Attributes:
        origin: which algorithm and rung of the ladder it came from, and by which changes.
        start_cost: J of what the local solver started from: AIGO's result, or a baseline's guess.
        start_defects: its largest violation of each kind of row, in that row's unit.
        trajectory: after the polish.
        cost: J of it.
        goal_error: ‖q_N − goal‖ that it promises [m].
        defects: its largest violation of each kind of row (m, m/s).
        max_penetration: the deepest −φ ≥ 0 at its knots [m].
        contacts: its contact sequence, read off its impulses.
        replay: the control alone, on the exactly rigid wall.
    """

    origin: Origin
    start_cost: float
    start_defects: Mapping[str, float]
    trajectory: Trajectory
    cost: float
    goal_error: float
    defects: Mapping[str, float]
    max_penetration: float
    contacts: tuple[PlannedContact, ...]
    replay: Replay

    @property
    def max_defect(self) -> float:
        """The largest of all defects."""
        return max(self.defects.values())

    @property
    def is_feasible(self) -> bool:
        """Whether it meets the transcription's rows."""
        return self.max_defect <= LARGEST_DEFECT

    @property
    def is_confirmed(self) -> bool:
        """Whether the event-driven replay confirms it."""
        return confirms(self.cost, self.replay, self.goal_error)

    @property
    def energy_ratio(self) -> float | None:
        """Kinetic energy after / before contact, multiplied over all; None without contact."""
        ratios = [contact.energy_ratio for contact in self.contacts]
        return math.prod(ratios) if ratios else None

    def describe_contacts(self) -> str:
        """Returns its contact sequence in words."""
        times = ", ".join(f"{contact.time:.3f} s" for contact in self.contacts)
        return f"contact at {times}" if times else "free flight"

    def holds(self, replays: Replays) -> bool:
        """Returns whether all replays of this candidate's control confirm it."""
        return all(confirms(self.cost, replay, self.goal_error) for replay in replays)

    def to_dict(self) -> dict[str, Any]:
        """Returns the fields as plain JSON values."""
        return {
            "origin": asdict(self.origin),
            "start_cost": self.start_cost,
            "start_defects": dict(self.start_defects),
            "trajectory": self.trajectory.to_dict(),
            "cost": self.cost,
            "goal_error": self.goal_error,
            "defects": dict(self.defects),
            "max_penetration": self.max_penetration,
            "contacts": [asdict(contact) for contact in self.contacts],
            "replay": self.replay.to_dict(),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Candidate:
        """Returns the candidate that `to_dict` gave."""
        parts = {
            "origin": Origin.from_dict(data["origin"]),
            "trajectory": Trajectory.from_dict(data["trajectory"]),
            "contacts": tuple(PlannedContact(**contact) for contact in data["contacts"]),
            "replay": Replay.from_dict(data["replay"]),
        }
        return cls(**{**data, **parts})


@dataclass(frozen=True)
class PlanStats:
    """What the plan took.

    Attributes:
        aigo_steps: inner iterations of AIGO, all candidates.
        polished: how many candidates the polish made feasible.
        seconds: wall time by part of the road.
        box_contacts: how many contacts the last box of each rung of the ladder shows, before any
            polish; None for a rung that was left out.
        flight_left_out: what a free flight costs at least, if it was left out for that.
    """

    aigo_steps: int
    polished: int
    seconds: Mapping[str, float]
    box_contacts: tuple[int | None, ...] = ()
    flight_left_out: float | None = None

    def __post_init__(self) -> None:
        """Converts lists to tuples."""
        object.__setattr__(self, "box_contacts", tuple(self.box_contacts))


@dataclass(frozen=True)
class Plan:
    """A plan for a scenario, and the verdict on it.

    Attributes:
        scenario: the question.
        transcription: its name.
        candidates: all of them, the best first.
        replay: simulations of the best one's control.
        stats: iterations and seconds.
    """

    scenario: Scenario
    transcription: str
    candidates: tuple[Candidate, ...]
    replay: Replays
    stats: PlanStats

    @property
    def best(self) -> Candidate:
        """The candidate that was chosen."""
        return self.candidates[0]

    @property
    def cost(self) -> float:
        """J = w_u Σ dt ‖u_k‖² + w_f ‖q_N − goal‖² of the chosen trajectory."""
        return self.best.cost

    @property
    def trajectory(self) -> Trajectory:
        """The chosen trajectory."""
        return self.best.trajectory

    @property
    def defects(self) -> Mapping[str, float]:
        """Its largest violation of each kind of row (m, m/s)."""
        return self.best.defects

    @property
    def holds(self) -> bool:
        """Whether every replay that was run confirms the chosen trajectory (`replay.confirms`)."""
        return self.best.holds(self.replay)

    def to_dict(self) -> dict[str, Any]:
        """Returns the plan as plain JSON values."""
        drake = self.replay.drake
        return {
            "format": FORMAT,
            "version": FORMAT_VERSION,
            "scenario": self.scenario.to_dict(),
            "transcription": self.transcription,
            "candidates": [candidate.to_dict() for candidate in self.candidates],
            "replay": {
                "event_driven": self.replay.event_driven.to_dict(),
                "drake": None if drake is None else drake.to_dict(),
            },
            "stats": {**asdict(self.stats), "seconds": dict(self.stats.seconds)},
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Plan:
        """Returns the plan that `to_dict` gave."""
        drake = data["replay"]["drake"]
        if not data["candidates"]:
            raise PlanFileError("candidates", got="none", expected="at least one")
        return cls(
            scenario=Scenario.from_dict(data["scenario"]),
            transcription=data["transcription"],
            candidates=tuple(Candidate.from_dict(item) for item in data["candidates"]),
            replay=Replays(
                Replay.from_dict(data["replay"]["event_driven"]),
                None if drake is None else Replay.from_dict(drake),
            ),
            stats=PlanStats(**data["stats"]),
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a JSON file that `load` reads back to the same numbers, whole or not at all.

        Raises:
            OutputFileError: the file can't be written.
        """
        write_text(path, json.dumps(self.to_dict()) + "\n")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Plan:
        """Reads a plan file.

        Raises:
            PlanFileError: no such file, cut short, not a plan, or of another version.
        """
        data = _read_json(path)
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            raise PlanFileError(
                f"{path} is not a plan file",
                got=f"format {data.get('format')!r}" if isinstance(data, dict) else "no mapping",
                expected=f"format {FORMAT!r}",
                remedy="Write one with `drake-aigto plan SCENARIO --json FILE`.",
            )
        if data.get("version") != FORMAT_VERSION:
            raise PlanFileError(
                f"plan file {path}",
                got=f"version {data.get('version')!r}",
                expected=f"version {FORMAT_VERSION}",
                remedy="Plan again with this version of drake_aigto.",
            )
        try:
            return cls.from_dict(data)
        except (KeyError, TypeError, IndexError, AttributeError, AigtoError) as error:
            raise PlanFileError(
                f"plan file {path} is damaged",
                got=f"{type(error).__name__}: {error}",
                remedy="Plan again.",
            ) from error


def _read_json(path: str | os.PathLike[str]) -> Any:
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise PlanFileError(f"plan file {path} can't be read", got=error) from error
    except json.JSONDecodeError as error:
        raise PlanFileError(
            f"plan file {path} is cut short or no JSON", got=error, remedy="Plan again."
        ) from error
