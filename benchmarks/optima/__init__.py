"""Exact optima, which no planner knows: what plans are judged by."""

from benchmarks.optima.block_optimum import block_optimum
from benchmarks.optima.masses_optimum import masses_optimum
from benchmarks.optima.walls_optimum import ContactOptimum, KnownTouch, walls_optimum

__all__ = ["ContactOptimum", "KnownTouch", "block_optimum", "masses_optimum", "walls_optimum"]
