"""Mechanisms: links on hinges and sliders, as SDF of our own, and those that are shipped."""

from __future__ import annotations

from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from drake_aigto import Scenario, World

MATERIAL = """<drake:proximity_properties><drake:mu_dynamic>0</drake:mu_dynamic>
  <drake:mu_static>0</drake:mu_static></drake:proximity_properties>"""


def link(name: str, mass: float, pose: str = "", offset: str = "0 0 0", shape: str = "") -> str:
    inertia = "<inertia><ixx>0.02</ixx><iyy>0.03</iyy><izz>0.04</izz></inertia>"
    return f"""<link name="{name}"><pose {pose}</pose>
      <inertial><pose>{offset} 0 0 0</pose><mass>{mass}</mass>{inertia}</inertial>{shape}</link>"""


def joint(kind: str, parent: str, child: str, axis: str, more: str = "", limit: str = "") -> str:
    return f"""<joint name="{child}_joint" type="{kind}"><parent>{parent}</parent>
      <child>{child}</child><axis><xyz>{axis}</xyz>{more}{limit}</axis></joint>"""


def sphere(name: str, place: str, radius: float = 0.05) -> str:
    return f"""<collision name="{name}"><pose>{place} 0 0 0</pose><geometry><sphere>
      <radius>{radius}</radius></sphere></geometry>{MATERIAL}</collision>"""


def box(name: str, place: str, size: str) -> str:
    return f"""<collision name="{name}"><pose>{place}</pose><geometry><box><size>{size}</size></box>
      </geometry>{MATERIAL}</collision>"""


def plane(name: str, place: str) -> str:
    return f"""<collision name="{name}"><pose>{place}</pose><geometry><plane>
      <normal>0 0 1</normal></plane></geometry>{MATERIAL}</collision>"""


def wall(*shapes: str) -> str:
    return f"""<link name="wall">{"".join(shapes)}</link>
      <joint name="wall_joint" type="fixed"><parent>world</parent><child>wall</child></joint>"""


PASSIVE = "<limit><effort>0</effort></limit>"
LEFT, RIGHT = "-0.6 0 0 0 1.5707963267948966 0", "0.6 0 0 0 -1.5707963267948966 0"
WORLD_AT = ">0 0 0 0 0 0"


def after(parent: str, place: str) -> str:
    return f'relative_to="{parent}">{place}'


DOUBLE_PENDULUM = (
    link("upper", 1.0, WORLD_AT, "0 0 -0.5")
    + joint("revolute", "world", "upper", "0 1 0", limit=PASSIVE)
    + link("lower", 2.0, after("upper", "0 0 -1 0 0 0"), "0 0.1 -0.7", sphere("tip", "0 0 -1"))
    + joint("revolute", "upper", "lower", "0 1 0")
)

PLANAR = """<drake:joint name="one_joint" type="planar"><drake:parent>wall</drake:parent>
  <drake:child>one</drake:child><drake:damping>0.1 0.2 0.3</drake:damping></drake:joint>"""

# name → links and joints
MECHANISMS: dict[str, str] = {
    "pendulum": link("rod", 1.3, WORLD_AT, "0 0 -0.7", sphere("tip", "0 0 -0.8"))
    + joint("revolute", "world", "rod", "0 1 0")
    + wall(plane("left", LEFT)),
    "cart-pole": link("cart", 1.0, WORLD_AT)
    + joint("prismatic", "world", "cart", "1 0 0")
    + link("pole", 0.1, after("cart", "0 0 0 0 0 0"), "0 0 -0.8", sphere("tip", "0 0 -0.8"))
    + joint("revolute", "cart", "pole", "0 -1 0", limit=PASSIVE)
    + wall(plane("left", LEFT), plane("right", RIGHT)),
    "double pendulum": DOUBLE_PENDULUM + wall(box("block", "1 0 0 0 0.3 0", "0.4 0.6 0.5")),
    "arm with a slider": link("base", 1.0, WORLD_AT, "0.3 0.02 0.01")
    + joint("revolute", "world", "base", "0 0.6 0.8")
    + link("elbow", 2.0, after("base", "0.5 0 0 0.2 0 0"), "0.2 0 0.1")
    + joint("revolute", "base", "elbow", "0 1 0")
    + link("hand", 0.5, after("elbow", "0.4 0 0 0 0 0"), "0.1 0 0", sphere("finger", "0.3 0 0"))
    + joint("prismatic", "elbow", "hand", "1 0 0")
    + wall(plane("floor", "0 0 -1 0 0 0")),
    "springs and dampers": link("rod", 1.3, WORLD_AT, "0 0 -0.7", sphere("tip", "0 0 -0.8"))
    + joint(
        "revolute",
        "world",
        "rod",
        "0 1 0",
        "<dynamics><damping>0.3</damping><spring_stiffness>4</spring_stiffness>"
        "<spring_reference>0.5</spring_reference></dynamics>",
    )
    + wall(plane("left", LEFT)),
    "paddle": link("paddle", 1.3, WORLD_AT, "0.2 0 0", box("bat", "0.3 0 0 0 0 0", "0.6 0.3 0.02"))
    + joint("revolute", "world", "paddle", "0 1 0")
    + link("carriage", 0.2, ">0.2 0 1 0 0 0")
    + joint("prismatic", "world", "carriage", "1 0 0", limit=PASSIVE)
    + link("ball", 0.3, after("carriage", "0 0 0 0 0 0"), "0 0 0", sphere("ball", "0 0 0"))
    + joint("prismatic", "carriage", "ball", "0 0 1", limit=PASSIVE),
    "two discs": link("one", 2.0, WORLD_AT, "0 0 0", sphere("a", "0 0 0", 0.3))
    + PLANAR
    + link("rail", 0.4, ">1 0 0 0 0 0")
    + joint("prismatic", "world", "rail", "1 0 0")
    + link("two", 1.0, after("rail", "0 0 0 0 0 0"), "0 0 0", sphere("b", "0.1 0 0", 0.2))
    + joint("prismatic", "rail", "two", "0 1 0")
    + wall(),
}


# Shipped models, and where they start.
ROBOTS: dict[str, list[float]] = {
    "cart_pole": [0.0, 0.0],
    "cart_pole_soft_06": [0.0, 0.0],
    "cart_pole_soft_10": [0.0, 0.0],
    "cart_pole_rigid_06": [0.0, 0.0],
    "cart_pole_rigid_10": [0.0, 0.0],
    "pendulum": [0.0],
    "acrobot": [0.0, 0.0],
    "acrobot_and_wall": [0.0, 0.0],
    "paddle": [0.0, 0.0, 0.1, 1.0],
    "three_carts": [-3.0, 0.0, 3.0],
    "throwing_ball": [0.0, 0.5],
    "two_discs": [-1.0, 0.0, 1.0, 0.0],
}


def build(name: str) -> World:
    if name in ROBOTS:
        return World.from_scenario(ask_robot(name))
    return build_world(MECHANISMS[name])


def ask_robot(name: str) -> Scenario:
    start = ROBOTS[name]
    return Scenario(
        model=f"package://drake_aigto_models/{name}.sdf",
        initial_position=start,
        initial_velocity=[0.0] * len(start),
        goal_position=start,
        goal_weight=[1.0] * len(start),
        control_weight=[1.0, 1.0] if name == "paddle" else 1.0,  # A force and a torque.
    )


def build_world(parts: str) -> World:
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    model = f"""<?xml version="1.0"?><sdf version="1.9" xmlns:drake="drake.mit.edu">
      <model name="mechanism">{parts}</model></sdf>"""
    Parser(plant).AddModelsFromString(model, "sdf")
    plant.Finalize()
    return World.from_diagram(builder.Build())


def build_stiff(name: str, stiffness: float) -> World:
    """Returns a mechanism of `MECHANISMS` whose contacts have this stiffness [N/m]."""
    return build_world(stiffen(MECHANISMS[name], stiffness))


def stiffen(parts: str, stiffness: float) -> str:
    """Returns links and joints whose contacts have this stiffness [N/m], and dissipate nothing."""
    given = f"""<drake:point_contact_stiffness>{2 * stiffness}</drake:point_contact_stiffness>
      <drake:hunt_crossley_dissipation>0</drake:hunt_crossley_dissipation>"""
    return parts.replace(MATERIAL, MATERIAL.replace("\n", given, 1))


def drop_ball() -> World:
    return build_world(
        link("ball", 2.0, ">0 0 0.5 0 0 0", shape=sphere("ball", "0 0 0"))
        + joint("prismatic", "world", "ball", "0 0 1")
        + wall(plane("floor", "0 0 0 0 0 0"))
    )
