"""Studies: the paper's Table I, with the truth beside it."""

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

__all__ = [
    "PAPER_COSTS",
    "ROWS",
    "Cell",
    "Entry",
    "Method",
    "RigidCell",
    "RigidOptimum",
    "Table1",
    "rigid_optimum",
    "run_cell",
    "run_rigid_cell",
    "run_table1",
]
