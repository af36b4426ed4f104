"""What is shown beside a plan is what a gradient solver makes of the same scenario."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_aigto import Scenario, World, replay_event_driven
from drake_aigto.show import gradient_motions


def test_before_one_wall_it_is_a_plan_and_its_simulation() -> None:
    scenario = Scenario.named("table1/1")
    world = World.from_scenario(scenario)
    planned, simulated = gradient_motions(world, scenario)
    assert planned.label == "SNOPT from zero: plan (not a simulation)"
    assert simulated.label == "SNOPT from zero: simulation: exactly rigid"
    assert planned.controls is not None and simulated.controls is not None
    np.testing.assert_array_equal(planned.controls, simulated.controls)
    # It brakes and turns before the wall, as the paper says of gradient solvers.
    assert not planned.touches and np.min(planned.positions) > 0.1
    np.testing.assert_array_equal(planned.positions[0], scenario.initial_position)


def test_between_walls_it_is_the_simulation_of_one_guess() -> None:
    scenario = dataclasses.replace(Scenario.named("corridor/lossy"), time_step=0.1)
    world = World.from_scenario(scenario)
    (simulated,) = gradient_motions(world, scenario, seed=1)
    assert simulated.label == "SNOPT from a random guess: simulation: exactly rigid"
    assert simulated.control_times is not None and simulated.controls is not None
    replay = replay_event_driven(world, scenario, simulated.control_times, simulated.controls)
    np.testing.assert_allclose(simulated.positions[-1], replay.positions[-1])
    (again,) = gradient_motions(world, scenario, seed=1)
    np.testing.assert_array_equal(again.positions, simulated.positions)
