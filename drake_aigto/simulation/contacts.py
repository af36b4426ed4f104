"""The contacts of a planned trajectory, read off its impulses."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.plain import called
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import World

# An impulse is a contact if it changes the velocity by this part of the largest one on the way. A
# literal plan has some force at every distance; this tells the blow from the breeze.
_SHARE = 0.05
# Impulses that follow each other sooner than this part of the duration are one contact.
_GAP = 0.1
# An impulse below this part of the largest velocity is a solver's rounding.
_ROUNDING = 1e-9
# A velocity below this part of the largest one is none: a contact that lasts may begin and end so.
_STILL = 1e-5


@dataclass(frozen=True)
class PlannedContact:
    """One contact of a plan.

    Attributes:
        time: of its first knot [s].
        last_time: of its last knot [s].
        velocity_change: ‖Σ M⁻¹ J_iᵀ (p_ik + λ_ik τ_k)‖ [m/s].
        energy_ratio: kinetic energy after / before, with all that happens at its knots; 1 where it
            is still before and after.
        index: i, which of the world's contacts.
    """

    time: float
    last_time: float
    velocity_change: float
    energy_ratio: float
    index: int = field(default=0, metadata=called("contact"))


def find_contacts(world: World, trajectory: Trajectory) -> tuple[PlannedContact, ...]:
    """Returns the contacts of a trajectory in the order of time: its contact sequence.

    Where a wall pushes at every knot, large impulses are contacts, and those that follow each
    other soon are one. Where it does not, every impulse and every held force is one.
    """
    q, v = trajectory.positions, trajectory.velocities
    after = v + world.calc_velocity_change(q, trajectory.impulses)
    energies = np.array([world.calc_kinetic_energy(q, each) for each in (v, after)])
    found = [
        contact
        for i in range(world.num_contacts)
        for contact in _find_contacts(world, trajectory, energies, i)
    ]
    return tuple(sorted(found, key=lambda contact: (contact.time, contact.index)))


def _find_contacts(
    world: World, trajectory: Trajectory, energies: Floats, index: int
) -> list[PlannedContact]:
    """Returns those of one contact; with the energies before and after each knot, (2, N+1) [J]."""
    impulses, forces = trajectory.impulses[:, index], trajectory.forces[:, index]
    held = forces * np.diff(trajectory.times)
    if not (np.any(impulses) or np.any(held)):
        return []
    alone = np.zeros(trajectory.impulses.shape)
    alone[:, index] = impulses + np.append(held, 0.0)
    changes = world.calc_velocity_change(trajectory.positions, alone)
    runs = _find_runs(trajectory, impulses, held, np.linalg.norm(changes, axis=1))
    still = _STILL**2 * np.max(energies[0])  # Rounding of the largest on the way is none.
    energies = np.where(energies > still, energies, 0.0)
    return [
        PlannedContact(
            time=float(trajectory.times[run[0]]),
            last_time=float(trajectory.times[run[-1]]),
            velocity_change=float(np.linalg.norm(changes[run[0] : run[-1] + 1].sum(axis=0))),
            energy_ratio=_divide(float(energies[0, run[0]]), float(energies[1, run[-1]])),
            index=index,
        )
        for run in runs
    ]


def _find_runs(trajectory: Trajectory, impulses: Floats, held: Floats, sizes: Floats) -> list[Ints]:
    """Returns the knots of each contact, given how much velocities change there (N+1,) [m/s]."""
    largest = np.max(np.linalg.norm(trajectory.velocities, axis=1))
    if np.all(impulses[:-1]):
        hit = np.flatnonzero(sizes > _SHARE * largest)
        apart = np.diff(trajectory.times[hit]) >= _GAP * np.ptp(trajectory.times)
    else:
        touching = np.append(held != 0, False) | np.append(False, held != 0)
        hit = np.flatnonzero((sizes > _ROUNDING * largest) | touching)
        apart = held[hit[:-1]] == 0
    return np.split(hit, np.flatnonzero(apart) + 1) if hit.size else []


def max_penetration(world: World, trajectory: Trajectory) -> float:
    """Returns how deep the ball is inside a wall at most, over the knots, at least 0 [m]."""
    return -float(np.min(world.calc_clearance(trajectory.positions), initial=0.0))


def _divide(before: float, after: float) -> float:
    """Returns kinetic energy after / before; 1 if neither is any."""
    if before == 0:
        return 1.0 if after == 0 else np.inf
    return after / before
