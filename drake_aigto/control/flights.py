"""A plan, cut at its bounces: flights that go on beyond their ends, and what a bounce does."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pydrake.polynomial import Polynomial
from pydrake.trajectories import PiecewisePolynomial

from drake_aigto.arrays import Floats
from drake_aigto.contact import calc_saltation, reflect
from drake_aigto.errors import TrajectoryError
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import Scenario, World

# A bounce that is approached by less than this part of the plan's largest velocity is a graze.
_GRAZE = 1e-6


@dataclass(frozen=True, eq=False)
class Flight:
    """A part of a plan between bounces, continued before its start and after its end.

    Attributes:
        start: of the flight itself [s].
        end: of the flight itself [s].
        state: (q, v)(t) over all of the plan's time, shape (2 nq, 1). Outside of the flight it is
            what led to its first state under its first control, and what its last control makes of
            its last state, as if there were no wall; with accelerations that stay as they are.
        control: u(t) over all of the plan's time, shape (nu, 1) [N].
        samples: the knots of the flight, and as many like them as there is time, increasing [s].
    """

    start: float
    end: float
    state: PiecewisePolynomial
    control: PiecewisePolynomial
    samples: Floats

    def calc_state(self, time: float) -> Floats:
        """Returns (q, v), shape (2 nq,)."""
        return self.state.value(time)[:, 0]

    def calc_control(self, time: float) -> Floats:
        """Returns u, shape (nu,) [N]."""
        return self.control.value(time)[:, 0]

    def find_next_sample(self, time: float) -> float:
        """Returns the first sample after a time, or else the last one [s]."""
        k = int(np.searchsorted(self.samples, time, side="right"))
        return float(self.samples[min(k, len(self.samples) - 1)])


@dataclass(frozen=True, eq=False)
class Bounce:
    """What a planned bounce does to deviations from the plan.

    Attributes:
        time: τ [s].
        contact: i, which of the world's contacts.
        saltation: Ξ, shape (2 nq, 2 nq): a deviation x̃ from the flight before it is Ξ x̃ from the
            flight after it, once the ball has bounced, to first order.
    """

    time: float
    contact: int
    saltation: Floats


def split_flights(
    world: World, scenario: Scenario, trajectory: Trajectory
) -> tuple[tuple[Flight, ...], tuple[Bounce, ...]]:
    """Returns the flights of a plan, and the bounces between them.

    Raises:
        TrajectoryError: it does not fit the world, or has contacts other than bounces one by one.
    """
    check_bounces(world, trajectory)
    joints = [int(k) for k in np.flatnonzero(trajectory.impulses[:-1].any(axis=1))]
    ends = [0, *joints, len(trajectory.times) - 1]
    flights = [
        _make_flight(world, trajectory, first, last) for first, last in itertools.pairwise(ends)
    ]
    bounces = [_make_bounce(world, scenario, trajectory, k) for k in joints]
    return tuple(flights), tuple(bounces)


def check_bounces(world: World, trajectory: Trajectory, may_last: bool = False) -> None:
    """Refuses what is not bounces one by one, or contacts that last if these may.

    Raises:
        TrajectoryError: says which contact is something else, or what does not fit the world.
    """
    sizes = world.num_positions, world.num_actuators, world.num_contacts
    got = tuple(
        each.shape[1] for each in (trajectory.positions, trajectory.controls, trajectory.impulses)
    )
    if got != sizes:
        raise TrajectoryError(
            "the trajectory",
            got=f"{got} positions, controls and contacts",
            expected=f"the world's, {sizes}",
        )
    times, impulses = trajectory.times, trajectory.impulses[:-1]
    remedy = "Track plans whose contacts are bounces one by one."
    lasting = np.flatnonzero(trajectory.forces.any(axis=1))
    if lasting.size and not may_last:
        raise _refuse(f"one that lasts, at {times[lasting[0]]:.3f} s", remedy)
    if impulses[0].any():
        rigid = "Track plans of the rigid transcription, whose contacts are bounces one by one."
        raise _refuse("a push at the very start", rigid)
    several = np.flatnonzero(np.count_nonzero(impulses, axis=1) > 1)
    if several.size:
        raise _refuse(f"several at once, at {times[several[0]]:.3f} s", remedy)
    speeds = world.calc_contact_rate(trajectory.positions[:-1], trajectory.velocities[:-1])
    slowest = -_GRAZE * float(np.max(np.linalg.norm(trajectory.velocities, axis=1)))
    grazes = np.flatnonzero(((impulses != 0) & (speeds >= slowest)).any(axis=1))
    if grazes.size:
        raise _refuse(f"one that grazes, at {times[grazes[0]]:.3f} s", remedy)


def _refuse(got: str, remedy: str) -> TrajectoryError:
    return TrajectoryError("contacts of a plan to track", got, "bounces", remedy)


def _make_flight(world: World, trajectory: Trajectory, first: int, last: int) -> Flight:
    """Returns the flight from one knot to another."""
    t, controls = trajectory.times, trajectory.controls
    state, _ = trajectory.to_piecewise()
    knots = t[first : last + 1].tolist()
    pieces = [state.getPolynomialMatrix(k) for k in range(first, last)]
    held = list(controls[first:last])
    if first > 0:
        x = state.value(t[first])[:, 0]
        pieces.insert(0, _coast(world, x, controls[first], float(t[0] - t[first])))
        knots.insert(0, float(t[0]))
        held.insert(0, held[0])
    if last < len(controls):
        x = np.concatenate([trajectory.positions[last], trajectory.velocities[last]])
        pieces.append(_coast(world, x, controls[last - 1], 0.0))
        knots.append(float(t[-1]))
        held.append(held[-1])
    return Flight(
        start=float(t[first]),
        end=float(t[last]),
        state=PiecewisePolynomial(pieces, knots),
        control=PiecewisePolynomial.ZeroOrderHold(knots, np.array([*held, held[-1]]).T),
        samples=_continue(t[first : last + 1], float(t[0]), float(t[-1])),
    )


def _coast(world: World, x: Floats, u: Floats, since: float) -> npt.NDArray[np.object_]:
    """Returns (q, v) as polynomials of the time since `since`, x being the state at time 0."""
    q, v = np.split(x, 2)
    a = world.calc_acceleration(q, v, u)
    q, v = q + since * v + since**2 / 2 * a, v + since * a
    positions = [Polynomial(each) for each in zip(q, v, a / 2, strict=True)]
    velocities = [Polynomial(each) for each in zip(v, a, strict=True)]
    return np.array([*positions, *velocities]).reshape(-1, 1)


def _continue(knots: Floats, start: float, end: float) -> Floats:
    """Returns knots, and before and after them more that are as far apart as the first and last."""
    first, last = knots[1] - knots[0], knots[-1] - knots[-2]
    before = knots[0] - first * np.arange(int((knots[0] - start) / first), 0, -1)
    after = knots[-1] + last * np.arange(1, int((end - knots[-1]) / last) + 1)
    samples = np.concatenate([before, knots, after[after < end]])
    return samples if samples[-1] == end else np.append(samples, end)


def _make_bounce(world: World, scenario: Scenario, trajectory: Trajectory, k: int) -> Bounce:
    """Returns the bounce at a knot."""
    (contact,) = np.flatnonzero(trajectory.impulses[k])
    inertia, n = world.constant_inertia, world.num_positions
    e = world.restitutions(scenario)[contact]
    D = np.eye(2 * n)
    D[n:, n:] = reflect(inertia.lifts[contact], inertia.jacobian[contact], e)
    q, v = trajectory.positions[k], trajectory.velocities[k]
    after = D[n:, n:] @ v
    before, later = (
        np.concatenate([speed, world.calc_acceleration(q, speed, u)])
        for speed, u in ((v, trajectory.controls[k - 1]), (after, trajectory.controls[k]))
    )
    normal = np.concatenate([inertia.jacobian[contact], np.zeros(n)])
    saltation = calc_saltation(D, before, later, normal)
    return Bounce(float(trajectory.times[k]), int(contact), saltation)
