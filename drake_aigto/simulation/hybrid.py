"""What moves smoothly between events, and a controller that drives it."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.simulation.controller import Controller
from drake_aigto.simulation.recording import Recording
from drake_aigto.simulation.smooth import Rates, Watched, follow
from drake_aigto.world import World

# What takes more pieces than these, and so many more for each hold of the control and each event,
# goes ever faster: a swing of a pendulum is some ten of them.
_MOST_PIECES, _MOST_EACH = 30_000, 500


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
        """Runs a controller, of an open or a closed loop, to its end.

        Returns:
            The states whenever the controller is asked, at the end, and at events; and samples of
            all motion between.

        Raises:
            TrajectoryError: the motion runs away to infinity, or goes so fast that it would take
                minutes to follow.
        """
        while self.time < controller.end:
            held = controller.sample(self.time, self.x, self.recording.bounces)
            self.recording.hold(self.time, held.control)
            self._advance(held.control, held.until, controller.feels_contact)
            self.recording.add(self.time, *self._split())
        self.recording.max_penetration = self._find_depth()
        return self.recording

    @abstractmethod
    def _advance(self, control: Floats, until: float, feels_contact: bool) -> None:
        """Moves on under a control, shape (nu,) [N], until a time [s].

        If the controller feels contact, only until one has ended.
        """

    @abstractmethod
    def _find_depth(self) -> float:
        """Returns the deepest −φ, at least 0 [m]."""

    def _follow(self, rates: Rates, watched: Watched, control: Floats, until: float) -> int:
        """Moves on smoothly until a watched value falls to zero.

        Returns:
            Which did; −1 if none.
        """
        seen = self.recording
        most = _MOST_PIECES + _MOST_EACH * len(seen.times) - len(seen.samples)
        stretch = follow(rates, watched, self.time, until, self.x, self._step, most)
        self.time, self.x = stretch.end, stretch.state
        self._step = stretch.step if stretch.fallen < 0 else np.inf
        self.recording.samples += [(samples, control) for samples in stretch.samples]
        return stretch.fallen

    def _split(self) -> tuple[Floats, Floats]:
        """Returns q and v."""
        n = self.world.num_positions
        return self.x[:n], self.x[n:]
