"""What runs a plan, or plans again: LeafSystems, and feedback in simulations of our own."""

from drake_aigto.control.feedback import (
    Feedback,
    FlightFeedback,
    KnotFeedback,
    Tracked,
    make_feedback,
    track_drake,
    track_event_driven,
)
from drake_aigto.control.predictive import ModelPredictiveController, TickStatus
from drake_aigto.control.tracking import TrackingController

__all__ = [
    "Feedback",
    "FlightFeedback",
    "KnotFeedback",
    "ModelPredictiveController",
    "TickStatus",
    "Tracked",
    "TrackingController",
    "make_feedback",
    "track_drake",
    "track_event_driven",
]
