"""How far compliant walls lead astray, bounce after bounce."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from drake_aigto.planning.contact_motion import ContactMotion
from drake_aigto.planning.material import LEAST_RESTITUTION, contact_delays

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from drake_aigto.planning.recording import Impact
    from drake_aigto.world import World

# Of a contact's duration, integrated for 1e-3 ≤ e ≤ 1: e τ(e) / τ(1) exceeds e by no more than this
# times 1 − e. At e = 0.5 it lasts 5 % longer, at 0.2 27 %.
_LINGERING = 0.07
# Of restitution, by Radau's rule as `simulate_compliant_wall` runs it.
_INTEGRATION = 4e-5


def calc_compliance_error(
    world: World, restitutions: npt.NDArray[np.float64], impacts: Sequence[Impact], end: float
) -> float:
    """Returns how far the end should be at most from where rigid walls lead [m].

    A contact lasts τ_i = π √(m_i/k_i). Meanwhile a rigid wall would have thrown the ball e v τ_i
    farther, and the push φ̈ would have added to its speed. So impact k displaces the ball across
    the wall, by l_i = M⁻¹ J_iᵀ (J_i M⁻¹ J_iᵀ)⁻¹ times

        δφ = −e v τ_i,    δφ̇ = −φ̈ τ_i

    and every later impact carries that on as a touch that comes later, to first order:

        flight for t    δq ← δq + t δv
        impact          δq ← P δq,  δv ← P δv − (1 + e) l_i (φ̈/v) J_i δq,    P = I − (1 + e) l_i J_i

    What it is at the end is added up in size over all impacts. Elastic, that is the last speed
    times the delays: lateness stays lateness. To it comes the same of what is known less well, each
    on its own: with dissipation contacts last a little longer and the push shares in it, none
    brings restitution below 1e-3, and integration misses it by up to 4e-5,

        |δφ| ≤ 0.07 (1 − e) v τ_i,    |δφ̇| ≤ (1 − e) |φ̈| τ_i + ((1e-3 − e)₊ + 4e-5) v

    Args:
        world: its stiffness and its contacts.
        restitutions: e of each contact, shape (m,).
        impacts: in the order of time.
        end: of the motion, T [s].
    """
    motion, delays = ContactMotion(world), contact_delays(world)
    n = world.num_velocities
    total, later = 0.0, end
    # Of the last position to (δq, δv) at `later`.
    sensitivity = np.eye(n, 2 * n)
    for impact in reversed(impacts):
        e, delay = float(restitutions[impact.contact]), delays[impact.contact]
        lift, J = motion.lifts[impact.contact], motion.jacobian[impact.contact]
        sensitivity[:, n:] += (later - impact.time) * sensitivity[:, :n]
        to_position, to_velocity = sensitivity[:, :n], sensitivity[:, n:]
        by_position, by_velocity = to_position @ lift, to_velocity @ lift
        late = delay * (e * impact.speed * by_position + impact.push * by_velocity)
        lingering = _LINGERING * (1 - e) * impact.speed * delay
        missed = (max(0.0, LEAST_RESTITUTION - e) + _INTEGRATION) * impact.speed
        missed += (1 - e) * abs(impact.push) * delay
        total += float(np.linalg.norm(late)) + lingering * float(np.linalg.norm(by_position))
        total += missed * float(np.linalg.norm(by_velocity))
        turn = (1 + e) * np.outer(lift, J)
        delayed = impact.push / impact.speed * to_velocity @ turn
        before = to_position - to_position @ turn - delayed, to_velocity - to_velocity @ turn
        sensitivity, later = np.hstack(before), impact.time
    return total
