"""Plans with friction: what simulations make of them, and their cost as their authors count it.

    python -m benchmarks.friction_worlds [--only payload] [--renewals 96] [--workers 1]
        [--minutes 30]

Worlds are planned from the question alone, and both replays tell whether the plan holds. Peers have
the same seconds: IPOPT from many starts where walls yield (`friction_peer`), what it finds polished
as ours is and simulated; and SCIP, stick and slip as binaries, where all else is linear
(`solve_modes`), in steps of twice the length, as many are beyond it. CRISP's
payload in its 27 starts and goals, and IMPACT's disc that a pusher has to go round, are discrete
programs by their authors, in other schemes than ours: Euler's steps, Coulomb's law as
complementarities, and the disc is quasistatic. There IPOPT runs through CasADi on the same rows,
complementarities as λ s ≤ ε, that are relaxed and tightened alike, by much and by little: from the
plan's states, controls and forces, and from the start that the authors give. A plan that itself
costs more than twice the best known counts for nothing, whatever IPOPT makes of it. The payload's
best known is of the record of `peer_programs`, or of many starts.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from pydrake.solvers import MathematicalProgram

from benchmarks.collections.peer_programs import KNOWN, payload, payload_tasks, push_circle
from benchmarks.friction_peer import solve_from_many, solve_modes
from benchmarks.records import read_output
from benchmarks.script import machine, read_flags, run_all, run_as
from benchmarks.staged_programs import FEASIBLE, GLOBAL, Ipopt, cost_of
from drake_aigto import Plan, Planner, Scenario
from drake_aigto.arrays import Floats
from drake_aigto.planning import PlanOptions
from drake_aigto.solver import StagedProgram, read_program

WORLDS = (
    "push_circle/round_it",
    "pushed_block/slide",
    "spinner/two_radians",
    "hopper/hop",
    "spinning_ball/off_the_wall",
    "sliding_block/to_rest",
    "cart_pole/dry",
)
# Where walls yield, and all that is asked for is written for IPOPT.
_SOFT = WORLDS[:5]
# ε, relative to what IPOPT's λ s varies by: relaxed by much, modes may change, by little they stay.
_LADDERS = ((1e-2, 1e-4, 1e-7), (1e-4, 1e-5, 1e-6, 1e-7))
# Of a payload they are cheap, beside its polish, and its optima many.
_RENEWALS, _USUAL_RENEWALS = {"payload": 96}, 24
_OWN = 2.0  # times the best known, at most, costs a plan that counts
_WEIGHT = 1.962  # of the payload's cargo times μ [N]
_GRIP = 0.981  # of the disc on the ground [N s/m]


@dataclass(frozen=True)
class Run:
    """What came of one question.

    Attributes:
        name: of it.
        cost: J of the plan.
        holds: whether both replays confirm it.
        seconds: of the processor, machine code compiled.
        rival: what a peer's plan costs that has the same seconds; NaN where there is none.
        ours: the cost that authors count, from our plan; NaN where no authors count.
        peer: the same of IPOPT from the authors' start.
        known: the best that is known of it.
    """

    name: str
    cost: float
    holds: bool
    seconds: float
    rival: float = np.nan
    ours: float = np.nan
    peer: float = np.nan
    known: float = np.nan

    def __str__(self) -> str:
        """Returns a line of a table."""
        costs = self.rival, self.ours, self.peer, self.known
        theirs = " ".join(map(_tell, costs))
        mark = "holds" if self.holds else "does not"
        gap = f"{100 * self.gap:8.3f} %" if np.isfinite(self.known) else ""
        return f"{self.name:28} {self.cost:12.6g} {mark:9} {self.seconds:7.2f} {theirs} {gap}"

    @property
    def is_near(self) -> bool:
        """Whether the plan holds, within 1 % of the best known as authors count."""
        return self.holds and self.cost <= _OWN * self.known and self.gap <= GLOBAL

    @property
    def gap(self) -> float:
        """How far our cost, as authors count, is above the best known, as a part of it."""
        return (self.ours - self.known) / abs(self.known)


def _tell(cost: float) -> str:
    """Returns a cost as a cell: a dash where nothing was asked for."""
    return f"{'-':>12}" if np.isnan(cost) else f"{cost:12.6g}"


def main() -> None:
    """Plans all, and prints a table and shares."""
    arguments = read_flags(
        __doc__,
        only=("", "questions whose name has this in it"),
        renewals=(None, "of each plan (payloads 96, others 24)", {"type": int}),
    )
    print(machine())
    columns = "a peer's", "ours, theirs", "IPOPT", "best known"
    heads = " ".join(f"{each:>12}" for each in columns)
    print(f"{'':28} {'plan':>12} {'':9} {'seconds':>7} {heads} {'gap':>8}")
    names = [*WORLDS, *(f"payload/{i}" for i in range(len(list(payload_tasks()))))]
    names = [each for each in names if arguments.only in each]
    runs = run_all(partial(run, renewals=arguments.renewals), names, arguments)
    counted = [each for each in runs if np.isfinite(each.known)]
    near = [each.is_near for each in counted]
    rivals = [each for each in runs if not np.isnan(each.rival)]
    better = sum(each.holds and each.cost <= (1 + GLOBAL) * each.rival for each in rivals)
    print(f"{better} of {len(rivals)} hold and cost no more than a peer's plan by 1 %")
    print(
        f"{sum(each.holds for each in runs)} of {len(runs)} hold in both simulations; as authors "
        f"count, {sum(near)} of {len(counted)} hold within 1 % of the best known"
    )


def run(name: str, *, renewals: int | None) -> Run:
    """Plans for one question, once more if code was compiled, and counts as its authors do."""
    family, _, number = name.partition("/")
    if renewals is None:
        renewals = _RENEWALS.get(family, _USUAL_RENEWALS)
    scenario = ask_payload(int(number)) if family == "payload" else Scenario.named(name)
    options = PlanOptions(renewals=renewals, threads=1)
    planner = Planner(scenario, options)
    if family != "payload" or not number.strip("0"):
        planner.plan()
    begin = time.process_time()
    plan = planner.plan()
    found = Run(name, plan.cost, plan.holds, time.process_time() - begin)
    if family == "payload":
        task = list(payload_tasks())[int(number)]
        found = _count(found, payload(*task), list_payload(plan), _read_known(name))
    elif family == "push_circle":
        found = _count(found, push_circle(), list_circle(plan), 0.51128)
    if name in _SOFT:
        found = replace(found, rival=solve_from_many(scenario, options, found.seconds))
    elif name.startswith("sliding_block"):
        longer = replace(scenario, time_step=2 * scenario.time_step)
        found = replace(found, rival=solve_modes(longer, found.seconds).cost)
    print(found, flush=True)
    return found


def ask_payload(number: int) -> Scenario:
    """Returns CRISP's payload from one of its starts to one of its goals."""
    start, goal = list(payload_tasks())[number]
    return replace(
        Scenario.named("payload/transport"),
        initial_position=[start[1], start[0] - start[1]],
        initial_velocity=[start[3], start[2] - start[3]],
        goal_position=[goal[1], goal[0] - goal[1]],
        goal_velocity=[goal[3], goal[2] - goal[3]],
    )


def list_payload(plan: Plan) -> Floats:
    """Returns a plan as the variables of `payload`: states, u, f, v, w."""
    motion, dt = plan.best.trajectory, plan.scenario.time_step
    q, v = motion.positions[:-1], motion.velocities[:-1]
    states = np.column_stack([q.sum(axis=1), q[:, 0], v.sum(axis=1), v[:, 0]])
    grip = np.diff(motion.velocities.sum(axis=1)) / dt
    slip = v[:, 1]
    forces = np.clip(grip, -_WEIGHT, _WEIGHT)
    parts = motion.controls[:, 0], forces, np.maximum(slip, 0.0), np.maximum(-slip, 0.0)
    return np.concatenate([states.T.ravel(), *parts])


def list_circle(plan: Plan) -> Floats:
    """Returns a plan as the variables of `push_circle`: disc, pusher, its velocity, forces."""
    motion, dt = plan.best.trajectory, plan.scenario.time_step
    pusher, disc = np.split(motion.positions, 2, axis=1)
    force = _GRIP * np.diff(disc, axis=0) / dt
    normal = (disc - pusher)[:-1]
    normal /= np.linalg.norm(normal, axis=1)[:, np.newaxis]
    along = np.column_stack([-normal[:, 1], normal[:, 0]])
    pushes = np.column_stack([np.sum(force * normal, axis=1), np.sum(force * along, axis=1)])
    speeds = np.diff(pusher, axis=0) / dt
    return np.concatenate([each.T.ravel() for each in (disc, pusher, speeds, pushes)])


def _count(found: Run, prog: MathematicalProgram, x: Floats, known: float) -> Run:
    """Returns the same with what authors count."""
    program = read_program(prog)
    ipopt = Ipopt(StagedProgram(program, FEASIBLE))
    ours, peer = (
        min(cost_of(program, ipopt.solve(start, ladder)) for ladder in _LADDERS)
        for start in (x, _start(prog))
    )
    return replace(found, ours=ours, peer=peer, known=min(ours, peer, known))


def _start(prog: MathematicalProgram) -> Floats:
    """Returns the authors' start: zeros, but where the program has a guess."""
    guess = prog.initial_guess()
    return np.where(np.isnan(guess), 0.0, guess)


def _read_known(name: str) -> float:
    """Returns the best known of a payload, of the record of `peer_programs` or many starts."""
    found: Iterator[re.Match[str]] = re.finditer(
        rf"^{name} +[*-] +([\d.e+-]+)", read_output("peer_programs"), re.MULTILINE
    )
    return min([float(each[1]) for each in found] + [KNOWN.get(name, np.inf)])


if __name__ == "__main__":
    run_as("benchmarks.friction_worlds")
