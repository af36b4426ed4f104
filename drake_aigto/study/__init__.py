"""Studies of random scenarios, with the truth beside them."""

from drake_aigto.study.method_run import MethodRun
from drake_aigto.study.scenario_question import ScenarioQuestion
from drake_aigto.study.scenario_results import ScenarioResult, ScenarioStudy
from drake_aigto.study.scenario_study import run_scenario_study
from drake_aigto.study.spread import Spread

__all__ = [
    "MethodRun",
    "ScenarioQuestion",
    "ScenarioResult",
    "ScenarioStudy",
    "Spread",
    "run_scenario_study",
]
