"""A run in the loop as text, and as one HTML page. What is told of is a simulation."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator

import numpy as np
import yaml
from pydrake.geometry import Meshcat

from drake_aigto.control import ClosedLoopRun
from drake_aigto.plain import to_plain
from drake_aigto.show.loop_figures import figures_of_run, motion_of_run, motions_of_switches
from drake_aigto.show.page import Page
from drake_aigto.show.playback import open_meshcat, publish
from drake_aigto.show.question import add_question
from drake_aigto.show.report import describe_versions
from drake_aigto.show.text import (
    WIDTH,
    cost_text,
    length_text,
    miss_text,
    task_items,
    touch_names,
    weight_text,
)

_ANY_PORT = 0
_LABEL = 12  # columns of the labels at the left
_MOST_TOUCHES, _MOST_TICKS, _MOST_MOTIONS = 6, 30, 4
_METHODS = {
    "tracking": "a plan is tracked (TrackingController)",
    "replanning": "it plans again at every tick (ModelPredictiveController)",
}
INTERRUPTED = "Ctrl-C ended the simulation; this is what happened by then"


def format_run(run: ClosedLoopRun) -> str:
    """Returns what happened, as text of at most 100 columns."""
    return "\n".join(
        line
        for label, text in _tell(run)
        for line in textwrap.wrap(
            text, WIDTH, initial_indent=label.ljust(_LABEL), subsequent_indent=" " * _LABEL
        )
    )


def _tell(run: ClosedLoopRun) -> Iterator[tuple[str, str]]:
    """Yields labels and sentences."""
    replay, world = run.replay, run.world
    walls = "soft walls" if run.scenario.contact == "compliant" else "stiff walls"
    where = f"with {walls}" if world.contacts else "without walls"
    yield "simulation", f"in Drake's Simulator, {where}; {_METHODS[run.method]}"
    if run.is_interrupted:
        yield "interrupted", INTERRUPTED
    yield "disturbed", describe_disturbance(run)
    first = cost_text(run.promised, 3)
    yield "cost", f"{cost_text(run.cost, 3)} along what happened; the first plan promises {first}"
    miss = miss_text(replay, run.scenario, world)
    yield "ends", f"at {run.duration:g} s, {miss} off the goal"
    yield "walls", f"deepest penetration {length_text(replay.max_penetration)}; {_touches(run)}"
    if broken := replay.broken:
        yield "breaks", ", ".join(f"{name} by {replay.violations[name]:.1g}" for name in broken)
    if run.ticks:
        yield "ticks", describe_ticks(run)
        yield "switches", describe_switches(run)
        learned, known = run.ticks[-1].restitution, run.scenario.restitution
        if learned not in (None, known):
            yield "learned", f"walls return {learned:.3f} of a speed; the scenario says {known:g}"


def describe_disturbance(run: ClosedLoopRun) -> str:
    """Returns what the controller did not know."""
    d, items = run.disturbance, []
    if d.start_offset.any():
        items.append(f"start off by {weight_text(d.start_offset)}")
    if d.mass_factor != 1:
        items.append(f"masses times {d.mass_factor:g}")
    if d.friction_factor != 1:
        items.append(f"friction times {d.friction_factor:g}")
    if d.wall_shift:
        items.append(f"walls {1e3 * d.wall_shift:g} mm nearer")
    if d.restitution_factor != 1:
        items.append(f"restitution times {d.restitution_factor:g}")
    if d.kick.any():
        items.append(f"a kick of {weight_text(d.kick)} at {d.kick_time:g} s")
    if d.noise.any():
        items.append(f"noise of {weight_text(d.noise)} (seed {d.seed})")
    return "; ".join(items) or "by nothing"


def _touches(run: ClosedLoopRun) -> str:
    """Returns what was touched when."""
    replay, names = run.replay, touch_names(run.world)
    pairs = list(zip(replay.bounce_contacts, replay.bounce_times, strict=True))
    told = [f"{names[i]} at {time:.3f} s" for i, time in pairs[:_MOST_TOUCHES]]
    more = [f"{len(pairs) - _MOST_TOUCHES} more"] if len(pairs) > _MOST_TOUCHES else []
    return f"touches {', '.join(told + more)}" if told else "nothing is touched"


def describe_ticks(run: ClosedLoopRun) -> str:
    """Returns how many ticks there were, and how long they took."""
    seconds = 1e3 * np.array([tick.seconds for tick in run.ticks])
    text = f"{len(seconds)}; the first took {seconds[0]:.0f} ms"
    if len(seconds) == 1:
        return text
    middle, late = np.percentile(seconds[1:], [50, 99])
    return f"{text}, others {middle:.1f} ms (median), {late:.1f} ms (99 %)"


def describe_switches(run: ClosedLoopRun) -> str:
    """Returns when another plan was taken."""
    times = ", ".join(f"{switch.time:.2f} s" for switch in run.switches)
    return f"another plan was taken at {times}" if times else "the first plan was improved only"


def report_run(run: ClosedLoopRun, progress: Callable[[str], None] | None = None) -> str:
    """Returns a page about a run: self-contained, about 1 MB, for any browser since 2023.

    Before each part that takes time, `progress` is called with a line of text.
    """
    say = progress or (lambda line: None)
    start, _, goal, *_ = task_items(run.scenario, run.world)
    page = Page(f"In the loop: {start}, {goal}")
    page.paragraph(
        "What moves here is a simulation: a plant and its controller in Drake's Simulator, with "
        "Drake's own contact. Plans are shown as what they are, and labeled."
    )
    page.table(("", ""), [(label, text) for label, text in _tell(run)])
    add_question(page, run.scenario, run.world)
    say("recording the simulation")
    page.heading("In motion")
    page.scenes({"Simulation and plans": _record(run)})
    say("drawing figures")
    page.heading("Figures")
    for figure, caption in figures_of_run(run):
        page.figure(figure, caption)
    if run.ticks:
        _add_ticks(page, run)
    page.heading("How to reproduce it")
    for asked in (run.scenario.to_plain(), {"disturbance": to_plain(run.disturbance)}):
        page.code(yaml.safe_dump(asked, sort_keys=False, allow_unicode=True))
    page.paragraph(describe_versions())
    return page.to_html()


def _record(run: ClosedLoopRun) -> str:
    """Returns Meshcat's page of the simulation, and of the plans beside it."""
    meshcat = open_meshcat(_ANY_PORT)
    show_run(run, meshcat)
    return str(meshcat.StaticHtml())


def show_run(run: ClosedLoopRun, meshcat: Meshcat) -> None:
    """Shows a run in Meshcat, with a slider: the simulation, and the first plans beside it."""
    motions = [motion_of_run(run), *motions_of_switches(run)]
    publish(motions[:_MOST_MOTIONS], meshcat, run.true_world, run.scenario)


def _add_ticks(page: Page, run: ClosedLoopRun) -> None:
    """Adds the ticks that did more than go on as before."""
    page.heading("Ticks")
    names = touch_names(run.world)
    telling = [tick for tick in run.ticks if tick.reason != "warm"]
    page.paragraph(
        f"{describe_ticks(run)}. Of {len(run.ticks)}, these {len(telling[:_MOST_TICKS])} did more "
        "than improve the last plan."
    )
    rows = [
        (
            f"{tick.time:.2f} s",
            cost_text(tick.cost),
            ", ".join(names[i] for i in tick.touches[:_MOST_TOUCHES]) or "nothing",
            tick.reason,
            f"{1e3 * tick.seconds:.1f} ms",
        )
        for tick in telling[:_MOST_TICKS]
    ]
    page.table(("", "cost from there on", "the plan touches", "why", "took"), rows)
