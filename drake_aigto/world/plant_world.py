"""A plant, what was read of its model, and its bounds: what worlds of any kind have; reading it."""

from __future__ import annotations

import dataclasses
import itertools
from abc import abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pkgutil import resolve_name
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from pydrake.geometry import GeometryId, Role, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import Context, Diagram

from drake_aigto.arrays import Floats
from drake_aigto.dynamics import STICTION_SPEED, EquationsOfMotion, read_damping
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.world.diagram import (
    check_friction_acts,
    check_plant,
    copy_diagram,
    create_root,
    exclude,
    find_plant,
    find_propeller,
    scale_masses,
)
from drake_aigto.world.frames import find_advance, place_scenario
from drake_aigto.world.limits import Limits, check_sizes
from drake_aigto.world.material import STIFFNESS, change_material, read_given, scale_friction
from drake_aigto.world.model_facts import FixableError, find_errors, gather
from drake_aigto.world.model_fields import Limited, ModelFields, as_globs
from drake_aigto.world.model_reader import read_model
from drake_aigto.world.model_shapes import name_shapes, pick_shapes, set_materials
from drake_aigto.world.scenario import Scenario

if TYPE_CHECKING:
    from typing import Self  # Python 3.10 has none.


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
        in_space: whether it is read as a tree, which joints of any kind make.
        limits: how far the model's joints and actuators go.
        ignored_shapes: names of the collision shapes that touch nothing, neither here nor in
            contexts that are made by `create_context`.
        model: what it was built from; None: a diagram of one's own.
        model_fields: how the model was read.
        ignored: what the model says and is left out, as the scenario allowed it.
        notes: what else differs from the model's file.
    """

    in_space: ClassVar[bool] = False

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

    @classmethod
    def from_diagram(
        cls,
        diagram: Diagram,
        mass: float | None = None,
        ignored_shapes: Iterable[str] | str = (),
        dry_friction: Floats | None = None,
        stiction_speed: float = STICTION_SPEED,
        limits: Limited = "model",
        material: Mapping[str, Any] = MappingProxyType({}),
        mass_factor: float = 1.0,
    ) -> Self:
        """Reads a diagram of your own, which holds one continuous plant and its scene graph.

        By `World` it is read as sums of products, for few joints in a plane; by `SpaceWorld` with
        bodies that float, arms of many joints, and friction along faces.

        In a plane, of a box that the sphere can only move along one line to, that face counts which
        the sphere faces at the plant's default positions; of another box, every face that it can
        reach.

        Args:
            diagram: of one continuous MultibodyPlant and its SceneGraph, at any depth.
            mass: replaces that of the only body with spheres that touch [kg]; None: the model's. In
                a plane.
            ignored_shapes: collision shapes that touch nothing, such as two meshes that
                meet: "shape", "link::shape", globs, or all.
            dry_friction: of each coordinate, shape (nv,) [N, N m], which a system of the diagram
                makes act on its plant (`add_dry_friction`); None: no joint has any.
            stiction_speed: v_s of friction in the plant, Drake's stiction tolerance, which can't be
                read off it [m/s, rad/s].
            limits: "model", or "ignore": limits of positions and velocities count for nothing.
            material: of collision shapes, glob → `Material`, in place of the diagram's, which stays
                as it is: the world has a copy. All else that a scenario says of how a model is
                read is for the parser that made the diagram.
            mass_factor: of masses and inertias of all links that move, and of the `mass`.

        Raises:
            ModelError: the plant is discrete, lacks a joint or an actuator, has shapes or joints
                that are not supported, none of which can meet, or feels forces that are; or the
                mass is that of several bodies, or of one that does not move. In space: the plant is
                no tree, or has pairs of shapes whose distance is not known. Says which.
            ScenarioError: the mass is not above zero, or one is given in space.
        """
        given: Any = material
        fields = ModelFields(limits=limits, material=given)
        diagram = copy_diagram(diagram) if fields.material else diagram
        plant, scene_graph = find_plant(diagram)
        set_materials(plant, scene_graph, fields.material)
        has_thrusters = find_propeller(diagram) is not None
        if has_thrusters and not cls.in_space:
            remedy = "Read it by SpaceWorld.from_diagram."
            raise ModelError("Propeller", "thrusters, in a plane", "a world in space", remedy)
        check_plant(plant, cls.in_space, has_thrusters)
        if dry_friction is not None:
            check_friction_acts(plant, diagram)
        return cls._of_plant(
            diagram=diagram,
            plant=plant,
            scene_graph=scene_graph,
            mass=mass,
            ignored_shapes=as_globs("ignored_shapes", ignored_shapes),
            dry_friction=dry_friction,
            stiction_speed=stiction_speed,
            model_fields=fields,
            mass_factor=mass_factor,
        )

    @classmethod
    @abstractmethod
    def _of_plant(cls, **given: Any) -> Self:
        """Reads the equations and the contacts of a plant; given are fields of the world."""

    @property
    @abstractmethod
    def shapes(self) -> tuple[tuple[GeometryId, GeometryId], ...]:
        """The shapes of each contact, in the scene graph."""

    def find_wall(self, contact: int) -> RigidBody:
        """Returns the body of a contact's wall, its second shape."""
        frame = self.scene_graph.model_inspector().GetFrameId(self.shapes[contact][1])
        body: Any = self.plant.GetBodyFromFrameId(frame)
        return body

    @property
    @abstractmethod
    def rubbing(self) -> Any:
        """Friction of contacts."""

    def of_diagram(self, diagram: Diagram, mass_factor: float | None = None) -> Self:
        """Returns the world of another diagram with a copy of its plant, all else as it is here.

        Args:
            diagram: the other one, or its own.
            mass_factor: in place of its own.

        Raises:
            ModelError: the plant there can't be planned for.
        """
        friction = self.dry_friction, self.stiction_speed
        given = self.mass, self.ignored_shapes, *friction, self.model_fields.limits
        factor = self.mass_factor if mass_factor is None else mass_factor
        other = type(self).from_diagram(diagram, *given, mass_factor=factor)
        mine = {
            name: getattr(self, name) for name in ("limits", "model_fields", "ignored", "notes")
        }
        return dataclasses.replace(other, **mine)

    def with_stiffness(self, factor: float) -> Self:
        """Returns a copy of this world with shapes that touch times as stiff, in a copied diagram.

        Raises:
            ModelError: a shape has no stiffness, or the diagram can't be copied.
        """
        copy = copy_diagram(self.diagram)
        for shape in dict.fromkeys(itertools.chain(*self.shapes)):
            plant, scene_graph = find_plant(copy)
            stiffness = factor * read_given(scene_graph, shape, STIFFNESS)[0]
            change_material(plant, scene_graph, shape, {STIFFNESS: stiffness})
        return self.of_diagram(copy)

    def with_friction(self, factor: float) -> Self:
        """Returns a copy of this world with times the μ of each pair, in a copied diagram."""
        copy = copy_diagram(self.diagram)
        scale_friction(*find_plant(copy), copy, self.rubbing.shapes, factor)
        return self.of_diagram(copy)

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

    def find_advance(self, scenario: Scenario) -> Floats:
        """Returns by how much a motion that repeats advances, (nv,); NaN where its start is free.

        Turns in space repeat, and their start is free.
        """
        return self.in_tangent(find_advance(self.plant, scenario), np.array([np.nan]))

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
        root = create_root(self.diagram)
        scale_masses(self.plant, self.plant.GetMyMutableContextFromRoot(root), self.mass_factor)
        if self.ignored_shapes:
            names = name_shapes(self.plant, self.scene_graph)
            shapes = pick_shapes("ignored_shapes", self.ignored_shapes, names)
            every = self.scene_graph.model_inspector().GetAllGeometryIds(Role.kProximity)
            exclude(self.scene_graph, shapes, every, root)
        return root

    def fix_control(self, root: Context, control: Floats) -> None:
        """Holds a control, shape (nu,), in a context of the diagram."""
        context = self.plant.GetMyMutableContextFromRoot(root)
        self.plant.get_actuation_input_port().FixValue(context, control)

    def read_control(self, root: Context) -> Floats:
        """Returns the control that acts in a context of the diagram, shape (nu,)."""
        context = self.plant.GetMyContextFromRoot(root)
        return np.array(self.plant.get_actuation_input_port().Eval(context))


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
    """Refuses a scenario with another mass or friction, or other ignored shapes, than a world's."""
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
