"""Published cart-poles between soft walls as models and tasks (`benchmarks.cart_poles`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.controllers import LinearQuadraticRegulator
from pydrake.systems.framework import DiagramBuilder

from drake_aigto import Scenario, World

STEPS = 25  # of a horizon
_RADIUS = 0.02  # of the tip [m]
_HEAVY = 1e7  # a wall that moves as it is told [kg]
_THICK = 2.0  # half of that [m]


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
        horizon=1.5,
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
        time_step=problem.horizon / STEPS,
        control_weight=effort,
        position_weight=weights[:2],
        velocity_weight=weights[2:],
        goal_weight=price[:2, :2],
        goal_velocity_weight=price[2:, 2:],
    )
