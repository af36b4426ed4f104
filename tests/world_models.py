"""Variants of the shipped model, for the tests of the world."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pydrake.symbolic import Expression

from drake_aigto import Scenario, World
from drake_aigto.world import models_directory

SHIPPED = models_directory() / "point_mass_and_wall.sdf"
# Drake's recursive dynamics and ours differ by rounding only: some tens of operations.
RELATIVE = 1e-12

AXIS = "<xyz>1 0 0</xyz>"
SPRING = (
    "<dynamics><spring_stiffness>3</spring_stiffness>"
    "<spring_reference>0.4</spring_reference></dynamics>"
)
DAMPER = "<dynamics><damping>0.7</damping></dynamics>"
WALL_POSE = "<pose>-0.1 0 0 0 0 0</pose>"
BOX = "<size>0.1 0.6 0.6</size>"
BALL_SHAPE = """<sphere>
            <radius>0.05</radius>
          </sphere>"""
TETRAHEDRON = """v 0 0 0
v 0.1 0 0
v 0 0.1 0
v 0 0 0.1
f 1 3 2
f 1 2 4
f 2 3 4
f 3 1 4
"""
# The shipped wall's collision shape is deep; variants turn and shift a thin one.
THIN_WALL = {
    "<pose>-0.05 0 0 0 0 0</pose>": WALL_POSE,
    "<pose>-8 0 0 0 0 0</pose>": "",
    "<size>16 16 16</size>": BOX,
}
# The slider no longer moves the ball but a cart along y, and the ball moves on the cart along x.
CART = """<link name="cart">
      <inertial><mass>3</mass></inertial>
    </link>
    <joint name="rail" type="prismatic">
      <parent>world</parent>
      <child>cart</child>
      <axis><xyz>0.6 0.8 0</xyz><dynamics><damping>0.2</damping></dynamics></axis>
    </joint>
    <joint name="slider" type="prismatic">
      <parent>cart</parent>"""
HALF_SPACE = {
    WALL_POSE: "<pose>-0.05 0 0 0 1.5707963267948966 0</pose>",
    f"<box>\n            {BOX}\n          </box>": "<plane><normal>0 0 1</normal></plane>",
}
SLIDER = """<joint name="slider" type="prismatic">
      <parent>world</parent>"""

# name → replacements in the shipped SDF
VARIANTS: dict[str, dict[str, str]] = {
    "as shipped": {},
    "2 kg": {"<mass>1.0</mass>": "<mass>2.0</mass>"},
    "spring": {AXIS: AXIS + SPRING},
    "damper": {AXIS: AXIS + DAMPER},
    "gravity": {AXIS: "<xyz>0 0 1</xyz>", WALL_POSE: "<pose>0 0 -0.1 0 1.570796 0</pose>"},
    "slope": {
        AXIS: f"<xyz>0.8 0 0.6</xyz>{SPRING}",
        WALL_POSE: "<pose>-0.08 0 -0.06 0 -0.6435011087932844 0</pose>",
    },
    "shifted wall": {WALL_POSE: "<pose>0.15 0 0 0 0 0</pose>"},
    "turned wall": {WALL_POSE: "<pose>-0.1 0 0 0 0.4 1.5707963267948966</pose>"},
    "half space": HALF_SPACE,
    "ball off its link's origin": {
        '<collision name="ball_collision">': '<collision name="ball_collision">'
        "<pose>0.2 0.1 0 0 0 0</pose>"
    },
    "geared motor": {
        "</axis>": "</axis><drake:rotor_inertia>0.3</drake:rotor_inertia>"
        "<drake:gear_ratio>2</drake:gear_ratio>"
    },
    "cart": {SLIDER: CART, **HALF_SPACE},
}


def read_thin_walled() -> str:
    text = SHIPPED.read_text(encoding="utf-8")
    for old, new in THIN_WALL.items():
        assert old in text, f"the shipped model has no {old!r} to replace"
        text = text.replace(old, new)
    return text


class ModelWriter:
    """Writes variants of the thin-walled SDF by text replacement."""

    def __init__(self, directory: Path) -> None:
        self.path = directory / "variant.sdf"

    def __call__(self, replacements: dict[str, str]) -> str:
        text = read_thin_walled()
        for old, new in replacements.items():
            assert old in text, f"the shipped model has no {old!r} to replace"
            text = text.replace(old, new)
        self.path.write_text(text, encoding="utf-8")
        return str(self.path)


def make_scenario(model: str | None = None, size: int = 1, **fields: Any) -> Scenario:
    fields = {
        "initial_position": np.full(size, 1.0),
        "initial_velocity": np.full(size, -2.0),
        "goal_position": np.full(size, 0.73),
        **fields,
    }
    return Scenario(**fields) if model is None else Scenario(model=model, **fields)


def make_world(write_model: ModelWriter, name: str, mass: float | None = None) -> World:
    size = 2 if name == "cart" else 1
    return World.from_scenario(make_scenario(write_model(VARIANTS[name]), size, mass=mass))


def evaluate(expressions: Any, variables: Any, values: Any) -> np.ndarray:
    environment = dict(zip(variables, values, strict=True))
    return np.array([(e * Expression(1.0)).Evaluate(environment) for e in np.ravel(expressions)])


def differs_by_zero(first: Expression, second: Any) -> bool:
    return (first - second).Expand().EqualTo(Expression(0.0))
