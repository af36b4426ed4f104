"""Diagrams of a shipped model and a controller, and what they do."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, Diagram, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource, ZeroOrderHold

from drake_aigto import ModelPredictiveController, Plan, Planner, Scenario, World, plan
from drake_aigto.world import find_model, package_map

BALL = Scenario.named("table1/1")


@cache
def make_plan() -> Plan:
    """Returns the plan of the ball."""
    return plan(BALL)


class Wrapper(LeafSystem):
    """An estimator that gives angles within half a turn of zero."""

    def __init__(self, world: World) -> None:
        super().__init__()
        self.is_hinge = np.append(world.is_hinge, np.zeros(world.num_velocities, dtype=bool))
        size = len(self.is_hinge)
        self.DeclareVectorInputPort("state", size)
        self.DeclareVectorOutputPort("estimate", size, self.write)

    def write(self, context: Context, output: BasicVector) -> None:
        x = self.get_input_port().Eval(context)
        wrapped = np.arctan2(np.sin(x), np.cos(x))
        output.SetFromVector(np.where(self.is_hinge, wrapped, x))


def close_loop(
    model: str,
    controller: LeafSystem,
    feels: bool = False,
    has_camera: bool = False,
    estimator: LeafSystem | None = None,
) -> tuple[Diagram, Any]:
    """Returns a diagram of a model's continuous plant under a controller, and the plant.

    A camera is a body that is welded in before the model. An estimator, if there is one, stands
    between the plant's state and the controller.
    """
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    parser = Parser(plant)
    parser.package_map().AddMap(package_map())
    if has_camera:
        camera = plant.AddRigidBody("camera", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
        plant.WeldFrames(plant.world_frame(), camera.body_frame())
    parser.AddModelsFromString(find_model(model).read_text(encoding="utf-8"), "sdf")
    plant.Finalize()
    builder.AddSystem(controller)
    state = plant.get_state_output_port()
    if estimator is not None:
        builder.AddSystem(estimator)
        builder.Connect(state, estimator.get_input_port())
        state = estimator.get_output_port()
    builder.Connect(state, controller.GetInputPort("estimated_state"))
    builder.Connect(controller.GetOutputPort("control"), plant.get_actuation_input_port())
    if feels:
        contacts = controller.GetInputPort("contact_results")
        builder.Connect(plant.get_contact_results_output_port(), contacts)
    return builder.Build(), plant


def hold_samples(period: float, size: int) -> LeafSystem:
    """Returns a sampled estimator, which has zeros before its first sample."""
    return ZeroOrderHold(period, size)


def set_start(plant: Any, root: Any, scenario: Scenario) -> Any:
    context = plant.GetMyMutableContextFromRoot(root)
    start = scenario.initial_position, scenario.initial_velocity
    plant.SetPositionsAndVelocities(context, np.concatenate(start))
    return context


def start_at(planner: Planner, x: Any) -> None:
    """Plans again from a state, in a Simulator that begins there."""
    builder = DiagramBuilder()
    source = builder.AddSystem(ConstantVectorSource(x))
    controller = builder.AddSystem(ModelPredictiveController(planner, period=0.1))
    builder.Connect(source.get_output_port(), controller.get_input_port(0))
    Simulator(builder.Build()).Initialize()
