"""All baselines by name, and how to run one."""

from __future__ import annotations

import difflib
import math
import time
from collections.abc import Callable, Iterable, Mapping
from importlib.util import find_spec
from types import MappingProxyType

import numpy as np

from benchmarks.baselines.baseline import Baseline, BaselineRun, Recorder
from benchmarks.baselines.gradient import Enumeration, GradientBaseline, Smoothing
from benchmarks.baselines.sampling import (
    CovarianceAdaptation,
    CrossEntropy,
    DualAnnealing,
    PathIntegral,
)
from drake_aigto.errors import MissingExtraError, OptionsError
from drake_aigto.world import Scenario, World

_ALL: tuple[Baseline, ...] = (
    GradientBaseline("snopt"),
    GradientBaseline("ipopt"),
    GradientBaseline("snopt", is_literal=True),
    GradientBaseline("ipopt", is_literal=True),
    Smoothing(),
    Smoothing(is_polished=True),
    CovarianceAdaptation(),
    CrossEntropy(),
    PathIntegral(),
    DualAnnealing(),
    Enumeration(),
)

BASELINES: Mapping[str, Baseline] = MappingProxyType({each.name: each for each in _ALL})


def check_baselines(names: Iterable[str]) -> None:
    """Checks that there are baselines of these names, and the libraries that they need.

    Raises:
        OptionsError: there is none of a name.
        MissingExtraError: a library is not installed.
    """
    for name in names:
        if name not in BASELINES:
            close = difflib.get_close_matches(name, BASELINES, n=1)
            raise OptionsError(
                f"unknown baseline {name!r}",
                expected=f"one of {', '.join(BASELINES)}",
                hint=f"Did you mean {close[0]!r}?" if close else None,
            )
        for module in BASELINES[name].modules:
            if find_spec(module) is None:
                raise MissingExtraError(f"the baseline {name!r}", module, "bench")


def run_baseline(
    name: str,
    world: World,
    scenario: Scenario,
    seconds: float,
    seed: int = 0,
    good_enough: float = -math.inf,
    clock: Callable[[], float] = time.process_time,
) -> BaselineRun:
    """Lets a baseline of `BASELINES` search for so many seconds of one core (`Recorder`).

    The same seed makes the same offers in the same order; with more time there are more of them. A
    cost that is good enough ends it early.

    Raises:
        OptionsError: an unknown name, or seconds that are no positive number.
        MissingExtraError: a library that this baseline needs is not installed.
        ModelError: the baseline can't treat this world.
        ScenarioError: the scenario does not fit the world.
    """
    check_baselines([name])
    recorder = Recorder(world, scenario, seconds, good_enough, clock)
    BASELINES[name].search(recorder, np.random.default_rng(seed))
    return recorder.finish(name)
