"""The world: what a plan needs to know of a MultibodyPlant and its geometry, read once."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.symbolic import MakeVectorVariable
from pydrake.systems.framework import Context, Diagram

from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.world.contact import Contact, SphereAndFace, find_pairs
from drake_aigto.world.diagram import build_diagram, check_plant, find_plant
from drake_aigto.world.fields import as_number
from drake_aigto.world.polynomials import PolynomialMap, evaluate_constants, tidy
from drake_aigto.world.scenario import Scenario
from drake_aigto.world.symbolic_plant import SymbolicPlant

if TYPE_CHECKING:
    import numpy.typing as npt


@dataclass(frozen=True, eq=False)
class World:
    """Everything that planning needs of a plant and its scene graph (AIGTO eq. (1)).

        M v̇ + h(q, v) = B u + J(q)ᵀ λ,    0 ≤ φ(q) ⊥ λ ≥ 0,    q̇ = v

    M, h and B come from the symbolic plant and φ from the scene graph's shapes: nothing is assumed
    about masses, springs, dampers, gravity, or where the wall is. Letters: nq positions, nv = nq
    velocities, nu actuators, m contacts (one, in this version).

    Attributes:
        diagram: holds the plant and its scene graph.
        plant: the continuous MultibodyPlant, as the model has it.
        scene_graph: its geometry.
        mass: replaces the model's mass of the body that the contact's sphere is on [kg], or None.
            The plant is not edited: it acts in all that is read here and in `create_context`.
        positions: the variables q, shape (nq,) [m].
        velocities: the variables v, shape (nv,) [m/s].
        controls: the variables u, shape (nu,) [N].
        mass_matrix: M, shape (nv, nv), constant Expressions [kg].
        bias: h(q, v), shape (nv,), polynomial Expressions [N]: Coriolis and centrifugal terms,
            gravity, springs and dampers, on the left side of the equation above.
        actuation: B, shape (nv, nu).
        contacts: φ and J of each contact.
    """

    diagram: Diagram
    plant: MultibodyPlant
    scene_graph: SceneGraph
    mass: float | None
    positions: npt.NDArray[Any]
    velocities: npt.NDArray[Any]
    controls: npt.NDArray[Any]
    mass_matrix: npt.NDArray[Any]
    bias: npt.NDArray[Any]
    actuation: npt.NDArray[np.float64]
    contacts: tuple[Contact, ...]
    _pair: SphereAndFace = field(repr=False)

    @classmethod
    def from_scenario(cls, scenario: Scenario) -> World:
        """Builds the scenario's model, reads it, and checks the scenario against it.

        The plant's default position is the scenario's start.

        Raises:
            ModelError: the model can't be found, parsed, or planned for.
            ScenarioError: the scenario does not fit the model (`check`).
        """
        diagram = build_diagram(scenario.model)
        plant, _ = find_plant(diagram)
        check_plant(plant)
        _check_sizes(plant, scenario)
        plant.SetDefaultPositions(scenario.initial_position)
        world = cls.from_diagram(diagram, scenario.mass)
        world.check(scenario)
        return world

    @classmethod
    def from_diagram(cls, diagram: Diagram, mass: float | None = None) -> World:
        """Reads a diagram of your own, which holds one continuous plant and its scene graph.

        Of a box, that face counts as the wall which the sphere faces at the plant's default
        positions.

        Raises:
            ModelError: the plant is discrete, lacks a joint, an actuator or a contact, has more
                than one contact, or moves in a way that is not polynomial; says which.
            ScenarioError: the mass is not above zero.
        """
        plant, scene_graph = find_plant(diagram)
        check_plant(plant)
        symbolic_plant = SymbolicPlant(plant)
        pair, contact = _find_contact(plant, scene_graph, symbolic_plant)
        if mass is not None:
            mass = as_number("mass", mass, above=0.0, unit="kg")
            _check_moves(plant, pair.sphere_body)
            symbolic_plant.set_mass(pair.sphere_body, mass)
        return cls(
            diagram=diagram,
            plant=plant,
            scene_graph=scene_graph,
            mass=mass,
            positions=_read_only(symbolic_plant.q),
            velocities=_read_only(symbolic_plant.v),
            controls=_read_only(MakeVectorVariable(plant.num_actuated_dofs(), "u")),
            mass_matrix=symbolic_plant.calc_mass_matrix(),
            bias=symbolic_plant.calc_bias(),
            actuation=_read_only(plant.MakeActuationMatrix()),
            contacts=(contact,),
            _pair=pair,
        )

    @property
    def num_positions(self) -> int:
        """The number of generalized positions, nq."""
        return len(self.positions)

    @property
    def num_velocities(self) -> int:
        """The number of generalized velocities, nv = nq."""
        return len(self.velocities)

    @property
    def num_actuators(self) -> int:
        """The number of controls, nu."""
        return len(self.controls)

    @property
    def num_contacts(self) -> int:
        """The number of contacts, m."""
        return len(self.contacts)

    @cached_property
    def mass_matrix_values(self) -> npt.NDArray[np.float64]:
        """M as floats, shape (nv, nv) [kg]; it is constant."""
        return evaluate_constants(self.mass_matrix)

    def calc_signed_distance(self, q: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Returns φ(q), shape (m,) [m], at q of shape (nq,) [m]."""
        return self._signed_distance_map(q)

    def calc_contact_jacobian(self, q: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Returns J(q) = ∂φ/∂q, shape (m, nv), at q of shape (nq,) [m]."""
        return self._jacobian_map(q).reshape(self.num_contacts, self.num_velocities)

    def calc_velocity_change(
        self, q: npt.NDArray[np.float64], impulses: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        """Returns M⁻¹ J(q)ᵀ p, shape (nv,) [m/s], for contact impulses p of shape (m,) [N s]."""
        return self._inverse_mass @ self.calc_contact_jacobian(q).T @ impulses

    def calc_acceleration(
        self,
        q: npt.NDArray[np.float64],
        v: npt.NDArray[np.float64],
        u: npt.NDArray[np.float64],
    ) -> npt.NDArray[np.float64]:
        """Returns v̇ = M⁻¹ (B u − h(q, v)), without contact, shape (nv,) [m/s²].

        Args:
            q: positions, shape (nq,) [m].
            v: velocities, shape (nv,) [m/s].
            u: controls, shape (nu,) [N].
        """
        h = self._bias_map(np.concatenate([q, v]))
        return self._inverse_mass @ (self.actuation @ u - h)

    def create_context(self) -> Context:
        """Returns a new root context of the diagram, at defaults, with the mass replaced."""
        root = self.diagram.CreateDefaultContext()
        if self.mass is not None:
            context = self.plant.GetMyMutableContextFromRoot(root)
            self._pair.sphere_body.SetMass(context, self.mass)
        return root

    def check(self, scenario: Scenario) -> None:
        """Checks that a scenario can be asked of this world.

        Raises:
            ScenarioError: sizes differ from the plant's, its mass is another, or start or goal
                touches the wall, is inside or behind it, or beside its face.
        """
        _check_sizes(self.plant, scenario)
        if scenario.mass is not None and scenario.mass != self.mass:
            raise ScenarioError(
                "mass",
                got=f"{scenario.mass:g} kg",
                expected="None, the model's" if self.mass is None else f"{self.mass:g} kg",
                remedy="The world was made with that; make it of this scenario.",
            )
        context = self.plant.CreateDefaultContext()
        for name in ("initial_position", "goal_position"):
            self.plant.SetPositions(context, getattr(scenario, name))
            self._check_place(name, self._pair.calc_center(self.plant, context))

    def _check_place(self, name: str, center: npt.NDArray[np.float64]) -> None:
        """Refuses a centre of the sphere, in the face's frame, that is not in front of it."""
        lateral, distance = center[:2], center[2] - self._pair.radius
        if distance <= 0:
            faced = np.round(self.plant.GetDefaultPositions(), 6).tolist()
            raise ScenarioError(
                f"{name} is inside, behind or against the wall ({self._pair.name})",
                got=f"a signed distance of {distance:g} m",
                expected="more than 0 m",
                remedy=f"The wall is the face that the sphere faces at q = {faced}; start and goal "
                "must both be in front of it.",
            )
        if np.any(np.abs(lateral) > self._pair.half_extents):
            raise ScenarioError(
                f"{name} is beside the face of the wall ({self._pair.name})",
                got=f"the sphere's centre {np.round(lateral, 6).tolist()} m off the face's middle",
                expected=f"within {self._pair.half_extents.tolist()} m",
                remedy="Widen the wall, or use a half space.",
            )

    @cached_property
    def _jacobian_map(self) -> PolynomialMap:
        jacobians = np.concatenate([contact.jacobian for contact in self.contacts])
        return PolynomialMap(jacobians, self.positions)

    @cached_property
    def _signed_distance_map(self) -> PolynomialMap:
        distances = np.array([contact.signed_distance for contact in self.contacts])
        return PolynomialMap(distances, self.positions)

    @cached_property
    def _bias_map(self) -> PolynomialMap:
        return PolynomialMap(self.bias, np.concatenate([self.positions, self.velocities]))

    @cached_property
    def _inverse_mass(self) -> npt.NDArray[np.floating]:
        return np.linalg.inv(self.mass_matrix_values)


def _find_contact(
    plant: MultibodyPlant, scene_graph: SceneGraph, symbolic_plant: SymbolicPlant
) -> tuple[SphereAndFace, Contact]:
    """Returns the one pair whose distance changes with q, and that distance."""
    found = []
    for pair in find_pairs(plant, scene_graph, plant.CreateDefaultContext()):
        distance = symbolic_plant.calc_signed_distance(pair)
        if distance.GetVariables().empty():
            continue  # No relative motion towards each other.
        jacobian = tidy(np.array([distance.Differentiate(x) for x in symbolic_plant.q]))
        found.append((pair, Contact(pair.name, distance, jacobian)))
    if not found:
        raise ModelError(
            "the model lacks contact geometry",
            expected="a sphere, and a box or half space that it can touch",
            remedy="Add <collision> shapes to both links.",
        )
    if len(found) > 1:
        raise ModelError(
            "the model has more than one contact",
            got=", ".join(pair.name for pair, _ in found),
            expected="one",
            remedy="Remove the others, or exclude them with a <drake:collision_filter_group>.",
        )
    return found[0]


def _check_moves(plant: MultibodyPlant, body: RigidBody) -> None:
    """Refuses to give a mass to a body that does not move."""
    if plant.IsAnchored(body):
        raise ModelError(
            "mass",
            got=f"link {body.name()!r}, which carries the contact's sphere and does not move",
            expected="the sphere on a moving link",
            remedy="Edit the mass in the model instead.",
        )


def _check_sizes(plant: MultibodyPlant, scenario: Scenario) -> None:
    """Refuses vectors whose length is not the plant's."""
    for name, size in (
        ("initial_position", plant.num_positions()),
        ("initial_velocity", plant.num_velocities()),
        ("goal_position", plant.num_positions()),
    ):
        got = len(getattr(scenario, name))
        if got != size:
            raise ScenarioError(
                name,
                got=f"{got} value{'s' if got > 1 else ''}",
                expected=f"{size}, one for each coordinate of the model",
            )


def _read_only(array: Any) -> npt.NDArray[Any]:
    """Returns the array, locked."""
    array = np.array(array)
    array.flags.writeable = False
    return array
