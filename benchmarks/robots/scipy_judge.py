"""Equations by hand of worlds with friction and of balls, integrated by SciPy: a second judge.

    M(q) v̇ = f(q, v, u) + Σ (Jᵀ λ + Tᵀ τ) - F σ(v / v_s)

over pairs of surfaces with the gap φ, its rate J v and the sliding velocity s = T v. Compliant
contact has the normal force λ = k x max(0, 1 + d ẋ), x = max(0, -φ), and in the middle of the
overlap the friction force τ = -μ λ σ(s / v_s), where σ(x) = x³ (10 - 15 x + 6 x²) up to x = 1, and
1 beyond, as in Drake; k is half of that of two equal bodies. Rigid contact has the impulse
(1 + e) |J v| m, and across it the one that ends sliding, but at most μ times as much. F is dry
friction of joints. Nothing is shared with the package but the scenario.

`integrate` takes a control to its cost: the eighth-order method of Dormand and Prince, a piece for
each value of the control and each flight. Constants are those of the shipped models.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.robots.judge import Control
from benchmarks.robots.setting import model_of
from drake_aigto.world import Scenario

_G = 9.81  # [m/s²]
_PRECISE = 1e-10  # of integration
_MOST_BOUNCES = 100


class Pair(NamedTuple):
    """Two surfaces in a state."""

    gap: float  # φ [m]
    normal: np.ndarray  # J (n,)
    slip: np.ndarray  # T (n,)


class Body(NamedTuple):
    """Bodies and their contacts; functions of q, or of q, v and u."""

    mass: Callable[[Any], np.ndarray]  # M (n, n)
    force: Callable[[Any, Any, Any], np.ndarray]  # f (n,)
    pairs: Callable[[Any], list[Pair]] = lambda q: []
    stiffness: float = 0.0  # k of a pair [N/m]; 0: rigid
    dissipation: float = 0.0  # d of a pair [s/m]
    friction: Sequence[float] = (0.0,)  # μ of each pair, or of all
    brake: float = 0.0  # of rigid friction against q₁ [N]


class Outcome(NamedTuple):
    """Result of a control."""

    cost: float  # J
    end: np.ndarray  # q and v (2n,)
    touched: float  # ∫ Σ λ dt of compliant pairs [N s], or the number of bounces


def integrate(scenario: Scenario, control: Control) -> Outcome:
    """Returns the result of a control of a scenario whose model is one of `BODIES`."""
    body = BODIES[model_of(scenario)]
    n = np.size(scenario.initial_position)
    x = np.concatenate([scenario.initial_position, scenario.initial_velocity, [0.0, 0.0]])
    for start, end, u in zip(control.times[:-1], control.times[1:], control.values, strict=True):
        x = _hold(body, scenario, x, u, start, end)
    goal, goal_velocity = _goals(scenario, n)
    cost = x[2 * n] + _square(scenario.goal_velocity_weight, x[n : 2 * n] - goal_velocity)
    if not scenario.hard_goal:
        cost += _square(scenario.goal_weight, x[:n] - goal)
    return Outcome(float(cost), x[: 2 * n], float(x[2 * n + 1]))


def _hold(body: Body, scenario: Scenario, x: Any, u: Any, start: float, end: float) -> Any:
    """Returns q, v, the cost and what touched after a control is held, through all bounces."""
    n = (x.size - 2) // 2
    for _ in range(_MOST_BOUNCES):
        mode = _find_mode(body, x[n], u)
        events = list(_list_events(body, n, mode))
        found = solve_ivp(
            lambda t, x: _calc_rates(body, scenario, mode, t, x, u),  # noqa: B023
            (start, end),
            x,
            "DOP853",
            rtol=_PRECISE,
            atol=1e-12,
            max_step=(end - start) / 4,
            events=events or None,
        )
        x, start = found.y[:, -1].copy(), found.t[-1]
        if found.status == 0:
            return x
        if mode:
            x[n] = 0.0
        else:
            (hit,) = (i for i, times in enumerate(found.t_events) if len(times))
            x[n : 2 * n] = _bounce(body, scenario, x[:n], x[n : 2 * n], hit)
            x[2 * n + 1] += 1
    raise RuntimeError(f"more than {_MOST_BOUNCES} bounces")


def _find_mode(body: Body, v: float, u: Any) -> float:
    """Returns the sign of what slides against the brake, 0 for what rests or has none."""
    if body.brake == 0.0:
        return 0.0
    if abs(v) > 1e-12:
        return float(np.sign(v))
    return float(np.sign(u[0])) if abs(u[0]) > body.brake else 0.0


def _list_events(body: Body, n: int, mode: float) -> Iterable[Callable[[float, Any], float]]:
    """Returns what ends a flight: gaps that close, a slide that ends."""
    if mode:
        yield _as_event(lambda t, x: mode * x[n])
    if body.stiffness == 0.0:
        for i in range(len(body.pairs(np.zeros(n)))):
            yield _as_event(lambda t, x, i=i: body.pairs(x[:n])[i].gap)


def _as_event(calc: Any) -> Any:
    calc.terminal, calc.direction = True, -1
    return calc


def _calc_rates(body: Body, scenario: Scenario, mode: float, t: float, x: Any, u: Any) -> Any:
    n = (x.size - 2) // 2
    q, v = x[:n], x[n : 2 * n]
    force, pushed = body.force(q, v, u).astype(float), 0.0
    if scenario.dry_friction is not None:
        force -= np.asarray(scenario.dry_friction) * [
            _sigma(s / scenario.stiction_speed) for s in v
        ]
    for i, pair in enumerate(body.pairs(q) if body.stiffness else []):
        depth, rate = max(0.0, -pair.gap), -pair.normal @ v
        normal = body.stiffness * depth * max(0.0, 1.0 + body.dissipation * rate)
        mu = body.friction[min(i, len(body.friction) - 1)]
        tangential = -mu * normal * _sigma(pair.slip @ v / scenario.stiction_speed)
        force += normal * pair.normal + tangential * pair.slip
        pushed += normal
    rates = np.linalg.solve(body.mass(q), force)
    if body.brake:
        rates[0] = rates[0] - mode * body.brake if mode else 0.0
    goal, goal_velocity = _goals(scenario, n)
    if scenario.reference_times is not None:
        columns = np.asarray(scenario.reference_positions).T
        goal = np.array([np.interp(t, scenario.reference_times, each) for each in columns])
    cost = _square(scenario.position_weight, q - goal) + _square(scenario.control_weight, u)
    cost += _square(scenario.velocity_weight, v - goal_velocity)
    return np.concatenate([v, rates, [cost, pushed]])


def _bounce(body: Body, scenario: Scenario, q: Any, v: Any, hit: int) -> np.ndarray:
    """Returns the velocity after a bounce; normal and slip do not mix in these worlds."""
    pair, inverse = body.pairs(q)[hit], np.linalg.inv(body.mass(q))
    rate, slip = pair.normal @ v, pair.slip @ v
    push = -(1.0 + scenario.restitution) * rate / (pair.normal @ inverse @ pair.normal)
    most = body.friction[0] * push
    stops = slip / (pair.slip @ inverse @ pair.slip) if most > 0.0 else 0.0
    return np.asarray(v + inverse @ (push * pair.normal - np.clip(stops, -most, most) * pair.slip))


def _goals(scenario: Scenario, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns q and v that are asked for, 0 where none are."""
    velocity = scenario.goal_velocity
    return np.asarray(scenario.goal_position), np.zeros(n) if velocity is None else velocity


def _square(weight: Any, error: Any) -> float:
    """Returns eᵀ W e, where W may be a matrix, its diagonal, a number or nothing."""
    if weight is None:
        return 0.0
    weight = np.asarray(weight, dtype=float)
    return float(error @ weight @ error if weight.ndim == 2 else np.sum(weight * error**2))


def _sigma(x: float) -> float:
    """Returns how much of Coulomb's friction acts at a slip, in stiction speeds."""
    s = min(abs(x), 1.0)
    return float(np.sign(x)) * s**3 * (10.0 - 15.0 * s + 6.0 * s * s)


def _ball_at_walls(q: Any, radius: float, walls: Sequence[tuple[int, float, float]]) -> list[Pair]:
    """Returns pairs of a ball with walls: axes, where its center touches, signs of φ.

    A ball with a third coordinate turns by that, and its surface moves along the wall.
    """
    found = list[Pair]()
    for axis, place, sign in walls:
        normal, slip = np.zeros(len(q)), np.zeros(len(q))
        gap = sign * (q[axis] - place)
        normal[axis] = sign
        slip[1 - axis] = sign if axis == 0 else -sign  # The normal, turned by +90°.
        slip[2:] = -(radius + min(0.0, gap) / 2)
        found.append(Pair(gap, normal, slip))
    return found


def _two_discs(difference: Any, reach: float) -> tuple[float, np.ndarray]:
    """Returns φ and the direction from one disc's center to the other's."""
    apart = float(np.linalg.norm(difference))
    return apart - reach, np.asarray(difference) / apart


def _circle_pairs(q: Any) -> list[Pair]:
    gap, (x, y) = _two_discs(q[:2] - q[2:], 0.3)
    return [Pair(gap, np.array([x, y, -x, -y]), np.array([-y, x, y, -x]))]


def _spinner_mass(q: Any) -> np.ndarray:
    c = np.cos(q[1])
    lower = 0.0839 + 0.25
    mixed = lower + 0.5 * c
    return np.array([[0.0839 + 0.25 + 1.0 + lower + c, mixed, 0], [mixed, lower, 0], [0, 0, 0.074]])


def _spinner_force(q: Any, v: Any, u: Any) -> np.ndarray:
    swing = 0.5 * np.sin(q[1])
    bias = np.array([swing * (2 * v[0] + v[1]) * v[1], -swing * v[0] ** 2, 0.0])
    return bias - 0.1 * v + [u[0], u[1], 0.0]


def _spinner_pairs(q: Any) -> list[Pair]:
    s1, c1, s12, c12 = np.sin(q[0]), np.cos(q[0]), np.sin(q[0] + q[1]), np.cos(q[0] + q[1])
    tip = np.array([c1 + 0.95 * c12, s1 + 0.95 * s12])
    moves = np.array([[-tip[1], -0.95 * s12, 0.0], [tip[0], 0.95 * c12, 0.0]])
    gap, (x, y) = _two_discs(tip - [1.5, 1.0], 0.3)
    half = min(0.0, gap) / 2
    turn = np.array([0.05 + half, 0.05 + half, 0.25 + half])
    return [Pair(gap, np.array([x, y]) @ moves, np.array([-y, x]) @ moves - turn)]


def _block_pairs(q: Any) -> list[Pair]:
    floor = Pair(q[2] - 0.15, np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]))
    pusher = Pair(q[1] - q[0] - 0.15, np.array([-1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    return [floor, pusher]


def _dry_force(q: Any, v: Any, u: Any) -> np.ndarray:
    s = np.sin(q[1])
    return np.array([u[0] + 0.1 * s * v[1] ** 2, -0.1 * _G * s])


def _foot(q: Any) -> tuple[float, np.ndarray]:
    """Returns the height of the foot's center, and its Jacobian (2, 4)."""
    s, c, reach = np.sin(q[2]), np.cos(q[2]), q[3] - 0.05
    return q[1] - reach * c, np.array([[1.0, 0.0, reach * c, s], [0.0, 1.0, reach * s, -c]])


def _hopper_mass(q: Any) -> np.ndarray:
    _, moves = _foot(q)
    return np.diag([1.001, 1.001, 0.27509, 0.0]) + 0.1 * moves.T @ moves


def _hopper_force(q: Any, v: Any, u: Any) -> np.ndarray:
    s, c, reach = np.sin(q[2]), np.cos(q[2]), q[3] - 0.05
    _, moves = _foot(q)
    bias = 2 * v[3] * v[2] * np.array([c, s]) + reach * v[2] ** 2 * np.array([-s, c])
    return np.array([0.0, -1.001 * _G, u[0], u[1]]) - 0.1 * moves.T @ (bias + np.array([0.0, _G]))


def _hopper_pairs(q: Any) -> list[Pair]:
    height, moves = _foot(q)
    gap = height - 0.05
    turn = np.array([0.0, 0.0, 0.05 + min(0.0, gap) / 2, 0.0])
    return [Pair(gap, moves[1], moves[0] + turn)]


def _room_with_block_pairs(q: Any) -> list[Pair]:
    away = q - 0.5
    axis = int(np.argmax(np.abs(away)))
    normal = np.zeros(2)
    normal[axis] = np.sign(away[axis])
    return [*_room_pairs(q), Pair(abs(away[axis]) - 0.1, normal, np.zeros(2))]


def _room_pairs(q: Any) -> list[Pair]:
    return _ball_at_walls(q, 0.0, [(0, 0, 1), (0, 1, -1), (1, 0, 1), (1, 1, -1)])


def _table_pairs(q: Any) -> list[Pair]:
    return _ball_at_walls(q, 0.1, [(0, 0.1, 1), (0, 1.5, -1), (1, 0.1, 1), (1, 0.9, -1)])


def _two_mass_pairs(q: Any) -> list[Pair]:
    gaps, normals = [q[0], q[1] - q[0], 1.0 - q[1]], np.array([[1.0, 0], [-1, 1], [0, -1]])
    return [Pair(gap, normal, np.zeros(2)) for gap, normal in zip(gaps, normals, strict=True)]


def _fixed(*masses: float) -> Callable[[Any], np.ndarray]:
    matrix = np.diag(masses)
    return lambda q: matrix


def _driven(q: Any, v: Any, u: Any) -> np.ndarray:
    return np.array(u)


def _line_pairs(q: Any) -> list[Pair]:
    return [Pair(q[0], np.ones(1), np.zeros(1)), Pair(1.0 - q[0], -np.ones(1), np.zeros(1))]


# Model → body.
BODIES: Mapping[str, Body] = {
    "point_mass_and_wall": Body(_fixed(1.0), _driven, lambda q: _line_pairs(q)[:1]),
    "corridor": Body(_fixed(1.0), _driven, _line_pairs),
    "floor": Body(_fixed(1.0), lambda q, v, u: u - _G, lambda q: _line_pairs(q)[:1]),
    "room": Body(_fixed(1.0, 1.0), _driven, _room_pairs),
    "room_with_block": Body(_fixed(1.0, 1.0), _driven, _room_with_block_pairs),
    "two_masses": Body(_fixed(1.0, 1.0), _driven, _two_mass_pairs),
    "billiard": Body(_fixed(1.0, 1.0, 0.004), _driven, _table_pairs, friction=(0.3,)),
    "spinning_ball": Body(
        _fixed(1.0, 1.0, 0.004),
        lambda q, v, u: np.array([0.0, u[0], u[1]]),
        _table_pairs,
        stiffness=400.0,
        friction=(0.4,),
    ),
    "sliding_block": Body(_fixed(1.0, 1.0), lambda q, v, u: np.array([u[0], 0.0]), brake=0.3 * _G),
    "pushed_block": Body(
        _fixed(1.0, 1.0, 1.0),
        lambda q, v, u: np.array([u[0], 0.0, -_G]),
        _block_pairs,
        stiffness=2000.0,
        dissipation=0.5,
        friction=(0.3, 0.0),
    ),
    "push_circle": Body(
        _fixed(0.1, 0.1, 0.1, 0.1),
        lambda q, v, u: np.array([u[0], u[1], 0.0, 0.0]) - np.array([1.0, 1.0, 0.981, 0.981]) * v,
        _circle_pairs,
        stiffness=60.0,
        friction=(0.1,),
    ),
    "spinner": Body(
        _spinner_mass,
        _spinner_force,
        _spinner_pairs,
        stiffness=200.0,
        dissipation=0.1,
        friction=(0.5,),
    ),
    "cart_pole_on_dry_rail": Body(
        lambda q: np.array([[1.1, 0.1 * np.cos(q[1])], [0.1 * np.cos(q[1]), 0.1]]), _dry_force
    ),
    "payload": Body(
        lambda q: np.array([[3.0, 1.0], [1.0, 1.0]]), lambda q, v, u: np.array([u[0], 0.0])
    ),
    "hopper": Body(
        _hopper_mass,
        _hopper_force,
        _hopper_pairs,
        stiffness=2000.0,
        dissipation=1.0,
        friction=(0.45,),
    ),
}
