"""What answers a question: ours and its peers, each as a stream of attempts.

Every random attempt starts from a random smooth control, piecewise linear between three to eight
values. An attempt tells what its own program promises.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from benchmarks.local_peers import casadi
from benchmarks.robots.bounce_times import find_bounces
from benchmarks.robots.impulses import find_rigid_program, find_touches
from benchmarks.robots.ipopt import IPOPT_STEPS, find_program
from benchmarks.robots.judge import Control, judge, roll_out
from benchmarks.robots.shooting import Transcription, find_plan, list_phases, pose, shoot
from benchmarks.robots.worlds import WORLDS, Question, scenario_of

_GUESS_STEP = 1e-3  # of roll-outs [s]


class Attempt(NamedTuple):
    """A control that a method found."""

    promised: float  # J as the method has it; infinite if it failed
    control: Control


Attempts = Iterator[Attempt]


class Method(NamedTuple):
    """A method, and where it applies."""

    run: Callable[[Question, int], Attempts]
    on_rigid_walls: bool = True
    on_soft_walls: bool = True  # or where nothing touches
    only: str = ""  # of all worlds

    def applies(self, world: str) -> bool:
        """Returns whether it can answer questions of a world."""
        if self.only not in ("", world):
            return False
        return self.on_rigid_walls if WORLDS[world].is_rigid else self.on_soft_walls


def random_control(question: Question, rng: np.random.Generator, shares: np.ndarray) -> np.ndarray:
    """Returns a smooth control (L, nu), at shares of the duration (L,)."""
    world = WORLDS[question.world]
    count = rng.integers(3, 9)
    nodes = rng.uniform(-1.0, 1.0, (count, len(world.push))) * rng.uniform(0.2, 1.0)
    grid = np.linspace(0.0, 1.0, count)
    columns = [np.interp(shares, grid, column) for column in nodes.T]
    return np.column_stack(columns) * np.array(world.push) + np.array(world.hold)


def _generators(question: Question, first: int) -> Iterator[np.random.Generator]:
    """Yields one for each attempt from the first one on, the same wherever a search goes on."""
    world = list(WORLDS).index(question.world)
    for number in itertools.count(first):
        yield np.random.default_rng([world, question.number, question.is_tuning, number])


def _middles(count: int) -> np.ndarray:
    return np.linspace(0.0, 1.0, 2 * count + 1)[1::2]


def plan(question: Question, first: int = 0) -> Attempts:
    """Yields the plan, of which there is one."""
    yield Attempt(*find_plan(question))


def shooting_multistart(question: Question, first: int = 0) -> Attempts:
    """Yields what our shooting makes of random controls."""
    shares = _middles(scenario_of(question).num_steps)
    guesses = (random_control(question, rng, shares) for rng in _generators(question, first))
    yield from itertools.starmap(Attempt, shoot(itertools.repeat(pose(question)), guesses))


def listed_sequences(question: Question, first: int = 0) -> Attempts:
    """Yields what our shooting makes of random controls with listed touches at random times.

    Each promises what it costs when it is replayed: between knots it may have passed a wall.
    """
    shares = _middles(scenario_of(question).num_steps)
    for rng in _generators(question, first):
        guess = random_control(question, rng, shares)
        world = WORLDS[question.world]
        listed = scenario_of(question), world.mechanism.walls, world.touches
        problem = pose(question, list_phases(*listed, rng))
        for promised, control in shoot([problem], [guess]):
            is_found = np.isfinite(promised)
            yield Attempt(judge(question, control).score if is_found else np.inf, control)


def bounces(question: Question, first: int = 0) -> Attempts:
    """Yields what a fine search over when the pendulum bounces, and how fast, finds."""
    yield from itertools.starmap(Attempt, find_bounces(question))


def ipopt_multistart(question: Question, first: int = 0) -> Attempts:
    """Yields what IPOPT makes of random roll-outs, of their touches where walls are rigid."""
    is_rigid, duration = WORLDS[question.world].is_rigid, scenario_of(question).duration
    count = round(duration / _GUESS_STEP) if is_rigid else IPOPT_STEPS
    for number in range(WORLDS[question.world].touches + 1 if is_rigid else 0):
        find_rigid_program(question.world, number)  # All of them once, before time counts.
    for rng in _generators(question, first):
        u = random_control(question, rng, np.linspace(0.0, 1.0, count + 1))
        states = roll_out(question, Control.even(u[:-1], duration), _GUESS_STEP).states
        if is_rigid:
            touches = find_touches(question, states)
            program = find_rigid_program(question.world, len(touches))
            yield Attempt(*program.solve(question, touches, states, u))
        else:
            yield Attempt(*find_program(question.world).solve(question, states, u))


def snopt_multistart(question: Question, first: int = 0) -> Attempts:
    """Yields what SNOPT makes of random roll-outs."""
    scenario = scenario_of(question)
    transcription = Transcription(pose(question))
    for rng in _generators(question, first):
        u = random_control(question, rng, _middles(scenario.num_steps))
        motion = roll_out(question, Control.even(u, scenario.duration), _GUESS_STEP)
        yield Attempt(*transcription.solve(motion.states, u))


METHODS: Mapping[str, Method] = {
    "plan": Method(plan),
    "shooting": Method(shooting_multistart, on_rigid_walls=False),
    "listed": Method(listed_sequences, on_soft_walls=False),
    "bounces": Method(bounces, only="pendulum/off_the_wall"),
    "IPOPT": Method(ipopt_multistart),
    "SNOPT": Method(snopt_multistart, on_rigid_walls=False),
}
PLANS = ("plan",)  # They end by themselves.


def is_installed(name: str) -> bool:
    """Returns whether a method's library is there."""
    return name != "IPOPT" or casadi is not None
