"""Worlds in space: any tree of joints and floating bodies, read as arrays instead of sums."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from pydrake.geometry import GeometryId, SceneGraph
from pydrake.multibody.plant import MultibodyPlant, Propeller
from pydrake.symbolic import Expression, MakeVectorVariable
from pydrake.systems.framework import Context, Diagram

from drake_aigto.arrays import Bools, Floats, read_only
from drake_aigto.dynamics import (
    PRISMATIC,
    QUATERNION,
    STICTION_SPEED,
    TRANSLATION,
    Contact,
    Tree,
    TreeMemory,
    make_tree_memory,
)
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.geometry import make_closest
from drake_aigto.world.diagram import find_plant, scale_masses
from drake_aigto.world.frames import FrameGoals
from drake_aigto.world.limits import Limits, check_sizes
from drake_aigto.world.material import SpringMaterial, combine_springs
from drake_aigto.world.model_facts import find_errors
from drake_aigto.world.model_fields import Limited, Named, as_globs
from drake_aigto.world.model_reader import open_diagram
from drake_aigto.world.model_shapes import choose_pairs
from drake_aigto.world.pair_errors import explain_no_contact
from drake_aigto.world.places import FrameGoal
from drake_aigto.world.scenario import Scenario
from drake_aigto.world.space_pairs import (
    EXPECTED,
    ShapePair,
    SpaceFriction,
    SpaceShapes,
    order_shapes,
    read_shapes,
)
from drake_aigto.world.task_cost import TaskCost
from drake_aigto.world.thrusters import find_propeller, read_thrusts
from drake_aigto.world.world import World

# Bodies that are deeper in each other than this part of the smaller one overlap at the start.
_OVERLAP = 0.1


@dataclass(frozen=True, eq=False)
class SpaceWorld(World):
    """A world of which numbers alone are known: M, h, φ and J at states, by recursion over a tree.

    Velocities v are as Drake's plant has them; differences of positions, errors of goals and
    weights are in the tangent space, of shape (nv,). Contacts are compliant, one per pair of
    shapes.

    Attributes:
        tree: of joints and bodies.
        pairs: of shapes that may touch, one per contact.
        geometry: the same, for compiled code.
        angular: whether each velocity turns, shape (nv,).
        propeller: of thrusters, whose B turns with their links: `actuation` is that at the plant's
            default positions; None: there are none.
    """

    tree: Tree = field(kw_only=True)
    pairs: tuple[ShapePair, ...] = field(kw_only=True)
    geometry: SpaceShapes = field(kw_only=True)
    angular: Bools = field(kw_only=True)
    propeller: Propeller | None = field(kw_only=True, default=None)

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
    ) -> SpaceWorld:
        """Reads a diagram of your own; arguments are those of `World.from_diagram`.

        Raises:
            ModelError: the plant is discrete, lacks an actuator, is no tree, feels forces that are
                not planned for, or has pairs of shapes whose distance is not known.
            ScenarioError: a mass is given.
        """
        fields, diagram, plant, scene_graph = open_diagram(
            diagram, limits, material, dry_friction, in_space=True
        )
        if mass is not None:
            remedy = "Edit the masses in the model instead."
            raise ScenarioError("mass", f"{mass:g} kg, in space", "None, the model's", remedy)
        globs = as_globs("ignored_shapes", ignored_shapes)
        pairs = _choose_pairs(plant, scene_graph, globs)
        context = plant.CreateDefaultContext()
        scale_masses(plant, context, mass_factor)
        propeller = find_propeller(diagram)
        thrusts = () if propeller is None else read_thrusts(plant, diagram, propeller)
        tree = Tree.of(plant, context, dry_friction, thrusts)
        nu = tree.actuation.shape[1]
        n, notes = plant.num_velocities(), []
        if not pairs and (why := explain_no_contact(scene_graph, bool(globs))):
            notes.append(why)
        angles, turns = _find_angles(tree)
        nothing = read_only(np.zeros((0, 0)), object)
        contacts = [Contact(p.name, Expression(), np.zeros(n), i) for i, p in enumerate(pairs)]
        return cls(
            diagram=diagram,
            plant=plant,
            scene_graph=scene_graph,
            mass=None,
            is_hinge=angles,
            positions=read_only(MakeVectorVariable(plant.num_positions(), "q"), object),
            velocities=read_only(MakeVectorVariable(n, "v"), object),
            controls=read_only(MakeVectorVariable(nu, "u"), object),
            mass_matrix=nothing,
            bias=nothing,
            actuation=read_only(tree.calc_actuation(plant.GetDefaultPositions())),
            contacts=tuple(contacts),
            limits=Limits.of(plant, {}, limits, len(thrusts)),
            _reachable=(),
            _stuck=(),
            ignored_shapes=globs,
            dry_friction=dry_friction,
            stiction_speed=stiction_speed,
            model_fields=fields,
            notes=tuple(notes),
            mass_factor=mass_factor,
            tree=tree,
            pairs=pairs,
            geometry=read_shapes(plant, scene_graph, tree, pairs),
            angular=turns,
            propeller=propeller,
        )

    @property
    def has_constant_inertia(self) -> bool:
        """False: M is not looked at."""
        return False

    has_constant_dynamics = has_constant_inertia

    @property
    def turns(self) -> Bools:
        """Whether each velocity is an angular one, shape (nv,)."""
        return self.angular

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

    def is_on_face(self, q: Floats) -> Bools:
        """Returns True for each contact, shape (m,): distances are those of whole shapes."""
        return np.ones(self.num_contacts, dtype=bool)

    def check(self, scenario: Scenario) -> None:
        """Checks that a scenario can be asked of this world.

        Raises:
            ScenarioError: as `World.check`; or bodies overlap at the start, or contact is rigid.
            ModelError: a shape lacks stiffness or dissipation.
        """
        check_sizes(self.plant, scenario)
        TaskCost.of(self, scenario)
        self.bounds(scenario)
        self._check_made_for(scenario)
        if scenario.clearance:
            got = f"{', '.join(scenario.clearance)}, in space"
            raise ScenarioError("clearance", got, "none, as pairs are kept apart in the plane")
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
        distances = self.calc_signed_distance(scenario.initial_position)
        sizes = self.geometry.shapes.bounds[self.geometry.pairs]
        smaller = np.min(np.where(sizes > 0, sizes, np.inf), axis=1)
        worst = int(np.argmin(distances / smaller))
        if distances[worst] < -_OVERLAP * smaller[worst]:
            raise ScenarioError(
                f"initial_position: {self.pairs[worst].name}",
                got=f"bodies that overlap by {-distances[worst]:.3g} m",
                expected=f"no more than {_OVERLAP * smaller[worst]:.3g} m",
                remedy="Start them apart, or exclude the pair by ignored_shapes.",
            )

    @staticmethod
    def _check_plant(scenario: Scenario, diagram: Diagram) -> list[ModelError]:
        """Returns what is wrong with pairs of shapes."""
        plant, scene_graph = find_plant(diagram)
        return find_errors(lambda: _choose_pairs(plant, scene_graph, scenario.ignored_shapes))

    @property
    def reaches(self) -> Floats:
        """Zero: distances are those of surfaces, shape (m,)."""
        return np.zeros(self.num_contacts)

    def normalized(self, q: Floats) -> Floats:
        """Returns positions with quaternions of unit length, shape (…, nq)."""
        return self.add(q, np.zeros(self.num_velocities))

    def add(self, q: Floats, delta: Floats) -> Floats:
        """Returns q ⊕ δ, shape (…, nq): links turned by rotation vectors, and moved."""
        q, delta = _broadcast(q, delta)
        rows = [self.tree.add(*row) for row in zip(_rows(q), _rows(delta), strict=True)]
        return np.array(rows).reshape(q.shape)

    def subtract(self, after: Floats, before: Floats) -> Floats:
        """Returns the shortest δ with before ⊕ δ = after, shape (…, nv), of positions (…, nq)."""
        from drake_aigto.world.space_kernels import subtract_rows

        after, before = np.broadcast_arrays(after, before)
        found = subtract_rows(self.tree, _rows(after), _rows(before))
        return found.reshape(*after.shape[:-1], self.num_velocities)

    def measure(self, after: Floats, before: Floats) -> Floats:
        """Returns the same difference for costs, smooth: turns in space by 2 sin(θ/2), not θ."""
        found = self.subtract(after, before)
        for first in self._turns_in_space:
            turn = found[..., first : first + 3]
            angle = np.linalg.norm(turn, axis=-1, keepdims=True)
            turn *= np.sinc(angle / (2 * np.pi))
        return found

    def take_nearest(self, q: Floats, about: Floats) -> Floats:
        """Returns positions as many turns on as bring them nearest to others, shape (…, nq).

        Of both quaternions of a turn that is the one on the other's side.
        """
        found = super().take_nearest(q, about)
        for i in np.flatnonzero(self.tree.kinds == QUATERNION):
            turn = slice(self.tree.positions[i], self.tree.positions[i] + 4)
            dots = np.sum(found[..., turn] * about[..., turn], axis=-1, keepdims=True)
            found[..., turn] *= np.where(dots < 0, -1.0, 1.0)
        return found

    def in_tangent(self, positions: Floats, turn: Floats) -> Floats:
        """Returns numbers of positions (…, nq) by velocities (…, nv); of turns in space `turn`.

        The latter has the shape (…, 1).
        """
        tree, places = self.tree, np.full(self.num_velocities, -1)
        for i in np.flatnonzero(tree.kinds < QUATERNION):
            dofs = tree.velocities[tree.dofs[i] : tree.dofs[i + 1]]
            places[dofs] = tree.positions[i] + np.arange(len(dofs))
        return np.where(places >= 0, positions[..., places], turn)

    @cached_property
    def _turns_in_space(self) -> list[int]:
        """Where velocities of links that turn about three axes start."""
        kinds, dofs = self.tree.kinds, self.tree.dofs[:-1]
        return [int(self.tree.velocities[dofs[i]]) for i in np.flatnonzero(kinds >= QUATERNION)]

    @property
    def units_of_positions(self) -> tuple[str, ...]:
        """The unit of each position, nq of them; none, "", of the numbers of a quaternion."""
        found = ["rad" if turns else "m" for turns in self.is_hinge]
        for i in np.flatnonzero(self.tree.kinds >= QUATERNION):
            first = int(self.tree.positions[i])
            found[first : first + 4] = [""] * 4
        return tuple(found)

    def middle(self, one: Floats, other: Floats) -> Floats:
        """Returns positions halfway between two, (…, nq)."""
        return self.add(one, self.subtract(other, one) / 2)

    def calc_position_rate(self, q: Floats, v: Floats) -> Floats:
        """Returns q̇ = N(q) v, shape (…, nq)."""
        rows = [self.tree.calc_position_rate(*row) for row in zip(_rows(q), _rows(v), strict=True)]
        return np.array(rows).reshape(np.shape(q))

    def find_frames(self, goals: Named[FrameGoal]) -> FrameGoals | None:
        """Returns goals of frames, checked; None: there are none."""
        return FrameGoals.of(self.plant, self.tree, goals)

    def calc_actuation(self, q: Floats) -> Floats:
        """Returns B(q), shape (…, nv, nu), at q of shape (…, nq)."""
        if self.propeller is None:
            return self.actuation
        found = [self.tree.calc_actuation(row) for row in _rows(q)]
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
        joints = super().read_control(root)
        if self.propeller is None:
            return joints
        context = self.propeller.GetMyContextFromRoot(root)
        return np.concatenate([joints, self.propeller.get_command_input_port().Eval(context)])

    def calc_mass_matrix(self, q: Floats) -> Floats:
        """Returns M(q), shape (…, nv, nv), at q of shape (…, nq)."""
        return self.tree.calc_mass_matrix(q)

    def calc_bias(self, q: Floats, v: Floats) -> Floats:
        """Returns h(q, v), shape (…, nv), with dry friction, at q (…, nq) and v (…, nv)."""
        return self.tree.calc_bias(*_broadcast(q, v))

    def calc_signed_distance(self, q: Floats) -> Floats:
        """Returns φ(q), shape (…, m) [m], at q of shape (…, nq)."""
        return self._measure(q)[0].reshape(*np.shape(q)[:-1], self.num_contacts)

    def calc_contact_jacobian(self, q: Floats) -> Floats:
        """Returns J(q) of φ̇ = J v, shape (…, m, nv), at q of shape (…, nq)."""
        J = np.empty((*np.shape(q)[:-1], self.num_contacts, self.num_velocities))
        self._measure(q, J.reshape(len(_rows(q)), *J.shape[-2:]))
        return J

    def calc_slides(self, q: Floats, v: Floats) -> Floats:
        """Returns how the first shape of each pair slides along the second, (…, m, 3) [m/s]."""
        found = []
        for (n, J), speed in zip(map(self.relate, _rows(q)), _rows(v), strict=True):
            rate = J @ speed
            found.append(rate - n * np.sum(n * rate, axis=1, keepdims=True))
        return np.array(found).reshape(*np.shape(q)[:-1], self.num_contacts, 3)

    def find_touch(self, contact: int, q: Floats) -> tuple[Floats, Floats]:
        """Returns where a pair's shapes meet at q (nq,), and its normal, in the world, (3,) each.

        The place is midway between both shapes [m]; the normal is from the second to the first.
        """
        n, C = np.split(self._measure(q)[1][0, contact], 2)
        return C, n

    def _measure(
        self, q: Floats, J: Floats | None = None, memory: TreeMemory | None = None
    ) -> tuple[Floats, Floats]:
        """Returns φ (K, m), and normals and points (K, m, 6), of rows; J becomes ∂φ/∂q of these."""
        from drake_aigto.world.space_kernels import measure_pairs

        J = np.empty((0, self.num_contacts, self.num_velocities)) if J is None else J
        memory = memory or make_tree_memory(self.tree)
        at = self.tree, *self.geometry, np.array(self.signs), _rows(q)
        return measure_pairs(*at, memory, make_closest(), J)

    def relate(self, q: Floats) -> tuple[Floats, Floats]:
        """Returns normals at one state, shape (m, 3), and ∂(ṗ_A − ṗ_B)/∂v, shape (m, 3, nv)."""
        memory, tree = make_tree_memory(self.tree), self.tree
        _, points = self._measure(q, memory=memory)
        turns, C = memory.motions[:, :3], points[0, :, np.newaxis, 3:]
        moved = memory.motions[:, 3:] + np.cross(turns, C)
        J = np.empty((self.num_contacts, 3, self.num_velocities))
        J[..., tree.velocities] = np.swapaxes(moved * self.signs[..., np.newaxis], 1, 2)
        return points[0, :, :3], J

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
        q, momentum = _broadcast(q, momentum)
        found = np.linalg.solve(self.calc_mass_matrix(q), momentum[..., np.newaxis])
        return np.asarray(found[..., 0], dtype=np.float64)


def _choose_pairs(
    plant: MultibodyPlant, scene_graph: SceneGraph, ignored: tuple[str, ...]
) -> tuple[ShapePair, ...]:
    """Returns pairs of shapes that may touch, but for ignored ones, with their names."""
    inspector: Any = scene_graph.model_inspector()
    pairs = choose_pairs(plant, scene_graph, ignored, order_shapes, EXPECTED)
    return tuple(ShapePair(" with ".join(map(inspector.GetName, pair)), pair) for pair in pairs)


def _rows(values: Floats) -> Floats:
    """Returns values as writable, contiguous rows."""
    array = np.asarray(values, dtype=float)
    return np.array(array.reshape(-1, array.shape[-1]), order="C")


def _broadcast(one: Floats, other: Floats) -> tuple[Floats, Floats]:
    """Returns rows of both at all states of either."""
    shape = np.broadcast_shapes(np.shape(one)[:-1], np.shape(other)[:-1])
    each = (np.broadcast_to(a, (*shape, np.shape(a)[-1])) for a in (one, other))
    first, second = each
    return first, second


def _find_angles(tree: Tree) -> tuple[Bools, Bools]:
    """Returns which positions (nq,) and which velocities (nv,) turn."""
    q, v = np.ones(tree.num_positions, dtype=bool), np.ones(tree.num_velocities, dtype=bool)
    for i in np.flatnonzero(np.isin(tree.kinds, (PRISMATIC, TRANSLATION))):
        dofs = slice(tree.dofs[i], tree.dofs[i + 1])
        v[tree.velocities[dofs]] = False
        count, first = tree.dofs[i + 1] - tree.dofs[i], tree.positions[i]
        q[first : first + count] = False
    return read_only(q, bool), read_only(v, bool)
