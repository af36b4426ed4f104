"""Models of bodies that float, and of what pushes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from drake_aigto import Scenario, World
from drake_aigto.world import SpaceWorld

MATERIAL = """<drake:proximity_properties>
  <drake:point_contact_stiffness>2000</drake:point_contact_stiffness>
  <drake:hunt_crossley_dissipation>2</drake:hunt_crossley_dissipation>
  <drake:mu_dynamic>0.5</drake:mu_dynamic>
  <drake:mu_static>0.5</drake:mu_static>
</drake:proximity_properties>"""
SPHERE = "<sphere><radius>0.05</radius></sphere>"
BOX = "<box><size>0.1 0.1 0.1</size></box>"
GROUND = "<plane><normal>0 0 1</normal></plane>"


def collision(name: str, geometry: str, pose: str = "0 0 0 0 0 0") -> str:
    return (
        f'<collision name="{name}"><pose>{pose}</pose><geometry>{geometry}</geometry>'
        f"{MATERIAL}</collision>"
    )


def link(name: str, mass: float, shapes: str) -> str:
    I = 0.4 * mass * 0.05**2  # noqa: E741
    return (
        f'<link name="{name}"><inertial><mass>{mass}</mass><inertia><ixx>{I}</ixx><iyy>{I}</iyy>'
        f"<izz>{I}</izz></inertia></inertial>{shapes}</link>"
    )


def slider(name: str, parent: str, child: str, axis: str) -> str:
    return (
        f'<joint name="{name}" type="prismatic"><parent>{parent}</parent><child>{child}</child>'
        f"<axis><xyz>{axis}</xyz><dynamics><damping>0.2</damping></dynamics></axis></joint>"
    )


def ball_and_finger(shapes: str = collision("ball", SPHERE), more: str = "") -> str:
    """Returns a body that floats, with these shapes, a ball on three sliders, and a ground."""
    links = link("thing", 0.3, shapes) + link("finger", 0.1, collision("tip", SPHERE))
    links += link("along", 0.01, "") + link("across", 0.01, "")
    joints = slider("x", "world", "along", "1 0 0") + slider("y", "along", "across", "0 1 0")
    joints += slider("z", "across", "finger", "0 0 1")
    floor = f'<link name="ground">{collision("floor", GROUND)}</link>'
    ground = f'<model name="ground"><static>true</static>{floor}</model>'
    return (
        '<sdf version="1.9" xmlns:drake="drake.mit.edu"><world name="w">'
        f'<model name="m">{links}{joints}{more}</model>{ground}</world></sdf>'
    )


def make_scenario(folder: Path, text: str | None = None, **changes: Any) -> Scenario:
    """Returns a scenario of a model in a folder: the finger pushes the ball along x."""
    path = folder / "model.sdf"
    path.write_text(ball_and_finger() if text is None else text, encoding="utf-8")
    fields: dict[str, Any] = {
        "model": str(path),
        "initial_position": {"thing": {"xyz": [0, 0, 0.0493]}, "x": -0.15, "z": 0.07},
        "initial_velocity": [0.0] * 9,
        "goal_position": {"thing": {"xyz": [0.3, 0, 0.05]}},
        "contact": "compliant",
        "stiction_speed": 0.05,
        "duration": 1.0,
        "time_step": 0.02,
        "goal_weight": {"thing": {"xyz": 10.0}},
    }
    return Scenario(**(fields | changes))


def build(scenario: Scenario) -> tuple[SpaceWorld, Scenario]:
    world = World.from_scenario(scenario)
    assert isinstance(world, SpaceWorld)
    return world, world.place(scenario)
