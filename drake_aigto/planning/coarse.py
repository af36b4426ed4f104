"""The coarse time steps of AIGO's boxes."""

from __future__ import annotations

import math

import numpy as np

from drake_aigto.planning.options import PlanOptions
from drake_aigto.transcription import RigidTranscription
from drake_aigto.transcription.touch import AT_ONCE
from drake_aigto.world import Scenario, World

# AIGO's boxes tell a bounce from the start's own push if so many steps lead to the wall; for that
# they have so many times the steps at most, if the scenario does not have more.
_STEPS_TO_WALL, _MOST_FINER = 3, 4


def transcribe(world: World, scenario: Scenario, options: PlanOptions) -> RigidTranscription:
    """Returns the scenario, transcribed with the time steps of `coarsen`."""
    world.check_plain(scenario)
    return RigidTranscription(world, coarsen(world, scenario, options), options.relaxation)


def coarsen(world: World, scenario: Scenario, options: PlanOptions) -> Scenario:
    """Returns the scenario with the time steps of AIGO's boxes (`PlanOptions.aigo_steps`).

    There are more of them if a wall would be touched in less than three: up to the scenario's, or
    four times as many if those are few.
    """
    most = max(scenario.num_steps, _MOST_FINER * options.aigo_steps)
    return scenario.in_steps(max(options.aigo_steps, min(_count_steps(world, scenario), most)))


def _count_steps(world: World, scenario: Scenario) -> int:
    """Returns into how many steps T has to be cut for the ball to fly three before the wall.

    No number would do for a wall that is touched at once, which needs no box to be seen.
    """
    distances = world.calc_signed_distance(scenario.initial_position)
    jacobian = world.calc_contact_jacobian(scenario.initial_position)
    speeds, T = -jacobian @ scenario.initial_velocity, scenario.duration
    counts = T * speeds[distances > 0] / distances[distances > 0]
    return math.ceil(_STEPS_TO_WALL * np.max(counts[counts < 1 / AT_ONCE], initial=0.0))
