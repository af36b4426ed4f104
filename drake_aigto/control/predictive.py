"""Planning again while the robot moves, as a LeafSystem."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, State
from pydrake.trajectories import PiecewisePolynomial

from drake_aigto.arrays import Floats
from drake_aigto.control.catch import PART
from drake_aigto.control.estimation import ModelEstimate
from drake_aigto.control.family import Unknown
from drake_aigto.control.ports import (
    NUMBERS,
    OFTEN,
    LoopController,
    Mode,
    Safety,
    TickStatus,
    check_seconds,
    may_be_unsampled,
)
from drake_aigto.control.ticks import (
    Horizons,
    Reference,
    Searches,
    TickChoice,
    TickMemory,
    TickQuestion,
    append_command,
)
from drake_aigto.control.touches import PlannedMotion, SeenBounces
from drake_aigto.errors import ControlError
from drake_aigto.planning import Plan, Planner
from drake_aigto.trajectory import Trajectory

# Times of ticks are the same within this part of a period.
_SAME = 1e-6


class ModelPredictiveController(LoopController):
    """Plans from the estimated state, every period, and holds the plan's control between.

        controller = builder.AddSystem(ModelPredictiveController(Planner(scenario), period=0.01))
        builder.Connect(plant.get_state_output_port(), controller.get_input_port(0))
        builder.Connect(controller.get_output_port(0), plant.get_actuation_input_port())

    Each tick is *warm*: the last plan, shifted, is led to the best one near it from the new state,
    by a few iterations of the descent, or of balls between rigid walls by Newton's on the phases
    between touches. Every `search_every` ticks, and where a plan costs half as much again as the
    one before (`surprise`), the planner *searches* for another contact sequence as well; it is
    taken if it costs less by a margin. Work is bounded by counts: runs are the same again, also
    where searches have a thread of their own.

    With friction in joints or at compliant walls, ticks begin with the motion that the last plan's
    controls lead to, in more steps.

    Where rigid walls stand, and what they return, balls learn from bounces that are seen between
    one tick and the next, and from being well inside of one. All else that a model has wrong of
    masses, friction, walls or forces is found with `estimate`, and planned with (`ModelEstimate`).

    Between ticks the plan's control is held, or with `feedback_period` it is u* + K (x − x*) of
    `Feedback` about the plan, sampled so often.

    A sample that is of no use (`Safety`), one inside of a rigid wall where no contact lasts, or one
    from which no motion is found, leaves the last plan as it is, and its control goes on, or the
    fallback. After the end of a horizon that shrinks its goal is held, where a `Regulator` does, of
    mechanisms with motions to rest there. Else the last control goes on. No NaN leaves a port.

    The first plan is from the first sample: a state that is all zero, where the scenario's start is
    not, is taken for none at the start. Hinges of an estimate are taken whole turns on, to where
    they are nearest to the plan. A Simulator that is initialized again on its way, at most a period
    after the last tick, keeps the plan.

    Ports are those of `LoopController`, and two input ports that may stay unconnected: `reference`,
    q and v of a goal that moves, not followed where not finite; or else `reference_path`, a
    PiecewisePolynomial of them in the context's time, the goal where a horizon ends, and on the way
    the reference, where the scenario weighs that. It stands still after its end.
    """

    def __init__(
        self,
        planner: Planner,
        period: float,
        horizon: Literal["receding", "shrinking"] = "receding",
        iterations: int | None = 5,
        search_every: int | None = None,
        margin: float = 0.02,
        surprise: float = 0.5,
        search_ticks: int | Literal["auto"] | None = None,
        learns: bool = True,
        waits: bool = True,
        plan: Plan | None = None,
        feedback_period: float | Literal["auto"] | None = "auto",
        delay: float = 0.0,
        start_time: float = 0.0,
        safety: Safety | None = None,
        estimate: Sequence[Unknown] = (),
    ) -> None:
        """Takes the planner's task; its start does not count.

        Args:
            planner: of balls between rigid walls, or of a mechanism; its task and options are
                compiled once more.
            period: between ticks [s].
            horizon: always as long as the scenario, or ending with it, as goals with velocity need.
            iterations: of the descent in a tick, at most; balls between rigid walls have none, and
                mechanisms there up to five times as many, or a fixed number where these lead to
                nothing. None: as many as take half of a period, at most 15, measured at the start;
                a run is the same again if it is given what `TickStatus.iterations` says.
            search_every: ticks between searches; None: only at the start, and after a surprise.
            margin: what another sequence has to be better by, as a share of the cost.
            surprise: share by which a plan may cost more than the last, without a search.
            search_ticks: after how many ticks a search is done that runs in a thread beside warm
                ones: begun at tick k, from where the plan is going to be at tick k + search_ticks,
                it is waited for there. None: searches end in their tick. "auto": as many as take a
                quarter of the scenario's duration.
            learns: whether what rigid walls return, and where they stand, is learned
                (`SeenBounces`); the scenario and the model are what is thought of it before.
            waits: whether a search in a thread is waited for, so that a run is the same again; else
                it is taken at the first tick at which it is done, and ticks until then are late.
            plan: the first plan, in place of a search; its time 0 is the `start_time`.
            feedback_period: between samples that are answered by feedback about the plan, at most a
                period [s]; None: no feedback. "auto": a fifth of the scenario's time step, between
                compliant walls where a period and the delay are longer than that step.
            delay: see `LoopController`, as for the other arguments.
            start_time: the context's time at which the task begins [s].
            safety: limits, and the fallback.
            estimate: what of the model is not known, of "mass", "friction", "stiffness", "walls"
                and "force" (`ModelEstimate.of`); walls of balls are learned anyhow.

        Raises:
            ControlError: a free duration, or something that was added to the planner's
                transcription; an argument is out of its range, or the plan is another world's.
        """
        given: Any = planner
        if not isinstance(given, Planner):
            remedy = "Give it Planner(plan.scenario)." if isinstance(given, Plan) else ""
            got = type(given).__name__
            raise ControlError("planner", got=got, expected="a Planner", remedy=remedy)
        if horizon not in ("receding", "shrinking"):
            raise ControlError("horizon", got=horizon, expected="'receding' or 'shrinking'")
        for name, share in (("margin", margin), ("surprise", surprise)):
            if not (isinstance(share, NUMBERS) and share >= 0):
                raise ControlError(name, got=share, expected="a number of at least 0")
        about = planner.world, (asked := planner.scenario)
        if feedback_period == "auto":
            period, delay = check_seconds("period", period, True), check_seconds("delay", delay)
            is_late = asked.contact == "compliant" and period + delay > asked.time_step
            feedback_period = min(asked.time_step / OFTEN, period) if is_late else None
        super().__init__(*about, period, delay, start_time, safety, feedback_period)
        if search_ticks == "auto":
            search_ticks = max(1, int(np.ceil(PART * asked.duration / self.period)))
        counts = ("iterations", iterations, ""), ("search_every", search_every, "")
        for name, value, other in (*counts, ("search_ticks", search_ticks, ", or 'auto'")):
            if value is not None and not (isinstance(value, int | np.integer) and value >= 1):
                raise ControlError(name, got=value, expected=f"a count of at least 1{other}")
        if plan is not None:
            plan.find_world(planner.world)  # Refuses another world's.
        self._first = PlannedMotion.of(plan.best) if plan is not None else None
        self._learns = learns
        is_receding, most = horizon == "receding", iterations or 1
        self._horizons = Horizons(planner, self._scenario, is_receding, most, self.period)
        self._horizon, self._iterations = self._horizons.own, iterations
        known = ModelEstimate.of(self._world, self._scenario, estimate) if estimate else None
        if known and planner.is_of_balls and "walls" in estimate:
            got, expected = "walls of balls, which learns=True finds", "what is not learned so"
            raise ControlError("estimate", got=got, expected=expected)
        self._searches = Searches(self.period, margin, surprise, search_every, search_ticks, waits)
        nx, own = len(self._units), self._horizon
        never = -np.inf, np.zeros(nx)
        nowhere = TickQuestion(*never, SeenBounces(), own, lambda: own, None, never)
        status = TickStatus(-np.inf, np.inf, (), "", 0.0, restitution=own.restitution)
        empty = self._no_commands, status, -1, nowhere, nowhere.seen, None, known
        self._nothing = TickMemory(TickChoice(own.rest(0.0, nowhere.x), ""), *empty)
        self._reference = self.DeclareVectorInputPort("reference", nx)
        path = AbstractValue.Make(PiecewisePolynomial())
        self._path = self.DeclareAbstractInputPort("reference_path", path)
        self.estimated = known.names if known else ()
        self._moment = self.DeclareAbstractState(AbstractValue.Make(self._nothing))
        self.DeclareInitializationUnrestrictedUpdateEvent(self._start)
        self.DeclarePeriodicUnrestrictedUpdateEvent(self.period, self.period, self._tick)
        if between := self.feedback_period:
            self.DeclarePeriodicUnrestrictedUpdateEvent(between, between, self._correct)
        self._declare_outputs({self.abstract_state_ticket(self._moment)})

    def read_plan(self, context: Context) -> Trajectory:
        """Returns the plan in its own context, in the context's time."""
        return self._read(context).choice.motion.trajectory.later(self.start_time)

    def update(self, context: Context) -> None:
        """Ticks at the context's time, as a Simulator would have it do."""
        self._tick(context, context.get_mutable_state())

    def read_status(self, context: Context) -> TickStatus:
        """Returns the report of the last tick, in its own context."""
        return self._read(context).status

    def _read(self, context: Context) -> TickMemory:
        moment: TickMemory = context.get_abstract_state(int(self._moment)).get_value()
        return moment

    def _read_commands(self, context: Context) -> Floats:
        return self._read(context).commands

    def _find_desired(self, context: Context) -> Floats:
        return self._read(context).choice.motion.calc_state(self._find_time(context))

    def _find_path(self, context: Context) -> PiecewisePolynomial:
        return self.read_plan(context).to_piecewise()[0]

    def _find_time(self, context: Context) -> float:
        """Returns the task's time at which a command of now acts [s]."""
        return float(context.get_time()) - self.start_time + self.delay

    def _read_reference(self, context: Context) -> Reference:
        """Returns the goal or path to follow now."""
        if self._path.HasValue(context):
            return Reference(None, self._path.Eval(context), self.start_time)
        goal = self._reference.Eval(context) if self._reference.HasValue(context) else [np.nan]
        return Reference(np.array(goal) if np.all(np.isfinite(goal)) else None)

    def _ask(
        self, context: Context, x: Floats, before: TickMemory, seen: SeenBounces
    ) -> TickQuestion:
        """Returns what is to be planned from: a sample, checked and led on to when u acts."""
        motion, time = before.choice.motion, float(context.get_time())
        planned = motion.calc_state(time - self.start_time)
        sample, off = self._judge(x, planned, motion.reach)
        is_first = np.isinf(before.usable.now)
        if is_first and sample == "far off":  # There is no plan yet.
            sample, off = "valid", 0.0
        later, now = x, self._find_time(context)
        if sample == "valid" and self.delay:
            model = before.known.models[0] if before.known else self._model
            ahead = model.find_end(x, self._find_held(before.commands, time, time + self.delay))
            later, sample = (x, "far off") if ahead is None else (ahead, sample)
        posed = self._read_reference(context), now, before.known, before.iterations
        task, aside, catch = self._horizons.find(*posed)
        horizon = task.knowing(seen)
        return TickQuestion(now, later, seen, horizon, aside, catch, (time, x), sample, off)

    def _start(self, context: Context, state: State) -> EventStatus:
        """Searches for the first plan; on the way, the one that there is goes on."""
        x, before = np.array(self._read_start(context)), self._read(context)
        begin = max(self._find_time(context) - self.delay, 0.0)
        self._read_reference(context).check(self._horizon, begin)
        elapsed = context.get_time() - before.status.time
        is_same = elapsed == 0 and np.array_equal(x, before.usable.sampled[1])
        if is_same or 0 < elapsed <= self.period:
            return EventStatus.DidNothing()
        return self._begin(context, state, self._nothing, x)

    def _begin(self, context: Context, state: State, before: TickMemory, x: Floats) -> EventStatus:
        """Makes the first plan, or waits for the first sample or the start."""
        begin, question = time.perf_counter(), self._ask(context, x, before, SeenBounces())
        start = self._horizon.scenario.initial_state
        if question.now < -_SAME * self.period:
            reason = "waits for its start"
        elif before.tick < 0 and may_be_unsampled(x, start):
            reason = "waits for the first sample of the state"
        elif question.sample != "valid":
            reason = f"the estimated state is {question.sample}: waits for another one"
        else:
            choice = self._choose_first(question)
            if self._iterations is None and not self._horizon.is_over(question.now):
                count = self._horizons.measure(question, choice.motion)
                before = dataclasses.replace(before, iterations=count)
            return self._keep(state, before, choice, question, begin, usable=question)
        rest = self._horizon.rest(question.now, np.where(np.isfinite(x), x, 0.0))
        choice = TickChoice(rest, reason)
        return self._keep(state, before, choice, question, begin, usable=before.usable)

    def _choose_first(self, question: TickQuestion) -> TickChoice:
        """Returns the given plan, or that of a search.

        Raises:
            ControlError: the state is inside of a wall.
        """
        now, x, horizon = question.now, question.x, question.horizon
        if horizon.is_over(now):
            return TickChoice(self._first or horizon.rest(now, x), "the horizon is over")
        if self._first is not None:
            led = None if horizon.is_inside(x) else horizon.advance(self._first, now, x)
            return TickChoice(led or self._first, "the plan that was given")
        if horizon.is_inside(x):
            raise ControlError(
                "the state at the start",
                got=f"{x.tolist()}, on or inside of a wall",
                expected="one outside of all walls, or a mechanism that lies at one",
                remedy="Start a little off the wall, or track a plan: TrackingController.",
            )
        if found := horizon.search(now, x):
            return TickChoice(found, "the first search")
        rest = horizon.rest(now, x)
        motion = horizon.advance(rest, now, x) or rest
        return TickChoice(motion, "a search found nothing; a descent from rest")

    def _tick(self, context: Context, state: State) -> EventStatus:
        """Improves the plan, or takes another one."""
        begin, before = time.perf_counter(), self._read(context)
        now, x = float(context.get_time()), np.array(self._estimate.Eval(context))
        if np.isinf(before.usable.now):
            return self._begin(context, state, before, x)
        x = self._unwrap(x, before.choice.motion.calc_state(now - self.start_time))
        seen, (then, last) = before.seen, before.usable.sampled
        if self._learns and np.all(np.isfinite(x)):
            u = self._find_acting(before.commands, then)
            seen = self._horizon.watch(seen, (last, x), now - then, u)
        if before.known and now - then < (1 + _SAME) * self.period:
            held = self._find_held(before.commands, then, now)
            known = before.known.watch((last, x), held)
            before = dataclasses.replace(before, known=known)
        question = self._ask(context, x, before, seen)
        choice = self._searches.choose(before, question)
        usable = before.usable if question.obstacle else question
        return self._keep(state, before, choice, question, begin, usable)

    def _correct(self, context: Context, state: State) -> EventStatus:
        """Answers a sample between two ticks by feedback about the plan."""
        before, ticks = self._read(context), context.get_time() / self.period
        if np.isinf(before.usable.now) or abs(ticks - round(ticks)) < _SAME:
            return EventStatus.DidNothing()
        x = np.array(self._estimate.Eval(context))
        planned = before.choice.motion.calc_state(context.get_time() - self.start_time)
        question = self._ask(context, self._unwrap(x, planned), before, before.seen)
        moment = self._command(before, question)
        state.get_mutable_abstract_state(int(self._moment)).set_value(moment)
        return EventStatus.Succeeded()

    def _keep(
        self,
        state: State,
        before: TickMemory,
        choice: TickChoice,
        question: TickQuestion,
        begin: float,
        usable: TickQuestion,
    ) -> EventStatus:
        """Remembers what a tick decided, and what it says of that."""
        motion, tick, feedback = choice.motion, before.tick + 1, choice.law
        has_law = self.feedback_period is not None or question.horizon.is_over(question.now)
        if feedback is None and has_law and not np.isinf(usable.now):
            is_kept = motion is before.choice.motion and before.feedback is not None
            feedback = before.feedback if is_kept else question.horizon.make_feedback(motion)
        status = TickStatus(
            time=question.sampled[0],
            cost=motion.cost,
            touches=tuple(touch.contact for touch in motion.touches),
            reason=choice.reason,
            seconds=0.0,
            has_switched=choice.has_switched,
            restitution=question.horizon.restitution,
            nearer=question.seen.nearer,
            estimated=tuple(before.known.values.tolist()) if before.known else (),
            iterations=before.iterations or self._iterations or 0,
        )
        moment = dataclasses.replace(
            before, choice=choice, status=status, tick=tick, usable=usable, seen=question.seen,
            feedback=feedback,
        )  # fmt: skip
        moment = self._command(moment, question)
        seconds, pending = time.perf_counter() - begin, choice.pending
        is_late = seconds > self.period or (pending is not None and tick >= pending.due)
        status = dataclasses.replace(moment.status, seconds=seconds, is_late=is_late)
        moment = dataclasses.replace(moment, status=status)
        state.get_mutable_abstract_state(int(self._moment)).set_value(moment)
        return EventStatus.Succeeded()

    def _command(self, moment: TickMemory, question: TickQuestion) -> TickMemory:
        """Returns a moment with the command for a sample, and what its report says of that."""
        motion, (time, x), now = moment.choice.motion, question.sampled, question.now
        mode: Mode = "running"
        u = motion.calc_held(now, now + (self.feedback_period or self.period))
        planned = motion.calc_state(now)
        if np.isinf(moment.usable.now):
            mode = "waiting"
        elif question.sample != "valid":
            u, mode = self._fall_back(x, planned, u, moment.commands), "fallback"
        else:
            is_over, feedback = question.horizon.is_over(now), moment.feedback
            mode = "holding" if is_over else "running"
            if feedback and (not is_over or feedback.regulator):
                at = max(now, feedback.end) if is_over and not moment.choice.law else now
                hits = moment.find_hits(question, self.period)
                u = feedback.sample(at, question.x, hits).control
        u, is_limited = self._limit(u, moment.commands, time)
        judged: dict[str, Any] = {"sample": question.sample, "deviation": question.deviation}
        status = dataclasses.replace(moment.status, mode=mode, is_limited=is_limited, **judged)
        commands = append_command(moment.commands, time, u)
        return dataclasses.replace(moment, commands=commands, status=status)
