"""Candidates: their origins, promised costs, and replays, which may be trajectories themselves."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
import scipy  # Not scipy.optimize, which takes a tenth of a second and few need.

from drake_aigto.arrays import Bools, Floats
from drake_aigto.planning.options import Rung
from drake_aigto.planning.riccati import FeedbackPhase
from drake_aigto.progress import list_some
from drake_aigto.simulation import Growth, PlannedContact, Replay, confirms, max_penetration
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import (
    DYNAMICS,
    FLIGHT,
    NONPENETRATION,
    Additions,
    Samples,
    TouchSequence,
    largest_defect,
)
from drake_aigto.world import Scales, World

ChangeName = Literal["seen", "dropped", "added", "swapped", "moved", "passed", "mode", "left out"]

_WORDS: dict[ChangeName, str] = {
    "seen": "with a bounce seen in its replay",
    "dropped": "a touch dropped",
    "added": "a touch added",
    "swapped": "touches swapped",
    "moved": "contacts moved",
    "passed": "a block passed on its other side",
    "mode": "a touch in another mode",
    "left out": "left out at first",
}

# The proposers of the uncontrolled motion, of its contacts, and of a user's motion.
NO_CONTROL, COASTING = "no control", "contacts of the motion without control"
GIVEN, SHOT = "the given guess", "contacts of a shot"
# A candidate whose rows are off by more than this part of the task's scales is no solution.
LARGEST_DEFECT = 1e-6
# Changes of velocity below this part of the largest velocity are rounding.
_ROUNDING = 1e-9
# Touches closer than this part of the duration count as the same.
_SAME_TIME = 1e-3
# Touches that are as near count as in one place, in lengths of the task.
_NEAR = 1e-4

# Time [s] and index of the world's contact.
TimedContact = tuple[float, int]


@dataclass(frozen=True)
class Change:
    """One step from a candidate to one near it."""

    # "seen", a bounce added that the replay has and the plan lacks; "dropped" or "added", one touch
    # fewer or more; "swapped", simultaneous bounces in the other order; "moved", contacts at other
    # knots; "passed", a block on its other side; "mode", a touch with friction that sticks or slips
    # instead; "left out", a flight that was not expected to win, tried as no other plan holds.
    kind: ChangeName
    of: TouchSequence  # the contact sequence that was changed


@dataclass(frozen=True)
class Origin:
    """Where a candidate came from.

    Attributes:
        proposer: AIGO's algorithm, as the options name it, or another guess: "zero", "random",
            "no control" (the uncontrolled motion), that motion's contacts, or "the given guess".
        rung: the start of AIGO; None for another guess.
        changes: of the contact sequence that was proposed, in order.
        renewals: how many times a stretch of the motion was opened to boxes again.
    """

    proposer: str
    rung: Rung | None = None
    changes: tuple[Change, ...] = ()
    renewals: int = 0

    def changed(self, kind: ChangeName, of: TouchSequence) -> Origin:
        """Returns the origin of a candidate with a changed contact sequence."""
        return dataclasses.replace(self, changes=(*self.changes, Change(kind, of)))

    def renewed(self) -> Origin:
        """Returns the origin of a motion after a stretch was opened to boxes again."""
        return dataclasses.replace(self, renewals=self.renewals + 1)

    def __str__(self) -> str:
        """Returns it in words; repeated changes are named once."""
        first = self.rung.describe(self.proposer) if self.rung else self.proposer
        changes = dict.fromkeys(_WORDS[each.kind] for each in self.changes)
        renewed = [f"renewed {self.renewals} times"] if self.renewals else []
        return "; ".join([first, *changes, *renewed])


@dataclass(frozen=True)
class Replays:
    """The plan's control, run in simulation from the start state.

    Attributes:
        event_driven: with exactly rigid walls.
        drake: on the continuous plant with its compliant contact; None if not requested.
        alone: of the control alone, where the others are with the plan's feedback; they judge
            nothing, and one that runs away is missing.
        perturbed: with feedback, from starts that are off.
    """

    event_driven: Replay
    drake: Replay | None
    alone: tuple[Replay, ...] = ()
    perturbed: tuple[Replay, ...] = ()

    def __iter__(self) -> Iterator[Replay]:
        """Yields the replays that were run from the start, and that judge."""
        yield self.event_driven
        if self.drake is not None:
            yield self.drake

    @property
    def judging(self) -> tuple[Replay, ...]:
        """All that judge: those from the start, then those from starts that are off."""
        return (*self, *self.perturbed)


@dataclass(frozen=True)
class Candidate:
    """One start, solved locally and replayed on the rigid wall.

    Attributes:
        origin: which algorithm and rung of the ladder it came from, and by which changes.
        start_cost: J of the local solver's guess: AIGO's result, or a baseline's; None: of neither.
        start_defects: its largest violation of each kind of row, in that row's unit.
        trajectory: after the polish.
        cost: its J, with costs of users (`Planner.transcription`).
        goal_error: ‖q_N − goal‖ that it promises (`TaskCost.goal_error`) [m, rad].
        defects: its largest violation of each kind of row (m, m/s), and of each constraint of
            users, relative to the task's scales.
        max_penetration: the deepest −φ ≥ 0 at its knots [m].
        contacts: its contact sequence, read off its impulses.
        replay: the control alone, on the exactly rigid wall.
        scales: of the task, which its verdict is relative to.
        added_costs: costs of users, by name.
        drake: its replay in Drake, if it was to be the plan, and another candidate is.
        cost_error: estimate of the error of its cost, by steps of half the length; None: not known.
        growth: of errors along it; None: not known, as its feedback is not.
        gains: its feedback, if that judges it, as errors grow too much; its replays are with that.
        alone: then, the control alone; None also if that runs away.
        perturbed: then, from starts that are off by 1e-3 of the scales.
    """

    origin: Origin
    start_cost: float | None
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
    cost_error: float | None = None
    growth: Growth | None = None
    gains: tuple[FeedbackPhase, ...] = ()
    alone: Replay | None = None
    perturbed: tuple[Replay, ...] = ()

    @property
    def own_replays(self) -> Replays:
        """Its replays without Drake's."""
        alone = () if self.alone is None else (self.alone,)
        return Replays(self.replay, None, alone, self.perturbed)

    @property
    def is_idle(self) -> bool:
        """Whether it is the uncontrolled motion."""
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
        """Whether the event-driven replay confirms it, and those from starts that are off."""
        return self.holds(self.own_replays)

    def is_confirmed_by(self, replay: Replay) -> bool:
        """Returns whether a replay of its control agrees with it, or has touches off their places.

        Then, in Drake, something else moves, and what becomes of that says nothing.
        """
        return self.agrees_with(replay) or replay.touch_error > _NEAR * self.scales.length

    def agrees_with(self, replay: Replay) -> bool:
        """Returns whether a replay of its control is as promised (`replay.confirms`).

        A replay from a file has no costs of users: it is compared without them.
        """
        is_known = replay.added_costs.keys() == self.added_costs.keys()
        cost = self.cost if is_known else self.cost - sum(self.added_costs.values())
        return confirms(cost, replay, self.scales, self.goal_error)

    @property
    def energy_ratio(self) -> float | None:
        """Kinetic energy after / before contact, multiplied over all that do not begin at rest.

        None if there is no such contact.
        """
        ratios = [c.energy_ratio for c in self.contacts if c.energy_ratio is not None]
        return math.prod(ratios) if ratios else None

    @property
    def unplanned(self) -> tuple[TimedContact, ...]:
        """Contacts of its replay on rigid walls that its trajectory does not have.

        A path that grazes a wall between knots may touch it, and keep its promise nonetheless.
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

    def describe_growth(self) -> str:
        """Returns in words by how much errors grow along it."""
        return f"errors grow {self.growth.factor:.1e} times" if self.growth else "growth not known"

    def describe_contacts(self) -> str:
        """Returns its contact sequence in words, the first few of many."""
        times = list_some(f"{contact.time:.3f} s" for contact in self.contacts)
        return f"contact at {times}" if times else "free flight"

    def describe_verdict(self) -> str:
        """Returns its contacts, its costs, promised and replayed, and what speaks against it."""
        told = [f"{self.describe_contacts()} for {self.cost:.2e}"]
        told.append(f"replayed {self.replay.cost:.2e}")
        if not self.is_feasible:
            told.append(f"largest defect {self.max_defect:.1e}")
        if self.is_confirmed_by(self.replay) and not self.is_confirmed:
            off = max(each.cost for each in self.perturbed)
            told.append(f"{off:.2e} from a start 1e-3 of the scales off")
        replays = self.own_replays.judging
        broken = dict.fromkeys(name for replay in replays for name in replay.broken)
        return ", ".join(told) + f"; there it breaks {', '.join(map(repr, broken))}" * bool(broken)

    def holds(self, replays: Replays) -> bool:
        """Returns whether all replays of this candidate's control confirm it."""
        return all(map(self.is_confirmed_by, replays.judging))


@dataclass(frozen=True)
class Veto:
    """A candidate that promises less than the plan costs, but is contradicted by a simulation.

    Attributes:
        candidate: the rejected one.
        replay: of its control, which contradicts its promise.
    """

    candidate: Candidate
    replay: Replay

    @property
    def first_difference(self) -> tuple[TimedContact | None, TimedContact | None]:
        """The first planned contact that was not simulated at that time, and vice versa.

        Each is its time [s] and the world's contact; None where there is no further one.
        """
        near = _SAME_TIME * self.candidate.scales.time
        planned = [(each.time, each.index) for each in self.candidate.contacts]
        seen = zip(self.replay.bounce_times, self.replay.bounce_contacts, strict=True)
        for one, other in itertools.zip_longest(planned, seen):
            if one is None or other is None or one[1] != other[1] or abs(one[0] - other[0]) > near:
                return one, other
        return None, None


def sample(trajectory: Trajectory) -> Samples:
    """Returns a trajectory at its knots."""
    t = trajectory
    return Samples(t.times, t.positions, t.velocities, t.controls)


def add_to_replay(replay: Replay, additions: Additions, trajectory: Trajectory) -> Replay:
    """Returns a replay of a trajectory's control with the costs and constraints of users.

    They are those of the simulated motion at the trajectory's knots. Violations of constraints
    count beyond the lengths that compliance explains.
    """
    if not additions:
        return replay
    q, v = replay.states_at(trajectory.times)
    motion = Samples(trajectory.times, q, v, trajectory.controls)
    explained = replay.compliance_error / additions.scales["q"]
    missed, added = additions.violations(motion).items(), additions.costs(motion)
    users = {name: max(0.0, by - explained) for name, by in missed}
    return dataclasses.replace(
        replay,
        cost=replay.cost + sum(added.values()),
        added_costs=added,
        violations={**replay.violations, **users},
    )


def read_motion(
    world: World, replay: Replay, knots: Floats, controls: Floats, length: float
) -> Trajectory:
    """Returns a simulated motion between rigid walls, with a knot at each impact.

    Controls (N, nu) were held between knots (N+1,); a millionth of the length [m] counts as
    touching.
    """
    first = np.flatnonzero(np.diff(replay.times, prepend=-1.0))
    last = np.append(first[1:], len(replay.times)) - 1
    t, q, v = replay.times[first], replay.positions[first], replay.velocities[first]
    jumps = replay.velocities[last] - v
    m = world.num_contacts
    impulses, forces = np.zeros((len(t), m)), np.zeros((len(t) - 1, m))
    struck = np.zeros((len(t), m), dtype=bool)
    struck[np.searchsorted(t, replay.bounce_times), np.array(replay.bounce_contacts, int)] = True
    for k in np.flatnonzero(np.any(struck, axis=1)):
        impulses[k, struck[k]] = _solve_pushes(world, q[k], struck[k], jumps[k])
    held = controls[np.searchsorted(knots, (t[:-1] + t[1:]) / 2) - 1]
    flying = Trajectory(t, q, v, held, impulses, forces)
    touching = np.abs(world.calc_signed_distance(q)) < LARGEST_DEFECT * length
    resting = touching[:-1] & touching[1:]
    if not np.any(resting):
        return flying
    left = _calc_unexplained(world, flying)
    is_pushed = np.max(np.abs(left), axis=1) > _ROUNDING * np.max(np.abs(v), initial=0.0)
    for k in np.flatnonzero(is_pushed & np.any(resting, axis=1)):
        pushes = _solve_pushes(world, q[k], resting[k], left[k])
        forces[k, resting[k]] = pushes / (t[k + 1] - t[k])
    return Trajectory(t, q, v, held, impulses, forces)


def _solve_pushes(world: World, q: Floats, pushing: Bools, change: Floats) -> Floats:
    """Returns the impulses ≥ 0 of contacts that cause a change of velocity [N s]."""
    units = np.eye(world.num_contacts)[pushing]
    kicks = world.calc_velocity_change(np.broadcast_to(q, (len(units), q.size)), units)
    return np.asarray(scipy.optimize.nnls(kicks.T, change)[0])


def _after(world: World, motion: Trajectory) -> Floats:
    """Returns the velocities after the impulses at knots, shape (N+1, nv) [m/s]."""
    kicks = world.calc_velocity_change(motion.positions, motion.impulses)
    return np.asarray(motion.velocities + kicks)


def _calc_unexplained(world: World, motion: Trajectory) -> Floats:
    """Returns changes of velocity without those by impulses and forces, (N, nv) [m/s].

    These follow the midpoint rule, like the rows "dynamics".
    """
    q, v, h = motion.positions, _after(world, motion)[:-1], np.diff(motion.times)[:, np.newaxis]
    middle, mean = (q[:-1] + q[1:]) / 2, (v + motion.velocities[1:]) / 2
    free = world.calc_acceleration(middle, mean, motion.controls)
    pushed = world.calc_velocity_change(middle, h * motion.forces)
    return np.asarray(motion.velocities[1:] - v - h * free - pushed)


def calc_defects(world: World, motion: Trajectory) -> dict[str, float]:
    """Returns the largest violation of the rows that any motion has to meet.

    In the interval in which it comes to rest, it hops more often than there are knots.
    """
    q, h = motion.positions, np.diff(motion.times)[:, np.newaxis]
    mean = (_after(world, motion)[:-1] + motion.velocities[1:]) / 2
    flies = ~np.any(motion.forces, axis=1, keepdims=True)
    return {
        FLIGHT: float(np.max(np.abs(flies * (np.diff(q, axis=0) - h * mean)))),
        DYNAMICS: float(np.max(np.abs(_calc_unexplained(world, motion)))),
        NONPENETRATION: max_penetration(world, motion),
    }
