"""What runs a plan, or plans again: LeafSystems, and feedback in simulations of our own."""

from drake_aigto.control.closed_loop import run_in_loop
from drake_aigto.control.disturbance import Disturbance
from drake_aigto.control.feedback import (
    Feedback,
    FlightFeedback,
    KnotFeedback,
    Tracked,
    track_drake,
    track_event_driven,
)
from drake_aigto.control.laws import make_feedback
from drake_aigto.control.loop_run import ClosedLoopRun, PlannedPath, PlanSwitch, is_run
from drake_aigto.control.phase_feedback import PhaseFeedback
from drake_aigto.control.predictive import ModelPredictiveController, TickStatus
from drake_aigto.control.tracking import TrackingController

__all__ = [
    "ClosedLoopRun",
    "Disturbance",
    "Feedback",
    "FlightFeedback",
    "KnotFeedback",
    "ModelPredictiveController",
    "PhaseFeedback",
    "PlanSwitch",
    "PlannedPath",
    "TickStatus",
    "Tracked",
    "TrackingController",
    "is_run",
    "make_feedback",
    "run_in_loop",
    "track_drake",
    "track_event_driven",
]
