"""Studies: the paper's Table I and worlds with several contacts, with the truth beside them."""

from drake_aigto.study.block_optimum import block_optimum
from drake_aigto.study.masses_optimum import masses_optimum
from drake_aigto.study.rigid_optimum import RigidOptimum, rigid_optimum
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
    "RigidCell",
    "RigidOptimum",
    "Table1",
    "WorldStudy",
    "block_optimum",
    "masses_optimum",
    "rigid_optimum",
    "run_cell",
    "run_rigid_cell",
    "run_table1",
    "walls_optimum",
]
