"""The road: a package imports only from those before it, and importing ours is quick."""

from __future__ import annotations

import ast
import functools
import graphlib
import importlib
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import pytest

import drake_aigto
from drake_aigto import code_cache


@functools.cache
def statements(source: str) -> tuple[ast.Import | ast.ImportFrom | ast.ClassDef, ...]:
    kinds = ast.Import, ast.ImportFrom, ast.ClassDef
    return tuple(node for node in ast.walk(ast.parse(source)) if isinstance(node, kinds))


@functools.cache
def imported_modules(source: str, package: str) -> tuple[str, ...]:
    names: list[str] = []
    for node in statements(source):
        if isinstance(node, ast.Import):
            names += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parents = package.split(".")[: len(package.split(".")) - node.level + 1]
            base = ".".join([*(parents if node.level else []), *filter(None, [node.module])])
            names += (f"{base}.{alias.name}" for alias in node.names)
    return tuple(names)


def import_graph(root: Path) -> dict[str, set[str]]:
    """Returns the modules that each module of a package imports, for type checkers alone too.

    A package's door is a module of its own, with what its stub imports. That of the package itself
    is left out, as it passes on names of all.
    """
    graph: dict[str, set[str]] = {}
    for path in sorted([*root.rglob("*.py"), *root.rglob("*.pyi")]):
        parts = path.relative_to(root.parent).with_suffix("").parts
        module = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        source = path.read_text(encoding="utf-8")
        graph.setdefault(module, set()).update(imported_modules(source, ".".join(parts[:-1])))
    del graph[root.name]
    return {
        module: {found for name in names for found in [_module_of(name, graph)] if found}
        for module, names in graph.items()
    }


def _module_of(name: str, modules: dict[str, set[str]]) -> str | None:
    """Returns the module that a dotted name is, or is in."""
    while name and name not in modules:
        name = name.rpartition(".")[0]
    return name or None


PACKAGE = Path(drake_aigto.__file__).parent
ROAD = (
    "errors",
    "progress",
    "plain",
    "arrays",
    "code_cache",
    "kernels",
    "linear",
    "terms",
    "dynamics",
    "geometry",
    "world",
    "trajectory",
    "contact",
    "simulation",
    "transcription",
    "box",
    "aigo",
    "local",
    "shooting",
    "certify",
    "solver",
    "planning",
    "jobs",
    "paper",
    "control",
    "show",
    "cli",
)
# These only pass on what others hold.
DOORS = ("__init__", "__main__")


def place(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def steps_imported(source: str, package: str = "drake_aigto") -> set[str]:
    names = (name.split(".") for name in imported_modules(source, package))
    return {name[1] for name in names if name[0] == "drake_aigto" and len(name) > 1}


FILES = [path for path in sorted(PACKAGE.glob("**/*.py")) if place(path) not in DOORS]


def test_a_step_imports_only_from_itself_and_those_before_it() -> None:
    for path in FILES:
        step = place(path)
        assert step in ROAD, f"{step} has no place on the road: add it to ROAD where it belongs"
        package = ".".join(["drake_aigto", *path.relative_to(PACKAGE).parts[:-1]])
        allowed = {*ROAD[: ROAD.index(step) + 1], "__version__"}
        source = path.read_text(encoding="utf-8")
        assert steps_imported(source, package) <= allowed, path
        # An installed wheel has nothing of a checkout.
        roots = {name.split(".")[0] for name in imported_modules(source, package)}
        assert roots.isdisjoint({"benchmarks", "tests"}), path


@pytest.mark.parametrize(
    "source",
    [
        "import drake_aigto.planning.plan",
        "from drake_aigto.planning import plan",
        "from drake_aigto import planning",
        "from ..planning import plan",
        "from .. import planning",
        "def later():\n    from drake_aigto.planning.plan import plan",
    ],
)
def test_an_import_is_seen_in_every_spelling(source: str) -> None:
    assert steps_imported(source, "drake_aigto.world") == {"planning"}


ROOMS = sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py"))
CHECKOUT = PACKAGE.parent
OUTSIDE = [*CHECKOUT.glob("tests/*.py"), *CHECKOUT.glob("benchmarks/**/*.py")]


def names_of_door(room: str) -> set[str]:
    door = PACKAGE / room / "__init__.pyi"
    door = door if door.exists() else door.with_suffix(".py")
    tree = ast.parse(door.read_text(encoding="utf-8"))
    imports = (node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom))
    return {alias.asname or alias.name for node in imports for alias in node.names}


NAMES = {room: names_of_door(room) for room in ROOMS}


def past_doors(source: str, package: str) -> list[str]:
    """Returns what a file imports of rooms other than its own that their doors do not name."""
    found = []
    for name in imported_modules(source, package):
        parts = name.split(".")
        if parts[0] == "drake_aigto" and len(parts) > 2 and parts[1] in ROOMS:
            is_own = package.split(".")[:2] == parts[:2]
            is_named = len(parts) == 3 and (parts[2] in NAMES[parts[1]] or parts[2] == "*")
            if not (is_own or is_named):
                found.append(name)
    return found


def test_nothing_is_imported_past_a_rooms_door() -> None:
    found = {}
    for path in (*FILES, *OUTSIDE):
        package = ".".join(path.relative_to(CHECKOUT).parts[:-1])
        if past := past_doors(path.read_text(encoding="utf-8"), package):
            found[str(path.relative_to(CHECKOUT))] = past
    assert found == {}


@pytest.mark.parametrize(
    "source",
    [
        "from drake_aigto.box.tapes import TapeBuilder",
        "from drake_aigto.box import tapes",
        "def later():\n    import drake_aigto.box.tapes",
    ],
)
def test_imports_past_a_door_are_found(source: str) -> None:
    assert past_doors(source, "drake_aigto.aigo") and not past_doors(source, "drake_aigto.box")
    assert not past_doors("from drake_aigto.box import BoxPolynomial", "tests")


def test_no_files_import_each_other_in_a_circle() -> None:
    graphlib.TopologicalSorter(import_graph(PACKAGE)).prepare()  # Raises with the circle.


def test_a_circle_is_found_behind_a_door_and_for_type_checkers(tmp_path: Path) -> None:
    sources = {
        "__init__.py": "from little.room import thing",
        "room/__init__.pyi": "from .inner import thing as thing",
        "room/inner.py": "if TYPE_CHECKING:\n    from little.other import Other",
        "other.py": "def later():\n    from little.room import thing",
    }
    for name, source in sources.items():
        path = tmp_path / "little" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(source, encoding="utf-8")
    with pytest.raises(graphlib.CycleError) as error:
        graphlib.TopologicalSorter(import_graph(tmp_path / "little")).prepare()
    assert set(error.value.args[1]) == {"little.room", "little.room.inner", "little.other"}


# What a program imports, one statement after another, and what is not yet loaded after it.
PROGRAMS = {
    "from the top": [
        ("import drake_aigto", "pydrake numpy scipy numba matplotlib"),
        ("import drake_aigto.cli.command_line", "pydrake numpy"),
        ("import drake_aigto.cli.command_line", "pydrake"),
        ("from drake_aigto import Scenario, World", "pydrake.all numba matplotlib"),
        ("from drake_aigto import Planner", "pydrake.all matplotlib scipy.optimize"),
        ("from drake_aigto.cli import main; main(['plan', 'nowhere'])", "matplotlib distributed"),
        # Plans have no views until one is asked for.
        ("from drake_aigto.planning import VIEWS; assert not VIEWS", "matplotlib"),
        # Pyplot would choose a backend.
        ("import drake_aigto.show.figures, drake_aigto.show.scene", "matplotlib.pyplot"),
    ],
    "rooms without Drake": [
        ("import drake_aigto.box, drake_aigto.aigo, drake_aigto.local", "pydrake")
    ],
}


@pytest.mark.parametrize("program", PROGRAMS.values(), ids=PROGRAMS)
def test_importing_loads_only_what_is_used(program: list[tuple[str, str]]) -> None:
    lines = ["import sys"]
    for statement, absent in program:
        lines += [statement, f"print([m for m in {absent.split()} if m in sys.modules])"]
    result = subprocess.run(
        [sys.executable, "-c", "\n".join(lines)],
        capture_output=True,
        text=True,
        check=True,
        cwd=PACKAGE.parent,
    )
    assert result.stdout.split() == ["[]"] * len(program)


def test_every_public_name_can_be_had() -> None:
    for name in drake_aigto.__all__:
        assert getattr(drake_aigto, name).__name__ == name
        assert name in dir(drake_aigto)
    with pytest.raises(ImportError, match="cannot import name 'Scenery'"):
        exec("from drake_aigto import Scenery")


@pytest.mark.parametrize("name", sorted(vars(drake_aigto)["_GONE"]))
def test_a_name_that_left_the_top_level_says_where_it_is(name: str) -> None:
    with pytest.raises(ImportError, match=f"{name} is gone: use ") as error:
        exec(f"from drake_aigto import {name}")
    place = str(error.value).split("use ")[1].rstrip(".").partition(",")[0]
    *module, there = place.removeprefix("drake_aigto.").split(".")
    room = importlib.import_module(".".join(["drake_aigto", *module]))
    assert there in room.__all__ if hasattr(room, "__all__") else hasattr(room, there)


@pytest.mark.parametrize(
    ("room", "name", "stands"),
    [
        ("control", "FlightFeedback", r"planning\.Feedback, one law"),
        ("control", "track_drake", r"simulation\.replay_with\(DRAKE, "),
        ("planning", "MechanismRung", r"PlanOptions\(starts=…\)"),
    ],
)
def test_a_name_that_left_a_room_says_what_stands_for_it(room: str, name: str, stands: str) -> None:
    with pytest.raises(ImportError, match=rf"{name} is gone: use {stands}"):
        getattr(importlib.import_module(f"drake_aigto.{room}"), name)


def imported_names(file: Path) -> set[tuple[str, str, str]]:
    """Returns leading dots, modules and names of a file's imports, found by Python's own parser."""
    found = set()
    for node in statements(file.read_text(encoding="utf-8")):
        if isinstance(node, ast.Import):
            found |= {("", alias.name, "") for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {("." * node.level, node.module or "", alias.name) for alias in node.names}
    return found


def test_no_import_is_overlooked() -> None:
    for file in (CHECKOUT / "drake_aigto").rglob("*.py*"):
        if file.suffix in (".py", ".pyi"):
            imports = code_cache._imports(str(file))
            found = {(*origin, name) for *origin, names in imports for name in names or ("",)}
            assert imported_names(file) <= found, file


def classes_by_name(root: Path) -> dict[str, list[str]]:
    """Returns the files of a package that define a class, by its name without underscores."""
    found = defaultdict(list)
    for path in sorted(root.rglob("*.py")):
        for node in statements(path.read_text(encoding="utf-8")):
            if isinstance(node, ast.ClassDef):
                found[node.name.lstrip("_")].append(str(path.relative_to(root)))
    return found


def test_no_two_classes_share_a_name() -> None:
    shared = {name: files for name, files in classes_by_name(PACKAGE).items() if len(files) > 1}
    assert shared == {}


def test_a_private_class_shares_the_name_of_a_public_one(tmp_path: Path) -> None:
    (tmp_path / "one.py").write_text("class Walls: ...", encoding="utf-8")
    (tmp_path / "other.py").write_text("def f():\n    class _Walls: ...", encoding="utf-8")
    assert classes_by_name(tmp_path) == {"Walls": ["one.py", "other.py"]}
