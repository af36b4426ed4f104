"""Runs of a loop: how plants differ from models, what happened, and plans as they changed."""

from __future__ import annotations

import dataclasses
import json
import os
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from drake_aigto.arrays import ArrayRecord, Floats, LockedArrays, locked
from drake_aigto.control.ports import TickStatus
from drake_aigto.errors import AigtoError, ControlError, ResultsFileError
from drake_aigto.plain import LEFT_OUT, from_plain, read_json, to_plain, write_text
from drake_aigto.simulation import Arrival, Replay
from drake_aigto.world import Scenario, World

FORMAT, FORMAT_VERSION = "drake_aigto closed loop", 2
HEAD = {"format": FORMAT, "version": FORMAT_VERSION, "simulation": True}

Method = Literal["tracking", "replanning"]


@dataclass(frozen=True, eq=False)
class Disturbance(ArrayRecord):
    """Differences of a plant in the loop from its model. The default is none.

    Letters: n coordinates. An empty array stands for zeros.

    Attributes:
        start_offset: of q(0) from the scenario's, shape (n,) [m, rad].
        mass_factor: of the masses of all links that move, and of their inertias.
        wall_shift: how much nearer each wall stands, along its normal [m].
        restitution_factor: of the scenario's restitution.
        friction_factor: of μ of each contact, and of friction in joints.
        stiffness_factor: of all compliant walls.
        saturation: |u| at most that acts on the plant, shape (nu,) [N, N m].
        kick: by how much v jumps, shape (n,) [m/s, rad/s].
        kick_time: when it does, before the run ends [s].
        noise: standard deviations of the estimate of q and v, shape (nq + n,), drawn anew
            at each of the controller's periods [m, rad, 1/s].
        seed: of the noise.
        delay: from a command of the controller to its acting on the plant, within a millisecond;
            until the first one acts there is no control [s].
    """

    start_offset: Floats = field(default_factory=lambda: np.empty(0))
    mass_factor: float = 1.0
    wall_shift: float = 0.0
    restitution_factor: float = 1.0
    friction_factor: float = 1.0
    stiffness_factor: float = 1.0
    saturation: Floats = field(default_factory=lambda: np.empty(0))
    kick: Floats = field(default_factory=lambda: np.empty(0))
    kick_time: float = 0.0
    noise: Floats = field(default_factory=lambda: np.empty(0))
    seed: int = 0
    delay: float = 0.0

    def __post_init__(self) -> None:
        """Checks what does not depend on a world, and makes the arrays read-only.

        Raises:
            ControlError: numbers that are not finite, or out of their range.
        """
        for name in ("start_offset", "kick", "noise", "saturation"):
            row = np.atleast_1d(np.array(getattr(self, name), dtype=float))
            if row.ndim != 1 or not np.all(np.isfinite(row)):
                raise ControlError(name, got=row.tolist(), expected="a row of finite numbers")
            object.__setattr__(self, name, locked(row))
        positive = ("mass_factor", "stiffness_factor")
        for name in (*positive, "restitution_factor", "friction_factor", "kick_time", "delay"):
            value = getattr(self, name)
            if not (np.isfinite(value) and (value > 0 if name in positive else value >= 0)):
                least = "above 0" if name in positive else "of at least 0"
                raise ControlError(name, got=value, expected=f"a number {least}")
        if np.any(self.saturation <= 0):
            got = self.saturation.tolist()
            raise ControlError("saturation", got=got, expected="limits above zero")
        if not np.isfinite(self.wall_shift):
            raise ControlError("wall_shift", got=self.wall_shift, expected="a finite number [m]")
        if np.any(self.noise < 0):
            raise ControlError("noise", got=self.noise.tolist(), expected="standard deviations")

    def apply(self, world: World, scenario: Scenario) -> tuple[World, Scenario]:
        """Returns the true world and scenario.

        Raises:
            ControlError: sizes that are not the world's, a restitution that is not the scenario's
                or would be above 1, no friction to change, or walls that can't stand
                nearer.
            ModelError: a wall moves (`World.with_wall_moved`), or has no stiffness.
        """
        self._check_sizes(world)
        scenario, changes = world.place(scenario), dict[str, object]()
        if self.start_offset.any():
            changes["initial_position"] = world.add(scenario.initial_position, self.start_offset)
        if self.restitution_factor != 1:
            changes["restitution"] = self._find_restitution(world, scenario)
        if self.friction_factor != 1:
            changes |= self.change_friction(world, scenario)
        true = dataclasses.replace(scenario, **changes)  # type: ignore[arg-type]
        if "dry_friction" in changes:
            world = World.from_scenario(true)
        if self.friction_factor != 1 and scenario.friction is None and world.frictions:
            world = world.with_friction(self.friction_factor)
        if self.mass_factor != 1:
            world = world.of_diagram(world.diagram, self.mass_factor * world.mass_factor)
        if self.stiffness_factor != 1:
            world = world.with_stiffness(self.stiffness_factor)
        return (self._move_walls(world) if self.wall_shift else world), true

    def check_times(self, end: float) -> None:
        """Checks that a kick comes, and commands act, before a run ends [s].

        Raises:
            ControlError: one does not.
        """
        if self.delay >= end:
            got, expected = f"{self.delay:g} s", f"less than the run's {end:g} s"
            raise ControlError("delay", got=got, expected=expected)
        if self.kick.any() and not 0 < self.kick_time < end:
            got, expected = f"{self.kick_time}", f"after the start, before the end at {end:g} s"
            raise ControlError("kick_time", got=got, expected=expected)

    def _check_sizes(self, world: World) -> None:
        n = world.num_velocities
        sizes = {"start_offset": n, "kick": n, "noise": world.num_positions + n}
        sizes["saturation"] = world.num_actuators
        for name, size in sizes.items():
            got = len(getattr(self, name))
            if got not in (0, size):
                raise ControlError(
                    name, got=f"{got} number{'s' * (got > 1)}", expected=f"{size}, or none"
                )

    def _find_restitution(self, world: World, scenario: Scenario) -> float:
        """Returns the true one."""
        own = [c.name for c in world.contacts if c.restitution is not None]
        got = None
        if scenario.contact == "compliant":
            got = "compliant walls, which have none"
        elif own or not world.contacts:
            got = f"{own[0]}, which has its own" if own else "no wall"
        elif (e := self.restitution_factor * scenario.restitution) <= 1:
            return e
        raise ControlError(
            "restitution_factor",
            got=got or f"{self.restitution_factor:g} times {scenario.restitution:g}",
            expected="rigid walls with the scenario's restitution, and no more than 1 in the end",
        )

    def change_friction(self, world: World, scenario: Scenario) -> dict[str, Any]:
        """Returns what the true scenario has in place of its friction, if not the world.

        Raises:
            ControlError: there is none.
        """
        given = {"friction": scenario.friction, "dry_friction": world.dry_friction}
        if world.dry_friction is None and not np.any(world.friction_coefficients(scenario)):
            got, expected = "no friction", "friction in joints, or of contacts"
            raise ControlError("friction_factor", got=got, expected=expected)
        return {name: self.friction_factor * of for name, of in given.items() if of is not None}

    def _move_walls(self, world: World) -> World:
        """Returns a world whose walls stand nearer."""
        if not world.contacts:
            raise ControlError("wall_shift", got="no wall", expected="walls")
        for faces in world.solids:
            if len(faces) > 1:
                raise ControlError(
                    "wall_shift",
                    got=f"{world.contacts[faces[0]].name}, one of {len(faces)} faces of a block",
                    expected="walls that have one face, and can stand nearer",
                )
        walls = [pair[1] for pair in world.shapes]
        return world.with_walls_moved({walls.index(wall): self.wall_shift for wall in walls})

    def draw_noise(self, count: int) -> Floats:
        """Returns the noise of q and v at each of a count of periods, shape (count, 2n)."""
        return self.noise * np.random.default_rng(self.seed).normal(size=(count, len(self.noise)))


@dataclass(frozen=True, eq=False)
class PlannedPath(LockedArrays, ArrayRecord):
    """A plan as a controller had it: no simulation.

    Attributes:
        times: of its knots, shape (K,) [s].
        states: q and v there, shape (K, 2n).
    """

    times: Floats
    states: Floats


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
class ClosedLoopRun(LockedArrays):
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
        is_filtered: whether a `StateFilter` stood before the controller.
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
    is_filtered: bool = False
    known_world: World | None = field(default=None, compare=False, repr=False, metadata=LEFT_OUT)

    def __repr__(self) -> str:
        """Returns a line without arrays: the cost, and what no cost is shown without."""
        replay = self.replay
        parts = [
            self.method,
            f"cost={self.cost:.4g}",
            f"promised={self.promised:.4g}",
            f"reached={self.arrival.is_reached}",
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
    def arrival(self) -> Arrival:
        """How near its goal the plant ended."""
        ends = self.replay.positions, self.replay.velocities, self.controls
        return Arrival.of(self.world, self.scenario, *ends)

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
        """The world that was simulated, but for its stiffness."""
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
