"""Analytical Integral Global Trajectory Optimization (AIGTO) with contact, on Drake."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drake_aigto.errors import AigtoError as AigtoError
    from drake_aigto.errors import ModelError as ModelError
    from drake_aigto.errors import OptionsError as OptionsError
    from drake_aigto.errors import OutputFileError as OutputFileError
    from drake_aigto.errors import PlanFileError as PlanFileError
    from drake_aigto.errors import ResultsFileError as ResultsFileError
    from drake_aigto.errors import ScenarioError as ScenarioError
    from drake_aigto.errors import StudyError as StudyError
    from drake_aigto.errors import TrajectoryError as TrajectoryError
    from drake_aigto.errors import UnsupportedTermError as UnsupportedTermError
    from drake_aigto.planning import Candidate as Candidate
    from drake_aigto.planning import Plan as Plan
    from drake_aigto.planning import Planner as Planner
    from drake_aigto.planning import PlanningError as PlanningError
    from drake_aigto.planning import PlanOptions as PlanOptions
    from drake_aigto.planning import plan as plan
    from drake_aigto.simulation import Replay as Replay
    from drake_aigto.simulation import replay_drake as replay_drake
    from drake_aigto.simulation import replay_event_driven as replay_event_driven
    from drake_aigto.solver import AigoDetails as AigoDetails
    from drake_aigto.solver import AigoOptions as AigoOptions
    from drake_aigto.solver import AigoSolver as AigoSolver
    from drake_aigto.solver import AigoStatus as AigoStatus
    from drake_aigto.trajectory import Trajectory as Trajectory
    from drake_aigto.world import Contact as Contact
    from drake_aigto.world import Scenario as Scenario
    from drake_aigto.world import World as World
    from drake_aigto.world import scenario_names as scenario_names

__version__ = "0.1.0"  # The only place that has it; the build reads it from here.

# Public name → module. Loaded on first use, so that `import drake_aigto` is quick.
_EXPORTS = {
    "AigoDetails": "drake_aigto.solver",
    "AigoOptions": "drake_aigto.solver",
    "AigoSolver": "drake_aigto.solver",
    "AigoStatus": "drake_aigto.solver",
    "AigtoError": "drake_aigto.errors",
    "ModelError": "drake_aigto.errors",
    "OptionsError": "drake_aigto.errors",
    "OutputFileError": "drake_aigto.errors",
    "PlanFileError": "drake_aigto.errors",
    "ResultsFileError": "drake_aigto.errors",
    "ScenarioError": "drake_aigto.errors",
    "StudyError": "drake_aigto.errors",
    "TrajectoryError": "drake_aigto.errors",
    "UnsupportedTermError": "drake_aigto.errors",
    "Candidate": "drake_aigto.planning",
    "Plan": "drake_aigto.planning",
    "PlanOptions": "drake_aigto.planning",
    "Planner": "drake_aigto.planning",
    "PlanningError": "drake_aigto.planning",
    "Replay": "drake_aigto.simulation",
    "Trajectory": "drake_aigto.trajectory",
    "plan": "drake_aigto.planning",
    "replay_drake": "drake_aigto.simulation",
    "replay_event_driven": "drake_aigto.simulation",
    "Contact": "drake_aigto.world",
    "Scenario": "drake_aigto.world",
    "World": "drake_aigto.world",
    "scenario_names": "drake_aigto.world",
}

__all__ = sorted(_EXPORTS)


def __getattr__(name: str) -> Any:
    """Imports a public name when it is first asked for."""
    if name not in _EXPORTS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_EXPORTS[name]), name)


def __dir__() -> list[str]:
    """Lists the public names, loaded or not."""
    return sorted({*globals(), *__all__})
