"""Which feedback fits a plan."""

from __future__ import annotations

from drake_aigto.control.feedback import Feedback, FlightFeedback, KnotFeedback
from drake_aigto.control.phase_feedback import PhaseFeedback
from drake_aigto.control.stretches import touches_walls
from drake_aigto.planning import needs_shooting
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import Scenario, World


def make_feedback(world: World, scenario: Scenario, trajectory: Trajectory) -> Feedback:
    """Returns the law that fits a plan.

    By flights for AIGTO's tasks of balls; by phases for mechanisms that bounce off rigid walls or
    lie at them; by knots where walls yield, or nothing is touched.

    Raises:
        TrajectoryError: none knows its contacts.
    """
    if not needs_shooting(world, scenario):
        return FlightFeedback(world, scenario, trajectory)
    touches = scenario.contact == "rigid" and touches_walls(world, trajectory)
    return (PhaseFeedback if touches else KnotFeedback)(world, scenario, trajectory)
