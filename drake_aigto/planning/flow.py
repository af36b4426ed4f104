"""A replay as a trajectory, checked by integrating it again between its rows."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.simulation.replay import Replay
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import ContactLaw, World

# Runge-Kutta steps between two rows of a replay, where contacts neither begin nor end.
_STEPS = 32


def trace(
    world: World, law: ContactLaw, replay: Replay, times: Floats, controls: Floats
) -> tuple[Trajectory, Floats]:
    """Returns the trajectory of a replay, and how far it is off the equations of motion.

    From each row of the replay Runge and Kutta's method of order 4 goes on to the next.

    Args:
        world: the mechanism.
        law: what contacts push with while they last.
        replay: of the controls.
        times: of the knots, shape (N+1,) [s].
        controls: held over each interval, shape (N, nu).

    Returns:
        The trajectory at the knots, with the mean forces between them; and the largest difference
        of each of (q, v) to what the row before leads to, shape (2n,).
    """
    is_step = np.diff(replay.times) > 0
    starts, h = replay.times[:-1][is_step], np.diff(replay.times)[is_step]
    knots = np.clip(np.searchsorted(times, starts + h / 2) - 1, 0, len(controls) - 1)
    x = np.hstack([replay.positions, replay.velocities])
    ends, pushes = _integrate(world, law, x[:-1][is_step], controls[knots], h)
    gaps = np.max(np.abs(ends - x[1:][is_step]), axis=0)
    impulses = np.zeros((len(controls), world.num_contacts))
    np.add.at(impulses, knots, pushes)
    q, v = replay.states_at(times)
    forces = impulses / np.diff(times)[:, np.newaxis]
    none = np.zeros((len(times), world.num_contacts))
    return Trajectory(times, q, v, controls, none, forces), gaps


def _integrate(
    world: World, law: ContactLaw, x: Floats, controls: Floats, durations: Floats
) -> tuple[Floats, Floats]:
    """Returns where states (K, 2n) are after durations (K,) [s], and what contacts gave [N s]."""
    n, h = world.num_positions, durations[:, np.newaxis] / _STEPS
    total = np.zeros((len(x), world.num_contacts))

    def rate(x: Floats) -> tuple[Floats, Floats]:
        q, v = x[:, :n], x[:, n:]
        forces = world.calc_pushes(law, q, v)
        pushed = world.calc_velocity_change(q, forces)
        return np.hstack([v, world.calc_acceleration(q, v, controls) + pushed]), forces

    for _ in range(_STEPS):
        first, a = rate(x)
        second, b = rate(x + h / 2 * first)
        third, c = rate(x + h / 2 * second)
        fourth, d = rate(x + h * third)
        x = x + h / 6 * (first + 2 * second + 2 * third + fourth)
        total += h / 6 * (a + 2 * b + 2 * c + d)
    return x, total
