"""Exactly rigid walls with Coulomb's friction, around any mechanism that moves in a plane."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.errors import FrictionError
from drake_aigto.simulation.controller import Controller
from drake_aigto.simulation.coulomb import Mode, calc_velocity_after
from drake_aigto.simulation.friction_modes import (
    RANK,
    Touching,
    find_modes,
    list_modes,
    refuse_modes,
)
from drake_aigto.simulation.impacts import MOST_IMPACTS
from drake_aigto.simulation.mechanism import (
    PULL,
    OfStates,
    RigidMechanism,
    calc_air,
    simulate_mechanism,
)
from drake_aigto.simulation.pushes import Push, calc_contact_turning, calc_push, stack_rows
from drake_aigto.simulation.recording import Impact, Recording
from drake_aigto.world import Scenario, World

# The n-th impact at a contact becomes rest if the hop after it would last less than n times this
# part of the simulated time, as on walls without friction.
_HOP = 1e-6
# Velocities of contacts below this, relative to the largest velocity so far or 1 m/s, are none.
_STILL = 1e-11
# Where what forces have to be divided by is this small, relative to masses, they have no answer;
# where it is below the second, contacts hold each other up without need.
_SINGULAR, _NEEDLESS = 1e-6, 1e-11


class RubbingMechanism(RigidMechanism):
    """A world whose walls are exactly rigid and rub, each with its μ.

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
        self,
        world: World,
        restitutions: Floats,
        friction: Floats,
        state: tuple[Floats, Floats],
        span: tuple[float, float],
    ) -> None:
        """Starts with nothing known of contacts.

        Args:
            world: its dynamics and its contacts.
            restitutions: e of each contact, in [0, 1], shape (m,).
            friction: μ of each contact, shape (m,).
            state: the start, (q, v).
            span: from when to when will be simulated [s].
        """
        super().__init__(world, restitutions, state, span)
        self._friction = friction
        self._modes = np.full(world.num_contacts, Mode.OPEN, dtype=int)
        self._last, self._stalls, self._fastest = -np.inf, 0, 1.0

    def _move(self, control: Floats, until: float) -> None:
        self._count_stalls()
        start, creep, rubs = self.time, self._calc_creep(), self._held & (self._friction > 0)
        super()._move(control, until)
        self.recording.creep += creep * (self.time - start)
        for i in np.flatnonzero(rubs) if self.time > start else ():
            mode = Mode(self._modes[i]).name.lower()
            self.recording.add_phase(int(i), mode, start, self.time)

    def _describe_contact(self, control: Floats, held: Ints) -> tuple[OfStates, OfStates]:
        edges = self._list_edges(control, held)
        # Of contacts that hold each other up without need, some may pull all the while.
        chosen = edges(self.x) > 0

        def accelerate(x: Floats) -> Floats:
            return self._push(x, control, held).acceleration

        def lasting(x: Floats) -> Floats:
            return edges(x)[..., chosen]

        return accelerate, lasting

    def _list_edges(self, control: Floats, held: Ints) -> OfStates:
        """Returns what is above zero while contacts go on as they do, of states (…, 2 nv)."""
        n, signs, friction = self.world.num_positions, self._modes[held], self._friction[held]
        stuck, slides = signs == Mode.STICK, (signs != Mode.STICK) & (friction > 0)
        start = self._push(self.x, control, held)
        masses = self.world.inertia_at(self.x[:n]).masses[held]
        pull = PULL * max(1.0, float(np.max(np.abs(start.acceleration)))) * masses
        still, size = self._calc_still(), abs(float(start.size))
        if _NEEDLESS < size <= 2 * _SINGULAR:
            raise refuse_modes("none", "a jam, in which forces grow without end")
        sign = np.sign(start.size) if size > _NEEDLESS else 0.0

        def edges(x: Floats) -> Floats:
            push = self._push(x, control, held)
            normal, tangent = np.split(push.forces, 2, axis=-1)
            cone = friction * normal + pull
            cones = normal + pull, (cone - tangent)[..., stuck], (cone + tangent)[..., stuck]
            slips = self.world.rubbing.calc_slips(x[..., :n], x[..., n:])[..., held]
            sizes = sign * push.size - _SINGULAR if sign else np.ones_like(push.size)
            moving = (signs * slips + still / 2)[..., slides]
            values = *cones, moving, sizes[..., np.newaxis]
            return np.concatenate(values, axis=-1)

        return edges

    def _push(self, x: Floats, control: Floats, held: Ints) -> Push:
        """Returns how contacts push in their modes, in states (…, 2 nv)."""
        modes = [Mode(mode) for mode in self._modes[held]]
        return calc_push(self.world, x, control, held, modes, self._friction[held])

    def _calc_creep(self) -> float:
        """Returns ‖q̇‖ that slips of 1 m/s of all contacts that stick add up to at most."""
        stuck = np.flatnonzero(self._held & (self._modes == Mode.STICK))
        q, _ = self._split()
        return float(sum(np.linalg.norm(calc_slide(self.world, q, int(i))) for i in stuck))

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
        else:
            self._hold_together()
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
        push = float(J @ self._push(self.x, control, others).acceleration + bias)
        self._counts[contact] += 1
        hop = _HOP * self._rules.duration * self._counts[contact]
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

    def _hold_together(self) -> None:
        """Ends a collapse: an impact of all that touch, which returns nothing."""
        touching = self._describe(self._find_closed(), None)
        going = next(list_modes(touching), None)
        if going is not None:
            n = self.world.num_positions
            self.x = np.concatenate([self.x[:n], self.x[n:] + going.change])

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

    def _count_stalls(self) -> None:
        """Refuses events without end at one instant."""
        self._stalls = self._stalls + 1 if self.time == self._last else 0
        self._last = self.time
        if self._stalls > MOST_IMPACTS:
            raise FrictionError(
                f"contact with friction at {self.time:g} s",
                got=f"more than {MOST_IMPACTS} changes between stick and slip at once",
                expected="motion that goes on",
                remedy="Ask for contact: compliant.",
            )


def calc_slide(world: World, q: Floats, contact: int) -> Floats:
    """Returns M⁻¹ Tᵀ / (T M⁻¹ Tᵀ), what friction moves for a slip of 1 m, shape (nv,)."""
    T = world.rubbing.calc_tangent_jacobian(q)[contact]
    drag = np.linalg.solve(world.calc_mass_matrix(q), T)
    return drag / (T @ drag) if T.any() else drag


def simulate_rigid_walls(
    world: World, scenario: Scenario, state: tuple[Floats, Floats], controller: Controller
) -> Recording:
    """Runs a controller on any mechanism between exactly rigid walls, with friction or without.

    Raises:
        TrajectoryError: the motion runs away to infinity.
        FrictionError: friction leaves no way to go on, or several (`find_modes`).
    """
    restitutions = world.restitutions(scenario)
    friction = world.friction_coefficients(scenario)
    if not friction.any():
        return simulate_mechanism(world, restitutions, state, controller)
    span = controller.start, controller.end
    return RubbingMechanism(world, restitutions, friction, state, span).run(controller)
