"""Guesses of a mechanism's motion that shooting closes, and the units that they are drawn in."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, TypeAlias, get_args

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

from drake_aigto.arrays import Floats, interpolate
from drake_aigto.contact import CompliantLaw, calc_levers, calc_pushes
from drake_aigto.errors import TrajectoryError
from drake_aigto.planning.mechanisms.reaches import Reaches
from drake_aigto.planning.sequence_search import read_touches_of
from drake_aigto.shooting import ShootingProblem, ShootingResult
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import TouchSequence
from drake_aigto.world import Scenario, SpaceWorld, World, calc_servo_forces

# A mechanism's own time is that of its fastest coordinate, but at least this part of the duration.
_SHORTEST = 0.05


@dataclass(frozen=True, eq=False)
class Measures:
    """Units of a task: scaling its lengths, masses and times scales them, and nothing else.

    Attributes:
        position: 1 rad of a hinge. Of a slider, the longest of the ways of sliders and of the
            distances of contacts at the start and the goal; without any, what the start moves by
            in the duration, or the radius at which the inertia of hinges equals a slider's;
            shape (n,) [rad, m].
        velocity: that in the duration, shape (n,) [rad/s, m/s].
        length: the farthest that `position` moves a contact along its normal; without contacts the
            longest unit of sliders [m].
        period: the time in which forces without control move the fastest coordinate by its unit
            and back, at most the duration; servos hold their set points, and count for none [s].
        duration: T [s].
    """

    position: Floats
    velocity: Floats
    length: float
    period: float
    duration: float

    @property
    def speed(self) -> float:
        """The length in the duration [m/s]."""
        return self.length / self.duration

    @classmethod
    def of(cls, world: World, scenario: Scenario) -> Measures:
        """Returns the units of a scenario in its world."""
        T = scenario.duration
        position = np.where(world.turns, 1.0, _measure_sliders(world, scenario))
        ends = np.array([scenario.initial_position, scenario.goal_position])
        levers = calc_levers(world.reaches, world.calc_signed_distance(ends))
        ways = np.linalg.norm(world.calc_contact_jacobian(ends) * position, axis=-1) * levers
        length = float(np.max(ways, initial=0.0)) or float(np.max(position))
        # π √(unit / acceleration) of the fastest coordinate near the ends.
        steps = np.vstack([np.zeros(len(position)), np.diag(position) / 2, -np.diag(position) / 2])
        q = world.add(ends[:, np.newaxis], steps).reshape(-1, world.num_positions)
        forces = world.calc_bias(q, np.zeros((len(q), len(position))))
        forces -= calc_servo_forces(world.plant, scenario.model_fields.servos, q)
        falls = np.abs(np.linalg.solve(world.calc_mass_matrix(q), forces[..., np.newaxis]))[..., 0]
        fastest = float(np.max(falls / position, initial=0.0))
        period = np.pi / np.sqrt(fastest) if fastest > 0 else T
        period = float(np.clip(period, _SHORTEST * T, T))
        return cls(position, position / T, length, period, T)


def _measure_sliders(world: World, scenario: Scenario) -> float:
    """Returns the unit of all sliders [m]."""
    q, v, is_slider = scenario.initial_position, scenario.initial_velocity, ~world.turns
    ends = np.array([q, scenario.goal_position])
    ways = np.abs(world.subtract(ends[1], ends[0]))[is_slider]
    distances = world.calc_signed_distance(ends)
    R = world.reaches
    distances = np.where(R > 0, R / calc_levers(R, distances) - R, distances)
    distances = np.abs(distances).ravel()
    if (found := np.max(np.concatenate([ways, distances]), initial=0.0)) > 0:
        return float(found)
    if (moved := np.max(np.abs(v[is_slider]), initial=0.0) * scenario.duration) > 0:
        return float(moved)
    inertias = np.diag(world.calc_mass_matrix(q))
    if is_slider.all() or not is_slider.any():
        return 1.0
    return float(np.sqrt(np.max(inertias[~is_slider]) / np.max(inertias[is_slider])))


StartName: TypeAlias = Literal["rest", "coast", "line", "turn", "controls", "push"]
_PUSH: StartName = "push"
STARTS: tuple[StartName, ...] = get_args(StartName)[:-1]  # In any world.

# Largest amplitudes of the waves that are added to a path: of a slider in its unit, of a hinge.
_FAR, _ROUND = 0.5, np.pi
_MOST_WAVES = 3
# Powers of ten of amplitudes of controls, in those that move by the units in the duration; and the
# numbers of their knots.
_EFFORTS, _FEWEST, _MOST = (-1.0, 0.7), 2, 8
# Power of ten of the widest contact, in the unit of distances, where closing begins; and where
# bodies touch already.
_WIDTHS, _NARROW = (-3.0, 0.0), (-3.0, -1.5)
# Parts of the time in which hands reach; and the last part of it in which they do anew.
_REACHES, _LAST_PUSH = (0.1, 0.6), 0.2
# A motion that departs by less than this part of its units rests.
_STILL = 1e-6
# Parts of a motion's units by which it is perturbed, as powers of ten.
_PERTURBED = (-1.5, 0.0)


@dataclass(frozen=True, eq=False)
class Guess:
    """A motion that need not obey the equations of motion.

    Attributes:
        times: t_0 … t_N, shape (N + 1,) [s].
        controls: held between them, shape (N, nu).
        states: q and v at the times, shape (N + 1, 2n); None: those that the controls lead to.
        width: of contact where closing begins, in the unit of distances.
        touches: of rigid walls, if they are known.
        start: q and v where controls begin, if the start is free, shape (2n,); None: as given.
        known: states that the controls lead to under the exact law, (N + 1, 2n); None: not known.
    """

    times: Floats
    controls: Floats
    states: Floats | None = None
    width: float = 1.0
    touches: TouchSequence | None = None
    start: Floats | None = None
    known: Floats | None = None

    def sample(self, times: Floats) -> tuple[Floats, Floats | None]:
        """Returns controls to hold between times (K + 1,), and states at them."""
        middles = (times[1:] + times[:-1]) / 2
        rows = np.searchsorted(self.times, middles) - 1
        controls = self.controls[np.clip(rows, 0, len(self.controls) - 1)]
        states = self.states
        return controls, None if states is None else interpolate(times, self.times, states)


def sample_cubic(
    world: World, knots: Floats, positions: Floats, velocities: Floats, times: Floats
) -> Floats:
    """Returns states at times, cubic between knots that have these q and v, shape (K, nq + nv)."""
    if world.num_positions != world.num_velocities:
        q = world.normalized(interpolate(times, knots, positions))
        return np.hstack([q, interpolate(times, knots, velocities)])
    motion = PiecewisePolynomial.CubicHermite(knots, positions.T, velocities.T)
    each = motion.vector_values(times), motion.MakeDerivative().vector_values(times)
    return np.vstack(each).T


class Guesses:
    """Guesses for a task: random ones around a few starts, and those near a motion.

    Paths are standing still (rest), the uncontrolled motion (`coast`), and a move to the goal
    (line), or to it from the other side where turns of a hinge do not count (turn). A move begins
    after a wait and ends before the end, or not; it lasts from the mechanism's own period up to all
    of the duration. Waves are added. In space a hand may reach for an object and push it to its
    goal, too (push: `Reaches`). Inverse dynamics gives the controls of a path,

        u = B⁺ (M(q) v̇ + h(q, v) − J(q)ᵀ f(q, v))   within bounds,

    which leave unexplained what no control can do. Or the controls themselves are random, linear
    between few knots, and lead to a motion.

    Args:
        world: the mechanism.
        law: of compliant contact.
        problem: of shooting, in the knots of guesses.
        measures: units of the task.
        coast: the uncontrolled motion.
        total: the least and the most that a motion may last [s].
        num_steps: of the scenario, in which hands push.
    """

    def __init__(
        self,
        world: World,
        law: CompliantLaw,
        problem: ShootingProblem,
        measures: Measures,
        coast: ShootingResult,
        total: tuple[float, float],
        num_steps: int,
    ) -> None:
        """Keeps all of these."""
        self._world, self._law, self._problem = world, law, problem
        self._measures, self._coast, self._total = measures, coast, total
        self._num_steps = num_steps
        cost = problem.cost
        self._start, self._velocity = world.split(problem.start)
        self._turns = cost.is_modulo | cost.is_chordal
        self._way = -cost.goal_errors(self._start)
        self._reaches: Reaches | None = None
        if isinstance(world, SpaceWorld) and world.contacts:
            limits = problem.state_bounds[:, : world.num_velocities]
            self._reaches = Reaches(world, law, cost, measures.position, limits, measures.duration)

    @property
    def starts(self) -> tuple[StartName, ...]:
        """The starts that differ from each other."""
        same = {} if self._turns.any() else {"turn"}
        path = self._coast.states[:, : self._world.num_positions]
        moved = np.abs(self._world.subtract(path, self._start))
        is_still = bool(np.all(moved <= _STILL * self._measures.position))
        others = [each for each in STARTS if each not in {*same, *(["coast"] * is_still)}]
        if self._reaches and len(self._reaches.contacts):
            pushes = [_PUSH] * (3 if self.must_carry else 1)  # Nothing else lifts objects.
            return tuple(name for each in others for name in (*pushes, each))
        return tuple(others)

    @property
    def must_carry(self) -> bool:
        """Whether friction of hands alone holds objects where the goal is."""
        return self._reaches is not None and self._reaches.must_carry

    @property
    def hurries(self) -> bool:
        """Whether hands push objects on the ground that have to be at their goal soon."""
        return self._reaches is not None and self._reaches.hurries

    @property
    def sharp_starts(self) -> tuple[StartName, ...]:
        """Those closed with hardly smoothed contact, too, with and without states: in space.

        There contact from afar pushes whatever flies or walks off its path.
        """
        return () if self._reaches is None else tuple(n for n in STARTS if n in self.starts)

    def plain(self, start: StartName, width: float = 1.0, has_states: bool = True) -> Guess:
        """Returns the guess of a start as it is: no wait, no waves, no control.

        Without states, it is where its controls lead: a robot whose servos follow the path stands
        on its feet, or falls, as contact has it, while feet on the path itself miss the ground.
        """
        times = self._problem.knot_times
        if start == "controls":
            none = np.zeros((len(times) - 1, self._world.num_actuators))
            return Guess(times, none, width=width)
        guess = self._follow(times, self._find_path(start, times, 0.0, times[-1]), width)
        return guess if has_states else replace(guess, states=None)

    def draw(self, start: StartName, rng: np.random.Generator) -> Guess:
        """Returns a random guess around a start."""
        duration = float(self._problem.knot_times[-1])
        least, most = self._total
        if least < most:
            duration = least * (most / least) ** rng.uniform()
        times = self._problem.knot_times * (duration / self._problem.knot_times[-1])
        begin, end = self._draw_stretch(rng, duration)
        width = 10 ** rng.uniform(*_WIDTHS)
        if start == "controls":
            return Guess(times, self._draw_controls(rng, times, begin, end), None, width)
        if start == _PUSH:
            times = np.linspace(0.0, duration, self._num_steps + 1)
            return self._push(times, (self._start, self._velocity), rng)
        path = self._find_path(start, times, begin, end)
        # A random sum of waves that vanishes at the start, shape (N + 1, n).
        far = np.where(self._world.turns, _ROUND, _FAR) * self._measures.position
        s, total = times / times[-1], np.zeros((len(times), len(far)))
        for number in range(1, 1 + int(rng.integers(1, 1 + _MOST_WAVES))):
            size = 10 ** rng.uniform(-1.0, 0.0) / number * rng.uniform(-1.0, 1.0, len(far))
            total += np.sin(np.pi * number * s)[:, np.newaxis] * far * size
        path = self._world.add(path, total)
        return self._follow(times, path, width)

    def renew(self, motion: ShootingResult, rng: np.random.Generator) -> Guess:
        """Returns a motion with a stretch of its path, or of its controls, perturbed, or moved.

        In space, where gaps that are closed at once lose contact, only controls are kept, and every
        second time a hand reaches and pushes anew, from somewhere on the way.
        """
        if self._reaches is None:
            return self._perturb(motion, rng)
        if len(self._reaches.contacts) and rng.integers(2):
            k = int(rng.uniform(0.0, 1.0 - _LAST_PUSH) * len(motion.controls))
            guess = self._push(motion.times[k:], self._world.split(motion.states[k]), rng)
            controls = np.vstack([motion.controls[:k], guess.controls])
            start = motion.states[0]
            return Guess(motion.times, controls, None, guess.width, start=start)
        guess = replace(self._perturb(motion, rng), start=motion.states[0])
        return replace(guess, states=None, width=10 ** rng.uniform(*_NARROW))

    def _perturb(self, motion: ShootingResult, rng: np.random.Generator) -> Guess:
        """Returns a motion with a stretch of its path, or of its controls, perturbed, or moved."""
        T, N = float(motion.times[-1]), len(self._problem.times) - 1
        times, width = np.linspace(0.0, T, N + 1), 10 ** rng.uniform(*_WIDTHS)
        begin, end = self._draw_stretch(rng, T)
        kind, n = int(rng.integers(4)), self._world.num_velocities
        size = 10 ** rng.uniform(*_PERTURBED)
        as_is = Guess(motion.times, motion.controls, motion.states, width)
        if kind == 0:  # Sooner or later.
            return self.extend(motion, rng.uniform(-0.5, 0.5) * self._measures.period, width)
        controls, states = as_is.sample(times)
        if kind == 1:
            controls = controls + size * self._draw_controls(rng, times, begin, end)
            return Guess(times, controls, start=motion.states[0])
        assert states is not None
        s = np.clip((times - begin) / (end - begin), 0.0, 1.0)[:, np.newaxis]
        wave = np.sin(np.pi * s) * size * self._measures.position * rng.uniform(-1.0, 1.0, n)
        path, speeds = self._world.split(states)
        moved = self._world.add(path, wave)
        before, after = (self._follow(times, q) for q in (path, moved))
        assert before.states is not None and after.states is not None
        change = self._world.split(after.states)[1] - self._world.split(before.states)[1]
        controls = controls + after.controls - before.controls
        positions = self._world.add(path, self._world.subtract(moved, path))
        states = np.hstack([positions, speeds + change])
        return Guess(times, self._bounded(controls), states, width)

    def follow(self, trajectory: Trajectory) -> Guess:
        """Returns the guess of a trajectory, with its touches."""
        touches, given = read_touches_of(self._world, trajectory), trajectory
        return Guess(given.times, given.controls, given.states, 0.0, touches)

    def extend(self, motion: ShootingResult, late: float, width: float = 0.0) -> Guess:
        """Returns a motion that begins late [s], or sooner; before it waits, and rests in the end.

        Below 0, so much of its beginning is left out. Closing begins at this width of contact.
        """
        n, times, world = self._world.num_positions, self._problem.knot_times, self._world
        if self._total[0] < self._total[1]:
            times = np.linspace(0.0, motion.times[-1], len(times))
        shifted = times - late
        controls, states = Guess(motion.times, motion.controls, motion.states).sample(shifted)
        assert states is not None
        states[:, :n] = world.normalized(states[:, :n])
        states[shifted > motion.times[-1], n:] = 0.0
        middles, end = (shifted[1:] + shifted[:-1]) / 2, motion.states[-1, :n]
        still = np.zeros(world.num_velocities)
        hold = world.inverse_actuation @ world.calc_bias(end, still)
        controls[middles < 0.0], controls[middles > motion.times[-1]] = 0.0, hold
        return Guess(times, self._bounded(controls), states, width)

    def _draw_stretch(self, rng: np.random.Generator, duration: float) -> tuple[float, float]:
        """Returns begin and end of a part of the duration [s]; half of these touch an end."""
        shortest = min(self._measures.period, duration / 4)
        length = shortest * (duration / shortest) ** rng.uniform()
        begin = float(rng.choice([0.0, rng.uniform(), rng.uniform(), 1.0])) * (duration - length)
        return begin, begin + length

    def _find_path(self, start: StartName, times: Floats, begin: float, end: float) -> Floats:
        """Returns the positions of a start's path, shape (N + 1, n)."""
        if start in ("line", "turn"):
            s = np.clip((times - begin) / (end - begin), 0.0, 1.0)[:, np.newaxis]
            way = self._way
            if start == "turn":
                way = way - np.where(self._turns, 2 * np.pi * np.copysign(1.0, way), 0.0)
            return self._world.add(self._start, s * s * (3 - 2 * s) * way)
        coast, _ = self._world.split(self._coast.states)
        if start == "coast" and np.isfinite(coast).all():
            return self._world.normalized(interpolate(times, self._coast.times, coast))
        return np.tile(self._start, (len(times), 1))

    def _push(self, times: Floats, state: tuple[Floats, Floats], rng: np.random.Generator) -> Guess:
        """Returns the controls of a hand that reaches for an object from a state, and pushes it."""
        assert self._reaches is not None
        width, share = 10 ** rng.uniform(*_NARROW), rng.uniform(*_REACHES)
        width *= not self.must_carry  # Contact from afar makes hands lose what they carry.
        bounds = np.array(self._problem.control_bounds)
        try:
            controls, known = self._reaches.push(times, state, share, bounds, rng)
        except TrajectoryError:  # It runs away.
            controls, known = np.zeros((len(times) - 1, self._world.num_actuators)), None
        return Guess(times, controls, None, width, known=known)

    def _draw_controls(
        self, rng: np.random.Generator, times: Floats, begin: float, end: float
    ) -> Floats:
        """Returns random controls between two times, else zero, shape (N, nu)."""
        scales = self._problem.control_scales
        knots = np.linspace(begin, end, int(rng.integers(_FEWEST, _MOST + 1)))
        values = 10 ** rng.uniform(*_EFFORTS) * rng.normal(size=(len(knots), len(scales)))
        middles = (times[1:] + times[:-1]) / 2
        acts = ((middles >= begin) & (middles <= end))[:, np.newaxis]
        return self._bounded(acts * interpolate(middles, knots, values * scales))

    def _follow(self, times: Floats, q: Floats, width: float = 1.0) -> Guess:
        """Returns the guess of positions at even times, shape (N + 1, n)."""
        world, h = self._world, times[1] - times[0]
        inner, last = world.subtract(q[2:], q[:-2]), world.subtract(q[-1:], q[-2:-1])
        v = np.vstack([self._velocity, inner / (2 * h), last / h])
        middle, mean = world.middle(q[:-1], q[1:]), (v[1:] + v[:-1]) / 2
        a = np.diff(v, axis=0) / h
        force = np.einsum("kij,kj->ki", world.calc_mass_matrix(middle), a)
        force += world.calc_bias(middle, mean)
        if world.num_contacts:
            pushes = calc_pushes(world, self._law, middle, mean)
            force -= np.einsum("ki,kij->kj", pushes, world.calc_contact_jacobian(middle))
        controls = self._bounded(force @ world.inverse_actuation.T)
        return Guess(times, controls, np.hstack([q, v]), width)

    def _bounded(self, controls: Floats) -> Floats:
        return np.asarray(np.clip(controls, *self._problem.control_bounds))
