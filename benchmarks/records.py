"""What README and docs say was measured: commands, what they printed, figures read off that.

    python -m benchmarks.records run                  # all of them, into docs/results
    python -m benchmarks.records run corridor room    # only these
    python -m benchmarks.records run questions --parts build/parts   # in parts: Ctrl-C, then again
    python -m benchmarks.records quote                # put their figures into README and docs

A page quotes a figure of `FIGURES` between marks that readers do not see:

    <!-- figure: plan_ms -->12.8<!-- end -->

One of several lines becomes a block of its own.

A test compares the pages with the records, so that neither changes without the other.
"""

from __future__ import annotations

import argparse
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import NamedTuple

from benchmarks.script import machine, versions
from drake_aigto.plain import write_text

CHECKOUT = Path(__file__).parents[1]
FOLDER = CHECKOUT / "docs" / "results"

_WORLDS = "python -m benchmarks.worlds"
_SPEED = "--out docs/results/speed"
_SOLVER = "--out docs/results/solver"
_STUDIES = " ".join(f"docs/results/{name}.json" for name in ("planner", "rivals", "ablations"))

# Record → its command. The page of results is made of what those before it saved, and of
# `rivals.json`, whose command that page tells.
RECORDS: Mapping[str, str] = {
    "planner": "python -m benchmarks scenarios --count 1500 --seed 2026 --read-boxes --workers 2"
    " --json docs/results/planner.json",
    "ablations": "python -m benchmarks ablations --count 60 --seed 2026 --workers 2"
    " --json docs/results/ablations.json",
    "page": f"python -m benchmarks page {_STUDIES} --out docs/results.md",
    "corridor": f"{_WORLDS} corridor --count 200 --peer coasting --workers 1",
    "floor": f"{_WORLDS} floor --count 200 --peer coasting --workers 2",
    "room": f"{_WORLDS} room --count 200 --peer coasting --workers 2",
    "two_masses": f"{_WORLDS} two_masses --count 30 --peer coasting --peer listed --workers 2",
    "unequal_masses": f"{_WORLDS} two_masses --mass-ratio 3 0.2 1.5 5 --restitution 1 0.8"
    " --count 104 --seed 200 --workers 2",
    "floors": "python -m benchmarks.floors --count 200 --seed 2026 --workers 2",
    "room_with_block": f"{_WORLDS} room_with_block --count 40 --peer coasting --peer listed"
    " --workers 2",
    "questions": "python -m benchmarks.questions acrobot/swing_up acrobot/beside_a_wall"
    " billiard/spin_shot cart_pole/dry cart_pole/rigid_06 cart_pole/rigid_10 cart_pole/soft_06"
    " cart_pole/soft_10 hopper/gait hopper/hop paddle/bat payload/transport pendulum/off_the_wall"
    " push_circle/round_it pushed_block/slide sliding_block/to_rest spinner/two_radians"
    " spinning_ball/off_the_wall three_carts/apart throwing_ball/bounces two_discs/swap"
    " --count 20 --times 4 --store --workers 2 --minutes 30",
    "questions_of_balls": "python -m benchmarks.questions table1/1 table1/2 table1/3 table1/4"
    " corridor/lossy corridor/six_bounces corridor/three_bounces floor/lossy floor/rebound"
    " floor/two_rebounds room/bank_shot room/two_walls room_with_block/around"
    " room_with_block/off_the_block two_masses/apart two_masses/handed_on"
    " --count 20 --times 4 --workers 1",
    "friction_worlds": "python -m benchmarks.friction_worlds --workers 1",
    "space": "python -m benchmarks.space --seeds 2 --renewals 24 --workers 2",
    "space_rivals": "python -m benchmarks.space --rivals --seeds 1 --renewals 0 --workers 1"
    " --minutes 16",
    "space_controllers": "python -m benchmarks.space --rivals --mujoco --seeds 1 --renewals 0"
    " --workers 1 --minutes 15",
    "push_tee_poses": "python -m benchmarks.space --poses 50 --renewals 16 --workers 1"
    " --minutes 40",
    "fingers_turn": "python -m benchmarks.space --poses 30 --only three_fingers/turn --renewals 0"
    " --workers 2 --minutes 90",
    "fingers_lift": "python -m benchmarks.space --poses 30 --only three_fingers/lift --renewals 0"
    " --workers 2 --minutes 90",
    "fingers_flip": "python -m benchmarks.space --poses 30 --only three_fingers/flip --renewals 0"
    " --workers 2 --minutes 90",
    "table1": "python -m benchmarks.table1_figures",
    "planner_speed": f"python -m benchmarks.planner_speed {_SPEED}",
    "newton_speed": f"python -m benchmarks.newton_speed {_SPEED}",
    "first_plans": "python -m benchmarks.first_plans",
    "start_time": f"python -m benchmarks.start_time --repeats 3 {_SPEED}",
    "global_functions": f"python -m benchmarks.global_functions --workers 2 --seeds 1 {_SOLVER}",
    "constrained_programs": f"python -m benchmarks.constrained_programs --workers 1 {_SOLVER}",
    "staged_programs": "python -m benchmarks.staged_programs --only push_bot --random 50 --seeds 1"
    " --workers 1",
    "lifted_functions": "python -m benchmarks.lifted_functions --workers 1",
    "peer_programs": "python -m benchmarks.peer_programs --seeds 0 --workers 2 --minutes 30",
    "loops": "python -m benchmarks.loops --count 2 --workers 2",
    "chain": "python -m benchmarks.chain --workers 2 --first-seed 100 --patience 20 --minutes 60"
    f" {_SOLVER}",
    "certificates": "python -m benchmarks.certificates --worlds 20 --lossy 10 --workers 1",
    "provers": "python -m benchmarks.provers --workers 1",
    "provers_without_rows": "python -m benchmarks.provers --without-rows --workers 1",
    "push_bot_bounds": "python -m benchmarks.push_bot_bounds",
    "loop_record": "python -m benchmarks.loop_record --only table1,corridor,room,floor,soft,block"
    " --seeds 20 --workers 1 --minutes 60",
    "loop_record_unstable": "python -m benchmarks.loop_record"
    " --only rigid_06,spinner,acrobot,hopper --seeds 20 --workers 1 --minutes 60",
    "estimated": "python -m benchmarks.estimated --workers 1 --minutes 25",
    "held": "python -m benchmarks.held --workers 1 --minutes 70",
    "live_latency": "python -m benchmarks.live_latency",
    "cart_poles": "python -m benchmarks.cart_poles --count 100 --workers 1 --minutes 45",
    "soak": "python -m benchmarks.soak --count 1000000",
    "random_programs": "python -m benchmarks.random_programs --count 3000 --seed 4 --workers 2",
}


class Figure(NamedTuple):
    """A figure that pages may quote: the only group of a pattern in what a command printed."""

    record: str
    pattern: str


def path_of(record: str) -> Path:
    """Returns the file of a record."""
    return FOLDER / f"{record}.txt"


def read_output(record: str) -> str:
    """Returns what a record's command printed."""
    lines = path_of(record).read_text(encoding="utf-8").splitlines(keepends=True)
    return "".join(line for line in lines if not line.startswith("# "))


CHAIN_SIZES = (2, 10, 26, 50, 82, 122, 170, 1000, 10_000)
_NUMBER = r"([\d.]+)"


def _planner(e: str) -> dict[str, Figure]:
    row = rf"^\| {re.escape(e)} \| aigto \| \d+ \| "
    name = f"one_wall_{e.replace('.', '')}"
    return {
        f"{name}_share": Figure("planner", rf"{row}([\d.]+ %)"),
        f"{name}_worst": Figure("planner", rf"{row}[\d.]+ % \| [\d.]+ \| {_NUMBER}"),
    }


def _world(name: str, *peers: str) -> dict[str, Figure]:
    patterns = {
        "optimal": rf"optimal: {_NUMBER} of",
        "count": r"optimal: \d+ of (\d+)",
        "boxes": rf"any rung: {_NUMBER} of",
        "median": rf"median {_NUMBER}, at most",
        "most": rf"at most {_NUMBER}$",
        **{peer: rf"peer '{peer}': {_NUMBER} of" for peer in peers},
    }
    return {f"{name}_{what}": Figure(name, pattern) for what, pattern in patterns.items()}


def _planner_speed(name: str, method: str) -> dict[str, Figure]:
    line = rf"^  {re.escape(method)} +"
    return {
        f"{name}_ms": Figure("planner_speed", rf"{line}{_NUMBER} ms, on"),
        f"{name}_cost": Figure("planner_speed", rf"{line}[\d.]+ ms, on a rigid wall (\S+)"),
        f"{name}_ratio": Figure("planner_speed", rf"{line}{_NUMBER} \("),
        f"{name}_quartiles": Figure("planner_speed", rf"{line}[\d.]+ \((.*)\)"),
    }


def _functions(name: str, solver: str) -> dict[str, Figure]:
    line = rf"^{re.escape(solver)}  .* "
    return {
        f"functions_{name}_range": Figure("global_functions", rf"{line}{_NUMBER}% +[\d.]+% "),
        f"functions_{name}_value": Figure("global_functions", rf"{line}[\d.]+% +{_NUMBER}% "),
    }


def _chain(n: int) -> dict[str, Figure]:
    line = rf"^n = +{n}  "
    return {
        f"chain_{n}_gap": Figure("chain", rf"{line}AIGO +gap +-?{_NUMBER}%"),
        f"chain_{n}_worst": Figure("chain", rf"{line}AIGO +gap.*worst +-?{_NUMBER}%"),
        f"chain_{n}_seconds": Figure("chain", rf"{line}AIGO +gap.* {_NUMBER} s$"),
        f"chain_{n}_alone": Figure("chain", rf"{line}AIGO, boxes alone +gap +-?{_NUMBER}%"),
        f"chain_{n}_annealing": Figure("chain", rf"{line}dual_annealing +gap +-?{_NUMBER}%"),
    }


FIGURES: Mapping[str, Figure] = {
    **_planner("1"),
    **_planner("0.8"),
    **_planner("0.5"),
    **_world("corridor", "coasting"),
    **_world("floor", "coasting"),
    **_world("room", "coasting"),
    **_world("two_masses", "coasting", "listed"),
    **_world("unequal_masses"),
    **_world("room_with_block", "coasting", "listed"),
    "floors_optimal": Figure("floors", rf"the best known: {_NUMBER} of"),
    "floors_count": Figure("floors", r"the best known: \d+ of (\d+)"),
    "floors_rests": Figure("floors", rf"rests and jumps: {_NUMBER},"),
    "floors_median": Figure("floors", rf"median {_NUMBER}, at most"),
    "floors_most": Figure("floors", rf"at most {_NUMBER}$"),
    "questions_table": Figure("questions", r"(?s)\A(.*\S)"),
    "questions_off": Figure("questions", rf"plans more than 1 % above the best known: {_NUMBER},"),
    "questions_of_balls_table": Figure("questions_of_balls", r"(?s)\A(.*\S)"),
    **_planner_speed("plan", "plan"),
    **_planner_speed("boxed", "plan with boxes"),
    "boxed_ratio": Figure(
        "planner_speed", rf"(?s)With boxes, likewise\n  CasADi \+ IPOPT from zero +{_NUMBER}"
    ),
    "boxless_same": Figure("planner_speed", r"without boxes at the same cost: (\d+) of"),
    "boxless_count": Figure("planner_speed", r"without boxes at the same cost: \d+ of (\d+)"),
    **_planner_speed("casadi", "CasADi + IPOPT from zero"),
    **_planner_speed("casadi_random", "CasADi + IPOPT from random"),
    **_planner_speed("ipopt", "Drake's IPOPT from zero"),
    **_planner_speed("snopt", "Drake's SNOPT from zero"),
    **_functions("ours", "AIGO"),
    **_functions("alone", "AIGO, boxes alone"),
    **_functions("annealing", "dual_annealing"),
    **_functions("lbfgs", "L-BFGS-B, multistart"),
    **_functions("starts", "our polish, multistart"),
    "univariate_solved": Figure("global_functions", rf"^AIGO +univariate +{_NUMBER} of 1000"),
    "univariate_ms": Figure("global_functions", rf"^AIGO +univariate .*  {_NUMBER} ms each"),
    "univariate_alone": Figure(
        "global_functions", rf"^AIGO, boxes alone +univariate +{_NUMBER} of 1000"
    ),
    **{name: each for n in CHAIN_SIZES for name, each in _chain(n).items()},
    "chase_reached": Figure("chain", rf"^n = +170  dual_annealing reaches .* in {_NUMBER} of 10"),
    "chase_gap": Figure("chain", rf"^n = +170  dual_annealing reaches .*gap then {_NUMBER}%"),
    "constrained_count": Figure("constrained_programs", r"^AIGO +global \d+ of (\d+)"),
    "constrained_ours": Figure("constrained_programs", rf"^AIGO +global {_NUMBER} of"),
    "constrained_snopt": Figure("constrained_programs", rf"^SNOPT.* global {_NUMBER} of"),
    "constrained_broken": Figure(
        "constrained_programs", rf"successes of ours that are infeasible: {_NUMBER}"
    ),
    "lifted_tables": Figure("lifted_functions", r"(?s)\A[^\n]*\n(.*\S)"),
    "staged_tables": Figure("staged_programs", r"(?s)^(push_bot/0\.6: .*\S)"),
    "friction_worlds_table": Figure("friction_worlds", r"(?s)\A[^\n]*\n(.*\S)"),
    "space_table": Figure("space", r"(?s)\A[^\n]*\n(.*\S)"),
    "space_rivals_table": Figure("space_rivals", r"(?s)\A[^\n]*\n(.*\S)"),
    "space_controllers_table": Figure("space_controllers", r"(?s)\A[^\n]*\n(.*\S)"),
    "push_tee_poses_table": Figure("push_tee_poses", r"(?s)\A[^\n]*\n(.*\S)"),
    **{
        f"fingers_{each}_met": Figure(f"fingers_{each}", r"^(\d+ of \d+) have 20 steps")
        for each in ("turn", "lift", "flip")
    },
    "loop_record_tables": Figure("loop_record", r"(?s)^(table1/1: .*\S)"),
    "loop_record_unstable_tables": Figure(
        "loop_record_unstable", r"(?s)^(cart_pole/rigid_06: cost.*\S)"
    ),
    "estimated_tables": Figure("estimated", r"(?s)^(table1/1  .*\S)"),
    "held_table": Figure("held", r"(?s)^(acrobot/swing_up\ntracking.*\S)"),
    "live_latency_table": Figure("live_latency", r"(?s)\A(.*\S)"),
    "cart_poles_table": Figure("cart_poles", r"(?s)\A[^\n]*\n(.*\S)"),
    "soak_lines": Figure("soak", r"(?s)\A(.*\S)"),
    "certificates_table": Figure("certificates", r"(?s)\A[^\n]*\n(.*\S)"),
    "provers_table": Figure("provers", r"(?s)^(ours: .*\S)"),
    "provers_without_rows_table": Figure("provers_without_rows", r"(?s)^(ours: .*\S)"),
    "push_bot_bounds_table": Figure("push_bot_bounds", r"(?s)\A[^\n]*\n(.*\S)"),
    "peer_tables": Figure("peer_programs", r"(?s)^(payload: .*\S)"),
    "loops_tables": Figure("loops", r"(?s)\A(.*\S)"),
    "random_tried": Figure("random_programs", rf"^{_NUMBER} of \d+ programs, "),
    "random_wrong": Figure("random_programs", rf"^crashed or lied: {_NUMBER}"),
    "table1_seconds": Figure("table1", rf"^table in {_NUMBER} s"),
    "newton_iteration": Figure("newton_speed", rf"^iteration .* {_NUMBER} × dpbtrf"),
    "newton_hessian": Figure("newton_speed", rf"^Hessian  .* {_NUMBER} × dpbtrf"),
    "start_import": Figure("start_time", rf"^import drake_aigto +{_NUMBER} \("),
    "start_plan": Figure("start_time", rf"^drake-aigto plan table1/1 +{_NUMBER} \("),
    "start_libraries": Figure("start_time", rf"^libraries alone +{_NUMBER} \("),
    "start_first": Figure("start_time", rf"^first plan, compiling +{_NUMBER} \("),
    "wheel_soft_first": Figure("first_plans", rf"^cart_pole/soft_06 +{_NUMBER}"),
    "wheel_soft_second": Figure("first_plans", rf"^cart_pole/soft_06 +\S+ +{_NUMBER}"),
    "wheel_rigid_first": Figure("first_plans", rf"^cart_pole/rigid_06 +{_NUMBER}"),
    "wheel_rigid_second": Figure("first_plans", rf"^cart_pole/rigid_06 +\S+ +{_NUMBER}"),
}


# The name by which a page quotes the table of all records.
AGES = "records"
MARKED = re.compile(r"(<!-- figure: (\w+) -->).*?(<!-- end -->)", re.DOTALL)
PAGES = (CHECKOUT / "README.md", *sorted((CHECKOUT / "docs").glob("*.md")))


def run(name: str, parts: Path | None = None) -> int:
    """Runs a record's command, saves what it prints, and returns its exit status.

    With a folder of parts, what is done is kept there, and gone on from when it is run again.
    """
    arguments = shlex.split(RECORDS[name])[1:]  # after `python`
    kept = parts and parts.absolute() / name
    if kept:
        kept.parent.mkdir(parents=True, exist_ok=True)
        if "--workers" in arguments:
            arguments += ["--keep", str(kept)]
    begin = time.perf_counter()
    result = subprocess.run(
        [sys.executable, *arguments], cwd=CHECKOUT, stdout=subprocess.PIPE, text=True, check=False
    )
    seconds = time.perf_counter() - begin
    head = (
        RECORDS[name],
        f"{machine()}; {versions()}",
        f"commit {_commit()}, {date.today()}, {seconds:.0f} s, exit status {result.returncode}",
    )
    write_text(path_of(name), "".join(f"# {line}\n" for line in head) + result.stdout)
    return result.returncode


def _commit() -> str:
    """Returns the commit, and whether what is measured was changed since."""

    def git(*arguments: str) -> str:
        command = ["git", *arguments]
        return subprocess.run(
            command, cwd=CHECKOUT, capture_output=True, text=True, check=True
        ).stdout.strip()

    changed = git("status", "--porcelain", "--", "drake_aigto", "benchmarks", "models")
    return git("rev-parse", "--short", "HEAD") + ("-dirty" if changed else "")


def quote(text: str) -> str:
    """Returns a page's text with the figures that the records have now.

    Raises:
        LookupError: a figure is not in its record.
    """
    return MARKED.sub(lambda mark: f"{mark[1]}{_read_figure(mark[2])}{mark[3]}", text)


def _read_figure(name: str) -> str:
    if name == AGES:
        return f"\n\n```text\n{list_ages()}\n```\n\n"
    record, pattern = FIGURES[name]
    found = re.search(pattern, read_output(record), re.MULTILINE)
    if not found:
        raise LookupError(f"figure {name!r}: record {record!r} has nothing like {pattern!r}")
    return f"\n\n```text\n{found[1]}\n```\n\n" if "\n" in found[1] else found[1]


def list_ages() -> str:
    """Returns a table of all records: the day, the commit and the seconds of each, oldest first."""
    rows = []
    for record in RECORDS:
        head = path_of(record).read_text(encoding="utf-8").splitlines()[2]
        commit, day, seconds, _ = head.removeprefix("# commit ").split(", ")
        rows.append((day, commit, seconds, record))
    return "\n".join(
        f"{day}  {commit:13} {seconds:>7}  {name}" for day, commit, seconds, name in sorted(rows)
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs or quotes, and returns the exit status: 1 if a command's is not 0."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    running = commands.add_parser("run", help="run commands and save what they print")
    running.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(RECORDS)}")
    running.add_argument("--parts", type=Path, metavar="FOLDER", help="keep parts, and go on")
    commands.add_parser("quote", help="put what is saved into README and docs")
    options = parser.parse_args(arguments)
    if options.command == "quote":
        for page in PAGES:
            write_text(page, quote(page.read_text(encoding="utf-8")))
        return 0
    if unknown := set(options.names) - set(RECORDS):
        parser.error(f"unknown records {sorted(unknown)}, expected some of {', '.join(RECORDS)}")
    failed = False
    for name in options.names or RECORDS:  # in turn: two at once slow each other down
        status = run(name, options.parts)
        failed |= status != 0
        print(f"{name}: exit status {status}, {path_of(name).relative_to(CHECKOUT)}", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
