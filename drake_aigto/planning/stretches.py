"""A plan between rigid walls, cut where contacts begin, end, or go on in another mode."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from enum import Enum

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.contact import RANK, Closed, Mode, stack_rows
from drake_aigto.errors import TrajectoryError
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import World

# Distances and velocities below this part of a plan's largest ones, or 1, are none: what its phases
# miss their walls by.
_NONE = 1e-5
# Just after an impact a slip is known from the motion to the next knot only, which is no parabola.
_NEARLY_NONE = 1e-2
# An impact that is approached by less than this part of the plan's largest velocity is a graze.
_GRAZE = 1e-6
# Steps of the differences of J v and T v by q, as a part of 1 m or 1 rad.
_DIFFERENCE = 1e-6


class Cut(Enum):
    """Events that end a stretch of a plan."""

    HIT = "a wall is hit, and bounced off or stayed at"
    STOP = "a slip ends"
    CLOCK = "a control lets go of a wall or a stick, or the plan ends"


@dataclass(frozen=True, eq=False)
class Stretch:
    """A part of a plan in which contacts go on as they do."""

    first: int  # the knot at which it starts
    last: int  # the knot at which it ends
    closed: Closed  # the contacts that are, and how each of them goes on
    begin: float  # when, in the plan [s]
    end: float  # when, in the plan [s]
    cut: Cut = Cut.CLOCK  # what ends it
    contact: int = -1  # which hits its wall, or stops to slip, then; −1: none
    speed: float = 0.0  # of a stop, the largest slip before; of an impact, the approach [m/s]
    # Whether a stop ends it, or an impact at a wall that is then held.
    is_shown_by_state: bool = False

    def find_mode(self, contact: int) -> Mode:
        """Returns how a contact goes on."""
        pairs = zip(self.closed.contacts.tolist(), self.closed.modes, strict=True)
        return dict(pairs).get(contact, Mode.OPEN)

    def calc_projection(self, x: Floats) -> Floats:
        """Returns what closed contacts leave of a deviation from a state x, shape (2n, 2n).

        Positions go back to walls along M⁻¹ Jᵀ, and velocities as an impact that returns nothing
        takes them, in the modes of the stretch:

            q̃ − M⁻¹ Jᵀ (J M⁻¹ Jᵀ)⁻¹ J q̃,    ṽ − M⁻¹ Dᵀ (C M⁻¹ Dᵀ)⁻¹ (C ṽ + ∂(C v)/∂q q̃)

        with C and D of `Closed`.
        """
        world, held = self.closed.world, self.closed.contacts
        n = world.num_positions
        if not len(held):
            return np.eye(2 * n)
        q, v = np.split(x, 2)
        J, (arrest, C) = world.calc_contact_jacobian(q)[held], self.closed.calc_arrest(q)
        lifts = np.linalg.solve(world.calc_mass_matrix(q), J.T)
        place = np.eye(n) - lifts @ np.linalg.pinv(J @ lifts, RANK) @ J
        vanish, _ = self.closed.directions
        ends = q + _DIFFERENCE * np.vstack([np.eye(n), -np.eye(n)])
        speeds = (stack_rows(world, ends, held) @ v)[:, vanish]
        bends = (speeds[:n] - speeds[n:]).T / (2 * _DIFFERENCE)
        return np.block(
            [[place, np.zeros((n, n))], [-arrest @ bends @ place, np.eye(n) - arrest @ C]]
        )


def read_stretches(world: World, friction: Floats, trajectory: Trajectory) -> list[Stretch]:
    """Returns the stretches of a plan, whose contacts have μ (m,).

    A contact is closed from one knot to the next where it is at its wall at both, and neither
    approaches nor leaves it.
    """
    modes = _read_modes(world, friction, trajectory)
    is_hit = np.asarray(trajectory.impulses.any(axis=1))
    changes = np.asarray(is_hit[1:-1] | np.any(modes[1:] != modes[:-1], axis=1))
    ends = [0, *(1 + np.flatnonzero(changes)).tolist(), len(modes)]
    found: list[Stretch] = []
    for first, last in itertools.pairwise(ends):
        held = np.flatnonzero(modes[first] != Mode.OPEN)
        kinds = tuple(Mode(mode) for mode in modes[first, held])
        closed = Closed(world, held, kinds, friction[held])
        begin, end = trajectory.times[[first, last]].tolist()
        cut = _find_cut(world, friction, trajectory, modes, first, last)
        found.append(Stretch(first, last, closed, begin, end, *cut))
    return found


def _find_cut(
    world: World, friction: Floats, plan: Trajectory, modes: Ints, first: int, last: int
) -> tuple[Cut, int, float, bool]:
    """Returns what ends a stretch: the last four attributes of `Stretch`."""
    if last == len(modes):
        return Cut.CLOCK, -1, 0.0, False
    q, v = plan.positions[first : last + 1], plan.velocities[first : last + 1]
    if plan.impulses[last].any():
        contact = int(np.argmax(plan.impulses[last]))
        speed = abs(float(world.calc_contact_rate(q[-1], v[-1])[contact]))
        return Cut.HIT, contact, speed, bool(modes[last, contact] != Mode.OPEN)
    before, after = modes[first], modes[last]
    slid = (np.abs(before) == 1) & (after != before) & (after != Mode.OPEN)
    stopped = np.flatnonzero(slid & (friction > 0))
    if not len(stopped):
        return Cut.CLOCK, -1, 0.0, False
    slips = world.rubbing.calc_slips(q, v)[:, stopped[0]]
    return Cut.STOP, int(stopped[0]), float(np.max(np.abs(slips))), True


def _read_modes(world: World, friction: Floats, trajectory: Trajectory) -> Ints:
    """Returns the mode of each contact between knots, shape (N, m)."""
    q, v = trajectory.positions, trajectory.velocities
    length, speed = 1 + np.max(np.abs(q)), 1 + np.max(np.abs(v))
    is_hit = trajectory.impulses[:-1].any(axis=1, keepdims=True)
    at = np.abs(world.calc_signed_distance(q)) <= _NONE * length
    still = np.abs(world.calc_contact_rate(q, v)) <= _NONE * speed
    closed = at[:-1] & at[1:] & still[1:] & (still[:-1] | is_hit)
    steps = np.diff(trajectory.times)[:, np.newaxis]
    after = np.where(is_hit, 2 * np.diff(q, axis=0) / steps - v[1:], v[:-1])
    slips = world.rubbing.calc_slips(q[:-1], after), world.rubbing.calc_slips(q[1:], v[1:])
    first = np.abs(slips[0]) <= np.where(is_hit, _NEARLY_NONE, _NONE) * speed
    sticks = first & (np.abs(slips[1]) <= _NONE * speed)
    signs = np.where(slips[0] + slips[1] < 0, Mode.BACKWARD, Mode.FORWARD)
    modes = np.where(sticks & (friction > 0), Mode.STICK, signs)
    return np.where(closed, modes, Mode.OPEN)


def is_at_rest_on(world: World, q: Floats, v: Floats, speed: float | None = None) -> Bools:
    """Returns which contacts are closed and approach by less than a speed [m/s], shape (m,).

    Args:
        world: the mechanism.
        q: positions, shape (n,).
        v: velocities, shape (n,).
        speed: of approach; None: next to none, and none away from the wall.
    """
    at = world.calc_signed_distance(q) <= _NONE * (1 + np.max(np.abs(q)))
    rates, still = world.calc_contact_rate(q, v), _NONE * (1 + np.max(np.abs(v)))
    if speed is None:
        return np.asarray(at & (np.abs(rates) <= still))
    return np.asarray(at & (rates >= -speed))


def touches_walls(world: World, trajectory: Trajectory) -> bool:
    """Returns whether a plan hits a wall, or stays at one between knots."""
    closed = _read_modes(world, np.zeros(world.num_contacts), trajectory) != Mode.OPEN
    return bool(trajectory.impulses.any() or closed.any())


def check_sizes(world: World, trajectory: Trajectory, name: str = "the trajectory") -> None:
    """Refuses the trajectory of another world, by its name in the error."""
    sizes = world.num_positions, world.num_actuators, world.num_contacts
    got = tuple(
        each.shape[1] for each in (trajectory.positions, trajectory.controls, trajectory.impulses)
    )
    if got != sizes:
        raise TrajectoryError(
            name, got=f"{got} positions, controls and contacts", expected=f"the world's, {sizes}"
        )


def check_impacts(world: World, trajectory: Trajectory) -> None:
    """Refuses impacts that no feedback is known for."""
    times, impulses = trajectory.times, trajectory.impulses[:-1]
    remedy = "Track plans whose contacts are bounces one by one."
    if impulses[0].any():
        rigid = "Track plans of the rigid transcription, whose contacts are bounces one by one."
        raise _refuse("a push at the very start", rigid)
    several = np.flatnonzero(np.count_nonzero(impulses, axis=1) > 1)
    if several.size:
        raise _refuse(f"several at once, at {times[several[0]]:.3f} s", remedy)
    speeds = world.calc_contact_rate(trajectory.positions[:-1], trajectory.velocities[:-1])
    slowest = -_GRAZE * float(np.max(np.linalg.norm(trajectory.velocities, axis=1)))
    grazes = np.flatnonzero(((impulses != 0) & (speeds >= slowest)).any(axis=1))
    if grazes.size:
        raise _refuse(f"one that grazes, at {times[grazes[0]]:.3f} s", remedy)


def _refuse(got: str, remedy: str) -> TrajectoryError:
    return TrajectoryError("contacts of a plan to track", got, "bounces", remedy)
