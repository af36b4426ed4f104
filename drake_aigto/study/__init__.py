"""Studies of random scenarios, and of worlds with several contacts; with the truth beside them."""

from drake_aigto.study.method_run import MethodRun
from drake_aigto.study.scenario_question import ScenarioQuestion
from drake_aigto.study.scenario_results import ScenarioResult, ScenarioStudy
from drake_aigto.study.scenario_study import run_scenario_study
from drake_aigto.study.spread import Spread
from drake_aigto.study.table1 import (
    PAPER_COSTS,
    ROWS,
    Cell,
    Entry,
    Method,
    RigidCell,
    Table1,
    run_cell,
    run_rigid_cell,
    run_table1,
)
from drake_aigto.study.workers import open_workers
from drake_aigto.study.world_scenarios import WORLDS, WorldStudy

__all__ = [
    "PAPER_COSTS",
    "ROWS",
    "WORLDS",
    "Cell",
    "Entry",
    "Method",
    "MethodRun",
    "RigidCell",
    "ScenarioQuestion",
    "ScenarioResult",
    "ScenarioStudy",
    "Spread",
    "Table1",
    "WorldStudy",
    "open_workers",
    "run_cell",
    "run_rigid_cell",
    "run_scenario_study",
    "run_table1",
]
