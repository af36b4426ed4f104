"""Drake's Simulator of the continuous plant, whose compliant walls return what they should."""

from __future__ import annotations

import math
import weakref
from collections.abc import Sequence

import numpy as np
from pydrake.geometry import GeometryId
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Context

from drake_aigto.arrays import Floats
from drake_aigto.contact import (
    Clearance,
    ContactMotion,
    calc_delays,
    calc_dissipation,
    calc_time_to_wall,
    contact_delays,
)
from drake_aigto.world import (
    DISSIPATION,
    STIFFNESS,
    Scenario,
    SpaceWorld,
    World,
    read_given,
    set_material,
)

# Radau's rule at this accuracy returns the energy of an elastic bounce to 1e-5. At such stiffness
# explicit rules make energy from nothing (2.9 times the speed), and so does implicit Euler.
_ACCURACY = 1e-5
# Where flight is no parabola it takes this, to be off by less than stiff walls are late.
_FINE_ACCURACY = 1e-6


def _make_config(rule: str, accuracy: float) -> SimulatorConfig:
    return SimulatorConfig(integration_scheme=rule, accuracy=accuracy, use_error_control=True)


# Soft walls need no implicit rule, and none is as exact as this. It does not mind the kinks.
_SOFT = _make_config("runge_kutta5", 1e-10)
# Friction has kinks where it is whole, of which a pole that balances for 3 s makes much. In space,
# where steps of 1e-10 take 1.5 times as long, ends of plans change by less than 1e-6 m.
_ROUGH, _IN_SPACE = (_make_config("runge_kutta5", accuracy) for accuracy in (1e-12, 1e-9))
# With a contact that lasts for fewer of the longest steps than this its trials leave all bounds.
_RESOLVED = 10.0
_STIFF = _make_config("radau3", 1e-7)
# Where friction sticks, Radau's rule would take steps of 30 ns. So the explicit rule is for stiff
# walls, too, with at least this number of steps in each contact.
_PER_CONTACT = 3.0
# There no step is longer than this part of the simulated time, so that none passes over a touch.
_LONGEST = 1 / 300
# Flight advances by this part of the predicted time to the wall, then predicts again, …
_APPROACH = 0.9
# … and at least so often, as a part of the simulated time.
_FLIGHT = 1 / 100
# The rest in durations of a contact. This near to the wall in time, and in it,
_NEAR = 0.5
# steps are so fine that no contact is stepped over and its depth is well resolved, …
_FINE_STEP = 1 / 20
# … unless it is older than this, so that the ball rests, …
SETTLED = 3.0
# … or as slow as this part of the fastest approach so far. Then they may be so long.
_SLOW = 1e-2
_COARSE_STEP = 10.0
# Radau's rule has its Jacobian from differences of √ε, and nearer to a wall than this part of the
# largest position, or of 1 m, takes it for touched. What leaves a wall goes on in fine steps until
# it is farther, unless that takes more than a number of durations of a contact.
_BLURRED, _LINGERS = 1e-7, 30.0
# Contacts that last have this part of their stiffness: forces of newtons press bodies together by
# nanometers, a blur to that Jacobian, with which steps are microseconds. So they do by no more than
# 1e-7 m a newton, where walls have 1e9 N/m; impacts of 1 m/s and 1 kg do by 3e-5 m.
_HELD_STIFFNESS = 1e-2
# Dissipation is matched to no speed below this part of the fastest approach so far: it grows as
# speeds fall, and with it the number of steps that bodies take which are pressed together.
_SLOWEST_MATCH = 5e-2


def make_simulator(world: World, scenario: Scenario) -> Simulator:
    """Returns Drake's Simulator of the world's diagram at the scenario's start, time 0.

    Its walls return what the scenario and the model's shapes say. In Drake that takes a
    Hunt-Crossley dissipation which depends on the speed of the impact, so that no model can have
    it beforehand: it is set just before each impact (`calc_dissipation`), in place of the model's.
    The scenario's mass counts, and so does its friction. All of that is in the Simulator's context
    alone: the plant and its scene graph stay as they are. If the scenario's contact is compliant,
    walls are as the model has them, and an explicit rule of fifth order integrates.

    Walls are as stiff as the model has them, so that a bounce is late by π √(m / k), but for
    contacts that last: of these a hundredth is left until they end, in the context alone, too. The
    integrator is Radau's of third order, in steps so fine about contacts that none is missed. What
    else is in the diagram runs as it is: controllers, loggers, visualizers.

    What does all this is the Simulator's monitor (`Simulator.get_monitor`): call it from the one
    that replaces it, if you set one of your own.

    Args:
        world: of a diagram of your own (`World.from_diagram`), in which something drives the
            actuators; or of a scenario, whose diagram has an input port "actuation" to fix.
        scenario: start, restitution, friction and duration; it has to fit the world
            (`World.check`). Simulations may go on beyond the duration.

    Raises:
        ScenarioError: it does not fit.
        ModelError: the model does not fit, or a shape has no stiffness.
    """
    scenario = world.place(scenario)
    world.check(scenario)
    simulator, contacts = start_plant(world, scenario, (0.0, scenario.duration))
    if contacts is not None:
        simulator.set_monitor(contacts)
    return simulator


def start_plant(
    world: World, scenario: Scenario, span: tuple[float, float]
) -> tuple[Simulator, ContactMonitor | None]:
    """Returns the Simulator of `make_simulator`, and the monitor that it needs if walls are stiff.

    Args:
        world: of the diagram.
        scenario: has to fit the world.
        span: from when to when it will simulate [s].

    Raises:
        ModelError: a shape has no stiffness.
    """
    root = world.create_context()
    world.rubbing.impose(root, scenario.friction)
    context = world.plant.GetMyMutableContextFromRoot(root)
    state = scenario.initial_position, scenario.initial_velocity
    world.plant.SetPositionsAndVelocities(context, np.concatenate(state))
    simulator, duration = Simulator(world.diagram, root), span[1] - span[0]
    root.SetTime(span[0])
    if scenario.contact == "rigid" and world.num_contacts:
        accuracy = _ACCURACY if world.has_constant_inertia else _FINE_ACCURACY
        ApplySimulatorConfig(_make_config("radau3", accuracy), simulator)
        monitor = ContactMonitor(world, simulator, world.restitutions(scenario), duration)
        return simulator, monitor
    longest = _LONGEST * duration
    shortest = min(contact_delays(world), default=math.inf)
    if world.dry_friction is not None or (world.frictions and scenario.friction != 0):
        config = _IN_SPACE if isinstance(world, SpaceWorld) else _ROUGH
        longest = min(longest, shortest / _PER_CONTACT)
    else:
        config = _STIFF if shortest < _RESOLVED * longest else _SOFT
    ApplySimulatorConfig(config, simulator)
    simulator.get_mutable_integrator().set_maximum_step_size(longest)
    return simulator, None


class ContactMonitor:
    """Called after each step, gives contacts their dissipation and chooses how long steps may be.

    Attributes:
        speeds: for which dissipation was set so far, restitution < 1 only [m/s].
    """

    def __init__(
        self, world: World, simulator: Simulator, restitutions: Floats, duration: float
    ) -> None:
        """Looks at nothing yet.

        Args:
            world: whose diagram is simulated.
            simulator: what is to call this.
            restitutions: e of each contact, in [0, 1], shape (m,).
            duration: about how long it will simulate [s].

        Raises:
            ModelError: a shape has no stiffness.
        """
        self._world = world
        self._simulator = weakref.ref(simulator)  # It holds this: neither would ever be freed.
        self._motion_at = ContactMotion.reader(world)
        self._stiffness = world.stiffness
        self.speeds: list[float] = []
        start, flight = simulator.get_context().get_time(), _FLIGHT * duration
        self._longest_delay = math.inf if world.has_constant_inertia else flight
        self._solids = [
            _SolidPace(world, restitutions, faces, flight, start, self.speeds)
            for faces in world.solids
        ]
        self._planned, self._due = -math.inf, -math.inf  # [s]
        self._longest_step = math.inf

    def __call__(self, root: Context) -> None:
        """Plans, unless the next step can't lead beyond what was planned."""
        if not self._planned <= root.get_time() <= self._due:
            self.plan(root)

    def plan(self, root: Context) -> None:
        """Plans the next steps from the state, and the control, as they are."""
        now = root.get_time()
        stretch, step = self._find_steps(root)
        simulator = self._simulator()
        assert simulator is not None, "it called"
        integrator = simulator.get_mutable_integrator()
        if step > self._longest_step:
            # What leaves a wall starts anew: Radau's rule keeps its Jacobian as long as Newton's
            # method converges with it. That of a contact is a million times too stiff for flight,
            # and may converge to a wrong velocity, in tiny steps.
            accuracy = integrator.get_target_accuracy()
            integrator.Reset()
            integrator.set_target_accuracy(accuracy)
            integrator.Initialize()
        integrator.set_maximum_step_size(step)
        integrator.request_initial_step_size_target(step)  # Else Drake refuses to start anew.
        self._longest_step = step
        self._planned, self._due = now, now + stretch - step

    def _find_steps(self, root: Context) -> tuple[float, float]:
        """Returns how long to go on before planning again, and the longest step [s]."""
        plant = self._world.plant
        context = plant.GetMyContextFromRoot(root)
        x = plant.GetPositionsAndVelocities(context)
        control = plant.get_net_actuation_output_port().Eval(context)
        motion = self._motion_at(x)
        clearances = motion.calc_clearances(x)
        delays = calc_delays(motion, self._stiffness, self._longest_delay)

        def calc_pushes(but: int | None = None) -> list[float]:
            world = self._world
            acceleration = calc_acceleration(world, motion, x, control, clearances, but)
            return motion.calc_pushes(acceleration)

        pushes = calc_pushes()
        blurred = _BLURRED * max(1.0, float(np.max(np.abs(x[: x.size // 2]))))
        plans = [
            pace.plan(
                root,
                near,
                (calc_pushes(near.contact) if pace.began_pressed(near) else pushes)[near.contact],
                blurred,
                delays,
            )
            for pace, near in zip(self._solids, clearances, strict=True)
        ]
        return min(stretch for stretch, _ in plans), min(step for _, step in plans)


class _SolidPace:
    """Steps that one solid asks for, and properties of its contacts for the coming impact."""

    def __init__(
        self,
        world: World,
        restitutions: Floats,
        faces: tuple[int, ...],
        flight: float,
        start: float,
        speeds: list[float],
    ) -> None:
        self._world, self._restitutions = world, restitutions
        self._faces, self._flight, self._speeds = faces, flight, speeds
        self._touched = start  # no contact that is still going on began before this [s]
        self._is_slow = False
        self._is_matched = False
        self._held: int | None = None  # the contact that lasts
        self._fastest = 0.0  # approach so far [m/s]

    def began_pressed(self, near: Clearance) -> bool:
        """Returns whether a contact goes on that nothing approached: closed at the start."""
        return near.distance <= 0 and not self._is_matched

    def plan(
        self, root: Context, near: Clearance, push: float, blurred: float, delays: list[float]
    ) -> tuple[float, float]:
        """Returns how long to go on before planning again, and the longest step [s].

        The push is φ̈ without this contact [m/s²]; an integrator takes a wall for touched where it
        is blurred [m]; delays are how long each contact of the world would last here [s].
        """
        time, delay = root.get_time(), min(delays[i] for i in self._faces)
        self._fastest = max(self._fastest, -near.rate)
        if near.distance > 0 and self._held is not None:
            set_stiffness(self._world, root, self._held, 1.0)
            self._held = None
        if 0 < near.distance < blurred:
            leaving = calc_time_to_wall(blurred - near.distance, -near.rate, -push)
            if leaving < _LINGERS * delay:
                step = _FINE_STEP * delay
                return max(leaving, step), step
        if near.distance > 0:
            fall = calc_time_to_wall(near.distance, near.rate, push)
            if fall > _NEAR * delay:
                stretch = min(_APPROACH * fall, self._flight)
                self._touched, self._is_slow, self._is_matched = time + stretch, False, False
                return stretch, stretch
            self._touched, self._is_slow = time, -near.rate <= _SLOW * self._fastest
        if near.rate < 0 and not self._is_matched:
            self._match(root, near, push, delays[near.contact])
            self._is_matched = True
        is_settled = time - self._touched > SETTLED * delay
        if is_settled and self._held is None:
            self._held = near.contact
            set_stiffness(self._world, root, near.contact, _HELD_STIFFNESS)
        if self._is_slow or is_settled:
            return 2 * _COARSE_STEP * delay, _COARSE_STEP * delay
        return delay, _FINE_STEP * delay

    def _match(self, root: Context, near: Clearance, push: float, delay: float) -> None:
        """Sets the dissipation for the speed of an approach, or of rest, or the slowest."""
        e, dissipation = float(self._restitutions[near.contact]), 0.0
        speed = math.sqrt(max(near.rate**2 - 2 * push * near.distance, 0.0))
        speed = max(speed, _SLOWEST_MATCH * self._fastest, abs(push) * delay)
        if e < 1 and speed > 0:
            dissipation = calc_dissipation(e, speed)
            self._speeds.append(speed)
        set_dissipation(self._world, root, near.contact, dissipation)


def calc_acceleration(
    world: World,
    motion: ContactMotion,
    x: Floats,
    control: Floats,
    clearances: Sequence[Clearance],
    but: int | None = None,
) -> Floats:
    """Returns v̇ as if the ball rested on all that it touches, but for one contact [m/s²]."""
    q, v = np.split(x, 2)
    touched = [near.contact for near in clearances if near.distance <= 0 and near.contact != but]
    return motion.calc_supported(world.calc_acceleration(q, v, control), touched)


def set_dissipation(world: World, root: Context, contact: int, dissipation: float) -> None:
    """Gives a contact a Hunt-Crossley dissipation [s/m], in this context only.

    Drake weighs those of the two shapes by the other one's stiffness. Where one shape belongs to
    other contacts too, as a ball between walls, its own becomes 0 and the other one's makes up for
    it, so that no other contact which is going on is another.
    """
    shapes, source = world.shapes[contact], world.plant.get_source_id()
    k = [read_given(world.scene_graph, shape, STIFFNESS)[0] for shape in shapes]
    alone = [_is_alone(world, shape) for shape in shapes]
    values = [dissipation, dissipation]
    if alone[0] != alone[1]:
        own = alone.index(True)
        values[1 - own] = 0.0
        values[own] = dissipation * (k[0] + k[1]) / k[1 - own]
    for shape, value in zip(shapes, values, strict=True):
        set_material(world.scene_graph, source, root, shape, DISSIPATION, value)


def set_stiffness(world: World, root: Context, contact: int, factor: float) -> None:
    """Gives a contact this part, at most 1, of its own stiffness, in this context only.

    Where one shape belongs to other contacts too, the other one is softer for both, so that no
    other contact is another. Where both do, nothing is changed.
    """
    shapes = [shape for shape in world.shapes[contact] if _is_alone(world, shape)]
    whole, source = world.stiffness[contact], world.plant.get_source_id()
    for shape in shapes:
        k = read_given(world.scene_graph, shape, STIFFNESS)[0]
        # 1/k of all is (Σ 1/k_i): what is added to it falls to those that may yield.
        value = 1 / (1 / k + (1 / factor - 1) / whole / len(shapes))
        set_material(world.scene_graph, source, root, shape, STIFFNESS, value)


def _is_alone(world: World, shape: GeometryId) -> bool:
    """Returns whether a shape can touch but one other."""
    return sum(shape in pair for pair in set(world.shapes)) == 1
