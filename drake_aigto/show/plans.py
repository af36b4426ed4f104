"""A plan as text, at most 100 columns wide: the verdict first, then what it rests on."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Sequence
from string import ascii_lowercase

from drake_aigto.arrays import interpolate
from drake_aigto.planning import Candidate, Plan, PlanOptions
from drake_aigto.show.remarks import (
    INTERRUPTED,
    describe_bound,
    describe_duration,
    describe_idle,
    describe_steps,
    describe_unplanned,
    describe_vetoes,
    name_simulator,
    verdict_items,
)
from drake_aigto.show.text import (
    WIDTH,
    contact_names,
    cost_text,
    energy_text,
    friction_items,
    law_items,
    length_text,
    miss_text,
    miss_texts,
    run_texts,
    task_items,
    time_text,
)
from drake_aigto.simulation import Replay
from drake_aigto.simulation.contacts import PlannedContact
from drake_aigto.simulation.material import contact_delay, contact_delays
from drake_aigto.transcription.rows import UNITS
from drake_aigto.world import Scenario, World

_LABEL = 12  # Columns of the labels at the left.
_COLUMNS = (9, 8, 9, 8, 10, 10)  # Of the table of candidates, before their contacts.
_MOST_CANDIDATES = 8
_MOST_BOUNCES = 6
_MOST_CONTACTS = 12


def format_plan(plan: Plan, world: World | None = None, contact_delay: float | None = None) -> str:
    """Returns a plan with its verdict, its replays and its rivals, as text.

    Of several contacts, each has its letter. Drake's walls are late by as much as `contact_delay`
    [s], which is left out if None.

    Raises:
        ModelError: the world has to be given (`Plan.find_world`).
    """
    world = plan.find_world(world)
    return "\n".join([*_answer(plan, world, contact_delay), *_search(plan, world)])


def format_replays(
    plan: Plan, world: World | None = None, contact_delay: float | None = None
) -> str:
    """Returns the part of `format_plan` that says what simulations of the plan's control do."""
    return "\n".join(_answer(plan, plan.find_world(world), contact_delay))


def _answer(plan: Plan, world: World, contact_delay: float | None) -> Iterator[str]:
    best, scenario, names = plan.best, plan.scenario, contact_names(world)
    yield from _row("verdict", verdict_items(plan, names))
    scale = best.scales.cost
    costs = [
        f"{name_simulator(replay, names)} {cost_text(replay.cost, 3, scale)}"
        for replay in plan.replay
    ]
    yield from _row("", [f"cost {cost_text(plan.cost, 3, scale)}", *costs])
    if plan.is_interrupted:
        yield from _text("interrupted", INTERRUPTED)
    for veto in describe_vetoes(plan, world):
        yield from _text("vetoed", veto)
    yield from _text("no control", describe_idle(plan, world))
    yield from _text("bound", describe_bound(plan))
    mass = [] if scenario.mass is None else [f"mass {scenario.mass:g} kg"]
    T = plan.trajectory.times[-1] if scenario.duration_range else scenario.duration
    span = f"T = {T:.6g} s in {scenario.num_steps} steps"
    items = [*task_items(scenario, world), *mass, *law_items(scenario, world), span]
    yield from _row("scenario", items)
    yield from _row("pairs", _pairs(world, names))
    yield from _row("friction", friction_items(scenario, world))
    literal = [f"ε = {scenario.epsilon:g} J", f"δ = {scenario.delta:g} m"]
    yield from _row(
        "plan",
        [
            f"{plan.transcription} transcription",
            *(literal if plan.transcription == "literal" else []),
            f"cost {cost_text(plan.cost, 3, scale)}",
            f"ends {miss_text(best, scenario, world)} off the goal",
            f"deepest penetration {length_text(best.max_penetration)}",
        ],
    )
    yield from _text("steps", describe_steps(plan))
    yield from _text("duration", describe_duration(plan))
    yield from _row("limits", _bounds(plan))
    yield from _row("added", _additions(plan))
    yield from _row("defects", _defects(best))
    yield from _row("contacts", _contacts(best, names, world))
    yield from _text("unplanned", describe_unplanned(plan, world))
    contact_delay = contact_delay if scenario.contact == "rigid" else None
    for replay in plan.replay:
        miss = miss_text(replay, scenario, world)
        yield from _row("simulated", _simulation(replay, scale, contact_delay, names, miss))


def _pairs(world: World, names: Sequence[str]) -> Iterator[str]:
    """Yields the letters of several contacts, each with its restitution if the model has one."""
    if len(names) == 1:
        return
    for index, (name, contact) in enumerate(zip(names, world.contacts, strict=True)):
        own = "" if contact.restitution is None else f" (restitution {contact.restitution:g})"
        yield f"{_letter(index)} {name}{own}"


def _simulation(
    replay: Replay, scale: float, contact_delay: float | None, names: Sequence[str], miss: str
) -> Iterator[str]:
    yield f"{name_simulator(replay, names)}: cost {cost_text(replay.cost, 3, scale)}"
    explained = f" (its compliance explains {length_text(replay.compliance_error)})"
    known = explained if replay.compliance_error else ""
    yield f"ends {miss} off the goal{known}"
    yield f"deepest penetration {length_text(replay.max_penetration)}"
    if not replay.bounce_times:
        yield "no bounce"
        return
    each = " a bounce" if len(replay.bounce_times) > 1 else ""
    yield f"energy ratio {energy_text(replay.energy_ratio)}{each}"
    yield _bounces(replay, names)
    if replay.matched_speeds:
        speeds = ", ".join(f"{speed:.2f}" for speed in replay.matched_speeds[:_MOST_BOUNCES])
        yield f"restitution matched for impacts at {speeds} m/s"
    if replay.simulator == "drake" and contact_delay is not None:
        most = "up to " if len(names) > 1 else ""
        yield f"each {most}{time_text(contact_delay)} late (π √(m / k))"


def _bounces(replay: Replay, names: Sequence[str]) -> str:
    """Returns when the first bounces are; of several contacts, with their letters."""
    letters = [f"{_letter(i)} " if len(names) > 1 else "" for i in replay.bounce_contacts]
    bounces = list(zip(letters, replay.bounce_times, strict=True))
    more = len(bounces) - _MOST_BOUNCES
    times = ", ".join(f"{letter}{time:.4f}" for letter, time in bounces[:_MOST_BOUNCES])
    return f"bounces at {times} s" + (f" and {more} times more" if more > 0 else "")


def _search(plan: Plan, world: World) -> Iterator[str]:
    options = plan.options
    boxes = [f"boxes of {plan.scenario.num_steps} steps"] if options else []
    if isinstance(options, PlanOptions):
        boxes = [f"boxes of {options.aigo_steps} steps", f"relaxation {options.relaxation:g}"]
    yield from _row("found by", boxes)
    for part in str(plan.best.origin).split("; "):
        yield from _row("", part.split(", "))
    count, iterations = len(plan.candidates), f"{plan.stats.aigo_steps} iterations of AIGO"
    yield from _row(
        "candidates",
        ["1, the plan", iterations]
        if count == 1
        else [
            f"{count}, of which {sum(each.is_feasible for each in plan.candidates)} feasible",
            f"{iterations}; the first is the plan",
        ],
    )
    shown = plan.candidates[:_MOST_CANDIDATES]
    yield from _table(
        ("cost", "defect", "in wall", "energy", "replayed", "off goal", "contacts"),
        *(candidate_texts(candidate, plan.scenario, world) for candidate in shown),
    )
    more = len(plan.candidates) - _MOST_CANDIDATES
    if more > 0:
        yield from _row("", [f"and {more} more"])
    if plan.stats.flight_left_out is not None:
        least = plan.stats.flight_left_out
        yield from _row("", [f"left out: free flight, which costs {least:.2e} at least"])
    yield from _row("seconds", [f"{part} {s:.2f}" for part, s in plan.stats.seconds.items()])


def candidate_texts(candidate: Candidate, scenario: Scenario, world: World) -> tuple[str, ...]:
    """Returns a candidate's numbers, those of its rigid simulation, and its contacts."""
    names = contact_names(world)
    times = ", ".join(map(_when, candidate.contacts))
    if len(names) > 1:
        times = " at ".join(["".join(_letter(c.index) for c in candidate.contacts), times])
    cost, defect, *others = run_texts(candidate)
    return (
        cost,
        f"{defect}{'' if candidate.is_feasible else '*'}",
        *others,
        cost_text(candidate.replay.cost, scale=candidate.scales.cost),
        " ".join(miss_texts(candidate.replay, scenario, world)),
        ("no control: " if candidate.is_idle else "")
        + (f"{times} s" if candidate.contacts else "none"),
    )


def _table(*rows: tuple[str, ...]) -> Iterator[str]:
    """Yields lines, in columns as wide as they need; the last text is cut off at the width."""
    needed = (2 + max(map(len, column)) for column in list(zip(*rows, strict=True))[:-1])
    sizes = list(map(max, _COLUMNS, needed))
    for *cells, last in rows:
        columns = [text.rjust(size) for text, size in zip(cells, sizes, strict=True)]
        line = " " * _LABEL + "".join(columns) + "  "
        yield line + textwrap.shorten(last, WIDTH - len(line), placeholder=" …")


def _row(label: str, items: Iterable[str], between: str = ", ") -> list[str]:
    """Returns a label and items, or nothing without items; lines break between items."""
    # Lines do not break at no-break spaces.
    text = between.join(item.replace(" ", "\u00a0") for item in items)
    if not text:
        return []
    lines = textwrap.wrap(
        text,
        WIDTH,
        initial_indent=label.ljust(_LABEL),
        subsequent_indent=" " * _LABEL,
        break_on_hyphens=False,
    )
    return [line.replace("\u00a0", " ") for line in lines]


def _text(label: str, text: str | None) -> list[str]:
    """Returns a label and a sentence, which breaks between words; nothing for None."""
    return [] if text is None else _row(label, text.split(" "), " ")


def _defects(candidate: Candidate) -> Iterator[str]:
    for name, defect in candidate.defects.items():
        unit = UNITS.get(name, "of the task's scales")
        yield f"{name} {defect:.0e} {unit}" if defect else f"{name} 0 {unit}"


def _additions(plan: Plan) -> Iterator[str]:
    """Yields costs and constraints that users added, and what simulations make of them."""
    best = plan.best
    for name, cost in best.added_costs.items():
        yield f"{name} {cost:.3e}"
    constraints = [name for name in plan.additions if name not in best.added_costs]
    known = best.added_costs.keys(), best.replay.violations.keys()
    if any((each.added_costs.keys(), each.violations.keys()) != known for each in plan.replay):
        yield from constraints
        yield "of which a plan file has the names alone: simulated and compared without"
        return
    yield from _misses(plan, constraints)


def _bounds(plan: Plan) -> Iterator[str]:
    """Yields what simulations make of bounds and a hard goal."""
    names = [name for name in plan.best.replay.violations if name not in plan.additions]
    yield from _misses(plan, names)


def _misses(plan: Plan, names: Iterable[str]) -> Iterator[str]:
    """Yields by how much simulations miss what has these names."""
    for name in names:
        missed = max(replay.violations[name] for replay in plan.replay)
        yield f"{name} missed by {missed:.0e} of the task's scales" if missed else f"{name} met"


def told_delay(plan: Plan, world: World) -> float | None:
    """Returns by how much the plan's contacts are late in Drake at most [s], if it ran there."""
    is_rigid = plan.scenario.contact == "rigid" and world.contacts
    if not is_rigid or plan.replay.drake is None:
        return None
    if world.has_constant_inertia or not plan.best.contacts:
        return contact_delay(world)
    times, rows = plan.trajectory.times, plan.trajectory.positions
    touches = [(interpolate(each.time, times, rows), each.index) for each in plan.best.contacts]
    return max(contact_delays(world, q)[index] for q, index in touches)


def _contacts(candidate: Candidate, names: Sequence[str], world: World) -> Iterator[str]:
    if not candidate.contacts:
        yield "none"
        return
    for contact in candidate.contacts[:_MOST_CONTACTS]:
        where = f"{names[contact.index]} at " if len(names) > 1 else ""
        change = f" (Δv {contact.velocity_change:.2f} m/s)"
        yield f"{where}{_when(contact)} s{'' if world.is_hinge.any() else change}"
    if (more := len(candidate.contacts) - _MOST_CONTACTS) > 0:
        yield f"{more} more"
    all_of_them = " in all" if len(candidate.contacts) > 1 else ""
    yield f"kinetic energy after / before {energy_text(candidate.energy_ratio)}{all_of_them}"


def _letter(contact: int) -> str:
    """Returns the letter of a contact, with a number after the alphabet is used up."""
    again, index = divmod(contact, len(ascii_lowercase))
    return f"{ascii_lowercase[index]}{again or ''}"


def _when(contact: PlannedContact) -> str:
    """Returns the time of a bounce, or the times of a contact that lasts [s]."""
    times = [f"{time:.3f}" for time in (contact.time, contact.last_time)]
    return "–".join(dict.fromkeys(times))
