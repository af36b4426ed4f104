"""The equations of motion of a MultibodyPlant, read as polynomials of q and v."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces_, RigidBody
from pydrake.symbolic import Expression, MakeVectorVariable, Variable

from drake_aigto.errors import ModelError
from drake_aigto.world.contact import SphereAndFace
from drake_aigto.world.diagram import find_joint
from drake_aigto.world.polynomials import evaluate, find_nonpolynomial_variable, tidy


class SymbolicPlant:
    """A plant's symbolic twin at a state of variables.

    Each method refuses, by the joint's name, what is not polynomial.

    Attributes:
        q: variables, shape (nq,) [m].
        v: variables, shape (nv,) [m/s], v = q̇.
    """

    def __init__(self, plant: MultibodyPlant) -> None:
        """Makes the twin.

        Raises:
            ModelError: a part of the plant has no symbolic form.
        """
        self._plant = plant
        try:
            self._twin = plant.ToSymbolic()
        except RuntimeError as error:
            raise ModelError("the plant has no symbolic form", got=error) from error
        self._context = self._twin.CreateDefaultContext()
        self.q = MakeVectorVariable(plant.num_positions(), "q")
        self.v = MakeVectorVariable(plant.num_velocities(), "v")
        self._twin.SetPositions(self._context, self.q)
        self._twin.SetVelocities(self._context, self.v)

    def set_mass(self, body: RigidBody, mass: float) -> None:
        """Replaces a body's mass [kg]; its inertia scales along."""
        self._twin.get_body(body.index()).SetMass(self._context, Expression(mass))

    def calc_place(self, face: SphereAndFace) -> NDArray[Any]:
        """Returns where a sphere is before a face, (x, y, φ), shape (3,) [m].

        x and y are its center's coordinates along the edges. A face without any has none: zeros.
        """
        x, y, z = face.calc_center(self._twin, self._context, Expression)
        distance = z - face.radius
        what = f"the distance of {face.pair}"
        if face.is_unbounded:
            zero = Expression(0.0)
            return np.array([zero, zero, *self._tidy(np.array([distance]), what)])
        return self._tidy(np.array([x, y, distance]), what)

    def calc_mass_matrix(self) -> NDArray[Any]:
        """Returns M(q), shape (nv, nv) [kg].

        Raises:
            ModelError: it is singular at the default positions.
        """
        M = self._tidy(self._twin.CalcMassMatrix(self._context), "the mass matrix")
        values = evaluate(M, dict(zip(self.q, self._plant.GetDefaultPositions(), strict=True)))
        if np.linalg.matrix_rank(values) < len(values):
            raise ModelError(
                "the mass matrix is singular",
                got=values.tolist(),
                remedy="Give every link that moves a mass.",
            )
        return M

    def calc_bias(self) -> NDArray[Any]:
        """Returns h(q, v), shape (nv,) [N]: all that B u and contact must balance at v̇ = 0."""
        # Force elements (gravity, springs) and joint damping go into `forces`; inverse dynamics
        # adds the Coriolis and centrifugal terms.
        forces = MultibodyForces_[Expression](self._twin)
        self._twin.CalcForceElementsContribution(self._context, forces)
        rest = np.array([Expression(0.0)] * len(self.v))
        h = self._twin.CalcInverseDynamics(self._context, rest, forces)
        return self._tidy(h, "the bias force")

    def _tidy(self, expressions: NDArray[Any], what: str) -> NDArray[Any]:
        for expression in expressions.flat:
            variable = find_nonpolynomial_variable(expression)
            if variable is not None:
                raise self._refusal(variable, what)
        return tidy(expressions)

    def _refusal(self, variable: Variable, what: str) -> ModelError:
        """Returns the error that names the joint of a variable."""
        names = [str(other) for other in (*self.q, *self.v)]
        joint = find_joint(self._plant, names.index(str(variable)) % len(self.q))
        return ModelError(
            f"joint {joint.name()!r} ({joint.type_name()})",
            got=f"a coordinate that enters {what} in a way that is not polynomial",
            expected="polynomial dynamics with a constant mass matrix",
            remedy="Use prismatic joints; weld this one, or remove the force that acts on it (a "
            "LinearSpringDamper is a square root: put spring and damping on a joint).",
        )
