"""Plans and runs in the loop as text, at most 100 columns wide: the verdict first."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from drake_aigto.planning import Candidate, Plan, PlanOptions
from drake_aigto.show.facts import (
    Fact,
    answer_facts,
    join_items,
    list_some,
    name_touch,
    question_facts,
    sequence_text,
    verdict_facts,
)
from drake_aigto.show.text import (
    WIDTH,
    cost_text,
    length_text,
    miss_text,
    miss_texts,
    run_texts,
    touch_names,
    weight_text,
)
from drake_aigto.world import Scenario, World

if TYPE_CHECKING:
    from drake_aigto.control import ClosedLoopRun

CUT_SHORT = "Ctrl-C ended the simulation; this is what happened by then"

_LABEL = 12  # columns of the labels at the left
_COLUMNS = (9, 8, 9, 8, 10, 10)  # Of the table of candidates, before their contacts.
_MOST_CANDIDATES = 8
_METHODS = {
    "tracking": "a plan is tracked (TrackingController)",
    "replanning": "it plans again at every tick (ModelPredictiveController)",
}


def format_plan(plan: Plan, world: World | None = None) -> str:
    """Returns a plan with its verdict, its replays and its rivals, as text.

    Of several contacts, each has its letter.

    Raises:
        ModelError: the world has to be given (`Plan.find_world`).
    """
    world = plan.find_world(world)
    lines = [format_replays(plan, world), *_format(_search_facts(plan))]
    shown = plan.candidates[:_MOST_CANDIDATES]
    table = [candidate_texts(candidate, plan.scenario, world) for candidate in shown]
    header = ("cost", "defect", "in wall", "energy", "replayed", "off goal", "contacts")
    others = [("seconds", join_items(f"{k} {s:.2f}" for k, s in plan.stats.seconds.items()))]
    if (least := plan.stats.flight_left_out) is not None:
        others.insert(0, ("", f"left out: free flight, which costs {least:.2e} at least"))
    if (more := len(plan.candidates) - _MOST_CANDIDATES) > 0:
        others.insert(0, ("", f"and {more} more"))
    return "\n".join([*lines, *_table(header, *table), *_format(others)])


def format_replays(plan: Plan, world: World | None = None) -> str:
    """Returns the part of `format_plan` that says what simulations of the plan's control do."""
    world = plan.find_world(world)
    duration = float(plan.trajectory.times[-1])
    question = question_facts(plan.scenario, world, duration)
    return "\n".join(_format([*verdict_facts(plan, world), *question, *answer_facts(plan, world)]))


def format_run(run: ClosedLoopRun) -> str:
    """Returns what happened in the loop, as text."""
    return "\n".join(_format(run_facts(run)))


def _format(facts: Iterable[Fact]) -> Iterator[str]:
    """Yields facts in lines of at most 100 columns, their labels at the left."""
    for label, text in facts:
        lines = textwrap.wrap(
            text,
            WIDTH,
            initial_indent=label.ljust(_LABEL),
            subsequent_indent=" " * _LABEL,
            break_on_hyphens=False,
        )
        yield from (line.replace("\u00a0", " ") for line in lines)


def _search_facts(plan: Plan) -> Iterator[Fact]:
    """Yields how a plan was found."""
    options = plan.options
    boxes = [f"boxes of {plan.scenario.num_steps} steps"] if options else []
    if isinstance(options, PlanOptions) and plan.transcription == "rigid":
        boxes = [f"boxes of {options.aigo_steps} steps", f"relaxation {options.relaxation:g}"]
    parts = [part.split(", ") for part in str(plan.best.origin).split("; ")]
    for index, items in enumerate([boxes, *parts]):
        if items:
            yield "" if index else "found by", join_items(items)
    count, iterations = len(plan.candidates), f"{plan.stats.aigo_steps} iterations of AIGO"
    feasible = sum(each.is_feasible for each in plan.candidates)
    several = [f"{count}, of which {feasible} feasible", f"{iterations}; the first is the plan"]
    yield "candidates", join_items(["1, the plan", iterations] if count == 1 else several)


def candidate_texts(candidate: Candidate, scenario: Scenario, world: World) -> tuple[str, ...]:
    """Returns a candidate's numbers, those of its rigid simulation, and its contacts."""
    cost, defect, *others = run_texts(candidate)
    return (
        cost,
        f"{defect}{'' if candidate.is_feasible else '*'}",
        *others,
        cost_text(candidate.replay.cost, scale=candidate.scales.cost),
        " ".join(miss_texts(candidate.replay, scenario, world)),
        sequence_text(candidate, world),
    )


def _table(*rows: tuple[str, ...]) -> Iterator[str]:
    """Yields lines, in columns as wide as they need; the last text is cut off at the width."""
    needed = (2 + max(map(len, column)) for column in list(zip(*rows, strict=True))[:-1])
    sizes = list(map(max, _COLUMNS, needed))
    for *cells, last in rows:
        columns = [text.rjust(size) for text, size in zip(cells, sizes, strict=True)]
        line = " " * _LABEL + "".join(columns) + "  "
        yield line + textwrap.shorten(last, WIDTH - len(line), placeholder=" …")


def run_facts(run: ClosedLoopRun) -> Iterator[Fact]:
    """Yields what happened in the loop."""
    replay, world = run.replay, run.world
    walls = "soft walls" if run.scenario.contact == "compliant" else "stiff walls"
    where = f"with {walls}" if world.contacts else "without walls"
    yield "simulation", f"in Drake's Simulator, {where}; {_METHODS[run.method]}"
    if run.is_interrupted:
        yield "interrupted", CUT_SHORT
    d = run.disturbance
    disturbed = {
        f"start off by {weight_text(d.start_offset)}": d.start_offset.any(),
        f"masses times {d.mass_factor:g}": d.mass_factor != 1,
        f"friction times {d.friction_factor:g}": d.friction_factor != 1,
        f"walls {1e3 * d.wall_shift:g} mm nearer": d.wall_shift,
        f"restitution times {d.restitution_factor:g}": d.restitution_factor != 1,
        f"a kick of {weight_text(d.kick)} at {d.kick_time:g} s": d.kick.any(),
        f"noise of {weight_text(d.noise)} (seed {d.seed})": d.noise.any(),
    }
    yield "disturbed", "; ".join(text for text, is_so in disturbed.items() if is_so) or "by nothing"
    first = cost_text(run.promised, 3)
    yield "cost", f"{cost_text(run.cost, 3)} along what happened; the first plan promises {first}"
    miss = miss_text(replay, run.scenario, world)
    yield "ends", f"at {run.duration:g} s, {miss} off the goal"
    pairs = zip(replay.bounce_times, replay.bounce_contacts, strict=True)
    touches = list_some(name_touch(pair, touch_names(world)) for pair in pairs)
    touched = f"touches {touches}" if touches else "nothing is touched"
    yield "walls", f"deepest penetration {length_text(replay.max_penetration)}; {touched}"
    if broken := replay.broken:
        yield "breaks", ", ".join(f"{name} by {replay.violations[name]:.1g}" for name in broken)
    if run.ticks:
        yield "ticks", describe_ticks(run)
        times = ", ".join(f"{switch.time:.2f} s" for switch in run.switches)
        taken = (
            f"another plan was taken at {times}" if times else "the first plan was improved only"
        )
        yield "switches", taken
        learned, known = run.ticks[-1].restitution, run.scenario.restitution
        if learned not in (None, known):
            yield "learned", f"walls return {learned:.3f} of a speed; the scenario says {known:g}"


def describe_ticks(run: ClosedLoopRun) -> str:
    """Returns how many ticks there were, and how long they took."""
    seconds = 1e3 * np.array([tick.seconds for tick in run.ticks])
    text = f"{len(seconds)}; the first took {seconds[0]:.0f} ms"
    if len(seconds) == 1:
        return text
    middle, late = np.percentile(seconds[1:], [50, 99])
    return f"{text}, others {middle:.1f} ms (median), {late:.1f} ms (99 %)"
