"""From a scenario to a plan: search, refinement, and replay on rigid walls."""

from typing import Any

from drake_aigto.planning.balls.arc_program import ArcPrograms
from drake_aigto.planning.balls.arcs import Arcs, solve_in_arcs
from drake_aigto.planning.balls.branching import find_grazes, find_insertions
from drake_aigto.planning.balls.phases import Path, PhaseMotion, PhaseProblem, coarsen
from drake_aigto.planning.balls.search import BallSearch
from drake_aigto.planning.balls.shots import draw_shots
from drake_aigto.planning.balls.task import BallTask, make_ball_task
from drake_aigto.planning.balls.timeline import straight_path
from drake_aigto.planning.candidate import (
    COASTING,
    LARGEST_DEFECT,
    Candidate,
    Origin,
    Replays,
    Veto,
    sample,
)
from drake_aigto.planning.feedback import Feedback, Regulator, calc_divergence
from drake_aigto.planning.mechanisms.closing import COARSE, Aim, close_gaps, find_tight
from drake_aigto.planning.mechanisms.guesses import Guess, Guesses, Measures
from drake_aigto.planning.mechanisms.phased_task import find_deepest, keep_off
from drake_aigto.planning.mechanisms.phases import (
    in_order,
    is_closed,
    lay_onto,
    lay_out,
    make_trajectory,
)
from drake_aigto.planning.mechanisms.reaches import Reaches
from drake_aigto.planning.mechanisms.rigid_task import RigidMechanismTask, make_mechanism_task
from drake_aigto.planning.mechanisms.search import MechanismSearch
from drake_aigto.planning.mechanisms.settling import settle, steady
from drake_aigto.planning.mechanisms.task import MechanismTask, soften
from drake_aigto.planning.mechanisms.touches import drop, lead_over_edges, list_mode_changes
from drake_aigto.planning.mechanisms.traces import (
    add_impulses,
    find_rates,
    integrate_rates,
    replay_at_knots,
    trace,
)
from drake_aigto.planning.options import (
    BALL_LADDER,
    LocalSolverName,
    PlanOptions,
    Rung,
    SearchOptions,
    needs_shooting,
)
from drake_aigto.planning.plan import VIEWS, Plan, PlanningError, PlanStats
from drake_aigto.planning.planner import Planner, plan, run_search
from drake_aigto.planning.program_task import ProgramTask
from drake_aigto.planning.programs import ProgramSolution
from drake_aigto.planning.riccati import FeedbackPhase, Sweep
from drake_aigto.planning.search import Progress, Proposal, Search, Stopwatch
from drake_aigto.planning.sequence_search import (
    SequenceSearch,
    is_same,
    kinds,
    neighbors,
    read_sequences,
    retimed,
    swapped,
)
from drake_aigto.planning.stretches import Cut, is_at_rest_on
from drake_aigto.planning.tracked import needs_feedback

__all__ = [
    "BALL_LADDER",
    "COARSE",
    "COASTING",
    "LARGEST_DEFECT",
    "VIEWS",
    "Aim",
    "ArcPrograms",
    "Arcs",
    "BallSearch",
    "BallTask",
    "Candidate",
    "Cut",
    "Feedback",
    "FeedbackPhase",
    "Guess",
    "Guesses",
    "LocalSolverName",
    "Measures",
    "MechanismSearch",
    "MechanismTask",
    "Origin",
    "Path",
    "PhaseMotion",
    "PhaseProblem",
    "Plan",
    "PlanOptions",
    "PlanStats",
    "Planner",
    "PlanningError",
    "ProgramSolution",
    "ProgramTask",
    "Progress",
    "Proposal",
    "Reaches",
    "Regulator",
    "Replays",
    "RigidMechanismTask",
    "Rung",
    "Search",
    "SearchOptions",
    "SequenceSearch",
    "Stopwatch",
    "Sweep",
    "Veto",
    "add_impulses",
    "calc_divergence",
    "close_gaps",
    "coarsen",
    "draw_shots",
    "drop",
    "find_deepest",
    "find_grazes",
    "find_insertions",
    "find_rates",
    "find_tight",
    "in_order",
    "integrate_rates",
    "is_at_rest_on",
    "is_closed",
    "is_same",
    "keep_off",
    "kinds",
    "lay_onto",
    "lay_out",
    "lead_over_edges",
    "list_mode_changes",
    "make_ball_task",
    "make_mechanism_task",
    "make_trajectory",
    "needs_feedback",
    "needs_shooting",
    "neighbors",
    "plan",
    "read_sequences",
    "replay_at_knots",
    "retimed",
    "run_search",
    "sample",
    "settle",
    "soften",
    "solve_in_arcs",
    "steady",
    "straight_path",
    "swapped",
    "trace",
]

# Names of the past, and what stands for them now.
_GONE = {
    **dict.fromkeys(("Center", "MechanismBoxes"), "Guess and Guesses: mechanisms have no boxes"),
    **dict.fromkeys(("MECHANISM_LADDER", "MechanismRung"), "PlanOptions(starts=…)"),
    "Renewal": "Guesses.renew",
}


def __getattr__(name: str) -> Any:
    """Says of a public name that is gone where it is now."""
    if name in _GONE:
        raise ImportError(f"drake_aigto.planning.{name} is gone: use {_GONE[name]}.")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
