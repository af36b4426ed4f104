"""What runs a plan, or plans again: LeafSystems, and feedback in simulations of our own."""

from drake_aigto.control.closed_loop import run_in_loop
from drake_aigto.control.disturbance import Disturbance
from drake_aigto.control.feedback import (
    Feedback,
    FlightFeedback,
    KnotFeedback,
    Tracked,
    make_feedback,
    track_drake,
    track_event_driven,
)
from drake_aigto.control.loop_run import ClosedLoopRun, PlannedPath, PlanSwitch
from drake_aigto.control.predictive import ModelPredictiveController, TickStatus
from drake_aigto.control.tracking import TrackingController

__all__ = [
    "ClosedLoopRun",
    "Disturbance",
    "Feedback",
    "FlightFeedback",
    "KnotFeedback",
    "ModelPredictiveController",
    "PlanSwitch",
    "PlannedPath",
    "TickStatus",
    "Tracked",
    "TrackingController",
    "make_feedback",
    "run_in_loop",
    "track_drake",
    "track_event_driven",
]
