"""Friction of contacts as the model or a scenario has it, and the velocity at which they slide."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import GeometryId
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.symbolic import Expression
from pydrake.systems.framework import Context, Diagram

from drake_aigto.arrays import Floats, read_only
from drake_aigto.dynamics import EquationsOfMotion, SumMap, calc_turning, tidy
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.world.diagram import find_anywhere, find_hinges, find_plant
from drake_aigto.world.material import impose_friction, read_frictions
from drake_aigto.world.pairs import SphereAndFace
from drake_aigto.world.plant_reader import TooManySamples, interpolate

# Parts of the largest entry below this are rounding.
_ROUNDING = 1e-9
_NUM_PROBES = 4  # Positions at which directions and sums are looked at.

# T(q), shape (nv,) Expressions, and W, shape (nv,).
_Tangent: TypeAlias = tuple[NDArray[Any], Floats]


class Rubbing:
    """Friction of each contact, and of each face that a sphere is stuck in.

    Letters: m contacts, s faces that a sphere is stuck in, which are no contacts, n velocities. Of
    a static and a dynamic coefficient the dynamic one counts for both, in simulations too
    (`impose`). All is read when it is first asked for.
    """

    def __init__(
        self, motion: EquationsOfMotion, diagram: Diagram, faces: tuple[SphereAndFace, ...]
    ) -> None:
        """Reads nothing yet.

        Args:
            motion: the contacts, and the variables of positions and velocities.
            diagram: of the plant and its scene graph.
            faces: those of the contacts, then those that spheres are stuck in, m + s.
        """
        self._q, self._v = motion.positions, motion.velocities
        self._num_contacts = motion.num_contacts
        self._diagram, self._faces = diagram, faces
        self._plant, self._scene_graph = find_plant(diagram)

    @cached_property
    def frictions(self) -> Mapping[str, float]:
        """The model's μ, by pair of shapes: those alone in which anything can slide with friction.

        Of a shape that gives none it is Drake's default, of two shapes 2 μ₁ μ₂ / (μ₁ + μ₂). Shapes
        that overlap wherever the joints are slide, too, though they are no contact.
        """
        pairs = zip(self._faces, self.model_coefficients, strict=True)
        return {face.pair: float(friction) for face, friction in pairs if friction > 0}

    @property
    def shapes(self) -> list[GeometryId]:
        """Those of all faces."""
        return [shape for face in self._faces for shape in face.shapes]

    def calc_coefficients(self, friction: float | None) -> Floats:
        """Returns μ of each contact, shape (m,); where nothing can slide it is 0.

        Args:
            friction: μ of all that slides; None: the model's.

        Raises:
            ModelError: a sphere can slide in two directions along a face where μ is not 0.
        """
        if friction is None and not self.frictions:  # Simulations ask this again and again.
            return self._none
        coefficients = self._calc_all(friction)[: self._num_contacts]
        for i in np.flatnonzero(coefficients):
            if self._tangents[i] is None:
                raise ModelError(
                    f"friction of {self._faces[i].pair}",
                    got=f"μ = {coefficients[i]:g} where the sphere can slide in two directions",
                    expected="motion in one plane, so that it slides along one line in the face",
                    remedy="Lock the joints that lead out of the plane, or leave friction out by "
                    "the scenario's friction: 0 (--friction 0).",
                )
        return coefficients

    @cached_property
    def tangents(self) -> NDArray[Any]:
        """T(q) of each contact, shape (m, n), Expressions: the slip velocity is s = T v [m/s].

        That of the sphere's material where it touches, as the face sees it, along the one direction
        in which it can slide (`_read_tangent`). Zero where it can't, or can in two.
        """
        nothing = np.full(self._v.size, Expression(0.0))
        rows = [nothing if each is None else each[0] for each in self._tangents]
        return np.array(rows, dtype=object).reshape(-1, nothing.size)

    @cached_property
    def spins(self) -> Floats:
        """W of each contact, shape (m, n): a sphere turns by e · ω = W v about the axis of sliding.

        T is for the lever r; for one that is longer by δ it is T − δ W.
        """
        rows = [np.zeros(self._v.size) if each is None else each[1] for each in self._tangents]
        return read_only(np.reshape(rows, (-1, self._v.size)))

    def calc_tangent_jacobian(self, q: Floats) -> Floats:
        """Returns T(q), shape (…, m, n), at q of shape (…, nq)."""
        return self.tangent_map(q)

    def calc_slips(self, q: Floats, v: Floats) -> Floats:
        """Returns s = T v, shape (…, m) [m/s], of rigid walls."""
        return (self.calc_tangent_jacobian(q) @ v[..., np.newaxis])[..., 0]

    def calc_tangent_bias(self, q: Floats, v: Floats) -> Floats:
        """Returns Ṫ v, which makes ṡ = T v̇ + Ṫ v, (…, m) [m/s²], at q (…, nq), v (…, n)."""
        return self._turning_map(q, v)

    @cached_property
    def tangent_map(self) -> SumMap:
        """T(q), shape (m, n)."""
        return SumMap(self.tangents, self._q)

    @cached_property
    def _turning_map(self) -> SumMap:
        return SumMap(calc_turning(self.tangents, self._q, self._v), self._q, self._v)

    def impose(self, root: Context, friction: float | None) -> None:
        """Gives all that slides one coefficient of friction, in this context only.

        Args:
            root: of the whole diagram.
            friction: μ; None: static coefficients become the dynamic ones.
        """
        source = self._plant.get_source_id()
        impose_friction(self._scene_graph, source, root, self.shapes, friction)

    def check(self, friction: float | None) -> None:
        """Checks that friction can act as it is asked for (`calc_coefficients`)."""
        if friction and not self._slides.any():
            raise ScenarioError(
                "friction",
                got=f"{friction:g}, in a world where no sphere can slide along anything",
                expected="0, or None, the model's",
                remedy="It would count for nothing.",
            )
        self.calc_coefficients(friction)
        self.check_none(friction, first=self._num_contacts)

    def check_none(self, friction: float | None, first: int = 0) -> None:
        """Checks that there is none from this face on, for planning without it."""
        coefficients = self._calc_all(friction)[first:]
        if coefficients.any():
            worst = first + int(np.argmax(coefficients))
            raise ModelError(
                f"friction of {self._faces[worst].pair}",
                got=f"μ = {coefficients[worst - first]:g} where the sphere can slide (Drake's "
                "default, if the shapes give none)",
                expected="0, for what plans here knows of no friction",
                remedy="Give one of both shapes <drake:mu_static>0</drake:mu_static> and "
                "<drake:mu_dynamic>0</drake:mu_dynamic>; or leave friction out of simulations by "
                "the scenario's friction: 0 (--friction 0).",
            )

    def _calc_all(self, friction: float | None) -> Floats:
        """Returns μ of each contact, and of each face that a sphere is stuck in, shape (m + s,)."""
        return self.model_coefficients if friction is None else friction * self._slides

    @cached_property
    def model_coefficients(self) -> Floats:
        """The model's μ of each contact, and of each face that a sphere is stuck in, (m + s,)."""
        pairs = [face.shapes for face in self._faces]
        return read_only(read_frictions(self._scene_graph, self._diagram, pairs) * self._slides)

    @cached_property
    def _none(self) -> Floats:
        return read_only(np.zeros(self._num_contacts))

    @cached_property
    def _slides(self) -> Floats:
        """1 for each face along which a sphere can slide, else 0."""
        return np.array(
            [float(_SphereMotion(self._plant, face).can_slide()) for face in self._faces]
        )

    @cached_property
    def _tangents(self) -> list[_Tangent | None]:
        faces = self._faces[: self._num_contacts]
        return [_read_tangent(self._plant, face, self._q) for face in faces]


def _read_tangent(plant: MultibodyPlant, face: SphereAndFace, q: NDArray[Any]) -> _Tangent | None:
    """Returns T(q) of a sphere on a face, (nv,) Expressions, and W; zeros where nothing can slide.

    The slip velocity is s = T v. Of the sphere's body S as the face's body sees it, with the
    velocity v_C of the sphere's center and the angular velocity ω,

        s = d · v_C − r e · ω,    d = e × n,    e · ω = W v,

    n being the face's normal and d the direction of sliding, which is fixed in the face; None if
    there is more than one. Two spheres that move about each other have n = p/R, with p from center
    to center and R the sum of radii, and e is the normal of the plane of motion. Compliant shapes
    overlap, which changes the lever r (`CompliantLaw`).
    """
    motion = _SphereMotion(plant, face)
    found = motion.find_turning() if motion.is_off_line else motion.find_sliding()
    if found is None:
        return None
    rates, axis = found
    try:
        tangent = tidy(interpolate(rates, q, find_hinges(plant), 1 + motion.is_off_line))
    except TooManySamples as error:
        raise ModelError(
            f"the slip velocity of {face.pair}",
            got=f"a function of {len(error.coordinates)} coordinates at once",
            expected="some six at most",
            remedy="Fix joints by the scenario's fixed_joints, or leave friction out.",
        ) from None
    compiled, probes = SumMap(tangent, q), motion.probes
    spins = np.array([axis @ motion.calc_rates(probe)[0] for probe in probes])
    errors = [np.max(np.abs(compiled(probe) - rates(probe))) for probe in probes]
    errors.append(np.max(np.abs(spins - spins[0])))
    size = max(np.max(np.abs(rates(probe))) for probe in probes)
    return (tangent, spins[0]) if max(errors) <= _ROUNDING * max(1.0, size) else None


class _SphereMotion:
    """How a sphere moves before a face, as numbers."""

    def __init__(self, plant: MultibodyPlant, face: SphereAndFace) -> None:
        self._plant, self._face = plant, face
        self._context = plant.CreateDefaultContext()
        steps = np.random.default_rng(0).uniform(-1.0, 1.0, (_NUM_PROBES, plant.num_positions()))
        self.probes = plant.GetDefaultPositions() + steps
        centers = np.array([self._calc_center(q) for q in self.probes])
        # Two spheres are no flat wall to each other, unless on one line.
        self.is_off_line = face.is_ball and bool(np.any(np.abs(centers[:, :2]) > _ROUNDING))

    def find_sliding(self) -> tuple[Callable[[Floats], Floats], Floats] | None:
        """Returns q → T along the one direction in a flat face, and e; None if there are two."""
        n, none = self._plant.num_velocities(), np.zeros(3)
        slips = np.hstack([self._calc_point(q)[:2] for q in self.probes])
        directions, sizes, _ = np.linalg.svd(slips, full_matrices=False)
        if sizes[0] <= _ROUNDING:
            return lambda q: np.zeros(n), none
        if sizes[1] > _ROUNDING * sizes[0]:
            return None
        d = _point(directions[:, 0])
        return lambda q: d @ self._calc_point(q)[:2], np.array([-d[1], d[0], 0.0])

    def find_turning(self) -> tuple[Callable[[Floats], Floats], Floats] | None:
        """Returns q → T of two spheres about each other, and e; None if not in one plane."""
        face = self._face
        middle, R = np.array([0.0, 0.0, -face.wall_radius]), face.sum_of_radii
        arms = np.array([self._calc_center(q) - middle for q in self.probes])
        _, sizes, axes = np.linalg.svd(arms)
        e = _point(axes[2])
        turns = np.hstack([self.calc_rates(q)[0] for q in self.probes])
        is_planar = sizes[2] <= _ROUNDING * sizes[0]
        if not is_planar or np.any(np.abs(turns - np.outer(e, e @ turns)) > _ROUNDING):
            return None

        def calc_slip(q: Floats) -> Floats:
            turning, moving = self.calc_rates(q)
            d = np.cross(e, self._calc_center(q) - middle) / R
            return np.asarray(d @ moving - face.radius * (e @ turning))

        return calc_slip, e

    def can_slide(self) -> bool:
        """Returns whether the sphere's point of contact can move along the face."""
        rates = self._calc_point(find_anywhere(self._plant))
        return bool(np.any(np.abs(rates[:2]) > _ROUNDING * np.max(np.abs(rates), initial=0.0)))

    def _calc_point(self, q: Floats) -> Floats:
        """Returns the Jacobian of the point below the center, in the face's frame, (3, nv)."""
        turning, moving = self.calc_rates(q)
        lever = self._face.radius
        return moving - lever * np.stack([turning[1], -turning[0], 0.0 * turning[2]])

    def _calc_center(self, q: Floats) -> Floats:
        """Returns the sphere's center in the face's frame, shape (3,) [m]."""
        self._plant.SetPositions(self._context, q)
        return self._face.calc_center(self._plant, self._context)

    def calc_rates(self, q: Floats) -> tuple[Floats, Floats]:
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
