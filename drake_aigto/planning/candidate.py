"""One start of a search: solved locally, replayed, and judged against its replays."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property

from drake_aigto.planning.origin import NO_CONTROL, Origin
from drake_aigto.simulation import (
    PlannedContact,
    Replay,
    confirms,
    replay_drake,
    replay_event_driven,
)
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription.rows import largest_defect
from drake_aigto.world import Scales, Scenario, World

# A candidate whose rows are off by more than this part of the task's scales is no solution.
LARGEST_DEFECT = 1e-6
# Touches that are no farther apart than this part of the duration are one.
_SAME_TIME = 1e-3

# When [s], and which of the world's contacts.
TimedContact = tuple[float, int]


@dataclass(frozen=True)
class Replays:
    """The plan's control, run in simulation from the start state.

    Attributes:
        event_driven: on an exactly rigid wall.
        drake: on the continuous plant with its compliant contact; None if it was not asked for.
    """

    event_driven: Replay
    drake: Replay | None

    @classmethod
    def of(
        cls, world: World, scenario: Scenario, trajectory: Trajectory, confirm: bool = True
    ) -> Replays:
        """Returns what a trajectory's control alone does: event-driven, and in Drake to confirm."""
        control = trajectory.times, trajectory.controls
        drake = replay_drake(world, scenario, *control) if confirm else None
        return cls(replay_event_driven(world, scenario, *control), drake)

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
        cost: J of it, with what users added (`Planner.transcription`).
        goal_error: ‖q_N − goal‖ that it promises (`TaskCost.goal_error`) [m, rad].
        defects: its largest violation of each kind of row (m, m/s), and of each constraint that
            users added, in parts of the task's scales.
        max_penetration: the deepest −φ ≥ 0 at its knots [m].
        contacts: its contact sequence, read off its impulses.
        replay: the control alone, on the exactly rigid wall.
        scales: of the task, which its verdict is relative to.
        added_costs: what of the cost users added, by name.
        drake: its control on Drake's plant, if that was to be the plan's, and another's is.
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
    scales: Scales
    added_costs: Mapping[str, float] = field(default_factory=dict)
    drake: Replay | None = None

    @property
    def is_idle(self) -> bool:
        """Whether it is doing nothing: what the world does without control."""
        return self.origin.proposer == NO_CONTROL

    @property
    def max_defect(self) -> float:
        """The largest of all defects, whatever its unit."""
        return max(self.defects.values())

    @cached_property
    def is_feasible(self) -> bool:
        """Whether it meets the transcription's rows."""
        return largest_defect(self.defects, self.scales) <= LARGEST_DEFECT

    @cached_property
    def is_confirmed(self) -> bool:
        """Whether the event-driven replay confirms it."""
        return self.is_confirmed_by(self.replay)

    def is_confirmed_by(self, replay: Replay) -> bool:
        """Returns whether a replay of its control confirms it (`replay.confirms`).

        A replay that was run from a file knows no costs that users added: it is compared without.
        """
        is_known = replay.added_costs.keys() == self.added_costs.keys()
        cost = self.cost if is_known else self.cost - sum(self.added_costs.values())
        return confirms(cost, replay, self.scales, self.goal_error)

    @property
    def energy_ratio(self) -> float | None:
        """Kinetic energy after / before contact, multiplied over all; None without contact."""
        ratios = [contact.energy_ratio for contact in self.contacts]
        return math.prod(ratios) if ratios else None

    @property
    def unplanned(self) -> tuple[TimedContact, ...]:
        """The contacts that its control has on the rigid wall, and its trajectory has not.

        Where a path grazes a wall between knots it may touch, and keep its promise nonetheless.
        """
        near = _SAME_TIME * self.scales.time
        seen = zip(self.replay.bounce_times, self.replay.bounce_contacts, strict=True)
        return tuple(
            (time, i)
            for time, i in seen
            if not any(
                each.index == i and each.time - near <= time <= each.last_time + near
                for each in self.contacts
            )
        )

    def describe_contacts(self) -> str:
        """Returns its contact sequence in words."""
        times = ", ".join(f"{contact.time:.3f} s" for contact in self.contacts)
        return f"contact at {times}" if times else "free flight"

    def holds(self, replays: Replays) -> bool:
        """Returns whether all replays of this candidate's control confirm it."""
        return all(map(self.is_confirmed_by, replays))


@dataclass(frozen=True)
class Veto:
    """A candidate that promises less than the plan costs, but is contradicted by a simulation.

    Attributes:
        candidate: what was to be the plan.
        replay: of its control, which does not do what it promises.
    """

    candidate: Candidate
    replay: Replay

    @property
    def first_difference(self) -> tuple[TimedContact | None, TimedContact | None]:
        """The first contact that was planned and was not simulated at that time, and the other way.

        Each is its time [s] and which of the world's contacts; None where there is none any more.
        """
        near = _SAME_TIME * self.candidate.scales.time
        planned = [(each.time, each.index) for each in self.candidate.contacts]
        seen = zip(self.replay.bounce_times, self.replay.bounce_contacts, strict=True)
        for one, other in itertools.zip_longest(planned, seen):
            if one is None or other is None or one[1] != other[1] or abs(one[0] - other[0]) > near:
                return one, other
        return None, None
