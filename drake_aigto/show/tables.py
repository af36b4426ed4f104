"""Table I as text, at most 100 columns wide."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from drake_aigto.paper import PAPER_COSTS, Cell, Entry, Method, RigidCell, Table1
from drake_aigto.show.text import (
    NO_COST,
    WIDTH,
    cost_text,
    length_text,
    run_texts,
    task_items,
    time_text,
)
from drake_aigto.world import Scenario

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


def format_table1(table: Table1) -> str:
    """Returns Table I: what each method's plan costs, and what it does on a rigid wall."""
    return "\n".join([*_blocks(table), "", _LEGEND, "", *_summary(table)])


def _blocks(table: Table1) -> Iterator[str]:
    rows = {cell.row for cell in table.literal} | {cell.row for cell in table.rigid}
    for row in sorted(rows):
        scenario, paper = Scenario.named(f"table1/{row}"), PAPER_COSTS[row]
        yield ""
        yield f"Row {row}: {', '.join(task_items(scenario))}, ε = {scenario.epsilon:g} J"
        yield f"       the paper: gradient {paper.gradient:.3g}, AIGTO {paper.aigto:.3g}"
        yield _join(name for name, _ in _COLUMNS)
        for cell in table.literal:
            if cell.row == row:
                yield f"  {_bound(cell, ' at every knot')} ".ljust(WIDTH, "-")
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
    title = (
        f"  rigid wall, e = {cell.restitution:g}; exact optimum {cost_text(optimum.cost, 4)}, "
        f"{bounces or 'no bounce'}"
    )
    if any(method.best.replays.drake for method in cell.methods):
        title += f"; Drake's wall {time_text(cell.contact_delay)} late"
    yield f"{title} ".ljust(WIDTH, "-")
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
    if cell.optimum.cost < NO_COST:
        return f"{excess:+.1e}" if excess >= NO_COST else "0"
    percent = 100 * excess / cell.optimum.cost
    return f"{percent:+.3f} %" if abs(percent) < 9.9995 else f"{percent:+.2g} %"


def _method_lines(methods: Iterable[Method]) -> Iterator[str]:
    for method in methods:
        for entry in method.entries:
            yield _entry_line(entry, method.seconds if entry is method.best else None)


def _entry_line(entry: Entry, seconds: float | None) -> str:
    run, rigid, drake = entry.candidate, entry.replays.event_driven, entry.replays.drake
    _, defect, *others = run_texts(run)
    return _join(
        (
            f"  {entry.label}",
            f"{run.start_cost:.0e}/{max(run.start_defects.values()):.0e}",
            cost_text(run.cost, 1),
            f"{defect}{'' if run.is_feasible else '*'}",
            *others,
            cost_text(rigid.cost, 1),
            length_text(rigid.goal_error),
            "-" if drake is None else cost_text(drake.cost, 1),
            "holds" if entry.holds else "fails",
            "" if seconds is None else f"{seconds:.1f}",
        )
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
