"""Walls that are springs: a world's own equations, integrated from touch to touch."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.simulation.controller import Controller
from drake_aigto.simulation.hybrid import HybridMotion
from drake_aigto.simulation.recording import Impact, Recording
from drake_aigto.world import CompliantLaw, World, compile_springs

# How far beyond zero a phase of contact lasts: φ relative to the largest position or 1 m, and
# 1 − d φ̇. More than rounding, so that phases do not alternate at once.
_OVERLAP = 1e-13


class _End(NamedTuple):
    """Of a phase: where sign · y + overlap falls to zero, y being φ or 1 − d φ̇."""

    contact: int
    next: int  # phase
    sign: float
    is_rate: bool  # whether y is 1 − d φ̇


class _Phase(IntEnum):
    """What a contact is in."""

    FREE = 0  # φ > 0
    PRESSED = 1  # φ < 0, and 1 + d ẋ > 0
    SLACK = 2  # φ < 0, but it leaves so fast that the spring can't follow


class Springs(HybridMotion):
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
        inside = np.where(law.dissipation * rates < 1, _Phase.PRESSED, _Phase.SLACK)
        self._phases = np.where(distances > 0, _Phase.FREE, inside)
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
            contact, phase = self._follow_phases(control, until)
            if contact < 0:
                return
            before, self._phases[contact] = self._phases[contact], phase
            if before == _Phase.FREE:
                self._touch(contact, control)
            elif phase == _Phase.FREE:
                self._leave(contact)
                if feels_contact:
                    return

    def _follow_phases(self, control: Floats, until: float) -> tuple[int, int]:
        """Moves on until a phase ends: of which contact, −1 if none, and what it is in then."""
        n, law, calc_rates = self.world.num_positions, self._law, self._calc_rates
        pressed, ends = self._phases == _Phase.PRESSED, self._list_ends()
        force = self.world.actuation @ control
        contacts = np.array([end.contact for end in ends], dtype=int)
        signs, is_rate = np.array([end.sign for end in ends]), [end.is_rate for end in ends]
        overlap = np.where(is_rate, 1.0, max(1.0, float(np.max(np.abs(self.x[:n]))))) * _OVERLAP

        def rates(x: Floats) -> Floats:
            return calc_rates(x, force, pressed)

        def watched(x: Floats) -> Floats:
            distances, speeds, _ = self._measure(x)
            values = np.where(
                is_rate,
                (1 - law.dissipation * speeds)[..., contacts],
                distances[..., contacts],
            )
            return signs * values + overlap

        fallen = self._follow(rates, watched, control, until)
        return (-1, _Phase.FREE) if fallen < 0 else (ends[fallen].contact, ends[fallen].next)

    def _list_ends(self) -> list[_End]:
        """Returns what ends the phase of each contact."""
        ends = []
        for i, phase in enumerate(self._phases):
            if phase == _Phase.FREE:
                ends.append(_End(i, _Phase.PRESSED, 1.0, False))
                continue
            ends.append(_End(i, _Phase.FREE, -1.0, False))
            if phase == _Phase.SLACK:
                ends.append(_End(i, _Phase.PRESSED, -1.0, True))
            elif self._law.dissipation[i] > 0:
                ends.append(_End(i, _Phase.SLACK, 1.0, True))
        return ends

    def _measure(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Returns `CompliantLaw.find_gaps` of states (…, 2 nv), shape (…, m) each."""
        n, world = self.world.num_positions, self.world
        q, v = x[..., :n], x[..., n:]
        return self._law.find_gaps(world.calc_signed_distance(q), world.calc_contact_rate(q, v))

    def _touch(self, contact: int, control: Floats) -> None:
        """Notes that a contact begins."""
        self.recording.add(self.time, *self._split())
        self._touched[contact] = read_touch(self.world, self.time, self.x, contact, control)

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
