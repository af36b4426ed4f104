"""Settings that all tests share."""

from __future__ import annotations

import os

# Tests run in a process on each core, where more threads of BLAS would spin while they wait.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import dataclasses
import signal
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from other_models import ARM, GANTRY, make, write
from pydrake.geometry import Meshcat
from world_models import ModelWriter

from drake_aigto import Plan, Planner, PlanOptions, Scenario, World
from drake_aigto.show import report_plan

# No deadlines: Numba compiles in whichever example comes first, and machines stall. The same
# examples every time: a test that fails fails again.
settings.register_profile("drake_aigto", deadline=None, derandomize=True, max_examples=12)
settings.load_profile("drake_aigto")

# A shell that starts tests in the background has Ctrl-C ignored, which some of them test.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


# Files whose tests compile longest: shooting in the plane and in space, with those that compile
# parts of it alone, which takes a sixth as long where all is known; the solver, certificates.
SHOOTING = ("mechanism_planner", "reaches", "tree_shooting", "shooting", "cli")
OF_SHOOTING = ("shooting_phases", "held_friction")
SOLVING = ("certify", "presolve")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Has one process begin with what compiles one half, and the next one with the other half.

    Of N tests, pytest-xdist gives each of W processes N / (4 W) in a row to begin with.
    """
    first, second, rest = list[pytest.Item](), list[pytest.Item](), list[pytest.Item]()
    for item in items:
        name = item.path.stem.removeprefix("test_")
        in_first, in_second = name in SHOOTING + OF_SHOOTING, name in SOLVING
        (first if in_first else second if in_second else rest).append(item)
    workers = getattr(config, "workerinput", {"workercount": 1})["workercount"]
    left = max(len(items) // (4 * workers) - len(first), 0)
    items[:] = [*first, *rest[:left], *second, *rest[left:]]


@pytest.fixture
def write_model(tmp_path: Path) -> ModelWriter:
    return ModelWriter(tmp_path)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return Scenario.named("table1/1")


@pytest.fixture(scope="module")
def world(scenario: Scenario) -> World:
    return World.from_scenario(scenario)


@pytest.fixture
def axes() -> Axes:
    return Figure().add_subplot()


@pytest.fixture(scope="module")
def meshcat() -> Meshcat:
    return Meshcat()


@pytest.fixture(scope="session")
def plan() -> Plan:
    scenario = dataclasses.replace(Scenario.named("table1/1"), time_step=0.05)
    return Planner(scenario, PlanOptions(aigo_steps=20, finalists=1)).plan()


@pytest.fixture(scope="session")
def plan_file(plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plans") / "plan.json"
    plan.save(path)
    return path


@pytest.fixture(scope="session")
def report(plan: Plan) -> tuple[str, list[str]]:
    """The page of the quick plan, and the lines of progress while it was made."""
    lines: list[str] = []
    return report_plan(plan, progress=lines.append), lines


@pytest.fixture
def arm(tmp_path: Path) -> Any:
    def make_arm(fields: dict[str, Any] | None = None, **parts: str) -> World:
        return make(write(tmp_path / "arm.xml", ARM, **parts), **(fields or {}))

    return make_arm


@pytest.fixture
def gantry(tmp_path: Path) -> Any:
    def make_gantry(fields: dict[str, Any] | None = None, **parts: str) -> World:
        return make(write(tmp_path / "gantry.urdf", GANTRY, **parts), **(fields or {}))

    return make_gantry
