"""From a scenario to a plan: search, polish, and replay on rigid walls."""

from drake_aigto.planning.literal import LiteralProblem
from drake_aigto.planning.options import PlanOptions, Rung
from drake_aigto.planning.plan import Candidate, Plan, PlanStats, Replays
from drake_aigto.planning.planner import Planner, PlanningError, make_problem, plan
from drake_aigto.planning.problem import PlanningProblem
from drake_aigto.planning.replay import (
    Replay,
    confirms,
    replay_costs,
    replay_drake,
    replay_event_driven,
)
from drake_aigto.planning.rigid import RigidProblem
from drake_aigto.planning.tracking import (
    Tracked,
    TrackingController,
    track_drake,
    track_event_driven,
)

__all__ = [
    "Candidate",
    "LiteralProblem",
    "Plan",
    "PlanOptions",
    "PlanStats",
    "Planner",
    "PlanningError",
    "PlanningProblem",
    "Replay",
    "Replays",
    "RigidProblem",
    "Rung",
    "Tracked",
    "TrackingController",
    "confirms",
    "make_problem",
    "plan",
    "replay_costs",
    "replay_drake",
    "replay_event_driven",
    "track_drake",
    "track_event_driven",
]
