"""Verdicts on motions: what they cost, what bounds they miss, and what compliance explains."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import ArrayRecord, Floats, LockedArrays
from drake_aigto.contact import LEAST_RESTITUTION, ContactMotion, calc_delays
from drake_aigto.simulation.event_driven import EventDriven
from drake_aigto.simulation.recording import (
    Controller,
    Impact,
    Recording,
    find_impacts,
    sample_cubics,
)
from drake_aigto.simulation.rigid import calc_slide
from drake_aigto.world import Limits, Scales, Scenario, TaskCost, World

BOUNDS, HARD_GOAL, CLEARANCE = "bounds", "hard goal", "clearance"
EDGES = "edges that cross"
# What counts as nothing in a simulation, as a part of the task's scales: 2 mm in a task of a meter.
NOTHING = 2e-3
# Two simulators, or a robot and its model, differ by more than this part of the scales anywhere.
_UNAVOIDABLE = 1e-8
# Where errors grow by more, what the control does by itself is no property of the plan.
MOST_GROWTH = NOTHING / _UNAVOIDABLE
# Parts that a motion is divided into, at most, for the growth of errors from any one to any other.
_MOST_PARTS = 64


def state_scales(world: World, scenario: Scenario) -> Floats:
    """Returns how much of q and v is much: 1 rad or a length, and that in T, shape (nq + nv,)."""
    scales = Scales.of(world, scenario)
    q, v = (np.where(turns, 1.0, scales.length) for turns in (world.is_hinge, world.turns))
    return np.concatenate([q, v / scales.time])


def tangent_scales(world: World, scenario: Scenario) -> Floats:
    """Returns the same along changes of q and v, shape (2 nv,)."""
    scales = Scales.of(world, scenario)
    q = np.where(world.turns, 1.0, scales.length)
    return np.concatenate([q, q / scales.time])


def calc_excess(world: World, scenario: Scenario, positions: Floats, velocities: Floats) -> Floats:
    """Returns how far a motion is below and above its bounds of q and v at most, (2, 2n), ≥ 0."""
    bounds = world.bounds(scenario)
    lower, upper = np.hstack([bounds.position, bounds.velocity])
    x = np.hstack([positions, velocities])
    return np.maximum([np.max(lower - x, axis=0), np.max(x - upper, axis=0)], 0.0)


def calc_lacks(world: World, scenario: Scenario, positions: Floats) -> Floats:
    """Returns by how much φ of contacts falls below the scenario's least at most, shape (m,).

    Corners of solids lack what these do, whose edges may be nearer to each other.
    """
    lacks = world.least_distances(scenario) - world.calc_gaps(np.array(positions))
    return np.asarray(np.max(lacks, axis=0).clip(min=0.0))


def calc_edge_overlap(world: World, positions: Floats) -> float:
    """Returns how much deeper solids overlap than their corners, at most [m]: edges cross."""
    q = np.array(positions)
    depths = np.maximum(0.0, -world.calc_signed_distance(q))
    of_corners = [np.max(depths[:, numbers], axis=1) for numbers in world.solid_corners]
    beyond = -world.calc_solid_distances(q).T - np.array(of_corners)
    return float(np.max(beyond, initial=0.0))


def narrow_bounds(bounds: Limits, states: Floats, excess: Floats) -> Limits:
    """Returns bounds of q and v that are within what states (K, 2n) have, less an excess (2, 2n).

    Where both ends are passed by more than all that is between, all there is left is a point.
    """
    lower, upper = np.hstack([bounds.position, bounds.velocity])
    lower = np.where(excess[0] > 0, np.maximum(lower, states.min(axis=0)) + excess[0], lower)
    upper = np.where(excess[1] > 0, np.minimum(upper, states.max(axis=0)) - excess[1], upper)
    ends = np.array([np.minimum(lower, upper), np.maximum(lower, upper)])
    position, velocity = np.split(ends, [bounds.position.shape[1]], axis=1)
    return dataclasses.replace(bounds, position=position, velocity=velocity)


@dataclass(frozen=True, eq=False)
class Growth(LockedArrays, ArrayRecord):
    """Growth of errors along a motion.

    Attributes:
        factor: from any time to any later one, at most, in units of the scales.
        worst: the error of q and v at the start that grows most, of size 1 in these, shape (2n,).
    """

    factor: float
    worst: Floats


def calc_growth(transitions: Floats, scales: Floats, least: float = 1.0) -> Growth:
    """Returns how much errors of a motion grow in units of scales.

        max over s ≤ t of σ_max(S⁻¹ Φ(t, s) S),    Φ(t, s) = F_{t−1} ⋯ F_s,    S = diag(scales)

    Args:
        transitions: F_k, shape (K, 2n, 2n).
        scales: of q and v, shape (2n,) (`state_scales`).
        least: if it is more than 1, only whether errors grow by more is found: the factor is this
            one then, or some larger one.
    """
    size, K = len(scales), len(transitions)
    growth, most, worst = least, least if least > 1 else 0.0, np.eye(size)[0]
    products = np.empty((0, size, size))  # From the starts of all parts so far to now.
    with np.errstate(all="ignore"):
        scaled = transitions * scales / scales[:, np.newaxis]
        for part in np.array_split(scaled, min(K, _MOST_PARTS)):
            step = functools.reduce(lambda product, F: F @ product, part)
            products = step @ np.concatenate([products, np.eye(size)[np.newaxis]])
            if not np.isfinite(products).all():
                return Growth(np.inf, worst * scales)
            # Frobenius norms, which take far less, are no smaller than singular values.
            floors = np.array([most, *np.full(len(products) - 1, growth)])
            rows = np.flatnonzero(np.linalg.norm(products, axis=(1, 2)) >= floors)
            if not len(rows):
                continue
            _, sizes, axes = np.linalg.svd(products[rows])
            growth = max(growth, float(sizes[:, 0].max()))
            if rows[0] == 0 and sizes[0, 0] > most:
                most, worst = float(sizes[0, 0]), axes[0, 0]
            if growth > least > 1:
                break
    return Growth(growth, worst * scales)


def calc_violations(
    world: World, scenario: Scenario, positions: Floats, velocities: Floats
) -> dict[str, float]:
    """Returns by how much a motion misses bounds and clearances, and its end a hard goal, by name.

    Each is the largest of all coordinates, in parts of `state_scales`, or of all pairs, in parts of
    the task's length; nothing of a plain task in a model without limits. Solids that meet by their
    corners miss what their edges overlap beyond that. Positions and velocities are shape (K, n),
    the start the first.
    """
    missed: dict[str, float] = {}
    if world.solid_corners:
        missed[EDGES] = calc_edge_overlap(world, positions) / Scales.of(world, scenario).length
    if scenario.is_plain and not world.limits.are_any:
        return missed
    bounds, units = world.bounds(scenario), state_scales(world, scenario)
    if np.any(np.isfinite(np.hstack([bounds.position, bounds.velocity]))):
        excess = calc_excess(world, scenario, positions, velocities)
        missed[BOUNDS] = float(np.max(excess / units))
    if scenario.clearance:
        lacks = calc_lacks(world, scenario, positions)
        missed[CLEARANCE] = float(np.max(lacks)) / Scales.of(world, scenario).length
    if scenario.hard_goal:
        off, n = calc_misses(world, scenario, positions[-1], velocities[-1]), world.num_velocities
        sizes = np.concatenate([units[-n:] * scenario.duration, units[-n:]])
        missed[HARD_GOAL] = float(np.max(np.abs(off) / sizes))
    return missed


def calc_misses(world: World, scenario: Scenario, q: Floats, v: Floats) -> Floats:
    """Returns how far an end is beside a hard goal, shape (2n,), 0 of speeds without a goal."""
    task = TaskCost.of(world, scenario)
    speeds = 0 * v if scenario.goal_velocity is None else v - task.goal_velocity
    return np.concatenate([task.goal_errors(q), speeds])


def calc_cost(
    world: World, scenario: Scenario, times: Floats, controls: Floats, recording: Recording
) -> tuple[float, float]:
    """Returns what a recorded motion costs, and how far its end is from the goal [m, rad].

    Controls (N, nu) are held between times (N+1,). The last row is the end. The integral of what
    runs is a quadrature over samples; if there are none, along the cubic between rows, exact where
    flight is a parabola.
    """
    end = recording.positions[-1]
    if scenario.is_plain and world.num_positions == world.num_velocities:  # In closed form.
        effort = float(np.diff(times) @ np.sum(controls**2, axis=1))
        goal_error = float(np.linalg.norm(end - scenario.goal_position))
        cost = scenario.control_weight * effort + scenario.goal_weight * goal_error**2
        return cost, goal_error
    task = TaskCost.of(world, scenario)
    cost = float(task.final(end, recording.velocities[-1]))
    sampled = recording.samples
    if not sampled:  # Between rows, with the control at each sample.
        states = np.hstack([recording.positions, recording.velocities])
        samples = sample_cubics(np.array(recording.times), states)
        held = np.searchsorted(times, samples.times, side="right") - 1
        sampled = [(samples, controls[held])]
    for samples, control in sampled:
        q, v = np.split(samples.states, [world.num_positions], axis=-1)
        u = np.broadcast_to(control, (len(q), controls.shape[1]))
        cost += float(samples.weights @ task.running(samples.times, q, v, u))
    return cost, float(task.goal_error(end))


def explain_cost(world: World, scenario: Scenario, end: Floats, error: float) -> float:
    """Returns what of the cost of an end q(T) is explained if it is off by an error [m] at most."""
    if scenario.is_plain:  # One weight counts for sliders and hinges alike there.
        goal_error = float(np.linalg.norm(end - scenario.goal_position))
        unexplained = max(0.0, goal_error - error)
        return scenario.goal_weight * (goal_error**2 - unexplained**2)
    task = TaskCost.of(world, scenario)
    missed = task.position_error(end, task.goal)
    size = float(np.sqrt(missed @ task.QT @ missed))
    explained = error * float(np.sqrt(np.linalg.eigvalsh(task.QT).max()))
    return size**2 - max(0.0, size - explained) ** 2


# Of a contact's duration, integrated for 1e-3 ≤ e ≤ 1: e τ(e) / τ(1) exceeds e by no more than this
# times 1 − e. At e = 0.5 it lasts 5 % longer, at 0.2 27 %.
_LINGERING = 0.07
# As a part of the path.
_MOST = 0.03
# Of restitution, by Radau's rule as `DrakeJudge` runs it.
_INTEGRATION = 4e-5


def _calc_offsets(impact: Impact, e: float, delay: float) -> Floats:
    """Returns (δφ, δφ̇) of an impact of restitution e that is late by τ_i [s], shape (2, 2).

    First what is known, then the most of what is known less well (`calc_lateness`).
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


def calc_lateness(world: World, scenario: Scenario, controller: Controller) -> Lateness:
    """Returns how far the end should be at most from where rigid walls lead, and its cost.

    A contact lasts τ_i = π √(m_i/k_i). Meanwhile a rigid wall would have thrown the bodies e v τ_i
    farther, and the push φ̈ would have added to their speed. So an impact displaces them across the
    wall, along l_i = M⁻¹ J_iᵀ (J_i M⁻¹ J_iᵀ)⁻¹, by

        δφ = e v τ_i,    δφ̇ = φ̈ τ_i

    To it comes what is known less well: with dissipation contacts last a little longer and the push
    shares in it, none brings restitution below 1e-3, and integration misses it by up to 4e-5,

        |δφ| ≤ 0.07 (1 − e) v τ_i,    |δφ̇| ≤ (1 − e) |φ̈| τ_i + ((1e-3 − e)₊ + 4e-5) v

    The rest of the motion on rigid walls is simulated again from there, once with each, both away
    from the wall: to first order the sign does not matter. By how much the end and the cost differ
    is added up in size over all impacts. No more than three hundredths of the path is explained
    this way, where a touch is almost a graze and first order says nothing; and beside it what the
    speed that is kept of an impact that should return less than 1e-3, from 100 m/s as much as
    0.1 m/s, leads to by itself until the end.

    Where walls have friction, so it is for the slip velocity, which a contact changes in τ and not
    at once, to no less than the stiction speed v_s at which the plant's friction is whole. To that
    comes what a contact creeps while it should stick, at v_s at most.
    """

    def run(state: Floats, start: float, bounces: Sequence[int]) -> tuple[Recording, float]:
        """Returns what the rest of the control does from (q, v), and what that costs."""
        later = controller.since(start, bounces)
        recording = EventDriven().simulate(world, scenario, later, (state[0], state[1]))
        held = np.append(recording.control_times, later.end), np.array(recording.controls)
        return recording, calc_cost(world, scenario, *held, recording)[0]

    start = np.array([scenario.initial_position, scenario.initial_velocity])
    recording, _ = run(start, controller.start, [])
    rows = np.array(recording.times), np.array(recording.velocities)
    after = 1 + find_impacts(*rows, len(recording.impacts))
    error = cost = kept = 0.0
    is_asked = TaskCost.of(world, scenario).is_asked
    for count, (row, impact) in enumerate(zip(after, recording.impacts, strict=True), 1):
        if impact.time < controller.end:
            state = np.array([recording.positions[row], recording.velocities[row]])
            change = state[1] - recording.velocities[row - 1]
            others, speed = _displace(world, scenario, impact, state, change)
            kept += speed * (controller.end - impact.time)
            bounces = recording.bounces[:count]
            (rigid, price), *runs = (run(each, impact.time, bounces) for each in [state, *others])
            for other, paid in runs:
                moved = other.positions[-1] - rigid.positions[-1]
                error += float(np.linalg.norm(moved[is_asked]))
                cost += abs(paid - price)
    steps = np.diff(np.array(recording.positions)[:, is_asked], axis=0)
    path = np.sum(np.linalg.norm(steps, axis=1))
    creep = world.stiction_speed * recording.creep
    cost += explain_cost(world, scenario, recording.positions[-1], creep) if creep else 0.0
    return Lateness(min(error, _MOST * float(path) + kept) + creep, cost)


def _displace(
    world: World, scenario: Scenario, impact: Impact, state: Floats, change: Floats
) -> tuple[list[Floats], float]:
    """Returns states after an impact, each off by what a compliant wall may do, shape (2, nv).

    The last one, with friction, is off by what that may do as it drags on. The impact changed v by
    `change`, shape (nv,). To these comes the speed that no dissipation takes [m/s].
    """
    i, e = impact.contact, float(world.restitutions(scenario)[impact.contact])
    motion = ContactMotion.at(world, state.ravel())
    delay, lift = calc_delays(motion, world.stiffness)[i], motion.walls.lifts[i, :-1]
    others = [state + np.outer(sizes, lift) for sizes in _calc_offsets(impact, e, delay)]
    if world.friction_coefficients(scenario)[i]:
        slip = abs(float(world.rubbing.calc_tangent_jacobian(state[0])[i] @ change))
        slide = calc_slide(world, state[0], i)
        others.append(state + np.outer((slip * delay, world.stiction_speed), slide))
    kept = max(0.0, LEAST_RESTITUTION - e) * impact.speed * float(np.linalg.norm(lift))
    return others, kept
