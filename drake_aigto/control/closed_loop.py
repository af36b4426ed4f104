"""A plant and its controller in Drake's Simulator, and all that happened."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort
from pydrake.systems.primitives import Adder, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from drake_aigto.control.disturbance import Disturbance
from drake_aigto.control.loop_recorder import LoopController, LoopRecorder
from drake_aigto.control.loop_run import ClosedLoopRun
from drake_aigto.errors import ControlError, ModelError
from drake_aigto.simulation import start_plant
from drake_aigto.world import Scenario, World


def run_in_loop(
    controller: LoopController,
    scenario: Scenario,
    world: World | None = None,
    disturbance: Disturbance | None = None,
    duration: float | None = None,
    meshcat: Meshcat | None = None,
    progress: Callable[[str], None] | None = None,
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

    Raises:
        ControlError: the disturbance does not fit, its kick comes after the end, the duration is
            not above zero, or the controller is for another plant.
        ModelError: a world of a diagram of one's own, which has no ports to connect: connect the
            controller there.
        ScenarioError: what is true does not fit, such as a start inside a wall.
    """
    world = world or World.from_scenario(scenario)
    disturbance = disturbance or Disturbance()
    end = _check_duration(duration, scenario, disturbance)
    true_world, true = disturbance.apply(world, scenario)
    diagram = _connect(true_world, controller, disturbance, end, meshcat)
    plant_world = true_world.of_diagram(diagram)
    plant_world.check(true)
    simulator, contacts = start_plant(plant_world, true, (0.0, true.duration))
    disturbance.scale_masses(plant_world, simulator.get_mutable_context())
    if meshcat is not None:
        simulator.set_target_realtime_rate(1.0)
    recorder = LoopRecorder(plant_world, controller, contacts, end, progress)
    is_interrupted = _advance(simulator, recorder, disturbance, end)
    return recorder.read(world, scenario, true, disturbance, is_interrupted)


def _check_duration(duration: float | None, scenario: Scenario, disturbance: Disturbance) -> float:
    end = scenario.duration if duration is None else duration
    if not 0 < end < np.inf:
        raise ControlError("duration", got=end, expected="seconds above zero")
    if disturbance.kick.any() and not disturbance.kick_time < end:
        got, expected = disturbance.kick_time, f"before the run ends, at {end:g} s"
        raise ControlError("kick_time", got=got, expected=expected)
    return float(end)


def _connect(
    world: World,
    controller: LoopController,
    disturbance: Disturbance,
    end: float,
    meshcat: Meshcat | None,
) -> Diagram:
    """Returns a diagram of a copy of the plant, and the controller."""
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
    state, estimate = plant.GetOutputPort("state"), controller.GetInputPort("estimated_state")
    if state.size() != estimate.size():
        got = f"one for {estimate.size()} numbers of q and v"
        raise ControlError("the controller", got=got, expected=f"one for {state.size()}")
    if disturbance.noise.any():
        state = _add_noise(builder, state, disturbance, controller.period, end)
    builder.Connect(state, estimate)
    builder.Connect(controller.GetOutputPort("control"), plant.GetInputPort("actuation"))
    if controller.HasInputPort("contact_results"):
        felt = controller.GetInputPort("contact_results")
        builder.Connect(plant.GetOutputPort("contact_results"), felt)
    if meshcat is not None:
        MeshcatVisualizer.AddToBuilder(builder, plant.GetOutputPort("query"), meshcat)
    return builder.Build()


def _add_noise(
    builder: DiagramBuilder,
    state: OutputPort,
    disturbance: Disturbance,
    period: float,
    end: float,
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
