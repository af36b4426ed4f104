"""Phases of a motion, and the stages that knots and phases cut it into."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from drake_aigto.arrays import ArrayRecord, Bools, Floats, Ints, read_only
from drake_aigto.errors import ProgramError
from drake_aigto.shooting.tables import FLOW, START

_FIELDS = {
    "contacts": np.int64,
    "knots": np.int64,
    "durations": float,
    "held": np.bool_,
    "modes": np.int64,
}


@dataclass(frozen=True, eq=False)
class Phases(ArrayRecord):
    """Which contact is hit at which knot, with free durations between; P phases, m contacts.

        φ_i(q) = 0,   v⁺ = v⁻ − M⁻¹ Jᵀ (J M⁻¹ Jᵀ)⁻¹ (1 + e) J v⁻     where contact i is hit
        J v̇ + J̇ v = 0,   M v̇ + h = B u + Jᵀ λ,   λ ≥ 0               while contacts are held

    J has the rows of what is held from then on, too. What is held has been hit before, and e is 0
    then, whatever the contact's is: so ends what bounces ever faster, or does not bounce at all. Or
    it has been held from the start on. What rubs does so in a mode, as it is hit and while it is
    held, and of these the last is λ_t, for impulses likewise:

        T v̇ + Ṫ v = 0,   |λ_t| ≤ μ λ_n                                stick, mode 0
        λ_t = −σ μ λ_n,   σ T v ≥ 0                                   slip, mode σ = ±1

    Attributes:
        contacts: what ends each phase but the last, −1 if nothing is hit; shape (P − 1,).
        knots: where it does, rising, inside of 0 … N, shape (P − 1,).
        durations: of the phases, to start from, shape (P,) [s].
        total: the least and the most of their sum [s].
        held: which contacts are held in each phase, shape (P, m); empty: never any.
        modes: of contacts that rub, in which they are held in each phase, and hit where it starts:
            0 if they stick, else the sign of the slip, shape (P, m); empty: all stick.
    """

    contacts: Ints
    knots: Ints
    durations: Floats
    total: tuple[float, float]
    held: Bools = field(default_factory=lambda: np.zeros((0, 0), dtype=np.bool_))
    modes: Ints = field(default_factory=lambda: np.zeros((0, 0), dtype=np.int64))

    def __post_init__(self) -> None:
        """Makes arrays read-only.

        Raises:
            ProgramError: numbers do not fit together.
        """
        count = len(self.contacts) + 1
        for name, dtype in _FIELDS.items():
            array = read_only(getattr(self, name), dtype)
            if name in ("held", "modes") and not len(array):
                array = read_only(np.zeros((count, 0)), dtype)
            object.__setattr__(self, name, array)
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
        """Returns one phase, which ends where nothing is hit, of free duration [s]."""
        none = np.zeros(0, dtype=np.int64)
        return cls(none, none, np.array([duration]), total)


@dataclass(frozen=True, eq=False)
class Layout:
    """The stages of a problem: flights between knots and, of phases, what starts each."""

    kinds: Ints  # FLOW, START or a contact, of each of K stages, shape (K,)
    held: Bools  # which contacts are held in each, shape (K, m)
    modes: Ints  # in which mode each contact is held in each, or hit, shape (K, m)
    flights: Ints  # which stages are flights, shape (N,)
    shares: Floats  # how long each lasts [s]; of phases, as a share of its phase; shape (K,)

    @classmethod
    def of(cls, times: Floats, phases: Phases | None, num_contacts: int) -> Layout:
        """Returns the stages of knots at these times, shape (N + 1,)."""
        steps = np.diff(times)
        if phases is None:
            never = np.zeros((len(steps), num_contacts), dtype=np.bool_)
            none = never.astype(np.int64)
            return cls(np.full(len(steps), FLOW), never, none, np.arange(len(steps)), steps)
        kinds: list[int] = []
        shares: list[float] = []
        ends = [*phases.knots.tolist(), len(steps)]
        contacts = np.where(phases.contacts < 0, START, phases.contacts).tolist()
        for kind, first, last in zip([START, *contacts], [0, *ends[:-1]], ends, strict=True):
            of_phase = steps[first:last]
            kinds += [kind, *[FLOW] * len(of_phase)]
            shares += [0.0, *(of_phase / of_phase.sum())]
        is_flight = np.equal(kinds, FLOW)
        phase = np.cumsum(~is_flight) - 1
        held = np.zeros((len(kinds), num_contacts), dtype=np.bool_)
        modes = np.zeros(held.shape, dtype=np.int64)
        held[:, : phases.held.shape[1]] = phases.held[phase]
        modes[:, : phases.modes.shape[1]] = phases.modes[phase]
        return cls(np.array(kinds), held, modes, np.flatnonzero(is_flight), np.array(shares))

    def calc_times(self, durations: Floats) -> Floats:
        """Returns when knots are [s], shape (N + 1,), where phases last so long, shape (P,)."""
        of_phase = np.cumsum(self.kinds != FLOW) - 1
        steps = (self.shares * durations[of_phase])[self.flights]
        return np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def starts(self) -> Ints:
        """Which stages start a phase, shape (P,); none without phases."""
        return np.flatnonzero(self.kinds != FLOW)
