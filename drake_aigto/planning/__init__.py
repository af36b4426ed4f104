"""From a scenario to a plan: search, polish, and replay on rigid walls."""

from drake_aigto.planning.options import PlanOptions, Rung
from drake_aigto.planning.plan import Candidate, Plan, PlanStats, Replays
from drake_aigto.planning.planner import Planner, PlanningError, PlanningProblem, plan
from drake_aigto.planning.replay import (
    Replay,
    confirms,
    replay_drake,
    replay_event_driven,
)

__all__ = [
    "Candidate",
    "Plan",
    "PlanOptions",
    "PlanStats",
    "Planner",
    "PlanningError",
    "PlanningProblem",
    "Replay",
    "Replays",
    "Rung",
    "confirms",
    "plan",
    "replay_drake",
    "replay_event_driven",
]
