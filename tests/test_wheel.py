"""An installed wheel has all that it needs, and works where nothing else is."""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import pytest

import drake_aigto
from drake_aigto import Planner, PlanOptions, Scenario

CHECKOUT = Path(drake_aigto.__file__).parents[1]
# Imports the installed package first, whatever else there is.
PRELUDE = "import sys; sys.path.insert(0, sys.argv[1])\n"

EVERY_MODULE = """
import importlib, pkgutil, drake_aigto
for module in pkgutil.walk_packages(drake_aigto.__path__, "drake_aigto."):
    importlib.import_module(module.name)
"""


def run_python(program: str, installed: Path, **environment: str) -> str:
    """Returns what a program prints that finds the installed package, but no checkout."""
    result = subprocess.run(
        [sys.executable, "-I", "-W", "error", "-c", PRELUDE + program, str(installed)],
        cwd=installed,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.strip()


def build(source: Path, target: Path, *options: str) -> Path:
    command = [sys.executable, "-m", "hatchling", "build", *options, "--directory", str(target)]
    subprocess.run(command, cwd=source, check=True, capture_output=True)
    return target


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(CHECKOUT, tmp_path_factory.mktemp("dist"))


def install(dist: Path, target: Path) -> Path:
    (wheel,) = dist.glob("*.whl")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run([*command, "--target", str(target), str(wheel)], check=True)
    return target


@pytest.fixture(scope="module")
def installed(dist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return install(dist, tmp_path_factory.mktemp("installed"))


def names_in_wheel(directory: Path) -> set[str]:
    (wheel,) = directory.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


@pytest.mark.slow
def test_wheel_has_the_models_and_nothing_beside_the_package(dist: Path) -> None:
    names = names_in_wheel(dist)
    models = CHECKOUT / "models"
    shipped = {
        f"drake_aigto/models/{path.relative_to(models).as_posix()}"
        for path in models.rglob("*")
        if path.is_file()
    }
    assert "drake_aigto/models/package.xml" in shipped <= names
    roots = {name.split("/")[0] for name in names}
    assert roots == {"drake_aigto", f"drake_aigto-{drake_aigto.__version__}.dist-info"}
    assert not [name for name in names if name.endswith((".pyc", ".nbc", ".nbi"))]


@pytest.mark.slow
def test_sdist_makes_the_same_wheel(dist: Path, tmp_path: Path) -> None:
    (sdist,) = dist.glob("*.tar.gz")
    # The tarfile module of some Pythons warns without a filter, that of others does not know one.
    subprocess.run(["tar", "-xzf", str(sdist), "-C", str(tmp_path)], check=True)
    source = tmp_path / sdist.name.removesuffix(".tar.gz")
    wheel = build(source, tmp_path / "dist", "--target", "wheel")
    assert names_in_wheel(wheel) == names_in_wheel(dist)


def test_models_have_the_version_of_the_package() -> None:
    version = ET.parse(CHECKOUT / "models" / "package.xml").findtext("version")
    assert version == drake_aigto.__version__


@pytest.mark.slow
def test_installed_wheel_finds_its_own_models(installed: Path) -> None:
    program = """
import numpy as np
from drake_aigto import Scenario, World
from drake_aigto.world import package_map
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
scenario = Scenario.named("table1/1")
plant = MultibodyPlant(time_step=0.0)
parser = Parser(plant)
parser.package_map().AddMap(package_map())
assert len(parser.AddModelsFromUrl(scenario.model)) == 1
world = World.from_scenario(scenario)
models = package_map().GetPath("drake_aigto_models")
print(models, *world.calc_signed_distance(np.array([1.0])), sep="|")
"""
    directory, distance = run_python(program, installed).split("|")
    assert Path(directory) == installed / "drake_aigto" / "models"
    assert float(distance) == pytest.approx(1.0)


@pytest.mark.slow
def test_installed_wheel_has_the_command(installed: Path) -> None:
    result = subprocess.run(
        [sys.executable, str(installed / "bin" / "drake-aigto"), "plan", "--help"],
        cwd=installed,
        env={**os.environ, "PYTHONPATH": str(installed)},
        capture_output=True,
        text=True,
        check=True,
    )
    # The scenarios that it names are those in the wheel.
    assert "table1/1" in result.stdout


@pytest.mark.slow
def test_pages_can_be_made_from_an_installed_wheel(installed: Path) -> None:
    program = """
from drake_aigto.show import Page
page = Page("title")
page.scenes({"scene": ("<html></html>", {})})
print(page.to_html().count("player-slider"))
"""
    assert int(run_python(program, installed)) > 1


@pytest.mark.slow
def test_every_module_imports_where_nothing_can_be_written(dist: Path, tmp_path: Path) -> None:
    installed = install(dist, tmp_path)
    # Files where folders should be stop root too, whom permissions do not.
    blocker = installed / "blocker"
    blocker.touch()
    for directory in {path.parent for path in (installed / "drake_aigto").rglob("*.py")}:
        for compiled in (directory / "__pycache__").glob("*"):
            compiled.unlink()
        (directory / "__pycache__").rmdir()
        (directory / "__pycache__").touch()
    nowhere = str(blocker / "none")
    program = f"{EVERY_MODULE}\nprint(type(drake_aigto.box.functions.factor_mean).__name__)"
    output = run_python(
        program, installed, HOME=nowhere, XDG_CACHE_HOME=nowhere, MPLCONFIGDIR=str(installed)
    )
    assert output == "CPUDispatcher"


@pytest.mark.slow
def test_numba_keeps_its_cache_where_it_is_told(installed: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    program = """
import numpy as np
from drake_aigto.box import factor_mean
factor_mean(0, 2, 1.0, 0.0, 3.0, 1.0, np.zeros(6))
"""
    run_python(program, installed, NUMBA_CACHE_DIR=str(cache))
    assert list(cache.rglob("functions.factor_mean-*.nbc"))


@pytest.mark.slow
def test_importing_has_no_side_effects(installed: Path) -> None:
    program = f"""
import logging, os, threading, warnings
def look():
    handlers = [str(handler) for handler in logging.getLogger().handlers]
    return dict(os.environ), os.getcwd(), sorted(os.listdir()), threading.active_count(), handlers
before = look()
{EVERY_MODULE}
import matplotlib
print(look() == before, matplotlib.rcParams == matplotlib.rcParamsDefault)
"""
    assert run_python(program, installed) == "True True"


FIRST_PLAN = """
import sys
from numba.core import event
from drake_aigto import Planner, PlanOptions, Scenario
from drake_aigto.kernels import tell_compilation
told = []
with event.install_recorder("numba:compile") as recorder, tell_compilation(told.append):
    plan = Planner(Scenario.named("table1/1"), PlanOptions(confirm=False)).plan()
print(plan.cost.hex(), len(recorder.buffer), *told)
"""


@pytest.mark.slow
def test_a_wheel_with_machine_code_compiles_nothing_and_plans_the_same(tmp_path: Path) -> None:
    if platform.machine() not in ("x86_64", "AMD64"):
        pytest.skip("machine code is made for x86-64 alone")
    # In a copy, as a build writes into its tree.
    source = tmp_path / "source"
    tracked = subprocess.run(
        ["git", "ls-files"], cwd=CHECKOUT, check=True, capture_output=True, text=True
    )
    for name in tracked.stdout.split("\n")[:-1]:
        if (CHECKOUT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(CHECKOUT / name, source / name)
    os.environ["DRAKE_AIGTO_MACHINE_CODE"] = "table1/1"
    try:
        (wheel,) = build(source, tmp_path / "dist", "--target", "wheel").glob("*.whl")
    finally:
        del os.environ["DRAKE_AIGTO_MACHINE_CODE"]
    assert "none-any" not in wheel.name
    installed = install(wheel.parent, tmp_path / "installed")

    def plan(number: int) -> list[str]:
        cache = tmp_path / f"cache{number}"
        return run_python(FIRST_PLAN, installed, NUMBA_CACHE_DIR=str(cache)).split(maxsplit=2)

    here = Planner(Scenario.named("table1/1"), PlanOptions(confirm=False)).plan().cost.hex()
    assert plan(0) == [here, "0"]
    # Of sources that were edited, and of other versions, it does not count.
    edited = installed / "drake_aigto" / "box" / "kernels.py"
    text = edited.read_text(encoding="utf-8")
    edited.write_text(f"{text}# edited\n", encoding="utf-8")
    cost, compiled, why = plan(1)
    assert cost == here and int(compiled) > 0
    assert why.startswith("the package's machine code is of other sources")
    edited.write_text(text, encoding="utf-8")
    manifest = installed / "drake_aigto" / "machine_code" / "manifest.json"
    versions = json.loads(manifest.read_text(encoding="utf-8"))
    manifest.write_text(json.dumps({**versions, "numba": "0.1"}), encoding="utf-8")
    for index in manifest.parent.glob("*.nbi"):
        index.unlink()
    _, _, why = plan(2)
    assert why.startswith("the package's machine code is for numba 0.1, not ")
