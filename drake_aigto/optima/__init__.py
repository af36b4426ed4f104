"""Exact optima, which no planner knows: what plans are judged by."""

from drake_aigto.optima.block_optimum import block_optimum
from drake_aigto.optima.masses_optimum import masses_optimum
from drake_aigto.optima.rigid_optimum import RigidOptimum, bounce_costs, rigid_optimum
from drake_aigto.optima.walls_optimum import ContactOptimum, KnownTouch, walls_optimum

__all__ = [
    "ContactOptimum",
    "KnownTouch",
    "RigidOptimum",
    "block_optimum",
    "bounce_costs",
    "masses_optimum",
    "rigid_optimum",
    "walls_optimum",
]
