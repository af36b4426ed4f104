"""Replays as trajectories, checked by integrating them again between their rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import TypeAlias

import numpy as np
import scipy  # Not scipy.optimize, which takes a tenth of a second and few need.

from drake_aigto.arrays import Floats, Ints
from drake_aigto.contact import Closed, CompliantLaw, ContactLaw, Mode, RigidLaw
from drake_aigto.planning.mechanisms.phases import is_closed
from drake_aigto.simulation import (
    FINE,
    Compliant,
    PlannedContact,
    Replay,
    find_impacts,
    replay_event_driven,
)
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import Scenario, World

# Runge-Kutta steps between two rows of a replay, where contacts neither begin nor end; more while
# gaps are above this part of the states, until steps do not cause them.
_STEPS, _MOST_STEPS, _EXACT = 32, 512, 1e-8
# Between compliant walls, the parts of an interval in which it is integrated again while it ends
# off by more than this part of the states: a graze is over within a step of the check.
_PARTS, _MOST_PARTS, _CLOSE = 8, 64, 1e-7
# Distances and speeds below this part of the largest coordinate, or 1, count as zero.
_STILL = 1e-10
# What rests is off by less than this part of them at starts of steps: farther off, it has left.
_LEFT = 1e-8

# Largest speed of a bounce as rest begins, as a part of the largest coordinate, or 1.
_SLOW = 1e-3

# States (K, 2n) → their rates of change, and the forces of contacts, shape (K, m) [N]. Within a
# step, with the forces at its start: contacts without any are open.
Rates: TypeAlias = Callable[[Floats, Floats | None], tuple[Floats, Floats]]


def trace(
    world: World, law: ContactLaw, replay: Replay, times: Floats, controls: Floats
) -> tuple[Trajectory, Floats]:
    """Returns the trajectory of a replay, and its defects of the equations of motion.

    Between compliant walls, steps of another size lead from each knot to the next. Between rigid
    ones a Runge-Kutta method of order 4 leads from each row of the replay to the next: contacts
    that rest at a row are held while they press, those with friction in the mode of the replay, and
    slow hops end as rest begins; impacts are added by `add_impulses`.

    Args:
        world: the mechanism.
        law: of contacts while they last.
        replay: of the controls.
        times: of the knots, shape (N+1,) [s].
        controls: held over each interval, shape (N, nu).

    Returns:
        The trajectory at the knots, with the mean forces between them; and the largest difference
        of (q, v) to the integration from the row before, shape (2n,).
    """
    if isinstance(law, CompliantLaw):
        return _trace_compliant(Compliant(world, law), replay, times, controls)
    is_step = np.diff(replay.times) > 0
    starts, h = replay.times[:-1][is_step], np.diff(replay.times)[is_step]
    knots = np.clip(np.searchsorted(times, starts + h / 2) - 1, 0, len(controls) - 1)
    x = np.hstack([replay.positions, replay.velocities])
    modes = _read_modes(world, replay, starts + h / 2)
    rates = find_rates(world, law, x[:-1][is_step], controls[knots], modes)
    sizes, steps = np.max(np.abs(x), axis=0), _STEPS
    while True:
        ends, pushes = integrate_rates(rates, x[:-1][is_step], h, steps)
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


def _trace_compliant(
    dynamics: Compliant, replay: Replay, times: Floats, controls: Floats
) -> tuple[Trajectory, Floats]:
    """Returns the same between compliant walls, in other steps from each knot to the next."""
    q, v = replay.states_at(times)
    x, step = np.hstack([q, v]), np.inf
    forces = np.zeros((len(controls), dynamics.world.num_contacts))
    gaps, most = np.zeros(x.shape[1]), np.maximum(_CLOSE * np.max(np.abs(x), axis=0), _STILL)
    for k, u in enumerate(np.array(controls)):
        parts, off = 1, np.full_like(most, np.inf)
        while parts <= _MOST_PARTS and not np.all(off <= most):
            end, pushes = x[k].copy(), []
            for span in pairwise(np.linspace(times[k], times[k + 1], parts + 1).tolist()):
                rows, step = dynamics.follow(end, u, span, step, FINE)
                pushes.append(dynamics.calc_mean_forces(rows))
            off, forces[k], parts = np.abs(end - x[k + 1]), np.mean(pushes, axis=0), _PARTS * parts
        gaps = np.maximum(gaps, off)
    none = np.zeros((len(times), dynamics.world.num_contacts))
    return Trajectory(times, q, v, controls, none, forces), gaps


def _read_modes(world: World, replay: Replay, times: Floats) -> Ints:
    """Returns the modes of a replay's contacts with friction at times, shape (K, m)."""
    modes = np.full((len(times), world.num_contacts), Mode.OPEN, dtype=np.int64)
    for phase in replay.contact_phases:
        lasts = (phase.start <= times) & (times <= phase.end)
        modes[lasts, phase.contact] = Mode[phase.mode.upper()]
    return modes


def find_rates(world: World, law: RigidLaw, x: Floats, controls: Floats, modes: Ints) -> Rates:
    """Returns the equations of motion of states (K, 2n), each under its control (K, nu).

    Contacts with friction are held in modes, shape (K, m).
    """
    n = world.num_positions

    def free(x: Floats) -> tuple[Floats, Floats]:
        q, v = x[:, :n], x[:, n:]
        rates = np.hstack([v, world.calc_acceleration(q, v, controls)])
        return rates, np.zeros((len(x), world.num_contacts))

    is_smooth = law.friction == 0
    slides = is_closed(world, x[:, :n], x[:, n:], _STILL) & is_smooth
    modes = np.where(is_smooth, np.where(slides, Mode.FORWARD, Mode.OPEN), modes)
    rest = np.flatnonzero((modes != Mode.OPEN).any(axis=1))

    def rigid(x: Floats, before: Floats | None) -> tuple[Floats, Floats]:
        rates, forces = free(x)
        if not len(rest):
            return rates, forces
        if before is None:
            is_left = ~is_closed(world, x[rest, :n], x[rest, n:], _LEFT)
        else:
            is_left = before[rest] == 0
        now = np.where(is_smooth & is_left, Mode.OPEN, modes[rest])
        kinds = np.unique(now, axis=0)
        for kind in kinds[(kinds != Mode.OPEN).any(axis=1)]:
            rows = rest[(now == kind).all(axis=1) & np.isfinite(x[rest]).all(axis=1)]
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
    """Lets some of the states rest on contacts in modes, while these press."""
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


def _begin_rest(world: World, ends: Floats, after: Floats) -> None:
    """Removes the speed of slow contacts from states (K, 2n) if they rest in those after them."""
    n = world.num_positions
    finite = np.isfinite(ends).all(axis=1)
    speeds = np.zeros((len(ends), world.num_contacts))
    speeds[finite] = world.calc_contact_rate(ends[finite, :n], ends[finite, n:])
    sizes = 1 + np.abs(after).max(axis=1, keepdims=True)
    is_slow = (np.abs(speeds) > _STILL * sizes) & (np.abs(speeds) <= _SLOW * sizes)
    begins = is_closed(world, after[:, :n], after[:, n:], _STILL) & is_slow
    for row in np.flatnonzero(begins.any(axis=1)):
        q = after[row, :n]
        J = world.calc_contact_jacobian(q)[begins[row]]
        kicks = np.linalg.solve(world.calc_mass_matrix(q), J.T)
        ends[row, n:] -= kicks @ np.linalg.lstsq(J @ kicks, speeds[row, begins[row]])[0]


def integrate_rates(
    rates: Rates, x: Floats, durations: Floats, steps: int
) -> tuple[Floats, Floats]:
    """Returns states (K, 2n) after durations (K,) [s], and the impulses of contacts [N s].

    With few steps, states may become infinite.
    """
    h = durations[:, np.newaxis] / steps
    total: Floats | float = 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(steps):
            first, a = rates(x, None)
            second, b = rates(x + h / 2 * first, a)
            third, c = rates(x + h / 2 * second, a)
            fourth, d = rates(x + h * third, a)
            x = x + h / 6 * (first + 2 * second + 2 * third + fourth)
            total = total + h / 6 * (a + 2 * b + 2 * c + d)
    return x, np.asarray(total)


# A bounce closer than this part of the duration is at a knot; replays do not resolve that.
_AT_KNOT = 1e-11
# A knot is moved to a bounce within this part of the shorter step beside it; otherwise one is
# added.
_NEAR_KNOT = 0.1
# How often knots are moved, at most: that moves bounces, but by the square only.
_MOST_MOVES = 12


def replay_at_knots(
    world: World, scenario: Scenario, times: Floats, controls: Floats
) -> tuple[Floats, Floats, Replay]:
    """Returns times, controls and their replay, whose bounces are at knots.

    Nearby knots are moved, and others added; controls hardly change.
    """
    replay = replay_event_driven(world, scenario, times, controls)
    for _ in range(_MOST_MOVES):
        moved = times, controls
        for bounce in replay.bounce_times:
            moved = _put_knot(*moved, bounce)
        if moved[0] is times:
            break
        times, controls = moved
        replay = replay_event_driven(world, scenario, times, controls)
    return times, controls, replay


def _put_knot(times: Floats, controls: Floats, bounce: float) -> tuple[Floats, Floats]:
    """Returns knots with one at a bounce; the same array if there is one."""
    at = int(np.clip(np.searchsorted(times, bounce), 1, len(times) - 1))
    nearest = at if times[at] - bounce < bounce - times[at - 1] else at - 1
    off = abs(times[nearest] - bounce)
    if off <= _AT_KNOT * times[-1]:
        return times, controls
    is_inside = 0 < nearest < len(times) - 1
    if is_inside and off < _NEAR_KNOT * min(np.diff(times)[nearest - 1 : nearest + 1]):
        times = times.copy()
        times[nearest] = bounce
        return times, controls
    return np.insert(times, at, bounce), np.insert(controls, at, controls[at - 1], axis=0)


def add_impulses(
    world: World, scenario: Scenario, replay: Replay, trajectory: Trajectory
) -> tuple[Trajectory, float]:
    """Returns a trajectory with a replay's impacts, which are at its knots.

    Also returns the largest error of velocities after impacts [m/s]. They have to follow from those
    before by an impulse ≥ 0 along the contact and one of at most μ times it along its tangent, and
    the contact's speed has to be returned e times, or to end where rest begins. Several contacts at
    one instant hit each other in turns: there impulses are the sums of all turns, and no contact is
    approached after the last.
    """
    impulses, missed = trajectory.impulses.copy(), 0.0
    for time, contacts, q, before, after in _list_events(replay):
        each = np.unique(contacts)
        J, e = world.calc_contact_jacobian(q)[each], world.restitutions(scenario)[each]
        friction, T = world.friction_coefficients(scenario)[each], J[:0]
        if friction.any():
            T = friction[:, np.newaxis] * world.rubbing.calc_tangent_jacobian(q)[each]
        # Along a cone's edges: impulses within it are sums of both.
        rows = np.vstack([J + T, J - T]) if len(T) else J
        kicks = np.linalg.solve(world.calc_mass_matrix(q), rows.T)
        pushes, off = scipy.optimize.nnls(kicks, after - before)
        pushes = pushes.reshape(-1, len(each)).sum(axis=0)
        knot = np.abs(trajectory.times - time).argmin()
        impulses[knot, each] += pushes
        came, went = J @ before, J @ after
        rebound = np.abs(went + e * came) if len(each) == 1 else np.maximum(-went, 0.0)
        missed = max(missed, off, float(np.max(np.minimum(rebound, np.abs(went)))))
    return replace(trajectory, impulses=impulses), missed


def with_losses(contacts: tuple[PlannedContact, ...], replay: Replay) -> tuple[PlannedContact, ...]:
    """Returns contacts with the energy ratios of a replay's impacts, which are at their knots.

    A trajectory has no impulses of friction, which change the kinetic energy, too. Contacts that
    last from the start have no impact.
    """
    seen = list(zip(replay.bounce_times, replay.bounce_contacts, strict=True))
    found = []
    for contact in contacts:
        away = [
            abs(time - contact.time) if index == contact.index else np.inf for time, index in seen
        ]
        nearest = int(np.argmin(away)) if away else 0
        is_hit = bool(away) and away[nearest] <= _AT_KNOT * replay.times[-1]
        ratio = replay.energy_ratios[nearest] if is_hit else contact.energy_ratio
        found.append(replace(contact, energy_ratio=ratio))
    return tuple(found)


def _list_events(replay: Replay) -> Iterator[tuple[float, Ints, Floats, Floats, Floats]]:
    """Yields the times of impacts, their contacts, q, and v before and after all of them."""
    contacts = np.array(replay.bounce_contacts, dtype=np.int64)
    rows = find_impacts(replay.times, replay.velocities, len(contacts))
    for time in np.unique(replay.times[rows]):
        at_once = replay.times[rows] == time
        first, last = rows[at_once][0], rows[at_once][-1] + 1
        if len(np.unique(contacts[at_once])) > 1:  # Touches too slow for impacts are among them.
            last = np.searchsorted(replay.times, time, side="right") - 1
        v = replay.velocities
        yield time, contacts[at_once], replay.positions[first], v[first], v[last]
