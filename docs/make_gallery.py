"""Plans for every shipped scenario, and shows the plans on the first page of these docs.

python -m docs.make_gallery FOLDER [NAME …]

Plans that are in the folder are taken from there; others are made, and kept there: that takes from
a second to two minutes for each. Of scenarios that are named, or of all, it writes the animation
and the motion that `tests/test_shipped_scenes.py` watches; and it lists all of them on the page.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageSequence

from drake_aigto import Plan, Scenario, World, plan
from drake_aigto.show import Motion, motions_of_plan
from drake_aigto.world import SpaceWorld, scenario_names, scenario_seconds, scenario_summaries

DOCS = Path(__file__).parent
PICTURES, PAGE = DOCS / "images" / "gallery", DOCS / "index.md"
MOTIONS = DOCS.parent / "tests" / "shipped_motions.json"

_WIDTH, _RATE = 4.0, 12  # of animations [hundreds of pixels], [1/s]
_QUALITIES, _MOST = (40, 30, 20, 10), 80_000  # The first one of as few bytes is taken.
_SECONDS = 2.0  # that an animation takes at most, but for the end's stand
_KNOTS, _DIGITS = 25, 5  # of a motion in the tests: rows, and digits of each number
_SPACE = "In space"  # the last heading
_BEGIN, _END = "<!-- gallery -->\n", "<!-- end of the gallery -->\n"


def make_plan(name: str, folder: Path) -> Plan:
    """Returns a scenario's plan, which is in a folder from then on."""
    path = folder / f"{name.replace('/', '_')}.json"
    if not path.exists():
        plan(Scenario.named(name)).save(path)
    return Plan.load(path)


def picture_of(name: str) -> Path:
    """Returns where the animation of a scenario's plan is."""
    return PICTURES / f"{name.replace('/', '_')}.webp"


def compress(drawn: Path, path: Path) -> None:
    """Writes an animation as a WebP, a quarter as large or less."""
    with Image.open(drawn) as frames:
        first, *others = (frame.convert("RGB") for frame in ImageSequence.Iterator(frames))
    look: dict[str, Any] = {"duration": 1000 / _RATE, "method": 4, "minimize_size": True}
    for quality in _QUALITIES:
        first.save(path, save_all=True, append_images=others, loop=0, quality=quality, **look)
        if path.stat().st_size < _MOST:
            break


def shorten(motion: Motion) -> dict[str, Any]:
    """Returns rows of a motion with its control and its touches, as plain numbers."""
    assert motion.controls is not None and motion.control_times is not None
    rows = np.linspace(0, len(motion.times) - 1, _KNOTS).astype(int)
    held = np.linspace(0, len(motion.controls) - 1, _KNOTS).astype(int)
    arrays = {
        "times": motion.times[rows],
        "states": np.hstack([motion.positions, motion.velocities])[rows],
        "control_times": motion.control_times[[*held, -1]],
        "controls": motion.controls[held],
    }
    plain = {name: _round(values).tolist() for name, values in arrays.items()}
    touches = [
        [_round(touch.start), _round(touch.end), int(touch.contact)] for touch in motion.touches
    ]
    return {**plain, "touches": touches}


def _round(values: Any) -> Any:
    """Returns numbers with few digits."""
    return np.vectorize(lambda value: float(f"{value:.{_DIGITS}g}"))(values) + 0.0


def kind_of(world: World) -> str:
    """Returns the heading that a scenario of a world is below."""
    if isinstance(world, SpaceWorld):
        return _SPACE
    if world.num_contacts and world.has_constant_inertia and not world.frictions:
        return "Balls between rigid walls"
    return "Contact with friction" if world.frictions else "Mechanisms"


def list_plans() -> Iterator[str]:
    """Yields the page's lines about all scenarios, below headings."""
    seconds, kinds = scenario_seconds(), dict[str, list[str]]()
    for name, text in scenario_summaries().items():
        world = World.from_scenario(Scenario.named(name))
        where = picture_of(name)
        figure = f"![Animation: the plan for {name}, and a simulation of its control]"
        figure += f"({where.relative_to(DOCS)}) "
        took = f" {seconds[name]:g}\u00a0s." if name in seconds else ""
        line = f"{figure if where.exists() else ''}**{name}** {text}.{took}"
        kinds.setdefault(kind_of(world), []).append(line)
    for kind, lines in sorted(kinds.items(), key=lambda pair: pair[0] == _SPACE):
        yield f"### {kind}\n"
        yield "```{container} gallery\n" + "\n\n".join(lines) + "\n```\n"


def main(folder: Path, names: Sequence[str]) -> None:
    """Writes animations and motions of scenarios, and the page."""
    folder.mkdir(parents=True, exist_ok=True)
    PICTURES.mkdir(exist_ok=True)
    for name in names or scenario_names():
        found = make_plan(name, folder)
        world = found.find_world()
        speed = max(1.0, found.trajectory.times[-1] / _SECONDS)
        look: dict[str, Any] = {"rate": _RATE, "speed": speed, "width": _WIDTH}
        drawn = found.animate(folder / "drawn.apng", world=world, has_title=False, **look)
        compress(drawn, picture_of(name))
        motions = json.loads(MOTIONS.read_text("utf-8")) if MOTIONS.exists() else {}
        motions[name] = shorten(motions_of_plan(found, world)[0])
        rows = (f"{json.dumps(key)}: {json.dumps(motions[key])}" for key in sorted(motions))
        MOTIONS.write_text("{\n" + ",\n".join(rows) + "\n}\n", "utf-8")
        print(f"{name}: {picture_of(name).stat().st_size / 1000:.0f} kB", flush=True)
    text = PAGE.read_text("utf-8")
    lines = "\n".join(list_plans())
    PAGE.write_text(re.sub(f"(?s){_BEGIN}.*{_END}", f"{_BEGIN}\n{lines}\n{_END}", text), "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
