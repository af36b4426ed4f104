"""Doing nothing: the motion without control, as a candidate that every plan has to beat."""

from __future__ import annotations

import numpy as np

from drake_aigto.planning.candidate import LARGEST_DEFECT, Candidate
from drake_aigto.planning.origin import NO_CONTROL, Origin
from drake_aigto.planning.problem import PlanningProblem, sample
from drake_aigto.planning.simulated import calc_defects, read_motion
from drake_aigto.simulation import find_contacts, max_penetration
from drake_aigto.transcription.rows import largest_defect

# Springs and dampers are integrated: knots become twice as many so often at most until the midpoint
# rule, which the rows of plans are, agrees.
_MOST_DOUBLINGS = 5


def idle_candidate(problem: PlanningProblem) -> Candidate:
    """Returns what the world does without any control, on rigid walls.

    Its knots are those of the problem's `coast`, and the times of impacts.

    Args:
        problem: the task, and what users added to it.
    """
    world, replay = problem.transcription.world, problem.coast
    no_control = np.zeros((1, world.num_actuators))
    for doubling in range(_MOST_DOUBLINGS + 1):
        if doubling:
            replay = problem.replay_coast(problem.coast_steps << doubling)
        ends = replay.times[[0, -1]]
        trajectory = read_motion(world, replay, ends, no_control, problem.scales.length)
        missed = problem.additions.violations(sample(trajectory)) if problem.additions else {}
        defects = {**calc_defects(world, trajectory), **missed}
        if largest_defect(defects, problem.scales) <= LARGEST_DEFECT:
            break
    replay = problem.add_to_replay(replay, trajectory)
    return Candidate(
        origin=Origin(NO_CONTROL),
        start_cost=replay.cost,
        start_defects=defects,
        trajectory=trajectory,
        cost=replay.cost,
        goal_error=replay.goal_error,
        defects=defects,
        max_penetration=max_penetration(world, trajectory),
        contacts=find_contacts(world, trajectory),
        replay=replay,
        scales=problem.scales,
        added_costs=replay.added_costs,
    )
