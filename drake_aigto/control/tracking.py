"""A plan tracked in a Diagram: feedback as a LeafSystem, which feels or infers bounces."""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.plant import ContactResults
from pydrake.systems.framework import Context, DiscreteStateIndex, DiscreteValues, EventStatus
from pydrake.trajectories import PiecewisePolynomial

from drake_aigto.arrays import Bools, Floats
from drake_aigto.control.catch import Catch, keep_within
from drake_aigto.control.family import Unknown
from drake_aigto.control.learning import LearnedModel
from drake_aigto.control.ports import (
    MODES,
    OFTEN,
    SAMPLES,
    LoopController,
    Mode,
    Safety,
    Sample,
    TickStatus,
    may_be_unsampled,
)
from drake_aigto.control.ticks import append_command
from drake_aigto.control.touches import (
    WALL_DOUBT,
    find_bodies,
    infer_touched,
    list_hits,
    read_touched,
)
from drake_aigto.planning import Cut, Feedback, Plan, is_at_rest_on
from drake_aigto.world import Scales, World

# A period of what happens once [s]; and how near to a sample is the same, as a part of the period.
_ONCE, _SAME = 1e12, 1e-6
# Of a contact: it is touched, or was and is not over yet; it has lasted since the start; none.
_TOUCHED, _LASTS, _APART = 1.0, -1.0, 0.0
_REASONS: dict[Mode, str] = {
    "waiting": "waits for the first sample of the state, or for its start",
    "running": "follows the plan",
    "holding": "the plan is over",
    "fallback": "the sample is of no use",
}


class _Groups(NamedTuple):
    """Which group of the discrete state holds what."""

    commands: DiscreteStateIndex  # rows (t, u), shape (k (1 + nu),)
    bounces: DiscreteStateIndex  # how many of each contact, shape (m,)
    touches: DiscreteStateIndex  # _TOUCHED, _LASTS or _APART, shape (m,)
    last: DiscreteStateIndex  # the time of the last valid sample, q and v, shape (1 + nq + n,)
    caught: DiscreteStateIndex  # the motion to rest that is asked for (`Catch`), (2 + nq + n,)
    before: DiscreteStateIndex  # the bounces before that begins, shape (m,)
    learned: DiscreteStateIndex  # of the model (`LearnedModel`)
    told: DiscreteStateIndex  # time, mode, sample, deviation, is_limited, seconds, shape (6,)


class TrackingController(LoopController):
    """Keeps a plant on a plan: samples its state every period, and at the plan's knots.

        controller = builder.AddSystem(TrackingController(plan))
        builder.Connect(plant.get_state_output_port(), controller.get_input_port(0))
        builder.Connect(controller.get_output_port(0), plant.get_actuation_input_port())

    Between rigid walls a plan has phases, each with its own gains, and the next one begins when a
    wall is hit, or a slip stops. While contacts last, gains are those of what can move then. Plans
    of mechanisms between compliant walls, or that touch nothing, have one phase (`Feedback`).

    A bounce is over when a ball leaves a wall that it has touched, with J_i v > 0. Touches are
    *felt*, at every step of the simulation, where the plant's contact results are connected; the
    control is sampled as soon as they are over. Else they are *inferred* from samples: φ_i ≤ 0, or
    it would have come to that since the last one, as the control drives it; or φ̇_i has turned
    round as only an impact turns it, wherever the wall stands (`find_bounce`). The first sample in
    a touched wall changes nothing where there are phases, for none says how fast a ball is there. A
    contact that lasts at the start has not bounced when it opens.

    Where a sample is of no use (`Safety`) the fallback is commanded, by default the plan's own
    control: no NaN leaves a port. The plan's goes on, too, while all of the state is zero, where
    the plan's is not: a sampled estimate that has no sample yet. Before `start_time` nothing is
    commanded; after its end its goal is held, where a `Regulator` does (`Catch`), or else the last
    state (`Feedback`). A Simulator that is initialized again on its way, at most a period after the
    last sample, samples anew, and remembers bounces. What of a mechanism's plan exceeds the limits
    of `Safety` is led to the best within them at first.

    Ports are those of `LoopController`, and an input port `contact_results`, which may stay
    unconnected. The desired state is that of the flight that the ball is on.

    Attributes:
        plan: what is tracked.
        feedback: the law.
    """

    def __init__(
        self,
        plan: Plan,
        world: World | None = None,
        period: float | None = None,
        delay: float = 0.0,
        start_time: float = 0.0,
        safety: Safety | None = None,
        estimate: Sequence[Unknown] = (),
    ) -> None:
        """Computes the gains.

        Args:
            plan: what to track.
            world: see `Plan.find_world`.
            period: between samples [s]; None: a fifth of the scenario's time step.
            delay: see `LoopController`, as for the other arguments.
            start_time: the context's time at which the plan begins [s].
            safety: limits, and the fallback.
            estimate: what of the model is not known (`ModelEstimate.of`): laws between compliant
                walls are judged by the model with what is learned of it.

        Raises:
            ModelError: from `Plan.find_world`.
            TrajectoryError: no feedback is known for its contacts (`Feedback`).
            ControlError: an argument is out of its range.
        """
        world = plan.find_world(world)
        period = plan.scenario.time_step / OFTEN if period is None else period
        interval = max(period, plan.scenario.time_step) if estimate else 0.0
        super().__init__(world, plan.scenario, period, delay, start_time, safety, None, interval)
        self.plan = plan
        self._motion = keep_within(plan, world, self._scenario, self.period)
        of = self._scenario, self._motion.trajectory
        self.feedback = Feedback(world, *of, period=self.period)
        self._learned = LearnedModel(world, of[0], self.feedback, estimate, interval)
        self.estimated = self._learned.names
        self._bodies = find_bodies(world)
        self._results = self.DeclareAbstractInputPort("contact_results", Value(ContactResults()))
        self._doubt = WALL_DOUBT * Scales.of(world, plan.scenario).length
        hits = [each for each in self.feedback.stretches if each.cut == Cut.HIT]
        # The slowest impact of each contact that is planned.
        self._speeds = {each.contact: each.speed for each in sorted(hits, key=lambda s: -s.speed)}
        self._never = np.append(-np.inf, np.zeros(len(self._units)))
        self._catch = Catch(world, self._scenario, self.period)
        none = np.zeros((2, world.num_contacts))
        rest = self._never, self._catch.nothing, none[0], self._learned.nothing
        self._empty = self._no_commands.ravel(), *none, *rest
        self._groups = _Groups(*map(self.DeclareDiscreteState, (*self._empty, np.zeros(6))))
        self.DeclareInitializationDiscreteUpdateEvent(self._start)
        self.DeclarePeriodicDiscreteUpdateEvent(self.period, 0.0, self._sample)
        for knot in _find_between(self.start_time + plan.trajectory.times, self.period):
            self.DeclarePeriodicDiscreteUpdateEvent(_ONCE, knot, self._sample)
        self.DeclarePerStepDiscreteUpdateEvent(self._step)
        self._declare_outputs({self.discrete_state_ticket(group) for group in self._groups})

    def count_bounces(self, context: Context) -> tuple[int, ...]:
        """Returns how many times each contact has bounced in its own context, shape (m,)."""
        return tuple(int(count) for count in self._read(context, self._groups.bounces))

    def read_status(self, context: Context) -> TickStatus:
        """Returns the report of the last sample, in its own context."""
        time, mode, sample, off, is_limited, seconds = self._read(context, self._groups.told)
        left = [each.contact for each in self.feedback.stretches if each.cut == Cut.HIT]
        for contact in self._find_bounces(context):
            if contact in left:
                left.remove(contact)
        return TickStatus(
            time=float(time),
            cost=self.plan.cost,
            touches=tuple(left),
            reason=_REASONS[MODES[int(mode)]],
            seconds=float(seconds),
            restitution=self._scenario.restitution if self.feedback.stretches else None,
            mode=MODES[int(mode)],
            sample=SAMPLES[int(sample)],
            deviation=float(off),
            is_limited=bool(is_limited),
            is_late=bool(seconds > self.period),
            estimated=self._learned.read(self._read(context, self._groups.learned)),
        )

    def update(self, context: Context) -> None:
        """Takes a sample of the context's state now, as a Simulator would have it do."""
        self._sample(context, context.get_mutable_discrete_state())

    def _read(self, context: Context, group: DiscreteStateIndex) -> Floats:
        return np.array(context.get_discrete_state(group).value())

    def _read_commands(self, context: Context) -> Floats:
        return self._read(context, self._groups.commands).reshape(self._no_commands.shape)

    def _find_time(self, context: Context) -> float:
        """Returns the plan's time [s]."""
        return float(context.get_time()) - self.start_time

    def _find_bounces(self, context: Context) -> list[int]:
        return list_hits(self._read(context, self._groups.bounces))

    def _find_desired(self, context: Context) -> Floats:
        time = self._find_time(context) + self.delay
        return self.feedback.find_state(time, self._find_bounces(context))

    def _find_path(self, context: Context) -> PiecewisePolynomial:
        return self._motion.trajectory.later(self.start_time).to_piecewise()[0]

    def _start(self, context: Context, values: DiscreteValues) -> EventStatus:
        """Forgets what was, and takes the first sample; on the way, the next one."""
        x = self._read_start(context)
        if self._results.HasValue(context):
            self.check_plant(self._results.Eval(context).plant())
        last, *before = self._read(context, self._groups.last)
        elapsed = context.get_time() - last
        if 0 < elapsed <= (1 + _SAME) * self.period or (elapsed == 0 and np.array_equal(x, before)):
            return self._sample(context, values)
        for group, known in zip(self._groups, self._empty, strict=False):
            values.set_value(group, known)
        if self._is_empty(context, x):
            return self._play(context, values, x, self._no_commands, "none", np.inf)
        return self._begin(context, values, x, self._no_commands)

    def _begin(
        self, context: Context, values: DiscreteValues, x: Floats, commands: Floats
    ) -> EventStatus:
        """Takes the first sample: what is at rest on a wall has not bounced."""
        none, (q, v) = np.zeros(self._world.num_contacts), self._world.split(x)
        lasts = is_at_rest_on(self._world, q, v)
        return self._hold(context, values, x, none, np.where(lasts, _LASTS, _APART), commands)

    def _sample(self, context: Context, values: DiscreteValues) -> EventStatus:
        """Takes a sample: touches, bounces that are over, and the control from now on."""
        x, commands = self._estimate.Eval(context), self._read_commands(context)
        sample, off, x = self._check(context, x)
        if sample != "valid":
            return self._play(context, values, x, commands, sample, off)
        if np.isinf(self._read(context, self._groups.last)[0]):
            return self._begin(context, values, x, commands)
        reached = pressed = self._feel(context, x)
        if not self._results.HasValue(context):
            reached = pressed | self._infer(context, x)
        return self._go_on(context, values, x, reached, pressed)

    def _check(self, context: Context, x: Floats) -> tuple[Sample, float, Floats]:
        """Returns whether an estimate is of use, how far off, and with angles near the plan's."""
        if np.isinf(self._read(context, self._groups.last)[0]) and self._is_empty(context, x):
            return "none", np.inf, x
        planned = self.feedback.find_state(self._find_time(context), self._find_bounces(context))
        x = self._unwrap(x, planned)
        return *self._judge(x, planned, self._motion.reach), x

    def _is_empty(self, context: Context, x: Floats) -> bool:
        """Returns whether a state may be what a hold has before its first sample."""
        return may_be_unsampled(x, self.feedback.find_state(self._find_time(context), ()))

    def _play(
        self,
        context: Context,
        values: DiscreteValues,
        x: Floats,
        commands: Floats,
        sample: Sample,
        off: float,
    ) -> EventStatus:
        """Commands what the fallback says, or the plan's own control before the first sample."""
        begin, time = clock.perf_counter(), self._find_time(context) + self.delay
        planned = self._find_desired(context)
        u = self._motion.calc_control(time)  # By the clock: bounces may be missed meanwhile.
        if time >= self.feedback.end:
            u = self.feedback.sample(time, planned, self._find_bounces(context)).control
        mode: Mode = "waiting"
        if sample != "none":
            u, mode = self._fall_back(x, planned, u, commands), "fallback"
        return self._command(context, values, u, commands, mode, sample, off, begin)

    def _command(
        self,
        context: Context,
        values: DiscreteValues,
        u: Floats,
        commands: Floats,
        mode: Mode,
        sample: Sample,
        off: float,
        begin: float,
    ) -> EventStatus:
        """Commands a control within limits, none before the start, and notes the report of that."""
        if self._find_time(context) + self.delay < 0:
            u, mode = np.zeros_like(u), "waiting"
        elif mode == "running" and self._find_time(context) >= self.feedback.end:
            mode = "holding"
        time = context.get_time()
        u, is_limited = self._limit(u, commands, time)
        values.set_value(self._groups.commands, append_command(commands, time, u).ravel())
        seconds = clock.perf_counter() - begin
        told = time, MODES.index(mode), SAMPLES.index(sample), off, is_limited, seconds
        values.set_value(self._groups.told, np.array(told, dtype=float))
        return EventStatus.Succeeded()

    def _feel(self, context: Context, x: Floats) -> Bools:
        """Returns which contacts are touched now: as the plant reports, or else φ_i ≤ 0."""
        phi = self._world.calc_signed_distance(self._world.split(x)[0])
        if not self._results.HasValue(context):
            return np.asarray(phi <= 0)
        return read_touched(self._results.Eval(context), self._bodies, phi)

    def _infer(self, context: Context, x: Floats) -> Bools:
        """Returns which contacts were touched between the last sample and this one."""
        time, *before = self._read(context, self._groups.last)
        u = self._find_acting(self._read_commands(context), time)
        seen = (np.array(before), x), context.get_time() - time, u
        return infer_touched(self._world, *seen, self._speeds, self._doubt)

    def _step(self, context: Context, values: DiscreteValues) -> EventStatus:
        """Notes touches that the plant reports, and samples at once where one is over."""
        is_first = bool(np.isinf(self._read(context, self._groups.last)[0]))
        if not (is_first or self._results.HasValue(context)):
            return EventStatus.DidNothing()
        sample, _, x = self._check(context, self._estimate.Eval(context))
        if sample != "valid":
            return EventStatus.DidNothing()
        if is_first:
            return self._begin(context, values, x, self._read_commands(context))
        touches, felt = self._read(context, self._groups.touches), self._feel(context, x)
        if np.array_equal(touches != _APART, felt):
            return EventStatus.DidNothing()
        return self._go_on(context, values, x, felt, felt)

    def _go_on(
        self, context: Context, values: DiscreteValues, x: Floats, reached: Bools, pressed: Bools
    ) -> EventStatus:
        """Counts what has left its wall, and holds another control unless a touch is new."""
        groups, before = self._groups, self._read(context, self._groups.touches)
        touches = np.where((before == _APART) & reached, _TOUCHED, before)
        is_leaving = self._world.calc_contact_rate(*self._world.split(x)) > 0
        over = (touches != _APART) & ~pressed & is_leaving
        bounces = self._read(context, groups.bounces) + (over & (touches == _TOUCHED))
        left = np.where(over, _APART, touches)
        is_new = np.any((left == _TOUCHED) & (before == _APART))
        if not (is_new and self.feedback.stretches):
            return self._hold(context, values, x, bounces, left, self._read_commands(context))
        values.set_value(groups.bounces, bounces)
        values.set_value(groups.touches, left)
        return EventStatus.Succeeded()

    def _hold(
        self,
        context: Context,
        values: DiscreteValues,
        x: Floats,
        bounces: Floats,
        touches: Floats,
        commands: Floats,
    ) -> EventStatus:
        """Answers a state from now on."""
        begin, now = clock.perf_counter(), context.get_time()
        time, seen = self._find_time(context), list_hits(bounces)
        sample, off = self._judge(x, self.feedback.find_state(time, seen), self._motion.reach)
        led = self._lead_on(now, x, commands)
        if led is None:
            return self._play(context, values, x, commands, "far off", off)
        later, more = led
        ahead = bounces + np.bincount(more, minlength=len(bounces))
        learned = self._learn(context, x, commands)
        u, *caught = self._answer(context, time + self.delay, later, ahead, learned)
        known = bounces, touches, np.append(now, x), *caught, learned
        for group, value in zip(self._groups[1:7], known, strict=True):
            values.set_value(group, value)
        return self._command(context, values, u, commands, "running", sample, off, begin)

    def _learn(self, context: Context, x: Floats, commands: Floats) -> Floats:
        """Returns what is known of the model after a sample, until the plan ends."""
        known, held = self._read(context, self._groups.learned), partial(self._find_held, commands)
        if self._find_time(context) >= self.feedback.end:
            return known
        return self._learned.watch(known, context.get_time(), x, held)

    def _answer(
        self, context: Context, time: float, x: Floats, bounces: Floats, learned: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Returns the control of the plan, or of a motion to rest, which, and bounces before."""
        groups, catch, plan = self._groups, self._catch, self.feedback
        asked, before = self._read(context, groups.caught), self._read(context, groups.before)
        if catch.task and time >= plan.end:
            asked, law, _, is_new = catch.follow(asked, time, x)
            before = bounces if is_new else before
            u = law.sample(time, x, list_hits(bounces - before)).control
        else:
            law = self._learned.judge(learned, plan)
            u = law.sample(time, x, list_hits(bounces)).control
            asked = catch.begin(asked, time, plan.end, x, u)
        return u, asked, before


def _find_between(knots: Floats, period: float) -> list[float]:
    """Returns the knots that are no samples already, but for the last [s]."""
    off = np.abs(knots - period * np.round(knots / period))[:-1]
    return [float(knot) for knot in knots[:-1][off > _SAME * period]]
