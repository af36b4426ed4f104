"""Walls that are springs: a world's own equations, integrated from touch to touch."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints, read_only
from drake_aigto.contact import CompliantLaw, calc_deeper, dot, find_gap, find_share
from drake_aigto.dynamics import divide_by_masses, evaluate_sums
from drake_aigto.kernels import kernel
from drake_aigto.simulation.recording import Controller, Impact, Recording
from drake_aigto.simulation.smooth import HybridMotion
from drake_aigto.world import World

# How far beyond zero a phase of contact lasts: φ relative to the largest position or 1 m, and
# 1 − d φ̇. More than rounding, so that phases do not alternate at once.
_OVERLAP = 1e-13


class _End(NamedTuple):
    """Of a phase: where sign · y + overlap falls to zero, y being φ or 1 − d φ̇."""

    contact: int
    next: int  # phase
    sign: float
    is_rate: bool  # whether y is 1 − d φ̇


class _ContactState(IntEnum):
    """Phase of a contact."""

    FREE = 0  # φ > 0
    PRESSED = 1  # φ < 0, and 1 + d ẋ > 0
    SLACK = 2  # φ < 0, but it leaves so fast that the spring can't follow


class SpringMotion(HybridMotion):
    """A world whose walls push as its contact law says (`CompliantLaw`).

        M v̇ + h(q, v) = B u + Jᵀ f + d,    f = k x max(0, 1 + d ẋ),    x = max(0, −φ)

    Friction d is that of `Rubbing.calc_drag`. The force is smooth while each contact is in one
    phase, and the phase changes where φ or 1 − d φ̇ is zero. Each of these stretches is integrated
    nearly to rounding (`follow`), so that no kink is stepped over. What counts as a bounce is every
    touch from outside.
    """

    def __init__(
        self, world: World, law: CompliantLaw, state: tuple[Floats, Floats], time: float
    ) -> None:
        """Starts with (q, v) at a time [s], maybe inside a wall."""
        super().__init__(world, state, time)
        self._law, self._calc_rates = law, compile_springs(world, law)
        q, v = state
        distances, rates = world.calc_signed_distance(q), world.calc_contact_jacobian(q) @ v
        inside = np.where(law.dissipation * rates < 1, _ContactState.PRESSED, _ContactState.SLACK)
        self._phases = np.where(distances > 0, _ContactState.FREE, inside)
        self._touched: dict[int, Impact] = {}  # each contact that goes on, as it began

    def run(self, controller: Controller) -> Recording:
        """Runs a controller, as any motion; contacts that last count until the end."""
        recording = super().run(controller)
        for contact in list(self._touched):
            self._leave(contact)
        recording.impacts.sort(key=lambda impact: impact.time)
        return recording

    def _advance(self, control: Floats, until: float, feels_contact: bool) -> None:
        while self.time < until:
            if (end := self._follow_phases(control, until)) is None:
                return
            contact, before = end.contact, self._phases[end.contact]
            self._phases[contact] = end.next
            if before == _ContactState.FREE:
                self.recording.add(self.time, *self._split())
                self._touched[contact] = read_touch(self.world, self.time, self.x, contact, control)
            elif end.next == _ContactState.FREE:
                self._leave(contact)
                if feels_contact:
                    return

    def _follow_phases(self, control: Floats, until: float) -> _End | None:
        """Moves on until a phase ends, and returns which did."""
        n, law, calc_rates = self.world.num_positions, self._law, self._calc_rates
        pressed, ends = self._phases == _ContactState.PRESSED, self._list_ends()
        force = self.world.actuation @ control
        contacts = np.array([end.contact for end in ends], dtype=int)
        signs, is_rate = np.array([end.sign for end in ends]), [end.is_rate for end in ends]
        overlap = np.where(is_rate, 1.0, max(1.0, float(np.max(np.abs(self.x[:n]))))) * _OVERLAP

        def rates(x: Floats) -> Floats:
            return calc_rates(x, force, pressed)

        def watched(x: Floats) -> Floats:
            distances, speeds, _ = self._measure(x)
            slacks = 1 - law.dissipation * speeds
            values = np.where(is_rate, slacks[..., contacts], distances[..., contacts])
            return signs * values + overlap

        fallen = self._follow(rates, watched, control, until)
        return None if fallen < 0 else ends[fallen]

    def _list_ends(self) -> list[_End]:
        """Returns what ends the phase of each contact."""
        ends = []
        for i, phase in enumerate(self._phases):
            if phase == _ContactState.FREE:
                ends.append(_End(i, _ContactState.PRESSED, 1.0, False))
                continue
            ends.append(_End(i, _ContactState.FREE, -1.0, False))
            if phase == _ContactState.SLACK:
                ends.append(_End(i, _ContactState.PRESSED, -1.0, True))
            elif self._law.dissipation[i] > 0:
                ends.append(_End(i, _ContactState.SLACK, 1.0, True))
        return ends

    def _measure(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Returns `CompliantLaw.find_gaps` of states (…, 2 nv), shape (…, m) each."""
        n, world = self.world.num_positions, self.world
        q, v = x[..., :n], x[..., n:]
        return self._law.find_gaps(world.calc_signed_distance(q), world.calc_contact_rate(q, v))

    def _leave(self, contact: int) -> None:
        """Notes that a contact ends, unless it began inside the wall."""
        self.recording.add(self.time, *self._split())
        if contact in self._touched:
            energy = float(self.world.calc_kinetic_energy(*self._split()))
            impact = self._touched.pop(contact)._replace(energy_after=energy)
            self.recording.impacts.append(impact)

    def _find_depth(self) -> float:
        states = np.concatenate([samples.states for samples, _ in self.recording.samples])
        times = np.concatenate([samples.times for samples, _ in self.recording.samples])
        distances, rates, _ = self._measure(states)
        rows = self.world.calc_signed_distance(np.array(self.recording.positions))
        return max(find_depth(times, distances, rates), -float(np.min(rows, initial=0.0)))


def read_touch(world: World, time: float, x: Floats, contact: int, control: Floats) -> Impact:
    """Returns how a contact begins, in a state x = (q, v); its energy after is the one before."""
    q, v = np.split(x, 2)
    J, bias = world.calc_contact_jacobian(q)[contact], world.calc_contact_bias(q, v)[contact]
    push = float(J @ world.calc_acceleration(q, v, control) + bias)
    energy = float(world.calc_kinetic_energy(q, v))
    return Impact(time, contact, -float(J @ v), push, energy, energy)


def find_depth(times: Floats, distances: Floats, rates: Floats) -> float:
    """Returns the deepest −φ, at least 0 [m], of rows φ and φ̇ at times (K,), shape (K, m) each.

    Between rows where φ̇ turns positive φ is taken for a parabola.
    """
    turns = (rates[:-1] < 0) & (rates[1:] > 0)
    parts = np.where(turns, rates[:-1] / np.where(turns, rates[:-1] - rates[1:], 1.0), 0.0)
    lowest = distances[:-1] + rates[:-1] * parts * np.diff(times)[:, np.newaxis] / 2
    return max(0.0, -float(np.min(distances, initial=0.0)), -float(np.min(lowest, initial=0.0)))


# Factors, waves, members and coefficients (`evaluate_sums`).
Sums: TypeAlias = tuple[Ints, Floats, Ints, Floats]


class SpringTables(NamedTuple):
    """Equations and law as arrays: n coordinates, m contacts.

    Attributes:
        dynamics: M, h, φ and J of (q, v), row by row.
        tangents: T of q, row by row.
        stiffness: see `CompliantLaw`, shape (m,), as the next three.
        dissipation: see there.
        friction: see there.
        reaches: see there.
        radii: see there.
        spins: W of `Rubbing`, shape (m, n).
        dry_friction: of each coordinate, shape (n,) [N, N m].
        stiction_speed: v_s [m/s, rad/s].
    """

    dynamics: Sums
    tangents: Sums
    stiffness: Floats
    dissipation: Floats
    friction: Floats
    reaches: Floats
    radii: Floats
    spins: Floats
    dry_friction: Floats
    stiction_speed: float


@kernel
def calc_spring_rates(x: Floats, actuation: Floats, pressed: Bools, tables: SpringTables) -> Floats:
    """Returns ẋ of a state x = (q, v), shape (2n,): that of `World.calc_acceleration`.

    There with `CompliantLaw.calc_forces` and `calc_drag`, of the contacts that are pressed;
    what those would pull with counts, so that it is smooth.

    Args:
        x: shape (2n,).
        actuation: B u, shape (n,) [N, N m].
        pressed: which contacts push, shape (m,).
        tables: of the world.
    """
    n, m = x.size // 2, pressed.size
    q, v = x[:n], x[n:]
    values = evaluate_sums(x.reshape(1, -1), *tables.dynamics)[0]
    masses, bias = values[: n * n], values[n * n : n * n + n]
    distances = values[n * n + n : n * n + n + m]
    normals = values[n * n + n + m :].reshape(m, n)
    rates, force = np.empty(2 * n), np.empty(n)
    for i in range(n):
        rates[i] = v[i]
        share = find_share(v[i] / tables.stiction_speed)
        force[i] = actuation[i] - bias[i] - tables.dry_friction[i] * share
    tangents, has_tangents = normals, False
    for c in range(m):
        if not pressed[c]:
            continue
        gap, lever = find_gap(tables.reaches[c], distances[c])
        speed = dot(normals, c, v) * lever
        push = -tables.stiffness[c] * gap * (1.0 - tables.dissipation[c] * speed) * lever
        drag = 0.0
        if tables.friction[c] > 0.0:
            if not has_tangents:
                tangents = evaluate_sums(q.reshape(1, -1), *tables.tangents)[0].reshape(m, n)
                has_tangents = True
            for i in range(n):  # Each row is of one contact.
                deeper = calc_deeper(tables.reaches[c], tables.radii[c], gap)
                tangents[c, i] -= deeper * tables.spins[c, i]
            share = find_share(dot(tangents, c, v) * lever / tables.stiction_speed)
            drag = tables.friction[c] * push * share
        for i in range(n):
            force[i] += normals[c, i] * push
            if drag != 0.0:
                force[i] -= tangents[c, i] * drag
    rates[n:] = divide_by_masses(masses.reshape(1, -1), force.reshape(1, -1))[0]
    return rates


# States (2n,), B u (n,) and which contacts are pressed (m,) → ẋ (2n,).
SpringRates: TypeAlias = Callable[[Floats, Floats, Bools], Floats]


def compile_springs(world: World, law: CompliantLaw) -> SpringRates:
    """Returns ẋ of a state x = (q, v) as one compiled function, see `calc_spring_rates`.

    It is that of `World.calc_acceleration` with forces of the law's springs, friction included,
    which takes ten times as long, state by state.
    """
    dynamics, dry = world.dynamics_map.tables, world.dry_friction
    none = np.zeros(world.num_velocities)
    tables = SpringTables(
        dynamics=dynamics,
        tangents=world.rubbing.tangent_map.tables if law.has_friction else dynamics,
        stiffness=law.stiffness,
        dissipation=law.dissipation,
        friction=law.friction,
        reaches=law.reaches,
        radii=law.radii,
        spins=world.rubbing.spins,
        dry_friction=read_only(none if dry is None else dry),
        stiction_speed=world.stiction_speed,
    )
    return partial(calc_spring_rates, tables=tables)
