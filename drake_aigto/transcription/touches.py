"""Contact sequences: contacts and their times, and the faces that motions are in front of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drake_aigto.arrays import Bools, Floats, interpolate
from drake_aigto.contact import calc_time_to_wall
from drake_aigto.errors import OptionsError
from drake_aigto.world import Scenario, World

# Contacts of the uncontrolled motion within this part of the duration are inevitable: to brake
# before would take the inverse of that in force.
AT_ONCE = 1e-6


@dataclass(frozen=True)
class Touch:
    """One contact of a sequence.

    Attributes:
        start: of the touch [s]; 0 for a sustained contact that exists at the start.
        end: of it [s]; equal to `start` for a bounce, later for a sustained contact.
        contact: which of the world's contacts.
        mode: with friction, at the end of the impact and while it lasts: 0 for stick, else the sign
            of the slip. A sustained contact that changes its mode is two touches, and the second
            starts when the first ends.
    """

    start: float
    end: float
    contact: int = 0
    mode: int = 0

    @classmethod
    def bounce(cls, time: float, contact: int = 0) -> Touch:
        """Returns an instantaneous touch."""
        return cls(float(time), float(time), contact)

    @property
    def lasts(self) -> bool:
        """Whether it is more than a bounce."""
        return self.end > self.start

    @property
    def joints(self) -> tuple[float, ...]:
        """Times at which phases meet: one for a bounce, two for a sustained contact [s]."""
        return (self.start, self.end) if self.lasts else (self.start,)


# In the order of their starts; () is a free flight. Touches of different contacts may overlap, and
# start together.
TouchSequence = tuple[Touch, ...]


def joint_times(sequence: Sequence[Touch]) -> tuple[float, ...]:
    """Returns the times at which a sequence's phases meet, without repetition, in order [s]."""
    return tuple(sorted({time for touch in sequence for time in touch.joints}))


def touches_at_once(world: World, scenario: Scenario) -> TouchSequence:
    """Returns the bounces right after the start, which no reasonable control prevents.

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


# Resolution of paths for finding the faces that they pass, in parts of the duration.
_GRID = 200
# By which part of its distance a path leans to another one.
_LEAN = 0.1
# Times that differ by less than this part of the duration count as equal.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Facing:
    """A time from which a motion is in front of one face of a box with several.

    A sphere is outside of a box if φ ≥ 0 for one of its faces. The choice of that face, like that
    of contacts, turns the alternative into a row.

    Attributes:
        start: since when [s]; 0 for the first face, until the next one of the same box.
        contact: the face, one of the world's contacts.
    """

    start: float
    contact: int


class Fronts:
    """The faces in force over time: the only one of half spaces, and those of boxes by facings.

    Attributes:
        times: of starts of facings, after 0 [s].
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
    world: World,
    times: Floats,
    path: Floats,
    sequence: Sequence[Touch] = (),
    leaning: Floats | None = None,
) -> tuple[Facing, ...]:
    """Returns the faces that a path goes along, with the fewest changes.

    A face lasts while the path is in front of it, or, if the path cuts a box, nearer to it than to
    the others. Faces change in the middle of the time for which both would do. A face that is
    touched is the one in force. The path is straight between its points (K, nq) [m], at times (K,).
    One that cuts a box through its middle passes it on no side: it leans a little to another path
    (K, nq), if that is given.
    """
    boxes = [faces for faces in world.solids if len(faces) > 1]
    if not boxes:
        return ()
    joints = np.unique([time for touch in sequence for time in touch.joints])
    others = np.unique([*np.linspace(times[0], times[-1], _GRID + 1), *times])
    # A touch at one of them is simultaneous, up to rounding.
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
        cover = _cover(fits)
        if leaning is not None:
            normals = world.calc_contact_jacobian(path[0])[[faces[face] for _, face in cover]]
            if np.any(np.sum(normals[1:] * normals[:-1], axis=1) < 0):  # From face to opposite.
                return find_facings(world, times, path + _LEAN * (leaning - path), sequence)
        found += [Facing(float(grid[k] - times[0]), faces[face]) for k, face in cover]
    return tuple(sorted(found, key=lambda facing: facing.start))


def _cover(fits: Bools) -> list[tuple[int, int]]:
    """Returns rows from which on to take columns, so that all fit (K, F) with few changes."""
    cover: list[tuple[int, int]] = []
    k, K = 0, len(fits)
    while k < K:
        ends = [k + int(np.argmin(np.append(column[k:], False))) for column in fits.T]
        face = int(np.argmax(ends))
        # Back to the first row that fits, at most to the begin of the one before.
        since = k - int(np.argmin(np.append(fits[:k, face][::-1], False)))
        earliest = cover[-1][0] + 1 if cover else 0
        cover.append(((max(since, earliest) + k) // 2 if cover else 0, face))
        k = ends[face]
    return cover
