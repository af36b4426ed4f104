"""Held controls on exactly rigid walls where flight is a parabola: one, or thousands at once."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.jit import kernel
from drake_aigto.simulation.contact_motion import Walls, calc_depth
from drake_aigto.simulation.impacts import (
    STATE,
    TIME,
    HybridState,
    Rules,
    calc_curves,
    fly,
    make_log,
    may_touch,
    run,
)
from drake_aigto.simulation.recording import Recording, list_impacts
from drake_aigto.world import ConstantDynamics

# Of the first log; what has more impacts runs a second time.
_USUAL_IMPACTS = 64


class Parabolas:
    """Rolls out held controls by roots alone, without integration (`RigidWall` has the equations).

    If the bias h is constant, v̇ = M⁻¹ (B u − h) is so between events under a held control, and

        φ(t) = φ + φ̇ t + ½ φ̈ t²

    Each event of an interval is the root of such a parabola (`impacts.run`): nothing is missed, and
    what is found is exact but for rounding.
    """

    def __init__(
        self,
        dynamics: ConstantDynamics,
        restitutions: Floats,
        state: tuple[Floats, Floats],
        times: Floats,
    ) -> None:
        """Reads what is constant.

        Args:
            dynamics: with the contacts.
            restitutions: e of each contact, in [0, 1], shape (m,).
            state: the start, (q, v).
            times: of the knots, shape (N+1,) [s].
        """
        self._dynamics = dynamics
        self._walls = Walls.of(dynamics)
        self._rules = Rules(restitutions, float(times[-1] - times[0]))
        # A copy: Numba compiles once more for arrays that are read-only.
        self._times = np.array(times)
        self._start = np.array(state)

    def record(self, controls: Floats) -> Recording:
        """Returns the states at all knots, and before and after each impact.

        Controls are held between the knots, shape (N, nu).
        """
        knots, n = self._times.size, self._start.shape[1]
        states, impacts_until = np.empty((knots, 2, n)), np.zeros(knots, dtype=np.int64)
        accelerations = self._calc_accelerations(controls)
        log, count = make_log(_USUAL_IMPACTS, n), 0
        while (count := self._roll_out(accelerations, states, impacts_until, log)) > len(log):
            log = make_log(count, n)
        log = log[:count]
        times, rows = self._insert_impacts(states, impacts_until, log)
        return Recording(
            times=times,
            positions=rows[:, 0],
            velocities=rows[:, 1],
            control_times=self._times[:-1],
            controls=controls,
            impacts=list_impacts(log, self._dynamics.mass_matrix),
            max_penetration=calc_depth(self._walls, rows[:, 0]),
        )

    def _insert_impacts(
        self, states: Floats, impacts_until: Ints, log: Floats
    ) -> tuple[Floats, Floats]:
        """Returns times and states (q, v), with two rows for each impact between the knots'."""
        knots, _, n = states.shape
        at_knots = np.arange(knots) + 2 * impacts_until
        times, rows = np.empty(knots + 2 * len(log)), np.empty((knots + 2 * len(log), 2, n))
        times[at_knots], rows[at_knots] = self._times, states
        is_impact = np.ones(times.size, dtype=bool)
        is_impact[at_knots] = False
        at_impacts = np.flatnonzero(is_impact)
        q, *velocities = log[:, STATE:].reshape(-1, 3, n).transpose(1, 0, 2)
        for part, v in enumerate(velocities):
            rows[at_impacts[part::2], 0], rows[at_impacts[part::2], 1] = q, v
            times[at_impacts[part::2]] = log[:, TIME]
        return times, rows

    def _calc_accelerations(self, controls: Floats) -> Floats:
        """Returns v̇ without contact, shape (…, nv) [m/s²]."""
        return controls @ self._dynamics.gain.T + self._dynamics.drift

    def _roll_out(
        self, accelerations: Floats, states: Floats, impacts_until: Ints, log: Floats
    ) -> int:
        walls, rules, phase = self._walls, self._rules, self._make_phase()
        return roll_out(walls, rules, phase, self._times, accelerations, states, impacts_until, log)

    def _make_phase(self) -> HybridState:
        """Returns the start, at rest on nothing."""
        q, v = self._start.copy()
        m = self._rules.restitutions.size
        return HybridState(q, v, np.zeros(m, dtype=bool), np.zeros(m))

    def find_ends(self, controls: Floats, times: Floats | None = None) -> Floats:
        """Returns the positions that many controls (C, N, nu) lead to, shape (C, nq) [m].

        Each may have times of its own, shape (C, N+1), from 0 to T [s].
        """
        times = np.broadcast_to(
            self._times if times is None else times, (len(controls), self._times.size)
        )
        accelerations = self._calc_accelerations(controls)
        ends = np.empty((len(controls), self._start.shape[1]))
        log = make_log(0, ends.shape[1])
        # A copy, for read-only arrays would be compiled for once more.
        knots, phase = np.array(times, order="C"), self._make_phase()
        roll_out_many(self._walls, self._rules, phase, knots, accelerations, ends, log)
        return ends


@kernel
def roll_out(
    walls: Walls,
    rules: Rules,
    phase: HybridState,
    times: Floats,
    accelerations: Floats,
    states: Floats,
    impacts_until: Ints,
    log: Floats,
) -> int:
    """Write the motion from a phase, under the acceleration of each interval (N, nv).

    States become (q, v) at each knot, shape (N+1, 2, nq), and `impacts_until` how many impacts
    there were by then, shape (N+1,). Other arguments are those of `impacts.run`; a log that is too
    short has the first impacts.

    Returns:
        How many impacts there were.
    """
    q, v, resting, _ = phase
    curves = np.empty((resting.size, 3))
    impacts_until[0] = 0
    for k in range(times.size):
        if k > 0:
            acceleration, left = accelerations[k - 1], times[k] - times[k - 1]
            logged = impacts_until[k - 1]
            calc_curves(walls, q, v, acceleration, curves)
            if may_touch(walls.firsts, resting, curves, left):
                logged = run(walls, rules, phase, acceleration, times[k], left, -1, log, logged)
            else:
                fly(q, v, acceleration, left)
            impacts_until[k] = logged
        for i in range(q.size):
            states[k, 0, i], states[k, 1, i] = q[i], v[i]
    return impacts_until[-1]


@kernel
def roll_out_many(
    walls: Walls,
    rules: Rules,
    start: HybridState,
    times: Floats,
    accelerations: Floats,
    ends: Floats,
    log: Floats,
) -> None:
    """Write the last position of each of C motions from a start, shape (C, nq), as `roll_out`."""
    states = np.empty((times.shape[1], 2, start.q.size))
    impacts_until = np.empty(times.shape[1], np.int64)
    for c in range(len(ends)):
        phase = HybridState(
            start.q.copy(), start.v.copy(), start.resting.copy(), start.counts.copy()
        )
        roll_out(walls, rules, phase, times[c], accelerations[c], states, impacts_until, log)
        ends[c] = phase.q
