"""How the material of a sphere slides along a face: one direction, in planar motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable

from drake_aigto.arrays import Floats
from drake_aigto.errors import ModelError
from drake_aigto.world.contact import SphereAndFace
from drake_aigto.world.diagram import find_hinges
from drake_aigto.world.interpolation import TooManySamples, interpolate
from drake_aigto.world.sums import SumMap, tidy

# What is below this part of the largest entry is rounding.
_ROUNDING = 1e-9
_NUM_PROBES = 4  # Positions at which directions and sums are looked at.


def read_tangent(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    face: SphereAndFace,
    q: NDArray[Any],
    yields: bool = False,
) -> NDArray[Any] | None:
    """Returns T(q), the slip velocity s = T v of a sphere on a face, shape (nv,) Expressions.

    Of the sphere's body S as the face's body sees it, with the velocity v_C of the sphere's center
    and the angular velocity ω,

        s = d · (v_C − l ω × n),    l = r,    or r + φ/2 if shapes yield,

    n being the face's normal and d the direction of sliding, which is fixed in the face. The second
    lever is that of the point at which the contact force of Drake's continuous plant acts, in the
    middle of the overlap. Two spheres that move about each other have n = p/R, with p from center
    to center and R the sum of radii, and d = e × n about the normal e of the plane of motion:

        s = d · v_C − l e · ω,    l = r,    or r + R x + (r − R/2)(x − x²/2) if shapes yield,

    x = φ/R, which is (R + ψ)/R (r + ψ/2) up to terms of third order in the distance ψ of their
    surfaces. Those that yield slip by s R/(R + ψ).

    Args:
        plant: whose joints move both.
        scene_graph: their shapes.
        face: the sphere and the face.
        q: the variables, shape (nq,).
        yields: whether the shapes do, and overlap.

    Returns:
        T; zeros where nothing can slide, and None if there is more than one direction.

    Raises:
        ModelError: it depends on too many joints.
    """
    motion = _Motion(plant, face)
    if motion.is_off_line:
        wall: Any = scene_graph.model_inspector().GetShape(face.shapes[1])
        rates = motion.find_turning(wall.radius(), yields)
    else:
        rates = motion.find_sliding(0.5 if yields else 0.0)
    if rates is None:
        return None
    degree = (4 if yields else 2) if motion.is_off_line else 1
    try:
        tangent = tidy(interpolate(rates, q, find_hinges(plant), degree))
    except TooManySamples as error:
        raise ModelError(
            f"the slip velocity of {face.pair}",
            got=f"a function of {len(error.coordinates)} coordinates at once",
            expected="some six at most",
            remedy="Weld joints that a plan can do without, or leave friction out.",
        ) from None
    compiled, probes = SumMap(tangent, q), motion.probes
    errors = [np.max(np.abs(compiled(probe) - rates(probe))) for probe in probes]
    size = max(np.max(np.abs(rates(probe))) for probe in probes)
    return tangent if max(errors) <= _ROUNDING * max(1.0, size) else None


class _Motion:
    """How a sphere moves before a face, as numbers."""

    def __init__(self, plant: MultibodyPlant, face: SphereAndFace) -> None:
        self._plant, self._face = plant, face
        self._context = plant.CreateDefaultContext()
        steps = np.random.default_rng(0).uniform(-1.0, 1.0, (_NUM_PROBES, plant.num_positions()))
        self.probes = plant.GetDefaultPositions() + steps
        centers = np.array([self._calc_center(q) for q in self.probes])
        # Two spheres are no flat wall to each other, unless on one line.
        self.is_off_line = face.is_ball and bool(np.any(np.abs(centers[:, :2]) > _ROUNDING))

    def find_sliding(self, share: float) -> Callable[[Floats], Floats] | None:
        """Returns q → T along the one direction in a flat face, or None if there are two.

        The lever is r and this share of φ.
        """
        n = self._plant.num_velocities()

        def calc_slip(q: Floats) -> Floats:
            center, turning, moving = self._calc_center(q), *self._calc_rates(q)
            lever = self._face.radius + share * (center[2] - self._face.radius)
            return moving[:2] - lever * np.stack([turning[1], -turning[0]])

        slips = np.hstack([calc_slip(q) for q in self.probes])
        directions, sizes, _ = np.linalg.svd(slips, full_matrices=False)
        if sizes[0] <= _ROUNDING:
            return lambda q: np.zeros(n)
        direction = _point(directions[:, 0])
        return None if sizes[1] > _ROUNDING * sizes[0] else lambda q: direction @ calc_slip(q)

    def find_turning(self, wall_radius: float, yields: bool) -> Callable[[Floats], Floats] | None:
        """Returns q → T of two spheres that move about each other; None if not in one plane."""
        face = self._face
        middle = np.array([0.0, 0.0, -wall_radius])
        R = face.radius + wall_radius
        arms = np.array([self._calc_center(q) - middle for q in self.probes])
        _, sizes, axes = np.linalg.svd(arms)
        e = _point(axes[2])
        turns = np.hstack([self._calc_rates(q)[0] for q in self.probes])
        is_planar = sizes[2] <= _ROUNDING * sizes[0]
        if not is_planar or np.any(np.abs(turns - np.outer(e, e @ turns)) > _ROUNDING):
            return None

        def calc_slip(q: Floats) -> Floats:
            turning, moving = self._calc_rates(q)
            arm = self._calc_center(q) - middle
            d, lever = np.cross(e, arm) / R, face.radius
            if yields:
                x, share = (arm @ arm / R**2 - 1) / 2, face.radius - R / 2
                lever += R * x + share * (x - x**2 / 2)
            return np.asarray(d @ moving - lever * (e @ turning))

        return calc_slip

    def _calc_center(self, q: Floats) -> Floats:
        """Returns the sphere's center in the face's frame, shape (3,) [m]."""
        self._plant.SetPositions(self._context, q)
        return self._face.calc_center(self._plant, self._context)

    def _calc_rates(self, q: Floats) -> tuple[Floats, Floats]:
        """Returns Jacobians of ω and v_C in the face's frame, shape (3, nv) each."""
        face = self._face
        self._plant.SetPositions(self._context, q)
        wall = face.face_body.body_frame()
        rates = self._plant.CalcJacobianSpatialVelocity(
            self._context,
            JacobianWrtVariable.kV,
            face.sphere_body.body_frame(),
            face.p_SC,
            wall,
            wall,
        )
        R_FB = face.X_BF.rotation().matrix().T
        return R_FB @ rates[:3], R_FB @ rates[3:]


def _point(direction: Floats) -> Floats:
    """Returns a direction, turned so that its largest part is positive."""
    return direction * np.sign(direction[np.argmax(np.abs(direction))])
