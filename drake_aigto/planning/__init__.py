"""From a scenario to a plan: search, polish, and replay on rigid walls."""

from drake_aigto.planning.candidate import Candidate, Replays, Veto
from drake_aigto.planning.coarse import coarsen
from drake_aigto.planning.mechanism_boxes import (
    Center,
    MechanismBoxes,
    MechanismRung,
    Renewal,
    StartedBoxes,
)
from drake_aigto.planning.mechanism_options import MechanismOptions, needs_shooting
from drake_aigto.planning.mechanism_phases import BouncingResult, find_deepest, lay_onto
from drake_aigto.planning.mechanism_problem import MechanismProblem
from drake_aigto.planning.mechanism_search import MechanismSearch
from drake_aigto.planning.options import LadderOptions, PlanOptions, Rung, SearchOptions
from drake_aigto.planning.origin import Origin
from drake_aigto.planning.plan import Plan, PlanningError, PlanStats
from drake_aigto.planning.planner import Planner, plan, run_search
from drake_aigto.planning.pool import Stopwatch
from drake_aigto.planning.problem import PlanningProblem
from drake_aigto.planning.rigid import RigidProblem, make_problem
from drake_aigto.planning.rigid_mechanism import RigidMechanismProblem
from drake_aigto.planning.rigid_mechanism_search import RigidMechanismSearch
from drake_aigto.planning.rigid_search import RigidSearch
from drake_aigto.planning.search import Search

__all__ = [
    "BouncingResult",
    "Candidate",
    "Center",
    "LadderOptions",
    "MechanismBoxes",
    "MechanismOptions",
    "MechanismProblem",
    "MechanismRung",
    "MechanismSearch",
    "Origin",
    "Plan",
    "PlanOptions",
    "PlanStats",
    "Planner",
    "PlanningError",
    "PlanningProblem",
    "Renewal",
    "Replays",
    "RigidMechanismProblem",
    "RigidMechanismSearch",
    "RigidProblem",
    "RigidSearch",
    "Rung",
    "Search",
    "SearchOptions",
    "StartedBoxes",
    "Stopwatch",
    "Veto",
    "coarsen",
    "find_deepest",
    "lay_onto",
    "make_problem",
    "needs_shooting",
    "plan",
    "run_search",
]
