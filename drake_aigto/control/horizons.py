"""Which horizon a planner's task has."""

from __future__ import annotations

from drake_aigto.control.ball_horizon import BallHorizon
from drake_aigto.control.horizon import Horizon
from drake_aigto.control.mechanism_horizon import MechanismHorizon
from drake_aigto.control.rigid_mechanism_horizon import RigidMechanismHorizon
from drake_aigto.errors import ControlError
from drake_aigto.planning import Planner

_ASKED = "the planner of a controller that plans again"


def make_horizon(planner: Planner, is_receding: bool, iterations: int, period: float) -> Horizon:
    """Returns the horizon of a planner's task, whose programs are compiled for it once more.

    Args:
        planner: of the task.
        is_receding: whether the horizon always lasts as long as the scenario, or ends with it.
        iterations: of a descent in a tick, at most.
        period: between ticks [s].

    Raises:
        ControlError: a free duration, or costs or constraints that were added: those at knots of a
            plan are at none of a motion that goes on.
    """
    world, scenario, options = planner.world, planner.scenario, planner.options
    if scenario.duration_range is not None:
        raise ControlError(
            _ASKED,
            got="a task whose duration is free",
            expected="one that is given",
            remedy="Leave duration_range out.",
        )
    if planner.transcription.additions():
        raise ControlError(
            _ASKED,
            got="costs or constraints that were added to its transcription",
            expected="the scenario's alone",
        )
    if planner.is_of_balls:
        return BallHorizon(world, scenario, options, is_receding, period)
    if scenario.contact == "rigid" and world.contacts:
        return RigidMechanismHorizon(world, scenario, options, is_receding, iterations, period)
    return MechanismHorizon(world, scenario, options, is_receding, iterations)
