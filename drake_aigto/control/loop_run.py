"""What happened in a loop: the motion, what the controller said, and its plans as they changed."""

from __future__ import annotations

import dataclasses
import json
import os
from dataclasses import dataclass
from typing import Literal

from drake_aigto.arrays import ArrayRecord, Floats, read_only
from drake_aigto.control.disturbance import Disturbance
from drake_aigto.control.predictive import TickStatus
from drake_aigto.plain import LEFT_OUT, to_plain
from drake_aigto.simulation import Replay
from drake_aigto.world import Scenario, World
from drake_aigto.world.files import write_text

FORMAT, FORMAT_VERSION = "drake_aigto closed loop", 1

Method = Literal["tracking", "replanning"]


@dataclass(frozen=True, eq=False)
class PlannedPath(ArrayRecord):
    """A plan as a controller had it: no simulation.

    Attributes:
        times: of its knots, shape (K,) [s].
        states: q and v there, shape (K, 2n).
    """

    times: Floats
    states: Floats

    def __post_init__(self) -> None:
        """Makes the arrays read-only."""
        for name in ("times", "states"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


@dataclass(frozen=True)
class PlanSwitch:
    """A moment at which a controller took another plan.

    Attributes:
        time: of the tick [s].
        before: the plan that it had.
        after: the one that it took.
    """

    time: float
    before: PlannedPath
    after: PlannedPath


@dataclass(frozen=True)
class ClosedLoopRun:
    """What a plant did under a controller, in Drake's Simulator.

    Attributes:
        method: how it was controlled.
        scenario: as the controller knows it.
        disturbance: what it does not know.
        replay: the simulation: the task's cost along what happened, the deepest penetration,
            touches, and the motion. Energies are those of the true masses.
        control_times: from when each control was held, and the end, shape (K+1,) [s].
        controls: shape (K, nu) [N, N m].
        promised: what the first plan costs.
        plan: the first plan.
        ticks: what each tick of `ModelPredictiveController` said; of tracking, none.
        switches: when it changed its mind.
        is_interrupted: whether Ctrl-C ended it; then it is what happened by then.
        world: that the controller knows, while it is in memory: files do not have it.
    """

    method: Method
    scenario: Scenario
    disturbance: Disturbance
    replay: Replay
    control_times: Floats
    controls: Floats
    promised: float
    plan: PlannedPath
    ticks: tuple[TickStatus, ...]
    switches: tuple[PlanSwitch, ...]
    is_interrupted: bool
    world: World = dataclasses.field(compare=False, repr=False, metadata=LEFT_OUT)

    @property
    def cost(self) -> float:
        """J of the scenario's task along what happened."""
        return self.replay.cost

    @property
    def duration(self) -> float:
        """How long it was simulated [s]."""
        return float(self.control_times[-1])

    @property
    def true_world(self) -> World:
        """The world that was simulated, but for its masses."""
        return self.disturbance.apply(self.world, self.scenario)[0]

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a log in JSON, whole or not at all.

        Raises:
            OutputFileError: the file can't be written.
        """
        head = {"format": FORMAT, "version": FORMAT_VERSION, "simulation": True}
        write_text(path, json.dumps({**head, **to_plain(self)}) + "\n")
