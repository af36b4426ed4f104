"""What finds the bounce: the planner with one part changed, or left out, at a time.

Studies of variants of the planner as text, at most 100 columns wide, and as Markdown.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, TypeAlias

from benchmarks.equal_widths import EqualWidths
from benchmarks.study.page import markdown_table
from benchmarks.study.scenario_question import (
    EXHAUSTIVE,
    Job,
    MethodRun,
    Runner,
    ScenarioQuestion,
    read_boxes,
)
from benchmarks.study.scenario_study import (
    ScenarioResult,
    ScenarioStudy,
    count_right_boxes,
    summarize,
)
from benchmarks.study.scenario_tables import failures, ratio_text
from drake_aigto.aigo import AigoResult, Algorithm, Alternating, FullGradient
from drake_aigto.errors import OptionsError
from drake_aigto.planning import (
    BALL_LADDER,
    BallSearch,
    BallTask,
    Origin,
    PlanOptions,
    Rung,
    coarsen,
    run_search,
)
from drake_aigto.simulation import replay_event_driven
from drake_aigto.transcription import RESTITUTION, RigidTranscription, Touch, TouchSequence
from drake_aigto.world import Scenario, World

Way: TypeAlias = Literal["plan", "replay", "listed"]


@dataclass(frozen=True)
class Variant:
    """A planner that differs from the default with all rungs, or from the bare one, in one thing.

    Attributes:
        group: what is varied.
        options: of the planner.
        algorithm: that shrinks boxes in place of the planner's.
        pull: whether contact sequences are read off box centers that a penalty continuation has
            pulled towards the rows.
        way: "plan"; or "replay", the controls in the centers of AIGO's last boxes as they are, the
            best of all rungs, without any polish; or "listed", the flight and one bounce polished,
            without AIGO.
    """

    group: str
    options: PlanOptions = EXHAUSTIVE
    algorithm: Algorithm | None = None
    pull: bool = False
    way: Way = "plan"


def _of(start: str) -> tuple[Rung, ...]:
    return tuple(rung for rung in BALL_LADDER if rung.start == start)


def _reweighed(rungs: Iterable[Rung], **weights: float) -> tuple[Rung, ...]:
    return tuple(dataclasses.replace(r, weights={**r.weights, **weights}) for r in rungs)


def _with(options: PlanOptions, **changes: object) -> PlanOptions:
    return dataclasses.replace(options, **changes)  # type: ignore[arg-type]


# Only boxes can find a bounce here: none starts in a simulation, no neighbour is tried.
_BARE = _with(EXHAUSTIVE, ladder=_of("line"), branches=0)
# A local optimum of the penalized cost itself.
_NO_BOXES = EqualWidths(first_share=0.0, final_share=0.0, max_newton_steps=200)
# Name → algorithm, and whether its end is pulled towards the rows.
_SHRINKING: Mapping[str, tuple[Algorithm, bool]] = {
    "equal widths": (EqualWidths(), False),
    "no boxes": (_NO_BOXES, False),
    "no boxes, continued": (_NO_BOXES, True),
    "Algorithm 1": (FullGradient(), False),
    "alternating": (Alternating(), False),
}


def _make_variants() -> dict[str, Variant]:
    """Returns all variants by name."""
    found = {
        "default": Variant("search"),
        "no neighbours": Variant("search", _with(EXHAUSTIVE, branches=0)),
        "line only": Variant("search", _with(EXHAUSTIVE, ladder=_of("line"))),
        "coast only": Variant("search", _with(EXHAUSTIVE, ladder=_of("coast"))),
        "listed, no AIGO": Variant("search", way="listed"),
    }
    for name, (algorithm, pull) in _SHRINKING.items():
        found[name] = Variant("boxes", algorithm=algorithm, pull=pull)
    found["bare"] = Variant("boxes, bare", _BARE)
    for name, (algorithm, pull) in _SHRINKING.items():
        found[f"bare, {name}"] = Variant("boxes, bare", _BARE, algorithm, pull)
    for number, rung in enumerate(BALL_LADDER, 1):
        found[f"rung {number} alone"] = Variant("ladder", _with(EXHAUSTIVE, ladder=(rung,)))
    for name, options in {"": EXHAUSTIVE, "bare, ": _BARE}.items():
        ladder = _reweighed(options.ball_ladder, **{RESTITUTION: 0.0})
        found[f"{name}no restitution row"] = Variant("rows", _with(options, ladder=ladder))
    found |= {
        "no polish": Variant("polish", way="replay"),
        "no polish, continued": Variant("polish", pull=True, way="replay"),
    }
    return found


# Name → variant. "Bare" has only the rungs around the straight line, and tries no neighbours;
# "continued" means that a penalty continuation pulls what the boxes found towards the rows.
VARIANTS: Mapping[str, Variant] = _make_variants()


@dataclass(frozen=True, kw_only=True)
class AblationQuestion(ScenarioQuestion):
    """Random scenarios, and the variants of the planner that are to solve them.

    Attributes:
        count: of scenarios.
        methods: names of `VARIANTS`.
        budgets: none has one: each variant takes the time that it takes.
    """

    count: int = 60
    methods: tuple[str, ...] = tuple(VARIANTS)
    budgets: tuple[float, ...] = (1.0,)

    kind: ClassVar[str] = "ablations"
    command: ClassVar[str] = "python -m benchmarks ablations"
    flags: ClassVar[Mapping[str, str]] = {"num_steps": "steps", "methods": "variants"}

    @property
    def runner(self) -> Runner:
        """What runs a variant."""
        return run_variant

    def check(self) -> None:
        """Refuses what is no variant."""
        unknown = [name for name in self.methods if name not in VARIANTS]
        if unknown:
            raise OptionsError(
                "variants",
                got=", ".join(map(repr, unknown)),
                expected=f"some of {', '.join(map(repr, VARIANTS))}",
            )


class AblationStudy(ScenarioStudy):
    """All variants on all scenarios."""

    question_type: ClassVar[Any] = AblationQuestion


def run_variant(world: World, job: Job) -> MethodRun:
    """Returns what the variant that a job names makes of its scenario."""
    variant, scenario = VARIANTS[job.method], job.scenario
    start = time.process_time()
    cost, boxes = _WAYS[variant.way](world, scenario, variant)
    seconds = time.process_time() - start
    improvements = ((seconds, cost),) if math.isfinite(cost) else ()
    return MethodRun(improvements, seconds, boxes=boxes)


_Found: TypeAlias = tuple[float, tuple[int, ...]]


class VariantProblem(BallTask):
    """The planner's problem with one part changed."""

    def __init__(self, variant: Variant, world: World, scenario: Scenario) -> None:
        """Compiles."""
        self._variant = variant
        coarse = coarsen(world, scenario, variant.options)
        transcription = RigidTranscription(world, coarse, variant.options.relaxation)
        super().__init__(transcription, variant.options, scenario.num_steps)

    def make_algorithm(self, rung: Rung) -> Algorithm:
        """Returns the variant's, or the planner's."""
        return self._variant.algorithm or super().make_algorithm(rung)

    @property
    def algorithm_name(self) -> str:
        """The algorithm's class, if it is the variant's."""
        algorithm = self._variant.algorithm
        return type(algorithm).__name__ if algorithm else super().algorithm_name

    def find_sequences(self, result: AigoResult, rung: Rung) -> list[TouchSequence]:
        """Returns the contact sequences that the box shows, or its center when it is pulled."""
        if self._variant.pull:
            box = dataclasses.replace(result.box, center=self.pull(result.box.center, rung))
            result = dataclasses.replace(result, box=box)
        return super().find_sequences(result, rung)


def _plan(world: World, scenario: Scenario, variant: Variant) -> _Found:
    """Returns a plan's cost when replayed, and how many contacts the box of each rung shows."""
    plan = run_search(BallSearch(VariantProblem(variant, world, scenario)), scenario)
    return plan.replay.event_driven.cost, read_boxes(plan)


def _replay_boxes(world: World, scenario: Scenario, variant: Variant) -> _Found:
    """Returns the least cost of what AIGO's boxes hold, replayed without any polish."""
    problem = VariantProblem(variant, world, scenario)
    costs, contacts = [], []
    for rung in variant.options.ball_ladder:
        result = problem.run_aigo(rung)
        center = problem.pull(result.box.center, rung) if variant.pull else result.box.center
        sequences = problem.find_sequences(result, rung)
        contacts.append(len(sequences[0]) if sequences else 0)
        boxes = problem.start(rung.start).transcription
        control = boxes.GetSampleTimes(), boxes.split(center)[2]
        costs.append(replay_event_driven(world, scenario, *control).cost)
    return min(costs), tuple(contacts)


def _polish_listed(world: World, scenario: Scenario, variant: Variant) -> _Found:
    """Returns the cost of the best of flight and one bounce, polished as AIGO's sequences are."""
    problem = VariantProblem(variant, world, scenario)
    search = BallSearch(problem)
    bounce = Touch.bounce(scenario.duration / 2)
    listed: tuple[TouchSequence, ...] = ((), (bounce,))
    for sequence in listed:
        search.add(Origin("listed"), problem.box.center, sequence)
    for sequence in search.finalists()[: variant.options.finalists]:
        search.improve(sequence)
    ranked = search.ranked()
    return (ranked[0].replay.cost if ranked else math.inf), ()


_WAYS: Mapping[Way, Callable[[World, Scenario, Variant], _Found]] = {
    "plan": _plan,
    "replay": _replay_boxes,
    "listed": _polish_listed,
}


def count_lost_bounces(results: Iterable[ScenarioResult], variant: str) -> tuple[int, int]:
    """Returns how many last boxes show no contact where the optimum has one, and of how many.

    All rungs count.

    Args:
        results: of a study.
        variant: its name.
    """
    boxes = [
        contacts
        for result in results
        if result.contacts and variant in result.runs
        for contacts in result.runs[variant].boxes
    ]
    return sum(contacts == 0 for contacts in boxes), len(boxes)


_LEGEND = """\
optimal   replayed on a rigid wall, costs at most 1.01 J* + 1e-7 J; J* is exact
cost / J* the median, where J* > 1e-7 J; none: most found nothing
seconds   of one core, the median
boxes     have as many contacts as the optimum, before any polish: those of the best rung, of any
lost      of all boxes of scenarios whose optimum has a bounce, those that show no contact
bare      only rungs around the straight line, and no neighbours of candidates"""
_HEADS = ("optimal", "cost / J*", "seconds", "best rung", "any rung", "lost")


def format_ablations(study: ScenarioStudy) -> str:
    """Returns a study's table, a line for each variant, and what failed."""
    bounces = sum(result.contacts > 0 for result in study.results)
    head = f"{len(study.results)} scenarios, of which {bounces} have a bounce in the optimum"
    lines = [head, _line("", ("", "", "", "boxes", "", "")), _line("variant", _HEADS)]
    group = None
    for variant in study.question.methods:
        if VARIANTS[variant].group != group:
            group = VARIANTS[variant].group
            lines.append("")
        lines.append(_line(variant, _cells(study, variant)))
    return "\n".join([*lines, "", _LEGEND, *failures(study)])


def markdown_ablations(study: ScenarioStudy) -> str:
    """Returns the same numbers as a Markdown table."""
    heads = ("varied", "variant", *_HEADS[:3], "boxes right: best rung", "any rung", "bounces lost")
    return markdown_table(
        heads,
        (
            [VARIANTS[variant].group, variant, *_cells(study, variant)]
            for variant in study.question.methods
        ),
    )


def _line(name: str, cells: tuple[str, ...]) -> str:
    widths = (10, 12, 9, 12, 12, 8)
    texts = [cell.rjust(width) for cell, width in zip(cells, widths, strict=True)]
    return (name.ljust(30) + "".join(texts)).rstrip()


def _cells(study: ScenarioStudy, variant: str) -> tuple[str, ...]:
    summary = summarize(study, study.results, variant)
    each, either, count = count_right_boxes(study.results, variant)
    lost, boxes = count_lost_bounces(study.results, variant)
    return (
        _share(summary.num_optimal[-1], summary.num_scenarios),
        ratio_text(summary.median_ratio),
        "-" if math.isnan(summary.median_seconds) else f"{summary.median_seconds:.2f}",
        _share(max(each, default=0), count),
        _share(either, count),
        _share(lost, boxes),
    )


def _share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.0f} %" if whole else "-"
