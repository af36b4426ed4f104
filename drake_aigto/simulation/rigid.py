"""Exactly rigid walls around any mechanism: flight is integrated, events are roots along it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.contact import Closed, ContactMotion, Mode, RigidLaw
from drake_aigto.simulation import flights
from drake_aigto.simulation.flights import MOST_IMPACTS, STATE, HybridState, Rules
from drake_aigto.simulation.smooth import HybridMotion
from drake_aigto.world import World

# This near to a wall is at it, relative to the largest position or 1 m, and this much air is left
# by what happens there: more than rounding, so that what falls to the wall has been above it.
_AIR = 1e-13
# A contact lets go when it pulls by this, relative to the largest acceleration or 1 m/s².
_PULL = 1e-11

OfStates = Callable[[Floats], Floats]


class RigidMotion(HybridMotion):
    """A world whose walls are exactly rigid and frictionless, wherever M and J depend on q.

        flight    M(q) v̇ + h(q, v) = B u                             while φ(q) > 0
        impact    v⁺ = v⁻ − (1 + e_i) M⁻¹ J_iᵀ (J_i M⁻¹ J_iᵀ)⁻¹ J_i v⁻    when φ_i = 0, J_i v⁻ < 0
        rest      M v̇ + h(q, v) = B u + J_Rᵀ λ,  J_R v̇ + J̇_R v = 0     while λ ≥ 0

    Between events, and in rest, motion is smooth and integrated nearly to rounding (`follow`), with
    every root of φ and λ along it. At an event the mechanism is one of constant inertia, and what
    happens is what happens there (`flights.run`): several impacts take turns, and one becomes rest
    if the hop after it would be too short.
    """

    def __init__(
        self, world: World, law: RigidLaw, state: tuple[Floats, Floats], span: tuple[float, float]
    ) -> None:
        """Starts at rest on nothing, with nothing known of contacts.

        Args:
            world: its dynamics and its contacts.
            law: of these contacts.
            state: the start, (q, v).
            span: from when to when will be simulated [s].
        """
        super().__init__(world, state, span[0])
        self._rules, self._friction = Rules(law.restitution, span[1] - span[0]), law.friction
        m = world.num_contacts
        self._held, self._counts = np.zeros(m, dtype=bool), np.zeros(m)
        self._log = flights.make_log(MOST_IMPACTS, world.num_positions + 1)

    def _advance(self, control: Floats, until: float, feels_contact: bool) -> None:
        known = len(self.recording.impacts)
        self._resolve(control)
        while self.time < until:
            if feels_contact and len(self.recording.impacts) > known:
                return
            self._move(control, until)
            self._resolve(control)

    def _move(self, control: Floats, until: float) -> None:
        """Moves on smoothly until something may happen."""
        n, (q, _) = self.world.num_positions, self._split()
        # Faces that may be touched, and those behind of solids that are rested on. A solid is
        # entered only when the last of the faces falls that the sphere is in front of.
        distances, clear = self.world.calc_signed_distance(q), calc_air(q) / 2
        is_held = self.world.are_of_one_solid @ self._held
        ahead = np.flatnonzero(~is_held & (distances > clear))
        beside = np.flatnonzero(is_held & ~self._held & (distances < -clear))
        closed = self._close(np.flatnonzero(self._held))
        lasting = self._watch(closed, control)

        def rates(x: Floats) -> Floats:
            return np.concatenate([x[..., n:], closed.calc_push(x, control).acceleration], axis=-1)

        def watched(x: Floats) -> Floats:
            distances = self.world.calc_signed_distance(x[..., :n])
            values = distances[..., ahead], -distances[..., beside], lasting(x)
            return np.concatenate(values, axis=-1)

        slid = self._follow(rates, watched, control, until) - len(ahead)
        if 0 <= slid < len(beside):
            solid = self.world.contacts[beside[slid]].solid
            self._held &= [contact.solid != solid for contact in self.world.contacts]

    def _close(self, contacts: Ints) -> Closed:
        """Returns contacts that are closed, and slide freely."""
        modes = (Mode.FORWARD,) * len(contacts)
        return Closed(self.world, contacts, modes, self._friction[contacts])

    def _watch(self, closed: Closed, control: Floats) -> OfStates:
        """Returns what is above zero while contacts go on as they do, of states (…, 2 nv)."""
        push = closed.calc_push(self.x, control)
        pull = self._calc_pull(closed, push.acceleration)
        # Of contacts that hold each other up without need, some may pull all the while.
        pressing = np.flatnonzero(push.normal > -pull)

        def lasting(x: Floats) -> Floats:
            return closed.calc_push(x, control).normal[..., pressing] + pull[pressing]

        return lasting

    def _calc_pull(self, closed: Closed, acceleration: Floats) -> Floats:
        """Returns with how little of a pull contacts let go, shape (k,) [N]."""
        masses = self.world.inertia_at(self.x[: self.world.num_positions]).masses[closed.contacts]
        return _PULL * max(1.0, float(np.max(np.abs(acceleration)))) * masses

    def _resolve(self, control: Floats) -> None:
        """Lets go of walls, or bounces off them, at this instant."""
        q, v = self._split()
        world, air = self.world, calc_air(q)
        if not self._held.any() and np.all(world.calc_clearance(q) > air):
            return
        motion, n = ContactMotion.at(world, self.x), len(q)
        phase = HybridState(motion.extend(q, 0.0), motion.extend(v, 0.0), self._held, self._counts)
        free = motion.extend(world.calc_acceleration(q, v, control), 1.0)
        walls = motion.walls._replace(offset=motion.walls.offset - air)
        moment = free, self.time, 0.0, False
        count = flights.advance(walls, self._rules, phase, *moment, self._log)
        states = self._log[:count, STATE:].reshape(-1, 3, n + 1)[..., :n].reshape(-1, 3 * n)
        rows = np.hstack([self._log[:count, :STATE], states])
        rows[-1:, -n:] = phase.v[:n]  # What follows is too slow for impacts, and part of the last.
        self.recording.add_impacts(rows, world.calc_mass_matrix(q))
        self.x = np.concatenate([phase.q[:n], phase.v[:n]])

    def _find_depth(self) -> float:
        states = np.concatenate([samples.states for samples, _ in self.recording.samples])
        clearances = self.world.calc_clearance(states[:, : self.world.num_positions])
        return max(0.0, -float(np.min(clearances, initial=0.0)))


def calc_air(q: Floats) -> float:
    """Returns how near to a wall is at it [m]."""
    return _AIR * max(1.0, float(np.max(np.abs(q))))
