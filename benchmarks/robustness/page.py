"""The part of the results page on robustness."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from matplotlib.figure import Figure

from benchmarks.robustness.figures import markdown_robustness, plot_robustness
from benchmarks.robustness.study import RobustnessStudy
from benchmarks.study.page import Images, Section
from benchmarks.study.study import command_of

_INTRODUCTION = """\
## Robustness

Plans where the truth is a little other than they were made for: start, velocity, wall, mass and
restitution, all at once and at random. *Ours* is the planner's plan, *gradient* what IPOPT makes of
flight that touches nothing. Open loop the plan's control runs as it is; with LQR, feedback
(Drake's finite-horizon LQR on each flight) tracks the plan and goes on to its next flight when the
ball bounces. *Possible* is the exact optimum under a perturbation that is known beforehand.
"""
_TASKS_A_ROW = 12


def _describe(path: Path, images: Images) -> Iterator[str]:
    study = RobustnessStudy.load(path)
    question = study.question
    yield f"### Everything ± {question.percent:g} %\n"
    yield f"    {command_of(question)}\n"
    yield f"{markdown_robustness(study)}\n"
    if len(study.results) < len(question.tasks()):
        yield "Not all of these tasks are done.\n"
    for result in study.results:
        for plan in result.plans:
            if plan.error is not None:
                yield f"- {result.name}, {plan.method}: {plan.error}\n"
    yield images.add(
        f"{path.stem}_costs",
        draw_robustness(study),
        "Costs under random perturbations of every task: ours and the gradient solver's plan, open "
        "loop and with feedback, and what is possible",
    )


ROBUSTNESS = Section(_INTRODUCTION, _describe)


def draw_robustness(study: RobustnessStudy) -> Figure:
    """Returns the costs of every task under random perturbations, some tasks a row."""
    starts = range(0, len(study.results), _TASKS_A_ROW)
    figure = Figure(figsize=(9.0, 0.6 + 3.0 * len(starts)), layout="constrained")
    column = figure.subplots(len(starts), squeeze=False)[:, 0]
    for axes, start in zip(column, starts, strict=True):
        plot_robustness(axes, study, study.results[start : start + _TASKS_A_ROW])
        if start:
            axes.get_legend().remove()
    return figure
