"""What runs a plan: feedback through its bounces, in a Diagram or in simulations of one's own."""

from drake_aigto.control.feedback import (
    Feedback,
    FlightFeedback,
    KnotFeedback,
    Tracked,
    make_feedback,
    track_drake,
    track_event_driven,
)
from drake_aigto.control.tracking import TrackingController

__all__ = [
    "Feedback",
    "FlightFeedback",
    "KnotFeedback",
    "Tracked",
    "TrackingController",
    "make_feedback",
    "track_drake",
    "track_event_driven",
]
