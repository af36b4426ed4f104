"""What a contact sequence says about every knot: phases, and who touches, rests or stays away."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.errors import OptionsError
from drake_aigto.transcription.facings import Facing, Fronts
from drake_aigto.transcription.touch import TouchSequence, joint_times
from drake_aigto.world import Scenario, World


@dataclass(frozen=True)
class Phase:
    """Steps first … last − 1, all of one length, during which some contacts rest."""

    first: int
    last: int
    rests: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Timeline:
    """The knots k = 0 … N of a contact sequence; phases meet where something starts or ends.

    Attributes:
        phases: in order.
        times: when they meet, and both ends [s], shape (P+1,).
        spans: the first and the last knot of each touch.
        turns: the knot at which each facing starts.
        instants: times that are asked for besides [s] → their knots.
        starts: which contacts are touched anew at each knot, shape (N+1, m).
        struck: those, and with them the ones that have been resting until then.
        held: φ = 0: struck, resting, or about to leave.
        apart: φ ≥ 0 is asked for: neither held, nor one of several faces that others stand for.
        beside: φ ≤ 0: the other faces of a box that is held, whose corners count as sharp.
        rests: which contacts rest during each step, shape (N, m).
        lands: which contacts last from each knot on, shape (N+1, m).
    """

    phases: tuple[Phase, ...]
    times: Floats
    spans: tuple[tuple[int, int], ...]
    turns: tuple[int, ...]
    instants: Mapping[float, int]
    starts: Bools
    struck: Bools
    held: Bools
    apart: Bools
    beside: Bools
    rests: Bools
    lands: Bools


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

    Raises:
        OptionsError: more phases than steps, or facings that leave out a box or what is touched.
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
    knots = np.append(0, np.cumsum(_spread(np.diff(times), N))).tolist()
    knot = dict(zip(times.tolist(), knots, strict=True))
    spans = tuple((knot[touch.start], knot[touch.end]) for touch in sequence)
    starts, held = np.zeros((2, N + 1, m), dtype=bool)
    rests = np.zeros((N, m), dtype=bool)
    for touch, (first, last) in zip(sequence, spans, strict=True):
        starts[first, touch.contact] = True
        held[first : last + 1, touch.contact] = True
        rests[first:last, touch.contact] = True
    resting_before = np.vstack([np.zeros((1, m), dtype=bool), rests])
    struck = (starts | resting_before) & np.any(starts, axis=1, keepdims=True)
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
        starts=starts,
        struck=struck,
        held=held,
        apart=front & ~is_solid_held,
        beside=is_solid_held & ~held,
        rests=rests,
        lands=starts & np.vstack([rests, np.zeros((1, m), dtype=bool)]),
    )


def check_sequence(world: World, sequence: TouchSequence, duration: float) -> None:
    """Checks that a sequence may be one of this world, and takes no longer than the duration [s].

    Raises:
        OptionsError: times out of order or outside of the duration, or contacts that there are not.
    """
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


def _spread(durations: Floats, count: int) -> Ints:
    """Returns how many of the steps each phase gets: by duration, and an equal share of half."""
    even = np.full(len(durations), 1 / len(durations))
    shares = np.cumsum(durations / durations.sum() + even) / 2
    spare = count - len(durations)  # Each gets one first.
    ends = np.round(spare * shares).astype(int)
    return 1 + np.diff(ends, prepend=0)
