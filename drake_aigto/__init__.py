"""Analytical Integral Global Trajectory Optimization (AIGTO) with contact, on Drake."""

from typing import Any

import lazy_loader

__version__ = "0.1.0"  # The only place that has it; the build reads it from here.

# Public names are in the stub beside; each is loaded when it is first used.
_find, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# Names of the past, and what stands for them now.
_MOVED = {
    **dict.fromkeys(
        [
            "ControlError",
            "FrictionError",
            "ModelError",
            "OptionsError",
            "OutputFileError",
            "PlanFileError",
            "ProgramError",
            "ResultsFileError",
            "ScenarioError",
            "StudyError",
            "TrajectoryError",
            "UnsupportedTermError",
        ],
        "errors",
    ),
    **{"AigoDetails": "solver", "AigoStatus": "solver", "Answer": "jobs", "Candidate": "planning"},
    **{"Contact": "dynamics", "Replay": "simulation", "Trajectory": "trajectory"},
}
_GONE = {
    "MechanismOptions": "PlanOptions, for every world",
    **{name: f"drake_aigto.{room}.{name}" for name, room in _MOVED.items()},
}


def __getattr__(name: str) -> Any:
    """Returns a public name; of one that is gone, says where it is now."""
    if name in _GONE:
        raise ImportError(f"drake_aigto.{name} is gone: use {_GONE[name]}.")
    return _find(name)
