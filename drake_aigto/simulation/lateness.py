"""How far compliant walls move the end of a motion: in closed form, and simulated."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import (
    LEAST_RESTITUTION,
    ContactMotion,
    calc_delays,
    contact_delays,
)
from drake_aigto.simulation.event_driven import EventDriven
from drake_aigto.simulation.recording import HeldControl, Impact, Recording, Rest, find_impacts
from drake_aigto.simulation.rigid import calc_slide
from drake_aigto.simulation.verdict import calc_cost, explain_cost
from drake_aigto.world import Scenario, TaskCost, World

# Of a contact's duration, integrated for 1e-3 ≤ e ≤ 1: e τ(e) / τ(1) exceeds e by no more than this
# times 1 − e. At e = 0.5 it lasts 5 % longer, at 0.2 27 %.
_LINGERING = 0.07
# As a part of the path.
_MOST = 0.03
# Of restitution, by Radau's rule as `DrakeJudge` runs it.
_INTEGRATION = 4e-5


def calc_compliance_error(world: World, restitutions: Floats, recording: Recording) -> float:
    """Returns how far the end should be at most from where rigid walls lead [m].

    A contact lasts τ_i = π √(m_i/k_i). Meanwhile a rigid wall would have thrown the ball e v τ_i
    farther, and the push φ̈ would have added to its speed. So impact k displaces the ball across
    the wall, by l_i = M⁻¹ J_iᵀ (J_i M⁻¹ J_iᵀ)⁻¹ times

        δφ = −e v τ_i,    δφ̇ = −φ̈ τ_i

    and every later impact carries that on as a touch that comes later, to first order:

        flight for t    δq ← δq + t δv
        impact          δq ← P δq,  δv ← P δv − (1 + e) l_i (φ̈/v) J_i δq,    P = I − (1 + e) l_i J_i
        rest            δq ← (I − l_i J_i) δq,  δv ← (I − l_i J_i) δv

    What it is at the end is added up in size over all impacts. Elastic, that is the last speed
    times the delays: lateness stays lateness. To it comes the same of what is known less well, each
    on its own: with dissipation contacts last a little longer and the push shares in it, none
    brings restitution below 1e-3, and integration misses it by up to 4e-5,

        |δφ| ≤ 0.07 (1 − e) v τ_i,    |δφ̇| ≤ (1 − e) |φ̈| τ_i + ((1e-3 − e)₊ + 4e-5) v

    No more than three hundredths of the path is explained this way, where a touch is almost a graze
    and first order says nothing; and beside it what the speed that is kept of an impact that should
    return less than 1e-3, from 100 m/s as much as 0.1 m/s, leads to by itself until the end.

    Args:
        world: its stiffness and its contacts.
        restitutions: e of each contact, shape (m,).
        recording: its impacts and rests, its end, and how long its path is.
    """
    inertia, delays = world.constant_inertia, contact_delays(world)
    n = world.num_velocities
    end = later = recording.times[-1]
    total = kept = 0.0
    # Of the last position to (δq, δv) at `later`.
    sensitivity = np.eye(n, 2 * n)
    events: list[Impact | Rest] = [*recording.impacts, *recording.rests]
    for event in sorted(events, key=lambda event: event.time, reverse=True):
        lift, J = inertia.lifts[event.contact], inertia.jacobian[event.contact]
        sensitivity[:, n:] += (later - event.time) * sensitivity[:, :n]
        to_position, to_velocity = sensitivity[:, :n], sensitivity[:, n:]
        later = event.time
        if isinstance(event, Impact):
            e = float(restitutions[event.contact])
            known, most = _calc_offsets(event, e, delays[event.contact])
            moves = np.array([to_position @ lift, to_velocity @ lift])
            total += float(np.linalg.norm(known @ moves))
            total += float(most @ np.linalg.norm(moves, axis=1))
            way = (end - event.time) * event.speed * float(np.linalg.norm(lift))
            kept += max(0.0, LEAST_RESTITUTION - e) * way
            turn = (1 + e) * np.outer(lift, J)
            to_position = to_position - event.push / event.speed * to_velocity @ turn
            before = to_position - sensitivity[:, :n] @ turn, to_velocity - to_velocity @ turn
        else:
            stop = np.outer(lift, J)
            before = to_position - to_position @ stop, to_velocity - to_velocity @ stop
        sensitivity = np.hstack(before)
    path = np.sum(np.linalg.norm(np.diff(recording.positions, axis=0), axis=1))
    return min(total, _MOST * float(path) + kept)


def _calc_offsets(impact: Impact, e: float, delay: float) -> Floats:
    """Returns (δφ, δφ̇) of an impact of restitution e that is late by τ_i [s], shape (2, 2).

    First what is known, then the most of what is known less well (`calc_compliance_error`).
    """
    speed, push = impact.speed, impact.push
    missed = (max(0.0, LEAST_RESTITUTION - e) + _INTEGRATION) * speed + (1 - e) * abs(push) * delay
    return np.array(
        [[e * speed * delay, push * delay], [_LINGERING * (1 - e) * speed * delay, missed]]
    )


class Lateness(NamedTuple):
    """Differences that compliant walls explain at most."""

    error: float  # of the last position, its norm where it matters [m, rad]
    cost: float


def calc_lateness(world: World, scenario: Scenario, times: Floats, controls: Floats) -> Lateness:
    """Returns how far the end should be at most from where rigid walls lead, and its cost.

    `calc_compliance_error` says by how much φ and φ̇ are off after a contact which lasts τ. Where M
    or J depends on q, nothing in closed form carries that on to the end. So the rest of the motion
    on rigid walls is simulated again from there, once with what is known of the delay and once with
    what is known less well, both away from the wall: to first order the sign does not matter. By
    how much the end and the cost differ is added up in size over all impacts. No more than three
    hundredths of the path is explained this way.

    Where walls have friction, so it is for the slip velocity, which a contact changes in τ and not
    at once, to no less than the stiction speed v_s at which the plant's friction is whole. To that
    comes what a contact creeps while it should stick, at v_s at most.

    Args:
        world: its stiffness and its contacts.
        scenario: the task.
        times: of the knots, shape (N+1,) [s].
        controls: held between them, shape (N, nu) [N, N m].
    """

    def run(state: Floats, start: float) -> tuple[Recording, float]:
        """Returns what the rest of the control does from (q, v), and what that costs."""
        first = int(np.searchsorted(times, start, side="right")) - 1
        held = HeldControl(np.array([start, *times[first + 1 :]]), controls[first:])
        recording = EventDriven().simulate(world, scenario, held, (state[0], state[1]))
        return recording, calc_cost(world, scenario, held.times, held.controls, recording)[0]

    start = np.array([scenario.initial_position, scenario.initial_velocity])
    recording, _ = run(start, float(times[0]))
    rows = np.array(recording.times), np.array(recording.velocities)
    after = 1 + find_impacts(*rows, len(recording.impacts))
    error, cost, is_asked = 0.0, 0.0, TaskCost.of(world, scenario).is_asked
    for row, impact in zip(after, recording.impacts, strict=True):
        if impact.time < times[-1]:
            state = np.array([recording.positions[row], recording.velocities[row]])
            change = state[1] - recording.velocities[row - 1]
            others = _displace(world, scenario, impact, state, change)
            (rigid, price), *runs = (run(each, impact.time) for each in [state, *others])
            for other, paid in runs:
                moved = other.positions[-1] - rigid.positions[-1]
                error += float(np.linalg.norm(moved[is_asked]))
                cost += abs(paid - price)
    steps = np.diff(np.array(recording.positions)[:, is_asked], axis=0)
    path = np.sum(np.linalg.norm(steps, axis=1))
    creep = world.stiction_speed * recording.creep
    cost += explain_cost(world, scenario, recording.positions[-1], creep) if creep else 0.0
    return Lateness(min(error, _MOST * float(path)) + creep, cost)


def _displace(
    world: World, scenario: Scenario, impact: Impact, state: Floats, change: Floats
) -> list[Floats]:
    """Returns states after an impact, each off by what a compliant wall may do, shape (2, nv).

    The last one, with friction, is off by what that may do as it drags on. The impact changed v by
    `change`, shape (nv,).
    """
    i, e = impact.contact, float(world.restitutions(scenario)[impact.contact])
    motion = ContactMotion.at(world, state.ravel())
    delay, lift = calc_delays(motion, world.stiffness)[i], motion.walls.lifts[i, :-1]
    others = [state + np.outer(sizes, lift) for sizes in _calc_offsets(impact, e, delay)]
    if world.friction_coefficients(scenario)[i]:
        slip = abs(float(world.rubbing.calc_tangent_jacobian(state[0])[i] @ change))
        slide = calc_slide(world, state[0], i)
        others.append(state + np.outer((slip * delay, world.stiction_speed), slide))
    return others
