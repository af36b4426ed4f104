"""What answers a question about the cart-pole: ours and its peers, each as a stream of attempts.

Every random attempt starts from a roll-out of a random smooth control, piecewise linear between
three to eight values. An attempt tells what its own program promises; the judge is not asked.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from typing import NamedTuple

import numpy as np

from benchmarks.local_peers import casadi
from benchmarks.robots.cart_pole import DURATION, LARGEST_POSITION, Question, roll_out
from benchmarks.robots.ipopt import Program
from benchmarks.robots.plans import find_plan
from benchmarks.robots.shooting import shoot

try:
    import cma
except ModuleNotFoundError:
    cma = None

NUM_STEPS = 60  # of the scenario
IPOPT_STEPS = 120  # with 60, costs of replays are off by more than 1 % in every third optimum
_GUESS_STEP = 1e-3  # of roll-outs [s]
# CMA-ES: nodes of the piecewise linear control, steps of 5 ms, and the price of leaving the range.
_NODES, _STEPS_PER_HOLD, _FINE = 16, 5, 300.0


class Attempt(NamedTuple):
    """A control that a method found."""

    promised: float  # J as the method has it; infinite if it failed
    controls: np.ndarray  # held for equal times (L,)


Method = Callable[[Question, int], Iterator[Attempt]]


def random_control(rng: np.random.Generator, times: np.ndarray) -> np.ndarray:
    """Returns a smooth control of up to 2 … 10 N, at times in [0, 1]."""
    count = rng.integers(3, 9)
    nodes = rng.uniform(-10.0, 10.0, count) * rng.uniform(0.2, 1.0)
    return np.interp(times, np.linspace(0.0, 1.0, count), nodes)


def _generators(question: Question, first: int) -> Iterator[np.random.Generator]:
    """Yields one for each attempt from the first one on, the same wherever a search goes on."""
    wall = round(1000 * question.wall)
    for number in itertools.count(first):
        yield np.random.default_rng([wall, question.number, number])


def ipopt_multistart(question: Question, first: int = 0) -> Iterator[Attempt]:
    """Yields what IPOPT makes of random roll-outs."""
    program = _program()
    steps = int(np.ceil(DURATION / IPOPT_STEPS / _GUESS_STEP))
    for rng in _generators(question, first):
        u = random_control(rng, np.linspace(0.0, 1.0, IPOPT_STEPS + 1))
        held = DURATION / IPOPT_STEPS / steps
        x, _ = roll_out(np.array(question.start), u[:-1], question.wall, held, steps)
        yield Attempt(*program.solve(question, x[::steps], u))


@cache
def _program() -> Program:
    return Program(IPOPT_STEPS)


def evolution(question: Question, first: int = 0) -> Iterator[Attempt]:
    """Yields the best of each generation of CMA-ES, begun again where it ends."""
    grid = np.linspace(0.0, 1.0, 2 * NUM_STEPS + 1)[1::2]
    spread = np.array(
        [np.interp(grid, np.linspace(0.0, 1.0, _NODES), row) for row in np.eye(_NODES)]
    )
    for number, rng in enumerate(_generators(question, first)):
        start = random_control(rng, np.linspace(0.0, 1.0, _NODES))
        seed = int(rng.integers(1, 2**31))
        options = {"seed": seed, "verbose": -9, "popsize_factor": 2 ** (number % 4)}
        search = cma.CMAEvolutionStrategy(start, 4.0, options)
        while not search.stop():
            nodes = search.ask()
            costs = [_penalized(question, each @ spread) for each in nodes]
            search.tell(nodes, costs)
            best = int(np.argmin(costs))
            yield Attempt(costs[best], nodes[best] @ spread)


def _penalized(question: Question, controls: np.ndarray) -> float:
    """Returns J by short steps, and the price of leaving the range."""
    force = np.clip(controls, -20.0, 20.0)
    step = DURATION / NUM_STEPS / _STEPS_PER_HOLD
    x, cost = roll_out(np.array(question.start), force, question.wall, step, _STEPS_PER_HOLD)
    excess = np.maximum(np.abs(x[:, 0]) - LARGEST_POSITION, 0.0)
    total = cost + _FINE * float(excess.max())
    return total if np.isfinite(total) else 1e9


def shooting_multistart(question: Question, first: int = 0) -> Iterator[Attempt]:
    """Yields what our shooting makes of random controls."""
    middles = np.linspace(0.0, 1.0, 2 * NUM_STEPS + 1)[1::2]
    guesses = (random_control(rng, middles) for rng in _generators(question, first))
    yield from itertools.starmap(Attempt, shoot(question, guesses))


def plan(question: Question, first: int = 0) -> Iterator[Attempt]:
    """Yields the plan, of which there is one."""
    yield Attempt(*find_plan(question, has_boxes=True))


def plan_of_points(question: Question, first: int = 0) -> Iterator[Attempt]:
    """Yields the plan without boxes."""
    yield Attempt(*find_plan(question, has_boxes=False))


METHODS: Mapping[str, Method] = {
    "plan": plan,
    "plan, points": plan_of_points,
    "shooting": shooting_multistart,
    "IPOPT": ipopt_multistart,
    "CMA-ES": evolution,
}
PLANS = ("plan", "plan, points")  # They end by themselves.
_EXTRAS = {"IPOPT": casadi, "CMA-ES": cma}


def is_installed(name: str) -> bool:
    """Returns whether a method's library is there."""
    return _EXTRAS.get(name, name) is not None
