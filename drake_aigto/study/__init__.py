"""Studies: Table I, random scenarios, worlds with several contacts; with the truth beside them."""

from drake_aigto.study.block_optimum import block_optimum
from drake_aigto.study.masses_optimum import masses_optimum
from drake_aigto.study.method_run import MethodRun
from drake_aigto.study.rigid_optimum import RigidOptimum, bounce_costs, rigid_optimum
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
from drake_aigto.study.walls_optimum import ContactOptimum, KnownTouch, walls_optimum
from drake_aigto.study.workers import Workers
from drake_aigto.study.world_scenarios import WORLDS, WorldStudy

__all__ = [
    "PAPER_COSTS",
    "ROWS",
    "WORLDS",
    "Cell",
    "ContactOptimum",
    "Entry",
    "KnownTouch",
    "Method",
    "MethodRun",
    "RigidCell",
    "RigidOptimum",
    "ScenarioQuestion",
    "ScenarioResult",
    "ScenarioStudy",
    "Spread",
    "Table1",
    "Workers",
    "WorldStudy",
    "block_optimum",
    "bounce_costs",
    "masses_optimum",
    "rigid_optimum",
    "run_cell",
    "run_rigid_cell",
    "run_scenario_study",
    "run_table1",
    "walls_optimum",
]
