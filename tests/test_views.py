"""What a plan shows of itself, through the one hook that the room of pictures fills."""

from __future__ import annotations

import base64
import csv
import dataclasses
import gzip
import html
import itertools
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image, ImageSequence

from drake_aigto import Plan, Scenario, World, __version__
from drake_aigto.cli import FINE, main
from drake_aigto.errors import ModelError, OptionsError, OutputFileError
from drake_aigto.paper import Entry, RigidCell, RigidOptimum, Table1, TableMethod
from drake_aigto.planning import VIEWS, Replays
from drake_aigto.show import (
    Page,
    add_answer,
    add_question,
    add_verdict,
    compare,
    describe_difference,
    embed_scenes,
    format_plan,
    frame,
    has_landscape,
    report_plan,
    report_table1,
    to_csv,
)
from drake_aigto.world import scenario_names, scenario_seconds, scenario_summaries


def test_a_plot_has_the_motion_and_its_numbers_over_time(plan: Plan) -> None:
    figure = plan.plot()
    assert figure.get_suptitle().startswith("table1/1, ")
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels[1:] == ["position q [m]", "velocity v [m/s]", "control u [N]"]
    assert sorted(VIEWS) == ["animate", "plot", "to_dataframe", "to_html"]


def test_an_animation_has_frames_of_the_whole_motion(plan: Plan, tmp_path: Path) -> None:
    path = plan.animate(tmp_path / "plan.gif", rate=4)
    with Image.open(path) as shown:
        shots = [(each.info["duration"], each.copy()) for each in ImageSequence.Iterator(shown)]
    assert [duration for duration, _ in shots] == [250, 250, 250, 250, 500]  # The end stands.
    frames = [np.array(frame.convert("RGB")) for _, frame in shots]
    assert all(np.any(a != b) for a, b in itertools.pairwise(frames))


def test_a_video_without_ffmpeg_names_the_extra_and_other_files_are_refused(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(OptionsError, match=r"got no ffmpeg, expected .* the extra `video`"):
        plan.animate(tmp_path / "plan.mp4")
    with pytest.raises(OptionsError, match=r"got plan.png, expected one of .gif, .webp"):
        plan.animate(tmp_path / "plan.png")
    with pytest.raises(OutputFileError, match="no folder"):
        plan.animate(tmp_path / "nowhere" / "plan.gif")
    for name in ("rate", "speed", "width"):
        with pytest.raises(OptionsError, match=f"`{name}` of an animation: got 0, expected more"):
            plan.animate(tmp_path / "plan.gif", **{name: 0})


def test_a_table_has_a_row_for_each_knot(
    plan: Plan, plan_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    header, *rows = csv.reader(to_csv(plan).splitlines())
    assert header[:4] == ["time", "position slider_x", "velocity slider_v", "control slider"]
    read = np.array(rows, dtype=float)
    np.testing.assert_array_equal(read[:, 1], plan.trajectory.positions[:, 0])
    np.testing.assert_array_equal(read[:-1, 3], plan.trajectory.controls[:, 0])
    assert np.isnan(read[-1, 3])
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(OptionsError, match=r"got no pandas, expected the extra `tables`"):
        plan.to_dataframe()


def test_a_notebook_shows_both_verdicts_and_a_picture(plan: Plan) -> None:
    shown = plan._repr_html_()
    assert "✓ Holds" in shown and "Goal reached" in shown and "data:image/svg+xml" in shown


def test_plans_of_one_world_are_compared_on_one_page(plan_file: Path, tmp_path: Path) -> None:
    page = tmp_path / "both.html"
    again = tmp_path / "again.json"
    shutil.copy(plan_file, again)
    assert main(["compare", str(plan_file), str(again), "--html", str(page)]) == FINE
    text = page.read_text("utf-8")
    assert "<title>Plans for table1/1, " in text and "plan, again</title>" in text
    for told in ("cost J", "dynamics defect", "deepest penetration", "energy ratio", "J simulated"):
        assert f"<th>{told}</th>" in text
    assert text.count("plan (not a simulation)") >= 2 and "<th>again</th>" in text
    assert len(text.encode()) < 3e6
    plan = Plan.load(plan_file)
    other = dataclasses.replace(plan, made_in=dataclasses.replace(plan.made_in, coordinates=("q",)))
    with pytest.raises(ModelError, match=r"got b: .*, expected plans for the world of a"):
        compare({"a": plan, "b": other})
    with pytest.raises(OptionsError, match="plans: got none"):
        compare({})


def test_shipped_scenarios_are_listed_with_what_each_shows(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["list", "corridor"]) == FINE
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "scenario                CPU s  what it shows"
    assert len(lines) == 4 and lines[1].startswith("corridor/lossy  ")
    assert (
        lines[1].split()[1] == f"{scenario_seconds()['corridor/lossy']:g}"
        and "Each bounce keeps 0.8" in lines[1]
    )
    assert main(["list"]) == FINE
    assert len(capsys.readouterr().out.splitlines()) == 1 + len(scenario_summaries())
    assert set(scenario_names()) | set(scenario_seconds()) <= set(scenario_summaries())
    assert main(["list", "xyz"]) != FINE


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
@pytest.mark.parametrize(
    ("typed", "completed"),
    [("pl", "plan plan-many play"), ("plan table1/", "table1/1 table1/2 table1/3 table1/4")],
)
def test_bash_completes_commands_and_scenarios(
    typed: str, completed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["completion"]) == FINE
    words = f"drake-aigto {typed}"
    ask = f"COMP_WORDS=({words}); COMP_CWORD={len(words.split()) - 1}; _drake_aigto"
    program = f'{capsys.readouterr().out}\n{ask}; echo "${{COMPREPLY[*]}}"'
    done = subprocess.run(["bash", "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == completed


def unpack(packed: str) -> str:
    return gzip.decompress(base64.b64decode(packed)).decode()


def scenes(text: str) -> list[str]:
    packed = dict(re.findall(r'id="scene-(\w+)">([^<]*)<', text))
    start, end = (unpack(packed.pop(name)) for name in ("start", "end"))
    return [start + unpack(each) + end for each in packed.values()]


@pytest.mark.parametrize("pages", [["<a>one</a>"], ["<a>one</a>", "<a>two</a>", "<a></a>"]])
def test_pages_are_put_together_again(pages: list[str]) -> None:
    text = embed_scenes(
        {f"scene <{i}>": (page, {"notes": ["</script>"]}) for i, page in enumerate(pages)}
    )
    assert scenes(text) == pages
    assert text.count("scene &lt;") == len(pages) and "scene <" not in text
    assert '</script>"' not in text  # What is said beside a scene ends no script.


def test_what_pages_share_is_there_once() -> None:
    library = "".join(f"function f{i}() {{ return {i * i}; }}\n" for i in range(3000))
    one = len(embed_scenes({"a": (f"{library}a", {})}))
    two = len(embed_scenes({"a": (f"{library}a", {}), "b": (f"{library}b", {})}))
    assert two < one + 400


def words(page: str) -> str:
    body = re.sub(r"<(script|style).*?</\1>", "", page, flags=re.DOTALL)
    return html.unescape(re.sub(r"<[^>]+>", " ", body))


def test_a_report_has_question_answer_verdict_and_how_to_reproduce_it(
    plan: Plan, report: tuple[str, list[str]]
) -> None:
    page, lines = report
    text = words(page)
    name = "table1/1, time step 0.05"  # As the shipped scenario is called, and what differs.
    assert f"<title>Plan for {name}</title>" in page and f"<h1>Plan for {name}</h1>" in page
    assert "Holds: the control alone keeps the plan's promise" in text
    for replay in plan.replay:
        assert f"{replay.cost:.3e}" in text
    # Whatever costs something comes with what it is worth.
    for told in ("dynamics defect", "deepest penetration", "energy ratio", "J simulated"):
        assert told in text
    assert "simulation: exactly rigid" in text and "plan (no simulation)" in text
    for command in (
        "drake-aigto plan scenario.yaml --json plan.json",
        f"drake_aigto {__version__}",
    ):
        assert command in text
    yaml = text[text.index("model: package") :]
    assert "time_step: 0.05" in yaml and "goal_position:\n- 0.73" in yaml
    assert "Options: finalists = 1, aigo_steps = 20." in text
    assert text.split().count("touches") >= 2 and "touches cost J" in " ".join(text.split())
    assert len(page.encode()) < 2e6
    assert "<details><summary>Velocity against position" in page  # Behind a click.
    assert not re.search(r'(src|href)="(?!data:)', page)
    assert len(lines) == 3


@pytest.mark.parametrize(
    ("name", "pair"), [("cart_pole/soft_06", "left wall"), ("table1/1", "ball against wall")]
)
def test_a_question_names_each_pair_once(name: str, pair: str) -> None:
    scenario, page = Scenario.named(name), Page("")
    add_question(page, scenario, World.from_scenario(scenario))
    assert words(page.to_html()).count(pair) == 1


@pytest.mark.slow
def test_boxes_that_can_not_be_run_again_are_said_to_be_missing(plan: Plan) -> None:
    text = words(report_plan(dataclasses.replace(plan, options=None)))
    assert "The plan's file does not say its options." in text
    assert "AIGO's boxes are missing: the plan's boxes can't be run again: got a plan" in text


def test_a_figure_says_where_its_axes_over_time_are_for_the_players_cursor() -> None:
    figure = Figure(figsize=(4, 4))
    upper, lower, other = figure.subplots(3, 1)
    upper.sharex(lower)
    lower.set(xlabel="time t [s]", xlim=(0, 2), position=(0.1, 0.4, 0.8, 0.2))
    other.set_xlabel("position [m]")
    page = Page("")
    page.figure(figure, "caption")
    plots = re.findall(r'class="plot" data-first="0" data-last="2" style="([^"]*)"', page.to_html())
    assert len(plots) == 2
    assert plots[1] == "left:10.0000%;top:40.0000%;width:80.0000%;height:20.0000%"


def test_a_plan_that_fails_is_said_to_fail(plan: Plan) -> None:
    missed = dataclasses.replace(plan.replay.event_driven, cost=1.0, goal_error=0.9)
    failing = dataclasses.replace(plan, replay=Replays(missed, None))
    page, world = Page("report"), World.from_scenario(plan.scenario)
    add_verdict(page, failing, world)
    add_answer(page, failing, world)
    text = words(page.to_html())
    assert "✗ Fails: the control alone misses the plan's promise on a rigid wall." in text
    assert "on a rigid wall: contradicts the plan, cost 1.000 (+1.0e+00), ends 0.90 m" in text


def test_drake_counts_for_nothing_where_its_touches_are_off_their_places(plan: Plan) -> None:
    """Of capsules and meshes its iteration may end elsewhere; where it agrees, it confirms."""
    off = dataclasses.replace(plan.replay.event_driven, simulator="drake", touch_error=2e-3)
    missed = dataclasses.replace(off, cost=1.0, goal_error=0.9)
    near = dataclasses.replace(missed, touch_error=1e-6)
    texts = {}
    for name, replay in {"agrees": off, "differs": missed, "fails": near}.items():
        judged = dataclasses.replace(plan, replay=Replays(plan.replay.event_driven, replay))
        assert judged.holds == (name != "fails")
        texts[name] = " ".join(format_plan(judged).split())
    assert "keeps the plan's promise on a rigid wall and on Drake's plant" in texts["agrees"]
    assert "keeps the plan's promise on a rigid wall goal" in texts["differs"]
    assert "capsules or meshes touch there up to 2.0 mm off their places" in texts["differs"]
    assert "on Drake's plant: contradicts the plan" in texts["fails"]


def test_what_is_added_is_text() -> None:
    page = Page("<b>")
    page.paragraph("a < b & c")
    page.table(("<th>",), [("<td>", "<i>")])
    page.code("<script>")
    text = page.to_html()
    assert "<title>&lt;b&gt;</title>" in text and "a &lt; b &amp; c" in text
    assert "<script>" not in text and "<i>" not in text


@pytest.mark.slow
def test_table_1_has_a_row_for_each_plan_with_all_that_it_is_worth(plan: Plan) -> None:
    entry = Entry("AIGTO, rigid", plan.best, plan.replay.drake, plan.holds)
    method = TableMethod("AIGTO, rigid", (plan.cost,), 1, (entry,), 0.5)
    optimum = RigidOptimum(2.18e-4, (0.55,), (-1.7,), 1.0)
    cells = tuple(RigidCell(row, 1.0, optimum, 1e-4, (method,)) for row in (1, 3))
    table = Table1((), cells, rows=(1, 3), num_guesses=2, seed=7, confirm=False)
    page = report_table1(table)
    text = words(page)
    assert "2 of 2 plans of the rigid transcription hold in simulation." in text
    assert "Row 1: q(0) = 1 m" in text and "Row 3: q(0) = 0.6 m" in text
    assert "2 tasks of the paper's four" in text and "Interrupted: 4 of 6 cells" in text
    command = "drake-aigto table1 --rows 1 3 --guesses 2 --seed 7 --no-confirm --html table1.html"
    assert command in text
    assert len(scenes(page)) == 2
    assert text.count(f"{plan.replay.event_driven.cost:.2e}") >= 2
    # A phone shows the first columns: what matters most is there.
    assert "verdict cost J dynamics defect" in " ".join(text.split())


def test_what_a_literal_plan_alone_does_is_cut_off_and_told() -> None:
    axes = Figure().subplots()
    simulated, literal = np.array([[-2.0], [2.0]]), np.array([[-2.0], [2500.0]])
    axes.plot(simulated)
    frame(axes, "m/s", [simulated], [simulated])
    assert axes.get_title("right") == "" and axes.get_ylim()[1] < 3.0
    axes = Figure().subplots()
    axes.plot(simulated)
    axes.plot(literal)
    frame(axes, "m/s", [simulated, literal], [simulated])
    assert axes.get_ylim()[1] == 4.0
    assert "goes from -2.0 to 2,500.0 m/s" in axes.get_title("right")


def test_a_simulation_that_costs_something_else_says_why(plan: Plan) -> None:
    replay = dataclasses.replace(plan.replay.event_driven, cost=1.2e-4, compliance_cost=2.5e-5)
    text = describe_difference(1e-4, replay)
    assert text == " (+2.0e-05, +20.00 %; its compliance explains up to 2.5e-05)"
    assert describe_difference(1.2e-4 * (1 + 1e-9), replay) == ""
    nothing = dataclasses.replace(replay, cost=1e-17, compliance_cost=0.0)
    assert describe_difference(0.0, nothing) == ""


@pytest.mark.parametrize(("name", "has"), [("table1/1", True), ("corridor/six_bounces", False)])
def test_a_landscape_of_single_touches_is_shown_only_where_the_plan_is_on_it(
    plan: Plan, name: str, has: bool
) -> None:
    world = World.from_scenario(Scenario.named(name))
    assert has_landscape(plan, world) == has
    twice = dataclasses.replace(plan.best, contacts=plan.best.contacts * 2)
    assert not has_landscape(dataclasses.replace(plan, candidates=(twice,)), world)
