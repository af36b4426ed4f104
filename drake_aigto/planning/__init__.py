"""From a scenario to a plan: search, refinement, and replay on rigid walls."""

from drake_aigto.planning.balls.phases import coarsen
from drake_aigto.planning.balls.search import BallSearch
from drake_aigto.planning.balls.task import BallTask, make_ball_task
from drake_aigto.planning.candidate import Candidate, Origin, Replays, Veto
from drake_aigto.planning.mechanisms.boxes import Center, MechanismBoxes, StartedBoxes
from drake_aigto.planning.mechanisms.phases import BouncingResult, find_deepest, lay_onto
from drake_aigto.planning.mechanisms.rigid_search import RigidMechanismSearch
from drake_aigto.planning.mechanisms.rigid_task import RigidMechanismTask, make_mechanism_task
from drake_aigto.planning.mechanisms.search import MechanismSearch
from drake_aigto.planning.mechanisms.task import MechanismTask
from drake_aigto.planning.options import PlanOptions, SearchOptions
from drake_aigto.planning.plan import Plan, PlanningError, PlanStats
from drake_aigto.planning.planner import Planner, needs_shooting, plan, run_search, start_search
from drake_aigto.planning.program_task import ProgramTask
from drake_aigto.planning.rungs import (
    BALL_LADDER,
    MECHANISM_LADDER,
    MechanismRung,
    Renewal,
    Rung,
)
from drake_aigto.planning.search import Proposal, Search, Stopwatch
from drake_aigto.planning.sequence_search import SequenceSearch

__all__ = [
    "BALL_LADDER",
    "MECHANISM_LADDER",
    "BallSearch",
    "BallTask",
    "BouncingResult",
    "Candidate",
    "Center",
    "MechanismBoxes",
    "MechanismRung",
    "MechanismSearch",
    "MechanismTask",
    "Origin",
    "Plan",
    "PlanOptions",
    "PlanStats",
    "Planner",
    "PlanningError",
    "ProgramTask",
    "Proposal",
    "Renewal",
    "Replays",
    "RigidMechanismSearch",
    "RigidMechanismTask",
    "Rung",
    "Search",
    "SearchOptions",
    "SequenceSearch",
    "StartedBoxes",
    "Stopwatch",
    "Veto",
    "coarsen",
    "find_deepest",
    "lay_onto",
    "make_ball_task",
    "make_mechanism_task",
    "needs_shooting",
    "plan",
    "run_search",
    "start_search",
]
