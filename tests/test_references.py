"""References that move, from tick to tick: those of scenarios, and trajectories at a port."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from marks import slow
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource
from pydrake.trajectories import PiecewisePolynomial

from drake_aigto import ModelPredictiveController, Planner, PlanOptions, Scenario
from drake_aigto.control import run_in_loop
from drake_aigto.errors import ControlError


@pytest.mark.parametrize("name", ["cart_pole/soft_10", *slow("cart_pole/rigid_10")])
def test_a_reference_goes_on_from_tick_to_tick(name: str) -> None:
    weights: dict[str, Any] = {
        "control_weight": 1e-3,
        "goal_weight": [0.0, 0.0],
        "goal_velocity_weight": [0.0, 0.0],
        "position_weight": [20.0, 1.0],
        "velocity_weight": [1.0, 0.1],
    }
    scenario = dataclasses.replace(
        Scenario.named(name),
        initial_position=[0.0, 0.0],
        initial_velocity=[0.0, 0.0],
        goal_position=[0.9, 0.0],
        angles="exact",
        duration=1.0,
        time_step=0.05,
        reference_times=[0.0, 3.0],
        reference_positions=[[0.0, 0.0], [0.9, 0.0]],
        reference_velocities=[[0.3, 0.0], [0.3, 0.0]],
        **weights,
    )
    options = PlanOptions(renewals=0, starts=3, finalists=1, confirm=False, threads=1)
    controller = ModelPredictiveController(Planner(scenario, options), period=0.05)
    run = run_in_loop(controller, scenario, duration=1.5)
    assert run.replay.positions[-1, 0] == pytest.approx(0.45, abs=0.03)
    without = dataclasses.replace(scenario, **NO_REFERENCE)
    path = PiecewisePolynomial.FirstOrderHold([0.0, 3.0], [[0, 0.9], [0, 0], [0.3, 0.3], [0, 0]])
    by_port, own = follow(Planner(without, options), path, 0.5), Planner(scenario, options)
    assert by_port == pytest.approx(follow(own, None, 0.5), rel=1e-3)


NO_REFERENCE: dict[str, Any] = {
    "reference_times": None,
    "reference_positions": None,
    "reference_velocities": None,
}


def follow(planner: Planner, path: PiecewisePolynomial | None, until: float) -> float:
    """Returns where a cart is that follows a trajectory by its port, or its scenario's."""
    controller = ModelPredictiveController(planner, period=0.05)
    builder = DiagramBuilder()
    plant: Any = builder.AddSystem(planner.world.diagram.Clone())
    builder.AddSystem(controller)
    builder.Connect(plant.GetOutputPort("state"), controller.get_input_port_estimated_state())
    builder.Connect(controller.get_output_port_control(), plant.GetInputPort("actuation"))
    if path is not None:
        source = builder.AddSystem(ConstantValueSource(AbstractValue.Make(path)))
        builder.Connect(source.get_output_port(), controller.GetInputPort("reference_path"))
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(until)
    context = plant.GetMyContextFromRoot(simulator.get_context())
    return float(plant.GetOutputPort("state").Eval(context)[0])


@pytest.mark.parametrize(
    ("path", "message"),
    [
        (
            PiecewisePolynomial.FirstOrderHold([0.0, 9.0], np.zeros((2, 2))),
            "^reference_path: got 2 by 1 numbers, expected q and v, 4 by 1",
        ),
        (
            PiecewisePolynomial.FirstOrderHold([0.0, 1.4], np.zeros((4, 2))),
            r"^reference_path: got one that ends at 1\.4 s, expected one until 1\.5 s",
        ),
    ],
)
def test_a_reference_that_does_not_fit_is_refused(path: Any, message: str) -> None:
    with pytest.raises(ControlError, match=message):
        follow(Planner(Scenario.named("cart_pole/soft_06")), path, 0.01)
