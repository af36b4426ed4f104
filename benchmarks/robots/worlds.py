"""The worlds that are compared: what is asked in each, and who answers."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import cache
from itertools import chain, islice
from typing import Any, NamedTuple

import numpy as np

from benchmarks.robots.mechanics import MECHANISMS, Mechanism, find_gaps
from drake_aigto.world import Scenario

Changes = dict[str, Any]  # Field of a scenario → value.

# How deep in a soft wall a random start may be [m]: deeper, the spring throws the tip at tens of
# metres a second, and no step that is in use resolves it.
DEEPEST = 0.1
_STIFFNESS = 200.0  # of soft walls [N/m]
# a, ȧ, θ, θ̇ of the starts in SPOT's table of random tests (Kang, Liu, Yang, "Global contact-rich
# planning with sparsity-rich SDP relaxations", arXiv 2502.02829), whose parameters and costs the
# scenarios have: its sums over steps of 0.05 s as integrals. Its mechanics have no mass in the
# force at the tip, at which such steps would be unstable otherwise (k/m dt² = 5 > 4); these have.
SPOT_STARTS = np.array(
    [
        [0.7740, -0.6848, 0.2446, 1.2363],
        [0.8605, 0.9412, -0.7293, -2.8090],
        [0.1206, 0.9143, 0.5484, -1.3385],
        [0.8677, -0.0292, 0.6817, -2.7230],
        [0.6007, 0.6006, 0.2808, -2.4172],
        [0.0927, -0.7162, 0.4049, 1.9407],
        [0.2646, -0.1565, 0.3819, 1.1690],
        [0.5195, 0.8315, -0.1693, -1.0974],
        [0.9096, 0.5844, 0.2442, 2.7013],
        [0.9166, 0.9190, -0.5165, -2.7933],
    ]
)
_TUNING = 1000  # Starts to tune on are drawn by another seed than those that are reported.


@cache
def _named(scenario: str) -> Scenario:
    return Scenario.named(scenario)


@dataclasses.dataclass(frozen=True)
class RobotWorld:
    """A world and its questions.

    Attributes:
        scenario: a shipped one.
        count: of questions that are reported.
        draw: the changes of a random question.
        push: how far random controls go on either side of what holds, [N], [N m].
        hold: what holds [N].
        given: the changes of the first questions.
        fixed: those of all.
        touches: how many are listed at most.
        off: which share of plans may be off the best known, as the project asks of itself.
    """

    scenario: str
    count: int
    draw: Callable[[np.random.Generator], Changes]
    push: tuple[float, ...]
    hold: tuple[float, ...] = (0.0,)
    given: tuple[Changes, ...] = ()
    fixed: Changes = dataclasses.field(default_factory=dict)
    touches: int = 3
    off: float = 0.05

    @property
    def mechanism(self) -> Mechanism:
        """The equations of its model."""
        model = _named(self.scenario).model
        return MECHANISMS[model.rpartition("/")[2].removesuffix(".sdf")]

    @property
    def is_soft(self) -> bool:
        """Whether its walls yield."""
        return _named(self.scenario).contact == "compliant"

    @property
    def is_rigid(self) -> bool:
        """Whether there are walls that do not."""
        return self.mechanism.walls > 0 and not self.is_soft


class Question(NamedTuple):
    """One question of a world."""

    world: str
    number: int
    is_tuning: bool = False

    @property
    def section(self) -> str:
        """Where it is found among what is known."""
        return f"{self.world}, tuning" if self.is_tuning else self.world

    @property
    def is_deep(self) -> bool:
        """Whether it starts deeper in a wall than random starts may."""
        return _least_gap(WORLDS[self.world], scenario_of(self)) < -DEEPEST


class Weights(NamedTuple):
    """What a motion costs, by coordinate (n,) and by control."""

    position: np.ndarray
    velocity: np.ndarray
    control: np.ndarray
    final_position: np.ndarray
    final_velocity: np.ndarray
    goal: np.ndarray
    goal_velocity: np.ndarray
    is_chordal: np.ndarray


class Setting(NamedTuple):
    """A question as the judge takes it."""

    mechanism: Mechanism
    start: np.ndarray  # q and v (2n,)
    duration: float
    weights: Weights
    stiffness: float  # of walls [N/m]; 0: rigid
    restitution: float
    ranges: np.ndarray  # of q and v (2, 2n)
    units: np.ndarray  # half of the ranges, 1 where there is none (2n,)
    norm: float  # of the control, at most
    is_hard: bool  # whether q has to be the goal at the end


def make_questions(world: str, count: int, is_tuning: bool = False) -> list[Question]:
    """Returns the first questions of a world."""
    return [Question(world, number, is_tuning) for number in range(count)]


@cache
def scenario_of(question: Question) -> Scenario:
    """Returns the scenario of a question."""
    return _draw_all(question.world, question.is_tuning)[question.number]


@cache
def _draw_all(name: str, is_tuning: bool) -> list[Scenario]:
    """Returns all of a world: given ones, and random ones, none of which start in a wall.

    Soft walls may be started in a little, and as deep as may be where that is given.
    """
    world = WORLDS[name]
    rng = np.random.default_rng(16 + (_TUNING if is_tuning else 0))
    shipped = dataclasses.replace(_named(world.scenario), **world.fixed)
    given = [] if is_tuning else [dataclasses.replace(shipped, **each) for each in world.given]
    drawn = iter(lambda: dataclasses.replace(shipped, **world.draw(rng)), None)
    deepest = DEEPEST if world.is_soft else 0.0
    kept = (each for each in drawn if _least_gap(world, each) >= -deepest)
    first = given if world.is_soft else [each for each in given if _least_gap(world, each) >= 0.0]
    return list(islice(chain(first, kept), world.count))


def _least_gap(world: RobotWorld, scenario: Scenario) -> float:
    gaps = find_gaps(world.mechanism, scenario.initial_position)
    return float(np.min(gaps, initial=np.inf))


@cache
def setting_of(question: Question) -> Setting:
    """Returns what the judge takes: read from the scenario's fields, and the model's by hand."""
    scenario, world = scenario_of(question), WORLDS[question.world]
    mechanism = world.mechanism
    n, nu = mechanism.coordinates, mechanism.controls

    def spread(value: Any, size: int, default: float = 0.0) -> np.ndarray:
        values = np.asarray(default if value is None else value, dtype=float)
        return np.array(np.broadcast_to(values, size))

    low, high = np.full(2 * n, -np.inf), np.full(2 * n, np.inf)
    low[: len(mechanism.least)], high[: len(mechanism.most)] = mechanism.least, mechanism.most
    low[n:] = spread(scenario.velocity_lower, n, -np.inf)
    high[n:] = spread(scenario.velocity_upper, n, np.inf)
    weights = Weights(
        position=spread(scenario.position_weight, n),
        velocity=spread(scenario.velocity_weight, n),
        control=spread(scenario.control_weight, nu),
        final_position=spread(scenario.goal_weight, n),
        final_velocity=spread(scenario.goal_velocity_weight, n),
        goal=spread(scenario.goal_position, n),
        goal_velocity=spread(scenario.goal_velocity, n),
        is_chordal=(scenario.angles == "chordal") & np.isin(np.arange(n), mechanism.hinges),
    )
    return Setting(
        mechanism,
        np.concatenate([scenario.initial_position, scenario.initial_velocity]),
        scenario.duration,
        weights,
        _STIFFNESS if world.is_soft else 0.0,
        scenario.restitution,
        np.array([low, high]),
        np.where(np.isfinite(high - low), (high - low) / 2, 1.0),
        scenario.control_norm or np.inf,
        scenario.hard_goal,
    )


def _start(q: Any, v: Any, **changes: Any) -> Changes:
    return {"initial_position": np.array(q), "initial_velocity": np.array(v), **changes}


def _draw_cart_pole(rng: np.random.Generator) -> Changes:
    """SPOT's distribution."""
    a, speed, angle, spin = rng.uniform([0.0, -1.0, -np.pi / 4, -3.0], [0.95, 1.0, np.pi / 4, 3.0])
    return _start([a, angle], [speed, spin])


def _draw_pendulum(rng: np.random.Generator) -> Changes:
    """From about the wall to the other side, there and back."""
    return _start(
        [rng.uniform(-0.4, 1.2)],
        [rng.uniform(-5.0, 3.0)],
        goal_position=np.array([rng.uniform(-0.4, 1.2)]),
        duration=0.02 * int(rng.integers(40, 91)),
        restitution=float(rng.choice([1.0, 0.8, 0.5])),
    )


def _draw_throw(rng: np.random.Generator) -> Changes:
    """A throw like nosnoc's, nearer or farther, lower or higher, on softer and harder floors."""
    height = rng.uniform(0.4, 0.6)
    return _start(
        [0.0, height],
        [0.0, 0.0],
        goal_position=np.array([rng.uniform(3.0, 5.0), height]),
        restitution=float(rng.uniform(0.85, 0.95)),
    )


def _draw_bat(rng: np.random.Generator) -> Changes:
    """A ball anywhere above the paddle, to anywhere above it."""
    return _start(
        [0.0, 0.0, rng.uniform(-0.2, 0.2), rng.uniform(0.5, 1.0)],
        [0.0, 0.0, rng.uniform(-0.3, 0.3), 0.0],
        goal_position=np.array([0.0, 0.0, rng.uniform(-0.6, 0.6), rng.uniform(0.6, 1.1)]),
    )


def _draw_swap(rng: np.random.Generator) -> Changes:
    """Two discs about nosnoc's places, which are each other's goals."""
    driven = np.array([-1.0, 0.0]) + rng.uniform(-0.3, 0.3, 2)
    other = np.array([1.0, 0.0]) + rng.uniform(-0.3, 0.3, 2)
    goal = np.concatenate([other, driven])
    return _start(np.concatenate([driven, other]), np.zeros(4), goal_position=goal)


def _draw_carts(rng: np.random.Generator) -> Changes:
    """Three carts about nosnoc's places."""
    near, far = np.array([-3.0, 0.0, 3.0]), np.array([-5.0, 0.0, 5.0])
    start, goal = near + rng.uniform(-0.5, 0.5, 3), far + rng.uniform(-0.5, 0.5, 3)
    return _start(start, np.zeros(3), goal_position=goal)


def _draw_acrobot(rng: np.random.Generator) -> Changes:
    """About hanging."""
    return _start(rng.uniform(-0.5, 0.5, 2), rng.uniform(-0.5, 0.5, 2))


_SPOT = tuple(_start([a, angle], [speed, spin]) for a, speed, angle, spin in SPOT_STARTS.tolist())


def _cart_pole(scenario: str, off: float, **fixed: Any) -> RobotWorld:
    return RobotWorld(scenario, 60, _draw_cart_pole, (10.0,), given=_SPOT, fixed=fixed, off=off)


WORLDS: Mapping[str, RobotWorld] = {
    "cart_pole/soft_06": _cart_pole("cart_pole/soft_06", 0.05),
    "cart_pole/soft_10": _cart_pole("cart_pole/soft_10", 0.05),
    **{
        f"cart_pole/rigid_{wall}/e={e:g}": _cart_pole(f"cart_pole/rigid_{wall}", 0.1, restitution=e)
        for wall in ("06", "10")
        for e in (1.0, 0.5)
    },
    "pendulum/off_the_wall": RobotWorld(
        "pendulum/off_the_wall", 200, _draw_pendulum, (8.0,), off=0.01
    ),
    "throwing_ball/bounces": RobotWorld(
        "throwing_ball/bounces", 20, _draw_throw, (3.0, 3.0), (0.0, 0.0), given=({},), touches=8
    ),
    "paddle/bat": RobotWorld("paddle/bat", 40, _draw_bat, (20.0, 1.0), (9.81, 0.0), given=({},)),
    "two_discs/swap": RobotWorld(
        "two_discs/swap", 40, _draw_swap, (15.0, 15.0), (0.0, 0.0), given=({},)
    ),
    "three_carts/apart": RobotWorld("three_carts/apart", 40, _draw_carts, (20.0,), given=({},)),
    "acrobot/swing_up": RobotWorld("acrobot/swing_up", 40, _draw_acrobot, (15.0,), given=({},)),
    "acrobot/beside_a_wall": RobotWorld(
        "acrobot/beside_a_wall", 40, _draw_acrobot, (15.0,), given=({},)
    ),
}
