"""A control alone, simulated: on exactly rigid walls, and in Drake; and the verdict on a plan."""

from drake_aigto.simulation.replay import (
    Replay,
    confirms,
    replay_costs,
    replay_drake,
    replay_event_driven,
)
from drake_aigto.simulation.simulator import make_simulator

__all__ = [
    "Replay",
    "confirms",
    "make_simulator",
    "replay_costs",
    "replay_drake",
    "replay_event_driven",
]
