"""Shooting: derivatives, the integrator's order, and optima that others agree with."""

from __future__ import annotations

import pickle
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from mechanisms import MECHANISMS, build
from pydrake.solvers import IpoptSolver, MathematicalProgram
from pydrake.symbolic import Formula, cos, exp, sin
from scipy.optimize import minimize
from shooting_problems import differ, expand_motion, pose
from shooting_problems import weigh as weigh_effort
from test_shooting_phases import RESTITUTION, ball
from test_shooting_phases import pose as pose_phases

from drake_aigto.contact import CompliantLaw, Mechanism, RigidLaw, evaluate_tape
from drake_aigto.errors import OptionsError, ProgramError, UnsupportedTermError
from drake_aigto.planning import MechanismTask, PlanOptions, make_mechanism_task
from drake_aigto.shooting import (
    IMPLICIT,
    AddedTerms,
    Phases,
    ShootingOptions,
    ShootingProblem,
    Smoothing,
    make_memory,
)
from drake_aigto.transcription import Addition, Additions, Place, Touch
from drake_aigto.world import Scenario, TaskCost, World

STICTION = 2  # Which of the numbers of friction the stiction speed is.
GIVE = 4  # Which of the numbers of contacts tells how far springs give.
STIFFNESS, DISSIPATION, SMOOTHING = 200.0, 0.3, 0.1
read = cache(build)


@cache
def soft(name: str, dissipation: float = DISSIPATION) -> Mechanism:
    m = read(name).num_contacts
    return Mechanism.of(read(name), CompliantLaw(np.full(m, STIFFNESS), np.full(m, dissipation)))


def weigh(goal: Any, effort: float = 0.05, **weights: Any) -> TaskCost:
    n = len(goal)
    usual = {"Q": np.full(n, 2.0), "Qv": np.full(n, 0.1), "QT": 20 * np.eye(n), "QTv": np.eye(n)}
    return weigh_effort(goal, effort, **(usual | weights))


def push(world: World, q: Any, v: Any) -> Any:
    """Returns what soft walls push with, the foremost face of each solid alone."""
    phi, rate = world.calc_signed_distance(q), world.calc_contact_jacobian(q) @ v
    force = np.zeros(world.num_contacts)
    for faces in world.solids:
        i = max(faces, key=lambda i: phi[i])
        depth = (np.hypot(phi[i], SMOOTHING) - phi[i]) / 2
        force[i] = STIFFNESS * depth * max(0.0, 1 - DISSIPATION * rate[i])
    return force


@pytest.mark.parametrize("name", MECHANISMS)
def test_the_acceleration_is_the_worlds_and_its_derivatives_are_those_of_differences(
    name: str,
) -> None:
    world, mechanism, rng = read(name), soft(name), np.random.default_rng(3)
    n, nu = world.num_positions, world.num_actuators
    for _ in range(5):
        x = rng.normal(size=2 * n + nu)
        got, slopes = mechanism.calc_acceleration(x[: 2 * n], x[2 * n :], SMOOTHING)
        q, v, u = np.split(x, [n, 2 * n])
        pushed = world.calc_contact_jacobian(q).T @ push(world, q, v)
        force = world.actuation @ u - world.calc_bias(q, v) + pushed
        expected = np.linalg.solve(world.calc_mass_matrix(q), force)
        np.testing.assert_allclose(got, expected, rtol=1e-10, atol=1e-10)
        differences = differ(
            lambda y: mechanism.calc_acceleration(y[: 2 * n], y[2 * n :], SMOOTHING)[0], x
        )
        # Rounding of 1e-16 times the values by the step, and the step squared times their bends.
        np.testing.assert_allclose(slopes, differences, rtol=1e-6, atol=1e-6 * np.abs(got).max())


def test_rigid_contacts_do_not_push() -> None:
    mechanism = Mechanism.of(read("pendulum"), RigidLaw(np.ones(1)))
    inside = np.array([-1.5, 0.0])
    assert read("pendulum").calc_signed_distance(inside[:1]) < -0.1
    rest, _ = mechanism.calc_acceleration(inside, np.zeros(1))
    pushed, _ = soft("pendulum").calc_acceleration(inside, np.zeros(1))
    alone = read("pendulum").calc_acceleration(inside[:1], inside[1:], np.zeros(1))
    np.testing.assert_allclose(rest, alone, rtol=1e-12)
    assert abs(pushed[0] - rest[0]) > 1


@pytest.mark.parametrize(("order", "substeps"), [(2, 16), (4, 2)])
def test_the_error_falls_as_the_integrators_order_says(order: int, substeps: int) -> None:
    problem = pose(soft("cart-pole"), weigh([0, np.pi]), [0, 0.5, 1, -1], N=60)
    controls = np.random.default_rng(1).normal(size=(60, 1))
    ends = [problem.simulate(controls, s * substeps, 0.3, order) for s in (1, 2, 4)]
    measures: tuple[Any, ...] = (lambda r: r.states, lambda r: np.array([r.cost]))
    for measure in measures:
        coarse, fine, finest = map(measure, ends)
        found = np.log2(np.linalg.norm(coarse - fine) / np.linalg.norm(fine - finest))
        assert order - 0.3 < found < order + 0.3


def test_implicit_steps_are_refused_where_there_is_no_tree_of_joints() -> None:
    problem = pose(soft("pendulum"), weigh([np.pi]), np.zeros(2))
    with pytest.raises(OptionsError, match=r"^order: got implicit steps in the plane, .* 2 or 4"):
        problem.simulate(np.zeros((30, 1)), 1, 0.0, IMPLICIT)


def check_stationary(problem: ShootingProblem, controls: Any, order: int) -> None:
    """Checks that no control within its bounds lowers the cost, by differences."""
    step, low, high = 1e-5, *problem.control_bounds
    cost = problem.simulate(controls, 1, 0.01, order).cost
    for k, j in np.ndindex(*controls.shape):
        change = np.zeros_like(controls)
        change[k, j] = step
        ahead, behind = (
            problem.simulate(controls + s * change, 1, 0.01, order).cost for s in (1, -1)
        )
        slope = (ahead - behind) / (2 * step)
        if controls[k, j] <= low[j] + step:
            slope = min((ahead - cost) / step, 0.0)
        elif controls[k, j] >= high[j] - step:
            slope = max((cost - behind) / step, 0.0)
        assert abs(slope) < 1e-3 * abs(cost), (k, j)


FINE = ShootingOptions(rungs=(Smoothing(0.1, 100, 1e-3), Smoothing(0.01, 200, 1e-12)))


@pytest.mark.parametrize("name", ["cart-pole", "arm with a slider"])
@pytest.mark.parametrize(("bound", "order"), [(3.0, 4), (np.inf, 2)])
def test_no_control_can_lower_the_cost_of_an_optimum(name: str, bound: float, order: int) -> None:
    mechanism = soft(name)
    n, nu = mechanism.num_positions, mechanism.num_controls
    cost = weigh(np.linspace(1.0, 2.0, n), R=np.full(nu, 0.05))
    bounds = np.outer([-bound, bound], np.ones(nu))
    problem = pose(mechanism, cost, np.full(2 * n, 0.1), control_bounds=bounds)
    result = problem.solve(np.zeros((30, nu)), options=replace(FINE, order=order))
    assert result.is_converged
    assert np.all(np.abs(result.controls) <= bound)
    check_stationary(problem, result.controls, order)


def test_a_quadratic_problem_has_the_optimum_of_its_normal_equations() -> None:
    name, N = "two discs", 6
    mechanism = Mechanism.of(read(name), RigidLaw(np.ones(1)))
    n, nu = mechanism.num_positions, mechanism.num_controls
    cost = weigh(np.arange(n) / n, R=np.full(nu, 0.1))
    problem = pose(mechanism, cost, np.linspace(-1, 1, 2 * n), N=N)

    def calc(u: Any) -> float:
        return problem.simulate(u.reshape(N, nu), 1).cost

    size, zero = N * nu, calc(np.zeros(N * nu))
    unit = np.eye(size)
    ahead, behind = (np.array([calc(s * e) for e in unit]) for s in (1, -1))
    both = np.array([[calc(e + f) for f in unit] for e in unit])
    hessian = both - ahead[:, None] - ahead + zero
    optimum = np.linalg.solve(hessian, -(ahead - behind) / 2)
    result = problem.solve(np.zeros((N, nu)), options=FINE)
    assert result.cost == pytest.approx(calc(optimum), rel=1e-9)
    np.testing.assert_allclose(result.controls.ravel(), optimum, atol=1e-5)


def test_a_gradient_solver_finds_nothing_better_near_a_swing_up() -> None:
    cost = weigh([np.pi], is_chordal=np.array([True]))
    bounds = np.array([[-4.0], [4.0]])
    problem = pose(soft("pendulum"), cost, [0.0, 0.0], control_bounds=bounds)
    result = problem.solve(np.full((30, 1), 0.1), options=FINE)

    def calc(u: Any) -> float:
        return problem.simulate(u[:, None], 1, 0.01).cost

    rival = minimize(calc, result.controls[:, 0], method="L-BFGS-B", bounds=[(-4, 4)] * 30)
    assert rival.fun > result.cost * (1 - 1e-6)


def test_a_guess_of_states_is_followed_and_its_gaps_are_closed() -> None:
    problem = pose(soft("cart-pole"), weigh([0.3, np.pi]), np.zeros(4))
    share = np.linspace(0, 1, 31)[:, None]
    guess = share * np.array([0.3, np.pi, 0, 0])
    result = problem.solve(np.zeros((30, 1)), guess, FINE)
    again = problem.simulate(result.controls, 1, FINE.rungs[-1].smoothing)
    np.testing.assert_array_equal(again.states, result.states)
    assert again.cost == result.cost < problem.simulate(np.zeros((30, 1)), 1).cost


def test_what_promises_to_cost_too_much_is_left_half_way_and_nothing_else_is() -> None:
    problem = pose(soft("cart-pole"), weigh([0.3, np.pi]), np.zeros(4))
    options = replace(FINE, rungs=FINE.rungs[-1:])
    whole = problem.solve(np.zeros((30, 1)), None, options)
    same = problem.solve(np.zeros((30, 1)), None, replace(options, most_promised=1e3 * whole.cost))
    np.testing.assert_array_equal(same.controls, whole.controls)
    left = problem.solve(np.zeros((30, 1)), None, replace(options, most_promised=whole.cost / 2))
    assert left.is_left and not (left.is_converged or same.is_left or whole.is_left)
    assert left.iterations < whole.iterations and left.cost > whole.cost
    again = problem.simulate(left.controls, 1, FINE.rungs[-1].smoothing)
    np.testing.assert_array_equal(again.states, left.states)
    assert again.cost == left.cost


def test_what_costs_too_much_after_a_wide_pass_is_left_there() -> None:
    problem, (wide, last) = pose(soft("cart-pole"), weigh([0.3, np.pi]), np.zeros(4)), FINE.rungs
    first = problem.solve(np.zeros((30, 1)), None, replace(FINE, rungs=(wide,)))
    dear, same = (
        problem.solve(np.zeros((30, 1)), None, replace(FINE, rungs=(limited, last)))
        for limited in (wide._replace(most=each * first.cost) for each in (0.99, 1.01e3))
    )
    whole = problem.solve(np.zeros((30, 1)), None, FINE)
    assert dear.is_left and not same.is_left
    assert dear.iterations <= first.iterations < same.iterations == whole.iterations
    assert same.cost == whole.cost < dear.cost


def test_tables_that_are_kept_carry_nothing_from_one_solve_to_the_next() -> None:
    bounds = np.array([[-0.2, -np.inf, -np.inf, -3.0], [0.2, np.inf, np.inf, 3.0]])
    used, fresh = (
        pose(soft("cart-pole"), weigh([0, np.pi]), np.zeros(4), state_bounds=bounds)
        for _ in range(2)
    )
    first = used.solve(np.ones((30, 1)))
    again, alone = (problem.solve(np.full((30, 1), 2.0)) for problem in (used, fresh))
    assert np.any(first.prices[1:] != 0)
    np.testing.assert_array_equal(again.controls, alone.controls)
    np.testing.assert_array_equal(again.prices, alone.prices)


def test_bounds_at_knots_and_a_hard_goal_hold() -> None:
    bounds = np.array([[-0.2, -np.inf, -np.inf, -3.0], [0.2, np.inf, np.inf, 3.0]])
    goal = np.array([0.1, 0.2, 0.0, np.nan])
    free = pose(soft("cart-pole"), weigh([0, np.pi]), np.zeros(4))
    loose = free.solve(np.ones((30, 1)))
    assert np.any(np.abs(loose.states[:, 0]) > 0.25)
    problem = pose(
        soft("cart-pole"), weigh([0, np.pi]), np.zeros(4), state_bounds=bounds, hard_goal=goal
    )
    result = problem.solve(np.ones((30, 1)))
    assert result.violation <= ShootingOptions().feasibility
    assert np.all(np.abs(result.states[1:, 0]) <= 0.2 + 1e-4)
    np.testing.assert_allclose(result.states[-1, :3], goal[:3], atol=1e-4)
    options = [ShootingOptions(most_promised=each * result.cost) for each in (0.1, 10.0)]
    dear, same = (problem.solve(np.ones((30, 1)), options=each) for each in options)
    assert dear.is_left
    assert dear.violation > ShootingOptions().feasibility
    assert dear.iterations < result.iterations
    assert same.cost == result.cost


def test_any_tolerance_leads_to_one_optimum_that_meets_rigid_walls() -> None:
    scenario = Scenario.named("cart_pole/rigid_06")
    task: Any = make_mechanism_task(World.from_scenario(scenario), scenario, PlanOptions())
    rough = ShootingOptions((Smoothing(0.0, 40, 1e-3),), penalty=1e4, multiplier_updates=24)
    near = task.shoot_phases((Touch.bounce(1.2, 1),), None, 40, rough)
    costs = []
    for tolerance in (1e-2, 1e-3, 1e-4):
        rungs = (Smoothing(0.0, 40, tolerance),)
        options = replace(rough, rungs=rungs, feasibility=1e-9)
        found = task.pose_phases(near.times, near.phases).solve(near.controls, None, options)
        assert found.violation <= 1e-9
        costs.append(found.cost)
    np.testing.assert_allclose(costs, costs[0], rtol=2e-7)


@pytest.mark.parametrize("how", ["is_modulo", "is_chordal"])
def test_a_hard_goal_is_met_at_the_nearest_turn_where_turns_do_not_count(how: str) -> None:
    goal = np.array([np.nan, 0.5, 0.0, 0.0])
    start = np.array([0.0, 4 * np.pi + 0.2, 0.0, 0.0])
    turns: dict[str, Any] = {how: np.array([False, True])}
    turning = weigh([0, 0.5], **turns)
    result = pose(soft("cart-pole"), turning, start, hard_goal=goal).solve(np.zeros((30, 1)))
    assert result.violation <= ShootingOptions().feasibility
    np.testing.assert_allclose(result.states[-1, 1:], [4 * np.pi + 0.5, 0, 0], atol=1e-4)


def test_the_norm_of_a_control_is_bounded_and_the_bound_is_used_well() -> None:
    mechanism, norm = soft("two discs"), 2.0
    nu = mechanism.num_controls
    cost = weigh([1, 1, 0, 1, 0], R=np.full(nu, 0.01))
    problem = pose(mechanism, cost, np.zeros(10), control_norm=norm)
    result = problem.solve(np.zeros((30, nu)), options=FINE)
    lengths = np.linalg.norm(result.controls, axis=1)
    assert np.all(lengths <= norm * (1 + 1e-9))
    assert np.sum(lengths > norm * (1 - 1e-6)) >= 3
    assert result.is_converged
    rng = np.random.default_rng(0)
    for _ in range(50):
        trial = result.controls + 1e-3 * rng.normal(size=result.controls.shape)
        lengths = np.linalg.norm(trial, axis=1, keepdims=True)
        trial *= np.minimum(1, norm / lengths)
        assert problem.simulate(trial, 1, 0.01).cost >= result.cost * (1 - 1e-9)


def test_a_moving_reference_is_followed() -> None:
    times = np.linspace(0, 1.5, 7)
    positions = 0.3 * np.sin(2 * times)[:, None]
    velocities = 0.6 * np.cos(2 * times)[:, None]
    cost = weigh(
        [0.0],
        1e-6,
        times=times,
        positions=positions,
        velocities=velocities,
        QT=np.zeros((1, 1)),
        QTv=np.zeros((1, 1)),
    )
    result = pose(soft("pendulum"), cost, [0.0, 0.6]).solve(np.zeros((30, 1)), options=FINE)
    expected = np.interp(result.times, times, positions[:, 0])
    np.testing.assert_allclose(result.states[:, 0], expected, atol=0.02)


def test_the_same_question_has_the_same_answer_also_of_a_pickled_mechanism() -> None:
    guess = np.random.default_rng(0).normal(size=(30, 1))
    first = pose(soft("cart-pole"), weigh([0, np.pi]), np.zeros(4)).solve(guess)
    copy = pickle.loads(pickle.dumps(soft("cart-pole")))
    assert pose(copy, weigh([0, np.pi]), np.zeros(4)).solve(guess) == first


def test_the_estimated_error_of_a_motion_falls_with_shorter_steps() -> None:
    problem = pose(soft("cart-pole"), weigh([0.8, 0.0]), np.zeros(4), N=10)
    coarse = problem.solve(np.ones((10, 1)))
    errors = [problem.estimate_error(coarse)]
    for substeps in (8, 16):
        options = ShootingOptions(substeps=substeps)
        fine = problem.solve(coarse.controls, None, options, coarse.prices)
        errors.append(problem.estimate_error(fine))
    # In units of the motion's cost, which the coarse one does not even know.
    assert errors[0] > 0.5 and errors[1] < errors[0] / 50 and errors[2] < errors[1] / 10


def test_a_motion_that_diverged_is_no_error_and_not_called_unstable() -> None:
    problem = pose(soft("cart-pole"), weigh([0.8, 0.0]), np.zeros(4), N=10)
    result = problem.simulate(np.ones((10, 1)), 1)
    far = replace(result, states=1e160 * np.ones_like(result.states))
    with pytest.raises(ProgramError, match="expected a finite one"):
        problem.linearize(far.controls, 1, states=far.states)
    assert not problem.is_unstable(far)


def test_friction_is_the_same_at_the_end_of_a_task_and_in_finer_steps_than_it_asks_for() -> None:
    scenario = Scenario.named("pushed_block/slide")
    world = World.from_scenario(scenario)
    whole = MechanismTask(world, scenario, PlanOptions()).shooting(40)
    controls = np.full((40, 1), 2.0)
    path = whole.simulate(controls, 8)
    end = replace(whole, times=whole.times[30:], start=path.states[30])
    told = replace(end, duration=scenario.duration).simulate(controls[30:], 8)
    np.testing.assert_allclose(told.states, path.states[30:], atol=1e-12)
    untold = end.simulate(controls[30:], 8)
    assert np.max(np.abs(untold.states - path.states[30:])) > 1e-6
    problem = MechanismTask(world, scenario, PlanOptions()).shooting(40)
    frictions = problem.mechanism.frictions
    ratios = problem.fit_mechanism(1).frictions[:, STICTION] / frictions[:, STICTION]
    count = int(np.ceil(np.max(ratios)))
    assert count > 1
    np.testing.assert_array_equal(
        problem.fit_mechanism(count).frictions[:, STICTION], frictions[:, STICTION]
    )
    assert np.all(problem.fit_mechanism(count - 1).frictions[:, STICTION] > frictions[:, STICTION])


def test_springs_from_afar_push_as_hard_as_springs_that_are_less_wide() -> None:
    scenario = Scenario.named("pushed_block/slide")
    world = World.from_scenario(scenario)
    problem = MechanismTask(world, scenario, PlanOptions()).shooting(40)
    own, fitted = problem.mechanism, problem.fit_mechanism(8)
    assert isinstance(own, Mechanism)
    soft = replace(own, mechanics=fitted)
    gives = fitted.contacts[:, GIVE]
    np.testing.assert_array_equal(fitted.contacts[:, :GIVE], own.contacts[:, :GIVE])
    assert np.all((gives > 0) & np.isfinite(gives)) and np.all(np.isinf(own.contacts[:, GIVE]))
    q, none = world.place(scenario).initial_position, np.zeros(world.num_actuators)
    q = q + world.calc_signed_distance(q)[0] * np.eye(3)[0]  # The pusher touches the block.
    assert abs(world.calc_signed_distance(q)[0]) < 1e-12
    state = np.concatenate([q, np.zeros(3)])

    def calc_push(mechanism: Mechanism, eps: float) -> float:
        """Returns the acceleration along the contact, less that without smoothing."""
        free, _ = mechanism.calc_acceleration(state, none)
        v, _ = mechanism.calc_acceleration(state, none, eps)
        return float(world.calc_contact_jacobian(q)[0] @ (v - free))

    g = float(gives[0])
    pushes = [calc_push(soft, times * g) for times in (0.5, 1.0, 10.0)]
    np.testing.assert_allclose(pushes, [0.5 * pushes[1], pushes[1], pushes[1]], rtol=1e-6)
    assert calc_push(own, 10 * g) > 9 * pushes[1]
    np.testing.assert_array_equal(
        soft.calc_acceleration(state, none)[0], own.calc_acceleration(state, none)[0]
    )
    _, slopes = soft.calc_acceleration(state, none, 10 * g)
    for j in range(6):
        moved = 1e-6 * np.eye(6)[j]
        ends = [soft.calc_acceleration(state + way * moved, none, 10 * g)[0] for way in (-1, 1)]
        np.testing.assert_allclose(slopes[:, j], (ends[1] - ends[0]) / 2e-6, rtol=1e-5, atol=1e-5)


N, T = 12, 1.5
FINEST = ShootingOptions(
    rungs=(Smoothing(0.01, 200, 1e-10),), multiplier_updates=30, feasibility=1e-8
)


@cache
def room() -> World:
    return World.from_scenario(Scenario.named("room/two_walls"))


def read_addition(world: World, function: Any, knot: int | None = None) -> Addition:
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
        name: tuple(read_addition(world, each) for each in these)
        for name, these in functions.items()
    }
    at_knots = tuple(read_addition(world, function, knot) for function, knot in knots)
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
    result = pose_room(added).solve(np.random.default_rng(0).normal(size=(N, 2)), None, FINEST)
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
    result = problem.solve(np.full((N, 2), 0.1), None, FINEST)
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
    program = pose_room(add(world, running=[x**2 * y + a * y - x * a**2])).make_program(FINEST)
    bare, memory = pose_room(add(world)).make_program(FINEST), make_memory(program)
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
    free = problem.solve(np.full((N, 1), -1.0), None, FINEST)
    before = free.states[6, 1] / RESTITUTION
    bound = 0.95 * before
    added = add(ball(), everywhere=[v**2 <= bound**2])
    slow = replace(problem, added=added).solve(np.full((N, 1), -1.0), None, FINEST)
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
    cost = read_addition(world, x * y, 2)
    places = (cost.places[0], cost.places[1]._replace(knot=3))
    across = Additions(at_knots=(replace(cost, places=places),), times=np.linspace(0, T, N + 1))
    with pytest.raises(ProgramError, match="variables of knots 2, 3, expected those of one knot"):
        AddedTerms.of(world, across)
    timed = pose_room(add(world, ((x**2, 3),)), phases=Phases.free(T, (T, T)))
    with pytest.raises(ProgramError, match=r"function of the knot at 0\.375 s"):
        timed.simulate(np.zeros((N, 2)), 1)
