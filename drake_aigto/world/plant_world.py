"""A plant, what was read of its model, and which bounds it has: what worlds of any kind have."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, Diagram

from drake_aigto.arrays import Floats
from drake_aigto.dynamics import EquationsOfMotion, read_damping
from drake_aigto.world.diagram import exclude_shapes, hide_half_space_warning, scale_masses
from drake_aigto.world.limits import Limits
from drake_aigto.world.model_fields import ModelFields
from drake_aigto.world.model_shapes import name_shapes, pick_shapes
from drake_aigto.world.placing import place_scenario
from drake_aigto.world.scenario import Scenario


@dataclass(frozen=True, eq=False, repr=False)
class PlantWorld(EquationsOfMotion):
    """Equations of motion, and the plant and scene graph that they are read from.

    Attributes:
        diagram: holds the plant and its scene graph.
        plant: the continuous MultibodyPlant, as the model has it.
        scene_graph: its geometry.
        mass: replaces the model's mass of the only body with spheres that touch [kg], or None. The
            plant is not edited: it acts in all that is read here and in `create_context`.
        mass_factor: of masses and inertias of all links that move, the `mass` too; acts likewise.
        limits: how far the model's joints and actuators go.
        ignored_shapes: names of the collision shapes that touch nothing, neither here nor in
            contexts that are made by `create_context`.
        model: what it was built from; None: a diagram of one's own.
        model_fields: how the model was read.
        ignored: what the model says and is left out, as the scenario allowed it.
        notes: what else differs from the model's file.
    """

    diagram: Diagram
    plant: MultibodyPlant
    scene_graph: SceneGraph
    mass: float | None
    limits: Limits
    model: str | None = None
    ignored_shapes: tuple[str, ...] = ()
    model_fields: ModelFields = ModelFields()  # noqa: RUF009
    ignored: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    mass_factor: float = 1.0

    def __repr__(self) -> str:
        """Returns a line without arrays: the model, and the sizes of q, v, u and contact."""
        model = "a diagram" if self.model is None else self.model
        sizes = f"nq={self.num_positions}, nv={self.num_velocities}, nu={self.num_actuators}"
        return f"{type(self).__name__}({model}: {sizes}, {len(self.contacts)} contacts)"

    def place(self, scenario: Scenario) -> Scenario:
        """Returns a scenario whose positions and weights by names are arrays (`place_scenario`).

        Raises:
            ScenarioError: a name is none of this world, or has another size.
        """
        return place_scenario(self.plant, scenario)

    def bounds(self, scenario: Scenario) -> Limits:
        """Returns within which bounds a motion has to stay: the model's and the scenario's.

        Raises:
            ScenarioError: start or goal is outside, or the bounds do not fit the model.
        """
        bounds = self.limits.narrowed(scenario)
        bounds.check_task(scenario, self.is_hinge)
        return bounds

    @cached_property
    def damping(self) -> Floats:
        """The dampers d of joints, whose force is −d v, shape (nv,) [N s/m, N m s/rad]."""
        return read_damping(self.plant, self.plant.CreateDefaultContext())

    def create_context(self) -> Context:
        """Returns a new root context, at defaults, with masses as here and shapes ignored."""
        with hide_half_space_warning():
            root = self.diagram.CreateDefaultContext()
        scale_masses(self.plant, self.plant.GetMyMutableContextFromRoot(root), self.mass_factor)
        if self.ignored_shapes:
            names = name_shapes(self.plant, self.scene_graph)
            shapes = pick_shapes("ignored_shapes", self.ignored_shapes, names)
            exclude_shapes(self.scene_graph, root, shapes)
        return root

    def fix_control(self, root: Context, control: Floats) -> None:
        """Holds a control, shape (nu,), in a context of the diagram."""
        context = self.plant.GetMyMutableContextFromRoot(root)
        self.plant.get_actuation_input_port().FixValue(context, control)

    def read_control(self, root: Context) -> Floats:
        """Returns the control that acts in a context of the diagram, shape (nu,)."""
        context = self.plant.GetMyContextFromRoot(root)
        return np.array(self.plant.get_actuation_input_port().Eval(context))
