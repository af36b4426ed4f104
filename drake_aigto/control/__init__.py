"""What runs a plan: feedback that tracks it through its bounces."""

from drake_aigto.control.tracking import (
    Tracked,
    TrackingController,
    track_drake,
    track_event_driven,
)

__all__ = ["Tracked", "TrackingController", "track_drake", "track_event_driven"]
