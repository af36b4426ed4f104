"""Optimal control by shooting."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from drake_aigto.arrays import Floats, read_only
from drake_aigto.errors import ProgramError
from drake_aigto.shooting.added import NO_TERMS, AddedTerms
from drake_aigto.shooting.friction import calc_drag, fit_to_steps
from drake_aigto.shooting.mechanism import Mechanism
from drake_aigto.shooting.program import Layout, Phases, make_program
from drake_aigto.shooting.solve import ShootingOptions, ShootingResult, Smoothing, Solve
from drake_aigto.shooting.tables import STICTION, Program
from drake_aigto.world import TaskCost


@dataclass(frozen=True, eq=False)
class ShootingProblem:
    """The best held controls u_k for a task from one start.

        minimize J   subject to   v̇ = M⁻¹ (B u − h + Jᵀ f),   bounds on u_k, and on q, v at knots

    Motion is integrated by Runge-Kutta steps, the cost with it, and the derivatives of both are
    exact.

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
        force += calc_drag(self.mechanism, self.start[:n])
        return inverse @ force + np.finfo(float).tiny

    def solve(
        self,
        controls: Floats,
        states: Floats | None = None,
        options: ShootingOptions | None = None,
        prices: Floats | None = None,
        most: float = np.inf,
    ) -> ShootingResult:
        """Returns a local optimum near a motion.

        Args:
            controls: u_k, shape (N, nu); those out of bounds are moved into them.
            states: q and v at knots, shape (N + 1, 2n), which need not follow from the controls
                and are taken there; None: those that do.
            options: numerics.
            prices: of bounds at first: those of a result of this problem under other options.
            most: a motion whose J is larger after a pass that ended is left as it is then, and one
                that was cut off where J is far larger: as bounds count more, J rises.

        Raises:
            ProgramError: a shape does not fit.
        """
        options = options or ShootingOptions()
        return Solve(self, controls, states, options, prices).run(most)

    def simulate(
        self, controls: Floats, substeps: int, smoothing: float = 0.0, order: int = 4
    ) -> ShootingResult:
        """Returns the motion of given controls.

        Args:
            controls: u_k, shape (N, nu); those out of bounds are moved into them.
            substeps: Runge-Kutta steps between knots.
            smoothing: ε in units of the problem's length.
            order: see `ShootingOptions`.

        Raises:
            ProgramError: a shape does not fit.
        """
        options = ShootingOptions((Smoothing(smoothing, 1, 1.0),), substeps, order)
        return Solve(self, controls, None, options).finish()

    def calc_gains(self, controls: Floats, substeps: int, smoothing: float = 0.0) -> Floats:
        """Returns how held controls best answer deviations of the state, shape (N, nu, 2n).

        ũ_k = K_k x̃_k has the least cost to go to second order, in the Gauss-Newton form, about the
        motion of given controls. Where a control is at its bound, K_k is 0.

        Args:
            controls: see `simulate`, as for substeps and smoothing.
            substeps: Runge-Kutta steps between knots.
            smoothing: ε in units of the problem's length.

        Raises:
            ProgramError: a shape does not fit, or the motion runs away.
        """
        options = ShootingOptions((Smoothing(smoothing, 1, np.inf),), substeps)
        return Solve(self, controls, None, options).find_gains()

    def estimate_error(self, result: ShootingResult) -> float:
        """Returns how far off the steps of a result are: against twice as many of order 4.

        It is the larger one of the cost's change, in units of the cost or of `cost_scale` if that
        is larger, and the final state's, in units of its scales.
        """
        question = self.starting_from(result)
        finer = question.simulate(result.controls, 2 * result.substeps)
        same = question.simulate(result.controls, result.substeps, order=result.order)
        unit = max(abs(finer.exact_cost), self.cost_scale)
        off = np.abs(finer.states[-1] - same.states[-1]) / self.scales
        error = max(abs(finer.exact_cost - same.exact_cost) / unit, float(off.max()))
        return error if np.isfinite(error) else np.inf

    def make_program(self, options: ShootingOptions) -> Program:
        """Returns the tables that compiled code reads, with multipliers of their own, zero.

        All else is made once for each order and number of substeps.
        """
        key = options.order, options.substeps
        if key not in self._programs:
            self._programs[key] = make_program(self, self.layout, options)
        program = self._programs[key]
        multipliers = np.zeros_like(program.bounds.multipliers)
        return program._replace(bounds=program.bounds._replace(multipliers=multipliers))

    @cached_property
    def _programs(self) -> dict[tuple[int, int], Program]:
        return {}

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

    def lasting(self, duration: float) -> ShootingProblem:
        """Returns the same problem, whose phases, if any, last for a sum at first [s]."""
        if self.phases is None:
            return self
        return self._with_durations(duration / self.phases.durations.sum() * self.phases.durations)

    def starting_from(self, result: ShootingResult) -> ShootingProblem:
        """Returns the same problem, whose phases last as long at first as those of a result."""
        return self if self.phases is None else self._with_durations(result.durations)

    def _with_durations(self, durations: Floats) -> ShootingProblem:
        assert self.phases is not None
        return replace(self, phases=replace(self.phases, durations=durations))
