"""Facts about plans and runs in the loop, and both as text, at most 100 columns wide.

A fact is a label and a text, the same on the terminal and in pages.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator

import numpy as np

from drake_aigto.arrays import interpolate
from drake_aigto.contact import contact_delay, contact_delays
from drake_aigto.planning import Candidate, Plan, PlanOptions, Veto, calc_divergence
from drake_aigto.progress import list_some
from drake_aigto.show import words
from drake_aigto.simulation import HARD_GOAL, Replay
from drake_aigto.transcription import UNITS
from drake_aigto.world import Scenario, TaskCost, World

Fact = tuple[str, str]

INTERRUPTED = "Ctrl-C ended the search; this is the best plan found until then"

_LABEL = 12  # columns of the labels at the left
_COLUMNS = (9, 8, 9, 8, 10, 10)  # Of the table of candidates, before their contacts.
_MOST_CANDIDATES, _MOST_VETOES = 8, 3
_OF_SCALES = "of the task's scales"
_FROM_OFF = "from a start 1e-3 of the scales off, "
_AT_END = 1e-6  # of a duration: as near as rounding to an end of its range
_FAR = 4.0  # Lengths of the task: a motion that ends farther off has left it.


def format_plan(plan: Plan, world: World | None = None) -> str:
    """Returns a plan with its verdict, its replays and its rivals, as text.

    Of several contacts, each has its letter.

    Raises:
        ModelError: the world has to be given (`Plan.find_world`).
    """
    world = plan.find_world(world)
    lines = [format_replays(plan, world), *format_facts(_search_facts(plan))]
    shown = plan.candidates[:_MOST_CANDIDATES]
    table = [candidate_texts(candidate, plan.scenario, world) for candidate in shown]
    header = ("cost", "defect", "in wall", "energy", "replayed", "off goal", "contacts")
    others = [("seconds", words.join_items(f"{k} {s:.2f}" for k, s in plan.stats.seconds.items()))]
    if (least := plan.stats.flight_left_out) is not None:
        others.insert(
            0, ("", f"left out: free flight, which costs {words.cost_text(least)} at least")
        )
    if (more := len(plan.candidates) - _MOST_CANDIDATES) > 0:
        others.insert(0, ("", f"and {more} more"))
    return "\n".join([*lines, *_table(header, *table), *format_facts(others)])


def format_replays(plan: Plan, world: World | None = None) -> str:
    """Returns the part of `format_plan` that says what simulations of the plan's control do."""
    world = plan.find_world(world)
    question = words.question_facts(plan.scenario, world, float(plan.trajectory.times[-1]))
    return "\n".join(
        format_facts([*verdict_facts(plan, world), *question, *answer_facts(plan, world)])
    )


def format_facts(facts: Iterable[Fact]) -> Iterator[str]:
    """Yields facts in lines of at most 100 columns, their labels at the left."""
    for label, text in facts:
        for line in textwrap.wrap(text, words.WIDTH - _LABEL, break_on_hyphens=False):
            yield label.ljust(_LABEL) + line.replace("\u00a0", " ")
            label = ""


def _table(*rows: tuple[str, ...]) -> Iterator[str]:
    """Yields lines, in columns as wide as they need; a last text without room is below its line."""
    needed = (2 + max(map(len, column)) for column in list(zip(*rows, strict=True))[:-1])
    sizes = list(map(max, _COLUMNS, needed))
    room = words.WIDTH - _LABEL - sum(sizes) - 2
    for *cells, last in rows:
        columns = "".join(text.rjust(size) for text, size in zip(cells, sizes, strict=True))
        fits = len(last) <= room
        yield " " * _LABEL + columns + (f"  {last}" if fits else "")
        for below in () if fits else textwrap.wrap(last, words.WIDTH - 2 * _LABEL):
            yield " " * 2 * _LABEL + below


def verdict_facts(plan: Plan, world: World) -> Iterator[Fact]:
    """Yields whether simulations confirm a plan, and what a reader has to know beside that."""
    best, names, scale = plan.best, words.contact_names(world), plan.best.scales.cost
    yield "verdict", words.join_items(verdict_items(plan, world))
    effort = TaskCost.of(world, plan.scenario).effort(
        plan.trajectory.times, plan.trajectory.controls
    )
    share = effort / plan.cost if plan.cost > 0 else None
    yield "goal", words.join_items(words.goal_items(plan.find_arrival(world), share))
    costs = (
        f"{words.name_simulator(r, names)} {words.cost_text(r.cost, 3, scale)}" for r in plan.replay
    )
    yield "cost", words.join_items([words.cost_text(plan.cost, 3, scale), *costs])
    if plan.is_interrupted:
        yield "interrupted", INTERRUPTED
    if best.growth is not None:
        judge = ": its own feedback judges it, not the control alone" if best.gains else ""
        yield "growth", f"{best.describe_growth()} along the motion{judge}"
    if rate := calc_divergence(world, plan.scenario):
        q = ", ".join(map(words.pi_text, plan.scenario.goal_position))
        yield (
            "holding",
            f"the goal, q = ({q}), is at an unstable equilibrium, where errors grow e-fold in "
            f"{1 / rate:.2g} s: to hold it beyond the plan's end needs feedback",
        )
    vetoes = sorted(plan.vetoes, key=lambda veto: veto.candidate.cost)
    for veto in vetoes[:_MOST_VETOES]:
        yield "vetoed", _describe_veto(veto, plan.scenario, world)
    if len(vetoes) > _MOST_VETOES:
        yield "vetoed", f"{len(vetoes) - _MOST_VETOES} more candidates that promise less"
    if plan.idleness:
        yield "moving", words.join_items(_why_idle(plan, world))
    if best.is_idle:
        yield "no control", "this is the plan: no other plan that holds costs less"
    elif plan.idle is not None:
        less = "doing nothing is better: " if plan.is_beaten else ""
        idle = plan.idle.replay
        miss = f"ends {words.miss_text(idle, plan.scenario, world)} off the goal"
        ways = np.ptp(idle.positions, axis=0)[~world.is_hinge]
        if np.max(ways, initial=0.0) > _FAR * best.scales.length:
            miss = "flies or falls far away: no wall of the model stops it"
        yield "no control", f"{less}it costs {words.cost_text(idle.cost, 3)} and {miss}"
    if plan.bound is not None:
        yield "bound", _describe_bound(plan)


def answer_facts(plan: Plan, world: World) -> Iterator[Fact]:
    """Yields a plan's numbers, and those of simulations of its control."""
    best, scenario = plan.best, plan.scenario
    literal = [f"ε = {scenario.epsilon:g} J", f"δ = {scenario.delta:g} m"]
    items = [
        f"{plan.transcription} transcription",
        *(literal if plan.transcription == "literal" else []),
        f"cost {words.cost_text(plan.cost, 3, best.scales.cost)}",
        *([] if best.cost_error is None else [f"known to {best.cost_error:.0e}"]),
        f"ends {words.miss_text(best, scenario, world)} off the goal",
        f"deepest penetration {words.length_text(best.max_penetration)}",
    ]
    yield "plan", words.join_items(items)
    steps, asked = len(plan.trajectory.controls), scenario.num_steps
    if steps != asked and not best.is_idle:
        few = "which are too few for its phases"
        why = few if steps > asked else "with which it was not polished"
        yield "steps", f"{steps} instead of {asked}, {why}"
    if scenario.duration_range is not None:
        T, (least, most) = plan.trajectory.times[-1], scenario.duration_range
        text = f"{T:.4g} s, chosen by the plan"
        if abs(T - least) <= _AT_END * least:
            text = f"{T:.4g} s, its lower bound: a shorter plan may cost less"
        elif abs(T - most) <= _AT_END * most:
            text = f"{T:.4g} s, its upper bound: a longer plan may cost less"
        yield "duration", text
    if scenario.periodic is not None:
        missed = max(replay.violations.get(HARD_GOAL, 0.0) for replay in plan.replay)
        yield "repeats", f"to {missed:.0e} {_OF_SCALES}, from a start chosen by the plan"
    limits = (name for name in best.replay.violations if name not in plan.additions)
    yield from words.list_fact("limits", _misses(plan, limits))
    yield from words.list_fact("added", _additions(plan))
    defects = (
        f"{name} {f'{size:.0e}' if size else 0} {UNITS.get(name, _OF_SCALES)}"
        for name, size in best.defects.items()
    )
    yield from words.list_fact("defects", defects)
    yield "contacts", words.join_items(words.contact_texts(best, world))
    if (unplanned := best.unplanned) and not best.is_idle:
        touches = (words.name_touch(each, words.touch_names(world)) for each in unplanned)
        where = words.name_simulator(best.replay, words.touch_names(world))
        yield "unplanned", f"{where} it also touches {list_some(touches)}"
    delay = _find_delay(plan, world)
    for replay in plan.replay:
        yield "simulated", words.join_items(_simulation(plan, replay, world, delay))
    for replay in plan.replay.alone:
        yield "alone", words.join_items(_simulation(plan, replay, world, delay))
    if plan.replay.perturbed:
        costs = (words.cost_text(each.cost, 3, best.scales.cost) for each in plan.replay.perturbed)
        off = "from starts 1e-3 of the scales off, with its feedback, the cost is"
        yield "perturbed", f"{off} {' and '.join(costs)}"


def _why_idle(plan: Plan, world: World) -> Iterator[str]:
    """Yields what the best motion that differs from the uncontrolled one costs, and why."""
    moving = [each for each in plan.candidates if not each.is_idle and each.is_feasible]
    if not moving:
        yield f"no other candidate is feasible ({len(plan.candidates)} candidates)"
        return
    best = min(moving, key=lambda candidate: candidate.cost)
    scale, path = best.scales.cost, best.trajectory
    effort = TaskCost.of(world, plan.scenario).effort(path.times, path.controls)
    cost, share = (words.cost_text(each, 3, scale) for each in (best.cost, effort))
    yield f"the best of {len(moving)} candidates that move costs {cost}"
    yield f"of which its control {share} by control_weight"
    lower, upper = world.bounds(plan.scenario).control
    at_bound = np.any((path.controls <= lower) | (path.controls >= upper), axis=1)
    if part := float(np.diff(path.times) @ at_bound / (path.times[-1] - path.times[0])):
        yield f"which is at its bound for {100 * part:.0f} % of the time"
    if vetoed := len(plan.vetoes):
        yield f"{vetoed} that promise less are contradicted by a simulation"


def verdict_items(plan: Plan, world: World) -> Iterator[str]:
    """Yields whether simulations confirm a plan, and what is wrong with it."""
    if plan.idleness:
        yield plan.idleness
    names, replays = words.contact_names(world), plan.replay.judging
    against = [replay for replay in replays if not plan.best.is_confirmed_by(replay)]
    agreed = filter(plan.best.agrees_with, replays)
    named = dict.fromkeys(words.name_simulator(replay, names) for replay in against or agreed)
    where, control = " and ".join(named).rstrip(","), "control alone"
    if plan.best.gains:
        where, control = where.replace(", with its feedback", ""), "control with its feedback"
    if against:
        yield f"fails: the {control} misses the plan's promise {where}"
        broken = dict.fromkeys(name for replay in against for name in replay.broken)
        yield from (f"breaks '{name}'" for name in broken)
    elif plan.is_beaten:
        where = words.name_simulator(plan.replay.event_driven, names)
        yield f"fails: {where} doing nothing costs less"
    else:
        yield f"holds: the {control} keeps the plan's promise {where}"


def _describe_veto(veto: Veto, scenario: Scenario, world: World) -> str:
    """Returns what a candidate promises, and what is wrong with it."""
    candidate, replay, names = veto.candidate, veto.replay, words.touch_names(world)
    times = list_some((f"{contact.time:.3f}" for contact in candidate.contacts), " s")
    contacts = f"contacts at {times}" if candidate.contacts else "no contact"
    start = _FROM_OFF if any(replay is each for each in candidate.perturbed) else ""
    text = (
        f"a candidate with {contacts} promises {words.cost_text(candidate.cost)}, but {start}"
        f"{words.name_simulator(replay, names)} costs {words.cost_text(replay.cost)} and ends "
        f"{words.miss_text(replay, scenario, world)} off the goal"
    )
    if replay.broken:
        return f"{text}, and breaks {', '.join(map(repr, replay.broken))}"
    planned, simulated = veto.first_difference
    if planned == simulated:
        return f"{text}, though with the same contacts"
    instead = f" instead of {words.name_touch(planned, names)}" if planned else ""
    return f"{text}: it touches {words.name_touch(simulated, names)}{instead}"


def _describe_bound(plan: Plan) -> str:
    """Returns how far a plan is above any other at most."""
    assert plan.bound is not None
    if plan.gap is None or plan.bound.lower_bound is None:
        return f"no lower bound: {plan.bound.reason}"
    of = " of the task's scale" if plan.bound.is_nothing else ""
    return (
        f"at most {100 * plan.gap:.2g} %{of} above any plan, as simulated: no control does it for "
        f"less than {words.cost_text(plan.bound.lower_bound, 4)}"
    )


def _simulation(plan: Plan, replay: Replay, world: World, delay: float | None) -> Iterator[str]:
    """Yields what a simulation made of a plan's control."""
    best, names = plan.best, words.contact_names(world)
    cost = words.cost_text(replay.cost, 3, best.scales.cost)
    where = words.name_simulator(replay, names)
    if best.agrees_with(replay):
        yield f"{where}: confirms the plan"
    elif best.is_confirmed_by(replay):
        off = words.length_text(replay.touch_error)
        yield f"{where}: differs from the plan"
        yield f"not counted, as capsules or meshes touch there up to {off} off their places"
    else:
        yield f"{where}: contradicts the plan"
    yield f"cost {cost}{words.describe_difference(plan.cost, replay)}"
    if replay.feedback is not None:
        yield f"its feedback adds up to {replay.feedback:.2g} to the control"
    known = f" (its compliance explains {words.way_text(replay.compliance_error, world)})"
    known = known if replay.compliance_error else ""
    yield f"ends {words.miss_text(replay, plan.scenario, world)} off the goal{known}"
    yield f"deepest penetration {words.length_text(replay.max_penetration)}"
    if not replay.bounce_times:
        yield "no bounce"
        return
    if replay.energy_ratio is not None:
        each = " a bounce" if len(replay.bounce_times) > 1 else ""
        yield f"energy ratio {words.energy_text(replay.energy_ratio)}{each}"
    letters = [f"{words.letter(i)} " if len(names) > 1 else "" for i in replay.bounce_contacts]
    bounces = zip(letters, replay.bounce_times, strict=True)
    yield f"bounces at {list_some((f'{each}{time:.4f}' for each, time in bounces), ' s')}"
    if replay.matched_speeds:
        speeds = list_some((f"{speed:.2f}" for speed in replay.matched_speeds), " m/s")
        yield f"restitution matched for impacts at {speeds}"
    if replay.simulator == "drake" and delay is not None:
        most = "up to " if len(names) > 1 else ""
        yield f"each {most}{words.time_text(delay)} late (π √(m / k))"


def _additions(plan: Plan) -> Iterator[str]:
    """Yields costs and constraints that users added, and what simulations make of them."""
    best = plan.best
    for name, cost in best.added_costs.items():
        yield f"{name} {words.cost_text(cost, 3)}"
    constraints = [name for name in plan.additions if name not in best.added_costs]
    known = best.added_costs.keys(), best.replay.violations.keys()
    if any((each.added_costs.keys(), each.violations.keys()) != known for each in plan.replay):
        yield from constraints
        yield "simulated and compared without them: a plan file has only their names"
        return
    yield from _misses(plan, constraints)


def _misses(plan: Plan, names: Iterable[str]) -> Iterator[str]:
    """Yields by how much simulations miss bounds, a hard goal, or constraints with these names."""
    for name in names:
        missed = max(replay.violations[name] for replay in plan.replay)
        yield f"{name} violated by {missed:.0e} {_OF_SCALES}" if missed else f"{name} met"


def _find_delay(plan: Plan, world: World) -> float | None:
    """Returns by how much the plan's contacts are late in Drake at most [s], if it ran there."""
    if plan.scenario.contact != "rigid" or not world.contacts or plan.replay.drake is None:
        return None
    if world.has_constant_inertia or not plan.best.contacts:
        return contact_delay(world)
    times, rows = plan.trajectory.times, plan.trajectory.positions
    touches = [(interpolate(each.time, times, rows), each.index) for each in plan.best.contacts]
    return max(contact_delays(world, q)[index] for q, index in touches)


def _search_facts(plan: Plan) -> Iterator[Fact]:
    """Yields how a plan was found."""
    options = plan.options
    steps = f"{plan.scenario.num_steps} steps"
    boxes = [steps if plan.transcription == "shooting" else f"boxes of {steps}"] if options else []
    if isinstance(options, PlanOptions) and plan.transcription == "rigid":
        boxes = [f"boxes of {options.aigo_steps} steps", f"relaxation {options.relaxation:g}"]
    parts = [part.split(", ") for part in str(plan.best.origin).split("; ")]
    for index, items in enumerate([boxes, *parts]):
        if items:
            yield "" if index else "found by", words.join_items(items)
    yield "candidates", words.join_items([*count_candidates(plan).split(", "), str(plan.stats)])


def count_candidates(plan: Plan) -> str:
    """Returns how many candidates there were."""
    count, feasible = len(plan.candidates), sum(each.is_feasible for each in plan.candidates)
    if count == 1:
        return "1, the plan"
    return f"{count}, of which {feasible} feasible; the first is the plan"


def candidate_texts(candidate: Candidate, scenario: Scenario, world: World) -> tuple[str, ...]:
    """Returns a candidate's numbers, those of its rigid simulation, and its contacts."""
    cost, defect, *others = words.run_texts(candidate)
    return (
        cost,
        f"{defect}{'' if candidate.is_feasible else '*'}",
        *others,
        words.cost_text(candidate.replay.cost, scale=candidate.scales.cost),
        " ".join(words.miss_texts(candidate.replay, scenario, world)),
        words.sequence_text(candidate, world),
    )
