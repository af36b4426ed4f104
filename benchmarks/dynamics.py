"""Speed of accelerations of trees of joints, and of shooting with them, beside crocoddyl's.

    python -m benchmarks.dynamics

Arms of 2, 4 and 7 hinges, and a floating body with four legs of 3 hinges each, 18 coordinates, all
on one thread; the least of some repeats [CPU µs]: of accelerations, with and without derivatives,
beside Drake's M and h by numbers; and of a knot and iteration of shooting, its line search and
backward sweep included, with a sphere at each tip that may touch the ground and without. Where
crocoddyl is installed (the extra `bench`), its FDDP solves the same task in as many
Runge-Kutta steps, without contact, and the accelerations of both are compared first. Exits with 1
if a figure is missed: `MOST` and `MOST_SHOOTING`.
"""

from __future__ import annotations

import importlib.util
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from benchmarks.script import is_met
from drake_aigto.dynamics import Tree, make_tree_memory, repeat_accelerations
from drake_aigto.planning import MechanismTask, PlanOptions
from drake_aigto.shooting import ShootingOptions, Smoothing
from drake_aigto.world import Scenario, SpaceWorld, World

MOST = {7: 4.0, 18: 12.0}  # [µs]
MOST_SHOOTING = {7: 60.0, 18: 200.0}  # With contact [µs].
_LENGTH, _RADIUS, _OVERLAP = 0.2, 0.02, 0.005  # of links, tips, and tips in the ground [m]
_COUNT, _REPEATS = 4000, 7
_KNOTS, _ITERATIONS, _SOLVES = 100, 8, 5
_WIDE = '<limit lower="-1000" upper="1000" effort="1000" velocity="1000"/>'
_SOFT = {"point_contact_stiffness": 4e3, "hunt_crossley_dissipation": 0.5} | dict.fromkeys(
    ("mu_dynamic", "mu_static"), 0.5
)
_GROUND = """<sdf version="1.8" xmlns:drake="http://drake.mit.edu"><model name="ground">
<static>true</static><link name="ground"><pose>0 0 {height} 0 0 0</pose><collision name="ground">
<geometry><plane/></geometry><drake:proximity_properties>{soft}</drake:proximity_properties>
</collision></link></model></sdf>"""
_TIP = """<collision name="tip_{name}"><origin xyz="0 0 -0.2"/><geometry><sphere radius="0.02"/>
</geometry><drake:proximity_properties>{soft}</drake:proximity_properties></collision>"""


def write_urdf(num_hinges: int, num_legs: int = 0, has_tips: bool = False) -> str:
    """Returns an arm on the link "base", or that body with legs, of this many hinges each."""
    soft = "".join(f'<drake:{name} value="{value}"/>' for name, value in _SOFT.items())
    parts = [_link("base", 9.0 if num_legs else 1.0, (0.4, 0.2, 0.1))]
    for leg in range(num_legs or 1):
        parent = "base"
        for k in range(num_hinges):
            name = f"link_{leg}_{k}"
            tip = _TIP.format(name=name, soft=soft) if has_tips and k == num_hinges - 1 else ""
            parts.append(_link(name, 1.0, (0.1, 0.08, 0.3), tip))
            axis = "0 0 1" if k % 2 == 0 else "0 1 0"
            parts.append(
                f'<joint name="j_{leg}_{k}" type="revolute"><parent link="{parent}"/>'
                f'<child link="{name}"/><origin xyz="0 0 {-0.2 if k else 0}"/>'
                f'<axis xyz="{axis}"/>{_WIDE}</joint><transmission name="t_{leg}_{k}"><type>'
                f'transmission_interface/SimpleTransmission</type><joint name="j_{leg}_{k}"/>'
                f'<actuator name="a_{leg}_{k}"/></transmission>'
            )
            parent = name
    return f'<robot name="robot" xmlns:drake="http://drake.mit.edu">{"".join(parts)}</robot>'


def _link(name: str, mass: float, size: tuple[float, float, float], more: str = "") -> str:
    x, y, z = (mass / 12 * (sum(s * s for s in size) - each**2) for each in size)
    return (
        f'<link name="{name}"><inertial><origin xyz="0 0 {0 if name == "base" else -0.1}"/>'
        f'<mass value="{mass}"/><inertia ixx="{x}" iyy="{y}" izz="{z}" ixy="0" ixz="0" iyz="0"/>'
        f"</inertial>{more}</link>"
    )


def make_world(num_hinges: int, num_legs: int, has_contact: bool) -> World:
    """Returns the robot of `write_urdf`, an arm's base welded; its tips may touch the ground."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    if has_contact:
        height = _OVERLAP - _RADIUS - _LENGTH * num_hinges
        soft = "".join(f"<drake:{name}>{value}</drake:{name}>" for name, value in _SOFT.items())
        ground = _GROUND.format(height=height, soft=soft)
        Parser(plant).AddModelsFromString(ground, "sdf")
    text = write_urdf(num_hinges, num_legs, has_contact)
    Parser(plant).AddModelsFromString(text, "urdf")
    if not num_legs:
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"), RigidTransform())
    plant.Finalize()
    return SpaceWorld.from_diagram(builder.Build())


def measure(plant: MultibodyPlant) -> tuple[float, float, float]:
    """Returns µs of v̇, of v̇ with derivatives, and of Drake's M and h."""
    tree, rng = Tree.of(plant), np.random.default_rng(0)
    memory, found = make_tree_memory(tree), []
    q = tree.add(plant.GetDefaultPositions(), rng.normal(size=tree.num_velocities))
    v, u = rng.normal(size=tree.num_velocities), rng.normal(size=plant.num_actuators())
    for has_slopes in (False, True):
        run = _timed(lambda: repeat_accelerations(_COUNT, tree, q, v, u, has_slopes, memory))  # noqa: B023
        found.append(run / _COUNT * 1e6)
    context, begin = plant.CreateDefaultContext(), time.process_time()
    for _ in range(_COUNT):
        plant.SetPositions(context, q)
        plant.CalcMassMatrix(context)
        plant.CalcBiasTerm(context)
    return found[0], found[1], (time.process_time() - begin) / _COUNT * 1e6


def _timed(work: Callable[[], Any], repeats: int = _REPEATS) -> float:
    """Returns the least CPU seconds of some repeats."""
    seconds = []
    for _ in range(repeats):
        begin = time.process_time()
        work()
        seconds.append(time.process_time() - begin)
    return min(seconds)


def time_shooting(world: World) -> float:
    """Returns µs of a knot and iteration of our shooting."""
    start = world.plant.GetDefaultPositions()
    is_floating = world.num_positions > world.num_velocities
    scenario = Scenario(
        initial_position=start if is_floating else start + 0.1,
        initial_velocity=np.zeros(world.num_velocities),
        goal_position=start if is_floating else start + 0.3,
        goal_weight=np.full(world.num_velocities, 50.0),
        goal_velocity_weight=np.full(world.num_velocities, 50.0),
        control_weight=5e-4,
        contact="compliant",
        duration=1.0,
        time_step=1.0 / _KNOTS,
    )
    task = MechanismTask(world, world.place(scenario), PlanOptions(threads=1))
    shooting = task.shooting(_KNOTS)
    rungs = (Smoothing(1e-3, _ITERATIONS, 1e-30),)
    controls = 0.01 * np.random.default_rng(0).normal(size=(_KNOTS, world.num_actuators))
    count = 0

    def solve() -> None:
        nonlocal count
        count = shooting.solve(controls, options=ShootingOptions(rungs)).iterations

    seconds = _timed(solve, _SOLVES)
    return seconds / count / _KNOTS * 1e6


def time_crocoddyl(text: str, is_floating: bool) -> float:
    """Returns the same of crocoddyl's FDDP, fully actuated but for a floating base."""
    import crocoddyl
    import pinocchio

    root = [pinocchio.JointModelFreeFlyer()] if is_floating else []
    model = pinocchio.buildModelFromXML(text, *root)
    state = crocoddyl.StateMultibody(model)
    kind = crocoddyl.ActuationModelFloatingBase if is_floating else crocoddyl.ActuationModelFull
    actuation = kind(state)
    neutral, still = pinocchio.neutral(model), np.zeros(model.nv)
    goal = np.concatenate([neutral if is_floating else neutral + 0.3, still])
    begin = np.concatenate([neutral if is_floating else neutral + 0.1, still])
    costs = [crocoddyl.CostModelSum(state, actuation.nu) for _ in range(2)]
    residuals = (
        crocoddyl.ResidualModelControl(state, actuation.nu),
        crocoddyl.ResidualModelState(state, goal, actuation.nu),
    )
    for cost, residual, weight in zip(costs, residuals, (1e-3, 100.0), strict=True):
        cost.addCost("cost", crocoddyl.CostModelResidual(state, residual), weight)
    running, last = (
        crocoddyl.DifferentialActionModelFreeFwdDynamics(state, actuation, cost) for cost in costs
    )
    stage = crocoddyl.IntegratedActionModelRK(running, crocoddyl.RKType.four, 1.0 / _KNOTS)
    end = crocoddyl.IntegratedActionModelEuler(last, 0.0)
    problem = crocoddyl.ShootingProblem(begin, [stage] * _KNOTS, end)
    problem.nthreads = 1
    generator = np.random.default_rng(0)
    controls = [0.01 * generator.normal(size=actuation.nu) for _ in range(_KNOTS)]
    states = problem.rollout(controls)
    count = 0

    def solve() -> None:
        nonlocal count
        solver = crocoddyl.SolverFDDP(problem)
        solver.th_stop = 1e-30
        solver.solve(states, controls, _ITERATIONS, False)
        count = solver.iter + 1

    seconds = _timed(solve, _SOLVES)
    return seconds / count / _KNOTS * 1e6


def compare_accelerations(world: World, text: str) -> float:
    """Returns the largest difference of our accelerations and Pinocchio's, of an arm."""
    import pinocchio

    model = pinocchio.buildModelFromXML(text)
    q, v, u = np.random.default_rng(1).normal(size=(3, model.nv))
    ours = world.calc_acceleration(q, v, u)
    return float(np.max(np.abs(ours - pinocchio.aba(model, model.createData(), q, v, u))))


def main() -> int:
    """Prints the figures, and returns 1 if one is missed."""
    met = []
    has_peer = importlib.util.find_spec("crocoddyl") is not None
    for hinges, legs in ((2, 0), (4, 0), (7, 0), (3, 4)):
        free = make_world(hinges, legs, has_contact=False)
        n = free.num_velocities
        value, slopes, drake = measure(free.plant)
        print(f"{n} coordinates: v̇ {value:.2f} µs, with derivatives {slopes:.2f} µs; ", end="")
        print(f"Drake's M and h {drake:.2f} µs")
        without = time_shooting(free)
        print(f"  a knot and iteration {without:.1f} µs", end="")
        if n in MOST:
            with_contact = time_shooting(make_world(hinges, legs, has_contact=True))
            print(f", with contact {with_contact:.1f} µs", end="")
        if has_peer:
            text = write_urdf(hinges, legs)
            peer = time_crocoddyl(text, bool(legs))
            print(f"; crocoddyl {peer:.1f} µs, ratio {without / peer:.2f}", end="")
            if not legs:
                print(f"; accelerations differ by {compare_accelerations(free, text):.0e}", end="")
        print(flush=True)
        if n in MOST:
            met.append(is_met(f"{n} coordinates, v̇ with derivatives [µs]", slopes, MOST[n]))
            name = f"{n} coordinates, a knot and iteration with contact [µs]"
            met.append(is_met(name, with_contact, MOST_SHOOTING[n]))
    if not has_peer:
        print("crocoddyl is not installed: no peer")
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
