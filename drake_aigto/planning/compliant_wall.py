"""Drake's own contact: the continuous plant, its compliant wall, and an implicit rule."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig

from drake_aigto.planning.contact_motion import ContactMotion, calc_time_to_wall
from drake_aigto.planning.material import contact_delay, set_dissipation
from drake_aigto.planning.recording import Impact, Recording

if TYPE_CHECKING:
    import numpy.typing as npt

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


def simulate_compliant_wall(
    world: World,
    state: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]],
    times: npt.NDArray[np.float64],
    controls: npt.NDArray[np.float64],
    dissipation: float | None = None,
) -> Recording:
    """Runs a held control on the world's own plant, by Radau's implicit rule.

    The plant and its scene graph stay as they are; another dissipation goes into the context alone.

    Args:
        world: its diagram is simulated, its stiffness decides where steps must be fine.
        state: the start, (q, v).
        times: of the knots, shape (N+1,) [s].
        controls: held between them, shape (N, nu).
        dissipation: Hunt-Crossley dissipation of the contact [s/m]; None keeps the model's.

    Returns:
        The states at all knots, and where each contact begins, is deepest, and ends.

    Raises:
        ModelError: a shape has no stiffness.
    """
    root = world.create_context()
    if dissipation is not None:
        set_dissipation(world, root, dissipation)
    context = world.plant.GetMyMutableContextFromRoot(root)
    world.plant.SetPositionsAndVelocities(context, np.concatenate(state))
    root.SetTime(times[0])
    simulator = Simulator(world.diagram, root)
    config = SimulatorConfig(integration_scheme=_SCHEME, accuracy=_ACCURACY, use_error_control=True)
    ApplySimulatorConfig(config, simulator)
    delay = contact_delay(world, state[0])
    pace = _Pace(world, delay, float(times[0]), float(times[-1] - times[0]))
    trace = _Trace(world, delay)
    simulator.set_monitor(
        lambda _: trace.add(context.get_time(), world.plant.GetPositionsAndVelocities(context))
    )
    for knot, control in zip(times[1:].tolist(), controls, strict=True):
        world.plant.get_actuation_input_port().FixValue(context, control)
        trace.control = control
        while context.get_time() < knot:
            x = world.plant.GetPositionsAndVelocities(context)
            stretch, step = pace.plan(context.get_time(), x, control)
            simulator.get_mutable_integrator().set_maximum_step_size(step)
            simulator.AdvanceTo(min(context.get_time() + stretch, knot))
    return trace.read(times)


class _Pace:
    """Chooses how far to simulate next, and in what steps, so that no contact is missed."""

    def __init__(self, world: World, delay: float, start: float, duration: float) -> None:
        self._world = world
        self._contact = ContactMotion(world)
        self._delay = delay
        self._flight = _FLIGHT * duration
        self._touched = start  # no contact that is still going on began before this [s]
        self._is_slow = False
        self._fastest = 0.0  # approach so far [m/s]

    def plan(
        self, time: float, x: npt.NDArray[np.float64], control: npt.NDArray[np.float64]
    ) -> tuple[float, float]:
        """Returns how long to go on before planning again, and the longest step [s]."""
        distance, rate = self._contact.calc_distance(x)
        self._fastest = max(self._fastest, -rate)
        if distance > 0:
            q, v = np.split(x, 2)
            push = self._contact.calc_push(x, self._world.calc_acceleration(q, v, control))
            fall = calc_time_to_wall(distance, rate, push)
            if fall > _NEAR * self._delay:
                stretch = min(_APPROACH * fall, self._flight)
                self._touched, self._is_slow = time + stretch, False
                return stretch, stretch
            self._touched, self._is_slow = time, -rate <= _SLOW * self._fastest
        if self._is_slow or time - self._touched > _SETTLED * self._delay:
            return _COARSE_STEP * self._delay, _COARSE_STEP * self._delay
        return self._delay, _FINE_STEP * self._delay


class _Sample(NamedTuple):
    """The end of a step, and the control that led to it."""

    time: float
    x: npt.NDArray[np.float64]
    control: npt.NDArray[np.float64]
    distance: float
    rate: float


_Row = tuple[float, "npt.NDArray[np.float64]"]  # time, (q, v)


class _Trace:
    """Every step of a simulation, and the contacts that are read off it."""

    def __init__(self, world: World, delay: float) -> None:
        self._world = world
        self._contact = ContactMotion(world)
        self._delay = delay
        self._samples: list[_Sample] = []
        self.control = np.zeros(world.num_actuators)

    def add(self, time: float, x: npt.NDArray[np.float64]) -> None:
        """Appends a step's end."""
        distance, rate = self._contact.calc_distance(x)
        self._samples.append(_Sample(time, x, self.control, distance, rate))

    def read(self, knots: npt.NDArray[np.float64]) -> Recording:
        """Returns the states at knots and about contacts, and the impacts."""
        at_knots = set(knots.tolist())
        rows = [(sample.time, sample.x) for sample in self._samples if sample.time in at_knots]
        recording = Recording(max_penetration=self._calc_depth())
        for first, last in self._find_contacts():
            touch, release = self._find_touch(first), self._find_release(last)
            deepest = min(self._samples[first : last + 1], key=lambda sample: sample.distance)
            rows += [touch, (deepest.time, deepest.x), release]
            impact = self._calc_impact(touch, release, self._samples[first].control)
            if impact is not None:
                recording.impacts.append(impact)
        for time, x in sorted(rows, key=lambda row: row[0]):
            recording.add(time, *np.split(x, 2))
        return recording

    def _find_contacts(self) -> list[tuple[int, int]]:
        """Returns the first and the last sample of each stretch with φ ≤ 0."""
        inside = np.array([sample.distance <= 0 for sample in self._samples])
        edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]])))
        return [(int(first), int(after) - 1) for first, after in edges.reshape(-1, 2)]

    def _find_touch(self, first: int) -> _Row:
        """Returns when and how contact began: from the flight before it, or the very start."""
        if first == 0:
            return self._samples[0].time, self._samples[0].x
        return self._extrapolate(self._samples[first - 1], self._samples[first].control, 1.0)

    def _find_release(self, last: int) -> _Row:
        """Returns when and how contact ended: from the flight after it, or the very end."""
        if last == len(self._samples) - 1:
            return self._samples[-1].time, self._samples[-1].x
        after = self._samples[last + 1]
        return self._extrapolate(after, after.control, -1.0)

    def _extrapolate(
        self, sample: _Sample, control: npt.NDArray[np.float64], direction: float
    ) -> _Row:
        """Returns when and how free flight is at the wall, forward (+1) or backward (−1)."""
        q, v = np.split(sample.x, 2)
        acceleration = self._world.calc_acceleration(q, v, control)
        push = self._contact.calc_push(sample.x, acceleration)
        t = calc_time_to_wall(sample.distance, direction * sample.rate, push)
        t = direction * t if math.isfinite(t) else 0.0
        x = np.concatenate([q + t * v + t**2 / 2 * acceleration, v + t * acceleration])
        return sample.time + t, x

    def _calc_impact(
        self, touch: _Row, release: _Row, control: npt.NDArray[np.float64]
    ) -> Impact | None:
        """Returns the impact, or None if the control alone could stop so slow a ball in contact."""
        q, v = np.split(touch[1], 2)
        speed = -self._contact.calc_distance(touch[1])[1]
        push = self._contact.calc_push(touch[1], self._world.calc_acceleration(q, v, control))
        if speed <= abs(push) * self._delay:
            return None
        energies = (
            self._contact.calc_kinetic_energy(np.split(x, 2)[1]) for _, x in (touch, release)
        )
        return Impact(touch[0], speed, push, *energies)

    def _calc_depth(self) -> float:
        """Returns the deepest penetration, of the parabola wherever φ̇ turns positive."""
        depths = [0.0] + [-sample.distance for sample in self._samples]
        for a, b in itertools.pairwise(self._samples):
            if a.rate < 0 < b.rate:
                t = (b.time - a.time) * a.rate / (a.rate - b.rate)
                depths.append(-a.distance - a.rate * t / 2)
        return max(depths)
