"""Additions of users to a program over knots, at whatever times the knots of another one are."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.solvers import Constraint, Cost, EvaluatorBase
from pydrake.symbolic import MakeVectorVariable, Variable

from drake_aigto.arrays import Floats, Ints
from drake_aigto.errors import ProgramError
from drake_aigto.transcription.rows import formula_rows, is_affine_in_one, shared_constraint

Part = Literal["q", "v", "u"]

# A bound is met within this part of 1 + its size: rounding.
_ROUNDING = 1e-12
# A knot is at a time if it is no farther from it than this part of the duration: rounding.
_LATE = 1e-9

_MOST_LISTED = 3  # Variables in a name.


class Place(NamedTuple):
    """One coordinate of the state or of the control at a knot.

    Attributes:
        part: "q", "v" or "u".
        coordinate: which one.
        knot: k of the transcription that users added to; None: any knot, one after the other.
    """

    part: Part
    coordinate: int
    knot: int | None = None


@dataclass(frozen=True, eq=False)
class Addition:
    """A cost or a constraint of a user.

    Attributes:
        name: its description, or its variables.
        evaluator: as Drake made it.
        places: of its variables.
    """

    name: str
    evaluator: EvaluatorBase
    places: tuple[Place, ...]

    @property
    def is_cost(self) -> bool:
        """Whether it is a cost, not a constraint."""
        return isinstance(self.evaluator, Cost)

    @property
    def reads_control(self) -> bool:
        """Whether it reads any control."""
        return any(place.part == "u" for place in self.places)

    def knots(self, num_steps: int) -> range:
        """Returns the knots for a place of any knot, in a motion with this number of steps."""
        if all(place.knot is not None for place in self.places):
            return range(1)
        return range(num_steps if self.reads_control else num_steps + 1)

    def read(
        self, arrays: Mapping[Part, NDArray[Any]], k: int, row: Callable[[int], int] = int
    ) -> NDArray[Any]:
        """Returns what it reads of q, v and u by rows: knot j is in row(j), any knot in row k."""
        return np.array([arrays[part][k if j is None else row(j), i] for part, i, j in self.places])

    @property
    def is_of_start(self) -> bool:
        """Whether it only reads the state at the first knot."""
        return not self.reads_control and all(not place.knot for place in self.places)


class Samples(NamedTuple):
    """A motion, planned or simulated, at the K + 1 knots where its control changes.

    Attributes:
        times: shape (K+1,) [s].
        q: positions, shape (K+1, nq).
        v: velocities, at an impact those before it, shape (K+1, nv).
        u: controls, held from each knot to the next, shape (K, nu).
    """

    times: Floats
    q: Floats
    v: Floats
    u: Floats


@dataclass(frozen=True, eq=False)
class Additions:
    """All additions of users to a transcription.

    Additions at knot k are at its time t_k. A control u_k is that of all of t_k … t_{k+1}:
    over this time it is held in any program that these are added to.

    Attributes:
        running: costs g(x_k, u_k) of every step, to be multiplied by its length.
        final: costs of x_N.
        everywhere: constraints on every x_k, or on every (x_k, u_k).
        at_knots: costs and constraints on the variables of some knots.
        times: t_k of the transcription that they were added to, shape (N+1,) [s].
        scales: by how much "q", "v" and "u" differ in this task.
    """

    running: tuple[Addition, ...] = ()
    final: tuple[Addition, ...] = ()
    everywhere: tuple[Addition, ...] = ()
    at_knots: tuple[Addition, ...] = ()
    times: Floats = field(default_factory=lambda: np.zeros(1))
    scales: Mapping[Part, float] = field(default_factory=dict)

    def __bool__(self) -> bool:
        """Returns whether there is anything."""
        return bool(self.running or self.final or self.everywhere or self.at_knots)

    @property
    def are_everywhere(self) -> bool:
        """Whether some are about every knot."""
        return bool(self.running or self.everywhere)

    def joined(self, other: Additions) -> Additions:
        """Returns the additions of both, with the knots of this one."""
        return replace(
            self,
            running=(*self.running, *other.running),
            final=(*self.final, *other.final),
            everywhere=(*self.everywhere, *other.everywhere),
            at_knots=(*self.at_knots, *other.at_knots),
        )

    @property
    def held(self) -> tuple[int, ...]:
        """The knots k with additions on their control u_k, in order."""
        places = (place for each in self.at_knots for place in each.places)
        return tuple(sorted({place.knot or 0 for place in places if place.part == "u"}))

    @property
    def knots(self) -> tuple[int, ...]:
        """The knots at whose times another program needs a knot, too, in order."""
        places = (place for each in self.at_knots for place in each.places)
        knots = {place.knot or 0 for place in places if place.part != "u"}
        return tuple(sorted(knots.union(*((k, k + 1) for k in self.held))))

    @property
    def instants(self) -> Floats:
        """The times of these, without start and end, shape (I,) [s]."""
        ends = 0, len(self.times) - 1
        return self.times[[k for k in self.knots if k not in ends]]

    @property
    def constraints(self) -> tuple[Addition, ...]:
        """All constraints."""
        return tuple(e for e in (*self.everywhere, *self.at_knots) if not e.is_cost)

    def costs(self, motion: Samples) -> dict[str, float]:
        """Returns each cost of a motion by name: Σ_k h_k g(x_k, u_k), e(x_N), or c(x_j, u_k, …)."""
        found: dict[str, float] = {}
        last = len(motion.u)
        for each in self.running:
            steps = enumerate(np.diff(motion.times).tolist())
            values = (h * self._value(each, motion, k)[0] for k, h in steps)
            found[each.name] = found.get(each.name, 0.0) + float(sum(values))
        for each in (*self.final, *filter(lambda each: each.is_cost, self.at_knots)):
            value = float(self._value(each, motion, last)[0])
            found[each.name] = found.get(each.name, 0.0) + value
        return found

    def violations(self, motion: Samples) -> dict[str, float]:
        """Returns a motion's violation of each constraint, by name; 0 if it is met.

        A row g(x) that violates its bound by r counts as r / Σ_i |∂g/∂x_i| s_i: to first order,
        the change of each x_i, in units of the task's `scales` s_i, that meets it. If the motion
        has no knot at a constraint's time, the difference, relative to the duration, counts.
        """
        found: dict[str, float] = {}
        for each in self.constraints:
            missed = (self._violation(each, motion, k) for k in each.knots(len(motion.u)))
            knots = {place.knot for place in each.places if place.knot is not None}
            late = [abs(motion.times[self._row(k, motion.times)] - self.times[k]) for k in knots]
            parts = max(late, default=0.0) / float(self.times[-1])
            off = parts if parts > _LATE else 0.0
            found[each.name] = max(found.get(each.name, 0.0), off, *missed)
        return found

    def miss_at_start(self, addition: Addition, q: Floats, v: Floats) -> float:
        """Returns the initial state's violation of a constraint, as in `violations`."""
        start = Samples(np.zeros(1), q[np.newaxis], v[np.newaxis], np.empty((0, 0)))
        return self._violation(addition, start, 0)

    def units(self, addition: Addition) -> Floats:
        """Returns Σ_i |∂g/∂x_i| s_i of each row of a constraint, the largest about 0 and ±s."""
        s = self._scales(addition)
        found = [np.abs(_slopes(addition, x)) @ s for x in (0 * s, s, -s)]
        largest = np.max(found, axis=0)
        return np.where(np.isfinite(largest) & (largest > 0), largest, 1.0)

    def _violation(self, addition: Addition, motion: Samples, k: int) -> float:
        value = self._value(addition, motion, k)
        lower, upper = addition.evaluator.lower_bound(), addition.evaluator.upper_bound()
        excess = np.maximum(lower - value, value - upper)
        missed = ~(excess <= _ROUNDING * (1 + np.abs(np.where(lower > value, lower, upper))))
        if not np.any(missed):
            return 0.0
        slopes = np.abs(_slopes(addition, self._values(addition, motion, k)))
        with np.errstate(divide="ignore"):
            parts = excess[missed] / (slopes[missed] @ self._scales(addition))
        return float(np.max(np.nan_to_num(parts, nan=np.inf, posinf=np.inf)))

    def _scales(self, addition: Addition) -> Floats:
        return np.array([self.scales[place.part] for place in addition.places])

    def _value(self, addition: Addition, motion: Samples, k: int) -> Floats:
        return np.asarray(addition.evaluator.Eval(self._values(addition, motion, k)), dtype=float)

    def _values(self, addition: Addition, motion: Samples, k: int) -> Floats:
        """Returns what an addition reads of a motion, places of any knot at the motion's k-th."""
        arrays: Any = motion._asdict()
        return addition.read(arrays, k, partial(self._row, times=motion.times))

    def _row(self, knot: int, times: Floats) -> int:
        """Returns which of a motion's knots is at the time of knot k here, or nearest to it."""
        return int(np.argmin(np.abs(times - self.times[knot])))


NO_ADDITIONS = Additions()


def _slopes(addition: Addition, x: Floats) -> Floats:
    """Returns ∂g/∂x of each row, shape (rows, variables)."""
    values = np.asarray(addition.evaluator.Eval(InitializeAutoDiff(x).ravel()))
    return np.asarray(ExtractGradient(values), dtype=float)


def read_binding(
    evaluator: EvaluatorBase,
    variables: Sequence[Variable] | NDArray[Any],
    places: Mapping[int, Place],
    expected: str,
    remedy: str,
) -> Addition:
    """Returns a cost or constraint with its variables as places, by their ids.

    A message tells which variables are expected, and what to do where there is another one.
    """
    listed = ", ".join(map(str, variables[:_MOST_LISTED]))
    more = ", …" if len(variables) > _MOST_LISTED else ""
    role = "cost" if isinstance(evaluator, Cost) else "constraint"
    name = evaluator.get_description() or f"{role} on {listed}{more}"
    for variable in variables:
        if variable.get_id() not in places:
            got = f"the variable {variable}"
            raise ProgramError(f"the {role} '{name}'", got, expected, remedy)
    return Addition(name, evaluator, tuple(places[v.get_id()] for v in variables))


# How the variables of their own are called.
SLACK = "slack"


@dataclass(frozen=True, eq=False)
class AddedRow:
    """A row lower ≤ y(x) ≤ upper of a user's constraint, K times.

    An inequality that is not about one variable has a slack of its own each time, as penalties need
    one variable: y(x) − s = 0 with lower ≤ s ≤ upper.
    """

    row: Constraint  # y − s, or y with its bounds
    reads: Ints  # the decision variables that it reads, shape (K, …)
    stages: Ints  # the last knot that it reads, shape (K,)
    slacks: Ints  # which decision variable s is, shape (K,), or (0,) without slacks
    bounds: tuple[float, float]  # of s
    unit: float  # of y

    def fill(self, x: Floats) -> None:
        """Sets the slacks among decision variables (n,) to y(x)."""
        for slack, read in zip(self.slacks, self.reads, strict=False):
            x[slack] = 0.0
            x[slack] = self.row.Eval(x[read])[0]

    def widen(self, center: Floats, half_width: Floats) -> None:
        """Sets the slacks' half widths, those of y in a box to first order, both (n,)."""
        for slack, read in zip(self.slacks, self.reads, strict=False):
            half_width[slack] = 0.0
            value = np.asarray(self.row.Eval(InitializeAutoDiff(center[read]).ravel()))
            half_width[slack] = np.abs(ExtractGradient(value)[0]) @ half_width[read]


def make_rows(
    addition: Addition, additions: Additions, reads: Ints, stages: Ints, new: Callable[[int], Ints]
) -> Iterator[AddedRow]:
    """Yields the rows of a user's constraint, one of these additions.

    Its K copies read decision variables (K, …), at knots up to these stages (K,); `new` returns so
    many new variables.
    """
    x, s = MakeVectorVariable(reads.shape[1], "x"), Variable("s")
    place = {variable.get_id(): i for i, variable in enumerate([*x, s])}
    rows = list(formula_rows(addition.evaluator, addition.name, x))
    for (y, lower, upper), unit in zip(rows, additions.units(addition).tolist(), strict=True):
        bounds = lower / unit, upper / unit
        if lower == upper or is_affine_in_one(y):
            shared, slacks = shared_constraint(y / unit, addition.name, *bounds), new(0)
            columns = reads
        else:
            shared, slacks = shared_constraint(y / unit - s, addition.name), new(len(reads))
            columns = np.column_stack([reads, slacks])
        order = [place[variable.get_id()] for variable in shared.placeholders]
        yield AddedRow(shared.evaluator, columns[:, order], stages, slacks, bounds, unit)
