"""Studies of random scenarios: methods on each, run as jobs, judged, recorded, shown."""

from benchmarks.study.scenario_question import MethodRun as MethodRun
from benchmarks.study.scenario_question import ScenarioQuestion as ScenarioQuestion
from benchmarks.study.scenario_study import ScenarioResult as ScenarioResult
from benchmarks.study.scenario_study import ScenarioStudy as ScenarioStudy
