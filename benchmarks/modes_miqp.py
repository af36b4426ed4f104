"""Stick and slip as binaries, for SCIP, where all else is linear: what lies on floors and slides.

A world of constant M, h, B, J and T whose contacts stay closed, in N steps of a held control each,
which are exact as long as modes change at knots:

    M (v_{k+1} − v_k) = Δt (B u_k − h + Jᵀ λ_k + Tᵀ f_k),    q_{k+1} − q_k = Δt (v_k + v_{k+1})/2
    J v_k = 0,    λ_k ≥ 0,    |f_k| ≤ μ λ_k,    minimize  Δt Σ u_kᵀ R u_k

Each contact in each step has two binaries, z₊ + z₋ ≤ 1, for slip forward and backward (big M):

    −S z₋ ≤ s_k, s_{k+1} ≤ S z₊,    f ≤ −μ λ + F (1 − z₊),    f ≥ μ λ − F (1 − z₋)

SCIP's branch and bound proves how far its answer is from the best, of convex costs globally.
"""

from __future__ import annotations

import importlib
from typing import Any, NamedTuple

import numpy as np

from drake_aigto.contact import RigidLaw, contact_law
from drake_aigto.errors import MissingExtraError
from drake_aigto.world import Scenario, TaskCost, World

pyscipopt: Any
try:
    pyscipopt = importlib.import_module("pyscipopt")
except ModuleNotFoundError:
    pyscipopt = None


class Proven(NamedTuple):
    """What SCIP found, and proved.

    Attributes:
        cost: J of its best answer, infinite if there is none.
        bound: no answer costs less.
    """

    cost: float
    bound: float


def solve_modes(scenario: Scenario, seconds: float) -> Proven:
    """Returns what SCIP makes of a scenario within this time of the processor.

    Raises:
        MissingExtraError: SCIP is not installed.
        ModelError: M, h or J is not constant.
        ValueError: the task is none of a hard goal and bounded controls, which alone count.
    """
    if pyscipopt is None:
        raise MissingExtraError("the mixed-integer peer", "pyscipopt", "bench")
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
