"""Impacts on rigid walls in a moment so short that accelerations are constant."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from drake_aigto.planning.contact_motion import Clearance, ContactMotion, calc_time_to_wall
from drake_aigto.planning.recording import Impact, Recording

if TYPE_CHECKING:
    import numpy.typing as npt

    _Array = npt.NDArray[np.float64]

# Times are parts of the simulated duration T.

# The n-th impact at a contact becomes rest if the hop after it would last less than n times this.
# No more than √(2 / _HOP) ≈ 1,400 hops fit into T then: no Zeno sequence can hang.
_HOP = 1e-6
# Impact and rest leave this much air, relative to the largest position or 1 m, so that rounding
# does not put the ball inside.
_AIR = 1e-14
# Rates of a contact at rest below this are rounding, relative to the largest velocity or 1 m/s.
_STILL = 1e-13
# So many impacts in one moment are a collapse, infinitely many: then all that touch stay together.
_MOST_IMPACTS = 1000


class Touch(NamedTuple):
    """A touch of a solid, soon or not long ago."""

    wait: float  # until then, or since then [s]
    contact: int  # the face


@dataclasses.dataclass
class Phase:
    """The state of a hybrid system: where and how fast, what it rests on, and how often it hit.

    Attributes:
        x: (q, v), shape (nq + nv,).
        resting: the contacts that it rests on.
        counts: how many impacts each contact had, m of them.
    """

    x: _Array
    resting: set[int]
    counts: list[float]


class Impacts:
    """What happens to a `Phase` on rigid, frictionless walls (`RigidWall` has the equations)."""

    def __init__(
        self,
        motion: ContactMotion,
        restitutions: npt.NDArray[np.float64],
        duration: float,
        recording: Recording,
    ) -> None:
        """Keeps what it needs.

        Args:
            motion: of the world.
            restitutions: e of each contact, in [0, 1].
            duration: T, how long will be simulated [s].
            recording: where impacts are noted, with the states before and after.
        """
        self._motion = motion
        self._restitutions = restitutions.tolist()
        self._duration = duration
        self._recording = recording

    def support(self, acceleration: _Array, resting: set[int]) -> _Array:
        """Returns v̇ from what it is without contact and the contacts that are rested on."""
        return self._motion.calc_supported(acceleration, sorted(resting))

    def trace_back(self, x: _Array, acceleration: _Array, clearance: Clearance) -> Touch:
        """Returns how long ago the ball came in where its clearance is at most 0.

        It came in through the face that it was in front of last.
        """
        distances, rates = self._motion.calc_distances(x)
        pushes = self._motion.calc_pushes(acceleration)
        touches = []
        for i in self._motion.solids[self._motion.solid_of[clearance.contact]]:
            # Back in time, from inside, the wall is ahead: both signs turn.
            came_in = distances[i] < 0 or rates[i] < 0
            age = calc_time_to_wall(-distances[i], rates[i], -pushes[i]) if came_in else math.inf
            touches.append(Touch(age, i))
        return min(touches)

    def find_touch(self, x: _Array, acceleration: _Array, resting: set[int]) -> Touch:
        """Returns the first touch under a constant acceleration, infinitely far if there is none.

        A contact at rest that others push in is touched at once.
        """
        distances, rates = self._motion.calc_distances(x)
        pushes = self._motion.calc_pushes(acceleration)
        still = self._calc_still(x)
        first = Touch(math.inf, -1)
        for faces in self._motion.solids:
            held = resting.intersection(faces)
            if held:
                touch = min(Touch(0.0 if rates[i] < -still else math.inf, i) for i in held)
            elif len(faces) == 1:
                (i,) = faces
                leaves = distances[i] <= 0 and rates[i] >= -still and pushes[i] >= 0
                wait = calc_time_to_wall(max(distances[i], 0.0), rates[i], pushes[i])
                touch = Touch(math.inf if leaves else wait, i)
            else:
                touch = self._find_entry(faces, distances, rates, pushes)
            first = min(first, touch)
        return first

    def _find_entry(
        self, faces: list[int], distances: list[float], rates: list[float], pushes: list[float]
    ) -> Touch:
        """Returns when a solid is entered: as the last of its faces is passed, the others behind.

        One that the ball is at, inside but for rounding, is entered at the face that is nearest.
        """
        ahead = [i for i in faces if distances[i] > 0] or [max(faces, key=distances.__getitem__)]
        wait, last = max(
            (calc_time_to_wall(max(distances[i], 0.0), rates[i], pushes[i]), i) for i in ahead
        )
        if wait == math.inf or (distances[last] <= 0 and rates[last] >= 0 and pushes[last] >= 0):
            return Touch(math.inf, last)
        there = (
            distances[i] + wait * (rates[i] + wait / 2 * pushes[i]) for i in faces if i != last
        )
        return Touch(wait if all(distance <= 0 for distance in there) else math.inf, last)

    def run(self, time: float, phase: Phase, acceleration: _Array, touch: Touch) -> None:
        """Replays the last moment, from the touch with which it began.

        Impacts are one by one, each where and when the parabolas between them say. If several
        contacts are touched at once, in a corner or by bodies in a row, they take turns until none
        is approached any more, in the order of the world's contacts. That is exact, and the order
        does not matter, where J_i M⁻¹ J_jᵀ = 0.

        Args:
            time: now, when the moment ends [s].
            phase: as it would be now without the touch; left as it is now with all impacts.
            acceleration: v̇ without contact, shape (nv,) [m/s²].
            touch: the first one, and how long ago it was.
        """
        left = touch.wait
        phase.x = _fly(phase.x, self.support(acceleration, phase.resting), -left)
        touched = set()
        for _ in range(_MOST_IMPACTS):
            self._hit(time - left, phase, acceleration, touch.contact)
            touched.add(touch.contact)
            supported = self.support(acceleration, phase.resting)
            touch = self.find_touch(phase.x, supported, phase.resting)
            if touch.wait > left:
                break
            phase.x = _fly(phase.x, supported, touch.wait)
            left -= touch.wait
        else:
            self._stick(phase, touched)
        phase.x = _fly(phase.x, self.support(acceleration, phase.resting), left)
        self.settle(phase)

    def _hit(self, time: float, phase: Phase, acceleration: _Array, contact: int) -> None:
        """Applies an impact, or brings the contact to rest."""
        motion, e = self._motion, self._restitutions[contact]
        q, v = _split(phase.x)
        others = phase.resting - {contact}
        push = float(motion.jacobian[contact] @ self.support(acceleration, others))
        speed = max(0.0, -float(motion.jacobian[contact] @ v))
        phase.counts[contact] += 1
        shortest_hop = _HOP * self._duration * phase.counts[contact]
        after = v + (1 + e) * speed * motion.lifts[contact]
        if 2 * speed > shortest_hop * abs(push):
            for velocity in (v, after):
                self._recording.add(time, q, velocity)
            energies = (motion.calc_kinetic_energy(velocity) for velocity in (v, after))
            self._recording.impacts.append(Impact(time, contact, speed, push, *energies))
        rests = 2 * e * speed <= -shortest_hop * push
        if rests:
            after = v + speed * motion.lifts[contact]
        phase.x = np.concatenate([q, after])
        still = self._calc_still(phase.x)
        leaves = {j for j in others if float(motion.jacobian[j] @ after) > still}
        phase.resting = (others - leaves) | ({contact} if rests else set())

    def _stick(self, phase: Phase, touched: set[int]) -> None:
        """Ends a collapse: what touches stays together."""
        q, v = _split(phase.x)
        contacts = sorted(touched | phase.resting)
        v = self._motion.calc_supported(v, contacts)
        phase.x = np.concatenate([q, v])
        still = self._calc_still(phase.x)
        phase.resting = {i for i in contacts if float(self._motion.jacobian[i] @ v) <= still}

    def settle(self, phase: Phase) -> None:
        """Takes rounding out: no ball is inside, those at rest are at the wall and stay there."""
        motion = self._motion
        q, v = _split(phase.x)
        air = _AIR * max(1.0, float(np.max(np.abs(q))))
        for clearance in motion.calc_clearances(phase.x):
            held = phase.resting.intersection(motion.solids[motion.solid_of[clearance.contact]])
            for i in held or ({clearance.contact} if clearance.distance < air else ()):
                q = (
                    q
                    + (air - motion.calc_distances(np.concatenate([q, v]))[0][i]) * motion.lifts[i]
                )
        for i in sorted(phase.resting):
            v = v - float(motion.jacobian[i] @ v) * motion.lifts[i]
        phase.x = np.concatenate([q, v])

    def _calc_still(self, x: _Array) -> float:
        """Returns how fast a contact at rest may seem to move [m/s]."""
        return _STILL * max(1.0, float(np.max(np.abs(x[len(x) // 2 :]))))


def _fly(x: _Array, acceleration: _Array, time: float) -> _Array:
    """Returns (q, v) a time later, or before, on the parabola."""
    q, v = _split(x)
    later = v + time * acceleration
    return np.concatenate([q + time / 2 * (v + later), later])


def _split(x: _Array) -> tuple[_Array, _Array]:
    half = len(x) // 2
    return x[:half], x[half:]
