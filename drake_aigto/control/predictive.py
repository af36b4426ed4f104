"""Planning again while the robot moves, as a LeafSystem."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, EventStatus, LeafSystem, State
from pydrake.trajectories import PiecewisePolynomial

from drake_aigto.arrays import Floats
from drake_aigto.control.horizon import Horizon, Motion
from drake_aigto.control.ports import check_period, read_start
from drake_aigto.errors import ControlError
from drake_aigto.planning import Planner

# A plan that costs by so much more than the one before, in parts of that one, met a surprise; and
# not if that is less than this part of the task's scale.
_SURPRISE, _NOTHING = 0.5, 1e-3


@dataclass(frozen=True)
class TickStatus:
    """What happened at a tick.

    Attributes:
        time: of the tick [s].
        cost: J of the plan from there on.
        touches: the contacts that the plan is in at its knots, in order, each as often as it comes
            into it.
        reason: why the plan is what it is.
        seconds: of wall time that the tick took.
        has_switched: whether another contact sequence was taken.
    """

    time: float
    cost: float
    touches: tuple[int, ...]
    reason: str
    seconds: float
    has_switched: bool = False


@dataclass(frozen=True, eq=False)
class _Moment:
    """What a tick leaves to the next."""

    motion: Motion
    control: Floats
    reason: str
    time: float
    seconds: float
    tick: int
    has_switched: bool = False


class ModelPredictiveController(LeafSystem):
    """Plans from the state that it is told, every period, and holds the plan's control between.

        controller = builder.AddSystem(ModelPredictiveController(Planner(scenario), period=0.01))
        builder.Connect(plant.get_state_output_port(), controller.get_input_port(0))
        builder.Connect(controller.get_output_port(0), plant.get_actuation_input_port())

    Each tick is *warm*: the last plan, shifted, is led to the best one near it from the new state
    by a few iterations of the descent. Every `search_every` ticks, and where a plan costs half as
    much again as the one before, boxes and renewals *search* for another contact sequence as well;
    it is taken if it costs less by a margin. Work is bounded by counts: runs are the same again.

    A state that is not finite, or from which no motion is found, leaves the last plan as it is, and
    its control goes on. So it does at the end of a horizon that shrinks. No NaN leaves a port.

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
    ) -> None:
        """Takes the planner's task; its start does not count.

        Args:
            planner: of a mechanism between walls that yield, or that touches nothing.
            period: between ticks [s].
            horizon: whether it always lasts as long as the scenario's duration, or ends with it.
            iterations: of the descent in a tick, at most.
            search_every: ticks from one search to the next; None: only at the start, and where
                costs rise. What a search takes is in the planner's options.
            margin: what another sequence has to be better by, as a share of the cost.

        Raises:
            ControlError: rigid walls; or an argument is out of its range.
        """
        super().__init__()
        for name, value in (("iterations", iterations), ("search_every", search_every)):
            if value is not None and not (isinstance(value, int) and value >= 1):
                raise ControlError(name, got=value, expected="a count of at least 1")
        if horizon not in ("receding", "shrinking"):
            raise ControlError("horizon", got=horizon, expected="'receding' or 'shrinking'")
        if not 0 <= margin < np.inf:
            raise ControlError("margin", got=margin, expected="a number of at least 0")
        self.period = check_period(period)
        self._world, self._every, self._margin = planner.world, search_every, margin
        self._horizon = Horizon(planner, horizon == "receding", iterations)
        n, nu = self._world.num_positions, self._world.num_actuators
        none = _Moment(self._horizon.rest(0.0, np.zeros(2 * n)), np.zeros(nu), "", 0.0, 0.0, 0)
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
            lambda: AbstractValue.Make(TickStatus(0.0, np.inf, (), "", 0.0)),
            self._write_status,
            held,
        )

    def _read(self, context: Context) -> _Moment:
        moment: _Moment = context.get_abstract_state(int(self._moment)).get_value()
        return moment

    def _start(self, context: Context, state: State) -> EventStatus:
        """Searches for the first plan."""
        x = read_start(self, self._estimate, context)
        now, begin = context.get_time(), time.perf_counter()
        found = self._horizon.search(now, x)
        motion = found or self._horizon.improve(self._horizon.rest(now, x))
        reason = "the first search" if found else "a search found nothing; a descent from rest"
        return self._keep(state, motion, reason, now, begin, 0)

    def _tick(self, context: Context, state: State) -> EventStatus:
        """Improves the plan, or takes another one."""
        x, now, begin = self._estimate.Eval(context), context.get_time(), time.perf_counter()
        before = self._read(context)
        motion, reason, has_switched = self._choose(before, now, x)
        return self._keep(state, motion, reason, now, begin, before.tick + 1, has_switched)

    def _choose(self, before: _Moment, now: float, x: Floats) -> tuple[Motion, str, bool]:
        """Returns the plan from now on, why it is that, and whether it is another sequence's."""
        last = before.motion
        if not np.all(np.isfinite(x)):
            return last, "the estimated state is not finite: the last plan goes on", False
        rest = self._horizon.shift(last, now, x)
        if rest is None:
            return last, "the horizon ends: the last plan goes on", False
        motion, reason, has_switched = self._horizon.improve(rest), "warm", False
        is_due = self._every is not None and (before.tick + 1) % self._every == 0
        surprise = motion.cost - last.cost
        if is_due or not surprise <= _SURPRISE * last.cost + _NOTHING * self._horizon.cost_scale:
            found = self._horizon.search(now, x)
            if found is not None and found.cost < (1 - self._margin) * motion.cost:
                reason = f"switched: {found.cost:.4g} in place of {motion.cost:.4g}"
                motion, has_switched = found, True
            else:
                reason = "warm; a search found nothing better"
        if not np.isfinite(motion.cost):
            return last, "no motion was found: the last plan goes on", False
        return motion, reason, has_switched

    def _keep(
        self,
        state: State,
        motion: Motion,
        reason: str,
        now: float,
        begin: float,
        tick: int,
        has_switched: bool = False,
    ) -> EventStatus:
        seconds = time.perf_counter() - begin
        control = motion.calc_control(now)
        moment = _Moment(motion, control, reason, now, seconds, tick, has_switched)
        state.get_mutable_abstract_state(int(self._moment)).set_value(moment)
        return EventStatus.Succeeded()

    def _write_control(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._read(context).control)

    def _write_path(self, context: Context, output: AbstractValue) -> None:
        motion = self._read(context).motion
        output.set_value(PiecewisePolynomial.FirstOrderHold(motion.times, motion.states.T))

    def _write_status(self, context: Context, output: AbstractValue) -> None:
        moment = self._read(context)
        q = moment.motion.states[:, : self._world.num_positions]
        inside = self._world.calc_signed_distance(q) <= 0
        comes = inside & ~np.vstack([np.zeros_like(inside[:1]), inside[:-1]])
        touches = tuple(int(i) for _, i in np.argwhere(comes))
        cost = moment.motion.cost
        output.set_value(
            TickStatus(
                moment.time,
                cost,
                touches,
                moment.reason,
                moment.seconds,
                moment.reason.startswith("switched"),
            )
        )
