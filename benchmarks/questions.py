"""Questions that nobody shipped: each world's scenarios with another task, drawn by seed.

    python -m benchmarks.questions --tuning --count 2 --keep tuning     # to tune on
    python -m benchmarks.questions --keep questions                     # reported, once each
    python -m benchmarks.questions cart_pole/soft_06 spinner/two_radians --count 20
    python -m benchmarks.questions --store              # and let later runs know what is best

A question changes some of: start, goal (as far as beyond a turn), horizon, weight of the control,
stiffness, mass, friction, restitution. What the world refuses is drawn again. Rivals
(`benchmarks.rivals`) have ten times the plan's CPU seconds, together; each motion costs what our
replay of its control does. `docs/results/known_questions.json` stores the best that is known of a
question, and how much time rivals have had: who had enough is not asked again.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import re
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.rivals import ask_rivals
from benchmarks.script import is_met, read_flags, run_all, run_as
from benchmarks.study.scenario_question import round_to
from drake_aigto import AigtoError, Planner, PlanOptions, Scenario, World, scenario_names
from drake_aigto.errors import OptionsError
from drake_aigto.plain import write_text
from drake_aigto.simulation import tangent_scales

PATH = Path(__file__).parents[1] / "docs" / "results" / "known_questions.json"
NEAR, WIDE = 0.01, 0.10
_ROUNDING = 1e-15  # Costs below are as good as zero.
# Each kind of change is made with this probability, and questions without any are drawn again.
_SHARE, _MOST_DRAWS = 0.4, 200
_HORIZON, _MOST_STEPS = (0.3, 4.0), 400
_FRICTION = 0.01, 5.0
_MOST_SECONDS = 60.0  # of CPU time of rivals
_DIGITS = 8  # of costs that are stored
_SAME_DIGITS = 9  # of a question; processors differ in the last ones
_FLOAT = re.compile(r"\d+\.\d*(e[-+]?\d+)?|\d+e[-+]?\d+")

Changes = dict[str, Any]
_Draw = Callable[[np.random.Generator, Scenario, World], Changes]


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** rng.uniform())


def _draw_start(rng: np.random.Generator, scenario: Scenario, world: World) -> Changes:
    q, v = np.split(tangent_scales(world, scenario), 2)
    size = 10 ** rng.uniform(-1.5, 0.0)
    moved = world.add(scenario.initial_position, size * q * rng.normal(size=len(q)))
    return {
        "initial_position": moved,
        "initial_velocity": scenario.initial_velocity + size * v * rng.normal(size=len(v)),
    }


def _draw_goal(rng: np.random.Generator, scenario: Scenario, world: World) -> Changes:
    """Near, or far: of a hinge as far as one and a half turns; a reference goes along with it."""
    units, goal = tangent_scales(world, scenario)[: world.num_velocities], scenario.goal_position
    change = 10 ** rng.uniform(-1.5, 0.0) * units * rng.normal(size=len(units))
    if world.turns.any() and rng.uniform() < 0.3:
        change[world.turns] = rng.uniform(-1.5 * np.pi, 1.5 * np.pi, world.turns.sum())
    changes: Changes = {"goal_position": world.add(goal, change)}
    if scenario.reference_positions is not None and scenario.reference_times is not None:
        share = scenario.reference_times / scenario.duration
        changes["reference_positions"] = scenario.reference_positions + np.outer(share, change)
    return changes


def _draw_horizon(rng: np.random.Generator, scenario: Scenario, _: World) -> Changes:
    factor = _log_uniform(rng, *_HORIZON)
    steps = int(np.clip(round(scenario.num_steps * factor), 10, _MOST_STEPS))
    duration = scenario.duration * factor
    changes: Changes = {"duration": duration, "time_step": duration / steps}
    if scenario.reference_times is not None:
        changes["reference_times"] = factor * scenario.reference_times
    if scenario.duration_range is not None:
        changes["duration_range"] = [factor * each for each in scenario.duration_range]
    return changes


def _draw_effort(rng: np.random.Generator, scenario: Scenario, _: World) -> Changes:
    return {"control_weight": _log_uniform(rng, 0.1, 10.0) * np.asarray(scenario.control_weight)}


def _draw_mass(rng: np.random.Generator, _: Scenario, world: World) -> Changes:
    return {"mass": _log_uniform(rng, 0.1, 10.0) * world.sphere_mass}


def _draw_contact(rng: np.random.Generator, scenario: Scenario, world: World) -> Changes:
    """Of compliant walls the stiffness, of rigid ones the restitution; and friction."""
    changes: Changes = {}
    if scenario.contact == "compliant" and world.contacts:
        stiffness = 2 * float(np.mean(world.stiffness)) * _log_uniform(rng, 0.1, 10.0)
        changes["material"] = {"*": {"stiffness": stiffness}}
    else:
        changes["restitution"] = float(rng.uniform(0.3, 1.0))
    if world.friction_coefficients(scenario).any():
        changes["friction"] = _log_uniform(rng, *_FRICTION)
    return changes


_DRAWS: tuple[_Draw, ...] = (
    *(_draw_start, _draw_goal, _draw_horizon),
    *(_draw_effort, _draw_mass, _draw_contact),
)


@cache
def draw(name: str, number: int, is_tuning: bool) -> Scenario:
    """Returns a question of a shipped scenario, which its world accepts.

    Raises:
        OptionsError: of many draws the world accepts none.
    """
    shipped = Scenario.named(name)
    world = World.from_scenario(shipped)
    shipped = world.place(shipped)
    rng = np.random.default_rng([is_tuning, number, *name.encode()])
    for _ in range(_MOST_DRAWS):
        changes: Changes = {}
        for each in _DRAWS:
            if rng.uniform() < _SHARE:
                try:
                    changes |= each(rng, shipped, world)
                except AigtoError:
                    continue
        try:
            scenario = dataclasses.replace(shipped, **changes)
            if scenario.periodic is not None:  # The goal moves with the start.
                free = dataclasses.replace(scenario, goal_position=None, goal_velocity=None)
                scenario = world.place(free)
            if changes:
                World.from_scenario(scenario).check(scenario)
                return scenario
        except AigtoError:
            continue
    raise OptionsError(name, got=f"no question in {_MOST_DRAWS} draws", expected="one that fits")


class Job(NamedTuple):
    """A question of a shipped scenario, and what rivals have."""

    world: str
    number: int
    is_tuning: bool
    times: float  # the plan's CPU seconds, together; 60 s at most

    @property
    def name(self) -> str:
        """Of what is stored."""
        return f"{self.world} {'tuning ' * self.is_tuning}{self.number}"


@dataclass(frozen=True)
class Row:
    """What came of one question.

    Attributes:
        world: the shipped scenario.
        number: of the question.
        cost: the plan's replay; infinite if there is no plan.
        promised: by the plan.
        idle: what doing nothing costs, where it keeps bounds and a hard goal; infinite elsewhere.
        rival: the best replay of a rival's control.
        known: the best that was known before.
        is_idle: whether the plan does nothing.
        searches: of the plan.
        found: how often these found its motion.
        seconds: CPU seconds of the plan.
        error: why there is no plan.
    """

    world: str
    number: int
    cost: float
    promised: float
    idle: float
    rival: float
    known: float
    is_idle: bool
    searches: int
    found: int
    seconds: float
    error: str = ""

    @property
    def best(self) -> float:
        """The best that is known now."""
        return min(self.cost, self.rival, self.known, self.idle)

    def is_within(self, part: float) -> bool:
        """Returns whether the plan costs at most this part more than the best known."""
        most = self.best + part * abs(self.best) + _ROUNDING
        return self.cost <= most or not math.isfinite(self.best)


class Known(NamedTuple):
    """What is stored of a question.

    Attributes:
        digest: of the scenario; another one makes it another question.
        cost: the best that any run has found, or infinite.
        times: rivals' CPU seconds, in multiples of the plan's.
    """

    digest: str
    cost: float
    times: float


def _digest(scenario: Scenario) -> str:
    shown = _FLOAT.sub(lambda found: f"{float(found[0]):.{_SAME_DIGITS}g}", repr(scenario))
    return f"{zlib.crc32(shown.encode()):08x}"


def load_known() -> dict[str, Known]:
    """Returns what is stored, by world, number, and whether it is to tune on."""
    stored = json.loads(PATH.read_text(encoding="utf-8")) if PATH.exists() else {}
    return {
        name: Known(digest, math.inf if cost is None else cost, times)
        for name, (digest, cost, times) in stored.items()
    }


def find_known(job: Job, known: Mapping[str, Known]) -> Known:
    """Returns what is known of a question; of one that is not stored, or has changed, nothing."""
    digest = _digest(draw(job.world, job.number, job.is_tuning))
    found = known.get(job.name)
    return found if found and found.digest == digest else Known(digest, math.inf, 0.0)


def answer(job: Job) -> Row:
    """Returns what the plan and its rivals make of a question."""
    scenario = draw(job.world, job.number, job.is_tuning)
    _, known, spent = find_known(job, load_known())
    world, cpu = World.from_scenario(scenario), time.process_time()
    options = PlanOptions(confirm=False, threads=1)
    cost = promised = idle = np.inf
    is_idle, searches, found, error = False, 0, 0, ""
    try:
        plan = Planner(scenario, options, world).plan()
        cost, promised, is_idle = plan.best.replay.cost, plan.cost, plan.best.is_idle
        idles = (each for each in plan.candidates if each.is_idle)
        holding = (each for each in idles if each.is_feasible and each.is_confirmed)
        idle = min((each.replay.cost for each in holding), default=np.inf)
        searches, found = plan.stats.searches, plan.stats.found
    except AigtoError as raised:
        error = str(raised)
    seconds = time.process_time() - cpu
    rival = np.inf
    if job.times > spent:
        most = min(job.times * seconds, _MOST_SECONDS)
        rival = ask_rivals(world, scenario, most, min(cost, known))
    cost, promised, idle, rival = (round_to(x, _DIGITS) for x in (cost, promised, idle, rival))
    figures = cost, promised, idle, rival, known
    return Row(job.world, job.number, *figures, is_idle, searches, found, round(seconds, 3), error)


def store(rows: Sequence[Row], is_tuning: bool, times: float) -> None:
    """Stores the best known costs, and rivals' CPU seconds in multiples of the plans'."""
    known = load_known()
    for row in rows:
        job = Job(row.world, row.number, is_tuning, times)
        digest, cost, spent = find_known(job, known)
        known[job.name] = Known(digest, min(row.best, cost), max(times, spent))
    lines = []
    for name, each in sorted(known.items()):
        best = each.cost if math.isfinite(each.cost) else None
        lines.append(f"{json.dumps(name)}: {json.dumps([each.digest, best, each.times])}")
    write_text(PATH, "{\n" + ",\n".join(lines) + "\n}\n")


def format_results(rows: Sequence[Row]) -> str:
    """Returns a table with a line for each world."""
    head = "questions", "1 %", "10 %", "worst", "no plan", "idle, wrongly", "CPU s"
    widths = [max(len(name) + 2, 9) for name in head]
    lines = [f"{'world':24}" + "".join(map(str.rjust, head, widths))]
    for world in dict.fromkeys(row.world for row in rows):
        own = [row for row in rows if row.world == world]
        ratios = [row.cost / row.best if row.best > _ROUNDING else 1.0 for row in own]
        values = (
            f"{len(own)}",
            f"{100 * np.mean([row.is_within(NEAR) for row in own]):.0f}",
            f"{100 * np.mean([row.is_within(WIDE) for row in own]):.0f}",
            f"{max(ratios):.4g}",
            f"{sum(math.isinf(row.cost) for row in own)}",
            f"{sum(row.is_idle and not row.is_within(NEAR) for row in own)}",
            f"{np.median([row.seconds for row in own]):.2f}",
        )
        lines.append(f"{world:24}" + "".join(map(str.rjust, values, widths)))
    return "\n".join(lines)


def main(words: Sequence[str] | None = None) -> int:
    """Prints the table, and returns the exit status: 1 if figures that are asked for are missed."""
    text = "shipped scenarios (default: all)"
    options = read_flags(
        __doc__,
        words,
        place=("worlds", {"nargs": "*", "metavar": "SCENARIO", "help": text}),
        count=(20, "questions of each"),
        times=(10.0, "as many times the plan's CPU seconds for rivals"),
        tuning=(False, "questions to tune on, and not those that are reported"),
        store=(False, "store the best known, so that rivals need not be asked again"),
    )
    worlds = options.worlds or scenario_names()
    for each in worlds:
        Scenario.named(each)  # Before any work.
    asked = itertools.product(range(options.count), worlds)  # The first of each world first.
    jobs = [Job(world, number, options.tuning, options.times) for number, world in asked]
    rows = sorted(run_all(answer, jobs, options), key=lambda row: worlds.index(row.world))
    if options.store:
        store(rows, options.tuning, options.times)
    print(format_results(rows), end="\n\n")
    off = {near: float(np.mean([not row.is_within(near) for row in rows])) for near in (NEAR, WIDE)}
    met = is_met("plans more than 1 % above the best known", off[NEAR], 0.05)
    return int(not (is_met("plans more than 10 % above it", off[WIDE], 0.01) and met))


if __name__ == "__main__":
    run_as("benchmarks.questions")
