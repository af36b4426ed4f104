"""Bodies in space under the exact law of compliant contact, integrated with a known error."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import (
    Bodies,
    BodiesMemory,
    CompliantLaw,
    accelerate_bodies,
    make_bodies_memory,
)
from drake_aigto.dynamics import turn_positions
from drake_aigto.errors import TrajectoryError
from drake_aigto.kernels import borrow, inner, kernel
from drake_aigto.simulation.recording import (
    Controller,
    Impact,
    MotionSamples,
    Recording,
    sample_cubics,
)
from drake_aigto.world import SpaceWorld

# Of one step, relative to positions and velocities of 1; coarser steps show how far that leads.
_TOLERANCE, _COARSE, FINE = 1e-10, 1e-8, 1e-11
# More steps between two knots are no motion any more, but numbers that run away.
_MOST_STEPS = 1_000_000
# Rows between two knots, at least: contacts are found, and costs summed, between them.
_ROWS = 8

# Dormand & Prince (1980), "A family of embedded Runge-Kutta formulae": the rule of order 5, and its
# difference to that of order 4.
_A = np.array(
    [
        [0, 0, 0, 0, 0, 0],
        [1 / 5, 0, 0, 0, 0, 0],
        [3 / 40, 9 / 40, 0, 0, 0, 0],
        [44 / 45, -56 / 15, 32 / 9, 0, 0, 0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0, 0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0],
        [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ]
)
_E = np.array([71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])


class BodyMotion:
    """A motion of bodies in space from a start, recorded.

        M v̇ + h(q, v) = B u + Jᵀ f,    q̇ = N(q) v

    with f of all pairs of shapes (`contact.touching`). Steps of a Runge-Kutta method of order 5 are
    as short as its own estimate of their error asks for, which sees the kinks where contacts begin,
    end, stick and slip.

    Attributes:
        recording: of what happened so far.
        forces: once it has run, normal forces at the start of each eighth of intervals between
            knots, shape (8 N, m) [N].
    """

    def __init__(
        self,
        world: SpaceWorld,
        law: CompliantLaw,
        state: tuple[Floats, Floats],
        time: float,
        tolerance: float = _TOLERANCE,
    ) -> None:
        """Starts with (q, v) at a time [s]; the tolerance is that of a step."""
        self.world, self.time, self._tolerance = world, time, tolerance
        self.q, self.v = (np.array(each, dtype=float) for each in state)
        self._law, self.forces = law, np.zeros((0, world.num_contacts))
        self._bodies = Bodies.of(world, law, 1.0)
        self._memory, self._step = make_bodies_memory(self._bodies), np.inf
        self.recording = Recording(simulator="integrated")
        self.recording.add(time, self.q.copy(), self.v.copy())
        self._rows: list[tuple[float, Floats, Floats, Floats]] = []

    def run(self, controller: Controller) -> Recording:
        """Runs a controller to its end.

        Raises:
            TrajectoryError: the motion runs away to infinity.
        """
        recording, bounces = self.recording, list[int]()
        while self.time < controller.end:
            x = np.concatenate([self.q, self.v])
            held = controller.sample(self.time, x, bounces)
            recording.hold(self.time, held)
            self._keep(held.control)
            self._advance(np.array(held.control), held.until)
            recording.add(self.time, self.q.copy(), self.v.copy())
        self._read()
        return recording

    def _keep(self, control: Floats) -> None:
        self._rows.append((self.time, self.q.copy(), self.v.copy(), np.array(control)))

    def _advance(self, control: Floats, until: float) -> None:
        """Moves on under a control until a time [s]."""
        start, step = self.time, self._step
        for row in range(1, _ROWS + 1):
            end = until if row == _ROWS else start + row * (until - start) / _ROWS
            step = integrate_bodies(
                self._bodies, self.q, self.v, control, end - self.time, step, self._tolerance,
                self._memory,
            )  # fmt: skip
            if not (step > 0 and np.isfinite(self.q).all() and np.isfinite(self.v).all()):
                raise TrajectoryError(
                    "the motion under this control",
                    got=f"one that runs away, or goes ever faster, at {self.time:g} s",
                    expected="one that can be integrated until the end",
                    remedy="Check the control's size.",
                )
            self.time = end
            if row < _ROWS:
                self._keep(control)
        self._step = step

    def _calc_forces(self) -> Floats:
        """Returns normal forces at the start of each part of intervals, shape (8 N, m) [N]."""
        q, v = (np.array([row[k] for row in self._rows]) for k in (1, 2))
        distances, rates = self.world.calc_signed_distance(q), self.world.calc_contact_rate(q, v)
        return self._law.calc_forces(distances, rates)

    def _read(self) -> None:
        """Fills in contacts, depth, and samples between rows."""
        self.forces = self._calc_forces()
        self._keep(self._rows[-1][3])
        times = np.array([row[0] for row in self._rows])
        q, v, u = (np.array([row[k] for row in self._rows]) for k in (1, 2, 3))
        self.recording.samples.append(sample_motion(self.world, times, q, v, u))
        self.recording.impacts, self.recording.max_penetration = read_touches(
            self.world, times, q, v
        )


def simulate_bodies(
    world: SpaceWorld, law: CompliantLaw, state: tuple[Floats, Floats], controller: Controller
) -> Recording:
    """Runs a controller; the recording's error is the change of the end in coarser steps."""
    recording = BodyMotion(world, law, state, controller.start).run(controller)
    if controller.is_open_loop:
        coarse = BodyMotion(world, law, state, controller.start, _COARSE).run(controller)
        off = world.subtract(coarse.positions[-1], recording.positions[-1])
        recording.error = float(np.linalg.norm(off))
    return recording


def sample_motion(
    world: SpaceWorld, times: Floats, q: Floats, v: Floats, controls: Floats
) -> tuple[MotionSamples, Floats]:
    """Returns samples between rows, by cubics of positions and velocities.

    Args:
        world: of the motion.
        times: of rows, shape (K,) [s].
        q: positions, shape (K, nq).
        v: velocities, shape (K, nv).
        controls: that lead on from each row, shape (K, nu).
    """
    steps = np.diff(times)
    keep = np.append(True, steps > 0)
    times, q, v = times[keep], q[keep], v[keep]
    rates, accelerations = world.calc_position_rate(q, v), np.gradient(v, times, axis=0)
    x, slopes = np.hstack([q, v]), np.hstack([rates, accelerations])
    samples = sample_cubics(times, np.hstack([x, slopes]))
    held = np.repeat(controls[keep][:-1], len(samples.times) // (len(times) - 1), axis=0)
    return samples._replace(states=samples.states[:, : x.shape[1]]), held


def read_touches(
    world: SpaceWorld, times: Floats, q: Floats, v: Floats
) -> tuple[list[Impact], float]:
    """Returns touches from outside, and the deepest penetration [m], of rows of a motion."""
    distances = world.calc_signed_distance(q)
    outside, found = distances > 0, list[Impact]()
    for before, contact in np.argwhere(outside[:-1] & ~outside[1:]).tolist():
        gap, depth = distances[before, contact], -distances[before + 1, contact]
        time = times[before] + (times[before + 1] - times[before]) * gap / (gap + depth)
        after = np.flatnonzero(outside[before + 1 :, contact])
        last = before + 1 + int(after[0]) if len(after) else len(times) - 1
        energies = [float(world.calc_kinetic_energy(q[k], v[k])) for k in (before, last)]
        speed = -float(world.calc_contact_rate(q[before], v[before])[contact])
        found.append(Impact(float(time), contact, speed, 0.0, *energies))
    found.sort(key=lambda impact: impact.time)
    return found, max(0.0, -float(np.min(distances, initial=0.0)))


@inner
def _find_rates(bodies: Bodies, x: Floats, u: Floats, rates: Floats, memory: BodiesMemory) -> None:
    """Computes ẋ of a state x = (q, v)."""
    tree = bodies.tree
    n = tree.up.size
    q, v = x[: x.size - n], x[x.size - n :]
    accelerate_bodies(bodies, q, v, u, 0.0, False, memory)
    turn_positions(tree, q, v, rates[: x.size - n])
    for s in range(n):
        rates[x.size - n + tree.velocities[s]] = memory.tree.force[s]


@kernel
def integrate_bodies(
    bodies: Bodies,
    q: Floats,
    v: Floats,
    u: Floats,
    length: float,
    step: float,
    tolerance: float,
    memory: BodiesMemory,
) -> float:
    """Moves q and v on for a time [s], and returns the next step; 0 if steps vanish."""
    bodies, memory = borrow(bodies), borrow(memory)
    nq, n = q.size, v.size
    x, y, K = np.empty(nq + n), np.empty(nq + n), np.empty((7, nq + n))
    x[:nq], x[nq:] = q, v
    done, h = 0.0, min(step, length)
    _find_rates(bodies, x, u, K[0], memory)
    for _ in range(_MOST_STEPS):
        is_last = done + h >= length
        used = length - done if is_last else h
        for s in range(1, 7):
            for i in range(nq + n):
                total = 0.0
                for r in range(s):
                    total += _A[s, r] * K[r, i]
                y[i] = x[i] + used * total
            _find_rates(bodies, y, u, K[s], memory)
        error = 0.0
        for i in range(nq + n):
            total = 0.0
            for s in range(7):
                total += _E[s] * K[s, i]
            error = max(error, abs(used * total) / (1.0 + abs(y[i])))
        if not np.isfinite(error):
            return 0.0
        scale = 0.9 * (tolerance / max(error, 1e-30)) ** 0.2
        if error <= tolerance:
            done += used
            x[:], K[0] = y, K[6]
            h = max(h, used * min(scale, 4.0)) if is_last else used * min(scale, 4.0)
            if is_last:
                q[:], v[:] = x[:nq], x[nq:]
                return h
        else:
            h = used * max(scale, 0.2)
    return 0.0
