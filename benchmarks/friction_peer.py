"""What others find where walls have friction: IPOPT from many starts, and SCIP with binaries.

*IPOPT* (`FrictionProgram`, through CasADi) is for compliant walls. Knots are k = 0, …, N at k Δt
and one beyond. The equations of any world, in CasADi's symbols, hold at knots, with accelerations
(q_{k+1} − 2 q_k + q_{k−1})/Δt², velocities (q_{k+1} − q_{k−1})/2Δt and q_{−1} = q_1 − 2 Δt q̇_0;
costs are by the trapezoid rule: second order throughout. What is relaxed is contact,

    max(0, y) as (y + √(y² + ε²))/2    of depths and of 1 − d φ̇,    friction σ(s / w) with w ≥ v_s

and tightened, each program from the optimum of the one before, in one of two ladders in turn.
Starts are random paths about the line from start to goal, without forces. The best motion of all,
which its own steps follow only nearly, is polished as ours are, and simulated.

*SCIP* (`solve_modes`) is for rigid walls whose contacts stay closed, with constant M, h, B, J and
T, where only stick and slip are not linear. Controls are held in N steps, which are exact as long
as modes change at knots:

    M (v_{k+1} − v_k) = Δt (B u_k − h + Jᵀ λ_k + Tᵀ f_k),    q_{k+1} − q_k = Δt (v_k + v_{k+1})/2
    J v_k = 0,    λ_k ≥ 0,    |f_k| ≤ μ λ_k,    minimize  Δt Σ u_kᵀ R u_k

Each contact in each step has two binaries, z₊ + z₋ ≤ 1, for slip forward and backward (big M):

    −S z₋ ≤ s_k, s_{k+1} ≤ S z₊,    f ≤ −μ λ + F (1 − z₊),    f ≥ μ λ − F (1 − z₋)

Branch and bound proves how far its answer is from the best, of convex costs globally.
"""

from __future__ import annotations

import importlib
import itertools
from functools import cached_property
from operator import itemgetter
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from benchmarks.local_peers import COLD, WARM, casadi, prepare
from benchmarks.script import within
from drake_aigto.arrays import Floats
from drake_aigto.contact import CompliantLaw, RigidLaw, contact_law
from drake_aigto.dynamics import SumMap
from drake_aigto.errors import MissingExtraError, TrajectoryError
from drake_aigto.planning import MechanismTask, Origin, PlanOptions, find_tight
from drake_aigto.simulation import state_scales
from drake_aigto.terms import FunctionKind
from drake_aigto.world import Scenario, TaskCost, World

# ε [m] and of 1 − d φ̇ [1], and w [m/s] at least.
_LADDERS = (
    ((1e-1, 1.0), (1e-2, 0.1), (1e-3, 0.0)),
    ((1e-1, 1.0), (3e-2, 0.3), (1e-2, 0.1), (3e-3, 0.03), (1e-3, 0.0)),
)
Ladder: TypeAlias = tuple[tuple[float, float], ...]
_MOST_FORCE = 1e3  # [N], [N m]: a bound that none comes near
_FARTHEST = 40.0  # [m], [rad]: likewise
_LEAST_STEPS = 120  # With 60, costs of replays are off by more than 1 % in every third optimum.


def write_sums(sums: SumMap, x: Any) -> Any:
    """Returns sums of products in CasADi's symbols."""
    factors, waves, members, coefficients = sums.tables
    values = []
    for (variable, exponent, kind), (scale, offset) in zip(factors.tolist(), waves, strict=True):
        power, angle = x[variable] ** exponent, scale * x[variable] + offset
        wave = {FunctionKind.COSINE: casadi.cos, FunctionKind.SINE: casadi.sin}.get(kind)
        values.append(power if wave is None else power * wave(angle))
    products = casadi.SX.ones(len(members), 1)
    for k, row in enumerate(members):
        for i in row[row < len(values)].tolist():
            products[k] *= values[i]
    return casadi.DM(coefficients) @ products


class Motion(NamedTuple):
    """What IPOPT found."""

    cost: float  # J, as it promises
    states: Floats  # q and v at the knots, shape (N + 1, 2n)
    controls: Floats  # between them, shape (N, nu)


class FrictionProgram:
    """Positions at knots 0, …, N + 1, forces at 0, …, N, between compliant walls with friction."""

    def __init__(self, world: World, scenario: Scenario) -> None:
        """Reads one question.

        Raises:
            ValueError: walls are rigid, or the task has what is not written here.
        """
        prepare()
        law, task = contact_law(world, scenario), TaskCost.of(world, scenario)
        is_weighed = (task.Q > 0) | task.QT.any(axis=0)
        is_turn = (task.is_modulo | task.is_chordal) & is_weighed
        is_other = scenario.hard_goal or is_turn.any()
        if not isinstance(law, CompliantLaw) or is_other or world.dry_friction is not None:
            raise ValueError(f"{scenario.model} asks for more than compliant walls with friction")
        self._world, self._scenario, self._law, self._task = world, scenario, law, task
        self.num_steps = scenario.num_steps * -(-_LEAST_STEPS // scenario.num_steps)

    def prepare(self) -> None:
        """Makes IPOPT for it, before time counts."""
        _ = self._solvers

    @cached_property
    def _solvers(self) -> list[Any]:
        """IPOPT for cold starts, and for warm ones."""
        n, nu, N = self._world.num_positions, self._world.num_actuators, self.num_steps
        q, u = casadi.SX.sym("q", n, N + 2), casadi.SX.sym("u", nu, N + 1)
        relaxation = casadi.SX.sym("relaxation", 2)
        cost, rows = self._write(q, u, relaxation)
        program = {"x": casadi.veccat(q, u), "p": relaxation, "f": cost, "g": rows}
        return [
            casadi.nlpsol(name, "ipopt", program, options)
            for name, options in (("cold", COLD), ("warm", WARM))
        ]

    def _write(self, q: Any, u: Any, relaxation: Any) -> tuple[Any, Any]:
        """Returns J and the rows that are zero."""
        h, task, N = self._scenario.duration / self.num_steps, self._task, self.num_steps
        start = casadi.DM(self._scenario.initial_velocity)
        before = casadi.horzcat(q[:, 1] - 2 * h * start, q[:, :-2])
        v, rate = (q[:, 1:] - before) / (2 * h), (q[:, 1:] - 2 * q[:, :-1] + before) / h**2
        about_q, about_v = task.reference(h * np.arange(N + 1))
        rows, total = [], 0.0
        for k in range(N + 1):
            rows.append(self.balance(q[:, k], v[:, k], u[:, k], rate[:, k], relaxation))
            squares = casadi.dot(task.Q, (q[:, k] - about_q[k]) ** 2)
            squares += casadi.dot(task.Qv, (v[:, k] - about_v[k]) ** 2)
            squares += casadi.dot(task.R, u[:, k] ** 2)
            total += h * squares * (0.5 if k in (0, N) else 1.0)
        off, error = q[:, N] - task.goal, v[:, N] - task.goal_velocity
        total += casadi.bilin(casadi.DM(task.QT), off) + casadi.bilin(casadi.DM(task.QTv), error)
        return total, casadi.veccat(*rows)

    def balance(self, q: Any, v: Any, u: Any, rate: Any, relaxation: Any) -> Any:
        """Returns M v̇ + h − B u − Jᵀ f + Tᵀ μ f σ at a knot."""
        world, law = self._world, self._law
        n, m, eps = world.num_positions, world.num_contacts, relaxation[0]
        entries = [world.mass_matrix.ravel(), world.bias]
        entries.append(np.array([contact.signed_distance for contact in world.contacts]))
        entries += [contact.jacobian for contact in world.contacts]
        sums = SumMap(np.concatenate(entries), world.positions, world.velocities)
        values = write_sums(sums, casadi.vertcat(q, v))
        mass, bias, gaps, normals = casadi.vertsplit(values, np.cumsum([0, n * n, n, m, m * n]))
        tangents = write_sums(world.rubbing.tangent_map, q)
        row = casadi.reshape(mass, n, n) @ rate + bias - casadi.DM(world.actuation) @ u
        speed = casadi.fmax(relaxation[1], world.stiction_speed)
        for i in range(m):
            J, T, R, gap, lever = normals[n * i : n * i + n], tangents[n * i : n * i + n], 0, 0, 1
            R, gap = law.reaches[i], gaps[i]
            if R > 0:
                apart = casadi.sqrt(casadi.fmax(R**2 + 2 * R * gap, 1e-6 * R**2))
                gap, lever = apart - R, R / apart
            r = law.radii[i]
            deeper = gap / 2 + (gap / R * (r + gap / 2) if R > 0 else 0)
            T -= deeper * casadi.DM(world.rubbing.spins[i])
            left = 1 - law.dissipation[i] * casadi.dot(J, v) * lever
            left = (left + casadi.sqrt(left**2 + eps**2)) / 2 if law.dissipation[i] else 1
            push = law.stiffness[i] * (casadi.sqrt(gap**2 + eps**2) - gap) / 2 * left * lever
            x = casadi.fmin(casadi.fmax(casadi.dot(T, v) * lever / speed, -1), 1)
            share = x**3 * (10 - 15 * casadi.fabs(x) + 6 * x**2)
            row += push * (law.friction[i] * share * T - J)
        return row

    def solve(self, path: Floats, ladder: Ladder) -> Motion | None:
        """Returns a local optimum, None if IPOPT finds none.

        Args:
            path: q of the guess, at knots 0, …, N + 1, shape (N + 2, n).
            ladder: of relaxations.
        """
        n, lower, upper = self._world.num_positions, *self._bounds()
        none = np.zeros((self.num_steps + 1, self._world.num_actuators))
        guess = {"x0": np.clip(np.concatenate([path.ravel(), none.ravel()]), lower, upper)}
        for number, relaxation in enumerate(ladder):
            solver = self._solvers[min(number, 1)]
            answer = solver(**guess, p=relaxation, lbx=lower, ubx=upper, lbg=0, ubg=0)
            if not solver.stats()["success"]:
                return None
            guess = {"x0": answer["x"], "lam_x0": answer["lam_x"], "lam_g0": answer["lam_g"]}
        x = np.array(answer["x"]).ravel()
        q, u = x[: -none.size].reshape(-1, n), x[-none.size :].reshape(none.shape)
        v = (q[2:] - q[:-2]) / (2 * self._scenario.duration / self.num_steps)
        v = np.vstack([self._scenario.initial_velocity, v])
        # Each control acts from half a step before its knot to half a step after it.
        return Motion(float(answer["f"]), np.hstack([q[:-1], v]), (u[:-1] + u[1:]) / 2)

    def _bounds(self) -> tuple[Floats, Floats]:
        """Returns those of all variables; the start's position is held by them."""
        bounds, n = self._world.bounds(self._scenario), self._world.num_positions
        lower, upper = (
            np.concatenate(
                [
                    np.tile(np.clip(positions, -_FARTHEST, _FARTHEST), self.num_steps + 2),
                    np.tile(np.clip(forces, -_MOST_FORCE, _MOST_FORCE), self.num_steps + 1),
                ]
            )
            for positions, forces in zip(bounds.position, bounds.control, strict=True)
        )
        lower[:n] = upper[:n] = self._scenario.initial_position
        return lower, upper

    def draw(self, rng: np.random.Generator) -> Floats:
        """Returns a random path at knots 0, …, N + 1, shape (N + 2, n)."""
        world, scenario = self._world, self._scenario
        start, goal, n = scenario.initial_position, scenario.goal_position, world.num_positions
        count = rng.integers(3, 9)
        nodes = rng.uniform(-1.0, 1.0, (count, n)) * rng.uniform(0.0, 1.0)
        nodes[0] = 0.0
        shares, grid = np.linspace(0.0, 1.0, self.num_steps + 2), np.linspace(0.0, 1.0, count)
        off = np.column_stack([np.interp(shares, grid, column) for column in nodes.T])
        line = start + shares[:, np.newaxis] * (goal - start)
        return line + off * state_scales(world, scenario)[:n]


def solve_from_many(scenario: Scenario, options: PlanOptions, seconds: float) -> float:
    """Returns what the best costs in simulation, of starts that end in time, of one at least.

    Args:
        scenario: the question.
        options: of the polish.
        seconds: of the processor, without those of the polish.
    """
    world = World.from_scenario(scenario)
    program, rng = FrictionProgram(world, scenario), np.random.default_rng(0)
    program.prepare()
    ladders = zip(within(seconds), itertools.cycle(_LADDERS), strict=False)
    motions = (program.solve(program.draw(rng), ladder) for _, ladder in ladders)
    found = [motion for motion in motions if motion is not None]
    if not found:
        return np.inf
    return finish(MechanismTask(world, scenario, options), min(found, key=itemgetter(0)))


def finish(problem: MechanismTask, motion: Motion) -> float:
    """Returns what a motion costs in simulation, polished; inf if it leaves its bounds there."""
    count = problem.scenario.num_steps
    often = len(motion.controls) // count
    states, controls = motion.states[::often], motion.controls.reshape(count, often, -1).mean(1)
    shooting = problem.shooting(count)
    start, step = problem.scenario.initial_position, problem.scenario.time_step
    closed = shooting.solve(controls, states, find_tight(problem.world, start, step))
    try:
        replay = problem.judge(Origin("IPOPT"), closed, problem.polish(closed)).replay
    except TrajectoryError:
        return np.inf
    return np.inf if replay.broken else replay.cost


pyscipopt: Any
try:
    pyscipopt = importlib.import_module("pyscipopt")
except ModuleNotFoundError:
    pyscipopt = None


class Proven(NamedTuple):
    """What SCIP found, and proved."""

    cost: float  # J of its best answer, infinite if there is none
    bound: float  # no answer costs less


def solve_modes(scenario: Scenario, seconds: float) -> Proven:
    """Returns what SCIP makes of a scenario within this time of the processor.

    Raises:
        MissingExtraError: SCIP is not installed.
        ModelError: M, h or J is not constant.
        ValueError: the task is none of a hard goal and bounded controls, which alone count.
    """
    if pyscipopt is None:
        raise MissingExtraError("the mixed-integer peer", "pyscipopt", "bench")
    with np.errstate(invalid="ignore"):  # PySCIPOpt's products multiply arrays not yet filled.
        model = _write(World.from_scenario(scenario), scenario)
    model.setParam("timing/clocktype", 1)  # CPU
    model.setParam("limits/time", seconds)
    model.optimize()
    cost = model.getPrimalbound() if model.getNSols() else np.inf
    return Proven(float(cost), float(model.getDualbound()))


def _write(world: World, scenario: Scenario) -> Any:
    """Returns the program as a model of SCIP."""
    task, law = TaskCost.of(world, scenario), contact_law(world, scenario)
    is_other = not scenario.hard_goal or task.Q.any() or task.Qv.any() or task.QTv.any()
    is_bounded = np.isfinite(world.bounds(scenario).control).all()
    if not isinstance(law, RigidLaw) or is_other or not is_bounded:
        raise ValueError(
            f"{scenario.model} asks for more than rigid walls, bounded controls and a hard goal"
        )
    world_of, n, N = world.constant_dynamics, world.num_positions, scenario.num_steps
    dt, m, mu = scenario.duration / N, world.num_contacts, law.friction
    J, T = world_of.jacobian, world.rubbing.calc_tangent_jacobian(np.zeros(n))
    low, high = world.bounds(scenario).control
    # All that acts, which contacts that stay closed answer; and how fast that makes things.
    strongest = float(np.abs(world_of.actuation) @ np.maximum(-low, high) @ np.ones(n))
    strongest += float(np.abs(world_of.bias).sum())
    gained = scenario.duration * strongest * float(np.linalg.norm(world_of.inverse_mass, 2))
    fastest = float(np.abs(scenario.initial_velocity).max()) + gained
    model = pyscipopt.Model()
    model.hideOutput()
    q = model.addMatrixVar((N + 1, n), lb=None)
    v = model.addMatrixVar((N + 1, n), lb=-fastest, ub=fastest)
    u = model.addMatrixVar((N, len(low)), lb=np.tile(low, (N, 1)), ub=np.tile(high, (N, 1)))
    f = model.addMatrixVar((N, m), lb=-strongest, ub=strongest)
    push = model.addMatrixVar((N, m), lb=0.0, ub=strongest)
    ahead, back = (model.addMatrixVar((N, m), vtype="B") for _ in range(2))
    cost = model.addVar(lb=0.0)
    ends = [(q[0], scenario.initial_position), (v[0], scenario.initial_velocity)]
    ends += [(q[N], task.goal)]
    ends += [] if scenario.goal_velocity is None else [(v[N], task.goal_velocity)]
    slips, most = v @ T.T, push * mu
    rows = [
        *(variables == values for variables, values in ends),
        q[1:] - q[:-1] == dt / 2 * (v[1:] + v[:-1]),
        (v[1:] - v[:-1]) @ world_of.mass_matrix
        == dt * (u @ world_of.actuation.T - world_of.bias + push @ J + f @ T),
        v @ J.T == np.zeros((N + 1, m)),
        *(s <= fastest * ahead for s in (slips[1:], slips[:-1])),
        *(s >= -fastest * back for s in (slips[1:], slips[:-1])),
        *(ahead + back <= 1, f <= most, f >= -most),
        f <= -most + 2 * strongest * (1 - ahead),
        f >= most - 2 * strongest * (1 - back),
    ]
    for row in rows:
        model.addMatrixCons(row)
    model.addCons(cost >= dt * (u**2 @ task.R).sum())
    model.setObjective(cost)
    return model
