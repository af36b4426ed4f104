"""How far compliant walls lead a mechanism astray: impacts that are late, simulated."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.simulation.compliance import INTEGRATION, LINGERING, MOST
from drake_aigto.simulation.contact_motion import ContactMotion
from drake_aigto.simulation.controller import HeldControl
from drake_aigto.simulation.costs import calc_cost, explain_cost
from drake_aigto.simulation.material import LEAST_RESTITUTION, calc_delays
from drake_aigto.simulation.recording import Impact, Recording, find_impacts
from drake_aigto.simulation.rubbing_mechanism import calc_slide, simulate_rigid_walls
from drake_aigto.world import Scenario, TaskCost, World


class Lateness(NamedTuple):
    """What compliant walls explain at most."""

    error: float  # of the last position, its norm where it matters [m, rad]
    cost: float


class _Control(NamedTuple):
    """What is replayed."""

    world: World
    scenario: Scenario
    times: Floats  # shape (N+1,) [s]
    controls: Floats  # shape (N, nu) [N, N m]

    def run(self, state: tuple[Floats, Floats], start: float) -> tuple[Recording, float]:
        """Returns what the rest of the control does from a state, and what that costs."""
        first = int(np.searchsorted(self.times, start, side="right")) - 1
        times, controls = np.array([start, *self.times[first + 1 :]]), self.controls[first:]
        held = HeldControl(times, controls)
        recording = simulate_rigid_walls(self.world, self.scenario, state, held)
        return recording, calc_cost(self.world, self.scenario, times, controls, recording)[0]


def calc_lateness(world: World, scenario: Scenario, times: Floats, controls: Floats) -> Lateness:
    """Returns how far the end should be at most from where rigid walls lead, and its cost.

    `calc_compliance_error` says by how much φ and φ̇ are off after a contact which lasts τ. Where M
    or J depends on q, nothing in closed form carries that on to the end. So the rest of the motion
    on rigid walls is simulated again from there, once with what is known of the delay and once with
    what is known less well, both away from the wall: to first order the sign does not matter. By
    how much the end and the cost differ is added up in size over all impacts. No more than three
    hundredths of the path is explained this way.

    Where walls rub, so it is for the slip velocity, which a contact changes in τ and not at once,
    to no less than the stiction speed v_s at which the plant's friction is whole. To that comes
    what a contact creeps while it should stick, at v_s at most.

    Args:
        world: its stiffness and its contacts.
        scenario: the task.
        times: of the knots, shape (N+1,) [s].
        controls: held between them, shape (N, nu) [N, N m].
    """
    control = _Control(world, scenario, times, controls)
    start = scenario.initial_position, scenario.initial_velocity
    recording, _ = control.run(start, float(times[0]))
    rows = np.array(recording.times), np.array(recording.velocities)
    after = 1 + find_impacts(*rows, len(recording.impacts))
    error, cost, is_asked = 0.0, 0.0, TaskCost.of(world, scenario).is_asked
    for row, impact in zip(after, recording.impacts, strict=True):
        if impact.time < times[-1]:
            state = np.array([recording.positions[row], recording.velocities[row]])
            change = state[1] - recording.velocities[row - 1]
            others = _displace(world, scenario, impact, state)
            others += _drag(world, scenario, impact, state, change)
            (rigid, price), *runs = (control.run((q, v), impact.time) for q, v in [state, *others])
            for other, paid in runs:
                moved = other.positions[-1] - rigid.positions[-1]
                error += float(np.linalg.norm(moved[is_asked]))
                cost += abs(paid - price)
    steps = np.diff(np.array(recording.positions)[:, is_asked], axis=0)
    path = np.sum(np.linalg.norm(steps, axis=1))
    creep = world.stiction_speed * recording.creep
    cost += explain_cost(world, scenario, recording.positions[-1], creep) if creep else 0.0
    return Lateness(min(error, MOST * float(path)) + creep, cost)


def _displace(world: World, scenario: Scenario, impact: Impact, state: Floats) -> list[Floats]:
    """Returns states after an impact, each off by what a compliant wall may do, shape (2, nv)."""
    i, e = impact.contact, float(world.restitutions(scenario)[impact.contact])
    motion = ContactMotion.at(world, state.ravel())
    delay, lift = calc_delays(motion, world.stiffness)[i], motion.walls.lifts[i, :-1]
    missed = (max(0.0, LEAST_RESTITUTION - e) + INTEGRATION) * impact.speed
    known = e * impact.speed * delay, impact.push * delay
    unknown = (
        LINGERING * (1 - e) * impact.speed * delay,
        missed + (1 - e) * abs(impact.push) * delay,
    )
    return [state + np.outer(sizes, lift) for sizes in (known, unknown)]


def _drag(
    world: World, scenario: Scenario, impact: Impact, state: Floats, change: Floats
) -> list[Floats]:
    """Returns a state after an impact with friction that drags on, off by what that may do.

    The impact changed v by so much, shape (nv,).
    """
    i, (q, _) = impact.contact, state
    if not world.friction_coefficients(scenario)[i]:
        return []
    delay = calc_delays(ContactMotion.at(world, state.ravel()), world.stiffness)[i]
    slip = abs(float(world.rubbing.calc_tangent_jacobian(q)[i] @ change))
    return [state + np.outer((slip * delay, world.stiction_speed), calc_slide(world, q, i))]
