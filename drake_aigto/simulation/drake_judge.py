"""Drake's judge: the continuous plant with its compliant walls, simulated and recorded."""

from __future__ import annotations

import itertools
import math
import weakref
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from pydrake.systems.framework import Context, EventStatus

from drake_aigto.arrays import Floats
from drake_aigto.contact import (
    Clearance,
    ContactMotion,
    calc_delays,
    calc_time_to_wall,
    read_clearances,
)
from drake_aigto.geometry import BALL, BOX, CAPSULE, HULL
from drake_aigto.simulation.compliant import find_depth, measure_steps, read_touches
from drake_aigto.simulation.recording import Controller, Held, Impact, Recording, sample_steps
from drake_aigto.simulation.simulator import SETTLED, calc_acceleration, start_plant
from drake_aigto.simulation.verdict import calc_lateness
from drake_aigto.world import Scenario, SpaceWorld, World

# Forces that jump from step to step, as where Drake iterates for the depth of two capsules, bring
# error control to a standstill. After this number of steps, four times the most that eight shipped
# scenarios took, none is shorter than this part of the time that is left, whatever its error.
_MOST_STEPS, _SHORTEST = 50_000, 2e-5


class DrakeJudge:
    """Simulates the world's own continuous plant in Drake, for its actuation (a `Judge`).

    Its walls are compliant, so each bounce is late by `contact_delay` and dips in by v √(m / k).
    The restitution that Hunt-Crossley dissipation makes depends on the speed. So it is set before
    each impact for the speed that is coming (`Recording.matched_speeds`), or to zero for
    restitution 1, in the simulation's context alone, and so is friction if the scenario leaves that
    out. A ball rolls round the corners of a box, which our own judge takes for sharp. If the
    scenario's contact is compliant, walls are as the model has them, and nothing is late.
    """

    def simulate(self, world: World, scenario: Scenario, controller: Controller) -> Recording:
        """Runs a controller from the scenario's start.

        A controller that feels contact is asked again when one with a stiff wall ends. While one
        goes on it is not, for no plan says how fast the ball should be inside a wall; unless it
        lasts so long that it is rest.

        Raises:
            ModelError: a shape of the contact has no stiffness.
        """
        recording, is_stiff = _simulate(world, scenario, controller)
        if is_stiff:
            recording.error, recording.cost_error = calc_lateness(world, scenario, controller)
        if isinstance(world, SpaceWorld):
            recording.touch_error = find_touch_error(world, recording.positions)
        recording.simulator = "drake"
        return recording


def _simulate(world: World, scenario: Scenario, controller: Controller) -> tuple[Recording, bool]:
    """Runs a controller on the world's own plant, and says whether its walls are stiff.

    Each contact with a stiff wall gets, just before an impact, the dissipation that makes its
    restitution at the speed that is coming (`ContactMonitor`). The plant and its scene graph stay
    as they are.

    Returns:
        The states whenever the controller is asked, at the end, and where each contact with a stiff
        wall begins, is deepest, and ends.
    """
    plant = world.plant
    simulator, contacts = start_plant(world, scenario, (controller.start, controller.end))
    root = simulator.get_mutable_context()
    context = plant.GetMyMutableContextFromRoot(root)
    trace = StepTrace(world) if contacts is None else ContactTrace(world)
    # A simulator holds its monitor: with a strong reference, neither would ever be freed.
    running = weakref.ref(simulator)

    def watch(root: Context) -> EventStatus:
        now = root.get_time()
        if (alive := running()) and alive.get_integrator().get_num_steps_taken() == _MOST_STEPS:
            integrator = alive.get_mutable_integrator()
            integrator.set_requested_minimum_step_size(_SHORTEST * (controller.end - now))
            integrator.set_throw_on_minimum_step_size_violation(False)
        trace.add(now, plant.GetPositionsAndVelocities(plant.GetMyContextFromRoot(root)))
        if trace.is_due(now, controller.feels_contact):
            return EventStatus.ReachedTermination(world.diagram, "the controller is asked again")
        if contacts is not None:
            contacts(root)
        return EventStatus.DidNothing()

    simulator.set_monitor(watch)
    while (now := context.get_time()) < controller.end:
        if trace.is_due(now, controller.feels_contact):
            x = plant.GetPositionsAndVelocities(context)
            held = controller.sample(now, x, trace.bounces)
            trace.hold(now, held)
            world.fix_control(root, held.control)
            if contacts is not None:
                contacts.plan(root)
        simulator.AdvanceTo(held.until if held.until > now else controller.end)
    recording = trace.read(controller.end)
    recording.matched_speeds = [] if contacts is None else contacts.speeds
    return recording, contacts is not None


class StepEnd(NamedTuple):
    """The end of a step."""

    time: float  # [s]
    x: Floats  # (q, v)
    control: Floats  # that led there
    clearances: Sequence[Clearance] = ()  # of each solid, between stiff walls


class StepTrace:
    """Every step of a simulation, and what is read off it: of walls as the model has them.

    Attributes:
        bounces: the contact of each touch of a stiff wall that has ended so far.
    """

    def __init__(self, world: World, keeps_all: bool = False) -> None:
        """Begins with nothing; the first control has to be held before the first step.

        Recordings have the ends of all steps, or of those at which the control changes.
        """
        self._world, self._keeps_all = world, keeps_all
        self._samples: list[StepEnd] = []
        self._held: Held | None = None
        self._recording = Recording()
        self.bounces: list[int] = []

    def add(self, time: float, x: Floats) -> None:
        """Appends a step's end."""
        assert self._held is not None, "a control is held from the start"
        last = self._samples[-1] if self._samples else None
        if last is None or time > last.time or not np.array_equal(x, last.x):
            self._samples.append(StepEnd(time, x, self._held.control))

    def hold(self, time: float, held: Held) -> None:
        """Appends a control, held from now on."""
        self._recording.hold(time, held)
        self._held = held

    def is_due(self, time: float, feels_contact: bool) -> bool:
        """Returns whether a controller is to be asked again, or for the first time."""
        return self._held is None or time >= self._held.until

    def read(self, end: float) -> Recording:
        """Returns the states whenever the control changed, at the end, and about contacts."""
        recording = self._recording
        columns = (np.array([sample[k] for sample in self._samples]) for k in range(3))
        recording.samples.append(sample_steps(self._world, *columns))
        kept = {*recording.control_times, end}
        rows = [(row.time, row.x) for row in self._samples if self._keeps_all or row.time in kept]
        rows += self._read_contacts(recording)
        # Of several at one time, the first of the world's comes first.
        recording.impacts.sort(key=lambda impact: (impact.time, impact.contact))
        for time, x in sorted(rows, key=lambda row: row[0]):
            recording.add(time, *np.split(x, [self._world.num_positions]))
        return recording

    def _read_contacts(self, recording: Recording) -> list[tuple[float, Floats]]:
        """Adds contacts and depth, and returns the times and states that are kept of them."""
        world, rows = self._world, self._samples
        times, states = np.array([row.time for row in rows]), np.array([row.x for row in rows])
        distances, rates = measure_steps(world, states)
        recording.max_penetration = find_depth(times, distances, rates)
        # A step's end belongs to the control that led there.
        ahead = np.array([row.control for row in (*rows[1:], rows[-1])])
        recording.impacts, _ = read_touches(world, times, states, ahead, distances)
        return []


class _Row(NamedTuple):
    """A moment of a contact."""

    time: float
    x: Floats
    push: float  # φ̈ without this contact [m/s²]


class ContactTrace(StepTrace):
    """The same between stiff walls, with the contacts that are read off it."""

    def __init__(self, world: World) -> None:
        """Begins with nothing; the first control has to be held before the first step."""
        super().__init__(world)
        self._motion_at = ContactMotion.reader(world)
        # Of each solid that is touched: when it is rest [s], and which face.
        self._touched: dict[int, tuple[float, int]] = {}
        self._known = 0  # bounces when the controller was asked

    def add(self, time: float, x: Floats) -> None:
        """Appends a step's end."""
        if self._world.has_constant_inertia:
            clearances = self._motion_at(x).calc_clearances(x)
        else:  # Without a mass matrix, which only contacts need.
            clearances = read_clearances(self._world, x)
        assert self._held is not None, "a control is held from the start"
        self._samples.append(StepEnd(time, x, self._held.control, clearances))
        for solid, near in enumerate(clearances):
            if near.distance <= 0:
                if solid not in self._touched:
                    delay = calc_delays(self._motion_at(x), self._world.stiffness)[near.contact]
                    self._touched[solid] = time + SETTLED * delay, near.contact
            elif solid in self._touched:
                self.bounces.append(self._touched.pop(solid)[1])

    def hold(self, time: float, held: Held) -> None:
        """Appends a control, held from now on."""
        super().hold(time, held)
        self._known = len(self.bounces)

    def is_due(self, time: float, feels_contact: bool) -> bool:
        """Returns whether a controller is to be asked again, or for the first time."""
        if self._held is None:
            return True
        if feels_contact:
            if len(self.bounces) > self._known:
                return True
            if any(time < settled for settled, _ in self._touched.values()):
                return False
        return time >= self._held.until

    def _read_contacts(self, recording: Recording) -> list[tuple[float, Floats]]:
        """Adds contacts and depth, and returns their begins, deepest states, and ends."""
        rows: list[tuple[float, Floats]] = []
        for solid in range(self._world.num_solids):
            depth = self._calc_depth(solid)
            recording.max_penetration = max(recording.max_penetration, depth)
            for first, last in self._find_contacts(solid):
                # From the flights before and after it, or the very start and end.
                touch = self._extrapolate(solid, first, max(first - 1, 0))
                release = self._extrapolate(solid, last, min(last + 1, len(self._samples) - 1))
                deepest = min(
                    self._samples[first : last + 1],
                    key=lambda sample: sample.clearances[solid].distance,
                )
                rows += [(row.time, row.x) for row in (touch, deepest, release)]
                impact = self._calc_impact(self._face(solid, first), touch, release)
                if impact is not None:
                    recording.impacts.append(impact)
        return rows

    def _face(self, solid: int, index: int) -> int:
        """Returns which face of a solid a sample is at."""
        return self._samples[index].clearances[solid].contact

    def _is_on_face(self, solid: int, index: int) -> bool:
        """Returns whether Drake sees a contact: past an edge the ball rounds the corner."""
        q, _ = np.split(self._samples[index].x, 2)
        return bool(self._world.is_on_face(q)[self._face(solid, index)])

    def _find_contacts(self, solid: int) -> list[tuple[int, int]]:
        """Returns the first and the last sample of each stretch with φ ≤ 0."""
        inside = np.array([sample.clearances[solid].distance <= 0 for sample in self._samples])
        edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]])))
        stretches = [(int(first), int(after) - 1) for first, after in edges.reshape(-1, 2)]
        return [
            (first, last)
            for first, last in stretches
            if any(self._is_on_face(solid, index) for index in (first, last))
        ]

    def _extrapolate(self, solid: int, index: int, beside: int) -> _Row:
        """Returns when and how flight of the sample beside a sample in contact is at the wall."""
        (time, x, _, clearances), face = self._samples[beside], self._face(solid, index)
        control, direction = self._samples[max(index, beside)].control, float(index - beside)
        motion = self._motion_at(x)
        acceleration = calc_acceleration(self._world, motion, x, control, clearances, but=face)
        push = motion.calc_pushes(acceleration)[face]
        distances, rates = motion.calc_distances(x)
        t = calc_time_to_wall(max(distances[face], 0.0), direction * rates[face], push)
        t = direction * t if direction and math.isfinite(t) else 0.0
        q, v = np.split(x, 2)
        moved = np.concatenate([q + t * v + t**2 / 2 * acceleration, v + t * acceleration])
        return _Row(time + t, moved, push)

    def _calc_impact(self, contact: int, touch: _Row, release: _Row) -> Impact | None:
        """Returns the impact, or None if the control alone could stop so slow a ball in contact."""
        motion = self._motion_at(touch.x)
        speed = -motion.calc_distances(touch.x)[1][contact]
        if speed <= abs(touch.push) * calc_delays(motion, self._world.stiffness)[contact]:
            return None
        energies = (
            float(self._world.calc_kinetic_energy(*np.split(row.x, 2))) for row in (touch, release)
        )
        return Impact(touch.time, contact, speed, touch.push, *energies)

    def _calc_depth(self, solid: int) -> float:
        """Returns the deepest penetration, of the parabola wherever φ̇ turns positive."""
        deepest = 0.0
        for index, (before, after) in enumerate(itertools.pairwise(self._samples)):
            a, b = before.clearances[solid], after.clearances[solid]
            depth = -b.distance
            if a.contact == b.contact and a.rate < 0 < b.rate:
                t = (after.time - before.time) * a.rate / (a.rate - b.rate)
                depth = max(depth, -a.distance - a.rate * t / 2)
            if depth > deepest and self._is_on_face(solid, index + 1):
                deepest = depth
        return deepest


def find_touch_error(world: SpaceWorld, positions: Iterable[Floats]) -> float:
    """Returns how far Drake's touches of capsules and meshes are off the exact ones, at most [m].

    Drake finds where and how deep these overlap by an iteration that may end elsewhere.

    Args:
        world: whose shapes overlap.
        positions: q of each state, shape (nq,).
    """
    pairs = {
        frozenset(pair.shapes): i
        for i, (pair, (a, b)) in enumerate(zip(world.pairs, world.geometry.pair_kinds, strict=True))
        if (a, b) in ((CAPSULE, CAPSULE), (CAPSULE, BOX), (BALL, HULL))
    }
    if not pairs:
        return 0.0
    root, worst = world.create_context(), 0.0
    plant = world.plant.GetMyMutableContextFromRoot(root)
    scene = world.scene_graph.GetMyContextFromRoot(root)
    for q in positions:
        world.plant.SetPositions(plant, q)
        query = world.scene_graph.get_query_output_port().Eval(scene)
        for found in query.ComputePointPairPenetration():
            if (i := pairs.get(frozenset([found.id_A, found.id_B]), -1)) >= 0:
                middle = (found.p_WCa + found.p_WCb) / 2
                worst = max(worst, float(np.linalg.norm(middle - world.find_touch(i, q)[0])))
    return worst
