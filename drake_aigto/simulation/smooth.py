"""Motion that is smooth between events, integrated nearly to rounding under a controller."""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import scipy  # Not scipy.integrate, which takes a tenth of a second and few need.
from numpy.polynomial import chebyshev, legendre

from drake_aigto.arrays import Floats
from drake_aigto.simulation.recording import Controller, MotionSamples, Recording, refuse_course
from drake_aigto.world import World

# Of one step, relative and absolute: in flight a thousand of them are off by 1e-10.
_TOLERANCE = 1e-13
# The farthest that a coordinate moves in what is looked at in one piece [rad, m]. There, its waves
# are polynomials of the degree below but for rounding.
_LONGEST = 0.5
_DEGREE = 16
# More pieces of one step are no motion any more, but numbers that run away.
_MOST_PIECES = 1e5
# Nodes of a piece: of the polynomial, and of a quadrature that is exact up to the degree 19.
_NODES = chebyshev.chebpts1(_DEGREE + 1)
_FIT = np.linalg.inv(chebyshev.chebvander(_NODES, _DEGREE))
_ABSCISSAE, _WEIGHTS = legendre.leggauss(10)
# A root of the polynomial whose imaginary part is smaller is real but for rounding.
_REAL = 1e-6

# The most pieces of a motion, and how many more for each hold of the control and each event. Motion
# that takes more goes ever faster. A swing of a pendulum is some ten of them.
_MOST_PIECES_IN_ALL, _MOST_EACH = 30_000, 500

# (q, v) of shape (…, 2 nv) → its rate of change, and → what is watched, shape (…, E).
Rates: TypeAlias = Callable[[Floats], Floats]
Watched: TypeAlias = Callable[[Floats], Floats]


class Course(NamedTuple):
    """How a motion went on, at most until something that is watched fell to zero."""

    end: float  # [s]
    state: Floats  # (q, v) there, shape (2 nv,)
    fallen: int  # which fell; −1: none
    samples: list[MotionSamples]  # of all of its pieces
    step: float  # the longest that was proposed [s]


class _Piece(NamedTuple):
    """A part of a step, short enough for a polynomial."""

    start: float  # [s]
    end: float  # [s]
    states: Callable[[Floats], Floats]  # times (K,) → (q, v), shape (K, 2 nv)

    def at(self, abscissae: Floats) -> Floats:
        """Returns times of abscissae in [−1, 1]."""
        return self.start + (self.end - self.start) / 2 * (abscissae + 1)

    def sample(self, end: float) -> MotionSamples:
        """Returns samples until some time in it."""
        part = self._replace(end=end)
        times = part.at(_ABSCISSAE)
        return MotionSamples(times, (end - self.start) / 2 * _WEIGHTS, self.states(times))


def follow(
    rates: Rates,
    watched: Watched,
    start: float,
    end: float,
    state: Floats,
    first_step: float = np.inf,
    most: float = np.inf,
) -> Course:
    """Integrates ẋ = f(x) until a watched value falls to zero, or to the end.

    By the eighth-order rule of Dormand and Prince in SciPy, with dense output. On each piece of it
    every watched value is a Chebyshev polynomial whose roots are all found (J. P. Boyd, "Computing
    zeros on a real interval through Chebyshev expansion and polynomial rootfinding", SIAM J. Numer.
    Anal. 40, 2002), so that none that falls and rises again between two steps is missed. Watched
    functions are smooth, above 0 at the start; one that is not falls at once.

    Raises:
        TrajectoryError: the motion runs away to infinity, or takes more pieces than the most.
    """
    samples, last, longest = [], state, 0.0
    first_step = min(first_step, end - start)
    for piece, last, step in _integrate(rates, start, end, state, first_step):  # noqa: B007 (used)
        longest, (time, fallen) = max(longest, step), _find_fall(watched, piece)
        samples.append(piece.sample(time))
        if len(samples) > most:
            raise refuse_course(time)
        if fallen >= 0:
            return Course(time, piece.states(np.array([time]))[0], fallen, samples, longest)
    return Course(end, last, -1, samples, longest)


def _integrate(
    rates: Rates, start: float, end: float, state: Floats, first_step: float
) -> Iterator[tuple[_Piece, Floats, float]]:
    """Yields the pieces of each step, the state at its end, and the next step it proposes [s]."""
    with np.errstate(over="ignore", invalid="ignore"):
        solver = scipy.integrate.DOP853(
            lambda _, x: rates(x),
            start,
            state,
            end,
            rtol=_TOLERANCE,
            atol=_TOLERANCE,
            first_step=first_step,
        )
        while solver.status == "running":
            try:
                solver.step()
            except np.linalg.LinAlgError:  # of numbers that overflowed
                raise refuse_course(solver.t) from None
            if solver.status == "failed" or not np.isfinite(solver.y).all():
                raise refuse_course(solver.t)
            for piece in _divide(solver):
                yield piece, solver.y, solver.h_abs


def _divide(solver: Any) -> Iterator[_Piece]:
    """Yields the last step in pieces in which no coordinate moves far."""
    dense = solver.dense_output()

    def states(times: Floats) -> Floats:
        return np.ascontiguousarray(dense(times).T)

    step = _Piece(solver.t_old, solver.t, states)
    speed = np.max(np.abs(states(step.at(_NODES))[:, len(solver.y) // 2 :]))
    length = speed * (solver.t - solver.t_old) / _LONGEST
    if not length <= _MOST_PIECES:
        raise refuse_course(solver.t_old)
    count = max(1, math.ceil(length))
    edges = np.linspace(solver.t_old, solver.t, count + 1).tolist()
    for first, last in itertools.pairwise(edges):
        yield _Piece(first, last, states)


def _find_fall(watched: Watched, piece: _Piece) -> tuple[float, int]:
    """Returns when the first value falls to zero in a piece, and which; its end and −1 if none."""
    coefficients = _FIT @ watched(piece.states(piece.at(_NODES)))
    # A Chebyshev polynomial nowhere exceeds the sum of its coefficients' sizes.
    least = coefficients[0] - np.sum(np.abs(coefficients[1:]), axis=0)
    first, fallen = np.inf, -1
    for i in np.flatnonzero(least <= 0).tolist():
        roots = chebyshev.chebroots(chebyshev.chebtrim(coefficients[:, i], 1e-17))
        real = np.real(roots[np.abs(np.imag(roots)) < _REAL])
        edges = np.concatenate([[-1.0], np.sort(real[np.abs(real) < 1]), [1.0]])
        falls = chebyshev.chebval((edges[:-1] + edges[1:]) / 2, coefficients[:, i]) < 0
        if np.any(falls) and edges[np.argmax(falls)] < first:
            first, fallen = float(edges[np.argmax(falls)]), i
    return (float(piece.at(np.array(first))), fallen) if fallen >= 0 else (piece.end, -1)


class HybridMotion(ABC):
    """A world's motion from a start, recorded.

    Attributes:
        world: its dynamics and its contacts.
        time: now [s].
        x: the state (q, v), shape (2 nv,).
        recording: of what happened so far.
    """

    def __init__(self, world: World, state: tuple[Floats, Floats], time: float) -> None:
        """Starts with (q, v) at a time [s]."""
        self.world, self.time, self.x = world, time, np.concatenate(state)
        self.recording = Recording()
        self.recording.add(time, *state)
        # Knots are close: mostly one step leads to the next, which a guess would halve.
        self._step = np.inf

    def run(self, controller: Controller) -> Recording:
        """Runs a controller, of an open or a closed loop, to its end, and records it.

        Rows are those whenever the controller is asked, at the end, and at events, beside samples
        of all motion between.

        Raises:
            TrajectoryError: the motion runs away to infinity, or goes so fast that it would take
                minutes to follow.
        """
        while self.time < controller.end:
            held = controller.sample(self.time, self.x, self.recording.bounces)
            self.recording.hold(self.time, held)
            self._advance(held.control, held.until, controller.feels_contact)
            self.recording.add(self.time, *self._split())
        self._finish()
        return self.recording

    @abstractmethod
    def _advance(self, control: Floats, until: float, feels_contact: bool) -> None:
        """Moves on under a control, shape (nu,) [N], until a time [s].

        If the controller feels contact, only until one has ended.
        """

    @abstractmethod
    def _finish(self) -> None:
        """Records what is read off the whole motion, as how deep it came into walls."""

    def _follow(self, rates: Rates, watched: Watched, control: Floats, until: float) -> int:
        """Moves on smoothly until a watched value falls to zero.

        Returns:
            Which did; −1 if none.
        """
        seen = self.recording
        most = _MOST_PIECES_IN_ALL + _MOST_EACH * len(seen.times) - len(seen.samples)
        course = follow(rates, watched, self.time, until, self.x, self._step, most)
        self.time, self.x = course.end, course.state
        self._step = course.step if course.fallen < 0 else np.inf
        self.recording.samples += [(samples, control) for samples in course.samples]
        return course.fallen

    def _split(self) -> tuple[Floats, Floats]:
        """Returns q and v."""
        return self.world.split(self.x)
