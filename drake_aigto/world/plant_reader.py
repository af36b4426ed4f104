"""The equations of motion of a MultibodyPlant, read as sums of products of q and v."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces, RigidBody
from pydrake.symbolic import Expression, MakeVectorVariable

from drake_aigto.arrays import Floats
from drake_aigto.errors import ModelError
from drake_aigto.world.contact import SphereAndFace
from drake_aigto.world.diagram import find_hinges, find_joint
from drake_aigto.world.interpolation import TooManySamples, interpolate
from drake_aigto.world.sums import SumMap, evaluate, tidy

# What Drake's recursive dynamics and the sums may differ by, relative to the largest value.
_ROUNDING = 1e-9
_NUM_CHECKS = 3  # States at which both are compared.


class PlantReader:
    """A plant's equations as expressions, from samples of its numbers.

    Drake's symbolic twin gives them too, but a product of rotations that nobody has multiplied out
    has exponentially many terms. Hinges and sliders leave so few functions of q that samples tell
    them apart (`interpolate`), and each result is checked against the plant at other states.

    Attributes:
        q: variables, shape (nq,) [m, rad].
        v: variables, shape (nv,) [m/s, rad/s], v = q̇.
    """

    def __init__(self, plant: MultibodyPlant) -> None:
        """Names the variables."""
        self._plant = plant
        self._context = plant.CreateDefaultContext()
        self._is_hinge = find_hinges(plant)
        self.q = MakeVectorVariable(plant.num_positions(), "q")
        self.v = MakeVectorVariable(plant.num_velocities(), "v")

    def set_mass(self, body: RigidBody, mass: float) -> None:
        """Replaces a body's mass [kg]; its inertia scales along."""
        body.SetMass(self._context, mass)

    def calc_place(self, face: SphereAndFace) -> NDArray[Any]:
        """Returns where a sphere is before a face, (x, y, φ), shape (3,) [m].

        x and y are its center's coordinates along the edges. A face without any has none: zeros.
        """

        def calc_center(q: Floats) -> Floats:
            self._plant.SetPositions(self._context, q)
            return face.calc_center(self._plant, self._context)

        place = self._read(calc_center, degree=1, what=f"the place of {face.pair}")
        place[2] -= face.radius
        if face.is_unbounded:
            place[:2] = Expression(0.0)
        return tidy(place)

    def calc_mass_matrix(self) -> NDArray[Any]:
        """Returns M(q), shape (nv, nv) [kg, kg m, kg m²].

        Raises:
            ModelError: it is singular at the default positions, or depends on too many joints.
        """

        def calc(q: Floats) -> Floats:
            self._plant.SetPositions(self._context, q)
            return self._plant.CalcMassMatrix(self._context)

        M = tidy(self._read(calc, degree=2, what="the mass matrix"))
        values = evaluate(M, dict(zip(self.q, self._plant.GetDefaultPositions(), strict=True)))
        if np.linalg.matrix_rank(values) < len(values):
            raise ModelError(
                "the mass matrix is singular",
                got=values.tolist(),
                remedy="Give every link that moves a mass.",
            )
        return M

    def calc_bias(self, mass_matrix: NDArray[Any]) -> NDArray[Any]:
        """Returns h(q, v), shape (nv,) [N, N m]: all that B u and contact must balance at v̇ = 0.

            h = Σ_jk (∂M_ij/∂q_k − ½ ∂M_jk/∂q_i) v_j v_k − gravity(q) + K q + D v + constant

        Args:
            mass_matrix: M(q), as `calc_mass_matrix` has it.

        Raises:
            ModelError: a force is none of these: names the joint that it acts on.
        """

        def calc_weight(q: Floats) -> Floats:
            self._plant.SetPositions(self._context, q)
            return -self._plant.CalcGravityGeneralizedForces(self._context)

        weight = self._read(calc_weight, degree=1, what="gravity")
        with np.errstate(invalid="ignore"):  # As Drake's arithmetic on Expressions looks for NaN.
            h = tidy(self._calc_coriolis(mass_matrix) + weight + self._read_springs())
        self._check_bias(h)
        return h

    def _calc_coriolis(self, M: NDArray[Any]) -> NDArray[Any]:
        """Returns Ṁ v − ½ ∂(vᵀ M v)/∂q, shape (nv,)."""
        slopes = np.array([[each.Jacobian(self.q) for each in row] for row in M])  # ∂M_ij/∂q_k
        momentum_rate = slopes @ self.v @ self.v
        energy_slope = slopes.T @ self.v @ self.v / 2  # M is symmetric.
        return np.asarray(momentum_rate - energy_slope)

    def _read_springs(self) -> NDArray[Any]:
        """Returns K q + D v + constant, the forces of joints, shape (nv,)."""
        n = len(self.q)
        nothing, units = np.zeros(n), np.eye(n)
        constant = self._calc_joint_forces(nothing, nothing)
        K = np.array([self._calc_joint_forces(unit, nothing) - constant for unit in units]).T
        D = np.array([self._calc_joint_forces(nothing, unit) - constant for unit in units]).T
        return np.asarray(K @ self.q + D @ self.v + constant)

    def _calc_joint_forces(self, q: Floats, v: Floats) -> Floats:
        """Returns all of h(q, v) but gravity, Coriolis and centrifugal terms, shape (nv,)."""
        bias = self._calc_bias(q, v)
        nothing, at_rest = MultibodyForces(self._plant), np.zeros(len(v))
        coriolis = self._plant.CalcInverseDynamics(self._context, at_rest, nothing)
        gravity = self._plant.CalcGravityGeneralizedForces(self._context)
        return np.asarray(bias - coriolis + gravity)

    def _calc_bias(self, q: Floats, v: Floats) -> Floats:
        """Returns h(q, v) as Drake computes it, shape (nv,)."""
        self._plant.SetPositions(self._context, q)
        self._plant.SetVelocities(self._context, v)
        # Force elements (gravity, springs) and joint damping go into `forces`; inverse dynamics
        # adds the Coriolis and centrifugal terms.
        forces = MultibodyForces(self._plant)
        self._plant.CalcForceElementsContribution(self._context, forces)
        return self._plant.CalcInverseDynamics(self._context, np.zeros(len(v)), forces)

    def _check_bias(self, h: NDArray[Any]) -> None:
        """Refuses forces that are no sums of what is read, by the joint that they act on."""
        compiled = SumMap(h, np.concatenate([self.q, self.v]))
        for q, v in np.random.default_rng(1).uniform(-1.0, 1.0, (_NUM_CHECKS, 2, len(self.q))):
            expected = self._calc_bias(q, v)
            errors = np.abs(compiled(np.concatenate([q, v])) - expected)
            worst = int(np.argmax(errors))
            if errors[worst] > _ROUNDING * max(1.0, np.abs(expected).max()):
                joint = find_joint(self._plant, worst)
                raise ModelError(
                    f"joint {joint.name()!r} ({joint.type_name()})",
                    got="a force that is not gravity, a linear spring or damper of a joint",
                    remedy="Remove the force that acts on it (a LinearSpringDamper is a square "
                    "root: put spring and damping on a joint).",
                )

    def _read(self, function: Callable[[Floats], Floats], degree: int, what: str) -> NDArray[Any]:
        """Returns a function of q as expressions."""
        try:
            return interpolate(function, self.q, self._is_hinge, degree)
        except TooManySamples as error:
            joints = [find_joint(self._plant, i).name() for i in error.coordinates]
            raise ModelError(
                what,
                got=f"a function of {len(joints)} coordinates at once: of {', '.join(joints)}",
                expected="some six at most",
                remedy="Weld joints that a plan can do without.",
            ) from None
