"""A replay as a trajectory, checked by integrating it again between its rows."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.contact import Closed, ContactLaw, Mode, RigidLaw, calc_drag, calc_pushes
from drake_aigto.simulation import Replay
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import World

# Runge-Kutta steps between two rows of a replay, where contacts neither begin nor end: more where
# gaps are above this part of the states, until they are none of the steps' own making.
_STEPS, _MOST_STEPS, _EXACT = 32, 512, 1e-8
# Distances and speeds below this part of the largest coordinate, or 1, are none.
_STILL = 1e-10

# What is left of a bounce as rest begins, as a part of the largest coordinate, or 1, at most.
_SLOW = 1e-3

# States (K, 2n) → their rates of change, and the forces of contacts, shape (K, m) [N].
Rates: TypeAlias = Callable[[Floats], tuple[Floats, Floats]]


def trace(
    world: World, law: ContactLaw, replay: Replay, times: Floats, controls: Floats
) -> tuple[Trajectory, Floats]:
    """Returns the trajectory of a replay, and how far it is off the equations of motion.

    From each row of the replay Runge and Kutta's method of order 4 goes on to the next. Between
    rigid walls, what rests at a row is held there as long as it presses, what rubs in the mode that
    the replay has, and slow hops end as rest begins; what impacts do is left to
    `bounces.add_impulses`.

    Args:
        world: the mechanism.
        law: what contacts push with while they last.
        replay: of the controls.
        times: of the knots, shape (N+1,) [s].
        controls: held over each interval, shape (N, nu).

    Returns:
        The trajectory at the knots, with the mean forces between them; and the largest difference
        of each of (q, v) to what the row before leads to, shape (2n,).
    """
    is_step = np.diff(replay.times) > 0
    starts, h = replay.times[:-1][is_step], np.diff(replay.times)[is_step]
    knots = np.clip(np.searchsorted(times, starts + h / 2) - 1, 0, len(controls) - 1)
    x = np.hstack([replay.positions, replay.velocities])
    modes = _read_modes(world, replay, starts + h / 2)
    rates = _find_rates(world, law, x[:-1][is_step], controls[knots], modes)
    sizes, steps = np.max(np.abs(x), axis=0), _STEPS
    while True:
        ends, pushes = _integrate(rates, x[:-1][is_step], h, steps)
        if isinstance(law, RigidLaw):
            _begin_rest(world, ends, x[1:][is_step])
        off = np.abs(ends - x[1:][is_step])
        gaps = np.max(np.where(np.isnan(off), np.inf, off), axis=0)
        if steps >= _MOST_STEPS or np.all(gaps <= _EXACT * sizes):
            break
        steps *= 4
    impulses = np.zeros((len(controls), world.num_contacts))
    np.add.at(impulses, knots, pushes)
    q, v = replay.states_at(times)
    forces = impulses / np.diff(times)[:, np.newaxis]
    none = np.zeros((len(times), world.num_contacts))
    return Trajectory(times, q, v, controls, none, forces), gaps


def _read_modes(world: World, replay: Replay, times: Floats) -> Ints:
    """Returns in which modes a replay's contacts with friction last at times, shape (K, m)."""
    modes = np.full((len(times), world.num_contacts), Mode.OPEN, dtype=np.int64)
    for phase in replay.contact_phases:
        lasts = (phase.start <= times) & (times <= phase.end)
        modes[lasts, phase.contact] = Mode[phase.mode.upper()]
    return modes


def _find_rates(world: World, law: ContactLaw, x: Floats, controls: Floats, modes: Ints) -> Rates:
    """Returns the equations of motion of states (K, 2n), each under its control (K, nu).

    What rubs on a rigid wall is held in modes, shape (K, m).
    """
    n = world.num_positions

    def yielding(x: Floats) -> tuple[Floats, Floats]:
        q, v = x[:, :n], x[:, n:]
        forces = calc_pushes(world, law, q, v)
        drag = calc_drag(world, law, q, v, forces)
        return np.hstack([v, world.calc_acceleration(q, v, controls, forces, drag)]), forces

    if not isinstance(law, RigidLaw):
        return yielding
    is_smooth = law.friction == 0
    slides = _find_resting(world, x) & is_smooth
    modes = np.where(is_smooth, np.where(slides, Mode.FORWARD, Mode.OPEN), modes)
    kinds = np.unique(modes, axis=0)

    def rigid(x: Floats) -> tuple[Floats, Floats]:
        rates, forces = yielding(x)
        for kind in kinds[(kinds != Mode.OPEN).any(axis=1)]:
            rows = np.flatnonzero((modes == kind).all(axis=1) & np.isfinite(x).all(axis=1))
            _hold(world, law.friction, kind, x, controls, rows, rates, forces)
        return rates, forces

    return rigid


def _hold(
    world: World,
    friction: Floats,
    modes: Ints,
    x: Floats,
    controls: Floats,
    rows: Ints,
    rates: Floats,
    forces: Floats,
) -> None:
    """Lets some of the states rest on contacts in modes, of these on those alone that press."""
    n, contacts = world.num_positions, np.flatnonzero(modes != Mode.OPEN)
    closed = Closed(world, contacts, tuple(map(Mode, modes[contacts])), friction[contacts])
    push = closed.calc_push(x[rows], controls[rows])
    pushes = push.normal
    presses = (pushes >= 0) | (friction[contacts] > 0)
    is_held = presses.all(axis=1)
    rates[rows[is_held], n:] = push.acceleration[is_held]
    forces[rows[is_held][:, np.newaxis], contacts] = pushes[is_held]
    for row, pressing in zip(rows[~is_held], presses[~is_held], strict=True):
        if pressing.any():
            left = modes.copy()
            left[contacts[~pressing]] = Mode.OPEN
            _hold(world, friction, left, x, controls, np.array([row]), rates, forces)


def _find_resting(world: World, x: Floats) -> Bools:
    """Returns which contacts are closed and neither approached nor left, shape (K, m)."""
    n = world.num_positions
    q, v = x[:, :n], x[:, n:]
    distances, speeds = world.calc_signed_distance(q), world.calc_contact_rate(q, v)
    still = _STILL * (1 + np.abs(x).max(axis=1, keepdims=True))
    return (np.abs(distances) <= still) & (np.abs(speeds) <= still)


def _begin_rest(world: World, ends: Floats, after: Floats) -> None:
    """Takes from velocities (K, 2n) what slow contacts lose that rest in the states after them."""
    n = world.num_positions
    finite = np.isfinite(ends).all(axis=1)
    speeds = np.zeros((len(ends), world.num_contacts))
    speeds[finite] = world.calc_contact_rate(ends[finite, :n], ends[finite, n:])
    sizes = 1 + np.abs(after).max(axis=1, keepdims=True)
    is_slow = (np.abs(speeds) > _STILL * sizes) & (np.abs(speeds) <= _SLOW * sizes)
    begins = _find_resting(world, after) & is_slow
    for row in np.flatnonzero(begins.any(axis=1)):
        q = after[row, :n]
        J = world.calc_contact_jacobian(q)[begins[row]]
        kicks = np.linalg.solve(world.calc_mass_matrix(q), J.T)
        ends[row, n:] -= kicks @ np.linalg.lstsq(J @ kicks, speeds[row, begins[row]])[0]


def _integrate(rates: Rates, x: Floats, durations: Floats, steps: int) -> tuple[Floats, Floats]:
    """Returns where states (K, 2n) are after durations (K,) [s], and what contacts gave [N s].

    Few steps may run away, to numbers that are not finite.
    """
    h = durations[:, np.newaxis] / steps
    total: Floats | float = 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(steps):
            first, a = rates(x)
            second, b = rates(x + h / 2 * first)
            third, c = rates(x + h / 2 * second)
            fourth, d = rates(x + h * third)
            x = x + h / 6 * (first + 2 * second + 2 * third + fourth)
            total = total + h / 6 * (a + 2 * b + 2 * c + d)
    return x, np.asarray(total)
