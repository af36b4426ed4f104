"""Facts about plans and simulations of their control, in words.

A fact is a label and a text, the same on the terminal and in pages. Items of a text, which lines
are not to break, have no-break spaces.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from string import ascii_lowercase

import numpy as np

from drake_aigto.arrays import interpolate
from drake_aigto.contact import contact_delay, contact_delays
from drake_aigto.planning import Candidate, Plan, Veto
from drake_aigto.show.text import (
    NO_COST,
    contact_names,
    cost_text,
    energy_text,
    friction_items,
    law_items,
    length_text,
    miss_text,
    task_items,
    time_text,
    touch_names,
)
from drake_aigto.simulation import PlannedContact, Replay
from drake_aigto.transcription import UNITS
from drake_aigto.world import Scenario, TaskCost, World

Fact = tuple[str, str]

INTERRUPTED = "the search was ended by Ctrl-C; this is the best of what it had found by then"

_MOST_TOUCHES = 6
_MOST_VETOES, _MOST_CONTACTS = 3, 12
_OF_SCALES = "of the task's scales"
_AT_END = 1e-6  # of a duration: as near as rounding to an end of its range
_SAME_COST = 1e-4  # Costs that differ by this part or less are called the same.


def join_items(items: Iterable[str]) -> str:
    """Returns items as the text of a fact."""
    return ", ".join(item.replace(" ", "\u00a0") for item in items)


def list_some(texts: Iterable[str], before_rest: str = "") -> str:
    """Returns the first of some texts, and how many more there are."""
    found = list(texts)
    rest = [f"{before_rest}{len(found) - _MOST_TOUCHES} more"] if found[_MOST_TOUCHES:] else []
    return ", ".join(found[:_MOST_TOUCHES] + rest)


def list_facts(label: str, items: Iterable[str]) -> Iterator[Fact]:
    """Yields a fact of items, if there are any."""
    if text := join_items(items):
        yield label, text


def verdict_facts(plan: Plan, world: World) -> Iterator[Fact]:
    """Yields whether simulations confirm a plan, and what a reader has to know beside that."""
    names, scale = contact_names(world), plan.best.scales.cost
    yield "verdict", join_items(verdict_items(plan, names))
    costs = (f"{name_simulator(r, names)} {cost_text(r.cost, 3, scale)}" for r in plan.replay)
    yield "", join_items([f"cost {cost_text(plan.cost, 3, scale)}", *costs])
    if plan.is_interrupted:
        yield "interrupted", INTERRUPTED
    vetoes = sorted(plan.vetoes, key=lambda veto: veto.candidate.cost)
    for veto in vetoes[:_MOST_VETOES]:
        yield "vetoed", _describe_veto(veto, plan.scenario, world)
    if len(vetoes) > _MOST_VETOES:
        yield "vetoed", f"{len(vetoes) - _MOST_VETOES} more candidates that promise less"
    if plan.idleness:
        yield "moving", join_items(_why_idle(plan, world))
    if plan.best.is_idle:
        yield "no control", "this is the plan: nothing that was found and holds costs less"
    elif plan.idle is not None:
        less = "doing nothing is better: " if plan.is_beaten else ""
        idle = plan.idle.replay
        miss = miss_text(idle, plan.scenario, world)
        yield "no control", f"{less}it costs {idle.cost:.3e} and ends {miss} off the goal"
    if plan.bound is not None:
        yield "bound", _describe_bound(plan)


def question_facts(
    scenario: Scenario, world: World, duration: float | None = None
) -> Iterator[Fact]:
    """Yields what was asked; a free duration is the plan's."""
    names = contact_names(world)
    T = duration if duration and scenario.duration_range else scenario.duration
    span = f"T = {T:.6g} s in {scenario.num_steps} steps"
    mass = [] if scenario.mass is None else [f"mass {scenario.mass:g} kg"]
    items = [*task_items(scenario, world), *mass, *law_items(scenario, world)]
    yield "scenario", join_items([*items, span])
    # Of several contacts, each has its letter, and its restitution if the model has one.
    owns = (contact.restitution for contact in world.contacts)
    pairs = (
        f"{_letter(i)} {name}" + ("" if own is None else f" (restitution {own:g})")
        for i, (name, own) in enumerate(zip(names, owns, strict=True))
    )
    yield from list_facts("pairs", pairs if len(names) > 1 else ())
    yield from list_facts("friction", friction_items(scenario, world))


def answer_facts(plan: Plan, world: World) -> Iterator[Fact]:
    """Yields a plan's numbers, and those of simulations of its control."""
    best, scenario, names = plan.best, plan.scenario, contact_names(world)
    literal = [f"ε = {scenario.epsilon:g} J", f"δ = {scenario.delta:g} m"]
    items = [
        f"{plan.transcription} transcription",
        *(literal if plan.transcription == "literal" else []),
        f"cost {cost_text(plan.cost, 3, best.scales.cost)}",
        f"ends {miss_text(best, scenario, world)} off the goal",
        f"deepest penetration {length_text(best.max_penetration)}",
    ]
    yield "plan", join_items(items)
    steps, asked = len(plan.trajectory.controls), scenario.num_steps
    if steps != asked and not best.is_idle:
        few = "which are too few for its phases"
        why = few if steps > asked else "with which it was not polished"
        yield "steps", f"{steps} instead of {asked}, {why}"
    if scenario.duration_range is not None:
        T, (least, most) = plan.trajectory.times[-1], scenario.duration_range
        text = f"{T:.4g} s, as it was free"
        if abs(T - least) <= _AT_END * least:
            text = f"{T:.4g} s, the least that it may be: with less, a plan may cost less"
        elif abs(T - most) <= _AT_END * most:
            text = f"{T:.4g} s, the most that it may be: with more, a plan may cost less"
        yield "duration", text
    limits = (name for name in best.replay.violations if name not in plan.additions)
    yield from list_facts("limits", _misses(plan, limits))
    yield from list_facts("added", _additions(plan))
    defects = (
        f"{name} {f'{size:.0e}' if size else 0} {UNITS.get(name, _OF_SCALES)}"
        for name, size in best.defects.items()
    )
    yield from list_facts("defects", defects)
    yield "contacts", join_items(_contacts(best, names, world))
    if (unplanned := best.unplanned) and not best.is_idle:
        touches = (name_touch(each, touch_names(world)) for each in unplanned)
        where = name_simulator(best.replay, touch_names(world))
        yield "unplanned", f"{where} it also touches {list_some(touches, 'and ')}"
    delay = _find_delay(plan, world)
    for replay in plan.replay:
        yield "simulated", join_items(_simulation(plan, replay, world, delay))


def _why_idle(plan: Plan, world: World) -> Iterator[str]:
    """Yields what the best motion that differs from the uncontrolled one costs, and why."""
    moving = [each for each in plan.candidates if not each.is_idle and each.is_feasible]
    if not moving:
        yield f"nothing else that was found is feasible ({len(plan.candidates)} candidates)"
        return
    best = min(moving, key=lambda candidate: candidate.cost)
    scale, path = best.scales.cost, best.trajectory
    effort = TaskCost.of(world, plan.scenario).effort(path.times, path.controls)
    yield f"the best of {len(moving)} candidates that move costs {cost_text(best.cost, 3, scale)}"
    yield f"of which its control {cost_text(effort, 3, scale)} by control_weight"
    lower, upper = world.bounds(plan.scenario).control
    at_bound = np.any((path.controls <= lower) | (path.controls >= upper), axis=1)
    share = float(np.diff(path.times) @ at_bound / (path.times[-1] - path.times[0]))
    if share:
        yield f"which is at its bound for {100 * share:.0f} % of the time"
    if vetoed := len(plan.vetoes):
        yield f"{vetoed} that promise less are contradicted by a simulation"


def verdict_items(plan: Plan, names: Sequence[str]) -> Iterator[str]:
    """Yields whether simulations confirm a plan, and what is wrong with it."""
    if plan.idleness:
        yield plan.idleness
    against = [replay for replay in plan.replay if not plan.best.is_confirmed_by(replay)]
    where = " and ".join(name_simulator(replay, names) for replay in against or plan.replay)
    if against:
        yield f"fails: the control alone misses the plan's promise {where}"
        broken = dict.fromkeys(name for replay in against for name in replay.broken)
        yield from (f"breaks '{name}'" for name in broken)
    elif plan.is_beaten:
        yield f"fails: {name_simulator(plan.replay.event_driven, names)} doing nothing costs less"
    else:
        yield f"holds: the control alone keeps the plan's promise {where}"


def name_simulator(replay: Replay, names: Sequence[str]) -> str:
    """Returns where a control was simulated; contacts have names."""
    if replay.simulator == "drake":
        return "on Drake's plant"
    if replay.simulator == "integrated" or not names:
        return "by integration"
    return "on a rigid wall" if len(names) == 1 else "on rigid walls"


def _describe_veto(veto: Veto, scenario: Scenario, world: World) -> str:
    """Returns what a candidate promises, and what is wrong with it."""
    candidate, replay, names = veto.candidate, veto.replay, touch_names(world)
    where = name_simulator(replay, names)
    times = [f"{contact.time:.3f}" for contact in candidate.contacts[:_MOST_TOUCHES]]
    more = ", …" if len(candidate.contacts) > _MOST_TOUCHES else ""
    contacts = f"contacts at {', '.join(times)}{more} s" if times else "no contact"
    text = (
        f"a candidate with {contacts} promises {candidate.cost:.2e}, but {where} costs "
        f"{replay.cost:.2e} and ends {miss_text(replay, scenario, world)} off the goal"
    )
    if replay.broken:
        return f"{text}, and breaks {', '.join(map(repr, replay.broken))}"
    planned, simulated = veto.first_difference
    if planned == simulated:
        return f"{text}, though with the same contacts"
    instead = f" instead of {name_touch(planned, names)}" if planned else ""
    return f"{text}: it touches {name_touch(simulated, names)}{instead}"


def name_touch(contact: tuple[float, int] | None, names: Sequence[str]) -> str:
    """Returns what is touched when; contacts have names."""
    return f"{names[contact[1]]} at {contact[0]:.3f} s" if contact else "nothing"


def _describe_bound(plan: Plan) -> str:
    """Returns how far a plan is above any other at most."""
    assert plan.bound is not None
    if plan.gap is None:
        return f"no lower bound: {plan.bound.reason}"
    of = " of the task's scale" if plan.bound.is_nothing else ""
    return (
        f"at most {100 * plan.gap:.2g} %{of} above any plan, as simulated: no control does it for "
        f"less than {plan.bound.lower_bound:.4e}"
    )


def _simulation(plan: Plan, replay: Replay, world: World, delay: float | None) -> Iterator[str]:
    """Yields what a simulation made of a plan's control."""
    names, confirms = contact_names(world), plan.best.is_confirmed_by(replay)
    cost = cost_text(replay.cost, 3, plan.best.scales.cost)
    judged = "confirms" if confirms else "contradicts"
    yield f"{name_simulator(replay, names)}: {judged} the plan"
    yield f"cost {cost}{describe_difference(plan.cost, replay)}"
    known = f" (its compliance explains {length_text(replay.compliance_error)})"
    known = known if replay.compliance_error else ""
    yield f"ends {miss_text(replay, plan.scenario, world)} off the goal{known}"
    yield f"deepest penetration {length_text(replay.max_penetration)}"
    if not replay.bounce_times:
        yield "no bounce"
        return
    each = " a bounce" if len(replay.bounce_times) > 1 else ""
    yield f"energy ratio {energy_text(replay.energy_ratio)}{each}"
    letters = [f"{_letter(i)} " if len(names) > 1 else "" for i in replay.bounce_contacts]
    bounces = list(zip(letters, replay.bounce_times, strict=True))
    times = ", ".join(f"{letter}{time:.4f}" for letter, time in bounces[:_MOST_TOUCHES])
    more = len(bounces) - _MOST_TOUCHES
    yield f"bounces at {times} s" + (f" and {more} times more" if more > 0 else "")
    if replay.matched_speeds:
        speeds = ", ".join(f"{speed:.2f}" for speed in replay.matched_speeds[:_MOST_TOUCHES])
        yield f"restitution matched for impacts at {speeds} m/s"
    if replay.simulator == "drake" and delay is not None:
        most = "up to " if len(names) > 1 else ""
        yield f"each {most}{time_text(delay)} late (π √(m / k))"


def describe_difference(cost: float, replay: Replay) -> str:
    """Returns by how much a simulation's cost differs from a plan's, and what explains it."""
    off = replay.cost - cost
    if abs(off) <= max(_SAME_COST * cost, NO_COST):
        return ""
    # Of plans that cost next to nothing, a percentage says nothing.
    part = f", {100 * off / cost:+.2f} %" if cost > max(NO_COST, abs(off) / 10) else ""
    # Walls that give a little delay what follows a contact.
    why = f"; its compliance explains up to {replay.compliance_cost:.1e}"
    return f" ({off:+.1e}{part}{why if replay.compliance_cost else ''})"


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


def _misses(plan: Plan, names: Iterable[str]) -> Iterator[str]:
    """Yields by how much simulations miss bounds, a hard goal, or constraints with these names."""
    for name in names:
        missed = max(replay.violations[name] for replay in plan.replay)
        yield f"{name} missed by {missed:.0e} {_OF_SCALES}" if missed else f"{name} met"


def _find_delay(plan: Plan, world: World) -> float | None:
    """Returns by how much the plan's contacts are late in Drake at most [s], if it ran there."""
    if plan.scenario.contact != "rigid" or not world.contacts or plan.replay.drake is None:
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


def sequence_text(candidate: Candidate, world: World) -> str:
    """Returns which contacts a candidate has when, in short."""
    times = ", ".join(map(_when, candidate.contacts))
    if len(world.contacts) > 1:
        times = " at ".join(["".join(_letter(c.index) for c in candidate.contacts), times])
    contacts = f"{times} s" if candidate.contacts else "none"
    return f"no control: {contacts}" if candidate.is_idle else contacts


def _letter(contact: int) -> str:
    """Returns the letter of a contact, with a number after the alphabet is used up."""
    again, index = divmod(contact, len(ascii_lowercase))
    return f"{ascii_lowercase[index]}{again or ''}"


def _when(contact: PlannedContact) -> str:
    """Returns the time of a bounce, or the times of a contact that lasts [s]."""
    times = [f"{time:.3f}" for time in (contact.time, contact.last_time)]
    return "–".join(dict.fromkeys(times))
