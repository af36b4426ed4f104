"""What is shown of a study of robustness: the table, the page, and the figure."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from robustness_studies import QUESTION, make_result

from benchmarks.robustness.page import ROBUSTNESS, format_robustness, plot_robustness
from benchmarks.robustness.question import QUANTITIES, RANDOM
from benchmarks.robustness.study import DRAKE, OURS, PlanResult, RobustnessStudy
from benchmarks.study.page import write_results_page


def test_the_table_has_every_kind_of_every_plan_in_a_hundred_columns() -> None:
    study = RobustnessStudy(QUESTION, (make_result("table1/1, e = 1"),))
    text = format_robustness(study)
    lines = text.splitlines()
    assert max(map(len, lines)) <= 100
    for kind in (*QUANTITIES, RANDOM):
        assert sum(line.startswith(f"    {kind} ± 1 %") for line in lines) == 2
    random = next(line for line in lines if line.startswith("    random"))
    assert random.split()[4:] == [
        *("6.5e-03", "7.0e-03", "1.0", "mm", "2/2"),
        *("6.5e-03", "7.0e-03", "1.0", "mm", "2/2"),
        *("7.0e-03", "6.5e-03"),
    ]
    assert "ours: 1.00e-03, 1.0 mm off the goal, bounce at 0.500 s ---" in text
    assert "gradient: 2.00e-03, 0 m off the goal, no bounce ---" in text
    velocity = next(line for line in lines if line.startswith("    velocity"))
    assert velocity.split().count("0/1") == 2
    summary = next(line for line in lines if line.startswith("  ours, LQR  "))
    assert summary.split()[2:] == [
        *("1", "5.5e-03", "6.0e-03", "1.0", "mm", "1.0", "mm", "2", "of", "2"),
    ]


def test_without_drake_or_random_perturbations_there_is_a_table_too() -> None:
    result = make_result("table1/1, e = 1", kinds=QUANTITIES)
    text = format_robustness(RobustnessStudy(QUESTION, (result,)))
    assert "    mass ± 1 %" in text and "    random" not in text
    plans = tuple(
        dataclasses.replace(plan, outcomes={k: v for k, v in plan.outcomes.items() if k != DRAKE})
        for plan in result.plans
    )
    text = format_robustness(RobustnessStudy(QUESTION, (dataclasses.replace(result, plans=plans),)))
    assert re.search(r"start ± 1 % .* 1/1 +- +1\.0e-03", text)


def test_the_page_has_the_command_the_summary_and_the_figure(tmp_path: Path) -> None:
    file, page = tmp_path / "percent.json", tmp_path / "results.md"
    question = dataclasses.replace(QUESTION, confirm=False)
    failed = PlanResult(OURS, error="nothing was found.")
    done = make_result("table1/2, e = 1")
    results = done, dataclasses.replace(done, name="table1/1, e = 1", plans=(failed,))
    RobustnessStudy(question, results).save(file)
    write_results_page([file], page, {QUESTION.kind: ROBUSTNESS})
    text = page.read_text(encoding="utf-8")
    command = "robustness --rows 1 2 --restitutions 1 --percent 1 --samples 2 --seed 0"
    assert f"    python -m benchmarks {command} --no-confirm\n" in text
    assert "| gradient, LQR | 1 | 4.5e-03 | 5.0e-03 | 1.0 mm | 1.0 mm | 2 of 2 |" in text
    assert "- table1/1, e = 1, ours: nothing was found." in text
    assert "Not all of these tasks" not in text
    (picture,) = re.findall(r"!\[[^]]+\]\((\S+)\)", text)
    assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")
    RobustnessStudy(question, results[:1]).save(file)
    write_results_page([file], page, {QUESTION.kind: ROBUSTNESS})
    assert "Not all of these tasks are done." in page.read_text(encoding="utf-8")


def test_the_figure_has_a_dot_for_every_random_perturbation() -> None:
    names = ["table1/1, e = 1", "table1/2, e = 1"]
    study = RobustnessStudy(QUESTION, tuple(map(make_result, names)))
    axes = Figure().add_subplot()
    plot_robustness(axes, study)
    drawn = [
        np.column_stack(line.get_data()) for line in axes.lines if str(line.get_marker()) in "ox"
    ]
    dots = [line for line in drawn if len(line)]  # The others are the legend's.
    assert len(dots) == 2 * 2 * 2  # Tasks, plans, ways to carry them out.
    assert all(line[:, 1] == pytest.approx([6e-3, 7e-3]) for line in dots)
    assert len({line[0, 0] for line in dots}) == len(dots)
    assert [label.get_text() for label in axes.get_xticklabels()] == names
    assert axes.get_yscale() == "log"
    legend = axes.get_legend()
    assert legend is not None and len(legend.get_texts()) == 5
