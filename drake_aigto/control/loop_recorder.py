"""Watches a plant and its controller while Drake's Simulator runs them."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np
from pydrake.systems.framework import Context, EventStatus

from drake_aigto.arrays import Floats, read_only
from drake_aigto.control.disturbance import Disturbance
from drake_aigto.control.loop_run import ClosedLoopRun, PlannedPath, PlanSwitch
from drake_aigto.control.predictive import ModelPredictiveController, TickStatus
from drake_aigto.control.tracking import TrackingController
from drake_aigto.simulation import (
    ContactMonitor,
    ContactTrace,
    Held,
    Recording,
    Replay,
    StepEnd,
    read_steps,
    summarize,
)
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import Scenario, World

LoopController: TypeAlias = TrackingController | ModelPredictiveController


class LoopRecorder:
    """Watches a simulation: the end of each step, and what the controller says of its plans."""

    def __init__(
        self,
        world: World,
        controller: LoopController,
        contacts: ContactMonitor | None,
        end: float,
        progress: Callable[[str], None] | None,
    ) -> None:
        """Has seen nothing yet.

        Args:
            world: of the diagram that is simulated.
            controller: in it.
            contacts: plans steps between stiff walls; None: walls yield, or there are none.
            end: of the simulation [s].
            progress: called with a line of text.
        """
        self._world, self._controller, self._contacts = world, controller, contacts
        self._end, self._say = end, progress or (lambda line: None)
        self._rows: list[StepEnd] = []
        self._kicked: list[int] = []  # rows just after a kick
        self._ticks: list[TickStatus] = []
        self._plans: list[PlannedPath] = []
        self._switches: list[PlanSwitch] = []

    @property
    def has_moved(self) -> bool:
        """Whether there is any motion."""
        return len(self._rows) > 1 and self._rows[-1].time > 0

    def watch(self, root: Context) -> EventStatus:
        """Notes the end of a step; between stiff walls it plans the next ones."""
        self._add(root)
        if isinstance(self._controller, ModelPredictiveController):
            self._look(self._controller, self._controller.GetMyContextFromRoot(root))
        elif not self._plans:
            self._plans.append(_read_path(self._controller.plan.trajectory))
        if self._contacts is not None:
            self._contacts(root)
        return EventStatus.DidNothing()

    def kick(self, root: Context, jump: Floats) -> None:
        """Has the velocities jump."""
        plant = self._world.plant
        context = plant.GetMyMutableContextFromRoot(root)
        plant.SetVelocities(context, plant.GetVelocities(context) + jump)
        self._kicked.append(len(self._rows))
        self._add(root)
        if self._contacts is not None:
            self._contacts.plan(root)

    def _add(self, root: Context) -> None:
        plant, controller = self._world.plant, self._controller
        x = plant.GetPositionsAndVelocities(plant.GetMyContextFromRoot(root))
        port = controller.GetOutputPort("control")
        u = np.array(port.Eval(controller.GetMyContextFromRoot(root)))
        self._rows.append(StepEnd(root.get_time(), np.array(x), u))
        self._say(f"simulating, {root.get_time():.2f} of {self._end:.2f} s")

    def _look(self, controller: ModelPredictiveController, context: Context) -> None:
        """Notes a tick that is new, and a plan that took the place of another."""
        status: TickStatus = controller.GetOutputPort("status").Eval(context)
        if self._ticks and status.time == self._ticks[-1].time:
            return
        planned = _read_path(controller.read_plan(context))
        if self._ticks and status.has_switched:
            self._switches.append(PlanSwitch(status.time, self._plans[-1], planned))
        self._ticks.append(status)
        # Of all plans the first is kept, and the last.
        self._plans = [*self._plans[:1], planned]

    @property
    def _promised(self) -> float:
        """What the first plan costs."""
        controller = self._controller
        is_tracking = isinstance(controller, TrackingController)
        return controller.plan.cost if is_tracking else self._ticks[0].cost

    def read(
        self,
        world: World,
        scenario: Scenario,
        true: Scenario,
        disturbance: Disturbance,
        is_interrupted: bool,
    ) -> ClosedLoopRun:
        """Returns the run.

        Args:
            world: that the controller knows.
            scenario: that it knows.
            true: the scenario that was simulated.
            disturbance: between them.
            is_interrupted: whether it ended early.
        """
        recording = self._record()
        recording.simulator = "drake"
        times = np.append(recording.control_times, self._rows[-1].time)
        controls = np.array(recording.controls)
        replay = summarize(self._world, true, recording, self._rows[-1].time)
        replay = _scale_energies(replay, disturbance.mass_factor)
        return ClosedLoopRun(
            method="replanning" if self._ticks else "tracking",
            scenario=scenario,
            disturbance=disturbance,
            replay=replay,
            control_times=read_only(times),
            controls=read_only(controls),
            promised=self._promised,
            plan=self._plans[0],
            ticks=tuple(self._ticks),
            switches=tuple(self._switches),
            is_interrupted=is_interrupted,
            world=world,
        )

    def _record(self) -> Recording:
        """Returns what was seen, as simulations of a held control have it."""
        holds = self._list_holds()
        if self._contacts is not None:
            return self._record_stiff(holds)
        recording = Recording()
        for number, row in enumerate(self._rows):
            recording.add(row.time, *np.split(row.x, 2))
            if number in holds:
                recording.hold(row.time, holds[number])
        read_steps(self._world, self._rows, recording)
        return recording

    def _record_stiff(self, holds: Mapping[int, Floats]) -> Recording:
        assert self._contacts is not None
        trace = ContactTrace(self._world)
        for number, row in enumerate(self._rows):
            # A step's end belongs to the control that led there, but for the first.
            if number == 0:
                trace.hold(row.time, Held(holds[number], np.inf))
            trace.add(row.time, row.x)
            if number in holds and number > 0:
                trace.hold(row.time, Held(holds[number], np.inf))
        recording = trace.read(self._rows[-1].time)
        recording.matched_speeds = self._contacts.speeds
        return recording

    def _list_holds(self) -> dict[int, Floats]:
        """Returns from which rows on another control was held, and those where v jumped."""
        holds: dict[int, Floats] = {}
        held = np.empty(0)
        for number, (row, after) in enumerate(itertools.pairwise(self._rows)):
            is_step = after.time > row.time
            if number in self._kicked or (is_step and not np.array_equal(after.control, held)):
                holds[number] = held = after.control
        return holds


def _read_path(trajectory: Trajectory) -> PlannedPath:
    """Returns a plan's knots."""
    return PlannedPath(trajectory.times, np.hstack([trajectory.positions, trajectory.velocities]))


def _scale_energies(replay: Replay, factor: float) -> Replay:
    """Returns a simulation with the energies of masses that are so many times the model's."""
    before, after = (
        tuple(factor * energy for energy in energies)
        for energies in (replay.energies_before, replay.energies_after)
    )
    return dataclasses.replace(replay, energies_before=before, energies_after=after)
