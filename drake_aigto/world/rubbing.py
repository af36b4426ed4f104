"""Where contacts rub: friction as the model or a scenario has it, and how what rubs slips."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import GeometryId
from pydrake.multibody.plant import CoulombFriction
from pydrake.symbolic import Expression
from pydrake.systems.framework import Context, Diagram

from drake_aigto.arrays import Floats, read_only
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.world.contact import SphereAndFace
from drake_aigto.world.diagram import find_plant, hide_half_space_warning
from drake_aigto.world.friction import calc_friction_share
from drake_aigto.world.law import CompliantLaw, ContactLaw, calc_levers
from drake_aigto.world.material import can_slide, read_friction, set_friction
from drake_aigto.world.reach import ReachableFace
from drake_aigto.world.sums import SumMap, calc_turning
from drake_aigto.world.tangent import read_tangent


class Rubbing:
    """Friction of each contact, and of each face that a sphere is stuck in.

    Letters: m contacts, s faces that a sphere is stuck in, which are no contacts, n velocities. Of
    a static and a dynamic coefficient the dynamic one counts for both, in simulations too
    (`impose`). All is read when it is first asked for.
    """

    def __init__(
        self,
        diagram: Diagram,
        q: NDArray[Any],
        v: NDArray[Any],
        reachable: Sequence[ReachableFace],
        stuck: Sequence[SphereAndFace],
        stiction_speed: float,
    ) -> None:
        """Reads nothing yet.

        Args:
            diagram: of the plant and its scene graph.
            q: the variables of positions, shape (nq,).
            v: the variables of velocities, shape (n,).
            reachable: the contacts, m.
            stuck: faces that spheres are stuck in, s.
            stiction_speed: v_s of friction in the plant [m/s].
        """
        self._diagram, self._q, self._v = diagram, q, v
        self._plant, self._scene_graph = find_plant(diagram)
        self._faces = *(each.face for each in reachable), *stuck
        self._num_contacts = len(reachable)
        self._distances = np.array([each.contact.signed_distance for each in reachable])
        self._reaches = np.array([each.reach for each in reachable])
        self._stiction_speed = stiction_speed

    @cached_property
    def _distance_map(self) -> SumMap:
        """φ(q), shape (m,)."""
        return SumMap(self._distances, self._q)

    @cached_property
    def frictions(self) -> Mapping[str, float]:
        """The model's μ, by pair of shapes: those alone in which anything can slide, and rubs.

        Of a shape that gives none it is Drake's default, of two shapes 2 μ₁ μ₂ / (μ₁ + μ₂). Shapes
        that overlap wherever the joints are slide, too, though they are no contact.
        """
        pairs = zip(self._faces, self.model_coefficients, strict=True)
        return {face.pair: float(friction) for face, friction in pairs if friction > 0}

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
                raise _refuse_two_directions(self._faces[i].pair, float(coefficients[i]))
        return coefficients

    @cached_property
    def tangents(self) -> NDArray[Any]:
        """T(q) of each contact, shape (m, n), Expressions: the slip velocity is s = T v [m/s].

        That of the sphere's material where it touches, as the face sees it, along the one direction
        in which it can slide (`read_tangent`). Zero where it can't, or can in two.
        """
        return self._stack(self._tangents)

    @cached_property
    def soft_tangents(self) -> NDArray[Any]:
        """The same where walls yield: at the point on which the plant's contact force acts."""
        return self._stack(self._read_tangents(yields=True))

    def calc_tangent_jacobian(self, q: Floats, yields: bool = False) -> Floats:
        """Returns T(q), shape (…, m, n), at q of shape (…, nq), where walls yield or do not."""
        read = self.soft_tangent_map if yields else self._tangent_map
        return read(q).reshape(*q.shape[:-1], self._num_contacts, self._v.size)

    def calc_slips(self, q: Floats, v: Floats, yields: bool = False) -> Floats:
        """Returns s, shape (…, m) [m/s], where walls yield or do not.

        That is T v, and T v R/l of two spheres that move about each other and yield (see
        `CompliantLaw`).
        """
        slips = (self.calc_tangent_jacobian(q, yields) @ v[..., np.newaxis])[..., 0]
        if yields and self._reaches.any():
            slips *= calc_levers(self._reaches, self._distance_map(q))
        return slips

    def calc_tangent_bias(self, q: Floats, v: Floats) -> Floats:
        """Returns Ṫ v, which makes ṡ = T v̇ + Ṫ v, (…, m) [m/s²], at q (…, nq), v (…, n)."""
        return self._turning_map(np.concatenate([q, v], axis=-1))

    def calc_drag(self, law: ContactLaw, q: Floats, v: Floats, forces: Floats) -> Floats | None:
        """Returns friction where walls yield as forces on q, −Tᵀ μ f σ(s / v_s), shape (…, n) [N].

        None where no wall yields and rubs. T is that of `soft_tangents`, s of
        `calc_slips`, σ of `calc_friction_share`.

        Args:
            law: of contact.
            q: shape (…, nq) [m].
            v: shape (…, n) [m/s].
            forces: f that contacts push with, shape (…, m) [N].
        """
        if not (isinstance(law, CompliantLaw) and law.rubs):
            return None
        T = self.calc_tangent_jacobian(q, yields=True)
        shares = calc_friction_share(self.calc_slips(q, v, yields=True), self._stiction_speed)
        return -((law.friction * forces * shares)[..., np.newaxis, :] @ T)[..., 0, :]

    def _stack(self, rows: Sequence[NDArray[Any] | None]) -> NDArray[Any]:
        """Returns rows as an array, zero where there is none."""
        nothing = np.full(self._v.size, Expression(0.0))
        stacked = [nothing if row is None else row for row in rows]
        return np.array(stacked, dtype=object).reshape(self._num_contacts, nothing.size)

    @cached_property
    def _tangent_map(self) -> SumMap:
        """T(q), row by row, shape (m n,)."""
        return SumMap(self.tangents.ravel(), self._q)

    @cached_property
    def soft_tangent_map(self) -> SumMap:
        """The same of walls that yield."""
        return SumMap(self.soft_tangents.ravel(), self._q)

    @cached_property
    def _turning_map(self) -> SumMap:
        """Ṫ v of q and v, shape (m,)."""
        turns = calc_turning(self.tangents, self._q, self._v)
        return SumMap(turns, np.concatenate([self._q, self._v]))

    def impose(self, root: Context, friction: float | None) -> None:
        """Gives all that slides one coefficient of friction, in this context only.

        Args:
            root: of the whole diagram.
            friction: μ; None: static coefficients become the dynamic ones.
        """
        source = self._plant.get_source_id()
        for shape in self._find_unlike(friction):
            set_friction(self._scene_graph, source, root, shape, friction)

    def check(self, friction: float | None) -> None:
        """Checks that friction can act as it is asked for (`calc_coefficients`).

        Raises:
            ScenarioError: nothing can slide with it.
            ModelError: it acts where a sphere can slide in two directions, or is stuck in a shape.
        """
        if friction and not self._slides.any():
            raise _refuse_idle(friction)
        self.calc_coefficients(friction)
        self._refuse_any(friction, range(self._num_contacts, len(self._faces)))

    def check_none(self, friction: float | None) -> None:
        """Checks that there is none, for who plans without it.

        Raises:
            ModelError: there is; says where.
        """
        self._refuse_any(friction, range(len(self._faces)))

    def _refuse_any(self, friction: float | None, indices: Sequence[int]) -> None:
        """Refuses friction at these faces."""
        coefficients = self._calc_all(friction)
        worst = max(indices, key=coefficients.__getitem__, default=None)
        if worst is not None and coefficients[worst] > 0:
            raise _refuse_friction(self._faces[worst].pair, float(coefficients[worst]))

    def _calc_all(self, friction: float | None) -> Floats:
        """Returns μ of each contact, and of each face that a sphere is stuck in, shape (m + s,)."""
        if friction is None:
            return self.model_coefficients
        return friction * self._slides if friction else np.zeros(len(self._faces))

    @cached_property
    def _friction(self) -> tuple[CoulombFriction, ...]:
        with hide_half_space_warning():
            root = self._diagram.CreateDefaultContext()
        return tuple(
            read_friction(self._plant, self._scene_graph, root, face) for face in self._faces
        )

    @cached_property
    def model_coefficients(self) -> Floats:
        """The model's μ of each contact, and of each face that a sphere is stuck in, (m + s,)."""
        return read_only([each.dynamic_friction() for each in self._friction])

    @cached_property
    def _none(self) -> Floats:
        """No friction of each contact, shape (m,)."""
        return read_only(np.zeros(self._num_contacts))

    @cached_property
    def _slides(self) -> Floats:
        """1 for each face along which a sphere can slide, else 0."""
        return np.array([float(can_slide(self._plant, face)) for face in self._faces])

    @cached_property
    def _tangents(self) -> list[NDArray[Any] | None]:
        return self._read_tangents(yields=False)

    def _read_tangents(self, yields: bool) -> list[NDArray[Any] | None]:
        return [
            read_tangent(self._plant, self._scene_graph, face, self._q, yields)
            for face in self._faces[: self._num_contacts]
        ]

    def _find_unlike(self, friction: float | None) -> set[GeometryId]:
        """Returns the shapes that slide with other friction than they should."""
        if friction:
            return {shape for face in self._faces for shape in face.shapes}
        pairs = list(zip(self._faces, self._friction, strict=True))
        if friction is None:
            unlike = (f for f, mu in pairs if mu.static_friction() != mu.dynamic_friction())
            return {shape for face in unlike for shape in face.shapes}
        return {face.shapes[0] for face, mu in pairs if mu.static_friction() > 0}


def _refuse_friction(pair: str, friction: float) -> ModelError:
    """Returns the error of friction that would act in Drake, and in no plan."""
    return ModelError(
        f"friction of {pair}",
        got=f"μ = {friction:g} where the sphere can slide (Drake's default, if the "
        "shapes give none)",
        expected="0, for what plans here knows of no friction",
        remedy="Give one of both shapes <drake:mu_static>0</drake:mu_static> and "
        "<drake:mu_dynamic>0</drake:mu_dynamic>; or leave friction out of simulations by the "
        "scenario's friction: 0 (--friction 0).",
    )


def _refuse_two_directions(pair: str, friction: float) -> ModelError:
    """Returns the error of friction where a sphere does not slide to and fro alone."""
    return ModelError(
        f"friction of {pair}",
        got=f"μ = {friction:g} where the sphere can slide in two directions",
        expected="motion in one plane, so that it slides along one line in the face",
        remedy="Lock the joints that lead out of the plane, or leave friction out by the "
        "scenario's friction: 0 (--friction 0).",
    )


def _refuse_idle(friction: float) -> ScenarioError:
    """Returns the error of friction that a scenario asks for where nothing slides."""
    return ScenarioError(
        "friction",
        got=f"{friction:g}, in a world where no sphere can slide along anything",
        expected="0, or None, the model's",
        remedy="It would count for nothing.",
    )
