"""Simulations on rigid walls as trajectories with a knot at each impact."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy  # Not scipy.optimize, which takes a tenth of a second and few need.

from drake_aigto.arrays import Floats
from drake_aigto.planning.candidate import LARGEST_DEFECT
from drake_aigto.simulation import Replay, max_penetration
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import DYNAMICS, FLIGHT, NONPENETRATION
from drake_aigto.world import World

# Changes of velocity below this part of the largest velocity are rounding.
_ROUNDING = 1e-9


def read_motion(
    world: World, replay: Replay, knots: Floats, controls: Floats, length: float
) -> Trajectory:
    """Returns a simulated motion, with a knot at each impact.

    Args:
        world: of the simulation.
        replay: its states, and its impacts.
        knots: of its control, shape (N+1,) [s].
        controls: held between them, shape (N, nu) [N].
        length: a millionth of it counts as touching [m].
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
    held = controls[np.searchsorted(knots, (t[:-1] + t[1:]) / 2) - 1]
    flying = Trajectory(t, q, v, held, impulses, forces)
    touching = np.abs(world.calc_signed_distance(q)) < LARGEST_DEFECT * length
    resting = touching[:-1] & touching[1:]
    if not np.any(resting):
        return flying
    left = _calc_unexplained(world, flying)
    is_pushed = np.max(np.abs(left), axis=1) > _ROUNDING * np.max(np.abs(v), initial=0.0)
    for k in np.flatnonzero(is_pushed & np.any(resting, axis=1)):
        pushes = _solve_pushes(world, q[k], resting[k], left[k])
        forces[k, resting[k]] = pushes / (t[k + 1] - t[k])
    return Trajectory(t, q, v, held, impulses, forces)


def _solve_pushes(
    world: World, q: Floats, pushing: npt.NDArray[np.bool_], change: Floats
) -> Floats:
    """Returns the impulses ≥ 0 of contacts that cause a change of velocity [N s]."""
    units = np.eye(world.num_contacts)[pushing]
    kicks = world.calc_velocity_change(np.broadcast_to(q, (len(units), q.size)), units)
    return np.asarray(scipy.optimize.nnls(kicks.T, change)[0])


def _after(world: World, motion: Trajectory) -> Floats:
    """Returns the velocities after the impulses at knots, shape (N+1, nv) [m/s]."""
    kicks = world.calc_velocity_change(motion.positions, motion.impulses)
    return np.asarray(motion.velocities + kicks)


def _calc_unexplained(world: World, motion: Trajectory) -> Floats:
    """Returns changes of velocity without those by impulses and forces, (N, nv) [m/s].

    These follow the midpoint rule, like the rows "dynamics".
    """
    q, v, h = motion.positions, _after(world, motion)[:-1], np.diff(motion.times)[:, np.newaxis]
    middle, mean = (q[:-1] + q[1:]) / 2, (v + motion.velocities[1:]) / 2
    free = world.calc_acceleration(middle, mean, motion.controls)
    pushed = world.calc_velocity_change(middle, h * motion.forces)
    return np.asarray(motion.velocities[1:] - v - h * free - pushed)


def calc_defects(world: World, motion: Trajectory) -> dict[str, float]:
    """Returns the largest violation of the rows that any motion has to meet.

    In the interval in which it comes to rest, it hops more often than there are knots.
    """
    q, h = motion.positions, np.diff(motion.times)[:, np.newaxis]
    mean = (_after(world, motion)[:-1] + motion.velocities[1:]) / 2
    flies = ~np.any(motion.forces, axis=1, keepdims=True)
    return {
        FLIGHT: float(np.max(np.abs(flies * (np.diff(q, axis=0) - h * mean)))),
        DYNAMICS: float(np.max(np.abs(_calc_unexplained(world, motion)))),
        NONPENETRATION: max_penetration(world, motion),
    }
