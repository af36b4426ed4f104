"""Exactly rigid walls around any mechanism, with Coulomb's friction of planar ones or without."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.contact import (
    RANK,
    Closed,
    ContactMotion,
    Mode,
    RigidLaw,
    Touching,
    Walls,
    calc_contact_turning,
    calc_depth,
    calc_velocity_after,
    find_modes,
    list_modes,
    refuse_modes,
    stack_rows,
)
from drake_aigto.errors import FrictionError
from drake_aigto.simulation import flights
from drake_aigto.simulation.flights import (
    MOST_IMPACTS,
    SHORTEST_HOP,
    STATE,
    HybridState,
    Rules,
    copy_phase,
)
from drake_aigto.simulation.recording import Impact
from drake_aigto.simulation.smooth import HybridMotion
from drake_aigto.world import World

# This near to a wall is at it, relative to the largest position or 1 m, and this much air is left
# by what happens there: more than rounding, so that what falls to the wall has been above it.
_AIR = 1e-13
# A contact lets go when it pulls by this, relative to the largest acceleration or 1 m/s².
_PULL = 1e-11

# Velocities of contacts below this, relative to the largest velocity so far or 1 m/s, are none.
_STILL = 1e-11
# Where what forces have to be divided by is this small, relative to masses, they have no answer;
# where it is below the second, contacts hold each other up without need.
_SINGULAR, _NEEDLESS = 1e-6, 1e-11

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
        self._log = flights.make_log(0, 0)

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
        if not len(closed.contacts):
            return lambda x: np.empty((*x.shape[:-1], 0))
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
        motion = ContactMotion.at(world, self.x)
        free = motion.extend(world.calc_acceleration(q, v, control), 1.0)
        walls = motion.walls._replace(offset=motion.walls.offset - air)
        self._pass(walls, free, self.time, False)

    def _pass(self, walls: Walls, acceleration: Floats, until: float, stops: bool) -> None:
        """Passes a moment until a time [s], or until its first impact if it stops there."""
        n, (q, v) = self.world.num_positions, self._split()
        left, more = until - self.time, np.zeros(len(acceleration) - self.world.num_positions)
        start = HybridState(np.append(q, more), np.append(v, more), self._held, self._counts)
        while True:
            phase = copy_phase(start)
            moment = phase, acceleration, until, left, stops
            count = flights.advance(walls, self._rules, *moment, self._log)
            if count <= len(self._log):
                break
            self._log = flights.make_log(count, len(phase.q))
        states = self._log[:count, STATE:].reshape(-1, 3, len(phase.q))[..., :n].reshape(-1, 3 * n)
        rows = np.hstack([self._log[:count, :STATE], states])
        if not left:  # What follows is too slow for impacts, and part of the last.
            rows[-1:, -n:] = phase.v[:n]
        self.recording.add_impacts(rows, self.world.calc_mass_matrix(q))
        self._held, self._counts = phase.resting, phase.counts
        self.x = np.concatenate([phase.q[:n], phase.v[:n]])
        self.time = float(self._log[0, flights.TIME]) if stops and count else until

    def _finish(self) -> None:
        states = np.concatenate([samples.states for samples, _ in self.recording.samples])
        clearances = self.world.calc_clearance(states[:, : self.world.num_positions])
        self.recording.max_penetration = max(0.0, -float(np.min(clearances, initial=0.0)))


class Flights(RigidMotion):
    """The same where flight is a parabola: by roots alone, without integration."""

    def _advance(self, control: Floats, until: float, feels_contact: bool) -> None:
        dynamics = self.world.constant_dynamics
        acceleration = dynamics.gain @ control + dynamics.drift
        self._pass(Walls.of(dynamics), acceleration, until, feels_contact)

    def _finish(self) -> None:
        walls = Walls.of(self.world.constant_dynamics)
        self.recording.max_penetration = calc_depth(walls, self.recording.positions)


class SlidingMotion(RigidMotion):
    """A world whose walls are exactly rigid and have friction, each with its μ.

        flight    M(q) v̇ + h(q, v) = B u                               while φ(q) > 0
        impact    v⁺ = v⁻ + M⁻¹ (J_iᵀ p_n + T_iᵀ p_t)                  (`calc_impulse`)
        contact   M v̇ + h(q, v) = B u + J_Cᵀ f_n + T_Cᵀ f_t,  J_C v̇ + J̇_C v = 0     while f_n ≥ 0
          slip    f_t = −μ sign(s) f_n                                 while s = T v ≠ 0
          stick   T v̇ + Ṫ v = 0                                        while |f_t| ≤ μ f_n

    Motion is smooth between events, which are roots along it: contacts begin and let go, slip ends,
    and stick gives way. Which contacts stick, slip or open from there is found by trying
    (`find_modes`). Several impacts at once take turns in the order of the world's contacts, until
    none is approached any more; what never ends that way, as collapse in a wedge, ends in an impact
    of all that returns nothing.
    """

    def __init__(
        self, world: World, law: RigidLaw, state: tuple[Floats, Floats], span: tuple[float, float]
    ) -> None:
        """Starts at rest on nothing; arguments are those of `RigidMotion`."""
        super().__init__(world, law, state, span)
        self._modes = np.full(world.num_contacts, Mode.OPEN, dtype=int)
        self._last, self._stalls, self._fastest = -np.inf, 0, 1.0

    def _move(self, control: Floats, until: float) -> None:
        self._stalls = self._stalls + 1 if self.time == self._last else 0
        self._last = self.time
        if self._stalls > MOST_IMPACTS:
            raise FrictionError(
                f"contact with friction at {self.time:g} s",
                got=f"more than {MOST_IMPACTS} changes between stick and slip at once",
                expected="motion that goes on",
                remedy="Ask for contact: compliant.",
            )
        start, (q, _), rough = self.time, self._split(), self._held & (self._friction > 0)
        stuck = np.flatnonzero(self._held & (self._modes == Mode.STICK))
        creep = sum(float(np.linalg.norm(calc_slide(self.world, q, int(i)))) for i in stuck)
        super()._move(control, until)
        self.recording.creep += creep * (self.time - start)
        for i in np.flatnonzero(rough) if self.time > start else ():
            mode = Mode(self._modes[i]).name.lower()
            self.recording.add_phase(int(i), mode, start, self.time)

    def _close(self, contacts: Ints) -> Closed:
        """Returns contacts that are closed in their modes."""
        modes = tuple(map(Mode, self._modes[contacts]))
        return Closed(self.world, contacts, modes, self._friction[contacts])

    def _watch(self, closed: Closed, control: Floats) -> OfStates:
        """Returns what is above zero while contacts go on as they do, of states (…, 2 nv)."""
        n, held, friction = self.world.num_positions, closed.contacts, closed.friction
        signs = self._modes[held]
        stuck, slides = signs == Mode.STICK, (signs != Mode.STICK) & (friction > 0)
        start = closed.calc_push(self.x, control)
        pull = self._calc_pull(closed, start.acceleration)
        still, size = self._calc_still(), float(start.calc_size())
        if _NEEDLESS < abs(size) <= 2 * _SINGULAR:
            raise refuse_modes("none", "a jam, in which forces grow without end")
        sign = np.sign(size) if abs(size) > _NEEDLESS else 0.0

        def edges(x: Floats) -> Floats:
            push = closed.calc_push(x, control)
            cone = friction * push.normal + pull
            cones = push.normal + pull, *((cone + s * push.tangent)[..., stuck] for s in (-1, 1))
            slips = self.world.rubbing.calc_slips(x[..., :n], x[..., n:])[..., held]
            margin = sign * push.calc_size() - _SINGULAR if sign else np.ones(x.shape[:-1])
            moving = (signs * slips + still / 2)[..., slides]
            return np.concatenate([*cones, moving, margin[..., np.newaxis]], axis=-1)

        # Of contacts that hold each other up without need, some may pull all the while.
        chosen = edges(self.x) > 0
        return lambda x: edges(x)[..., chosen]

    def _calc_still(self) -> float:
        """Returns below which a velocity is none [m/s]."""
        self._fastest = max(self._fastest, float(np.max(np.abs(self._split()[1]))))
        return _STILL * self._fastest

    def _resolve(self, control: Floats) -> None:
        """Lets go of walls, hits them, or sticks and slips, at this instant."""
        q, _ = self._split()
        if not self._held.any() and np.all(self.world.calc_clearance(q) > calc_air(q)):
            return
        held, stuck = self._held, self._held & (self._modes == Mode.STICK)
        self._project(np.flatnonzero(held), np.flatnonzero(stuck))
        for _ in range(MOST_IMPACTS):
            closed = self._find_closed()
            rates = self.world.calc_contact_rate(*self._split())[closed]
            hit = closed[rates < -self._calc_still()]
            if not len(hit):
                break
            self._hit(int(hit[0]), control)
        else:  # A collapse ends in an impact of all that touch, which returns nothing.
            q, v = self._split()
            touching = self._describe(self._find_closed(), None)
            if (going := next(list_modes(touching), None)) is not None:
                self.x = np.concatenate([q, v + going.change])
        self._go_on(control)

    def _find_closed(self) -> Ints:
        """Returns the contacts that touch: of each solid, the face that is nearest to."""
        q, _ = self._split()
        distances, air = self.world.calc_signed_distance(q), calc_air(q)
        near = np.where(self._held, np.inf, distances)
        faces = [max(solid, key=near.__getitem__) for solid in self.world.solids]
        return np.array([i for i in faces if self._held[i] or distances[i] <= air], dtype=int)

    def _hit(self, contact: int, control: Floats) -> None:
        """Applies an impact, and brings the contact to rest if the hop after it is too short."""
        q, v = self._split()
        world, M = self.world, self.world.calc_mass_matrix(q)
        J, T = stack_rows(self.world, q, np.array([contact]))
        speed = -float(J @ v)
        others = np.flatnonzero(self._held & (np.arange(world.num_contacts) != contact))
        bias = world.calc_contact_bias(q, v)[contact]
        push = float(J @ self._close(others).calc_push(self.x, control).acceleration + bias)
        self._counts[contact] += 1
        hop = SHORTEST_HOP * self._rules.duration * self._counts[contact]
        e = float(self._rules.restitutions[contact])
        e = 0.0 if 2 * e * speed <= -hop * push else e
        friction = float(self._friction[contact])
        after = calc_velocity_after(M, (J, T), v, e, friction)
        if 2 * speed > hop * abs(push):
            energies = (float(world.calc_kinetic_energy(q, each)) for each in (v, after))
            self.recording.impacts.append(Impact(self.time, contact, speed, push, *energies))
            self.recording.add(self.time, q, v)
            self.recording.add(self.time, q, after)
        self.x = np.concatenate([q, after])

    def _describe(self, closed: Ints, control: Floats | None) -> Touching:
        """Returns closed contacts, and how they go on without forces; None: without impulses."""
        q, v = self._split()
        world, rows = self.world, stack_rows(self.world, q, closed)
        kicks = np.asarray(np.linalg.solve(world.calc_mass_matrix(q), rows.T), dtype=float)
        friction = self._friction[closed]
        if control is None:
            return Touching(kicks, rows, rows @ v, friction, [0] * len(closed))
        rates = rows @ world.calc_acceleration(q, v, control) + calc_contact_turning(
            self.world, q, v, closed
        )
        slips, still = world.rubbing.calc_slips(q, v)[closed], self._calc_still()
        signs = np.where(np.abs(slips) <= still, 0.0, np.sign(slips)).astype(int)
        return Touching(kicks, rows, rates, friction, signs.tolist())

    def _go_on(self, control: Floats) -> None:
        """Decides how each contact that touches goes on."""
        closed, still = self._find_closed(), self._calc_still()
        rates = self.world.calc_contact_rate(*self._split())[closed]
        leaving, closed = closed[rates > still], closed[rates <= still]
        slips = np.abs(self.world.rubbing.calc_slips(*self._split())[closed])
        self._project(closed, closed[(slips <= still) & (self._friction[closed] > 0)])
        before = self._modes.copy()
        self._modes[:] = Mode.OPEN
        if len(closed):
            self._modes[closed] = find_modes(self._describe(closed, control)).modes
        if np.any(self._modes != before):
            self.recording.add(self.time, *self._split())
        self._held = self._modes != Mode.OPEN
        air = calc_air(self._split()[0])
        opened = closed[~self._held[closed]]
        self._place(np.concatenate([leaving, opened]).astype(int), 2 * air)
        self._place(np.flatnonzero(self._held), air / 2)

    def _place(self, contacts: Ints, distance: float) -> None:
        """Moves to so small a distance from walls, as rounding puts what touches on any side."""
        if len(contacts):
            q, v = self._split()
            J = self.world.calc_contact_jacobian(q)[contacts]
            missing = distance - self.world.calc_signed_distance(q)[contacts]
            self.x = np.concatenate([q + np.linalg.pinv(J) @ missing, v])

    def _project(self, closed: Ints, stuck: Ints) -> None:
        """Takes out of v what rounding moves contacts by that touch, and by which they slip."""
        q, v = self._split()
        names = np.union1d(closed, stuck).astype(int)
        J, T = np.split(stack_rows(self.world, q, names), 2)
        rows = np.vstack([J[np.isin(names, closed)], T[np.isin(names, stuck)]])
        if len(rows):
            kicks = np.linalg.solve(self.world.calc_mass_matrix(q), rows.T)
            v = v - kicks @ (np.linalg.pinv(rows @ kicks, RANK) @ (rows @ v))
            self.x = np.concatenate([q, v])


def calc_slide(world: World, q: Floats, contact: int) -> Floats:
    """Returns M⁻¹ Tᵀ / (T M⁻¹ Tᵀ), what friction moves for a slip of 1 m, shape (nv,)."""
    T = world.rubbing.calc_tangent_jacobian(q)[contact]
    drag = np.linalg.solve(world.calc_mass_matrix(q), T)
    return drag / (T @ drag) if T.any() else drag


def calc_air(q: Floats) -> float:
    """Returns how near to a wall is at it [m]."""
    return _AIR * max(1.0, float(np.max(np.abs(q))))
