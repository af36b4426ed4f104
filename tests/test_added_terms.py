"""Costs and constraints of users in shooting: derivatives, optima of IPOPT, and refusals."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from mechanisms import build
from pydrake.solvers import IpoptSolver, MathematicalProgram
from pydrake.symbolic import Formula, cos, exp, sin
from shooting_problems import expand_motion, pose
from shooting_problems import weigh as weigh_effort
from test_shooting import soft, weigh
from test_shooting_phases import RESTITUTION, ball
from test_shooting_phases import pose as pose_phases

from drake_aigto.contact import Mechanism, RigidLaw, evaluate_tape
from drake_aigto.errors import ProgramError, UnsupportedTermError
from drake_aigto.shooting import (
    AddedTerms,
    Phases,
    ShootingOptions,
    ShootingProblem,
    Smoothing,
    make_memory,
)
from drake_aigto.transcription import Addition, Additions, Place
from drake_aigto.world import Scenario, World

N, T = 12, 1.5
FINE = ShootingOptions(
    rungs=(Smoothing(0.01, 200, 1e-10),), multiplier_updates=30, feasibility=1e-8
)


@cache
def room() -> World:
    return World.from_scenario(Scenario.named("room/two_walls"))


def read(world: World, function: Any, knot: int | None = None) -> Addition:
    parts: dict[Any, Any] = {"q": world.positions, "v": world.velocities, "u": world.controls}
    prog = MathematicalProgram()
    places: dict[int, Any] = {}
    for part, variables in parts.items():
        prog.AddDecisionVariables(variables)
        for i, each in enumerate(variables):
            places[each.get_id()] = Place(part, i, knot)
    is_constraint, name = isinstance(function, Formula), str(function)
    binding = prog.AddConstraint(function) if is_constraint else prog.AddCost(function)
    read_places = tuple(places[variable.get_id()] for variable in binding.variables())
    return Addition(name, binding.evaluator(), read_places)


def add(world: World, knots: Any = (), **functions: list[Any]) -> AddedTerms:
    lists: dict[str, Any] = {
        name: tuple(read(world, each) for each in these) for name, these in functions.items()
    }
    at_knots = tuple(read(world, function, knot) for function, knot in knots)
    times = np.linspace(0, T, N + 1)
    return AddedTerms.of(world, Additions(**lists, at_knots=at_knots, times=times))


def pose_room(added: AddedTerms, **more: Any) -> ShootingProblem:
    mechanism = Mechanism.of(room(), RigidLaw(np.ones(4)))
    cost = weigh_effort([0.8, 0.6], np.full(2, 0.05), QT=20 * np.eye(2))
    return pose(mechanism, cost, [0.1, 0.2, 0.0, 0.0], N, T, added=added, **more)


class Peer:
    """The same motions as a program for IPOPT: a point mass, whose Runge-Kutta steps are exact."""

    def __init__(self, total: tuple[float, float] = (T, T)) -> None:
        problem = pose_room(add(room()))
        mass, bias = problem.mechanism.calc_inertia(problem.start[:2])
        self.prog = prog = MathematicalProgram()
        self.q, self.v = (
            prog.NewContinuousVariables(N + 1, 2),
            prog.NewContinuousVariables(N + 1, 2),
        )
        self.u, (self.T,) = prog.NewContinuousVariables(N, 2), prog.NewContinuousVariables(1)
        prog.AddBoundingBoxConstraint(*total, self.T)
        prog.SetInitialGuess(self.T, T)
        q, v, u, self.h = self.q, self.v, self.u, self.T / N
        force = problem.mechanism.actuation
        prog.AddBoundingBoxConstraint([0.1, 0.2], [0.1, 0.2], q[0])
        prog.AddBoundingBoxConstraint(0.0, 0.0, v[0])
        gains, fall = np.linalg.solve(mass, force), np.linalg.solve(mass, bias)
        for k, i in np.ndindex(N, 2):
            a = gains[i, 0] * u[k, 0] + gains[i, 1] * u[k, 1] - fall[i]
            prog.AddConstraint(q[k + 1, i] == q[k, i] + self.h * v[k, i] + self.h**2 / 2 * a)
            prog.AddConstraint(v[k + 1, i] == v[k, i] + self.h * a)
            prog.AddCost(self.h * 0.05 * u[k, i] ** 2)
        prog.AddCost(20 * (q[N, 0] - 0.8) ** 2 + 20 * (q[N, 1] - 0.6) ** 2)

    def at(self, function: Any, k: int) -> Any:
        world, u = room(), self.u[min(k, N - 1)]
        symbols = [*world.positions, *world.velocities, *world.controls]
        return function.Substitute(dict(zip(symbols, [*self.q[k], *self.v[k], *u], strict=True)))

    def solve(self) -> tuple[float, Any, float]:
        share = np.linspace(0, 1, N + 1)[:, None]
        self.prog.SetInitialGuess(self.q, [0.1, 0.2] + share * [0.7, 0.4])
        result = IpoptSolver().Solve(self.prog)
        assert result.is_success()
        return result.get_optimal_cost(), result.GetSolution(self.u), result.GetSolution(self.T)


def make_functions() -> tuple[Any, ...]:
    (x, y), (vx, vy), (a, b) = room().positions, room().velocities, room().controls
    running = 3 * (x - y) ** 4 + 0.1 * (x * a - 1) ** 2 + sin(2 * y) + vx**2 * vy**2
    final = vx**2 + 0.5 * cos(x)
    return running, final, [(x - 0.45) ** 2 + (y - 0.45) ** 2 >= 0.04, a**2 + b**2 <= 9.0]


def test_optima_with_costs_and_constraints_are_those_of_ipopt() -> None:
    running, final, everywhere = make_functions()
    x, y = room().positions
    added = add(
        room(), ((y == 0.7, 6), (2.0 * (x - 0.2) ** 2, 4)), running=[running], final=[final],
        everywhere=everywhere,
    )  # fmt: skip
    result = pose_room(added).solve(np.random.default_rng(0).normal(size=(N, 2)), None, FINE)
    peer = Peer()
    for k in range(N):
        peer.prog.AddCost(peer.h * peer.at(running, k))
        peer.prog.AddConstraint(peer.at(everywhere[1], k))
        peer.prog.AddConstraint(peer.at(everywhere[0], k + 1))
    peer.prog.AddConstraint(peer.at(y == 0.7, 6))
    peer.prog.AddCost(peer.at(2.0 * (x - 0.2) ** 2, 4) + peer.at(final, N))
    cost, controls, _ = peer.solve()
    assert result.violation <= 1e-7
    assert result.cost == pytest.approx(cost, rel=1e-5)
    np.testing.assert_allclose(result.controls, controls, atol=1e-2)
    np.testing.assert_allclose(result.states[6, 1], 0.7, atol=1e-6)


def test_costs_of_every_knot_stretch_with_free_durations() -> None:
    (x, y), (vx, _) = room().positions, room().velocities
    running = 4 + (x - y) ** 2 + vx**2
    total = 0.5 * T, 2 * T
    problem = pose_room(add(room(), running=[running]), phases=Phases.free(T, total))
    result = problem.solve(np.full((N, 2), 0.1), None, FINE)
    peer = Peer(total)
    for k in range(N):
        peer.prog.AddCost(peer.h * peer.at(running, k))
    cost, _, duration = peer.solve()
    assert result.cost == pytest.approx(cost, rel=1e-6)
    np.testing.assert_allclose(result.phases.durations, duration, rtol=1e-3)


@pytest.mark.parametrize("has_phases", [False, True])
def test_derivatives_are_those_of_differences_and_hessians_are_positive(has_phases: bool) -> None:
    world, mechanism = build("cart-pole"), soft("cart-pole")
    (x, angle), (vx, omega), (u,) = world.positions, world.velocities, world.controls
    functions = {"running": [vx * u * x + 0.5 * sin(angle) * omega], "final": [x**3 * vx]}
    added = add(world, ((x * angle, 3),) if not has_phases else (), **functions)
    phases = Phases.free(T, (T / 2, 2 * T)) if has_phases else None
    problem = pose(mechanism, weigh([0, 1.0]), np.zeros(4), N, T, phases=phases)
    programs = [
        each.make_program(ShootingOptions()) for each in (replace(problem, added=added), problem)
    ]
    K, shapes = len(programs[0].kinds), make_memory(programs[0])
    rng = np.random.default_rng(2)
    states, controls = (rng.normal(size=a.shape) for a in (shapes.states, shapes.controls))
    states[:, 4:], controls[programs[0].kinds < -1] = 0.7, 0.7

    def evaluate(program: Any, states: Any, controls: Any) -> tuple[float, Any, Any]:
        memory = make_memory(program)
        cost = expand_motion(program, states, controls, 0.1, memory)
        return cost, memory.expansion.l1, memory.expansion.l2

    (_, slopes, bends), (_, _, own_bends) = (evaluate(p, states, controls) for p in programs)
    nz, step = states.shape[1], 1e-6
    for k, c in np.ndindex(K + 1, nz + 1):
        if c == nz and k == K:
            continue
        costs = []
        for sign in (1, -1):
            z, w = states.copy(), controls.copy()
            (z if c < nz else w)[k, c if c < nz else 0] += sign * step
            costs.append(evaluate(programs[0], z, w)[0])
        expected = (costs[0] - costs[1]) / (2 * step)
        assert slopes[k, c] == pytest.approx(expected, rel=1e-5, abs=1e-5), (k, c)
    for difference in bends - own_bends:
        upper = np.triu(difference)
        whole = upper + np.triu(difference, 1).T
        assert np.all(np.linalg.eigvalsh(whole) >= -1e-9)
    assert np.max(np.abs(bends - own_bends)) > 0.1


def test_hessians_are_the_positive_parts_of_exact_ones() -> None:
    world = room()
    (x, y), (a, _) = world.positions, world.controls
    program = pose_room(add(world, running=[x**2 * y + a * y - x * a**2])).make_program(FINE)
    bare, memory = pose_room(add(world)).make_program(FINE), make_memory(program)
    states = np.random.default_rng(1).normal(size=memory.states.shape)
    controls = np.random.default_rng(3).normal(size=memory.controls.shape)
    expand_motion(program, states, controls, 0.0, memory)
    other = make_memory(bare)
    expand_motion(bare, states, controls, 0.0, other)
    for k in range(N):
        (x_k, y_k), a_k = states[k, :2], controls[k, 0]
        exact = np.zeros((6, 6))
        exact[0, 0], exact[0, 1], exact[0, 4], exact[1, 4] = 2 * y_k, 2 * x_k, -2 * a_k, 1.0
        exact[4, 4] = -2 * x_k
        values, vectors = np.linalg.eigh(exact + np.triu(exact, 1).T)
        positive = (vectors * np.maximum(values, 0)) @ vectors.T * T / N
        found = np.triu(memory.expansion.l2[k] - other.expansion.l2[k])
        np.testing.assert_allclose(found, np.triu(positive), atol=1e-12)


def test_constraints_on_the_state_hold_on_both_sides_of_an_impact() -> None:
    (v,) = ball().velocities
    phases = Phases(np.zeros(1, dtype=np.int64), np.array([6]), np.array([0.7, 1.3]), (2.0, 2.0))
    problem = pose_phases(ball(), [1.0], [2.0], phases, N)
    free = problem.solve(np.full((N, 1), -1.0), None, FINE)
    before = free.states[6, 1] / RESTITUTION
    bound = 0.95 * before
    added = add(ball(), everywhere=[v**2 <= bound**2])
    slow = replace(problem, added=added).solve(np.full((N, 1), -1.0), None, FINE)
    assert slow.violation <= 1e-6 and slow.cost > free.cost
    assert slow.states[6, 1] / RESTITUTION == pytest.approx(bound, rel=1e-5)


def test_functions_of_quaternions_have_derivatives_along_turns() -> None:
    world = World.from_scenario(scenario := Scenario.named("drone/deliver"))
    q, v, u = world.positions, world.velocities, world.controls
    cost = q[0] * q[1] * v[0] + q[2] ** 2 * q[4] + u[0] * q[3] + v[3] * sin(q[7])
    added, rng = add(world, running=[cost], everywhere=[cost <= 1.0]), np.random.default_rng(0)
    (n, nu), tape = world.actuation.shape, added.tape
    size = 2 * n + nu
    at = world.add(np.array(world.place(scenario).initial_position), rng.normal(size=(n,)))
    v0, u0, step = rng.normal(size=n), rng.normal(size=nu), np.float64(1e-4)

    def evaluate(delta: Any) -> Any:
        x = np.concatenate([world.add(at, delta[:n]), v0 + delta[n : 2 * n], u0 + delta[2 * n :]])
        values, sums = np.zeros(1 + len(x) + 2 * tape.code[0] + tape.code[1]), tape.constants.copy()
        evaluate_tape(np.array(tape.code), np.array(tape.numbers), x, values, sums)
        return sums

    sums, moves = evaluate(np.zeros(size)), step * np.eye(size)
    slopes = [(evaluate(move)[0] - evaluate(-move)[0]) / (2 * step) for move in moves]
    np.testing.assert_allclose(sums[2 : 2 + 2 * size], slopes * 2, atol=1e-8)
    bends = [
        (evaluate(a + b)[0] - evaluate(a - b)[0] - evaluate(b - a)[0] + evaluate(-a - b)[0])
        / (4 * step**2)
        for i, a in enumerate(moves)
        for b in moves[i:]
    ]
    np.testing.assert_allclose(sums[2 + 2 * size :][: len(bends)], bends, atol=1e-7)


def test_what_shooting_cannot_take_is_refused_by_name() -> None:
    world = room()
    x, y = world.positions
    with pytest.raises(UnsupportedTermError, match=r"exp.*can't be planned for a mechanism"):
        add(world, running=[exp(x)])
    cost = read(world, x * y, 2)
    places = (cost.places[0], cost.places[1]._replace(knot=3))
    across = Additions(at_knots=(replace(cost, places=places),), times=np.linspace(0, T, N + 1))
    with pytest.raises(ProgramError, match="variables of knots 2, 3, expected those of one knot"):
        AddedTerms.of(world, across)
    timed = pose_room(add(world, ((x**2, 3),)), phases=Phases.free(T, (T, T)))
    with pytest.raises(ProgramError, match=r"function of the knot at 0\.375 s"):
        timed.simulate(np.zeros((N, 2)), 1)
