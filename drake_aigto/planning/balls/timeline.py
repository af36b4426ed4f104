"""Knots of a contact sequence, and guesses for motions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import Bools, Floats, Ints, interpolate
from drake_aigto.contact import JointImpact
from drake_aigto.dynamics import ConstantInertia
from drake_aigto.errors import OptionsError
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Facing, Fronts, Touch, TouchSequence, joint_times
from drake_aigto.world import Scenario, World


@dataclass(frozen=True)
class Phase:
    """Steps first … last − 1, all of one length, during which some contacts rest."""

    first: int
    last: int
    rests: tuple[int, ...]


class Marks(NamedTuple):
    """Contacts at each of K knots, shape (K, m)."""

    starts: Bools  # which contacts are touched anew
    struck: Bools  # those, and the ones that were resting until then
    held: Bools  # φ = 0: struck, resting, or about to leave
    apart: Bools  # φ ≥ 0 has to hold: neither held, nor a face that is not in force
    beside: Bools  # φ ≤ 0: the other faces of a held box, with sharp corners
    lands: Bools  # which contacts are sustained from there on

    def at(self, knots: Ints) -> Marks:
        """Returns those of some knots."""
        return Marks(*(each[knots] for each in self))

    def calc_impact(self, k: int, inertia: ConstantInertia, restitutions: Floats) -> JointImpact:
        """Returns the impact of what is struck at a knot; where contacts land, they stay."""
        struck = np.flatnonzero(self.struck[k])
        returned = np.where(self.lands[k], 0.0, restitutions)[struck]
        return JointImpact.of(inertia, tuple(struck.tolist()), tuple(returned.tolist()))


@dataclass(frozen=True, eq=False)
class Timeline:
    """The knots k = 0 … N of a contact sequence; phases meet where something starts or ends."""

    phases: tuple[Phase, ...]  # in order
    times: Floats  # when they meet, and both ends [s], shape (P+1,)
    spans: tuple[tuple[int, int], ...]  # the first and the last knot of each touch
    turns: tuple[int, ...]  # the knot at which each facing starts
    instants: Mapping[float, int]  # further times of knots [s] → their knots
    marks: Marks  # contacts at the knots
    rests: Bools  # which contacts rest during each step, shape (N, m)


def make_timeline(
    world: World,
    scenario: Scenario,
    sequence: TouchSequence,
    facings: Sequence[Facing] = (),
    instants: ArrayLike = (),
) -> Timeline:
    """Spreads the knots over the phases of a sequence that is checked (`check_sequence`).

    Phases also meet where another face of a box takes over, and at these instants, which are after
    the start and before the end [s].
    """
    N, m, T = scenario.num_steps, world.num_contacts, scenario.duration
    fronts = Fronts(world, facings, T)
    fixed = np.asarray(instants, dtype=float).tolist()
    inner = sorted({*joint_times(sequence), *fronts.times, *fixed})
    times = np.array([0.0, *inner, T])
    if len(times) - 1 > N:
        raise OptionsError(
            "sequence",
            got=f"{len(times) - 1} phases",
            expected=f"at most the {N} steps of the scenario",
        )
    knots = [0, *_spread(np.diff(times), N)]
    knot = dict(zip(times.tolist(), knots, strict=True))
    spans = tuple((knot[touch.start], knot[touch.end]) for touch in sequence)
    starts, held = np.zeros((2, N + 1, m), dtype=bool)
    rests = np.zeros((N, m), dtype=bool)
    for touch, (first, last) in zip(sequence, spans, strict=True):
        starts[first, touch.contact] = True
        held[first : last + 1, touch.contact] = True
        rests[first:last, touch.contact] = True
    none = np.zeros((1, m), dtype=bool)
    resting_before = np.vstack([none, rests])
    front = fronts.at_knots(times, knots)
    if np.any(held & ~front):
        k, i = np.argwhere(held & ~front)[0]
        raise OptionsError(
            "facings",
            got=f"another face than {world.contacts[i].name}, which is touched",
            expected=f"that one at {times[np.searchsorted(knots, k, side='right') - 1]:g} s",
        )
    is_solid_held = held @ world.are_of_one_solid
    return Timeline(
        phases=tuple(
            Phase(first, last, tuple(np.flatnonzero(rests[first]).tolist()))
            for first, last in pairwise(knots)
        ),
        times=times,
        spans=spans,
        turns=tuple(knot[facing.start] for facing in facings),
        instants={time: knot[time] for time in fixed},
        marks=Marks(
            starts=starts,
            struck=(starts | resting_before) & np.any(starts, axis=1, keepdims=True),
            held=held,
            apart=front & ~is_solid_held,
            beside=is_solid_held & ~held,
            lands=starts & np.vstack([rests, none]),
        ),
        rests=rests,
    )


def check_sequence(world: World, sequence: TouchSequence, duration: float) -> None:
    """Checks that a sequence fits the world and the duration [s]."""
    m = world.num_contacts
    for touch in sequence:
        if not 0 <= touch.contact < m:
            raise OptionsError(
                "sequence",
                got=f"a touch of contact {touch.contact}",
                expected=f"0 … {m - 1}, for the world has {m}",
            )
    for i, contact in enumerate(world.contacts):
        joints = [t for touch in sequence if touch.contact == i for t in touch.joints]
        if any(later <= time for time, later in pairwise([0.0, *joints, duration])):
            whose = f" ({contact.name})" if m > 1 else ""
            raise OptionsError(
                "sequence",
                got=f"contacts at {joints} s{whose}",
                expected=f"increasing times between 0 and {duration:g} s",
            )
    starts = [touch.start for touch in sequence]
    if starts != sorted(starts):
        raise OptionsError(
            "sequence", got=f"touches that start at {starts} s", expected="the order of time"
        )


def _spread(durations: Floats, count: int) -> list[int]:
    """Returns the knot at the end of each phase: steps by duration, and an equal share of half."""
    even = np.full(len(durations), 1 / len(durations))
    shares = np.cumsum(durations / durations.sum() + even) / 2
    spare = count - len(durations)  # Each gets one first.
    return [k + int(end) for k, end in enumerate(np.round(spare * shares), 1)]


def straight_path(
    world: World, scenario: Scenario, sequence: Sequence[Touch], through: ArrayLike | None = None
) -> tuple[Floats, Floats]:
    """Returns times (J+2,) [s] and positions (J+2, nq) [m] of start, goal and stops between.

    There is a stop at each of a sequence's `joint_times`, on the straight way from start to goal
    unless it is given, (J, nq), and moved to the walls that are touched then.
    """
    times = np.array([0.0, *joint_times(sequence), scenario.duration])
    ends = scenario.initial_position, scenario.goal_position
    stops = ends[0] + np.outer(times / times[-1], ends[1] - ends[0])
    if through is not None:
        stops[1:-1] = np.reshape(through, (len(times) - 2, world.num_positions))
    for stop, time in zip(stops[1:-1], times[1:-1], strict=True):
        touched = [touch.contact for touch in sequence if touch.start <= time <= touch.end]
        stop[:] = world.move_onto(stop, touched)
    return times, stops


def make_guess(
    world: World, scenario: Scenario, timeline: Timeline, times: Floats, stops: Floats
) -> Trajectory:
    """Returns a motion at all knots, by stops (J+2, nq) at times (J+2,).

    Sustained contacts are straight, pressed by gravity. Flights are without control, bent by it.
    After a rest, without speed to fly with, a decreasing control pushes them:

        q(t) = q₀ + t w + t²/2 a + t²/2 (1 − t/(3τ)) p,    u(t) = G⁺ p (1 − t/τ),    G = M⁻¹ B

    with the speed w along the wall, the acceleration a without control, and p such that q(τ) is the
    next stop.
    """
    N, line, inertia = scenario.num_steps, timeline, world.constant_inertia
    knots = [0, *(phase.last for phase in line.phases)]
    t = np.interp(np.arange(N + 1), knots, line.times)
    q = interpolate(t, times, stops)
    v = np.vstack([scenario.initial_velocity, np.diff(q, axis=0) / np.diff(t)[:, np.newaxis]])
    u, forces = np.zeros((N, world.num_actuators)), np.zeros((N, world.num_contacts))
    still, idle = np.zeros(world.num_velocities), np.zeros(world.num_actuators)
    rested: tuple[int, ...] = ()
    for phase in line.phases:
        middle = (q[phase.first] + q[phase.last]) / 2
        pull = world.calc_acceleration(middle, still, idle)
        if rested and not phase.rests:
            _jump(phase, pull, (t, q, v, u), inertia.inverse_mass @ world.actuation)
        elif not phase.rests:
            inside = slice(phase.first, phase.last + 1)
            since, left = t[inside] - t[phase.first], t[phase.last] - t[inside]
            q[inside] -= np.outer(since * left / 2, pull)
            v[inside][1:] += np.outer((since - left)[1:] / 2, pull)
        rested = phase.rests
        weights = np.maximum(-inertia.masses * (inertia.jacobian @ pull), 0.0)
        forces[phase.first : phase.last, rested] = weights[[*rested]]
    return Trajectory(t, q, v, u, np.zeros((N + 1, world.num_contacts)), forces)


def _jump(
    phase: Phase, pull: Floats, motion: tuple[Floats, Floats, Floats, Floats], gain: Floats
) -> None:
    """Writes a flight that begins at the speed of the end of the phase before.

    Args:
        phase: the flight.
        pull: a, shape (nv,) [m/s²].
        motion: t, q, v and u at all knots.
        gain: G, shape (nv, nu) [1/kg].
    """
    t, q, v, u = motion
    first, inside = phase.first, slice(phase.first, phase.last + 1)
    s, w = (t[inside] - t[first])[:, np.newaxis], v[first]
    whole = s[-1]
    push = 3 / whole**2 * (q[phase.last] - q[first] - whole * w - whole**2 / 2 * pull)
    q[inside] = q[first] + s * w + s**2 / 2 * (pull + (1 - s / (3 * whole)) * push)
    v[inside] = w + s * (pull + (1 - s / (2 * whole)) * push)
    middles = (s[1:] + s[:-1]) / 2
    u[first : phase.last] = (1 - middles / whole) * (np.linalg.pinv(gain) @ push)


def bend(path: tuple[Floats, Floats], times: Floats, stops: Floats) -> tuple[Floats, Floats]:
    """Returns a path moved to stops at some times, and between them in proportion.

    Args:
        path: times and positions.
        times: from the path's first to its last, shape (K,) [s].
        stops: shape (K, nq) [m].
    """
    grid = np.unique([*path[0], *times])
    at = interpolate(grid, *path)
    return grid, at + interpolate(grid, times, stops - interpolate(times, grid, at))
