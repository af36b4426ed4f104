"""A plan tracked in a Diagram: feedback as a LeafSystem, which feels or infers bounces."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.plant import ContactResults
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiscreteStateIndex,
    DiscreteValues,
    EventStatus,
    InputPort,
    LeafSystem,
    System,
)

from drake_aigto.arrays import Bools, Floats
from drake_aigto.control.touches import WALL_DOUBT, find_bounce
from drake_aigto.errors import ControlError
from drake_aigto.planning import Cut, Feedback, Plan, is_at_rest_on
from drake_aigto.world import Scales, SpaceWorld, World

# A period of what happens once [s]; and how near to a sample is the same, as a part of the period.
_ONCE, _SAME = 1e12, 1e-6
# Types of real numbers: NumPy's scalars may be given, too.
NUMBERS = int | float | np.integer | np.floating
# Samples in a time step of the scenario: gains are of its holds, and are no worse in shorter ones.
_SAMPLES = 5
# What turns round more slowly than this part of the slowest impact that is planned is noise.
_FAINT = 0.2
# Of a contact: it is touched, or was and is not over yet; it has lasted since the start; none.
_TOUCHED, _LASTS, _APART = 1.0, -1.0, 0.0


class _Groups(NamedTuple):
    """Which group of the discrete state holds what."""

    control: DiscreteStateIndex  # u, shape (nu,)
    bounces: DiscreteStateIndex  # how many of each contact, shape (m,)
    touches: DiscreteStateIndex  # _TOUCHED, _LASTS or _APART, shape (m,)
    last: DiscreteStateIndex  # the time of the last sample, q and v, shape (1 + 2n,)


class TrackingController(LeafSystem):
    """Keeps a plant on a plan: samples its state every period, and holds the control between.

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
    a touched wall changes nothing, for no plan says how fast a ball is there. A contact that
    lasts at the start has not bounced when it opens.

    Samples are taken at the plan's own knots as well, where its control changes.

    Where a state is not finite the plan's own control goes on: no NaN leaves a port. So it does
    while all of the state is zero, where the plan's is not: a sampled estimate that has no sample
    yet. After its end a plan is held (`Feedback`). A Simulator that is initialized again on its
    way, at most a period after the last sample, samples anew, and remembers bounces.

    Input ports: `estimated_state`, q and v; `contact_results`, which may stay unconnected. Output
    ports: `control`, u as the plant's actuation port takes it, and `desired_state`, q and v of the
    plan, on the flight that the ball is on.

    Attributes:
        plan: what is tracked.
        feedback: the law.
        period: between samples [s].
    """

    def __init__(self, plan: Plan, world: World | None = None, period: float | None = None) -> None:
        """Computes the gains.

        Args:
            plan: what to track; its time 0 is the context's.
            world: see `Plan.find_world`.
            period: between samples [s]; None: a fifth of the scenario's time step.

        Raises:
            ModelError: from `Plan.find_world`.
            TrajectoryError: no feedback is known for its contacts (`Feedback`).
            ControlError: the period is not a number above zero, or the plan is in space.
        """
        super().__init__()
        world = plan.find_world(world)
        check_plane(world)
        self.plan = plan
        usual = plan.scenario.time_step / _SAMPLES
        self.period = usual if period is None else check_period(period)
        known, of = plan.best.gains, (world, plan.scenario, plan.trajectory)
        self.feedback = Feedback(*of, known, period=self.period)
        self._world, self._bodies = world, _find_bodies(world)
        n, m, nu = world.num_positions, world.num_contacts, world.num_actuators
        self._estimate = self.DeclareVectorInputPort("estimated_state", 2 * n)
        self._results = self.DeclareAbstractInputPort("contact_results", Value(ContactResults()))
        self._doubt = WALL_DOUBT * Scales.of(world, plan.scenario).length
        hits = [each for each in self.feedback.stretches if each.cut == Cut.HIT]
        # The slowest impact of each contact that is planned.
        self._speeds = {each.contact: each.speed for each in sorted(hits, key=lambda s: -s.speed)}
        self._never = np.append(-np.inf, np.zeros(2 * n))
        groups = np.zeros(nu), np.zeros(m), np.zeros(m), self._never
        self._groups = _Groups(*map(self.DeclareDiscreteState, groups))
        self.DeclareInitializationDiscreteUpdateEvent(self._start)
        self.DeclarePeriodicDiscreteUpdateEvent(self.period, 0.0, self._sample)
        for knot in _find_between(plan.trajectory.times, self.period):
            self.DeclarePeriodicDiscreteUpdateEvent(_ONCE, knot, self._sample)
        self.DeclarePerStepDiscreteUpdateEvent(self._step)
        state = self.discrete_state_ticket
        control = {state(self._groups.control)}
        desired = {self.time_ticket(), state(self._groups.bounces)}
        self.DeclareVectorOutputPort("control", nu, self._write_control, control)
        self.DeclareVectorOutputPort("desired_state", 2 * n, self._write_state, desired)

    def count_bounces(self, context: Context) -> tuple[int, ...]:
        """Returns how many times each contact has bounced in its own context, shape (m,)."""
        return tuple(int(count) for count in self._read(context, self._groups.bounces))

    def _read(self, context: Context, group: DiscreteStateIndex) -> Floats:
        return np.array(context.get_discrete_state(group).value())

    def _start(self, context: Context, values: DiscreteValues) -> EventStatus:
        """Forgets what was, and takes the first sample; on the way, the next one."""
        x = read_start(self, self._estimate, context)
        last, *before = self._read(context, self._groups.last)
        elapsed = context.get_time() - last
        if 0 < elapsed <= (1 + _SAME) * self.period or (elapsed == 0 and np.array_equal(x, before)):
            return self._sample(context, values)
        if self._is_empty(context, x):
            none = np.zeros(self._world.num_contacts)
            for group, known in zip(self._groups[1:], (none, none, self._never), strict=True):
                values.set_value(group, known)
            return self._play(context, values)
        return self._begin(context, values, x)

    def _begin(self, context: Context, values: DiscreteValues, x: Floats) -> EventStatus:
        """Takes the first sample: what is at rest on a wall has not bounced."""
        none, (q, v) = 0 * self._read(context, self._groups.bounces), np.split(x, 2)
        lasts = is_at_rest_on(self._world, q, v)
        return self._hold(context, values, x, none, np.where(lasts, _LASTS, _APART))

    def _sample(self, context: Context, values: DiscreteValues) -> EventStatus:
        """Takes a sample: touches, bounces that are over, and the control from now on."""
        x = self._estimate.Eval(context)
        if not self._is_known(context, x):
            return self._play(context, values)
        if np.isinf(self._read(context, self._groups.last)[0]):
            return self._begin(context, values, x)
        reached = pressed = self._feel(context, x)
        if not self._results.HasValue(context):
            reached = pressed | self._infer(context, x)
        return self._go_on(context, values, x, reached, pressed)

    def _is_known(self, context: Context, x: Floats) -> bool:
        """Returns whether an estimate is one: finite, and not what a hold has before its sample."""
        if np.isinf(self._read(context, self._groups.last)[0]) and self._is_empty(context, x):
            return False
        return bool(np.all(np.isfinite(x)))

    def _is_empty(self, context: Context, x: Floats) -> bool:
        """Returns whether a state may be what a hold has before its first sample."""
        return may_be_unsampled(x, self.feedback.find_state(context.get_time(), ()))

    def _play(self, context: Context, values: DiscreteValues) -> EventStatus:
        """Holds the plan's own control from now on."""
        now, bounces = context.get_time(), self._read(context, self._groups.bounces)
        planned = self.feedback.find_state(now, _list_bounces(bounces))
        control = self.feedback.sample(now, planned, _list_bounces(bounces)).control
        values.set_value(self._groups.control, control)
        return EventStatus.Succeeded()

    def _feel(self, context: Context, x: Floats) -> Bools:
        """Returns which contacts are touched now: as the plant reports, or else φ_i ≤ 0.

        Bodies are known by their names. Of several contacts between the same two bodies it is the
        nearest to its wall.
        """
        phi = self._world.calc_signed_distance(np.split(x, 2)[0])
        if not self._results.HasValue(context):
            return np.asarray(phi <= 0)
        results: ContactResults = self._results.Eval(context)
        felt, plant = np.zeros(len(phi), dtype=bool), results.plant()
        for k in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(k)
            a, b = (_name_body(plant, index) for index in (info.bodyA_index(), info.bodyB_index()))
            same = [
                i
                for i, (one, other) in enumerate(self._bodies)
                if (a in one and b in other) or (a in other and b in one)
            ]
            if same:
                felt[min(same, key=lambda i: phi[i])] = True
        return felt

    def _infer(self, context: Context, x: Floats) -> Bools:
        """Returns which contacts were touched between the last sample and this one.

        That is where J_i v < 0 at the last one, and φ_i(q + v t + a t² / 2) ≤ 0 now; or what has
        turned round as an impact that is planned does.
        """
        world, (time, *before) = self._world, self._read(context, self._groups.last)
        last, u = np.array(before), self._read(context, self._groups.control)
        elapsed, (q, v) = context.get_time() - time, np.split(last, 2)
        ahead = q + elapsed * (v + elapsed / 2 * world.calc_acceleration(q, v, u))
        comes = world.calc_contact_rate(q, v) < 0
        reached = np.asarray(comes & (world.calc_signed_distance(ahead) <= 0))
        bounce = find_bounce(world, (last, x), elapsed, u, self._doubt) if self._speeds else None
        if bounce and -bounce.comes > _FAINT * self._speeds.get(bounce.contact, np.inf):
            reached[bounce.contact] = True
        return reached

    def _step(self, context: Context, values: DiscreteValues) -> EventStatus:
        """Notes touches that the plant reports, and samples at once where one is over."""
        x = self._estimate.Eval(context)
        if not self._is_known(context, x):
            return EventStatus.DidNothing()
        if np.isinf(self._read(context, self._groups.last)[0]):
            return self._begin(context, values, x)
        if not self._results.HasValue(context):
            return EventStatus.DidNothing()
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
        is_leaving = self._world.calc_contact_rate(*np.split(x, 2)) > 0
        over = (touches != _APART) & ~pressed & is_leaving
        bounces = self._read(context, groups.bounces) + (over & (touches == _TOUCHED))
        left = np.where(over, _APART, touches)
        if not np.any((left == _TOUCHED) & (before == _APART)):
            return self._hold(context, values, x, bounces, left)
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
    ) -> EventStatus:
        """Holds the control of a state from now on."""
        time = context.get_time()
        control = self.feedback.sample(time, x, _list_bounces(bounces)).control
        for group, value in zip(
            self._groups, (control, bounces, touches, np.append(time, x)), strict=True
        ):
            values.set_value(group, value)
        return EventStatus.Succeeded()

    def _write_control(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._read(context, self._groups.control))

    def _write_state(self, context: Context, output: BasicVector) -> None:
        bounces = _list_bounces(self._read(context, self._groups.bounces))
        output.SetFromVector(self.feedback.find_state(context.get_time(), bounces))


def _find_between(knots: Floats, period: float) -> list[float]:
    """Returns the knots that are no samples already, but for the last [s]."""
    inside = knots[:-1]
    off = np.abs(inside - period * np.round(inside / period))
    return [float(knot) for knot in inside[off > _SAME * period]]


def _list_bounces(counts: Floats) -> list[int]:
    """Returns the contact of each bounce so far."""
    return [int(i) for i in np.repeat(np.arange(len(counts)), counts.astype(int))]


def _find_bodies(world: World) -> list[list[set[str]]]:
    """Returns the names of both bodies that meet in each contact, plain and with their model's."""
    inspector, plant = world.scene_graph.model_inspector(), world.plant
    bodies = [
        [plant.GetBodyFromFrameId(inspector.GetFrameId(shape)) for shape in pair]
        for pair in world.shapes
    ]
    return [[{body.name(), str(body.scoped_name())} for body in pair] for pair in bodies]


def _name_body(plant: Any, index: Any) -> str:
    """Returns a body's name, with its model's if other bodies of the plant have the same."""
    body = plant.get_body(index)
    is_alone = plant.NumBodiesWithName(body.name()) == 1
    return str(body.name() if is_alone else body.scoped_name())


def may_be_unsampled(x: Floats, expected: Floats) -> bool:
    """Returns whether all of a state is zero where another one is expected."""
    return bool(np.any(expected) and not np.any(x))


def check_plane(world: World) -> None:
    """Refuses worlds in space, for which no controller is made.

    Raises:
        ControlError: it is one.
    """
    if isinstance(world, SpaceWorld):
        raise ControlError(
            "the world to control",
            got="one in space, whose positions and velocities differ in number or kind",
            expected="one in a plane, of hinges and sliders",
            remedy="Play the plan's control: TrajectorySource(plan.trajectory.to_piecewise()[1]).",
        )


def check_period(period: float) -> float:
    """Returns a period as a number above zero.

    Raises:
        ControlError: it is none.
    """
    if not (isinstance(period, NUMBERS) and 0 < period < np.inf):
        raise ControlError("period", got=period, expected="seconds above zero")
    return float(period)


def read_start(system: System, port: InputPort, context: Context) -> Floats:
    """Returns the first estimated state of a controller.

    Raises:
        ControlError: nothing is connected, or it is not finite.
    """
    if not port.HasValue(context):
        is_named = system.get_name() and "@" not in system.get_name()  # Else Drake has an address.
        name = system.GetSystemPathname() if is_named else type(system).__name__
        raise ControlError(
            f"the input port {port.get_name()} of {name}",
            got="nothing that is connected to it",
            expected="q and v of the plant",
            remedy="Connect the plant's state output port, or an estimator's.",
        )
    x: Floats = port.Eval(context)
    if not np.all(np.isfinite(x)):
        raise ControlError("the state at the start", got=x.tolist(), expected="finite numbers")
    return x
