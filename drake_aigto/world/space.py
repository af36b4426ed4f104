"""Worlds in space: any tree of joints and floating bodies, read as arrays instead of sums."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter
from threading import local
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from pydrake.geometry import Box, Convex, GeometryId, Mesh, SceneGraph
from pydrake.multibody.plant import MultibodyPlant, Propeller
from pydrake.symbolic import Expression, MakeVectorVariable
from pydrake.systems.framework import Context, Diagram

from drake_aigto.arrays import Bools, Floats, read_only
from drake_aigto.dynamics import Blend, Contact, Tree, broadcast_rows, list_rows, make_tree_memory
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.geometry import BALL, CAPSULE, HALF_SPACE, make_closest
from drake_aigto.world.diagram import (
    create_root,
    find_plant,
    find_propeller,
    read_thrusts,
    scale_masses,
)
from drake_aigto.world.frames import FrameGoals
from drake_aigto.world.limits import Limits
from drake_aigto.world.material import SpringMaterial, combine_springs
from drake_aigto.world.model_facts import find_errors
from drake_aigto.world.model_fields import Named
from drake_aigto.world.model_shapes import choose_pairs
from drake_aigto.world.pair_errors import explain_no_contact, name_whole
from drake_aigto.world.places import FrameGoal
from drake_aigto.world.scenario import Scenario
from drake_aigto.world.space_parts import (
    EXPECTED,
    RIM,
    ShapePair,
    SpaceCoordinates,
    SpaceFriction,
    SpaceShapes,
    find_angles,
    find_whole,
    list_rims,
    order_shapes,
    read_shapes,
)
from drake_aigto.world.world import World

if TYPE_CHECKING:
    from typing import Self  # Python 3.10 has none.

# Bodies that are deeper in each other than this part of the smaller one overlap at the start.
_OVERLAP = 0.1


@dataclass(frozen=True, eq=False, repr=False)
class SpaceWorld(SpaceCoordinates, World):
    """A world of which numbers alone are known: M, h, φ and J at states, by recursion over a tree.

    Contacts are compliant, one per pair of shapes.

    Attributes:
        pairs: of shapes that may touch, one per contact.
        geometry: the same, for compiled code.
        propeller: of thrusters, whose B turns with their links: `actuation` is that at the plant's
            default positions; None: there are none.
    """

    in_space: ClassVar[bool] = True

    pairs: tuple[ShapePair, ...] = field(kw_only=True)
    geometry: SpaceShapes = field(kw_only=True)
    propeller: Propeller | None = field(kw_only=True, default=None)

    @classmethod
    def _of_plant(cls, **given: Any) -> Self:
        diagram, plant, scene_graph = (given[key] for key in ("diagram", "plant", "scene_graph"))
        if given["mass"] is not None:
            got, remedy = f"{given['mass']:g} kg, in space", "Edit the masses in the model instead."
            raise ScenarioError("mass", got, "None, the model's", remedy)
        ignored_shapes = given["ignored_shapes"]
        pairs = _choose_pairs(plant, scene_graph, ignored_shapes)
        context = plant.CreateDefaultContext()
        scale_masses(plant, context, given["mass_factor"])
        propeller = find_propeller(diagram)
        thrusts = () if propeller is None else read_thrusts(plant, diagram, propeller)
        tree = Tree.of(plant, context, given["dry_friction"], thrusts)
        n, notes = plant.num_velocities(), []
        if not pairs and (why := explain_no_contact(scene_graph, bool(ignored_shapes))):
            notes.append(why)
        geometry = read_shapes(plant, scene_graph, tree, pairs)
        if edges := _list_edges(pairs, geometry):
            notes.append(
                f"of {', '.join(edges)}, only the lowest point touches, which jumps where a flat "
                "face lies on the ground: put spheres at its edge"
            )
        if rims := list_rims(scene_graph.model_inspector(), pairs):
            notes.append(
                f"of {', '.join(rims)}, {RIM} points at each rim touch half spaces: it stands "
                f"firmly, and rolls as a prism of {RIM} sides"
            )
        angles, turns = find_angles(tree)
        nothing = read_only(np.zeros((0, 0)), object)
        contacts = [Contact(p.name, Expression(), np.zeros(n), i) for i, p in enumerate(pairs)]
        return cls(
            **given,
            is_hinge=angles,
            positions=read_only(MakeVectorVariable(plant.num_positions(), "q"), object),
            velocities=read_only(MakeVectorVariable(n, "v"), object),
            controls=read_only(MakeVectorVariable(tree.actuation.shape[1], "u"), object),
            mass_matrix=nothing,
            bias=nothing,
            actuation=read_only(tree.calc_actuation(plant.GetDefaultPositions())),
            contacts=tuple(contacts),
            limits=Limits.of(plant, {}, given["model_fields"].limits, len(thrusts)),
            _reachable=(),
            _stuck=(),
            notes=tuple(notes),
            tree=tree,
            pairs=pairs,
            geometry=geometry,
            angular=turns,
            propeller=propeller,
        )

    def changed(self, **fields: Any) -> Self:
        """Returns the same with other fields, see `World`; the tree has its dry friction."""
        if (friction := fields.get("dry_friction")) is not None:
            tree = fields.get("tree", self.tree)
            fields["tree"] = tree._replace(friction=np.array(friction)[tree.velocities])
        return super().changed(**fields)

    def with_double_masses(self) -> Self:
        """Returns this world where links that move have twice their masses, in numbers alone."""
        double = {name: 2.0 * getattr(self.tree, name) for name in ("masses", "inertias")}
        return self.changed(tree=self.tree._replace(**double))

    def blend(self, *shares: tuple[Self, float]) -> Self:
        """Returns the world between others, see `World`: of masses and dry friction."""
        found, mixed, tables = super().blend(*shares), Blend.of(self, shares), self.tree
        for name in ("masses", "inertias", "friction"):
            table = mixed.mix(attrgetter(f"tree.{name}"))
            tables = tables._replace(**{name: table})
        return found.changed(tree=tables)

    @property
    def has_constant_inertia(self) -> bool:
        """False: M is not looked at."""
        return False

    has_constant_dynamics = has_constant_inertia

    @property
    def shapes(self) -> tuple[tuple[GeometryId, GeometryId], ...]:
        """The shapes of each contact, in the scene graph."""
        return tuple(pair.shapes for pair in self.pairs)

    @cached_property
    def springs(self) -> SpringMaterial:
        """Stiffness and dissipation of contacts.

        Raises:
            ModelError: a shape lacks one of them, or both are hydroelastic.
        """
        return combine_springs(self.scene_graph, [(p.name, p.shapes) for p in self.pairs])

    @property
    def stiffness(self) -> Floats:
        """That of each contact as the model has it, shape (m,) [N/m]."""
        return self.springs.stiffness

    @cached_property
    def rubbing(self) -> Any:
        """Friction of contacts (`SpaceFriction`)."""
        return SpaceFriction(self.plant, self.scene_graph, self.diagram, self.pairs)

    @property
    def edges(self) -> list[str]:
        """Names of pairs in which an edge touches a half space, by its lowest point alone."""
        return _list_edges(self.pairs, self.geometry)

    def is_on_face(self, q: Floats) -> Bools:
        """Returns True for each contact, shape (m,): distances are those of whole shapes."""
        return np.ones(self.num_contacts, dtype=bool)

    def _check_contacts(self, scenario: Scenario) -> None:
        if not self.pairs:
            return
        if scenario.contact != "compliant":
            raise ScenarioError(
                "contact",
                got=f"{scenario.contact!r}, of bodies in space ({self.pairs[0].name})",
                expected="'compliant', as rigid contact is planned for in the plane",
                remedy="Ask for contact: compliant (--contact compliant).",
            )
        _ = self.springs
        if scenario.periodic is not None:  # Where a plan of a gait begins, feet may be pressed.
            return
        (distances,) = self.calc_gaps(np.array([scenario.initial_position]))
        sizes = self.geometry.radii[self.geometry.pairs]
        smaller = np.min(np.where(sizes > 0, sizes, np.inf), axis=1)
        worst = int(np.argmin(distances / smaller))
        if distances[worst] < -_OVERLAP * smaller[worst]:
            raise ScenarioError(
                f"initial_position: {name_whole(self.pairs[worst].name)}",
                got=f"bodies that overlap by {-distances[worst]:.3g} m",
                expected=f"no more than {_OVERLAP * smaller[worst]:.3g} m",
                remedy="Start them apart, or exclude the pair by ignored_shapes.",
            )

    @staticmethod
    def find_plant_errors(scenario: Scenario, diagram: Diagram) -> list[ModelError]:
        """Returns what is wrong with pairs of shapes."""
        plant, scene_graph = find_plant(diagram)
        return find_errors(lambda: _choose_pairs(plant, scene_graph, scenario.ignored_shapes))

    @property
    def reaches(self) -> Floats:
        """Zero: distances are those of surfaces, shape (m,)."""
        return np.zeros(self.num_contacts)

    @cached_property
    def _solids(self) -> dict[frozenset[GeometryId], list[int]]:
        """Boxes and meshes that meet by their corners, and which contacts these are."""
        inspector: Any = self.scene_graph.model_inspector()
        found: dict[frozenset[GeometryId], list[int]] = {}
        for number, pair in enumerate(self.shapes):
            wholes = frozenset(find_whole(inspector, shape) for shape in pair)
            flat = [isinstance(inspector.GetShape(each), Box | Convex | Mesh) for each in wholes]
            if wholes != frozenset(pair) and all(flat):
                found.setdefault(wholes, []).append(number)
        return found

    @property
    def solid_corners(self) -> tuple[list[int], ...]:
        """Of each two boxes or meshes that meet by their corners, which contacts these are."""
        return tuple(self._solids.values())

    def calc_solid_distances(self, q: Floats) -> Floats:
        """Returns distances of such solids, by Drake, edges too, (K, S) [m], at q (K, nq)."""
        root = create_root(self.diagram)
        graph = self.scene_graph.GetMyContextFromRoot(root)
        of_plant = self.plant.GetMyContextFromRoot(root)
        found = np.empty((len(q), len(self._solids)))
        for row, distances in zip(q, found, strict=True):
            self.plant.SetPositions(of_plant, row)
            query: Any = self.scene_graph.get_query_output_port().Eval(graph)
            distances[:] = [_calc_distance(query, pair) for pair in self._solids]
        return found

    def find_frames(self, goals: Named[FrameGoal]) -> FrameGoals | None:
        """Returns goals of frames, checked; None: there are none."""
        return FrameGoals.of(self.plant, self.tree, goals)

    def calc_actuation(self, q: Floats) -> Floats:
        """Returns B(q), shape (…, nv, nu), at q of shape (…, nq)."""
        if self.propeller is None:
            return self.actuation
        found = [self.tree.calc_actuation(row) for row in list_rows(q)]
        return np.reshape(found, (*np.shape(q)[:-1], *self.actuation.shape))

    def fix_control(self, root: Context, control: Floats) -> None:
        """Holds a control, shape (nu,), in a context of the diagram."""
        joints, thrusts = np.split(control, [self.plant.num_actuated_dofs()])
        super().fix_control(root, joints)
        if self.propeller is not None:
            context = self.propeller.GetMyMutableContextFromRoot(root)
            self.propeller.get_command_input_port().FixValue(context, thrusts)

    def read_control(self, root: Context) -> Floats:
        """Returns the control that acts in a context of the diagram, shape (nu,)."""
        if self.propeller is None:
            return super().read_control(root)
        # The plant's port is not connected if thrusters are all there is.
        joints = super().read_control(root) if self.plant.num_actuated_dofs() else np.empty(0)
        context = self.propeller.GetMyContextFromRoot(root)
        return np.concatenate([joints, self.propeller.get_command_input_port().Eval(context)])

    def calc_mass_matrix(self, q: Floats) -> Floats:
        """Returns M(q), shape (…, nv, nv), at q of shape (…, nq)."""
        return self.tree.calc_mass_matrix(q)

    def calc_bias(self, q: Floats, v: Floats) -> Floats:
        """Returns h(q, v), shape (…, nv), with dry friction, at q (…, nq) and v (…, nv)."""
        return self.tree.calc_bias(*broadcast_rows(q, v))

    def calc_signed_distance(self, q: Floats) -> Floats:
        """Returns φ(q), shape (…, m) [m], at q of shape (…, nq)."""
        return self._measure(q)[0].reshape(*np.shape(q)[:-1], self.num_contacts)

    def calc_contact_jacobian(self, q: Floats) -> Floats:
        """Returns J(q) of φ̇ = J v, shape (…, m, nv), at q of shape (…, nq)."""
        J = np.empty((*np.shape(q)[:-1], self.num_contacts, self.num_velocities))
        self._measure(q, J.reshape(len(list_rows(q)), *J.shape[-2:]))
        return J

    def measure_contacts(self, q: Floats) -> tuple[Floats, Floats]:
        """Returns φ (m,) [m], and J of φ̇ = J v, shape (m, nv), at one q of shape (nq,)."""
        J = np.empty((1, self.num_contacts, self.num_velocities))
        return self._measure(q, J)[0][0], J[0]

    def calc_slides(self, q: Floats, v: Floats) -> Floats:
        """Returns how the first shape of each pair slides along the second, (…, m, 3) [m/s]."""
        found = []
        for (_, n, J), speed in zip(map(self.relate, list_rows(q)), list_rows(v), strict=True):
            rate = J @ speed
            found.append(rate - n * np.sum(n * rate, axis=1, keepdims=True))
        return np.array(found).reshape(*np.shape(q)[:-1], self.num_contacts, 3)

    def find_touch(self, contact: int, q: Floats) -> tuple[Floats, Floats]:
        """Returns where a pair's shapes meet at q (nq,), and its normal, in the world, (3,) each.

        The place is midway between both shapes [m]; the normal is from the second to the first.
        """
        n, C = np.split(self._measure(q)[1][0, contact], 2)
        return C, n

    def _measure(self, q: Floats, J: Floats | None = None) -> tuple[Floats, Floats]:
        """Returns φ (K, m), and normals and points (K, m, 6), of rows; J becomes ∂φ/∂q of these."""
        from drake_aigto.world.space_kernels import measure_pairs

        J = np.empty((0, self.num_contacts, self.num_velocities)) if J is None else J
        (shapes, pairs, _), room = self.geometry, self._room
        at = self.tree, shapes, pairs, room.signs, list_rows(q)
        return measure_pairs(*at, room.memory, room.closest, J)

    @cached_property
    def _room(self) -> _Room:
        return _Room(self)

    def relate(self, q: Floats) -> tuple[Floats, Floats, Floats]:
        """Returns φ of one state (m,), normals (m, 3), and ∂(ṗ_A − ṗ_B)/∂v, shape (m, 3, nv)."""
        distances, points = self._measure(q)
        memory, tree = self._room.memory, self.tree
        (x, y, z), (a, b, c) = points[0, :, 3:, np.newaxis].swapaxes(0, 1), memory.motions[:, :3].T
        moved = np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=1)
        J = np.empty((self.num_contacts, 3, self.num_velocities))
        J[..., tree.velocities] = (moved + memory.motions[:, 3:].T) * self.signs[:, np.newaxis]
        return distances[0], points[0, :, :3], J

    @cached_property
    def signs(self) -> Floats:
        """Whether degrees of freedom move the first body of each pair, 1, or the second, −1.

        Its shape is (m, nv); of those that move both, 0.
        """
        tree, links = self.tree, self.geometry.shapes.bodies[self.geometry.pairs]
        moves = np.zeros((len(tree.parents) + 1, self.num_velocities))  # The last row: the world.
        for link in range(len(tree.parents)):
            dof = int(tree.dofs[link + 1]) - 1
            while dof >= 0:
                moves[link, dof], dof = 1.0, int(tree.up[dof])
        return read_only(moves[links[:, 0]] - moves[links[:, 1]])

    def _divide_by_mass(self, q: Floats, momentum: Floats) -> Floats:
        q, momentum = broadcast_rows(q, momentum)
        found = np.linalg.solve(self.calc_mass_matrix(q), momentum[..., np.newaxis])
        return np.asarray(found[..., 0], dtype=np.float64)


class _Room(local):
    """Room to measure pairs in, each thread's own: making it takes longer than measuring."""

    def __init__(self, world: SpaceWorld) -> None:
        self.memory, self.closest = make_tree_memory(world.tree), make_closest()
        self.signs = np.array(world.signs)


def _list_edges(pairs: Sequence[ShapePair], geometry: SpaceShapes) -> list[str]:
    """Returns the names of pairs in which an edge touches a half space."""
    found = zip(pairs, geometry.pair_kinds, strict=True)
    return [pair.name for pair, (a, b) in found if b == HALF_SPACE and a not in (BALL, CAPSULE)]


def _choose_pairs(
    plant: MultibodyPlant, scene_graph: SceneGraph, ignored: tuple[str, ...]
) -> tuple[ShapePair, ...]:
    """Returns pairs of shapes that may touch, but for ignored ones, with their names."""
    inspector: Any = scene_graph.model_inspector()
    pairs = choose_pairs(plant, scene_graph, ignored, order_shapes, EXPECTED)
    return tuple(ShapePair(" with ".join(map(inspector.GetName, pair)), pair) for pair in pairs)


def _calc_distance(query: Any, pair: frozenset[GeometryId]) -> float:
    """Returns the distance of two solids [m]."""
    try:
        return float(query.ComputeSignedDistancePairClosestPoints(*pair).distance)
    except SystemExit:  # Of boxes within 1e-14 m Drake asserts that nearest points coincide.
        return 0.0
