"""A plant and its controller in Drake's Simulator, and all that happened."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus, OutputPort
from pydrake.systems.primitives import Adder, DiscreteTimeDelay, Saturation, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from drake_aigto.arrays import Floats
from drake_aigto.control.filtering import StateFilter
from drake_aigto.control.loop_run import ClosedLoopRun, Disturbance, PlannedPath, PlanSwitch
from drake_aigto.control.ports import OFTEN, LoopController, TickStatus
from drake_aigto.control.predictive import ModelPredictiveController
from drake_aigto.control.tracking import TrackingController
from drake_aigto.errors import ControlError, ModelError
from drake_aigto.simulation import (
    ContactMonitor,
    ContactTrace,
    Held,
    Recording,
    StepEnd,
    StepTrace,
    start_plant,
    summarize,
)
from drake_aigto.world import Scenario, World

# Commands that act later are sampled so often [s].
_SAMPLED = 1e-3


class LoopRecorder:
    """Watches a simulation: the end of each step, and what the controller says of its plans."""

    def __init__(
        self,
        world: World,
        controller: LoopController,
        contacts: ContactMonitor | None,
        end: float,
        progress: Callable[[str], None] | None,
    ) -> None:
        """Has seen nothing yet.

        Args:
            world: of the diagram that is simulated.
            controller: in it.
            contacts: plans steps between stiff walls; None: walls are compliant, or there are none.
            end: of the simulation [s].
            progress: called with a line of text.
        """
        self._world, self._controller, self._contacts = world, controller, contacts
        self._end, self._say = end, progress or (lambda line: None)
        self._rows: list[StepEnd] = []
        self._kicked: list[int] = []  # rows just after a kick
        self._ticks: list[TickStatus] = []
        self._plans: list[PlannedPath] = []
        self._switches: list[PlanSwitch] = []

    @property
    def has_moved(self) -> bool:
        """Whether there is any motion."""
        return len(self._rows) > 1 and self._rows[-1].time > 0

    def watch(self, root: Context) -> EventStatus:
        """Notes the end of a step; between stiff walls it plans the next ones."""
        self._add(root)
        if isinstance(self._controller, ModelPredictiveController):
            self._look(self._controller, self._controller.GetMyContextFromRoot(root))
        elif not self._plans:
            plan = self._controller.plan.trajectory
            self._plans.append(PlannedPath(plan.times, plan.states))
        if self._contacts is not None:
            self._contacts(root)
        return EventStatus.DidNothing()

    def kick(self, root: Context, jump: Floats) -> None:
        """Has the velocities jump."""
        plant = self._world.plant
        context = plant.GetMyMutableContextFromRoot(root)
        plant.SetVelocities(context, plant.GetVelocities(context) + jump)
        self._kicked.append(len(self._rows))
        self._add(root)
        if self._contacts is not None:
            self._contacts.plan(root)

    def _add(self, root: Context) -> None:
        plant = self._world.plant
        context = plant.GetMyContextFromRoot(root)
        x = plant.GetPositionsAndVelocities(context)
        self._rows.append(StepEnd(root.get_time(), np.array(x), self._world.read_control(root)))
        self._say(f"simulating, {root.get_time():.2f} of {self._end:.2f} s")

    def _look(self, controller: ModelPredictiveController, context: Context) -> None:
        """Notes a tick that is new, and a plan that took the place of another."""
        status: TickStatus = controller.GetOutputPort("status").Eval(context)
        if self._ticks and status.time == self._ticks[-1].time:
            return
        plan = controller.read_plan(context)
        planned = PlannedPath(plan.times, plan.states)
        if self._ticks and status.has_switched:
            self._switches.append(PlanSwitch(status.time, self._plans[-1], planned))
        self._ticks.append(status)
        # Of all plans the first is kept, and the last.
        self._plans = [*self._plans[:1], planned]

    def read(
        self,
        world: World,
        scenario: Scenario,
        true: Scenario,
        disturbance: Disturbance,
        is_interrupted: bool,
    ) -> ClosedLoopRun:
        """Returns the run.

        Args:
            world: that the controller knows.
            scenario: that it knows.
            true: the scenario that was simulated.
            disturbance: between them.
            is_interrupted: whether it ended early.
        """
        recording, end, controller = self._record(), self._rows[-1].time, self._controller
        recording.simulator = "drake"
        is_tracking = isinstance(controller, TrackingController)
        return ClosedLoopRun(
            method="tracking" if is_tracking else "replanning",
            scenario=scenario,
            disturbance=disturbance,
            replay=summarize(self._world, true, recording, end),
            control_times=np.append(recording.control_times, end),
            controls=np.array(recording.controls),
            promised=controller.plan.cost if is_tracking else self._ticks[0].cost,
            plan=self._plans[0],
            ticks=tuple(self._ticks),
            switches=tuple(self._switches),
            is_interrupted=is_interrupted,
            known_world=world,
        )

    def _record(self) -> Recording:
        """Returns what was seen, as simulations of a held control have it."""
        is_stiff, held = self._contacts is not None, np.empty(0)
        trace = ContactTrace(self._world) if is_stiff else StepTrace(self._world, keeps_all=True)
        for number, (row, after) in enumerate(itertools.pairwise(self._rows)):
            # A step's end belongs to the control that led there.
            is_other = after.time > row.time and not np.array_equal(after.control, held)
            if is_other or number in self._kicked:
                held = after.control
                trace.hold(row.time, Held(held, np.inf))
            for each in (row, after) if number == 0 else (after,):
                trace.add(each.time, each.x)
        recording = trace.read(self._rows[-1].time)
        recording.matched_speeds = self._contacts.speeds if self._contacts else []
        return recording


def run_in_loop(
    controller: LoopController,
    scenario: Scenario,
    world: World | None = None,
    disturbance: Disturbance | None = None,
    duration: float | None = None,
    meshcat: Meshcat | None = None,
    progress: Callable[[str], None] | None = None,
    filters: bool = False,
) -> ClosedLoopRun:
    """Simulates a world's plant under a controller, as Drake users run it, and records all of it.

    The plant is a copy of the world's continuous one, with Drake's own contact: stiff walls return
    what the scenario says (`make_simulator`), soft ones are as the model has them. Ctrl-C ends the
    simulation, and what happened by then is returned.

    Args:
        controller: of this scenario; nothing else may use it.
        scenario: what the controller knows: start, goal, weights, contact.
        world: of the scenario's model; built if None.
        disturbance: what it does not know; None: nothing.
        duration: how long to simulate [s]; None: the scenario's.
        meshcat: shows the plant as it moves, in real time, if given.
        progress: called with a line of text from time to time.
        filters: whether a `StateFilter` that knows how large the noise is stands before the
            controller.

    Raises:
        ControlError: the disturbance does not fit, there is no noise to filter, its kick or all its
            commands come after the end, the duration is not above zero, or the controller is for
            another plant.
        ModelError: a world of a diagram of one's own, which has no ports to connect: connect the
            controller there.
        ScenarioError: what is true does not fit, such as a start inside a wall.
    """
    world = world or World.from_scenario(scenario)
    scenario, disturbance = world.place(scenario), disturbance or Disturbance()
    end = scenario.duration if duration is None else duration
    if not 0 < end < np.inf:
        raise ControlError("duration", got=end, expected="seconds above zero")
    disturbance.check_times(end)
    true_world, true = disturbance.apply(world, scenario)
    quiet = _make_filter(world, scenario, disturbance, controller) if filters else None
    diagram = _connect(true_world, controller, disturbance, end, meshcat, quiet)
    plant_world = true_world.of_diagram(diagram)
    plant_world.check(true)
    simulator, contacts = start_plant(plant_world, true, (0.0, true.duration))
    if meshcat is not None:
        simulator.set_target_realtime_rate(1.0)
    recorder = LoopRecorder(plant_world, controller, contacts, end, progress)
    is_interrupted = _advance(simulator, recorder, disturbance, end)
    run = recorder.read(world, scenario, true, disturbance, is_interrupted)
    return dataclasses.replace(run, is_filtered=filters)


def _connect(
    world: World,
    controller: LoopController,
    disturbance: Disturbance,
    end: float,
    meshcat: Meshcat | None,
    quiet: StateFilter | None,
) -> Diagram:
    """Returns a diagram of a copy of the plant, and the controller, with a filter before it."""
    builder = DiagramBuilder()
    plant: Any = builder.AddSystem(world.diagram.Clone())
    if not all(plant.HasOutputPort(name) for name in ("state", "contact_results", "query")):
        raise ModelError(
            "the world to simulate in a loop",
            got="a diagram of one's own",
            expected="the world of a scenario's model",
            remedy="Connect the controller to the plant in your diagram.",
        )
    builder.AddSystem(controller)
    controller.check_plant(world.plant)
    state = plant.GetOutputPort("state")
    if disturbance.noise.any():
        state = _add_noise(builder, state, disturbance, controller.period, end)
    if quiet is not None:
        builder.AddSystem(quiet)
        builder.Connect(state, quiet.GetInputPort("measured_state"))
        state = quiet.get_output_port()
    builder.Connect(state, controller.get_input_port_estimated_state())
    control = controller.get_output_port_control()
    if disturbance.delay:
        count = int(np.ceil(disturbance.delay / _SAMPLED))
        # Never sooner: what is commanded for after a task's end would act at it.
        late = builder.AddSystem(
            DiscreteTimeDelay(disturbance.delay / count, count, control.size())
        )
        builder.Connect(control, late.get_input_port())
        control = late.get_output_port()
    if (most := disturbance.saturation).any():
        cut = builder.AddSystem(Saturation(-most, most))
        builder.Connect(control, cut.get_input_port())
        control = cut.get_output_port()
    builder.Connect(control, plant.GetInputPort("actuation"))
    if quiet is not None:
        builder.Connect(control, quiet.GetInputPort("control"))
    # Bounces are counted where the filter sees them, or a command answers one with the other.
    if quiet is None and controller.HasInputPort("contact_results"):
        felt = controller.GetInputPort("contact_results")
        builder.Connect(plant.GetOutputPort("contact_results"), felt)
    if meshcat is not None:
        MeshcatVisualizer.AddToBuilder(builder, plant.GetOutputPort("query"), meshcat)
    return builder.Build()


def _make_filter(
    world: World, scenario: Scenario, disturbance: Disturbance, controller: LoopController
) -> StateFilter:
    """Returns a filter of what the controller samples."""
    if not disturbance.noise.any():
        expected = "noise of the estimated state"
        raise ControlError("filters", got="a disturbance without noise", expected=expected)
    often = min(controller.period, scenario.time_step / OFTEN)
    return StateFilter(world, scenario, disturbance.noise, controller.period, often)


def _add_noise(
    builder: DiagramBuilder, state: OutputPort, disturbance: Disturbance, period: float, end: float
) -> OutputPort:
    """Returns the port of a state with noise, another one every period."""
    times = period * np.arange(int(end / period) + 2)
    held = PiecewisePolynomial.ZeroOrderHold(times, disturbance.draw_noise(len(times)).T)
    source, adder = (
        builder.AddSystem(TrajectorySource(held)),
        builder.AddSystem(Adder(2, state.size())),
    )
    builder.Connect(source.get_output_port(), adder.get_input_port(0))
    builder.Connect(state, adder.get_input_port(1))
    return adder.get_output_port()


def _advance(
    simulator: Simulator, recorder: LoopRecorder, disturbance: Disturbance, end: float
) -> bool:
    """Simulates to the end, and returns whether Ctrl-C ended it before."""
    simulator.set_monitor(recorder.watch)
    try:
        if disturbance.kick.any():
            simulator.AdvanceTo(disturbance.kick_time)
            recorder.kick(simulator.get_mutable_context(), disturbance.kick)
        simulator.AdvanceTo(end)
    except KeyboardInterrupt:
        if recorder.has_moved:
            return True
        raise
    return False
