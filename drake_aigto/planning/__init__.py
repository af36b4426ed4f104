"""From a scenario to a plan: search, polish, and replay on rigid walls."""

from drake_aigto.planning.literal import LiteralProblem
from drake_aigto.planning.options import PlanOptions, Rung
from drake_aigto.planning.origin import Origin
from drake_aigto.planning.plan import Candidate, Plan, PlanStats, Replays
from drake_aigto.planning.planner import Planner, PlanningError, make_problem, plan
from drake_aigto.planning.problem import PlanningProblem
from drake_aigto.planning.rigid import RigidProblem

__all__ = [
    "Candidate",
    "LiteralProblem",
    "Origin",
    "Plan",
    "PlanOptions",
    "PlanStats",
    "Planner",
    "PlanningError",
    "PlanningProblem",
    "Replays",
    "RigidProblem",
    "Rung",
    "make_problem",
    "plan",
]
