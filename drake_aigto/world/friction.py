"""Friction that is smooth about zero speed, as that of Drake's point contact is."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pydrake.multibody.plant import MultibodyPlantConfig
from pydrake.symbolic import Expression, MakeVectorVariable
from pydrake.symbolic import abs as size
from pydrake.symbolic import max as largest
from pydrake.symbolic import min as least
from pydrake.systems.primitives import SymbolicVectorSystem

from drake_aigto.arrays import Floats
from drake_aigto.errors import ModelError

if TYPE_CHECKING:
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.systems.framework import Diagram, DiagramBuilder

# What Drake's plant has unless told otherwise. Of a plant it can be set, but not asked for.
STICTION_SPEED: float = MultibodyPlantConfig().stiction_tolerance  # [m/s, rad/s]


def calc_friction_share(speeds: Floats, stiction_speed: float) -> Floats:
    """Returns σ(s / v_s), the part of the largest friction that acts against a sliding speed s.

        σ(x) = x³ (10 − 15 |x| + 6 x²)    for |x| ≤ 1,    sign(x)    elsewhere

    That is the regularization of Drake's point contact, whose first two derivatives are continuous.
    What sticks creeps, slower than v_s.

    Args:
        speeds: s [m/s, rad/s].
        stiction_speed: v_s > 0 [m/s, rad/s].
    """
    x = np.clip(speeds / stiction_speed, -1.0, 1.0)
    return np.asarray(x**3 * (10.0 - 15.0 * np.abs(x) + 6.0 * x**2), dtype=np.float64)


def add_dry_friction(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    dry_friction: Floats,
    stiction_speed: float = STICTION_SPEED,
) -> SymbolicVectorSystem:
    """Adds −F σ(v / v_s) to the forces on a plant's joints, and returns the system that does.

    Args:
        builder: of the plant's diagram.
        plant: finalized, with q̇ = v.
        dry_friction: F of each coordinate, shape (nv,) [N, N m].
        stiction_speed: v_s [m/s, rad/s].
    """
    n = plant.num_velocities()
    state = MakeVectorVariable(2 * n, "x")
    shares = (_express_share(v, stiction_speed) for v in state[n:])
    forces = [-F * share for F, share in zip(dry_friction, shares, strict=True)]
    # A state that stays where it is: without any, Drake 1.51 aborts when it asks for derivatives.
    still = MakeVectorVariable(1, "still")
    system = builder.AddSystem(
        SymbolicVectorSystem(
            state=still, input=state, dynamics=np.array([Expression(0.0)]), output=np.array(forces)
        )
    )
    builder.Connect(plant.get_state_output_port(), system.get_input_port())
    builder.Connect(system.get_output_port(), plant.get_applied_generalized_force_input_port())
    return system


def check_friction_acts(plant: MultibodyPlant, diagram: Diagram) -> None:
    """Refuses a diagram in which nothing makes dry friction act on its plant."""
    context = plant.GetMyContextFromRoot(diagram.CreateDefaultContext())
    if not plant.get_applied_generalized_force_input_port().HasValue(context):
        raise ModelError(
            "dry_friction",
            got="a diagram in which nothing applies forces to the plant's joints",
            expected="a system that does",
            remedy="Make it with add_dry_friction(builder, plant, dry_friction).",
        )


def _express_share(speed: Expression, stiction_speed: float) -> Expression:
    """Returns σ as an expression."""
    x = largest(-1.0, least(1.0, speed / stiction_speed))
    return x**3 * (10.0 - 15.0 * size(x) + 6.0 * x**2)
