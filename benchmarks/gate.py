"""The gate of every change: plans for fixed questions, compared with those of another commit.

    python -m benchmarks.gate run before.jsonl            # in a checkout of the commit before
    python -m benchmarks.gate run after.jsonl             # here; both may be interrupted, and go on
    python -m benchmarks.gate compare before.jsonl after.jsonl
    python -m benchmarks.gate time ../before . --repeats 5   # CPU seconds of two checkouts in turn

The questions are all shipped scenarios, and variations of them whose seeds were fixed before the
first change that was measured with them: starts, velocities and goals are moved, and for balls
restitutions changed. What is refused is compared as well. A question's line has its cost, touches,
verdict, replays and CPU seconds; `compare` lists the cases that differ.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drake_aigto import AigtoError, Plan, Scenario, plan, scenario_names

# How many variations each scenario has: few where a plan takes tens of seconds.
VARIATIONS = {
    "table1/1": 24,
    "table1/3": 12,
    "corridor/three_bounces": 16,
    "corridor/lossy": 8,
    "floor/rebound": 16,
    "floor/lossy": 8,
    "room/bank_shot": 16,
    "room_with_block/around": 12,
    "two_masses/apart": 12,
    "cart_pole/soft_06": 24,
    "cart_pole/soft_10": 12,
    "cart_pole/rigid_06": 10,
    "cart_pole/rigid_10": 10,
    "acrobot/swing_up": 6,
    "acrobot/beside_a_wall": 3,
    "pendulum/off_the_wall": 12,
    "paddle/bat": 6,
    "billiard/spin_shot": 6,
    "sliding_block/to_rest": 4,
    "spinning_ball/off_the_wall": 4,
    "payload/transport": 3,
    "throwing_ball/bounces": 2,
    "three_carts/apart": 1,
    "two_discs/swap": 1,
    "push_circle/round_it": 1,
    "spinner/two_radians": 1,
    "hopper/hop": 1,
    "pushed_block/slide": 1,
    "cart_pole/dry": 1,
}
_RESTITUTIONS = (1.0, 0.8, 0.5, 0.0)
_BALLS = ("table1", "corridor", "floor", "room", "room_with_block", "two_masses")
_SEED = 20261123

# No cost may be worse by the first in more than the second of cases, and none by the third.
_WORSE, _SHARE, _MOST = 1e-4, 0.02, 1e-2


class Question(NamedTuple):
    """A scenario, and what it is called."""

    name: str
    scenario: Scenario


def list_questions(names: Iterable[str] = ()) -> Iterator[Question]:
    """Yields the shipped scenarios and their variations, of these names only if any are given."""
    wanted = set(names)
    for number, name in enumerate(sorted(scenario_names())):
        if wanted and name not in wanted:
            continue
        scenario = Scenario.named(name)
        yield Question(name, scenario)
        generator = np.random.default_rng([_SEED, number])
        for variation in range(VARIATIONS.get(name, 0)):
            yield Question(f"{name}#{variation}", _vary(name, scenario, variation, generator))


def _vary(
    name: str, scenario: Scenario, variation: int, generator: np.random.Generator
) -> Scenario:
    """Returns a scenario whose start, velocity and goal are moved by parts of its own scales."""
    q, v, goal = scenario.initial_position, scenario.initial_velocity, scenario.goal_position
    # Parts of how far each coordinate moves, and of all of them where one does not.
    way = np.abs(goal - q)
    scale = np.where(way > 0.0, way, 0.3 * float(np.max(way)))
    # A hard goal that is moved may be out of reach.
    goal_scale = np.zeros_like(scale) if "hard_goal" in scenario.extras else 0.2 * scale
    changes: dict[str, Any] = {
        "initial_position": q + 0.25 * scale * generator.uniform(-1.0, 1.0, len(q)),
        "initial_velocity": v
        + 0.5 * scale / scenario.duration * generator.uniform(-1.0, 1.0, len(v)),
        "goal_position": goal + goal_scale * generator.uniform(-1.0, 1.0, len(q)),
    }
    if name.startswith(_BALLS):
        changes["restitution"] = _RESTITUTIONS[variation % len(_RESTITUTIONS)]
    return dataclasses.replace(scenario, **changes)


def answer(question: Question) -> dict[str, Any]:
    """Returns a line about a question: its plan, or why there is none."""
    begin = time.process_time()
    try:
        found = plan(question.scenario)
    except AigtoError as error:
        outcome: dict[str, Any] = {"error": f"{type(error).__name__}: {error}"}
    else:
        outcome = _describe(found)
    return {"name": question.name, **outcome, "seconds": time.process_time() - begin}


def _describe(found: Plan) -> dict[str, Any]:
    drake = found.replay.drake
    return {
        "cost": found.cost,
        "holds": found.holds,
        "touches": [(contact.index, contact.time) for contact in found.best.contacts],
        "event_driven": found.replay.event_driven.cost,
        "drake": None if drake is None else drake.cost,
        "defect": max(found.defects.values(), default=0.0),
        "penetration": found.best.max_penetration,
        "lower_bound": found.lower_bound,
        "vetoes": len(found.vetoes),
    }


def _work(job: tuple[str, frozenset[str]]) -> list[dict[str, Any]]:
    """Answers a scenario and its variations in one process, the shipped one first."""
    name, done = job
    questions = [each for each in list_questions([name]) if each.name not in done]
    return [answer(each) for each in questions]


def run(path: Path, names: Sequence[str], workers: int) -> None:
    """Answers the questions that a file has no answers of yet, and adds them to it."""
    done = frozenset(line["name"] for line in _read(path)) if path.exists() else frozenset()
    # One process a scenario, so that what it compiled or loaded disturbs its first question alone.
    jobs = [(each, done) for each in names or sorted(scenario_names())]
    with get_context("spawn").Pool(workers, maxtasksperchild=1) as pool:
        for lines in pool.imap_unordered(_work, jobs):
            with path.open("a", encoding="utf-8") as file:
                file.writelines(json.dumps(line) + "\n" for line in lines)
            if lines:
                print(f"{lines[0]['name']}: {len(lines)} questions", flush=True)


def _read(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def compare(before: Path, after: Path) -> int:
    """Prints how answers differ, and returns 1 if they are worse than the gate lets through."""
    old = {line["name"]: line for line in _read(before)}
    new = {line["name"]: line for line in _read(after)}
    common = sorted(old.keys() & new.keys())
    if missing := sorted(old.keys() ^ new.keys()):
        print(f"{len(missing)} questions are in one file only: {', '.join(missing[:5])} …")
    print(
        f"{'scenario':28}{'questions':>10}{'equal':>7}{'worse':>7}{'better':>7}{'lost':>6}"
        f"{'worst':>9}{'CPU s':>9}{'before':>9}"
    )
    worse, lost, listed, worst_of_all = 0, 0, [], 1.0
    for scenario in dict.fromkeys(name.partition("#")[0] for name in common):
        pairs = [(old[n], new[n]) for n in common if n.partition("#")[0] == scenario]
        ratios = [_compare_costs(*pair) for pair in pairs]
        gone = [b["name"] for a, b in pairs if _is_lost(a, b)]
        lost += len(gone)
        worse += sum(ratio > 1.0 + _WORSE for ratio in ratios)
        worst_of_all = max([worst_of_all, *ratios])
        listed += [
            (b["name"], ratio, a, b)
            for (a, b), ratio in zip(pairs, ratios, strict=True)
            if abs(ratio - 1.0) > _WORSE or _is_told_otherwise(a, b)
        ]
        seconds = [sum(line["seconds"] for line in lines) for lines in zip(*pairs, strict=True)]
        print(
            f"{scenario:28}{len(pairs):10}{sum(r == 1.0 for r in ratios):7}"
            f"{sum(r > 1.0 + _WORSE for r in ratios):7}{sum(r < 1.0 - _WORSE for r in ratios):7}"
            f"{len(gone):6}{max(ratios):9.5f}{seconds[1]:9.2f}{seconds[0]:9.2f}"
        )
    for name, ratio, a, b in listed:
        print(f"  {name}: {_show(a)} → {_show(b)}, ratio {ratio:.6f}")
    share = worse / max(1, len(common))
    print(
        f"{len(common)} questions, {sum('cost' in old[n] for n in common)} planned before: "
        f"{worse} worse by over {_WORSE:g} ({share:.1%}), worst {worst_of_all:.5f}, {lost} lost"
    )
    return int(share > _SHARE or worst_of_all > 1.0 + _MOST or lost > 0)


def _compare_costs(before: dict[str, Any], after: dict[str, Any]) -> float:
    """Returns cost after / before; 1 where either has no plan, as these are told apart."""
    if "cost" not in before or "cost" not in after or before["cost"] == after["cost"]:
        return 1.0
    a, b = before["cost"], after["cost"]
    # Costs of nearly nothing differ by rounding.
    return 1.0 if math.isclose(a, b, abs_tol=1e-9) else b / a if a > 0.0 else math.inf


def _is_lost(before: dict[str, Any], after: dict[str, Any]) -> bool:
    return bool(before.get("holds")) and not after.get("holds")


def _is_told_otherwise(before: dict[str, Any], after: dict[str, Any]) -> bool:
    """Returns whether verdict, error or sequence of touches differ."""
    kinds = [
        (line.get("holds"), line.get("error"), [i for i, _ in line.get("touches", ())])
        for line in (before, after)
    ]
    return kinds[0] != kinds[1]


def _show(line: dict[str, Any]) -> str:
    if "cost" not in line:
        return str(line["error"])[:60]
    touches = ", ".join(f"{i} at {t:.3f}" for i, t in line["touches"][:4])
    return f"{line['cost']:.6g} ({'holds' if line['holds'] else 'fails'}; {touches})"


def take_turns(checkouts: Sequence[Path], names: Sequence[str], repeats: int) -> None:
    """Prints CPU seconds of shipped scenarios in several checkouts, asked in turn."""
    print(f"{'scenario':28}" + "".join(f"{c.resolve().name:>14}" for c in checkouts))
    for name in names or sorted(scenario_names()):
        spent: list[list[float]] = [[] for _ in checkouts]
        for _ in range(repeats):
            for found, checkout in zip(spent, checkouts, strict=True):
                found.append(_time(checkout, name))
        medians = [float(np.median(each)) for each in spent]
        print(
            f"{name:28}"
            + "".join(f"{each:14.3f}" for each in medians)
            + f"   ratio {medians[-1] / medians[0]:.3f}",
            flush=True,
        )


# The second plan is timed: the first loads machine code, or compiles it.
_TIMED = """
import sys, time
from drake_aigto import Scenario, plan
scenario = Scenario.named(sys.argv[1])
plan(scenario)
begin = time.process_time()
plan(scenario)
print(time.process_time() - begin)
"""


def _time(checkout: Path, name: str) -> float:
    environment = {**os.environ, "PYTHONPATH": str(checkout.resolve())}
    result = subprocess.run(
        [sys.executable, "-c", _TIMED, name],
        cwd=checkout,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return float(result.stdout.split()[-1])


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs, compares or times, and returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    running = commands.add_parser("run", help="plan, and write a line for each question")
    running.add_argument("file", type=Path)
    running.add_argument("names", nargs="*", metavar="SCENARIO")
    running.add_argument("--workers", type=int, default=2)
    comparing = commands.add_parser("compare", help="compare two files")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    timing = commands.add_parser("time", help="CPU seconds of checkouts in turn")
    timing.add_argument("checkouts", type=Path, nargs="+")
    timing.add_argument("--names", nargs="*", default=())
    timing.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args(arguments)
    if options.command == "run":
        run(options.file, options.names, options.workers)
    elif options.command == "time":
        take_turns(options.checkouts, options.names, options.repeats)
    else:
        return compare(options.before, options.after)
    return 0


if __name__ == "__main__":
    sys.exit(main())
