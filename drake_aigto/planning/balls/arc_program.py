"""Programs of arcs of one shape: unknowns, costs and rows, built once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.symbolic import MakeVectorVariable

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.dynamics import ConstantDynamics
from drake_aigto.local import Monomial, NlpBuilder, Summand
from drake_aigto.planning.balls.added import AddedSums
from drake_aigto.planning.balls.phases import PhaseProblem
from drake_aigto.planning.balls.timeline import Marks
from drake_aigto.terms import expression_terms
from drake_aigto.transcription import (
    CONTACT,
    DYNAMICS,
    FLIGHT,
    NO_ADDITIONS,
    NONPENETRATION,
    RESTITUTION,
    Additions,
    as_expression,
)
from drake_aigto.world import World

# Programs that are kept, at most: searches return to contact sequences.
_MOST_KEPT = 64


@dataclass(frozen=True, eq=False)
class ArcShape:
    """J arcs between J + 1 joints of a multi-phase problem, without numbers that bounds can fix."""

    counts: Ints  # steps of each arc, shape (J,); if no row reads them, 1 for one and 2 for more
    phases: Ints  # which phase each arc is a part of, shape (J,)
    rests: Bools  # which contacts last during each arc, shape (J, m)
    marks: Marks  # contacts at the joints
    # Of contacts that are sustained, or struck with others coupled to them, shape (m,); 0 for
    # others, whose impacts bounds fix.
    restitutions: Floats
    weights: Floats  # w_u and w_f

    @classmethod
    def of(cls, phases: PhaseProblem, knots: Ints) -> ArcShape:
        """Returns the shape of arcs between these knots of the phases."""
        line, scenario, counts = phases.timeline, phases.scenario, np.diff(knots)
        rests = line.rests[knots[:-1]]
        if counts.size == len(line.phases) and not np.any(rests):
            counts = np.minimum(counts, 2)
        ends = [phase.last for phase in line.phases]
        stays = np.any(line.marks.lands, axis=0)
        for knot, impact in phases.impacts.items():
            stays |= line.marks.struck[knot] & np.any(impact.coupled)
        return cls(
            counts=counts,
            phases=np.searchsorted(ends, knots[:-1], side="right"),
            rests=rests,
            marks=line.marks.at(knots),
            restitutions=np.where(stays, phases.restitutions, 0.0),
            weights=np.array([scenario.control_weight, scenario.goal_weight]),
        )

    @property
    def key(self) -> tuple[bytes, ...]:
        """A key that differs between shapes."""
        rest = self.counts, self.phases, self.rests, self.restitutions, self.weights
        return tuple(each.tobytes() for each in (*self.marks, *rest))


class ArcPrograms:
    """Programs of the same world without additions, by the shape of their arcs."""

    def __init__(self) -> None:
        """Starts with none."""
        self._kept: dict[tuple[bytes, ...], ArcProgram] = {}

    def of(self, phases: PhaseProblem, knots: Ints) -> ArcProgram:
        """Returns the program of arcs between these knots of the phases.

        Raises:
            UnsupportedTermError: walls leave a joint no place.
        """
        shape, additions = ArcShape.of(phases, knots), phases.additions
        if additions:
            at = {k: int(np.searchsorted(knots, phases.knot_of(k))) for k in additions.knots}
            return ArcProgram(phases.world, shape, additions, at)
        key = shape.key
        if key not in self._kept:
            program = ArcProgram(phases.world, shape)
            if len(self._kept) >= _MOST_KEPT:
                del self._kept[next(iter(self._kept))]
            self._kept[key] = program
        return self._kept[key]


@dataclass(frozen=True, eq=False)
class WallBounds:
    """Bounds of φ = J q + φ(0), W of them, each a bound of one position."""

    positions: Ints  # the unknowns, shape (W,)
    contacts: Ints  # shape (W,)
    slopes: Floats  # the entry of J that is not 0, shape (W,)
    limits: Floats  # lower and upper bounds of φ, shape (2, W)

    @classmethod
    def of(cls, rows: list[tuple[int, int, float, float, float]]) -> WallBounds:
        """Returns bounds from unknowns, contacts, slopes, and lower and upper bounds."""
        table = np.array(rows, dtype=float).reshape(-1, 5).T
        return cls(table[0].astype(np.int64), table[1].astype(np.int64), table[2], table[3:])

    def bound(self, lower: Floats, upper: Floats, offset: Floats) -> None:
        """Writes the positions' bounds, given φ(0), shape (m,), into those of all unknowns."""
        held = self.positions[self.limits[0] == self.limits[1]]  # At another place so far.
        lower[held], upper[held] = -np.inf, np.inf
        low, high = np.sort((self.limits - offset[self.contacts]) / self.slopes, axis=0)
        np.maximum.at(lower, self.positions, low)
        np.minimum.at(upper, self.positions, high)


class ArcProgram:
    """The problem of arcs of one shape (`Arcs` has its equations).

    Other differences between problems (the start, the goal, durations, √ρ/2, positions and
    restitutions of walls) are unknowns that bounds fix, so that tables and the order of unknowns
    are made once.

    Attributes:
        nlp: the problem; its `held` unknowns, and h, still need their bounds.
        q: positions at the joints, shape (J+1, nq).
        v: velocities there, at an impact those before it.
        t: times there.
        w: velocities with which arcs start, shape (J, nv).
        a: mean controls, shape (J, nu).
        b: tilts of the controls.
        h: durations, shape (J,).
        f: mean forces, shape (J, m).
        g: tilts of the forces.
        half_root: √ρ/2, shape (J,).
        goal: shape (nq,).
        offset: φ(0) of the contacts, shape (m,).
        impacts: joint → the coordinates whose speed an impact changes there, and their rows of R
            (`JointImpact`), shapes (c,) and (c, nv).
        walls: bounds of φ that are bounds of one position.
        phases: which phase each arc is a part of, shape (J,).
        end_forces: λ at both ends of arcs of several steps, where contacts last.
    """

    def __init__(
        self,
        world: World,
        shape: ArcShape,
        additions: Additions = NO_ADDITIONS,
        joints: Mapping[int, int] | None = None,
    ) -> None:
        """Builds the problem.

        Args:
            world: has M, J and h; arcs are of one step each if h varies.
            shape: of the arcs.
            additions: of users; arcs are of one step each if some are about every knot.
            joints: the joint at the time of each knot that additions read.
        """
        self._world, self._inertia = world, world.constant_inertia
        self._shape, self.phases = shape, shape.phases
        self._builder = NlpBuilder()
        self._make_variables()
        at = joints or {}
        # Arcs from one joint to another share one control.
        for first, last in [(at[k], at[k + 1]) for k in additions.held]:
            unused = np.append(self.a[first + 1 : last], self.b[first:last], axis=0)
            self._builder.bound(unused, 0.0, 0.0)
            self.a[first:last] = self.a[first]
        for rests in dict.fromkeys(map(tuple, shape.rests.tolist())):
            self._add_motion(np.array(rests, dtype=bool))
        self._add_costs()
        self._add_clock()
        self._add_distances()
        self._add_touches()
        self._add_forces()
        self._added = AddedSums(self._builder)
        self._added.add(additions, {"q": self.q, "v": self.v, "u": self.a}, self.h, at)
        self.nlp = self._builder.build()

    def complete(self, x: Floats) -> Floats:
        """Returns a point (n,) with its sums computed from the other unknowns."""
        return self._added.complete(self._builder.complete(x))

    def _make_variables(self) -> None:
        new, rests, (nq, nu) = self._builder.new, self._shape.rests, self._inertia.gain.shape
        J, m = rests.shape
        self.q, self.v, self.t = new(J + 1, nq), new(J + 1, nq), new(J + 1)
        self.a, self.b, self.h = new(J, nu), new(J, nu), new(J)
        self.f, self.g = new(J, m), new(J, m)
        # Held unknowns also make all arcs copies of one sum.
        self.half_root, self.goal, self.offset = new(J), new(nq), new(m)
        is_short = (self._shape.counts == 1)[:, np.newaxis]
        no_tilts = self.b[is_short[:, 0]], self.g[~rests | is_short]
        ends = self.q[0], self.v[0], self.t[[0, -1]]
        for held in (*ends, self.half_root, self.goal, self.offset, self.f[~rests], *no_tilts):
            self._builder.bound(held, 0.0, 0.0)
        self.w = self.v[:-1].copy()
        self.impacts: dict[int, tuple[Ints, Ints]] = {}
        for j in np.flatnonzero(np.any(self._shape.marks.struck[:-1], axis=1)).tolist():
            # w = R v, for the speeds that an impact changes.
            impact = self._shape.marks.calc_impact(j, self._inertia, self._shape.restitutions)
            velocities = impact.velocities
            changed = np.flatnonzero(np.any(velocities != np.eye(len(velocities)), axis=1))
            rows = self._builder.new(changed.size, len(velocities))
            self._builder.bound(rows, 0.0, 0.0)
            self.impacts[j] = changed, rows
            for i, row in zip(changed.tolist(), rows, strict=True):
                self.w[j, i] = self._builder.new_product(RESTITUTION, row, self.v[j])

    def _add_motion(self, rests: Bools) -> None:
        """Adds flight and dynamics of the arcs during which these contacts last."""
        columns = (
            *(self.q[:-1], self.w, self.q[1:], self.v[1:], self.a, self.b),
            *(self.f[:, rests], self.g[:, rests]),
            *(self.h[:, np.newaxis], self.half_root[:, np.newaxis]),
        )
        copies = np.hstack(columns)[np.all(self._shape.rests == rests, axis=1)]
        ends = np.cumsum([column.shape[1] for column in columns])
        q, w, next_q, next_v, a, b, f, g, (H,), (r,) = (
            places.tolist() for places in np.split(np.arange(ends[-1]), ends[:-1])
        )
        for i, drift in enumerate(self._express_drifts(H)):
            pushes = [*self._inertia.gain[i], *self._inertia.kicks[rests, i]]
            flight: list[Monomial] = [(1.0, (next_q[i],)), (-1.0, (q[i],))]
            flight += [(-0.5, (H, speed)) for speed in (w[i], next_v[i])]
            flight += [(push, (r, H, H, x)) for push, x in zip(pushes, [*b, *g], strict=True)]
            self._builder.add_row(FLIGHT, flight, copies)
            dynamics: list[Summand] = [(1.0, (next_v[i],)), (-1.0, (w[i],)), *drift]
            dynamics += [(-push, (H, x)) for push, x in zip(pushes, [*a, *f], strict=True)]
            self._builder.add_row(DYNAMICS, dynamics, copies)

    def _express_drifts(self, H: int) -> list[Sequence[Summand]]:
        """Returns −H times the acceleration without control, of each coordinate.

        It is over an arc's q, w, q′ and v′, the first unknowns of its motion, and H.
        """
        if isinstance(self._inertia, ConstantDynamics):
            return [[(-drift, (H,))] for drift in self._inertia.drift.tolist()]
        names, n = MakeVectorVariable(H + 1, "x"), len(self._inertia.mass_matrix)
        q, w, next_q, next_v = np.split(names[: 4 * n], 4)
        # NumPy takes Drake's boxed constants for invalid numbers, and warns.
        with np.errstate(invalid="ignore"):
            force = self._world.express_bias((q + next_q) / 2, (w + next_v) / 2)
            slowed = names[H] * (self._inertia.inverse_mass @ force)
        return [expression_terms("the bias", as_expression(each), names, True) for each in slowed]

    def _add_costs(self) -> None:
        (w_u, w_f), (nq, nu) = self._shape.weights.tolist(), self._inertia.gain.shape
        effort = [(w_u, (0, i, i)) for i in range(1, 2 * nu + 1)]
        copies = np.column_stack([self.h, self.a, self.b])
        self._builder.add_cost("control effort", effort, copies)
        miss = [
            monomial
            for i in range(nq)
            for monomial in ((w_f, (i, i)), (-2 * w_f, (i, nq + i)), (w_f, (nq + i, nq + i)))
        ]
        self._builder.add_cost("goal", miss, np.append(self.q[-1], self.goal))

    def _add_clock(self) -> None:
        """Adds t' = t + H, and equal steps within a phase."""
        add: list[Monomial] = [(1.0, (0,)), (-1.0, (1,)), (-1.0, (2,))]
        copies = np.column_stack([self.t[1:], self.t[:-1], self.h])
        self._builder.add_row("clock", add, copies)
        counts, phases = self._shape.counts, self._shape.phases
        for j in np.flatnonzero(phases[1:] == phases[:-1]).tolist():
            same = [(1.0, (0,)), (-counts[j] / counts[j + 1], (1,))]
            self._builder.add_row("clock", same, self.h[j : j + 2])

    def _add_distances(self) -> None:
        shape = self._shape
        alone: list[tuple[int, int, float, float, float]] = []
        for name, mask, lower, upper in (
            (NONPENETRATION, shape.marks.apart, 0.0, np.inf),
            (NONPENETRATION, shape.marks.beside, -np.inf, 0.0),
            (CONTACT, shape.marks.held, 0.0, 0.0),
        ):
            for j, i in np.argwhere(mask[1:]).tolist():
                J, q = self._inertia.jacobian[i], self.q[j + 1]
                used = np.flatnonzero(J)
                if used.size == 1:
                    alone.append((q[used[0]], i, J[used[0]], lower, upper))
                    if lower == upper:
                        self._builder.bound(q[used], 0.0, 0.0)
                else:
                    both = np.append(J, 1.0), np.append(q, self.offset[i])
                    self._builder.bound_sum(name, *both, lower, upper)
        self.walls = WallBounds.of(alone)

    def _add_touches(self) -> None:
        """Adds approach speeds at walls, and that no wall pulls in an impact."""
        builder, shape = self._builder, self._shape
        for j, i in np.argwhere(shape.marks.starts).tolist():
            # An elastic contact must be at rest already to stay.
            stays = shape.marks.lands[j, i] and shape.restitutions[i] == 1
            least = 0.0 if stays else -np.inf
            builder.bound_sum(RESTITUTION, self._inertia.jacobian[i], self.v[j], least, 0.0)
            if shape.marks.lands[j, i] and 0 < shape.restitutions[i] < 1:
                self._add_settling(j, i)
        for j in np.flatnonzero(np.any(shape.marks.struck, axis=1)).tolist():
            impact = shape.marks.calc_impact(j, self._inertia, shape.restitutions)
            for row in impact.impulses[impact.coupled]:
                builder.bound_sum(RESTITUTION, row, self.v[j], 0.0, np.inf)

    def _add_settling(self, joint: int, i: int) -> None:
        """Adds that hops end before the contact does: (1 − e) Σ H f_i + 2 e m_i J_i v ≥ 0."""
        e, ends = self._shape.restitutions[i], np.flatnonzero(~self._shape.rests[joint:, i])
        arcs = slice(joint, joint + int(ends[0]) if ends.size else None)
        pushed = self._builder.new_product(CONTACT, self.h[arcs], self.f[arcs, i])
        closing = 2 * e * self._inertia.masses[i] * self._inertia.jacobian[i]
        row = np.append(closing, 1 - e), np.append(self.v[joint], pushed)
        self._builder.bound_sum(CONTACT, *row, 0.0, np.inf)

    def _add_forces(self) -> None:
        """Adds λ ≥ 0 at both ends of arcs, and that contacts stay at rest."""
        builder = self._builder
        ends: list[int] = []
        for j, i in np.argwhere(self._shape.rests).tolist():
            n, both = self._shape.counts[j], np.array([self.f[j, i], self.g[j, i]])
            if n == 1:
                builder.bound(both[0], 0.0, np.inf)
                continue  # It stays at rest as both ends are at the wall.
            tilt = (n - 1) / n / calc_root(n)
            sides = (np.array([1.0, side]) for side in (-tilt, tilt))
            ends += [builder.new_sum(CONTACT, side, both) for side in sides]
            builder.bound_sum(CONTACT, self._inertia.jacobian[i], self.v[j + 1], 0.0, 0.0)
        self.end_forces = np.array(ends, dtype=np.int64)
        builder.bound(self.end_forces, 0.0, np.inf)


def calc_root(counts: Ints) -> Floats:
    """Returns √ρ_n of arcs, given their numbers of steps."""
    roots: Floats = np.sqrt((counts**2 - 1) / 3) / counts
    return roots
