"""Ports, checks of samples, limits and latency, which all controllers in a loop have."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DependencyTicket,
    InputPort,
    LeafSystem,
    OutputPort,
)
from pydrake.trajectories import PiecewisePolynomial

from drake_aigto.arrays import ArrayRecord, Floats, read_only
from drake_aigto.control.model import Model
from drake_aigto.errors import ControlError
from drake_aigto.planning import needs_shooting
from drake_aigto.simulation import HeldControl, state_scales
from drake_aigto.world import Scenario, World

Mode: TypeAlias = Literal["waiting", "running", "holding", "fallback"]
Sample: TypeAlias = Literal["none", "valid", "not finite", "off limits", "far off"]
Fallback: TypeAlias = Literal["plan", "hold", "brake", "zero"]
MODES, SAMPLES = get_args(Mode), get_args(Sample)

# Types of real numbers: NumPy's scalars may be given, too.
NUMBERS = int | float | np.integer | np.floating
# Samples in a time step of the scenario: gains are of its holds, and are no worse in shorter ones.
OFTEN = 5
# To brake, velocities fall by a factor e in this part of the task's duration.
_BRAKE = 0.1
# Commands that are remembered in each period of a delay: of samples, of knots and of bounces.
_COMMANDS = 3


@dataclass(frozen=True)
class TickStatus:
    """Report of a controller, of its last sample or tick.

    Attributes:
        time: of the tick [s].
        cost: J of the plan from there on; of a plan that is tracked, all of its J.
        touches: the contacts that the plan comes into, in order, each as often as it does.
        reason: why the plan is what it is.
        seconds: of wall time that the tick took.
        has_switched: whether another contact sequence was taken.
        restitution: e of rigid walls, as the scenario has it or as bounces have shown it; None
            where they are compliant.
        nearer: by how much nearer the wall of each contact was found to stand than the model has
            it, shape (m,) [m]; empty: nothing was found.
        mode: "waiting" for the first sample or the start, "running" along the plan, "holding" the
            goal after its end, or "fallback", where the sample is of no use (`Safety`).
        sample: whether the sample is valid, or why not.
        deviation: of the state from the plan, as a part of the task's scales or of the plan's own
            values, whichever are larger, the largest of all coordinates; infinite without a sample.
        is_limited: whether limits have changed the command, or it is as large as `Safety` allows.
        is_late: whether the tick took longer than the period, or a search longer than its ticks.
        estimated: what is estimated of the model (`ModelPredictiveController.estimated`).
        iterations: of a descent in a tick, at most; 0: there is none.
    """

    time: float
    cost: float
    touches: tuple[int, ...]
    reason: str
    seconds: float
    has_switched: bool = False
    restitution: float | None = None
    nearer: tuple[float, ...] = ()
    mode: Mode = "running"
    sample: Sample = "valid"
    deviation: float = 0.0
    is_limited: bool = False
    is_late: bool = False
    estimated: tuple[float, ...] = ()
    iterations: int = 0


def tabulate(ticks: Sequence[TickStatus]) -> dict[str, list[Any]]:
    """Returns reports as columns by name: pandas.DataFrame(tabulate(ticks)) is a table of them."""
    return {each.name: [getattr(tick, each.name) for tick in ticks] for each in fields(TickStatus)}


@dataclass(frozen=True, eq=False)
class Safety(ArrayRecord):
    """Limits of a controller, and its command where a sample of the state is of no use.

    Letters: n coordinates, nu actuators. One number stands for all of an array.

    Attributes:
        control: |u_i| at most, in the scenario's bounds, (nu,) [N, N m]; mechanisms' plans know it.
        rate: |du_i/dt| at most, from one sample to the next, shape (nu,) [N/s, N m/s].
        lower, upper: of q and v, shape (nq + n,) [m, rad, 1/s]; a sample beyond is of no use.
        far: nor is one that is farther off the plan (`TickStatus.deviation`).
        fallback: the command then: the plan's ("plan"), the last one ("hold"), none ("zero"), or
            ("brake") what leads to M v̇ = −M v / τ as nearly as actuators can, with τ a tenth of the
            task's duration; for v a sample that is finite serves, or else the plan.
    """

    control: Floats | float = np.inf
    rate: Floats | float = np.inf
    lower: Floats | float = -np.inf
    upper: Floats | float = np.inf
    far: float = 10.0
    fallback: Fallback = "plan"

    def __post_init__(self) -> None:
        """Makes the arrays read-only.

        Raises:
            ControlError: a limit that is not above zero, bounds that leave nothing, or an unknown
                fallback.
        """
        for name in ("control", "rate", "lower", "upper"):
            value = np.atleast_1d(np.array(getattr(self, name), dtype=float))
            object.__setattr__(self, name, read_only(value))
        for name in ("control", "rate", "far"):
            if not np.all(np.asarray(value := getattr(self, name)) > 0):
                raise ControlError(name, got=value, expected="limits above zero")
        if not np.all(self.lower < self.upper):
            got = f"{self.lower} and {self.upper}"
            raise ControlError("lower and upper", got=got, expected="lower ones below upper ones")
        if self.fallback not in get_args(Fallback):
            got, expected = self.fallback, f"one of {', '.join(get_args(Fallback))}"
            raise ControlError("fallback", got=got, expected=expected)

    def fit(self, world: World) -> Safety:
        """Returns the same with arrays of full length.

        Raises:
            ControlError: one has the wrong length.
        """
        states, found = world.num_positions + world.num_velocities, dict[str, Floats]()
        sizes = {"lower": states, "upper": states}
        for name in ("control", "rate", "lower", "upper"):
            value, size = np.asarray(getattr(self, name)), sizes.get(name, world.num_actuators)
            if len(value) not in (1, size):
                raise ControlError(name, got=f"{len(value)} numbers", expected=f"1 or {size}")
            found[name] = np.broadcast_to(value, size)
        return Safety(**found, far=self.far, fallback=self.fallback)


class LoopController(LeafSystem):
    """A controller in a loop: its ports, and what is common to tracking and planning again.

    Input port: `estimated_state`, q and v. Output ports: `control`, u as the plant's actuation port
    takes it; `desired_state`, q and v of the plan when the present command acts; `planned_state`, a
    PiecewisePolynomial of both; and `status`, a `TickStatus`.

    A command that leaves at t acts from t + `delay` on. So the state is led on to then, by the
    commands that are on their way and the scenario's own law of contact (`EventDriven`), before it
    is answered; before the first command acts there is no control.

    Attributes:
        period: between samples or ticks [s].
        delay: from a sample of the state to the command that answers it acting on the plant [s].
        start_time: the context's time at which the plan, or the task, begins [s].
        safety: limits, and the fallback.
    """

    def __init__(
        self,
        world: World,
        scenario: Scenario,
        period: float,
        delay: float = 0.0,
        start_time: float = 0.0,
        safety: Safety | None = None,
        often: float | None = None,
        memory: float = 0.0,
    ) -> None:
        """Declares the input port; heirs their state, then others. Commands may come `often`.

        They are remembered until they act, and for as long as the `memory` [s] after that.

        Raises:
            ControlError: an argument is out of its range.
        """
        super().__init__()
        T, self._world, self._scenario = scenario.duration, world, scenario
        self.period = check_seconds("period", period, is_positive=True, most=T)
        self.delay = check_seconds("delay", delay, most=T)
        self.start_time = check_seconds("start_time", start_time)
        self.safety = (safety or Safety()).fit(world)
        self._units = state_scales(world, scenario)
        low, high = world.bounds(scenario).control
        self._most = np.maximum(low, -self.safety.control), np.minimum(high, self.safety.control)
        # Plans of mechanisms know these limits, too; those of balls have none, and are cut.
        if np.any(np.isfinite(self.safety.control)) and needs_shooting(world, scenario):
            least, most = self._most
            self._scenario = replace(scenario, control_lower=least, control_upper=most)
        self._model = Model(world, self._scenario)
        self._estimate = self.DeclareVectorInputPort("estimated_state", len(self._units))
        if often is not None:
            often = check_seconds("feedback_period", often, True, self.period, "a period")
        self.feedback_period = often
        a_period = max(_COMMANDS, int(np.ceil(self.period / (often or self.period))))
        count = 2 + a_period * int(np.ceil(1 + (self.delay + memory) / self.period))
        self._no_commands = np.zeros((count, 1 + world.num_actuators))
        self._no_commands[:, 0] = -np.inf

    def _declare_outputs(self, held: set[DependencyTicket]) -> None:
        """Declares the output ports, of a state."""
        nx, nu, later = len(self._units), self._world.num_actuators, {self.time_ticket()}
        self.DeclareVectorOutputPort("control", nu, self._write_control, held)
        self.DeclareVectorOutputPort("desired_state", nx, self._write_state, held | later)
        empty = TickStatus(-np.inf, np.inf, (), "", 0.0)
        for name, value, write in (
            ("planned_state", PiecewisePolynomial(), self._write_path),
            ("status", empty, self._write_status),
        ):
            make = lambda value=value: AbstractValue.Make(value)  # noqa: E731
            self.DeclareAbstractOutputPort(name, make, write, held)

    def get_input_port_estimated_state(self) -> InputPort:
        """Returns the port of q and v."""
        return self.GetInputPort("estimated_state")

    def get_output_port_control(self) -> OutputPort:
        """Returns the port of u."""
        return self.GetOutputPort("control")

    def get_output_port_desired_state(self) -> OutputPort:
        """Returns the port of the plan's q and v."""
        return self.GetOutputPort("desired_state")

    def get_output_port_status(self) -> OutputPort:
        """Returns the port of reports."""
        return self.GetOutputPort("status")

    def check_plant(self, plant: Any) -> None:
        """Checks that a plant's state and actuators are those of the plan, in order: no port tells.

        Raises:
            ControlError: joints or actuators have other names, or another order.
        """
        for what, read in (("joints", "GetStateNames"), ("actuators", "GetActuatorNames")):
            names = [", ".join(getattr(each, read)(False)) for each in (plant, self._world.plant)]
            if names[0] != names[1]:
                remedy = "Put them in that order, or plan for this plant (World.from_diagram)."
                raise ControlError(f"{what} of the plant", names[0], names[1], remedy=remedy)

    @abstractmethod
    def update(self, context: Context) -> None:
        """Takes a sample, or a tick, at the context's time: for nodes without a Simulator."""

    @abstractmethod
    def read_status(self, context: Context) -> TickStatus:
        """Returns the report of the last sample or tick, in its own context."""

    @abstractmethod
    def _read_commands(self, context: Context) -> Floats:
        """Returns the last commands, the times of which increase: rows (t, u)."""

    @abstractmethod
    def _find_desired(self, context: Context) -> Floats:
        """Returns q and v of the plan when the present command acts, shape (nq + n,)."""

    @abstractmethod
    def _find_path(self, context: Context) -> PiecewisePolynomial:
        """Returns q and v of the plan in the context's time."""

    def _judge(self, x: Floats, planned: Floats, reach: Floats) -> tuple[Sample, float]:
        """Returns whether a sample can be used, and how far it is off the plan.

        Args:
            x: the sample, angles as near to the plan as turns bring them (`_unwrap`).
            planned: the plan's state now.
            reach: the largest |q| and |v| of the plan, shape (nq + n,).
        """
        if not np.all(np.isfinite(x)):
            return "not finite", np.inf
        off = float(np.max(np.abs(x - planned) / np.maximum(self._units, reach)))
        if np.any((x < self.safety.lower) | (x > self.safety.upper)):
            return "off limits", off
        return ("far off" if off > self.safety.far else "valid"), off

    def _unwrap(self, x: Floats, planned: Floats) -> Floats:
        """Returns a state with turns written as is nearest to the plan."""
        if not np.all(np.isfinite(x)):
            return x
        (q, v), (about, _) = map(self._world.split, (x, planned))
        return np.concatenate([self._world.take_nearest(q, about), v])

    def _limit(self, u: Floats, commands: Floats, time: float) -> tuple[Floats, bool]:
        """Returns a command within all limits, and whether they changed it, or it is at one."""
        last, *before = commands[commands[:, 0] < time][-1]
        change = self.safety.rate * (time - last)
        limited = np.clip(np.clip(u, *self._most), before - change, before + change)
        is_at_limit = np.any(np.abs(limited) >= self.safety.control)
        return limited, bool(is_at_limit or not np.array_equal(limited, u))

    def _fall_back(self, x: Floats, planned: Floats, u: Floats, commands: Floats) -> Floats:
        """Returns the command of the fallback, from the plan's state and control."""
        if self.safety.fallback == "plan":
            return u
        if self.safety.fallback == "hold":
            return np.array(commands[-1, 1:])
        if self.safety.fallback == "zero":
            return np.zeros_like(u)
        world, is_known = self._world, np.all(np.isfinite(x))
        q, v = world.split(x if is_known else planned)
        slowing = world.calc_mass_matrix(q) @ v / (_BRAKE * self._scenario.duration)
        return np.asarray(world.inverse_actuation @ (world.calc_bias(q, v) - slowing))

    def _find_acting(self, commands: Floats, time: float) -> Floats:
        """Returns u that acts on the plant at a time, shape (nu,)."""
        k = int(np.searchsorted(commands[:, 0] + self.delay, time, side="right")) - 1
        return np.array(commands[max(k, 0), 1:])

    def _find_held(self, commands: Floats, start: float, end: float) -> HeldControl:
        """Returns the commands that act on the plant in a stretch of time."""
        acts = commands[:, 0] + self.delay
        is_coming = (acts > start) & (acts < end)
        coming, knots = commands[is_coming], np.concatenate([[start], acts[is_coming], [end]])
        return HeldControl(knots, np.vstack([self._find_acting(commands, start), coming[:, 1:]]))

    def _lead_on(self, time: float, x: Floats, commands: Floats) -> tuple[Floats, list[int]] | None:
        """Returns the state a delay later, and the contacts that bounce until then; None: unknown.

        Args:
            time: of the sample x [s].
            x: q and v.
            commands: rows (t, u), of which those that are on their way count.
        """
        if not self.delay:
            return x, []
        held = self._find_held(commands, time, time + self.delay)
        return self._model.predict(x, held)

    def _write_control(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._read_commands(context)[-1, 1:])

    def _write_state(self, context: Context, output: BasicVector) -> None:
        q, v = self._world.split(self._find_desired(context))
        output.SetFromVector(np.concatenate([self._world.normalized(q), v]))

    def _write_path(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._find_path(context))

    def _write_status(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self.read_status(context))

    def _read_start(self, context: Context) -> Floats:
        """Returns the first estimated state.

        Raises:
            ControlError: nothing is connected, or it is not finite.
        """
        port = self._estimate
        if not port.HasValue(context):
            is_named = self.get_name() and "@" not in self.get_name()  # Else Drake has an address.
            name = self.GetSystemPathname() if is_named else type(self).__name__
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


def may_be_unsampled(x: Floats, expected: Floats) -> bool:
    """Returns whether all of a state is zero where another one is expected."""
    return bool(np.any(expected) and not np.any(x))


def check_seconds(
    name: str,
    seconds: float,
    is_positive: bool = False,
    most: float = np.inf,
    limit: str = "the task's duration",
) -> float:
    """Returns seconds of at least 0, or above it, that are at most those of a limit.

    Raises:
        ControlError: they are none.
    """
    is_number = isinstance(seconds, NUMBERS) and 0 <= seconds < np.inf
    if not is_number or (is_positive and seconds == 0):
        expected = "seconds above zero" if is_positive else "seconds of at least zero"
        raise ControlError(name, got=seconds, expected=expected)
    if seconds > most:
        got, expected = f"{float(seconds):g} s", f"at most {limit}, {most:g} s"
        raise ControlError(name, got=got, expected=expected)
    return float(seconds)
