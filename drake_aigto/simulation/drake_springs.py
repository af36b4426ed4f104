"""Drake's own contact with the model's own stiffness and dissipation, recorded."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from pydrake.systems.framework import Context, EventStatus

from drake_aigto.arrays import Floats
from drake_aigto.simulation.contact_motion import calc_time_to_wall
from drake_aigto.simulation.controller import Controller
from drake_aigto.simulation.costs import sample_steps
from drake_aigto.simulation.recording import Recording
from drake_aigto.simulation.simulator import start_soft_simulator
from drake_aigto.simulation.springs import find_depth, read_touch
from drake_aigto.world import World


class StepEnd(NamedTuple):
    """The end of a step."""

    time: float  # [s]
    x: Floats  # (q, v)
    control: Floats  # that led there


def simulate_plant(
    world: World,
    state: tuple[Floats, Floats],
    controller: Controller,
    friction: float | None = None,
) -> Recording:
    """Runs a controller on the world's own plant, whose walls are as the model has them.

    Args:
        world: its diagram is simulated.
        state: the start, (q, v), maybe inside a wall.
        controller: decides the control, open or closed loop. One that feels contact is asked again
            at its next sample.
        friction: μ of all that slides, in this simulation only; None: the model's.

    Returns:
        The states whenever the controller is asked, at the end, and where each contact begins and
        ends; and samples of all motion between.
    """
    span = controller.start, controller.end
    simulator = start_soft_simulator(world, state, span, friction)
    plant, root = world.plant, simulator.get_mutable_context()
    context = plant.GetMyMutableContextFromRoot(root)
    recording, control = Recording(), np.zeros(world.num_actuators)
    rows = [StepEnd(controller.start, np.concatenate(state), control)]

    def watch(root: Context) -> EventStatus:
        x = plant.GetPositionsAndVelocities(plant.GetMyContextFromRoot(root))
        if root.get_time() > rows[-1].time:
            rows.append(StepEnd(root.get_time(), x, control))
        return EventStatus.DidNothing()

    simulator.set_monitor(watch)
    recording.add(controller.start, *state)
    while (now := context.get_time()) < controller.end:
        held = controller.sample(now, plant.GetPositionsAndVelocities(context), recording.bounces)
        recording.hold(now, held.control)
        control = held.control
        plant.get_actuation_input_port().FixValue(context, control)
        simulator.AdvanceTo(held.until)
        recording.add(held.until, *np.split(rows[-1].x, 2))
    read_steps(world, rows, recording)
    return recording


def read_steps(world: World, rows: list[StepEnd], recording: Recording) -> None:
    """Adds samples, contacts and depth to a recording, read off the ends of steps."""
    times, states = np.array([row.time for row in rows]), np.array([row.x for row in rows])
    controls = np.array([row.control for row in rows])
    recording.samples.append(sample_steps(times, states, controls))
    q, v = np.split(states, 2, axis=1)
    distances, rates = world.calc_signed_distance(q), world.calc_contact_rate(q, v)
    recording.max_penetration = find_depth(times, distances, rates)
    for contact in range(world.num_contacts):
        _read_contact(world, rows, contact, distances[:, contact], rates[:, contact], recording)
    recording.impacts.sort(key=lambda impact: impact.time)


def _read_contact(
    world: World,
    rows: list[StepEnd],
    contact: int,
    distances: Floats,
    rates: Floats,
    recording: Recording,
) -> None:
    """Adds the touches of one contact, given φ and φ̇ at each row, shape (K,)."""
    outside = distances > 0
    for before in np.flatnonzero(outside[:-1] & ~outside[1:]):
        a, b = rows[before], rows[before + 1]
        push = (rates[before + 1] - rates[before]) / (b.time - a.time)
        wait = calc_time_to_wall(distances[before], rates[before], push)
        time, x = _interpolate(a, b, wait)
        touch = read_touch(world, time, x, contact, b.control)
        after = np.flatnonzero(outside[before + 1 :])
        end = rows[before + 1 + after[0]] if len(after) else rows[-1]
        energy = float(world.calc_kinetic_energy(*np.split(end.x, 2)))
        recording.impacts.append(touch._replace(energy_after=energy))


def _interpolate(a: StepEnd, b: StepEnd, wait: float) -> tuple[float, Floats]:
    """Returns time and state a wait [s] after one row, at most at the next."""
    step = b.time - a.time
    t = min(wait, step) if math.isfinite(wait) else step
    (q, v), (_, later) = np.split(a.x, 2), np.split(b.x, 2)
    acceleration = (later - v) / step
    return a.time + t, np.concatenate([q + t * (v + t / 2 * acceleration), v + t * acceleration])
