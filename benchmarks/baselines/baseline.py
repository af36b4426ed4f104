"""A rival of the planner: it offers controls, which the rigid wall judges, until time is up."""

from __future__ import annotations

import dataclasses
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import Floats, read_only
from drake_aigto.errors import OptionsError
from drake_aigto.simulation import replay_event_driven
from drake_aigto.world import Scenario, World


class Improvement(NamedTuple):
    """A moment at which a run had found something cheaper: seconds of one core, and J."""

    seconds: float
    cost: float


@dataclass(frozen=True, eq=False)
class BaselineRun:
    """What a baseline found on one scenario, and when.

    Attributes:
        method: the baseline's name.
        improvements: by event-driven replay, each cheaper than the one before.
        seconds: of one core that the run took. The last step of a run may end late: what it found
            then is among the improvements, with its time.
        evaluations: how many controls were offered.
        times: knots of the best control, shape (N+1,) [s]; None if nothing was offered.
        controls: the best, shape (N, nu) [N]; None if nothing was offered.
    """

    method: str
    improvements: tuple[Improvement, ...]
    seconds: float
    evaluations: int
    times: Floats | None
    controls: Floats | None

    @property
    def cost(self) -> float:
        """The least cost of an event-driven replay; infinity if nothing was offered."""
        return self.improvements[-1].cost if self.improvements else math.inf


class Recorder:
    """Takes a baseline's offers, replays them on the rigid wall, and says when it is over.

    Time is the CPU time of this process, "seconds of one core": cores may be shared. It counts from
    the recorder's making, replays included. Code that Numba compiles, or loads, at a process's
    first run counts too: let a method run once before it is measured.

    Attributes:
        world: that controls act in.
        scenario: the question.
        run: what is recorded so far.
    """

    def __init__(
        self,
        world: World,
        scenario: Scenario,
        seconds: float,
        good_enough: float = -math.inf,
        clock: Callable[[], float] = time.process_time,
    ) -> None:
        """Starts the clock; it is over after so many seconds, or with a cost that is good enough.

        Raises:
            OptionsError: seconds are no positive number.
            ScenarioError: the scenario does not fit the world.
        """
        if not 0 < seconds < math.inf:
            raise OptionsError("seconds", got=seconds, expected="a finite number above 0")
        world.check(scenario)
        world.check_plain(scenario)
        self.world, self.scenario = world, scenario
        self.run = BaselineRun("", (), 0.0, 0, None, None)
        self._seconds, self._good_enough = seconds, good_enough
        self._clock, self._began = clock, clock()

    @property
    def seconds(self) -> float:
        """Seconds since the start."""
        return self._clock() - self._began

    @property
    def cost(self) -> float:
        """The least cost so far; infinity before the first offer."""
        return self.run.cost

    @property
    def is_over(self) -> bool:
        """Whether time is up, or the best so far is good enough."""
        return self.cost <= self._good_enough or self.seconds >= self._seconds

    def offer(self, times: ArrayLike, controls: ArrayLike) -> float:
        """Replays a held control, keeps it if none was cheaper, and returns its cost.

        Args:
            times: of the knots, shape (N+1,) [s].
            controls: held over each interval, shape (N, nu) [N].

        Raises:
            TrajectoryError: shapes that do not fit, times that do not increase, NaN or infinity.
        """
        cost = replay_event_driven(self.world, self.scenario, times, controls).cost
        run, seconds = self.run, self.seconds
        changes: dict[str, Any] = {"evaluations": run.evaluations + 1}
        if cost < run.cost:
            changes |= {"times": read_only(times), "controls": read_only(controls)}
            changes["improvements"] = (*run.improvements, Improvement(seconds, cost))
        self.run = dataclasses.replace(run, **changes)
        return cost

    def finish(self, method: str) -> BaselineRun:
        """Returns what was recorded under a method's name."""
        return dataclasses.replace(self.run, method=method, seconds=self.seconds)


class Baseline(ABC):
    """A way to solve scenarios that is not ours.

    Attributes:
        name: in `BASELINES` and in tables.
        modules: of other people's libraries that it needs, from the extra ``bench``.
    """

    name: str
    modules: tuple[str, ...] = ()

    @abstractmethod
    def search(self, recorder: Recorder, generator: np.random.Generator) -> None:
        """Offers controls to the recorder until `Recorder.is_over`, or until nothing is left.

        The clock only ends the search: how it goes on must not depend on the time that is left, so
        that the same seed makes the same offers, more of them in more time. The generator is the
        source of all chance.

        Raises:
            ModelError: a world that this method can't treat.
        """
