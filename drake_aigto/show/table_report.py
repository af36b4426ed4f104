"""Table I as one HTML page: every method's plan on every row, and what simulations make of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from matplotlib.figure import Figure

from drake_aigto import __version__
from drake_aigto.paper import PAPER_COSTS, Cell, Entry, RigidCell, Table1
from drake_aigto.show.figures import plot_motions
from drake_aigto.show.motion import PLAN_LABEL, SIMULATION_LABELS, Motion
from drake_aigto.show.page import Page
from drake_aigto.show.playback import open_meshcat, publish
from drake_aigto.show.report import PROBLEM, describe_versions
from drake_aigto.show.tables import entries_of, format_table1
from drake_aigto.show.text import length_text, run_texts, task_items
from drake_aigto.world import Scenario, World

_ANY_PORT = 0
_HEADER = (
    *("", "cost J", "dynamics defect", "deepest penetration", "energy ratio"),
    *("J simulated, rigid", "off the goal there", "J simulated, Drake", "verdict"),
)


def report_table1(table: Table1, progress: Callable[[str], None] | None = None) -> str:
    """Returns a page about Table I: self-contained, with a recording for each row.

    A recording shows the rigid transcription's plan beside a gradient solver's from zero, each with
    a rigid simulation of its control. Before each part that takes time, `progress` is called with a
    line of text.
    """
    say = progress or (lambda line: None)
    page = Page("Table I of AIGTO, and what its plans do on a rigid wall")
    _add_verdict(page, table)
    page.heading("The question")
    page.paragraph("A point mass before a wall, in four tasks.")
    page.code(PROBLEM)
    rows = sorted({cell.row for cell in _cells(table)})
    say("recording the plans")
    page.heading("In motion")
    page.scenes({f"Row {row}": _record(table, row) for row in rows})
    for row in rows:
        say(f"drawing row {row}")
        _add_row(page, table, row)
    page.heading("All numbers")
    page.code(format_table1(table).strip())
    page.heading("How to reproduce it")
    chosen = " ".join(map(str, rows))
    page.code(
        f"pip install drake_aigto=={__version__}\n"
        f"drake-aigto table1 --rows {chosen} --html table1.html"
    )
    page.paragraph(describe_versions())
    return page.to_html()


def _add_verdict(page: Page, table: Table1) -> None:
    """Adds how many plans of each transcription hold."""
    for name, cells in (("rigid", table.rigid), ("literal", table.literal)):
        if entries := entries_of(cells):
            held = sum(entry.holds for entry in entries)
            text = f"{held} of {len(entries)} plans of the {name} transcription hold in simulation."
            page.verdict(text, held == len(entries))


def _cells(table: Table1) -> list[Cell | RigidCell]:
    return [*table.literal, *table.rigid]


def _add_row(page: Page, table: Table1, row: int) -> None:
    """Adds a row's task, numbers and figure."""
    scenario, paper = Scenario.named(f"table1/{row}"), PAPER_COSTS[row]
    page.heading(f"Row {row}: {', '.join(task_items(scenario))}")
    page.paragraph(
        f"The paper's costs: gradient {paper.gradient:g}, AIGTO {paper.aigto:g}. They come without "
        "defects or simulations."
    )
    page.table(_HEADER, _number_rows(table, row))
    for cell in table.rigid:
        if cell.row == row:
            cost = cell.optimum.cost
            page.paragraph(f"The exact optimum on a rigid wall costs {cost:.4e}.")
    world = World.from_scenario(scenario)
    entries = _pick_entries(table, row)
    motions = [motion for entry in entries for motion in _make_motions(entry, world)]
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    plot_motions(figure.subplots(3, 1, sharex=True), motions, world, scenario)
    page.figure(figure, f"Row {row}: plans, and rigid simulations of their controls.")


def _number_rows(table: Table1, row: int) -> Iterator[tuple[str, ...]]:
    for cell in _cells(table):
        if cell.row != row:
            continue
        bound = ""
        if isinstance(cell, Cell):
            bound = ", φ ≥ 0" if cell.nonpenetration else ", φ free"
        for entry in entries_of([cell]):
            yield _number_row(f"{entry.label}{bound}", entry)


def _number_row(name: str, entry: Entry) -> tuple[str, ...]:
    rigid, drake = entry.replays.event_driven, entry.replays.drake
    return (
        name,
        *run_texts(entry.candidate),
        f"{rigid.cost:.2e}",
        length_text(rigid.goal_error),
        "-" if drake is None else f"{drake.cost:.2e}",
        "holds" if entry.holds else "fails",
    )


def _pick_entries(table: Table1, row: int) -> list[Entry]:
    """Returns the rigid plan and a gradient solver's from zero, as far as they were run."""
    rigid = [method.best for cell in table.rigid if cell.row == row for method in cell.methods]
    literal = [cell.methods[0].best for cell in table.literal if cell.row == row]
    return [*rigid[:1], *literal[:1]]


def _make_motions(entry: Entry, world: World) -> tuple[Motion, Motion]:
    """Returns a plan, and the rigid simulation of its control."""
    rigid = f"{entry.label}: {SIMULATION_LABELS['event-driven']}"
    return (
        Motion.from_trajectory(entry.candidate.trajectory, world, f"{entry.label}: {PLAN_LABEL}"),
        Motion.from_replay(entry.replays.event_driven, rigid),
    )


def _record(table: Table1, row: int) -> str:
    """Returns Meshcat's page of a row."""
    scenario = Scenario.named(f"table1/{row}")
    world = World.from_scenario(scenario)
    motions = []
    for entry in _pick_entries(table, row):
        planned, simulated = _make_motions(entry, world)
        control = entry.candidate.trajectory
        motions += [planned, simulated.under(control.times, control.controls)]
    meshcat = open_meshcat(_ANY_PORT)
    publish(motions, meshcat, world, scenario)
    page: str = meshcat.StaticHtml()
    return page
