"""Reading a scenario's model in a plane or in space, and checking what a world is made for."""

from __future__ import annotations

import dataclasses
from pkgutil import resolve_name
from typing import Any

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.world.diagram import find_plant
from drake_aigto.world.limits import Limits, check_sizes
from drake_aigto.world.model_facts import FixableError, find_errors, gather
from drake_aigto.world.model_reader import read_model
from drake_aigto.world.placing import place_scenario
from drake_aigto.world.plant_world import PlantWorld
from drake_aigto.world.scenario import Scenario

# Its module imports this one.
_IN_SPACE = "drake_aigto.world.space:SpaceWorld"
# Coordinates of compliant mechanisms that are read as sums; recursions are faster for more.
_MOST_SUMMED = 5


def read_world(kind: type[Any], scenario: Scenario, start: Floats | None) -> Any:
    """Reads a scenario's model and nothing of its task.

    Args:
        kind: the class `World`, in a plane if that can be, or `SpaceWorld`, in space at once.
        scenario: the model, and how it is read.
        start: its positions; None: default positions.

    Raises:
        ModelError: the model can't be found, parsed, or planned for.
        ScenarioError: a field of the scenario does not fit the model.
    """
    may_leave_plane = not kind.in_space and scenario.contact == "compliant"
    try:
        world = _read(kind, scenario, start)
        if may_leave_plane:
            # What is refused here, a world in space may have.
            world.friction_coefficients(scenario)
            _ = world.springs
            if world.num_velocities > _MOST_SUMMED:
                raise ModelError("the model has too many joints for sums of products")
    except ModelError as error:
        if may_leave_plane:
            return read_world(resolve_name(_IN_SPACE), scenario, start)
        if not isinstance(error, FixableError):
            raise
        raise gather(lambda asked: _find_errors(kind, asked), scenario, error) from error
    return world


def _read(kind: type[Any], scenario: Scenario, start: Floats | None) -> Any:
    """Reads a model, and stops at the first thing that is wrong with it."""
    friction = scenario.dry_friction, scenario.stiction_speed
    asked = scenario.model, *friction, scenario.model_fields
    of_space = [name for name in ("thrusters", "frame_goals") if getattr(scenario, name)]
    if of_space and not kind.in_space:
        remedy = "Ask for contact: compliant (--contact compliant)."
        expected = "none, but of models that are read in space"
        raise ModelError(of_space[0], "them, in a plane", expected, remedy)
    found = read_model(*asked, is_bare=True, in_space=kind.in_space)
    if found.is_bare:
        if errors := kind.find_plant_errors(scenario, found.diagram):
            raise errors[0]
        found = read_model(*asked, in_space=kind.in_space)
    plant, _ = find_plant(found.diagram)
    if start is not None:
        scenario = place_scenario(plant, scenario)
        check_sizes(plant, scenario)
        plant.SetDefaultPositions(scenario.initial_position)
    friction = found.dry_friction, scenario.stiction_speed
    given = scenario.mass, scenario.ignored_shapes, *friction, scenario.limits
    world = kind.from_diagram(found.diagram, *given)
    thrusts = world.num_actuators - plant.num_actuated_dofs()
    return dataclasses.replace(
        world,
        model=scenario.model,
        model_fields=scenario.model_fields,
        limits=Limits.of(plant, found.efforts, scenario.limits, thrusts),
        ignored=found.ignored,
        notes=(*found.notes, *world.notes),
    )


def _find_errors(kind: type[Any], scenario: Scenario) -> list[ModelError]:
    """Returns what is refused of a model at once, whatever its start is."""
    found = list[ModelError]()

    def check() -> None:
        fields = scenario.model_fields
        model = read_model(scenario.model, fields=fields, is_bare=True, in_space=kind.in_space)
        found.extend(kind.find_plant_errors(scenario, model.diagram))

    return [*find_errors(check), *found]


def check_made_for(world: PlantWorld, scenario: Scenario) -> None:
    """Refuses a scenario with another mass or friction, or other ignored shapes, than a world's.

    Raises:
        ScenarioError: says which field.
    """
    given, mine = scenario.dry_friction, world.dry_friction
    each = (scenario.mass, world.mass)
    masses = ["None, the model's" if mass is None else f"{mass:g} kg" for mass in each]
    shapes = [", ".join(names) for names in (scenario.ignored_shapes, world.ignored_shapes)]
    speeds = [f"{side.stiction_speed:g} m/s" for side in (scenario, world)]
    frictions = ["none" if side is None else side.tolist() for side in (given, mine)]
    is_other_shape = set(scenario.ignored_shapes) != set(world.ignored_shapes)
    own = 0.0 if mine is None else mine
    for name, is_other, (got, expected) in (
        ("mass", scenario.mass not in (None, world.mass), masses),
        ("ignored_shapes", scenario.ignored_shapes and is_other_shape, shapes),
        ("dry_friction", given is not None and not np.array_equal(given, own), frictions),
        ("stiction_speed", scenario.stiction_speed != world.stiction_speed, speeds),
        *(
            (key, value != own_value, (value, f"{own_value}, as the world has it"))
            for key, own_value in vars(world.model_fields).items()
            for value in [getattr(scenario, key)]
        ),
    ):
        if is_other:
            remedy = f"Give the scenario the world's {name}, or make the world with this one: "
            remedy += "World.from_scenario(scenario), or from_diagram with the same arguments."
            raise ScenarioError(name, got, expected or "none", remedy)
