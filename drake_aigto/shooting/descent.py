"""Differential dynamic programming on a motion that need not be a roll-out."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.jit import borrow, inner, kernel, pasted
from drake_aigto.shooting.bounds import add_bounds
from drake_aigto.shooting.controls import clip_control
from drake_aigto.shooting.flow import flow, measure_end
from drake_aigto.shooting.jump import jump
from drake_aigto.shooting.sweep import sweep_back
from drake_aigto.shooting.tables import FLOW, Memory, Program

# A step must keep this share of the fall that the expansion promises (Armijo).
_SHARE = 1e-4
# A step that closes gaps may raise the cost this much, times its size, gain included; and below
# this step length closing a gap is worth any cost.
_RISE, _SHORT = 3.0, 0.2
# The same of a wary descent, where motions diverge as soon as they are let go.
_WARY_RISE, _WARY_SHORT = 0.3, 0.0
# Damping, a share of curvature: where it starts, grows to at least and by, and gives up.
_DAMPING, _LEAST, _GROWTH, _MOST = 1e-6, 1e-2, 10.0, 1e3
# Step lengths that are tried: 1, 1/2, ….
_LENGTHS = 5
# Iterations in a row that gain less than the tolerance and end it.
_PATIENCE = 3
# What costs more than is asked for, after so many times the fall that the expansion promises, is
# left. Of 3,072 boxes around cart-poles between soft walls, whose motions are to be better than the
# eighth of those known, that saves 37 % of all iterations; 13 of 346 that would have been better
# than the best one are lost. At 8 times it is 31 % and 9, at 4 times 45 % and 20.
_FALLS = 6.0


# What `_travel` does besides going through the stages.
_FOLLOW, _EXPAND, _ROLL = range(3)


@inner
def _travel(
    program: Program,
    states: Floats,
    controls: Floats,
    mode: int,
    length: float,
    eps: float,
    most: float,
    memory: Memory,
) -> float:
    """Goes through all stages, and returns what they cost with the end; infinite above `most`.

    _ROLL computes the states after the first one, _EXPAND the problem to second order about a
    motion, and _FOLLOW a trial that obeys the control law with a step length α, of which gaps
    shrink likewise: z_{k+1} = f(z_k, u_k) − (1 − α) gap_k.
    """
    code, numbers, _, actuation, contacts, solids, rubs = program.mechanics
    effort, running, final, errors_of, goal, times, reference = program.task
    room, points, by_column, by_start = memory.flow
    values, sums, factor, force, rub, acceleration, slopes, support, grip, by_force = room
    F, l1, l2, gaps = memory.expansion
    feedforward, gains = memory.sweep.feedforward, memory.sweep.gains
    lower, upper = program.bounds.lower_control, program.bounds.upper_control
    kinds, shares, starts, norm = program.kinds, program.steps, program.times, program.bounds.norm
    trial_states, trial_controls, nz = memory.states, memory.controls, states.shape[1]
    K, nu, cost = controls.shape[0], effort.size, 0.0
    for i in range(nz):
        trial_states[0, i] = states[0, i]
    for k in range(K):
        z, u, after = states[k], controls[k], states[k + 1]
        size = nu if kinds[k] == FLOW else 1
        if mode == _FOLLOW:
            z, u, after = trial_states[k], trial_controls[k], trial_states[k + 1]
            for i in range(size):
                u[i] = controls[k, i] + length * feedforward[k, i]
                for j in range(nz):
                    u[i] += gains[k, i, j] * (z[j] - states[k, j])
            clip_control(size, u, lower[k], upper[k], norm if kinds[k] == FLOW else np.inf)
        elif mode == _EXPAND:
            after = trial_states[k + 1]
        if kinds[k] != FLOW:
            jump(
                code,
                numbers,
                rubs,
                program.closed[k],
                program.leans[k],
                program.restitutions[k],
                points.shape[1],
                z,
                u[0],
                mode == _EXPAND,
                values,
                sums,
                factor,
                slopes,
                support,
                grip,
                by_force,
                after,
                F[k],
                l1[k],
                l2[k],
            )
        else:
            cost += flow(
                code,
                numbers,
                actuation,
                contacts,
                solids,
                rubs,
                effort,
                running,
                errors_of,
                times,
                reference,
                starts[k],
                shares[k],
                program.substeps,
                program.method,
                program.closed[k],
                program.leans[k],
                z,
                u,
                eps,
                mode == _EXPAND,
                values,
                sums,
                factor,
                force,
                rub,
                acceleration,
                slopes,
                support,
                grip,
                by_force,
                points,
                by_column,
                by_start,
                after,
                F[k],
                l1[k],
                l2[k],
            )
        if mode == _FOLLOW:
            for i in range(nz):
                after[i] -= (1 - length) * gaps[k, i]
        elif mode == _EXPAND:
            for i in range(nz):
                gaps[k, i] = after[i] - states[k + 1, i]
        if not cost <= most:
            return np.inf
    z = trial_states[K] if mode == _FOLLOW else states[K]
    return cost + measure_end(errors_of, final, goal, z, mode == _EXPAND, points[4:], l1[K], l2[K])


@inner
def _copy(source: Floats, target: Floats) -> None:
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]


@kernel
def clip_controls(program: Program, controls: Floats) -> None:
    """Moves controls into their bounds."""
    for k in range(controls.shape[0]):
        is_flow = program.kinds[k] == FLOW
        size = program.task.control.size if is_flow else 1
        norm = program.bounds.norm if is_flow else np.inf
        low, high = program.bounds.lower_control[k], program.bounds.upper_control[k]
        clip_control(size, controls[k], low, high, norm)


@pasted
def _expand(
    program: Program, states: Floats, controls: Floats, eps: float, penalty: float, memory: Memory
) -> float:
    """Computes the problem to second order about a motion, and returns its cost."""
    cost = _travel(program, states, controls, _EXPAND, 0.0, eps, np.inf, memory)
    return cost + add_bounds(program, states, controls, penalty, True, memory)


@pasted
def _march(
    program: Program,
    states: Floats,
    controls: Floats,
    length: float,
    eps: float,
    penalty: float,
    most: float,
    memory: Memory,
) -> float:
    """Follows the control law with a step length; returns the cost, infinite above `most`."""
    cost = _travel(program, states, controls, _FOLLOW, length, eps, most, memory)
    if cost < np.inf:
        cost += add_bounds(program, memory.states, memory.controls, penalty, False, memory)
    return cost if cost <= most else np.inf


@pasted
def _search(
    program: Program,
    states: Floats,
    controls: Floats,
    eps: float,
    penalty: float,
    cost: float,
    drop: float,
    has_gaps: bool,
    is_wary: bool,
    memory: Memory,
) -> float:
    """Returns the first step length that is good enough, 0 if none is."""
    length = 1.0
    rise, short = (_WARY_RISE, _WARY_SHORT) if is_wary else (_RISE, _SHORT)
    for _ in range(_LENGTHS):
        most = cost - _SHARE * length * drop
        if has_gaps:
            most = np.inf if length < short else rise * (abs(cost) + drop)
        found = _march(program, states, controls, length, eps, penalty, most, memory)
        if found < np.inf:
            return length
        length /= 2
    return 0.0


@pasted
def _improve(
    program: Program,
    states: Floats,
    controls: Floats,
    eps: float,
    penalty: float,
    cost: float,
    tolerance: float,
    has_gaps: bool,
    is_wary: bool,
    damping: float,
    most: float,
    memory: Memory,
) -> tuple[float, float]:
    """Returns the step length, and the damping.

    The length is 0 if there is none, −1 if none is needed and −2 if none leads below `most`.
    """
    while damping <= _MOST:
        drop = sweep_back(program, controls, has_gaps, damping, memory.expansion, memory.sweep)
        if drop >= 0.0:
            if not has_gaps and drop <= tolerance:
                return -1.0, damping
            if not has_gaps and cost - _FALLS * drop > most:
                return -2.0, damping
            length = _search(
                program, states, controls, eps, penalty, cost, drop, has_gaps, is_wary, memory
            )
            if length > 0.0:
                return length, damping
        damping = max(_GROWTH * damping, _LEAST)
    return 0.0, damping


@kernel
def descend(
    program: Program,
    states: Floats,
    controls: Floats,
    eps: float,
    penalty: float,
    iterations: int,
    tolerance: float,
    scale: float,
    has_gaps: bool,
    is_wary: bool,
    most: float,
    memory: Memory,
) -> tuple[float, int, bool, bool]:
    """Improves a motion in place until the expansion promises nearly nothing.

    Args:
        program: the problem.
        states: shape (K + 1, nz); computed first unless they have gaps.
        controls: shape (K, nu), within bounds.
        eps: the smoothing of contact [m].
        penalty: ρ.
        iterations: at most so many.
        tolerance: of what is promised, as a share of the cost.
        scale: a cost below which costs are small.
        has_gaps: whether the states are no roll-out.
        is_wary: whether steps that close gaps may raise the cost by little only.
        most: what promises to cost more is left.
        memory: room.

    Returns:
        The cost of the roll-out that it ends with, without penalties; how many iterations it took;
        whether it ended in that tolerance, and whether it was left.
    """
    program, memory = borrow(program), borrow(memory)
    states, controls = borrow(states), borrow(controls)
    damping, is_converged, count, slow, before = _DAMPING, False, 0, 0, np.inf
    is_left = False
    if not has_gaps:
        cost = _travel(program, states, controls, _ROLL, 0.0, eps, np.inf, memory)
        if iterations == 0 or not np.isfinite(cost):
            return cost, 0, False, False
    while count < iterations:
        count += 1
        cost = _expand(program, states, controls, eps, penalty, memory)
        if not np.isfinite(cost):
            break
        small = tolerance * max(abs(cost), scale)
        slow = slow + 1 if before - cost < small and not has_gaps else 0
        if slow == _PATIENCE:
            is_converged = True
            break
        before = cost
        length, damping = _improve(
            program,
            states,
            controls,
            eps,
            penalty,
            cost,
            small,
            has_gaps,
            is_wary,
            damping,
            most,
            memory,
        )
        is_converged, is_left = length == -1.0, length == -2.0
        if length <= 0.0:
            break
        _copy(memory.states, states)
        _copy(memory.controls, controls)
        has_gaps = has_gaps and length < 1.0
        damping = max(damping / 4, 1e-9)
    cost = _travel(program, states, controls, _ROLL, 0.0, eps, np.inf, memory)
    return cost, count, is_converged, is_left
