"""The world: what a plan needs to know of a MultibodyPlant and its geometry, read once."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.geometry import GeometryId
from pydrake.symbolic import Expression, MakeVectorVariable
from pydrake.systems.framework import Context, Diagram

from drake_aigto.arrays import Bools, Floats, read_only
from drake_aigto.dynamics import SumMap
from drake_aigto.errors import ModelError
from drake_aigto.world.diagram import find_hinges, find_plant, move_shape
from drake_aigto.world.fields import as_number
from drake_aigto.world.fingerprint import Fingerprint
from drake_aigto.world.limits import Limits, check_clearance, check_sizes, find_least_distances
from drake_aigto.world.material import SpringMaterial, read_materials, read_springs, read_stiffness
from drake_aigto.world.model_facts import find_errors
from drake_aigto.world.model_shapes import choose_pairs
from drake_aigto.world.pair_errors import check_work, explain_no_contact
from drake_aigto.world.pairs import (
    ReachableFace,
    SphereAndFace,
    find_reach,
    find_sphere_body,
    leave_out_far,
    order_pair,
    refuse_beside,
    refuse_inside,
)
from drake_aigto.world.plant_reader import PlantReader
from drake_aigto.world.plant_world import PlantWorld, check_made_for, read_world
from drake_aigto.world.rubbing import Rubbing
from drake_aigto.world.scenario import Scenario
from drake_aigto.world.task_cost import TaskCost

if TYPE_CHECKING:
    from typing import Self  # Python 3.10 has none.

# A sphere this near to a wall with friction lies against it, however its place was rounded [m].
_TOUCHING = 1e-9


@dataclass(frozen=True, eq=False, repr=False)
class World(PlantWorld):
    """Equations of motion, and the plant and scene graph that they are read from.

    M, h and B come from the plant's numbers and φ from the scene graph's shapes: nothing is assumed
    about masses, springs, dampers, gravity, or where the walls are.
    """

    _reachable: tuple[ReachableFace, ...] = field(repr=False, kw_only=True)
    _stuck: tuple[SphereAndFace, ...] = field(repr=False, kw_only=True)

    @classmethod
    def from_scenario(cls, scenario: Scenario) -> World:
        """Builds the scenario's model, reads it, and checks the scenario against it.

        The plant's default position is the scenario's start.

        Raises:
            ModelError: the model can't be found, parsed, or planned for; says all that fields of
                the scenario would change about that.
            ScenarioError: the scenario does not fit the model (`check`).
        """
        world = cls.from_model(scenario, scenario.initial_position)
        world.check(world.place(scenario))
        return world

    @classmethod
    def from_model(cls, scenario: Scenario, start: Floats | None = None) -> World:
        """Reads the scenario's model and nothing of its task, at a start or at default positions.

        Raises:
            ModelError, ScenarioError: as `from_scenario` does.
        """
        return read_world(cls, scenario, start)

    @staticmethod
    def find_plant_errors(scenario: Scenario, diagram: Diagram) -> list[ModelError]:
        """Returns what is wrong with contacts, and with the joints that M depends on."""
        plant, scene_graph = find_plant(diagram)
        pairs = cache(
            partial(choose_pairs, plant, scene_graph, scenario.ignored_shapes, order_pair)
        )
        return find_errors(pairs, PlantReader(plant).read_mass_matrix) or find_errors(
            lambda: check_work(plant, scene_graph, pairs())
        )

    @classmethod
    def _of_plant(cls, **given: Any) -> Self:
        plant, mass, factor = given["plant"], given["mass"], given["mass_factor"]
        reader = PlantReader(plant, factor)
        # What refuses at once comes first.
        scene_graph, ignored_shapes = given["scene_graph"], given["ignored_shapes"]
        pairs = choose_pairs(plant, scene_graph, ignored_shapes, order_pair)
        mass_matrix = reader.calc_mass_matrix()
        reachable, stuck = find_reach(plant, scene_graph, reader, pairs)
        if mass is not None:
            given["mass"] = mass = as_number("mass", mass, above=0.0, unit="kg")
            reader.set_mass(find_sphere_body(plant, reachable), factor * mass)
            mass_matrix = reader.calc_mass_matrix()
        return cls(
            **given,
            is_hinge=read_only(find_hinges(plant), bool),
            positions=read_only(reader.q, object),
            velocities=read_only(reader.v, object),
            controls=read_only(MakeVectorVariable(plant.num_actuated_dofs(), "u"), object),
            mass_matrix=mass_matrix,
            bias=reader.calc_bias(mass_matrix),
            actuation=read_only(plant.MakeActuationMatrix()),
            contacts=tuple(each.contact for each in reachable),
            limits=Limits.of(plant, {}, given["model_fields"].limits),
            _reachable=reachable,
            _stuck=stuck,
        )._within_reach()

    @property
    def solid_corners(self) -> tuple[list[int], ...]:
        """None: no two solids touch each other with their corners."""
        return ()

    def calc_solid_distances(self, q: Floats) -> Floats:
        """Returns no distance, shape (K, 0), at q (K, nq)."""
        return np.empty((len(q), 0))

    def calc_gaps(self, q: Floats) -> Floats:
        """Returns φ of contacts, of corners that of their solids if it is less, (K, m) [m]."""
        gaps = np.array(self.calc_signed_distance(q))
        for corners, gap in zip(self.solid_corners, self.calc_solid_distances(q).T, strict=True):
            gaps[:, corners] = np.minimum(gaps[:, corners], gap[:, np.newaxis])
        return gaps

    @property
    def shapes(self) -> tuple[tuple[GeometryId, GeometryId], ...]:
        """The sphere and the shape that it touches, of each contact, in the scene graph."""
        return tuple(each.face.shapes for each in self._reachable)

    @cached_property
    def fingerprint(self) -> Fingerprint:
        """Names and numbers that no other world has."""
        materials = tuple(read_materials(self.scene_graph, pair) for pair in self.shapes)
        friction = self.rubbing.model_coefficients
        return Fingerprint.of(self, self.plant, self.model, materials, self.limits, friction)

    def is_on_face(self, q: Floats) -> Bools:
        """Returns whether the sphere's center projects onto each face, shape (m,)."""
        return np.logical_and.reduce(np.abs(self._lateral_map(q)) <= self._half_extents, axis=1)

    def restitutions(self, scenario: Scenario) -> Floats:
        """Returns the restitution of each contact, shape (m,): the model's own, or the scenario's.

        A model has its own as the proximity property ("material", "restitution") of a shape; of two
        shapes that have it, the smaller one counts.
        """
        owns = (contact.restitution for contact in self.contacts)
        return np.array([scenario.restitution if own is None else own for own in owns])

    @cached_property
    def stiffness(self) -> Floats:
        """That of each contact as the model has it, k₁ k₂ / (k₁ + k₂), shape (m,) [N/m].

        Raises:
            ModelError: a shape has none.
        """
        return read_stiffness(self.scene_graph, self._reachable)

    @property
    def reaches(self) -> Floats:
        """Sums of radii of two spheres that move about each other, else 0, shape (m,) [m]."""
        return np.array([each.reach for each in self._reachable])

    @cached_property
    def springs(self) -> SpringMaterial:
        """Stiffness, dissipation and reaches of compliant contacts.

        Raises:
            ModelError: a shape lacks stiffness or dissipation, or Drake's plant would have another
                force there than `CompliantLaw`.
        """
        return read_springs(self.scene_graph, self._reachable)

    def least_distances(self, scenario: Scenario) -> Floats:
        """Returns the least φ of each contact by the clearance, shape (m,) [m]; −∞: any.

        Raises:
            ScenarioError: the clearance is of no pair, or of a box that is passed on several sides.
        """
        return find_least_distances(self, self.reaches, scenario.clearance)

    @cached_property
    def rubbing(self) -> Rubbing:
        """Friction of contacts, and the velocity at which they slip."""
        faces = (*(each.face for each in self._reachable), *self._stuck)
        return Rubbing(self, self.diagram, faces)

    @property
    def frictions(self) -> Mapping[str, float]:
        """The model's μ, by pair of shapes, where anything slides (`Rubbing.frictions`)."""
        return self.rubbing.frictions

    def friction_coefficients(self, scenario: Scenario) -> Floats:
        """Returns μ of each contact, shape (m,): the model's, or the scenario's in place of it.

        Where nothing can slide it is 0.

        Raises:
            ModelError: a sphere can slide in two directions along a face where μ is not 0.
        """
        return self.rubbing.calc_coefficients(scenario.friction)

    def create_context(self) -> Context:
        """Returns a new root context, at defaults, with masses as here and shapes ignored."""
        root = super().create_context()
        if self.mass is not None:
            body = find_sphere_body(self.plant, self._reachable)
            context = self.plant.GetMyMutableContextFromRoot(root)
            body.SetMass(context, self.mass_factor * self.mass)
        return root

    @property
    def sphere_mass(self) -> float:
        """The mass that a scenario's replaces: of the only body with spheres that touch [kg].

        Raises:
            ModelError: several bodies have such spheres, or the one that has does not move.
        """
        body = find_sphere_body(self.plant, self._reachable)
        return body.default_mass() if self.mass is None else self.mass

    def with_wall_moved(self, contact: int, distance: float) -> Self:
        """Returns a copy of this world with the shape of contact i, all of its faces, elsewhere.

        Its diagram is a copy, too, so that Drake simulates what is read here. What is only drawn
        stays where it is. The distance [m] is along the face's outward normal: φ_i falls by it.

        Raises:
            ModelError: the shape is on a link that moves, or the diagram can't be copied.
        """
        face = self._reachable[contact].face
        if not self.plant.IsAnchored(wall := self.find_wall(contact)):
            got = f"a shape on link {wall.name()!r}, which moves"
            raise ModelError(f"the wall of {face.pair}", got, "one that stands still")
        translation = distance * face.X_BF.rotation().col(2)
        return self.of_diagram(move_shape(self.diagram, face.shapes[1], translation))

    def with_walls_moved(self, distances: Mapping[int, float]) -> Self:
        """Returns the same for several shapes: distances [m] by contacts of this world."""
        world = self
        for contact, distance in distances.items():
            # One that is out of reach by now is no contact any more, and those after it move up.
            names = [each.name for each in world.contacts]
            world = world.with_wall_moved(names.index(self.contacts[contact].name), distance)
        return world

    def with_double_masses(self) -> Self:
        """Returns this world where links that move have twice their masses, in numbers alone."""
        other = self.of_diagram(self.diagram, 2.0 * self.mass_factor)
        own, mine = ([*each.positions, *each.velocities] for each in (other, self))
        names = dict(zip(own, map(Expression, mine), strict=True))
        M = [[entry.Substitute(names) for entry in row] for row in other.mass_matrix]
        h = [entry.Substitute(names) for entry in other.bias]
        return self.changed(mass_matrix=read_only(M, object), bias=read_only(h, object))

    def check_plain(self, scenario: Scenario) -> None:
        """Refuses what is not planned for where balls are, so that nothing is dropped in silence.

        Raises:
            ScenarioError: the task asks for more than AIGTO's (`Scenario.is_plain`); says for what.
            ModelError: there are limits or friction, or nothing can touch.
        """
        scenario.check_plain()
        self.rubbing.check_none(scenario.friction)
        self.limits.check_none(self.plant)
        if not self.contacts:
            raise ModelError(
                "the model lacks a contact",
                got=explain_no_contact(self.scene_graph) or "no collision shapes",
                expected="a sphere, and a box, half space or sphere that it can touch",
                remedy="Add <collision> shapes to both links.",
            )

    def lies_at_wall(self, scenario: Scenario) -> bool:
        """Returns whether the start or the goal is at a wall, with no distance at all."""
        ends = np.array([scenario.initial_position, scenario.goal_position])
        distances = self.calc_clearance(ends)
        return bool(np.any((distances <= 0) & (distances >= -_TOUCHING)))

    def check(self, scenario: Scenario) -> None:
        """Checks that a scenario can be asked of this world.

        Raises:
            ScenarioError: sizes differ from the plant's, its mass or dry friction is another, the
                cost makes no sense here (`TaskCost.of`), or start or goal touches the wall, is
                inside or behind it, or beside its face, or is beyond joint limits; or the start
                lacks its clearance; or servos can't hold the goal.
            ModelError: friction acts where a sphere can slide in two directions, or is stuck in a
                shape; or the model lacks what compliant contact takes (`springs`). In space contact
                is compliant, and bodies may not overlap at the start.
        """
        check_sizes(self.plant, scenario)
        TaskCost.of(self, scenario)
        self.bounds(scenario).check_servos(self.plant, scenario)
        check_made_for(self, scenario)
        self._check_contacts(scenario)
        least = self.least_distances(scenario)
        if scenario.periodic is None:  # Else the plan's verdict says how nearly its start has it.
            (gaps,) = self.calc_gaps(np.array([scenario.initial_position]))
            check_clearance(self, least - gaps)

    def _check_contacts(self, scenario: Scenario) -> None:
        """Refuses a law of contact that shapes lack, and places against or inside of these."""
        if scenario.contact == "compliant":
            _ = self.springs
        self.friction_coefficients(scenario)
        self.rubbing.check(scenario.friction)
        for name in ("initial_position", "goal_position"):
            self._check_place(name, getattr(scenario, name), scenario)

    def _within_reach(self) -> Self:
        """Returns this world without walls that are farther off than its joints go, with notes.

        Of a box before one face of which a sphere always stays, the other faces are left out. All
        of that is known where the model's joints have limits.
        """
        limits = self.limits.position
        least, _ = self._signed_distance_map.calc_range(*limits)
        lateral = np.abs(self._lateral_map.calc_range(*limits)).max(axis=0).reshape(-1, 2)
        near, far = leave_out_far(self._reachable, self.solids, least, lateral)
        notes = [f"{pair} can't touch: they stay {gap:.3g} m apart" for pair, gap in far.items()]
        why = explain_no_contact(self.scene_graph, bool(self.ignored_shapes))
        if not self._reachable and why:
            notes.append(why)
        contacts = tuple(each.contact for each in near)
        return dataclasses.replace(
            self, _reachable=near, contacts=contacts, notes=(*self.notes, *notes)
        )

    def _check_place(self, name: str, q: Floats, scenario: Scenario) -> None:
        """Refuses a position inside or against a solid, or beside the one face that it has.

        Compliant half spaces may be entered: they have no far side to be pushed out of. So may
        boxes, while the sphere's center is outside, so that its side is known. A sphere may lie
        against a wall.
        """
        for faces, distance in zip(self.solids, self.calc_clearance(q), strict=True):
            face = self._reachable[faces[0]].face
            has_one_side = face.is_unbounded or distance > -face.radius
            is_soft = has_one_side and scenario.contact == "compliant"
            if distance <= 0 and not (is_soft or abs(distance) <= _TOUCHING):
                raise refuse_inside(name, face, distance, len(faces), self.plant)
            if len(faces) == 1 and not self.is_on_face(q)[faces[0]]:
                raise refuse_beside(name, face, self._lateral_map(q)[faces[0]])

    @cached_property
    def _lateral_map(self) -> SumMap:
        """Centers of spheres along the edges of the faces, shape (m, 2) [m]."""
        laterals = [each.lateral for each in self._reachable]
        return SumMap(np.array(laterals, dtype=object).reshape(-1, 2), self.positions)

    @cached_property
    def _half_extents(self) -> Floats:
        return np.array([each.face.half_extents for each in self._reachable]).reshape(-1, 2)
