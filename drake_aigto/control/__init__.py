"""Controllers that run a plan, or plan again: LeafSystems, and feedback in our own simulations."""

from typing import Any

import lazy_loader

# Loaded when first used: the planner behind them takes a second.
_find, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# Names of the past, and what stands for them now.
_GONE = {
    "Regulator": "planning.Regulator",
    "Sweep": "planning.Sweep",
    **dict.fromkeys(
        ("Feedback", "FlightFeedback", "KnotFeedback", "PhaseFeedback", "make_feedback"),
        "planning.Feedback, one law for every plan",
    ),
    "track_drake": "simulation.replay_with(DRAKE, …)",
    "track_event_driven": "simulation.replay_with(EVENT_DRIVEN, …)",
}


def __getattr__(name: str) -> Any:
    """Returns a public name; of one that is gone, says where it is now."""
    if name in _GONE:
        raise ImportError(f"drake_aigto.control.{name} is gone: use {_GONE[name]}.")
    return _find(name)
