"""Problems of optimal control: what moves, from where, for how long, within which bounds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from drake_aigto.arrays import Floats, read_only
from drake_aigto.errors import ProgramError
from drake_aigto.shooting.added import NO_TERMS, AddedTerms
from drake_aigto.shooting.friction import fit_to_steps
from drake_aigto.shooting.mechanism import Mechanism
from drake_aigto.shooting.phases import Layout, Phases
from drake_aigto.shooting.tables import STICTION
from drake_aigto.world import TaskCost


@dataclass(frozen=True, eq=False)
class OptimalControlProblem:
    """The best held controls u_k for a task from one start.

        minimize J   subject to   v̇ = M⁻¹ (B u − h + Jᵀ f),   bounds on u_k, and on q, v at knots

    Knots t_0 … t_N; n coordinates, nu controls.

    Attributes:
        mechanism: what moves.
        cost: the task's weights.
        times: of the knots, shape (N + 1,) [s].
        start: q and v at the first knot, shape (2n,).
        scales: how much of q and v is much, shape (2n,): units of bounds and violations.
        state_bounds: lower and upper ones of q and v after the first knot, shape (2, 2n).
        control_bounds: the same of u, shape (2, nu).
        hard_goal: what q and v have to be at the end, shape (2n,); NaN: anything. Whole turns do
            not count where the cost does not count them.
        control_norm: ‖u‖ at most.
        length: what smoothing and φ are measured in [m].
        phases: what rigid walls are hit at which knots; None: nothing is hit. Then `times` says how
            knots divide each phase, and where contacts do not yield φ ≥ 0 at all knots.
        clearances: of phases, how far φ has to be above 0 at knots, shape (N + 1, m) [m]; None: 0.
        slowest: of phases, how fast walls are hit at least [m/s].
        duration: of the whole task, where the knots are no more than its end, so that friction
            stays what it was [s]; 0: they are all of it.
        added: costs and constraints of users.

    Raises:
        ProgramError: a shape or a number does not fit; says which.
    """

    mechanism: Mechanism
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
    slowest: float = 0.0
    duration: float = 0.0
    added: AddedTerms = NO_TERMS

    def __post_init__(self) -> None:
        """Checks shapes and numbers, and makes arrays read-only."""
        n, nu = self.mechanism.num_positions, self.mechanism.num_controls
        shapes: dict[str, tuple[int, ...]] = {"times": (len(self.times),)}
        shapes |= dict.fromkeys(("start", "scales", "hard_goal"), (2 * n,))
        shapes |= {"state_bounds": (2, 2 * n), "control_bounds": (2, nu)}
        for name, shape in shapes.items():
            array = read_only(getattr(self, name))
            object.__setattr__(self, name, array)
            if array.shape != shape:
                raise ProgramError(name, got=f"shape {array.shape}", expected=f"{shape}")
        self._check_numbers()

    def _check_numbers(self) -> None:
        """Refuses numbers that mean nothing."""
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
            ("duration", "a number of at least 0", 0 <= self.duration < np.inf),
        )
        for name, expected, holds in checks:
            if not holds:
                got = np.asarray(getattr(self, name)).tolist() if name != "phases" else phases
                raise ProgramError(name, got=got, expected=expected)

    @cached_property
    def cost_scale(self) -> float:
        """What the task costs where all is off by its scale, controls too; 1 if that is nothing."""
        n, cost, T = self.mechanism.num_positions, self.cost, np.ptp(self.times)
        q, v = self.scales[:n], self.scales[n:]
        running = T * (cost.Q @ q**2 + cost.Qv @ v**2 + cost.R @ self.control_scales**2)
        return float(running + cost.QT.diagonal() @ q**2 + cost.QTv.diagonal() @ v**2) or 1.0

    @cached_property
    def control_scales(self) -> Floats:
        """The control that moves by the scales in time, against friction, and holds the start.

        Its shape is (nu,).
        """
        n, T = self.mechanism.num_positions, np.ptp(self.times)
        mass, bias = self.mechanism.calc_inertia(self.start[:n])
        inverse = np.abs(np.linalg.pinv(self.mechanism.mechanics.actuation))
        force = np.abs(mass) @ self.scales[:n] / T**2 + np.abs(bias)
        force += self.mechanism.calc_drag(self.start[:n])
        return inverse @ force + np.finfo(float).tiny

    @cached_property
    def layout(self) -> Layout:
        """Its stages."""
        return Layout.of(self.times, self.phases, self.mechanism.num_contacts)

    def fit_friction(self, substeps: int) -> Floats:
        """Returns the numbers of friction in so short Runge-Kutta steps, see `fit_to_steps`."""
        duration = self.duration or float(np.ptp(self.times))
        step, rubs = np.max(np.diff(self.times)) / substeps, self.mechanism.mechanics.rubs
        return fit_to_steps(rubs, step, duration, self.length / duration)

    @property
    def rubbing_substeps(self) -> int:
        """In how many Runge-Kutta steps between knots friction is as steep as the world has it."""
        ratios = self.fit_friction(1)[:, STICTION] / self.mechanism.mechanics.rubs[:, STICTION]
        return int(np.ceil(np.max(ratios, initial=1.0)))

    @property
    def knot_times(self) -> Floats:
        """When knots are [s], shape (N + 1,), where phases last as long as at first."""
        if self.phases is None:
            return self.times
        return self.layout.calc_times(self.phases.durations)
