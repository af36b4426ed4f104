"""A plan as text, at most 100 columns wide: the verdict first, then what it rests on."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator

from drake_aigto.planning import Candidate, Plan, PlanOptions, Replay, confirms
from drake_aigto.planning.contacts import PlannedContact
from drake_aigto.show.text import WIDTH, energy_text, length_text, task_items, time_text
from drake_aigto.transcription.rigid_contact import DYNAMICS, RESTITUTION

_LABEL = 12  # Columns of the labels at the left.
_COLUMNS = (9, 8, 9, 8, 10, 10)  # Of the table of candidates, before their contacts.
_MOST_CANDIDATES = 8
_MOST_BOUNCES = 4


def format_plan(plan: Plan, options: PlanOptions, contact_delay: float | None = None) -> str:
    """Returns a plan with its verdict, its replays and its rivals, as text.

    Args:
        plan: to show.
        options: that it was made with.
        contact_delay: by how much Drake's wall is late [s]; None leaves that out.
    """
    return "\n".join([*_answer(plan, contact_delay), *_search(plan, options)])


def format_replays(plan: Plan, contact_delay: float | None = None) -> str:
    """Returns what simulations of a plan's control say, as text.

    Args:
        plan: with its replays.
        contact_delay: by how much Drake's wall is late [s]; None leaves that out.
    """
    return "\n".join(_answer(plan, contact_delay))


def _answer(plan: Plan, contact_delay: float | None) -> Iterator[str]:
    best, scenario = plan.best, plan.scenario
    yield from _row("verdict", [_verdict(plan)])
    costs = [f"{_simulator(replay)} {replay.cost:.3e}" for replay in plan.replay]
    yield from _row("", [f"cost {plan.cost:.3e}", *costs])
    mass = [] if scenario.mass is None else [f"mass {scenario.mass:g} kg"]
    span = f"T = {scenario.duration:g} s in {scenario.num_steps} steps"
    restitution = f"restitution {scenario.restitution:g}"
    yield from _row("scenario", [*task_items(scenario), *mass, restitution, span])
    literal = [f"ε = {scenario.epsilon:g} J", f"δ = {scenario.delta:g} m"]
    yield from _row(
        "plan",
        [
            f"{plan.transcription} transcription",
            *(literal if plan.transcription == "literal" else []),
            f"cost {plan.cost:.3e}",
            f"ends {length_text(best.goal_error)} off the goal",
            f"deepest penetration {length_text(best.max_penetration)}",
        ],
    )
    yield from _row("defects", _defects(best))
    yield from _row("contacts", _contacts(best))
    for replay in plan.replay:
        yield from _row("simulated", _simulation(replay, contact_delay))


def _verdict(plan: Plan) -> str:
    against = [
        replay for replay in plan.replay if not confirms(plan.cost, replay, plan.best.goal_error)
    ]
    where = " and ".join(map(_simulator, against or plan.replay))
    if against:
        return f"fails: the control alone misses the plan's promise {where}"
    return f"holds: the control alone keeps the plan's promise {where}"


def _simulation(replay: Replay, contact_delay: float | None) -> Iterator[str]:
    yield f"{_simulator(replay)}: cost {replay.cost:.3e}"
    explained = f" (its compliance explains {length_text(replay.compliance_error)})"
    known = explained if replay.compliance_error else ""
    yield f"ends {length_text(replay.goal_error)} off the goal{known}"
    yield f"deepest penetration {length_text(replay.max_penetration)}"
    if not replay.bounce_times:
        yield "no bounce"
        return
    yield f"energy ratio {energy_text(replay.energy_ratio)}"
    more = len(replay.bounce_times) - _MOST_BOUNCES
    times = ", ".join(f"{time:.4f}" for time in replay.bounce_times[:_MOST_BOUNCES])
    yield f"bounces at {times} s" + (f" and {more} times more" if more > 0 else "")
    if replay.matched_speeds:
        speeds = ", ".join(f"{speed:.2f}" for speed in replay.matched_speeds[:_MOST_BOUNCES])
        yield f"restitution matched for impacts at {speeds} m/s"
    if replay.simulator == "drake" and contact_delay is not None:
        yield f"each {time_text(contact_delay)} late (π √(m / k))"


def _search(plan: Plan, options: PlanOptions) -> Iterator[str]:
    steps = plan.scenario.num_steps
    boxes = [f"boxes of {steps} steps"]
    if plan.transcription == "rigid":
        boxes = [
            f"boxes of {min(options.aigo_steps, steps)} steps",
            f"relaxation {options.relaxation:g}",
        ]
    yield from _row("found by", boxes)
    for part in plan.best.origin.split("; "):
        yield from _row("", part.split(", "))
    yield from _row(
        "candidates",
        [
            f"{len(plan.candidates)}, of which {plan.stats.polished} feasible",
            f"{plan.stats.aigo_steps} iterations of AIGO; the first is the plan",
        ],
    )
    yield _line("cost", "defect", "in wall", "energy", "replayed", "off goal", "contacts")
    for candidate in plan.candidates[:_MOST_CANDIDATES]:
        yield _candidate_line(candidate)
    more = len(plan.candidates) - _MOST_CANDIDATES
    if more > 0:
        yield from _row("", [f"and {more} more"])
    yield from _row("seconds", [f"{part} {s:.2f}" for part, s in plan.stats.seconds.items()])


def _candidate_line(candidate: Candidate) -> str:
    times = ", ".join(map(_when, candidate.contacts))
    return _line(
        f"{candidate.cost:.2e}",
        f"{candidate.max_defect:.0e}{'' if candidate.is_feasible else '*'}",
        length_text(candidate.max_penetration),
        energy_text(candidate.energy_ratio),
        f"{candidate.replay.cost:.2e}",
        length_text(candidate.replay.goal_error),
        f"{times} s" if times else "none",
    )


def _line(*texts: str) -> str:
    """Returns a line of the table of candidates; the last text is cut off at the width."""
    *cells, last = texts
    columns = [text.rjust(size) for text, size in zip(cells, _COLUMNS, strict=True)]
    line = " " * _LABEL + "".join(columns) + "  "
    return line + textwrap.shorten(last, WIDTH - len(line), placeholder=" …")


def _row(label: str, items: Iterable[str]) -> list[str]:
    """Returns a label and items; lines break between items."""
    # Lines do not break at no-break spaces.
    text = ", ".join(item.replace(" ", "\u00a0") for item in items)
    lines = textwrap.wrap(
        text,
        WIDTH,
        initial_indent=label.ljust(_LABEL),
        subsequent_indent=" " * _LABEL,
        break_on_hyphens=False,
    )
    return [line.replace("\u00a0", " ") for line in lines]


def _simulator(replay: Replay) -> str:
    return "on a rigid wall" if replay.simulator == "event-driven" else "on Drake's plant"


def _defects(candidate: Candidate) -> Iterator[str]:
    for name, defect in candidate.defects.items():
        unit = "m/s" if name in (DYNAMICS, RESTITUTION) else "m"
        yield f"{name} {defect:.0e} {unit}" if defect else f"{name} 0 {unit}"


def _contacts(candidate: Candidate) -> Iterator[str]:
    if not candidate.contacts:
        yield "none"
        return
    for contact in candidate.contacts:
        yield f"{_when(contact)} s (Δv {contact.velocity_change:.2f} m/s)"
    yield f"kinetic energy after / before {energy_text(candidate.energy_ratio)}"


def _when(contact: PlannedContact) -> str:
    """Returns the time of a bounce, or the times of a contact that lasts [s]."""
    times = [f"{time:.3f}" for time in (contact.time, contact.last_time)]
    return "–".join(dict.fromkeys(times))
