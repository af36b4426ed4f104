"""Plans and tables as text, at most 100 columns wide."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from drake_aigto.planning import Candidate, Plan, Replay
from drake_aigto.study import PAPER_COSTS, Cell, Entry, Method
from drake_aigto.world import Scenario

_WIDTH = 100
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
cost     J of the plan;  defect: its largest dynamics defect, m or m/s (* above 1e-6: no solution)
in wall  the plan's deepest penetration;  energy: kinetic energy after / before its contact
rigid    J of its control alone on an exactly rigid wall (event-driven);  miss: goal error there
Drake    J of its control alone on Drake's plant (compliant wall, Radau3)
wall     holds if both simulations come within 5 % + 4e-6 of the plan's cost and 2 mm of its goal"""


def format_table1(cells: Sequence[Cell]) -> str:
    """Returns Table I: what each method's plan costs, and what it does on a rigid wall."""
    lines = [*_blocks(cells), "", _LEGEND, "", _summary(cells)]
    return "\n".join(lines)


def format_plan(plan: Plan) -> str:
    """Returns a plan with its verdict, as text."""
    best = plan.best
    lines = [
        f"scenario    {_describe(plan.scenario)}",
        f"plan        {plan.transcription}",
        *(f"            {part}" for part in best.origin.split("; ")),
        f"            cost {plan.cost:.3e}, ends {_length(best.goal_error)} off the goal",
        f"            defects: {_defects(best)}",
        f"            deepest penetration {_length(best.max_penetration)}, kinetic energy after / "
        f"before contact {_ratio(best.energy_ratio)}",
        f"            contacts: {_contacts(best)}",
        *_replay_lines(plan),
        f"candidates  {len(plan.candidates)}, of which {plan.stats.polished} feasible; "
        f"{plan.stats.aigo_steps} iterations of AIGO",
        "seconds     " + ", ".join(f"{k} {v:.2f}" for k, v in plan.stats.seconds.items()),
    ]
    return "\n".join(lines)


def format_replays(plan: Plan) -> str:
    """Returns what simulations of a plan's control say, as text."""
    head = f"plan        {plan.transcription}; cost {plan.cost:.3e}, defects: {_defects(plan.best)}"
    return "\n".join([f"scenario    {_describe(plan.scenario)}", head, *_replay_lines(plan)])


def _replay_lines(plan: Plan) -> Iterator[str]:
    for replay in plan.replay:
        name = "event-driven rigid wall" if replay.simulator == "event-driven" else "Drake's plant"
        yield (
            f"simulated   {name}: cost {replay.cost:.3e}, ends {_length(replay.goal_error)} off "
            "the goal,"
        )
        yield (
            f"            deepest penetration {_length(replay.max_penetration)}, energy ratio "
            f"{_ratio(replay.energy_ratio)}, bounces at {_times(replay)}"
        )
    if plan.holds:
        yield "verdict     holds: the control alone does in simulation what the plan promises"
    else:
        yield "verdict     fails: in simulation the control alone misses what the plan promises"


def _blocks(cells: Sequence[Cell]) -> Iterator[str]:
    for row in sorted({cell.row for cell in cells}):
        paper = PAPER_COSTS[row]
        yield ""
        yield f"Row {row}: {_describe(Scenario.named(f'table1/{row}'), brief=True)}"
        yield f"       the paper: gradient {paper.gradient:.3g}, AIGTO {paper.aigto:.3g}"
        yield _join(name for name, _ in _COLUMNS)
        for cell in cells:
            if cell.row == row:
                bound = "φ ≥ 0 at every knot" if cell.nonpenetration else "φ free"
                yield f"  {bound} ".ljust(_WIDTH, "-")
                yield from _method_lines(cell.methods)


def _method_lines(methods: Iterable[Method]) -> Iterator[str]:
    for method in methods:
        for entry in method.entries:
            yield _entry_line(entry, method.seconds if entry is method.best else None)


def _entry_line(entry: Entry, seconds: float | None) -> str:
    run, rigid, drake = entry.candidate, entry.replays.event_driven, entry.replays.drake
    return _join(
        (
            f"  {entry.label}",
            f"{run.start_cost:.0e}/{max(run.start_defects.values()):.0e}",
            f"{run.cost:.1e}",
            f"{run.max_defect:.0e}{'' if run.is_feasible else '*'}",
            _length(run.max_penetration),
            _ratio(run.energy_ratio),
            f"{rigid.cost:.1e}",
            _length(rigid.goal_error),
            "-" if drake is None else f"{drake.cost:.1e}",
            "holds" if entry.holds else "fails",
            "" if seconds is None else f"{seconds:.1f}",
        )
    )


def _join(texts: Iterable[str]) -> str:
    (_, width), *rest = _COLUMNS
    name, *others = texts
    cells = [text.rjust(size) for text, (_, size) in zip(others, rest, strict=True)]
    return (name.ljust(width) + "".join(cells)).rstrip()


def _summary(cells: Sequence[Cell]) -> str:
    entries = [entry for cell in cells for method in cell.methods for entry in method.entries]
    lines = [
        f"{sum(entry.holds for entry in entries)} of {len(entries)} plans hold on a rigid wall:",
        *_holding(cells),
        "The literal transcription's contacts are free impulses, and its wall pushes from afar: a",
        "low cost is real only where it holds.",
    ]
    return "\n".join(lines)


def _holding(cells: Iterable[Cell]) -> Iterator[str]:
    for cell in cells:
        labels = [e.label for method in cell.methods for e in method.entries if e.holds]
        if labels:
            bound = "φ ≥ 0" if cell.nonpenetration else "φ free"
            yield f"  row {cell.row}, {bound}: {'; '.join(labels)}"


def _describe(scenario: Scenario, brief: bool = False) -> str:
    q, v, goal = (
        _numbers(x)
        for x in (scenario.initial_position, scenario.initial_velocity, scenario.goal_position)
    )
    text = f"q(0) = {q} m, v(0) = {v} m/s, goal {goal} m, ε = {scenario.epsilon:g} J"
    if brief:
        return text
    return (
        f"{text}, δ = {scenario.delta:g} m,\n            T = {scenario.duration:g} s in "
        f"{scenario.num_steps} steps, restitution {scenario.restitution:g}"
    )


def _numbers(values: Iterable[float]) -> str:
    texts = [f"{value:g}" for value in values]
    return texts[0] if len(texts) == 1 else f"({', '.join(texts)})"


def _defects(candidate: Candidate) -> str:
    units = {"dynamics": "m/s"}
    parts = (f"{name} {d:.0e} {units.get(name, 'm')}" for name, d in candidate.defects.items())
    return ", ".join(parts)


def _contacts(candidate: Candidate) -> str:
    texts = [f"{c.time:.3f} s (Δv {c.velocity_change:.2f} m/s)" for c in candidate.contacts]
    return ", ".join(texts) if texts else "none"


def _times(replay: Replay) -> str:
    times = [f"{time:.4f}" for time in replay.bounce_times[:4]]
    more = len(replay.bounce_times) - 4
    return (" ".join(times) + (f" and {more} more" if more > 0 else "") or "no time") + " s"


def _length(metres: float) -> str:
    """Returns a length in the unit that it is best read in."""
    if metres >= 0.1:
        return f"{metres:.2f} m"
    if metres >= 1e-4:
        return f"{1e3 * metres:.1f} mm"
    return f"{1e6 * metres:.1f} µm" if metres >= 1e-8 else "0 m"


def _ratio(ratio: float | None) -> str:
    if ratio is None:
        return "-"
    return ">1e6" if ratio > 1e6 else f"{ratio:.2g}"
