"""Plans of a ball that spins between rigid walls with friction."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from rubbing_worlds import make_discs
from shooting_problems import pose, weigh

from drake_aigto import Plan, PlanOptions, Scenario, World, plan
from drake_aigto.arrays import Floats
from drake_aigto.contact import Mobility, RigidLaw, calc_impulse
from drake_aigto.errors import ProgramError
from drake_aigto.planning import RigidMechanismTask, make_mechanism_task
from drake_aigto.shooting import (
    Mechanism,
    Phases,
    ShootingProblem,
)
from drake_aigto.show import motions_of_plan, plot_friction
from drake_aigto.transcription import Touch

RESTITUTION, FRICTION = 0.6, 0.5
# When what is about to hit does, in problems that last so long [s].
SOON, BRIEFLY = 1e-6, 1e-3


@cache
def tilted() -> World:
    """Returns a disc over a board on a hinge, where M and b depend on q."""
    return World.from_diagram(make_discs(tilts=True))


def hit(state: Floats, mode: int) -> ShootingProblem:
    """Returns a problem of a touch right after the start."""
    world = tilted()
    n, nu, m = world.num_positions, world.num_actuators, world.num_contacts
    phases = Phases(
        np.zeros(1, dtype=np.int64),
        np.array([1]),
        np.array([SOON, BRIEFLY - SOON]),
        (BRIEFLY, BRIEFLY),
        modes=np.array([[0] * m, [mode] * m]),
    )
    mechanism = Mechanism.of(world, RigidLaw(np.full(m, RESTITUTION), np.full(m, FRICTION)))
    times = np.array([0.0, SOON, BRIEFLY])
    return pose(mechanism, weigh(np.zeros(n), np.ones(nu)), state, times=times, phases=phases)


def draw(seed: int) -> tuple[Floats, Mobility, float, float]:
    """Returns a state on the wall, and what its impact is about."""
    world, rng = tilted(), np.random.default_rng(seed)
    q, v = rng.normal(size=world.num_positions), rng.normal(size=world.num_positions)
    q[3] = 0.2 * q[3]
    for _ in range(10):
        J = world.calc_contact_jacobian(q)
        q -= np.linalg.pinv(J) @ world.calc_signed_distance(q)
    J, T = world.calc_contact_jacobian(q)[0], world.rubbing.calc_tangent_jacobian(q)[0]
    v *= -np.sign(J @ v)
    mobility = Mobility.of(J, T, world.calc_mass_matrix(q))
    return np.concatenate([q, v]), mobility, float(J @ v), float(T @ v)


def is_newtons(mobility: Mobility, rate: float, slip: float) -> bool:
    """Returns whether Routh's impact returns e of the speed, and slip that it has does not turn."""
    p = calc_impulse(mobility, rate, slip, RESTITUTION, FRICTION)
    returned = rate + mobility.a * p.normal + mobility.b * p.tangent
    turns = abs(p.mode) == 1 and p.mode * slip < 0
    return not turns and returned == pytest.approx(-RESTITUTION * rate, rel=1e-9)


def test_impacts_of_phases_are_rouths_in_the_mode_that_they_end_in_and_in_no_other() -> None:
    world, seen = tilted(), set()
    n = world.num_positions
    for seed in range(40):
        state, mobility, rate, slip = draw(seed)
        if not is_newtons(mobility, rate, slip):
            continue
        p = calc_impulse(mobility, rate, slip, RESTITUTION, FRICTION)
        J = world.calc_contact_jacobian(state[:n])[0]
        T = world.rubbing.calc_tangent_jacobian(state[:n])[0]
        M = world.calc_mass_matrix(state[:n])
        after = state[n:] + np.linalg.solve(M, J * p.normal + T * p.tangent)
        none = np.zeros((2, world.num_actuators))
        motions = {mode: hit(state, mode).simulate(none, 1) for mode in (-1, 0, 1)}
        np.testing.assert_allclose(motions[int(p.mode)].states[1, n:], after, atol=1e-3)
        # Elsewhere Coulomb's cone is left, or slip turns round.
        assert min(motions, key=lambda mode: motions[mode].violation) == p.mode
        assert motions[int(p.mode)].violation < 1e-3
        seen.add(int(p.mode))
    assert seen == {-1, 0, 1}


def test_modes_that_are_no_signs_are_refused() -> None:
    one = np.ones(1, dtype=np.int64)
    with pytest.raises(ProgramError, match=r"(?s)phases: modes: got .* expected −1, 0 or 1"):
        Phases(0 * one, one, np.ones(2), (1.0, 1.0), modes=np.full((2, 1), 2))


BRIEF = PlanOptions(starts=3, renewals=0)


@cache
def shot(friction: float | None = None) -> Plan:
    """Returns the plan of the shipped shot."""
    scenario = dataclasses.replace(Scenario.named("billiard/spin_shot"), friction=friction)
    return plan(scenario, BRIEF)


@pytest.mark.slow
def test_a_shot_with_spin_costs_less_than_any_without_friction_and_holds_in_both_replays() -> None:
    rough, smooth = shot(), shot(0.0)
    drake = rough.replay.drake
    assert drake is not None
    assert rough.holds
    assert drake.cost == pytest.approx(rough.cost, rel=1e-2)
    assert rough.replay.event_driven.cost == pytest.approx(rough.cost, rel=1e-6)
    assert rough.cost < 0.9 * smooth.cost
    assert max(rough.best.defects.values()) < 1e-9
    assert rough.best.energy_ratio == pytest.approx(rough.replay.event_driven.energy_ratio)


@cache
def problem() -> RigidMechanismTask:
    scenario = Scenario.named("billiard/spin_shot")
    found = make_mechanism_task(World.from_scenario(scenario), scenario, BRIEF)
    assert isinstance(found, RigidMechanismTask)
    return found


def test_a_figure_has_the_impulse_of_an_impact_that_sticks_at_the_edge_of_its_cone() -> None:
    rough = shot()
    world, motion = rough.find_world(), motions_of_plan(rough)[0]
    plot_friction(axes := Figure().subplots(), motion, world, rough.scenario)
    (bar,) = axes.patches
    (mark,) = (line for line in axes.lines if line.get_marker() == "o")
    assert isinstance(bar, Rectangle)
    most = 0.3 * np.max(rough.trajectory.impulses)
    assert bar.get_height() == pytest.approx(2 * most, rel=1e-6)
    assert 2 * abs(np.asarray(mark.get_ydata())[0]) == pytest.approx(bar.get_height(), rel=1e-3)


def test_an_impact_at_the_edge_of_its_mode_is_led_to_the_best_from_every_mode() -> None:
    of = problem()
    costs = []
    for mode in (-1, 0, 1):
        touches: tuple[Touch, ...] = tuple(
            dataclasses.replace(touch, mode=mode) for touch in of.coasting[:1]
        )
        costs.append(of.bounce(touches, of.idle_motion).cost)
    np.testing.assert_allclose(costs, min(costs), rtol=1e-3)
