"""Published cart-poles between soft walls, held upright for 40 s by planning again every 5 ms.

    python -m benchmarks.cart_poles [--only C3 MIQP Benders] [--count 100] [--seconds 40]

Plants, walls, bounds and weights are those of the published examples:

- C3: Aydinoglu, Wei, Huang, Posa, T-RO 2024 (arXiv 2304.11259), `cartpole_softwalls`; 100 Hz.
- MIQP: Marcucci and Tedrake, T-AC 2021, `cart_pole_with_walls`; 57 Hz by Gurobi, median.
- Benders: Lin, 2024 (arXiv 2406.00780), `cart_pole`; "oftentimes" 1000 Hz.

There the plant is the linear model, or PyBullet's; here it is Drake's MultibodyPlant with its own
contact, in `Simulator`. What C3 and MIQP add to the state is added here every 50 ms, to velocities;
Benders' torques on the pole are drawn every 5 ms, and its walls wander. Controllers know the still
walls only. Starts are by chance, and the states that are told have noise.

Beside `ModelPredictiveController` runs an LQR about upright, cut to the bounds, which knows of no
wall: a weak peer, and the one that needs no solver. A run counts as upright if the pole leans by
less than 45 degrees from one second after the start to the end.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.controllers import LinearQuadraticRegulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem

from drake_aigto import MechanismOptions, ModelPredictiveController, Planner, Scenario, World
from drake_aigto.control import TickStatus

PERIOD = 0.005  # [s]
_SHOVED = 0.05  # between jumps of velocities [s]
_STEPS = 25
_UPRIGHT, _SETTLED = np.pi / 4, 1.0
_RADIUS = 0.02  # of the tip [m]
_HEAVY = 1e7  # a wall that moves as it is told [kg]
_THICK = 2.0  # half of that [m]
# Of the estimate of q and v.
_NOISE = np.array([1e-4, 1e-4, 1e-3, 1e-3])
_OPTIONS = MechanismOptions(renewals=8, patience=8, search_steps=_STEPS, confirm=False)


@dataclass(frozen=True)
class CartPole:
    """A published example; q is the cart's place and the pole's angle, 0 upright.

    Attributes:
        masses: of cart and pole [kg].
        center: how far up the pole its mass is [m].
        length: how far up its tip is [m].
        gravity: g [m/s²].
        walls: where the left and the right one touch the tip [m].
        stiffness: of the walls [N/m].
        dissipation: Hunt and Crossley's [s/m].
        force: on the cart, at most [N].
        weights: of q and v, and of the force.
        start: q and v; runs begin at this or its mirror image, each number up to a fifth off.
        shove: standard deviation of what is added to v every 50 ms.
        torque: standard deviation of that on the pole [N m].
        wander: of each wall's velocity [m/s].
        horizon: that is planned over [s].
    """

    masses: tuple[float, float]
    center: float
    length: float
    gravity: float
    walls: tuple[float, float]
    stiffness: float
    dissipation: float
    force: float
    weights: tuple[tuple[float, ...], float]
    start: tuple[float, ...]
    shove: float
    torque: float = 0.0
    wander: float = 0.0
    horizon: float = 0.5


PROBLEMS = {
    "C3": CartPole(
        masses=(0.978, 0.411),
        center=0.4267,
        length=0.6,
        gravity=9.81,
        walls=(-0.35, 0.35),
        stiffness=100.0,
        dissipation=10.0,
        force=10.0,
        weights=((10.0, 2.0, 1.0, 1.0), 1.0),
        start=(0.0, -0.5, 0.5, -0.4),
        shove=0.03,
    ),
    "MIQP": CartPole(
        masses=(1.0, 1.0),
        center=1.0,
        length=1.0,
        gravity=10.0,
        walls=(-0.5, 0.5),
        stiffness=100.0,
        dissipation=0.1,
        force=1.0,
        weights=((1.0, 1.0, 1.0, 1.0), 1.0),
        start=(0.0, 0.0, 0.8, 0.0),
        shove=0.003,
        horizon=1.0,
    ),
    "Benders": CartPole(
        masses=(1.0, 0.4),
        center=0.6,
        length=0.6,
        gravity=9.81,
        walls=(-0.40, 0.35),
        stiffness=50.0,
        dissipation=0.01,
        force=20.0,
        weights=((1.0, 50.0, 1.0, 50.0), 0.1),
        start=(0.0, -0.3, 0.3, -0.3),
        shove=0.0,
        torque=8.0**0.5,
        wander=0.03,
    ),
}

_SHAPE = """
      <collision name="{name}"><pose>0 0 {z} 0 0 0</pose><geometry>{geometry}</geometry>
        <drake:proximity_properties>
          <drake:point_contact_stiffness>{stiffness}</drake:point_contact_stiffness>
          <drake:hunt_crossley_dissipation>{dissipation}</drake:hunt_crossley_dissipation>
          <drake:mu_dynamic>0</drake:mu_dynamic><drake:mu_static>0</drake:mu_static>
        </drake:proximity_properties>
      </collision>"""
_LINK = """
    <link name="{name}"><pose{of}>{x} 0 0 0 0 0</pose>
      <inertial><pose>0 0 {z} 0 0 0</pose><mass>{mass}</mass><inertia>
        <ixx>{inertia}</ixx><iyy>{inertia}</iyy><izz>{inertia}</izz></inertia></inertial>{shape}
    </link>"""
_JOINT = """
    <joint name="{name}_joint" type="{kind}"><parent>{parent}</parent><child>{name}</child>
      {axis}
    </joint>"""
_AXIS = "<axis><xyz>{xyz}</xyz><limit><effort>{effort}</effort></limit></axis>"


def write_cart_pole(problem: CartPole) -> str:
    """Returns the links of a cart-pole in SDF."""
    cart, pole = problem.masses
    sphere = f"<sphere><radius>{_RADIUS}</radius></sphere>"
    tip = _SHAPE.format(
        name="tip", z=problem.length, geometry=sphere, stiffness=2e9, dissipation=0.0
    )
    body = {"name": "cart", "of": "", "x": 0, "z": 0, "mass": cart, "inertia": 0.01, "shape": ""}
    links = _LINK.format(**body)
    links += _JOINT.format(
        name="cart",
        kind="prismatic",
        parent="world",
        axis=_AXIS.format(xyz="1 0 0", effort=problem.force),
    )
    body = {"name": "pole", "of": ' relative_to="cart"', "z": problem.center, "mass": pole}
    links += _LINK.format(**body, x=0, inertia=0, shape=tip)
    axis = _AXIS.format(xyz="0 -1 0", effort=0)
    return links + _JOINT.format(name="pole", kind="revolute", parent="cart", axis=axis)


def write_wall(problem: CartPole, side: int, moves: bool) -> str:
    """Returns the links of the left wall, 0, or the right one, 1, in SDF."""
    inward, name = 1 - 2 * side, ("left", "right")[side]
    # Drake has no contact of two half spaces, which is looked for where they move.
    face = f"<plane><normal>{inward} 0 0</normal></plane>"
    face = f"<box><size>{2 * _THICK} 4 4</size></box>" if moves else face
    # Springs in series have the published stiffness, and so do half spaces their dissipation.
    stiffness = 1 / (1 / problem.stiffness - 1 / 2e9)
    shape = _SHAPE.format(
        name=name, z=0, geometry=face, stiffness=stiffness, dissipation=problem.dissipation
    )
    x = problem.walls[side] - inward * (_RADIUS + moves * _THICK)
    link = {"name": name, "of": "", "x": x, "z": 0, "mass": _HEAVY, "inertia": 1}
    axis = _AXIS.format(xyz="1 0 0", effort=0)
    kind, axis = ("prismatic", axis) if moves else ("fixed", "")
    return _LINK.format(**link, shape=shape) + _JOINT.format(
        name=name, kind=kind, parent="world", axis=axis
    )


def add_plant(builder: DiagramBuilder, problem: CartPole, moves: bool) -> Any:
    """Returns the plant of an example; walls that move are models of their own."""
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    walls = [write_wall(problem, side, moves) for side in (0, 1)]
    models = {"cart_pole": write_cart_pole(problem) + ("" if moves else "".join(walls))}
    if moves:
        models |= {"left_wall": walls[0], "right_wall": walls[1]}
    for name, links in models.items():
        head = '<sdf version="1.9" xmlns:drake="drake.mit.edu">'
        text = f'<?xml version="1.0"?>{head}<model name="{name}">{links}</model></sdf>'
        Parser(plant).AddModelsFromString(text, "sdf")
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -problem.gravity])
    plant.Finalize()
    return plant


def make_world(problem: CartPole) -> World:
    """Returns the world that controllers know: walls stand still."""
    builder = DiagramBuilder()
    plant = add_plant(builder, problem, moves=False)
    builder.ExportInput(plant.get_actuation_input_port(), "actuation")
    return World.from_diagram(builder.Build())


def linearize(problem: CartPole) -> tuple[Any, Any]:
    """Returns A and B about upright: of a point mass on a massless pole."""
    (cart, pole), g, L = problem.masses, problem.gravity, problem.center
    A, B = np.zeros((4, 4)), np.zeros((4, 1))
    A[:2, 2:] = np.eye(2)
    A[2, 1], A[3, 1] = g * pole / cart, g * (cart + pole) / (L * cart)
    B[2:, 0] = 1 / cart, 1 / (L * cart)
    return A, B


def make_scenario(problem: CartPole) -> Scenario:
    """Returns the task of a horizon, whose end costs as much as an LQR from there on.

    That costs products of q and v, too, which are left out.
    """
    weights, effort = problem.weights
    _, price = LinearQuadraticRegulator(*linearize(problem), np.diag(weights), [[effort]])
    price = (price + price.T) / 2  # But for rounding it is symmetric.
    return Scenario(
        initial_position=np.array(problem.start[:2]),
        initial_velocity=np.zeros(2),
        goal_position=np.zeros(2),
        goal_velocity=np.zeros(2),
        contact="compliant",
        duration=problem.horizon,
        time_step=problem.horizon / _STEPS,
        control_weight=effort,
        position_weight=weights[:2],
        velocity_weight=weights[2:],
        goal_weight=price[:2, :2],
        goal_velocity_weight=price[2:, 2:],
    )


class Regulator(LeafSystem):
    """An LQR, sampled every period and cut to the bounds."""

    def __init__(self, problem: CartPole) -> None:
        """Computes the gain."""
        super().__init__()
        weights, effort = problem.weights
        self._gain, _ = LinearQuadraticRegulator(*linearize(problem), np.diag(weights), [[effort]])
        self._force = problem.force
        self._estimate = self.DeclareVectorInputPort("estimated_state", 4)
        held = self.DeclareDiscreteState(1)
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, self._sample)
        self.DeclareStateOutputPort("control", held)

    def _sample(self, context: Context, values: Any) -> None:
        u = -self._gain @ self._estimate.Eval(context)
        values.set_value(np.clip(u, -self._force, self._force))


class Noisy(LeafSystem):
    """What is told of a state: with noise, another one every period."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Draws as it is asked, in the order of time."""
        super().__init__()
        self._rng = rng
        self._state = self.DeclareVectorInputPort("state", 4)
        noise = self.DeclareDiscreteState(4)
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, self._draw)
        self._noise = noise
        self.DeclareVectorOutputPort("estimate", 4, self._write)

    def _draw(self, context: Context, values: Any) -> None:
        values.set_value(_NOISE * self._rng.normal(size=4))

    def _write(self, context: Context, output: BasicVector) -> None:
        noise = context.get_discrete_state(self._noise).value()
        output.SetFromVector(self._state.Eval(context) + noise)


@dataclass(frozen=True)
class Outcome:
    """A run.

    Attributes:
        is_upright: whether the pole stayed so.
        touches: how often the tip came to a wall.
        seconds: of wall time, of each tick after the first.
        mean: of the squared angle [rad²].
    """

    is_upright: bool
    touches: int
    seconds: tuple[float, ...]
    mean: float


def run(problem: CartPole, controller: LeafSystem, seed: int, seconds: float) -> Outcome:
    """Returns what becomes of a cart-pole from a start by chance."""
    return _Run(problem, controller, seed).advance(seconds)


class _Run:
    """A cart-pole under a controller in Drake's Simulator, shoved about."""

    def __init__(self, problem: CartPole, controller: LeafSystem, seed: int) -> None:
        self._problem, self._controller = problem, controller
        self._rng = np.random.default_rng(seed)
        self._moves = problem.wander > 0
        builder = DiagramBuilder()
        self._plant = plant = add_plant(builder, problem, self._moves)
        self._model = plant.GetModelInstanceByName("cart_pole")
        noisy = builder.AddSystem(Noisy(np.random.default_rng(seed + 1)))
        builder.AddSystem(controller)
        builder.Connect(plant.get_state_output_port(self._model), noisy.get_input_port())
        builder.Connect(noisy.get_output_port(), controller.get_input_port(0))
        u = plant.get_actuation_input_port(self._model)
        builder.Connect(controller.GetOutputPort("control"), u)
        self._simulator = Simulator(builder.Build())
        self._simulator.get_mutable_integrator().set_maximum_step_size(PERIOD)
        self._simulator.get_mutable_integrator().set_target_accuracy(1e-4)
        self._context = plant.GetMyMutableContextFromRoot(self._simulator.get_mutable_context())
        start = np.array(problem.start) * self._rng.uniform(0.8, 1.2, 4) * self._rng.choice([-1, 1])
        plant.SetPositionsAndVelocities(self._context, self._model, start)
        self._walls = np.zeros(2)

    def advance(self, seconds: float) -> Outcome:
        """Returns what became of it after so long."""
        ticks = list(self._go(seconds))
        angles = np.array([x[1] for x, _ in ticks])
        touched = np.array([clear <= 0 for _, clear in ticks])
        late = angles[int(_SETTLED / PERIOD) :]
        return Outcome(
            is_upright=bool(late.size and np.max(np.abs(late)) < _UPRIGHT),
            touches=int(np.sum(touched[1:] & ~touched[:-1])),
            seconds=tuple(self._seconds),
            mean=float(np.mean(late**2)) if late.size else np.inf,
        )

    def _go(self, seconds: float) -> Iterator[tuple[Any, float]]:
        """Yields q and v, and how far the tip is from the walls, until the pole has fallen."""
        self._seconds: list[float] = []
        for tick in range(1, round(seconds / PERIOD) + 1):
            self._disturb(tick)
            self._simulator.AdvanceTo(tick * PERIOD)
            self._note()
            x = self._plant.GetPositionsAndVelocities(self._context, self._model)
            tip = x[0] - self._problem.length * np.sin(x[1])
            left, right = self._problem.walls + self._walls
            yield x, min(tip - left, right - tip)
            if abs(x[1]) > np.pi / 2:
                break

    def _note(self) -> None:
        if isinstance(self._controller, ModelPredictiveController):
            context = self._controller.GetMyContextFromRoot(self._simulator.get_context())
            status: TickStatus = self._controller.GetOutputPort("status").Eval(context)
            if status.time > 0:
                self._seconds.append(status.seconds)

    def _disturb(self, tick: int) -> None:
        problem, plant, rng = self._problem, self._plant, self._rng
        if problem.shove and tick % round(_SHOVED / PERIOD) == 0:
            v = plant.GetVelocities(self._context, self._model)
            plant.SetVelocities(self._context, self._model, v + problem.shove * rng.normal(size=2))
        forces = np.zeros(plant.num_velocities())
        if problem.torque:
            forces[plant.GetJointByName("pole_joint").velocity_start()] = (
                problem.torque * rng.normal()
            )
        plant.get_applied_generalized_force_input_port().FixValue(self._context, forces)
        if self._moves:
            self._move_walls(problem.wander * rng.normal(size=2))

    def _move_walls(self, velocities: Any) -> None:
        """Has walls wander about where they belong."""
        plant = self._plant
        for side, name in enumerate(("left", "right")):
            joint = plant.GetJointByName(f"{name}_joint")
            self._walls[side] = joint.get_translation(self._context)
            joint.set_translation_rate(self._context, velocities[side] - self._walls[side])


def main() -> int:
    """Runs both controllers on the same disturbances, and prints a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", nargs="*", choices=[*PROBLEMS], default=[*PROBLEMS])
    parser.add_argument("--count", type=int, default=100, help="of runs of each")
    parser.add_argument("--seconds", type=float, default=40.0, help="that each lasts")
    options = parser.parse_args()
    print("plant     controller  upright   mean angle  touches a run  ms a tick, 99 %")
    for name in options.only:
        problem = PROBLEMS[name]
        planner = Planner(make_scenario(problem), _OPTIONS, make_world(problem))
        found: dict[str, list[Outcome]] = {"MPC": [], "LQR": []}
        for seed in range(options.count):
            mpc = ModelPredictiveController(planner, PERIOD, iterations=2, surprise=np.inf)
            for method, controller in (("MPC", mpc), ("LQR", Regulator(problem))):
                found[method].append(run(problem, controller, 2 * seed, options.seconds))
            print(f"{name}: {seed + 1} of {options.count}", file=sys.stderr, flush=True)
        for method, outcomes in found.items():
            print(f"{name:<8}  {report(method, outcomes)}", flush=True)
    return 0


def report(method: str, outcomes: list[Outcome]) -> str:
    """Returns a row of the table."""
    upright = sum(each.is_upright for each in outcomes)
    angle = np.rad2deg(np.sqrt(np.mean([each.mean for each in outcomes if each.is_upright] or [0])))
    touches = np.mean([each.touches for each in outcomes])
    row = f"{method:<10}  {upright:3d} of {len(outcomes):3d}  {angle:6.2f} deg  {touches:9.1f}"
    if times := [1e3 * second for each in outcomes for second in each.seconds]:
        middle, late = np.percentile(times, [50, 99])
        row += f"      {middle:6.2f} {late:6.2f}"
    return row


if __name__ == "__main__":
    sys.exit(main())
