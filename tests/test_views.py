"""What a plan shows of itself, through the one hook that the room of pictures fills."""

from __future__ import annotations

import csv
import dataclasses
import itertools
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

from drake_aigto import Plan
from drake_aigto.cli import FINE, main
from drake_aigto.errors import ModelError, OptionsError, OutputFileError
from drake_aigto.planning import VIEWS
from drake_aigto.show import compare, to_csv
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
