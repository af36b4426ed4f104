"""Differential dynamic programming on a motion that need not be a roll-out."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.kernels import borrow, borrowing, kernel
from drake_aigto.shooting.bounds import EXPAND, MEASURE, PENALIZE, UPDATE, add_costs, visit_bounds
from drake_aigto.shooting.flow import choose, flow, jump, measure_end
from drake_aigto.shooting.stages import align, shift, subtract
from drake_aigto.shooting.sweep import clip_control, find_size, sweep_back
from drake_aigto.shooting.tables import CHOOSE, FLOW, Memory, Outcome, Pass, Program

# A step must keep this share of the fall that the expansion promises (Armijo).
_SHARE = 1e-4
# A step that closes gaps may raise the cost this much, times its size, gain included; and below
# this step length closing a gap is worth any cost.
_RISE, _SHORT = 3.0, 0.2
# The same for a wary descent, where motions diverge easily.
_WARY_RISE, _WARY_SHORT = 0.3, 0.0
# Damping: its start, its least value after growth, its limits, its growth, and its fall. It grows
# where no length is good enough, and falls after steps; where it holds states, it falls after
# whole steps only, and grows by as much after others.
_DAMPING, _LEAST, _SMALLEST, _MOST, _GROWTH, _FALL = 1e-6, 1e-2, 1e-9, 1e3, 10.0, 4.0
# Damping that holds states near the motion (`Pass.holds_states`) adds this share of the cost at a
# distance of one of their scales at all knots. Where contacts begin, end or slip, an expansion
# holds but near the motion, and along what hardly costs, undamped steps go many scales. With
# damping of controls, a quadruped's fall costs 4.1 after 20 iterations, with this 0.077.
# Step lengths that are tried: 1, 1/2, …; where states are held they are fitted to costs, each at
# least this part of the one before.
_LENGTHS, _FITTED_LENGTHS, _LEAST_PART = 5, 2, 0.1
# Iterations in a row that gain less than the tolerance and end it.
_PATIENCE = 3
# A motion is left unfinished if this times the decrease that the expansion promises does not
# suffice. Of 3,072 boxes around cart-poles between soft walls, with the eighth best motion as a
# limit, that saves 37 % of all iterations and loses 13 of 346 motions that would have been better
# than the best one. A factor of 8 saves 31 % and loses 9, one of 4 45 % and 20.
_FALLS = 6.0


# Modes of `travel`.
FOLLOW, LINEARIZE, ROLL = range(3)


@borrowing
def travel(
    program: Program,
    states: Floats,
    controls: Floats,
    mode: int,
    length: float,
    eps: float,
    most: float,
    first: int,
    memory: Memory,
) -> float:
    """Goes through all stages from the first one on, and returns their cost and the end's.

    That is infinite above `most`.

    ROLL computes the states after the first one, LINEARIZE the problem to second order about a
    motion, and FOLLOW a trial from its own start under the control law with a step length α, with
    gaps that shrink likewise: z_{k+1} = f(z_k, u_k) − (1 − α) gap_k.
    """
    feedforward, gains, gaps = memory.sweep.feedforward, memory.sweep.gains, memory.expansion.gaps
    lower, upper = program.bounds.lower_control, program.bounds.upper_control
    trial_states, trial_controls, kinds = memory.states, memory.controls, program.kinds
    K, nz, cost, has_added = controls.shape[0], gaps.shape[1], 0.0, program.added.factors.any()
    mechanics, room, off = program.mechanics, memory.flow.mechanics, memory.sweep.v1
    for k in range(first, K):
        z, u, after = states[k], controls[k], states[k + 1]
        size, norm = find_size(program, k)
        if mode == FOLLOW:
            z, u, after = trial_states[k], trial_controls[k], trial_states[k + 1]
            subtract(mechanics, z, states[k], off)
            for i in range(size):
                u[i] = controls[k, i] + length * feedforward[k, i]
                for j in range(nz):
                    u[i] += gains[k, i, j] * off[j]
            clip_control(size, u, lower[k], upper[k], norm)
        elif mode == LINEARIZE:
            after = trial_states[k + 1]
        if kinds[k] == CHOOSE:
            choose(k, size, z, u, mode == LINEARIZE, after, memory)
        elif kinds[k] != FLOW:
            jump(program, k, z, u, mode == LINEARIZE, after, memory)
        else:
            is_trial = mode == FOLLOW
            cost += flow(program, k, z, u, eps, mode == LINEARIZE, is_trial, after, memory)
            if has_added:
                cost += add_costs(program, k, z, u, mode == LINEARIZE, memory)
        if mode == FOLLOW:
            shift(mechanics, after, length - 1, gaps[k], room)
        elif mode == LINEARIZE:
            subtract(mechanics, after, states[k + 1], gaps[k])
            align(mechanics, gaps[k], memory.expansion.F[k], room)
        if not cost <= most:
            return np.inf
    z = trial_states[K] if mode == FOLLOW else states[K]
    cost += measure_end(program, z, mode == LINEARIZE, memory)
    if has_added:
        cost += add_costs(program, K, z, controls[K - 1], mode == LINEARIZE, memory)
    return cost


@borrowing
def _search(
    program: Program,
    states: Floats,
    controls: Floats,
    settings: Pass,
    cost: float,
    drop: float,
    has_gaps: bool,
    memory: Memory,
) -> float:
    """Returns the first step length that is good enough, 0 if none is."""
    length, eps = 1.0, settings.eps
    count = _FITTED_LENGTHS if settings.holds_states else _LENGTHS
    _copy(states[:1], memory.states)
    rise, short = (_WARY_RISE, _WARY_SHORT) if settings.is_wary else (_RISE, _SHORT)
    for _ in range(count):
        most, part = cost - _SHARE * length * drop, 0.5
        if has_gaps:
            most = np.inf if length < short else rise * (abs(cost) + drop)
        is_fitted = settings.holds_states and not has_gaps
        limit = np.inf if is_fitted else most
        found = travel(program, states, controls, FOLLOW, length, eps, limit, 0, memory)
        if found < np.inf:
            penalty, trial = settings.penalty, memory.controls
            found += visit_bounds(program, memory.states, trial, penalty, PENALIZE, memory)
        if found <= most and found < np.inf:
            return length
        if is_fitted and found < np.inf:  # A parabola through both costs, of the known slope.
            part = drop * length / (found - cost + 2 * drop * length)
        length *= min(max(part, _LEAST_PART), 0.5)
    return 0.0


@borrowing
def _improve(
    program: Program,
    states: Floats,
    controls: Floats,
    settings: Pass,
    cost: float,
    small: float,
    has_gaps: bool,
    damping: float,
    memory: Memory,
) -> tuple[float, float]:
    """Returns the step length, and the damping.

    The length is 0 if none is good enough, −1 if none is needed, as steps gain next to nothing, and
    −2 if none promises a cost below the limit.
    """
    expansion, sweep, growth, unit = memory.expansion, memory.sweep, _GROWTH, 0.0
    if settings.holds_states:
        growth, unit = _FALL, max(abs(cost), settings.scale) / controls.shape[0]
    while damping <= _MOST:
        share = _DAMPING if settings.holds_states else damping
        drop = sweep_back(program, controls, has_gaps, share, damping * unit, expansion, sweep)
        if drop >= 0.0:
            is_told = damping <= _LEAST or not settings.holds_states  # By steps that are held, not.
            is_certain = is_told or not settings.is_patient
            if is_certain and drop <= small and (not has_gaps or small == np.inf):
                return -1.0, damping
            if is_told and not has_gaps and cost - _FALLS * drop > settings.most:
                return -2.0, damping
            length = _search(program, states, controls, settings, cost, drop, has_gaps, memory)
            if length > 0.0:
                return length, damping
        damping = max(growth * damping, _LEAST)
    return 0.0, damping


@kernel
def descend(
    program: Program,
    states: Floats,
    controls: Floats,
    has_gaps: bool,
    settings: Pass,
    memory: Memory,
) -> Outcome:
    """Improves a motion in place until the expansion promises nearly nothing.

    With an infinite tolerance it is only expanded, and stays as it is. Where a law is to be
    followed, only the trial in the memory changes.

    Args:
        program: the problem.
        states: shape (K + 1, nz); computed first unless they have gaps.
        controls: shape (K, nu), within bounds.
        has_gaps: whether the states are not a roll-out.
        settings: of this pass.
        memory: room.
    """
    program, memory = borrow(program), borrow(memory)
    states, controls = borrow(states), borrow(controls)
    damping, is_converged, count, slow, before = _DAMPING, False, 0, 0, np.inf
    is_left, eps, cost, is_possible = False, settings.eps, 0.0, settings.iterations > 0
    plain = np.inf
    if settings.first >= 0:
        most, first = settings.most, settings.first
        cost = travel(program, states, controls, FOLLOW, 1.0, eps, most, first, memory)
        return Outcome(cost, 0, False, cost == np.inf, 0.0)
    if not has_gaps:
        cost = travel(program, states, controls, ROLL, 0.0, eps, np.inf, 0, memory)
        is_possible = is_possible and np.isfinite(cost)
    while is_possible and count < settings.iterations:
        count += 1
        plain = travel(program, states, controls, LINEARIZE, 0.0, eps, np.inf, 0, memory)
        cost = plain + visit_bounds(program, states, controls, settings.penalty, EXPAND, memory)
        if not np.isfinite(cost):
            break
        small = settings.tolerance * max(abs(cost), settings.scale)
        slow = slow + 1 if before - cost < small and not has_gaps else 0
        if slow == _PATIENCE:
            is_converged = True
            break
        before = cost
        length, damping = _improve(
            program, states, controls, settings, cost, small, has_gaps, damping, memory
        )
        is_converged, is_left = length == -1.0, length == -2.0
        if length <= 0.0:
            break
        _copy(memory.states, states)
        _copy(memory.controls, controls)
        for k in range(controls.shape[0]):
            _copy(memory.flow.changes[1, k], memory.flow.changes[0, k])
        has_gaps = has_gaps and length < 1.0
        if settings.holds_states and length < 1.0:
            damping = min(max(_FALL * damping, _LEAST), _MOST)
        else:
            damping = max(damping / _FALL, _SMALLEST)
    if settings.tolerance == np.inf:
        cost = plain
    elif has_gaps or is_possible:
        cost = travel(program, states, controls, ROLL, 0.0, eps, np.inf, 0, memory)
    job = UPDATE if settings.updates else MEASURE
    violation = visit_bounds(program, states, controls, settings.penalty, job, memory)
    return Outcome(cost, count, is_converged, is_left, violation)


@borrowing
def _copy(source: Floats, target: Floats) -> None:
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]
