"""Diagrams of a shipped model and a controller, and what they do."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem

from drake_aigto import Scenario
from drake_aigto.world import find_model, package_map


def close_loop(
    model: str, controller: LeafSystem, feels: bool = False, has_camera: bool = False
) -> tuple[Diagram, Any]:
    """Returns a diagram of a model's continuous plant under a controller, and the plant.

    A camera is a body that is welded in before the model.
    """
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    parser = Parser(plant)
    parser.package_map().AddMap(package_map())
    if has_camera:
        camera = plant.AddRigidBody("camera", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
        plant.WeldFrames(plant.world_frame(), camera.body_frame())
    parser.AddModels(find_model(model))
    plant.Finalize()
    builder.AddSystem(controller)
    builder.Connect(plant.get_state_output_port(), controller.GetInputPort("estimated_state"))
    builder.Connect(controller.GetOutputPort("control"), plant.get_actuation_input_port())
    if feels:
        contacts = controller.GetInputPort("contact_results")
        builder.Connect(plant.get_contact_results_output_port(), contacts)
    return builder.Build(), plant


def set_start(plant: Any, root: Any, scenario: Scenario) -> Any:
    """Sets the scenario's start, and returns the plant's context."""
    context = plant.GetMyMutableContextFromRoot(root)
    start = scenario.initial_position, scenario.initial_velocity
    plant.SetPositionsAndVelocities(context, np.concatenate(start))
    return context
