"""Verdicts on motions: what they cost, and what bounds they miss."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.polynomial import legendre

from drake_aigto.arrays import Floats
from drake_aigto.simulation.recording import MotionSamples, Recording
from drake_aigto.world import Limits, Scales, Scenario, TaskCost, World

BOUNDS, HARD_GOAL = "bounds", "hard goal"
# Of a quadrature between rows: the square of a cubic has degree 6, so that it is exact.
_NODES, _WEIGHTS = legendre.leggauss(4)


def state_scales(world: World, scenario: Scenario) -> Floats:
    """Returns how much of q and v is much: 1 rad or a length, and that in T, shape (2n,)."""
    scales = Scales.of(world, scenario)
    q = np.where(world.is_hinge, 1.0, scales.length)
    return np.concatenate([q, q / scales.time])


def calc_excess(world: World, scenario: Scenario, positions: Floats, velocities: Floats) -> Floats:
    """Returns how far a motion is below and above its bounds of q and v at most, (2, 2n), ≥ 0."""
    bounds = world.bounds(scenario)
    lower, upper = np.hstack([bounds.position, bounds.velocity])
    x = np.hstack([positions, velocities])
    return np.maximum([np.max(lower - x, axis=0), np.max(x - upper, axis=0)], 0.0)


def narrow_bounds(bounds: Limits, states: Floats, excess: Floats) -> Limits:
    """Returns bounds of q and v that are within what states (K, 2n) have, less an excess (2, 2n).

    Where both ends are passed by more than all that is between, all there is left is a point.
    """
    lower, upper = np.hstack([bounds.position, bounds.velocity])
    lower = np.where(excess[0] > 0, np.maximum(lower, states.min(axis=0)) + excess[0], lower)
    upper = np.where(excess[1] > 0, np.minimum(upper, states.max(axis=0)) - excess[1], upper)
    ends = np.array([np.minimum(lower, upper), np.maximum(lower, upper)])
    position, velocity = np.split(ends, 2, axis=1)
    return dataclasses.replace(bounds, position=position, velocity=velocity)


def calc_violations(
    world: World, scenario: Scenario, positions: Floats, velocities: Floats
) -> dict[str, float]:
    """Returns by how much a motion misses its bounds, and its end a hard goal, by name.

    Each is the largest of all coordinates, in parts of `state_scales`; nothing of a plain task in a
    model without limits. Positions and velocities are shape (K, n), the start the first.
    """
    if scenario.is_plain and not world.limits.are_any:
        return {}
    bounds, units = world.bounds(scenario), state_scales(world, scenario)
    missed: dict[str, float] = {}
    if np.any(np.isfinite(np.hstack([bounds.position, bounds.velocity]))):
        excess = calc_excess(world, scenario, positions, velocities)
        missed[BOUNDS] = float(np.max(excess / units))
    if scenario.hard_goal:
        task = TaskCost.of(world, scenario)
        off = [task.goal_errors(positions[-1])]
        if scenario.goal_velocity is not None:
            off.append(velocities[-1] - task.goal_velocity)
        ends = np.concatenate(off)
        missed[HARD_GOAL] = float(np.max(np.abs(ends) / units[: len(ends)]))
    return missed


def calc_cost(
    world: World, scenario: Scenario, times: Floats, controls: Floats, recording: Recording
) -> tuple[float, float]:
    """Returns what a recorded motion costs, and how far its end is from the goal [m, rad].

    Args:
        world: that it was recorded in.
        scenario: the task.
        times: of the control's knots, shape (N+1,) [s].
        controls: held between them, shape (N, nu) [N, N m].
        recording: its last row is the end. The integral of what runs is a quadrature over its
            samples; if it has none, along the cubic between rows, exact where flight is a parabola.
    """
    end = recording.positions[-1]
    if scenario.is_plain:  # AIGTO's cost, in closed form.
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
        q, v = np.split(samples.states, 2, axis=-1)
        u = np.broadcast_to(control, (len(q), controls.shape[1]))
        cost += float(samples.weights @ task.running(samples.times, q, v, u))
    return cost, float(task.goal_error(end))


def explain_cost(world: World, scenario: Scenario, end: Floats, error: float) -> float:
    """Returns what of the cost of an end q(T) is explained if it is off by an error [m] at most."""
    if scenario.is_plain:
        goal_error = float(np.linalg.norm(end - scenario.goal_position))
        unexplained = max(0.0, goal_error - error)
        return scenario.goal_weight * (goal_error**2 - unexplained**2)
    task = TaskCost.of(world, scenario)
    missed = task.position_error(end, task.goal)
    size = float(np.sqrt(missed @ task.QT @ missed))
    explained = error * float(np.sqrt(np.linalg.eigvalsh(task.QT).max()))
    return size**2 - max(0.0, size - explained) ** 2


def sample_steps(times: Floats, states: Floats, controls: Floats) -> tuple[MotionSamples, Floats]:
    """Returns samples between the ends of steps, and the control at each.

    Args:
        times: of the ends, shape (K,) [s].
        states: (q, v) there, shape (K, 2 nv).
        controls: that led there, shape (K, nu) [N, N m].
    """
    held = controls[1:][np.diff(times) > 0]
    return sample_cubics(times, states), np.repeat(held, len(_NODES), axis=0)


def sample_cubics(times: Floats, states: Floats) -> MotionSamples:
    """Returns samples along the cubics between rows of states (q, v), shape (K, 2 nv)."""
    lasts = np.flatnonzero(np.diff(times) > 0)
    steps = np.diff(times)[lasts, np.newaxis]
    s = ((_NODES + 1) / 2)[:, np.newaxis, np.newaxis]
    (q0, v0), (q1, v1) = (np.split(states[rows], 2, axis=1) for rows in (lasts, lasts + 1))
    chord = (q1 - q0) / steps
    bend, twist = 3 * chord - 2 * v0 - v1, v0 + v1 - 2 * chord
    q = q0 + s * steps * (v0 + s * (bend + s * twist))
    v = v0 + s * (2 * bend + 3 * s * twist)
    at = times[lasts, np.newaxis] + s[..., 0].T * steps
    weights = steps / 2 * _WEIGHTS
    rows = np.concatenate([q, v], axis=-1).transpose(1, 0, 2)
    return MotionSamples(at.ravel(), weights.ravel(), rows.reshape(-1, states.shape[1]))
