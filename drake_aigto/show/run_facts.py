"""Facts about runs in the loop, and these as text."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from drake_aigto.progress import list_some
from drake_aigto.show import words
from drake_aigto.show.facts import Fact, format_facts

if TYPE_CHECKING:
    from drake_aigto.control import ClosedLoopRun

CUT_SHORT = "Ctrl-C ended the simulation; this is the motion until then"

_METHODS = {
    "tracking": "a plan is tracked (TrackingController)",
    "replanning": "it plans again at every tick (ModelPredictiveController)",
}


def format_run(run: ClosedLoopRun) -> str:
    """Returns what happened in the loop, as text."""
    return "\n".join(format_facts(run_facts(run)))


def run_facts(run: ClosedLoopRun) -> Iterator[Fact]:
    """Yields what happened in the loop."""
    replay, world = run.replay, run.world
    walls = "soft walls" if run.scenario.contact == "compliant" else "stiff walls"
    where = f"with {walls}" if world.contacts else "without walls"
    yield "goal", words.join_items(words.goal_items(run.arrival))
    yield "simulation", f"in Drake's Simulator, {where}; {_METHODS[run.method]}"
    if run.is_interrupted:
        yield "interrupted", CUT_SHORT
    d, filtered = run.disturbance, ", filtered before the controller" if run.is_filtered else ""
    disturbed = {
        f"start off by {words.weight_text(d.start_offset)}": d.start_offset.any(),
        f"masses times {d.mass_factor:g}": d.mass_factor != 1,
        f"friction times {d.friction_factor:g}": d.friction_factor != 1,
        f"walls {1e3 * d.wall_shift:g} mm nearer": d.wall_shift,
        f"restitution times {d.restitution_factor:g}": d.restitution_factor != 1,
        f"a kick of {words.weight_text(d.kick)} at {d.kick_time:g} s": d.kick.any(),
        f"noise of {words.weight_text(d.noise)} (seed {d.seed}){filtered}": d.noise.any(),
        f"commands {1e3 * d.delay:g} ms late": d.delay,
        f"stiffness times {d.stiffness_factor:g}": d.stiffness_factor != 1,
        f"commands cut at {d.saturation.tolist()}": d.saturation.any(),
    }
    yield "disturbed", "; ".join(text for text, is_so in disturbed.items() if is_so) or "by nothing"
    cost, first = (words.cost_text(each, 3) for each in (run.cost, run.promised))
    yield "cost", f"{cost} along the simulated motion; the first plan promises {first}"
    yield "ends", f"at {run.duration:g} s"
    pairs = zip(replay.bounce_times, replay.bounce_contacts, strict=True)
    touches = list_some(words.name_touch(pair, words.touch_names(world)) for pair in pairs)
    touched = f"touches {touches}" if touches else "nothing is touched"
    yield "walls", f"deepest penetration {words.length_text(replay.max_penetration)}; {touched}"
    if broken := replay.broken:
        yield "breaks", ", ".join(f"{name} by {replay.violations[name]:.1g}" for name in broken)
    if run.ticks:
        yield "ticks", describe_ticks(run)
        times = ", ".join(f"{switch.time:.2f} s" for switch in run.switches)
        taken = f"another plan was taken at {times}"
        yield "switches", taken if times else "the first plan was only improved"
        learned, known = run.ticks[-1].restitution, run.scenario.restitution
        if learned not in (None, known):
            yield "learned", f"walls restore {learned:.3f} of a speed; the scenario says {known:g}"


def describe_ticks(run: ClosedLoopRun) -> str:
    """Returns how many ticks there were, and how long they took."""
    seconds = 1e3 * np.array([tick.seconds for tick in run.ticks])
    first = f"{seconds[0]:.0f} ms" if seconds[0] < 1e3 else f"{1e-3 * seconds[0]:.1f} s"
    text = f"{len(seconds)}; the first took {first}"
    if len(seconds) == 1:
        return text
    middle, late = np.percentile(seconds[1:], [50, 99])
    return f"{text}, others {middle:.1f} ms (median), {late:.1f} ms (99 %)"
