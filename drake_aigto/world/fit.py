"""Why a scenario does not fit a world, each with one clear error."""

from __future__ import annotations

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from drake_aigto.arrays import Floats
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.world.contact import SphereAndFace
from drake_aigto.world.scenario import Scenario


def check_made_for(
    scenario: Scenario,
    mass: float | None,
    ignored_shapes: tuple[str, ...],
    dry_friction: Floats | None,
    stiction_speed: float,
) -> None:
    """Refuses a scenario with another mass or friction, or other ignored shapes, than a world's.

    Raises:
        ScenarioError: it is another one.
    """
    remedy = "The world was made with that; make it of this scenario."
    if scenario.mass is not None and scenario.mass != mass:
        raise ScenarioError(
            "mass",
            got=f"{scenario.mass:g} kg",
            expected="None, the model's" if mass is None else f"{mass:g} kg",
            remedy=remedy,
        )
    if scenario.ignored_shapes and set(scenario.ignored_shapes) != set(ignored_shapes):
        raise ScenarioError(
            "ignored_shapes",
            got=", ".join(scenario.ignored_shapes),
            expected=", ".join(ignored_shapes) or "none",
            remedy=remedy,
        )
    if scenario.dry_friction is not None and not np.array_equal(
        scenario.dry_friction, 0.0 if dry_friction is None else dry_friction
    ):
        raise ScenarioError(
            "dry_friction",
            got=scenario.dry_friction.tolist(),
            expected="none" if dry_friction is None else dry_friction.tolist(),
            remedy=remedy,
        )
    if scenario.stiction_speed != stiction_speed:
        raise ScenarioError(
            "stiction_speed",
            got=f"{scenario.stiction_speed:g} m/s",
            expected=f"{stiction_speed:g} m/s",
            remedy=remedy,
        )


def refuse_inside(
    name: str, face: SphereAndFace, distance: float, num_faces: int, plant: MultibodyPlant
) -> ScenarioError:
    """Returns the error of a position inside or against a solid."""
    faced = np.round(plant.GetDefaultPositions(), 6).tolist()
    remedy = (
        f"The wall is the face that the sphere faces at q = {faced}; start and goal must both be "
        "in front of it."
    )
    return ScenarioError(
        f"{name} is inside, behind or against the wall ({face.pair})",
        got=f"a signed distance of {distance:g} m",
        expected="more than 0 m",
        remedy=remedy if num_faces == 1 else "Start and goal must both be outside.",
    )


def refuse_out_of_reach(face: SphereAndFace, distance: float) -> ModelError:
    """Returns the error of a wall that stays at least so far from all that could touch it."""
    return ModelError(
        f"a wall is out of reach ({face.pair})",
        got=f"at least {distance:.3g} m between them, wherever joints go within their limits",
        expected="a wall that a sphere can touch",
        remedy="Move the wall, widen the joints' limits, or leave the shape out by the scenario's "
        "ignored_shapes.",
    )


def refuse_beside(name: str, face: SphereAndFace, off: Floats) -> ScenarioError:
    """Returns the error of a position off the edges of the only face of a wall."""
    return ScenarioError(
        f"{name} is beside the face of the wall ({face.pair})",
        got=f"the sphere's center {np.round(off, 6).tolist()} m off the face's middle",
        expected=f"within {face.half_extents.tolist()} m",
        remedy="Widen the wall, or use a half space.",
    )


def check_sizes(plant: MultibodyPlant, scenario: Scenario) -> None:
    """Refuses vectors whose length is not the plant's."""
    for name, size in (
        ("initial_position", plant.num_positions()),
        ("initial_velocity", plant.num_velocities()),
        ("goal_position", plant.num_positions()),
    ):
        check_size(name, len(getattr(scenario, name)), size)


def check_size(name: str, got: int, size: int) -> None:
    """Refuses a number of values that is not the plant's number of coordinates."""
    if got != size:
        raise ScenarioError(
            name,
            got=f"{got} value{'s' if got > 1 else ''}",
            expected=f"{size}, one for each coordinate of the model",
        )
