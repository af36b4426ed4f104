"""Solution of a shooting problem: options, one solve, and its result."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import ArrayRecord, Floats, Ints, LockedArrays
from drake_aigto.contact import SOURCE, TreeMechanics
from drake_aigto.errors import OptionsError, ProgramError, check_counts, check_positive
from drake_aigto.shooting.descent import descend
from drake_aigto.shooting.optimal_control import OptimalControlProblem, Phases
from drake_aigto.shooting.program import is_implicit
from drake_aigto.shooting.tables import FLOW, Outcome, Pass, Program, make_memory
from drake_aigto.simulation import Replay
from drake_aigto.transcription import Touch, TouchSequence

# Of 69 boxes around arms of three links, 5 are closed to motions better than no control if steps
# may raise the cost by much, 14 if they may not, and 24 with Runge-Kutta steps shorter by this
# factor as well. Around a cart-pole between soft walls, steps that may do so lead to better plans.
_SHORTER = 2
# Bounds are infeasible near a motion if this many updates in a row, with growing penalties, each
# leave more than this part of their violation; a pass without a step does not count at first.
_PATIENCE, _STUCK = 4, 0.9
# After a pass without a step, tolerances are finer by this factor: larger ρ would damp steps, too.
# Only between rigid walls: between compliant ones plans of two tasks cost up to 2 % more with that.
_FINER, _FINEST = 1e-2, 1e-13
# After a pass that was cut off, costs may still fall by up to this factor: of 280 motions of discs
# that swap places, none fell further below the limit.
_FALLING = 2.5
# Passes of this tolerance and above are rough.
_ROUGH = 1e-2


class Smoothing(NamedTuple):
    """A pass at one smoothing.

    Attributes:
        smoothing: ε in units of the problem's length.
        iterations: at most.
        tolerance: of the decrease that the next step promises, as a share of the cost.
        most: motions that cost more at its end, or promise to, are left unfinished; of the last
            pass `ShootingOptions.most_promised` counts instead.
    """

    smoothing: float
    iterations: int
    tolerance: float
    most: float = math.inf


@dataclass(frozen=True)
class ShootingOptions:
    """Options of `ShootingProblem.solve`.

    Attributes:
        rungs: passes at falling smoothing. Without compliance or friction, the last one with all
            iterations replaces them.
        substeps: steps of a stage, by a Runge-Kutta method, or implicit ones.
        order: of their error: 4, or 2 with half as many evaluations; or implicit (`is_implicit`).
        penalty: ρ at first, in units of cost per squared scale.
        multiplier_updates: further passes of the last rung, until bounds at knots hold.
        feasibility: their largest violation, in units of the state's scales.
        is_wary: whether steps that close gaps of a guess may raise the cost by little only. Most
            motions are found sooner without; where they diverge, few are.
        most_promised: motions that promise to cost more in the last pass, with penalties, are
            left unfinished; so are those that cost more after a pass that ended, and far more
            after one that was cut off: as bounds count more, costs rise.
        judges: whether the exact cost of what is found is asked, too; else it is infinite.

    Raises:
        OptionsError: an option is out of its range.
    """

    rungs: tuple[Smoothing, ...] = (
        Smoothing(0.1, 40, 1e-3),
        Smoothing(0.01, 40, 1e-3),
        Smoothing(0.001, 60, 1e-5),
    )
    substeps: int = 1
    order: int = 4
    penalty: float = 10.0
    multiplier_updates: int = 12
    feasibility: float = 1e-4
    is_wary: bool = False
    most_promised: float = math.inf
    judges: bool = True

    def __post_init__(self) -> None:
        """Checks the ranges."""
        rungs = tuple(Smoothing(*rung) for rung in self.rungs)
        object.__setattr__(self, "rungs", rungs)
        check_positive(self, "penalty", "feasibility")
        check_counts(self, substeps=1, multiplier_updates=0)
        checks = (
            ("rungs", rungs, "at least one", len(rungs) > 0),
            ("smoothing", rungs, "numbers of at least 0", all(r.smoothing >= 0 for r in rungs)),
            ("iterations", rungs, "at least 1", all(r.iterations >= 1 for r in rungs)),
            ("tolerance", rungs, "numbers above 0", all(r.tolerance > 0 for r in rungs)),
            ("order", self.order, "1, -2, 2 or 4", self.order in (2, 4) or is_implicit(self.order)),
            ("most_promised", self.most_promised, "a number", not math.isnan(self.most_promised)),
        )
        for name, got, expected, holds in checks:
            if not holds:
                raise OptionsError(name, got, expected)

    @property
    def wary(self) -> ShootingOptions:
        """The same options for motions that diverge."""
        return replace(self, substeps=_SHORTER * self.substeps, is_wary=True)


class MotionExpansion(NamedTuple):
    """A problem about a motion: K stages, of which N are flights."""

    cost: float  # of all stages, each from its own state of the motion
    gaps: Floats  # by how much each stage misses the next one's state, shape (K, 2n)
    transitions: Floats  # ∂(q, v) after each stage by (q, v) before it, shape (K, 2n, 2n)
    gains: Floats  # of the best feedback of held controls, shape (N, nu, 2n)


@dataclass(frozen=True, eq=False)
class ShootingResult(LockedArrays, ArrayRecord):
    """The motion of given controls, to the accuracy of its steps.

    Attributes:
        times: of the knots, shape (N + 1,) [s].
        states: q and v at the knots, shape (N + 1, 2n); after impacts.
        controls: u between them, shape (N, nu).
        cost: with the contact law smoothed as it was at the end; infinite if the start's controls
            lead nowhere.
        exact_cost: of the same controls, without smoothing; infinite if it was not asked for.
        violation: of bounds at knots, in units of the state's scales, at most.
        iterations: in all.
        is_converged: whether the last pass ended in its tolerance.
        smoothing: ε at the end [m].
        substeps: Runge-Kutta steps between knots.
        order: of their error.
        phases: with their durations; one if the problem has none.
        prices: of bounds at knots: ρ, then all multipliers.
        is_left: whether it was left unfinished (`ShootingOptions.most_promised`).
        replay: of the controls, if they were simulated to get this; else None.
    """

    times: Floats
    states: Floats
    controls: Floats
    cost: float
    exact_cost: float
    violation: float
    iterations: int
    is_converged: bool
    smoothing: float
    substeps: int
    order: int
    phases: Phases
    prices: Floats
    is_left: bool = field(default=False, kw_only=True)
    replay: Replay | None = field(default=None, kw_only=True)

    @property
    def hits(self) -> Ints:
        """The knots of impacts."""
        return self.phases.knots[self.phases.contacts >= 0]

    @property
    def touches(self) -> TouchSequence:
        """The touches of rigid walls, by time."""
        return tuple(touch for touch, _ in self.starts)

    @property
    def starts(self) -> list[tuple[Touch, int | None]]:
        """The touches by time, and the knots of their impacts; None for those without one."""
        phases, times = self.phases, self.times[[0, *self.phases.knots, -1]].tolist()
        found: list[tuple[Touch, int | None]] = []
        for phase, held in enumerate(phases.held):
            hit = int(phases.contacts[phase - 1]) if phase else -1
            for contact in sorted({*np.flatnonzero(held).tolist(), hit} - {-1}):
                if contact != hit and phase and phases.goes_on(phase, contact):
                    continue
                end = phase + 1 if held[contact] else phase
                while end < len(phases.held) and phases.goes_on(end, contact):
                    end += 1
                mode = int(phases.modes[phase, contact])
                knot = int(phases.knots[phase - 1]) if contact == hit else None
                found.append((Touch(times[phase], times[end], contact, mode), knot))
        return sorted(found, key=lambda each: (each[0].start, each[1] is not None))


class ShootingRun:
    """One solve: the motion, the multipliers and the memory."""

    def __init__(
        self,
        problem: OptimalControlProblem,
        program: Program,
        controls: Floats,
        states: Floats | None,
        options: ShootingOptions,
        prices: Floats | None = None,
    ) -> None:
        """Takes the motion's shape from the problem, and fills its tables."""
        self._problem, self._options, self._has_gaps = problem, options, states is not None
        self._layout, self._program = problem.layout, program
        self._controls = self._lay_out_controls(controls)
        self._states = self._lay_out_states(states)
        self._memory = make_memory(self._program)
        self._is_bounded = bool(self._program.bounds.is_bounded.any())
        self._penalty, self._iterations = float(options.penalty * problem.cost_scale), 0
        if prices is not None:
            own = self._program.bounds.multipliers
            known = _take("prices", prices, (1 + own.size,))
            self._penalty, own[...] = float(known[0]), known[1:].reshape(own.shape)

    def _lay_out_controls(self, controls: Floats) -> Floats:
        """Returns the controls of stages, shape (K, nu): durations where phases start.

        Controls are moved into their bounds, then towards 0 until their norm is within its own.
        """
        problem, layout, bounds = self._problem, self._layout, self._program.bounds
        nu, low, high = problem.mechanism.num_controls, bounds.lower_control, bounds.upper_control
        chosen, flights = np.zeros((len(layout.kinds), nu)), layout.flights
        taken = _take("controls", controls, (len(flights), nu))
        taken = np.minimum(np.maximum(taken, low[flights]), high[flights])
        squares = sum((column**2 for column in taken.T), np.zeros(len(flights)))
        is_off = squares > bounds.norm**2
        taken[is_off] *= (bounds.norm / np.sqrt(squares[is_off]))[:, np.newaxis]
        chosen[flights] = taken
        if problem.phases is not None:
            starts = layout.starts
            chosen[starts, 0] = np.clip(problem.phases.durations, low[starts, 0], high[starts, 0])
        if problem.free_start is not None:
            change, count = layout.spread(problem.free_start.change, nu), layout.num_choices
            chosen[:count] = np.clip(change, low[:count], high[:count])
        return chosen

    def _lay_out_states(self, states: Floats | None) -> Floats:
        """Returns z at each stage, shape (K + 1, nz), and at the end."""
        problem, layout = self._problem, self._layout
        K, N, nx = len(layout.kinds), len(problem.times) - 1, len(problem.start)
        first, free = layout.num_choices, problem.free_start
        size = nx + (0 if problem.phases is None else 2)
        laid = np.zeros((K + 1, size + (0 if free is None else len(free.change))))
        if states is not None:
            knots = np.cumsum(layout.kinds == FLOW)
            laid[:, :nx] = _take("states", states, (N + 1, nx))[np.concatenate([[0], knots])]
        laid[: first + 1, :nx] = problem.start
        if problem.phases is not None:
            laid[0, nx] = problem.phases.durations[0]
            laid[1:, nx] = problem.phases.durations[layout.phases]
            laid[1:, nx + 1] = np.cumsum(layout.shares * laid[1:, nx])
        if free is not None:
            nu, n = self._controls.shape[1], len(free.change)
            chosen = self._controls[:first].ravel()[:n]
            for k in range(first):
                laid[k + 1 :, size + k * nu :][:, :nu] = chosen[k * nu :][:nu]
        return laid

    def run(self) -> ShootingResult:
        """Runs all rungs, then the last one until bounds hold, or J is above the most."""
        before, stuck, most = np.inf, 0, self._options.most_promised
        rungs = self._options.rungs
        if not self._problem.mechanism.is_smoothed:  # All iterations in one.
            rungs = (rungs[-1]._replace(iterations=sum(rung.iterations for rung in rungs)),)
        for rung in rungs:
            outcome = self._run_rung(rung, before)
            before = outcome.violation
            outcome = outcome._replace(is_left=outcome.is_left or outcome.cost > rung.most)
            if outcome.is_left:
                return self.finish(outcome)
        for _ in range(self._options.multiplier_updates if self._is_bounded else 0):
            before, has_ended = outcome.violation, outcome.iterations < rung.iterations
            limit = most if has_ended else most + (_FALLING - 1) * abs(most)
            outcome = outcome._replace(is_left=outcome.is_left or outcome.cost > limit)
            is_done = before <= self._options.feasibility or stuck == _PATIENCE
            if is_done or outcome.is_left:
                break
            if self._tells_nothing(outcome):
                rung = rung._replace(tolerance=max(_FINER * rung.tolerance, _FINEST))
            outcome = self._run_rung(rung, before)
            waits = self._tells_nothing(outcome) and rung.tolerance > _FINEST
            stuck = stuck + (not waits) if outcome.violation > _STUCK * before else 0
        return self.finish(outcome)

    def linearize(self) -> MotionExpansion:
        """Returns the expansion about the motion, after one sweep, without bounds of controls."""
        bounds, flights = self._program.bounds, self._layout.flights
        lower, upper = np.array(bounds.lower_control), np.array(bounds.upper_control)
        lower[flights], upper[flights] = -np.inf, np.inf
        free = bounds._replace(lower_control=lower, upper_control=upper, norm=np.inf)
        self._program = self._program._replace(bounds=free)
        outcome = self._descend(self._options.rungs[-1], self._states, False)
        if not outcome.is_converged:
            got = f"a motion that costs {outcome.cost}"
            raise ProgramError("controls", got=got, expected="a finite one")
        nx, found = len(self._problem.scales), self._memory.expansion
        return MotionExpansion(
            cost=outcome.cost,
            gaps=np.array(found.gaps[:, :nx]),
            transitions=np.array(found.F[:, :nx, :nx]),
            gains=np.array(self._memory.sweep.gains[flights][:, :, :nx]),
        )

    def _run_rung(self, rung: Smoothing, before: float) -> Outcome:
        """Returns the outcome of a rung; ρ grows if its steps leave violations as they were."""
        outcome = self._descend(rung, self._states, self._is_bounded)
        self._iterations, self._has_gaps = self._iterations + outcome.iterations, False
        stays = outcome.violation > before / 4 and not self._tells_nothing(outcome)
        self._penalty *= 10 if self._is_bounded and stays else 1
        return outcome

    def _tells_nothing(self, outcome: Outcome) -> bool:
        """Returns whether a pass between rigid walls made no step: violations cost too little."""
        return outcome.iterations == 1 and self._problem.phases is not None

    def _holds_states(self, rung: Smoothing) -> bool:
        """Returns whether damping holds states: of trees, and where compliant contacts slide.

        In a plane, not in rough passes: of five seeds, three would find worse hops, by 6 to 9 %.
        """
        if isinstance(self._program.mechanics, TreeMechanics):
            return True
        return self._slides and rung.tolerance < _ROUGH

    @cached_property
    def _slides(self) -> bool:
        """Whether compliant contacts slide in a plane."""
        slides = np.any(self._problem.mechanism.frictions[:, SOURCE] >= 0)
        return bool(slides) and self._problem.phases is None

    def _descend(self, rung: Smoothing, states: Floats, updates: bool) -> Outcome:
        """Returns the outcome of a pass; multipliers are updated after it if asked."""
        is_last = rung.smoothing == self._options.rungs[-1].smoothing
        settings = Pass(
            eps=float(rung.smoothing * self._problem.length),
            penalty=self._penalty,
            iterations=rung.iterations,
            tolerance=float(rung.tolerance),
            scale=float(1e-3 * self._problem.effort_scale),
            is_wary=self._options.is_wary,
            most=float(self._options.most_promised if is_last else rung.most),
            updates=updates,
            holds_states=self._holds_states(rung),
            # Of trees, patience takes half as long again, for costs that are as often worse.
            is_patient=not isinstance(self._program.mechanics, TreeMechanics),
            first=-1,
        )
        has_gaps, memory = self._has_gaps, self._memory
        return descend(self._program, states, self._controls, has_gaps, settings, memory)

    def finish(self, outcome: Outcome | None = None) -> ShootingResult:
        """Returns the motion of the controls with its costs; None: without a pass."""
        last = self._options.rungs[-1]._replace(iterations=0)
        found = outcome or self._descend(last, self._states, False)
        exact = found.cost if self._options.judges else np.inf
        if last.smoothing and self._options.judges:
            exact = self._descend(last._replace(smoothing=0.0), self._states.copy(), False).cost
        problem, layout, nx = self._problem, self._layout, len(self._problem.start)
        at_knots, T = self._states[[*layout.flights, -1]], float(np.ptp(problem.times))
        phases = Phases.free(T, (T, T))
        if problem.phases is not None:
            phases = replace(problem.phases, durations=self._controls[layout.starts, 0])
        return ShootingResult(
            times=problem.times if problem.phases is None else at_knots[:, nx + 1],
            states=at_knots[:, :nx],
            controls=self._controls[layout.flights],
            cost=found.cost if np.isfinite(found.cost) else np.inf,
            exact_cost=exact if np.isfinite(exact) else np.inf,
            violation=found.violation,
            iterations=self._iterations,
            is_converged=outcome is not None and outcome.is_converged,
            smoothing=last.smoothing * self._problem.length,
            substeps=self._options.substeps,
            order=self._options.order,
            phases=phases,
            prices=np.concatenate([[self._penalty], self._program.bounds.multipliers.ravel()]),
            is_left=found.is_left,
        )


def _take(name: str, values: Floats, shape: tuple[int, ...]) -> Floats:
    """Returns a copy to work on; raises a ProgramError if its shape is another."""
    array = np.array(values, dtype=float)
    if array.shape != shape:
        raise ProgramError(name, got=f"shape {array.shape}", expected=f"{shape}")
    return array
