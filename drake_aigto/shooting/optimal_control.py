"""Problems of optimal control: mechanism, start, times, phases and bounds."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from drake_aigto.arrays import ArrayRecord, Bools, Floats, Ints, LockedArrays, read_only
from drake_aigto.contact import AnyMechanism, Load
from drake_aigto.errors import ProgramError
from drake_aigto.shooting.added import NO_TERMS, AddedTerms
from drake_aigto.shooting.tables import CHOOSE, FLOW, START
from drake_aigto.world import TaskCost


@dataclass(frozen=True, eq=False)
class Phases(LockedArrays, ArrayRecord):
    """Phases with free durations, and the contacts hit between them; P phases, m contacts.

        φ_i(q) = 0,   v⁺ = v⁻ − M⁻¹ Jᵀ (J M⁻¹ Jᵀ)⁻¹ (1 + e) J v⁻     where contact i is hit
        J v̇ + J̇ v = 0,   M v̇ + h = B u + Jᵀ λ,   λ ≥ 0               while contacts are held

    J also has the rows of contacts that are held from then on. A held contact is hit first, with
    e = 0 whatever its restitution: that ends ever faster bounces. Or it is held from the start. A
    contact with friction is in a mode as it is hit and while it is held; λ_t is its tangential
    force, and impulses follow the same laws:

        T v̇ + Ṫ v = 0,   |λ_t| ≤ μ λ_n                                stick, mode 0
        λ_t = −σ μ λ_n,   σ T v ≥ 0                                   slip, mode σ = ±1

    Attributes:
        contacts: hit at the end of each phase but the last, −1 for none; shape (P − 1,).
        knots: at these ends, rising, inside of 0 … N, shape (P − 1,).
        durations: of the phases, as a guess, shape (P,) [s].
        total: limits of their sum [s].
        held: which contacts are held in each phase, shape (P, m); empty: never any.
        modes: of contacts with friction, held in each phase or hit at its start: 0 for stick, else
            the sign of the slip, shape (P, m); empty: all stick.
    """

    contacts: Ints
    knots: Ints
    durations: Floats
    total: tuple[float, float]
    held: Bools = field(default_factory=lambda: np.zeros((0, 0), dtype=np.bool_))
    modes: Ints = field(default_factory=lambda: np.zeros((0, 0), dtype=np.int64))

    def __post_init__(self) -> None:
        """Checks shapes and numbers, and makes arrays read-only."""
        count = len(self.contacts) + 1
        for name in ("held", "modes"):
            if not len(given := getattr(self, name)):
                object.__setattr__(self, name, given.reshape(count, 0))
        super().__post_init__()
        rows = f"{count} rows"
        checks = (
            ("held", rows, len(self.held) == count and self.held.ndim == 2),
            ("modes", rows, len(self.modes) == count and self.modes.ndim == 2),
            ("modes", "−1, 0 or 1", bool(np.all(np.abs(self.modes) <= 1))),
            ("knots", f"{count - 1}, rising", len(self.knots) == count - 1),
            ("knots", "rising numbers", bool(np.all(np.diff(self.knots) > 0))),
            ("durations", f"{count} numbers", len(self.durations) == count),
            ("durations", "numbers above 0", bool(np.all(self.durations > 0))),
            ("total", "0 < least ≤ most", 0 < self.total[0] <= self.total[1] < np.inf),
        )
        for name, expected, holds in checks:
            if not holds:
                raise ProgramError(f"phases: {name}", got=getattr(self, name), expected=expected)

    @classmethod
    def free(cls, duration: float, total: tuple[float, float]) -> Phases:
        """Returns one phase of free duration [s], without an impact."""
        none = np.zeros(0, dtype=np.int64)
        return cls(none, none, np.array([duration]), total)

    def goes_on(self, phase: int, contact: int) -> bool:
        """Returns whether a contact is held as in the phase before, not hit, and in its mode."""
        both = slice(phase - 1, phase + 1)
        is_same = self.modes[phase - 1, contact] == self.modes[phase, contact]
        is_hit = self.contacts[phase - 1] == contact
        return bool(np.all(self.held[both, contact]) and is_same and not is_hit)


@dataclass(frozen=True, eq=False)
class FreeStart(LockedArrays, ArrayRecord):
    """A start x₀ ⊕ s that is free within limits, and to which the motion returns.

        x(T) ⊖ (x₀ ⊕ s) = goal ⊖ x₀    in all coordinates that have a hard goal

    Attributes:
        limits: the least and the most s, shape (2, 2n).
        change: s, as a guess, shape (2n,).
    """

    limits: Floats
    change: Floats


@dataclass(frozen=True, eq=False)
class StageLayout:
    """The stages of a problem: flights between knots and starts of phases."""

    kinds: Ints  # FLOW, START or a contact, of each of K stages, shape (K,)
    held: Bools  # which contacts are held in each, shape (K, m)
    modes: Ints  # in which mode each contact is held in each, or hit, shape (K, m)
    flights: Ints  # which stages are flights, shape (N,)
    phases: Ints  # of which phase each is, shape (K,)
    shares: Floats  # their lengths [s]; with phases, as shares of these; shape (K,)

    @classmethod
    def of(
        cls, times: Floats, phases: Phases | None, num_contacts: int, num_choices: int = 0
    ) -> StageLayout:
        """Returns the stages of knots at these times, shape (N + 1,).

        With phases, as many as `num_choices` before these choose the start.
        """
        steps = np.diff(times)
        if phases is None:
            never = np.zeros((len(steps), num_contacts), dtype=np.bool_)
            none = never.astype(np.int64)
            every = np.arange(len(steps))
            return cls(np.full(len(steps), FLOW), never, none, every, 0 * every, steps)
        kinds: list[int] = [CHOOSE] * num_choices
        shares: list[float] = [0.0] * num_choices
        ends = [*phases.knots.tolist(), len(steps)]
        contacts = np.where(phases.contacts < 0, START, phases.contacts).tolist()
        for kind, first, last in zip([START, *contacts], [0, *ends[:-1]], ends, strict=True):
            of_phase = steps[first:last]
            kinds += [kind, *[FLOW] * len(of_phase)]
            shares += [0.0, *(of_phase / of_phase.sum())]
        is_flight = np.equal(kinds, FLOW)
        phase = np.maximum(np.cumsum(~is_flight) - 1 - num_choices, 0)
        held = np.zeros((len(kinds), num_contacts), dtype=np.bool_)
        modes = np.zeros(held.shape, dtype=np.int64)
        held[:, : phases.held.shape[1]] = phases.held[phase]
        modes[:, : phases.modes.shape[1]] = phases.modes[phase]
        flights = np.flatnonzero(is_flight)
        return cls(np.array(kinds), held, modes, flights, phase, np.array(shares))

    @property
    def starts(self) -> Ints:
        """Which stages start a phase, shape (P,); none without phases."""
        return np.flatnonzero((self.kinds != FLOW) & (self.kinds != CHOOSE))

    @property
    def num_choices(self) -> int:
        """How many stages choose the start, the first ones."""
        return int(np.count_nonzero(self.kinds == CHOOSE))

    def spread(self, row: Floats, size: int) -> Floats:
        """Returns numbers of the start's coordinates, (2n,), as those stages' controls."""
        spread = np.zeros(self.num_choices * size)
        spread[: len(row)] = row
        return spread.reshape(-1, size)


@dataclass(frozen=True, eq=False)
class OptimalControlProblem:
    """The best held controls u_k for a task from one start.

        minimize J   subject to   v̇ = M⁻¹ (B u − h + Jᵀ f),   bounds on u_k, and on q, v at knots

    Knots t_0 … t_N; n coordinates, nu controls.

    Attributes:
        mechanism: its dynamics.
        cost: the task's weights.
        times: of the knots, shape (N + 1,) [s].
        start: q and v at the first knot, shape (nq + n,); nq = n but for quaternions.
        scales: of q and v, shape (2n,): units of bounds and violations.
        state_bounds: lower and upper ones of q and v after the first knot, shape (2, 2n).
        control_bounds: the same of u, shape (2, nu).
        hard_goal: prescribed q and v at the end, shape (2n,); NaN: free. Coordinates that count
            modulo 2π in the cost do so here; of turns about three axes, it is the rotation vector
            from the cost's goal.
        control_norm: ‖u‖ at most.
        length: unit of smoothing and φ [m].
        phases: with impacts at rigid walls; None: no impacts. With phases, `times` divide each of
            them, and at rigid contacts φ ≥ 0 holds at all knots.
        clearances: with phases, least φ at knots, shape (N + 1, m) [m]; None: 0.
        least_distances: φ of contacts at least, at knots after the first, shape (m,) [m]; −∞: any.
        slowest: with phases, least speed of impacts [m/s].
        fastest: speed of contacts at the start, where that is more than a length per duration
            (`contact.calc_start_speed`) [m/s].
        duration: of the whole task if the knots are only its end, so that friction stays the same
            [s]; 0: they are all of it.
        softens: whether springs that are smoothed push no harder than the task takes
            (`contact.tables.calc_gives`).
        added: costs and constraints of users.
        free_start: with phases, where the start may be, and the hard goal with it; None: `start`.

    Raises:
        ProgramError: a shape or a number does not fit; says which.
    """

    mechanism: AnyMechanism
    cost: TaskCost
    times: Floats
    start: Floats
    scales: Floats
    state_bounds: Floats
    control_bounds: Floats
    hard_goal: Floats
    control_norm: float = np.inf
    length: float = 1.0
    phases: Phases | None = None
    clearances: Floats | None = None
    least_distances: Floats | None = None
    slowest: float = 0.0
    fastest: float = 0.0
    duration: float = 0.0
    softens: bool = False
    added: AddedTerms = NO_TERMS
    free_start: FreeStart | None = None

    def __post_init__(self) -> None:
        """Checks shapes and numbers, and makes arrays read-only."""
        n, nu = self.mechanism.num_velocities, self.mechanism.num_controls
        shapes: dict[str, tuple[int, ...]] = {"times": (len(self.times),)}
        shapes |= {"start": (self.mechanism.num_positions + n,)}
        shapes |= dict.fromkeys(("scales", "hard_goal"), (2 * n,))
        shapes |= {"state_bounds": (2, 2 * n), "control_bounds": (2, nu)}
        for name, shape in shapes.items():
            array = read_only(getattr(self, name))
            object.__setattr__(self, name, array)
            if array.shape != shape:
                raise ProgramError(name, got=f"shape {array.shape}", expected=f"{shape}")
        self._check_numbers()

    def _check_numbers(self) -> None:
        """Refuses meaningless numbers."""
        m, N, phases = self.mechanism.num_contacts, len(self.times) - 1, self.phases
        fits = phases is None or (
            np.all((phases.knots > 0) & (phases.knots < N))
            and np.all((phases.contacts >= -1) & (phases.contacts < m))
            and {phases.held.shape[1], phases.modes.shape[1]} <= {0, m}
        )
        is_rising = len(self.times) > 1 and np.all(np.diff(self.times) > 0)
        (low, high), (least, most) = self.state_bounds, self.control_bounds
        checks = (
            ("times", "at least two, rising", is_rising),
            ("start", "finite numbers", np.all(np.isfinite(self.start))),
            ("scales", "numbers above 0", np.all(self.scales > 0)),
            ("state_bounds", "lower ≤ upper", np.all(low <= high)),
            ("control_bounds", "lower ≤ upper", np.all(least <= most)),
            ("phases", f"contacts below {m}, knots inside of 0 … {N}", fits),
            ("control_norm", "a number above 0", self.control_norm > 0),
            ("length", "a number above 0", self.length > 0),
            ("slowest", "a number of at least 0", 0 <= self.slowest < np.inf),
            ("fastest", "a number of at least 0", 0 <= self.fastest < np.inf),
            ("duration", "a number of at least 0", 0 <= self.duration < np.inf),
        )
        for name, expected, holds in checks:
            if not holds:
                got = np.asarray(getattr(self, name)).tolist() if name != "phases" else phases
                raise ProgramError(name, got=got, expected=expected)

    @cached_property
    def cost_scale(self) -> float:
        """Cost with all errors and controls at their scales; 1 if that is 0."""
        n, cost, T = self.mechanism.num_velocities, self.cost, np.ptp(self.times)
        q, v = self.scales[:n], self.scales[n:]
        running = T * (cost.Q @ q**2 + cost.Qv @ v**2 + cost.R @ self.control_scales**2)
        return float(running + cost.QT.diagonal() @ q**2 + cost.QTv.diagonal() @ v**2) or 1.0

    @cached_property
    def effort_scale(self) -> float:
        """Cost of controls at their scales, and `cost_scale` where they cost nothing.

        Heavy goals make `cost_scale` large, which says little of motions that reach them.
        """
        return float(np.ptp(self.times) * self.cost.R @ self.control_scales**2) or self.cost_scale

    @cached_property
    def control_scales(self) -> Floats:
        """The control that moves by the scales in the duration, against what brakes, and gravity.

        Its shape is (nu,).
        """
        inverse = np.abs(np.linalg.pinv(self.mechanism.actuation))
        return inverse @ self._load.force + np.finfo(float).tiny

    @cached_property
    def _load(self) -> Load:
        n, T = self.mechanism.num_velocities, np.ptp(self.times)
        q = self.start[: self.mechanism.num_positions]
        mass, bias = self.mechanism.calc_inertia(q)
        force = np.abs(mass) @ self.scales[:n] / T**2 + np.abs(bias)
        force += self.mechanism.calc_drag(q) + self.mechanism.damping * self.scales[n:]
        return Load(q, force)

    @cached_property
    def layout(self) -> StageLayout:
        """Its stages."""
        count = 0 if self.free_start is None else -(-len(self.scales) // len(self.control_scales))
        return StageLayout.of(self.times, self.phases, self.mechanism.num_contacts, count)

    def fit_mechanism(self, substeps: int, is_implicit: bool = False) -> Any:
        """Returns the mechanism's tables for compiled code and this number of steps of a stage.

        Implicit steps resolve friction, whatever their length.
        """
        duration, load = self.duration or float(np.ptp(self.times)), None
        step = 0.0 if is_implicit else float(np.max(np.diff(self.times))) / substeps
        if self.softens:
            load = self._load
        speed = max(self.fastest, self.length / duration)
        return self.mechanism.fit(step, duration, speed, load)

    @property
    def knot_times(self) -> Floats:
        """Times of knots [s], shape (N + 1,), with the guessed durations of phases."""
        if self.phases is None:
            return self.times
        of_stages = self.phases.durations[self.layout.phases]
        steps = (self.layout.shares * of_stages)[self.layout.flights]
        return np.concatenate([[0.0], np.cumsum(steps)])
