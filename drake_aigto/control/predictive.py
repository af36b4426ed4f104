"""Planning again while the robot moves, as a LeafSystem."""

from __future__ import annotations

import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, EventStatus, LeafSystem, State
from pydrake.trajectories import PiecewisePolynomial

from drake_aigto.arrays import Floats
from drake_aigto.control.horizon import Horizon
from drake_aigto.control.mechanism_horizon import make_horizon
from drake_aigto.control.touches import PlannedMotion, SeenBounces
from drake_aigto.control.tracking import NUMBERS, check_period, may_be_unsampled, read_start
from drake_aigto.errors import ControlError
from drake_aigto.planning import Plan, Planner
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import take_nearest_turn

# A plan that costs more than the one before met no surprise if that is less than this part of the
# task's scale.
_NOTHING = 1e-3


@dataclass(frozen=True)
class TickStatus:
    """Report of a tick.

    Attributes:
        time: of the tick [s].
        cost: J of the plan from there on.
        touches: the contacts that the plan comes into, in order, each as often as it does.
        reason: why the plan is what it is.
        seconds: of wall time that the tick took.
        has_switched: whether another contact sequence was taken.
        restitution: e of rigid walls, as the scenario has it or as bounces have shown it; None
            where they are compliant.
        nearer: by how much nearer the wall of each contact was found to stand than the model has
            it, shape (m,) [m]; empty: nothing was found.
    """

    time: float
    cost: float
    touches: tuple[int, ...]
    reason: str
    seconds: float
    has_switched: bool = False
    restitution: float | None = None
    nearer: tuple[float, ...] = ()


class _Pending(NamedTuple):
    """A search that goes on in its thread."""

    due: int  # the tick that waits for it
    found: Future[PlannedMotion | None]


class _Choice(NamedTuple):
    """Decision of a tick."""

    motion: PlannedMotion
    reason: str
    has_switched: bool = False
    pending: _Pending | None = None


class _Question(NamedTuple):
    """The state that a tick plans from."""

    now: float
    x: Floats
    seen: SeenBounces
    horizon: Horizon  # that knows what was seen

    def find_obstacle(self) -> str | None:
        """Returns why nothing can be planned from here; None: something can."""
        if not np.all(np.isfinite(self.x)):
            return "the estimated state is not finite"
        if self.horizon.is_over(self.now):
            return "the horizon ends"
        return "a wall is touched" if self.horizon.is_inside(self.x) else None


@dataclass(frozen=True, eq=False)
class _Moment:
    """Memory from one tick to the next; contexts share it, as it never changes.

    Attributes:
        choice: what the tick decided.
        control: that is held since.
        status: what the output port says.
        tick: how many there were before.
        usable: the last question from which something could be planned.
        seen: what is known of walls.
    """

    choice: _Choice
    control: Floats
    status: TickStatus
    tick: int
    usable: _Question
    seen: SeenBounces

    def __deepcopy__(self, memo: object) -> _Moment:
        """Returns itself."""
        return self


class ModelPredictiveController(LeafSystem):
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
    controls lead to, in steps that resolve friction; sustained contact may take 15 iterations a
    tick.

    Of what differs from a model, rigid walls mislead plans of balls most: where they stand, and
    what they return. Both are learned from bounces that are seen between one tick and the next; and
    a wall that a ball is well inside of stands farther away. Mechanisms learn nothing of walls.

    A state that is not finite, one inside of a rigid wall where no contact lasts, or one from
    which no motion is found, leaves the last plan as it is, and its control goes on. So it does at
    the end of a horizon that shrinks. No NaN leaves a port.

    The first plan is from the first sample: where all of the state is zero at the start, and the
    scenario's is not, it is searched for at the first tick, as a sampled estimate may have no
    sample before. Hinges of an estimate that wraps angles are taken a whole number of turns on, to
    where they are nearest to the plan.

    A Simulator that is initialized again
    on its way, at most a period after the last tick, keeps the plan.

    Input port: `estimated_state`, q and v. Output ports: `control`, u as the plant's actuation port
    takes it; `planned_state`, a PiecewisePolynomial of q and v over the horizon; and `status`, a
    `TickStatus`.

    Attributes:
        period: between ticks [s].
    """

    def __init__(
        self,
        planner: Planner,
        period: float,
        horizon: Literal["receding", "shrinking"] = "receding",
        iterations: int = 5,
        search_every: int | None = None,
        margin: float = 0.02,
        surprise: float = 0.5,
        search_ticks: int | None = None,
        learns: bool = True,
    ) -> None:
        """Takes the planner's task; its start does not count.

        Args:
            planner: of balls between rigid walls, or of a mechanism; its task and options are
                compiled once more.
            period: between ticks [s].
            horizon: whether it always lasts as long as the scenario's duration, or ends with it.
            iterations: of the descent in a tick, at most; balls between rigid walls have none, and
                mechanisms there up to five times as many, or a fixed number where these lead to
                nothing.
            search_every: ticks from one search to the next; None: only at the start, and after a
                surprise. What a search takes is in the planner's options.
            margin: what another sequence has to be better by, as a share of the cost.
            surprise: by how much more than the one before a plan may cost, as a share of that,
                before there is a search; infinite: any.
            search_ticks: after how many ticks a search is done that runs in a thread beside warm
                ones: begun at tick k, from where the plan is going to be at tick k + search_ticks,
                it is waited for there, and what it found is led from there to the estimated
                state. None: searches end in their tick.
            learns: whether what rigid walls return, and where they stand, is learned
                (`SeenBounces`); the scenario and the model are what is thought of it before.

        Raises:
            ControlError: a free duration, or something that was added to the planner's
                transcription; or an argument is out of its range.
        """
        super().__init__()
        given: Any = planner
        if not isinstance(given, Planner):
            remedy = "Give it Planner(plan.scenario)." if isinstance(given, Plan) else ""
            got = type(given).__name__
            raise ControlError("planner", got=got, expected="a Planner", remedy=remedy)
        counts = {
            "iterations": iterations,
            "search_every": search_every,
            "search_ticks": search_ticks,
        }
        for name, value in counts.items():
            if value is not None and not (isinstance(value, int | np.integer) and value >= 1):
                raise ControlError(name, got=value, expected="a count of at least 1")
        if horizon not in ("receding", "shrinking"):
            raise ControlError("horizon", got=horizon, expected="'receding' or 'shrinking'")
        for name, share in (("margin", margin), ("surprise", surprise)):
            if not (isinstance(share, NUMBERS) and share >= 0):
                raise ControlError(name, got=share, expected="a number of at least 0")
        self.period = check_period(period)
        self._world, self._every = planner.world, search_every
        self._margin, self._surprise, self._learns = margin, surprise, learns
        self._horizon = make_horizon(planner, horizon == "receding", iterations, self.period)
        self._search_ticks = search_ticks
        if search_ticks is not None:
            # In its thread it shares nothing that changes.
            self._searching = make_horizon(planner, horizon == "receding", iterations, self.period)
            self._thread = ThreadPoolExecutor(1, "search")
        n, nu = self._world.num_positions, self._world.num_actuators
        nowhere = _Question(-np.inf, np.zeros(2 * n), SeenBounces(), self._horizon)
        rest = _Choice(self._horizon.rest(0.0, nowhere.x), "")
        status = TickStatus(-np.inf, np.inf, (), "", 0.0, restitution=self._horizon.restitution)
        none = _Moment(rest, np.zeros(nu), status, 0, nowhere, nowhere.seen)
        self._estimate = self.DeclareVectorInputPort("estimated_state", 2 * n)
        self._moment = self.DeclareAbstractState(AbstractValue.Make(none))
        self.DeclareInitializationUnrestrictedUpdateEvent(self._start)
        self.DeclarePeriodicUnrestrictedUpdateEvent(self.period, self.period, self._tick)
        held = {self.abstract_state_ticket(self._moment)}
        self.DeclareVectorOutputPort("control", nu, self._write_control, held)
        self.DeclareAbstractOutputPort(
            "planned_state",
            lambda: AbstractValue.Make(PiecewisePolynomial()),
            self._write_path,
            held,
        )
        self.DeclareAbstractOutputPort(
            "status",
            lambda: AbstractValue.Make(status),
            self._write_status,
            held,
        )

    def read_plan(self, context: Context) -> Trajectory:
        """Returns the plan in its own context, in the context's time."""
        return self._read(context).choice.motion.trajectory

    def _read(self, context: Context) -> _Moment:
        moment: _Moment = context.get_abstract_state(int(self._moment)).get_value()
        return moment

    def _start(self, context: Context, state: State) -> EventStatus:
        """Searches for the first plan; on the way, the one that there is goes on."""
        x, before = read_start(self, self._estimate, context), self._read(context)
        elapsed = context.get_time() - before.status.time
        is_same = elapsed == 0 and np.array_equal(x, before.usable.x)
        if is_same or 0 < elapsed <= self.period:
            return EventStatus.DidNothing()
        now, begin = context.get_time(), time.perf_counter()
        question = _Question(now, np.array(x), SeenBounces(), self._horizon)
        if self._is_empty(x):
            choice = _Choice(self._horizon.rest(now, x), "waits for the first sample of the state")
            return self._keep(state, choice, question, begin, 0, before.usable)
        return self._keep(state, self._choose_first(question), question, begin, 0, question)

    def _is_empty(self, x: Floats) -> bool:
        """Returns whether a state may be what a hold has before its first sample."""
        asked = self._horizon.scenario
        start = np.concatenate([asked.initial_position, asked.initial_velocity])
        return may_be_unsampled(x, start)

    def _choose_first(self, question: _Question) -> _Choice:
        """Returns the plan of a search.

        Raises:
            ControlError: the state is inside of a wall.
        """
        now, x, _, horizon = question
        if horizon.is_inside(x):
            raise ControlError(
                "the state at the start",
                got=f"{x.tolist()}, on or inside of a wall",
                expected="one outside of all walls, or a mechanism that lies at one",
                remedy="Start a little off the wall, or track a plan: TrackingController.",
            )
        if found := horizon.search(now, x):
            return _Choice(found, "the first search")
        rest = horizon.rest(now, x)
        motion = horizon.advance(rest, now, x) or rest
        return _Choice(motion, "a search found nothing; a descent from rest")

    def _tick(self, context: Context, state: State) -> EventStatus:
        """Improves the plan, or takes another one."""
        x, now, begin = self._estimate.Eval(context), context.get_time(), time.perf_counter()
        before = self._read(context)
        if np.isinf(before.usable.now) and np.all(np.isfinite(x)):
            first = _Question(now, np.array(x), SeenBounces(), self._horizon)
            return self._keep(state, self._choose_first(first), first, begin, 0, first)
        x = self._unwrap(x, before.choice.motion.calc_state(now))
        seen, last = before.seen, before.usable
        if self._learns and np.all(np.isfinite(x)):
            seen = self._horizon.watch(seen, (last.x, x), now - last.now, before.control)
        question = _Question(now, np.array(x), seen, self._horizon.knowing(seen))
        obstacle = question.find_obstacle()
        choice = self._choose(before, question, obstacle)
        usable = last if obstacle else question
        return self._keep(state, choice, question, begin, before.tick + 1, usable)

    def _unwrap(self, x: Floats, planned: Floats) -> Floats:
        """Returns a state with hinges as many turns on as bring them nearest to the plan."""
        (q, v), (about, _) = np.split(x, 2), np.split(planned, 2)
        turns = q - about - take_nearest_turn(q - about, self._world.is_hinge)
        return np.concatenate([q - turns, v])

    def _keep(
        self,
        state: State,
        choice: _Choice,
        question: _Question,
        begin: float,
        tick: int,
        usable: _Question,
    ) -> EventStatus:
        """Remembers what a tick decided, and what it says of that."""
        motion, control = choice.motion, choice.motion.calc_control(question.now)
        status = TickStatus(
            time=question.now,
            cost=motion.cost,
            touches=tuple(touch.contact for touch in motion.touches),
            reason=choice.reason,
            seconds=time.perf_counter() - begin,
            has_switched=choice.has_switched,
            restitution=question.horizon.restitution,
            nearer=question.seen.nearer,
        )
        moment = _Moment(choice, control, status, tick, usable, question.seen)
        state.get_mutable_abstract_state(int(self._moment)).set_value(moment)
        return EventStatus.Succeeded()

    def _choose(self, before: _Moment, question: _Question, obstacle: str | None) -> _Choice:
        """Returns the plan from now on, and why it is that."""
        last, pending = before.choice.motion, before.choice.pending
        now, x, _, horizon = question
        if obstacle:
            return _Choice(last, f"{obstacle}: the last plan goes on", pending=pending)
        motion = horizon.advance(last, now, x)
        cost = motion.cost if motion else np.inf
        has_searched, found, pending = self._find_other(before, question, motion)
        if found and found.cost < (1 - self._margin) * cost:
            reason = f"switched: {found.cost:.4g} in place of {cost:.4g}"
            return _Choice(found, reason, has_switched=True, pending=pending)
        if motion is None:
            return _Choice(last, "no motion was found: the last plan goes on", pending=pending)
        reason = "warm; a search found nothing better" if has_searched else "warm"
        return _Choice(motion, reason, pending=pending)

    def _find_other(
        self, before: _Moment, question: _Question, motion: PlannedMotion | None
    ) -> tuple[bool, PlannedMotion | None, _Pending | None]:
        """Returns whether a search is done, what it found, and one that goes on."""
        last, pending, tick = before.choice.motion.cost, before.choice.pending, before.tick + 1
        now, x, seen, horizon = question
        if pending is not None:
            if tick < pending.due:
                return False, None, pending
            found = pending.found.result()
            return True, found and horizon.advance(found, now, x), None
        is_due = self._every is not None and tick % self._every == 0
        cost = motion.cost if motion else np.inf
        if not is_due and cost - last <= self._calc_surprise(last):
            return False, None, None
        if self._search_ticks is None:
            return True, horizon.search(now, x), None
        ahead = now + self._search_ticks * self.period
        x = motion.calc_state(ahead) if motion else np.array(x)
        if horizon.is_over(ahead) or horizon.is_inside(x):
            return False, None, None
        begun = self._thread.submit(self._searching.knowing(seen).search, ahead, x)
        return False, None, _Pending(tick + self._search_ticks, begun)

    def _calc_surprise(self, cost: float) -> float:
        """Returns by how much a plan costs more than the one before, if it met a surprise."""
        if np.isinf(self._surprise):  # What costs nothing any more, too.
            return np.inf
        return self._surprise * cost + _NOTHING * self._horizon.cost_scale

    def _write_control(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._read(context).control)

    def _write_path(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self.read_plan(context).to_piecewise()[0])

    def _write_status(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._read(context).status)
