"""Our own judge, of exact laws of contact; and rigid walls where flight is a parabola."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.contact import CompliantLaw, ContactLaw, Walls, calc_depth, contact_law
from drake_aigto.dynamics import ConstantDynamics
from drake_aigto.kernels import kernel
from drake_aigto.simulation.compliant import simulate_compliant
from drake_aigto.simulation.flights import (
    STATE,
    TIME,
    HybridState,
    Rules,
    calc_curves,
    copy_phase,
    fly,
    make_log,
    may_touch,
    run,
    start_phase,
)
from drake_aigto.simulation.recording import Controller, HeldControl, Recording, list_impacts
from drake_aigto.simulation.rigid import Flights, RigidMotion, SlidingMotion
from drake_aigto.world import Scenario, World

# Of the first log; what has more impacts runs a second time.
_USUAL_IMPACTS = 64


class Parabolas:
    """Rolls out held controls by roots alone, without integration.

    Equations are those of `RigidMotion`. If the bias h is constant, v̇ = M⁻¹ (B u − h) is so between
    events under a held control, and

        φ(t) = φ + φ̇ t + ½ φ̈ t²

    Each event of an interval is the root of such a parabola (`flights.run`): nothing is missed, and
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
        # Copies: Numba compiles once more for arrays that are read-only.
        self._rules = Rules(np.array(restitutions), float(times[-1] - times[0]))
        self._times = np.array(times)
        self._start = start_phase(state, len(dynamics.offset))

    def record(self, controls: Floats) -> Recording:
        """Returns the states at all knots, and before and after each impact.

        Controls are held between the knots, shape (N, nu).
        """
        knots, n = self._times.size, len(self._start.q)
        states, impacts_until = np.empty((knots, 2, n)), np.zeros(knots, dtype=np.int64)
        log = make_log(_USUAL_IMPACTS, n)
        moments = self._times, self._calc_accelerations(controls), states, impacts_until
        while True:
            count = roll_out(self._walls, self._rules, copy_phase(self._start), *moments, log)
            if count <= len(log):
                break
            log = make_log(count, n)
        log = log[:count]
        # Two rows for each impact between those of knots.
        at_knots = np.arange(knots) + 2 * impacts_until
        times, rows = np.empty(knots + 2 * count), np.empty((knots + 2 * count, 2, n))
        times[at_knots], rows[at_knots] = self._times, states
        is_impact = np.ones(times.size, dtype=bool)
        is_impact[at_knots] = False
        at_impacts = np.flatnonzero(is_impact)
        q, *velocities = log[:, STATE:].reshape(-1, 3, n).transpose(1, 0, 2)
        for part, v in enumerate(velocities):
            rows[at_impacts[part::2], 0], rows[at_impacts[part::2], 1] = q, v
            times[at_impacts[part::2]] = log[:, TIME]
        return Recording(
            times=times,
            positions=rows[:, 0],
            velocities=rows[:, 1],
            control_times=self._times[:-1],
            controls=controls,
            impacts=list_impacts(log, self._dynamics.mass_matrix),
            max_penetration=calc_depth(self._walls, rows[:, 0]),
        )

    def _calc_accelerations(self, controls: Floats) -> Floats:
        """Returns v̇ without contact, shape (…, nv) [m/s²]."""
        return controls @ self._dynamics.gain.T + self._dynamics.drift

    def find_ends(
        self, controls: Floats, times: Floats | None = None, kicks: Floats | None = None
    ) -> Floats:
        """Returns the positions that many controls (C, N, nu) lead to, shape (C, nq) [m].

        Each may have times of its own, shape (C, N+1), from 0 to T [s], and a velocity that is
        added at the start, shape (C, nv) [m/s].
        """
        states = np.empty((self._times.size, 2, len(self._start.q)))
        moments = states, np.empty(self._times.size, dtype=np.int64)
        log, ends = make_log(0, states.shape[2]), np.empty((len(controls), states.shape[2]))
        for c, accelerations in enumerate(self._calc_accelerations(controls)):
            knots, phase = self._times if times is None else times[c], copy_phase(self._start)
            if kicks is not None:
                phase.v[:] += kicks[c]
            roll_out(self._walls, self._rules, phase, knots, accelerations, *moments, log)
            ends[c] = phase.q
        return ends


class EventDriven:
    """Simulates walls that are rigid or compliant as the scenario says, exactly (a `Judge`).

    Where flight under a held control is a parabola (`World.constant_dynamics`) it is exact but for
    rounding, by roots alone (`Parabolas`, `Flights`); only hops too short to follow become rest.
    Elsewhere it is integrated nearly to rounding (`RigidMotion` has the equations), and so it is
    with friction (`SlidingMotion`): what sticks, slips or rolls, and until when, is found by roots,
    too. Compliant walls are springs that may be entered (`CompliantMotion`, which takes mechanisms
    that touch nothing, too).
    """

    def simulate(
        self,
        world: World,
        scenario: Scenario,
        controller: Controller,
        state: tuple[Floats, Floats] | None = None,
    ) -> Recording:
        """Runs a controller from the scenario's start, or from another state (q, v).

        Raises:
            TrajectoryError: the motion runs away to infinity.
            FrictionError: friction leaves no way to go on, or several (`find_modes`).
        """
        law, span = contact_law(world, scenario), (controller.start, controller.end)
        start = state or (scenario.initial_position, scenario.initial_velocity)
        if isinstance(law, CompliantLaw):
            return simulate_compliant(world, law, start, controller)
        is_parabola = world.has_constant_dynamics and not law.has_friction
        springs = find_springs(world, law)
        if springs is not None:
            recording = simulate_compliant(world, springs, start, controller)
        elif is_parabola and isinstance(controller, HeldControl):
            flights = Parabolas(world.constant_dynamics, law.restitution, start, controller.times)
            recording = flights.record(controller.controls)
        else:
            kind = Flights if is_parabola else SlidingMotion if law.has_friction else RigidMotion
            recording = kind(world, law, start, span).run(controller)
        recording.simulator = "event-driven"
        return recording


def find_springs(world: World, law: ContactLaw) -> CompliantLaw | None:
    """Returns the law of a motion without impacts, of no walls if nothing is touched; None: other.

    A point mass that touches nothing flies on parabolas, which need no integration.
    """
    if isinstance(law, CompliantLaw):
        return law
    if world.contacts or world.has_constant_dynamics:
        return None
    return CompliantLaw(np.zeros(0), np.zeros(0))


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
    there were by then, shape (N+1,). Other arguments are those of `flights.run`; a log that is too
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
                logged = run(walls, rules, phase, acceleration, times[k], left, False, log, logged)
            else:
                fly(q, v, acceleration, left)
            impacts_until[k] = logged
        for i in range(q.size):
            states[k, 0, i], states[k, 1, i] = q[i], v[i]
    return impacts_until[-1]
