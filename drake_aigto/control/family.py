"""What may differ from a model, and the models with any of it."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.control.loop_run import Disturbance
from drake_aigto.control.model import Model
from drake_aigto.world import Scenario, World

Unknown: TypeAlias = Literal["mass", "friction", "stiffness", "walls", "force"]

# Scenarios with other friction that are kept at most: about p there are three.
_MOST_KEPT = 6


class Parameter(NamedTuple):
    """A number that is not known."""

    name: str
    kind: Unknown
    which: int  # of the contact whose wall it is, or of the coordinate of a force
    usual: float  # of the model
    unit: float  # its standard deviation before anything is seen
    lower: float
    upper: float


class ModelFamily:
    """Models that differ from one in parameters p.

    M, h and φ, dry friction and stiffness are affine in these, and so are the tables that
    simulations take. So only a world with each parameter one above the model's is read, once
    (`World.blend`). Diagrams are the model's, whatever p is.
    """

    def __init__(self, model: Model, parameters: Sequence[Parameter]) -> None:
        """Reads these worlds."""
        self._model, self._parameters = model, tuple(parameters)
        self._above = [self._find_above(each) for each in parameters]
        self._rubbed = dict[float, Scenario]()  # With that much friction.

    def _find_above(self, parameter: Parameter) -> World:
        """Returns the world with one more of a parameter: a factor of 2, 1 m, or 1 N."""
        world, one = self._model.world, np.eye(1, self._model.world.num_velocities, parameter.which)
        if parameter.kind == "mass":
            return world.with_double_masses()
        if parameter.kind == "walls":
            walls = [wall for _, wall in world.shapes]
            return world.with_walls_nearer(
                np.array([float(wall == walls[parameter.which]) for wall in walls])
            )
        if parameter.kind == "friction" and world.dry_friction is not None:
            return world.changed(dry_friction=2.0 * world.dry_friction)
        if parameter.kind == "force":
            with np.errstate(invalid="ignore"):  # As Drake's arithmetic on Expressions has NaN.
                return world.changed(bias=world.bias - one[0])
        return world

    def find(self, values: Floats) -> Model:
        """Returns the model with parameters p, shape (P,)."""
        world, scenario = self._model.world, self._model.scenario
        off = [value - each.usual for each, value in zip(self._parameters, values, strict=True)]
        if not any(off):
            return self._model
        found = world.blend(*zip(self._above, off, strict=True))
        for each, value in zip(self._parameters, values.tolist(), strict=True):
            if each.kind == "stiffness":
                springs = world.springs
                stiffer = springs._replace(stiffness=value * springs.stiffness)
                vars(found)["springs"] = stiffer
            elif each.kind == "friction":
                rubbing = copy.copy(found.rubbing)
                vars(rubbing).pop("frictions", None)
                vars(rubbing)["model_coefficients"] = value * world.rubbing.model_coefficients
                vars(found)["rubbing"] = rubbing
                if value not in self._rubbed:
                    if len(self._rubbed) >= _MOST_KEPT:
                        del self._rubbed[next(iter(self._rubbed))]
                    changes = Disturbance(friction_factor=value).change_friction(world, scenario)
                    if found.dry_friction is not None:  # To the bit, as worlds check it.
                        changes["dry_friction"] = found.dry_friction
                    self._rubbed[value] = dataclasses.replace(scenario, **changes)
                scenario = self._rubbed[value]
        return Model(found, scenario)
