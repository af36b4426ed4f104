"""Contact sequences: which contacts there are and when, and in front of which faces motions go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drake_aigto.arrays import Bools, Floats, interpolate
from drake_aigto.contact import calc_time_to_wall
from drake_aigto.errors import OptionsError
from drake_aigto.world import Scenario, World

# What is touched within this part of the duration without control is touched whatever the control:
# to brake before would take the inverse of that in force.
AT_ONCE = 1e-6


@dataclass(frozen=True)
class Touch:
    """One contact of a sequence.

    Attributes:
        start: when the wall is touched [s]; 0 for a contact that lasts and is there from the start.
        end: when it is left [s]; equal to `start` for a bounce, later for a contact that lasts.
        contact: which of the world's contacts.
        mode: how the impact ends where the contact rubs, and how it goes on as it lasts: 0 if it
            sticks, else the sign of the slip. A contact that lasts on in another mode is another
            touch, which starts when the one before ends.
    """

    start: float
    end: float
    contact: int = 0
    mode: int = 0

    @classmethod
    def bounce(cls, time: float, contact: int = 0) -> Touch:
        """Returns a touch that takes no time."""
        return cls(float(time), float(time), contact)

    @property
    def lasts(self) -> bool:
        """Whether it is more than a bounce."""
        return self.end > self.start

    @property
    def joints(self) -> tuple[float, ...]:
        """When phases meet here: once for a bounce, twice for a contact that lasts [s]."""
        return (self.start, self.end) if self.lasts else (self.start,)


# In the order of their starts; () is a free flight. Touches of different contacts may overlap, and
# start together.
TouchSequence = tuple[Touch, ...]


def joint_times(sequence: Sequence[Touch]) -> tuple[float, ...]:
    """Returns when a sequence's phases meet, each time once, in order [s]."""
    return tuple(sorted({time for touch in sequence for time in touch.joints}))


def touches_at_once(world: World, scenario: Scenario) -> TouchSequence:
    """Returns the bounces right after the start, which no control of any reasonable size prevents.

    A solid is entered as the last of its faces is passed.
    """
    q, v = scenario.initial_position, scenario.initial_velocity
    J, u = world.calc_contact_jacobian(q), np.zeros(world.num_actuators)
    curves = zip(
        world.calc_signed_distance(q).tolist(),
        (J @ v).tolist(),
        (J @ world.calc_acceleration(q, v, u)).tolist(),
        strict=True,
    )
    times = [calc_time_to_wall(*curve) if curve[0] > 0 else 0.0 for curve in curves]
    entries = ((max(times[i] for i in faces), faces) for faces in world.solids)
    return tuple(
        Touch.bounce(time, max(faces, key=lambda i: times[i]))
        for time, faces in sorted(entries)
        if time < AT_ONCE * scenario.duration
    )


# How finely a path is looked at to find the faces that it passes, in parts of the duration.
_GRID = 200
# Times that differ by less than this part of the duration are one.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Facing:
    """From a time on, a motion is in front of one face of a box that has several.

    A sphere is outside of a box where φ ≥ 0 for one of its faces. Which one is a choice, as which
    contact is touched is: it turns the alternative into a row.

    Attributes:
        start: since when [s]; 0 for the first face, until the next one of the same box.
        contact: the face, one of the world's contacts.
    """

    start: float
    contact: int


class Fronts:
    """The faces in force over time: of half spaces the only one, of boxes as the facings say.

    Attributes:
        times: when a facing starts, after 0 [s].
    """

    def __init__(self, world: World, facings: Sequence[Facing], duration: float) -> None:
        """Checks that there is a face of every box at any time."""
        boxes = [faces for faces in world.solids if len(faces) > 1]
        known = [face for faces in boxes for face in faces]
        self._world, self._is_alone = world, np.ones(world.num_contacts, dtype=bool)
        self._is_alone[known] = False
        self._facings = tuple(facings)
        self.times = tuple(facing.start for facing in facings if facing.start > 0)
        chosen = [facing.contact for facing in facings]
        if not set(known).issuperset(chosen):
            raise OptionsError(
                "facings",
                got=f"contacts {chosen}",
                expected=f"those of {known}, the faces of boxes",
            )
        for faces in boxes:
            _check_starts([each.start for each in facings if each.contact in faces], duration)

    def at_knots(self, times: Floats, knots: Sequence[int]) -> Bools:
        """Returns which faces are in force, shape (N+1, m); both of them where one takes over.

        Phases meet at these times [s] and knots, the ends among them.
        """
        front = np.tile(self._is_alone, (knots[-1] + 1, 1))
        for facing in self._facings:
            later = (
                other.start
                for other in self._facings
                if other.start > facing.start
                and self._world.are_of_one_solid[facing.contact, other.contact]
            )
            end = min(later, default=times[-1])
            first, last = (knots[int(np.searchsorted(times, t))] for t in (facing.start, end))
            front[first : last + 1, facing.contact] = True
        return front


def _check_starts(starts: Sequence[float], duration: float) -> None:
    """Refuses faces of one box if there is none at some time."""
    if not starts or starts[0] != 0 or np.any(np.diff([*starts, duration]) <= 0):
        raise OptionsError(
            "facings",
            got=f"faces of one box from {starts} s on",
            expected=f"the first from 0 s, and increasing times below {duration:g} s",
        )


def find_facings(
    world: World, times: Floats, path: Floats, sequence: Sequence[Touch] = ()
) -> tuple[Facing, ...]:
    """Returns the faces that a path goes along, as few changes as it takes.

    A face lasts for as long as the path is in front of it, or, where the path cuts a box, nearer to
    it than to the others. It takes over in the middle of the time in which both are. Where a face
    is touched, it is the one. The path is straight between its points (K, nq) [m], at times (K,).
    """
    boxes = [faces for faces in world.solids if len(faces) > 1]
    if not boxes:
        return ()
    joints = np.unique([time for touch in sequence for time in touch.joints])
    others = np.unique([*np.linspace(times[0], times[-1], _GRID + 1), *times])
    # A touch at one of them is at the same time, but for rounding, not a moment before or after.
    gaps = np.abs(others[:, np.newaxis] - joints)
    is_apart = np.all(gaps > _ROUNDING * (times[-1] - times[0]), axis=1)
    grid = np.union1d(others[is_apart], joints)
    points = interpolate(grid, times, path)
    distances = world.calc_signed_distance(points)
    found: list[Facing] = []
    for faces in boxes:
        phi = distances[:, faces]
        fits = (phi >= 0) | (phi == np.max(phi, axis=1, keepdims=True))
        for touch in sequence:
            if touch.contact in faces:
                during = (grid >= touch.start) & (grid <= touch.end)
                fits[during] = np.array(faces) == touch.contact
        found += [Facing(float(grid[k] - times[0]), faces[face]) for k, face in _cover(fits)]
    return tuple(sorted(found, key=lambda facing: facing.start))


def _cover(fits: Bools) -> list[tuple[int, int]]:
    """Returns from which row on which column to take, so that all fit (K, F) and few change."""
    cover: list[tuple[int, int]] = []
    k, K = 0, len(fits)
    while k < K:
        ends = [k + int(np.argmin(np.append(column[k:], False))) for column in fits.T]
        face = int(np.argmax(ends))
        # Back to since when it fits, at most to where the one before began.
        since = k - int(np.argmin(np.append(fits[:k, face][::-1], False)))
        earliest = cover[-1][0] + 1 if cover else 0
        cover.append(((max(since, earliest) + k) // 2 if cover else 0, face))
        k = ends[face]
    return cover
