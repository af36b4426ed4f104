"""Motion under the exact law of compliant contact, integrated with a known error."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import (
    CompliantLaw,
    calc_time_to_wall,
    make_mechanics_memory,
    make_mechanism,
)
from drake_aigto.simulation.embedded import MOST_STEPS, integrate
from drake_aigto.simulation.recording import (
    Controller,
    HeldControl,
    Impact,
    Recording,
    refuse_course,
    sample_rates,
)
from drake_aigto.simulation.smooth import HybridMotion
from drake_aigto.world import SpaceWorld, World

# Tolerances of one step, relative to positions and velocities of 1: nearly rounding of sums, which
# are cheap; of trees, whose errors coarser steps show; and of steps that check a motion.
_OF_SUMS, _OF_TREES, _COARSE, FINE = 1e-13, 1e-10, 1e-8, 1e-11
# Rows that are read at once.
_BLOCK = 256
# Steps in each hold of a control, at least: no touch is over within one.
_FEWEST = 8
# Step of the difference that gives φ̈, as a part of 1 s.
_DIFFERENCE = 1e-6


class Rows(NamedTuple):
    """The ends of steps of a motion, K of them; two of one time where the control changes."""

    times: Floats  # shape (K,) [s]
    states: Floats  # (q, v), shape (K, nx)
    rates: Floats  # of the same, shape (K, nx)


class Compliant:
    """Dynamics of a world whose contacts are compliant.

        M v̇ + h(q, v) = B u + Jᵀ f + d,    q̇ = N(q) v

    with forces f and friction d of the law (`CompliantLaw`, and `contact.touching` in space). Steps
    of a Runge-Kutta method of order 5 are as short as its own estimate of their error asks for,
    which sees the kinks where contacts begin, end, stick and slip.

    Attributes:
        world: the mechanism.
        law: of its contacts.
        tolerance: of steps, the usual one.
        most_steps: in each hold of a control; more are no motion.
    """

    def __init__(self, world: World, law: CompliantLaw) -> None:
        """Reads the tables of compiled code."""
        self.world, self.law = world, law
        self.most_steps = MOST_STEPS
        self.tolerance = _OF_TREES if isinstance(world, SpaceWorld) else _OF_SUMS
        law_as_it_is = make_mechanism(world, law, brakes=False)
        self._tables = law_as_it_is.fit(0.0, 1.0, 0.0)
        self._memory = make_mechanics_memory(self._tables)
        self._room = np.empty((_BLOCK, 1 + 2 * (world.num_positions + world.num_velocities)))

    def follow(
        self, x: Floats, control: Floats, span: tuple[float, float], step: float, tolerance: float
    ) -> tuple[Rows, float]:
        """Returns the motion from a state (q, v) under a control, and the step that comes next.

        Args:
            x: shape (nx,), which becomes the state at the end.
            control: shape (nu,).
            span: when it begins and ends [s].
            step: that is tried first [s].
            tolerance: of a step.

        Raises:
            TrajectoryError: it runs away to infinity, or goes so fast that it would take minutes.
        """
        blocks = list[Floats]()
        for time, rows, tried in self._move(x, control, span, step, tolerance):
            blocks.append(rows.copy())
            blocks[-1][:, 0] += time
            step = tried
        all_rows, ends = np.concatenate(blocks), 1 + len(x)
        return Rows(all_rows[:, 0], all_rows[:, 1:ends], all_rows[:, ends:]), step

    def _move(
        self, x: Floats, control: Floats, span: tuple[float, float], step: float, tolerance: float
    ) -> Iterator[tuple[float, Floats, float]]:
        """Yields times, rows from then on, and next steps; see `follow`."""
        (now, end), passed = span, 0
        most = (end - now) / _FEWEST
        while now < end:
            left = end - now
            done, step, count = integrate(
                self._tables, x, control, left, most, step, tolerance, self._memory, self._room
            )
            if not (step > 0 and np.isfinite(x).all() and passed < self.most_steps):
                edges = self.world.edges if isinstance(self.world, SpaceWorld) else ()
                raise refuse_course(now, edges)
            yield now, self._room[:count], step
            now = now + done if done < left else end
            passed += _BLOCK

    def lead(self, x: Floats, controller: Controller, flies: bool = False) -> Floats | None:
        """Returns (q, v) after a controller, shape (nx,), and keeps nothing of the way there.

        Args:
            x: (q, v) at its start.
            controller: is run to its end.
            flies: whether nothing may be touched; None is returned where a solid is nearer at the
                end of a step than it moves in any.

        Raises:
            TrajectoryError: see `follow`.
        """
        x, time, step = np.array(x, dtype=float), controller.start, np.inf
        while time < controller.end:
            held = controller.sample(time, x.copy(), ())
            control, span = np.array(held.control, dtype=float), (time, held.until)
            for _, rows, tried in self._move(x, control, span, step, self.tolerance):
                step = tried
                if flies:
                    clear = self.world.calc_clearance(rows[:, 1 : 1 + self.world.num_positions])
                    moved = np.max(np.abs(np.diff(clear, axis=0)), axis=0)
                    if np.any(np.min(clear, axis=0) <= moved):
                        return None
            time = held.until
        return x

    def calc_mean_forces(self, rows: Rows) -> Floats:
        """Returns the mean normal force of each contact over a motion, shape (m,) [N]."""
        none = np.zeros((len(rows.times) - 1, 0))
        samples, _ = sample_rates(*rows, none)
        forces = self.law.calc_forces(*measure_steps(self.world, samples.states))
        return np.asarray(samples.weights @ forces) / (rows.times[-1] - rows.times[0])


class CompliantMotion(HybridMotion):
    """A motion between compliant walls, or one that touches nothing, recorded.

    A touch from outside counts as a bounce, until it is over; controllers hear of none meanwhile.
    """

    def __init__(
        self,
        dynamics: Compliant,
        state: tuple[Floats, Floats],
        time: float,
        tolerance: float | None = None,
    ) -> None:
        """Starts with (q, v) at a time [s]; the tolerance is that of a step."""
        super().__init__(dynamics.world, state, time)
        self._dynamics, self._tolerance = dynamics, tolerance or dynamics.tolerance
        self._rows, self._held = list[Rows](), list[Floats]()
        self.recording.simulator = "integrated"

    def _advance(self, control: Floats, until: float, feels_contact: bool) -> None:
        x, held = self.x.copy(), np.array(control, dtype=float)
        rows, self._step = self._dynamics.follow(
            x, held, (self.time, until), self._step, self._tolerance
        )
        self._rows.append(rows)
        self._held.append(np.tile(held, (len(rows.times), 1)))
        self.time, self.x = until, x

    def _finish(self) -> None:
        """Records samples, touches with the states about them, and depth."""
        recording, world = self.recording, self.world
        times, states, rates = (np.concatenate(part) for part in zip(*self._rows, strict=True))
        controls = np.concatenate(self._held)
        recording.samples.append(sample_rates(times, states, rates, controls[:-1]))
        if not world.num_contacts:
            return
        distances, speeds = measure_steps(world, states)
        gaps, speeds, _ = self._dynamics.law.find_gaps(distances, speeds)
        recording.max_penetration = find_depth(times, gaps, speeds)
        recording.impacts, beside = read_touches(world, times, states, controls, distances)
        rows = list(zip(recording.times, recording.positions, recording.velocities, strict=True))
        rows += [(time, *world.split(x)) for time, x in beside]
        recording.times, recording.positions, recording.velocities = [], [], []
        for row in sorted(rows, key=lambda row: row[0]):
            recording.add(*row)


def simulate_compliant(
    world: World, law: CompliantLaw, state: tuple[Floats, Floats], controller: Controller
) -> Recording:
    """Runs a controller; in space the recording's error is the change of the end in coarser steps.

    Raises:
        TrajectoryError: see `Compliant.follow`.
    """
    dynamics = Compliant(world, law)
    recording = CompliantMotion(dynamics, state, controller.start).run(controller)
    if isinstance(controller, HeldControl) and isinstance(world, SpaceWorld):
        coarse = CompliantMotion(dynamics, state, controller.start, _COARSE).run(controller)
        off = world.subtract(coarse.positions[-1], recording.positions[-1])
        recording.error = float(np.linalg.norm(off))
    return recording


def measure_steps(world: World, states: Floats) -> tuple[Floats, Floats]:
    """Returns φ [m] and φ̇ [m/s] of states (K, nx), shape (K, m) each.

    Rates are those of states in contact and next to these, and 0 elsewhere.
    """
    q, v = world.split(states)
    distances = world.calc_signed_distance(q)
    inside = np.pad(np.any(distances <= 0, axis=1), 1)
    near, rates = inside[2:] | inside[1:-1] | inside[:-2], np.zeros_like(distances)
    rates[near] = world.calc_contact_rate(q[near], v[near])
    return distances, rates


def read_touches(
    world: World, times: Floats, states: Floats, controls: Floats, distances: Floats
) -> tuple[list[Impact], list[tuple[float, Floats]]]:
    """Returns touches from outside of a motion in steps, and times and states as each begins, ends.

    Args:
        world: the mechanism.
        times: of the ends of steps, shape (K,) [s].
        states: (q, v) there, shape (K, nx).
        controls: just after, shape (K, nu).
        distances: of contacts there, shape (K, m) [m].
    """
    outside, found, beside = distances > 0, list[Impact](), list[tuple[float, Floats]]()

    def calc_rate(contact: int, q: Floats, v: Floats) -> float:
        return float(world.calc_contact_rate(q, v)[contact])

    for k, contact in np.argwhere(outside[:-1] & ~outside[1:]).tolist():
        step, (q, v), later = times[k + 1] - times[k], *map(world.split, states[k : k + 2])
        acceleration, rate = (later[1] - v) / step, calc_rate(contact, q, v)
        bend = (calc_rate(contact, *later) - rate) / step
        t = min(calc_time_to_wall(float(distances[k, contact]), rate, bend), step)
        q, v = world.add(q, t * (v + t / 2 * acceleration)), v + t * acceleration
        leaves = np.flatnonzero(outside[k + 1 :, contact])
        last = k + 1 + int(leaves[0]) if len(leaves) else len(times) - 1
        before, after = (
            float(world.calc_kinetic_energy(*each)) for each in ((q, v), world.split(states[last]))
        )
        free, rate = world.calc_acceleration(q, v, controls[k]), calc_rate(contact, q, v)
        ahead = world.add(q, _DIFFERENCE * v), v + _DIFFERENCE * free
        push, time = (calc_rate(contact, *ahead) - rate) / _DIFFERENCE, float(times[k] + t)
        found.append(Impact(time, contact, -rate, push, before, after))
        beside += [(time, np.concatenate([q, v])), (float(times[last]), states[last])]
    found.sort(key=lambda impact: (impact.time, impact.contact))
    return found, beside


def find_depth(times: Floats, distances: Floats, rates: Floats) -> float:
    """Returns the deepest −φ, at least 0 [m], of rows φ and φ̇ at times (K,), shape (K, m) each.

    Between rows where φ̇ turns positive φ is taken for a parabola.
    """
    turns = (rates[:-1] < 0) & (rates[1:] > 0)
    parts = np.where(turns, rates[:-1] / np.where(turns, rates[:-1] - rates[1:], 1.0), 0.0)
    lowest = distances[:-1] + rates[:-1] * parts * np.diff(times)[:, np.newaxis] / 2
    return max(0.0, -float(np.min(distances, initial=0.0)), -float(np.min(lowest, initial=0.0)))
