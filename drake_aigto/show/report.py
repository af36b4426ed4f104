"""Plans and runs in the loop as one HTML page: question, answer, verdict, recording, figures."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterable
from dataclasses import fields
from importlib import metadata
from typing import Any

import numpy as np
import yaml
from pydrake.geometry import Meshcat

from drake_aigto import __version__
from drake_aigto.control import ClosedLoopRun
from drake_aigto.errors import OptionsError
from drake_aigto.plain import to_plain
from drake_aigto.planning import BALL_LADDER, Candidate, Plan, SearchOptions
from drake_aigto.progress import list_some
from drake_aigto.show import report_figures, words
from drake_aigto.show.box_playback import play_boxes, run_boxes
from drake_aigto.show.facts import answer_facts, candidate_texts, count_candidates
from drake_aigto.show.film import open_meshcat
from drake_aigto.show.motion import motions_of_plan, simulation_label
from drake_aigto.show.page import Page, Playback
from drake_aigto.show.run_facts import describe_ticks, run_facts
from drake_aigto.show.scene import publish
from drake_aigto.show.views import add_verdict
from drake_aigto.simulation import Replay
from drake_aigto.world import Scenario, World

_ANY_PORT = 0
_MOST_CANDIDATES, _MOST_TICKS, _MOST_MOTIONS = 10, 30, 4

_NUMBERS = (
    *("", "touches", "cost J", "dynamics defect", "off the goal", "deepest penetration"),
    "energy ratio",
)
_CANDIDATE_HEADER = (
    *("", "touches", "cost J", "dynamics defect", "deepest penetration", "energy ratio"),
    *("J simulated", "off the goal there"),
)

PROBLEM = """\
minimize over u   ∫₀ᵀ w_u ‖u(t)‖² dt + w_f ‖q(T) − q_goal‖²
subject to        M v̇ + h(q, v) = B u + J(q)ᵀ λ,    0 ≤ φ(q) ⊥ λ ≥ 0,    q(0), v(0) given
                  J v⁺ = −e J v⁻  where a wall is hit"""
# Of tasks that ask for more than that, with e_q and e_v the errors of q and v.
_COST = """\
minimize over u   ∫₀ᵀ uᵀ R u + e_qᵀ Q e_q + e_vᵀ Q_v e_v dt
                  + e_q(T)ᵀ Q_T e_q(T) + e_v(T)ᵀ Q_vT e_v(T)"""
_SOFT = """\
subject to        M v̇ + h(q, v) = B u + J(q)ᵀ λ,    λ = k x max(0, 1 + d ẋ),    x = max(0, −φ(q)),
                  q(0), v(0) given"""
_WEIGHTS = {
    "R": "control_weight",
    "Q": "position_weight",
    "Q_v": "velocity_weight",
    "Q_T": "goal_weight",
    "Q_vT": "goal_velocity_weight",
}


def report_plan(
    plan: Plan, world: World | None = None, progress: Callable[[str], None] | None = None
) -> str:
    """Returns a page about a plan: self-contained, about 1.7 MB, for any browser since 2023.

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
        # Shooting has none, as everybody expects.
        no_boxes = "" if plan.transcription == "shooting" else f"AIGO's boxes are missing: {error}"
    page = Page(f"Plan for {words.plan_name(plan.scenario, world)}")
    add_verdict(page, plan, world)
    add_question(page, plan.scenario, world, float(plan.trajectory.times[-1]))
    add_answer(page, plan, world)
    say("recording the plan, its simulations, and the boxes")
    meshcat, motions = open_meshcat(_ANY_PORT), motions_of_plan(plan, world)
    control = plan.trajectory.times, plan.trajectory.controls
    driven = [motion.under(*control) for motion in motions]
    scenes = {"Plan and simulations": publish(driven, meshcat, world, plan.scenario).scene}
    if run is not None:
        scenes["AIGO's boxes"] = play_boxes(plan, meshcat, world, run).scene
    page.heading("In motion")
    page.scenes(scenes)
    say("drawing figures")
    page.heading("Figures")
    for figure, caption in report_figures.figures_of_plan(plan, motions, world, run):
        page.figure(figure, caption)
    page.figure(*report_figures.draw_portraits(motions, world, plan.scenario), is_folded=True)
    if no_boxes:
        page.paragraph(no_boxes)
    _add_candidates(page, plan, world)
    _add_reproduction(page, plan)
    return page.to_html()


def add_question(
    page: Page, scenario: Scenario, world: World, duration: float | None = None
) -> None:
    """Adds what was asked; a free duration is the plan's."""
    page.heading("The question")
    if scenario.is_plain:
        problem = PROBLEM
        weights = f"w_u = {scenario.control_weight:g}, w_f = {scenario.goal_weight:g}"
    else:
        rigid = PROBLEM[PROBLEM.index("subject to") :]
        problem = "\n".join([_COST, rigid if scenario.contact == "rigid" else _SOFT])
        found = ((symbol, getattr(scenario, name)) for symbol, name in _WEIGHTS.items())
        weights = "; ".join(
            f"{symbol} = {words.weight_text(w)}" for symbol, w in found if np.any(w)
        )
    page.code(problem)
    names = words.contact_names(world)  # Several of them are facts of the question already.
    alone = [] if len(names) > 1 else [("pairs", names[0] if names else "none")]
    more = [*alone, ("weights", weights), ("model", world.model or "a diagram of one's own")]
    page.facts([*words.question_facts(scenario, world, duration), *more])


def add_answer(page: Page, plan: Plan, world: World) -> None:
    """Adds a plan's numbers and contacts, and those of its simulations."""
    page.heading("The answer")
    best = plan.best
    runs: list[tuple[str, Candidate | Replay, str, Iterable[float]]] = [
        ("plan (no simulation)", best, f"{best.max_defect:.0e}", (c.time for c in best.contacts)),
        *((simulation_label(r, world), r, "none", r.bounce_times) for r in plan.replay),
    ]
    rows = (
        (
            label,
            list_some((f"{time:.3f}" for time in times), " s") or "none",
            words.cost_text(run.cost, 3, best.scales.cost),
            defect,
            words.miss_text(run, plan.scenario, world),
            words.length_text(run.max_penetration),
            words.energy_text(run.energy_ratio),
        )
        for label, run, defect, times in runs
    )
    page.table(_NUMBERS, rows)
    page.paragraph(
        "The plan is what the optimizer promises. The simulations apply its control alone, from "
        "the start, and know nothing else about the plan."
    )
    page.facts(answer_facts(plan, world))


def _add_candidates(page: Page, plan: Plan, world: World) -> None:
    page.heading("Candidates")
    page.paragraph(f"Candidates: {count_candidates(plan)}.")
    if plan.stats.flight_left_out is not None:
        least = plan.stats.flight_left_out
        page.paragraph(f"A free flight was skipped: it costs at least {words.cost_text(least)}.")
    rows = []
    for number, candidate in enumerate(plan.candidates[:_MOST_CANDIDATES], 1):
        *numbers, touches = candidate_texts(candidate, plan.scenario, world)
        rows.append((str(number), touches, *numbers))
    page.table(_CANDIDATE_HEADER, rows)


def _add_reproduction(page: Page, plan: Plan) -> None:
    page.heading("How to reproduce it")
    page.paragraph(
        f"Save these lines as scenario.yaml and plan again with drake_aigto {__version__}: the "
        f"same question has the same answer. {_describe_options(plan.options)}"
    )
    _add_yaml(page, plan.scenario.to_plain())
    literal = " --transcription literal" if plan.transcription == "literal" else ""
    command = (
        f"drake-aigto plan scenario.yaml{literal} --json plan.json\n"
        "drake-aigto report plan.json --html report.html"
    )
    if plan.made_in.model is None:  # Of a diagram of one's own: only in Python.
        command = (
            'scenario, world = Scenario.load("scenario.yaml"), World.from_diagram(diagram)\n'
            "page = report_plan(plan(scenario, world=world))"
        )
    page.code(command)
    if plan.additions:
        names = ", ".join(plan.additions)
        page.paragraph(
            f"These lines lack the additions to the planner's program in Python: {names}."
        )
    seconds = sum(plan.stats.seconds.values())
    page.paragraph(f"Planned in {seconds:.1f} s: {plan.stats}. {describe_versions()}")


def _add_yaml(page: Page, asked: Any) -> None:
    page.code(yaml.safe_dump(asked, sort_keys=False, allow_unicode=True))


def _describe_options(options: SearchOptions | None) -> str:
    """Returns which options of a plan are not the defaults, as a sentence."""
    if options is None:
        return "The plan's file does not say its options."
    changed = [
        "a custom ladder" if field.name == "ladder" else f"{field.name} = {value}"
        for field in fields(options)
        if (value := getattr(options, field.name)) not in (BALL_LADDER, field.default)
    ]
    return f"Options: {', '.join(changed)}." if changed else "All options are the defaults."


def describe_versions() -> str:
    """Returns what a page was made with, as a sentence."""
    return (
        f"This page was made by drake_aigto {__version__} on Drake {metadata.version('drake')}, "
        f"Python {platform.python_version()}."
    )


def report_run(run: ClosedLoopRun, progress: Callable[[str], None] | None = None) -> str:
    """Returns a page about a run: self-contained, about 1.5 MB, for any browser since 2023.

    Before each part that takes time, `progress` is called with a line of text.
    """
    say = progress or (lambda line: None)
    page = Page(f"In the loop: {words.plan_name(run.scenario, run.world)}")
    page.paragraph(
        "The motion is a simulation: a plant with its controller in Drake's Simulator, with "
        "Drake's own contact. Plans are labeled as such."
    )
    (_, goal), *others = run_facts(run)
    page.verdict(f"goal {goal}", run.arrival.is_reached)
    page.facts(others)
    add_question(page, run.scenario, run.world)
    say("recording the simulation")
    page.heading("In motion")
    meshcat = open_meshcat(_ANY_PORT)
    page.scenes({"Simulation and plans": show_run(run, meshcat).scene})
    say("drawing figures")
    page.heading("Figures")
    for figure, caption in report_figures.figures_of_run(run):
        page.figure(figure, caption)
    if run.ticks:
        _add_ticks(page, run)
    page.heading("How to reproduce it")
    _add_yaml(page, run.scenario.to_plain())
    _add_yaml(page, {"disturbance": to_plain(run.disturbance)})
    page.paragraph(describe_versions())
    return page.to_html()


def show_run(run: ClosedLoopRun, meshcat: Meshcat) -> Playback:
    """Shows a run in Meshcat, with a slider: the simulation, and the first plans as ghosts.

    A flash is a kick, or the moment at which another plan was taken, which is there from then on.
    """
    motions = [report_figures.motion_of_run(run), *report_figures.motions_of_switches(run)][
        :_MOST_MOTIONS
    ]
    events = {switch.time: "takes another plan" for switch in run.switches}
    if run.disturbance.kick.any():
        events[run.disturbance.kick_time] = "is kicked"
    return publish(motions, meshcat, run.true_world, run.scenario, events)


def _add_ticks(page: Page, run: ClosedLoopRun) -> None:
    """Adds the ticks that did more than go on as before."""
    page.heading("Ticks")
    names = words.touch_names(run.world)
    telling = [tick for tick in run.ticks if tick.reason != "warm"]
    page.paragraph(
        f"{describe_ticks(run)}. Of {len(run.ticks)}, these {len(telling[:_MOST_TICKS])} did more "
        "than improve the last plan."
    )
    rows = [
        (
            f"{tick.time:.2f} s",
            words.cost_text(tick.cost),
            list_some(names[i] for i in tick.touches) or "nothing",
            tick.reason,
            f"{1e3 * tick.seconds:.1f} ms",
        )
        for tick in telling[:_MOST_TICKS]
    ]
    page.table(("", "cost from there on", "the plan touches", "why", "took"), rows)
