"""A plan as one HTML page: question, answer, verdict, recording, figures, and all numbers."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from importlib import metadata

import yaml
from matplotlib.figure import Figure

from drake_aigto import __version__
from drake_aigto.errors import ModelError, OptionsError
from drake_aigto.optima import rigid_optimum
from drake_aigto.planning import Candidate, Plan, SearchOptions
from drake_aigto.show.box_playback import BoxRun, play_boxes, run_boxes
from drake_aigto.show.coordinates import moves_straight
from drake_aigto.show.figures import plot_boxes, plot_motions, plot_path, plot_phase_portrait
from drake_aigto.show.friction_figures import draw_friction
from drake_aigto.show.landscapes import plot_cost_history, plot_cost_landscape
from drake_aigto.show.linkage_figures import draw_mechanism
from drake_aigto.show.motion import motions_of_plan, simulation_label
from drake_aigto.show.page import Page
from drake_aigto.show.plans import candidate_texts, format_replays, told_delay
from drake_aigto.show.playback import open_meshcat, play
from drake_aigto.show.question import add_question
from drake_aigto.show.remarks import (
    INTERRUPTED,
    describe_bound,
    describe_duration,
    describe_idle,
    describe_steps,
    describe_unplanned,
    describe_verdict,
    describe_vetoes,
)
from drake_aigto.show.text import (
    NO_COST,
    contact_names,
    cost_text,
    energy_text,
    length_text,
    miss_text,
    task_items,
)
from drake_aigto.simulation import Replay
from drake_aigto.world import World

_ANY_PORT = 0
_MOST_CANDIDATES = 10
_MOST_TOUCHES = 6
_COLUMNS = 2  # of a figure that has one for each coordinate: more could not be read
_SAME_COST = 1e-4  # Costs that differ by this part or less are called the same.

NUMBERS = ("cost J", "dynamics defect", "off the goal", "deepest penetration", "energy ratio")


def report_plan(
    plan: Plan, world: World | None = None, progress: Callable[[str], None] | None = None
) -> str:
    """Returns a page about a plan: self-contained, about 1.4 MB, for any browser since 2023.

    No cost is there without the plan's largest dynamics defect, its deepest penetration, the
    energy ratio over contact, and what simulations make of its control. Before each part that takes
    time, `progress` is called with a line of text.

    Raises:
        ModelError: the world has to be given (`Plan.find_world`).
    """
    say = progress or (lambda line: None)
    world = plan.find_world(world)
    say("running AIGO again, for its boxes")
    run, no_boxes = None, ""
    try:
        run = run_boxes(plan, world)
    except OptionsError as error:
        no_boxes = str(error)
    start, _, goal, *_ = task_items(plan.scenario, world)
    page = Page(f"Plan: {start}, {goal}")
    add_verdict(page, plan, world)
    add_question(page, plan.scenario, world, plan.additions)
    _add_answer(page, plan, world)
    say("recording the plan, its simulations, and the boxes")
    page.heading("In motion")
    page.scenes(_record(plan, world, run))
    say("drawing figures")
    page.heading("Figures")
    for figure, caption in figures_of_plan(plan, world, run):
        page.figure(figure, caption)
    if run is None:
        page.paragraph(f"{no_boxes[0].upper()}{no_boxes[1:]}")
    _add_candidates(page, plan, world)
    page.heading("All numbers")
    page.code(format_replays(plan, world, told_delay(plan, world)))
    _add_reproduction(page, plan)
    return page.to_html()


def add_verdict(page: Page, plan: Plan, world: World) -> None:
    """Adds whether simulations confirm a plan, and how far they are from it."""
    verdict = describe_verdict(plan, world)
    page.verdict(f"{verdict[0].upper()}{verdict[1:]}.", plan.holds)
    for replay in plan.replay:
        confirmed = plan.best.is_confirmed_by(replay)
        label = simulation_label(replay, world)
        page.paragraph(
            f"{label[0].upper()}{label[1:]}: {'confirms' if confirmed else 'contradicts'} the "
            f"plan. {describe_difference(plan.cost, replay)}; it ends "
            f"{miss_text(replay, plan.scenario, world)} off the goal, the plan "
            f"{miss_text(plan.best, plan.scenario, world)}."
        )
    if plan.is_interrupted:
        page.paragraph(f"Interrupted: {INTERRUPTED}.")
    for veto in describe_vetoes(plan, world):
        page.paragraph(f"Vetoed: {veto}.")
    if unplanned := describe_unplanned(plan, world):
        page.paragraph(f"Unplanned: {unplanned}.")
    if duration := describe_duration(plan):
        page.paragraph(f"Duration: {duration}.")
    if steps := describe_steps(plan):
        page.paragraph(f"Time steps: {steps}.")
    if bound := describe_bound(plan):
        page.paragraph(f"{bound[0].upper()}{bound[1:]}.")
    if idle := describe_idle(plan, world):
        page.paragraph(f"Without control: {idle}.")


def describe_difference(cost: float, replay: Replay) -> str:
    """Returns by how much a simulation's cost differs from a plan's, and what explains it."""
    off = replay.cost - cost
    if abs(off) <= max(_SAME_COST * cost, NO_COST):
        return "It costs the same"
    # Of plans that cost next to nothing, no number of percent tells anything.
    part = f", {100 * off / cost:+.2f} %" if cost > max(NO_COST, abs(off) / 10) else ""
    text = f"Its cost differs by {off:+.1e}{part}"
    if not replay.compliance_cost:
        return text
    return (
        f"{text}: its walls give a little, which delays what follows a contact and explains up to "
        f"{replay.compliance_cost:.1e}"
    )


def _add_answer(page: Page, plan: Plan, world: World) -> None:
    page.heading("The answer")
    page.paragraph(describe_contacts(plan.best, world))
    page.table(("", *NUMBERS, "touches"), _number_rows(plan, world))
    page.paragraph(
        "The plan is what the optimizer promises. The simulations run its control alone, from the "
        "start: they know nothing else of it."
    )


def describe_contacts(best: Candidate, world: World) -> str:
    """Returns which walls a plan touches, and when, as a sentence."""
    names = contact_names(world)
    if not best.contacts:
        return "The plan touches nothing."
    touches = [f"{names[c.index]} at {c.time:.3f} s" for c in best.contacts]
    count = "once" if len(touches) == 1 else f"{len(touches)} times"
    return f"The plan touches {count}: {'; '.join(touches)}."


def _number_rows(plan: Plan, world: World) -> Iterator[tuple[str, ...]]:
    """Yields a plan's numbers and those of its simulations, as rows below `NUMBERS`."""
    best = plan.best
    times = [contact.time for contact in best.contacts]
    numbers = _numbers(plan, best, world, f"{best.max_defect:.0e}", times)
    yield "plan (no simulation)", *numbers
    for replay in plan.replay:
        numbers = _numbers(plan, replay, world, "obeys them", replay.bounce_times)
        yield simulation_label(replay, world), *numbers


def _numbers(
    plan: Plan, run: Candidate | Replay, world: World, defect: str, times: Sequence[float]
) -> tuple[str, ...]:
    touches = ", ".join(f"{time:.3f} s" for time in times[:_MOST_TOUCHES]) or "none"
    return (
        cost_text(run.cost, 3, plan.best.scales.cost),
        defect,
        miss_text(run, plan.scenario, world),
        length_text(run.max_penetration),
        energy_text(run.energy_ratio),
        f"{touches}, {len(times) - _MOST_TOUCHES} more" if len(times) > _MOST_TOUCHES else touches,
    )


def _record(plan: Plan, world: World, run: BoxRun | None) -> dict[str, str]:
    """Returns Meshcat's pages of the plan and of the boxes, if there are any, by title."""
    meshcat = open_meshcat(_ANY_PORT)
    play(plan, meshcat, world)
    scenes = {"Plan and simulations": meshcat.StaticHtml()}
    if run is None:
        return scenes
    play_boxes(plan, meshcat, world, run)
    return {**scenes, "AIGO's boxes": meshcat.StaticHtml()}


def figures_of_plan(plan: Plan, world: World, run: BoxRun | None) -> Iterator[tuple[Figure, str]]:
    """Yields the figures of a report, each with its caption; of boxes, if there are any."""
    n, motions = world.num_positions, motions_of_plan(plan, world)
    for first in range(0, n, _COLUMNS):
        columns = range(first, min(first + _COLUMNS, n))
        figure = Figure(figsize=(4.5 * max(len(columns), 2), 7), layout="constrained")
        grid = figure.subplots(3, len(columns), sharex=True)
        plot_motions(grid, motions, world, plan.scenario, columns)
        yield figure, "Positions, velocities, controls: the plan, and simulations of its control."
    if moves_straight(world):
        yield _draw_states(plan, world)
        yield from draw_friction(motions[0], world, plan.scenario)
    else:
        yield from draw_mechanism(motions, world, plan.scenario)
    if run is not None:
        yield _draw_boxes(run, n)


def _draw_boxes(run: BoxRun, num_positions: int) -> tuple[Figure, str]:
    """Returns a figure of the boxes around each coordinate, and of what they cost."""
    figure = Figure(figsize=(4.5 * (num_positions + 1), 4.2), layout="constrained")
    *panels, last = figure.subplots(1, num_positions + 1)
    shown = [run.result.history[i] for i in run.pick(5, smallest=0.01)]
    for coordinate, axes in enumerate(panels):
        plot_boxes(axes, run.transcription, shown, coordinate=coordinate)
    plot_cost_history(last, run)
    return (
        figure,
        "AIGO's boxes, center ± half width, as they shrink, and what that costs. The last center "
        "only proposes a contact sequence; the plan is polished from it.",
    )


def _draw_states(plan: Plan, world: World) -> tuple[Figure, str]:
    """Returns a figure of states against each other, and what a touch costs where that is known."""
    motions, n = motions_of_plan(plan, world), world.num_positions
    figure = Figure(figsize=(4.5 * max(n + (n > 1), 2), 4.6), layout="constrained")
    *portraits, last = figure.subplots(1, max(n + (n > 1), 2))
    for coordinate, axes in enumerate(portraits):
        plot_phase_portrait(axes, motions, world, plan.scenario, coordinate)
    if n > 1:
        plot_path(last, motions, world, plan.scenario)
        return figure, "Velocity against position, and the path."
    if not has_landscape(plan, world):
        figure.delaxes(last)
        return figure, "Velocity against position."
    plot_cost_landscape(last, world, plan.scenario, {"plan": plan.best})
    return figure, (
        "Velocity against position; and what motions cost that touch the wall once, by when and "
        "how fast, with the exact optimum, which the planner does not know."
    )


def has_landscape(plan: Plan, world: World) -> bool:
    """Returns whether the landscape of single touches has the plan on it, and its exact optimum."""
    if world.num_contacts > 1 or len(plan.best.contacts) > 1:
        return False
    try:
        rigid_optimum(world, plan.scenario)
    except ModelError:  # None is known for this world.
        return False
    return True


_CANDIDATE_HEADER = (
    *("", "cost J", "dynamics defect", "deepest penetration", "energy ratio"),
    *("J simulated", "off the goal there", "touches"),
)


def _add_candidates(page: Page, plan: Plan, world: World) -> None:
    page.heading("Candidates")
    count, feasible = len(plan.candidates), sum(each.is_feasible for each in plan.candidates)
    page.paragraph(
        "There was one candidate, the plan."
        if count == 1
        else f"There were {count} candidates, of which {feasible} are feasible; the "
        "first is the plan."
    )
    if plan.stats.flight_left_out is not None:
        least = plan.stats.flight_left_out
        page.paragraph(f"A free flight was left out, as it costs {least:.2e} at least.")
    rows = [
        (str(number), *candidate_texts(each, plan.scenario, world))
        for number, each in enumerate(plan.candidates[:_MOST_CANDIDATES], 1)
    ]
    page.table(_CANDIDATE_HEADER, rows)


def _add_reproduction(page: Page, plan: Plan) -> None:
    page.heading("How to reproduce it")
    page.paragraph(
        f"Save these lines as scenario.yaml and plan again with drake_aigto {__version__}: the "
        f"same question has the same answer. {describe_options(plan.options)}"
    )
    page.code(yaml.safe_dump(plan.scenario.to_plain(), sort_keys=False, allow_unicode=True))
    page.code(_command(plan))
    if plan.additions:
        names = ", ".join(plan.additions)
        page.paragraph(
            f"That leaves out what was added to the planner's program in Python: {names}."
        )
    seconds = sum(plan.stats.seconds.values())
    page.paragraph(
        f"Planned in {seconds:.1f} s, with {plan.stats.aigo_steps} iterations of AIGO. "
        f"{describe_versions()}"
    )


def _command(plan: Plan) -> str:
    """Returns how the page is made again: of a diagram of one's own, only in Python."""
    if plan.made_in and plan.made_in.model is None:
        return (
            'scenario, world = Scenario.load("scenario.yaml"), World.from_diagram(diagram)\n'
            "page = report_plan(plan(scenario, world=world))"
        )
    literal = " --transcription literal" if plan.transcription == "literal" else ""
    return (
        f"drake-aigto plan scenario.yaml{literal} --json plan.json\n"
        "drake-aigto report plan.json --html report.html"
    )


def describe_options(options: SearchOptions | None) -> str:
    """Returns which options of a plan are not the defaults, as a sentence."""
    if options is None:
        return "The plan's file does not say its options."
    changed = [
        "a ladder of one's own" if field.name == "ladder" else f"{field.name} = {value}"
        for field in fields(options)
        if (value := getattr(options, field.name)) != field.default
    ]
    return f"Options: {', '.join(changed)}." if changed else "All options are the defaults."


def describe_versions() -> str:
    """Returns what a page was made with, as a sentence."""
    return (
        f"This page was made by drake_aigto {__version__} on Drake {metadata.version('drake')}, "
        f"Python {platform.python_version()}."
    )
