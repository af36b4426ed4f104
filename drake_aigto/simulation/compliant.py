"""Motion under the exact law of compliant contact, integrated with a known error."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import (
    CompliantLaw,
    Mechanics,
    MechanicsMemory,
    TreeMechanics,
    TreeMechanicsMemory,
    accelerate,
    accelerate_bodies,
    calc_time_to_wall,
    make_mechanics_memory,
    make_mechanism,
    of_tree,
)
from drake_aigto.dynamics import turn_positions
from drake_aigto.geometry import BALL, CAPSULE, HALF_SPACE
from drake_aigto.kernels import borrow, borrowing, kernel
from drake_aigto.simulation.recording import (
    Controller,
    Impact,
    Recording,
    refuse_course,
    sample_rates,
)
from drake_aigto.world import SpaceWorld, World

# Tolerances of one step, relative to positions and velocities of 1: nearly rounding of sums, which
# are cheap; of trees, whose errors coarser steps show; and of steps that check a motion.
_OF_SUMS, _OF_TREES, _COARSE, FINE = 1e-13, 1e-10, 1e-8, 1e-11
# More steps are no motion any more, but numbers that run away; and rows that are read at once.
_MOST_STEPS, _BLOCK = 1_000_000, 256
# Steps in each hold of a control, at least: no touch is over within one.
_FEWEST = 8
# Step of the difference that gives φ̈, as a part of 1 s.
_DIFFERENCE = 1e-6

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
    """

    def __init__(self, world: World, law: CompliantLaw) -> None:
        """Reads the tables of compiled code."""
        self.world, self.law = world, law
        self.tolerance = _OF_TREES if isinstance(world, SpaceWorld) else _OF_SUMS
        self._tables = make_mechanism(world, law).fit(0.0, 1.0, 0.0)  # The law as it is.
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
        """Yields times, rows from then on, and the next step; see `follow`."""
        (time, end), most, passed = span, (span[1] - span[0]) / _FEWEST, 0
        kept = tolerance, self._memory, self._room
        while time < end:
            left, step = end - time, min(step, most)
            done, step, count = integrate(self._tables, x, control, left, step, most, *kept)
            if not (step > 0 and np.isfinite(x).all() and passed < _MOST_STEPS):
                raise refuse_course(time, self._list_edges())
            yield time, self._room[:count], step
            passed, time = passed + _BLOCK, end if done == left else time + done

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
                if flies and self._may_touch(rows):
                    return None
            time = held.until
        return x

    def _may_touch(self, rows: Floats) -> bool:
        clear = self.world.calc_clearance(rows[:, 1 : 1 + self.world.num_positions])
        return bool(np.any(np.min(clear, axis=0) <= np.max(np.abs(np.diff(clear, axis=0)), axis=0)))

    def _list_edges(self) -> list[str]:
        """Returns the names of pairs in which an edge touches a half space."""
        if not isinstance(world := self.world, SpaceWorld):
            return []
        found = zip(world.pairs, world.geometry.pair_kinds, strict=True)
        return [pair.name for pair, (a, b) in found if b == HALF_SPACE and a not in (BALL, CAPSULE)]

    def calc_mean_forces(self, rows: Rows) -> Floats:
        """Returns the mean normal force of each contact over a motion, shape (m,) [N]."""
        none = np.zeros((len(rows.times) - 1, 0))
        samples, _ = sample_rates(*rows, none)
        forces = self.law.calc_forces(*measure_steps(self.world, samples.states))
        return np.asarray(samples.weights @ forces) / (rows.times[-1] - rows.times[0])


class CompliantMotion:
    """A motion between compliant walls, or one that touches nothing, recorded.

    A touch from outside counts as a bounce, until it is over; controllers hear of none meanwhile.

    Attributes:
        time: now [s].
        recording: of what happened so far.
    """

    def __init__(
        self,
        dynamics: Compliant,
        state: tuple[Floats, Floats],
        time: float,
        tolerance: float | None = None,
    ) -> None:
        """Starts with (q, v) at a time [s]; the tolerance is that of a step."""
        self.time, self._dynamics = time, dynamics
        self._tolerance = tolerance or dynamics.tolerance
        self._x = np.concatenate([np.array(each, dtype=float) for each in state])
        self._step, self._rows, self._held = np.inf, list[Rows](), list[Floats]()
        self.recording = Recording(simulator="integrated")
        self.recording.add(time, *self._split())

    def _split(self) -> tuple[Floats, Floats]:
        return self._dynamics.world.split(self._x.copy())

    def run(self, controller: Controller) -> Recording:
        """Runs a controller to its end.

        Raises:
            TrajectoryError: see `Compliant.follow`.
        """
        recording = self.recording
        while self.time < controller.end:
            held = controller.sample(self.time, self._x.copy(), ())
            recording.hold(self.time, held)
            span, control = (self.time, held.until), np.array(held.control, dtype=float)
            rows, self._step = self._dynamics.follow(
                self._x, control, span, self._step, self._tolerance
            )
            self._rows.append(rows)
            self._held.append(np.tile(control, (len(rows.times), 1)))
            self.time = held.until
            recording.add(self.time, *self._split())
        self._read()
        return recording

    def _read(self) -> None:
        """Fills in samples, touches with the states about them, and depth."""
        recording, world = self.recording, self._dynamics.world
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
    if controller.is_open_loop and isinstance(world, SpaceWorld):
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


def _find_rates_of_bodies(
    mechanics: TreeMechanics, x: Floats, u: Floats, rates: Floats, memory: TreeMechanicsMemory
) -> None:
    """Computes ẋ of a state x = (q, v) of a tree."""
    n, nq = mechanics.tree.up.size, mechanics.num_positions
    accelerate_bodies(mechanics, x[:nq], x[nq:], u, 0.0, False, memory)
    turn_positions(mechanics.tree, x[:nq], x[nq:], rates[:nq])
    for i in range(n):
        rates[nq + i] = memory.acceleration[0, i]


@of_tree(_find_rates_of_bodies)
def _find_rates(
    mechanics: Mechanics, x: Floats, u: Floats, rates: Floats, memory: MechanicsMemory
) -> None:
    """Computes ẋ of a state x = (q, v), of sums or of a tree."""
    n = x.size // 2
    accelerate(mechanics, x, u, 0.0, False, memory)
    for i in range(n):
        rates[i], rates[n + i] = x[n + i], memory.acceleration[0, i]


@kernel
def integrate(
    tables: Any,
    x: Floats,
    u: Floats,
    length: float,
    step: float,
    most: float,
    tolerance: float,
    memory: Any,
    rows: Floats,
) -> tuple[float, float, int]:
    """Moves x on for a time [s], or until rows are full: times since the start, x and ẋ.

    Returns:
        The time that it moved on, the next step, 0 if steps vanish, and the number of rows.
    """
    tables, memory, nx = borrow(tables), borrow(memory), x.size
    y, K, done, h = np.empty(nx), np.empty((7, nx)), 0.0, min(step, length)
    count, tries = 0, 0
    _find_rates(tables, x, u, K[0], memory)
    while tries < _MOST_STEPS:
        tries += 1
        is_last = done + h >= length
        used = length - done if is_last else h
        for s in range(1, 7):
            for i in range(nx):
                total = 0.0
                for r in range(s):
                    total += _A[s, r] * K[r, i]
                y[i] = x[i] + used * total
            _find_rates(tables, y, u, K[s], memory)
        error = 0.0
        for i in range(nx):
            total = 0.0
            for s in range(7):
                total += _E[s] * K[s, i]
            error = max(error, abs(used * total) / (1.0 + abs(y[i])))
        if not np.isfinite(error):
            return done, 0.0, count
        scale = 0.9 * (tolerance / max(error, 1e-30)) ** 0.2
        if error > tolerance:
            h = used * max(scale, 0.2)
            continue
        _keep(rows[count], done, x, K[0])
        done, count = length if is_last else done + used, count + 1
        for i in range(nx):
            x[i], K[0, i] = y[i], K[6, i]
        h = max(h, used * min(scale, 4.0)) if is_last else used * min(scale, 4.0)
        h = min(h, most)
        if is_last or count == rows.shape[0] - 1:
            _keep(rows[count], done, x, K[0])
            return done, h, count + 1
    return done, 0.0, count


@borrowing
def _keep(row: Floats, time: float, x: Floats, rates: Floats) -> None:
    row[0] = time
    for i in range(x.size):
        row[1 + i], row[1 + x.size + i] = x[i], rates[i]
