"""Studies: questions × methods, run as jobs, judged, recorded, shown; random scenarios first."""

from benchmarks.study.scenario_question import MethodRun, ScenarioQuestion
from benchmarks.study.scenario_study import ScenarioResult, ScenarioStudy
from benchmarks.study.study import Call, Study, StudyQuestion

__all__ = [
    "Call",
    "MethodRun",
    "ScenarioQuestion",
    "ScenarioResult",
    "ScenarioStudy",
    "Study",
    "StudyQuestion",
]
