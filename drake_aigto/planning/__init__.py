"""From a scenario to a plan: search, polish, and replay on rigid walls."""

from drake_aigto.planning.options import PlanOptions, Rung
from drake_aigto.planning.plan import Candidate, Plan, PlanStats, Replays
from drake_aigto.planning.planner import Planner, PlanningError, plan
from drake_aigto.planning.problem import PlanningProblem, make_transcription
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
    "make_transcription",
    "plan",
    "replay_drake",
    "replay_event_driven",
]
