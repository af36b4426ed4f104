"""What people would use instead, on the same scenarios and under the same verdict."""

from benchmarks.baselines.baseline import Baseline, BaselineRun, Improvement, Recorder
from benchmarks.baselines.registry import BASELINES, check_baselines, run_baseline
from benchmarks.baselines.sampling import weigh

__all__ = [
    "BASELINES",
    "Baseline",
    "BaselineRun",
    "Improvement",
    "Recorder",
    "check_baselines",
    "run_baseline",
    "weigh",
]
