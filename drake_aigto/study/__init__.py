"""Studies of random scenarios, and of worlds with several contacts; with the truth beside them."""

from drake_aigto.study.method_run import MethodRun
from drake_aigto.study.scenario_question import ScenarioQuestion
from drake_aigto.study.scenario_results import ScenarioResult, ScenarioStudy
from drake_aigto.study.scenario_study import run_scenario_study
from drake_aigto.study.spread import Spread
from drake_aigto.study.world_scenarios import WORLDS, WorldStudy

__all__ = [
    "WORLDS",
    "MethodRun",
    "ScenarioQuestion",
    "ScenarioResult",
    "ScenarioStudy",
    "Spread",
    "WorldStudy",
    "run_scenario_study",
]
