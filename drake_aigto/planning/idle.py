"""Doing nothing: the motion without control, as a candidate that every plan has to beat."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy  # Not scipy.optimize, which takes a tenth of a second and few need.

from drake_aigto.planning.origin import NO_CONTROL, Origin
from drake_aigto.planning.plan import LARGEST_DEFECT, Candidate
from drake_aigto.planning.problem import PlanningProblem, sample
from drake_aigto.simulation.contacts import find_contacts, max_penetration
from drake_aigto.simulation.replay import Replay
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription.rows import DYNAMICS, FLIGHT, NONPENETRATION, largest_defect

if TYPE_CHECKING:
    import numpy.typing as npt

    from drake_aigto.world import World

    _Array = npt.NDArray[np.float64]

# Changes of velocity below this part of the largest velocity are rounding.
_ROUNDING = 1e-9
# Springs and dampers are integrated: knots become twice as many so often at most until the midpoint
# rule, which the rows of plans are, agrees.
_MOST_DOUBLINGS = 5


def idle_candidate(problem: PlanningProblem) -> Candidate:
    """Returns what the world does without any control, on rigid walls.

    Its knots are those of the problem's `coast`, and the times of impacts.

    Args:
        problem: the task, and what users added to it.
    """
    world, replay = problem.transcription.world, problem.coast
    for doubling in range(_MOST_DOUBLINGS + 1):
        if doubling:
            replay = problem.replay_coast(problem.coast_steps << doubling)
        trajectory = _read(world, replay, problem.scales.length)
        missed = problem.additions.violations(sample(trajectory)) if problem.additions else {}
        defects = {**_calc_defects(world, trajectory), **missed}
        if largest_defect(defects, problem.scales) <= LARGEST_DEFECT:
            break
    replay = problem.add_to_replay(replay, trajectory)
    return Candidate(
        origin=Origin(NO_CONTROL),
        start_cost=replay.cost,
        start_defects=defects,
        trajectory=trajectory,
        cost=replay.cost,
        goal_error=replay.goal_error,
        defects=defects,
        max_penetration=max_penetration(world, trajectory),
        contacts=find_contacts(world, trajectory),
        replay=replay,
        scales=problem.scales,
        added_costs=replay.added_costs,
    )


def _read(world: World, replay: Replay, length: float) -> Trajectory:
    """Returns a simulated motion without control, with a knot at each impact.

    Args:
        world: where it was simulated.
        replay: its states, and its impacts.
        length: of which a millionth counts as touching [m].
    """
    first = np.flatnonzero(np.diff(replay.times, prepend=-1.0))
    last = np.append(first[1:], len(replay.times)) - 1
    t, q, v = replay.times[first], replay.positions[first], replay.velocities[first]
    jumps = replay.velocities[last] - v
    m = world.num_contacts
    impulses, forces = np.zeros((len(t), m)), np.zeros((len(t) - 1, m))
    struck = np.zeros((len(t), m), dtype=bool)
    struck[np.searchsorted(t, replay.bounce_times), np.array(replay.bounce_contacts, int)] = True
    for k in np.flatnonzero(np.any(struck, axis=1)):
        impulses[k, struck[k]] = _solve_pushes(world, q[k], struck[k], jumps[k])
    flying = Trajectory(t, q, v, _no_control(world, t), impulses, forces)
    touching = np.abs(world.calc_signed_distance(q)) < LARGEST_DEFECT * length
    resting = touching[:-1] & touching[1:]
    if not np.any(resting):
        return flying
    left = _calc_unexplained(world, flying)
    is_pushed = np.max(np.abs(left), axis=1) > _ROUNDING * np.max(np.abs(v), initial=0.0)
    for k in np.flatnonzero(is_pushed & np.any(resting, axis=1)):
        pushes = _solve_pushes(world, q[k], resting[k], left[k])
        forces[k, resting[k]] = pushes / (t[k + 1] - t[k])
    return Trajectory(t, q, v, _no_control(world, t), impulses, forces)


def _no_control(world: World, times: _Array) -> _Array:
    return np.zeros((len(times) - 1, world.num_actuators))


def _solve_pushes(
    world: World, q: _Array, pushing: npt.NDArray[np.bool_], change: _Array
) -> _Array:
    """Returns the impulses ≥ 0 of these contacts that change the velocity so, [N s]."""
    units = np.eye(world.num_contacts)[pushing]
    kicks = world.calc_velocity_change(np.broadcast_to(q, (len(units), q.size)), units)
    return np.asarray(scipy.optimize.nnls(kicks.T, change)[0])


def _after(world: World, motion: Trajectory) -> _Array:
    """Returns the velocities after the impulses at knots, shape (N+1, nv) [m/s]."""
    kicks = world.calc_velocity_change(motion.positions, motion.impulses)
    return np.asarray(motion.velocities + kicks)


def _calc_unexplained(world: World, motion: Trajectory) -> _Array:
    """Returns what of the changes of velocity neither impulses nor forces explain, (N, nv) [m/s].

    By the midpoint rule, as the rows "dynamics" are.
    """
    q, v, h = motion.positions, _after(world, motion)[:-1], np.diff(motion.times)[:, np.newaxis]
    middle, mean = (q[:-1] + q[1:]) / 2, (v + motion.velocities[1:]) / 2
    free = world.calc_acceleration(middle, mean, motion.controls)
    pushed = world.calc_velocity_change(middle, h * motion.forces)
    return np.asarray(motion.velocities[1:] - v - h * free - pushed)


def _calc_defects(world: World, motion: Trajectory) -> dict[str, float]:
    """Returns the largest violation of the rows that any motion has to meet.

    In the interval that it comes to rest in, it hops more often than there are knots.
    """
    q, h = motion.positions, np.diff(motion.times)[:, np.newaxis]
    mean = (_after(world, motion)[:-1] + motion.velocities[1:]) / 2
    flies = ~np.any(motion.forces, axis=1, keepdims=True)
    return {
        FLIGHT: float(np.max(np.abs(flies * (np.diff(q, axis=0) - h * mean)))),
        DYNAMICS: float(np.max(np.abs(_calc_unexplained(world, motion)))),
        NONPENETRATION: max_penetration(world, motion),
    }
