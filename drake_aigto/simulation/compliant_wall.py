"""Drake's own contact: the continuous plant, its compliant walls, and an implicit rule."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig

from drake_aigto.arrays import Floats
from drake_aigto.simulation.contact_motion import Clearance, ContactMotion, calc_time_to_wall
from drake_aigto.simulation.controller import Controller, Held
from drake_aigto.simulation.material import calc_dissipation, contact_delays, set_dissipation
from drake_aigto.simulation.recording import Impact, Recording, Rest

if TYPE_CHECKING:
    from pydrake.systems.framework import Context

    from drake_aigto.world import World

# Radau's rule at this accuracy returns the energy of an elastic bounce to 1e-5. At such stiffness
# explicit rules make energy from nothing (2.9 times the speed), and so does implicit Euler.
_SCHEME = "radau3"
_ACCURACY = 1e-5
# Flight advances by this part of the predicted time to the wall, then predicts again, …
_APPROACH = 0.9
# … and at least so often, as a part of the simulated time.
_FLIGHT = 1 / 100
# The rest in durations of a contact. This near to the wall in time, and in it,
_NEAR = 0.5
# steps are so fine that no contact is stepped over and its depth is well resolved, …
_FINE_STEP = 1 / 20
# … unless it is older than this, so that the ball rests, …
_SETTLED = 3.0
# … or as slow as this part of the fastest approach so far. Then they may be so long.
_SLOW = 1e-2
_COARSE_STEP = 10.0
# Radau's rule has its Jacobian from differences of √ε, and nearer to a wall than this part of the
# largest position, or of 1 m, takes it for touched. What leaves a wall goes on in fine steps until
# it is farther, unless that takes so many durations of a contact.
_BLURRED, _LINGERS = 1e-7, 30.0
# Dissipation is matched to no speed below this part of the fastest approach so far: it grows as
# speeds fall, and with it the number of steps that bodies take which are pressed together.
_SLOWEST_MATCH = 5e-2


def simulate_compliant_wall(
    world: World,
    state: tuple[Floats, Floats],
    controller: Controller,
    restitutions: Floats,
    without_friction: bool = False,
) -> Recording:
    """Runs a controller on the world's own plant, by Radau's implicit rule.

    A contact of restitution 1 keeps the model's dissipation. Any other gets, just before each
    impact, the Hunt-Crossley dissipation that makes its restitution at the speed that is coming.
    The plant and its scene graph stay as they are: it goes into the context alone.

    A controller that feels contact is asked again when one ends. While one goes on it is not, for
    no plan says how fast the ball should be inside a wall; unless it lasts so long that it is rest.

    Args:
        world: its diagram is simulated, its stiffness decides where steps must be fine.
        state: the start, (q, v).
        controller: decides the control, open or closed loop.
        restitutions: e of each contact, in [0, 1], shape (m,).
        without_friction: whether to leave the model's friction out, in the same way.

    Returns:
        The states whenever the controller is asked, at the end, and where each contact begins, is
        deepest, and ends.

    Raises:
        ModelError: a shape has no stiffness.
    """
    root = world.create_context()
    if without_friction:
        world.remove_friction(root)
    context = world.plant.GetMyMutableContextFromRoot(root)
    world.plant.SetPositionsAndVelocities(context, np.concatenate(state))
    root.SetTime(controller.start)
    simulator = Simulator(world.diagram, root)
    config = SimulatorConfig(integration_scheme=_SCHEME, accuracy=_ACCURACY, use_error_control=True)
    ApplySimulatorConfig(config, simulator)
    delays, motion = contact_delays(world), ContactMotion(world.constant_inertia)
    matching = _Matching(world, root, restitutions, delays)
    pace = _Pace(world, motion, delays, controller, matching)
    trace = _Trace(world, motion, delays)
    simulator.set_monitor(
        lambda _: trace.add(context.get_time(), world.plant.GetPositionsAndVelocities(context))
    )
    longest_step = math.inf
    held: Held | None = None
    while (now := context.get_time()) < controller.end:
        x = world.plant.GetPositionsAndVelocities(context)
        if held is None or trace.is_due(now, held, controller):
            held = controller.sample(now, x, trace.bounces)
            trace.hold(now, held.control)
            world.plant.get_actuation_input_port().FixValue(context, held.control)
        stretch, step = pace.plan(now, x, held.control)
        if step > longest_step:
            _forget(simulator)
        longest_step = step
        simulator.get_mutable_integrator().set_maximum_step_size(step)
        until = held.until if held.until > now else controller.end
        simulator.AdvanceTo(min(now + stretch, until))
    recording = trace.read(controller.end)
    recording.matched_speeds = matching.speeds
    return recording


def _forget(simulator: Simulator) -> None:
    """Starts the integrator anew, which leaves a wall.

    Radau's rule keeps its Jacobian as long as Newton's method converges with it. That of a contact
    is a million times too stiff for flight, and may converge to a wrong velocity, in tiny steps.
    """
    integrator = simulator.get_mutable_integrator()
    integrator.Reset()
    integrator.set_target_accuracy(_ACCURACY)
    integrator.Initialize()


class _Matching:
    """Gives contacts the dissipation for the impact that is coming."""

    def __init__(
        self, world: World, root: Context, restitutions: Floats, delays: list[float]
    ) -> None:
        self._world = world
        self._root = root
        self._restitutions = restitutions.tolist()
        self._delays = delays
        self.speeds: list[float] = []

    def match(self, near: Clearance, push: float, slowest: float) -> None:
        """Sets the dissipation for the speed of an approach, or of rest, or the slowest."""
        e = self._restitutions[near.contact]
        speed = math.sqrt(max(near.rate**2 - 2 * push * near.distance, 0.0))
        speed = max(speed, slowest, abs(push) * self._delays[near.contact])
        if e < 1 and speed > 0:
            set_dissipation(self._world, self._root, near.contact, calc_dissipation(e, speed))
            self.speeds.append(speed)


class _Pace:
    """Chooses how far to simulate next, and in what steps, so that no contact is missed."""

    def __init__(
        self,
        world: World,
        motion: ContactMotion,
        delays: list[float],
        controller: Controller,
        matching: _Matching,
    ) -> None:
        self._world = world
        self._motion = motion
        start, flight = controller.start, _FLIGHT * (controller.end - controller.start)
        shortest = [min(delays[i] for i in faces) for faces in motion.solids]
        self._solids = [_SolidPace(delay, flight, start, matching) for delay in shortest]

    def plan(self, time: float, x: Floats, control: Floats) -> tuple[float, float]:
        """Returns how long to go on before planning again, and the longest step [s]."""
        clearances = self._motion.calc_clearances(x)
        acceleration = _calc_acceleration(self._world, self._motion, x, control, clearances)
        pushes = self._motion.calc_pushes(acceleration)
        blurred = _BLURRED * max(1.0, float(np.max(np.abs(x[: x.size // 2]))))
        plans = [
            pace.plan(time, near, pushes[near.contact], blurred)
            for pace, near in zip(self._solids, clearances, strict=True)
        ]
        return min(stretch for stretch, _ in plans), min(step for _, step in plans)


class _SolidPace:
    """What one solid asks for."""

    def __init__(self, delay: float, flight: float, start: float, matching: _Matching) -> None:
        self._delay = delay
        self._flight = flight
        self._matching = matching
        self._touched = start  # no contact that is still going on began before this [s]
        self._is_slow = False
        self._is_matched = False
        self._fastest = 0.0  # approach so far [m/s]

    def plan(
        self, time: float, near: Clearance, push: float, blurred: float
    ) -> tuple[float, float]:
        """Returns how long to go on before planning again, and the longest step [s].

        Args:
            time: now [s].
            near: where the ball is.
            push: φ̈ without this contact [m/s²].
            blurred: how near an integrator takes a wall for touched [m].
        """
        self._fastest = max(self._fastest, -near.rate)
        if 0 < near.distance < blurred:
            leaving = calc_time_to_wall(blurred - near.distance, -near.rate, -push)
            if leaving < _LINGERS * self._delay:
                step = _FINE_STEP * self._delay
                return max(leaving, step), step
        if near.distance > 0:
            fall = calc_time_to_wall(near.distance, near.rate, push)
            if fall > _NEAR * self._delay:
                stretch = min(_APPROACH * fall, self._flight)
                self._touched, self._is_slow, self._is_matched = time + stretch, False, False
                return stretch, stretch
            self._touched, self._is_slow = time, -near.rate <= _SLOW * self._fastest
        if near.rate < 0 and not self._is_matched:
            self._matching.match(near, push, _SLOWEST_MATCH * self._fastest)
            self._is_matched = True
        if self._is_slow or time - self._touched > _SETTLED * self._delay:
            return _COARSE_STEP * self._delay, _COARSE_STEP * self._delay
        return self._delay, _FINE_STEP * self._delay


def _calc_acceleration(
    world: World,
    motion: ContactMotion,
    x: Floats,
    control: Floats,
    clearances: list[Clearance],
    but: int | None = None,
) -> Floats:
    """Returns v̇ as if the ball rested on all that it touches, but for one contact [m/s²]."""
    q, v = np.split(x, 2)
    touched = [near.contact for near in clearances if near.distance <= 0 and near.contact != but]
    return motion.calc_supported(world.calc_acceleration(q, v, control), touched)


class _Sample(NamedTuple):
    """The end of a step, and the control that led to it."""

    time: float
    x: Floats
    control: Floats
    clearances: list[Clearance]  # of each solid


class _Row(NamedTuple):
    """A moment of a contact."""

    time: float
    x: Floats
    push: float  # φ̈ without this contact [m/s²]


class _Trace:
    """Every step of a simulation, and the contacts that are read off it."""

    def __init__(self, world: World, motion: ContactMotion, delays: list[float]) -> None:
        self._world = world
        self._motion = motion
        self._delays = delays
        self._samples: list[_Sample] = []
        self._control = np.zeros(world.num_actuators)
        self._recording = Recording()
        # Of each solid that is touched: since when [s], and which face.
        self._touched: dict[int, tuple[float, int]] = {}
        self.bounces: list[int] = []  # the contact of each touch that has ended
        self._known = 0  # of them when the controller was asked

    def add(self, time: float, x: Floats) -> None:
        """Appends a step's end."""
        clearances = self._motion.calc_clearances(x)
        self._samples.append(_Sample(time, x, self._control, clearances))
        for solid, near in enumerate(clearances):
            if near.distance <= 0:
                self._touched.setdefault(solid, (time, near.contact))
            elif solid in self._touched:
                self.bounces.append(self._touched.pop(solid)[1])

    def hold(self, time: float, control: Floats) -> None:
        """Appends a control, held from now on."""
        self._recording.hold(time, control)
        self._control, self._known = control, len(self.bounces)

    def is_due(self, time: float, held: Held, controller: Controller) -> bool:
        """Returns whether the controller is to be asked again."""
        if controller.feels_contact:
            if len(self.bounces) > self._known:
                return True
            touches = self._touched.values()
            if any(time - since < _SETTLED * self._delays[contact] for since, contact in touches):
                return False
        return time >= held.until

    def read(self, end: float) -> Recording:
        """Returns the states at samples and about contacts, and the impacts."""
        recording = self._recording
        at_samples = {*recording.control_times, end}
        rows = [(sample.time, sample.x) for sample in self._samples if sample.time in at_samples]
        for solid in range(len(self._motion.solids)):
            depth = self._calc_depth(solid)
            recording.max_penetration = max(recording.max_penetration, depth)
            for first, last in self._find_contacts(solid):
                touch, release = self._find_touch(solid, first), self._find_release(solid, last)
                deepest = min(
                    self._samples[first : last + 1],
                    key=lambda sample: sample.clearances[solid].distance,
                )
                rows += [(row.time, row.x) for row in (touch, deepest, release)]
                impact = self._calc_impact(self._face(solid, first), touch, release)
                if impact is not None:
                    recording.impacts.append(impact)
                elif touch.push < 0:
                    recording.rests.append(Rest(touch.time, self._face(solid, first)))
        recording.impacts.sort(key=lambda impact: impact.time)
        recording.rests.sort(key=lambda rest: rest.time)
        for time, x in sorted(rows, key=lambda row: row[0]):
            recording.add(time, *np.split(x, 2))
        return recording

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

    def _find_touch(self, solid: int, first: int) -> _Row:
        """Returns when and how contact began: from the flight before it, or the very start."""
        before = self._samples[max(first - 1, 0)]
        control, face = self._samples[first].control, self._face(solid, first)
        return self._extrapolate(before, control, face, 1.0 if first else 0.0)

    def _find_release(self, solid: int, last: int) -> _Row:
        """Returns when and how contact ended: from the flight after it, or the very end."""
        ends = last == len(self._samples) - 1
        after = self._samples[last if ends else last + 1]
        return self._extrapolate(after, after.control, self._face(solid, last), float(ends) - 1)

    def _extrapolate(self, sample: _Sample, control: Floats, face: int, direction: float) -> _Row:
        """Returns when and how flight is at the wall, forward (+1) or backward (−1); 0: as is."""
        x = sample.x
        clearances = sample.clearances
        acceleration = _calc_acceleration(
            self._world, self._motion, x, control, clearances, but=face
        )
        push = self._motion.calc_pushes(acceleration)[face]
        distances, rates = self._motion.calc_distances(x)
        t = calc_time_to_wall(max(distances[face], 0.0), direction * rates[face], push)
        t = direction * t if direction and math.isfinite(t) else 0.0
        q, v = np.split(x, 2)
        moved = np.concatenate([q + t * v + t**2 / 2 * acceleration, v + t * acceleration])
        return _Row(sample.time + t, moved, push)

    def _calc_impact(self, contact: int, touch: _Row, release: _Row) -> Impact | None:
        """Returns the impact, or None if the control alone could stop so slow a ball in contact."""
        speed = -self._motion.calc_distances(touch.x)[1][contact]
        if speed <= abs(touch.push) * self._delays[contact]:
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
