"""How far compliant walls lead astray, bounce after bounce."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.simulation.material import LEAST_RESTITUTION, contact_delays
from drake_aigto.simulation.recording import Impact, Recording, Rest
from drake_aigto.world import World

# Of a contact's duration, integrated for 1e-3 ≤ e ≤ 1: e τ(e) / τ(1) exceeds e by no more than this
# times 1 − e. At e = 0.5 it lasts 5 % longer, at 0.2 27 %.
LINGERING = 0.07
# As a part of the path.
MOST = 0.03
# Of restitution, by Radau's rule as `simulate_compliant_wall` runs it.
INTEGRATION = 4e-5


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
            e, delay = float(restitutions[event.contact]), delays[event.contact]
            total += _calc_displacement(event, e, delay, to_position @ lift, to_velocity @ lift)
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
    return min(total, MOST * float(path) + kept)


def _calc_displacement(
    impact: Impact, e: float, delay: float, by_position: Floats, by_velocity: Floats
) -> float:
    """Returns by how much an impact of restitution e, late by τ_i [s], moves the end at most [m].

    The end moves so much for each meter that the contact is apart, and for each meter a second more
    [s], shape (nv,) both.
    """
    late = delay * (e * impact.speed * by_position + impact.push * by_velocity)
    lingering = LINGERING * (1 - e) * impact.speed * delay
    missed = (max(0.0, LEAST_RESTITUTION - e) + INTEGRATION) * impact.speed
    missed += (1 - e) * abs(impact.push) * delay
    return (
        float(np.linalg.norm(late))
        + lingering * float(np.linalg.norm(by_position))
        + missed * float(np.linalg.norm(by_velocity))
    )
