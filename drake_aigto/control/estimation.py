"""Masses, friction, walls and forces that a model has wrong, from what was commanded and seen."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, get_args

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, EventStatus, LeafSystem, State

from drake_aigto.arrays import Floats
from drake_aigto.control.family import ModelFamily, Parameter, Unknown
from drake_aigto.control.loop_run import Disturbance
from drake_aigto.control.model import Model
from drake_aigto.control.ports import check_seconds
from drake_aigto.errors import ControlError
from drake_aigto.simulation import HeldControl, tangent_scales
from drake_aigto.world import Scales, Scenario, SpaceWorld, World

_FACTORS = ("mass", "friction", "stiffness")

# Standard deviations of a prediction's errors, in the task's scales of q and v.
_NOISE = 2e-3, 1e-2
# An error larger than this number of standard deviations, as of a kick, counts less.
_LARGE = 3.0
# What is seen counts e times less after this number of samples.
_WINDOW = 100.0
# Predictions are differentiated over this share of a parameter's unit, and linear as far from where
# the model was built; no sample tells more than the second one.
_LINEAR, _CURVED = 0.1, 0.05
# Models are built anew so often at one sample, at most. Of the ticks of cart_pole/soft_06 the
# longest took 4.2 medians after a kick, with up to 2 builds 5.3; costs differed by 0.04 % at most.
_BUILDS = 1
# The noise and the values that leave it are found in turn, so often.
_TURNS = 3
# Factors stay between these; walls and forces within this number of units.
_LEAST, _MOST, _FARTHEST = 0.2, 5.0, 2.0
# A unit of walls, in the task's length; and how deep in one a sample may be that was not foreseen,
# in such units.
_WALL, _DEPTHS = 0.1, (0.01, 0.02, 0.04, 0.08, 0.16)


@dataclass(frozen=True, eq=False)
class ModelEstimate:
    """Recursive Gauss-Newton estimate of a model's parameters p, shape (P,).

    Between two samples the model predicts x̂(p), by simulation under the command, so that the error

        x − x̂(p) ≈ x − x̂(p₀) − Φ (p − p₀),    Φ_i = (x̂(p₀ + h_i) − x̂(p₀ − h_i)) / 2h_i,

    and p minimizes Σ wₖ ‖x − x̂(p)‖² / s²σ² + ‖p − p_model‖² / σ_p² with weights that fall by a
    factor e in a hundred samples, as Cauchy's for errors above 3 sσ that doubts about p do not
    explain. The noise is as large as the errors that p leaves: s² is their mean, and at least 1.
    What is not linear counts as noise, of covariance Σ b_i b_iᵀ + Φ δ² Φᵀ beside s²σ²: no sample
    tells p better than δ, and bends b_i = (x̂(p₀ + h_i) − 2x̂(p₀) + x̂(p₀ − h_i)) / 2 are taken as
    far as p_i is in doubt, σ_i: they grow by (σ_i / h_i)². So a sample in which something begins to
    slip tells little while friction is not known. (Second differences are those of Nørgaard,
    Poulsen and Ravn's filter, Automatica 2000.) Where p has left p₀ by h, a tenth of σ_p, or by
    half of its doubt σ, the model is built anew, about p, and that sample looked at again.

    A wall that the model has out of reach changes no prediction if it moves a little. So where p
    leaves an error above 3 sσ, it is also looked for from where a wall is as near as to be touched.

    Attributes:
        world: that the model was thought to be.
        scenario: its task.
        parameters: what is estimated.
        family: models with any values of these.
        values: p.
        sums: Σ wₖ Φᵀ Φ, shape (P, P), Σ wₖ Φᵀ y, shape (P,), Σ wₖ yᵀ y, and Σ wₖ of numbers y, over
            σ, with y = x − x̂(p₀) + Φ (p₀ − p_model).
        about: p₀.
        models: at p₀, at p₀ with each parameter higher, and with each lower.
        scales: standard deviations σ of a prediction's errors, shape (2 nv,).
    """

    world: World
    scenario: Scenario
    parameters: tuple[Parameter, ...]
    family: ModelFamily
    values: Floats
    sums: tuple[Floats, Floats, float, float]
    about: Floats
    models: tuple[Model, ...]
    scales: Floats

    @classmethod
    def of(cls, world: World, scenario: Scenario, unknown: Sequence[Unknown]) -> ModelEstimate:
        """Returns what is known before anything is seen: the model.

        Args:
            world: the model.
            scenario: its task.
            unknown: of "mass", a factor of all masses and inertias; "friction", of all friction;
                "stiffness", of all compliant walls; "walls", by how much nearer each stands [m];
                and "force", one that acts on each coordinate all the time [N, N m].

        Raises:
            ControlError: no list of different names, an unknown one, or one that the model has
                nothing of.
        """
        parameters = tuple(_list_parameters(world, scenario, unknown))
        usual, none = np.array([each.usual for each in parameters]), np.zeros(len(parameters))
        empty = np.diag(none), none, 0.0, 0.0
        scales = np.repeat(_NOISE, world.num_velocities) * tangent_scales(world, scenario)
        family = ModelFamily(Model(world, world.place(scenario)), parameters)
        return cls(world, scenario, parameters, family, usual, empty, usual, (), scales).build()

    def __deepcopy__(self, memo: object) -> ModelEstimate:
        """Returns itself: it never changes."""
        return self

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(each.name for each in self.parameters)

    @cached_property
    def is_of_the_model(self) -> bool:
        """Whether p₀ is the model's."""
        return bool(np.all(self.about == self._usual))

    @cached_property
    def noise(self) -> float:
        """s², by which the noise of samples is larger than it is thought to be: at least 1."""
        (information, slopes, squares, count), off = self.sums, self.values - self._usual
        left = squares - 2.0 * slopes @ off + off @ information @ off
        least = 2.0 * self.world.num_velocities  # As much is thought of it as a sample tells.
        return max(1.0, float((least + left) / (least + count)))

    @cached_property
    def covariance(self) -> Floats:
        """Covariance of the values, shape (P, P)."""
        precision: Floats = self.sums[0] / self.noise + np.diag(self._units**-2.0)
        return np.asarray(np.linalg.inv(precision), dtype=float)

    @cached_property
    def deviations(self) -> Floats:
        """Standard deviations of the values, shape (P,)."""
        return np.sqrt(np.diag(self.covariance))

    @cached_property
    def wall_doubts(self) -> Floats:
        """Standard deviations of where each contact's wall stands; 0: not estimated, (m,) [m]."""
        doubts = np.zeros(self.world.num_contacts)
        for each, off in zip(self.parameters, self.deviations, strict=True):
            if each.kind == "walls":
                doubts[each.which] = off
        return doubts

    @cached_property
    def _usual(self) -> Floats:
        return np.array([each.usual for each in self.parameters])

    @cached_property
    def _units(self) -> Floats:
        return np.array([each.unit for each in self.parameters])

    def build(self) -> ModelEstimate:
        """Returns the same with models about its values."""
        steps = np.diag(_LINEAR * self._units)
        changed = [self.values, *(self.values + steps), *(self.values - steps)]
        models = tuple(map(self.family.find, changed))
        return dataclasses.replace(self, about=self.values, models=models)

    def watch(self, samples: tuple[Floats, Floats], held: HeldControl) -> ModelEstimate:
        """Returns what is known after another sample.

        Args:
            samples: q and v before and after, shape (nq + n,) each.
            held: the commands that acted between.
        """
        if not np.all(np.isfinite(samples)):
            return self
        errors, builds = self._predict(samples, held), iter(range(_BUILDS))
        found = self._pass(self, samples, held, errors, builds)
        if errors is not None and self._weigh(errors[0]) <= _LARGE**2:
            return found
        tried = [found.values, *self._list_nearer(samples[1])]
        best = tried[int(np.argmin([self._price(values, samples, held) for values in tried]))]
        if best is found.values:
            return found
        near, most = best, self._price(best, samples, held)
        for _ in builds:
            known = dataclasses.replace(self, values=near).build()
            found = self._pass(known, samples, held, known._predict(samples, held), builds)
            if self._price(found.values, samples, held) <= most:
                break
            near = (best + found.values) / 2.0  # Beyond the impact that it began from.
        return found

    def _pass(
        self,
        known: ModelEstimate,
        samples: tuple[Floats, Floats],
        held: HeldControl,
        errors: Floats | None,
        builds: Iterator[int],
    ) -> ModelEstimate:
        """Returns what is known after a sample, with models about its values if builds are left.

        Errors are those of what is known.
        """
        while True:
            found = known if errors is None else known._update(errors, self)
            near = np.minimum(_LINEAR * self._units, found.deviations / 2.0)
            is_near = np.all(np.abs(found.values - found.about) <= near)
            if is_near or next(builds, None) is None:
                return found
            known = found.build()
            errors = known._predict(samples, held)

    def _list_nearer(self, x: Floats) -> Iterator[Floats]:
        """Yields values with one wall as near as touches a state that it seems to be off."""
        distances = self.models[0].world.calc_signed_distance(self.world.split(x)[0])
        for i, each in enumerate(self.parameters):
            if each.kind == "walls" and 0 < distances[each.which] < each.upper - self.about[i]:
                for depth in _DEPTHS:
                    nearer = self.about.copy()
                    nearer[i] += distances[each.which] + depth * each.unit
                    yield nearer

    def _price(self, values: Floats, samples: tuple[Floats, Floats], held: HeldControl) -> float:
        """Returns how unlikely values are by a sample, and by what was known before."""
        errors = self._calc_errors([self.family.find(values)], samples, held)
        if errors is None:
            return np.inf
        off = values - self.values
        before = float(off @ np.linalg.solve(self.covariance, off))
        return 2 * self.world.num_velocities * self._weigh(errors) + before

    def _predict(self, samples: tuple[Floats, Floats], held: HeldControl) -> Floats | None:
        """Returns the errors of all models, shape (1 + 2P, 2 nv); None: one predicts nothing."""
        return self._calc_errors(self.models, samples, held)

    def _calc_errors(
        self, models: Sequence[Model], samples: tuple[Floats, Floats], held: HeldControl
    ) -> Floats | None:
        """Returns predictions' errors over σ, shape (K, 2 nv); None: a model predicts nothing."""
        found = [model.find_end(samples[0], held) for model in models]
        ends = np.array([end for end in found if end is not None])
        if len(ends) < len(found):
            return None
        return np.asarray(self.world.calc_error(samples[1], ends) / self.scales)

    def _weigh(self, errors: Floats) -> float:
        """Returns the mean square of a prediction's errors, in standard deviations."""
        return float(np.mean(errors**2) / self.noise)

    def _update(self, errors: Floats, before: ModelEstimate) -> ModelEstimate:
        """Returns the same after a sample, linear about p₀, with what was known before it."""
        expected, (above, below) = errors[0], np.split(errors[1:], 2)
        steps = _LINEAR * self._units
        slopes = (below - above).T / (2.0 * steps)
        bends = (above + below - 2.0 * expected).T * np.maximum(before.deviations / steps, 1.0) ** 2
        spread = np.hstack([bends / 2.0, slopes * _CURVED * self._units])
        noise = before.noise * np.eye(len(expected)) + spread @ spread.T
        likely = noise + slopes @ before.covariance @ slopes.T
        error = expected - slopes @ (before.values - self.about)
        trust = before.noise * np.linalg.inv(noise)
        trust /= 1 + error @ np.linalg.solve(likely, error) / len(error) / _LARGE**2
        kept, y = np.exp(-1 / _WINDOW), expected + slopes @ (self.about - self._usual)
        told = slopes.T @ trust @ slopes, slopes.T @ trust @ y, y @ trust @ y, np.trace(trust)
        sums = tuple(kept * old + new for old, new in zip(before.sums, told, strict=True))
        return dataclasses.replace(self, values=before.values, sums=sums)._solve()

    def _solve(self) -> ModelEstimate:
        """Returns the same with the likeliest values, and the noise that they leave."""
        lower, upper = np.array([each[-2:] for each in self.parameters]).T
        known = self
        for _ in range(_TURNS):
            values = self._usual + known.covariance @ self.sums[1] / known.noise
            known = dataclasses.replace(known, values=np.clip(values, lower, upper))
        return known


def _list_parameters(
    world: World, scenario: Scenario, unknown: Sequence[Unknown]
) -> Iterator[Parameter]:
    is_list = isinstance(unknown, Iterable) and not isinstance(unknown, str)
    names = list(unknown) if is_list else []
    if not is_list or len(set(map(str, names))) < len(names):
        expected = 'a list of different names, such as ["mass", "friction"]'
        raise ControlError("estimate", got=repr(unknown), expected=expected)
    scales = Scales.of(world, scenario)
    for kind in names:
        if kind == "stiffness" and not (scenario.contact == "compliant" and world.contacts):
            raise ControlError(
                "estimate", got="no compliant wall", expected="walls with a stiffness"
            )
        if kind in _FACTORS:
            if kind == "friction":
                Disturbance().change_friction(world, scenario)  # Refuses where there is none.
            yield Parameter(kind, kind, 0, 1.0, 0.3, _LEAST, _MOST)
        elif kind == "walls":
            unit = _WALL * scales.length
            alone = [faces[0] for faces in world.solids if _can_move(world, faces)]
            for i in alone:
                name, most = f"wall of {world.contacts[i].name}", _FARTHEST * unit
                yield Parameter(name, kind, i, 0.0, unit, -most, most)
            if not alone:
                got, expected = "no wall of one face", "walls that can stand nearer"
                raise ControlError("estimate", got=got, expected=expected)
        elif kind == "force" and not isinstance(world, SpaceWorld):
            pushes = np.max(np.abs(world.bounds(scenario).control), axis=0)
            unit = float(np.max(pushes[np.isfinite(pushes)], initial=0.0)) or 1.0
            names = world.plant.GetPositionNames()
            for i in range(world.num_velocities):
                yield Parameter(f"force on {names[i]}", kind, i, 0.0, unit, -np.inf, np.inf)
        else:
            expected = f"some of {', '.join(get_args(Unknown))}; in space no force"
            raise ControlError("estimate", got=kind, expected=expected)


def _can_move(world: World, faces: Sequence[int]) -> bool:
    """Returns whether a wall has one face, and stands still; none in space does."""
    if world.in_space or len(faces) > 1:
        return False
    return bool(world.plant.IsAnchored(world.find_wall(faces[0])))


class _Seen(NamedTuple):
    """The last sample of a `ModelEstimator`: its time, q and v, and u; and what is known."""

    last: tuple[float, Floats, Floats] | None
    known: ModelEstimate


class ModelEstimator(LeafSystem):
    """A system that estimates what a model has wrong: `ModelEstimate`, sampled every period.

    Input ports: `estimated_state`, q and v; and `control`, u as it acts on the plant, which is held
    from one sample to the next. Output ports: `values` and `deviations`, shape (P,) each, in the
    order of `names`.

    Attributes:
        names: of what is estimated.
    """

    def __init__(
        self, world: World, scenario: Scenario, unknown: Sequence[Unknown], period: float
    ) -> None:
        """Builds the models; arguments are those of `ModelEstimate.of`, and the period [s].

        Raises:
            ControlError: see there; or the period is not above zero.
        """
        super().__init__()
        period = check_seconds("period", period, is_positive=True)
        known = ModelEstimate.of(world, scenario, unknown)
        self.names, nx = known.names, world.num_positions + world.num_velocities
        self._state = self.DeclareVectorInputPort("estimated_state", nx)
        self._control = self.DeclareVectorInputPort("control", world.num_actuators)
        self._known = self.DeclareAbstractState(AbstractValue.Make(_Seen(None, known)))
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._sample)
        held, size = {self.abstract_state_ticket(self._known)}, len(self.names)
        for name in ("values", "deviations"):

            def write(context: Context, output: BasicVector, name: str = name) -> None:
                output.SetFromVector(getattr(self.read(context), name))

            self.DeclareVectorOutputPort(name, size, write, held)

    def read(self, context: Context) -> ModelEstimate:
        """Returns what is known by now, in its own context."""
        seen: _Seen = context.get_abstract_state(int(self._known)).get_value()
        return seen.known

    def _sample(self, context: Context, state: State) -> EventStatus:
        kept, now = state.get_mutable_abstract_state(int(self._known)), float(context.get_time())
        (last, known), x = kept.get_value(), np.array(self._state.Eval(context))
        if last is not None:
            times = np.array([last[0], now])
            known = known.watch((last[1], x), HeldControl(times, last[2][np.newaxis]))
        kept.set_value(_Seen((now, x, np.array(self._control.Eval(context))), known))
        return EventStatus.Succeeded()
