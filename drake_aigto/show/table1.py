"""Table I of the paper as text, at most 100 columns wide, and as one HTML page."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drake_aigto.arrays import Floats
from drake_aigto.paper import PAPER_COSTS, Cell, Entry, RigidCell, Table1, TableMethod
from drake_aigto.show import words
from drake_aigto.show.figures import plot_motions
from drake_aigto.show.film import open_meshcat
from drake_aigto.show.motion import PLAN_LABEL, SIMULATION_LABELS, Motion
from drake_aigto.show.page import Page, Scene
from drake_aigto.show.report import PROBLEM, describe_versions
from drake_aigto.show.scene import publish
from drake_aigto.world import Scenario, World

_COLUMNS = (
    ("method", 22),
    ("before", 12),
    ("cost", 8),
    ("defect", 7),
    ("in wall", 8),
    ("energy", 8),
    ("rigid", 8),
    ("miss", 8),
    ("Drake", 8),
    ("wall", 6),
    ("s", 5),
)
_LEGEND = """\
before   cost / largest defect of what the local solver began with (for AIGTO: AIGO's last box)
cost     J of the plan;  defect: its largest dynamics defect, m or m/s (* no solution)
in wall  the plan's deepest penetration;  energy: kinetic energy after / before its contact
rigid    J of its control alone on an exactly rigid wall (event-driven);  miss: goal error there
Drake    J of its control alone on Drake's plant (compliant wall, Radau3), which is late: contact
         lasts π √(m / k) there
wall     holds if both simulations come within 5 % + 4e-6 of the plan's cost and 2 mm of its goal,
         beside what the compliance of Drake's wall explains
optimum  of a point mass on a rigid wall, over all controls; the planner does not know it. Plan and
         simulations are so much above it: in percent, or in J where it is 0"""
_ANY_PORT = 0
_FRAME = 0.5  # What is shown beside simulations, in parts of their range.
_HEADER = (
    *("", "verdict", "cost J", "dynamics defect", "deepest penetration", "energy ratio"),
    *("J simulated, rigid", "off the goal there", "J simulated, Drake"),
)


def format_table1(table: Table1) -> str:
    """Returns Table I: what each method's plan costs, and what it does on a rigid wall."""
    return "\n".join([*_summary(table), *_blocks(table), "", _LEGEND])


def _blocks(table: Table1) -> Iterator[str]:
    for row in sorted({cell.row for cell in _cells(table)}):
        scenario, paper = Scenario.named(f"table1/{row}"), PAPER_COSTS[row]
        yield ""
        yield f"Row {row}: {', '.join(words.task_items(scenario))}, ε = {scenario.epsilon:g} J"
        yield f"       the paper: gradient {paper.gradient:.3g}, AIGTO {paper.aigto:.3g}"
        yield _join(name for name, _ in _COLUMNS)
        for cell in table.literal:
            if cell.row == row:
                yield f"  {_bound(cell, ' at every knot')} ".ljust(words.WIDTH, "-")
                yield from _method_lines(cell.methods)
        for rigid in table.rigid:
            if rigid.row == row:
                yield from _rigid_lines(rigid)


def _bound(cell: Cell, where: str = "") -> str:
    return f"φ ≥ 0{where}" if cell.nonpenetration else "φ free"


def _rigid_lines(cell: RigidCell) -> Iterator[str]:
    """Yields the rigid plan, and how far it and its replays are above the exact optimum."""
    optimum = cell.optimum
    bounces = ", ".join(f"bounce at {time:.3f} s" for time in optimum.bounce_times)
    title = f"  rigid wall, e = {cell.restitution:g}; exact optimum "
    title += f"{words.cost_text(optimum.cost, 4)}, {bounces or 'no bounce'}"
    if any(method.best.replays.drake for method in cell.methods):
        title += f"; Drake's wall {words.time_text(cell.contact_delay)} late"
    yield f"{title} ".ljust(words.WIDTH, "-")
    yield from _method_lines(cell.methods)
    for method in cell.methods:
        replays = method.best.replays
        drake = "" if replays.drake is None else _excess(cell, replays.drake.cost)
        plan, rigid = (
            _excess(cell, cost) for cost in (method.best.candidate.cost, replays.event_driven.cost)
        )
        yield _join(("  above the optimum", "", plan, "", "", "", rigid, "", drake, "", ""))


def _excess(cell: RigidCell, cost: float) -> str:
    """Returns how far a cost is above the exact optimum, in eight columns."""
    excess = cost - cell.optimum.cost
    if cell.optimum.cost < words.NO_COST:
        return f"{excess:+.1e}" if excess >= words.NO_COST else "0"
    percent = 100 * excess / cell.optimum.cost
    return f"{percent:+.3f} %" if abs(percent) < 9.9995 else f"{percent:+.2g} %"


def _method_lines(methods: Iterable[TableMethod]) -> Iterator[str]:
    for method in methods:
        for entry in method.entries:
            run, seconds = entry.candidate, f"{method.seconds:.1f}" if entry is method.best else ""
            start = "-"  # A motion that began elsewhere than at a guess of the solver.
            if run.start_cost is not None:
                start = f"{run.start_cost:.0e}/{max(run.start_defects.values()):.0e}"
            cost, defect, *others = _numbers(entry, 1)
            defect += "" if run.is_feasible else "*"
            yield _join((f"  {entry.label}", start, cost, defect, *others, seconds))


def _numbers(entry: Entry, digits: int = 2) -> tuple[str, ...]:
    """Returns a plan's numbers, and those of simulations of its control."""
    rigid, drake = entry.replays.event_driven, entry.replays.drake
    return (
        words.cost_text(entry.candidate.cost, digits),
        *words.run_texts(entry.candidate)[1:],
        words.cost_text(rigid.cost, digits),
        words.length_text(rigid.goal_error),
        "-" if drake is None else words.cost_text(drake.cost, digits),
        "holds" if entry.holds else "fails",
    )


def _join(texts: Iterable[str]) -> str:
    (_, width), *rest = _COLUMNS
    name, *others = texts
    cells = [text.rjust(size) for text, (_, size) in zip(others, rest, strict=True)]
    return (name.ljust(width) + "".join(cells)).rstrip()


def _summary(table: Table1) -> Iterator[str]:
    literal, rigid = entries_of(table.literal), entries_of(table.rigid)
    if literal:
        yield f"Literal transcription: {_count(literal)} on a rigid wall."
        for cell in table.literal:
            if labels := [entry.label for entry in entries_of([cell]) if entry.holds]:
                yield f"  row {cell.row}, {_bound(cell)}: {'; '.join(labels)}"
        yield "Its contacts are free impulses, and its wall pushes from afar: a low cost is real"
        yield "only where it holds."
    if table.num_missing:
        yield f"Interrupted: {table.num_missing} of {3 * len(table.rows)} cells are not done."
    if rigid:
        yield f"Rigid transcription: {_count(rigid)} there."


def entries_of(cells: Iterable[Cell | RigidCell]) -> list[Entry]:
    """Returns all lines of some of the table's cells."""
    return [entry for cell in cells for method in cell.methods for entry in method.entries]


def _count(entries: Sequence[Entry]) -> str:
    return f"{sum(entry.holds for entry in entries)} of {len(entries)} plans hold"


def report_table1(table: Table1) -> str:
    """Returns a page about Table I: self-contained, with a recording for each row.

    A recording shows the rigid transcription's plan beside a gradient solver's from zero, each with
    a rigid simulation of its control.
    """
    page = Page("Table I of AIGTO, and what its plans do on a rigid wall")
    for name, cells in (("rigid", table.rigid), ("literal", table.literal)):
        if entries := entries_of(cells):
            held = sum(entry.holds for entry in entries)
            text = f"{held} of {len(entries)} plans of the {name} transcription hold in simulation"
            page.verdict(text, held == len(entries))
    if table.num_missing:
        missing = f"{table.num_missing} of {3 * len(table.rows)} cells"
        page.paragraph(f"Interrupted: {missing} of the table are not done.")
    page.heading("The question")
    rows = sorted({cell.row for cell in _cells(table)})
    tasks = f"{len(rows)} tasks" if len(rows) > 1 else "one task"
    page.paragraph(f"A point mass before a wall: {tasks} of the paper's four.")
    page.code(PROBLEM)
    page.heading("In motion")
    page.scenes({f"Row {row}": _record(table, row) for row in rows})
    for row in rows:
        _add_row(page, table, row)
    page.heading("All numbers")
    page.code(format_table1(table).strip())
    page.heading("How to reproduce it")
    asked = f"--rows {' '.join(map(str, table.rows))} --guesses {table.num_guesses}"
    confirm = "" if table.confirm else " --no-confirm"
    page.code(f"drake-aigto table1 {asked} --seed {table.seed}{confirm} --html table1.html")
    page.paragraph(f"All numbers but times will be the same. {describe_versions()}")
    return page.to_html()


def _cells(table: Table1) -> list[Cell | RigidCell]:
    return [*table.literal, *table.rigid]


def _add_row(page: Page, table: Table1, row: int) -> None:
    """Adds a row's task, numbers and figure."""
    scenario, paper = Scenario.named(f"table1/{row}"), PAPER_COSTS[row]
    page.heading(f"Row {row}: {', '.join(words.task_items(scenario))}")
    page.paragraph(
        f"The paper's costs: gradient {paper.gradient:g}, AIGTO {paper.aigto:g}. They come without "
        "defects or simulations."
    )
    cells = [cell for cell in _cells(table) if cell.row == row]
    rows = []
    for cell in cells:
        bound = f", {_bound(cell)}" if isinstance(cell, Cell) else ""
        for entry in entries_of([cell]):
            *numbers, verdict = _numbers(entry)
            rows.append((f"{entry.label}{bound}", verdict, *numbers))
    page.table(_HEADER, rows)
    for cell in cells:
        if isinstance(cell, RigidCell):
            cost = words.cost_text(cell.optimum.cost, 4)
            page.paragraph(f"The exact optimum on a rigid wall costs {cost}.")
    world = World.from_scenario(scenario)
    motions = _make_motions(table, row, world)
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    plot_motions(axes, motions, world, scenario)
    simulated = [motion for motion in motions if motion.controls is None]
    frame(axes[0], "m", [m.positions for m in motions], [m.positions for m in simulated])
    frame(axes[1], "m/s", [m.velocities for m in motions], [m.velocities for m in simulated])
    page.figure(figure, f"Row {row}: plans, and rigid simulations of their controls.")


def frame(axes: Axes, unit: str, values: Sequence[Floats], simulated: Sequence[Floats]) -> None:
    """Frames what was simulated: a literal plan's jump of thousands of m/s would hide all else."""
    low, high = np.min(np.vstack(simulated)), np.max(np.vstack(simulated))
    bottom, top = axes.get_ylim()
    axes.set_ylim(max(bottom, low - _FRAME * (high - low)), min(top, high + _FRAME * (high - low)))
    if (bottom, top) != axes.get_ylim():
        least, most = np.min(np.vstack(values)), np.max(np.vstack(values))
        text = f"cut off: the literal plan goes from {least:,.1f} to {most:,.1f} {unit}"
        axes.set_title(text, loc="right", fontsize="small")


def _make_motions(table: Table1, row: int, world: World) -> list[Motion]:
    """Returns plans, each with the rigid simulation of its control, as far as they were run.

    They are the rigid plan, and a gradient solver's from zero.
    """
    rigid = [method.best for cell in table.rigid if cell.row == row for method in cell.methods]
    literal = [cell.methods[0].best for cell in table.literal if cell.row == row]
    motions = []
    for entry in (*rigid[:1], *literal[:1]):
        labels = (
            f"{entry.label}: {PLAN_LABEL}",
            f"{entry.label}: {SIMULATION_LABELS['event-driven']}",
        )
        motions.append(Motion.from_trajectory(entry.candidate.trajectory, world, labels[0]))
        motions.append(Motion.from_replay(entry.replays.event_driven, world, labels[1]))
    return motions


def _record(table: Table1, row: int) -> Scene:
    """Returns Meshcat's page of a row."""
    scenario = Scenario.named(f"table1/{row}")
    world = World.from_scenario(scenario)
    motions = _make_motions(table, row, world)
    for index, planned in enumerate(motions[::2]):
        assert planned.control_times is not None and planned.controls is not None
        simulated = motions[2 * index + 1]
        motions[2 * index + 1] = simulated.under(planned.control_times, planned.controls)
    meshcat = open_meshcat(_ANY_PORT)
    return publish(motions, meshcat, world, scenario).scene
