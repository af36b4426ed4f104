"""Run of a loop: the motion, the controller's reports, and its plans as they changed."""

from __future__ import annotations

import dataclasses
import json
import os
from dataclasses import dataclass
from typing import Literal

from drake_aigto.arrays import ArrayRecord, Floats, read_only
from drake_aigto.control.disturbance import Disturbance
from drake_aigto.control.predictive import TickStatus
from drake_aigto.errors import AigtoError, ResultsFileError
from drake_aigto.output import write_text
from drake_aigto.plain import LEFT_OUT, from_plain, read_json, to_plain
from drake_aigto.simulation import Replay
from drake_aigto.world import Scenario, World

FORMAT, FORMAT_VERSION = "drake_aigto closed loop", 1
HEAD = {"format": FORMAT, "version": FORMAT_VERSION, "simulation": True}

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
    """Motion of a plant under a controller, in Drake's Simulator.

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
        known_world: see `world`; files do not have it (`load`).
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
    known_world: World | None = dataclasses.field(
        default=None, compare=False, repr=False, metadata=LEFT_OUT
    )

    def __post_init__(self) -> None:
        """Makes the arrays read-only."""
        for name in ("control_times", "controls"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def __repr__(self) -> str:
        """Returns a line without arrays: the cost, and what no cost is shown without."""
        replay = self.replay
        parts = [
            self.method,
            f"cost={self.cost:.4g}",
            f"promised={self.promised:.4g}",
            f"{self.duration:.4g} s in {replay.simulator}",
            f"bounces: {len(replay.bounce_times)}",
            f"deepest penetration {replay.max_penetration + 0.0:.2g} m",
            *([] if replay.energy_ratio is None else [f"energy ratio {replay.energy_ratio:.4g}"]),
            f"switches of the plan: {len(self.switches)}",
            *(["interrupted"] if self.is_interrupted else []),
        ]
        return f"ClosedLoopRun({', '.join(parts)})"

    @property
    def world(self) -> World:
        """The world that the controller knows."""
        return self.known_world or World.from_scenario(self.scenario)

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
        write_text(path, json.dumps({**HEAD, **to_plain(self)}) + "\n")

    @classmethod
    def load(cls, path: str | os.PathLike[str], world: World | None = None) -> ClosedLoopRun:
        """Reads a log that `save` wrote.

        Args:
            path: of the file.
            world: that the controller knew; None: that of the scenario's model.

        Raises:
            ResultsFileError: no such file, cut short, not the log of a run, damaged, or of another
                version.
            ModelError: from `World.from_scenario`.
        """
        data = read_json(path, "log", ResultsFileError)
        if not is_run(data):
            raise ResultsFileError(
                f"{path} is not the log of a run in the loop",
                expected=f"an object with the format {FORMAT!r}",
                remedy="Write one with `drake-aigto control SCENARIO --json FILE`.",
            )
        plain = {key: value for key, value in data.items() if key not in HEAD}
        if (version := data.get("version")) != FORMAT_VERSION:
            got, expected = f"version {version!r}", f"version {FORMAT_VERSION}"
            raise ResultsFileError(f"log {path}", got, expected, remedy="Run it again.")
        try:
            run = from_plain(cls, plain, "run")
        except AigtoError as error:
            raise ResultsFileError(
                f"log {path} is damaged", got=error, remedy="Run it again."
            ) from error
        return dataclasses.replace(run, known_world=world or World.from_scenario(run.scenario))


def is_run(data: object) -> bool:
    """Returns whether data of a file say that they are the log of a run."""
    return isinstance(data, dict) and data.get("format") == FORMAT
